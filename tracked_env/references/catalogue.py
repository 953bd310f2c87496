"""The catalogue of references: functions that turn a few numbers into one.

With kappa = w / v the curvature of the path, left positive:
    straight         kappa = 0
    circle           kappa = +-1 / R
    spiral           kappa linear in time: at constant speed a clothoid
    figure_eight     yaw = a (1 - cos(Omega t)), a = first zero of the Bessel function J0: the
                     sine-generated curve that closes into an eight
    identification   straight, then a spiral from kappa = 0, with a speed that oscillates
    chicane          F (53), jumps in v and w
    random_smooth    v, w = sum_n V_n B((t - t_n) / T), B the cubic B-spline on knots of spacing T
    waypoints        the quintic spline through points over the chord length, at constant speed
Parameters are those that `specification` has checked. Angles in rad, the start is the origin, yaw
0, unless the pose is set afterwards. Every profile goes on by its own law until one segment after
`duration` and keeps v and w from there.

Random coefficients are drawn in a kernel, = clip(1.5 U(-1, 1), -1, 1), first those of v, then those
of w. Per interval of T four neighbours times `_spline_segments` give the polynomials; sums are
fused, so that the bits depend neither on the processor nor on the number of paths.
The path through way-points is C4 and straight at both ends (curvature and its derivative are zero
there). With s = v t the arc length, r(u) the spline and ' = d/du:
    kappa = (x' y'' - y' x'') / |r'|^3,  w = v kappa,  dw/dt = v^2 kappa' / |r'|
Per segment of time the polynomial w has six conditions: w and dw/dt at both ends, the exact
change of heading, and the exact mean heading. So the heading has no drift at all, and the
position none to first order; w is C1, hence the path C3.

References: [1] Focchi et al. 2025, (53). [2] Strawa et al., Electronics 10 (2021) 187, 8.3.
[3] Langbein, Leopold, River Meanders, USGS Prof. Paper 422-H, 1966 (sine-generated curve).
[4] de Boor, A Practical Guide to Splines, ch. IX-XI, XIII.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from tracked_env.physics.elementary import fused
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.reference_profile import SEGMENT_DURATION, UNIFORM_COLUMNS
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.references.profile import (
    DEGREE,
    FloatArray,
    ReferenceProfile,
    constant,
    derivative_row,
    fit,
    knot_times,
    number_of_segments,
    sample,
)
from tracked_env.streams import addresses, uniform

EIGHT_AMPLITUDE = 2.404825557695773  # [rad] a, first zero of J0
EIGHT_EXTENT = 0.7497418431069495  # [-] Struve H0(a): tip to tip over half the length
SMOOTHSTEP_SLOPE = 1.875  # [-] largest slope of 10 s^3 - 15 s^4 + 6 s^5
SPIRAL_ONSET = 2.0  # [s] over which the identification spiral begins to curve
SPIRAL_SHORTEST = 5.0  # [s] least time over which it reaches its final curvature
CHICANE_RAMP_TIME = 1.0  # [s] F (53) prints v = v_max t: v_max is reached after 1 s
RANDOM_STRETCH = 1.5  # [-] of the uniform draws before clipping, so that limits are visited
ACCELERATING = 0.1  # [-] effort of a track over m g, that a random path may take to accelerate
SPEED_LIMIT = 5.0  # [m/s] to which references are scaled
SLOWEST = 1e-9  # [m/s] below it the lateral acceleration limits nothing
PASSING_TOLERANCE = 1e-3  # [m] to each way-point
PANELS = 4  # [-] quadrature panels between two way-points
NEWTON_STEPS = 4  # [-] for the inverse of the arc length; quadratic from 1e-2


def _smooth_ramp(
    times: FloatArray, start: float, end: float, acceleration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Value, first and second derivative (T,) of a C2 change with that peak rate [1/s]."""
    least = SMOOTHSTEP_SLOPE * abs(end - start) / acceleration
    duration = max(math.ceil(least / SEGMENT_DURATION), 1) * SEGMENT_DURATION
    s = np.minimum(times / duration, 1.0)
    change = end - start
    value = start + change * s * s * s * (10.0 - s * (15.0 - 6.0 * s))
    first = change / duration * 30.0 * s * s * (1.0 - s) ** 2
    second = change / duration**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    return value, first, second


def straight(
    duration: float,
    speed: float = 2.0,
    initial_speed: float | None = None,
    acceleration: float = 1.0,
) -> ReferenceProfile:
    """Straight ahead at `speed` [m/s]; from `initial_speed` by a C2 ramp if that is given.

    acceleration: largest of the ramp [m/s^2].
    """
    times = knot_times(number_of_segments(duration))
    start = speed if initial_speed is None else initial_speed
    v = fit(*_smooth_ramp(times, start, speed, acceleration))
    return ReferenceProfile(v, constant(0.0, len(v)))


