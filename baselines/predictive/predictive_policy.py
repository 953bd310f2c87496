"""Model predictive control as a policy: the identification stack in front of the controller.

    PredictivePolicy         its model has the parameters that are identified under way
    NominalPredictivePolicy  its model has the nominal parameters; motion is filtered all the same
    PredictiveOraclePolicy   its model has the true parameters
Estimates, filter, late poses and outages are those of the adaptive policy; the controller alone
differs.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.actuators import COMMANDS
from baselines.estimators.sensor_samples import DataSheet
from baselines.estimators.stack import Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.known_parameters import OraclePolicy
from baselines.predictive.predictive_control import NEEDS, PredictiveController
from baselines.predictive.tracking_cost import PredictiveSettings
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters


class PredictivePolicy(AdaptivePolicy):
    """Predictive controller and estimators as one policy, for one vehicle or a batch.

    parameters: nominal ones. control_period [s]: between two calls. data_sheet: noise of the
    sensors (default `rtk`). lateral: must be "sliding". observation: names of the fields that the
    environment shows; the look-ahead and the commands must be among them. settings: weights and
    horizon.
    Raises ValueError for arguments that make no sense, and for an observation that lacks a field.
    """

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        lateral: str = "sliding",
        observation: Sequence[str] = layout.NAMES,
        settings: PredictiveSettings | None = None,
    ) -> None:
        if lateral != "sliding":
            raise ValueError(
                f"lateral = {lateral!r}; model predictive control predicts 'sliding' alone. Use "
                "'adaptive' or 'nominal', or an environment with lateral_model='sliding'"
            )
        self._settings = settings
        super().__init__(parameters, control_period, data_sheet, observation=observation)
        needed = (*NEEDS, *COMMANDS, *self.stack.needs)
        self._view = layout.View(observation, tuple(dict.fromkeys(needed)))

    def _made(self, control_period: float, settings: Any, lateral: str, sloped: bool) -> Any:
        return PredictiveController(self.parameters, control_period, self._settings, sloped)

    def _drive(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_], memory: Any,
        given: NDArray[np.float64],
    ) -> tuple[NDArray[np.float32], Any]:  # fmt: skip
        action, plans = self.controller.act(observation, memory, start, given)
        return action, plans


class NominalPredictivePolicy(PredictivePolicy):
    """The same with the nominal parameters; arguments as PredictivePolicy."""

    def _adapt(self, known: Identification) -> None:
        """The parameters stay what they are."""


class PredictiveOraclePolicy(OraclePolicy):
    """The same with the true parameters at every step; arguments as PredictivePolicy."""

    identifying = PredictivePolicy
