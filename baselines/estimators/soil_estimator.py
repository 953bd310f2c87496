"""Soil estimator: [F_max, K] of the ground under the tracks, from slips and torques.

A window of samples of both tracks (soil_window) and a damped Gauss-Newton fit of S (7) to it
(soil_regression); the generalised Newton-Raphson method of S with weights and a weak prior.
Identifiability: at u = i l / K << 1 only the stiffness F_max l / (2 K), the slope dF/di at
i = 0, is observable; near i = 1 only F_max. `ratio_only` and `effort_limit` say so.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.3.

What the soil estimator claims to know: the covariance of F_max and K, on a soil that may change.

The fit of soil_regression weighs all samples of its window alike. Its covariance is that of a soil
which never changes; of alternating soils it was too sure by a factor of hundreds. Here with
x = [ln F_max, ln K], Lambda the prior's information, e = x(nominal) - x(estimate):
    M   = Lambda^-1 + e e^T          another soil, drawn from the prior: its second moment about x
    P   = M                          before the first sample, and on a new soil
    P+  = P + q (M - P),  q = 1 - exp(-t / SOJOURN)     after t [s]: with odds q it is another one
    P+  = P - P j^T j P / (R + j P j^T)                 sample: Jacobian j, variance R of the fit
sample by sample, in their order. Without samples P grows to M. A soil ten times as strong is not
within three standard deviations F_max sqrt(P_FF) of a weak one, hence
    sigma_F = F_max (exp(sqrt(P_FF)) - 1), likewise K: one sigma above is one of the logarithm.

The window of the soil estimator: which samples enter it, and what follows from its fit.

Both tracks run on the same soil; each control step gives one sample per track. Per vehicle
and step:
    samples    only fresh drive data, |F| above its noise, belt or ground faster than SLOWEST,
               effort and slip not contradicting each other beyond noise
    outliers   innovation^2 > OUTLIER_GATE S is refused; PATIENCE of them in short succession,
               or windows that no soil explains, are a new soil: the window is emptied.
               Old samples of high slip and new ones of little make K a tenth of any
               soil's, without a misfit: that K tells a mixture too (NO_SOIL)
    fit        by soil_regression, from the last converged values; not converged -> kept
    anchor     the prior mean moves on to the fit in those directions (eigenvectors of the data's
               information in units of the prior's) that the data know DETERMINED times better
               than the prior, and only if they contradict it: else noise would let it drift
               along the directions that are hardly observable
Slip without a filter: i = (r omega - V) / max(|r omega|, |V|), V = v_x -+ w B / 2, with the
variance of first order; the error of v_x is shared by both tracks and counted twice, so that
two equal samples weigh as much as the one that they are.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    POSE,
    AnsweringEstimator,
    DataSheet,
    Estimate,
    Estimator,
    Measurement,
    Quantity,
    Setting,
)
from baselines.estimators.slip_observer import Answer, SlipObserver
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

SOJOURN = 5.0  # [s] mean time on one soil: twice that of the fastest evaluation sets


@formula
def another_soil(memory, i, model):
    """(M_FF, M_FK, M_KK) about the estimate of vehicle i."""
    gap_f = model.nominal_f - memory[i, sr.LOG_F]
    gap_k = model.nominal_k - memory[i, sr.LOG_K]
    return (
        1.0 / model.information_f + gap_f * gap_f,
        gap_f * gap_k,
        1.0 / model.information_k + gap_k * gap_k,
    )


@formula
def _age(p, steps, m, model):
    """P (FF, FK, KK) some control steps later."""
    q = -math.expm1(-model.change_odds * steps)
    return p[0] + q * (m[0] - p[0]), p[1] + q * (m[1] - p[1]), p[2] + q * (m[2] - p[2])


@formula
def _learn(p, by_f, by_k, weight):
    """P after a sample with Jacobian (by_f, by_k) and variance 1 / weight."""
    gain_f, gain_k = p[0] * by_f + p[1] * by_k, p[1] * by_f + p[2] * by_k
    share = weight / (1.0 + weight * (by_f * gain_f + by_k * gain_k))
    return (
        p[0] - share * gain_f * gain_f,
        p[1] - share * gain_f * gain_k,
        p[2] - share * gain_k * gain_k,
    )


@formula
def weigh(memory, i, window, scratch, n, share, model):
    """P of the window (BLOCKS, samples) of vehicle i, fitted with scratch; share: of weights."""
    m = another_soil(memory, i, model)
    p, clock = m, 0.0
    k = 2 * int(memory[i, sr.NEXT]) % n  # the oldest
    for _ in range(n):
        if window[1, k] > 0.0:
            if window[4, k] > clock:
                p = _age(p, window[4, k] - clock, m, model)
                clock = window[4, k]
            p = _learn(p, scratch[0, k], -scratch[1, k], share * scratch[3, k])
        k = k + 1 if k + 1 < n else 0
    p = _age(p, memory[i, sr.TAKEN] - clock, m, model)
    memory[i, sr.P_FF], memory[i, sr.P_FK], memory[i, sr.P_KK] = p


@formula
def forget(memory, i, model):
    """Another soil: nothing is known but the law of soils."""
    memory[i, sr.P_FF], memory[i, sr.P_FK], memory[i, sr.P_KK] = another_soil(memory, i, model)


@formula
def logarithmic(memory, i, model):
    """(P_FF, P_FK, P_KK) of now."""
    p = memory[i, sr.P_FF], memory[i, sr.P_FK], memory[i, sr.P_KK]
    return _age(p, memory[i, sr.CLOCK] - memory[i, sr.TAKEN], another_soil(memory, i, model), model)


@formula
def write(memory, i, model, value, covariance):
    """F_max [N], K [m] into value (N, 2), and their claimed covariance (N, 2, 2)."""
    maximum, modulus = math.exp(memory[i, sr.LOG_F]), math.exp(memory[i, sr.LOG_K])
    ff, fk, kk = logarithmic(memory, i, model)
    sigma_f, sigma_k = maximum * math.expm1(math.sqrt(ff)), modulus * math.expm1(math.sqrt(kk))
    value[i, 0], value[i, 1] = maximum, modulus
    covariance[i, 0, 0], covariance[i, 1, 1] = sigma_f * sigma_f, sigma_k * sigma_k
    covariance[i, 0, 1] = covariance[i, 1, 0] = fk / math.sqrt(ff * kk) * sigma_f * sigma_k


SLOWEST = 0.1  # [m/s] belt or ground must be faster: below it slip is noise
CONTRADICTION = 4.0  # [-] standard deviations by which a slip may be outside [0, 1]
OUTLIER_GATE = 25.0  # [-] five standard deviations
PATIENCE = 4  # [steps] that many outliers, or misfits in a row, are a new soil
START_SHARE = 1.1  # [-] F_max over the largest effort seen, first guess on a new soil
RECOVERY = 0.1  # [steps] by which a sample that fits lowers the count of outliers
DETERMINED = 25.0  # [-] data over prior information: F_max to 0.2 of itself, see PRIOR
SIGNIFICANT = 9.0  # [-] squared distance to the fit, in its variances, that moves the anchor
NO_SOIL = 9.0  # [-] squared distance to the nominal ln K, in the prior's variances, of no soil
MISFIT = 4.0  # [-] cost per sample of a window that mixes two soils; 1 is expected
SURPRISE = 9.0  # [-] normalised innovation squared that makes a holding vehicle fit at once
HOLD_STRIDE = 5  # [steps] between the fits of a vehicle that holds, with a full window

_BELT, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]
_V_X, _YAW_RATE = COLUMN["v_x"], COLUMN["yaw_rate"]


class Sensing(NamedTuple):
    """How slips and efforts follow from the channels, and how exactly."""

    radius: float  # [m] r
    half_gauge: float  # [m] B/2
    belt_variance: float  # [m^2/s^2] of V_t
    track_variance: float  # [m^2/s^2] of V; what both tracks share counts twice
    slip_variance: float  # [-] added to the variance of every slip
    least_effort: float  # [N]
    given_scale: float  # [-] on the variance of slips that are given
    window: int  # [control steps]


class Sample(NamedTuple):
    """One track's sample, mirrored so that the effort is positive. effort 0 = none."""

    slip: float
    effort: float
    variance: float