def circle(
    duration: float, speed: float = 2.0, radius: float = 10.0, direction: float = 1.0
) -> ReferenceProfile:
    """Circle of `radius` [m]; its centre is to the left for direction +1, right for -1."""
    n = number_of_segments(duration)
    return ReferenceProfile(constant(speed, n), constant(direction * speed / radius, n))


def figure_eight(
    duration: float, speed: float = 2.0, size: float = 30.0, direction: float = 1.0
) -> ReferenceProfile:
    """An eight from its crossing point; `size` [m] is the distance between its two tips.

    One round is 2 size / H0(a) = 2.668 size long and takes 2 pi / Omega = length / speed; the first
    lobe is to the left for direction +1. Largest curvature a pi H0(a) / size = 5.66 / size, at the
    tips.
    """
    times = knot_times(number_of_segments(duration))
    omega = math.pi * EIGHT_EXTENT * speed / size
    amplitude = direction * EIGHT_AMPLITUDE * omega
    sine, cosine = np.sin(omega * times), np.cos(omega * times)
    w = fit(amplitude * sine, amplitude * omega * cosine, -amplitude * omega**2 * sine)
    return ReferenceProfile(constant(speed, len(w)), w)


def spiral(
    duration: float,
    speed: float = 2.0,
    radius_start: float = 30.0,
    radius_end: float = 8.0,
    direction: float = 1.0,
) -> ReferenceProfile:
    """Clothoid: curvature linear in time from 1 / radius_start to 1 / radius_end [1/m].

    The end value is reached at the first knot at or after `duration`, then kept.
    """
    times = knot_times(number_of_segments(duration))
    start, end = direction * speed / radius_start, direction * speed / radius_end
    slope = (end - start) / times[-2]
    w = constant(0.0, len(times) - 1)
    w[:, 0] = start + slope * times[:-1]
    w[:-1, 1] = slope
    return ReferenceProfile(constant(speed, len(w)), w)


def identification(
    duration: float,
    speed: float = 2.0,
    initial_speed: float = 0.5,
    straight_duration: float = 7.0,
    radius_end: float = 6.0,
    direction: float = 1.0,
    speed_amplitude: float = 0.2,
    speed_period: float = 4.0,
) -> ReferenceProfile:
    """The manoeuvre of [2] 8.3: straight, then a spiral, both with an oscillating speed.

    v = C2 ramp from `initial_speed` with 1 m/s^2 at most + speed_amplitude sin(2 pi t /
    speed_period). The curvature is 0 for `straight_duration` and reaches 1 / radius_end at the end
    of the profile (or after SPIRAL_SHORTEST); it grows linearly but for a C3 onset. The paper
    prints neither radius nor speed.
    """
    times = knot_times(number_of_segments(duration))
    v, dv, ddv = _smooth_ramp(times, initial_speed, speed, acceleration=1.0)
    rate = 2.0 * math.pi / speed_period
    sine, cosine = np.sin(rate * times), np.cos(rate * times)
    v = v + speed_amplitude * sine
    dv = dv + speed_amplitude * rate * cosine
    ddv = ddv - speed_amplitude * rate**2 * sine
    elapsed = np.maximum(times - straight_duration, 0.0)
    growth = max(times[-1] - straight_duration, SPIRAL_SHORTEST)
    slope = direction / (radius_end * (growth - 0.5 * SPIRAL_ONSET))  # [1/(m s)] d kappa / dt
    u = np.minimum(elapsed / SPIRAL_ONSET, 1.0)  # integral of the smoothstep, then linear
    onset = SPIRAL_ONSET * u**4 * (2.5 - u * (3.0 - u))
    kappa = slope * (onset + np.maximum(elapsed - SPIRAL_ONSET, 0.0))
    dkappa = slope * u**3 * (10.0 - u * (15.0 - 6.0 * u))
    ddkappa = slope / SPIRAL_ONSET * 30.0 * (u * (1.0 - u)) ** 2
    w = fit(v * kappa, dv * kappa + v * dkappa, ddv * kappa + 2.0 * dv * dkappa + v * ddkappa)
    return ReferenceProfile(fit(v, dv, ddv), w)


