"""Damped Gauss-Newton fit of the soil's [F_max, K] to a window of slips and efforts, and its claim.

Model of both tracks, S (7), with p = (ln F_max, ln K), f = mobilised_shear, u = |i| l / K:
    F(i; p)    = F_max f(u) sign(i),    F' = dF/di = F_max (l / K) f'(u)
    dF/dln F_max = F,                   dF/dln K = -i F'
Both the slip i_m and the effort F_m = torque / r of a sample are measured with errors, so that the
residual e with variance R is the least squares of both (effective variance at the fitted point):
    e = F_m - F(i*) - F'(i*) (i_m - i*),  R = sigma_F^2 + F'(i*)^2 sigma_i^2
    i* = i_m + sigma_i^2 F'(i*) e / R, the slip that both measurements make most likely
Where slip noise rules it is a residual in slip, i_m - i(F_m), at full slip one in effort. The
residual of S (43), F_m - F(i_m), is attenuated by noise of the slip: F is concave and F' is taken
at the wrong place.
Minimised is, with the weak prior Lambda around the anchor p_0 (the last determined value),
    sum of e^2 / R + (p - p_0)^T Lambda (p - p_0)
by steps (A + Lambda + mu diag) dp = g, A = sum of J^T J / R, within the bounds, mu raised when
the cost does not fall: never singular; a direction that the data do not determine stays at p_0.

Claimed covariance: the fit weighs all samples of its window alike. Its covariance is that of a soil
which never changes; of alternating soils it was too sure by a factor of hundreds. Here with
x = [ln F_max, ln K], Lambda the prior's information, e = x(nominal) - x(estimate):
    M   = Lambda^-1 + e e^T          another soil, drawn from the prior: its second moment about x
    P   = M                          before the first sample, and on a new soil
    P+  = P + q (M - P),  q = 1 - exp(-t / SOJOURN)     after t [s]: with odds q it is another one
    P+  = P - P j^T j P / (R + j P j^T)                 sample: Jacobian j, variance R of the fit
sample by sample, in their order. Without samples P grows to M. A soil ten times as strong is not
within three standard deviations F_max sqrt(P_FF) of a weak one, hence
    sigma_F = F_max (exp(sqrt(P_FF)) - 1), likewise K: one sigma above is one of the logarithm.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.3. [2] J. Orear, Am. J.
Physics 50 (1982) 912: effective variance. [3] D. W. Marquardt, SIAM J. 11 (1963) 431.
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.estimators.least_squares import eigenvalues
from tracked_env.physics.elementary import signed
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.terramechanics import (
    SERIES_LIMIT,
    mobilised_shear,
    mobilised_shear_slope,
    slip_from_effort,
)

DECREMENT = 0.01  # [-] squared step in standard deviations below which the fit has converged
LONGEST_STEP = 1.5  # [-] in ln F_max and ln K, per iteration
FREE_STEPS = 12  # [-] iterations without damping, see fit
FIRST_DAMPING = 0.1  # [-] mu after the first step that did not lower the cost
LARGEST_DAMPING = 1e8  # [-] beyond it no step lowers the cost
SMALLEST_SLIP = 1e-9  # [-] fitted slips stay positive
SOJOURN = 5.0  # [s] mean time on one soil: twice that of the fastest evaluation sets
TRUSTED = 100.0  # [-] inverse variance of ln F from the data that a controller may rely on
SHRINK = 0.2  # [-] a step leaves at least this share of a fitted slip

# The state of the soil estimator for one vehicle, beside its window.
ROW = np.dtype([(name, float) for name in (
    "log_f", "log_k", "anchor_f", "anchor_k", "j_ff", "j_fk", "j_kk", "filled", "next", "outliers",
    "skipped", "changes", "waiting", "iterations", "converged", "misfits",
    "p_ff", "p_fk", "p_kk",  # covariance that is claimed
    "clock", "taken",  # control steps so far, and at the last sample
)])  # fmt: skip
SLIP, EFFORT, VARIANCE, STAR, CLOCK = range(5)  # rows of a window; STAR: fitted slip
BLOCKS = 5
ROWS = 6  # of the scratch: F, i F', e, 1 / R, next i*, d i*/dF


class Model(NamedTuple):
    """What the fit knows beforehand."""

    contact_length: float  # [m] l
    effort_variance: float  # [N^2] sigma_F^2
    information_f: float  # [-] 1 / variance of ln F_max, prior
    information_k: float  # [-] 1 / variance of ln K, prior
    low_f: float  # ln of the bounds
    high_f: float
    low_k: float
    high_k: float
    largest_iterations: int
    nominal_f: float  # ln of the first guess
    nominal_k: float
    change_odds: float  # [-] per control step, of another soil


class Normal(NamedTuple):
    """Normal equations at one point, data only."""

    ff: float  # entries of A
    fk: float
    kk: float
    f: float  # sum of J^T e / R
    k: float
    cost: float  # sum of e^2 / R
    samples: float


@formula
def residual(slip, effort, variance, star, maximum, shear_length, model):
    """(F, i F', e, 1/R, next i*, d i*/dF) of one sample at the fitted slip `star`. maximum F_max
    [N], shear_length l / K [-]. The next i* is one Newton step towards the minimum over i of
    (i_m - i)^2 / sigma_i^2 + (F_m - F(i))^2 / sigma_F^2; the curvature F'' < 0 is used only where
    it makes the step shorter (F_m > F), there the step would oscillate without it."""
    u = abs(star) * shear_length
    share, rise = mobilised_shear(u), mobilised_shear_slope(u)
    force = maximum * signed(share, star)
    slope = maximum * shear_length * rise
    rest = effort - force
    spread = slope * slope * variance
    weight = 1.0 / (model.effort_variance + spread)
    error = rest - slope * (slip - star)
    # f'' = (exp(-u) - 2 f') / u with exp(-u) = 1 - u (1 - f); -1/3 for u -> 0.
    bend = (1.0 - u * (1.0 - share) - 2.0 * rise) / max(u, SERIES_LIMIT)
    bend = -1 / 3 if u < SERIES_LIMIT else bend
    curvature = max(-rest * bend, 0.0) * maximum * shear_length * shear_length
    inverse = 1.0 / (model.effort_variance + spread + curvature * variance)
    step = ((slip - star) * model.effort_variance + slope * variance * rest) * inverse
    following = min(max(star + step, SHRINK * star), 1.0)
    return force, star * slope, error, weight, following, slope * variance * inverse


@formula
def _first_slip(sample, maximum, shear_length):
    """Where the search for the fitted slip of a new sample begins."""
    slip, effort, variance = sample
    reach = 3.0 * math.sqrt(variance)
    guess = slip_from_effort(effort, maximum, shear_length)
    guess = min(max(guess, slip - reach), slip + reach)
    return min(max(guess, SMALLEST_SLIP), 1.0)


@formula
def sample_slips(left, right, log_f, log_k, model):
    """Fitted slips i* of two new samples (slip, effort > 0 [N], variance): four Newton steps. Both
    in one loop: neither waits for the other's divisions, which takes half the time."""
    maximum, shear_length = math.exp(log_f), model.contact_length * math.exp(-log_k)
    a = _first_slip(left, maximum, shear_length)
    b = _first_slip(right, maximum, shear_length)
    for _ in range(4):
        a = residual(left[0], left[1], left[2], a, maximum, shear_length, model)[4]
        b = residual(right[0], right[1], right[2], b, maximum, shear_length, model)[4]
    return a, b


@formula
def _evaluate(window, star, scratch, n, log_f, log_k, model):
    """Residuals of n samples into `scratch` (ROWS, >= n), at the fitted slips `star`."""
    slip, effort, variance = window[SLIP], window[EFFORT], window[VARIANCE]
    maximum = math.exp(log_f)
    shear_length = model.contact_length * math.exp(-log_k)
    for k in range(n):
        here = residual(slip[k], effort[k], variance[k], star[k], maximum, shear_length, model)
        scratch[0, k], scratch[1, k], scratch[2, k] = here[0], here[1], here[2]
        scratch[3, k], scratch[4, k], scratch[5, k] = here[3], here[4], here[5]


@formula
def _normal(effort, scratch, n):
    """Sum up the normal equations; empty samples are zero and add nothing."""
    ff, fk, kk, f, k_, cost, samples = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        weight = scratch[3, k]
        a, b, error = scratch[0, k], scratch[1, k], scratch[2, k]
        wa, wb = weight * a, weight * b
        ff += wa * a
        fk -= wa * b
        kk += wb * b
        f += wa * error
        k_ -= wb * error
        cost += weight * error * error
        samples += 1.0 if effort[k] > 0.0 else 0.0
    return Normal(ff, fk, kk, f, k_, cost, samples)


@formula
def _move_slips(star, scratch, moved, n, step_f, step_k):
    """Fitted slips after a step of the parameters, to first order, into `moved`."""
    for k in range(n):
        change = scratch[0, k] * step_f - scratch[1, k] * step_k
        new = scratch[4, k] - scratch[5, k] * change
        moved[k] = min(max(new, SHRINK * star[k]), max(1.0, star[k]))


@formula
def _step(normal, log_f, log_k, anchor_f, anchor_k, mu, limited, model):
    """(step of ln F_max, of ln K, Newton decrement) with damping mu, kept within the bounds."""
    pull_f = normal.f - model.information_f * (log_f - anchor_f)
    pull_k = normal.k - model.information_k * (log_k - anchor_k)
    h_ff = (normal.ff + model.information_f) * (1.0 + mu)
    h_kk = (normal.kk + model.information_k) * (1.0 + mu)
    inverse = 1.0 / (h_ff * h_kk - normal.fk * normal.fk)
    step_f = (h_kk * pull_f - normal.fk * pull_k) * inverse
    step_k = (h_ff * pull_k - normal.fk * pull_f) * inverse
    if limited:
        length = max(abs(step_f), abs(step_k))
        share = LONGEST_STEP / max(length, LONGEST_STEP)
        step_f *= share
        step_k *= share
    # On a bound the other parameter takes the best step along it.
    free_f = min(max(log_f + step_f, model.low_f), model.high_f) - log_f
    if free_f != step_f:
        step_k = (pull_k - normal.fk * free_f) / h_kk
    free_k = min(max(log_k + step_k, model.low_k), model.high_k) - log_k
    if free_k != step_k:
        free_f = (pull_f - normal.fk * free_k) / h_ff
        free_f = min(max(log_f + free_f, model.low_f), model.high_f) - log_f
    decrement = h_ff * free_f * free_f + 2.0 * normal.fk * free_f * free_k + h_kk * free_k * free_k
    return free_f, free_k, decrement


@formula
def _prior_cost(log_f, log_k, anchor_f, anchor_k, model):
    """(p - p_0)^T Lambda (p - p_0) [-]."""
    f, k = log_f - anchor_f, log_k - anchor_k
    return model.information_f * f * f + model.information_k * k * k


@loop
def fit(window, n, scratch, start, anchor, model):
    """Fit the first n samples of one vehicle, from `start` with prior mean `anchor`. window
    (BLOCKS, samples), whose fitted slips are updated; scratch (2 ROWS + 1, samples); start, anchor:
    (ln F_max, ln K). The first FREE_STEPS are full steps within the bounds: far from the solution
    its cost, linear around slips that are not yet fitted, is too low to compare with. Returns (ln
    F_max, ln K, Normal, iterations, converged); the first ROWS of scratch are those of the last
    accepted step."""
    effort, star = window[EFFORT], window[STAR]
    here, there, moved = scratch[:ROWS], scratch[ROWS : 2 * ROWS], scratch[2 * ROWS]
    log_f, log_k = start
    anchor_f, anchor_k = anchor
    _evaluate(window, star, here, n, log_f, log_k, model)
    normal = _normal(effort, here, n)
    cost = normal.cost + _prior_cost(log_f, log_k, anchor_f, anchor_k, model)
    mu, iterations, converged = 0.0, 0, False
    while iterations < model.largest_iterations and not converged and mu < LARGEST_DAMPING:
        iterations += 1
        free = iterations <= FREE_STEPS
        step_f, step_k, decrement = _step(
            normal, log_f, log_k, anchor_f, anchor_k, 0.0, not free, model
        )
        converged = decrement < DECREMENT
        if not converged and mu > 0.0:
            step_f, step_k, decrement = _step(
                normal, log_f, log_k, anchor_f, anchor_k, mu, True, model
            )
        new_f, new_k = log_f + step_f, log_k + step_k
        _move_slips(star, here, moved, n, step_f, step_k)
        if converged:
            star[:n] = moved[:n]
            log_f, log_k = new_f, new_k
        else:
            _evaluate(window, moved, there, n, new_f, new_k, model)
            moved[:n] = there[4, :n]
            _evaluate(window, moved, there, n, new_f, new_k, model)
            trial = _normal(effort, there, n)
            trial_cost = trial.cost + _prior_cost(new_f, new_k, anchor_f, anchor_k, model)
            if trial_cost <= cost or free:
                here, there = there, here
                star[:n] = moved[:n]
                log_f, log_k, normal, cost = new_f, new_k, trial, trial_cost
                mu = 0.1 * mu if mu > FIRST_DAMPING else 0.0
            else:
                mu = max(10.0 * mu, FIRST_DAMPING)
                # Compare with slips that are fitted as well as the trial's.
                star[:n] = here[4, :n]
                _evaluate(window, star, here, n, log_f, log_k, model)
                normal = _normal(effort, here, n)
                cost = normal.cost + _prior_cost(log_f, log_k, anchor_f, anchor_k, model)
    scratch[:ROWS, :n] = here[:, :n]
    return log_f, log_k, normal, iterations, converged


@formula
def eigen(ff, fk, kk):
    """(smallest, largest eigenvalue, cosine, sine of the direction of the largest) of a matrix."""
    smallest, largest = eigenvalues(ff, fk, kk)
    angle = 0.5 * math.atan2(fk, 0.5 * (ff - kk))
    return smallest, largest, math.cos(angle), math.sin(angle)


@formula
def limit_determined(row, contact_length):
    """Whether the data of the window determine F(i = 1) of a track, the effort limit."""
    u = contact_length * math.exp(-row.log_k)
    twist = -u * mobilised_shear_slope(u) / mobilised_shear(u)
    a, b, c = row.j_ff, row.j_fk, row.j_kk
    determinant = a * c - b * b
    numerator = c - 2.0 * b * twist + a * twist * twist
    return determinant > 1e-12 * a * c and numerator * TRUSTED <= determinant


@formula
def _another_soil(row, model):
    """(M_FF, M_FK, M_KK) about the estimate."""
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
def claim(row, window, scratch, n, share, model):
    """P of a window (BLOCKS, samples) that is fitted, with its scratch; share: of the weights."""
    m = _another_soil(row, model)
    p, clock = m, 0.0
    k = 2 * int(row.next) % n  # the oldest
    for _ in range(n):
        if window[EFFORT, k] > 0.0:
            if window[CLOCK, k] > clock:
                p = _age(p, window[CLOCK, k] - clock, m, model)
                clock = window[CLOCK, k]
            p = _learn(p, scratch[0, k], -scratch[1, k], share * scratch[3, k])
        k = k + 1 if k + 1 < n else 0
    p = _age(p, row.taken - clock, m, model)
    row.p_ff, row.p_fk, row.p_kk = p


@formula
def forget(row, model):
    """Another soil: nothing is known but the law of soils."""
    row.p_ff, row.p_fk, row.p_kk = _another_soil(row, model)


@formula
def write_answer(row, model, value, covariance):
    """F_max [N], K [m] into value (2,), and their claimed covariance (2, 2)."""
    maximum, modulus = math.exp(row.log_f), math.exp(row.log_k)
    p = row.p_ff, row.p_fk, row.p_kk
    ff, fk, kk = _age(p, row.clock - row.taken, _another_soil(row, model), model)
    sigma_f, sigma_k = maximum * math.expm1(math.sqrt(ff)), modulus * math.expm1(math.sqrt(kk))
    value[0], value[1] = maximum, modulus
    covariance[0, 0], covariance[1, 1] = sigma_f * sigma_f, sigma_k * sigma_k
    covariance[0, 1] = covariance[1, 0] = fk / math.sqrt(ff * kk) * sigma_f * sigma_k
