"""Plants: one file for each, with all that the engine needs of it, and the names they have.

`plants.register(plant)` adds one; the environments' argument `plant` takes a registered name or a
`Plant` itself. `plants.standalone` drives a plant without an environment.
"""

from collections.abc import Mapping
from typing import Any

from tracked_env.plants.base import DRIVES, Drive, Plant, Prepared
from tracked_env.plants.distributed import DISTRIBUTED
from tracked_env.plants.lumped import LUMPED
from tracked_env.plants.terrain import TERRAIN
from tracked_env.validation import checked_choice, checked_keys

PLANTS: dict[str, Plant] = {plant.name: plant for plant in (LUMPED, DISTRIBUTED, TERRAIN)}


def register(plant: Plant) -> Plant:
    """Give a plant a name that environments know. Raises ValueError when another one has it."""
    if PLANTS.get(plant.name, plant) is not plant:
        raise ValueError(f"plant = {plant.name!r}; another plant is registered by this name")
    PLANTS[plant.name] = plant
    return plant


def find(plant: str | Plant) -> Plant:
    """The plant of a registered name, or the plant itself. Raises ValueError."""
    return plant if isinstance(plant, Plant) else PLANTS[checked_choice("plant", plant, PLANTS)]


def prepared(plant: Plant, drive: str, options: Mapping[str, Any]) -> Prepared:
    """The plant with a drive, and with options that differ from its defaults.

    Raises ValueError for a drive it does not accept, and for an option that is unknown or wrong.
    """
    checked_choice("drive", drive, DRIVES)
    if drive not in plant.reads:
        others = " or ".join(f'"{other.name}"' for other in PLANTS.values() if drive in other.reads)
        accepted = ", ".join(f'"{name}"' for name in plant.reads)
        raise ValueError(
            f'drive = "{drive}"; needs plant = {others}: "{plant.name}" is driven by {accepted}'
        )
    given = checked_keys(f"plant_options of {plant.name}", options, plant.options)
    return plant.prepare(drive, {**plant.options, **given})


__all__ = ["DRIVES", "PLANTS", "Drive", "Plant", "Prepared", "find", "prepared", "register"]
