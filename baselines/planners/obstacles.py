"""Obstacles in the plane as a field of clearance: signed distance to the nearest [m].

Circles and polygons give their exact distance at the nodes of a grid, an occupancy grid the
distance between the middles of cells; between nodes it is bilinear. A signed distance changes by
at most the way moved, so the field is wrong by at most 0.71 spacings, which `Footprint` adds.

The vehicle is DISCS discs that cover its rectangle, contact length by gauge plus track width.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from baselines.planners.trajectory import PLACE
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

SPACING = 0.05  # [m] of the field
DISCS = 3
MOST_NODES = 4_000_000
_RADIUS = Range(1e-3, 1e5, "m", "Did you pass millimetres?")
_CELL = Range(1e-3, 10.0, "m", "It is the size of a cell of the grid.")


class Footprint(NamedTuple):
    """Discs that cover a vehicle, along its axis."""

    offset: Array  # [m] (DISCS,) of their middles, forwards
    radius: float  # [m] with half a cell's diagonal and a margin added

    @classmethod
    def of(cls, vehicle: PlantParameters, margin: float = 0.05) -> "Footprint":
        """Discs over contact length by gauge plus track width, and a margin [m] around."""
        half = 0.5 * vehicle.contact_length / DISCS
        across = 0.5 * (vehicle.track_gauge + vehicle.track_width)
        offset = np.array([(2.0 * disc + 1.0 - DISCS) * half for disc in range(DISCS)])
        return cls(offset, math.hypot(half, across) + margin + SPACING * math.sqrt(0.5))


class Clearance(NamedTuple):
    """Signed distance to the nearest obstacle on a grid of nodes; beyond it, none."""

    distance: Array  # [m] (NY, NX), negative inside an obstacle
    x: float  # [m] of the first column
    y: float  # [m] of the first row
    spacing: float  # [m]

    def at(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Clearance [m] at points, inf outside the grid."""
        xs, ys = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        out = np.empty(xs.size)
        _clearances(self, xs.ravel(), ys.ravel(), out)
        return out.reshape(xs.shape)


class Obstacles(NamedTuple):
    """What must not be touched. Make it with `Obstacles.of`."""

    circles: Array  # (C, 3) x, y, radius [m]
    polygons: tuple[Array, ...]  # each (K, 2) corners x, y [m] in order
    occupied: NDArray[np.bool_]  # (NY, NX) cells, row j at y
    cell: float  # [m] size of a cell
    origin: tuple[float, float]  # [m] middle of occupied[0, 0]

    @classmethod
    def of(
        cls, circles: ArrayLike = (), polygons: Sequence[ArrayLike] = (),
        occupied: ArrayLike | None = None, cell: float = 0.1, origin: Sequence[float] = (0.0, 0.0),
    ) -> "Obstacles":  # fmt: skip
        """Circles (C, 3) x, y, radius [m]; polygons (K, 2) each; occupied: a grid of cells, row j
        at y = origin[1] + j cell. Raises ValueError.
        """
        rings = np.asarray(circles, dtype=np.float64).reshape(-1, 3) if np.size(circles) else None
        made = np.zeros((0, 3)) if rings is None else rings
        for x, y, radius in made:
            checked_number("circle x", float(x), PLACE)
            checked_number("circle y", float(y), PLACE)
            checked_number("circle radius", float(radius), _RADIUS)
        corners = tuple(np.asarray(polygon, dtype=np.float64) for polygon in polygons)
        for polygon in corners:
            if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
                raise ValueError(f"polygon of shape {polygon.shape}; must be (K, 2), K >= 3: x, y")
            if not np.isfinite(polygon).all():
                raise ValueError(f"polygon {polygon.tolist()}; all corners must be finite")
        cells = np.zeros((0, 0), dtype=bool) if occupied is None else np.asarray(occupied)
        if cells.ndim != 2 or cells.dtype != bool:
            raise ValueError(
                f"occupied has shape {cells.shape} of {cells.dtype}; must be (NY, NX) of bool. "
                "Did you pass probabilities? Compare them with a threshold."
            )
        size = checked_number("cell", cell, _CELL)
        return cls(made, corners, cells, size, (float(origin[0]), float(origin[1])))

    def clearance(self, low: ArrayLike, high: ArrayLike, spacing: float = SPACING) -> Clearance:
        """The field over a rectangle from `low` to `high`, (x, y) [m]. Raises ValueError."""
        (x, y), (x_end, y_end) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        nx, ny = (math.ceil((e - b) / spacing) + 1 for b, e in ((x, x_end), (y, y_end)))
        if nx * ny > MOST_NODES:
            raise ValueError(
                f"{nx} x {ny} nodes of {spacing} m; must be at most {MOST_NODES}. Is the goal far "
                "away? Plan in parts, or with a larger spacing."
            )
        xs, ys = x + spacing * np.arange(nx), y + spacing * np.arange(ny)
        field = np.full((ny, nx), np.inf)
        for ring_x, ring_y, radius in self.circles:
            away = np.hypot(xs - ring_x, (ys - ring_y)[:, None]) - radius
            np.minimum(field, away, out=field)
        for polygon in self.polygons:
            away = np.empty_like(field)
            _polygon_distance(polygon, xs, ys, away)
            np.minimum(field, away, out=field)
        if self.occupied.size:
            np.minimum(field, self._of_cells(xs, ys), out=field)
        return Clearance(np.minimum(field, 1e6), float(x), float(y), spacing)

    def _of_cells(self, xs: Array, ys: Array) -> Array:
        """Distance to the edge of the nearest occupied cell, inf outside the grid of cells."""
        outside = distance_transform_edt(~self.occupied) * self.cell - 0.5 * self.cell
        inside = distance_transform_edt(self.occupied) * self.cell - 0.5 * self.cell
        known = np.where(self.occupied, -inside, outside)
        if not self.occupied.any():
            known = np.full(self.occupied.shape, 1e6)
        columns, rows = (xs - self.origin[0]) / self.cell, (ys - self.origin[1]) / self.cell
        ny, nx = self.occupied.shape
        # Beyond the grid a lower bound: nothing is occupied there.
        inner = np.meshgrid(np.clip(rows, 0, ny - 1), np.clip(columns, 0, nx - 1), indexing="ij")
        near = map_coordinates(known, inner, order=1)
        beyond = np.hypot(rows[:, None] - inner[0], columns - inner[1]) * self.cell
        return np.where(beyond > 0.0, np.maximum(beyond, near - beyond), near)


