"""A bank of plants over friction: how well each explains what is measured.

Each of M plants, on frictions mu_k, is driven by the measured sprocket speeds and drawn to the
measured velocities z = (v_x, v_y, w) over PULL seconds (a Kalman filter with a fixed gain). With
the innovations r_k = z - z_k in units of their noise, the prediction of a friction between two of
the bank, at share s of the way in 1 / mu, has (1 - s) r_k + s r_{k+1}, as slip is nearly linear
in 1 / mu. Its sum of squares is kept for all s at once:
    J(k, s) = (1 - s)^2 A_k + 2 s (1 - s) C_k + s^2 A_{k+1} + ((k + s - p_0) / SPREAD)^2
    A_k <- f A_k + r_k . r_k,   C_k <- f C_k + r_k . r_{k+1}
and its least value gives mu, its curvature the variance. The last term is the prior. Plants and
not the tables predict, because on slippery ground the vehicle takes seconds to become steady.
    excitation   a sample counts in turns only, for friction does not show when driving straight;
                 f falls below 1 as far as the sample tells the neighbours of mu apart: nothing is
                 forgotten where nothing is learned
    outliers     a sample that no plant explains within GATE has less weight
    changes      Page's test of every mu_k against the present one,
                 D_k <- max(D_k + r . r - r_k . r_k, 0); beyond CHANGED the D_k replace the sums.
                 A friction that the data contradict is LARGEST behind the best at most:
                 however long the soil was the same, a change is seen soon
    bounds       mu stays within the bank, the curvature below SURE

References: [1] D. T. Magill (1965): banks of models. [2] E. S. Page (1954): cumulative sums.
"""

import math

import numpy as np

from tracked_env.physics.jit import formula, loop

JUMP = 0.5  # [m/s, rad/s] largest innovation that draws them: an outlier moves them little
FARTHEST = 100.0  # [-] largest innovation in units of its noise: a wild sample does not overflow
GATE = 9.0  # [-] squares of an innovation that the best plant may have
TOLD_APART = 0.02  # [-] squares by which a sample tells neighbours apart for f to be half way down
LARGEST = 200.0  # [-] that J may be above its least value
SURE = 100.0  # [-] curvature of J per share^2: 0.14 of the way between two frictions, 6 % of mu
SPREAD = 2.0  # [-] sigma of the prior, in frictions of the bank: a factor of 2.2
CHANNELS = 3  # v_x, v_y, w
CHANGED = 12.0  # [-] fall of the sum of squares that is a change: 3.5 sigma


# What is remembered of one vehicle: sprocket speeds, whether started, velocities of the plants,
# A, C, D; what else the plants have; then where mu is (k + s), and the curvature there.
STARTED, VELOCITIES, PLACE, CURVE = 2, 3, -2, -1


def columns_for(count: int, more: int = 0) -> int:
    """Columns of the memory for a bank of `count` plants, with `more` of each before PLACE."""
    return VELOCITIES + CHANNELS * count + 3 * count - 1 + more * count + 2


@formula
def least(memory, i, first, count, prior):
    """(J, k, s, curvature) where J is least; A in columns first.., C behind, prior p_0."""
    lowest, best, share, bend = math.inf, 0, 0.0, 1.0
    weight = 1.0 / (SPREAD * SPREAD)
    for k in range(count - 1):
        a, b = memory[i, first + k], memory[i, first + k + 1]
        c = memory[i, first + count + k]
        off = k - prior
        curve = a - 2.0 * c + b + weight
        slope = c - a + off * weight
        s = min(max(-slope / curve, 0.0), 1.0) if curve > 0.0 else (0.0 if a <= b else 1.0)
        value = (1.0 - s) * (1.0 - s) * a + 2.0 * s * (1.0 - s) * c + s * s * b
        value += (off + s) * (off + s) * weight
        if value < lowest:
            lowest, best, share, bend = value, k, s, curve
    return lowest, best, share, max(bend, weight)


@formula
def value_at(memory, i, first, count, best, share):
    """Sum of squares at share s between the frictions best and best + 1, without the prior."""
    a, b, c = memory[i, first + best], memory[i, first + best + 1], memory[i, first + count + best]
    rest = 1.0 - share
    return rest * rest * a + 2.0 * share * rest * c + share * share * b


