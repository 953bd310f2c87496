"""What a planner is given and what it returns: start, limits, trajectory.

A trajectory carries two descriptions of one motion: the pose with the yaw of the vehicle, which a
controller that repeats planned sprocket speeds follows, and the course chi = yaw + alpha with the
ground speed V along it, which a controller that compensates slip follows. Without slip, alpha is 0
and both are the same.

    x' = V cos(chi)   y' = V sin(chi)   yaw' = w   v_k = V cos(alpha) -+ w B / 2
    belt k runs at r omega_k = v_k + beta_k; beta_k [m/s] is the slip velocity of the track
Frame: world, SI units. Yaw and course are continuous, not wrapped.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2 and 6.

What a controller follows of a planned trajectory, at any time: its course, or its body.

    "course"  x, y, chi, V, chi' and V', chi'': a unicycle on the path of the centre. For a
              controller that compensates slip (slc): it adds beta and alpha itself
    "body"    x, y, yaw of the vehicle, and the speeds of the belts
              v_b = r (omega_L + omega_R) / 2    w_b = r (omega_R - omega_L) / B
              For a controller that repeats the planned sprocket speeds (uc): slip is in the pose
Belt speeds with the pose given to slc count slip twice; the course given to uc leaves it out.

Held inputs. An optimal plan holds its belt speeds over intervals: its yaw is continuous, but alpha,
and with it chi = yaw + alpha, jumps between intervals, as no vehicle's course does. Here alpha is
the planned one in the middle of each interval and linear in between, so that chi is continuous and
chi' = w + alpha' is its derivative, constant on half intervals. V and w are held as planned; V' and
chi'' are the slopes between the middles. x, y are the planned ones: V exp(i chi) stays within a
millimetre of them.
After its end a plan stands at the goal, with the vehicle's yaw in both frames: without speed a
vehicle has no course.
Frame: world, SI units; angles are continuous, not wrapped.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), (35), sections 6 and 7.2; the code of F gives both controllers the pose and v_b,
w_b.
"""

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import checked_choice, checked_keys, checked_number

Array = NDArray[np.float64]


PLACE = Range(-1e6, 1e6, "m", "Did you pass millimetres?")
ANGLE = Range(-1e4, 1e4, "rad", "Did you pass degrees?")
SPEED = Range(-1e3, 1e3, "m/s", "Did you pass km/h?")
YAW_RATE = Range(-1e3, 1e3, "rad/s", "Did you pass degrees a second?")
SPROCKET = Range(-1e4, 1e4, "rad/s", "Did you pass rpm?")
MOST_SAMPLES = 1_000_000  # of one trajectory: 104 MB


class Start(NamedTuple):
    """Pose and motion from which a plan begins; all zero: at rest in the origin."""

    x: float = 0.0  # [m] world
    y: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]
    speed: float = 0.0  # [m/s] v_x, along the vehicle
    yaw_rate: float = 0.0  # [rad/s]
    sprocket_left: float | None = None  # [rad/s]; None: as without slip
    sprocket_right: float | None = None  # [rad/s]

    def sprockets(self, vehicle: PlantParameters) -> tuple[float, float]:
        """Sprocket speeds (left, right) [rad/s]; without slip where they are not given."""
        turn = 0.5 * self.yaw_rate * vehicle.track_gauge
        left = (self.speed - turn) / vehicle.sprocket_radius
        right = (self.speed + turn) / vehicle.sprocket_radius
        given = self.sprocket_left, self.sprocket_right
        return (left if given[0] is None else given[0], right if given[1] is None else given[1])


class Goal(NamedTuple):
    """The pose to reach; whole turns in its yaw have no meaning."""

    x: float  # [m] world
    y: float  # [m]
    yaw: float  # [rad]