@formula
def clearance_at(field, x, y):
    """Clearance [m] at (x, y) [m], bilinear; inf outside the grid."""
    rows, columns = field.distance.shape
    u, v = (x - field.x) / field.spacing, (y - field.y) / field.spacing
    if not (0.0 <= u <= columns - 1 and 0.0 <= v <= rows - 1):
        return math.inf
    i, j = min(int(u), columns - 2), min(int(v), rows - 2)
    u, v = u - i, v - j
    below = field.distance[j, i] * (1.0 - u) + field.distance[j, i + 1] * u
    above = field.distance[j + 1, i] * (1.0 - u) + field.distance[j + 1, i + 1] * u
    return below * (1.0 - v) + above * v


@formula
def vehicle_clearance(field, footprint, x, y, yaw):
    """Least distance [m] between the discs of a vehicle at a pose and the obstacles."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    least = math.inf
    for disc in range(DISCS):
        ahead = footprint.offset[disc]
        least = min(least, clearance_at(field, x + ahead * cos, y + ahead * sin))
    return least - footprint.radius


@loop
def _clearances(field, xs, ys, out):
    """Clearance at points (M,)."""
    for i in range(len(xs)):
        out[i] = clearance_at(field, xs[i], ys[i])


@loop
def _vehicle_clearances(field, footprint, poses, out):
    """Clearance of a vehicle at poses (M, 3)."""
    for i in range(len(poses)):
        out[i] = vehicle_clearance(field, footprint, poses[i, 0], poses[i, 1], poses[i, 2])


def clearances(field: Clearance, footprint: Footprint, poses: ArrayLike) -> Array:
    """Distance [m] (M,) between a vehicle at poses (M, 3) and the obstacles, margin taken off."""
    given = np.ascontiguousarray(np.atleast_2d(np.asarray(poses, dtype=np.float64)))
    out = np.empty(len(given))
    _vehicle_clearances(field, footprint, given, out)
    return out


@loop
def _polygon_distance(polygon, xs, ys, out):
    """Signed distance [m] of grid points from a polygon, negative inside."""
    count = len(polygon)
    for j in range(len(ys)):
        for i in range(len(xs)):
            nearest, inside = math.inf, False
            for k in range(count):
                ax, ay = polygon[k, 0], polygon[k, 1]
                bx, by = polygon[(k + 1) % count, 0], polygon[(k + 1) % count, 1]
                ex, ey, px, py = bx - ax, by - ay, xs[i] - ax, ys[j] - ay
                square = ex * ex + ey * ey
                part = min(max((px * ex + py * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
                nearest = min(nearest, math.hypot(px - part * ex, py - part * ey))
                if (ay > ys[j]) != (by > ys[j]) and px < ex * py / ey:
                    inside = not inside
            out[j, i] = -nearest if inside else nearest
