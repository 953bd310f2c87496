"""Named policies for the benchmark: the knowledge that each has of the vehicle and its soil.

SUMMARIES says it of each. Those that command torques are one controller, the feedback-linearizing
one, but for `mpc-`; all but `nominal` stand behind the filter of `adaptive`. Those that command
sprocket speeds are Lyapunov controllers. Where the observation shows the attitude all track in the
plane of the vehicle, and the slip is that on the slope that is felt, but for `slc-flat`.
`slc-replan` and `slc-once` are for observations that show the goal (group `goal`). A factory takes
a `batch_policy.Context`; `register` adds a controller.

Beside them are the trained agents that come with this package, one archive per seed. The source
distribution leaves the archives out; an installation that was built from it has their names alone.
"""

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from baselines.augmented import mrac as mrac_policy
from baselines.augmented.augmented_policy import L1_TUNABLE, L1Policy, L1Settings
from baselines.augmented.mrac import MracPolicy, MracSettings
from baselines.batch_policy import Context, shows_attitude
from baselines.estimators.measurement import DataSheet
from baselines.linearizing import linearizing_law
from baselines.linearizing.adaptive_policy import (
    INTEGRAL_GAINS,
    INTEGRAL_TUNABLE,
    AdaptivePolicy,
    IntegralPolicy,
)
from baselines.linearizing.linearizing_law import TUNED_GAINS
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.linearizing.oracle_policy import MOTION, PARAMETERS, OraclePolicy
from baselines.lyapunov import lyapunov_laws
from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.replanning import ReplanningPolicy
from baselines.lyapunov.slippage_aware import (
    AdaptiveSlipPolicy,
    OracleSlipPolicy,
    SlippageAwarePolicy,
    UnicyclePolicy,
    tuned_gains,
)
from baselines.lyapunov.true_motion import (
    PredictiveTrueMotionSlipPolicy,
    TrueMotionSlipPolicy,
)
from baselines.predictive.predictive_control import (
    NominalPredictivePolicy,
    PredictiveOraclePolicy,
    PredictivePolicy,
)
from baselines.predictive.sprocket_control import (
    PredictiveAdaptiveSlipPolicy,
    PredictiveOracleSlipPolicy,
    PredictiveSlipPolicy,
    settings_for,
)
from baselines.predictive.stages import TUNABLE as PREDICTIVE_TUNABLE
from baselines.predictive.stages import PredictiveSettings
from baselines.slip.slip_sweep import identified_slip, identified_slope_slip

PRETRAINED = Path(__file__).resolve().parent / "learned" / "pretrained"
LEARNED = "mpc-learned-observer"  # of PRETRAINED: archives of observers
ANY = "any-vehicle"  # of PRETRAINED: archives of policies that are told no vehicle
SCORES = "scores.json"  # per environment: {"seeds": {name: ...}}, of every shipped agent
FOLDERS = {"torque": "Torque-v0", "speed": "Speed-v0"}

# Medians of what the laws of the sets torque-v4 draw, over the nominal value of their vehicle.
CENTRE = {
    **{"mass": 1.114, "inertia": 1.101, "cohesion": 0.163, "friction_angle": 0.954},
    **{"longitudinal_resistance": 0.702, "lateral_resistance": 0.835},
}
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


def _arguments(context: Context, drives: Sequence[str]) -> dict[str, Any]:
    """Arguments of a policy that commands one of `drives`. Raises ValueError in an environment of
    another drive."""
    if context.drive not in drives:
        raise ValueError(
            f"this policy commands each sprocket's {drives[0]}, the environment takes its "
            f"{context.drive}; policies for that are {', '.join(BY_DRIVE[context.drive])}"
        )
    lateral: dict[str, Any] = {"lateral": context.lateral} if context.drive == "torque" else {}
    return lateral | {
        "parameters": context.vehicle,
        "control_period": context.control_period,
        "data_sheet": DataSheet.of(context.sensors),
        "observation": context.observation,
    }


