"""Recursive least squares with exponential forgetting for two parameters, in information form.

Model: y = phi . theta + e, e ~ N(0, R), R known sample by sample from the sensors' data sheets.
In units of the prior, theta = theta_0 + sigma_0 x, with J the information of the data,
    eps = y - phi . theta                                              S 7.1.1
    J   = lambda J + phi phi^T / R,   P = (J + 1)^-1
    x  += P phi eps / R
lambda forgets exponentially, as in S. Parameters that change need more than that: several such
estimates with random walks, in interacting_models. The 1 is the prior: it never fades, so P never
exceeds the prior covariance, however long nothing is excited (no wind-up), yet it does not pull
back: it is centred on the present estimate. Per sample:
    excitation gate  samples that gain nothing, phi^T P phi < GAIN_GATE R, are not used and do
                     not age the estimate
    noisy regressor  the noise of phi_1 would bias theta_1 towards 0; its known variance V is
                     taken out of the normal equations: J_11 -= V / R, and V theta_1 added to
                     phi_1 eps (bias-compensated least squares)
    holding          where phi_1 varies against phi_2 by its noise alone, only noise would change
                     theta_1: it is neither learned nor forgotten, and only theta_2 learns
    projection       on the bounds, in the metric of J
interacting_models takes the samples.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.1. [2] S. Sagara, K. Wada
(1977): on-line bias compensation.
"""

import math
from typing import NamedTuple

import numpy as np

from tracked_env.physics.jit import formula

GAIN_GATE = 1e-6  # [-] share of R by which a sample must reduce the uncertainty
EXCITED = 1.0  # [-] excitation from which on the data determine every parameter
LARGEST = 1e12  # [-] information that J may hold: beyond it the determinant would cancel
ROUNDING = 1e-12  # [-] smaller information is none
VARIES = 3.0  # [-] of phi_1 against phi_2 in units of the variance of its noise: not noise alone
VARIES_SHARE = 0.05  # [-] of a sample in the mean of that: 20 samples
VARIES_MOST = 100.0  # [-] that a sample may count

# One Gaussian estimate: x in units of the prior, and the information of the data.
ESTIMATE = np.dtype([(name, float) for name in ("x_1", "x_2", "j_11", "j_12", "j_22")])


class Prior(NamedTuple):
    """Prior and bounds of two parameters, and how fast both are forgotten."""

    mean_1: float
    mean_2: float
    sigma_1: float
    sigma_2: float
    low_1: float
    low_2: float
    high_1: float
    high_2: float
    forgetting: float  # [-] lambda, per used sample, of both


class Sample(NamedTuple):
    """One equation y = phi_1 theta_1 + phi_2 theta_2 + e."""

    y: float
    phi_1: float
    phi_2: float
    variance: float  # R of e
    noise_1: float  # variance of phi_1


@formula
def values(e, prior):
    """(theta_1, theta_2) of an estimate."""
    theta_1 = prior.mean_1 + prior.sigma_1 * e.x_1
    theta_2 = prior.mean_2 + prior.sigma_2 * e.x_2
    return (
        min(max(theta_1, prior.low_1), prior.high_1),
        min(max(theta_2, prior.low_2), prior.high_2),
    )


@formula
def scaled_covariance(e):
    """(P_11, P_12, P_22) of x: at most 1, the prior's."""
    a, b, c = e.j_11 + 1.0, e.j_12, e.j_22 + 1.0
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def covariance(e, prior):
    """(P_11, P_12, P_22) of theta."""
    p_11, p_12, p_22 = scaled_covariance(e)
    return (
        p_11 * prior.sigma_1 * prior.sigma_1,
        p_12 * prior.sigma_1 * prior.sigma_2,
        p_22 * prior.sigma_2 * prior.sigma_2,
    )


@formula
def set_gaussian(e, x_1, x_2, p_11, p_12, p_22):
    """Set the mean and covariance of x; the covariance never exceeds that of the prior."""
    inverse = 1.0 / (p_11 * p_22 - p_12 * p_12)
    a, c = p_22 * inverse - 1.0, p_11 * inverse - 1.0
    a = min(a, LARGEST) if a > ROUNDING else 0.0
    c = min(c, LARGEST) if c > ROUNDING else 0.0
    most = math.sqrt(a * c)
    e.x_1, e.x_2, e.j_11, e.j_22 = x_1, x_2, a, c
    e.j_12 = min(max(-p_12 * inverse, -most), most)


