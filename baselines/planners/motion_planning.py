"""`plan`: from a start to a goal by any method, through way points and around obstacles.

    dubins        shortest path with bounded curvature, forwards
    reeds-shepp   the same, forwards and in reverse
    clothoid      one clothoid; another method where it breaks a limit or goes far round
    optimal       least time under slip (`least_time`), forwards, or with `reverse` in the gears
                  that cost least (`legs`)

Around obstacles, the plan straight to the goal is taken if it is free. Otherwise a route is
searched (`route`). Dubins and Reeds-Shepp drive it as it is; the others plan legs to poses on it:
as far along as the leg's plan is free, found by halving, and to rest where the gear changes, before
and after turns on the spot, and where no leg goes on in motion. A leg of the optimal planner begins
with the motion in which the one before ended; paths with a speed profile end every leg at rest.
A plan is free if the rectangle of the vehicle, with its margin, is clear of obstacles at samples so
dense that nothing fits between them (`obstacles`), whatever the period of the samples returned.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 6.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners import obstacles as obs
from baselines.planners import trajectory
from baselines.planners.hybrid_a_star import Motions
from baselines.planners.least_time import INTERVALS, PERIOD, THREADS, optimal
from baselines.planners.legs import Planner, concatenated, end_of
from baselines.planners.plan_on_slopes import Ground
from baselines.planners.route import Route, Search, find_route
from baselines.planners.speed_along_path import moved
from baselines.planners.trajectory import Limits, Start, Trajectory
from baselines.slip.slip_models import SlipModel
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_choice, checked_flag, checked_number, checked_whole
from tracked_env.vehicles import Spec, find_vehicle

Array = NDArray[np.float64]

METHODS = ("optimal", "dubins", "reeds-shepp", "clothoid")
_ROOM = Range(0.0, 1e6, "m", "It is around start and goal.")
_TIME_LIMIT = Range(0.0, 1e5, "s", "Did you pass milliseconds?")
_MARGIN = Range(0.0, 100.0, "m", "Did you pass millimetres?")
TIGHTEST = 0.4  # [-] of the track gauge: radius of a route's arcs at least
SHORTEST = 0.05  # [-] of the vehicle's radius, or [rad]: of a leg
BEND = 0.8  # [-] of the largest curvature on a route: the rest is for corrections
COARSE, FINER = 16, 4  # samples of a first look, and of the next, over those of the last one


@dataclass
class Space:
    """Obstacles as a vehicle meets them, and what a search for a way around them may take."""

    obstacles: obs.Obstacles
    footprint: obs.Footprint
    margin: float  # [m]
    room: float | None  # [m]
    time_limit: float  # [s]
    _scene: obs.Scene | None = None

    def __post_init__(self) -> None:
        self.capsules = self.obstacles.capsules()

    def scene(self, poses: Array) -> obs.Scene:
        """The obstacles around poses (M, 3)."""
        low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
        if self._scene is None or not self._scene.covers(low, high):
            area = low - self.footprint.radius, high + self.footprint.radius
            self._scene = obs.Scene.of(self.capsules, self.footprint, self.margin, *area)
        return self._scene

    def check(self, name: str, pose: Array) -> None:
        """Raise ValueError where a vehicle at a pose (3,) has not its margin."""
        scene = self.scene(pose[None])
        clear = float(obs.clearances(scene, pose)[0])
        if self.obstacles.contain(float(pose[0]), float(pose[1])):
            clear = -math.inf
        where = f"{clear + self.margin:.3g} m from" if clear > -self.margin else "in"
        if clear <= scene.tolerance:
            raise ValueError(
                f"the vehicle at its {name} is {where} an obstacle at {pose.tolist()}; must be "
                f"more than {self.margin + scene.tolerance:.3g} m away, margin included. Is the "
                "obstacle in the vehicle's own frame, or the margin too large?"
            )

    def state_of(self, plan: Trajectory, planner: Planner) -> int:
        """Whether the sweep of a trajectory is OPEN, UNCERTAIN or TOUCHING."""
        poses = np.stack([plan.x, plan.y, plan.yaw], axis=1)
        speed, turn = planner.fastest
        fastest = max(speed, np.abs(plan.speed).max())
        fastest += self.footprint.radius * max(turn, np.abs(plan.yaw_rate).max())
        return int(obs.swept(self.scene(poses), poses, fastest * np.diff(plan.time)))

    def finest(self, planner: Planner) -> float:
        """Period [s] at which a motion with twice the tolerance's clearance is never UNCERTAIN."""
        speed, turn = planner.fastest
        radius = self.footprint.radius
        return 1.9 * obs.TOLERANCE * radius / (speed + radius * turn)


