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
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators import least_squares as ls
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import Identification, IdentificationStack
from baselines.estimators.turning import TurningEstimator
from baselines.estimators.two_parameters import PLAIN, TwoParameterEstimator
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from reproduce.strawa2021.control import (
    NO_LAG,
    ON_PATH,
    PERIOD,
    SCENARIOS,
    STRAIGHT,
    Drive,
    Floats,
    believed_parameters,
    drive,
    lateral_model_options,
    manoeuvre,
    rms,
)
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


def as_in_paper(estimator: TwoParameterEstimator) -> None:
    """Equations and forgetting factor of S: no interacting models."""
    estimator.table = PLAIN
    estimator.prior = estimator.prior._replace(forgetting=FORGETTING)


def as_printed(prior: ls.Prior) -> ls.Prior:
    """The prior with which the kernel is the recursion of S 7.1.1: wide, and without bounds."""
    return prior._replace(
        sigma_1=WIDE * prior.sigma_1, sigma_2=WIDE * prior.sigma_2,
        low_1=-math.inf, low_2=-math.inf, high_1=math.inf, high_2=math.inf,
    )  # fmt: skip


class PaperLongitudinal(LongitudinalEstimator):
    """1/m and mu_l by the equations of S, kept bounded."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        as_in_paper(self)
        self._constants = self._constants._replace(coupled=False)


class PrintedLongitudinal(PaperLongitudinal):
    """The same as S prints them."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.prior = as_printed(self.prior)
        self._constants = self._constants._replace(
            acceleration_variance=1.0, effort_variance=0.0, largest_torque=math.inf, slowest=-1.0
        )


class PaperTurning(TurningEstimator):
    """I and mu_t by the equations of S, kept bounded."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        as_in_paper(self)


class PrintedTurning(PaperTurning):
    """The same as S prints them. Raises ValueError for another lateral model."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if not self._constants.constrained:
            raise ValueError(
                "regression as printed with lateral = 'sliding'; must be 'constrained': S 7.1.2 "
                "knows no lateral motion but that of a fixed ICR"
            )
        self.prior = as_printed(self.prior)
        self._constants = self._constants._replace(
            moment_variance=SAME_WEIGHT, bend_variance=0.0, turn_variance=0.0, slowest=-1.0,
            largest_torque=math.inf, low=-math.inf, high=math.inf,
        )  # fmt: skip


class PaperStack(IdentificationStack):
    """The estimators of N vehicles with the regressions of S, kept bounded."""

    longitudinal_kind, turning_kind, uses_sideslip = PaperLongitudinal, PaperTurning, False


class PrintedStack(IdentificationStack):
    """The same with the regressions as S prints them."""

    longitudinal_kind, turning_kind, uses_sideslip = PrintedLongitudinal, PrintedTurning, False


class FixedPolicy(AdaptivePolicy):
    """The adaptive policy without adaptation: the controller keeps its parameters."""

    def _adapt(self, known: Identification) -> None:
        """Keep the parameters."""


class PaperPolicy(AdaptivePolicy):
    """The adaptive policy with the regressions of S, kept bounded."""

    stack_kind = PaperStack


class PrintedPolicy(AdaptivePolicy):
    """The adaptive policy with the regressions as S prints them."""

    stack_kind = PrintedStack


POLICIES = {
    "fixed": FixedPolicy, "printed": PrintedPolicy, "paper": PaperPolicy, "coupled": AdaptivePolicy,
}  # fmt: skip


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


def scaled(sensors: Sensors, factor: float) -> Sensors:
    """The sensors with all noise and bias times `factor`."""
    return sensors._replace(
        **{
            name: factor * getattr(sensors, name)
            for name in Sensors._fields
            if name.endswith(("_noise", "_bias"))
        }
    )


def options(condition: Condition, reference: Event) -> dict[str, Any]:
    """Options of reset for one vehicle."""
    return {
        "reference": reference,
        "schedule": GROUNDS[condition.ground],
        "vehicle": NO_LAG,
        "lateral_model": lateral_model_options(condition.factor, condition.lateral),
        "start": {**ON_PATH, "speed": reference["initial_speed"], "yaw_rate": 0.0},
    }


