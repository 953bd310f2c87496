"""The ground from above: one soil parameter as the plant sees it, relief and contour lines.

The value at a place is that of the episode's start, changed by each event in turn with the
kernel of the plant (`ground.parameter_at`). It is drawn in square tiles, which are kept: a tile
is computed again only when a ramp in time moves its parameter. On a terrain the colours are shaded:
    n = (-h_x, -h_y, 1) / sqrt(1 + h_x^2 + h_y^2)                normal of the ground
    brightness = B (a + (1 - a) max(n . s, 0) / s_z)             s: unit vector to the light
Level ground has brightness B. The light comes from the north-west as in maps [1], 30 degrees high:
that shows soft hills.
A pixel is on a contour line when its height differs from a level by less than half the line's
width times the change of height over one pixel, so that lines have the same width on any slope.

References: [1] Imhof, "Cartographic Relief Presentation" (1982).
"""

import math

import numpy as np
from pygame import Surface

from tracked_env import events as parameter_events
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.rendering.canvas import (
    LABELS,
    SOIL_SCALE,
    Bytes,
    Colour,
    Floats,
    grid_of,
    paint,
    surface,
)
from tracked_env.rendering.snapshot import Snapshot, TerrainSource
from tracked_env.terrain import ground

LIGHT = (-math.sqrt(0.375), math.sqrt(0.375), 0.5)  # s, unit vector to the light: x, y, z
AMBIENT = 0.35  # [-] a, share of the light that has no direction
LEVEL = 0.9  # [-] B, brightness of level ground; slopes to the light are brighter
BRIGHTEST = 1.2  # [-] beyond it colours lose their hue
LINE: Colour = (122, 92, 58)  # contour lines, brown as in maps
LEVELS = 12  # [-] contour lines at most between the lowest and the highest place
STRONG = 5  # [-] one in so many lines is strong
THIN, BROAD = 0.45, 0.9  # [px] half width of a line, and of a strong one
FAINT = 0.55  # [-] opacity of thin lines over that of strong ones
FLATTEST = 2e-4  # [lines per pixel] on flatter ground there are none
CROWDED = 0.25  # [lines per pixel] nor on steeper
AROUND, COARSE = 4.0, 96  # [contact lengths] around the path, and [-] heights on each side, that
#                           choose the interval of the contour lines

CELL_PIXELS = 2  # [px] side of a cell with one colour
REFRESH = 0.2  # [s] a running ramp shows in steps of this length
_TILES = 64  # [-] tiles kept
_THIN, _THICK = 0.955, 0.86  # [-] the grid lines darken the soil by these factors


@formula
def brightness(slope_x, slope_y, light):
    """Brightness of ground with these slopes [-]; light (3,): unit vector to it."""
    cosine = light[2] - slope_x * light[0] - slope_y * light[1]
    cosine = max(cosine, 0.0) / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return min(LEVEL * (AMBIENT + (1.0 - AMBIENT) * cosine / light[2]), BRIGHTEST)


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
            out[row, column] = brightness(slope_x, slope_y, light)


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
            bright = brightness(slope_x, slope_y, light)
            change = cell * math.sqrt(slope_x * slope_x + slope_y * slope_y)
            ink = contour(heights[row + 1, column + 1], 1.0 / interval, change)
            for c in range(3):
                shade = min(bright * pixels[row, column, c], 255.0)
                pixels[row, column, c] = int(shade + ink * (LINE[c] - shade) + 0.5)


def interval_around(terrain: TerrainSource, path: Floats, length: float) -> float:
    """Interval [m] of the contour lines for the ground around a path (P, 2) [m].

    1, 2 or 5 times a power of ten, for at most LEVELS lines; 1 on level ground.
    """
    low, high = path.min(axis=0) - AROUND * length, path.max(axis=0) + AROUND * length
    xs, ys = (np.linspace(low[k], high[k], COARSE) for k in (0, 1))
    heights = terrain.checked_heights(*np.meshgrid(xs, ys))
    least = float(heights.max() - heights.min()) / LEVELS
    if least < 1e-6:
        return 1.0
    decade = 10.0 ** math.floor(math.log10(least))
    return next(decade * step for step in (1.0, 2.0, 5.0, 10.0) if decade * step >= least)


@loop
def values_on_grid(start, events, count, parameter, time, xs, ys, out):
    """Write the value of a parameter at `time` [s] over xs (W,), ys (H,) [m] into out (H, W).

    start: its value at the start of the episode; events (1, E, 8), of which the first `count`
    act; parameter: its row in PARAMETER_NAMES.
    """
    for row in range(ys.size):
        for column in range(xs.size):
            out[row, column] = ground.parameter_at(
                start, parameter, events, 0, count, time, xs[column], ys[row]
            )


def value_at(shot: Snapshot, count: int, name: str, time: float, x: float, y: float) -> float:
    """Value of a parameter at one place, after the first `count` events."""
    out, start = np.empty((1, 1)), getattr(shot.parameters_at_start, name)
    place = np.array([x]), np.array([y])
    values_on_grid(start, shot.events, count, PARAMETER_INDEX[name], time, *place, out)
    return float(out[0, 0])