@formula
def bounded(memory, i, first, count, best, share, curve):
    """Bring A and C down to what LARGEST and SURE allow, relative to their least value."""
    least_value = value_at(memory, i, first, count, best, share)
    shrink = min(1.0, SURE / curve)
    for k in range(2 * count - 1):
        memory[i, first + k] = min((memory[i, first + k] - least_value) * shrink, LARGEST)
    for k in range(count - 1):
        ends = min(memory[i, first + k], memory[i, first + k + 1])
        memory[i, first + count + k] = min(memory[i, first + count + k], ends)


@formula
def weigh(memory, i, first, count, residual, best, forgetting):
    """Take the innovations residual (count, CHANNELS), in units of their noise, into A and C."""
    smallest, apart = math.inf, 0.0
    for k in range(count):
        square = 0.0
        for c in range(CHANNELS):
            square += residual[k, c] * residual[k, c]
        smallest = min(smallest, square)
    for c in range(CHANNELS):
        apart += (residual[best + 1, c] - residual[best, c]) ** 2
    weight = min(1.0, GATE / max(smallest, GATE))
    keep = 1.0 - forgetting * weight * apart / (apart + TOLD_APART)
    for k in range(count):
        own, next_one = 0.0, 0.0
        for c in range(CHANNELS):
            own += residual[k, c] * residual[k, c]
            if k < count - 1:
                next_one += residual[k, c] * residual[k + 1, c]
        memory[i, first + k] = keep * memory[i, first + k] + weight * own
        if k < count - 1:
            column = first + count + k
            memory[i, column] = keep * memory[i, column] + weight * next_one


@formula
def changed(memory, i, first, count, residual, best, share):
    """Page's test; where it finds a change, what speaks for each friction replaces A and C."""
    page = first + 2 * count - 1
    own, largest = 0.0, 0.0
    for c in range(CHANNELS):
        own += ((1.0 - share) * residual[best, c] + share * residual[best + 1, c]) ** 2
    weight = min(1.0, GATE / max(own, GATE))
    for k in range(count):
        square = 0.0
        for c in range(CHANNELS):
            square += residual[k, c] * residual[k, c]
        gain = min(max(weight * (own - square), -GATE), GATE)
        memory[i, page + k] = max(memory[i, page + k] + gain, 0.0)
        largest = max(largest, memory[i, page + k])
    if largest > CHANGED:
        for k in range(count):
            memory[i, first + k] = largest - memory[i, page + k]
            memory[i, page + k] = 0.0
        for k in range(count - 1):
            memory[i, first + count + k] = min(memory[i, first + k], memory[i, first + k + 1])


@loop
def compare(memory, states, measured, sigma, fastest, gain, turning, forgetting, prior, used):
    """Compare the bank with one sample of N vehicles and draw it to the measured velocities.

    memory (N, columns_for(M)). states (N M, 6): the plants after the step.
    measured (N, 5): sprocket speeds and v_x, v_y, w, NaN where missing. sigma (3,): of the
    innovations. fastest (3,): a wilder sample counts as missing. gain [-]: share of the way to z.
    turning [rad/s]: difference of sprocket speeds above which a sample counts. forgetting [-]:
    share of a period in the memory. prior: p_0. used (N,) bool out: whether a sample counted.
    """
    count = states.shape[0] // memory.shape[0]
    first = VELOCITIES + CHANNELS * count
    residual = np.empty((count, CHANNELS))
    for i in range(memory.shape[0]):
        started = memory[i, STARTED] > 0.0
        seen = 0
        for c in range(CHANNELS):
            z = measured[i, 2 + c]
            known = abs(z) < fastest[c]  # NaN is not
            seen += 1 if known else 0
            for k in range(count):
                model = states[i * count + k, 3 + c] if started else (z if known else 0.0)
                off = z - model if known else 0.0
                residual[k, c] = min(max(off / sigma[c], -FARTHEST), FARTHEST)
                drawn = model + gain * min(max(off, -JUMP), JUMP)
                memory[i, VELOCITIES + CHANNELS * k + c] = drawn
        if seen == CHANNELS:
            memory[i, STARTED] = 1.0
        turns = abs(memory[i, 1] - memory[i, 0]) > turning
        _value, best, share, curve = least(memory, i, first, count, prior)
        if started and seen > 0 and turns:
            weigh(memory, i, first, count, residual, best, forgetting)
            changed(memory, i, first, count, residual, best, share)
            _value, best, share, curve = least(memory, i, first, count, prior)
            bounded(memory, i, first, count, best, share, curve)
            _value, best, share, curve = least(memory, i, first, count, prior)
        used[i] = started and seen > 0 and turns
        memory[i, PLACE], memory[i, CURVE] = best + share, curve
