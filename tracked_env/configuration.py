"""What an environment is built from: its arguments, and the solver that follows from them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tracked_env.physics.parameters import Range
from tracked_env.sensors import Sensors
from tracked_env.validation import checked_choice, checked_number

SUBSTEP = 0.0025  # [s] longest RK4 step; converged and stable there, see docs/numerics.md
LATERAL = ("sliding", "constrained")


class TorqueConfig(NamedTuple):
    """Arguments of the environments, as `TrackedVehicleEnv` documents them."""

    reference: str | Mapping[str, Any] = "random"
    uncertainty: str | Mapping[str, Any] = "soil-and-mass"
    sensors: str | Mapping[str, Any] | Sensors = "rtk"
    duration: float = 30.0  # [s]
    control_rate: float = 50.0  # [Hz]
    lateral: str = "sliding"
    error_limit: float = 5.0  # [m]
    time_step: float = SUBSTEP  # [s]
    threads: int = 1


class Solver(NamedTuple):
    """Clock, closure and limits, the same for every vehicle of a batch."""

    control_period: float  # [s]
    substeps: int  # per control step
    substep: float  # [s]
    constrained: bool
    error_limit: float  # [m] distance to the reference that ends an episode
    threads: int


def make_solver(config: TorqueConfig) -> Solver:
    """Check and combine; the sub-step is the largest one <= time_step that divides a step.

    Raises ValueError for a value outside its range and for an unknown closure.
    """
    rate = checked_number(
        "control_rate", config.control_rate, Range(5.0, 1000.0, "Hz", "Did you pass the period?")
    )
    longest = checked_number(
        "time_step", config.time_step, Range(1e-5, 0.005, "s", "Larger RK4 steps are unstable.")
    )
    limit = checked_number(
        "error_limit", config.error_limit, Range(0.01, 1e6, "m", "It is a distance.")
    )
    threads = checked_number("threads", config.threads, Range(1, 64, "-", "Number of threads."))
    closure = checked_choice("lateral closure", config.lateral, LATERAL)
    substeps = int(np.ceil(1.0 / (rate * longest) - 1e-9))
    substep = 1.0 / (rate * substeps)
    return Solver(1.0 / rate, substeps, substep, closure == "constrained", limit, int(threads))