def map_time(events: Floats, time: float) -> float:
    """The instant [s] whose map is shown at `time`: exact at steps, every REFRESH in ramps."""
    instant = 0.0
    for start, duration in events[events[:, 0] == parameter_events.RAMP, 3:5]:
        if time >= start:
            elapsed = min(time - start, duration)
            instant = max(instant, start + REFRESH * math.floor(elapsed / REFRESH + 1e-9))
            if elapsed == duration:
                instant = max(instant, start + duration)
    return float(instant)


class SoilMap:
    """The map of one episode."""

    def __init__(
        self,
        shot: Snapshot,
        pixels_per_metre: int,
        parameter: str | None = None,
        terrain: TerrainSource | None = None,
        interval: float = 1.0,
    ) -> None:
        """parameter: a name of SoilParameters; None takes the first that varies in the plane.

        terrain: whose relief is shown; None: none; interval [m] between its contour lines.
        """
        self._terrain, self.interval = terrain, interval
        events = shot.events[0]
        spatial = {int(row[1]) for row in events if row[0] != parameter_events.RAMP}
        preference = shot.plant.soil_map
        varying = [name for name in preference if PARAMETER_INDEX[name] in spatial]
        self.name = parameter or (varying or preference)[0]
        self.label = LABELS[self.name]
        self.uniform = self.name not in varying
        self._row = PARAMETER_INDEX[self.name]
        self._events = events[events[:, 1] == self._row]  # those of this parameter
        self._start = float(getattr(shot.parameters_at_start, self.name))
        self._grid = grid_of(pixels_per_metre)
        self._metre = pixels_per_metre
        self._pixels = self._grid.side * pixels_per_metre  # side of a tile
        self._tiles: dict[tuple[int, int], Surface] = {}
        self._time = -1.0

    def image(self, shot: Snapshot, xs: Floats, ys: Floats) -> Bytes:
        """Colours (H, W, 3) at the places xs (W,), ys (H,) [m]."""
        out, count = np.empty((ys.size, xs.size)), shot.events.shape[1]
        values_on_grid(self._start, shot.events, count, self._row, self._time, xs, ys, out)
        index = np.clip(256.0 * self.label.share(out), 0.0, 255.0)
        return SOIL_SCALE[index.astype(np.uint8)]

    def advance(self, shot: Snapshot) -> bool:
        """Move to the time of the snapshot; True when the map has changed since the last call."""
        time = map_time(self._events, shot.time)
        if time == self._time:
            return False
        self._time = time
        self._tiles.clear()
        return True

    def draw(self, target: Surface, shot: Snapshot, left: float, top: float) -> None:
        """Cover the target, whose upper left corner lies at world (left, top) [m]."""
        width, height = target.get_size()
        x0, y0 = round(left * self._metre), round(-top * self._metre)  # [px] of the corner, y down
        side = self._pixels
        for row in range(y0 // side, (y0 + height - 1) // side + 1):
            for column in range(x0 // side, (x0 + width - 1) // side + 1):
                tile = self._tile(shot, column, row)
                target.blit(tile, (column * side - x0, row * side - y0))

    def _tile(self, shot: Snapshot, column: int, row: int) -> Surface:
        """Tile whose upper left corner is at (column, -row) tiles."""
        key = (0, 0) if self.uniform and self._terrain is None else (column, row)
        if key not in self._tiles:
            if len(self._tiles) >= _TILES:
                del self._tiles[next(iter(self._tiles))]
            self._tiles[key] = self._new_tile(shot, *key)
        return self._tiles[key]

    def _new_tile(self, shot: Snapshot, column: int, row: int) -> Surface:
        side, (metres, parts) = self._pixels, self._grid
        cells = -(-side // CELL_PIXELS)
        middles = metres * (np.arange(cells) + 0.5) * CELL_PIXELS / side
        coarse = self.image(shot, metres * column + middles, -(metres * row + middles))
        plain = coarse.repeat(CELL_PIXELS, 0).repeat(CELL_PIXELS, 1)[:side, :side]
        with_lines = plain.copy()
        for part in range(parts - 1, -1, -1):
            line, factor = part * side // parts, _THIN if part else _THICK
            with_lines[line] = factor * plain[line]
            with_lines[:, line] = factor * plain[:, line]
        tile = surface(side, side)
        paint(tile, self.with_relief(with_lines, metres * column, -metres * row, metres / side))
        return tile

    def with_relief(self, pixels: Bytes, left: float, top: float, cell: float) -> Bytes:
        """An image (H, W, 3) shaded by the terrain; (left, top) [m]: corner, cell [m]: a pixel."""
        if self._terrain is None:
            return pixels
        height, width = pixels.shape[:2]
        xs = left + cell * (np.arange(-1, width + 1) + 0.5)
        ys = top - cell * (np.arange(-1, height + 1) + 0.5)
        out, heights = pixels.copy(), self._terrain.checked_heights(*np.meshgrid(xs, ys))
        draw_relief(out, heights, cell, self.interval, LIGHT)
        return out
