"""Named policies for the benchmark: what each knows of the vehicle and its soil.

    nominal   the feedback-linearizing controller with the nominal parameters, right or wrong
    adaptive  the same controller with the parameters that it identifies under way
    oracle    the same controller, handed the true parameters at every step: what perfect
              identification would reach. It measures like everybody else.
A factory takes a context with `control_period` [s], `lateral` (closure) and `sensors` (data
sheet: the noise of the sensors, which everybody may know).
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.adaptive import AdaptivePolicy
from baselines.controllers.feedback_linearization import FeedbackLinearizingController
from baselines.estimators.measurement import DataSheet
from tracked_env.physics.parameters import PARAMETER_NAMES, plant_parameters


class Context(Protocol):
    """What a factory needs to know of the environment."""

    @property
    def control_period(self) -> float:
        """Time between two actions [s]."""

    @property
    def lateral(self) -> str:
        """Lateral closure of the plant."""

    @property
    def sensors(self) -> Any:
        """Data sheet: an object with the attributes of estimators.measurement.DataSheet."""


class OracleController(FeedbackLinearizingController):
    """The controller with the parameters in force, as handed to `observe_truth`."""

    needs_truth = True

    def observe_truth(self, truth: Mapping[str, NDArray[np.float64]]) -> None:
        """Take over the true parameters, {name: number or (N,)}; other names are ignored."""
        self.parameters = np.stack([np.atleast_1d(truth[name]) for name in PARAMETER_NAMES])


def nominal(context: Context) -> FeedbackLinearizingController:
    """The controller that trusts the nominal parameters."""
    return FeedbackLinearizingController(
        plant_parameters(), control_period=context.control_period, lateral=context.lateral
    )


def adaptive(context: Context) -> AdaptivePolicy:
    """The controller that identifies vehicle and soil under way."""
    return AdaptivePolicy(
        plant_parameters(),
        control_period=context.control_period,
        data_sheet=DataSheet.of(context.sensors),
        lateral=context.lateral,
    )


def oracle(context: Context) -> OracleController:
    """The controller that knows the true parameters."""
    return OracleController(
        plant_parameters(), control_period=context.control_period, lateral=context.lateral
    )


POLICIES: dict[str, Callable[[Any], Any]] = {
    "nominal": nominal,
    "adaptive": adaptive,
    "oracle": oracle,
}