class Limits(NamedTuple):
    """What a plan may ask of the vehicle; equal v_min and v_max: constant speed.

    In reverse the same limits hold for speeds backwards: v_min and v_max are never negative, and
    `plan(..., reverse=True)` chooses the gear.
    """

    sprocket_speed: float  # [rad/s] of either sprocket, both directions
    reserve: float = 0.0  # [-] share of `sprocket_speed` that is left to the controller
    sprocket_acceleration: float = math.inf  # [rad/s^2] of either sprocket
    v_min: float = 0.15  # [m/s] of the mean of both belts
    v_max: float = 0.4  # [m/s] of the mean of both belts, and of the ground speed
    acceleration: float = math.inf  # [m/s^2] along the path
    curvature: float = math.inf  # [1/m]
    lateral_acceleration: float = math.inf  # [m/s^2] mu g at most

    @classmethod
    def of(cls, vehicle: PlantParameters, **given: float) -> "Limits":
        """Limits of a vehicle on its soil: its sprockets, and accelerations that friction allows.

        Raises TypeError for a name that is no limit.
        """
        grip = GRAVITY * math.tan(vehicle.friction_angle)
        known = {
            "sprocket_speed": vehicle.sprocket_speed_limit,
            "acceleration": grip,
            "lateral_acceleration": grip,
        }
        return cls(**{**known, **given})

    @property
    def fixed(self) -> bool:
        """Whether the speed is constant."""
        return self.v_min == self.v_max

    @property
    def sprocket_used(self) -> float:
        """Sprocket speed up to which a plan goes [rad/s]."""
        return self.sprocket_speed * (1.0 - self.reserve)

    def curvature_at(self, speed: float, vehicle: PlantParameters) -> float:
        """Largest curvature [1/m] at a speed [m/s], no slip: sprockets, friction, own limit."""
        gauge, belt = vehicle.track_gauge, vehicle.sprocket_radius * self.sprocket_used
        by_sprocket = 2.0 * (belt - speed) / (gauge * speed)
        return min(self.curvature, by_sprocket, self.lateral_acceleration / speed**2)