@formula
def _kinematic_slip(belt, track, sensing):
    """(slip ratio [-], its variance) from belt and track speed [m/s]."""
    larger = max(abs(belt), abs(track))
    inverse = 1.0 / max(larger, SLOWEST)
    belt_leads = abs(belt) >= abs(track)
    ratio = (track if belt_leads else belt) * inverse
    leading = sensing.belt_variance if belt_leads else sensing.track_variance
    trailing = sensing.track_variance if belt_leads else sensing.belt_variance
    variance = (trailing + ratio * ratio * leading) * inverse * inverse
    return soil.slip_ratio(belt, track), variance


@formula
def _sample(values, i, side, given, slips, variances, sensing):
    """Sample of one track of vehicle i; side 0 left, 1 right. NaN effort: a channel is missing."""
    belt = values[i, _BELT + side] * sensing.radius
    torque = values[i, _TORQUE + side]
    track = values[i, _V_X] + (2.0 * side - 1.0) * sensing.half_gauge * values[i, _YAW_RATE]
    slip, variance = _kinematic_slip(belt, track, sensing)
    speed = max(abs(belt), abs(track))
    if given:
        slip, variance = slips[i, side], variances[i, side] * sensing.given_scale
        # The ground moves at least as the slip says, also where v_x is missing.
        speed = max(abs(belt), abs(belt) * (1.0 - slip))
    variance += sensing.slip_variance
    effort = torque / sensing.radius
    forward = slip if effort >= 0.0 else -slip
    reach = CONTRADICTION * math.sqrt(variance)
    good = abs(effort) > sensing.least_effort and speed > SLOWEST
    good = good and forward > -reach and forward < 1.0 + reach and variance < math.inf
    missing = math.isnan(slip + variance + effort + belt)
    size = abs(effort) if good else 0.0
    return Sample(forward, math.nan if missing else size, variance)


