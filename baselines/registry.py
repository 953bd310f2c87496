"""Named policies for the benchmark: the knowledge that each has of the vehicle and its soil.

    nominal   the feedback-linearizing controller with the nominal parameters, right or wrong
    integral  the same with the filter of the adaptive policy and integral action: what a
              practitioner tries who does not identify anything
    l1, mrac  the same controller with L1 adaptive and model-reference adaptive augmentation, behind
              the same filter
    adaptive  the same controller with the parameters that it identifies under way
    oracle    the adaptive policy, handed the true parameters at every step: what perfect
              identification would reach. It measures, and filters, like the adaptive one.
    mpc-nominal, mpc-adaptive, mpc-oracle   model predictive control with nominal, identified and
              true parameters, behind the same filter
For vehicles driven by their sprocket speeds:
    uc            the Lyapunov controller of a unicycle: slip is not known
    slc           the slippage-aware one, slip identified beforehand on the nominal soil
    slc-adaptive  the same controller with the slip of the friction that it identifies under way
    slc-oracle    the same controller with the slip of the true soil
Where the observation shows the goal (group `goal`), beside these
    slc-replan    slc-adaptive on plans of its own to the goal, a new one every second
    slc-once      the same with one plan, made at the start
Where the observation shows the attitude (`tracked_env/Terrain-v0`) all of them track in the plane
of the vehicle, and the slip is that on the slope that is felt, but for
    slc-flat      slc with the slip that the nominal soil has on level ground
A factory takes a context with `control_period` [s], `lateral` (its model), `sensors` (data sheet:
the noise of the sensors, which every policy may use), `drive`, `vehicle`, and `observation` (names
of its fields). `register` adds a controller.

Beside them are the trained agents that come with this package, one archive per seed. The source
distribution leaves the archives out; an installation that was built from it has their names alone.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from baselines.augmented import L1Policy, L1Settings, MracPolicy, MracSettings
from baselines.augmented import l1 as l1_policy
from baselines.augmented import mrac as mrac_policy
from baselines.batch_policy import Context, shows_attitude
from baselines.estimators.measurement import DataSheet
from baselines.linearizing import (
    TUNED_GAINS,
    AdaptivePolicy,
    FeedbackLinearizingController,
    IntegralPolicy,
    OraclePolicy,
    linearizing_law,
)
from baselines.linearizing.adaptive_policy import INTEGRAL_GAINS, INTEGRAL_TUNABLE
from baselines.lyapunov import (
    AdaptiveSlipPolicy,
    LyapunovGains,
    OracleSlipPolicy,
    SlippageAwarePolicy,
    UnicyclePolicy,
    lyapunov_laws,
)
from baselines.lyapunov.replanning import ReplanningPolicy
from baselines.lyapunov.slippage_aware import tuned_gains
from baselines.predictive.predictive_control import (
    NominalPredictivePolicy,
    PredictiveOraclePolicy,
    PredictivePolicy,
)
from baselines.predictive.sprocket_control import SETTINGS as SPROCKET_SETTINGS
from baselines.predictive.sprocket_control import (
    PredictiveAdaptiveSlipPolicy,
    PredictiveOracleSlipPolicy,
    PredictiveSlipPolicy,
)
from baselines.predictive.stages import TUNABLE as PREDICTIVE_TUNABLE
from baselines.predictive.stages import PredictiveSettings
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip
from tracked_env.physics.parameters import VEHICLES

PRETRAINED = Path(__file__).resolve().parent / "learned" / "pretrained"
SCORES = "scores.json"  # per environment: {"seeds": {name: ...}}, of every shipped agent
FOLDERS = {"torque": "Torque-v0", "speed": "Speed-v0"}

_SEEDED = re.compile(r"(.+)-seed(\d+)")


def shipped_agents(env: str) -> dict[str, list[Path]]:
    """Archives of PRETRAINED for an environment, its id or a drive, by the name of the agent."""
    archives: dict[str, list[Path]] = {}
    folder = PRETRAINED / FOLDERS.get(env, env.rpartition("/")[2])
    for path in sorted(folder.glob("*/agent.zip")):
        match = _SEEDED.fullmatch(path.parent.name)
        archives.setdefault(match[1] if match else path.parent.name, []).append(path)
    scores = folder / SCORES
    if not archives and scores.is_file():
        return {name: [] for name in json.loads(scores.read_text(encoding="utf-8"))["seeds"]}
    return archives


def _arguments(context: Context, drive: str) -> dict[str, Any]:
    """Arguments of a policy that commands `drive`. Raises ValueError in an environment of another
    drive."""
    if context.drive != drive:
        raise ValueError(
            f"this policy commands each sprocket's {drive}, the environment takes its "
            f"{context.drive}; policies for that are {', '.join(BY_DRIVE[context.drive])}"
        )
    lateral: dict[str, Any] = {"lateral": context.lateral} if drive == "torque" else {}
    return lateral | {
        "parameters": VEHICLES[context.vehicle],
        "control_period": context.control_period,
        "data_sheet": DataSheet.of(context.sensors),
        "observation": context.observation,
    }


def tunable(ranges: Mapping[str, tuple[float, float, bool]], settings: Any) -> Any:
    """Declare what `tracked-env tune` searches, see `tracked_env.benchmark.tuning`.

    ranges: TUNABLE of the controller. settings: its defaults, a NamedTuple, or a function of the
    context that returns them.
    """

    def declared(factory: Any) -> Any:
        factory.TUNABLE = ranges
        factory.SETTINGS = settings if callable(settings) else lambda context: settings
        return factory

    return declared


@tunable(linearizing_law.TUNABLE, TUNED_GAINS)
def nominal(context: Context, **settings: float) -> FeedbackLinearizingController:
    """The controller that trusts the nominal parameters."""
    arguments = _arguments(context, "torque")
    del arguments["data_sheet"]  # it filters nothing
    return FeedbackLinearizingController(**arguments, gains=TUNED_GAINS._replace(**settings))


@tunable(INTEGRAL_TUNABLE, INTEGRAL_GAINS)
def integral(context: Context, **settings: float) -> IntegralPolicy:
    """The controller with nominal parameters, the filter and integral action."""
    gains = INTEGRAL_GAINS._replace(**settings)
    return IntegralPolicy(**_arguments(context, "torque"), gains=gains)


@tunable(l1_policy.TUNABLE, L1Settings())
def l1(context: Context, **settings: float) -> L1Policy:
    """The controller with L1 adaptive augmentation."""
    return L1Policy(**_arguments(context, "torque"), settings=L1Settings(**settings))


@tunable(mrac_policy.TUNABLE, MracSettings())
def mrac(context: Context, **settings: float) -> MracPolicy:
    """The controller with model-reference adaptive augmentation."""
    return MracPolicy(**_arguments(context, "torque"), settings=MracSettings(**settings))


@tunable(linearizing_law.TUNABLE, TUNED_GAINS)
def adaptive(context: Context, **settings: float) -> AdaptivePolicy:
    """The controller that identifies vehicle and soil under way."""
    return AdaptivePolicy(**_arguments(context, "torque"), gains=TUNED_GAINS._replace(**settings))


@tunable(linearizing_law.TUNABLE, TUNED_GAINS)
def oracle(context: Context, **settings: float) -> OraclePolicy:
    """The controller that knows the true parameters."""
    return OraclePolicy(**_arguments(context, "torque"), gains=TUNED_GAINS._replace(**settings))


def lyapunov_gains(context: Context) -> LyapunovGains:
    """Gains of the policies that command speeds."""
    return tuned_gains(context.observation)


def _with_gains(context: Context, settings: Mapping[str, float]) -> dict[str, Any]:
    gains = lyapunov_gains(context)._replace(**settings)
    return {"gains": gains, **_arguments(context, "speed")}


@tunable(lyapunov_laws.TUNABLE, lyapunov_gains)
def uc(context: Context, **settings: float) -> UnicyclePolicy:
    """The controller of a unicycle without slip."""
    return UnicyclePolicy(**_with_gains(context, settings))


@tunable(lyapunov_laws.TUNABLE, lyapunov_gains)
def slc(context: Context, **settings: float) -> SlippageAwarePolicy:
    """The slippage-aware controller that trusts the slip of the nominal soil."""
    if not shows_attitude(context.observation):
        return slc_flat(context, **settings)
    arguments = _with_gains(context, settings)
    return SlippageAwarePolicy(
        slip_model=identified_slope_slip(arguments["parameters"]), **arguments
    )


@tunable(lyapunov_laws.TUNABLE, lyapunov_gains)
def slc_flat(context: Context, **settings: float) -> SlippageAwarePolicy:
    """The slippage-aware controller that trusts the slip of the nominal soil on level ground."""
    arguments = _with_gains(context, settings)
    return SlippageAwarePolicy(slip_model=identified_slip(arguments["parameters"]), **arguments)


@tunable(lyapunov_laws.TUNABLE, lyapunov_gains)
def slc_adaptive(context: Context, **settings: float) -> AdaptiveSlipPolicy:
    """The slippage-aware controller that identifies the friction under way."""
    return AdaptiveSlipPolicy(**_with_gains(context, settings))


@tunable(lyapunov_laws.TUNABLE, lyapunov_gains)
def slc_oracle(context: Context, **settings: float) -> OracleSlipPolicy:
    """The slippage-aware controller that knows the true soil."""
    return OracleSlipPolicy(**_with_gains(context, settings))


def slc_replan(context: Context) -> ReplanningPolicy:
    """The slippage-aware controller that plans to the goal again every second."""
    return ReplanningPolicy(**_arguments(context, "speed"))


def slc_once(context: Context) -> ReplanningPolicy:
    """The same controller with one plan, made at the start."""
    return ReplanningPolicy(**_arguments(context, "speed"), replan_period=math.inf)


def _predictive(context: Context, settings: Mapping[str, float]) -> dict[str, Any]:
    chosen = predictive_settings(context)._replace(**settings)
    return {**_arguments(context, context.drive), "settings": chosen}


def predictive_settings(context: Context) -> PredictiveSettings:
    """Weights and horizon of the predictive controllers, by what the actions are."""
    return PredictiveSettings() if context.drive == "torque" else SPROCKET_SETTINGS


@tunable(PREDICTIVE_TUNABLE, predictive_settings)
def mpc_nominal(context: Context, **settings: float) -> Any:
    """Model predictive control with the nominal parameters, or the slip of the nominal soil."""
    arguments = _predictive(context, settings)
    if context.drive == "torque":
        return NominalPredictivePolicy(**arguments)
    return PredictiveSlipPolicy(slip_model=identified_slip(arguments["parameters"]), **arguments)


@tunable(PREDICTIVE_TUNABLE, predictive_settings)
def mpc_adaptive(context: Context, **settings: float) -> Any:
    """Model predictive control that identifies vehicle and soil under way."""
    by_torque = context.drive == "torque"
    kind = PredictivePolicy if by_torque else PredictiveAdaptiveSlipPolicy
    return kind(**_predictive(context, settings))


@tunable(PREDICTIVE_TUNABLE, predictive_settings)
def mpc_oracle(context: Context, **settings: float) -> Any:
    """Model predictive control that knows the true parameters."""
    by_torque = context.drive == "torque"
    kind = PredictiveOraclePolicy if by_torque else PredictiveOracleSlipPolicy
    return kind(**_predictive(context, settings))


POLICIES: dict[str, Callable[[Any], Any]] = {
    "nominal": nominal,
    "integral": integral,
    "l1": l1,
    "mrac": mrac,
    "adaptive": adaptive,
    "oracle": oracle,
    "mpc-nominal": mpc_nominal,
    "mpc-adaptive": mpc_adaptive,
    "mpc-oracle": mpc_oracle,
    "uc": uc,
    "slc": slc,
    "slc-flat": slc_flat,
    "slc-adaptive": slc_adaptive,
    "slc-oracle": slc_oracle,
    "slc-replan": slc_replan,
    "slc-once": slc_once,
}


def register(name: str, factory: Callable[[Any], Any]) -> None:
    """Add a controller: factory(context) makes a fresh one, see the head of the file.

    From then on it has a name for the benchmark. Raises ValueError for a name that is taken.
    """
    if name in POLICIES:
        raise ValueError(f"policy {name!r} is registered already; known are {sorted(POLICIES)}")
    POLICIES[name] = factory


PREDICTIVE = ("mpc-nominal", "mpc-adaptive", "mpc-oracle")  # for either kind of drive
# Those for each kind of drive, from the least to the most that is known.
BY_DRIVE = {
    "torque": ("nominal", "integral", "l1", "mrac", "adaptive", "oracle", *PREDICTIVE),
    "speed": ("uc", "slc", "slc-adaptive", "slc-oracle", *PREDICTIVE),
}


# Environments that policies are compared on by default, beside those of each drive.
_ON_SLOPES = ("uc", "slc-flat", "slc", "slc-adaptive", "slc-oracle")
BY_ENVIRONMENT = {**BY_DRIVE, "tracked_env/Terrain-v0": _ON_SLOPES}


def policies() -> dict[str, dict[str, Any]]:
    """Controllers and shipped agents per drive or environment id, as the entry point registers."""
    return {
        env: {**{name: POLICIES[name] for name in names}, **shipped_agents(env)}
        for env, names in BY_ENVIRONMENT.items()
    }
