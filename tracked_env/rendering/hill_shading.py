"""Relief in pictures: brightness by the slope of the ground, and contour lines.

    n = (-h_x, -h_y, 1) / sqrt(1 + h_x^2 + h_y^2)                normal of the ground
    brightness = B (a + (1 - a) max(n . s, 0) / s_z)             s: unit vector to the light
Level ground has brightness B. The light comes from the north-west, 45 degrees high, as in maps [1].
A pixel is on a contour line when its height differs from a level by less than half the line's
width times the change of height over one pixel, so that lines have the same width on any slope.

References: [1] Imhof, "Cartographic Relief Presentation" (1982).
"""

import math

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula, loop
from tracked_env.rendering.canvas import Bytes

FloatArray = NDArray[np.float64]

LIGHT = (-0.5, 0.5, math.sqrt(0.5))  # s, unit vector to the light: x, y, z
AMBIENT = 0.35  # [-] a, share of the light that has no direction
LEVEL = 0.9  # [-] B, brightness of level ground; slopes to the light are brighter
BRIGHTEST = 1.12  # [-] beyond it colours lose their hue
LINE: tuple[int, int, int] = (122, 92, 58)  # contour lines, brown as in maps
LEVELS = 12  # [-] contour lines at most between the lowest and the highest place
STRONG = 5  # [-] one in so many lines is strong
THIN, BROAD = 0.45, 0.9  # [px] half width of a line, and of a strong one
FAINT = 0.55  # [-] opacity of thin lines over that of strong ones
FLATTEST = 2e-4  # [lines per pixel] on flatter ground there are none
CROWDED = 0.25  # [lines per pixel] nor on steeper


@formula
def brightness(slope_x, slope_y, light_x, light_y, light_z):
    """Brightness of ground with these slopes [-]; light: unit vector to it."""
    cosine = light_z - slope_x * light_x - slope_y * light_y
    cosine = max(cosine, 0.0) / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return min(LEVEL * (AMBIENT + (1.0 - AMBIENT) * cosine / light_z), BRIGHTEST)


@formula
def coverage(value, per_unit, change, half_width):
    """Share of a pixel [0, 1] under the lines where value * per_unit is a whole number.

    change: of the value over one pixel, >= 0; half_width [px]. Lines closer than eight pixels
    fade, and those closer than four are gone.
    """
    share, rate = value * per_unit, change * per_unit  # [lines], [lines per pixel]
    away, reach = abs(share - math.floor(share + 0.5)), (half_width + 0.5) * rate
    if away >= reach or rate < FLATTEST or rate > CROWDED:
        return 0.0
    return min(1.0, (reach - away) / rate) * min(1.0, 2.0 - 2.0 * rate / CROWDED)


@formula
def contour(height, per_metre, change):
    """Opacity [0, 1] of contour lines at a pixel of that height [m]; per_metre: 1 / interval."""
    thin = FAINT * coverage(height, per_metre, change, THIN)
    return max(thin, coverage(height, per_metre / STRONG, change, BROAD))


@loop
def brightness_on_grid(heights, cell, light, out):
    """Brightness (H, W) of heights (H, W) [m]; rows along y, columns along x, `cell` [m] apart."""
    rows, columns = heights.shape
    for row in range(rows):
        low, high = max(row - 1, 0), min(row + 1, rows - 1)
        for column in range(columns):
            left, right = max(column - 1, 0), min(column + 1, columns - 1)
            slope_x = (heights[row, right] - heights[row, left]) / (cell * max(right - left, 1))
            slope_y = (heights[high, column] - heights[low, column]) / (cell * max(high - low, 1))
            out[row, column] = brightness(slope_x, slope_y, light[0], light[1], light[2])


@loop
def draw_relief(pixels, heights, cell, interval, light):
    """Shade an image (H, W, 3) seen from above and draw its contour lines.

    heights (H + 2, W + 2) [m]: of the middles of its pixels and of one more on each side, the
    first row in the north; cell [m]: side of a pixel; interval [m] between contour lines.
    """
    for row in range(pixels.shape[0]):
        for column in range(pixels.shape[1]):
            east, west = heights[row + 1, column + 2], heights[row + 1, column]
            north, south = heights[row, column + 1], heights[row + 2, column + 1]
            slope_x, slope_y = (east - west) / (2.0 * cell), (north - south) / (2.0 * cell)
            bright = brightness(slope_x, slope_y, light[0], light[1], light[2])
            change = cell * math.sqrt(slope_x * slope_x + slope_y * slope_y)
            ink = contour(heights[row + 1, column + 1], 1.0 / interval, change)
            for c in range(3):
                ground = min(bright * pixels[row, column, c], 255.0)
                pixels[row, column, c] = int(ground + ink * (LINE[c] - ground) + 0.5)


def contour_interval(heights: FloatArray) -> float:
    """Interval [m], 1, 2 or 5 times a power of ten, for at most LEVELS lines; 1 on level ground."""
    least = float(heights.max() - heights.min()) / LEVELS
    if least < 1e-6:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(least))
    return next(decade * step for step in (1.0, 2.0, 5.0, 10.0) if decade * step >= least)


def shaded_map(
    pixels: Bytes,
    heights: FloatArray,
    cell: float,
    interval: float,
    light: tuple[float, float, float] = LIGHT,
) -> Bytes:
    """A copy of an image (H, W, 3) with relief; arguments as `draw_relief` has them."""
    out = pixels.copy()
    draw_relief(out, heights, cell, interval, light)
    return out