@formula
def _covariance(memory, i, model):
    """(P_FF, P_FK, P_KK) of (ln F_max, ln K)."""
    a = memory[i, sr.J_FF] + model.information_f
    b = memory[i, sr.J_FK]
    c = memory[i, sr.J_KK] + model.information_k
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def _innovation(memory, i, sample, star, model):
    """Squared innovation of a sample with fitted slip `star` over its expected variance [-]."""
    log_f, log_k = memory[i, sr.LOG_F], memory[i, sr.LOG_K]
    force, twist, error, weight, _star, _gain = sr.residual(
        sample.slip, sample.effort, sample.variance, star,
        math.exp(log_f), model.contact_length * math.exp(-log_k), model,
    )  # fmt: skip
    ff, fk, kk = _covariance(memory, i, model)
    spread = force * force * ff - 2.0 * force * twist * fk + twist * twist * kk
    return error * error / (1.0 / weight + spread)


@formula
def _insert(memory, i, slot, sample, star, samples):
    """Write a sample with fitted slip `star`, or an empty one, into the ring."""
    base = sr.HEADER + slot
    used = sample.effort > 0.0
    memory[i, base] = sample.slip if used else 0.0
    memory[i, base + samples] = sample.effort if used else 0.0
    memory[i, base + 2 * samples] = sample.variance if used else 0.0
    memory[i, base + 3 * samples] = star if used else 0.0
    memory[i, base + 4 * samples] = memory[i, sr.CLOCK]


