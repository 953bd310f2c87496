"""Paths, the speed along them, and the trajectory with the sprocket speeds that drive them.

Path: pieces whose curvature is linear in the way along it,
    k(s) = k_0 + k' s        yaw(s) = yaw_0 + k_0 s + k' s^2 / 2
each forwards or in reverse; s is the signed way along it, so that yaw' = k s' holds in both.
Clothoids are evaluated by Gauss-Legendre quadrature. Frame: world; yaw is continuous.

Speed: the fastest within limits. Along the way s with x = V^2 and u = V', x changes by
dx/ds = 2 u. Every limit is linear in (u, x):
    V <= v_max, V (1 + |k| B / 2) <= r omega_max, V^2 |k| <= lateral acceleration: x <= X(s)
    |u| <= acceleration
    |u (1 -+ k B / 2) -+ x k' B / 2| <= r omega'_max     left and right belt, without slip
Backwards from the end, the largest x from which the end can be reached; then forwards from the
start with the largest u that stays below it [1]. Between grid points u is constant. The vehicle
stops where it changes gear. Slip changes sprocket speeds and is not in these limits: leave a
reserve. Where the curvature jumps, between arcs and lines, belt speeds jump with it.

Trajectory: the path is that of the centre, its direction is the course. Slip is added to the belts:
with the speed v_k = V cos(alpha) -+ w B / 2 of each track over the ground,
    r omega_k = v_k + beta_k(omega_L, omega_R)        yaw = course - alpha(omega_L, omega_R)
solved by repeated substitution. The yaw rate in v_k is that of the course, as if alpha were steady.

References: [1] Pham and Pham, A new approach to time-optimal path parameterization based on
reachability analysis, IEEE Transactions on Robotics 34 (2018). [F] Focchi et al., Pseudo-Kinematic
Trajectory Control and Planning of Tracked Vehicles (2025), (29) to (31) with beta = r omega - v.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import Limits, Trajectory, checked_sample_count, slope_of
from baselines.slip.slip_models import NoSlip, SlipModel
from tracked_env.physics.jit import copy_entries, formula, loop
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
PART = 3.0  # [rad] of turning a part of the quadrature at most
STEPS = 200  # of the integration of a piece
SPACING = 0.01  # [m] of the grid along the path
MOST = 1_000_000  # intervals from one stop to the next: of more the grid is coarser
LEAST = 32  # intervals from one stop to the next at least
HALVINGS = 50  # of the interval that holds the largest reachable x
SUBSTITUTIONS = 60  # at most; slip of identified surfaces converges in 5 to 20
SETTLED = 1e-9  # [rad/s] change of sprocket speeds that ends them
JUMP = 1e-3  # [rad/s] of a sprocket at once, above which a trajectory says so


class Path(NamedTuple):
    """A path of P pieces from a pose."""

    start: Array  # (3,) x, y [m], yaw [rad]
    length: Array  # [m] (P,) of each piece, signed: negative in reverse
    curvature: Array  # [1/m] (P,) at the beginning of the piece, positive to the left
    sharpness: Array  # [1/m^2] (P,) k', over the signed way

    @classmethod
    def of(
        cls, start: ArrayLike, length: ArrayLike, curvature: ArrayLike, sharpness: ArrayLike = 0.0
    ) -> "Path":
        """A path without the pieces that have no length."""
        rows = np.broadcast_arrays(*(np.asarray(v, float) for v in (length, curvature, sharpness)))
        pieces = np.abs(rows[0]) > 0.0
        return cls(np.array(start, dtype=np.float64), *(row[pieces] for row in rows))

    @property
    def whole_length(self) -> float:
        """Way along all pieces [m], in reverse too."""
        return float(np.sum(np.abs(self.length)))

    @property
    def largest_curvature(self) -> float:
        """Largest |k| [1/m]; 0 for a path without pieces."""
        ends = np.abs([self.curvature, self.curvature + self.sharpness * self.length])
        return float(np.max(ends, initial=0.0))


class Place(NamedTuple):
    """A path at M distances, each field (M,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad]
    curvature: Array  # [1/m]
    sharpness: Array  # [1/m^2] over the signed way
    gear: Array  # [-] 1 forwards, -1 in reverse


