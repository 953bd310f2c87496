"""The adaptive policy with parameters that it does not identify.

    OraclePolicy     the true parameters at every step: what perfect identification would reach
    IntegralPolicy   the nominal parameters, right or wrong; integral action removes the constant
                     part of the error that they cause
Both filter what the sensors give as the adaptive policy does, with the ground that they know or
trust, and estimate no parameter.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.linearizing import linearizing_law as law
from baselines.linearizing.adaptive_policy import AdaptivePolicy, AdaptiveState
from baselines.linearizing.linearizing_law import Gains
from tracked_env.physics.parameters import PARAMETER_NAMES

INTEGRAL_GAINS = Gains(200.0, 120.0, 20.0, 0.5, 100.0)  # tuned, docs/tuning.md
TUNABLE = {**law.TUNABLE, "k_i": (5.0, 500.0, True)}


class KnownParametersPolicy:
    """An adaptive policy, made of the same arguments, whose parameters a subclass gives."""

    identifying: type[AdaptivePolicy] = AdaptivePolicy

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._policy = self.identifying(*arguments, **options)

    @property
    def controller(self) -> Any:
        """The controller that drives."""
        return self._policy.controller

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AdaptiveState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AdaptiveState]:
        """As AdaptivePolicy.predict."""
        return self._policy.predict(observation, state, episode_start, deterministic)


class OraclePolicy(KnownParametersPolicy):
    """The adaptive policy with the parameters in force, as handed to `observe_truth`."""

    needs_truth = True

    def observe_truth(self, truth: Mapping[str, NDArray[np.float64]]) -> None:
        """Take over the true parameters, {name: number or (N,)}; other names are ignored."""
        self._policy.given_parameters = np.stack(
            [np.atleast_1d(truth[name]) for name in PARAMETER_NAMES]
        )


class IntegralPolicy(KnownParametersPolicy):
    """Nominal parameters, the filter of the adaptive policy, integral action with anti-windup.

    Arguments as AdaptivePolicy; gains: INTEGRAL_GAINS by default.
    """

    def __init__(self, *arguments: Any, gains: Gains = INTEGRAL_GAINS, **options: Any) -> None:
        super().__init__(*arguments, gains=gains, **options)
        self._nominal = np.array(self._policy.parameters, dtype=np.float64)[:, np.newaxis]

    def predict(
        self,
        observation: NDArray[np.float32],
        state: AdaptiveState | None = None,
        episode_start: NDArray[np.bool_] | bool | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], AdaptiveState]:
        """As AdaptivePolicy.predict."""
        count = len(observation) if np.ndim(observation) == 2 else 1
        self._policy.given_parameters = np.repeat(self._nominal, count, axis=1)
        return super().predict(observation, state, episode_start, deterministic)
