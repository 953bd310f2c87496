"""Trajectories of several legs: through way points, and around obstacles.

Around obstacles, the plan straight to the goal is taken if it is free. Otherwise a route is
searched (`route`). Dubins and Reeds-Shepp drive it as it is; the others plan legs to poses on it:
as far along as the leg's plan is free, found by halving, and to rest where the gear changes, before
and after turns on the spot, and where no leg goes on in motion. A leg of the optimal planner begins
with the motion in which the one before ended; paths with a speed profile end every leg at rest.

A plan is free if the rectangle of the vehicle, with its margin, is clear of obstacles at samples so
dense that nothing fits between them (`clearance`), whatever the period of the samples returned.
"""

import math
import time
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.planners.clearance import (
    FREE,
    TOLERANCE,
    UNCERTAIN,
    Footprint,
    Scene,
    clearances,
    moved,
    swept,
)
from baselines.planners.curves import Path
from baselines.planners.hybrid_a_star import Motions
from baselines.planners.obstacles import Obstacles, Route, Search, find_route
from baselines.planners.trajectory import Limits, Start, Trajectory
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

TIGHTEST = 0.4  # [-] of the track gauge: radius of a route's arcs at least
SHORTEST = 0.05  # [-] of the vehicle's radius, or [rad]: of a leg
BEND = 0.8  # [-] of the largest curvature on a route: the rest is for corrections
COARSE, FINER = 16, 4  # samples of a first look, and of the next, over those of the last one


class Planner(Protocol):
    """What plans one leg."""

    @property
    def limits(self) -> Limits:
        """Limits of the vehicle."""

    @property
    def vehicle(self) -> PlantParameters:
        """The vehicle."""

    @property
    def period(self) -> float:
        """Time between samples [s]."""

    @property
    def method(self) -> str:
        """Of `plan`."""

    @property
    def gears(self) -> int:
        """In which a route may be driven: 1: forwards, 2: both, 0: both, but without a change."""

    @property
    def turns_on_the_spot(self) -> bool:
        """Whether a leg may."""

    def __call__(self, start: Start, goal: Array, last: bool = True, gear: int = 0) -> Trajectory:
        """One trajectory to a goal (3,); last: to rest there; gear: 1, -1, or 0 for any."""

    @property
    def follows(self) -> bool:
        """Whether it can drive arcs and lines, where belts jump."""

    def follow(self, start: Start, path: Path, goal: Array) -> Trajectory:
        """The trajectory along a path."""

    def _replace(self, *, period: float) -> "Planner":
        """The same with another period."""


def end_of(made: Trajectory) -> Start:
    """Pose and motion at the end of a trajectory."""
    return Start(
        float(made.x[-1]), float(made.y[-1]), float(made.yaw[-1]),
        float(made.speed[-1] * math.cos(made.course[-1] - made.yaw[-1])),
        float(made.yaw_rate[-1]), float(made.sprocket_left[-1]), float(made.sprocket_right[-1]),
    )  # fmt: skip


def joined(legs: list[Trajectory]) -> Trajectory:
    """Legs one after the other; the end errors are those of the last.

    Where two meet, the sample is the first one of the later leg, whose speeds hold from there on.
    """
    if len(legs) == 1:
        return legs[0]
    rows = {name: [getattr(legs[0], name)] for name in Trajectory._fields[:13]}
    for leg in legs[1:]:
        turned = rows["yaw"][-1][-1] - leg.yaw[0]
        turned = 2.0 * math.pi * round(turned / (2.0 * math.pi))
        for name, parts in rows.items():
            values = getattr(leg, name)
            if name == "time":
                values = values + parts[-1][-1]
            elif name in ("yaw", "course"):
                values = values + turned
            parts[-1] = parts[-1][:-1]
            parts.append(values)
    notes = [f"leg {i + 1}: {leg.message}" for i, leg in enumerate(legs) if leg.message]
    whole: dict[str, Any] = {name: np.concatenate(parts) for name, parts in rows.items()}
    return legs[-1]._replace(
        **whole,
        cost=sum(leg.cost for leg in legs),
        converged=all(leg.converged for leg in legs),
        iterations=sum(leg.iterations for leg in legs),
        message="; ".join(notes),
    )


