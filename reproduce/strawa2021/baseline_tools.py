"""Controller and estimators as the scenarios of Strawa et al. (2021) ask for them.

reproduce.strawa2021 drives vehicles and draws figures, and knows no baseline: it is
handed these factories. Each `observe` takes one observation (N, SIZE) per control step.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.observation_reader import ObservationReader
from baselines.estimators.sensor_samples import DataSheet
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.soil_estimator import SoilEstimator
from baselines.estimators.stack import SLIP_CORRELATION, Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from tracked_env.physics.parameters import PlantParameters

Floats = NDArray[np.float64]


def controller(
    parameters: PlantParameters, period: float, lateral: str
) -> FeedbackLinearizingController:
    """The controller alone, on what it measures; parameters: numbers or (N,)."""
    return FeedbackLinearizingController(parameters, period, lateral=lateral)


class FilteringPolicy(AdaptivePolicy):
    """The controller behind the filter of the adaptive policy, with the parameters it was given.

    Noise of 1 m makes the unfiltered controller shake: a comparison with the adaptive policy
    has to differ in the parameters only.
    """

    def _adapt(self, known: Identification) -> None:
        """Keep the parameters."""


def policy(
    parameters: PlantParameters, period: float, sensors: Any, lateral: str, kind: str
) -> AdaptivePolicy:
    """kind "printed", "paper" or "coupled": regression of the policy; "fixed": no adaptation.

    As in S the estimated soil is not used by the controller.
    """
    made = FilteringPolicy if kind == "fixed" else AdaptivePolicy
    return made(
        parameters, period, DataSheet.of(sensors), lateral,
        regression="coupled" if kind == "fixed" else kind, uses_soil=False,
    )  # fmt: skip


class SlipTool:
    """The UKF fed with observations. velocity: False takes X, Y, yaw only, as S does."""

    def __init__(
        self, parameters: PlantParameters, period: float, sensors: Any, count: int, velocity: bool
    ) -> None:
        self._reader = ObservationReader(period, count)
        self._filter = SlipObserver(
            parameters, period, DataSheet.of(sensors), count, velocity=velocity
        )

    def observe(self, observation: NDArray[np.float32]) -> tuple[Floats, Floats]:
        """(slips i_L, i_R (N, 2) [-], their variances)."""
        self._filter.update(self._reader.read(observation).latest)
        return self._filter.slips, self._filter.slip_variances


class SoilTool:
    """The soil estimator fed with observations and slips.

    residual: "effort" is S (43), "total" allows for noise of the slips. filtered: whether the
    slips come from a filter, so that their errors hang together.
    """

    def __init__(
        self,
        parameters: PlantParameters,
        period: float,
        sensors: Any,
        count: int,
        residual: str = "total",
        filtered: bool = True,
    ) -> None:
        self._reader = ObservationReader(period, count)
        self._estimator = SoilEstimator(
            parameters, period, DataSheet.of(sensors), count, residual=residual,
            correlation_steps=SLIP_CORRELATION if filtered else 1.0,
        )  # fmt: skip

    def observe(
        self, observation: NDArray[np.float32], slips: Floats, variances: Floats
    ) -> dict[str, Floats]:
        """By name (N,): F_max [N], K [m], iterations, flags 0 or 1."""
        soil = self._estimator
        soil.provide_slip(slips, variances)
        estimate = soil.update(self._reader.read(observation).latest)
        return {
            **{name: estimate.of(name) for name in estimate.names},
            "iterations": soil.iterations.astype(np.float64),
            "converged": soil.converged.astype(np.float64),
            "ratio_only": soil.ratio_only.astype(np.float64),
        }


TOOLS: dict[str, Any] = {
    "controller": controller,
    "policy": policy,
    "slip": SlipTool,
    "soil": SoilTool,
}
