"""What a log says of vehicle and soil, by the identification stack of the adaptive policy.

The stack goes over the log twice:
    over time  as the policy has it: every parameter may change at any moment, so old samples are
               forgotten, and the deviations are those of a vehicle that may be loaded or leave its
               soil right now
    constant   without forgetting and without the models of change: mass, inertia and the two
               resistances of the whole log. Beside the noise counts what a bias of each sensor of
               its stated magnitude does: the stack goes over as many copies of the log, each with
               one bias. The 95 % interval holds normal noise plus biases of either sign.
The second holds where nothing has changed. Where the first contradicts it, the values are those of
the first at the end. Soil strength is estimated over windows; the most informative ones count.

The stack is that of the installed package which registers `identify` in `tracked_env.commands`.

What was identified as a set of parameters, and in words what a log cannot tell.

    {"make": {"vehicle": {...}}}     arguments of an environment: gymnasium.make(id, **set["make"])
    {"ranges": {name: [low, high]}}  95 % intervals of what is determined, for `uncertainty=`
    {"parameters": {name: {...}}}    value, deviation, interval, verdict of everything
    {"contradictions": [...]}        why the log is not one of this vehicle and model; then there is
                                     no "make" and no range
What a log does not determine stays at its nominal value. The strength of a soil is one number in
the log, F_max = c A + (m g / 2) tan phi; the friction angle is kept as far as the cohesion stays
positive.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm

from baselines.identify.csv_log import Floats
from baselines.identify.friction_smoothing import turning_of
from baselines.identify.vehicle_log import Log
from tracked_env import observation as layout
from tracked_env.benchmark.policies import command_function
from tracked_env.observation import GROUPS as FIELDS
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.sensors import CHANNELS, GROUPS

SCALE = {field.name: field.scale for group in FIELDS.values() for field in group.fields}
CONSTANT = ("mass", "longitudinal_resistance", "inertia", "lateral_resistance")
SOIL = ("effort_maximum", "shear_deformation_modulus")
PARTS = ("longitudinal", "turning", "slip", "soil")
COVERED = 0.95  # [-] of the intervals
NORMAL = float(norm.isf(0.5 * (1.0 - COVERED)))
DETERMINED = 0.1  # [-] claimed deviation over the value, below which the log determines a parameter
LEARNED = 0.5  # [-] over the deviation before the log, below which it says something of it
CONTRADICTED = 4.0  # [-] deviations between the two passes, and the share of time with more
CONTRADICTED_SHARE = 0.02
WINDOW = 50  # [steps] of the soil estimator
BEST = 20  # windows of the soil estimator that count, the most informative ones
CONTRADICTING = 1.8  # [-] middle size of residuals over their standard deviation, which are not
FEW = 200  # residuals, below which they say nothing
WHITE = 0.3  # [-] white beyond this autocorrelation: then the model is not that of the log
NEAR = 1e-3  # [-] of a bound: at it
EQUATION = {"mass": "longitudinal", "longitudinal_resistance": "longitudinal",
            "inertia": "turning", "lateral_resistance": "turning"}  # fmt: skip
SETTLING = 5.0  # [s] at first in which the passes are not compared


class Found(NamedTuple):
    """A parameter of the whole log."""

    value: float  # SI
    deviation: float
    low: float  # 95 % interval
    high: float
    prior_deviation: float
    changed: bool  # it changes within the log; then the value is that at its end
    against: str = ""  # why the value is none, whatever its deviation: "at its bound", ..

    @property
    def verdict(self) -> str:
        """How much the log says of it."""
        if self.against:
            return self.against
        if self.deviation <= DETERMINED * abs(self.value):
            return "determined"
        return "weakly" if self.deviation <= LEARNED * self.prior_deviation else "not determined"


class Misfit(NamedTuple):
    """How far the residuals of an equation are from those of a log of its model."""

    size: float  # [-] their middle size over their standard deviation, 1 where the model is right
    following: float  # [-] autocorrelation at lag 1

    @property
    def contradicts(self) -> bool:
        """More than noise that was stated too small."""
        return self.size > CONTRADICTING and self.following > WHITE


class Identified(NamedTuple):
    """Everything that a log says; series over the T steps of the log."""

    log: Log
    nominal: PlantParameters
    series: dict[str, tuple[Floats, Floats]]  # (T,) value and standard deviation by quantity
    excitation: dict[str, Floats]  # (T,) by estimator
    status: dict[str, NDArray[np.int64]]  # (T,) 0 learning, 1 holding, 2 refused
    nis: dict[str, Floats]  # (T,) normalised innovation squared, NaN without a sample
    motion: Floats  # (T, 6) filtered x, y, yaw, v_x, v_y, yaw_rate
    residuals: dict[str, Floats]  # (K,) of each regression over their standard deviation
    found: dict[str, Found]
    resistance_force: tuple[float, float]  # [N] m g mu_l and its deviation
    stiffness: tuple[float, float]  # [N/m] F_max / K of a track and its deviation
    misfits: dict[str, Misfit]  # of each regression


def misfit(residuals: Floats) -> Misfit:
    """Of residuals (K,); outliers, and what a change leaves until it is learned, count little."""
    if len(residuals) < FEW:
        return Misfit(1.0, 0.0)
    size = float(np.median(np.abs(residuals))) / float(norm.isf(0.25))
    centred = np.clip(residuals, -4.0 * size, 4.0 * size)
    power = float(centred @ centred) or 1.0
    return Misfit(size, float(centred[1:] @ centred[:-1]) / power)


def _bounds(stack: Any, mass: float) -> dict[str, tuple[float, float]]:
    """(low, high) between which the regressions seek each constant."""
    straight, turning = stack.longitudinal.prior, stack.turning.prior
    return {
        "mass": (1.0 / straight.high_1, 1.0 / straight.low_1),
        "longitudinal_resistance": (straight.low_2, straight.high_2),
        "inertia": (turning.low_1, turning.high_1),
        "lateral_resistance": (turning.low_2 / mass, RANGES["lateral_resistance"].high),
    }


def observations(log: Log, needs: Sequence[str]) -> NDArray[np.float32]:
    """The log as observations (T, SIZE + registered fields) of a reference that stands still at
    the first position. Sensors that are missing are NaN."""
    behind = [name for name in needs if name not in layout.INDEX]
    rows = np.zeros((len(log.time), layout.SIZE + len(behind)), dtype=np.float32)
    values = log.values
    c, s = np.cos(values["yaw"]), np.sin(values["yaw"])
    x, y = values["x"][0] - values["x"], values["y"][0] - values["y"]
    shown = {
        "position_error_x": c * x + s * y, "position_error_y": c * y - s * x,
        "heading_error": -values["yaw"],
        **{name: values[name] for name in CHANNELS[3:]},
        **{f"{group}_age": np.minimum(log.age[:, k], 60.0) for k, group in enumerate(GROUPS)},
    }  # fmt: skip
    for name, column in shown.items():
        rows[:, layout.INDEX[name]] = column / SCALE[name]
    for k, name in enumerate(behind):
        rows[:, layout.SIZE + k] = values[name] / SCALE[name]
    return rows


def make_stack(log: Log, nominal: PlantParameters, lateral: str, count: int = 1) -> Any:
    """The stack for a log."""
    module: Any = command_function("identify")
    return module.IdentificationStack(
        nominal, control_period=log.period, data_sheet=module.DataSheet.of(log.sensors),
        count=count, lateral=lateral, attitude=log.attitude,
    )  # fmt: skip


def biases(log: Log) -> dict[str, float]:
    """Magnitude [SI] of the bias of each channel that has one."""
    sheet = log.sensors
    bend = math.sqrt(2.0) * sheet.acceleration_bias / sheet.accelerometer_distance
    found = {
        "acceleration_x": sheet.acceleration_bias, "acceleration_y": sheet.acceleration_bias,
        "yaw_rate": sheet.gyro_bias, "yaw_acceleration": bend,
    }  # fmt: skip
    return {name: bias for name, bias in found.items() if bias > 0.0}


def half_width(deviation: float, shifts: Sequence[float]) -> float:
    """h for which |n + sum of +-shifts| <= h with probability COVERED, n of that deviation."""
    size = sorted((abs(one) for one in shifts), reverse=True)[:6]
    sums = np.array([sum(signs) for signs in itertools.product(*((-s, s) for s in size))])
    if deviation <= 0.0:
        return float(np.abs(sums).max())

    def lacking(h: float) -> float:
        inside = norm.cdf((h - sums) / deviation) - norm.cdf((-h - sums) / deviation)
        return float(np.mean(inside)) - COVERED

    return float(brentq(lacking, 0.0, float(np.abs(sums).max()) + 5.0 * deviation))


def _module(name: str) -> Any:
    """The module of one of the regressions."""
    return command_function(f"identify-{name}")


def shared_friction(stack: Any, inertia: float, deviation: float) -> float:
    """The deviation of the inertia where the slip may share friction, as `stack` found it."""
    turning = _module("turning")
    out = np.zeros((1, stack.turning.answer.shape[1]))
    out[0, turning.VALUE_1], out[0, turning.P_11] = inertia, deviation**2
    turning.admit_shared_friction(out, 0, stack.turning.memory, stack.turning.prior)
    return math.sqrt(float(out[0, turning.P_11]))


def _joined(answers: list[Any]) -> Any:
    """Bare answers of T steps as one of T rows."""
    if isinstance(answers[0], tuple):
        return tuple(np.concatenate(column) for column in zip(*answers, strict=True))
    return np.concatenate(answers)


def _over_time(
    rows: NDArray[np.float32], stack: Any
) -> tuple[dict[str, Any], Floats, dict[str, Floats]]:
    """Estimates of T rows by estimator, motion (T, 6), and the residuals of the regressions."""
    answers: dict[str, list[Any]] = {name: [] for name in PARTS}
    motion, residuals = [], _Residuals(stack)
    for row in rows:
        known = stack.update(row[None])
        for name in PARTS:
            answers[name].append(known.parts.answers[name])
        motion.append(known.motion_rows[0].copy())
        residuals.add(known.reading.paired)
    parts = {name: stack.parts[name].estimate(_joined(answers[name])) for name in PARTS}
    return parts, np.array(motion), residuals.normalised()


class _Residuals:
    """Residuals of the two regressions, each by the estimates before its sample."""

    def __init__(self, stack: Any) -> None:
        self.equations = {name: _module(name).equation for name in ("longitudinal", "turning")}
        self.stack = stack
        self.found: dict[str, list[float]] = {name: [] for name in self.equations}
        self.before: tuple[tuple[float, float], tuple[float, float]] | None = None

    def add(self, paired: Any) -> None:
        """Compare a sample with what was known before it."""
        parts = self.stack.parts
        if self.before is not None and paired.fresh[0, 1] and paired.fresh[0, 2]:
            (mass, resistance), (inertia, friction) = self.before
            straight, turning = (parts[name].known() for name in ("longitudinal", "turning"))
            arguments = {
                "longitudinal": ((straight[0], 1.0), (1.0 / mass, resistance)),
                "turning": (
                    (turning[0], mass, resistance, mass * friction, inertia, 1.0),
                    (inertia, mass * friction),
                ),
            }
            for name, (known, (first, second)) in arguments.items():
                sample, usable = self.equations[name](paired.values, 0, *known)
                error = sample.y - sample.phi_1 * first - sample.phi_2 * second
                if usable and math.isfinite(error):
                    self.found[name].append(error / math.sqrt(sample.variance))
        straight, turning = (parts[name].answer[0] for name in ("longitudinal", "turning"))
        self.before = ((1.0 / straight[0], straight[1]), (turning[0], turning[1]))

    def normalised(self) -> dict[str, Floats]:
        """(K,) of each regression."""
        return {name: np.array(values) for name, values in self.found.items()}


def _constant(
    rows: NDArray[np.float32], log: Log, nominal: PlantParameters, lateral: str
) -> tuple[dict[str, Any], dict[str, Floats]]:
    """({name: (value, deviation)} at the end without forgetting, shifts by each bias)."""
    shifted = biases(log)
    stack = make_stack(log, nominal, lateral, 1 + len(shifted))
    for part in (stack.longitudinal, stack.turning):
        part.table = part.table[:0]  # no models of change
        part.prior = part.prior._replace(forgetting=1.0)
    offsets = np.zeros((1 + len(shifted), rows.shape[1]), dtype=np.float32)
    for k, (name, bias) in enumerate(shifted.items()):
        offsets[1 + k, layout.INDEX[name]] = bias / SCALE[name]
    for row in rows:
        known = stack.update(row + offsets)
    told = known.estimates()
    values = {name: (float(told[name][0][0]), float(told[name][1][0])) for name in CONSTANT}
    return values, {name: told[name][0][1:] - told[name][0][0] for name in CONSTANT}


def _prior_deviations(stack: Any) -> dict[str, float]:
    """Before the first sample, to first order."""
    told: dict[str, float] = {}
    for part in (stack.longitudinal, stack.turning):
        estimate = part.read()
        told |= {q.name: float(q.read(estimate)[1][0]) for q in part.provides}
    return told


def _soil(soil: Any) -> tuple[dict[str, Found], tuple[float, float]]:
    """F_max and K of a log, and F_max / K with its deviation.

    The mean of the logarithms over the BEST of all windows, weighted by what they claim. Windows
    share errors of the slips, so that many are not better than one: the deviation is that of the
    best window and the scatter of all together.
    """
    ends = np.arange(WINDOW - 1, len(soil.value), WINDOW) if len(soil.value) > WINDOW else [-1]
    values = np.log(soil.value[ends])
    values = np.column_stack([values, values[:, 0] - values[:, 1]])
    relative = soil.covariance[ends] / (soil.value[ends, :, None] * soil.value[ends, None, :])
    variances = np.diagonal(relative, axis1=1, axis2=2)
    ratio = np.maximum(variances.sum(axis=1) - 2.0 * relative[:, 0, 1], 1e-12)
    variances = np.column_stack([variances, ratio])
    best = np.argsort(np.sqrt(variances[:, :2]).sum(axis=1))[:BEST]
    values, weights = values[best], 1.0 / variances[best]
    mean = np.sum(weights * values, axis=0) / weights.sum(axis=0)
    scatter = np.sum(weights * (values - mean) ** 2, axis=0) / weights.sum(axis=0)
    spread = np.sqrt(variances[best].min(axis=0) + scatter)
    found, prior = {}, np.sqrt(np.diagonal(soil.covariance[0])) / soil.value[0]
    for k, name in enumerate(SOIL):
        value, factor = float(np.exp(mean[k])), float(np.exp(NORMAL * spread[k]))
        before = float(prior[k]) * value  # of the logarithm
        found[name] = Found(
            value, float(spread[k]) * value, value / factor, value * factor, before, False
        )
    ratio_found = float(np.exp(mean[2]))
    return found, (ratio_found, ratio_found * float(spread[2]))


def identify(log: Log, nominal: PlantParameters, lateral: str = "sliding") -> Identified:
    """Go over a log. nominal: where every estimate begins, and the geometry.

    Raises ValueError for a log that the stack refuses.
    """
    stack = make_stack(log, nominal, lateral)
    prior = _prior_deviations(stack)
    rows = observations(log, stack.needs)
    turning = turning_of(log, nominal) if lateral == "sliding" else None
    if turning is not None:  # as if friction were smoothed as the estimators have it
        share = turning.excess * nominal.sprocket_radius / nominal.track_gauge
        for name, sign in (("torque_left", 1.0), ("torque_right", -1.0)):
            rows[:, layout.INDEX[name]] += sign * share / SCALE[name]
    parts, motion, residuals = _over_time(rows, stack)
    if log.averaged or turning is not None:  # forces of a moment, for what compares with slips
        as_measured = observations(log, stack.needs)
        for name in ("torque_left", "torque_right"):
            as_measured[:, layout.INDEX[name]] = log.values[f"raw_{name}"] / SCALE[name]
        plain, motion, _ = _over_time(as_measured, make_stack(log, nominal, lateral))
        parts |= {name: plain[name] for name in ("slip", "soil")}
    series = {
        quantity.name: quantity.read(parts[name])
        for name in PARTS for quantity in stack.quantities[name]
    }  # fmt: skip
    constant, shifts = _constant(rows, log, nominal, lateral)
    if turning is not None:
        for name, spread in (("inertia", turning.inertia_spread),
                             ("lateral_resistance", turning.resistance_spread)):  # fmt: skip
            shifts[name] = np.append(shifts[name], spread * constant[name][0])
    settled = log.time > min(SETTLING, 0.5 * log.time[-1])
    found: dict[str, Found] = {}
    misfits = {name: misfit(of) for name, of in residuals.items()}
    bounds = _bounds(stack, constant["mass"][0])
    for name in CONSTANT:
        value, noise = constant[name]
        fit, (low, high) = misfits[EQUATION[name]], bounds[name]
        noise *= max(fit.size, 1.0)  # a data sheet that is too good
        if name == "inertia":
            noise = shared_friction(stack, value, noise)
        now, claimed = series[name]
        off = np.abs(now - value) > CONTRADICTED * np.hypot(claimed, noise)
        changed = bool(np.mean(off[settled]) > CONTRADICTED_SHARE)
        if changed:
            value, deviation = float(now[-1]), float(claimed[-1])
            half = NORMAL * deviation
        else:
            deviation = math.sqrt(noise**2 + float(np.sum(shifts[name] ** 2)))
            half = half_width(noise, list(shifts[name]))
        margin = NEAR * (high - low)
        against = "contradicted" if fit.contradicts else ""
        if against and EQUATION[name] == "turning":  # which needs mu_l where tracks oppose
            lost = found["longitudinal_resistance"].verdict == "not determined"
            against = "not determined" if lost else against
        if not against and not low + margin < value < high - margin:
            against = "at its bound"
        found[name] = Found(
            value, deviation, value - half, value + half, prior[name], changed, against
        )
    soil, stiffness = _soil(parts["soil"])
    regression = parts["longitudinal"]
    return Identified(
        log, nominal, series,
        {name: parts[name].excitation for name in PARTS},
        {name: parts[name].status for name in PARTS},
        {name: parts[name].nis for name in PARTS},
        motion, residuals, found | soil, _force(regression.value[-1], regression.covariance[-1]),
        stiffness, misfits,
    )  # fmt: skip


def _force(value: Floats, covariance: Floats) -> tuple[float, float]:
    """m g mu_l [N] and its deviation, of 1/m and mu_l with their covariance."""
    inverse, resistance = value
    force = 9.81 * resistance / inverse
    gradient = np.array([-force / inverse, 9.81 / inverse])
    return float(force), float(math.sqrt(max(gradient @ covariance @ gradient, 0.0)))


WHITE_LAGS = 50  # [samples] of the autocorrelation
EXPLAINED = (0.7, 1.5)  # [-] rms of residuals whose data sheet is right
COHESIVE = 0.02  # [-] share of the log beyond the largest mu_t from which on it is worth a word
REFUSED = 0.05  # [-] share of samples from which on outliers are worth a word
OUTLYING = 4.0  # [-] residuals beyond it count as that large
CORRELATED = 0.2  # [-] autocorrelation from which on residuals hang together
NAMES = {
    "mass": ("mass", "kg"), "inertia": ("yaw inertia", "kg m^2"),
    "longitudinal_resistance": ("motion resistance mu_l", "-"),
    "lateral_resistance": ("lateral resistance mu_t", "-"),
    "effort_maximum": ("soil strength F_max", "N"),
    "shear_deformation_modulus": ("shear deformation modulus K", "m"),
}  # fmt: skip


def soil_of(identified: Identified, mass: float) -> dict[str, float]:
    """cohesion [Pa] and friction_angle [rad] that give the F_max of the log."""
    nominal = identified.nominal
    area = nominal.track_width * nominal.contact_length
    load = 0.5 * mass * GRAVITY
    strength = identified.found["effort_maximum"].value
    angle = nominal.friction_angle
    cohesion = (strength - load * math.tan(angle)) / area
    if cohesion < 0.0:
        cohesion, angle = 0.0, math.atan(strength / load)
    found = {"cohesion": cohesion, "friction_angle": angle}
    return {name: min(max(of, RANGES[name].low), RANGES[name].high) for name, of in found.items()}


def determined(identified: Identified) -> tuple[str, ...]:
    """Names of what the log determines, weakly or well."""
    return tuple(n for n, of in identified.found.items() if of.verdict in ("determined", "weakly"))


def contradictions(identified: Identified) -> list[str]:
    """What speaks against a log of this vehicle and model, a sentence each."""
    said = [
        f"The {name} equation does not hold in this log: its residuals are {fit.size:.3g} times as "
        "large as the data sheet allows, and follow each other "
        f"(autocorrelation {fit.following:.2f}). Check signs, sides and units of torques and "
        "accelerations, their delays, and the geometry of --vehicle."
        for name, fit in identified.misfits.items()
        if any(identified.found[of].against == "contradicted" for of in CONSTANT
               if EQUATION[of] == name)
    ]  # fmt: skip
    for name in ("mass", "inertia"):
        of = identified.found[name]
        if of.against == "at its bound" and of.deviation <= LEARNED * of.prior_deviation:
            said.append(
                f"The {NAMES[name][0]} ends at the bound of its search, {of.value:.4g} "
                f"{NAMES[name][1]}, and is no result. Is the nominal one of --vehicle, "
                f"{getattr(identified.nominal, name):g}, far off, or are the torques on another "
                "scale?"
            )
    return said


def parameter_set(identified: Identified) -> dict[str, Any]:
    """The set as JSON has it; without "make" and ranges where the log contradicts the model."""
    known, found = determined(identified), identified.found
    against = contradictions(identified)
    vehicle = {name: float(value) for name, value in identified.nominal._asdict().items()}
    ranges = {}
    for name in known:
        if name != "effort_maximum":
            low, high = RANGES[name].low, RANGES[name].high
            vehicle[name] = min(max(found[name].value, low), high)
            ranges[name] = [min(max(x, low), high) for x in (found[name].low, found[name].high)]
    if "effort_maximum" in known:
        vehicle |= soil_of(identified, vehicle["mass"])
    usable = {"contradictions": against} if against else {
        "make": {"vehicle": vehicle}, "ranges": ranges
    }  # fmt: skip
    return {
        **usable,
        "parameters": {
            name: {
                "unit": NAMES[name][1], "value": of.value, "deviation": of.deviation,
                "low": of.low, "high": of.high, "verdict": of.verdict, "changed": of.changed,
            }
            for name, of in found.items()
        },
        "not_told": untold(identified),
    }  # fmt: skip


def autocorrelation(residuals: Any, lags: int = WHITE_LAGS) -> Any:
    """Autocorrelation (lags,) [-] from lag 1 on."""
    centred = residuals - residuals.mean()
    power = float(centred @ centred) or 1.0
    return np.array([centred[k:] @ centred[:-k] / power for k in range(1, lags + 1)])


def untold(identified: Identified) -> list[str]:
    """What the log cannot tell, and what speaks against the model, a sentence each."""
    found, said = identified.found, contradictions(identified)
    lost = set(found) - set(determined(identified))
    if said:
        lost = set()
    if {"mass", "longitudinal_resistance"} & lost:
        force, deviation = identified.resistance_force
        text = "Mass and motion resistance are not told apart: the log has too little speeding up, \
braking and turning. At constant speed only their product shows"
        if deviation < 0.2 * force:
            text += f", the resisting force m g mu_l = {force:.0f} +- {deviation:.0f} N"
        said.append(f"{text}.")
    if {"inertia", "lateral_resistance"} & lost:
        said.append(
            "Yaw inertia and lateral resistance are not determined: they show in turns, the inertia"
            " in turns that begin and end. They stay at their nominal values."
        )
    if set(SOIL) & lost:
        text = "Soil strength and shear deformation modulus are not told apart: the tracks slipped "
        text += "too little"
        stiffness, deviation = identified.stiffness
        if deviation < 0.2 * stiffness:
            text += f". Their ratio is F_max / K = {stiffness:.3g} +- {deviation:.2g} N/m"
        said.append(f"{text}. Full torque from rest, or a tight turn, would show them.")
    changing = [NAMES[name][0] for name in CONSTANT if found[name].changed]
    if changing:
        said.append(
            f"Within the log {', '.join(changing)} changed, or an equation does not hold there. "
            "The values are those at the end, with the deviations of a vehicle that may change."
        )
    most = RANGES["lateral_resistance"].high
    cohesive = float(np.mean(identified.series["lateral_resistance"][0] > most))
    if cohesive > COHESIVE:
        said.append(
            f"In {100.0 * cohesive:.0f} % of the log the resistance to a turn is more than a mu_t "
            f"of {most:g} explains. Cohesion of firm soil does that: it does not grow with the "
            "weight, but with the curvature, and hides the inertia. plant='distributed' models it."
        )
    said += _against(identified)
    said.append(
        "Cohesion and friction angle act through F_max alone under one load; the set has the "
        "nominal friction angle where it can."
    )
    return said


def _against(identified: Identified) -> list[str]:
    """What speaks against model or data sheet."""
    said = []
    changed = any(of.changed for of in identified.found.values())
    for name, found in identified.residuals.items():
        if len(found) < 4 * WHITE_LAGS or identified.misfits[name].contradicts:
            continue
        residuals = np.clip(found, -OUTLYING, OUTLYING)
        # A change leaves residuals until it is learned; the middle size has few of them.
        size = float(np.sqrt(np.mean(residuals**2)))
        size = identified.misfits[name].size if changed else size
        if not EXPLAINED[0] <= size <= EXPLAINED[1]:
            cause = "more noise than" if size > 1.0 else "less noise than"
            said.append(
                f"Residuals of the {name} equation are {size:.2g} times what the data sheet says, "
                f"where 1 is expected: the log has {cause} --sensors state"
                + (", or the model lacks something." if size > 1.0 else ".")
            )
        first = float(np.abs(autocorrelation(residuals)[:5]).max())
        if first > CORRELATED and not changed:
            said.append(
                f"Residuals of the {name} equation are not white (autocorrelation {first:.2f}): "
                "the intervals are too narrow."
            )
    for name, status in identified.status.items():
        share = float(np.mean(status == 2))
        if name != "slip" and share > REFUSED:
            said.append(
                f"{share:.0%} of the samples of the {name} estimator were refused as outliers."
            )
    return said
