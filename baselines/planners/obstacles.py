"""Obstacles in the plane, and the distance between them and the rectangle of a vehicle.

Circles, polygons and the occupied cells of a map all become capsules: what is within `radius` of a
segment. A circle has no length; edges of polygons, and of areas of occupied cells, have no radius.
A vehicle that touches no edge and does not begin inside stays outside.

Clearance. The capsules near a place are listed in square buckets. Two convex shapes that do not
meet are nearest at a corner of one, so the distance of a rectangle from a segment is that of its
ends from the rectangle or of a corner from the segment. A motion is free where no point of the
vehicle can have moved farther, since the last pose that was looked at, than the clearance there: a
point of the body moves at most |way| + radius |turn|. So nothing is between poses, however thin.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.speed_along_path import moved
from baselines.planners.trajectory import PLACE, checked_table
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number, checked_whole

Array = NDArray[np.float64]

MARGIN = 0.05  # [m] by default
TOLERANCE = 0.004  # [-] of the vehicle's radius: clearance that a free motion has at least
MOST_BUCKETS = 1_000_000
_CELLS = Range(0, 100_000_000, "-", "Cut the map to the area of the plan.")  # 100 MB as bool
_EDGES = Range(0, 2_000_000, "-", "Is the map noise? Filter it.")  # some 200 MB
FLAT = 1e-12  # [-] area over the square of the extent below which a polygon has none
OPEN, UNCERTAIN, TOUCHING = 0, 1, 2  # what a swept motion is
_CIRCLE = {"x": PLACE, "y": PLACE, "radius": Range(1e-3, 1e5, "m", "Did you pass millimetres?")}
_CELL = Range(1e-3, 10.0, "m", "It is the size of a cell of the grid.")


class Obstacles(NamedTuple):
    """What must not be touched. Make it with `Obstacles.of`."""

    circles: Array  # (C, 3) x, y, radius [m]
    polygons: tuple[Array, ...]  # each (K, 2) corners x, y [m] in order
    occupied: NDArray[np.bool_]  # (NY, NX) cells, row j along y of the map
    cell: float  # [m] size of a cell
    origin: tuple[float, ...]  # x, y [m] of the middle of occupied[0, 0], yaw [rad]

    @classmethod
    def of(
        cls,
        circles: Sequence[ArrayLike] | Array = (),
        polygons: Sequence[ArrayLike] = (),
        occupied: ArrayLike | None = None,
        cell: float = 0.1,
        origin: Sequence[float] = (0.0, 0.0),
    ) -> "Obstacles":
        """Circles (C, 3) x, y, radius [m]; polygons (K, 2) each; a map of occupied cells (NY, NX).

        Row j, column i of the map is centred at origin[:2] + (i cell, j cell), turned by
        origin[2] [rad] about the origin if it is there. Beyond the map nothing is occupied: close
        it with occupied cells where the vehicle must stay on it. Raises ValueError.
        """
        cells = np.zeros((0, 0), dtype=bool) if occupied is None else np.asarray(occupied)
        if cells.ndim != 2 or cells.dtype != bool:
            raise ValueError(
                f"occupied has shape {cells.shape} of {cells.dtype}; must be (NY, NX) of bool. "
                "Did you pass probabilities? Compare them with a threshold."
            )
        checked_whole("cells of the map", cells.size, _CELLS)
        size = checked_number("cell", cell, _CELL)
        if np.shape(origin) == (2,):
            origin = (*origin, 0.0)
        (middle,) = checked_table("origin", origin).tolist()
        rings = checked_table("circle", circles, _CIRCLE) if len(circles) else np.zeros((0, 3))
        return cls(rings, tuple(_checked_polygon(p) for p in polygons), cells, size, tuple(middle))

    def capsules(self) -> Array:
        """All obstacles as (S, 5) x, y of both ends and radius [m]. Raises ValueError."""
        rings = self.circles[:, [0, 1, 0, 1, 2]]
        edges = [np.hstack([p, np.roll(p, -1, axis=0)]) for p in self.polygons]
        edges.append(self._edges_of_cells(len(rings) + sum(map(len, self.polygons))))
        lines = np.vstack(edges)
        return np.vstack([rings, np.hstack([lines, np.zeros((len(lines), 1))])])

    def contain(self, x: float, y: float) -> bool:
        """Whether a point [m] is inside an obstacle."""
        away = np.hypot(self.circles[:, 0] - x, self.circles[:, 1] - y)
        if np.any(away <= self.circles[:, 2]) or any(_inside(p, x, y) for p in self.polygons):
            return True
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        x, y = x - self.origin[0], y - self.origin[1]
        column = math.floor((cos * x + sin * y) / self.cell + 0.5)
        row = math.floor((cos * y - sin * x) / self.cell + 0.5)
        inside = 0 <= row < self.occupied.shape[0] and 0 <= column < self.occupied.shape[1]
        return inside and bool(self.occupied[row, column])

    def _edges_of_cells(self, others: int) -> Array:
        """Outlines of the occupied areas (S, 4), runs of edges as one, in the world.

        others: edges of other obstacles. Raises ValueError for more edges than are handled.
        """
        edges = _steps(self.occupied), _steps(self.occupied.T)
        count = others + sum(np.count_nonzero(each > 0) for each in edges)
        checked_whole("edges of the obstacles", count, _EDGES)
        across, upwards = (_runs(each) for each in edges)
        x, y = (np.vstack([across, upwards[:, [1, 0, 3, 2]]]) - 0.5).reshape(-1, 2).T * self.cell
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        world = self.origin[0] + cos * x - sin * y, self.origin[1] + sin * x + cos * y
        return np.stack(world, axis=1).reshape(-1, 4)


def _checked_polygon(corners: ArrayLike) -> Array:
    """Corners (K, 2) without those that repeat the one before. Raises ValueError."""
    polygon = checked_table("polygon", corners, {"x": PLACE, "y": PLACE})
    ring = np.ascontiguousarray(polygon[np.any(polygon != np.roll(polygon, 1, axis=0), axis=1)])
    x, y = (ring - ring[:1]).T
    area = 0.5 * np.abs(x[:-1] * y[1:] - x[1:] * y[:-1]).sum()  # of triangles, unsigned
    if len(ring) < 3 or area <= FLAT * float(np.ptp(ring, axis=0).max()) ** 2:
        raise ValueError(
            f"polygon {polygon.tolist()[:4]} has no area; its corners must not be on one line. Is "
            "it a thin wall? Give it a thickness."
        )
    first, second = _crossing(ring)
    if first >= 0:
        raise ValueError(
            f"polygon crosses itself: the edges from corner {first} {ring[first].tolist()} and "
            f"from corner {second} {ring[second].tolist()}; must not. Are its corners in order?"
        )
    return ring


@loop
def _side(a, b, c):
    """Twice the signed area of a, b, c (2,): above 0 where they turn left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@loop