def identify(
    condition: Condition,
    references: Sequence[Event] | None = None,
    seeds: int | None = None,
    sensors: Sensors | None = None,
    duration: float = DURATION,
) -> Drive:
    """Drive the manoeuvre: rows are the references, each with `seeds` vehicles.

    seeds: default 1 with ideal sensors, else SEEDS. sensors: instead of the preset.
    """
    used = PRESETS[condition.sensors] if sensors is None else sensors
    count = (SEEDS if used.position_noise > 0.0 else 1) if seeds is None else seeds
    paths = [manoeuvre()] if references is None else list(references)
    rows = [options(condition, path) for path in paths for _ in range(count)]
    believed = believed_parameters(SCENARIOS["mass-inertia"], condition.factor)
    policy = filtered_policy(believed, used, condition.kind, condition.lateral)
    return drive(policy, rows, duration, used._asdict(), condition.lateral)


def conditions(
    lateral: str = "constrained", grounds: Sequence[str] = tuple(GROUNDS)
) -> list[Condition]:
    """Every policy with both turning factors, both sensors, and the grounds."""
    return [
        Condition(kind, factor, sensors, ground, lateral)
        for ground in grounds
        for sensors in ("ideal", "strawa")
        for factor in (2.0, 1.0)
        for kind in KINDS
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
    held = window(result, STRAIGHT, exceeds if beyond.any() else math.inf)
    return Quality(
        rms(mass[line]), worst(mass[line]), rms(mass[spiral]), worst(mass[spiral]), exceeds,
        rms(inertia[excited]), mean(along[spiral]), rms(along[spiral]), mean(across[excited]),
        rms(across[excited]), mean(along[held]), mean(across[held]), rms(result.error),
    )  # fmt: skip


def mean(values: Floats) -> float:
    """Mean of all values; nan of none."""
    return float(values.mean()) if values.size else math.nan


def worst(values: Floats) -> float:
    """Largest magnitude; nan of none."""
    return float(np.abs(values).max()) if values.size else math.nan


SPEEDS = (1.0, 2.0, 3.0)
RADII = (6.0, 12.0, 24.0)
NOISES = (0.01, 0.1, 1.0)  # times `strawa`
AMPLITUDES = (0.05, 0.2, 0.5)  # [m/s]
STARTS = (0.5, 1.0, 2.0)  # [m/s]


def by_path(kind: str) -> dict[tuple[float, float], Quality]:
    """Over speed [m/s] and final radius [m], ideal sensors, printed factor, maps."""
    cases = [(speed, radius) for speed in SPEEDS for radius in RADII]
    result = identify(Condition(kind, 2.0, "ideal"), [manoeuvre(*case) for case in cases])
    return {case: quality(only(result, i, 1)) for i, case in enumerate(cases)}


def by_noise(kind: str) -> dict[tuple[float, float], Quality]:
    """Over noise (times `strawa`) and amplitude [m/s] of the speed, uniform ground, factor 2."""
    found = {}
    paths = [manoeuvre(amplitude=amplitude) for amplitude in AMPLITUDES]
    for noise in NOISES:
        sensors = scaled(PRESETS["strawa"], noise)
        result = identify(Condition(kind, 2.0, "strawa", "uniform"), paths, SEEDS, sensors)
        for i, amplitude in enumerate(AMPLITUDES):
            found[noise, amplitude] = quality(only(result, i * SEEDS, SEEDS))
    return found


def by_start(kind: str) -> dict[float, Quality]:
    """Over the speed [m/s] at the start, the paper's noise, uniform ground, factor 2."""
    paths = [manoeuvre(start=start) for start in STARTS]
    result = identify(Condition(kind, 2.0, "strawa", "uniform"), paths)
    return {start: quality(only(result, i * SEEDS, SEEDS)) for i, start in enumerate(STARTS)}


def only(result: Drive, first: int, count: int) -> Drive:
    """The vehicles first .. first + count - 1 of a batch."""
    part = slice(first, first + count)
    return Drive(
        result.time,
        {name: values[:, part] for name, values in result.truth.items()},
        result.reference[:, part],
        result.error[:, part],
        {name: values[:, part] for name, values in result.belief.items()},
        result.observations[:, part],
    )
