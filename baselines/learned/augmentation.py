"""Observation augmentation: what an agent sees besides the present observation, by kind.

    blind       nothing: one policy for all vehicles and soils
    history     what was measured and done some steps ago, at lags that double
    reckoned    the pose error by dead reckoning with the belts, without any identification
    estimates   the filtered motion, the identified parameters and their standard deviations
    residual    the estimates and the adaptive controller's action; the agent only corrects it
Any of them can have the data sheet of the sensors behind its features.
An augmentation turns the observations of N vehicles into features that are appended to them, as
the observers of `tracked_env.wrappers` do. `command` turns the agent's action into the vehicle's.
Training and driving (`baselines.learned.agent_policy`) use the same object, so they cannot differ.

A controller that runs beside an agent: its state, put back in some rows, and its correction.

Observation augmentation without estimators: none, or samples of the past.

blind       nothing: one policy for all vehicles and soils
history     what was measured and done some steps ago, at lags that double

Observation augmentation by dead reckoning, and by the data sheet of the sensors.

reckoned    the pose error, carried on by the belts while no pose comes, and the speed of the belts
data sheet  the noise of the sensors, which controllers may read as well, behind the other features
Dead reckoning is that of the Lyapunov controllers (`baselines.lyapunov.slippage_aware`): gyro and
velocity, or belts without slip where no velocity is measured, pulled towards the samples of the
pose by the steady gain of the data sheet. It knows nothing of soil, mass or slip.

Observation augmentation for vehicles that are driven by their sprocket speeds.

    estimates   the filtered errors, the friction and slip that the slippage-aware controller knows
    residual    the same and that controller's action; the agent only corrects it
As `baselines.learned.augmentation`, of another controller.

Observation augmentation for vehicles that are driven by their sprocket torques.

estimates   the filtered motion, the identified parameters and their standard deviations
residual    the estimates and the adaptive controller's action; the agent only corrects it
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import FEATURES, Identification, IdentificationStack, features
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
from baselines.registry import POLICIES, Context
from tracked_env import observation as layout
from tracked_env.observation import NAMES, append_features
from tracked_env.physics.parameters import VEHICLES, PlantParameters

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


def chosen(old: Any, new: Any, rows: NDArray[np.bool_]) -> Any:
    """`old` in the rows marked, `new` in the others; arrays (N, ...), tuples of them, or None of
    a network that carries nothing on."""
    if old is None or new is None:
        return new if old is None else old
    if isinstance(old, tuple):
        parts = [chosen(one, other, rows) for one, other in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    return np.where(rows.reshape(-1, *[1] * (old.ndim - 1)), old, new)


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


LAGS = (1, 2, 4, 8, 16, 32)  # [control steps] 20 ms to 0.64 s: drive, sensor delay, slow pole
# What shows the vehicle's response; references and ages of the past say nothing about it.
REMEMBERED = (
    "position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate",
    "acceleration_x", "acceleration_y", "yaw_acceleration", "sprocket_speed_left",
    "sprocket_speed_right", "torque_left", "torque_right", "previous_action_left",
    "previous_action_right",
)  # fmt: skip


class Blind:
    """No augmentation. count: number of vehicles. control_period [s]."""

    feature_names: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    learned: tuple[str, ...] = ()

    def __init__(self, count: int, control_period: float) -> None:
        self.count = count
        self.control_period = control_period

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """No features, (N, 0)."""
        return np.empty((self.count, 0), dtype=np.float32)

    def memories(self) -> Any:
        """Nothing."""
        return ()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Nothing to put back."""

    def freeze(self, rows: Bools) -> None:
        """No controller that could learn."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class History(Blind):
    """Past samples of REMEMBERED at LAGS; before an episode's first, its first one.

    `samples` (N, longest lag + 1, fields) holds the latest ones, the newest first.
    """

    needs = REMEMBERED

    def __init__(self, count: int, control_period: float, lags: tuple[int, ...] = LAGS) -> None:
        """Raises ValueError unless the lags rise from 1 on."""
        super().__init__(count, control_period)
        if not lags or list(lags) != sorted(set(lags)) or lags[0] < 1:
            raise ValueError(f"lags = {lags}; must rise, from 1 control step on")
        self._lags = np.array(lags)
        self._columns = np.array([layout.INDEX[name] for name in REMEMBERED])
        self.learned = self.feature_names = tuple(
            f"{name}_{lag}_before" for lag in lags for name in REMEMBERED
        )
        self.samples: Floats = np.zeros((count, lags[-1] + 1, len(REMEMBERED)), dtype=np.float32)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The samples at the lags, (N, lags * fields); rows with `start` forget."""
        sample = np.nan_to_num(observation[:, self._columns])
        self.samples[:, 1:] = self.samples[:, :-1]
        self.samples[:, 0] = sample
        if start.any():
            self.samples[start] = sample[start, None]
        return self.samples[:, self._lags].reshape(self.count, -1)

    def memories(self) -> Any:
        """A copy of the samples."""
        return self.samples.copy()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if np.shape(memories) != self.samples.shape:
            raise ValueError(f"state of shape {np.shape(memories)}; must be {self.samples.shape}")
        where = slice(None) if rows is None else rows
        self.samples[where] = memories[where]