@formula
def moved(x, y, yaw, way, turn):
    """The pose after a way [m] along an arc, negative in reverse, with a turn [rad]."""
    half = 0.5 * turn
    chord = way * (1.0 - half * half / 6.0) if abs(half) < 1e-4 else way * math.sin(half) / half
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


@formula
def _along(x, y, yaw, way, curvature, sharpness):
    """The pose after a signed way [m] along a piece."""
    turned = (curvature + 0.5 * sharpness * way) * way
    if sharpness == 0.0:
        return moved(x, y, yaw, way, turned)
    parts = 1 + int((abs(curvature * way) + abs(sharpness) * way * way) / PART)
    step_x, step_y, width = 0.0, 0.0, way / parts
    for part in range(parts):
        for node in range(len(_NODES)):
            s = width * (part + 0.5 * (_NODES[node] + 1.0))
            angle = yaw + (curvature + 0.5 * sharpness * s) * s
            step_x += 0.5 * width * _WEIGHTS[node] * math.cos(angle)
            step_y += 0.5 * width * _WEIGHTS[node] * math.sin(angle)
    return x + step_x, y + step_y, yaw + turned


@loop
def _places(start, length, curvature, sharpness, distances, out):
    """Rows x, y, yaw, curvature, sharpness, gear at sorted distances [m] along the path."""
    x, y, yaw = start[0], start[1], start[2]
    piece, begun = 0, 0.0
    for i in range(len(distances)):
        while piece < len(length) - 1 and distances[i] > begun + abs(length[piece]):
            x, y, yaw = _along(x, y, yaw, length[piece], curvature[piece], sharpness[piece])
            begun += abs(length[piece])
            piece += 1
        k, sharp, gear = curvature[piece], sharpness[piece], math.copysign(1.0, length[piece])
        way = gear * min(distances[i] - begun, abs(length[piece]))
        out[0, i], out[1, i], out[2, i] = _along(x, y, yaw, way, k, sharp)
        out[3, i], out[4, i], out[5, i] = k + sharp * way, sharp, gear


def places(path: Path, distances: ArrayLike) -> Place:
    """The path at sorted distances (M,) [m] from its start, counted forwards in either gear."""
    ways = np.ascontiguousarray(distances, dtype=np.float64)
    out = np.zeros((len(Place._fields), len(ways)))
    if len(path.length):
        _places(*path, ways, out)
    else:
        out[:3], out[5] = path.start[:, None], 1.0
    return Place(*out)


@loop
def _integrate(start, length, curvature, sharpness, steps, pose):
    """The pose at the end by Runge-Kutta's method of order 4 on yaw' = k, x' = cos, y' = sin."""
    copy_entries(start, pose)
    for piece in range(len(length)):
        step = length[piece] / steps
        for i in range(steps):
            k = curvature[piece] + sharpness[piece] * step * i
            middle = pose[2] + 0.5 * step * (k + 0.25 * sharpness[piece] * step)
            last = pose[2] + step * (k + 0.5 * sharpness[piece] * step)
            pose[0] += step / 6.0 * (math.cos(pose[2]) + 4.0 * math.cos(middle) + math.cos(last))
            pose[1] += step / 6.0 * (math.sin(pose[2]) + 4.0 * math.sin(middle) + math.sin(last))
            pose[2] = last


def end_errors(path: Path, goal: ArrayLike) -> tuple[float, float]:
    """(distance [m], yaw [rad]) from the goal after integrating the path numerically."""
    pose = np.empty(3)
    _integrate(*path, STEPS, pose)
    away = np.asarray(goal, dtype=np.float64) - pose
    return math.hypot(away[0], away[1]), abs(math.remainder(float(away[2]), 2.0 * math.pi))


