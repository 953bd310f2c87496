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
                     not age what is known
    noisy regressor  the noise of phi_1 would bias theta_1 towards 0; its known variance V is
                     taken out of the normal equations: J_11 -= V / R, and V theta_1 added to
                     phi_1 eps (bias-compensated least squares)
    holding          where phi_1 varies against phi_2 by its noise alone, it is all noise that
                     is left of theta_1: it is kept, neither learned nor forgotten, and only
                     theta_2 learns
    projection       on the bounds, in the metric of J

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.1. [2] S. Sagara, K. Wada
(1977): on-line bias compensation.

Estimates of least_squares as Gaussians: mean and covariance of one block of a memory.

A block holds x, in units of the prior's deviations, and the information J beyond the prior's. Its
covariance is P = (J + 1)^-1; a random walk of variance Q makes J^-1 into J^-1 + Q. Block 0 is a
mixture, about whose mean the moments of the others are taken (see interacting_models).
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula

GAIN_GATE = 1e-6  # [-] share of R by which a sample must reduce the uncertainty
EXCITED = 1.0  # [-] excitation from which on the data determine every parameter
LARGEST = 1e12  # [-] information that J may hold: beyond it the determinant would cancel
VARIES = 3.0  # [-] of phi_1 against phi_2 in units of the variance of its noise: not noise alone
VARIES_SHARE = 0.05  # [-] of a sample in the mean of that: 20 samples
VARIES_MOST = 100.0  # [-] that a sample may count

# What is remembered of one vehicle, the columns of `memory`: the estimate, in SIZE columns, and
# behind BLOCKS of those, which interacting_models needs, what belongs to all.
X_1, X_2, J_11, J_12, J_22 = range(5)
SIZE = 5
BLOCKS = 6
SKIPPED, VARIATION = range(SIZE * BLOCKS, SIZE * BLOCKS + 2)
PLAIN_MEMORY = VARIATION + 1


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
def values(memory, i, prior):
    """(theta_1, theta_2) of vehicle i."""
    theta_1 = prior.mean_1 + prior.sigma_1 * memory[i, X_1]
    theta_2 = prior.mean_2 + prior.sigma_2 * memory[i, X_2]
    return (
        min(max(theta_1, prior.low_1), prior.high_1),
        min(max(theta_2, prior.low_2), prior.high_2),
    )


@formula
def covariance(memory, i, prior):
    """(P_11, P_12, P_22) of theta of vehicle i: at most the prior's."""
    a, b, c = memory[i, J_11] + 1.0, memory[i, J_12], memory[i, J_22] + 1.0
    inverse = 1.0 / (a * c - b * b)
    return (
        c * inverse * prior.sigma_1 * prior.sigma_1,
        -b * inverse * prior.sigma_1 * prior.sigma_2,
        a * inverse * prior.sigma_2 * prior.sigma_2,
    )


@formula
def eigenvalues(memory, i):
    """(smallest, largest) eigenvalue [-] of the information J of vehicle i."""
    a, b, c = memory[i, J_11], memory[i, J_12], memory[i, J_22]
    mean, half = 0.5 * (a + c), 0.5 * (a - c)
    root = math.sqrt(half * half + b * b)
    return max((a * c - b * b) / max(mean + root, 1e-300), 0.0), mean + root


@formula
def project(memory, i, h, prior):
    """Move the estimate in block h into its bounds along the least-cost direction of J."""
    low = (prior.low_1 - prior.mean_1) / prior.sigma_1
    high = (prior.high_1 - prior.mean_1) / prior.sigma_1
    moved = min(max(memory[i, h + X_1], low), high) - memory[i, h + X_1]
    x_2 = memory[i, h + X_2] - moved * memory[i, h + J_12] / (memory[i, h + J_22] + 1.0)
    low_2 = (prior.low_2 - prior.mean_2) / prior.sigma_2
    high_2 = (prior.high_2 - prior.mean_2) / prior.sigma_2
    bounded = min(max(x_2, low_2), high_2)
    step_1 = (bounded - x_2) * memory[i, h + J_12] / (memory[i, h + J_11] + 1.0)
    x_1 = memory[i, h + X_1] + moved - step_1
    memory[i, h + X_1] = min(max(x_1, low), high)
    memory[i, h + X_2] = bounded


@formula
def innovation(memory, i, h, sample, prior):
    """(eps, phi^T P phi) of the estimate in block h before the sample."""
    theta_1 = prior.mean_1 + prior.sigma_1 * memory[i, h + X_1]
    theta_2 = prior.mean_2 + prior.sigma_2 * memory[i, h + X_2]
    error = sample.y - sample.phi_1 * theta_1 - sample.phi_2 * theta_2
    p_1, p_2 = sample.phi_1 * prior.sigma_1, sample.phi_2 * prior.sigma_2
    a, b, c = memory[i, h + J_11] + 1.0, memory[i, h + J_12], memory[i, h + J_22] + 1.0
    return error, (c * p_1 * p_1 - 2.0 * b * p_1 * p_2 + a * p_2 * p_2) / (a * c - b * b)


@formula
def noise_alone(memory, i, sample, prior):
    """Whether phi_1 has lately varied against phi_2 by no more than its noise."""
    if sample.noise_1 <= 0.0:
        return False
    b, c = memory[i, J_12] * prior.sigma_2, memory[i, J_22] * prior.sigma_1
    off = sample.phi_1 - sample.phi_2 * b / c if c > 0.0 else 0.0
    varies = min(off * off / sample.noise_1, VARIES_MOST)
    memory[i, VARIATION] += VARIES_SHARE * (varies - memory[i, VARIATION])
    return memory[i, VARIATION] < VARIES