@formula
def _move_anchor(memory, i, model):
    """Let the prior mean follow the fit in the directions that the data determine."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    smallest, largest, cosine, sine = sr.eigen(
        memory[i, sr.J_FF] * s_f * s_f, memory[i, sr.J_FK] * s_f * s_k,
        memory[i, sr.J_KK] * s_k * s_k,
    )  # fmt: skip
    gap_f = (memory[i, sr.LOG_F] - memory[i, sr.ANCHOR_F]) / s_f
    gap_k = (memory[i, sr.LOG_K] - memory[i, sr.ANCHOR_K]) / s_k
    strong, weak = cosine * gap_f + sine * gap_k, cosine * gap_k - sine * gap_f
    if largest < DETERMINED or strong * strong * largest < SIGNIFICANT:
        strong = 0.0
    if smallest < DETERMINED or weak * weak * smallest < SIGNIFICANT:
        weak = 0.0
    memory[i, sr.ANCHOR_F] += s_f * (cosine * strong - sine * weak)
    memory[i, sr.ANCHOR_K] += s_k * (sine * strong + cosine * weak)


@formula
def _empty(memory, i, model):
    """A new soil: forget the window of vehicle i; the estimate stays as the first guess."""
    memory[i, sr.CHANGES] += 1.0
    for column in (sr.OUTLIERS, sr.MISFITS, sr.FILLED, sr.NEXT, sr.J_FF, sr.J_FK, sr.J_KK):
        memory[i, column] = 0.0
    forget(memory, i, model)
    memory[i, sr.CONVERGED] = 0.0


@formula
def _start(memory, i, window, n, model):
    """(ln F_max, ln K) to start the fit from: the last converged values.

    After a new soil or a fit that failed: an F_max that just carries the largest effort in the
    window, and the anchor's K; the fitted slips start anew too.
    """
    log_f, log_k = memory[i, sr.LOG_F], memory[i, sr.LOG_K]
    if memory[i, sr.CONVERGED] < 0.5:
        largest = math.exp(model.low_f)
        for k in range(n):
            largest = max(largest, window[1, k])
        log_f = min(math.log(START_SHARE * largest), model.high_f)
        log_k = memory[i, sr.ANCHOR_K]
        for k in range(0, n, 2):  # both tracks of a step
            left = Sample(window[0, k], window[1, k], window[2, k])
            right = Sample(window[0, k + 1], window[1, k + 1], window[2, k + 1])
            star_left, star_right = sr.sample_slips(left, right, log_f, log_k, model)
            if left.effort > 0.0:
                window[3, k] = star_left
            if right.effort > 0.0:
                window[3, k + 1] = star_right
    return log_f, log_k


@formula
def _fit(memory, i, scratch, samples, model):
    """Fit the window of vehicle i and remember the result if it converged."""
    window = memory[i][sr.HEADER :].reshape(sr.BLOCKS, samples)
    n = int(2.0 * memory[i, sr.FILLED])
    log_f, log_k, normal, iterations, converged = sr.fit(
        window, n, scratch, _start(memory, i, window, n, model),
        (memory[i, sr.ANCHOR_F], memory[i, sr.ANCHOR_K]), model,
    )  # fmt: skip
    memory[i, sr.ITERATIONS] = iterations
    memory[i, sr.CONVERGED] = 1.0 if converged else 0.0
    memory[i, sr.WAITING] = 0.0
    gap = log_k - model.nominal_k
    misfit = normal.cost > MISFIT * max(normal.samples, 1.0)
    misfit = misfit or gap * gap * model.information_k > NO_SOIL
    memory[i, sr.MISFITS] = memory[i, sr.MISFITS] + 1.0 if misfit else 0.0
    if memory[i, sr.MISFITS] >= PATIENCE and normal.samples > 2 * PATIENCE:
        _empty(memory, i, model)
    elif converged:
        # A fit worse than the noise explains knows less (Birge ratio).
        share = 1.0 / max(normal.cost / max(normal.samples, 1.0), 1.0)
        memory[i, sr.LOG_F] = log_f
        memory[i, sr.LOG_K] = log_k
        memory[i, sr.J_FF] = share * normal.ff
        memory[i, sr.J_FK] = share * normal.fk
        memory[i, sr.J_KK] = share * normal.kk
        weigh(memory, i, window, scratch, n, share, model)
        _move_anchor(memory, i, model)


@formula
def _excitation(memory, i, model):
    """(smallest, largest) eigenvalue of the information in units of the prior's [-]."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    smallest, largest, _cosine, _sine = sr.eigen(
        memory[i, sr.J_FF] * s_f * s_f, memory[i, sr.J_FK] * s_f * s_k,
        memory[i, sr.J_KK] * s_k * s_k,
    )  # fmt: skip
    return smallest, largest


