"""Distance between the rectangle of a vehicle and obstacles, exactly, at poses and along motions.

Obstacles are capsules (`obstacles`); those near a place are listed in square buckets. Two convex
shapes that do not meet are nearest at a corner of one, so the distance of a rectangle from a
segment is that of its ends from the rectangle or of a corner from the segment.

A motion is free where no point of the vehicle can have moved farther, since the last pose that was
looked at, than the clearance there: a point of the body moves at most |way| + radius |turn|. So
nothing is between poses, however thin it is, and the margin is kept all along.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

MARGIN = 0.05  # [m] by default
TOLERANCE = 0.004  # [-] of the vehicle's radius: clearance that a free motion has at least
MOST_BUCKETS = 1_000_000
_EXTENT = Range(0.0, 100.0, "m", "Did you pass millimetres?")
_MARGIN = Range(0.0, 100.0, "m", "Did you pass millimetres?")


class Footprint(NamedTuple):
    """The rectangle that a vehicle covers, seen from its centre, without margin."""

    front: float  # [m]
    back: float  # [m]
    left: float  # [m]
    right: float  # [m]

    @classmethod
    def of(cls, vehicle: PlantParameters) -> "Footprint":
        """Contact length by gauge plus track width."""
        along, across = vehicle.contact_length, vehicle.track_gauge + vehicle.track_width
        return cls(0.5 * along, 0.5 * along, 0.5 * across, 0.5 * across)

    @property
    def radius(self) -> float:
        """Of the farthest corner [m]."""
        return math.hypot(max(self.front, self.back), max(self.left, self.right))

    @property
    def turned(self) -> "Footprint":
        """The same seen by a vehicle whose front is the back of this one."""
        return Footprint(self.back, self.front, self.right, self.left)


def checked_footprint(value: Sequence[float] | None, vehicle: PlantParameters) -> Footprint:
    """A footprint from front, back, left, right [m], that of the vehicle for None; ValueError."""
    if value is None:
        return Footprint.of(vehicle)
    if np.ndim(value) != 1 or len(value) != 4:
        raise ValueError(f"footprint = {value!r}; must be front, back, left, right [m]")
    sides = zip(Footprint._fields, value, strict=True)
    made = Footprint(*(checked_number(f"footprint {n}", v, _EXTENT) for n, v in sides))
    if min(made.front + made.back, made.left + made.right) <= 0.0:
        raise ValueError(f"footprint = {tuple(made)}; must have a length and a width above 0 m")
    return made


def checked_margin(value: float) -> float:
    """A margin [m]. Raises ValueError."""
    return checked_number("margin", value, _MARGIN)


class Scene(NamedTuple):
    """Obstacles of a rectangle of places, as a vehicle with its margin meets them."""

    capsules: Array  # (S, 5)
    first: NDArray[np.int64]  # (B + 1,) of every bucket's items
    items: NDArray[np.int32]  # numbers of capsules
    x: float  # [m] of the corner of the first bucket
    y: float  # [m]
    size: float  # [m] of a bucket
    columns: int
    rows: int
    box: Array  # (4,) front, back, left, right [m]
    margin: float  # [m]
    radius: float  # [m] of the vehicle
    tolerance: float  # [m]

    @classmethod
    def of(
        cls, capsules: Array, footprint: Footprint, margin: float, low: Array, high: Array
    ) -> "Scene":
        """Obstacles for centres of the vehicle from low (2,) to high (2,) [m]."""
        radius = footprint.radius
        reach = 2.0 * radius + margin
        extent = np.maximum(high - low, reach)
        size = max(0.5 * reach, math.sqrt(float(np.prod(extent)) / MOST_BUCKETS))
        columns, rows = (int(n) for n in np.ceil(extent / size))
        middle = 0.5 * (low + high) - 0.5 * size * np.array([columns, rows])
        near = np.max(capsules[:, [0, 2]], axis=1) + capsules[:, 4] > middle[0] - reach
        near &= np.min(capsules[:, [0, 2]], axis=1) - capsules[:, 4] < high[0] + reach + size
        near &= np.max(capsules[:, [1, 3]], axis=1) + capsules[:, 4] > middle[1] - reach
        near &= np.min(capsules[:, [1, 3]], axis=1) - capsules[:, 4] < high[1] + reach + size
        chosen = np.flatnonzero(near)
        grid = float(middle[0]), float(middle[1]), float(size), columns, rows
        first = np.zeros(columns * rows + 1, dtype=np.int64)
        _listed(capsules, chosen, grid, reach, first, np.empty(0, dtype=np.int32))
        np.cumsum(first, out=first)
        items = np.empty(int(first[-1]), dtype=np.int32)
        _listed(capsules, chosen, grid, reach, first.copy(), items)
        return cls(
            capsules, first, items, *grid, np.array(footprint), float(margin), radius,
            TOLERANCE * radius,
        )  # fmt: skip

    def covers(self, low: Array, high: Array) -> bool:
        """Whether centres from low (2,) to high (2,) [m] are in buckets."""
        end = self.x + self.columns * self.size, self.y + self.rows * self.size
        return bool(np.all(low >= (self.x, self.y)) and np.all(high <= end))


@formula
def _to_segment(x, y, a_x, a_y, b_x, b_y):
    """Distance [m] of a point from a segment."""
    e_x, e_y, p_x, p_y = b_x - a_x, b_y - a_y, x - a_x, y - a_y
    square = e_x * e_x + e_y * e_y
    part = min(max((p_x * e_x + p_y * e_y) / square, 0.0), 1.0) if square > 0.0 else 0.0
    p_x, p_y = p_x - part * e_x, p_y - part * e_y
    return math.sqrt(p_x * p_x + p_y * p_y)


@formula
def _to_box(box, x, y):
    """Distance [m] of a point from the box, in its axes."""
    away_x = max(x - box[0], -box[1] - x, 0.0)
    away_y = max(y - box[2], -box[3] - y, 0.0)
    return math.sqrt(away_x * away_x + away_y * away_y)


@formula
def _cut(begin, along, low, high, enters, leaves):
    """The part of begin + t along that is between low and high, of t from enters to leaves."""
    if along == 0.0:
        return (enters, leaves) if low <= begin <= high else (1.0, 0.0)
    one, other = (low - begin) / along, (high - begin) / along
    return max(enters, min(one, other)), min(leaves, max(one, other))


@loop
def _box_to_segment(box, a_x, a_y, b_x, b_y):
    """Distance [m] of the box from a segment in its axes, 0 where they meet."""
    enters, leaves = _cut(a_x, b_x - a_x, -box[1], box[0], 0.0, 1.0)
    enters, leaves = _cut(a_y, b_y - a_y, -box[3], box[2], enters, leaves)
    if enters <= leaves:
        return 0.0
    least = min(_to_box(box, a_x, a_y), _to_box(box, b_x, b_y))
    least = min(least, _to_segment(box[0], box[2], a_x, a_y, b_x, b_y))
    least = min(least, _to_segment(box[0], -box[3], a_x, a_y, b_x, b_y))
    least = min(least, _to_segment(-box[1], box[2], a_x, a_y, b_x, b_y))
    return min(least, _to_segment(-box[1], -box[3], a_x, a_y, b_x, b_y))


@loop
def _listed(capsules, chosen, grid, reach, first, items):
    """Count the capsules within `reach` of every bucket into first[1:], or list them in items.

    To list, first is the beginning of every bucket's items, and becomes their end.
    """
    x, y, size, columns, rows = grid
    far = reach + 0.5 * math.sqrt(2.0) * size
    for number in chosen:
        a_x, a_y, b_x, b_y, radius = capsules[number]
        away = far + radius
        low, high = (min(a_y, b_y) - away - y) / size, (max(a_y, b_y) + away - y) / size
        for row in range(max(int(max(low, 0.0)), 0), int(min(high, rows - 1.0)) + 1):
            # the part of the segment that can reach this row
            middle = y + (row + 0.5) * size
            enters, leaves = _cut(a_y, b_y - a_y, middle - away, middle + away, 0.0, 1.0)
            if enters > leaves:
                continue
            one, other = a_x + enters * (b_x - a_x), a_x + leaves * (b_x - a_x)
            low, high = (min(one, other) - away - x) / size, (max(one, other) + away - x) / size
            for column in range(int(max(low, 0.0)), int(min(high, columns - 1.0)) + 1):
                centre = x + (column + 0.5) * size
                if _to_segment(centre, middle, a_x, a_y, b_x, b_y) > away:
                    continue
                bucket = row * columns + column
                if len(items) == 0:
                    first[bucket + 1] += 1
                else:
                    items[first[bucket]] = number
                    first[bucket] += 1


@formula
def bucket_of(scene, x, y):
    """Number of the bucket of a place, -1 outside."""
    u, v = (x - scene.x) / scene.size, (y - scene.y) / scene.size
    if not (0.0 <= u < scene.columns and 0.0 <= v < scene.rows):
        return -1
    return int(v) * scene.columns + int(u)


@loop
def place_clearance(scene, x, y):
    """Distance [m] of a place from the obstacles, at most 2 radii and the margin."""
    bucket, least = bucket_of(scene, x, y), 2.0 * scene.radius + scene.margin
    begin = scene.first[bucket] if bucket >= 0 else 0
    end = scene.first[bucket + 1] if bucket >= 0 else len(scene.capsules)
    for k in range(begin, end):
        c = scene.capsules[scene.items[k] if bucket >= 0 else k]
        least = min(least, _to_segment(x, y, c[0], c[1], c[2], c[3]) - c[4])
    return least


@loop
def vehicle_clearance(scene, x, y, yaw):
    """Distance [m] of a vehicle at a pose from the obstacles, margin taken off, at most a radius.

    Outside the buckets all obstacles are looked at. Negative where the margin is not free.
    """
    bucket, least = bucket_of(scene, x, y), scene.radius + scene.margin
    begin = scene.first[bucket] if bucket >= 0 else 0
    end = scene.first[bucket + 1] if bucket >= 0 else len(scene.capsules)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for k in range(begin, end):
        c = scene.capsules[scene.items[k] if bucket >= 0 else k]
        if _to_segment(x, y, c[0], c[1], c[2], c[3]) - c[4] - scene.radius >= least:
            continue
        p_x, p_y, q_x, q_y = c[0] - x, c[1] - y, c[2] - x, c[3] - y
        away = _box_to_segment(
            scene.box, cos * p_x + sin * p_y, cos * p_y - sin * p_x, cos * q_x + sin * q_y,
            cos * q_y - sin * q_x,
        )  # fmt: skip
        least = min(least, away - c[4])
    return least - scene.margin


@formula
def moved(x, y, yaw, way, turn):
    """The pose after a way [m] along an arc, negative in reverse, with a turn [rad]."""
    half = 0.5 * turn
    chord = way * (1.0 - half * half / 6.0) if abs(half) < 1e-4 else way * math.sin(half) / half
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + turn


@loop
def clearance_along(scene, x, y, yaw, way, turn):
    """Least clearance [m] at the poses looked at along an arc; -1 where it is not free."""
    total, at, least = abs(way) + scene.radius * abs(turn), 0.0, math.inf
    while True:
        share = at / total if total > 0.0 else 0.0
        to_x, to_y, to_yaw = moved(x, y, yaw, share * way, share * turn)
        clear = vehicle_clearance(scene, to_x, to_y, to_yaw)
        if clear <= scene.tolerance:
            return -1.0
        least = min(least, clear)
        if at >= total:
            return least
        at = min(total, at + clear)


FREE, UNCERTAIN, TOUCHING = 0, 1, 2


@loop
def _swept(scene, poses, spread):
    """FREE, TOUCHING at a pose, or UNCERTAIN between poses (M, 3); spread (M - 1,) of a point."""
    state = FREE
    for i in range(len(poses)):
        clear = vehicle_clearance(scene, poses[i, 0], poses[i, 1], poses[i, 2])
        if clear <= 0.0:
            return TOUCHING
        before = spread[i - 1] if i > 0 else 0.0
        after = spread[i] if i < len(spread) else 0.0
        if clear <= 0.5 * max(before, after):
            state = UNCERTAIN
    return state


def swept(scene: Scene, poses: Array, spread: Array) -> int:
    """Whether a motion through poses (M, 3) is FREE, UNCERTAIN or TOUCHING.

    spread (M - 1,): way [m] of any point of the vehicle from one pose to the next at most.
    """
    return int(_swept(scene, np.ascontiguousarray(poses, dtype=np.float64), spread))


def clearances(scene: Scene, poses: Array) -> Array:
    """Clearance [m] (M,) of a vehicle at poses (M, 3), margin taken off."""
    rows = np.atleast_2d(np.asarray(poses, dtype=np.float64))
    return np.array([vehicle_clearance(scene, *row) for row in rows])
