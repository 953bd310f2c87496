"""What a planner takes and what it returns: start, limits, trajectory.

A trajectory has the yaw of the vehicle, and its course chi = yaw + alpha with the ground speed V:
    x' = V cos(chi)   y' = V sin(chi)   yaw' = w   v_k = V cos(alpha) -+ w B / 2
    belt k runs at r omega_k = v_k + beta_k; beta_k [m/s] is the slip velocity of the track
Frame: world, SI units. Yaw and course are continuous, not wrapped.

`Trajectory.at` gives it at any time, as a controller follows it:
    "course"  x, y, chi, V, chi' and V', chi'': a unicycle on the path of the centre. For a
              controller that compensates slip (slc): it adds beta and alpha itself
    "body"    x, y, yaw of the vehicle, and the speeds of the belts
              v_b = r (omega_L + omega_R) / 2    w_b = r (omega_R - omega_L) / B
              For a controller that repeats the planned sprocket speeds (uc): slip is in the pose

Held inputs. An optimal plan holds its belt speeds over intervals: alpha jumps between them, as no
vehicle's course does. `at` takes the planned alpha in the middle of each interval, linear in
between, so that chi is continuous and chi' = w + alpha' its derivative. V and w are held as
planned; V' and chi'' are the slopes between the middles. x, y are the planned ones: V exp(i chi)
stays within a millimetre of them. After its end a plan stands at the goal, with the vehicle's yaw.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), (35), sections 3.2, 6 and 7.2; the code of F gives both controllers the pose and
v_b, w_b.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import checked_choice, checked_keys, checked_number

Array = NDArray[np.float64]
Index = NDArray[np.integer]

PLACE = Range(-1e6, 1e6, "m", "Did you pass millimetres?")
ANGLE = Range(-1e4, 1e4, "rad", "Did you pass degrees?")
SPEED = Range(-1e3, 1e3, "m/s", "Did you pass km/h?")
YAW_RATE = Range(-1e3, 1e3, "rad/s", "Did you pass degrees a second?")
SPROCKET = Range(-1e4, 1e4, "rad/s", "Did you pass rpm?")
MOST_SAMPLES = 1_000_000  # of one trajectory: 104 MB
POSE = {"x": PLACE, "y": PLACE, "yaw": ANGLE}
FRAMES = ("course", "body")
STRAIGHT = 1e-6  # [rad] arcs that turn less are straight


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
        """Sprocket speeds (left, right) [rad/s]; without slip where they are None."""
        turn = 0.5 * self.yaw_rate * vehicle.track_gauge
        left = (self.speed - turn) / vehicle.sprocket_radius
        right = (self.speed + turn) / vehicle.sprocket_radius
        left = left if self.sprocket_left is None else self.sprocket_left
        return left, right if self.sprocket_right is None else self.sprocket_right


class Limits(NamedTuple):
    """What a plan may ask of the vehicle; equal v_min and v_max: constant speed.

    They hold in reverse too: v_min and v_max are never negative.
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
    def of(cls, vehicle: PlantParameters, **changes: float) -> "Limits":
        """Limits of a vehicle on its soil: its sprockets, and accelerations that friction allows.

        Raises TypeError for a name that is no limit.
        """
        grip = GRAVITY * math.tan(vehicle.friction_angle)
        usual = {"sprocket_speed": vehicle.sprocket_speed_limit, "acceleration": grip}
        return cls(**{**usual, "lateral_acceleration": grip, **changes})

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


