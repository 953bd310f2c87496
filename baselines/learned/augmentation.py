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
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.sensor_samples import DataSheet
from baselines.learned.history_augmentation import LAGS, Blind, History
from baselines.learned.reckoned_augmentation import Reckoned, WithDataSheet
from baselines.learned.speed_augmentation import SlipEstimates, SlipResidual
from baselines.learned.torque_augmentation import Estimates, IdentifyingPolicy, Residual
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from baselines.linearizing.linearizing_policy import NEEDS as CONTROLLER_NEEDS
from baselines.lyapunov.adaptive_slippage_aware import AdaptiveSlipPolicy
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.slope_errors import ATTITUDE, shows_attitude
from baselines.registry import POLICIES, Context
from tracked_env.observation import NAMES, joined
from tracked_env.physics.parameters import VEHICLES

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

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
    return np.nan_to_num(joined(observation, features), copy=False)


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