# Reckoned errors, reference minus vehicle in body axes, and the speed by the belts, and what is
# shown as 1 [SI].
RECKONED = {
    "reckoned_error_x": 0.2, "reckoned_error_y": 0.2, "reckoned_heading_error": 0.1,
    "belt_speed": 2.0,
}  # fmt: skip
_SCALE = np.array(list(RECKONED.values()))
_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]

# What the data sheet says, and what is shown as 0 [SI]: logarithms to base 10, because sensors
# differ from millimetres to metres.
SHEET = {
    "position_noise": 0.02, "yaw_noise": 0.005, "velocity_noise": 0.03, "gyro_bias": 0.001,
    "sprocket_speed_noise": 0.02,
}  # fmt: skip
_NO_NOISE = 1e-3  # of the value that is shown as 0: less is shown as this


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


def sheet_features(sheet: DataSheet) -> Floats:
    """SHEET of a data sheet, (F,)."""
    known = np.array([getattr(sheet, name) for name in SHEET]) / np.array(list(SHEET.values()))
    return np.log10(np.maximum(known, _NO_NOISE)).astype(np.float32)


class WithDataSheet:
    """Another augmentation, with the data sheet of the sensors behind its features."""

    def __init__(self, inner: Any, sheet: DataSheet) -> None:
        self.inner, self.count, self.control_period = inner, inner.count, inner.control_period
        self.needs = inner.needs
        self.feature_names = (*inner.feature_names, *SHEET)
        self.learned: tuple[str, ...] = inner.learned
        self._shown = np.tile(sheet_features(sheet), (inner.count, 1))

    def freeze(self, rows: Bools) -> None:
        """A controller inside keeps what it knows of these rows (N,)."""
        self.inner.freeze(rows)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The features of the other one, then SHEET, (N, F)."""
        return np.concatenate([self.inner.observe(observation, start), self._shown], axis=1)

    def memories(self) -> Any:
        """A copy of all that is remembered."""
        return self.inner.memories()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        self.inner.restore(memories, rows)

    def command(self, action: Floats, features: Floats) -> Floats:
        """As the other one."""
        command: Floats = self.inner.command(action, features)
        return command


# What is known, and what is shown as 1 [SI].
KNOWN = {
    "filtered_error_x": 0.05, "filtered_error_y": 0.05, "filtered_heading_error": 0.1,
    "log_friction": 1.0, "friction_uncertainty": 0.1,
    "slip_velocity_left": 0.1, "slip_velocity_right": 0.1, "slip_angle": 0.1,
}  # fmt: skip
_SCALE_SPEED_AUGMENTATION = np.array(list(KNOWN.values()))
_SPROCKETS_SPEED_AUGMENTATION = [
    layout.INDEX[n] for n in ("sprocket_speed_left", "sprocket_speed_right")
]


def known_features(observation: Floats, policy: AdaptiveSlipPolicy, error: Any) -> Floats:
    """KNOWN (N, F) after a call of the policy; error: its filtered pose error, (N, 3)."""
    mu, sigma = policy.estimator.estimates()["friction"]
    left, right = (
        observation[:, _SPROCKETS_SPEED_AUGMENTATION] * layout.SCALE[_SPROCKETS_SPEED_AUGMENTATION]
    ).T
    nominal = policy.nominal_friction
    slip = policy.estimator.slip(np.nan_to_num(left), np.nan_to_num(right))
    values = np.stack([*np.asarray(error).T, np.log(mu / nominal), sigma / mu, *slip], axis=1)
    return (values / _SCALE_SPEED_AUGMENTATION).astype(np.float32)


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


# Errors of the filtered motion, as the estimators know it, and what is shown as 1 [SI].
FILTERED = {
    "filtered_error_x": 0.2, "filtered_error_y": 0.2, "filtered_heading_error": 0.1,
    "filtered_speed_error": 0.2, "filtered_v_y": 0.2, "filtered_yaw_rate_error": 0.1,
}  # fmt: skip
# Standard deviations of the filtered pose and what is shown as 0 [SI]: how far to trust it, by
# which sensors differ. Logarithms, as they reach from millimetres to metres.
TRUSTED = {"filtered_position_log_deviation": 0.05, "filtered_yaw_log_deviation": 0.01}
KNOWN_TORQUE_AUGMENTATION = (*FILTERED, *TRUSTED, *FEATURES)
_WANTED = [layout.INDEX["reference_speed"], layout.INDEX["reference_yaw_rate"]]


def known_features_torque_augmentation(
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
        return KNOWN_TORQUE_AUGMENTATION

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Filtered errors and estimates, (N, F); rows with `start` forget."""
        return known_features_torque_augmentation(
            observation, self.update(observation, start), self.parameters
        )

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

    feature_names = ("adaptive_left", "adaptive_right", *KNOWN_TORQUE_AUGMENTATION)
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
        known = known_features_torque_augmentation(
            observation, self.policy.identification, self.policy.parameters
        )
        return np.concatenate([action, known], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The adaptive policy's action plus the agent's, scaled, within [-1, 1]."""
        return corrected(features[:, :2], self.scale, action)


KINDS = ("blind", "history", "reckoned", "estimates", "residual")
BASE = "adaptive"  # the policy that a residual agent corrects
RESIDUAL_SCALE = 0.3  # [-] of the torque limit, how far the agent may correct the controller


class Augmentation(Protocol):
    """An observer that also says how the agent's action becomes the vehicle's."""

    @property
    def count(self) -> int:
        """Number of vehicles."""

    @property
    def control_period(self) -> float:
        """Time [s] between two observations."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Fields of the observation that are read."""

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the F features."""

    @property
    def learned(self) -> tuple[str, ...]:
        """Names of the features that say what has been learned of the vehicle."""

    def freeze(self, rows: Bools) -> None:
        """A controller inside keeps what it knows of these rows (N,)."""

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Features (N, F) after observations (N, D); rows with `start` begin an episode."""

    def memories(self) -> Any:
        """A copy of all that is remembered."""

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The vehicle's action (N, 2) in [-1, 1] from the agent's and the present features."""


def seen(observation: Floats, features: Floats) -> Floats:
    """What the network sees: observation (N, SIZE) and features, 0 for what is not measured."""
    return np.nan_to_num(append_features(observation, features), copy=False)


def make_augmentation(
    kind: str, options: Mapping[str, Any], context: Context, count: int
) -> Augmentation:
    """A fresh augmentation of `count` vehicles.

    options: `lags` of history, `scale` and `base` of residual, and of all `data_sheet`, whether
    that of the sensors is shown. `gains` of residual are those of `adaptive` or `slc-adaptive`, by
    default the paper's (on slopes GAINS_ON_SLOPES): agents without them in their archive were
    trained on these. Raises ValueError for an unknown kind or option.
    """
    known = {"history": {"lags"}, "residual": {"scale", "base", "gains"}}.get(kind, set())
    if kind not in KINDS or set(options) - {*known, "data_sheet"}:
        raise ValueError(
            f"augmentation {kind!r} with options {dict(options)}; kinds are {', '.join(KINDS)}, "
            "options `lags` of history, `scale`, `base` and `gains` of residual, `data_sheet` of "
            "all"
        )
    made = _plain(kind, options, context, count)
    if options.get("data_sheet", False):
        return WithDataSheet(made, DataSheet.of(context.sensors))
    return made


def _plain(kind: str, options: Mapping[str, Any], context: Context, count: int) -> Augmentation:
    """An augmentation without the data sheet. Raises ValueError."""
    sheet, vehicle = DataSheet.of(context.sensors), VEHICLES[context.vehicle]
    if kind == "blind":
        return Blind(count, context.control_period)
    if kind == "history":
        return History(count, context.control_period, tuple(options.get("lags", LAGS)))
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
        chosen = LyapunovGains(*options["gains"]) if "gains" in options else None
        driver = AdaptiveSlipPolicy(
            vehicle, context.control_period, sheet, gains=chosen, observation=names
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
    if not hasattr(policy, "known"):
        raise ValueError(f"base = {name!r} identifies nothing; must be adaptive or mpc-adaptive")
    found: IdentifyingPolicy = policy
    return found
