"""Observation augmentation: what an agent sees besides the present observation, by kind.

    blind       nothing: one policy for all vehicles and soils
    history     what was measured and done some steps ago, at lags that double
    estimates   the filtered motion, the identified parameters and their standard deviations
    residual    the estimates and the adaptive controller's action; the agent only corrects it
An augmentation turns the observations of N vehicles into features that are appended to them, as
the observers of `tracked_env.wrappers` do. `command` turns the agent's action into the vehicle's.
Training and driving (`baselines.learned.agent_policy`) use the same object, so they cannot differ.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.sensor_samples import DataSheet
from baselines.learned.history_augmentation import LAGS, Blind, History
from baselines.learned.speed_augmentation import SlipEstimates, SlipResidual
from baselines.learned.torque_augmentation import Estimates, Residual
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from baselines.lyapunov.slope_errors import ATTITUDE, shows_attitude
from baselines.registry import Context
from tracked_env.observation import NAMES, joined
from tracked_env.physics.parameters import VEHICLES

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

KINDS = ("blind", "history", "estimates", "residual")
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
    return np.nan_to_num(joined(observation, features), copy=False)


def make_augmentation(
    kind: str, options: Mapping[str, Any], context: Context, count: int
) -> Augmentation:
    """A fresh augmentation of `count` vehicles. options: `lags` of history, `scale` of residual,
    and `gains` of the controller that drives by torques, by default those of the paper: agents
    without them in their archive were trained on these.

    Raises ValueError for an unknown kind or option.
    """
    known = {"history": {"lags"}, "residual": {"scale", "gains"}}.get(kind, set())
    if kind not in KINDS or set(options) - known:
        raise ValueError(
            f"augmentation {kind!r} with options {dict(options)}; kinds are {', '.join(KINDS)}, "
            "options `lags` of history, `scale` and `gains` of residual"
        )
    if kind == "blind":
        return Blind(count, context.control_period)
    if kind == "history":
        return History(count, context.control_period, tuple(options.get("lags", LAGS)))
    scale = options.get("scale", RESIDUAL_SCALE)
    sheet, vehicle = DataSheet.of(context.sensors), VEHICLES[context.vehicle]
    if context.drive == "speed":
        # A View gives it the fields of V0, and those that it needs besides behind them.
        names = (*NAMES, *ATTITUDE) if shows_attitude(context.observation) else NAMES
        driver = AdaptiveSlipPolicy(vehicle, context.control_period, sheet, observation=names)
        if kind == "estimates":
            return SlipEstimates(driver, count)
        return SlipResidual(driver, count, scale)
    if kind == "estimates":
        return Estimates(vehicle, context.control_period, sheet, count, context.lateral)
    gains = Gains(*options.get("gains", ()))
    policy = AdaptivePolicy(vehicle, context.control_period, sheet, context.lateral, gains)
    return Residual(policy, count, scale)