@formula
def forget(memory, i, h, prior):
    """Exponential forgetting of the estimate in block h."""
    memory[i, h + J_11] *= prior.forgetting
    memory[i, h + J_12] *= prior.forgetting
    memory[i, h + J_22] *= prior.forgetting


@formula
def learn(memory, i, h, sample, prior, error, hold_1):
    """Take the sample into the estimate in block h; hold_1: parameter 1 is kept."""
    p_1, p_2 = sample.phi_1 * prior.sigma_1, sample.phi_2 * prior.sigma_2
    weight = min(1.0 / sample.variance, LARGEST / (p_1 * p_1 + p_2 * p_2))
    noise = sample.noise_1 * prior.sigma_1
    a, b, c = memory[i, h + J_11], memory[i, h + J_12], memory[i, h + J_22]
    alone = a - b * b / max(c, 1e-300)
    b, c = b + weight * p_1 * p_2, c + weight * p_2 * p_2
    least = b * b / max(c, 1e-300)
    raised = least + alone if hold_1 else a + weight * (p_1 * p_1 - noise * prior.sigma_1)
    a = max(raised, least)
    shrink = min(1.0, LARGEST / max(a + c, 1.0))
    a, b, c = a * shrink, b * shrink, c * shrink
    memory[i, h + J_11], memory[i, h + J_12], memory[i, h + J_22] = a, b, c
    if hold_1:
        memory[i, h + X_2] += weight * p_2 * error / (c + 1.0)
    else:
        theta_1 = prior.mean_1 + prior.sigma_1 * memory[i, h + X_1]
        g_1, g_2 = p_1 * error + noise * theta_1, p_2 * error
        scale = weight / ((a + 1.0) * (c + 1.0) - b * b)
        memory[i, h + X_1] += scale * ((c + 1.0) * g_1 - b * g_2)
        memory[i, h + X_2] += scale * ((a + 1.0) * g_2 - b * g_1)
    project(memory, i, h, prior)


@formula
def step(memory, i, sample, prior):
    """Take one sample of vehicle i. Returns (status, eps^2 / S): status as estimate.Status.

    Status 1 (holding) when the sample gains nothing or some direction is not excited.
    """
    error, gain = innovation(memory, i, 0, sample, prior)
    total = gain + sample.variance
    nis = error * error / total
    status = 1
    if not math.isfinite(nis + total):
        memory[i, SKIPPED] += 1.0
        status = 2
    elif gain > GAIN_GATE * sample.variance:
        hold_1 = noise_alone(memory, i, sample, prior)
        if not hold_1:
            forget(memory, i, 0, prior)
        learn(memory, i, 0, sample, prior, error, hold_1)
        smallest, _largest = eigenvalues(memory, i)
        status = 0 if smallest >= EXCITED and not hold_1 else 1
    return status, nis


ROUNDING = 1e-12  # [-] smaller information is none


@formula
def covariance_gaussian_blocks(memory, i, h):
    """(P_11, P_12, P_22) of the estimate in block h, in units of the prior."""
    a, b, c = memory[i, h + J_11] + 1.0, memory[i, h + J_12], memory[i, h + J_22] + 1.0
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def put(memory, i, h, x_1, x_2, p_11, p_12, p_22):
    """Mean and covariance into block h; the covariance never exceeds that of the prior."""
    inverse = 1.0 / (p_11 * p_22 - p_12 * p_12)
    a, c = p_22 * inverse - 1.0, p_11 * inverse - 1.0
    a = min(a, LARGEST) if a > ROUNDING else 0.0
    c = min(c, LARGEST) if c > ROUNDING else 0.0
    most = math.sqrt(a * c)
    memory[i, h + X_1], memory[i, h + X_2] = x_1, x_2
    memory[i, h + J_11], memory[i, h + J_22] = a, c
    memory[i, h + J_12] = min(max(-p_12 * inverse, -most), most)


@formula
def moments(memory, i, h):
    """Mean and second moments of block h about the mixture's mean: (d_1, d_2, M_11, M_12, M_22)."""
    p_11, p_12, p_22 = covariance_gaussian_blocks(memory, i, h)
    d_1 = memory[i, h + X_1] - memory[i, X_1]
    d_2 = memory[i, h + X_2] - memory[i, X_2]
    return d_1, d_2, p_11 + d_1 * d_1, p_12 + d_1 * d_2, p_22 + d_2 * d_2


@formula
def walk(memory, i, h, prior, walk_1, walk_2):
    """Add the variance of the random walks to block h: (J^-1 + Q)^-1."""
    a, b, c = memory[i, h + J_11], memory[i, h + J_12], memory[i, h + J_22]
    less = 1.0 / (1.0 + walk_2 * c)
    a, b, c = a - walk_2 * less * b * b, b * less, c * less
    size = prior.mean_1 / prior.sigma_1 + memory[i, h + X_1]
    step = walk_1 * size * size
    less = 1.0 / (1.0 + step * a)
    memory[i, h + J_11], memory[i, h + J_12] = a * less, b * less
    memory[i, h + J_22] = c - step * less * b * b