class Motion(NamedTuple):
    """A trajectory at T times in one frame, each field (T,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad] course, or yaw of the vehicle
    speed: Array  # [m/s] over the ground along the course, or of the belts
    acceleration: Array  # [m/s^2] its derivative
    yaw_rate: Array  # [rad/s] of the course, or of the belts
    yaw_acceleration: Array  # [rad/s^2] its derivative


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

    def __repr__(self) -> str:
        size = f"{self.duration:.2f} s, {self.length:.2f} m"
        end = f"{'' if self.converged else 'not '}converged, {self.end_error:.1e} m from the goal"
        parts = filter(None, (repr(self.method), size, end, self.message))
        return f"Trajectory({', '.join(parts)})"

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

    def at(
        self, times: ArrayLike, frame: str = "course", vehicle: PlantParameters | None = None
    ) -> Motion:
        """The motion at `times` (T,) [s] from the beginning, as a controller follows it.

        frame: one of FRAMES; "body" needs the vehicle. Raises ValueError for another frame and for
        times that are negative or not finite.
        """
        checked_choice("frame", frame, FRAMES)
        if frame == "body" and vehicle is None:
            raise ValueError("vehicle = None; must be the vehicle's parameters with frame = 'body'")
        at = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if at.ndim != 1 or not np.isfinite(at).all() or np.min(at, initial=0.0) < 0.0:
            raise ValueError(f"times = {times!r} s; must be (T,), finite and >= 0. Absolute?")
        over = at >= self.duration
        pose = (np.full(len(at), float(v[-1])) for v in (self.x, self.y, self.yaw))
        standing = Motion(*pose, *np.zeros((4, len(at))))
        if len(self.time) == 1 or over.all():
            return standing
        part = np.searchsorted(self.time, at, side="right") - 1
        part = np.clip(part, 0, len(self.time) - 2)
        moving = _moving(self, part, at, None if frame == "course" else vehicle)
        return Motion(*(np.where(over, s, m) for s, m in zip(standing, moving, strict=True)))

    def to_csv(self, path: str | FilePath) -> None:
        """Write the samples as a table with a header: time, pose, speeds, ... in SI units."""
        names, rows = ",".join(self._fields[:SAMPLED]), np.stack(self[:SAMPLED], axis=1)
        np.savetxt(path, rows, "%.9g", delimiter=",", header=names, comments="")


SAMPLED = 13  # fields of a Trajectory that have samples, the first ones


def _between(values: Array, part: Index, share: Array) -> Array:
    """Linear between samples."""
    return np.asarray(values[part] + share * (values[part + 1] - values[part]))


def _moving(
    t: Trajectory, part: Index, at: Array, vehicle: PlantParameters | None
) -> tuple[Array, ...]:
    """Fields of Motion on the arcs between samples; vehicle: for its body, None for the course."""
    held = t.method == "optimal"
    turning = np.diff(t.yaw if held else t.course)[part]
    since, step = at - t.time[part], (t.time[part + 1] - t.time[part])
    gain = np.zeros(len(at)) if held else t.acceleration[part]
    way, whole = ((t.speed[part] + 0.5 * gain * d) * d for d in (since, step))
    in_time = since / step
    share = np.where(np.abs(whole) > 0.0, way / np.where(whole == 0.0, 1.0, whole), in_time)
    bent = np.abs(turning) > STRAIGHT
    angle = np.where(bent, turning, 1.0)
    chord = np.expm1(1j * angle * share) / np.expm1(1j * angle)
    place = t.x + 1j * t.y
    place = place[part] + np.diff(place)[part] * np.where(bent, chord, share)
    if vehicle is None:
        alpha, speed, turn = t.course - t.yaw, t.speed, t.yaw_rate
        columns = t.course, speed, t.acceleration, t.course_rate, t.course_acceleration
    else:
        alpha, radius = np.zeros(len(t.time)), vehicle.sprocket_radius
        speed = 0.5 * radius * (t.sprocket_left + t.sprocket_right)
        turn = radius * (t.sprocket_right - t.sprocket_left) / vehicle.track_gauge
        rates = (np.gradient(values, t.time) for values in (speed, turn))
        columns = t.yaw, speed, next(rates), turn, next(rates)
    if not held:
        return place.real, place.imag, *(_between(each, part, in_time) for each in columns)
    parts = held_intervals(t)
    k = parts.of[part]
    since = at - parts.middle[k]
    alpha, speed, turn = (values[parts.first] for values in (alpha, speed, turn))
    rate, gain, bend = (_slopes(values, parts, k, since) for values in (alpha, speed, turn))
    yaw = _between(t.yaw, part, in_time) + alpha[k] + rate * since
    return place.real, place.imag, yaw, speed[k], gain, turn[k] + rate, bend


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


def _slopes(values: Array, parts: Intervals, k: Index, since: Array) -> Array:
    """Slope of held values (K,) between the middles of intervals; since [s]: middle of k."""
    if len(values) < 2:
        return np.zeros(len(k))
    slope = np.diff(values) / np.diff(parts.middle)
    return np.asarray(slope[np.clip(np.where(since < 0.0, k - 1, k), 0, len(slope) - 1)])


def slope_of(values: Array, times: Array) -> Array:
    """Derivative of values (M,) at times (M,) [s]; 0 of a single one."""
    return np.gradient(values, times) if len(values) > 1 else np.zeros(len(values))


def failed_plan(start: Start, goal: Array, method: str, why: str) -> Trajectory:
    """The plan of one goal (3,) of several that cannot be planned: it stands at the start."""
    still = np.zeros((SAMPLED, 1))
    still[1:5, 0] = start.x, start.y, start.yaw, start.yaw
    missed = math.hypot(goal[0] - start.x, goal[1] - start.y)
    finite = np.isfinite(goal[2])
    turned = math.remainder(goal[2] - start.yaw, 2.0 * math.pi) if finite else math.nan
    outcome = math.inf, False, 0, missed, abs(turned), method, why
    return Trajectory._make((*still, *outcome))


def checked_start(start: Start | Sequence[float]) -> Start:
    """`start` with finite numbers. Raises ValueError."""
    checked = start if isinstance(start, Start) else Start(*checked_table("start", start)[0])
    allowed = (PLACE, PLACE, ANGLE, SPEED, YAW_RATE, SPROCKET, SPROCKET)
    for name, value, inside in zip(Start._fields, checked, allowed, strict=True):
        if value is not None:
            checked_number(f"start {name}", value, inside)
    return checked


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
        starts = [Start(*pose) for pose in checked_table("start", start).tolist()]
        single = np.ndim(start) == 1
    goals = number_table("goal", goal)
    single = single and np.ndim(goal) == 1
    if single:
        checked_table("goal", goals)
    counts = len(starts), len(goals)
    if len(set(counts) - {1}) > 1:
        raise ValueError("{} starts and {} goals; must be as many, or one".format(*counts))
    count = 0 if 0 in counts else max(counts)
    starts = starts * count if len(starts) == 1 else starts
    return starts, np.array(np.broadcast_to(goals, (count, 3))), single


def number_table(what: str, values: Any, names: Iterable[str] = POSE) -> Array:
    """Numbers (N, C), finite or not, or one row; C names of columns. Raises ValueError."""
    columns = list(names)
    try:
        table = np.atleast_2d(np.asarray(values))
    except (TypeError, ValueError):
        table = np.array([[None]])
    if table.dtype.kind not in "fiu":
        raise ValueError(f"{what} = {values!r:.200}; must be numbers {', '.join(columns)}")
    if table.ndim != 2 or table.shape[1] != len(columns):
        raise ValueError(
            f"{what} has shape {np.shape(values)}; must be one or more rows of {', '.join(columns)}"
        )
    return table.astype(np.float64)


def checked_table(what: str, values: Any, ranges: Mapping[str, Range] = POSE) -> Array:
    """Numbers (N, C) within the ranges of their columns, by default poses. Raises ValueError."""
    table = number_table(what, values, ranges)
    for (name, allowed), column in zip(ranges.items(), table.T, strict=True):
        for value in (np.min(column), np.max(column)) if len(column) else ():
            checked_number(f"{what} {name}", float(value), allowed)
    return table


def checked_sample_count(duration: float, period: float) -> None:
    """Whether a plan of a duration every period [s] has at most MOST_SAMPLES. Raises ValueError."""
    if not duration / period <= MOST_SAMPLES:
        raise ValueError(
            f"period = {period:g} s; must be at least {duration / MOST_SAMPLES:.3g} s for "
            f"{duration:.3g} s, as a plan has at most {MOST_SAMPLES} samples. Is the goal in "
            "millimetres, or the speed or the curvature far too small?"
        )


def checked_limits(limits: Limits | Mapping[str, float] | None, vehicle: PlantParameters) -> Limits:
    """`limits` that leave the vehicle something to do; fields of a mapping replace its own limits.

    Raises ValueError, and TypeError for what is neither.
    """
    if limits is None or isinstance(limits, Mapping):
        limits = Limits.of(vehicle, **checked_keys("limits", limits, Limits._fields))
    if not isinstance(limits, Limits):
        raise TypeError(f"limits = {limits!r}; must be Limits, or a dict of their fields")
    for name, value in limits._asdict().items():
        what = f"limits {name} = {value!r}"
        if isinstance(value, bool) or not isinstance(value, Real) or value != value:
            raise ValueError(f"{what}; must be a number")
        if value == math.inf and name in ("sprocket_speed", "v_max"):
            raise ValueError(f"{what}; must be finite")
        if value < 0.0 or (value == 0.0 and name not in ("reserve", "v_min")):
            raise ValueError(f"{what}; must be positive, in reverse too; v_min, reserve also 0")
    if limits.v_min > limits.v_max or limits.reserve >= 1.0:
        raise ValueError(
            f"limits v_min = {limits.v_min}, v_max = {limits.v_max} m/s, reserve = "
            f"{limits.reserve}; must be 0 <= v_min <= v_max, reserve < 1. Did you swap them?"
        )
    belt = vehicle.sprocket_radius * limits.sprocket_used
    if limits.v_min >= belt:
        raise ValueError(
            f"limits v_min = {limits.v_min:g} m/s; must be below {belt:g} m/s, the belts at "
            f"{limits.sprocket_used:g} rad/s. Is the reserve too large?"
        )
    return limits
