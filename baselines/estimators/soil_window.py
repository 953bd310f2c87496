"""The window of the soil estimator: which samples enter it, its fit, and the claimed covariance.

Both tracks run on the same soil; each control step gives one sample per track. Per vehicle
and step:
    samples    only fresh drive data, |F| above its noise, belt or ground faster than SLOWEST,
               effort and slip not contradicting each other beyond noise
    outliers   innovation^2 > OUTLIER_GATE S is refused; PATIENCE of them in short succession,
               or windows that no soil explains, are a new soil: the window is emptied.
               Old samples of high slip and new ones of little make K a tenth of any
               soil's, without a misfit: such a K is a sign of a mixture too (NO_SOIL)
    fit        by soil_regression, from the last converged values, which stay where it does not
               converge
    anchor     the prior mean moves on to the fit in those directions (eigenvectors of the data's
               information in units of the prior's) that the data determine DETERMINED times
               better than the prior, and only if they contradict it: else noise would let it drift
               along the directions that are hardly observable
Slip without a filter: i = (r omega - V) / max(|r omega|, |V|), V = v_x -+ w B / 2, with the
variance of first order; the error of v_x is shared by both tracks and counted twice, so that
two equal samples weigh as much as the one that they are.

Claimed covariance: the fit of soil_regression weighs all samples of its window alike. Its
covariance is that of a soil which never changes; of alternating soils it was too sure by a factor
of hundreds. Here with
x = [ln F_max, ln K], Lambda the prior's information, e = x(nominal) - x(estimate):
    M   = Lambda^-1 + e e^T          another soil, drawn from the prior: its second moment about x
    P   = M                          before the first sample, and on a new soil
    P+  = P + q (M - P),  q = 1 - exp(-t / SOJOURN)     after t [s]: with odds q it is another one
    P+  = P - P j^T j P / (R + j P j^T)                 sample: Jacobian j, variance R of the fit
sample by sample, in their order. Without samples P grows to M. A soil ten times as strong is not
within three standard deviations F_max sqrt(P_FF) of a weak one, hence
    sigma_F = F_max (exp(sqrt(P_FF)) - 1), likewise K: one sigma above is one of the logarithm.
"""

import math
from typing import NamedTuple

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import COLUMN, DRIVE, POSE
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop

SOJOURN = 5.0  # [s] mean time on one soil: twice that of the fastest evaluation sets
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
    provided_scale: float  # [-] on the variance of slips that are provided
    window: int  # [control steps]


class Sample(NamedTuple):
    """One track's sample, mirrored so that the effort is positive. effort 0 = none."""

    slip: float
    effort: float
    variance: float


@formula
def another_soil(row, model):
    """(M_FF, M_FK, M_KK) about the estimate of vehicle i."""
    gap_f = model.nominal_f - row.log_f
    gap_k = model.nominal_k - row.log_k
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
def weigh(row, window, scratch, n, share, model):
    """P of the window (BLOCKS, samples) of vehicle i, fitted with scratch; share: of weights."""
    m = another_soil(row, model)
    p, clock = m, 0.0
    k = 2 * int(row.next) % n  # the oldest
    for _ in range(n):
        if window[sr.EFFORT, k] > 0.0:
            if window[sr.CLOCK, k] > clock:
                p = _age(p, window[sr.CLOCK, k] - clock, m, model)
                clock = window[sr.CLOCK, k]
            p = _learn(p, scratch[0, k], -scratch[1, k], share * scratch[3, k])
        k = k + 1 if k + 1 < n else 0
    p = _age(p, row.taken - clock, m, model)
    row.p_ff, row.p_fk, row.p_kk = p


@formula
def forget(row, model):
    """Another soil: nothing is known but the law of soils."""
    row.p_ff, row.p_fk, row.p_kk = another_soil(row, model)


@formula
def logarithmic(row, model):
    """(P_FF, P_FK, P_KK) of now."""
    p = row.p_ff, row.p_fk, row.p_kk
    return _age(p, row.clock - row.taken, another_soil(row, model), model)