@formula
def walk(e, prior, walk_1, walk_2):
    """Add the variances Q of random walks: J becomes (J^-1 + Q)^-1."""
    a, b, c = e.j_11, e.j_12, e.j_22
    less = 1.0 / (1.0 + walk_2 * c)
    a, b, c = a - walk_2 * less * b * b, b * less, c * less
    size = prior.mean_1 / prior.sigma_1 + e.x_1
    step = walk_1 * size * size
    less = 1.0 / (1.0 + step * a)
    e.j_11, e.j_12, e.j_22 = a * less, b * less, c - step * less * b * b


@formula
def eigenvalues(a, b, c):
    """(smallest, largest) eigenvalue of the symmetric matrix [[a, b], [b, c]]."""
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    root = math.sqrt(half * half + b * b)
    return max((a * c - b * b) / max(mean + root, 1e-300), 0.0), mean + root


@formula
def excitations(e):
    """(smallest, largest) eigenvalue [-] of the information J."""
    return eigenvalues(e.j_11, e.j_12, e.j_22)


@formula
def project(e, prior):
    """Move the estimate into its bounds along the least-cost direction of J."""
    low = (prior.low_1 - prior.mean_1) / prior.sigma_1
    high = (prior.high_1 - prior.mean_1) / prior.sigma_1
    moved = min(max(e.x_1, low), high) - e.x_1
    x_2 = e.x_2 - moved * e.j_12 / (e.j_22 + 1.0)
    low_2 = (prior.low_2 - prior.mean_2) / prior.sigma_2
    high_2 = (prior.high_2 - prior.mean_2) / prior.sigma_2
    bounded = min(max(x_2, low_2), high_2)
    step_1 = (bounded - x_2) * e.j_12 / (e.j_11 + 1.0)
    e.x_1 = min(max(e.x_1 + moved - step_1, low), high)
    e.x_2 = bounded


@formula
def innovation(e, sample, prior):
    """(eps, phi^T P phi) before the sample."""
    theta_1 = prior.mean_1 + prior.sigma_1 * e.x_1
    theta_2 = prior.mean_2 + prior.sigma_2 * e.x_2
    error = sample.y - sample.phi_1 * theta_1 - sample.phi_2 * theta_2
    p_1, p_2 = sample.phi_1 * prior.sigma_1, sample.phi_2 * prior.sigma_2
    a, b, c = e.j_11 + 1.0, e.j_12, e.j_22 + 1.0
    return error, (c * p_1 * p_1 - 2.0 * b * p_1 * p_2 + a * p_2 * p_2) / (a * c - b * b)


@formula
def noise_alone(row, e, sample, prior):
    """Whether phi_1 has lately varied against phi_2 by no more than its noise."""
    if sample.noise_1 <= 0.0:
        return False
    b, c = e.j_12 * prior.sigma_2, e.j_22 * prior.sigma_1
    off = sample.phi_1 - sample.phi_2 * b / c if c > 0.0 else 0.0
    varies = min(off * off / sample.noise_1, VARIES_MOST)
    row.variation += VARIES_SHARE * (varies - row.variation)
    return row.variation < VARIES


@formula
def forget(e, prior):
    """Exponential forgetting."""
    e.j_11 *= prior.forgetting
    e.j_12 *= prior.forgetting
    e.j_22 *= prior.forgetting


@formula
def learn(e, sample, prior, hold_1):
    """Take the sample into the estimate; hold_1: parameter 1 stays as it is."""
    error, _gain = innovation(e, sample, prior)
    p_1, p_2 = sample.phi_1 * prior.sigma_1, sample.phi_2 * prior.sigma_2
    weight = min(1.0 / sample.variance, LARGEST / (p_1 * p_1 + p_2 * p_2))
    noise = sample.noise_1 * prior.sigma_1
    a, b, c = e.j_11, e.j_12, e.j_22
    alone = a - b * b / max(c, 1e-300)
    b, c = b + weight * p_1 * p_2, c + weight * p_2 * p_2
    least = b * b / max(c, 1e-300)
    raised = least + alone if hold_1 else a + weight * (p_1 * p_1 - noise * prior.sigma_1)
    a = max(raised, least)
    shrink = min(1.0, LARGEST / max(a + c, 1.0))
    a, b, c = a * shrink, b * shrink, c * shrink
    e.j_11, e.j_12, e.j_22 = a, b, c
    if hold_1:
        e.x_2 += weight * p_2 * error / (c + 1.0)
    else:
        theta_1 = prior.mean_1 + prior.sigma_1 * e.x_1
        g_1, g_2 = p_1 * error + noise * theta_1, p_2 * error
        scale = weight / ((a + 1.0) * (c + 1.0) - b * b)
        e.x_1 += scale * ((c + 1.0) * g_1 - b * g_2)
        e.x_2 += scale * ((a + 1.0) * g_2 - b * g_1)
    project(e, prior)