class Space:
    """Obstacles as a vehicle meets them, and what a search for a way around them may take."""

    def __init__(
        self, obstacles: Obstacles, footprint: Footprint, margin: float, room: float | None,
        time_limit: float,
    ) -> None:  # fmt: skip
        """All checked. Raises ValueError for more edges than are handled."""
        self.obstacles, self.footprint, self.margin = obstacles, footprint, margin
        self.room, self.time_limit = room, time_limit
        self.capsules = obstacles.capsules()
        self._scene: Scene | None = None

    def scene(self, poses: Array) -> Scene:
        """The obstacles around poses (M, 3)."""
        low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
        if self._scene is None or not self._scene.covers(low, high):
            pad = self.footprint.radius
            self._scene = Scene.of(
                self.capsules, self.footprint, self.margin, low - pad, high + pad
            )
        return self._scene

    def check(self, name: str, pose: Array) -> None:
        """Raise ValueError where a vehicle at a pose (3,) has not its margin."""
        scene = self.scene(pose[None])
        clear = float(clearances(scene, pose)[0])
        if self.obstacles.contain(float(pose[0]), float(pose[1])):
            clear = -math.inf
        if clear > scene.tolerance:
            return
        where = f"{clear + self.margin:.3g} m from an obstacle"
        if clear <= -self.margin:
            where = "in an obstacle"
        raise ValueError(
            f"the vehicle at its {name} is {where} at {pose.tolist()}; must be more than "
            f"{self.margin + scene.tolerance:.3g} m away, margin included. Is the obstacle in the "
            "vehicle's own frame, or the margin too large?"
        )

    def state_of(self, made: Trajectory, planner: Planner) -> int:
        """Whether the sweep of a trajectory is FREE, UNCERTAIN or TOUCHING."""
        poses = np.stack([made.x, made.y, made.yaw], axis=1)
        speed, turn = self._fastest(planner)
        fastest = max(speed, np.abs(made.speed).max())
        fastest += self.footprint.radius * max(turn, np.abs(made.yaw_rate).max())
        return swept(self.scene(poses), poses, fastest * np.diff(made.time))

    def finest(self, planner: Planner) -> float:
        """Period [s] at which a motion with twice the tolerance's clearance is never UNCERTAIN."""
        speed, turn = self._fastest(planner)
        radius = self.footprint.radius
        return 1.9 * TOLERANCE * radius / (speed + radius * turn)

    def _fastest(self, planner: Planner) -> tuple[float, float]:
        """Speed [m/s] and yaw rate [rad/s] that limits allow."""
        belt = planner.vehicle.sprocket_radius * planner.limits.sprocket_used
        return planner.limits.v_max, 2.0 * belt / planner.vehicle.track_gauge


def through(planner: Planner, start: Start, points: Array, space: Space | None) -> Trajectory:
    """One trajectory through way points (N, 3); it ends at the first that is not reached.

    Raises ValueError where the start or a point is too near to an obstacle.
    """
    legs, begin = [], start
    if space is not None:
        space.check("start", np.array(start[:3]))
        for number, point in enumerate(points, 1):
            space.check("goal" if number == len(points) else f"way point {number}", point)
    for number, point in enumerate(points):
        last = number == len(points) - 1
        if space is None:
            leg = planner(begin, point, last)
        else:
            leg = around(planner, begin, point, space, last)
        legs.append(leg)
        if not leg.converged:
            break
        begin = end_of(leg)
    return joined(legs)


def around(
    planner: Planner, start: Start, goal: Array, space: Space, last: bool = True
) -> Trajectory:
    """One trajectory to a goal (3,) that touches no obstacle."""
    direct, free = _checked(planner, space, lambda p: p(start, goal, last))
    if free:
        return direct
    routes = [_route(planner, start, goal, space, gears) for gears in _orders(planner)[:1]]
    if not len(routes[0].pieces):
        routes += [_route(planner, start, goal, space, gears) for gears in _orders(planner)[1:]]
    route = routes[-1]
    if not len(route.pieces):
        why = f"no way around the obstacles was found: {'; '.join(r.report for r in routes)}"
        return _failed(direct, why + ("" if "cannot go between" in why else _advice(planner)))
    made, free = direct, False
    if planner.method in ("optimal", "clothoid"):
        made, free = _along(planner, start, goal, last, route, space)
    if not free and not route.turns_on_the_spot and planner.follows:
        made, free = _checked(planner, space, lambda p: p.follow(start, route.path(), goal))
    return made if free else _failed(made, "no free plan along a free route was found")


def _orders(planner: Planner) -> tuple[int, ...]:
    """Gears of the searches, one after the other."""
    return (planner.gears,) if planner.gears else (1, -1)


def _route(planner: Planner, start: Start, goal: Array, space: Space, gears: int) -> Route:
    """A route in the gears allowed."""
    motions = Motions(
        _radius(planner), gears, planner.turns_on_the_spot, 0.5 * planner.vehicle.track_gauge
    )
    limit = space.time_limit / len(_orders(planner))
    search = Search(space.capsules, space.footprint, space.margin, motions, space.room, limit)
    return find_route(np.array(start[:3], dtype=np.float64), goal, search)