@formula
def write(row, model, value, covariance):
    """F_max [N], K [m] into value (2,), and their claimed covariance (2, 2)."""
    maximum, modulus = math.exp(row.log_f), math.exp(row.log_k)
    ff, fk, kk = logarithmic(row, model)
    sigma_f, sigma_k = maximum * math.expm1(math.sqrt(ff)), modulus * math.expm1(math.sqrt(kk))
    value[0], value[1] = maximum, modulus
    covariance[0, 0], covariance[1, 1] = sigma_f * sigma_f, sigma_k * sigma_k
    covariance[0, 1] = covariance[1, 0] = fk / math.sqrt(ff * kk) * sigma_f * sigma_k


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
def _sample(values, side, slips, sensing):
    """Sample of one track; side 0 left, 1 right. NaN effort: a channel is missing.

    values (CHANNELS,). slips: whether slips are provided, and these with their variances (2,).
    """
    provided, ratios, variances = slips
    belt = values[_BELT + side] * sensing.radius
    torque = values[_TORQUE + side]
    track = values[_V_X] + (2.0 * side - 1.0) * sensing.half_gauge * values[_YAW_RATE]
    slip, variance = _kinematic_slip(belt, track, sensing)
    speed = max(abs(belt), abs(track))
    if provided:
        slip, variance = ratios[side], variances[side] * sensing.provided_scale
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
def _covariance(row, model):
    """(P_FF, P_FK, P_KK) of (ln F_max, ln K)."""
    a = row.j_ff + model.information_f
    b = row.j_fk
    c = row.j_kk + model.information_k
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def _innovation(row, sample, star, model):
    """Squared innovation of a sample with fitted slip `star` over its expected variance [-]."""
    log_f, log_k = row.log_f, row.log_k
    force, twist, error, weight, _star, _gain = sr.residual(
        sample.slip, sample.effort, sample.variance, star,
        math.exp(log_f), model.contact_length * math.exp(-log_k), model,
    )  # fmt: skip
    ff, fk, kk = _covariance(row, model)
    spread = force * force * ff - 2.0 * force * twist * fk + twist * twist * kk
    return error * error / (1.0 / weight + spread)


@formula
def _insert(row, window, slot, sample, star):
    """Write a sample with fitted slip `star`, or an empty one, into the window."""
    used = sample.effort > 0.0
    window[sr.SLIP, slot] = sample.slip if used else 0.0
    window[sr.EFFORT, slot] = sample.effort if used else 0.0
    window[sr.VARIANCE, slot] = sample.variance if used else 0.0
    window[sr.STAR, slot] = star if used else 0.0
    window[sr.CLOCK, slot] = row.clock


@formula
def _move_anchor(row, model):
    """Let the prior mean follow the fit in the directions that the data determine."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    smallest, largest, cosine, sine = sr.eigen(
        row.j_ff * s_f * s_f, row.j_fk * s_f * s_k,
        row.j_kk * s_k * s_k,
    )  # fmt: skip
    gap_f = (row.log_f - row.anchor_f) / s_f
    gap_k = (row.log_k - row.anchor_k) / s_k
    strong, weak = cosine * gap_f + sine * gap_k, cosine * gap_k - sine * gap_f
    if largest < DETERMINED or strong * strong * largest < SIGNIFICANT:
        strong = 0.0
    if smallest < DETERMINED or weak * weak * smallest < SIGNIFICANT:
        weak = 0.0
    row.anchor_f += s_f * (cosine * strong - sine * weak)
    row.anchor_k += s_k * (sine * strong + cosine * weak)


@formula
def _empty(row, model):
    """A new soil: forget the window of vehicle i; the estimate stays as the first guess."""
    row.changes += 1.0
    row.outliers = row.misfits = row.filled = row.next = 0.0
    row.j_ff = row.j_fk = row.j_kk = 0.0
    forget(row, model)
    row.converged = 0.0


@formula
def _start(row, window, n, model):
    """(ln F_max, ln K) to start the fit from: the last converged values.

    After a new soil or a fit that failed: an F_max that just carries the largest effort in the
    window, and the anchor's K; the fitted slips start anew too.
    """
    log_f, log_k = row.log_f, row.log_k
    if row.converged < 0.5:
        largest = math.exp(model.low_f)
        for k in range(n):
            largest = max(largest, window[sr.EFFORT, k])
        log_f = min(math.log(START_SHARE * largest), model.high_f)
        log_k = row.anchor_k
        for k in range(0, n, 2):  # both tracks of a step
            left = Sample(window[sr.SLIP, k], window[sr.EFFORT, k], window[sr.VARIANCE, k])
            right = Sample(
                window[sr.SLIP, k + 1], window[sr.EFFORT, k + 1], window[sr.VARIANCE, k + 1]
            )
            star_left, star_right = sr.sample_slips(left, right, log_f, log_k, model)
            if left.effort > 0.0:
                window[sr.STAR, k] = star_left
            if right.effort > 0.0:
                window[sr.STAR, k + 1] = star_right
    return log_f, log_k


@formula
def _fit(row, window, scratch, model):
    """Fit the window of vehicle i and remember the result if it converged."""
    n = int(2.0 * row.filled)
    log_f, log_k, normal, iterations, converged = sr.fit(
        window, n, scratch, _start(row, window, n, model),
        (row.anchor_f, row.anchor_k), model,
    )  # fmt: skip
    row.iterations = iterations
    row.converged = 1.0 if converged else 0.0
    row.waiting = 0.0
    gap = log_k - model.nominal_k
    misfit = normal.cost > MISFIT * max(normal.samples, 1.0)
    misfit = misfit or gap * gap * model.information_k > NO_SOIL
    row.misfits = row.misfits + 1.0 if misfit else 0.0
    if row.misfits >= PATIENCE and normal.samples > 2 * PATIENCE:
        _empty(row, model)
    elif converged:
        # A fit worse than the noise explains knows less (Birge ratio).
        share = 1.0 / max(normal.cost / max(normal.samples, 1.0), 1.0)
        row.log_f = log_f
        row.log_k = log_k
        row.j_ff = share * normal.ff
        row.j_fk = share * normal.fk
        row.j_kk = share * normal.kk
        weigh(row, window, scratch, n, share, model)
        _move_anchor(row, model)


@formula
def _excitation(row, model):
    """(smallest, largest) eigenvalue of the information in units of the prior's [-]."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    smallest, largest, _cosine, _sine = sr.eigen(
        row.j_ff * s_f * s_f, row.j_fk * s_f * s_k,
        row.j_kk * s_k * s_k,
    )  # fmt: skip
    return smallest, largest


