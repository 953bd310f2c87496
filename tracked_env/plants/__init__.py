"""What the engine needs of a plant, in one object, and the plants by name.

A plant is the motion of a vehicle over one control step: actions in, state out. `Plant` holds all
that differs between plants; simulation, sensors, drawing and benchmark read it there and know no
plant by name. A new plant is one file that makes a `Plant`, and `tracked_env.plants.register`.
The plants of this package are imported when they are asked for; `plants.standalone` drives one
without an environment.
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.arrays import Batch
from tracked_env.entry_points import registered_name
from tracked_env.physics.parameters import PlantParameters, SoilParameters, VehicleState
from tracked_env.validation import checked_choice, checked_keys

Floats = NDArray[np.float64]
NO_COMMANDS = np.zeros((1, 0))  # actions say what the drives are to give
# Plants of this package, and the files that they are in.
SHIPPED = {"lumped": "lumped_block", "distributed": "distributed", "terrain": "terrain"}


class Drive(NamedTuple):
    """What an action of 1 asks of a sprocket."""

    name: str
    limit: str  # the parameter that the action is a share of
    quantity: str  # what is driven: `<quantity>_left`, `<quantity>_right` of the state


DRIVES = {
    "torque": Drive("torque", "torque_limit", "torque"),
    "speed": Drive("speed", "sprocket_speed_limit", "sprocket_speed"),
}


def unchanged(parameters: PlantParameters, state: VehicleState) -> VehicleState:
    """The state an episode draws, as it is."""
    return state


class Ground(NamedTuple):
    """The uneven ground of a plant, and how vehicles come onto it.

    place: (floats, rows) completes the states of these rows of the batch, in place of `start`.
    heights: (floats, rows, x, y) -> heights [m] (n, M) at places (n, M) [m] on the ground of rows.
    loads: (batch, row) -> normal load [N] of each patch (2, nx, ny): left and right track, from the
    rear to the front, from the right to the left edge of the track. For pictures: computed anew.
    centre_height: (parameters) -> [m] of the centre of mass over the underside, on level ground.
    """

    place: Callable[[Floats, NDArray[np.int64]], None]
    heights: Callable[[Floats, NDArray[np.int64], Floats, Floats], Floats]
    loads: Callable[[Batch, int], Floats]
    centre_height: Callable[[PlantParameters], float]
    tilt_limit: float  # [rad] between the up axis and the vertical, beyond which an episode ends


class Prepared(NamedTuple):
    """A plant with its drive and its options chosen.

    advance: kernel of a control step, made of `step.advance_blocks`.
    hold: kernel of the plant alone, made of `hold_blocks`; None if it has none.
    Both take (commands, options) as their last argument: commands (N, 2 or 4) that are held, or
    NO_COMMANDS where actions count; options: plain numbers, arrays or named tuples of them.
    start: (parameters, drawn state) -> the state that the episode starts from.
    """

    advance: Callable[..., int]
    hold: Callable[..., None] | None = None
    options: tuple[Any, ...] = ()
    start: Callable[[PlantParameters, VehicleState], VehicleState] = unchanged
    unread: frozenset[str] = frozenset()  # parameters without effect under these options
    variant: str = ""  # what the options make of the plant, in words
    ground: Ground | None = None  # None: level ground at height 0
    terrains: int = 1  # of which an episode draws one


@dataclass(frozen=True)
class Plant:
    """All that the engine needs of a plant.

    prepare: (drive, options) -> Prepared; raises ValueError for an option outside its range.
    motion_resistances: compiled (floats, i) -> [N] of the left and the right track of vehicle i.
    """

    name: str
    # Drives that it accepts, each with the parameters that motion and sensors then depend on.
    reads: Mapping[str, frozenset[str]]
    prepare: Callable[[str, Mapping[str, Any]], Prepared]
    motion_resistances: Callable[[NDArray[np.float64], int], tuple[float, float]]
    options: Mapping[str, Any] = field(default_factory=dict)  # names and defaults
    columns: int = 0  # of its own, from `arrays.PLANT` on
    lanes: int = 1  # vehicles that it moves at once
    threads_from: int = 512  # [vehicles] from which two threads are faster than one
    panel: tuple[str, ...] = ("mass", "inertia")  # quantities of the picture's panel
    # Why a vehicle cannot go on, `arrays.FAILURE` = 1, 2, ...; each a flag `ended_NAME` of `info`.
    failures: tuple[str, ...] = ()
    relief_column: int = 0  # of the floats, where a drawn relief begins; 0: level ground
    soil_map: tuple[str, ...] = SoilParameters._fields  # that colour the ground, the first wins


_REGISTERED: dict[str, Plant] = {}


def register(plant: Plant) -> Plant:
    """Give a plant a name that environments know. Raises ValueError when another one has it."""
    if plant.name in (*SHIPPED, *_REGISTERED) and find(plant.name) is not plant:
        raise ValueError(f"plant = {plant.name!r}; another plant is registered by this name")
    _REGISTERED[plant.name] = plant
    return plant


def find(plant: str | Plant) -> Plant:
    """The plant of a name, also as module:name, or the plant itself. Raises ValueError."""
    if isinstance(plant, Plant):
        return plant
    name = registered_name("plant", plant, lambda: (*SHIPPED, *_REGISTERED))
    if name in SHIPPED:
        shipped: Plant = importlib.import_module(f"tracked_env.plants.{SHIPPED[name]}").PLANT
        return shipped
    return _REGISTERED[name]


def known_plants() -> list[Plant]:
    """All plants that have a name, those of this package first."""
    return [find(name) for name in dict.fromkeys((*SHIPPED, *_REGISTERED))]


def prepared(plant: Plant, drive: str, options: Mapping[str, Any]) -> Prepared:
    """The plant with a drive, and with options that differ from its defaults.

    Raises ValueError for a drive it does not accept, and for an option that is unknown or wrong.
    """
    checked_choice("drive", drive, DRIVES)
    if drive not in plant.reads:
        others = " or ".join(f'"{other.name}"' for other in known_plants() if drive in other.reads)
        accepted = ", ".join(f'"{name}"' for name in plant.reads)
        raise ValueError(
            f'drive = "{drive}"; needs plant = {others}: "{plant.name}" is driven by {accepted}'
        )
    changes = checked_keys(f"plant_options of {plant.name}", options, plant.options)
    return plant.prepare(drive, {**plant.options, **changes})
