"""Named policies for the benchmark: what each knows of the vehicle and its soil.

    nominal   the feedback-linearizing controller with the nominal parameters, right or wrong
    adaptive  the same controller with the parameters that it identifies under way
    oracle    the adaptive policy, handed the true parameters at every step: what perfect
              identification would reach. It measures, and filters, like the adaptive one.
A factory takes a context with `control_period` [s], `lateral` (closure) and `sensors` (data
sheet: the noise of the sensors, which everybody may know).
"""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.adaptive import AdaptivePolicy, AdaptiveState
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


class OraclePolicy:
    """The adaptive policy with the parameters in force, as handed to `observe_truth`.

    It filters what the sensors give as the adaptive policy does, and estimates no parameter.
    Arguments as AdaptivePolicy.
    """

    needs_truth = True

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._policy = AdaptivePolicy(*arguments, **options)

    @property
    def controller(self) -> FeedbackLinearizingController:
        """The controller that drives."""
        return self._policy.controller

    def observe_truth(self, truth: Mapping[str, NDArray[np.float64]]) -> None:
        """Take over the true parameters, {name: number or (N,)}; other names are ignored."""
        self._policy.given_parameters = np.stack(
            [np.atleast_1d(truth[name]) for name in PARAMETER_NAMES]
        )

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AdaptiveState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AdaptiveState]:
        """As AdaptivePolicy.predict."""
        return self._policy.predict(observation, state, episode_start, deterministic)


def nominal(context: Context) -> FeedbackLinearizingController:
    """The controller that trusts the nominal parameters."""
    return FeedbackLinearizingController(
        plant_parameters(), control_period=context.control_period, lateral=context.lateral
    )


def _arguments(context: Context) -> dict[str, Any]:
    return {
        "parameters": plant_parameters(),
        "control_period": context.control_period,
        "data_sheet": DataSheet.of(context.sensors),
        "lateral": context.lateral,
    }


def adaptive(context: Context) -> AdaptivePolicy:
    """The controller that identifies vehicle and soil under way."""
    return AdaptivePolicy(**_arguments(context))


def oracle(context: Context) -> OraclePolicy:
    """The controller that knows the true parameters."""
    return OraclePolicy(**_arguments(context))


POLICIES: dict[str, Callable[[Any], Any]] = {
    "nominal": nominal,
    "adaptive": adaptive,
    "oracle": oracle,
}
