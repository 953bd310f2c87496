"""The ground of one episode for pictures in perspective: height grid, soil colours, ribbons.

The grid covers the path and as far around it as a picture shows. A ribbon is a line drawn on the
ground: quads whose corners lie on the ground, so that it bends with it and hides behind hills.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tracked_env.rendering.hill_shading import LIGHT, brightness_on_grid, contour_interval
from tracked_env.rendering.raster import GroundGrid
from tracked_env.rendering.sizes import default_zoom, grid_of
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap
from tracked_env.rendering.terrain_source import TerrainSource

Points = NDArray[np.float64]

VIEW = 30.0  # [contact lengths] that are seen; around the path the grid reaches as far
AROUND, COARSE = 4.0, 96  # [contact lengths] around the path, and [-] heights on each side, that
#                           choose the interval of the contour lines
FINEST = 1.0 / 24.0  # [contact lengths] between heights
MOST_CELLS = 1.5e6  # [-] of a grid
SOIL_STEP = 4  # cells of the heights for one colour of the soil
LIFT = 0.01  # [contact lengths] of ribbons above the ground


def height_grid(
    terrain: TerrainSource, low: Points, high: Points, cell: float
) -> tuple[NDArray[np.float32], float, float]:
    """Heights [m] float32 (R, C), x and y [m] of the first, over low to high (2,) [m]."""
    columns, rows = (math.ceil((high[k] - low[k]) / cell) + 2 for k in (0, 1))
    xs = low[0] + cell * np.arange(columns)
    ys = low[1] + cell * np.arange(rows)
    heights = np.empty((rows, columns), dtype=np.float32)
    block = max(1, int(2e5) // columns)
    for first in range(0, rows, block):
        x, y = np.meshgrid(xs, ys[first : first + block])
        heights[first : first + block] = terrain.checked_heights(x, y)
    return heights, float(low[0]), float(low[1])


def interval_around(terrain: TerrainSource, path: Points, length: float) -> float:
    """Interval [m] of the contour lines for the ground around a path (P, 2) [m]."""
    low, high = path.min(axis=0) - AROUND * length, path.max(axis=0) + AROUND * length
    xs, ys = (np.linspace(low[k], high[k], COARSE) for k in (0, 1))
    x, y = np.meshgrid(xs, ys)
    return contour_interval(terrain.checked_heights(x, y))


class Landscape:
    """Ground of one episode."""

    def __init__(
        self,
        terrain: TerrainSource,
        path: Points,
        length: float,
        interval: float,
        light: tuple[float, float, float] = LIGHT,
    ) -> None:
        """path (P, 2) [m] of the reference; length: contact length [m]; interval [m] between
        contour lines; light: vector to it.
        """
        self.length, self.light = length, light
        low, high = path.min(axis=0) - VIEW * length, path.max(axis=0) + VIEW * length
        self.cell = max(FINEST * length, math.sqrt(float(np.prod(high - low)) / MOST_CELLS))
        heights, x, y = height_grid(terrain, low, high, self.cell)
        bright = np.empty_like(heights)
        brightness_on_grid(heights, self.cell, light, bright)
        mesh = grid_of(default_zoom(length))
        white = np.full((1, 1, 3), 255, dtype=np.uint8)
        self.grid = GroundGrid(
            heights, bright, x, y, 1.0 / self.cell, white, float(max(heights.shape)),
            1.0 / interval, mesh.parts / mesh.side,
        )  # fmt: skip

    def colour(self, soil: SoilMap, shot: Snapshot) -> None:
        """Take the soil's colours as they are now."""
        rows, columns = self.grid.heights.shape
        step = 1 if soil.uniform else SOIL_STEP
        count = (1, 1) if soil.uniform else (rows // step, columns // step)
        xs = self.grid.x + self.cell * step * (np.arange(count[1]) + 0.5)
        ys = self.grid.y + self.cell * step * (np.arange(count[0]) + 0.5)
        pixels = soil.image(shot, xs, ys)
        one = float(max(rows, columns)) if soil.uniform else float(step)
        self.grid = self.grid._replace(soil=pixels, soil_step=one)

    def heights(self, points: Points) -> Points:
        """Heights [m] (...,) of the drawn ground at places (..., 2) [m], bilinear."""
        grid = self.grid.heights
        at = (points - (self.grid.x, self.grid.y)) * self.grid.inverse_cell
        at = np.clip(at, 0.0, (grid.shape[1] - 1.001, grid.shape[0] - 1.001))
        j, i = np.moveaxis(at.astype(np.int64), -1, 0)
        u, v = np.moveaxis(at - at.astype(np.int64), -1, 0)
        low = grid[i, j] + u * (grid[i, j + 1] - grid[i, j])
        high = grid[i + 1, j] + u * (grid[i + 1, j + 1] - grid[i + 1, j])
        return low + v * (high - low)

    def on_ground(self, points: Points) -> Points:
        """Places (..., 2) [m] with their heights, just above the ground (..., 3)."""
        heights = self.heights(points) + LIFT * self.length
        return np.concatenate([points, heights[..., None]], axis=-1)

    def ribbon(self, line: Points, width: Points) -> Points:
        """Quads (P - 1, 4, 3) [m] of a line (P, 2) [m] on the ground, width (P,) [m].

        Points that repeat the one before them give quads without an area.
        """
        along = np.gradient(line, axis=0)
        size = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        aside = 0.5 * width[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=1) / size
        left, right = self.on_ground(line + aside), self.on_ground(line - aside)
        return np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)


def resampled(line: Points, step: float) -> Points:
    """A line (P, 2) [m] with points `step` [m] apart along it; at least its two ends."""
    size = np.linalg.norm(np.diff(line, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(size)])
    moved = np.concatenate([[True], size > 1e-9])
    count = max(math.ceil(at[-1] / step), 1) + 1
    wanted = np.linspace(0.0, at[-1], count)
    return np.stack([np.interp(wanted, at[moved], line[moved, k]) for k in (0, 1)], axis=1)
