"""The ground, coloured by one soil parameter as the plant sees it.

The value at a place is that of the episode's start, changed by each event in turn with the
kernel of the plant (`terrain.ground.changed`). It is drawn in square tiles, which are
kept: a tile is computed again only when a ramp in time moves its parameter. On a terrain the
colours are shaded by its slope and contour lines are drawn.
"""

import math

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.physics import parameter_events
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.rendering.canvas import SOIL_SCALE, Bytes, paint, surface
from tracked_env.rendering.hill_shading import shaded_map
from tracked_env.rendering.quantities import QUANTITIES
from tracked_env.rendering.sizes import grid_of
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.terrain_source import TerrainSource
from tracked_env.terrain import ground

FloatArray = NDArray[np.float64]

CELL_PIXELS = 2  # [px] side of a cell with one colour
REFRESH = 0.2  # [s] a running ramp shows in steps of this length
_TILES = 64  # [-] tiles kept
_THIN, _THICK = 0.955, 0.86  # [-] the grid lines darken the soil by these factors


@loop
def values_on_grid(start, events, count, parameter, time, xs, ys, out):
    """Write the value of a parameter at `time` [s] over xs (W,), ys (H,) [m] into out (H, W).

    start: its value at the start of the episode; events (1, E, 8), of which the first `count`
    act; parameter: its row in PARAMETER_NAMES.
    """
    for row in range(ys.size):
        for column in range(xs.size):
            out[row, column] = ground.changed(
                start, parameter, events, 0, count, time, xs[column], ys[row]
            )


def value_at(shot: Snapshot, count: int, name: str, time: float, x: float, y: float) -> float:
    """Value of a parameter at one place, after the first `count` events."""
    out = np.empty((1, 1))
    start = getattr(shot.parameters_at_start, name)
    values_on_grid(
        start, shot.events, count, PARAMETER_INDEX[name], time, np.array([x]), np.array([y]), out
    )
    return float(out[0, 0])


def map_time(events: FloatArray, time: float) -> float:
    """The instant [s] whose map is shown at `time`: exact at steps, every REFRESH in ramps."""
    shown = 0.0
    for start, duration in events[events[:, 0] == parameter_events.RAMP, 3:5]:
        if time >= start:
            elapsed = min(time - start, duration)
            shown = max(shown, start + REFRESH * math.floor(elapsed / REFRESH + 1e-9))
            if elapsed == duration:
                shown = max(shown, start + duration)
    return float(shown)


class SoilMap:
    """The map of one episode."""

    def __init__(
        self,
        shot: Snapshot,
        pixels_per_metre: int,
        parameter: str | None,
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
        self.quantity = QUANTITIES[self.name]
        self.uniform = self.name not in varying
        self._row = PARAMETER_INDEX[self.name]
        self._own_events = events[events[:, 1] == self._row]
        self._start = float(getattr(shot.parameters_at_start, self.name))
        self._grid = grid_of(pixels_per_metre)
        self._metre = pixels_per_metre
        self._pixels = self._grid.side * pixels_per_metre  # side of a tile
        self._tiles: dict[tuple[int, int], pygame.Surface] = {}
        self._time = -1.0

    def image(self, shot: Snapshot, xs: FloatArray, ys: FloatArray) -> Bytes:
        """Colours (H, W, 3) at the places xs (W,), ys (H,) [m]."""
        out = np.empty((ys.size, xs.size))
        count = shot.events.shape[1]
        values_on_grid(self._start, shot.events, count, self._row, self._time, xs, ys, out)
        index = np.clip(256.0 * self.quantity.share(out), 0.0, 255.0)
        return SOIL_SCALE[index.astype(np.uint8)]

    def advance(self, shot: Snapshot) -> bool:
        """Move to the time of the snapshot; True when the map has changed since the last call."""
        time = map_time(self._own_events, shot.time)
        if time == self._time:
            return False
        self._time = time
        self._tiles.clear()
        return True

    def draw(self, target: pygame.Surface, shot: Snapshot, left: float, top: float) -> None:
        """Cover the target, whose upper left corner lies at world (left, top) [m]."""
        width, height = target.get_size()
        x0, y0 = round(left * self._metre), round(-top * self._metre)  # [px] of the corner, y down
        side = self._pixels
        for row in range(y0 // side, (y0 + height - 1) // side + 1):
            for column in range(x0 // side, (x0 + width - 1) // side + 1):
                tile = self._tile(shot, column, row)
                target.blit(tile, (column * side - x0, row * side - y0))

    def _tile(self, shot: Snapshot, column: int, row: int) -> pygame.Surface:
        """Tile whose upper left corner is at (column, -row) tiles."""
        key = (0, 0) if self.uniform and self._terrain is None else (column, row)
        if key not in self._tiles:
            if len(self._tiles) >= _TILES:
                del self._tiles[next(iter(self._tiles))]
            self._tiles[key] = self._new_tile(shot, *key)
        return self._tiles[key]

    def _new_tile(self, shot: Snapshot, column: int, row: int) -> pygame.Surface:
        side, (metres, parts) = self._pixels, self._grid
        cells = -(-side // CELL_PIXELS)
        middles = metres * (np.arange(cells) + 0.5) * CELL_PIXELS / side
        coarse = self.image(shot, metres * column + middles, -(metres * row + middles))
        plain = coarse.repeat(CELL_PIXELS, 0).repeat(CELL_PIXELS, 1)[:side, :side]
        lined = plain.copy()
        for part in range(parts - 1, -1, -1):
            line, factor = part * side // parts, _THIN if part else _THICK
            lined[line] = factor * plain[line]
            lined[:, line] = factor * plain[:, line]
        tile = surface(side, side)
        paint(tile, self.with_relief(lined, metres * column, -metres * row, metres / side))
        return tile

    def with_relief(self, pixels: Bytes, left: float, top: float, cell: float) -> Bytes:
        """An image (H, W, 3) shaded by the terrain; (left, top) [m]: corner, cell [m]: a pixel."""
        if self._terrain is None:
            return pixels
        height, width = pixels.shape[:2]
        xs = left + cell * (np.arange(-1, width + 1) + 0.5)
        ys = top - cell * (np.arange(-1, height + 1) + 0.5)
        heights = self._terrain.checked_heights(*np.meshgrid(xs, ys))
        return shaded_map(pixels, heights, cell, self.interval)
