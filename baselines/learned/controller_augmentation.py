"""Observation augmentations with a filter or a controller of this project beside the agent.

reckoned    the pose error by the dead reckoning of the Lyapunov controllers, and the belts' speed:
            gyro and velocity, or belts without slip where no velocity is measured, pulled towards
            the samples of the pose. It knows nothing of soil, mass or slip
estimates   vehicles driven by torque: the filtered motion, the identified parameters and their
            standard deviations; driven by sprocket speeds: the filtered errors, the friction
            and slip that the slippage-aware controller knows
residual    the estimates and the adaptive controller's action; the agent only corrects it
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from baselines.batch_policy import Context, body_errors, shows_attitude
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import FEATURES, Identification, IdentificationStack, features
from baselines.learned.augmentation import (
    BASE,
    FILTERED,
    RECKONED,
    RESIDUAL_SCALE,
    Augmentation,
    Bools,
    Floats,
    PlainContext,
    merge_rows,
)
from baselines.linearizing import linearizing_policy
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.lyapunov import pose_filter
from baselines.lyapunov.lyapunov_laws import LyapunovGains, PseudoKinematicModel
from baselines.lyapunov.slippage_aware import AdaptiveSlipPolicy
from baselines.registry import POLICIES
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters

_SCALE = np.array(list(RECKONED.values()))
_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]


class Reckoned(Augmentation):
    """The reckoned pose error as features; the agent drives.

    count, control_period: as Augmentation. vehicle: nominal. sheet: of the sensors.
    """

    feature_names = tuple(RECKONED)
    needs = (*pose_filter.POSE, "pose_age", *_BELTS, *pose_filter.PATH)

    def __init__(
        self, count: int, control_period: float, vehicle: PlantParameters, sheet: DataSheet
    ) -> None:
        super().__init__(count, control_period)
        self._filter = pose_filter.PoseFilter.of(sheet, control_period, True)
        self._belts = PseudoKinematicModel(vehicle)
        self._memory = self._poses = pose_filter.PoseMemory.blank(count)

    def features(self, observation: Floats, start: Bools) -> Floats:
        """RECKONED (N, F); rows with `start` forget."""
        for values in self._memory:
            values[start] = 0
        sprockets = observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]
        motion, alpha = self._belts.motion(np.nan_to_num(sprockets))
        unused = np.empty((self.count, 4))
        pose_filter.locate(observation, motion, alpha, self._filter, self._poses, unused)
        return (np.column_stack([-self._poses.error, motion[:, 0]]) / _SCALE).astype(np.float32)


# What is known, and what is shown as 1 [SI].
SLIP_ESTIMATES = {
    "filtered_error_x": 0.05, "filtered_error_y": 0.05, "filtered_heading_error": 0.1,
    "log_friction": 1.0, "friction_uncertainty": 0.1,
    "slip_velocity_left": 0.1, "slip_velocity_right": 0.1, "slip_angle": 0.1,
}  # fmt: skip
_SLIP_SCALE = np.array(list(SLIP_ESTIMATES.values()))


def slip_features(observation: Floats, policy: AdaptiveSlipPolicy, state: Any) -> Floats:
    """SLIP_ESTIMATES (N, F) after a call of the policy, which returned `state`."""
    mu, sigma = policy.estimator.estimates()["friction"]
    left, right = (observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]).T
    nominal = policy.nominal_friction
    slip = policy.estimator.slip(np.nan_to_num(left), np.nan_to_num(right))
    values = np.stack(
        [*np.asarray(state.driving.error).T, np.log(mu / nominal), sigma / mu, *slip], axis=1
    )
    return (values / _SLIP_SCALE).astype(np.float32)


# Standard deviations of the filtered pose and what is shown as 0 [SI]: how far to trust it, by
# which sensors differ. Logarithms, as they reach from millimetres to metres.
TRUSTED = {"filtered_position_log_deviation": 0.05, "filtered_yaw_log_deviation": 0.01}
ESTIMATED = (*FILTERED, *TRUSTED, *FEATURES)
_WANTED = [layout.INDEX["reference_speed"], layout.INDEX["reference_yaw_rate"]]


def estimated_features(
    observation: Floats, identification: Identification, nominal: PlantParameters
) -> Floats:
    """FILTERED errors, TRUSTED deviations, FEATURES as `stack.features` shows them, (N, F).

    The filtered pose is several times less noisy than the measured one, and centimetres, which
    the observation shows as hundredths, are of order one here.
    """
    motion, reference = identification.motion, identification.reading.reference
    speed, yaw_rate = (observation[:, _WANTED] * layout.SCALE[_WANTED]).T
    errors = (
        *body_errors(reference.T, motion.x, motion.y, motion.yaw),
        speed - motion.v_x,
        motion.v_y,
        yaw_rate - motion.yaw_rate,
    )
    scaled = np.stack(errors, axis=-1) / np.array(list(FILTERED.values()))
    position = np.hypot(identification.slip.deviation("x"), identification.slip.deviation("y"))
    deviations = np.stack([position, identification.slip.deviation("yaw")], axis=-1)
    trusted = np.log(deviations / np.array(list(TRUSTED.values())))
    identified = features(identification, nominal, further=False)
    return np.concatenate([scaled, trusted, identified], axis=1, dtype=np.float32)


class Estimates(Augmentation):
    """What the identification stack knows, as features; the agent drives."""

    feature_names = ESTIMATED
    learned = FEATURES

    def __init__(self, stack: IdentificationStack) -> None:
        super().__init__(stack.count, stack.control_period)
        self.stack, self.needs = stack, stack.needs
        self.memories, self.restore = stack.memories, stack.restore  # type: ignore[method-assign]

    def features(self, observation: Floats, start: Bools) -> Floats:
        """Filtered errors and estimates, (N, F); rows with `start` forget."""
        identification = self.stack.update(observation, start)
        return estimated_features(observation, identification, self.stack.parameters)


class Beside(Augmentation):
    """What a controller knows, as features, and its action, where the agent corrects that.

    policy: of vehicles with this drive, as `adaptive` or `slc-adaptive`; its state never changes in
    place. needs: fields that it reads. scale [-]: how far the agent may move an action, over its
    limit; None: the agent drives. Raises ValueError for a scale outside (0, 2].
    """

    def __init__(
        self, policy: Any, context: Context, count: int, needs: tuple[str, ...], scale: float | None
    ) -> None:
        super().__init__(count, context.control_period)
        if scale is not None and not 0.0 < scale <= 2.0:
            raise ValueError(f"residual scale = {scale}; must be in (0, 2]: actions lie in [-1, 1]")
        self.policy, self.scale, self.needs = policy, scale, needs
        self._state: Any = None
        self._torque = context.drive == "torque"
        self.learned = FEATURES if self._torque else ()
        names = ESTIMATED if self._torque else tuple(SLIP_ESTIMATES)
        self.feature_names = names if scale is None else ("adaptive_left", "adaptive_right", *names)

    def features(self, observation: Floats, start: Bools) -> Floats:
        """The controller's action, where it is corrected, and what it knows, (N, F)."""
        policy = self.policy
        action, self._state = policy.predict(observation, self._state, start)
        if self._torque:
            values = estimated_features(observation, policy.identification, policy.parameters)
        else:
            values = slip_features(observation, policy, self._state)
        return values if self.scale is None else np.concatenate([action, values], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action; or the controller's plus that, scaled, within [-1, 1]."""
        if self.scale is None:
            return action
        return np.clip(features[:, :2] + np.float32(self.scale) * action, -1.0, 1.0)

    def freeze(self, rows: Bools) -> None:
        """The controller keeps what it knows in these rows (N,)."""
        self.policy.freeze(rows)

    def memories(self) -> Any:
        """The policy's state, None before the first observation."""
        return self._state

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if rows is None:
            self._state = memories
        elif rows.any():
            values = self._state is not None and memories is not None
            self._state = merge_rows(memories, self._state, rows) if values else memories


def make_controlled(
    kind: str, options: Mapping[str, Any], context: Context, count: int
) -> Augmentation:
    """An augmentation of this file, without the data sheet. Raises ValueError."""
    sheet, vehicle = DataSheet.of(context.sensors), context.vehicle
    nominal = vehicle, context.control_period, sheet
    if kind == "reckoned":
        return Reckoned(count, context.control_period, vehicle, sheet)
    scale = options.get("scale", RESIDUAL_SCALE) if kind == "residual" else None
    policy: Any
    if context.drive == "speed":
        if "base" in options:
            raise ValueError(
                f"base = {options['base']!r} on a vehicle driven by its sprocket speeds; must be "
                "left out: there a residual agent corrects slc-adaptive"
            )
        # A View gives it the fields of V0, and those that it needs besides behind them.
        slopes = shows_attitude(context.observation)
        names = (*layout.NAMES, *pose_filter.ATTITUDE) if slopes else layout.NAMES
        gains_of = LyapunovGains(*options["gains"]) if "gains" in options else None
        policy = AdaptiveSlipPolicy(*nominal, gains=gains_of, observation=names)
        return Beside(policy, context, count, policy.needs, scale)
    if kind == "estimates":
        return Estimates(IdentificationStack(*nominal, count, context.lateral))
    base = options.get("base", BASE)
    if base != BASE:
        if base not in POLICIES:
            raise ValueError(f"base = {base!r}; must be a registered policy: {', '.join(POLICIES)}")
        shared = (getattr(context, field) for field in PlainContext._fields[:-1])
        policy, needs = POLICIES[base](PlainContext(*shared)), layout.NAMES  # that may look ahead
        if not hasattr(policy, "identification"):
            raise ValueError(
                f"base = {base!r} identifies nothing; must be adaptive or mpc-adaptive"
            )
    else:
        policy = AdaptivePolicy(*nominal, context.lateral, Gains(*options.get("gains", ())))
        needs = tuple(dict.fromkeys((*linearizing_policy.NEEDS, *policy.stack.needs)))
    return Beside(policy, context, count, needs, scale)
