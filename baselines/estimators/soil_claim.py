"""What the soil estimator claims to know: the covariance of F_max and K, on a soil that may change.

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
"""

import math

from baselines.estimators import soil_regression as sr
from tracked_env.physics.jit import formula

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
