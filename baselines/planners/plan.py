"""`plan`: from a start to a goal, by the method that is asked for.

    dubins        shortest path with bounded curvature, forwards
    reeds-shepp   the same, forwards and in reverse
    clothoid      one clothoid; another method where it breaks a limit or goes far round
    optimal       least time under slip (`baselines.planners.optimal`), forwards, or with `reverse`
                  in the gears that cost least (`baselines.planners.optimal`)
With equal v_min and v_max the speed is constant from the first moment on, as in [F]; otherwise a
path is driven as fast as the limits allow, from the start's speed to rest, and the optimal plan
can be at rest one interval after its end if the sprocket acceleration has a limit (`Trajectory`).
With obstacles, a plan that touches one is replaced by a chain of plans along a route around them
(`baselines.planners.legs`); so are way points.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 6.

A plan as a command line asks for it: a vehicle on its soil, limits, and the slip of both.

`planned` is registered in the group `tracked_env.commands` under the name `plan`.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners import legs, plan_on_slopes, speed_along_path
from baselines.planners import optimal as gears
from baselines.planners.clearance import MARGIN, Footprint, checked_footprint, checked_margin
from baselines.planners.curves import CLOSEST, Path, clothoid, dubins, reeds_shepp
from baselines.planners.obstacles import Obstacles, checked_obstacles
from baselines.planners.optimal import INTERVALS, RADIUS, THREADS, optimal
from baselines.planners.speed_along_path import driven
from baselines.planners.trajectory import (
    Limits,
    Start,
    Trajectory,
    checked_limits,
    checked_poses,
    checked_starts,
    failed_plan,
)
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip, with_friction
from tracked_env.physics.parameters import VEHICLES, PlantParameters, Range
from tracked_env.validation import checked_choice, checked_flag, checked_number, checked_whole

Array = NDArray[np.float64]


LONGEST = 3.0  # [-] times the Dubins path: a longer clothoid is not driven
_PERIOD = Range(1e-4, 10.0, "s", "It is the time between samples.")
_ROOM = Range(0.0, 1e6, "m", "It is around start and goal.")
_TIME_LIMIT = Range(0.0, 1e5, "s", "Did you pass milliseconds?")


def arc_radius(limits: Limits, vehicle: PlantParameters) -> float:
    """Least turning radius [m] of arcs at v_max. Raises ValueError where the limits allow none."""
    bend = limits.curvature_at(limits.v_max, vehicle)
    if bend <= 0.0:
        belt = vehicle.sprocket_radius * limits.sprocket_used
        raise ValueError(
            f"limits v_max = {limits.v_max:g} m/s; must be below {belt:g} m/s for any turn, the "
            f"belts at {limits.sprocket_used:g} rad/s. Is the reserve too large?"
        )
    return 1.0 / bend


def _dubins(start: Start, goal: Array, limits: Limits, vehicle: PlantParameters) -> Path:
    pose = start[:3]
    made = dubins(pose, goal, arc_radius(limits, vehicle))
    return Path.of(pose, made.segments[0], made.curvature[0])


def _reeds_shepp(start: Start, goal: Array, limits: Limits, vehicle: PlantParameters) -> Path:
    pose = start[:3]
    made = reeds_shepp(pose, goal, arc_radius(limits, vehicle))
    return Path.of(pose, made.segments[0], made.curvature[0])


def _clothoid(
    start: Start, goal: Array, limits: Limits, vehicle: PlantParameters
) -> tuple[Path | None, str]:
    """The clothoid, or none and why it is not driven."""
    pose = start[:3]
    if np.hypot(*(goal[:2] - pose[:2])) < CLOSEST:
        return None, "start and goal are one place, which no clothoid joins"
    made = clothoid(pose, goal)
    path = Path.of(pose, made.length, made.curvature, made.sharpness)
    bend = path.largest_curvature
    if bend > limits.curvature:
        return None, f"the clothoid has a curvature of {bend:.3g} of {limits.curvature:.3g} 1/m"
    allowed = float(speed_along_path.bound_speed(np.array([bend]), limits, vehicle)[0])
    needed = limits.v_min
    if allowed < needed * (1.0 - 1e-12):
        return None, f"the clothoid can be driven at {allowed:.3g} m/s of {needed:.3g} at least"
    shortest = float(dubins(pose, goal, arc_radius(limits, vehicle)).length[0])
    if path.whole_length > LONGEST * max(shortest, float(np.hypot(*(goal[:2] - pose[:2])))):
        return None, f"the clothoid is {path.whole_length:.3g} m long, Dubins' {shortest:.3g} m"
    return path, ""


class TimedPath(NamedTuple):
    """A path with the speed along it."""

    path: Path
    speed: speed_along_path.SpeedProfile
    method: str  # that made it
    message: str  # why it is not the one that was asked for


def timed_path(
    start: Start, goal: Array, limits: Limits, vehicle: PlantParameters, method: str
) -> TimedPath:
    """A path of `method`, any but "optimal", with its speed. Raises ValueError as `plan`."""
    path, message, used = None, "", method
    if method == "clothoid":
        path, why = _clothoid(start, goal, limits, vehicle)
        if path is None:
            message, used = f"{why}: Dubins path instead", "dubins"
    if path is None:
        path = (_reeds_shepp if used == "reeds-shepp" else _dubins)(start, goal, limits, vehicle)
    return TimedPath(path, _profile(path, start, limits, vehicle), used, message)


def _profile(
    path: Path, start: Start, limits: Limits, vehicle: PlantParameters
) -> speed_along_path.SpeedProfile:
    """The speed along a path."""
    if limits.fixed:
        return speed_along_path.constant(path, limits.v_max, limits, vehicle)
    return speed_along_path.fastest(path, limits, vehicle, max(start.speed, 0.0))


METHODS = ("optimal", "dubins", "reeds-shepp", "clothoid")


class Planner(NamedTuple):
    """One way to plan, to be called with a start and a goal."""

    limits: Limits
    vehicle: PlantParameters
    slip_model: SlipModel | None
    method: str
    period: float  # [s]
    intervals: int
    reverse: bool
    ground: plan_on_slopes.Ground | None

    @property
    def brakes(self) -> bool:
        """Whether the optimal planner can end at rest: speed and its rate of change have limits."""
        return not self.limits.fixed and math.isfinite(self.limits.sprocket_acceleration)

    @property
    def gears(self) -> int:
        """In which a route may be driven: 1: forwards, 2: both, 0: both, but without a change."""
        if self.method == "reeds-shepp":
            return 2
        jumps = self.limits.fixed and math.isfinite(self.limits.sprocket_acceleration)
        return (0 if jumps else 2) if self.reverse else 1

    @property
    def turns_on_the_spot(self) -> bool:
        """Whether a leg may."""
        slow = self.limits.v_min == 0.0 and math.isinf(self.limits.curvature)
        return self.method == "optimal" and slow

    def __call__(self, start: Start, goal: Array, last: bool = True, gear: int = 0) -> Trajectory:
        """One trajectory to a goal (3,); last: to rest there, if the limits say how to brake.

        gear: of the optimal planner, 1 forwards, -1 in reverse, 0 the cheapest that is allowed.
        """
        if self.method == "optimal":
            level = {0: self._level, 1: self._forwards, -1: self._backwards}[gear]
            if self.ground is None:
                return level(start, goal, last)
            return plan_on_slopes.on_ground(
                level, start, goal, last, self.ground, self.slip_model, self.vehicle
            )
        made = timed_path(start, goal, self.limits, self.vehicle, self.method)
        return driven(
            made.path, made.speed, goal, self.limits, self.vehicle, made.method, self.slip_model,
            made.message, self.period,
        )  # fmt: skip

    @property
    def follows(self) -> bool:
        """Whether it can drive arcs and lines, where belts jump."""
        free = math.isinf(self.limits.sprocket_acceleration) and self.ground is None
        return self.method != "optimal" or free

    def follow(self, start: Start, path: Path, goal: Array) -> Trajectory:
        """The trajectory along a path to a goal (3,)."""
        profile = _profile(path, start, self.limits, self.vehicle)
        both = bool(np.any(path.length < 0.0))
        method = "reeds-shepp" if both or self.method == "reeds-shepp" else "dubins"
        message = f"no free plan by '{self.method}': arcs and lines instead"
        message = "" if self.method in ("dubins", "reeds-shepp") else message
        return driven(
            path, profile, goal, self.limits, self.vehicle, method, self.slip_model, message,
            self.period,
        )  # fmt: skip

    def _level(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        """The optimal plan on level ground, in the gears that are allowed."""
        if not self.reverse:
            return self._forwards(start, goal, last, turning)
        radius = max(arc_radius(self.limits, self.vehicle), RADIUS * self.vehicle.track_gauge)
        jumps = self.limits.fixed and math.isfinite(self.limits.sprocket_acceleration)
        return gears.cheapest(self._forwards, start, goal, None if jumps else radius, last)

    def _backwards(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        return gears.in_reverse(
            lambda begin, end, rest: self._forwards(begin, end, rest, turning), start, goal, last
        )

    def _forwards(
        self, start: Start, goal: Array, last: bool, turning: float | None = None
    ) -> Trajectory:
        made = optimal(
            start, goal, self.limits, self.vehicle, self.slip_model, intervals=self.intervals,
            period=self.period, stop=last and self.brakes, turning=turning,
        )  # fmt: skip
        assert isinstance(made, Trajectory)
        return made


def plan(
    start: Start | Sequence[Start] | ArrayLike,
    goal: ArrayLike,
    limits: Limits | Mapping[str, float] | None = None,
    slip_model: SlipModel | None = None,
    method: str = "optimal",
    vehicle: str | PlantParameters = "focchi",
    *,
    via: ArrayLike = (),
    obstacles: Obstacles | None = None,
    period: float = 0.02,
    intervals: int = 40,
    threads: int = 1,
    reverse: bool = False,
    ground: plan_on_slopes.Ground | None = None,
    footprint: Footprint | Sequence[float] | None = None,
    margin: float = MARGIN,
    room: float | None = None,
    time_limit: float = 5.0,
) -> Trajectory | list[Trajectory]:
    """Plan from a start to a goal (3,), or for N pairs (N, 3): x, y [m], yaw [rad].

    start: pose, or `Start` for a moving vehicle; N of them, or one for all goals, as one goal may
    be that of all starts. limits: those of the vehicle on its soil by default, or a dict of some.
    slip_model: of `baselines.slip`; None plans as if the tracks did not slip. vehicle: parameters,
    or a key of VEHICLES. via: way points (K, 3) to be passed before the goal. period: time between
    samples [s]. intervals: N of the optimal planner. threads: for N goals by the optimal planner
    forwards, without obstacles and way points. reverse: whether the optimal planner may drive
    backwards, where that costs less; its limits hold in both gears.
    ground: slopes of a plane, or heights with slopes as functions of x and y, on which the optimal
    planner drives with a slip model that knows slopes.
    Around obstacles - footprint: front, back, left, right [m] of the centre, by default the tracks;
    margin [m] around it; room [m] around start and goal in which a route is searched, by default as
    much as there are obstacles; time_limit [s] of that search.
    Returns a Trajectory, or a list of N. Look at `converged` and `message` before one is driven:
    one of N goals that cannot be planned has the reason there. Raises ValueError for what is not
    finite, out of range, unknown or contradictory.
    """
    planner = _prepared(limits, slip_model, method, vehicle, period, intervals, reverse, ground)
    body = checked_footprint(footprint, planner.vehicle), checked_margin(margin)
    if room is not None:
        checked_number("room", room, _ROOM)
    checked_number("time_limit", time_limit, _TIME_LIMIT)
    space = None
    if checked_obstacles(obstacles) is not None:
        assert obstacles is not None
        space = legs.Space(obstacles, *body, room, time_limit)
    begins, goals, single = checked_starts(start, goal)
    workers = checked_whole("threads", threads, THREADS)
    before = checked_poses("via", via) if np.size(via) else np.zeros((0, 3))
    passing = space is not None or len(before) > 0
    if method == "optimal" and workers > 1 and not (reverse or passing or ground is not None):
        several = optimal(
            begins, goals, planner.limits, planner.vehicle, slip_model, intervals=intervals,
            period=period, threads=workers, stop=planner.brakes,
        )  # fmt: skip
        made = several if isinstance(several, list) else [several]
        return made[0] if single else made
    made = []
    for begin, row in zip(begins, goals, strict=True):
        try:
            checked_poses("goal", row)
            if passing:
                made.append(legs.through(planner, begin, np.vstack([before, row]), space))
            else:
                made.append(planner(begin, row))
        except ValueError as error:
            if single:
                raise
            made.append(failed_plan(begin, row, method, str(error)))
    return made[0] if single else made


def _prepared(
    limits: Limits | Mapping[str, float] | None, slip_model: SlipModel | None, method: str,
    vehicle: str | PlantParameters, period: float, intervals: int, reverse: bool,
    ground: plan_on_slopes.Ground | None,
) -> Planner:  # fmt: skip
    checked_choice("method", method, METHODS)
    checked_number("period", period, _PERIOD)
    if checked_flag("reverse", reverse) and method in ("dubins", "clothoid"):
        raise ValueError(
            f"reverse = True; must be False with method = '{method}', whose paths are driven "
            "forwards. Did you mean 'reeds-shepp' or 'optimal'?"
        )
    if ground is not None and method != "optimal":
        raise ValueError(f"ground with method = '{method}'; must be 'optimal', which knows slopes")
    if isinstance(vehicle, str):
        vehicle = VEHICLES[checked_choice("vehicle", vehicle, VEHICLES)]
    checked_whole("intervals", intervals, INTERVALS)
    allowed = checked_limits(limits, vehicle)
    return Planner(allowed, vehicle, slip_model, method, period, intervals, reverse, ground)


class Planned(NamedTuple):
    """A trajectory with what is drawn beside it."""

    trajectory: Trajectory
    slip: tuple[Array, Array, Array]  # beta left, right [m/s], alpha [rad], (M,) each
    limits: Limits
    vehicle: PlantParameters


def planned(
    goal: Sequence[float],
    start: Sequence[float] = (0.0, 0.0, 0.0),
    method: str = "optimal",
    vehicle: str = "focchi",
    friction: float | None = None,
    slips: bool = True,
    limits: Mapping[str, float] | None = None,
    via: Sequence[Sequence[float]] = (),
    circles: Sequence[Sequence[float]] = (),
    reverse: bool = False,
    slope: Sequence[float] | None = None,
    around: Mapping[str, Any] | None = None,
) -> Planned:
    """Plan from a start to a goal, x, y [m], yaw [rad].

    vehicle: a key of VEHICLES. friction: mu [-] of the soil, that of the vehicle by default. slips:
    whether the plan knows the slip, identified on the distributed plant. limits: fields of
    `Limits`. via: way points. circles: obstacles, x, y, radius [m]. reverse: whether it may be
    driven backwards. slope: of the ground in x and y [-]; None: level. around: margin, room, time
    limit of `plan` around obstacles. Raises ValueError.
    """
    body = VEHICLES[checked_choice("vehicle", vehicle, VEHICLES)]
    if friction is not None:
        body = with_friction(body, friction)
    allowed = Limits.of(body, **dict(limits or {}))
    if slope is not None and not slips:
        raise ValueError("slope without slip; a plan on a slope must know slip. Drop one of them")
    identified = identified_slip if slope is None else identified_slope_slip
    made = plan(
        tuple(start), goal, allowed, identified(body) if slips else None, method, body,
        via=via, obstacles=Obstacles.of(circles=circles) if len(circles) else None,
        reverse=reverse, ground=slope, **dict(around or {}),
    )  # fmt: skip
    assert isinstance(made, Trajectory)
    return Planned(made, made.slip(body), allowed, body)