@formula
def _step(memory, i, left, right, scratch, sensing, model):
    """Take the samples of both tracks. Returns (refused, mean innovation squared or NaN)."""
    count, total, worst = 0.0, 0.0, 0.0
    star_left, star_right = sr.sample_slips(
        left, right, memory[i, sr.LOG_F], memory[i, sr.LOG_K], model
    )
    for side in range(2):
        sample = left if side == 0 else right
        if sample.effort > 0.0:
            star = star_left if side == 0 else star_right
            nis = _innovation(memory, i, sample, star, model)
            count += 1.0
            total += nis
            worst = max(worst, nis)
    refused = worst > OUTLIER_GATE
    memory[i, sr.ITERATIONS] = 0.0
    if count > 0.0:
        outliers = memory[i, sr.OUTLIERS]
        memory[i, sr.OUTLIERS] = outliers + 1.0 if refused else max(outliers - RECOVERY, 0.0)
        if memory[i, sr.OUTLIERS] >= PATIENCE:
            _empty(memory, i, model)
            refused = False
        if not refused:
            memory[i, sr.TAKEN] = memory[i, sr.CLOCK]
            samples = 2 * sensing.window
            slot = 2 * int(memory[i, sr.NEXT])
            _insert(memory, i, slot, left, star_left, samples)
            _insert(memory, i, slot + 1, right, star_right, samples)
            memory[i, sr.NEXT] = (memory[i, sr.NEXT] + 1.0) % sensing.window
            full = memory[i, sr.FILLED] >= sensing.window
            memory[i, sr.FILLED] = min(memory[i, sr.FILLED] + 1.0, float(sensing.window))
            smallest, _largest = _excitation(memory, i, model)
            memory[i, sr.WAITING] += 1.0
            waits = full and smallest < DETERMINED and worst < SURPRISE
            if not waits or memory[i, sr.WAITING] >= HOLD_STRIDE:
                _fit(memory, i, scratch, samples, model)
    return refused, total / count if count > 0.0 else math.nan