def _advice(planner: Planner) -> str:
    """What may help."""
    help_gears = ""
    if planner.gears == 1:
        help_gears = " reverse=True," if planner.method == "optimal" else " 'reeds-shepp',"
    return f". May help:{help_gears} a smaller margin, more room, a larger time_limit"


def _checked(planner: Planner, space: Space, make: Any) -> tuple[Trajectory, bool]:
    """The plan of make(planner) with the planner's period, and whether it is free."""
    finest = space.finest(planner)
    period = min(planner.period, COARSE * finest)
    while True:
        parts = math.ceil(planner.period / period - 1e-9)
        made = make(planner._replace(period=planner.period / parts))
        state = space.state_of(made, planner) if made.converged else UNCERTAIN
        if not made.converged or state != UNCERTAIN or period <= finest:
            return (made if parts == 1 else _thinned(made, planner.period)), state == FREE
        period = max(period / FINER, finest)


def _thinned(made: Trajectory, period: float) -> Trajectory:
    """A trajectory at multiples of the period [s], at its ends, and where held belts step."""
    turns = made.time / period
    chosen = np.abs(turns - np.round(turns)) < 1e-6
    chosen[[0, -1]] = True
    if made.method == "optimal":
        belts = np.stack([made.sprocket_left, made.sprocket_right])
        chosen[1:] |= np.any(belts[:, 1:] != belts[:, :-1], axis=0)
    rows: dict[str, Any] = {name: getattr(made, name)[chosen] for name in Trajectory._fields[:13]}
    return made._replace(**rows)


class _Run(NamedTuple):
    """Pieces of a route in one gear, or on the spot."""

    begin: Array  # (3,) pose
    pieces: Array  # (P, 2)

    @property
    def gear(self) -> int:
        """1, -1, or 0 on the spot."""
        return int(np.sign(self.pieces[0, 0]))

    @property
    def lengths(self) -> Array:
        """(P,) [m], or [rad] on the spot."""
        return np.abs(self.pieces[:, 0 if self.gear else 1])

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
    runs, pose = [], route.start
    for pieces in np.split(route.pieces, cuts):
        run = _Run(pose, pieces)
        runs.append(run)
        pose = run.at(math.inf)
    return runs


def _along(
    planner: Planner, start: Start, goal: Array, last: bool, route: Route, space: Space
) -> tuple[Trajectory, bool]:
    """Legs to poses on the route, each as long as its plan is free; whether they reach the goal."""
    legs: list[Trajectory] = []
    begin, until = start, time.perf_counter() + space.time_limit
    runs = _runs(route)
    for number, run in enumerate(runs):
        at, length, before = 0.0, float(run.lengths.sum()), None
        final = number == len(runs) - 1
        shortest = SHORTEST * (space.footprint.radius if run.gear else 1.0)
        while at < length - 1e-9:
            to = length
            while True:
                target = goal if final and to == length else run.at(to)
                rest = to == length and (last or not final)
                leg, free = _leg(planner, space, begin, target, rest, run.gear)
                if free or to - at < shortest or time.perf_counter() > until:
                    break
                to = at + 0.5 * (to - at)
            if not free and before is not None:
                # to rest at the end of the leg before, and on from there
                leg, free = _leg(planner, space, *before, True, run.gear)
                legs, before, to = legs[:-1], None, at
            else:
                before = None if to == length else (begin, target)
            if not free:
                return joined([*legs, leg]), False
            legs.append(leg)
            begin, at = end_of(leg), to
    return joined(legs), True


def _leg(
    planner: Planner, space: Space, begin: Start, target: Array, rest: bool, gear: int
) -> tuple[Trajectory, bool]:
    """A leg in a gear, and whether it is free."""
    return _checked(planner, space, lambda p: p(begin, target, rest, gear or 1))


def _radius(planner: Planner) -> float:
    """Turning radius [m] of a route that the planner can follow."""
    speed = max(planner.limits.v_min, min(planner.limits.v_max, 1.0))
    bend = BEND * planner.limits.curvature_at(speed, planner.vehicle)
    return max(TIGHTEST * planner.vehicle.track_gauge, 1.0 / bend if bend > 0.0 else 1.0)


def _failed(made: Trajectory, why: str) -> Trajectory:
    """The same trajectory, not to be driven."""
    return made._replace(converged=False, message="; ".join(filter(None, [made.message, why])))