def chicane(
    duration: float,
    speed: float = 1.0,
    yaw_rate: float = 0.3,
    turn_time: float = 2.0,
    switch_time: float = 12.0,
) -> ReferenceProfile:
    """The deliberately discontinuous chicane F (53): ramp, left turn, right turn.

    v = speed t / (1 s) until `turn_time` [s], then `speed`: as printed, v overshoots by
    turn_time / (1 s) and jumps back. w = 0, then `yaw_rate` [rad/s], from `switch_time` [s]
    on -yaw_rate. The paper has 0.2 m/s, 0.3 rad/s and 20 s, for a vehicle of 62 kg. Raises
    ValueError where the right turn would come first.
    """
    if turn_time > switch_time:
        raise ValueError(
            f"switch_time = {switch_time} s; must be >= turn_time = {turn_time} s. The left turn "
            "comes first."
        )
    starts = knot_times(number_of_segments(duration))[:-1]
    before = starts < turn_time - 0.5 * SEGMENT_DURATION
    v, w = constant(speed, len(starts)), constant(-yaw_rate, len(starts))
    v[before, 0] = speed / CHICANE_RAMP_TIME * starts[before]
    v[before, 1] = speed / CHICANE_RAMP_TIME
    w[starts < switch_time - 0.5 * SEGMENT_DURATION, 0] = yaw_rate
    w[before, 0] = 0.0
    return ReferenceProfile(v, w)


@lru_cache
def _spline_segments(per_interval: int) -> FloatArray:
    """Map (4, 6 per_interval): four B-spline coefficients @ it = the segments of an interval."""
    u = np.arange(per_interval + 1) / per_interval
    rate = 1.0 / (per_interval * SEGMENT_DURATION)
    one = np.ones_like(u)
    value = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    first = [-3 * (1 - u) ** 2, 9 * u**2 - 12 * u, -9 * u**2 + 6 * u + 3, 3 * u**2]
    second = [6 * (1 - u), 18 * u - 12 * one, 6 * one - 18 * u, 6 * u]
    rows = [
        fit(f / 6, df * rate / 6, ddf * rate**2 / 6)
        for f, df, ddf in zip(value, first, second, strict=True)
    ]
    return np.stack([row.ravel() for row in rows])


@formula
def _clipped_draws(rng, out):
    """=clip(1.5 U(-1, 1), -1, 1) each; steady at the start, where derivatives are zero."""
    for n in range(out.size):
        out[n] = min(max(RANDOM_STRETCH * uniform(rng, -1.0, 1.0), -1.0), 1.0)
    out[1] = out[2] = out[0]


@formula
def _limited(v, w, lateral_acceleration):
    """Reduce w (C,) where |v w| could exceed the limit: V_n meets W_m for |n - m| <= 3."""
    for n in range(v.size):
        fastest = SLOWEST
        for m in range(max(n - 3, 0), min(n + 4, v.size)):
            fastest = max(fastest, abs(v[m]))
        bound = lateral_acceleration / fastest
        w[n] = min(max(w[n], -bound), bound)


@formula
def _write(coefficients, segments, row, out):
    """Fill out (S, 6) with the polynomials of the spline; row: room for those of an interval."""
    width = DEGREE + 1
    per_interval = row.size // width
    for n in range(coefficients.size - 3):
        for j in range(row.size):
            total = coefficients[n] * segments[0, j]
            for m in range(1, 4):
                total = fused(coefficients[n + m], segments[m, j], total)
            row[j] = total
        for k in range(n * per_interval, min((n + 1) * per_interval, out.shape[0])):
            for j in range(width):
                out[k, j] = row[(k - n * per_interval) * width + j]