@loop
def update_all(
    memory, values, fresh, given, slips, variances, sensing, model, scratch,
    value, covariance, summary, status, known, fitted,
):  # fmt: skip
    """One sample of every vehicle; the last six arrays are written: summary (N, 4) excitation,
    condition, NIS, skipped; known (N,) whether the data determine the effort limit; fitted
    (N, 2, 2) covariance by the fit alone, as if the soil never changed."""
    for i in range(memory.shape[0]):
        refused, innovation = False, math.nan
        memory[i, sr.ITERATIONS] = 0.0
        memory[i, sr.CLOCK] += 1.0
        if fresh[i, DRIVE] and (given or fresh[i, POSE]):
            left = _sample(values, i, 0, given, slips, variances, sensing)
            right = _sample(values, i, 1, given, slips, variances, sensing)
            if math.isnan(left.effort + right.effort):
                memory[i, sr.SKIPPED] += 1.0
                refused = True
            else:
                refused, innovation = _step(memory, i, left, right, scratch, sensing, model)
        write(memory, i, model, value, covariance)
        ff, fk, kk = _covariance(memory, i, model)
        fitted[i, 0, 0] = ff * value[i, 0] * value[i, 0]
        fitted[i, 0, 1] = fitted[i, 1, 0] = fk * value[i, 0] * value[i, 1]
        fitted[i, 1, 1] = kk * value[i, 1] * value[i, 1]
        smallest, largest = _excitation(memory, i, model)
        summary[i, 0] = smallest
        summary[i, 1] = largest / smallest if smallest > 0.0 else math.inf
        summary[i, 2] = innovation
        summary[i, 3] = memory[i, sr.SKIPPED]
        status[i] = 2 if refused else (0 if smallest > DETERMINED else 1)
        _limit, known[i] = sr.effort_limit(memory, i, model.contact_length)


EFFORT_RANGE = (100.0, 1e6)  # [N] bounds of F_max
EFFORT_FLOOR = 5.0  # [N] sigma of the model: F is not quite quasi-static
SLIP_FLOOR = 2e-4  # [-] sigma of the model, likewise
CLEAR_EFFORT = 5.0  # [-] standard deviations that an effort must be above zero
# The UKF's slip errors hang together over some samples: variance counts that much more.
SLIP_CORRELATION = 10.0  # [control steps]
# In the stack. A second after a change of the soil, and of the slips behind it, all is new.
WINDOW = 40  # [control steps]
PRIOR_SIGMA = (1.0, 0.7)  # [-] of ln F_max (weak soil to clay: a factor e), ln K (1 to 6 cm)
_WINDOW = Range(2, 10000, "control steps", "Did you pass seconds?")
_ITERATIONS = Range(1, 1000, "-", "S allows 20.")
_CORRELATED = Range(1.0, 1e4, "control steps", "1 = white.")
_CORRELATION = Range(0.0, 1.0, "-", "It is a coefficient.")


def nominal_effort_maximum(parameters: PlantParameters) -> float:
    """F_max of one track [N]."""
    return float(lumped.drive_limits(parameters).effort_maximum)