class _Controller:
    """A factory of a controller, and what `tracked-env tune` searches of it; it can be pickled.

    ranges: its TUNABLE (`tracked_env.benchmark.tuning`). settings: the defaults of its
    `argument`, a NamedTuple, or a function of the context that returns them; one with a method
    `for_vehicle` is of the vehicle for which it was tuned, and scaled to that of the context. slip:
    gives the slip model of a context where speeds are commanded. centre: factors on the parameters
    that it is told. kinds: its class, by drive.
    """

    def __init__(
        self,
        ranges: Any,
        settings: Any,
        argument: str,
        slip: Any = None,
        centre: Mapping[str, float] = MappingProxyType({}),
        **kinds: Any,
    ) -> None:
        self.TUNABLE, self._settings, self._argument = ranges, settings, argument
        self._slip, self._centre, self._kinds = slip, dict(centre), kinds

    def SETTINGS(self, context: Context) -> Any:
        """The defaults in a context."""
        return self._settings(context) if callable(self._settings) else self._settings

    def __call__(self, context: Context, **changes: float) -> Any:
        """A fresh controller. Raises ValueError in an environment of another drive."""
        told = {n: getattr(context.vehicle, n) * factor for n, factor in self._centre.items()}
        vehicle = context.vehicle._replace(**told)
        arguments = {**_arguments(context, [*self._kinds]), "parameters": vehicle}
        if self._slip is not None and context.drive == "speed":
            arguments["slip_model"] = self._slip(context)
        settings = self.SETTINGS(context)._replace(**changes)
        if hasattr(settings, "for_vehicle"):
            settings = settings.for_vehicle(vehicle)
        arguments[self._argument] = settings
        return self._kinds[context.drive](**arguments)


def lyapunov_gains(context: Context) -> LyapunovGains:
    """Gains of the policies that command speeds."""
    return tuned_gains(context.observation)


def predictive_settings(context: Context) -> PredictiveSettings:
    """Weights and horizon of the predictive controllers, by what the actions are."""
    if context.drive == "torque":
        return PredictiveSettings().for_pace(context.vehicle)
    return settings_for(context.vehicle)


def _unfiltered(data_sheet: DataSheet, **arguments: Any) -> FeedbackLinearizingController:
    return FeedbackLinearizingController(**arguments)


def _level_slip(context: Context) -> Any:
    return identified_slip(context.vehicle)


def _slip(context: Context) -> Any:
    sloped = shows_attitude(context.observation)
    return identified_slope_slip(context.vehicle) if sloped else _level_slip(context)


def slc_replan(context: Context) -> ReplanningPolicy:
    """See SUMMARIES."""
    return ReplanningPolicy(**_arguments(context, ["speed"]))


def slc_once(context: Context) -> ReplanningPolicy:
    """See SUMMARIES."""
    return ReplanningPolicy(**_arguments(context, ["speed"]), replan_period=math.inf)


_LINEARIZING = linearizing_law.TUNABLE, TUNED_GAINS, "gains"
_INTEGRAL = INTEGRAL_TUNABLE, INTEGRAL_GAINS, "gains"
_LYAPUNOV = lyapunov_laws.TUNABLE, lyapunov_gains, "gains"
_MPC = PREDICTIVE_TUNABLE, predictive_settings, "settings"
nominal = _Controller(*_LINEARIZING, torque=_unfiltered)
l1 = _Controller(L1_TUNABLE, L1Settings(), "settings", torque=L1Policy)
mrac = _Controller(mrac_policy.TUNABLE, MracSettings(), "settings", torque=MracPolicy)
adaptive = _Controller(*_LINEARIZING, torque=AdaptivePolicy)
oracle = _Controller(*_LINEARIZING, torque=OraclePolicy)
slc_adaptive = _Controller(*_LYAPUNOV, speed=AdaptiveSlipPolicy)
_BY_SPEED: dict[str, Any] = {"speed": PredictiveTrueMotionSlipPolicy}
# Compared where they are named: what better filters could be worth at most.
TRUE_MOTION = {
    f"{name}-true-motion": _Controller(*of, torque=partial(kind, told=told), **speed)
    for name, of, kind, told, speed in (
        ("adaptive", _LINEARIZING, OraclePolicy, (MOTION,), {}),
        ("oracle", _LINEARIZING, OraclePolicy, (PARAMETERS, MOTION), {}),
        ("mpc-adaptive", _MPC, PredictiveOraclePolicy, (MOTION,), _BY_SPEED),
        ("mpc-oracle", _MPC, PredictiveOraclePolicy, (PARAMETERS, MOTION), {}),
    )
}
TRUE_MOTION["slc-adaptive-true-motion"] = _Controller(*_LYAPUNOV, speed=TrueMotionSlipPolicy)