def _through(planner: Planner, start: Start, points: Array, space: Space | None) -> Trajectory:
    """One trajectory through way points (N, 3); it ends at the first that is not reached.

    Raises ValueError where the start or a point is too near to an obstacle.
    """
    legs, begin = [], start
    names = [*(f"way point {number}" for number in range(1, len(points))), "goal"]
    if space is not None:
        for name, pose in zip(["start", *names], [start[:3], *points], strict=True):
            space.check(name, np.array(pose))
    for name, point in zip(names, points, strict=True):
        task = begin, point, name == "goal"
        legs.append(planner(*task) if space is None else _around(planner, space, *task))
        if not legs[-1].converged:
            break
        begin = end_of(legs[-1])
    return concatenated(legs)


def _around(planner: Planner, space: Space, start: Start, goal: Array, last: bool) -> Trajectory:
    """One trajectory to a goal (3,) that touches no obstacle."""
    direct, free = _checked(planner, space, lambda p: p(start, goal, last))
    if free:
        return direct
    limits, vehicle = planner.limits, planner.vehicle
    bend = BEND * limits.curvature_at(max(limits.v_min, min(limits.v_max, 1.0)), vehicle)
    radius = max(TIGHTEST * vehicle.track_gauge, 1.0 / bend if bend > 0.0 else 1.0)
    orders = (planner.gears,) if planner.gears else (1, -1)  # gears of the searches in turn
    shape, limit = (space.capsules, space.footprint, space.margin), space.time_limit / len(orders)
    reports = []
    for gears in orders:
        motions = Motions(radius, gears, planner.turns_on_the_spot, 0.5 * vehicle.track_gauge)
        search = Search(*shape, motions, space.room, limit)
        route = find_route(np.array(start[:3], dtype=np.float64), goal, search)
        reports.append(route.report)
        if len(route.pieces):
            break
    plan, free, why = direct, False, "no free plan along a free route was found"
    if not len(route.pieces):
        why = f"no way around the obstacles was found: {'; '.join(reports)}"
        if "cannot go between" not in why:
            gear = " reverse=True," if planner.method == "optimal" else " 'reeds-shepp',"
            gear = gear if planner.gears == 1 else ""
            why += f". May help:{gear} a smaller margin, more room, a larger time_limit"
    else:
        if planner.method in ("optimal", "clothoid"):
            plan, free = _along(planner, start, goal, last, route, space)
        if not free and not route.turns_on_the_spot and planner.follows:
            plan, free = _checked(planner, space, lambda p: p.follow(start, route.path(), goal))
    notes = "; ".join(filter(None, [plan.message, why]))
    return plan if free else plan._replace(converged=False, message=notes)


def _checked(
    planner: Planner, space: Space, make: Callable[[Planner], Trajectory]
) -> tuple[Trajectory, bool]:
    """The plan of make(planner) with the planner's period, and whether it is free."""
    finest = space.finest(planner)
    period = min(planner.period, COARSE * finest)
    while True:
        parts = math.ceil(planner.period / period - 1e-9)
        plan = make(planner._replace(period=planner.period / parts))
        state = space.state_of(plan, planner) if plan.converged else obs.UNCERTAIN
        if not plan.converged or state != obs.UNCERTAIN or period <= finest:
            return (plan if parts == 1 else _thinned(plan, planner.period)), state == obs.OPEN
        period = max(period / FINER, finest)


def _thinned(plan: Trajectory, period: float) -> Trajectory:
    """A trajectory at multiples of the period [s], at its ends, and where held belts step."""
    turns = plan.time / period
    chosen = np.abs(turns - np.round(turns)) < 1e-6
    chosen[[0, -1]] = True
    if plan.method == "optimal":
        belts = np.stack([plan.sprocket_left, plan.sprocket_right])
        chosen[1:] |= np.any(belts[:, 1:] != belts[:, :-1], axis=0)
    samples = np.array(plan[: trajectory.SAMPLED])[:, chosen]
    return Trajectory._make((*samples, *plan[trajectory.SAMPLED :]))


class _Run(NamedTuple):
    """A part of a route in one gear, or on the spot."""

    begin: Array  # (3,) pose
    pieces: Array  # (P, 2) way [m] and turn [rad]

    gear: int  # 1, -1, or 0 on the spot
    lengths: Array  # (P,) [m], or [rad] on the spot

    def at(self, length: float) -> Array:
        """The pose (3,) after a length."""
        pose = tuple(self.begin)
        for piece, whole in zip(self.pieces, self.lengths, strict=True):
            share = min(length / whole, 1.0)
            pose = moved(*pose, *(share * piece))
            length -= whole
            if length <= 0.0:
                break
        return np.array(pose)


def _runs(route: Route) -> list[_Run]:
    """A route cut where its gear changes."""
    cuts = np.flatnonzero(np.diff(np.sign(route.pieces[:, 0]))) + 1
    runs, pose = list[_Run](), route.start
    for pieces in np.split(route.pieces, cuts):
        gear = int(np.sign(pieces[0, 0]))
        runs.append(_Run(pose, pieces, gear, np.abs(pieces[:, 0 if gear else 1])))
        pose = runs[-1].at(math.inf)
    return runs


