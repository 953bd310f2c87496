"""Obstacles in the plane: circles, polygons and the occupied cells of a map, checked.

All become one shape, the capsule: what is within `radius` of a segment. A circle is a capsule
without length; edges of polygons, and of areas of occupied cells, are capsules without radius.
Who touches no edge and does not begin inside stays outside, so that edges are enough for a motion
that begins in the open. They are exact, whatever is thin, and whatever the cells measure.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import ANGLE, PLACE
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

MOST_CELLS = 100_000_000  # of a map: 100 MB as bool
MOST_EDGES = 2_000_000  # of all obstacles together: some 200 MB
_RADIUS = Range(1e-3, 1e5, "m", "Did you pass millimetres?")
_CELL = Range(1e-3, 10.0, "m", "It is the size of a cell of the grid.")
FLAT = 1e-12  # [-] area over the square of the extent below which a polygon has none


class Obstacles(NamedTuple):
    """What must not be touched. Make it with `Obstacles.of`."""

    circles: Array  # (C, 3) x, y, radius [m]
    polygons: tuple[Array, ...]  # each (K, 2) corners x, y [m] in order
    occupied: NDArray[np.bool_]  # (NY, NX) cells, row j along y of the map
    cell: float  # [m] size of a cell
    origin: tuple[float, float, float]  # x, y [m] of the middle of occupied[0, 0], yaw [rad]

    @classmethod
    def of(
        cls, circles: ArrayLike = (), polygons: Sequence[ArrayLike] = (),
        occupied: ArrayLike | None = None, cell: float = 0.1,
        origin: Sequence[float] = (0.0, 0.0),
    ) -> "Obstacles":  # fmt: skip
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
        if cells.size > MOST_CELLS:
            raise ValueError(
                f"occupied has {cells.size} cells; must be at most {MOST_CELLS}. Cut the map to "
                "the area of the plan, or make its cells larger."
            )
        size = checked_number("cell", cell, _CELL)
        return cls(
            _checked_circles(circles), tuple(_checked_polygon(p) for p in polygons), cells, size,
            _checked_origin(origin),
        )  # fmt: skip

    def capsules(self) -> Array:
        """All obstacles as (S, 5) x, y of both ends and radius [m]. Raises ValueError."""
        rings = self.circles[:, [0, 1, 0, 1, 2]]
        edges = [np.hstack([p, np.roll(p, -1, axis=0)]) for p in self.polygons]
        edges.append(self._edges_of_cells())
        lines = np.vstack(edges)
        _check_edges(len(lines) + len(rings))
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
        ny, nx = self.occupied.shape
        return 0 <= row < ny and 0 <= column < nx and bool(self.occupied[row, column])

    def _edges_of_cells(self) -> Array:
        """Outlines of the occupied areas (S, 4), runs of edges as one, in the world."""
        if not self.occupied.any():
            return np.zeros((0, 4))
        columns = np.ascontiguousarray(self.occupied.T)
        across, upwards = _runs(self.occupied), _runs(columns)[:, [1, 0, 3, 2]]
        x, y = (np.vstack([across, upwards]) - 0.5).reshape(-1, 2).T * self.cell
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        world = self.origin[0] + cos * x - sin * y, self.origin[1] + sin * x + cos * y
        return np.stack(world, axis=1).reshape(-1, 4)


def _check_edges(count: int) -> None:
    if count > MOST_EDGES:
        raise ValueError(
            f"the obstacles have {count} edges; must be at most {MOST_EDGES}. Is the map noise? "
            "Filter it, or make its cells larger."
        )


def checked_obstacles(value: Any) -> Obstacles | None:
    """`value` if it is None or Obstacles. Raises ValueError."""
    if value is None or isinstance(value, Obstacles):
        return value
    raise ValueError(
        f"obstacles = a {type(value).__name__}; must be Obstacles. Did you mean "
        "Obstacles.of(circles=..., polygons=...)?"
    )


def _checked_circles(circles: ArrayLike) -> Array:
    try:
        rings = np.asarray(circles, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"circles = {circles!r}; must be numbers x, y, radius [m]") from error
    rings = rings.reshape(1, 3) if rings.shape == (3,) else rings
    if rings.size == 0:
        return np.zeros((0, 3))
    if rings.ndim != 2 or rings.shape[1] != 3:
        raise ValueError(f"circles have shape {rings.shape}; must be (C, 3): x, y, radius [m]")
    for x, y, radius in rings:
        checked_number("circle x", float(x), PLACE)
        checked_number("circle y", float(y), PLACE)
        checked_number("circle radius", float(radius), _RADIUS)
    return rings


def _checked_polygon(corners: ArrayLike) -> Array:
    """Corners (K, 2) without those that repeat the one before. Raises ValueError."""
    try:
        polygon = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"polygon {corners!r}; must be corners x, y [m] (K, 2)") from error
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise ValueError(f"polygon of shape {polygon.shape}; must be (K, 2), K >= 3: x, y")
    if not np.isfinite(polygon).all():
        raise ValueError(f"polygon {polygon.tolist()}; all corners must be finite")
    checked_number("polygon corner", float(polygon.flat[np.abs(polygon).argmax()]), PLACE)
    ring = np.ascontiguousarray(polygon[np.any(polygon != np.roll(polygon, 1, axis=0), axis=1)])
    if len(ring) < 3 or _area(ring) <= FLAT * float(np.ptp(ring, axis=0).max()) ** 2:
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


def _checked_origin(origin: Sequence[float]) -> tuple[float, float, float]:
    if np.ndim(origin) != 1 or len(origin) not in (2, 3):
        raise ValueError(f"origin = {origin!r}; must be x, y [m], or x, y, yaw [rad]")
    x, y, yaw = (*origin, 0.0)[:3]
    return (
        checked_number("origin x", x, PLACE), checked_number("origin y", y, PLACE),
        checked_number("origin yaw", yaw, ANGLE),
    )  # fmt: skip


def _area(ring: Array) -> float:
    """Sum of the areas [m^2] that successive triangles around the first corner sweep, unsigned."""
    x, y = (ring - ring[0]).T
    return float(0.5 * np.abs(x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


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


def _runs(occupied: NDArray[np.bool_]) -> Array:
    """Edges along rows, between cells of which one is occupied: (S, 4) in cells, from corners."""
    edge = np.zeros((len(occupied) + 1, occupied.shape[1]), dtype=bool)
    edge[0], edge[-1] = occupied[0], occupied[-1]
    np.not_equal(occupied[1:], occupied[:-1], out=edge[1:-1])
    begins = np.count_nonzero(edge[:, 1:] > edge[:, :-1])
    _check_edges(int(np.count_nonzero(edge[:, 0]) + begins))
    row, column = np.nonzero(edge)
    breaks = np.flatnonzero((np.diff(row) != 0) | (np.diff(column) != 1))
    first, last = np.append(0, breaks + 1), np.append(breaks, len(row) - 1)
    ends = [column[first], row[first], column[last] + 1, row[last]]
    return np.stack(ends, axis=1).astype(np.float64)
