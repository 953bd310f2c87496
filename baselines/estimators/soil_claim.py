"""What the soil estimator claims to know: the covariance of [ln F_max, ln K], and of F_max, K.

The fit of soil_regression weighs all samples of the window alike and holds what they do not
show. As a claim that is too sure: the soil may have changed since a sample was taken. With Lambda
the prior's information, e = ln(nominal) - ln(estimate) and h = 1 / SOJOURN the odds per second
of another soil,
    M     = Lambda^-1 + e e^T                another soil: its second moment about the estimate
    J     = sum of J_k^T J_k / (R_k + h t_k J_k M J_k^T)     t_k [s]: since sample k was taken
    P     = (1 - q) (J + M^-1)^-1 + q M,     q = 1 - exp(-h t),  t since the last sample
So one sample of high slip tells F_max to a few per cent only while it is new, many samples that say
little each are nearly as good as before, and without samples P grows to M.
    sigma_F = F_max (exp(sqrt(P_FF)) - 1), likewise K: one sigma above the estimate is one sigma of
              the logarithm. F_max (1 + sqrt(P_FF)) would be below it: what may be ten times as
              strong is not within three sigma of itself
"""

import math

from baselines.estimators import soil_regression as sr
from tracked_env.physics.jit import formula

SOJOURN = 5.0  # [s] mean time on one soil, as of the calm model of interacting_models


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
    return p[0] - share * gain_f * gain_f, p[1] - share * gain_f * gain_k, p[2] - share * gain_k * gain_k


@formula
def weigh(memory, i, window, n, share, model):
    """Write P of the fitted window (BLOCKS, samples) of vehicle i into memory; share: of weights."""
    m = another_soil(memory, i, model)
    maximum = math.exp(memory[i, sr.LOG_F])
    shear_length = model.contact_length * math.exp(-memory[i, sr.LOG_K])
    p, clock = m, 0.0
    oldest = 2 * int(memory[i, sr.NEXT]) % n
    for step in range(n):
        k = (oldest + step) % n
        if window[1, k] > 0.0:
            p = _age(p, window[4, k] - clock, m, model)
            clock = window[4, k]
            force, twist, _error, weight, _star, _gain = sr.residual(
                window[0, k], window[1, k], window[2, k], window[3, k], maximum, shear_length, model
            )
            p = _learn(p, force, -twist, share * weight)
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