def _along(
    planner: Planner, start: Start, goal: Array, last: bool, route: Route, space: Space
) -> tuple[Trajectory, bool]:
    """Legs to poses on the route, each as long as its plan is free; whether they reach the goal."""
    legs: list[Trajectory] = []
    begin, until = start, time.perf_counter() + space.time_limit
    runs = _runs(route)

    def leg_to(begin: Start, target: Array, rest: bool, gear: int) -> tuple[Trajectory, bool]:
        return _checked(planner, space, lambda p: p(begin, target, rest, gear or 1))

    for number, run in enumerate(runs):
        at, length, before = 0.0, float(run.lengths.sum()), None
        final = number == len(runs) - 1
        shortest = SHORTEST * (space.footprint.radius if run.gear else 1.0)
        while at < length - 1e-9:
            to = length
            while True:
                target = goal if final and to == length else run.at(to)
                rest = to == length and (last or not final)
                leg, free = leg_to(begin, target, rest, run.gear)
                if free or to - at < shortest or time.perf_counter() > until:
                    break
                to = at + 0.5 * (to - at)
            if not free and before is not None:
                # to rest at the end of the leg before, and on from there
                leg, free = leg_to(*before, True, run.gear)
                legs, before, to = legs[:-1], None, at
            else:
                before = None if to == length else (begin, target)
            if not free:
                return concatenated([*legs, leg]), False
            legs.append(leg)
            begin, at = end_of(leg), to
    return concatenated(legs), True


def plan(
    start: Start | Sequence[Start] | ArrayLike,
    goal: ArrayLike,
    limits: Limits | Mapping[str, float] | None = None,
    slip_model: SlipModel | None = None,
    method: str = "optimal",
    vehicle: Spec = "focchi",
    *,
    via: ArrayLike = (),
    obstacles: obs.Obstacles | None = None,
    period: float = 0.02,
    intervals: int = 40,
    threads: int = 1,
    reverse: bool = False,
    ground: Ground | None = None,
    footprint: Sequence[float] | None = None,
    margin: float = obs.MARGIN,
    room: float | None = None,
    time_limit: float = 5.0,
) -> Trajectory | list[Trajectory]:
    """Plan from a start to a goal (3,), or for N pairs (N, 3): x, y [m], yaw [rad].

    start: pose, or `Start` for a moving vehicle; N of them, or one for all goals, as one goal may
    be that of all starts. limits: those of the vehicle on its soil by default, or a dict of some.
    slip_model: of `baselines.slip`; None plans as if the tracks did not slip. vehicle: parameters,
    name, file or values. via: way points (K, 3) to be passed before the goal. period: time between
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
    checked_choice("method", method, METHODS)
    checked_number("period", period, PERIOD)
    if checked_flag("reverse", reverse) and method in ("dubins", "clothoid"):
        raise ValueError(
            f"reverse = True; must be False with method = '{method}', whose paths are driven "
            "forwards. Did you mean 'reeds-shepp' or 'optimal'?"
        )
    if ground is not None and method != "optimal":
        raise ValueError(f"ground with method = '{method}'; must be 'optimal', which knows slopes")
    if not isinstance(vehicle, PlantParameters):
        vehicle = find_vehicle(vehicle)
    checked_whole("intervals", intervals, INTERVALS)
    limits = trajectory.checked_limits(limits, vehicle)
    planner = Planner(limits, vehicle, slip_model, method, period, intervals, reverse, ground)
    body = obs.Footprint.of(vehicle, footprint), checked_number("margin", margin, _MARGIN)
    checked_number("room", 0.0 if room is None else room, _ROOM)
    checked_number("time_limit", time_limit, _TIME_LIMIT)
    if obstacles is not None and not isinstance(obstacles, obs.Obstacles):
        raise ValueError(
            f"obstacles = a {type(obstacles).__name__}; must be Obstacles. Did you mean "
            "Obstacles.of(circles=..., polygons=...)?"
        )
    space = None if obstacles is None else Space(obstacles, *body, room, time_limit)
    begins, goals, single = trajectory.checked_starts(start, goal)
    workers = checked_whole("threads", threads, THREADS)
    before = trajectory.checked_table("via", via) if np.size(via) else np.zeros((0, 3))
    passing = space is not None or len(before) > 0
    if method == "optimal" and workers > 1 and not (reverse or passing or ground is not None):
        how: Any = {"intervals": intervals, "period": period, "stop": planner.brakes}
        several: Any = optimal(begins, goals, limits, vehicle, slip_model, threads=workers, **how)
        return several[0] if single else list(several)
    plans = []
    for begin, row in zip(begins, goals, strict=True):
        try:
            trajectory.checked_table("goal", row)
            plans.append(_through(planner, begin, np.vstack([before, row]), space))
        except ValueError as error:
            if single:
                raise
            plans.append(trajectory.failed_plan(begin, row, method, str(error)))
    return plans[0] if single else plans
