"""Figure 17: the tracking error that a wrong mass and a wrong inertia cause, on a grid of both.

As in the paper the RMSE over a run is that of the distance to the vehicle whose controller knows
both. All grid points are one batch: one plant, a controller with its own parameters per vehicle.
Paths are the circle and the straight line of 8.2.1 and the manoeuvre of 8.3.1.
"""

from typing import Any, NamedTuple

import numpy as np

from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from reproduce.strawa2021.control import (
    ICR_FORWARD,
    PATHS,
    PERIOD,
    SCENARIOS,
    START,
    Floats,
    believed_parameters,
    drive,
)
from reproduce.strawa2021.identification import manoeuvre

FACTORS = np.linspace(0.5, 1.5, 11)  # [-] of the true value; the middle one is right
DURATION = 30.0  # [s]
WAYS: dict[str, Any] = {**PATHS, "manoeuvre": manoeuvre()}


class Surface(NamedTuple):
    """RMSE [m] over mass (rows) and inertia (columns): assumed by the controller over true."""

    factors: Floats
    rmse: Floats  # (F, F)

    def along(self) -> tuple[float, float]:
        """Largest RMSE with only the mass wrong, and with only the inertia wrong [m]."""
        middle = len(self.factors) // 2
        return float(self.rmse[:, middle].max()), float(self.rmse[middle].max())


def surface(
    way: str, turning_factor: float, factors: Floats = FACTORS, duration: float = DURATION
) -> Surface:
    """The grid for one path. factors: odd in number, the middle one 1."""
    believed = believed_parameters(SCENARIOS["exact"], turning_factor)
    mass, inertia = (grid.ravel() for grid in np.meshgrid(factors, factors, indexing="ij"))
    arrays: Any = {"mass": believed.mass * mass, "inertia": believed.inertia * inertia}
    policy = FeedbackLinearizingController(
        believed._replace(**arrays), PERIOD, lateral="constrained"
    )
    row = {
        "reference": WAYS[way],
        "vehicle": {"drive_time_constant": 0.0},
        "lateral_model": {"turning_resistance_factor": turning_factor, "icr_forward": ICR_FORWARD},
        "start": START,
    }
    truth = drive(policy, [row] * mass.size, duration).truth
    right = mass.size // 2
    square = sum((truth[name] - truth[name][:, [right]]) ** 2 for name in ("x", "y"))
    rmse = np.sqrt(np.mean(square, axis=0))
    return Surface(factors, rmse.reshape(len(factors), len(factors)))


def run_all() -> dict[tuple[str, float], Surface]:
    """Every path with both turning factors."""
    return {(way, factor): surface(way, factor) for way in WAYS for factor in (2.0, 1.0)}
