"""Observation augmentation for vehicles that are driven by their sprocket speeds.

    estimates   the filtered errors, the friction and slip that the slippage-aware controller knows
    residual    the same and that controller's action; the agent only corrects it
As `baselines.learned.torque_augmentation`, of another controller.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned.held_policy import HeldState, checked_scale, corrected
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from tracked_env import observation as layout

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

# What is known, and what is shown as 1 [SI].
KNOWN = {
    "filtered_error_x": 0.05, "filtered_error_y": 0.05, "filtered_heading_error": 0.1,
    "log_friction": 1.0, "friction_uncertainty": 0.1,
    "slip_velocity_left": 0.1, "slip_velocity_right": 0.1, "slip_angle": 0.1,
}  # fmt: skip
_SCALE = np.array(list(KNOWN.values()))
_SPROCKETS = [layout.INDEX[n] for n in ("sprocket_speed_left", "sprocket_speed_right")]


def known_features(observation: Floats, policy: AdaptiveSlipPolicy, error: Any) -> Floats:
    """KNOWN (N, F) after a call of the policy; error: its filtered pose error, (N, 3)."""
    mu, sigma = policy.estimator.estimates()["friction"]
    left, right = (observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]).T
    nominal = policy.nominal_friction
    slip = policy.estimator.slip(np.nan_to_num(left), np.nan_to_num(right))
    values = np.stack([*np.asarray(error).T, np.log(mu / nominal), sigma / mu, *slip], axis=1)
    return (values / _SCALE).astype(np.float32)


class SlipEstimates(HeldState):
    """What the slippage-aware controller knows, as features; the agent drives."""

    feature_names: tuple[str, ...] = tuple(KNOWN)

    def __init__(self, policy: AdaptiveSlipPolicy, count: int) -> None:
        self.policy, self.count, self.needs = policy, count, policy.needs
        self.control_period = policy.control_period

    def _looked(self, observation: Floats, start: Bools) -> tuple[Floats, Floats]:
        """The controller's action and KNOWN."""
        action, self._state = self.policy.predict(observation, self._state, start)
        return action, known_features(observation, self.policy, self._state.driving.error)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """KNOWN, (N, F); rows with `start` forget."""
        return self._looked(observation, start)[1]

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class SlipResidual(SlipEstimates):
    """The controller's action, which the agent corrects by up to `scale` of the top speed."""

    feature_names = ("adaptive_left", "adaptive_right", *KNOWN)

    def __init__(self, policy: AdaptiveSlipPolicy, count: int, scale: float) -> None:
        """Raises ValueError for a scale outside (0, 2]."""
        super().__init__(policy, count)
        self.scale = checked_scale(scale)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The controller's action, then KNOWN, (N, F)."""
        action, known = self._looked(observation, start)
        return np.concatenate([action, known], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The controller's action plus the agent's, scaled, within [-1, 1]."""
        return corrected(features[:, :2], self.scale, action)
