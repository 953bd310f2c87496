"""The fastest speed along a path within limits, from a start speed to rest.

Along the way s with x = V^2 and u = V', x changes by dx/ds = 2 u. Every limit is linear in (u, x):

    V <= v_max, V (1 + |k| B / 2) <= r omega_max, V^2 |k| <= lateral acceleration: x <= X(s)
    |u| <= acceleration
    |u (1 -+ k B / 2) -+ x k' B / 2| <= r omega'_max     left and right belt, without slip
Backwards from the end, the largest x from which the end can be reached; then forwards from the
start with the largest u that stays below it [1]. Between grid points u is constant, so that speed
and way are exact in time. The vehicle stops where it changes gear.

Slip changes sprocket speeds and is not in these limits: leave a reserve. Where the curvature jumps,
between arcs and lines, belt speeds jump with it whatever the speed.

References: [1] Pham and Pham, A new approach to time-optimal path parameterization based on
reachability analysis, IEEE Transactions on Robotics 34 (2018).

A trajectory from a path and the speed along it, with the sprocket speeds that drive it.

The path is that of the centre: its direction is the course. Slip is added to the belts: with the
speed v_k = V cos(alpha) -+ w B / 2 of each track over the ground,

    r omega_k = v_k + beta_k(omega_L, omega_R)        yaw = course - alpha(omega_L, omega_R)
solved by repeated substitution. The yaw rate in v_k is that of the course, as if alpha were steady.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), (29) to (31) with beta = r omega - v.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.curves import Path, end_errors, places
from baselines.planners.trajectory import Limits, Trajectory, checked_sample_count
from baselines.slip.slip_models import NoSlip, SlipModel
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]


SPACING = 0.01  # [m] of the grid along the path
MOST = 1_000_000  # intervals from one stop to the next: of more the grid is coarser
LEAST = 32  # intervals from one stop to the next at least
HALVINGS = 50  # of the interval that holds the largest reachable x


class SpeedProfile(NamedTuple):
    """Speed over the way, G grid points; constant acceleration between them."""

    distance: Array  # [m] (G,) along the path, in reverse too
    speed: Array  # [m/s] (G,) >= 0
    time: Array  # [s] (G,)
    acceleration: Array  # [m/s^2] (G - 1,)
    limit: Array  # [m/s] (G,) what curvature, sprockets and friction allow there
    reached: bool  # False: the start speed is too high for the limits


STANDING = SpeedProfile(
    np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(1), np.zeros(2), True
)  # for a path without length


@formula
def _range(x, curvature, sharpness, half_gauge, most, belt):
    """Least and largest u at x = V^2: accelerations of the vehicle and of both belts."""
    low, high = -most, most
    for side in range(2):
        sign = 2.0 * side - 1.0
        factor = 1.0 + sign * curvature * half_gauge
        rest = sign * x * sharpness * half_gauge
        if abs(factor) > 1e-9:
            ends = (-belt - rest) / factor, (belt - rest) / factor
            low, high = max(low, min(ends)), min(high, max(ends))
        elif abs(rest) > belt:
            low, high = math.inf, -math.inf
    return low, high


@formula
def _can_reach(x, after, gap, curvature, sharpness, half_gauge, most, belt):
    """Whether some u leads from x to at most `after` over a gap [m]."""
    low, high = _range(x, curvature, sharpness, half_gauge, most, belt)
    return low <= high and x + 2.0 * gap * low <= after


@loop
def _profile(gaps, bound, curvature, sharpness, half_gauge, most, belt, first, last, x, u):
    """x (G,) and u (G - 1,); returns whether the first x is kept."""
    count = len(gaps)
    x[count] = min(last, bound[count])
    for i in range(count - 1, -1, -1):
        low, high = 0.0, bound[i]
        shape = (curvature[i], sharpness[i], half_gauge, most, belt)
        if not _can_reach(high, x[i + 1], gaps[i], *shape):
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                if _can_reach(middle, x[i + 1], gaps[i], *shape):
                    low = middle
                else:
                    high = middle
            high = low
        x[i] = high
    kept = first <= x[0] * (1.0 + 1e-9) + 1e-12
    x[0] = min(first, x[0])
    for i in range(count):
        shape = (curvature[i], sharpness[i], half_gauge, most, belt)
        _, high = _range(x[i], *shape)
        u[i] = min(high, (x[i + 1] - x[i]) / (2.0 * gaps[i]))
        x[i + 1] = max(x[i] + 2.0 * gaps[i] * u[i], 0.0)
    return kept


def bound_speed(curvature: Array, limits: Limits, vehicle: PlantParameters) -> Array:
    """Speed [m/s] that limits allow at each curvature [1/m], accelerations apart."""
    bent = np.abs(curvature)
    belt = vehicle.sprocket_radius * limits.sprocket_used
    by_sprocket = belt / (1.0 + 0.5 * vehicle.track_gauge * bent)
    with np.errstate(divide="ignore"):
        by_friction = np.sqrt(limits.lateral_acceleration / bent)
    return np.minimum(np.minimum(by_sprocket, by_friction), limits.v_max)


def fastest(
    path: Path, limits: Limits, vehicle: PlantParameters, first: float = 0.0, last: float = 0.0
) -> SpeedProfile:
    """The fastest speed along a path, from `first` [m/s] to `last` [m/s], both >= 0.

    An infinite acceleration counts as one that is reached within a grid interval.
    """
    if not len(path.length):
        return STANDING
    stops = np.flatnonzero(np.diff(np.sign(path.length))) + 1
    ends = np.cumsum(np.abs(path.length))
    places_of_stops = [0.0, *ends[stops - 1], *ends[-1:]]
    parts, reached = [], True
    half_gauge = 0.5 * vehicle.track_gauge
    belt = vehicle.sprocket_radius * limits.sprocket_acceleration
    for number, (begin, end) in enumerate(itertools.pairwise(places_of_stops)):
        intervals = min(max(LEAST, math.ceil((end - begin) / SPACING)), MOST)
        grid = np.linspace(begin, end, intervals + 1)
        grid[1:-1] += 1e-12  # belongs to the piece that begins there
        at = places(path, grid)
        gaps = np.diff(grid)
        curvature = np.where(at.gear > 0, at.curvature, -at.curvature)
        bent = np.maximum(np.abs(at.curvature[:-1]), np.abs(at.curvature[1:]))
        bent = np.maximum(np.append(bent, 0.0), np.insert(bent, 0, 0.0))
        allowed = bound_speed(bent, limits, vehicle)
        steepest = float(np.max(allowed)) ** 2 / (2.0 * gaps[0])
        most, belt_most = min(limits.acceleration, steepest), min(belt, 2.0 * steepest)
        x, u = np.empty(intervals + 1), np.empty(intervals)
        begin_speed = first if number == 0 else 0.0
        end_speed = last if number == len(places_of_stops) - 2 else 0.0
        kept = _profile(
            gaps, allowed**2, curvature, at.sharpness, half_gauge, most, belt_most,
            begin_speed**2, end_speed**2, x, u,
        )  # fmt: skip
        reached = reached and bool(kept)
        parts.append((grid, np.sqrt(x), u, allowed))
    return _joined(parts, reached)


def constant(path: Path, speed: float, limits: Limits, vehicle: PlantParameters) -> SpeedProfile:
    """One speed [m/s] along the whole path."""
    length = path.whole_length
    if length == 0.0:
        return STANDING
    grid = np.linspace(0.0, length, 2)
    allowed = float(bound_speed(np.array([path.largest_curvature]), limits, vehicle)[0])
    time = grid / speed
    both = np.full(2, speed)
    return SpeedProfile(grid, both, time, np.zeros(1), np.full(2, allowed), True)


def _joined(parts: list[tuple[Array, Array, Array, Array]], reached: bool) -> SpeedProfile:
    """Profiles from stop to stop, one after the other."""
    grid = np.concatenate([part[0][min(i, 1) :] for i, part in enumerate(parts)])
    speed = np.concatenate([part[1][min(i, 1) :] for i, part in enumerate(parts)])
    allowed = np.concatenate([part[3][min(i, 1) :] for i, part in enumerate(parts)])
    u = np.concatenate([part[2] for part in parts])
    gaps = np.diff(grid)
    steps = 2.0 * gaps / np.maximum(speed[1:] + speed[:-1], 1e-12)
    return SpeedProfile(grid, speed, np.append(0.0, np.cumsum(steps)), u, allowed, reached)


SUBSTITUTIONS = 60  # at most; slip of identified surfaces converges in 5 to 20
SETTLED = 1e-9  # [rad/s] change of sprocket speeds that ends them
JUMP = 1e-3  # [rad/s] of a sprocket at once, above which a trajectory says so


def sample_times(duration: float, period: float) -> Array:
    """0, period, 2 period, ... and the duration [s]."""
    if duration == 0.0:
        return np.zeros(1)
    whole = np.arange(math.floor(duration / period * (1.0 - 1e-12)) + 1) * period
    return np.append(whole, duration)


def driven(
    path: Path, profile: SpeedProfile, goal: ArrayLike, limits: Limits, vehicle: PlantParameters,
    method: str, slip_model: SlipModel | None = None, message: str = "", period: float = 0.02,
) -> Trajectory:  # fmt: skip
    """The trajectory along `path` with `profile`, sampled every `period` [s] and at its end.

    It has `converged` unset, with a reason, where the sprockets would exceed the limits.
    """
    checked_sample_count(float(profile.time[-1]), period)
    times = sample_times(float(profile.time[-1]), period)
    distance, fast, u = _at(profile, times)
    place = places(path, distance)
    speed, acceleration = place.gear * fast, place.gear * u
    rate = place.curvature * speed
    bend = place.curvature * acceleration + place.sharpness * speed * speed
    left, right, alpha = sprockets(fast * place.gear, rate, vehicle, slip_model)
    alpha_rate = np.gradient(alpha, times) if len(times) > 1 else np.zeros_like(alpha)
    alpha_bend = np.gradient(alpha_rate, times) if len(times) > 1 else np.zeros_like(alpha)
    notes = [message] if message else []
    fastest = max(np.max(np.abs(left)), np.max(np.abs(right)))
    feasible = fastest <= limits.sprocket_used * (1.0 + 1e-9)
    if not feasible:
        notes.append(
            f"with slip the sprockets reach {fastest:.3g} rad/s of {limits.sprocket_used:.3g}"
        )
    if not profile.reached:
        notes.append("the start speed is too high for the limits")
    jump = _largest_jump(path, profile, vehicle)
    if jump > JUMP and math.isfinite(limits.sprocket_acceleration):
        notes.append(f"sprocket speeds jump by {jump:.3g} rad/s where the curvature jumps")
    missed, turned = end_errors(path, goal)
    return Trajectory(
        times, place.x, place.y, place.yaw - alpha, place.yaw, speed, acceleration, rate, bend,
        rate - alpha_rate, bend - alpha_bend, left, right, float(times[-1]),
        feasible and profile.reached, 0, missed, turned, method, "; ".join(notes),
    )  # fmt: skip


def sprockets(
    speed: Array, rate: Array, vehicle: PlantParameters, slip_model: SlipModel | None
) -> tuple[Array, Array, Array]:
    """Sprocket speeds (left, right) [rad/s] and slip angle alpha [rad], (M,) each.

    speed: [m/s] (M,) along the course, rate: [rad/s] (M,) of it.
    """
    turn, radius = 0.5 * vehicle.track_gauge * rate, vehicle.sprocket_radius
    left, right = (speed - turn) / radius, (speed + turn) / radius
    alpha = np.zeros_like(speed)
    if slip_model is None or isinstance(slip_model, NoSlip):
        return left, right, alpha
    for _ in range(SUBSTITUTIONS):
        beta_left, beta_right, alpha = slip_model.slip(left, right)
        forward = speed * np.cos(alpha)
        new = (forward - turn + beta_left) / radius, (forward + turn + beta_right) / radius
        change = max(np.max(np.abs(new[0] - left)), np.max(np.abs(new[1] - right)))
        left, right = new
        if change < SETTLED:
            break
    return left, right, alpha


def _at(profile: SpeedProfile, times: Array) -> tuple[Array, Array, Array]:
    """Distance [m], speed [m/s] and acceleration [m/s^2] at times (M,) [s]."""
    part = np.clip(np.searchsorted(profile.time, times, side="right") - 1, 0, len(profile.time) - 2)
    since, u = times - profile.time[part], profile.acceleration[part]
    speed = np.maximum(profile.speed[part] + u * since, 0.0)
    distance = profile.distance[part] + (profile.speed[part] + 0.5 * u * since) * since
    return np.clip(distance, 0.0, profile.distance[-1]), speed, u


def _largest_jump(path: Path, profile: SpeedProfile, vehicle: PlantParameters) -> float:
    """Largest jump of a sprocket speed [rad/s] where the curvature jumps, ends included."""
    ends = np.cumsum(np.abs(path.length))
    before = np.append(0.0, path.curvature + path.sharpness * path.length)
    jumps = np.abs(np.append(path.curvature, 0.0) - before)
    speed = np.interp(np.append(0.0, ends), profile.distance, profile.speed)
    per_curvature = 0.5 * vehicle.track_gauge / vehicle.sprocket_radius
    return float(np.max(jumps * speed, initial=0.0) * per_curvature)