POLICIES: dict[str, Callable[[Any], Any]] = {
    "nominal": nominal,
    "nominal-centred": _Controller(*_LINEARIZING, centre=CENTRE, torque=_unfiltered),
    "integral": _Controller(*_INTEGRAL, torque=IntegralPolicy),
    "integral-centred": _Controller(*_INTEGRAL, centre=CENTRE, torque=IntegralPolicy),
    "l1": l1,
    "mrac": mrac,
    "adaptive": adaptive,
    "oracle": oracle,
    "mpc-nominal": _Controller(
        *_MPC, _level_slip, torque=NominalPredictivePolicy, speed=PredictiveSlipPolicy
    ),
    "mpc-adaptive": _Controller(*_MPC, torque=PredictivePolicy, speed=PredictiveAdaptiveSlipPolicy),
    "mpc-oracle": _Controller(
        *_MPC, torque=PredictiveOraclePolicy, speed=PredictiveOracleSlipPolicy
    ),
    **TRUE_MOTION,
    "uc": _Controller(*_LYAPUNOV, speed=UnicyclePolicy),
    "slc": _Controller(*_LYAPUNOV, _slip, speed=SlippageAwarePolicy),
    "slc-flat": _Controller(*_LYAPUNOV, _level_slip, speed=SlippageAwarePolicy),
    "slc-adaptive": slc_adaptive,
    "slc-oracle": _Controller(*_LYAPUNOV, speed=OracleSlipPolicy),
    "slc-replan": slc_replan,
    "slc-once": slc_once,
}
SUMMARIES = {
    "nominal": "the feedback-linearizing controller with the nominal parameters, right or wrong",
    "nominal-centred": "the same with the medians of the parameters that the sets draw",
    "integral": "the nominal one, filtered as `adaptive`, with integral action; identifies nothing",
    "integral-centred": "the same with the medians of the parameters that the sets draw",
    "l1": "the same controller behind the filter, with L1 adaptive augmentation",
    "mrac": "the same behind the filter, with model-reference adaptive augmentation",
    "adaptive": "the same controller with the parameters that it identifies under way",
    "oracle": "the adaptive policy, handed the true parameters at every step",
    "mpc-nominal": "model predictive control with nominal parameters, behind the same filter",
    "mpc-adaptive": "model predictive control with the parameters that it identifies under way",
    "mpc-oracle": "model predictive control with the true parameters",
    "uc": "the Lyapunov controller of a unicycle: slip is not known",
    "slc": "the slippage-aware one, slip identified beforehand on the nominal soil",
    "slc-flat": "the same with the slip that the nominal soil has on level ground",
    "slc-adaptive": "the same with the slip of the friction that it identifies under way",
    "slc-oracle": "the same with the slip of the true soil",
    "slc-replan": "slc-adaptive on plans of its own to the goal, a new one every second",
    "slc-once": "slc-adaptive on one plan of its own to the goal, made at the start",
    **{name: f"{name[:-12]} with the true pose and velocities" for name in TRUE_MOTION},
}
for _name, _summary in SUMMARIES.items():
    POLICIES[_name].__doc__ = _summary


def _first_of(agent: str, context: Context) -> tuple[Path, Any]:
    """The archive of the first training of an agent, and its recipe."""
    from baselines.learned.trained_agent import read_recipe

    path = shipped_agents(context.drive)[agent][0]
    return path, read_recipe(path)


def adaptive_learned_observer(context: Context) -> Any:
    """the adaptive policy behind the learned observer of the first mpc-learned-observer"""
    from baselines.learned.agent_policy import OBSERVER
    from baselines.learned.trained_agent import apart_at

    return apart_at(*_first_of(LEARNED, context), OBSERVER, base="adaptive")(context)


def any_vehicle_told(context: Context) -> Any:
    """the first any-vehicle, shown the data sheet of its vehicle"""
    from baselines.learned.agent_policy import ANY_VEHICLE
    from baselines.learned.trained_agent import apart_at

    return apart_at(*_first_of(ANY, context), ANY_VEHICLE, told=True)(context)


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
    "torque": (
        *("nominal", "nominal-centred", "integral", "integral-centred"),
        *("l1", "mrac", "adaptive", "oracle", *PREDICTIVE),
    ),
    "speed": ("uc", "slc", "slc-adaptive", "slc-oracle", *PREDICTIVE),
}


# Environments that policies are compared on by default, beside those of each drive.
_ON_SLOPES = ("uc", "slc-flat", "slc", "slc-adaptive", "slc-oracle")
BY_ENVIRONMENT = {**BY_DRIVE, "tracked_env/Terrain-v0": _ON_SLOPES}


def policies() -> dict[str | None, dict[str, Any]]:
    """Controllers and shipped agents per drive or environment id, as the entry point registers;
    under None those that are compared where they are named."""
    known: dict[str | None, dict[str, Any]] = {
        env: {**{name: POLICIES[name] for name in names}, **shipped_agents(env)}
        for env, names in BY_ENVIRONMENT.items()
    }
    named: dict[str, Any] = dict(TRUE_MOTION)
    if known["torque"].get(LEARNED):
        named["adaptive-learned-observer"] = adaptive_learned_observer
    if known["torque"].get(ANY):
        named["any-vehicle-told"] = any_vehicle_told
    return {**known, None: named}
