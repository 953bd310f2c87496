"""Trajectories of several legs: through way points, and around obstacles.

Around obstacles, the plan straight to the goal is taken if it is free. Otherwise a route of arcs is
searched (`route`), in reverse and with turns on the spot where the planner may do that, and legs
are planned to poses on it: as far along as the leg's plan is free, found by halving. Where not even
a short leg is, the goal is not reached, and the trajectory says so. A leg of the optimal planner
begins with the motion in which the one before ended; paths with a speed profile end every leg at
rest, and so does every leg before a change of gear.

What is free: the rectangle of the vehicle and its margin, at poses along the whole plan that are
half a node of the map apart, whatever the samples of the trajectory. The map covers the whole plan;
where it does not reach, nothing is free.
"""

import math
import time
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.planners.obstacles import Clearance, Footprint, Obstacles, clearances
from baselines.planners.path import Path, places
from baselines.planners.route import PIVOT, Route, find_route
from baselines.planners.trajectory import Limits, Start, Trajectory
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

ROOM = 3.0  # [m] around start and goal in which a route is searched first, at least
ROOMS = 1.0, 2.0, 4.0  # times the first, until a route is found
TIGHTEST = 0.4  # [-] of the track gauge: radius of a route's arcs at least
SHORTEST = 0.2  # [m] of a leg
BEND = 0.8  # [-] of the largest curvature on a route: the rest is for corrections
SLOW = 0.25  # [-] of v_max: speed in the tight arcs of a route, where the planner may choose it
FINE = 0.02  # [s] between the samples of a plan that is checked, at most
_MARGIN = Range(0.0, 10.0, "m", "Did you pass millimetres?")
_SIZE = Range(0.01, 100.0, "m", "Did you pass millimetres?")
_ROOM = Range(0.0, 1000.0, "m", "Did you pass millimetres?")
_TIME = Range(0.01, 3600.0, "s", "Did you pass milliseconds?")


class RouteSearch(NamedTuple):
    """How a way around obstacles is searched."""

    margin: float = 0.05  # [m] around the vehicle
    footprint: tuple[float, float] | None = None  # [m] length, width; None: of the tracks
    room: float | None = None  # [m] around start and goal; None: by the vehicle, and then more
    time_limit: float = 10.0  # [s] for all routes of a plan

    def checked(self) -> "RouteSearch":
        """The same with numbers in range. Raises ValueError."""
        checked_number("search margin", self.margin, _MARGIN)
        checked_number("search time_limit", self.time_limit, _TIME)
        if self.room is not None:
            checked_number("search room", self.room, _ROOM)
        if self.footprint is not None:
            if np.shape(self.footprint) != (2,):
                raise ValueError(f"search footprint = {self.footprint!r}; must be length, width")
            for name, size in zip(("length", "width"), self.footprint, strict=True):
                checked_number(f"search footprint {name}", size, _SIZE)
        return self


DEFAULT_SEARCH = RouteSearch()


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
    def chooses_speed(self) -> bool:
        """Whether it can slow down in a tight arc."""

    @property
    def changes_gear(self) -> bool:
        """Whether a plan may go on in reverse."""

    def sampled(self, period: float) -> "Planner":
        """The same planner with another time between samples [s]."""

    def in_gear(self, start: Start, goal: Array, last: bool, gear: float) -> Trajectory:
        """One trajectory to a goal (3,), forwards (gear 1) or in reverse (-1) where it can."""

    def __call__(self, start: Start, goal: Array, last: bool = True) -> Trajectory:
        """One trajectory to a goal (3,); last: to rest there."""


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


def through(
    planner: Planner, start: Start, points: Array, obstacles: Obstacles | None,
    search: RouteSearch = DEFAULT_SEARCH,
) -> Trajectory:  # fmt: skip
    """One trajectory through way points (N, 3); it ends at the first that is not reached."""
    legs, begin = [], start
    for number, point in enumerate(points):
        last = number == len(points) - 1
        leg = planner(begin, point, last)
        if obstacles is not None:
            leg = around(planner, begin, point, obstacles, last, leg, search)
        legs.append(leg)
        if not leg.converged:
            break
        begin = end_of(leg)
    return joined(legs)


def around(
    planner: Planner, start: Start, goal: Array, obstacles: Obstacles, last: bool = True,
    direct: Trajectory | None = None, search: RouteSearch = DEFAULT_SEARCH,
) -> Trajectory:  # fmt: skip
    """One trajectory to a goal (3,) that touches no obstacle; direct: the plan without them.

    Raises ValueError where the vehicle touches one at its start or goal.
    """
    until = time.monotonic() + search.time_limit
    ends = np.array([start[:3], goal])
    field, footprint = _map(obstacles, planner, search, ends, 0.0)
    for name, clear in zip(("start", "goal"), clearances(field, footprint, ends), strict=True):
        if clear <= 0.0:
            raise ValueError(
                f"the vehicle at its {name} is {-clear:.3g} m too near to an obstacle, margin of "
                f"{search.margin:g} m included; must be clear of it. Is the obstacle in the "
                "vehicle's own frame, or the margin too large?"
            )
    direct = planner(start, goal, last) if direct is None else direct
    if direct.converged:
        fine = planner.sampled(min(planner.period, FINE))(start, goal, last)
        field, footprint = _map(obstacles, planner, search, swept(fine), 0.0)
        if is_free(fine, field, footprint):
            return direct
    size = 2.0 * footprint.reach
    room = max(ROOM, 2.0 * size + 2.0 * _radius(planner)) if search.room is None else search.room
    reason = ""
    for share in ROOMS if search.room is None else (1.0,):
        field, footprint = _map(obstacles, planner, search, ends, share * room)
        half_gauge = 0.5 * planner.vehicle.track_gauge if _turns_on_the_spot(planner) else None
        route = find_route(
            start[:3], goal, _radius(planner), field, footprint, planner.changes_gear, half_gauge,
            max(until - time.monotonic(), 0.0),
        )  # fmt: skip
        reason = _searched(route, field, planner, search)
        if route.path is not None:
            made = _along(planner, start, goal, last, route.path, field, footprint)
            if made.converged:
                return made
            reason = made.message
        if time.monotonic() > until:
            break
    return _failed(direct, reason)


