"""What an agent has besides the present observation: kinds of memory and help.

    blind       nothing: one policy for all vehicles and soils
    history     what was measured and done some steps ago, at lags that double
    estimates   the filtered motion, the identified parameters and how sure they are
    residual    the estimates and the adaptive controller's action; the agent only corrects it
Each is an observer of N vehicles as `tracked_env.wrappers` has it: it turns observations into
features that are appended to them. `command` turns the agent's action into the vehicle's. Training
(`AgentVectorEnv`) and evaluation (`agents.policy`) run the same object, so they cannot differ.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from agents.held import HeldState
from agents.slip_memory import SlipEstimates, SlipResidual
from baselines.estimators.sensor_samples import DataSheet
from baselines.estimators.stack import FEATURES, Identification, IdentificationStack, features
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from tracked_env import observation as layout
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.parameters import VEHICLES, PlantParameters
from tracked_env.wrappers import FEATURE_BOUND, IdentifiedVectorObservation, Observer, joined

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

LAGS = (1, 2, 4, 8, 16, 32)  # [control steps] 20 ms to 0.64 s: drive, sensor delay, slow pole
# What shows the vehicle's response; references and ages of the past say nothing about it.
REMEMBERED = (
    "position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate",
    "acceleration_x", "acceleration_y", "yaw_acceleration", "sprocket_speed_left",
    "sprocket_speed_right", "torque_left", "torque_right", "previous_action_left",
    "previous_action_right",
)  # fmt: skip
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
RESIDUAL_SCALE = 0.3  # [-] of the torque limit, how far the agent may correct the controller


class Memory(Observer, Protocol):
    """An observer that also says how the agent's action becomes the vehicle's."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The vehicle's action (N, 2) in [-1, 1] from the agent's and the present features."""
        ...


def seen(observation: Floats, features: Floats) -> Floats:
    """What the network sees: observation (N, SIZE) and features, 0 for what is not measured."""
    return np.nan_to_num(joined(observation, features), copy=False)


class Blind:
    """No memory. count: number of vehicles. control_period [s]."""

    feature_names: tuple[str, ...] = ()

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

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class History(Blind):
    """Past samples of REMEMBERED at LAGS; before an episode's first, its first one.

    `memory` (N, longest lag + 1, fields) holds the latest samples, the newest first.
    """

    def __init__(self, count: int, control_period: float, lags: tuple[int, ...] = LAGS) -> None:
        """Raises ValueError unless the lags rise from 1 on."""
        super().__init__(count, control_period)
        if not lags or list(lags) != sorted(set(lags)) or lags[0] < 1:
            raise ValueError(f"lags = {lags}; must rise, from 1 control step on")
        self._lags = np.array(lags)
        self._columns = np.array([layout.INDEX[name] for name in REMEMBERED])
        self.feature_names = tuple(f"{name}_{lag}_before" for lag in lags for name in REMEMBERED)
        self.memory: Floats = np.zeros((count, lags[-1] + 1, len(REMEMBERED)), dtype=np.float32)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The samples at the lags, (N, lags * fields); rows with `start` forget."""
        sample = np.nan_to_num(observation[:, self._columns])
        self.memory[:, 1:] = self.memory[:, :-1]
        self.memory[:, 0] = sample
        if start.any():
            self.memory[start] = sample[start, None]
        return self.memory[:, self._lags].reshape(self.count, -1)

    def memories(self) -> Any:
        """A copy of the samples."""
        return self.memory.copy()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if np.shape(memories) != self.memory.shape:
            raise ValueError(f"state of shape {np.shape(memories)}; must be {self.memory.shape}")
        where = slice(None) if rows is None else rows
        self.memory[where] = memories[where]


def known_features(observation: Floats, known: Identification, nominal: PlantParameters) -> Floats:
    """FILTERED errors, TRUSTED deviations, the estimates as `stack.features` shows them, (N, F).

    The filtered pose is several times less noisy than the measured one, and centimetres, which
    the observation shows as hundredths, are of order one here.
    """
    motion, reference = known.motion, known.reading.reference
    ahead_x, ahead_y = reference[:, 0] - motion.x, reference[:, 1] - motion.y
    cosine, sine = np.cos(motion.yaw), np.sin(motion.yaw)
    wanted = observation[:, _WANTED] * layout.SCALE[_WANTED]
    errors = (
        cosine * ahead_x + sine * ahead_y,
        cosine * ahead_y - sine * ahead_x,
        wrap_angle(reference[:, 2] - motion.yaw),
        wanted[:, 0] - motion.v_x,
        motion.v_y,
        wanted[:, 1] - motion.yaw_rate,
    )
    scaled = np.stack(errors, axis=-1) / np.array(list(FILTERED.values()))
    position = np.hypot(known.slip.deviation("x"), known.slip.deviation("y"))
    deviations = np.stack([position, known.slip.deviation("yaw")], axis=-1)
    trusted = np.log(deviations / np.array(list(TRUSTED.values())))
    return np.concatenate([scaled, trusted, features(known, nominal)], axis=1, dtype=np.float32)


class Estimates(IdentificationStack):
    """What the identification stack knows, as features."""

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of what `observe` returns."""
        return KNOWN

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Filtered errors and estimates, (N, F); rows with `start` forget."""
        return known_features(observation, self.update(observation, start), self.parameters)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class Residual(HeldState):
    """The adaptive policy, whose action the agent corrects; its estimates are features too.

    scale [-]: how far the agent may move an action, over the torque limit.
    """

    feature_names = ("adaptive_left", "adaptive_right", *KNOWN)

    def __init__(self, policy: AdaptivePolicy, count: int, scale: float = RESIDUAL_SCALE) -> None:
        """Raises ValueError for a scale outside (0, 2]."""
        if not 0.0 < scale <= 2.0:
            raise ValueError(f"residual scale = {scale}; must be in (0, 2]: actions lie in [-1, 1]")
        self.count, self.scale = count, scale
        self.policy = policy
        self.control_period = policy.controller.control_period

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Action of the adaptive policy, then the features of its estimates, (N, F)."""
        action, self._state = self.policy.predict(observation, self._state, start)
        assert self.policy.known is not None
        known = known_features(observation, self.policy.known, self.policy.parameters)
        return np.concatenate([action, known], axis=1)

    def command(self, action: Floats, features: Floats) -> Floats:
        """The adaptive policy's action plus the agent's, scaled, within [-1, 1]."""
        return np.clip(features[:, :2] + np.float32(self.scale) * action, -1.0, 1.0)


