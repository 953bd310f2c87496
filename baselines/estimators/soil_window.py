"""The window of the soil estimator: which samples enter it, and what follows from its fit.

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
from typing import NamedTuple

from baselines.estimators import soil_claim
from baselines.estimators import soil_regression as sr
from baselines.estimators.sensor_samples import COLUMN, DRIVE, POSE
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop

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
    soil_claim.forget(memory, i, model)
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
        soil_claim.weigh(memory, i, window, scratch, n, share, model)
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
        soil_claim.write(memory, i, model, value, covariance)
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
