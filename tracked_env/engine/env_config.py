"""What an environment is built from: its arguments, and the solver that follows from them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tracked_env.physics.parameters import VEHICLES, PlantParameters, Range
from tracked_env.physics.patch_forces import Patches, make_patches
from tracked_env.sensors import Sensors
from tracked_env.uncertainty import Spec
from tracked_env.validation import checked_choice, checked_number

SUBSTEP = 0.0025  # [s] longest RK4 step; converged and stable there, see docs/numerics.md
LATERAL = ("sliding", "constrained")
PLANTS = ("lumped", "distributed")
DRIVES = ("torque", "speed")


class EnvConfig(NamedTuple):
    """Arguments of the environments, as `TrackedVehicleEnv` documents them."""

    reference: str | Mapping[str, Any] = "random"
    uncertainty: Spec = "soil-and-mass"
    sensors: str | Mapping[str, Any] | Sensors = "rtk"
    duration: float = 30.0  # [s]
    control_rate: float = 50.0  # [Hz]
    lateral: str = "sliding"
    error_limit: float = 5.0  # [m]
    time_step: float = SUBSTEP  # [s]
    threads: int = 1
    vehicle: str = "strawa"
    plant: str = "lumped"
    drive: str = "torque"
    patches: Sequence[int] = (10, 4)
    observation: str | Sequence[str] = "v0"


class Solver(NamedTuple):
    """Clock, closure and limits, the same for every vehicle of a batch."""

    control_period: float  # [s]
    substeps: int  # per control step
    substep: float  # [s]
    constrained: bool  # of the lumped plant
    distributed: bool  # which plant
    by_torque: bool  # what the action is
    patches: Patches  # of the distributed plant
    nominal: PlantParameters  # of the vehicle and the soil that its controllers expect
    error_limit: float  # [m] distance to the reference that ends an episode
    threads: int


def make_solver(config: EnvConfig) -> Solver:
    """Check and combine; the sub-step is the largest one <= time_step that divides a step.

    Raises ValueError for a value outside its range, an unknown name, and for sprocket speeds as
    actions of the lumped plant, in which sprockets have no dynamics of their own.
    """
    rate = checked_number(
        "control_rate", config.control_rate, Range(5.0, 1000.0, "Hz", "Did you pass the period?")
    )
    longest = checked_number(
        "time_step", config.time_step, Range(1e-5, 0.005, "s", "Larger steps are unstable.")
    )
    limit = checked_number(
        "error_limit", config.error_limit, Range(0.01, 1e6, "m", "It is a distance.")
    )
    threads = checked_number("threads", config.threads, Range(1, 64, "-", "Number of threads."))
    closure = checked_choice("lateral closure", config.lateral, LATERAL)
    plant = checked_choice("plant", config.plant, PLANTS)
    drive = checked_choice("drive", config.drive, DRIVES)
    vehicle = checked_choice("vehicle", config.vehicle, VEHICLES)
    if drive == "speed" and plant == "lumped":
        raise ValueError(
            'drive = "speed"; needs plant = "distributed": the lumped one has no belts'
        )
    if len(config.patches) != 2:
        raise ValueError(
            f"patches = {config.patches!r}; must be two numbers: along, across a track"
        )
    substeps = int(np.ceil(1.0 / (rate * longest) - 1e-9))
    substep = 1.0 / (rate * substeps)
    return Solver(
        1.0 / rate, substeps, substep, closure == "constrained", plant == "distributed",
        drive == "torque", make_patches(*config.patches), VEHICLES[vehicle], limit, int(threads),
    )  # fmt: skip