class SpeedProfile(NamedTuple):
    """Speed over the way, G grid points; constant acceleration between them."""

    distance: Array  # [m] (G,) along the path, in reverse too
    speed: Array  # [m/s] (G,) >= 0
    time: Array  # [s] (G,)
    acceleration: Array  # [m/s^2] (G - 1,)
    reached: bool  # False: the start speed is too high for the limits


_NONE = np.zeros(2)
STANDING = SpeedProfile(_NONE, _NONE, _NONE, np.zeros(1), True)  # without length


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
def _can_reach(x, after, gap, shape):
    """Whether some u leads from x to at most `after` over a gap [m]; shape: see `_range`."""
    low, high = _range(x, *shape)
    return low <= high and x + 2.0 * gap * low <= after


@loop
def _profile(gaps, bound, curvature, sharpness, limits, first, x, u):
    """x (G,) and u (G - 1,); returns whether the first x is reached.

    limits: B / 2 [m], acceleration of the vehicle and of the belts [m/s^2]. first: x; the last: 0.
    """
    count = len(gaps)
    x[count] = 0.0
    for i in range(count - 1, -1, -1):
        low, high = 0.0, bound[i]
        shape = (curvature[i], sharpness[i], *limits)
        if not _can_reach(high, x[i + 1], gaps[i], shape):
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                if _can_reach(middle, x[i + 1], gaps[i], shape):
                    low = middle
                else:
                    high = middle
            high = low
        x[i] = high
    reached = first <= x[0] * (1.0 + 1e-9) + 1e-12
    x[0] = min(first, x[0])
    for i in range(count):
        _, high = _range(x[i], curvature[i], sharpness[i], *limits)
        u[i] = min(high, (x[i + 1] - x[i]) / (2.0 * gaps[i]))
        x[i + 1] = max(x[i] + 2.0 * gaps[i] * u[i], 0.0)
    return reached


def bound_speed(curvature: Array, limits: Limits, vehicle: PlantParameters) -> Array:
    """Speed [m/s] that limits allow at each curvature [1/m], accelerations apart."""
    bent = np.abs(curvature)
    belt = vehicle.sprocket_radius * limits.sprocket_used
    by_sprocket = belt / (1.0 + 0.5 * vehicle.track_gauge * bent)
    with np.errstate(divide="ignore"):
        by_friction = np.sqrt(limits.lateral_acceleration / bent)
    return np.minimum(np.minimum(by_sprocket, by_friction), limits.v_max)


def fastest(
    path: Path, limits: Limits, vehicle: PlantParameters, first: float = 0.0
) -> SpeedProfile:
    """The fastest speed along a path, from `first` >= 0 [m/s] to rest.

    An infinite acceleration counts as one that is reached within a grid interval.
    """
    if not len(path.length):
        return STANDING
    ends = np.cumsum(np.abs(path.length))
    stops = [0.0, *ends[np.flatnonzero(np.diff(np.sign(path.length)))], ends[-1]]
    belt = vehicle.sprocket_radius * limits.sprocket_acceleration
    parts, reached = [], True
    for number, (begin, end) in enumerate(itertools.pairwise(stops)):
        intervals = min(max(LEAST, math.ceil((end - begin) / SPACING)), MOST)
        grid = np.linspace(begin, end, intervals + 1)
        grid[1:-1] += 1e-12  # belongs to the piece that begins there
        at = places(path, grid)
        gaps = np.diff(grid)
        curvature = at.gear * at.curvature
        bent = np.maximum(np.abs(at.curvature[:-1]), np.abs(at.curvature[1:]))
        bent = np.maximum(np.append(bent, 0.0), np.insert(bent, 0, 0.0))
        allowed = bound_speed(bent, limits, vehicle)
        steepest = float(np.max(allowed)) ** 2 / (2.0 * gaps[0])
        rates = min(limits.acceleration, steepest), min(belt, 2.0 * steepest)
        x, u = np.empty(intervals + 1), np.empty(intervals)
        limit, square = (0.5 * vehicle.track_gauge, *rates), first**2 if number == 0 else 0.0
        reached &= _profile(gaps, allowed**2, curvature, at.sharpness, limit, square, x, u)
        parts.append((grid, np.sqrt(x), u))
    grid, speed = (
        np.concatenate([part[k][min(i, 1) :] for i, part in enumerate(parts)]) for k in (0, 1)
    )
    steps = 2.0 * np.diff(grid) / np.maximum(speed[1:] + speed[:-1], 1e-12)
    time = np.append(0.0, np.cumsum(steps))
    u = np.concatenate([part[2] for part in parts])
    return SpeedProfile(grid, speed, time, u, bool(reached))


