"""Section 8.3.1: mass, inertia and resistance identified on line, and the effect on the path.

The paper says that the error of the mass is below 1 % on the straight line, and that the
coefficients begin to vary fast at 6 s, when the spiral begins. Both hold if the straight line is
the Y axis: at X = 0 the maps (44), (45) are constant. So the manoeuvre (figure 32) starts at the
origin along +Y: 7 s straight, then a spiral. Speed, radius and excitation are not in the paper;
chosen: 2 m/s +- 0.2 m/s with a period of 4 s, spiral down to R = 6 m at 30 s, start on the path
at its speed. The controller begins with 55 % of the mass, 110 % of the inertia, mu_l = 0.6 and
mu_t = 0.8 (8.2), lateral constraint and d as in 8.1. As in S it does not use the estimated soil.

Four policies differ in what they do about the parameters only:
    fixed    keeps them. Position noise of 1 m saturates the controller without a filter, so a
             comparison has to have the same filter
    printed  identifies by the recursion that S 7.1.1 prints: no prior, bounds, gates or
             compensation, all samples of one weight, in whose units its covariance is. Only yaw
             rates below the regularisation of the friction stay out, where sign(w) is not +-1
    paper    the equations and forgetting factor of S, kept bounded: with prior, bounds, gates and
             compensation of the torque noise. Its name on the page is "bounded"
    coupled  by this project's regressions, interacting models of how the parameters change

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators.interacting_models import PLAIN
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import Identification, IdentificationStack
from baselines.estimators.turning import TurningEstimator
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from reproduce.policy_runs import Drive, Floats
from reproduce.strawa2021 import control
from reproduce.strawa2021.control import PERIOD, STRAIGHT, TURNING_FACTORS, manoeuvre, rms
from tracked_env.events import Event, ramp_events
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import PRESETS, Sensors
from tracked_env.uncertainty import STRAWA_MAPS

DURATION = 30.0  # [s]
BEGUN = 1.0  # [s] the first second is the start of the estimators
SETTLED = 12.0  # [s] the spiral is 5 s old: the yaw equation has been excited
SEEDS = 6  # vehicles per condition with noise
FORGETTING = 0.998  # [-] S 8.3.1
WIDE = 1e3  # [-] times the prior's standard deviations, as printed: no prior to speak of
SAME_WEIGHT = 1e6  # [N^2 m^2] variance of every turning sample, as printed: any number will do
# Of policies, and their names on the page.
KINDS = ("fixed", "printed", "paper", "coupled")
NAMES = {"fixed": "fixed", "printed": "printed", "paper": "bounded", "coupled": "coupled"}
REGRESSIONS = KINDS[1:]

# The coefficients at X = 0, everywhere: errors on this ground have other causes than the maps.
UNIFORM: list[Event] = ramp_events(
    {"longitudinal_resistance": 0.7, "lateral_resistance": 0.6}, 0.0, 0.0
)
GROUNDS = {"maps": STRAWA_MAPS, "uniform": UNIFORM}


# The regressions of S, in place of this project's

Regression = LongitudinalEstimator | TurningEstimator
AS_PRINTED: dict[type, dict[str, float]] = {  # constants of the equations
    LongitudinalEstimator: {
        "acceleration_variance": 1.0, "effort_variance": 0.0, "largest_torque": math.inf,
        "slowest": -1.0,
    },
    TurningEstimator: {
        "moment_variance": SAME_WEIGHT, "bend_variance": 0.0, "turn_variance": 0.0,
        "slowest": -1.0, "largest_torque": math.inf, "low": -math.inf, "high": math.inf,
    },
}  # fmt: skip


def as_in_paper(regression: Regression) -> None:
    """Equations and forgetting factor of S, kept bounded: no interacting models."""
    regression.table = PLAIN
    regression.prior = regression.prior._replace(forgetting=FORGETTING)
    if isinstance(regression, LongitudinalEstimator):
        regression._constants = regression._constants._replace(coupled=False)


def as_printed(regression: Regression) -> None:
    """The recursion of S 7.1.1 and 7.1.2: the prior wide and without bounds, no sample left out.

    Raises ValueError for another lateral model.
    """
    if isinstance(regression, TurningEstimator) and not regression._constants.constrained:
        raise ValueError(
            "regression as printed with lateral = 'sliding'; must be 'constrained': S 7.1.2 "
            "knows no lateral motion but that of a fixed ICR"
        )
    as_in_paper(regression)
    prior, bound = regression.prior, math.inf
    regression.prior = prior._replace(
        sigma_1=WIDE * prior.sigma_1,
        sigma_2=WIDE * prior.sigma_2,
        low_1=-bound,
        low_2=-bound,
        high_1=bound,
        high_2=bound,
    )
    constants: Any = AS_PRINTED[type(regression)]
    regression._constants = regression._constants._replace(**constants)


class PaperStack(IdentificationStack):
    """The estimators of N vehicles with the regressions of S, kept bounded."""

    uses_sideslip = False
    settings: Callable[[Regression], None] = staticmethod(as_in_paper)

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for regression in (self.longitudinal, self.turning):
            self.settings(regression)


class PrintedStack(PaperStack):
    """The same with the regressions as S prints them."""

    settings = staticmethod(as_printed)


class FixedPolicy(AdaptivePolicy):
    """The adaptive policy without adaptation."""

    def _adapt(self, step: Identification) -> None:
        """Keep the parameters of the controller."""


class PaperPolicy(AdaptivePolicy):
    """The adaptive policy with the regressions of S, kept bounded."""

    stack_kind = PaperStack


class PrintedPolicy(AdaptivePolicy):
    """The adaptive policy with the regressions as S prints them."""

    stack_kind = PrintedStack


POLICIES = {
    "fixed": FixedPolicy,
    "printed": PrintedPolicy,
    "paper": PaperPolicy,
    "coupled": AdaptivePolicy,
}


def filtered_policy(
    parameters: PlantParameters, sensors: Sensors, kind: str, lateral: str = "constrained"
) -> AdaptivePolicy:
    """The policy of one row of the tables, for any number of vehicles: one of KINDS.

    parameters: believed at the start. sensors: their noise is known to the filters.
    """
    sheet = DataSheet.of(sensors)
    return POLICIES[kind](parameters, PERIOD, sheet, lateral, Gains(), uses_soil=False)


# The manoeuvre


class Condition(NamedTuple):
    """What one batch has in common."""

    kind: str  # of policy
    factor: float  # turning factor of plant and controller
    sensors: str
    ground: str = "maps"
    lateral: str = "constrained"


def identify(
    condition: Condition,
    references: Sequence[Event] = (),
    seeds: int | None = None,
    duration: float = DURATION,
) -> Drive:
    """Drive the manoeuvre, or each of `references`, with `seeds` vehicles each.

    seeds: default 1 with ideal sensors, else SEEDS.
    """
    sensors = PRESETS[condition.sensors]
    count = (SEEDS if sensors.position_noise > 0.0 else 1) if seeds is None else seeds
    rows: list[dict[str, Any]] = [
        {
            "reference": reference,
            "schedule": GROUNDS[condition.ground],
            "lateral_model": control.lateral_model(condition.factor, condition.lateral),
            "start": control.ON_PATH | {"speed": reference["initial_speed"], "yaw_rate": 0.0},
        }
        for reference in references or [manoeuvre()]
        for _ in range(count)
    ]
    assumed = control.assumed_parameters("mass-inertia", condition.factor)
    policy = filtered_policy(assumed, sensors, condition.kind, condition.lateral)
    return control.drive(policy, rows, duration, sensors._asdict(), condition.lateral)


def conditions(
    lateral: str = "constrained", grounds: Sequence[str] = tuple(GROUNDS)
) -> list[Condition]:
    """Every policy with both turning factors, both sensors, and the grounds."""
    return [
        Condition(kind, factor, sensors, ground, lateral)
        for ground, sensors, factor, kind in product(
            grounds, ("ideal", "strawa"), TURNING_FACTORS, KINDS
        )
        if kind != "printed" or lateral == "constrained"  # it supposes the constraint
    ]


def run_all(duration: float = DURATION) -> dict[Condition, Drive]:
    """The manoeuvre under all conditions; sliding tracks on the maps only."""
    every = conditions() + conditions("sliding", ("maps",))
    return {condition: identify(condition, duration=duration) for condition in every}


def relative_error(result: Drive, name: str) -> Floats:
    """(belief - truth) / truth, (T, N)."""
    truth = result.truth[name]
    return np.asarray((result.belief[name] - truth) / truth)


def window(result: Drive, start: float, end: float = math.inf) -> slice:
    """The rows of start <= t < end."""
    first, last = np.searchsorted(result.time, [start, end])
    return slice(int(first), int(last))


class Quality(NamedTuple):
    """How good the estimates of one condition are; relative errors [-]."""

    mass_straight: float  # rms from BEGUN to STRAIGHT
    mass_straight_worst: float  # largest magnitude there
    mass_spiral: float  # rms after STRAIGHT
    mass_spiral_worst: float
    exceeds: float  # [s] first time after STRAIGHT with more than 5 %, nan = never
    inertia: float  # rms after SETTLED
    longitudinal_bias: float  # mean error of mu_l after STRAIGHT [-]
    longitudinal_rms: float
    lateral_bias: float  # mu_t after SETTLED
    lateral_rms: float
    longitudinal_held: float  # mean error of mu_l from STRAIGHT until `exceeds`, or the end
    lateral_held: float  # of mu_t
    rmse: float  # [m] distance to the reference


def quality(result: Drive) -> Quality:
    """Numbers of one condition, over all its vehicles."""
    mass, inertia = relative_error(result, "mass"), relative_error(result, "inertia")
    along, across = (
        result.belief[name] - result.truth[name]
        for name in ("longitudinal_resistance", "lateral_resistance")
    )
    line, spiral = window(result, BEGUN, STRAIGHT), window(result, STRAIGHT)
    excited = window(result, SETTLED)
    beyond = np.abs(mass[spiral]).max(axis=1) > 0.05
    exceeds = float(result.time[spiral][beyond.argmax()]) if beyond.any() else math.nan
    within = window(result, STRAIGHT, exceeds if beyond.any() else math.inf)
    return Quality(
        rms(mass[line]), worst(mass[line]), rms(mass[spiral]), worst(mass[spiral]), exceeds,
        rms(inertia[excited]), mean(along[spiral]), rms(along[spiral]), mean(across[excited]),
        rms(across[excited]), mean(along[within]), mean(across[within]), rms(result.distance),
    )  # fmt: skip


def mean(values: Floats) -> float:
    """Mean of all values; nan of none."""
    return float(values.mean()) if values.size else math.nan


def worst(values: Floats) -> float:
    """Largest magnitude; nan of none."""
    return float(np.abs(values).max()) if values.size else math.nan


SPEEDS = (1.0, 2.0, 3.0)
RADII = (6.0, 12.0, 24.0)
STARTS = (0.5, 1.0, 2.0)  # [m/s]


def qualities(condition: Condition, references: Sequence[Event]) -> list[Quality]:
    """Numbers of each reference."""
    result = identify(condition, references)
    count = len(result.truth["x"][0]) // len(references)
    parts = (slice(i * count, (i + 1) * count) for i in range(len(references)))
    return [quality(result.part(part)) for part in parts]


def by_path(kind: str) -> dict[tuple[float, float], Quality]:
    """Over speed [m/s] and final radius [m], ideal sensors, printed factor, maps."""
    cases = list(product(SPEEDS, RADII))
    paths = [manoeuvre(*case) for case in cases]
    return dict(zip(cases, qualities(Condition(kind, 2.0, "ideal"), paths), strict=True))


def by_start(kind: str) -> dict[float, Quality]:
    """Over the speed [m/s] at the start, the paper's noise, uniform ground, factor 2."""
    paths = [manoeuvre(start=start) for start in STARTS]
    numbers = qualities(Condition(kind, 2.0, "strawa", "uniform"), paths)
    return dict(zip(STARTS, numbers, strict=True))