class Trajectory(NamedTuple):
    """A planned motion: M samples in time, world frame, and how well it was found.

    Optimal plans hold their sprocket speeds over N intervals of T / N and step between them,
    whatever the samples are: a step, that from the speeds of the start included, is at most
    `sprocket_acceleration` T / N. They end at the speeds of the last interval, from rest to rest at
    most as large, so that a drive that keeps the limit stands T / N later. At constant speed, and
    without a limit on the sprocket acceleration, a plan begins and ends at speed. Paths (the other
    methods) begin at the speed of the start and end at rest, unless the speed is constant.
    """

    time: Array  # [s] (M,) from 0, increasing
    x: Array  # [m] (M,)
    y: Array  # [m] (M,)
    yaw: Array  # [rad] (M,) of the vehicle, continuous
    course: Array  # [rad] (M,) direction of motion of the centre (of its back, in reverse)
    speed: Array  # [m/s] (M,) ground speed along the course, negative in reverse
    acceleration: Array  # [m/s^2] (M,) its derivative
    course_rate: Array  # [rad/s] (M,)
    course_acceleration: Array  # [rad/s^2] (M,) its derivative
    yaw_rate: Array  # [rad/s] (M,)
    yaw_acceleration: Array  # [rad/s^2] (M,) its derivative
    sprocket_left: Array  # [rad/s] (M,)
    sprocket_right: Array  # [rad/s] (M,)
    cost: float  # [s] duration, and what the method adds to it
    converged: bool  # False: not to be driven; `message` says why
    iterations: int  # of the method; 0 for closed forms
    end_error: float  # [m] distance to the goal after integrating the model
    end_yaw_error: float  # [rad] yaw to the goal there, wrapped
    method: str  # that made it: "dubins", "clothoid", "optimal", ...
    message: str  # empty, or what the caller has to know

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.time[-1])

    @property
    def length(self) -> float:
        """Way of the centre [m], forwards and in reverse."""
        steps = np.diff(self.time)
        return float(np.sum(0.5 * np.abs(self.speed[1:] + self.speed[:-1]) * steps))

    def slip(self, vehicle: PlantParameters) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) (M,) that the plan has taken into account."""
        alpha, radius = self.course - self.yaw, vehicle.sprocket_radius
        forward, across = self.speed * np.cos(alpha), 0.5 * vehicle.track_gauge * self.yaw_rate
        left = radius * self.sprocket_left - (forward - across)
        return left, radius * self.sprocket_right - (forward + across), alpha


def failed_plan(start: Start, goal: Array, method: str, why: str) -> Trajectory:
    """The plan of one goal (3,) of several that cannot be planned: it stands at the start."""
    still = {name: np.zeros(1) for name in Trajectory._fields[:13]}
    for name, value in (("x", start.x), ("y", start.y), ("yaw", start.yaw), ("course", start.yaw)):
        still[name] = np.array([float(value)])
    missed = math.hypot(goal[0] - start.x, goal[1] - start.y)
    turned = (
        math.remainder(goal[2] - start.yaw, 2.0 * math.pi) if np.isfinite(goal[2]) else math.nan
    )
    return Trajectory(
        **still, cost=math.inf, converged=False, iterations=0, end_error=missed,
        end_yaw_error=abs(turned), method=method, message=why,
    )  # fmt: skip


def checked_start(start: Start | Sequence[float]) -> Start:
    """`start` with finite numbers. Raises ValueError."""
    made = start if isinstance(start, Start) else Start(*checked_poses("start", start)[0])
    allowed = (PLACE, PLACE, ANGLE, SPEED, YAW_RATE, SPROCKET, SPROCKET)
    for name, value, inside in zip(Start._fields, made, allowed, strict=True):
        if value is not None:
            checked_number(f"start {name}", value, inside)
    return made


def checked_starts(start: Any, goal: Any) -> tuple[list[Start], Array, bool]:
    """N starts, N goals (N, 3) that may lie out of range, and whether both were single.

    start: Start, (3,), (N, 3) or a sequence of Start; goal: (3,) or (N, 3). One start goes to all
    goals, and one goal is that of all starts. Raises ValueError.
    """
    if isinstance(start, Start):
        starts, single = [checked_start(start)], True
    elif isinstance(start, (list, tuple)) and any(isinstance(each, Start) for each in start):
        starts, single = [checked_start(each) for each in start], False
    else:
        poses, single = checked_poses("start", start), np.ndim(start) == 1
        starts = [Start(*(float(v) for v in pose)) for pose in poses]
    goals = pose_table("goal", goal)
    single = single and np.ndim(goal) == 1
    if single:
        checked_poses("goal", goals)
    counts = len(starts), len(goals)
    if len(set(counts) - {1}) > 1:
        raise ValueError(
            f"{counts[0]} starts and {counts[1]} goals; must be as many, or one of either"
        )
    count = 0 if 0 in counts else max(counts)
    starts = starts * count if len(starts) == 1 else starts
    return starts, np.array(np.broadcast_to(goals, (count, 3))), single


def pose_table(what: str, given: Any) -> Array:
    """Poses as (N, 3), finite or not; what: "start" or "goal". Raises ValueError."""
    wrong = f"{what} = {given!r:.200}; must be numbers x, y [m], yaw [rad]"
    try:
        made = np.atleast_2d(np.asarray(given))
    except (TypeError, ValueError) as error:
        raise ValueError(wrong) from error
    if made.dtype.kind not in "fiu":
        raise ValueError(wrong)
    if made.ndim != 2 or made.shape[1] != 3:
        raise ValueError(f"{what} has shape {np.shape(given)}; must be (3,) or (N, 3): x, y, yaw")
    return made.astype(np.float64)


def checked_poses(what: str, given: Any) -> Array:
    """Poses as (N, 3): x, y [m], yaw [rad]; what: "start" or "goal". Raises ValueError."""
    made = pose_table(what, given)
    for name, column, inside in zip(Goal._fields, made.T, (PLACE, PLACE, ANGLE), strict=True):
        for value in (np.min(column), np.max(column)) if len(column) else ():
            checked_number(f"{what} {name}", float(value), inside)
    return made


def checked_sample_count(duration: float, period: float) -> None:
    """Whether a plan of a duration every period [s] has at most MOST_SAMPLES. Raises ValueError."""
    if not duration / period <= MOST_SAMPLES:
        raise ValueError(
            f"period = {period:g} s; must be at least {duration / MOST_SAMPLES:.3g} s for "
            f"{duration:.3g} s, as a plan has at most {MOST_SAMPLES} samples. Is the goal in "
            "millimetres, or the speed or the curvature far too small?"
        )


def checked_pairs(start: Any, goal: Any, further: int = 1) -> tuple[Array, Array]:
    """Starts and goals as (N, 3) each, with N the one number above 1 among them and `further`.

    Raises ValueError.
    """
    starts, goals = checked_poses("start", start), checked_poses("goal", goal)
    counts = sorted({len(starts), len(goals), further} - {1})
    if len(counts) > 1:
        raise ValueError(f"{counts} poses; starts and goals must be as many, or one")
    shape = (counts[0] if counts else 1, 3)
    starts, goals = (np.ascontiguousarray(np.broadcast_to(p, shape)) for p in (starts, goals))
    return starts, goals


def checked_limits(limits: Limits | Mapping[str, float] | None, vehicle: PlantParameters) -> Limits:
    """`limits` that leave the vehicle something to do; fields of a mapping replace its own limits.

    Raises ValueError, and TypeError for what is neither.
    """
    if limits is None or isinstance(limits, Mapping):
        limits = Limits.of(vehicle, **checked_keys("limits", limits, Limits._fields))
    if not isinstance(limits, Limits):
        raise TypeError(f"limits = {limits!r}; must be Limits, or a dict of their fields")
    for name, value in limits._asdict().items():
        if isinstance(value, bool) or not isinstance(value, Real) or value != value:
            raise ValueError(f"limits {name} = {value!r}; must be a number")
    for name in ("sprocket_speed", "v_max"):
        if getattr(limits, name) == math.inf:
            raise ValueError(f"limits {name} = inf; must be finite")
    positive = ("sprocket_speed", "sprocket_acceleration", "acceleration", "curvature")
    for name in (*positive, "lateral_acceleration", "v_max"):
        value = getattr(limits, name)
        if not value > 0.0:
            raise ValueError(f"limits {name} = {value}; must be above 0")
    if not 0.0 <= limits.reserve < 1.0:
        raise ValueError(
            f"limits reserve = {limits.reserve}; must be in [0, 1). It is a share of the speed."
        )
    if not 0.0 <= limits.v_min <= limits.v_max:
        raise ValueError(
            f"limits v_min = {limits.v_min}, v_max = {limits.v_max} m/s; must be 0 <= v_min <= "
            "v_max. Did you swap them? In reverse (`reverse=True`) the same limits hold."
        )
    belt = vehicle.sprocket_radius * limits.sprocket_used
    if limits.v_min >= belt:
        raise ValueError(
            f"limits v_min = {limits.v_min:g} m/s; must be below {belt:g} m/s, the belts at "
            f"{limits.sprocket_used:g} rad/s. Is the reserve too large?"
        )
    return limits


Index = NDArray[np.integer]

FRAMES = ("course", "body")
STRAIGHT = 1e-6  # [rad] arcs that turn less are straight


class Followed(NamedTuple):
    """A trajectory at T times in one frame, each field (T,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad] course, or yaw of the vehicle
    speed: Array  # [m/s] over the ground along the course, or of the belts
    acceleration: Array  # [m/s^2] its derivative
    yaw_rate: Array  # [rad/s] of the course, or of the belts
    yaw_acceleration: Array  # [rad/s^2] its derivative