KINDS = ("blind", "history", "estimates", "residual")


def make_memory(
    kind: str, options: Mapping[str, Any], context: PolicyContext, count: int
) -> Memory:
    """A fresh memory of `count` vehicles. options: `lags` of history, `scale` of residual.

    Raises ValueError for an unknown kind or option.
    """
    known = {"history": {"lags"}, "residual": {"scale"}}.get(kind, set())
    if kind not in KINDS or set(options) - known:
        raise ValueError(
            f"memory {kind!r} with options {dict(options)}; kinds are {', '.join(KINDS)}, "
            "options `lags` of history and `scale` of residual"
        )
    if kind == "blind":
        return Blind(count, context.control_period)
    if kind == "history":
        return History(count, context.control_period, tuple(options.get("lags", LAGS)))
    sheet, vehicle = DataSheet.of(context.sensors), VEHICLES[context.vehicle]
    if context.drive == "speed":
        driver = AdaptiveSlipPolicy(vehicle, context.control_period, sheet)
        if kind == "estimates":
            return SlipEstimates(driver, count)
        return SlipResidual(driver, count, options.get("scale", RESIDUAL_SCALE))
    if kind == "estimates":
        return Estimates(vehicle, context.control_period, sheet, count, context.lateral)
    policy = AdaptivePolicy(vehicle, context.control_period, sheet, context.lateral)
    return Residual(policy, count, **options)


class AgentVectorEnv(IdentifiedVectorObservation):
    """A vector env as the agent lives in it: widened observations, its own actions."""

    observer: Memory

    def step(self, actions: Floats) -> tuple[Floats, NDArray[np.float64], Bools, Bools, Any]:
        """Advance all rows by the commands that follow from the agent's actions (N, 2)."""
        commands = self.observer.command(np.asarray(actions, np.float32), self._features)
        observation, reward, terminated, truncated, info = super().step(commands)
        for last in info.get("final_obs", ()):
            if last is not None:
                np.nan_to_num(last, copy=False)
        return np.nan_to_num(observation, copy=False), reward, terminated, truncated, info

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start episodes on all rows, or on those of `options["reset_mask"]`."""
        observation, info = super().reset(seed=seed, options=options)
        return np.nan_to_num(observation, copy=False), info

    def snapshot(self) -> Any:
        """All that is remembered, to go on from later."""
        return self.observer.memories(), self._features.copy(), self._over.copy()

    def resume(self, snapshot: Any) -> None:
        """Go on from what `snapshot` returned."""
        memories, self._features, self._over = snapshot
        self.observer.restore(memories)


__all__ = [
    "FEATURE_BOUND", "KINDS", "LAGS", "REMEMBERED", "RESIDUAL_SCALE", "AgentVectorEnv", "Blind",
    "Estimates", "History", "Memory", "Residual", "make_memory", "seen",
]  # fmt: skip
