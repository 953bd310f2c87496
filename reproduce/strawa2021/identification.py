"""Section 8.3.1: mass, inertia and resistance identified on line, and the effect on the path.

The paper says that the error of the mass is below 1 % on the straight line, and that the
coefficients begin to vary fast at 6 s, when the spiral begins. Both hold if the straight line is
the Y axis: at X = 0 the maps (44), (45) are constant. So the manoeuvre (figure 32) starts at the
origin along +Y: 7 s straight, then a spiral. Speed, radius and excitation are not in the paper;
chosen: 2 m/s +- 0.2 m/s with a period of 4 s, spiral down to R = 6 m at 30 s, start on the path
at its speed. The controller begins with 55 % of the mass, 110 % of the inertia, mu_l = 0.6 and
mu_t = 0.8 (8.2), lateral constraint and d as in 8.1.

The policies of section 8.3: the controller behind the filter of its pose and slips.

They differ in what they do about the parameters only: keep them, or identify them on line. As in
S the estimated soil is not used by the controller.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 7 and 8.3.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.estimators.measurement import DataSheet
from baselines.estimators.stack import Identification
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from reproduce.strawa2021.control import (
    PERIOD,
    SCENARIOS,
    Drive,
    Floats,
    believed_parameters,
    drive,
    lateral_model_options,
    rms,
)
from tracked_env.events import Event, ramp_events
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import PRESETS, Sensors
from tracked_env.uncertainty import STRAWA_MAPS


class FilteringPolicy(AdaptivePolicy):
    """The adaptive policy without adaptation: the controller keeps the parameters it was given.

    Position noise of 1 m saturates the controller without a filter, so a comparison with the
    adaptive policy has to have the same filter.
    """

    def _adapt(self, known: Identification) -> None:
        """Keep the parameters."""


def filtered_policy(
    parameters: PlantParameters, sensors: Sensors, kind: str, lateral: str = "constrained"
) -> AdaptivePolicy:
    """The policy of one row of the tables, for any number of vehicles.

    parameters: believed at the start. sensors: their noise is known to the filters. kind:
    "printed", "paper" or "coupled" is the regression of mass, inertia and resistance, "fixed"
    keeps the parameters.
    """
    made = FilteringPolicy if kind == "fixed" else AdaptivePolicy
    return made(
        parameters,
        PERIOD,
        DataSheet.of(sensors),
        lateral,
        Gains(),
        regression="coupled" if kind == "fixed" else kind,
        uses_soil=False,
    )


DURATION = 30.0  # [s]
STRAIGHT = 7.0  # [s] length of the straight part
BEGUN = 1.0  # [s] the first second is the start of the estimators
SETTLED = 12.0  # [s] the spiral is 5 s old: the yaw equation has been excited
SPEED = 2.0  # [m/s]
SEEDS = 6  # vehicles per condition with noise
# "printed": the recursion of 7.1.1 as it stands; "paper": the same equations and forgetting factor,
# with prior, bounds, gates and compensation (its name in the page: "bounded"); "coupled": ours.
KINDS = ("fixed", "printed", "paper", "coupled")
NAMES = {"fixed": "fixed", "printed": "printed", "paper": "bounded", "coupled": "coupled"}

# The coefficients at X = 0, everywhere: errors on this ground have other causes than the maps.
UNIFORM: list[Event] = ramp_events(
    {"longitudinal_resistance": 0.7, "lateral_resistance": 0.6}, 0.0, 0.0
)
GROUNDS = {"maps": STRAWA_MAPS, "uniform": UNIFORM}


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


def manoeuvre(
    speed: float = SPEED,
    radius_end: float = 6.0,
    amplitude: float = 0.2,
    period: float = 4.0,
    start: float | None = None,
) -> Event:
    """The reference: along +Y, then a spiral to the left; the speed oscillates.

    start [m/s]: speed at the beginning, `speed` unless given.
    """
    return {
        "kind": "identification", "speed": speed,
        "initial_speed": speed if start is None else start,
        "straight_duration": STRAIGHT, "radius_end": radius_end,
        "speed_amplitude": amplitude, "speed_period": period,
        "x": 0.0, "y": 0.0, "yaw": 0.5 * math.pi,
    }  # fmt: skip


def options(condition: Condition, reference: Event) -> dict[str, Any]:
    """Options of reset for one vehicle."""
    return {
        "reference": reference,
        "schedule": GROUNDS[condition.ground],
        "vehicle": {"drive_time_constant": 0.0},
        "lateral_model": lateral_model_options(condition.factor, condition.lateral),
        "start": {
            "offset_x": 0.0,
            "offset_y": 0.0,
            "offset_yaw": 0.0,
            "speed": reference["initial_speed"],
            "yaw_rate": 0.0,
        },
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