def hand_over(
    trajectory: Trajectory, times: ArrayLike, vehicle: PlantParameters, frame: str = "course"
) -> Followed:
    """A trajectory at `times` (T,) [s] from its beginning, as a controller follows it.

    frame: one of FRAMES. Raises ValueError for another one and for times that are negative or not
    finite.
    """
    checked_choice("frame", frame, FRAMES)
    at = np.atleast_1d(np.asarray(times, dtype=np.float64))
    if at.ndim != 1 or not np.isfinite(at).all() or np.min(at, initial=0.0) < 0.0:
        raise ValueError(f"times = {times!r} s; must be (T,), finite and >= 0. Are they absolute?")
    over = at >= trajectory.duration
    if len(trajectory.time) == 1 or over.all():
        return _standing(trajectory, at)
    part = np.searchsorted(trajectory.time, at, side="right") - 1
    part = np.clip(part, 0, len(trajectory.time) - 2)
    held = trajectory.method == "optimal"
    x, y = _places(trajectory, part, at, held)
    if frame == "course":
        rest = _course(trajectory, part, at, held)
    else:
        rest = _body(trajectory, part, at, vehicle, held)
    still = _standing(trajectory, at)
    moving = (x, y, *rest)
    return Followed(*(np.where(over, s, m) for s, m in zip(still, moving, strict=True)))


def _standing(trajectory: Trajectory, times: Array) -> Followed:
    """At the goal."""
    pose = (np.full(len(times), float(v[-1])) for v in trajectory[1:4])
    return Followed(*pose, *(np.zeros(len(times)) for _ in range(4)))


