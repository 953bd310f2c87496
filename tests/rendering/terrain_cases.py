"""What the tests of pictures on terrain share: analytic terrains, eyes, and height grids."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.rendering.perspective import Picture
from tracked_env.rendering.raster import Eye, GroundGrid
from tracked_env.rendering.soil_map import LIGHT, brightness_on_grid

Points = NDArray[np.float64]
WIDTH, HEIGHT = 320, 240  # [px]
SOIL = (200, 170, 130)


def bump(x0: float, y0: float, height: float = 2.0, width: float = 1.5) -> Callable[..., Any]:
    """A round hill."""
    return lambda x, y: height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2.0 * width**2))


def eye(z: float = 2.0, y: float = 0.0) -> Eye:
    """At x = 0, looking east, with the horizon in the upper third."""
    return Eye(0.0, y, z, 1.0, 0.0, 200.0, 0.5 * WIDTH, 80.0, 0.5, 50.0)


def grid(
    heights: Callable[..., Any], light: tuple[float, float, float] = LIGHT, cell: float = 0.125
) -> GroundGrid:
    """The ground 64 m ahead of x = -4 m and 24 m to both sides."""
    x, y = np.meshgrid(np.arange(-4.0, 60.0, cell), np.arange(-24.0, 24.0 + cell, cell))
    values = np.asarray(heights(x, y), dtype=np.float32) + np.zeros(x.shape, dtype=np.float32)
    bright = np.empty_like(values)
    brightness_on_grid(values, cell, light, bright)
    soil = np.array(SOIL, dtype=np.uint8).reshape(1, 1, 3)
    return GroundGrid(values, bright, -4.0, -24.0, 1.0 / cell, soil, 1e6, 2.0, 1.0)


class Plain:
    """Stands for a landscape where only its grid is asked for."""

    def __init__(self, ground: GroundGrid) -> None:
        self.grid = ground


def seen(heights: Callable[..., Any], at: Eye | None = None, **options: Any) -> Picture:
    """A picture of that ground alone."""
    picture = Picture(WIDTH, HEIGHT)
    picture.ground(Plain(grid(heights, **options)), at or eye())  # type: ignore[arg-type]
    return picture


def board(x: float, y: float, z: float, side: float = 0.6) -> Points:
    """An upright square (1, 4, 3) [m] that faces west, with its middle there."""
    h = 0.5 * side
    return np.array([[(x, y - h, z - h), (x, y + h, z - h), (x, y + h, z + h), (x, y - h, z + h)]])
