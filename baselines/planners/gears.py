"""Optimal plans that may drive in reverse: the cheapest of one gear, and of changes between both.

A vehicle in reverse is one that drives forwards with its ends exchanged: turned by pi, with the
left track for the right one and sprockets that run the other way. Slip is mirrored with it, as the
tracks are symmetric from front to back: p -> -p, v_x -> -v_x, v_y -> -v_y at the same q and w. So a
plan in reverse is the forward plan from the turned start to the turned goal, exactly.

Changes of gear are those of Reeds-Shepp paths, of RADII times the radius at which the belts
can turn: their cusps are poses that legs in alternating gears join, each a plan of least time that
ends at rest, if the limits say how to brake. The cusps are not optimized further.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from baselines.planners.chain import end_of, joined
from baselines.planners.path import Path, places
from baselines.planners.reeds_shepp import reeds_shepp
from baselines.planners.trajectory import Start, Trajectory

Array = NDArray[np.float64]
Drive = Callable[
    [Start, Array, bool], Trajectory
]  # forwards to a goal (3,), whether it is the last

RADII = 1.0, 2.0  # [-] of the least radius: of the Reeds-Shepp paths that are tried
SHORTEST = 1e-6  # [m] of a leg


def turned_start(start: Start) -> Start:
    """The start as the vehicle sees it whose front is the back of this one."""
    left, right = start.sprocket_left, start.sprocket_right
    return Start(
        start.x, start.y, start.yaw + math.pi, -start.speed, start.yaw_rate,
        None if right is None else -right, None if left is None else -left,
    )  # fmt: skip


def turned(made: Trajectory) -> Trajectory:
    """The same motion of the vehicle whose front is the back of this one."""
    return made._replace(
        yaw=made.yaw - math.pi, course=made.course - math.pi,
        speed=-made.speed, acceleration=-made.acceleration,
        sprocket_left=-made.sprocket_right, sprocket_right=-made.sprocket_left,
    )  # fmt: skip


def in_reverse(drive: Drive, start: Start, goal: Array, last: bool) -> Trajectory:
    """The plan that drives backwards all the way."""
    return turned(drive(turned_start(start), goal + np.array([0.0, 0.0, math.pi]), last))


def cheapest(
    drive: Drive, start: Start, goal: Array, radius: float | None, last: bool
) -> Trajectory:
    """The plan of least cost among one gear and changes between both.

    drive: plans forwards. radius: at which the belts can turn [m]; None: the gear cannot change, as
    at constant speed the belts would jump. The first plan is returned where none converged.
    """
    found = [drive(start, goal, last), in_reverse(drive, start, goal, last)]
    for share in RADII if radius is not None else ():
        assert radius is not None
        legs = _legs(drive, start, goal, share * radius, last)
        if legs:
            found.append(joined(legs))
    plans = [made for made in found if made.converged]
    return min(plans, key=lambda made: made.cost) if plans else found[0]


def _legs(drive: Drive, start: Start, goal: Array, radius: float, last: bool) -> list[Trajectory]:
    """Plans from cusp to cusp of the Reeds-Shepp path; none where it has no cusp."""
    made = reeds_shepp(start[:3], goal, radius)
    path = Path.of(start[:3], made.segments[0], made.curvature[0])
    cusps = np.flatnonzero(np.diff(np.sign(path.length)))
    if not len(cusps):
        return []
    ends = np.cumsum(np.abs(path.length))
    at = places(path, ends[cusps])
    targets = [*np.stack([at.x, at.y, at.yaw], axis=1), goal]
    gears = np.sign(path.length)[[*cusps, -1]]
    legs, begin = [], start
    for target, gear in zip(targets, gears, strict=True):
        if math.hypot(target[0] - begin.x, target[1] - begin.y) < SHORTEST:
            continue
        final = last or target is not goal
        leg = (drive if gear > 0.0 else _backwards(drive))(begin, target, final)
        legs.append(leg)
        if not leg.converged:
            break
        begin = end_of(leg)
    return legs


def _backwards(drive: Drive) -> Drive:
    return lambda start, goal, last: in_reverse(drive, start, goal, last)
