"""Kernels that look slip up: in tables, in decision trees and by the exponential form.

    v_x    = (r omega_L - beta_L + r omega_R - beta_R) / 2              F (29), sign of F's text
    alpha  = atan(v_y v_x / (v_x^2 + e^2))                              F (28), e = SLOW
F identifies alpha itself, which flips by pi where v_x changes sign, and fits both signs of v_x
apart. The side velocity v_y has no such jump: a table holds beta_L, beta_R and v_y, and alpha
is formed from them, split by the sign of v_x by construction. e keeps it continuous there.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2, 4, 7.2.3.
"""

import math
from typing import NamedTuple

import numpy as np

from tracked_env.physics.jit import formula, loop

SLOW = 0.005  # [m/s] e: below it alpha fades out; alpha is 1 % small at ten times this speed
STRAIGHT = 1e-9  # [rad/s] belts whose speeds differ by less drive straight: infinite radius
CHANNELS = 3  # of a table: beta_left, beta_right, v_y [m/s]


class Grid(NamedTuple):
    """A regular grid of sprocket speeds with a node at standstill."""

    spacing: float  # [rad/s]
    zero_left: int  # index of the node where the left sprocket stands
    zero_right: int
    count_left: int
    count_right: int


@formula
def slip_angle(v_x, v_y):
    """alpha [rad] of body velocities [m/s]; 0 at v_x = 0, odd in both."""
    return math.atan(v_y * v_x / (v_x * v_x + SLOW * SLOW))


@formula
def cell(speed, spacing, zero, count):
    """(index, share [-]) of a speed [rad/s] between the nodes index and index + 1, clamped."""
    place = min(max(speed / spacing + zero, 0.0), count - 1.0)
    index = min(int(place), count - 2) if place == place else 0
    return index, place - index


@formula
def bilinear(table, layer, i, a, j, b, channel):
    """Value of one channel of table (M, count_left, count_right, CHANNELS) in cell (i, j)."""
    low = table[layer, i, j, channel] * (1.0 - b) + table[layer, i, j + 1, channel] * b
    high = table[layer, i + 1, j, channel] * (1.0 - b) + table[layer, i + 1, j + 1, channel] * b
    return low * (1.0 - a) + high * a


@loop
def look_up(table, grid, radius, left, right, layer, share, out):
    """Slip of N vehicles: out (N, 3) gets beta_left, beta_right [m/s], alpha [rad].

    table (M, count_left, count_right, CHANNELS): row i mixes layer[i] and the next, the next
    with share[i]. left, right (N,) [rad/s]; radius [m] of the sprockets.
    """
    for n in range(left.size):
        i, a = cell(left[n], grid.spacing, grid.zero_left, grid.count_left)
        j, b = cell(right[n], grid.spacing, grid.zero_right, grid.count_right)
        m = layer[n]
        s = share[n]
        for c in range(CHANNELS):
            value = bilinear(table, m, i, a, j, b, c)
            if s > 0.0:
                value += s * (bilinear(table, m + 1, i, a, j, b, c) - value)
            out[n, c] = value
        v_x = 0.5 * (radius * (left[n] + right[n]) - (out[n, 0] + out[n, 1]))
        out[n, 2] = slip_angle(v_x, out[n, 2])


@loop
def layers(frictions, friction, layer, share):
    """Where a friction [-] lies among `frictions` (M,), rising, both (N,) out: share of the way in
    1 / mu from `layer` to the next. friction (n,) repeats; beyond the ends it is theirs."""
    last = frictions.size - 1
    for n in range(layer.size):
        mu = friction[n % friction.size]
        mu = (
            frictions[0] if mu < frictions[0] else (frictions[last] if mu > frictions[last] else mu)
        )
        k = 0
        while k < last - 1 and not frictions[k + 1] >= mu:
            k += 1
        low, high = 1.0 / frictions[k], 1.0 / frictions[k + 1]
        layer[n] = k
        share[n] = (low - 1.0 / mu) / (low - high)


@loop
def descend(trees, radius, left, right, out):
    """Slip of N vehicles by four trees (roots, feature, threshold, below, above, value); out
    (N, 3). Speeds are compared in single precision, as scikit-learn does."""
    roots, feature, threshold, below, above, value = trees
    for n in range(left.size):
        forward = 0.0
        for c in range(3):
            root = roots[c] if c < 2 or forward >= 0.0 else roots[3]
            node = root
            while feature[node] >= 0:
                speed = np.float32(right[n] if feature[node] else left[n])
                node = root + (below[node] if speed <= threshold[node] else above[node])
            out[n, c] = value[node]
            if c == 1:
                forward = radius * (left[n] + right[n]) - (out[n, 0] + out[n, 1])
        if left[n] == 0.0 and right[n] == 0.0:
            out[n, :] = 0.0


@loop
def exponentials(constants, half_gauge, left, right, out):
    """F (54) for N vehicles; out (N, 3). constants (3, 2): c_1, c_2 of beta_left, beta_right
    and alpha; the turning radius is that of the belts, F (26)."""
    for n in range(left.size):
        turn = right[n] - left[n]
        straight = abs(turn) < STRAIGHT
        bend = abs(half_gauge * (left[n] + right[n]) / (1.0 if straight else turn))
        sign = 0.0 if straight else (-1.0 if turn > 0.0 else 1.0)
        for c in range(3):
            out[n, c] = sign * constants[c, 0] * math.exp(-constants[c, 1] * bend)
