"""What is under a vehicle at a place: height, slope and soil, at one instant of its episode.

The soil starts with the parameters of the episode; each event changes one of them in turn, by
time and place (`tracked_env.events`). `refresh` writes all parameters in
force at the vehicle's centre of mass; `at` gives ground and soil at any other place, under a track
or under a patch, so that a plant decides where its soil is asked for.

    ground = Terrain(batch.floats, batch.events, i, count, time)       inside a kernel
    under = at(level, ground, x, y)                                    Ground: surface, soil
    Terrain(...).at(x, y)                                              the same from Python

Level ground, the default surface.

A surface is a compiled function (x, y) [m] -> `Surface`; another one is another such function,
passed to `tracked_env.terrain.ground.at` by the plant that drives on it.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env import events as parameter_events
from tracked_env.physics import parameters as s
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import (
    PARAMETER_INDEX,
    PARAMETER_NAMES,
    PARAMETER_ROWS,
    PlantParameters,
    SoilParameters,
    gathering,
)

STEEPEST = 5.0  # [-] dz/dx of any terrain, 79 degrees
# What an episode draws on top of a terrain, see `terrain.pool`: two slopes, and sinusoids.
DRAWN_WAVES = 8
RELIEF_SIZE = 2 + 4 * DRAWN_WAVES
RELIEF_COLUMNS = RELIEF_SIZE + 1  # and the member of the pool


class Surface(NamedTuple):
    """Geometry of the ground at one place, world frame."""

    height: float  # [m]
    slope_x: float  # [-] dz/dx
    slope_y: float  # [-] dz/dy


@formula
def level(x, y):
    """Height 0 and no slope, wherever (x, y) [m] is."""
    return Surface(0.0, 0.0, 0.0)


class Ground(NamedTuple):
    """Surface and soil at one place."""

    surface: Surface
    soil: SoilParameters


class Terrain(NamedTuple):
    """The ground of vehicle i at one instant: where its soil starts, and what changes it."""

    floats: NDArray[np.float64]  # of the batch: parameters at the start of the episode
    events: NDArray[np.float64]  # (N, E, 8)
    i: int  # row of the vehicle
    acting: int  # events of it that count
    time: float  # [s] since the start of the episode

    def at(self, x: float, y: float) -> Ground:
        """Level ground and its soil at (x, y) [m], world frame."""
        return at(level, self, float(x), float(y))


@formula
def changed(value, parameter, events, i, count, time, x, y):
    """One parameter at `time` [s] and (x, y) [m]: its first value, changed by each event in turn.

    parameter: its row in PARAMETER_NAMES.
    """
    for e in range(count):
        if int(events[i, e, 1]) == parameter:
            value = parameter_events.changed_value(value, events, i, e, time, x, y)
    return value


@formula
def _value(terrain, parameter, x, y):
    """One parameter of the soil at (x, y) [m]."""
    return changed(
        terrain.floats[terrain.i, b.BASE + parameter], parameter, terrain.events, terrain.i,
        terrain.acting, terrain.time, x, y,
    )  # fmt: skip


# (terrain, x, y): SoilParameters at (x, y) [m].
_soil_at = gathering(
    SoilParameters,
    "terrain, x, y",
    {name: f"value(terrain, {PARAMETER_INDEX[name]}, x, y)" for name in SoilParameters._fields},
    value=_value,
)


@formula
def at(surface, terrain, x, y):
    """Ground at (x, y) [m]; surface: compiled (x, y) -> Surface."""
    return Ground(surface(x, y), _soil_at(terrain, x, y))


# (p, soil): PlantParameters p with another soil.
on_soil = gathering(
    PlantParameters,
    "p, soil",
    {
        name: f"soil.{name}" if name in SoilParameters._fields else f"p.{name}"
        for name in PARAMETER_NAMES
    },
)


@formula
def refresh(floats, events, i, count, time):
    """Parameters in force at the centre of mass of vehicle i, at `time` [s], into their columns."""
    for row in range(PARAMETER_ROWS):
        floats[i, b.PARAMETERS + row] = floats[i, b.BASE + row]
    for e in range(count):
        row = b.PARAMETERS + int(events[i, e, 1])
        floats[i, row] = parameter_events.changed_value(
            floats[i, row], events, i, e, time, floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
        )


def checked_relief(given: Any) -> tuple[float, ...]:
    """A drawn relief as numbers; empty for none. Raises ValueError."""
    numbers = tuple(float(value) for value in given)
    if len(numbers) not in (0, RELIEF_SIZE) or not all(math.isfinite(value) for value in numbers):
        raise ValueError(
            f"relief of {len(numbers)} numbers; must be {RELIEF_SIZE} finite ones, two slopes and "
            f"{DRAWN_WAVES} rows [A, kx, ky, phi], or none"
        )
    steep = math.hypot(*numbers[:2]) if numbers else 0.0
    for k in range(2, len(numbers), 4):
        steep += abs(numbers[k]) * math.hypot(numbers[k + 1], numbers[k + 2])
    if steep > STEEPEST:
        raise ValueError(
            f"relief with a slope of up to {steep:.3g}; must be at most {STEEPEST:g}. "
            "Are the wave numbers in rad/m?"
        )
    return numbers