def _between(values: Array, t: Trajectory, part: Index, at: Array) -> Array:
    """Linear between samples."""
    share = (at - t.time[part]) / (t.time[part + 1] - t.time[part])
    return np.asarray(values[part] + share * (values[part + 1] - values[part]))


def _places(t: Trajectory, part: Index, at: Array, held: bool) -> tuple[Array, Array]:
    """x, y on the arcs between samples, whose ends are the samples."""
    turned = np.diff(t.yaw if held else t.course)[part]
    since, step = at - t.time[part], (t.time[part + 1] - t.time[part])
    gain = np.zeros(len(at)) if held else t.acceleration[part]
    way, whole = ((t.speed[part] + 0.5 * gain * d) * d for d in (since, step))
    share = np.where(np.abs(whole) > 0.0, way / np.where(whole == 0.0, 1.0, whole), since / step)
    bent = np.abs(turned) > STRAIGHT
    angle = np.where(bent, turned, 1.0)
    chord = np.expm1(1j * angle * share) / np.expm1(1j * angle)
    place = t.x + 1j * t.y
    found = place[part] + np.diff(place)[part] * np.where(bent, chord, share)
    return found.real, found.imag


class Intervals(NamedTuple):
    """The K intervals of a plan on which its inputs are held."""

    of: Index  # (M,) the interval in which, or with which, a sample begins
    first: Index  # (K,) sample at its beginning
    middle: Array  # [s] (K,)


def held_intervals(t: Trajectory) -> Intervals:
    """Intervals of equal sprocket speeds."""
    left, right = t.sprocket_left[:-1], t.sprocket_right[:-1]
    new = np.append(True, (np.diff(left) != 0.0) | (np.diff(right) != 0.0))
    first = np.flatnonzero(new)
    ends = np.append(t.time[first], t.time[-1])
    of = np.append(np.cumsum(new), np.sum(new)) - 1
    return Intervals(of, first, 0.5 * (ends[1:] + ends[:-1]))


def _course(t: Trajectory, part: Index, at: Array, held: bool) -> tuple[Array, ...]:
    """chi, V, V', chi', chi''."""
    if not held:
        names = ("course", "speed", "acceleration", "course_rate", "course_acceleration")
        return tuple(_between(getattr(t, name), t, part, at) for name in names)
    parts = held_intervals(t)
    k = parts.of[part]
    since = at - parts.middle[k]
    alpha, turn, speed = (v[parts.first] for v in (t.course - t.yaw, t.yaw_rate, t.speed))
    rate = _slopes(alpha, parts, k, since)
    course = _between(t.yaw, t, part, at) + alpha[k] + rate * since
    bend = _slopes(turn, parts, k, since)
    return course, speed[k], _slopes(speed, parts, k, since), turn[k] + rate, bend


def _body(
    t: Trajectory, part: Index, at: Array, vehicle: PlantParameters, held: bool
) -> tuple[Array, ...]:
    """yaw, v_b, v_b', w_b, w_b'."""
    radius = vehicle.sprocket_radius
    speed = 0.5 * radius * (t.sprocket_left + t.sprocket_right)
    turn = radius * (t.sprocket_right - t.sprocket_left) / vehicle.track_gauge
    yaw = _between(t.yaw, t, part, at)
    if not held:
        rates = (np.gradient(values, t.time) for values in (speed, turn))
        given = [_between(values, t, part, at) for values in (speed, *rates, turn)]
        return yaw, given[0], given[1], given[3], given[2]
    parts = held_intervals(t)
    k = parts.of[part]
    speed, turn = speed[parts.first], turn[parts.first]
    slopes = [_slopes(values, parts, k, at - parts.middle[k]) for values in (speed, turn)]
    return yaw, speed[k], slopes[0], turn[k], slopes[1]


def _slopes(values: Array, parts: Intervals, k: Index, since: Array) -> Array:
    """Slope of held values (K,) between the middles of intervals; since [s]: middle of k."""
    if len(values) < 2:
        return np.zeros(len(k))
    slope = np.diff(values) / np.diff(parts.middle)
    return np.asarray(slope[np.clip(np.where(since < 0.0, k - 1, k), 0, len(slope) - 1)])