def _crossing(ring):
    """Two edges of a ring (K, 2) that cross, by their first corners; (-1, -1): none."""
    count = len(ring)
    for i in range(count):
        a, b = ring[i], ring[(i + 1) % count]
        for j in range(i + 2, count):
            c, d = ring[j], ring[(j + 1) % count]
            if _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0:
                return i, j
    return -1, -1


def _inside(polygon: Array, x: float, y: float) -> bool:
    """Whether a point is inside a polygon (K, 2): edges that a ray to the right crosses."""
    (a_x, a_y), (b_x, b_y) = polygon.T, np.roll(polygon, -1, axis=0).T
    cut = (a_y > y) != (b_y > y)
    at = a_x[cut] + (y - a_y[cut]) / (b_y[cut] - a_y[cut]) * (b_x[cut] - a_x[cut])
    return bool(np.count_nonzero(at > x) % 2)


def _steps(occupied: NDArray[np.bool_]) -> NDArray[np.int8]:
    """Edges along rows, between cells of which one is occupied: 1 where a run begins, -1 behind."""
    rows = np.pad(occupied, ((1, 1), (0, 0)))
    edge = np.pad(rows[1:] != rows[:-1], ((0, 0), (1, 1))).astype(np.int8)
    return edge[:, 1:] - edge[:, :-1]


def _runs(steps: NDArray[np.int8]) -> Array:
    """Runs of edges as (S, 4) in cells, from corners."""
    (row, first), (_, last) = np.nonzero(steps > 0), np.nonzero(steps < 0)
    return np.stack([first, row, last, row], axis=1).astype(np.float64)