@formula
def _step(row, window, left, right, scratch, sensing, model):
    """Take the samples of both tracks. Returns (refused, mean innovation squared or NaN)."""
    count, total, worst = 0.0, 0.0, 0.0
    star_left, star_right = sr.sample_slips(left, right, row.log_f, row.log_k, model)
    for side in range(2):
        sample = left if side == 0 else right
        if sample.effort > 0.0:
            star = star_left if side == 0 else star_right
            nis = _innovation(row, sample, star, model)
            count += 1.0
            total += nis
            worst = max(worst, nis)
    refused = worst > OUTLIER_GATE
    row.iterations = 0.0
    if count > 0.0:
        outliers = row.outliers
        row.outliers = outliers + 1.0 if refused else max(outliers - RECOVERY, 0.0)
        if row.outliers >= PATIENCE:
            _empty(row, model)
            refused = False
        if not refused:
            row.taken = row.clock
            slot = 2 * int(row.next)
            _insert(row, window, slot, left, star_left)
            _insert(row, window, slot + 1, right, star_right)
            row.next = (row.next + 1.0) % sensing.window
            full = row.filled >= sensing.window
            row.filled = min(row.filled + 1.0, float(sensing.window))
            smallest, _largest = _excitation(row, model)
            row.waiting += 1.0
            waits = full and smallest < DETERMINED and worst < SURPRISE
            if not waits or row.waiting >= HOLD_STRIDE:
                _fit(row, window, scratch, model)
    return refused, total / count if count > 0.0 else math.nan


@loop
def update_all(samples, slips, rows, windows, sensing, model, scratch, answers):
    """One sample of every vehicle.

    samples: values (N, CHANNELS), fresh (N, 3); slips: whether they are provided, ratios and
    variances (N, 2); rows (N,) and windows (N, BLOCKS, samples) of the memory are changed. The
    answers are written: value, covariance, summary (N, 4) excitation, condition, NIS, skipped,
    status; limited (N,) whether the data determine the effort limit; fitted (N, 2, 2) covariance by
    the fit alone, as if the soil never changed.
    """
    values, fresh = samples
    provided, ratios, variances = slips
    value, covariance, summary, status, limited, fitted = answers
    for i in range(rows.shape[0]):
        row, refused, innovation = rows[i], False, math.nan
        row.iterations = 0.0
        row.clock += 1.0
        if fresh[i, DRIVE] and (provided or fresh[i, POSE]):
            of_vehicle = provided, ratios[i], variances[i]
            left = _sample(values[i], 0, of_vehicle, sensing)
            right = _sample(values[i], 1, of_vehicle, sensing)
            if math.isnan(left.effort + right.effort):
                row.skipped += 1.0
                refused = True
            else:
                refused, innovation = _step(row, windows[i], left, right, scratch, sensing, model)
        write(row, model, value[i], covariance[i])
        ff, fk, kk = _covariance(row, model)
        fitted[i, 0, 0] = ff * value[i, 0] * value[i, 0]
        fitted[i, 0, 1] = fitted[i, 1, 0] = fk * value[i, 0] * value[i, 1]
        fitted[i, 1, 1] = kk * value[i, 1] * value[i, 1]
        smallest, largest = _excitation(row, model)
        condition = largest / smallest if smallest > 0.0 else math.inf
        summary[i, 0], summary[i, 1], summary[i, 2] = smallest, condition, innovation
        summary[i, 3] = row.skipped
        status[i] = 2 if refused else (0 if smallest > DETERMINED else 1)
        _limit, limited[i] = sr.effort_limit(row, model.contact_length)
