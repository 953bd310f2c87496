"""Observation augmentations with a filter or a controller of this project beside the agent.

reckoned    the pose error, carried on by the belts while no pose comes, and the belts' speed.
            Dead reckoning is that of the Lyapunov controllers (`baselines.lyapunov`): gyro and
            velocity, or belts without slip where no velocity is measured, pulled towards the
            samples of the pose by the steady gain of the data sheet. It knows nothing of soil,
            mass or slip
estimates   vehicles driven by torque: the filtered motion, the identified parameters and their
            standard deviations; driven by sprocket speeds: the filtered errors, the friction
            and slip that the slippage-aware controller knows
residual    the estimates and the adaptive controller's action; the agent only corrects it
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.batch_policy import Context
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import FEATURES, Identification, IdentificationStack, features
from baselines.learned.augmentation import (
    BASE,
    FILTERED,
    RECKONED,
    RESIDUAL_SCALE,
    Augmentation,
    Blind,
    Bools,
    Floats,
    chosen,
)
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import NEEDS as CONTROLLER_NEEDS
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from baselines.lyapunov.lyapunov_laws import LyapunovGains, PseudoKinematicModel
from baselines.lyapunov.pose_filter import (
    ATTITUDE,
    GYRO,
    PATH,
    POSE,
    PoseFilter,
    PoseMemory,
    locate,
    shows_attitude,
)
from baselines.registry import POLICIES
from tracked_env import observation as layout
from tracked_env.observation import NAMES
from tracked_env.physics.parameters import VEHICLES, PlantParameters


class HeldState:
    """An augmentation that remembers the state of its policy, which never changes in place."""

    _state: Any = None
    policy: Any
    learned: tuple[str, ...] = ()

    def freeze(self, rows: NDArray[np.bool_]) -> None:
        """The controller keeps what it knows in these rows (N,)."""
        self.policy.freeze(rows)

    def memories(self) -> Any:
        """The policy's state, None before the first observation."""
        return self._state

    def restore(self, memories: Any, rows: NDArray[np.bool_] | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if rows is None:
            self._state = memories
        elif rows.any():
            known = self._state is not None and memories is not None
            self._state = chosen(memories, self._state, rows) if known else memories


def checked_scale(scale: float) -> float:
    """How far an agent may correct an action. Raises ValueError for one outside (0, 2]."""
    if not 0.0 < scale <= 2.0:
        raise ValueError(f"residual scale = {scale}; must be in (0, 2]: actions lie in [-1, 1]")
    return scale


def corrected(
    action: NDArray[np.float32], scale: float, correction: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The controller's action plus the agent's, scaled, within [-1, 1]; (N, 2) each."""
    return np.clip(action + np.float32(scale) * correction, -1.0, 1.0)


_SCALE = np.array(list(RECKONED.values()))
_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]


class Reckoned(Blind):
    """The reckoned pose error as features; the agent drives.

    count, control_period: as Blind. vehicle: nominal. sheet: of the sensors.
    """

    feature_names = tuple(RECKONED)
    needs = (*POSE, "pose_age", *_BELTS, *PATH)

    def __init__(
        self, count: int, control_period: float, vehicle: PlantParameters, sheet: DataSheet
    ) -> None:
        super().__init__(count, control_period)
        self._filter = PoseFilter.of(sheet, control_period, True)
        self._belts = PseudoKinematicModel(vehicle)
        # error (N, 3), age (N,) of the pose, mean motion (N, 3), what is known of the gyro,
        # whether a pose has come (N,)
        self._memories = (
            np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3)), np.zeros((count, GYRO)),
            np.zeros(count, bool),
        )  # fmt: skip

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """RECKONED (N, F); rows with `start` forget."""
        for values in self._memories:
            values[start] = 0
        sprockets = observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]
        motion, alpha = self._belts.motion(np.nan_to_num(sprockets))
        memory = PoseMemory(*self._memories)
        locate(observation, motion, alpha, self._filter, memory, np.empty((self.count, 4)))
        return (np.column_stack([-memory.error, motion[:, 0]]) / _SCALE).astype(np.float32)

    def memories(self) -> Any:
        """A copy of all that is remembered."""
        return tuple(values.copy() for values in self._memories)

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        for own, given in zip(self._memories, memories, strict=True):
            if own.shape != np.shape(given):
                raise ValueError(f"state of shape {np.shape(given)}; must be {own.shape}")
        where = slice(None) if rows is None else rows
        for own, given in zip(self._memories, memories, strict=True):
            own[where] = given[where]


# What is known, and what is shown as 1 [SI].
KNOWN = {
    "filtered_error_x": 0.05, "filtered_error_y": 0.05, "filtered_heading_error": 0.1,
    "log_friction": 1.0, "friction_uncertainty": 0.1,
    "slip_velocity_left": 0.1, "slip_velocity_right": 0.1, "slip_angle": 0.1,
}  # fmt: skip
_KNOWN_SCALE = np.array(list(KNOWN.values()))


def known_features(observation: Floats, policy: AdaptiveSlipPolicy, error: Any) -> Floats:
    """KNOWN (N, F) after a call of the policy; error: its filtered pose error, (N, 3)."""
    mu, sigma = policy.estimator.estimates()["friction"]
    left, right = (observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]).T
    nominal = policy.nominal_friction
    slip = policy.estimator.slip(np.nan_to_num(left), np.nan_to_num(right))
    values = np.stack([*np.asarray(error).T, np.log(mu / nominal), sigma / mu, *slip], axis=1)
    return (values / _KNOWN_SCALE).astype(np.float32)


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


# Standard deviations of the filtered pose and what is shown as 0 [SI]: how far to trust it, by
# which sensors differ. Logarithms, as they reach from millimetres to metres.
TRUSTED = {"filtered_position_log_deviation": 0.05, "filtered_yaw_log_deviation": 0.01}
ESTIMATED = (*FILTERED, *TRUSTED, *FEATURES)
_WANTED = [layout.INDEX["reference_speed"], layout.INDEX["reference_yaw_rate"]]


def estimated_features(
    observation: Floats, known: Identification, nominal: PlantParameters
) -> Floats:
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
        return ESTIMATED

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Filtered errors and estimates, (N, F); rows with `start` forget."""
        return estimated_features(observation, self.update(observation, start), self.parameters)

    def freeze(self, rows: Bools) -> None:
        """No controller that could learn."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class IdentifyingPolicy(Protocol):
    """A controller that says what it has identified, as `adaptive` does."""

    identification: Identification | None  # after the last call
    parameters: PlantParameters  # nominal ones

    def predict(self, observation: Any, state: Any, episode_start: Any) -> tuple[Floats, Any]:
        """Action and state."""
        ...


class Residual(HeldState):
    """An adaptive policy, whose action the agent corrects; its estimates are features too.

    control_period [s]. scale [-]: how far the agent may move an action, over the torque limit.
    needs: fields of the observation that the policy reads.
    """

    feature_names = ("adaptive_left", "adaptive_right", *ESTIMATED)
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
        assert self.policy.identification is not None
        known = estimated_features(observation, self.policy.identification, self.policy.parameters)
        return np.concatenate([action, known], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The adaptive policy's action plus the agent's, scaled, within [-1, 1]."""
        return corrected(features[:, :2], self.scale, action)


def make_controlled(
    kind: str, options: Mapping[str, Any], context: Context, count: int
) -> Augmentation:
    """An augmentation of this file, without the data sheet. Raises ValueError."""
    sheet, vehicle = DataSheet.of(context.sensors), VEHICLES[context.vehicle]
    if kind == "reckoned":
        return Reckoned(count, context.control_period, vehicle, sheet)
    scale = options.get("scale", RESIDUAL_SCALE)
    if context.drive == "speed":
        if "base" in options:
            raise ValueError(
                f"base = {options['base']!r} on a vehicle driven by its sprocket speeds; must be "
                "left out: there a residual agent corrects slc-adaptive"
            )
        # A View gives it the fields of V0, and those that it needs besides behind them.
        names = (*NAMES, *ATTITUDE) if shows_attitude(context.observation) else NAMES
        gains_of = LyapunovGains(*options["gains"]) if "gains" in options else None
        driver = AdaptiveSlipPolicy(
            vehicle, context.control_period, sheet, gains=gains_of, observation=names
        )
        if kind == "estimates":
            return SlipEstimates(driver, count)
        return SlipResidual(driver, count, scale)
    if kind == "estimates":
        return Estimates(vehicle, context.control_period, sheet, count, context.lateral)
    if "base" in options and options["base"] != BASE:
        policy, needs = _base(options["base"], context), NAMES  # that may look ahead
    else:
        gains = Gains(*options.get("gains", ()))
        policy = AdaptivePolicy(vehicle, context.control_period, sheet, context.lateral, gains)
        needs = tuple(dict.fromkeys((*CONTROLLER_NEEDS, *policy.stack.needs)))
    return Residual(policy, count, context.control_period, scale, needs)


class _Plain(NamedTuple):
    """A context in which the base policy of a residual agent is made: it is given V0."""

    control_period: float
    lateral: str
    sensors: Any
    drive: str
    vehicle: str
    observation: Sequence[str] = NAMES


def _base(name: str, context: Context) -> IdentifyingPolicy:
    """The policy that a residual agent corrects.

    Raises ValueError for a name that is not registered, and for a policy that identifies nothing.
    """
    if name not in POLICIES:
        raise ValueError(f"base = {name!r}; must be a registered policy: {', '.join(POLICIES)}")
    plain = _Plain(*(getattr(context, field) for field in _Plain._fields[:-1]))
    policy = POLICIES[name](plain)
    if not hasattr(policy, "identification"):
        raise ValueError(f"base = {name!r} identifies nothing; must be adaptive or mpc-adaptive")
    base: IdentifyingPolicy = policy
    return base