class Footprint(NamedTuple):
    """The rectangle that a vehicle covers, seen from its centre, without margin."""

    front: float  # [m]
    back: float  # [m]
    left: float  # [m]
    right: float  # [m]

    @classmethod
    def of(cls, vehicle: PlantParameters, sides: Sequence[float] | None = None) -> "Footprint":
        """From front, back, left, right [m]; None: contact length by gauge plus track width.

        Raises ValueError.
        """
        if sides is None:
            along, across = vehicle.contact_length, vehicle.track_gauge + vehicle.track_width
            return cls(0.5 * along, 0.5 * along, 0.5 * across, 0.5 * across)
        ranges = dict.fromkeys(cls._fields, Range(0.0, 100.0, "m", "Did you pass millimetres?"))
        (row,) = checked_table("footprint", sides, ranges).tolist()
        body = cls(*row)
        if min(body.front + body.back, body.left + body.right) <= 0.0:
            raise ValueError(f"footprint = {tuple(body)}; must have a length and a width above 0 m")
        return body

    @property
    def radius(self) -> float:
        """Of the farthest corner [m]."""
        return math.hypot(max(self.front, self.back), max(self.left, self.right))

    @property
    def turned(self) -> "Footprint":
        """The same seen by a vehicle whose front is the back of this one."""
        return Footprint(self.back, self.front, self.right, self.left)


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
        grid = float(middle[0]), float(middle[1]), float(size), columns, rows
        first = np.zeros(columns * rows + 1, dtype=np.int64)
        _list(capsules, grid, reach, first, np.empty(0, dtype=np.int32))
        np.cumsum(first, out=first)
        items = np.empty(int(first[-1]), dtype=np.int32)
        _list(capsules, grid, reach, first.copy(), items)
        vehicle = np.array(footprint), float(margin), radius, TOLERANCE * radius
        return cls(capsules, first, items, *grid, *vehicle)

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
    for x in (box[0], -box[1]):
        for y in (box[2], -box[3]):
            least = min(least, _to_segment(x, y, a_x, a_y, b_x, b_y))
    return least


@loop
def _list(capsules, grid, reach, first, items):
    """Count the capsules within `reach` of every bucket into first[1:], or list them in items.

    To list, first is the beginning of every bucket's items, and becomes their end.
    """
    x, y, size, columns, rows = grid
    far = reach + 0.5 * math.sqrt(2.0) * size
    for number in range(len(capsules)):
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
def _near(scene, x, y):
    """(first, last, listed): items of the bucket of a place, or all capsules outside of buckets."""
    u, v = (x - scene.x) / scene.size, (y - scene.y) / scene.size
    if not (0.0 <= u < scene.columns and 0.0 <= v < scene.rows):
        return 0, len(scene.capsules), False
    bucket = int(v) * scene.columns + int(u)
    return scene.first[bucket], scene.first[bucket + 1], True


@loop
def place_clearance(scene, x, y):
    """Distance [m] of a place from the obstacles, at most 2 radii and the margin."""
    (begin, end, listed), least = _near(scene, x, y), 2.0 * scene.radius + scene.margin
    for k in range(begin, end):
        c = scene.capsules[scene.items[k] if listed else k]
        least = min(least, _to_segment(x, y, c[0], c[1], c[2], c[3]) - c[4])
    return least


@loop
def vehicle_clearance(scene, x, y, yaw):
    """Distance [m] of a vehicle at a pose from the obstacles, margin taken off, at most a radius.

    Negative where the margin is not free.
    """
    (begin, end, listed), least = _near(scene, x, y), scene.radius + scene.margin
    cos, sin = math.cos(yaw), math.sin(yaw)
    for k in range(begin, end):
        c = scene.capsules[scene.items[k] if listed else k]
        if _to_segment(x, y, c[0], c[1], c[2], c[3]) - c[4] - scene.radius >= least:
            continue
        p_x, p_y, q_x, q_y = c[0] - x, c[1] - y, c[2] - x, c[3] - y
        a_x, a_y = cos * p_x + sin * p_y, cos * p_y - sin * p_x
        b_x, b_y = cos * q_x + sin * q_y, cos * q_y - sin * q_x
        least = min(least, _box_to_segment(scene.box, a_x, a_y, b_x, b_y) - c[4])
    return least - scene.margin


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


@loop
def swept(scene, poses, spread):
    """Whether a motion through poses (M, 3) is OPEN, UNCERTAIN or TOUCHING.

    spread (M - 1,): way [m] of any point of the vehicle from one pose to the next at most.
    """
    state = OPEN
    for i in range(len(poses)):
        clear = vehicle_clearance(scene, poses[i, 0], poses[i, 1], poses[i, 2])
        if clear <= 0.0:
            return TOUCHING
        before = spread[i - 1] if i > 0 else 0.0
        after = spread[i] if i < len(spread) else 0.0
        if clear <= 0.5 * max(before, after):
            state = UNCERTAIN
    return state


def clearances(scene: Scene, poses: Array) -> Array:
    """Clearance [m] (M,) of a vehicle at poses (M, 3), margin taken off."""
    rows = np.atleast_2d(np.asarray(poses, dtype=np.float64))
    return np.array([vehicle_clearance(scene, *row) for row in rows])