def constant(path: Path, speed: float) -> SpeedProfile:
    """One speed [m/s] along the whole path."""
    if path.whole_length == 0.0:
        return STANDING
    grid = np.linspace(0.0, path.whole_length, 2)
    return SpeedProfile(grid, np.full(2, speed), grid / speed, np.zeros(1), True)


class TimedPath(NamedTuple):
    """A path with the speed along it."""

    path: Path
    speed: SpeedProfile
    method: str  # that made it
    message: str = ""  # why it is not the one that was asked for


def sampled(
    timed: TimedPath,
    goal: ArrayLike,
    limits: Limits,
    vehicle: PlantParameters,
    slip_model: SlipModel | None = None,
    period: float = 0.02,
) -> Trajectory:
    """The trajectory along a path with its speed, sampled every `period` [s] and at its end.

    It has `converged` unset, with a reason, where the sprockets would exceed the limits.
    """
    path, profile, method, message = timed
    duration = float(profile.time[-1])
    checked_sample_count(duration, period)
    count = math.floor(duration / period * (1.0 - 1e-12)) + 1 if duration > 0.0 else 0
    times = np.append(np.arange(count) * period, duration)
    part = np.clip(np.searchsorted(profile.time, times, side="right") - 1, 0, len(profile.time) - 2)
    since, u = times - profile.time[part], profile.acceleration[part]
    fast = np.maximum(profile.speed[part] + u * since, 0.0)
    distance = profile.distance[part] + (profile.speed[part] + 0.5 * u * since) * since
    place = places(path, np.clip(distance, 0.0, profile.distance[-1]))
    speed, acceleration = place.gear * fast, place.gear * u
    rate = place.curvature * speed
    bend = place.curvature * acceleration + place.sharpness * speed * speed
    left, right, alpha = sprockets(fast * place.gear, rate, vehicle, slip_model)
    largest = max(np.max(np.abs(left)), np.max(np.abs(right)))
    feasible = largest <= limits.sprocket_used * (1.0 + 1e-9)
    notes = [message] if message else []
    if not feasible:
        used = limits.sprocket_used
        notes.append(f"with slip the sprockets reach {largest:.3g} rad/s of {used:.3g}")
    if not profile.reached:
        notes.append("the start speed is too high for the limits")
    ends = np.append(0.0, np.cumsum(np.abs(path.length)))  # at which the curvature jumps
    before = np.append(0.0, path.curvature + path.sharpness * path.length)
    jumps = np.abs(np.append(path.curvature, 0.0) - before)
    jumps *= np.interp(ends, profile.distance, profile.speed)
    jump = float(np.max(jumps, initial=0.0)) * 0.5 * vehicle.track_gauge / vehicle.sprocket_radius
    if jump > JUMP and math.isfinite(limits.sprocket_acceleration):
        notes.append(f"sprocket speeds jump by {jump:.3g} rad/s where the curvature jumps")
    missed, turned = end_errors(path, goal)
    motion = (place.x, place.y, place.yaw - alpha, place.yaw, speed, acceleration, rate, bend)
    alpha_rate = slope_of(alpha, times)
    yaw_rates = rate - alpha_rate, bend - slope_of(alpha_rate, times)
    outcome = duration, bool(feasible and profile.reached), 0, missed, turned, method
    return Trajectory._make((times, *motion, *yaw_rates, left, right, *outcome, "; ".join(notes)))


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
