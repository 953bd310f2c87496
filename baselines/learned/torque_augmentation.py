"""Observation augmentation for vehicles that are driven by their sprocket torques.

estimates   the filtered motion, the identified parameters and their standard deviations
residual    the estimates and the adaptive controller's action; the agent only corrects it
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.stack import FEATURES, Identification, IdentificationStack, features
from baselines.learned.held_policy import HeldState, checked_scale, corrected
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

# Errors of the filtered motion, as the estimators know it, and what is shown as 1 [SI].
FILTERED = {
    "filtered_error_x": 0.2, "filtered_error_y": 0.2, "filtered_heading_error": 0.1,
    "filtered_speed_error": 0.2, "filtered_v_y": 0.2, "filtered_yaw_rate_error": 0.1,
}  # fmt: skip
# Standard deviations of the filtered pose and what is shown as 0 [SI]: how far to trust it, by
# which sensors differ. Logarithms, as they reach from millimetres to metres.
TRUSTED = {"filtered_position_log_deviation": 0.05, "filtered_yaw_log_deviation": 0.01}
KNOWN = (*FILTERED, *TRUSTED, *FEATURES)
_WANTED = [layout.INDEX["reference_speed"], layout.INDEX["reference_yaw_rate"]]


def known_features(observation: Floats, known: Identification, nominal: PlantParameters) -> Floats:
    """FILTERED errors, TRUSTED deviations, FEATURES as `stack.features` shows them, (N, F).

    The filtered pose is several times less noisy than the measured one, and centimetres, which
    the observation shows as hundredths, are of order one here.
    """
    motion, reference = known.motion, known.reading.reference
    ahead_x, ahead_y = reference[:, 0] - motion.x, reference[:, 1] - motion.y
    cosine, sine = np.cos(motion.yaw), np.sin(motion.yaw)
    turn = reference[:, 2] - motion.yaw
    wanted = observation[:, _WANTED] * layout.SCALE[_WANTED]
    errors = (
        cosine * ahead_x + sine * ahead_y,
        cosine * ahead_y - sine * ahead_x,
        turn - 2.0 * np.pi * np.floor(turn / (2.0 * np.pi) + 0.5),
        wanted[:, 0] - motion.v_x,
        motion.v_y,
        wanted[:, 1] - motion.yaw_rate,
    )
    scaled = np.stack(errors, axis=-1) / np.array(list(FILTERED.values()))
    position = np.hypot(known.slip.deviation("x"), known.slip.deviation("y"))
    deviations = np.stack([position, known.slip.deviation("yaw")], axis=-1)
    trusted = np.log(deviations / np.array(list(TRUSTED.values())))
    shown = features(known, nominal, further=False)
    return np.concatenate([scaled, trusted, shown], axis=1, dtype=np.float32)


class Estimates(IdentificationStack):
    """What the identification stack knows, as features."""

    learned = FEATURES

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what `observe` returns."""
        return KNOWN

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Filtered errors and estimates, (N, F); rows with `start` forget."""
        return known_features(observation, self.update(observation, start), self.parameters)

    def freeze(self, rows: Bools) -> None:
        """No controller that could learn."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class IdentifyingPolicy(Protocol):
    """A controller that says what it has identified, as `adaptive` does."""

    known: Identification | None  # after the last call
    parameters: PlantParameters  # nominal ones

    def predict(self, observation: Any, state: Any, episode_start: Any) -> tuple[Floats, Any]:
        """Action and state."""
        ...


class Residual(HeldState):
    """An adaptive policy, whose action the agent corrects; its estimates are features too.

    control_period [s]. scale [-]: how far the agent may move an action, over the torque limit.
    needs: fields of the observation that the policy reads.
    """

    feature_names = ("adaptive_left", "adaptive_right", *KNOWN)
    learned = FEATURES

    def __init__(
        self, policy: IdentifyingPolicy, count: int, control_period: float, scale: float,
        needs: tuple[str, ...] = layout.NAMES,
    ) -> None:  # fmt: skip
        """Raises ValueError for a scale outside (0, 2]."""
        self.count, self.scale, self.needs = count, checked_scale(scale), needs
        self.policy, self.control_period = policy, control_period

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Action of the adaptive policy, then the features of its estimates, (N, F)."""
        action, self._state = self.policy.predict(observation, self._state, start)
        assert self.policy.known is not None
        known = known_features(observation, self.policy.known, self.policy.parameters)
        return np.concatenate([action, known], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The adaptive policy's action plus the agent's, scaled, within [-1, 1]."""
        return corrected(features[:, :2], self.scale, action)
