"""Trajectories of several legs: through way points, and around obstacles.

Around obstacles, the plan straight to the goal is taken if it is free. Otherwise a route of arcs is
searched (`route`), and legs are planned to poses on it: as far along as the leg's plan is free,
found by halving. Where not even a short leg is, the goal is not reached, and the trajectory says
so. A leg of the optimal planner begins with the motion in which the one
before ended; paths with a speed profile end every leg at rest.
"""

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.planners.obstacles import Clearance, Footprint, Obstacles, clearances
from baselines.planners.path import Path, places
from baselines.planners.route import find_route
from baselines.planners.trajectory import Limits, Start, Trajectory
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

ROOM = 3.0  # [m] around start and goal in which a route is searched
TIGHTEST = 0.4  # [-] of the track gauge: radius of a route's arcs at least
SHORTEST = 0.2  # [m] of a leg
BEND = 0.8  # [-] of the largest curvature on a route: the rest is for corrections


class Planner(Protocol):
    """What plans one leg."""

    @property
    def limits(self) -> Limits:
        """Limits of the vehicle."""

    @property
    def vehicle(self) -> PlantParameters:
        """The vehicle."""

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
    planner: Planner, start: Start, points: Array, obstacles: Obstacles | None
) -> Trajectory:
    """One trajectory through way points (N, 3); it ends at the first that is not reached."""
    legs, begin = [], start
    for number, point in enumerate(points):
        last = number == len(points) - 1
        leg = planner(begin, point, last)
        if obstacles is not None:
            leg = around(planner, begin, point, obstacles, last, leg)
        legs.append(leg)
        if not leg.converged:
            break
        begin = end_of(leg)
    return joined(legs)


def around(
    planner: Planner, start: Start, goal: Array, obstacles: Obstacles, last: bool = True,
    direct: Trajectory | None = None,
) -> Trajectory:  # fmt: skip
    """One trajectory to a goal (3,) that touches no obstacle; direct: the plan without them."""
    low, high = np.minimum(start[:2], goal[:2]) - ROOM, np.maximum(start[:2], goal[:2]) + ROOM
    field, footprint = obstacles.clearance(low, high), Footprint.of(planner.vehicle)
    ends = clearances(field, footprint, np.array([start[:3], goal]))
    for name, clear in zip(("start", "goal"), ends, strict=True):
        if clear <= 0.0:
            raise ValueError(
                f"the vehicle at its {name} is {-clear:.3g} m too near to an obstacle, margin "
                "included; must be clear of it. Is the obstacle in the vehicle's own frame?"
            )
    direct = planner(start, goal, last) if direct is None else direct
    if direct.converged and is_free(direct, field, footprint):
        return direct
    path = find_route(start[:3], goal, _radius(planner), field, footprint).path
    if path is None:
        return _failed(direct, "no way around the obstacles was found")
    return _along(planner, start, goal, last, path, field, footprint)


def is_free(made: Trajectory, field: Clearance, footprint: Footprint) -> bool:
    """Whether no sample of a trajectory touches an obstacle."""
    poses = np.stack([made.x, made.y, made.yaw], axis=1)
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
    """Legs to poses on the route, each as long as its plan is free."""
    legs: list[Trajectory] = []
    begin, at = start, 0.0
    length = path.whole_length
    while at < length - 1e-9:
        to = length
        while True:
            place = places(path, [to])
            target = goal if to == length else np.array([place.x[0], place.y[0], place.yaw[0]])
            leg = planner(begin, target, last and to == length)
            if leg.converged and is_free(leg, field, footprint):
                break
            to = at + 0.5 * (to - at)
            if to - at < SHORTEST:
                return _failed(joined([*legs, leg]), "no free leg along the route was found")
        legs.append(leg)
        begin, at = end_of(leg), to
    return joined(legs)


def _radius(planner: Planner) -> float:
    """Turning radius [m] of a route that the planner can follow."""
    speed = max(planner.limits.v_min, min(planner.limits.v_max, 1.0))
    bend = BEND * planner.limits.curvature_at(speed, planner.vehicle)
    return max(TIGHTEST * planner.vehicle.track_gauge, 1.0 / bend if bend > 0.0 else 1.0)


def _failed(made: Trajectory, why: str) -> Trajectory:
    """The same trajectory, not to be driven."""
    return made._replace(converged=False, message="; ".join(filter(None, [made.message, why])))
