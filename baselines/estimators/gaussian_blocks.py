"""Estimates of least_squares as Gaussians: mean and covariance of one block of a memory.

A block holds x, in units of the prior's deviations, and the information J beyond the prior's. Its
covariance is P = (J + 1)^-1; a random walk of variance Q makes J^-1 into J^-1 + Q. Block 0 is a
mixture, about whose mean the moments of the others are taken (see interacting_models).
"""

import math

from baselines.estimators import least_squares as ls
from tracked_env.physics.jit import formula

ROUNDING = 1e-12  # [-] smaller information is none


@formula
def covariance(memory, i, h):
    """(P_11, P_12, P_22) of the estimate in block h, in units of the prior."""
    a, b, c = memory[i, h + ls.J_11] + 1.0, memory[i, h + ls.J_12], memory[i, h + ls.J_22] + 1.0
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def put(memory, i, h, x_1, x_2, p_11, p_12, p_22):
    """Mean and covariance into block h; the covariance never exceeds that of the prior."""
    inverse = 1.0 / (p_11 * p_22 - p_12 * p_12)
    a, c = p_22 * inverse - 1.0, p_11 * inverse - 1.0
    a = min(a, ls.LARGEST) if a > ROUNDING else 0.0
    c = min(c, ls.LARGEST) if c > ROUNDING else 0.0
    most = math.sqrt(a * c)
    memory[i, h + ls.X_1], memory[i, h + ls.X_2] = x_1, x_2
    memory[i, h + ls.J_11], memory[i, h + ls.J_22] = a, c
    memory[i, h + ls.J_12] = min(max(-p_12 * inverse, -most), most)


@formula
def moments(memory, i, h):
    """Mean and second moments of block h about the mixture's mean: (d_1, d_2, M_11, M_12, M_22)."""
    p_11, p_12, p_22 = covariance(memory, i, h)
    d_1 = memory[i, h + ls.X_1] - memory[i, ls.X_1]
    d_2 = memory[i, h + ls.X_2] - memory[i, ls.X_2]
    return d_1, d_2, p_11 + d_1 * d_1, p_12 + d_1 * d_2, p_22 + d_2 * d_2


@formula
def walk(memory, i, h, prior, walk_1, walk_2):
    """Add the variance of the random walks to block h: (J^-1 + Q)^-1."""
    a, b, c = memory[i, h + ls.J_11], memory[i, h + ls.J_12], memory[i, h + ls.J_22]
    less = 1.0 / (1.0 + walk_2 * c)
    a, b, c = a - walk_2 * less * b * b, b * less, c * less
    size = prior.mean_1 / prior.sigma_1 + memory[i, h + ls.X_1]
    step = walk_1 * size * size
    less = 1.0 / (1.0 + step * a)
    memory[i, h + ls.J_11], memory[i, h + ls.J_12] = a * less, b * less
    memory[i, h + ls.J_22] = c - step * less * b * b