class SoilEstimator(AnsweringEstimator):
    """Estimates [F_max [N], K [m]] of vehicles on the move.

    parameters: nominal; its soil is the first guess. count: vehicles N.
    window: [control steps] 50 as in S. iterations: at most, per update, 20 as in S.
    residual: "total" (both errors) or "effort" (S (43)); see soil_regression.
    correlation_steps: [control steps] over which errors of given slips are correlated; 1 =
    white. A filter's slip needs more, else the covariance is too small.
    Raises ValueError for a parameter or option outside its range.
    """

    names = ("effort_maximum", "shear_deformation_modulus")
    provides = (
        Quantity("effort_maximum", "N", nominal_effort_maximum, True),
        Quantity("shear_deformation_modulus", "m", "shear_deformation_modulus", True),
    )
    needs = (
        "v_x", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right", "torque_left",
        "torque_right", "slip_left", "slip_right",
    )  # fmt: skip
    paired = False

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        window: int = 50,
        iterations: int = 20,
        residual: str = "total",
        correlation_steps: float = 1.0,
    ) -> None:
        for name in (
            "mass", "track_width", "track_gauge", "contact_length", "sprocket_radius", "cohesion",
            "friction_angle", "shear_deformation_modulus",
        ):  # fmt: skip
            checked_number(f"nominal {name}", getattr(parameters, name), RANGES[name])
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        window = checked_whole("window", window, _WINDOW)
        iterations = checked_whole("iterations", iterations, _ITERATIONS)
        checked_number("correlation_steps", correlation_steps, _CORRELATED)
        for name in ("torque_noise", "sprocket_speed_noise", "velocity_noise", "gyro_noise"):
            checked_number(name, getattr(data_sheet, name), SIGMA)
        if residual not in ("total", "effort"):
            raise ValueError(f"residual = {residual!r}; must be 'total' or 'effort'")
        p, sheet = parameters, data_sheet
        radius, half = float(p.sprocket_radius), 0.5 * float(p.track_gauge)
        effort = math.hypot(sheet.torque_noise / radius, EFFORT_FLOOR)
        maximum = soil.maximum_tractive_effort(
            p.cohesion, p.friction_angle, p.track_width, p.contact_length, p.mass
        )
        maximum = min(max(maximum, EFFORT_RANGE[0]), EFFORT_RANGE[1])
        self._nominal = math.log(maximum), math.log(p.shear_deformation_modulus)
        low_k, high_k = RANGES["shear_deformation_modulus"][:2]
        self._model = sr.Model(
            float(p.contact_length), effort * effort,
            1.0 / PRIOR_SIGMA[0] ** 2, 1.0 / PRIOR_SIGMA[1] ** 2,
            math.log(EFFORT_RANGE[0]), math.log(EFFORT_RANGE[1]),
            math.log(low_k), math.log(high_k), residual == "total", int(iterations),
            *self._nominal, control_period / SOJOURN,
        )  # fmt: skip
        turn = half * half * (sheet.gyro_noise**2 + sheet.gyro_bias**2)
        self._sensing = Sensing(
            radius, half, (radius * sheet.sprocket_speed_noise) ** 2,
            2.0 * sheet.velocity_noise**2 + turn, SLIP_FLOOR**2, CLEAR_EFFORT * effort,
            float(correlation_steps), int(window),
        )  # fmt: skip
        self._given: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._nothing = np.zeros((count, 2))
        # (N,) whether the data determined the effort limit after the last sample
        self.limit_known = np.zeros(count, dtype=bool)
        samples = 2 * int(window)
        self.memory = np.zeros((count, sr.HEADER + sr.BLOCKS * samples))
        self.fitted = np.empty((count, 2, 2))  # covariance on a soil that never changes
        self._scratch = np.zeros((2 * sr.ROWS + 1, samples))
        self.reset()

    @classmethod
    def for_stack(cls, setting: Setting) -> "SoilEstimator":
        """As a part of the identification stack."""
        return cls(
            setting.parameters, setting.control_period, setting.data_sheet, setting.count,
            window=WINDOW, correlation_steps=SLIP_CORRELATION,
        )  # fmt: skip

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """The slips of the filter."""
        source = parts["slip"]
        assert isinstance(source, SlipObserver)
        self._given = source.slips_and_variances()

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all of the vehicles `rows` (indices or a mask), or of all."""
        where = slice(None) if rows is None else np.asarray(rows)
        self.memory[where] = 0.0
        for columns in ((sr.LOG_F, sr.LOG_K), (sr.ANCHOR_F, sr.ANCHOR_K)):
            for column, number in zip(columns, self._nominal, strict=True):
                self.memory[where, column] = number
        self.memory[where, sr.CONVERGED] = 1.0
        self.memory[where, sr.P_FF] = PRIOR_SIGMA[0] ** 2
        self.memory[where, sr.P_KK] = PRIOR_SIGMA[1] ** 2

    def provide_slip(self, slip: ArrayLike, variance: ArrayLike, correlation: float = 0.0) -> None:
        """Slip ratios (N, 2) and their variances for the next update, such as a filter's.

        correlation: of the errors of the two tracks, in [0, 1]. Without this call the slip
        follows from sprocket speeds, v_x and yaw rate of the measurement. Raises ValueError
        for other shapes.
        """
        shape = (len(self.memory), 2)
        arrays = np.array(slip, dtype=float), np.array(variance, dtype=float)
        if arrays[0].shape != shape or arrays[1].shape != shape:
            raise ValueError(f"slip {arrays[0].shape}, variance {arrays[1].shape}; must be {shape}")
        self._given = (
            arrays[0],
            arrays[1] * (1.0 + checked_number("correlation", correlation, _CORRELATION)),
        )

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle; uses provided slips once."""
        count = len(self.memory)
        if measurement.values.shape[0] != count:
            raise ValueError(
                f"measurement of {measurement.values.shape[0]} vehicles; this estimates {count}"
            )
        return self.estimate(self.compute(measurement))

    def compute(self, measurement: Measurement) -> Answer:
        """Take one sample; returns the bare answer: value, covariance, summary, status."""
        count = len(self.memory)
        slips, variances = self._given or (self._nothing, self._nothing)
        value, covariance = np.empty((count, 2)), np.empty((count, 2, 2))
        summary, status = np.empty((count, 4)), np.empty(count, dtype=np.int64)
        self.limit_known = np.empty(count, dtype=bool)
        update_all(
            self.memory, measurement.values, measurement.fresh, self._given is not None, slips,
            variances, self._sensing, self._model, self._scratch, value, covariance, summary,
            status, self.limit_known, self.fitted,
        )  # fmt: skip
        self._given = None
        return value, covariance, summary, status

    def estimate(self, answer: Answer) -> Estimate:
        """The bare answer as an Estimate."""
        value, covariance, summary, status = answer
        return Estimate(
            self.names, value, covariance, summary[:, 0], summary[:, 1], status,
            summary[:, 2], summary[:, 3].astype(np.int64),
        )  # fmt: skip

    @property
    def iterations(self) -> NDArray[np.int64]:
        """Steps of the fit in the last update, (N,); 0 where there was none."""
        return self.memory[:, sr.ITERATIONS].astype(np.int64)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether the last fit converged, (N,); else the values before it are kept."""
        return self.memory[:, sr.CONVERGED] > 0.5

    @property
    def changes(self) -> NDArray[np.int64]:
        """New soils found so far, (N,)."""
        return self.memory[:, sr.CHANGES].astype(np.int64)

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """F_max l / (2 K) [N], the slope dF/di at i = 0, (N,)."""
        difference = self.memory[:, sr.LOG_F] - self.memory[:, sr.LOG_K]
        return 0.5 * self._model.contact_length * np.exp(difference)

    @property
    def stiffness_deviation(self) -> NDArray[np.float64]:
        """Standard deviation [N] of the stiffness, from data and prior, (N,)."""
        return self.stiffness * np.sqrt(self._variance(-1.0, self._model))

    def _variance(
        self, twist: float | NDArray[np.float64], model: sr.Model | None
    ) -> NDArray[np.float64]:
        """Variance of ln F_max + twist ln K; without a model from the data alone (or inf)."""
        prior = (0.0, 0.0) if model is None else (model.information_f, model.information_k)
        a, b = self.memory[:, sr.J_FF] + prior[0], self.memory[:, sr.J_FK]
        c = self.memory[:, sr.J_KK] + prior[1]
        determinant = a * c - b * b
        safe = determinant > 1e-12 * a * c
        numerator = c - 2.0 * b * twist + a * np.square(twist)
        return np.divide(numerator, determinant, out=np.full(len(a), np.inf), where=safe)

    @property
    def ratio_only(self) -> NDArray[np.bool_]:
        """True where the data determine the stiffness, but not F_max, to 20 %, (N,)."""
        stiff = self._variance(-1.0, self._model) * DETERMINED <= 1.0
        return stiff & (self._variance(0.0, None) * DETERMINED > 1.0)

    def effort_limit(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """(F(i = 1) [N] of one track, whether the data of the window determine it to 10 %)."""
        count = len(self.memory)
        limit, trusted = np.empty(count), np.empty(count, dtype=bool)
        sr.limits(self.memory, self._model.contact_length, limit, trusted)
        return limit, trusted