@loop
def draw_paths(rngs, vehicles, profile, limits, segments):
    """Draw the references of the chosen vehicles into profile (S, N, 12), see `RandomPaths`.

    rngs: addresses of their generators.
    """
    per_interval = segments.shape[1] // (DEGREE + 1)
    count = -(-profile.shape[0] // per_interval) + 3
    v, w, row = np.empty(count), np.empty(count), np.empty(segments.shape[1])
    for k in range(vehicles.size):
        its = limits[vehicles[k]]
        middle, half = 0.5 * (its[0] + its[1]), 0.5 * (its[1] - its[0])
        _clipped_draws(rngs[k], v)
        _clipped_draws(rngs[k], w)
        for n in range(count):
            v[n] = middle + half * v[n]
            w[n] = its[2] * w[n]
        _limited(v, w, its[3])
        _write(v, segments, row, profile[:, vehicles[k], :6])
        _write(w, segments, row, profile[:, vehicles[k], 6:])


@formula
def pace(p, other, fastest):
    """Factors for the vehicle p on speeds and yaw rates that are for `other`.

    fastest [m/s]: the largest of the speeds, which stays below SPEED_LIMIT.
    """
    ratio = p.sprocket_radius * p.sprocket_speed_limit
    ratio /= other.sprocket_radius * other.sprocket_speed_limit
    faster = min(ratio, max(SPEED_LIMIT / fastest, 1.0)) if fastest > 0.0 else ratio
    return faster, min(ratio * other.track_gauge / p.track_gauge, 1.0)


@formula
def gentleness(p, limits, knot_interval):
    """Factor <= 1 on the limits of random paths: accelerating then takes at most ACCELERATING."""
    along = 0.5 * (limits[1] - limits[0]) / knot_interval / GRAVITY
    turning = 2.0 * limits[2] / knot_interval
    share = along + p.inertia * turning / (p.track_gauge * p.mass * GRAVITY)
    return min(ACCELERATING / share, 1.0) if share > 0.0 else 1.0


@loop
def scale_limits(rows, vehicles, written, others, knot_interval, limits):
    """Limits (N, 4) of the paths of the vehicles in these rows, by `pace` and `gentleness`.

    written (4,): limits for others[0], the yaw rate for others[1]; vehicles (N,), others (2,):
    records of parameters.
    """
    fastest = max(abs(written[0]), abs(written[1]))
    for k in range(rows.size):
        p, own = vehicles[rows[k]], limits[rows[k]]
        faster, turning = pace(p, others[0], fastest)[0], pace(p, others[1], fastest)[1]
        own[0], own[1], own[2] = faster * written[0], faster * written[1], turning * written[2]
        factor = gentleness(p, own, knot_interval)
        for j in range(3):
            own[j] *= factor
        own[3] = written[3]


class RandomPaths(NamedTuple):
    """Paths of one law for a batch of vehicles."""

    limits: FloatArray  # (N, 4) speed low, high [m/s], yaw rate [rad/s], lateral acc. [m/s^2]
    segments: FloatArray  # of `_spline_segments`


def random_paths(
    speed_range: tuple[float, float] = (1.0, 3.0),
    yaw_rate_limit: float = 0.5,
    lateral_acceleration_limit: float = 1.5,
    knot_interval: float = 2.0,
) -> RandomPaths:
    """The law of `random_smooth`.

    Coefficients of v =clip(..) over `speed_range` [m/s], of w =clip(..) within +-`yaw_rate_limit`
    [rad/s], reduced where |v w| could exceed `lateral_acceleration_limit` [m/s^2].
    """
    limits = np.array([[*speed_range, yaw_rate_limit, lateral_acceleration_limit]], dtype=float)
    return RandomPaths(limits, _spline_segments(round(knot_interval / SEGMENT_DURATION)))


def random_smooth(duration: float, rng: np.random.Generator, **law: Any) -> ReferenceProfile:
    """Random smooth path: v and w are cubic B-splines, C2, with one coefficient an interval.

    law: arguments of `random_paths`. A B-spline never leaves the hull of its coefficients, so all
    limits hold exactly at all times, and |v'| <= (high - low) / knot_interval.
    """
    profile = np.empty((number_of_segments(duration), 1, UNIFORM_COLUMNS))
    draw_paths(addresses([rng]), np.zeros(1, np.int64), profile, *random_paths(**law))
    return ReferenceProfile(profile[:, 0, :6].copy(), profile[:, 0, 6:].copy())


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # on [0, 1]
_CONDITIONS = [derivative_row(t, order) for order in (0, 1) for t in (0.0, SEGMENT_DURATION)]
_CONDITIONS += [derivative_row(SEGMENT_DURATION, order) for order in (-1, -2)]
_FIT = np.linalg.inv(np.array(_CONDITIONS)).T  # (6, 6): conditions @ this


class _Path:
    """The spline through points (M, 2) with its arc length; beyond its end it is straight."""

    def __init__(self, points: FloatArray) -> None:
        from scipy.interpolate import make_interp_spline  # 0.4 s to import: only when used

        chords = np.hypot(*np.diff(points, axis=0).T)
        knots = np.concatenate([[0.0], np.cumsum(chords)])
        straight_end = [(2, np.zeros(2)), (3, np.zeros(2))]
        ends: Any = (straight_end, straight_end)  # the stubs know the named conditions only
        spline = make_interp_spline(knots, points, k=5, bc_type=ends)
        self._first, self._second, self._third = (spline.derivative(n) for n in (1, 2, 3))
        fractions = np.arange(PANELS) / PANELS
        panels = (knots[:-1, None] + chords[:, None] * fractions).ravel()
        self._panels = np.append(panels, knots[-1])
        lengths = self._length(self._panels[:-1], np.diff(self._panels))
        self._arc = np.concatenate([[0.0], np.cumsum(lengths)])
        self.arc_of_points = self._arc[::PANELS]

    def _length(self, start: FloatArray, extent: FloatArray) -> FloatArray:
        """Arc length [m] from parameter `start` over `extent`, both (n,)."""
        tangent = self._first(start[:, None] + extent[:, None] * _NODES)
        return extent * (np.hypot(tangent[..., 0], tangent[..., 1]) @ _WEIGHTS)

    def parameter(self, arc: FloatArray) -> FloatArray:
        """Return u with s(u) = arc [m] (n,), limited to the path."""
        arc = np.minimum(arc, self._arc[-1])
        panel = np.clip(np.searchsorted(self._arc, arc, "right") - 1, 0, len(self._arc) - 2)
        start, base = self._panels[panel], self._arc[panel]
        width = self._panels[panel + 1] - start
        extent = width * (arc - base) / (self._arc[panel + 1] - base)
        for _ in range(NEWTON_STEPS):
            tangent = self._first(start + extent)
            missing = arc - base - self._length(start, extent)
            extent = np.clip(extent + missing / np.hypot(*tangent.T), 0.0, width)
        return start + extent

    def heading(self, u: FloatArray) -> FloatArray:
        """Heading [rad] at sorted u (n,), unwrapped."""
        tangent = self._first(u)
        return np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))

    def curvature(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Curvature [1/m] and its derivative by the arc length [1/m^2] at u (n,)."""
        (x1, y1), (x2, y2), (x3, y3) = self._first(u).T, self._second(u).T, self._third(u).T
        tangent2 = x1 * x1 + y1 * y1
        tangent3 = tangent2 * np.sqrt(tangent2)
        kappa = (x1 * y2 - y1 * x2) / tangent3
        bend = (x1 * y3 - y1 * x3) / tangent3 - 3.0 * kappa * (x1 * x2 + y1 * y2) / tangent2
        return kappa, bend / np.sqrt(tangent2)


@lru_cache(maxsize=64)
def _profile(points_bytes: bytes, speed: float, segments: int) -> ReferenceProfile:
    """Build the profile (10 ms); an episode that repeats the points finds it here."""
    points = np.frombuffer(points_bytes).reshape(-1, 2)
    path = _Path(points)
    starts = knot_times(segments)
    # Per segment: its start and the quadrature nodes, in one sorted list of times.
    times = starts[:, None] + SEGMENT_DURATION * np.concatenate([[0.0], _NODES])
    u = path.parameter(speed * times.ravel())
    heading = path.heading(u).reshape(times.shape)
    kappa, bend = path.curvature(u.reshape(times.shape)[:, 0])
    w, dw = speed * kappa, speed**2 * bend
    turn = np.diff(heading[:, 0])
    mean = SEGMENT_DURATION * ((heading[:-1, 1:] - heading[:-1, :1]) @ _WEIGHTS)
    yaw_rate = np.stack([w[:-1], w[1:], dw[:-1], dw[1:], turn, mean], axis=1) @ _FIT
    (x, y), yaw = points[0].tolist(), float(heading[0, 0])
    profile = ReferenceProfile(constant(speed, segments), yaw_rate, x, y, yaw)
    _check_passing(profile, points, path.arc_of_points / speed)
    return profile


def _check_passing(profile: ReferenceProfile, points: FloatArray, times: FloatArray) -> None:
    """Raise ValueError unless the profile passes every way-point that it has time for."""
    reached = times <= len(profile.speed) * SEGMENT_DURATION
    path = sample(profile, times[reached])
    miss = np.hypot(path.x - points[reached, 0], path.y - points[reached, 1])
    worst = int(miss.argmax())
    if not miss[worst] <= PASSING_TOLERANCE:
        raise ValueError(
            f"points: the path misses way-point {worst} by {miss[worst]:.2g} m; must be within "
            f"{PASSING_TOLERANCE} m. Its curvature changes too fast for {SEGMENT_DURATION} s "
            "segments: lower the speed, or spread or smooth the way-points."
        )


def waypoints(duration: float, points: FloatArray, speed: float = 2.0) -> ReferenceProfile:
    """Path through `points` (M, 2) [m], world frame, M >= 2, at `speed` [m/s] > 0.

    The start pose is the first point, along the path. A path longer than the profile is truncated
    by time; after the last point the reference goes straight on at the same speed. Raises
    ValueError if a way-point were missed by more than 1 mm.
    """
    data = np.ascontiguousarray(points, dtype=np.float64).tobytes()
    cached = _profile(data, float(speed), number_of_segments(duration))
    return cached._replace(speed=cached.speed.copy(), yaw_rate=cached.yaw_rate.copy())