def _map(
    obstacles: Obstacles, planner: Planner, search: RouteSearch, poses: Array, room: float
) -> tuple[Clearance, Footprint]:
    """Clearance over poses (M, 3) of the whole vehicle and `room` [m] around, and its footprint."""
    reach = Footprint.of(planner.vehicle, search.margin, size=search.footprint).reach + room + 0.5
    field = obstacles.clearance(poses[:, :2].min(axis=0) - reach, poses[:, :2].max(axis=0) + reach)
    return field, Footprint.of(planner.vehicle, search.margin, field.spacing, search.footprint)


def _searched(route: Route, field: Clearance, planner: Planner, search: RouteSearch) -> str:
    """What a search without success has looked at, in words."""
    wide, high = ((n - 1) * field.spacing for n in field.distance.shape[::-1])
    how = "in both gears" if planner.changes_gear else "forwards only"
    how += ", with turns on the spot" if _turns_on_the_spot(planner) else ""
    until = "all of it" if route.exhausted else f"until the time limit of {search.time_limit:g} s"
    return (
        f"no way around the obstacles was found: searched x {field.x:.3g} to "
        f"{field.x + wide:.3g} m, y {field.y:.3g} to {field.y + high:.3g} m, {how}, turning radius "
        f"{_radius(planner):.3g} m, margin {search.margin:g} m, {until}"
    )


def swept(made: Trajectory, spacing: float = math.inf, reach: float = 0.0) -> Array:
    """Poses (M, 3) along a trajectory that no point within `reach` [m] moves further apart than
    `spacing` [m]."""
    poses = np.stack([made.x, made.y, made.yaw], axis=1)
    if len(poses) == 1:
        return poses
    steps = np.diff(poses, axis=0)
    moved = np.hypot(steps[:, 0], steps[:, 1]) + reach * np.abs(steps[:, 2])
    parts = np.maximum(np.ceil(moved / spacing), 1).astype(np.int64)
    share = np.concatenate([np.arange(count) / count for count in parts])
    begin = np.repeat(np.arange(len(parts)), parts)
    return np.vstack([poses[begin] + share[:, None] * steps[begin], poses[-1:]])


def is_free(made: Trajectory, field: Clearance, footprint: Footprint) -> bool:
    """Whether the vehicle touches no obstacle along a trajectory, between its samples too."""
    poses = swept(made, 0.5 * field.spacing, float(footprint.offset[-1]))
    return bool(np.min(clearances(field, footprint, poses)) > -0.5 * field.spacing)


def _along(
    planner: Planner,
    start: Start,
    goal: Array,
    last: bool,
    path: Path,
    field: Clearance,
    footprint: Footprint,
) -> Trajectory:
    """Legs to poses on the route, each in one gear and as long as its plan is free."""
    legs: list[Trajectory] = []
    fine = planner.sampled(min(planner.period, FINE))
    ends, gears = _stretches(path)
    begin, at = start, 0.0
    for end, gear in zip(ends, gears, strict=True):
        while at < end - 1e-9:
            to = end
            while True:
                place = places(path, [to])
                target = np.array([place.x[0], place.y[0], place.yaw[0]])
                target = goal if to == ends[-1] else target
                rest = last if to == ends[-1] else to == end
                leg = fine.in_gear(begin, target, rest, gear)
                if leg.converged and is_free(leg, field, footprint):
                    break
                to = at + 0.5 * (to - at)
                if to - at < SHORTEST:
                    return _failed(joined([*legs, leg]), "no free leg along the route was found")
            if planner.period > FINE:
                leg = planner.in_gear(begin, target, rest, gear)
            legs.append(leg)
            begin, at = end_of(leg), to
    return joined(legs)


def _stretches(path: Path) -> tuple[list[float], list[float]]:
    """Ends [m] of the parts of a route in one gear, and the gears; a turn on the spot is a part."""
    kinds = np.where(np.abs(path.curvature) > 0.5 / PIVOT, 0.0, np.sign(path.length))
    ways = np.cumsum(np.abs(path.length))
    changes = np.append(np.flatnonzero(np.diff(kinds)), len(kinds) - 1)
    return ways[changes].tolist(), np.where(kinds[changes] < 0.0, -1.0, 1.0).tolist()


def _turns_on_the_spot(planner: Planner) -> bool:
    """Whether a plan may stand and turn."""
    return planner.chooses_speed and planner.limits.v_min == 0.0


def _radius(planner: Planner) -> float:
    """Turning radius [m] of a route that the planner can follow."""
    limits = planner.limits
    fast = SLOW * limits.v_max if planner.chooses_speed else min(limits.v_max, 1.0)
    bend = BEND * limits.curvature_at(max(limits.v_min, fast), planner.vehicle)
    return max(TIGHTEST * planner.vehicle.track_gauge, 1.0 / bend if bend > 0.0 else 1.0)


def _failed(made: Trajectory, why: str) -> Trajectory:
    """The same trajectory, not to be driven."""
    return made._replace(converged=False, message="; ".join(filter(None, [made.message, why])))
