"""What a log says of vehicle and soil, by the identification stack of the adaptive policy.

The stack goes over the log twice:
    over time  as the policy has it: every parameter may change at any moment, so old samples are
               forgotten, and the deviations are those of a vehicle that may be loaded or leave its
               soil right now
    constant   without forgetting and without the models of change: mass, inertia and the two
               resistances of the whole log. Beside the noise counts what a bias of each sensor of
               its stated magnitude does: the stack goes over as many copies of the log, each with
               one bias. The 95 % interval holds normal noise plus biases of either sign.
The second holds where nothing has changed. Where the first contradicts it, or the second differs
between the halves of the log, the values are those of the first at the end. Soil strength is
estimated over windows; the most informative ones count.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm

from baselines.estimators.measurement import DataSheet, Estimate
from baselines.estimators.stack import IdentificationStack
from baselines.identify.csv_log import Floats
from baselines.identify.log_torques import turning_of
from baselines.identify.vehicle_log import TORQUES, Log
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.sensors import CHANNELS, GROUPS

SCALE = {field.name: field.scale for group in layout.GROUPS.values() for field in group.fields}
# Parameters of the whole log, and the regression of each.
EQUATION = {
    "mass": "longitudinal",
    "longitudinal_resistance": "longitudinal",
    "inertia": "turning",
    "lateral_resistance": "turning",
}
CONSTANT = tuple(EQUATION)
SOIL = ("effort_maximum", "shear_deformation_modulus")
PARTS = ("longitudinal", "turning", "slip", "soil")
COVERAGE = 0.95  # [-] of the intervals
NORMAL = float(norm.isf(0.5 * (1.0 - COVERAGE)))
DETERMINED = 0.1  # [-] claimed deviation over the value, below which the log determines a parameter
LEARNED = 0.5  # [-] over the deviation before the log, below which it says something of it
CHANGE = 4.0  # [-] deviations between the two passes, and the share of time with more
CHANGE_SHARE = 0.02
WINDOW = 50  # [steps] of the soil estimator
BEST = 20  # windows of the soil estimator that count, the most informative ones
CONTRADICTING = 1.8  # [-] middle size of residuals over their standard deviation, which are not
LEAST_RESIDUALS = 200  # below which they say nothing
WHITE = 0.3  # [-] white beyond this autocorrelation: then the model is not that of the log
NEAR = 1e-3  # [-] of a bound: at it
SETTLING = 5.0  # [s] at first in which the passes are not compared


class Parameter(NamedTuple):
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
    correlation: float  # [-] autocorrelation at lag 1

    @property
    def contradicts(self) -> bool:
        """More than noise that was stated too small."""
        return self.size > CONTRADICTING and self.correlation > WHITE


def misfit(residuals: Floats) -> Misfit:
    """Of residuals (K,); outliers, and what a change leaves until it is learned, count little."""
    if len(residuals) < LEAST_RESIDUALS:
        return Misfit(1.0, 0.0)
    size = float(np.median(np.abs(residuals))) / float(norm.isf(0.25))
    centred = np.clip(residuals, -4.0 * size, 4.0 * size)
    power = float(centred @ centred) or 1.0
    return Misfit(size, float(centred[1:] @ centred[:-1]) / power)


class Identified(NamedTuple):
    """Everything that a log says; series over the T steps of the log."""

    log: Log
    nominal: PlantParameters
    series: dict[str, tuple[Floats, Floats]]  # (T,) value and standard deviation by quantity
    estimates: dict[str, Estimate]  # of T rows, by estimator
    motion: Floats  # (T, 6) filtered x, y, yaw, v_x, v_y, yaw_rate
    residuals: dict[str, Floats]  # (K,) of each regression over their standard deviation
    parameters: dict[str, Parameter]
    resistance_force: tuple[float, float]  # [N] m g mu_l and its deviation
    stiffness: tuple[float, float]  # [N/m] F_max / K of a track and its deviation
    misfits: dict[str, Misfit]  # of each regression


def observations(log: Log, needs: Sequence[str], torques: Sequence[Floats]) -> NDArray[np.float32]:
    """The log as observations (T, SIZE + registered fields) of a reference that stands still at
    the first position, with torques (T,) of both sides. Sensors that are missing are NaN."""
    added = [name for name in needs if name not in layout.INDEX]
    rows = np.zeros((len(log.time), layout.SIZE + len(added)), dtype=np.float32)
    values = log.values
    c, s = np.cos(values["yaw"]), np.sin(values["yaw"])
    x, y = values["x"][0] - values["x"], values["y"][0] - values["y"]
    columns = {name: values[name] for name in CHANNELS[3:]}
    columns |= {f"{group}_age": np.minimum(log.age[:, k], 60.0) for k, group in enumerate(GROUPS)}
    columns |= {"position_error_x": c * x + s * y, "position_error_y": c * y - s * x}
    columns |= {"heading_error": -values["yaw"], **dict(zip(TORQUES, torques, strict=True))}
    for name, column in columns.items():
        rows[:, layout.INDEX[name]] = column / SCALE[name]
    for k, name in enumerate(added):
        rows[:, layout.SIZE + k] = values[name] / SCALE[name]
    return rows


def make_stack(log: Log, nominal: PlantParameters, count: int = 1) -> IdentificationStack:
    """The stack for `count` copies of a log."""
    sheet = DataSheet.of(log.sensors)
    return IdentificationStack(nominal, log.period, sheet, count, attitude=log.attitude)


def biases(log: Log) -> dict[str, float]:
    """Magnitude [SI] of the bias of each channel that has one."""
    sheet = log.sensors
    bend = math.sqrt(2.0) * sheet.acceleration_bias / sheet.accelerometer_distance
    magnitudes = {
        "acceleration_x": sheet.acceleration_bias,
        "acceleration_y": sheet.acceleration_bias,
        "yaw_rate": sheet.gyro_bias,
        "yaw_acceleration": bend,
    }
    return {name: bias for name, bias in magnitudes.items() if bias > 0.0}


def half_width(deviation: float, shifts: Sequence[float]) -> float:
    """h for which |n + sum of +-shifts| <= h with probability COVERAGE, n of that deviation."""
    size = sorted(map(abs, shifts), reverse=True)[:6]
    sums = np.array([sum(signs) for signs in itertools.product(*((-s, s) for s in size))])
    if deviation <= 0.0:
        return float(np.abs(sums).max())

    def lacking(h: float) -> float:
        inside = norm.cdf((h - sums) / deviation) - norm.cdf((-h - sums) / deviation)
        return float(np.mean(inside)) - COVERAGE

    return float(brentq(lacking, 0.0, float(np.abs(sums).max()) + 5.0 * deviation))


def _over_time(
    rows: NDArray[np.float32], stack: IdentificationStack
) -> tuple[dict[str, Estimate], Floats, dict[str, Floats]]:
    """Estimates of T rows by estimator, motion (T, 6), and the residuals of both regressions, each
    by the estimates before its sample."""
    answers: dict[str, list[Any]] = {name: [] for name in PARTS}
    residuals: dict[str, list[float]] = {"longitudinal": [], "turning": []}
    motion, before = np.empty((len(rows), 6)), None
    for k, row in enumerate(rows):
        step = stack.update(row[None])
        for name in PARTS:
            answers[name].append(step.parts.answers[name])
        motion[k] = step.motion_rows[0]
        paired = step.reading.paired
        if before is not None and paired.fresh[0, 1] and paired.fresh[0, 2]:
            error = {
                "longitudinal": stack.longitudinal.residual(paired.values, *before[:2]),
                "turning": stack.turning.residual(paired.values, *before),
            }
            for name, value in error.items():
                if math.isfinite(value):
                    residuals[name].append(value)
        straight, turning = (
            part.answer["value"][0] for part in (stack.longitudinal, stack.turning)
        )
        before = 1.0 / straight[0], straight[1], turning[0], turning[1]
    estimators: dict[str, Any] = {name: stack.parts[name] for name in PARTS}
    parts = {
        name: part.estimate(np.concatenate(answers[name])) for name, part in estimators.items()
    }
    return parts, motion, {name: np.array(values) for name, values in residuals.items()}


def _constant(
    rows: NDArray[np.float32], log: Log, nominal: PlantParameters
) -> tuple[dict[str, tuple[float, float]], dict[str, Floats]]:
    """({name: (value, deviation)} at the end without forgetting, shifts by each bias)."""
    shifted = biases(log)
    stack = make_stack(log, nominal, 1 + len(shifted))
    stack.longitudinal.expect_constants()
    stack.turning.expect_constants()
    offsets = np.zeros((1 + len(shifted), rows.shape[1]), dtype=np.float32)
    for k, (name, bias) in enumerate(shifted.items()):
        offsets[1 + k, layout.INDEX[name]] = bias / SCALE[name]
    for row in rows:
        last = stack.update(row + offsets)
    estimates = last.estimates()
    pairs = {name: estimates[name] for name in CONSTANT}
    values = {name: (float(value[0]), float(sigma[0])) for name, (value, sigma) in pairs.items()}
    return values, {name: value[1:] - value[0] for name, (value, _) in pairs.items()}


def _halves_apart(
    rows: NDArray[np.float32], log: Log, nominal: PlantParameters
) -> dict[str, tuple[float, float]]:
    """How far the values of the second half are from those of the first, and the deviation of that,
    by name. A bias is the same in both, so that only what it changes in the difference counts."""
    middle = len(rows) // 2
    first, second = (_constant(part, log, nominal) for part in (rows[:middle], rows[middle:]))
    apart = {}
    for name in CONSTANT:
        (a, spread_a), (b, spread_b) = first[0][name], second[0][name]
        bias = float(np.sum((second[1][name] - first[1][name]) ** 2))
        apart[name] = b - a, math.sqrt(spread_a**2 + spread_b**2 + bias)
    return apart


def _soil(soil: Estimate) -> tuple[dict[str, Parameter], tuple[float, float]]:
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
    soils, prior = {}, np.sqrt(np.diagonal(soil.covariance[0])) / soil.value[0]
    for k, name in enumerate(SOIL):
        value, factor = float(np.exp(mean[k])), float(np.exp(NORMAL * spread[k]))
        before = float(prior[k]) * value  # of the logarithm
        deviation = float(spread[k]) * value
        soils[name] = Parameter(value, deviation, value / factor, value * factor, before, False)
    stiffness = float(np.exp(mean[2]))
    return soils, (stiffness, stiffness * float(spread[2]))


def identify(log: Log, nominal: PlantParameters) -> Identified:
    """Go over a log. nominal: where every estimate begins, and the geometry.

    Raises ValueError for a log that the stack refuses.
    """
    stack = make_stack(log, nominal)
    prior: dict[str, float] = {}  # deviations before the first sample, to first order
    for part in (stack.longitudinal, stack.turning):
        prior |= {q.name: float(q.read(part.read())[1][0]) for q in part.provides}
    turning = turning_of(log.values, log.fresh, log.sensors, nominal)
    rows = observations(log, stack.needs, [log.values[name] for name in TORQUES])
    if turning is not None:  # as if friction were smoothed as the estimators have it
        share = turning.excess * nominal.sprocket_radius / nominal.track_gauge
        for name, sign in zip(TORQUES, (1.0, -1.0), strict=True):
            rows[:, layout.INDEX[name]] += sign * share / SCALE[name]
    parts, motion, residuals = _over_time(rows, stack)
    if log.averaged or turning is not None:  # forces of a moment, for what compares with slips
        raw = observations(log, stack.needs, [log.values[f"raw_{name}"] for name in TORQUES])
        plain, motion, _ = _over_time(raw, make_stack(log, nominal))
        parts |= {name: plain[name] for name in ("slip", "soil")}
    series = {q.name: q.read(parts[name]) for name in PARTS for q in stack.quantities[name]}
    constant, shifts = _constant(rows, log, nominal)
    halves = _halves_apart(rows, log, nominal)
    if turning is not None:
        spreads = turning.inertia_spread, turning.resistance_spread
        for name, spread in zip(("inertia", "lateral_resistance"), spreads, strict=True):
            shifts[name] = np.append(shifts[name], spread * constant[name][0])
    settled = log.time > min(SETTLING, 0.5 * log.time[-1])
    parameters: dict[str, Parameter] = {}
    misfits = {name: misfit(values) for name, values in residuals.items()}
    bounds = stack.longitudinal.bounds() | stack.turning.bounds(constant["mass"][0])
    for name in CONSTANT:
        value, noise = constant[name]
        fit, (low, high) = misfits[EQUATION[name]], bounds[name]
        noise *= max(fit.size, 1.0)  # a data sheet that is too good
        if name == "inertia":
            noise = stack.turning.with_shared_friction(value, noise)
        now, claimed = series[name]
        off = np.abs(now - value) > CHANGE * np.hypot(claimed, noise)
        apart, spread = halves[name]
        changed = bool(np.mean(off[settled]) > CHANGE_SHARE)
        changed = changed or abs(apart) > CHANGE * spread * max(fit.size, 1.0)
        if changed:
            value, deviation = float(now[-1]), float(claimed[-1])
            half = NORMAL * deviation
        else:
            deviation = math.sqrt(noise**2 + float(np.sum(shifts[name] ** 2)))
            half = half_width(noise, list(shifts[name]))
        margin, against = NEAR * (high - low), ""
        if fit.contradicts:
            against = "contradicted"
            if EQUATION[name] == "turning":  # which needs mu_l where tracks oppose
                unknown = parameters["longitudinal_resistance"].verdict == "not determined"
                against = "not determined" if unknown else against
        elif not low + margin < value < high - margin:
            against = "at its bound"
        ends = value - half, value + half
        parameters[name] = Parameter(value, deviation, *ends, prior[name], changed, against)
    soils, stiffness = _soil(parts["soil"])
    straight = parts["longitudinal"]
    return Identified(
        log=log,
        nominal=nominal,
        series=series,
        estimates={name: parts[name] for name in PARTS},
        motion=motion,
        residuals=residuals,
        parameters=parameters | soils,
        resistance_force=_force(straight.value[-1], straight.covariance[-1]),
        stiffness=stiffness,
        misfits=misfits,
    )


def _force(value: Floats, covariance: Floats) -> tuple[float, float]:
    """m g mu_l [N] and its deviation, of 1/m and mu_l with their covariance."""
    inverse, resistance = value
    force = GRAVITY * resistance / inverse
    gradient = np.array([-force / inverse, GRAVITY / inverse])
    return float(force), float(math.sqrt(max(gradient @ covariance @ gradient, 0.0)))
