"""Newton step of an optimal control problem whose two inputs have bounds, in O(N).

States s (STATES,), inputs u (2,), the stages of tracked_prediction. With z = (s, u) and F =
d s_next / dz, Gauss-Newton weights L (diagonal) and gradients l of the cost, the recursion
    M = L + F' P F,   m = l + F' p
    d = argmin d' M_uu d / 2 + m_u' d   with   low <= u + d <= high          exactly, two inputs
    K = -M_ff^-1 M_fs in the rows of the inputs that are free, 0 in the others
    P <- M_ss + M_su K + K' M_us + K' M_uu K,   p <- m_s + M_su d + K' (M_uu d + m_u)
takes the bounds into account where the input is chosen: what one bounded input cannot give, the
other one and later stages make up for.

References: [1] Y. Tassa, N. Mansard, E. Todorov, Control-limited differential dynamic programming,
ICRA 2014.

Cost of the model predictive controller for the torque-driven vehicle.

Over N stages of h seconds the commands u_k, in units of the largest torque, minimise
    sum_{k=1..N} t_k [q_p |p_k - p_ref|^2 + q_psi (yaw_k - yaw_ref)^2 + q_v (v_k - v_ref)^2
                      + q_w (w_k - w_ref)^2]
    + sum_{k<N} [r |u_k - f_k|^2 + r_c |(u_k - e_k) (1 - exp(-h/T))|^2],   t_k = 1, t_N = terminal
with the states of `tracked_prediction`, the reference of `path_ahead`, f the command that keeps the
model on it, and (u - e) (1 - exp(-h/T)) what the effort of a drive changes by in a stage.
Gauss-Newton drops the curvature of the model: weights and gradients are all that its step needs.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.predictive.tracked_prediction import (
    ALL,
    CHANGED,
    COLUMNS,
    GIVEN_LEFT,
    GIVEN_RIGHT,
    HEADING,
    LEFT,
    PATH_SPEED,
    PATH_X,
    PATH_Y,
    PATH_YAW_RATE,
    RIGHT,
    SPEED,
    STATES,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]


class Stages(NamedTuple):
    """The problem of one step, and its solution; N stages."""

    forward: Array  # (N, COLUMNS, CHANGED) derivatives of each stage
    weight: Array  # (N + 1, ALL) diagonal of L; inputs of the last are not used
    gradient: Array  # (N + 1, ALL) l
    gains: Array  # (N, 2, STATES) K
    offsets: Array  # (N, 2) d
    value: Array  # (STATES, STATES) P
    linear: Array  # (STATES,) p
    product: Array  # (COLUMNS, STATES) P F
    matrix: Array  # (ALL, ALL) M, upper triangle
    vector: Array  # (ALL,) m
    change: Array  # (STATES,) of the state, against that of the gains


def make_stages(count: int) -> Stages:
    """Work space for `count` stages."""
    return Stages(
        np.zeros((count, COLUMNS, CHANGED)), np.zeros((count + 1, ALL)), np.zeros((count + 1, ALL)),
        np.zeros((count, 2, STATES)), np.zeros((count, 2)), np.zeros((STATES, STATES)),
        np.zeros(STATES), np.zeros((COLUMNS, STATES)), np.zeros((ALL, ALL)), np.zeros(ALL),
        np.zeros(STATES),
    )  # fmt: skip


@formula
def _clipped(value, low, high):
    return min(max(value, low), high)


@formula
def bounded_minimum(pp, pq, qq, p, q, low, high):
    """(d_p, d_q, p free, q free) of the least pp d_p^2/2 + pq d_p d_q + qq d_q^2/2 + p d_p + q d_q.

    low, high: (2,) bounds. pp, qq, pp qq - pq^2 > 0. Where the free minimum lies outside, the least
    of the four edges.
    """
    determinant = pp * qq - pq * pq
    d_p, d_q = (pq * q - qq * p) / determinant, (pq * p - pp * q) / determinant
    if low[0] <= d_p <= high[0] and low[1] <= d_q <= high[1]:
        return d_p, d_q, True, True
    best, b_p, b_q, first, second = np.inf, 0.0, 0.0, False, False
    for edge in range(4):
        fixed = edge % 2
        bound = low[fixed] if edge < 2 else high[fixed]
        if fixed == 0:
            d_p, free = bound, -(q + pq * bound) / qq
            d_q = _clipped(free, low[1], high[1])
        else:
            d_q, free = bound, -(p + pq * bound) / pp
            d_p = _clipped(free, low[0], high[0])
        cost = d_p * (0.5 * pp * d_p + pq * d_q + p) + d_q * (0.5 * qq * d_q + q)
        if cost < best:
            best, b_p, b_q = cost, d_p, d_q
            first = fixed == 1 and d_p == free
            second = fixed == 0 and d_q == free
    return b_p, b_q, first, second


@formula
def _quadratic(a, forward, weight, gradient, decay, coupling):
    """M and m of one stage from P and p."""
    value, linear, product, matrix, vector = a.value, a.linear, a.product, a.matrix, a.vector
    for c in range(COLUMNS):
        for r in range(STATES):
            total = 0.0
            for j in range(CHANGED):
                total += forward[c, j] * value[j, r]
            product[c, r] = total
    for side in range(2):
        for r in range(STATES):
            held = value[GIVEN_LEFT + side, r]
            product[3 + side, r] += decay * held
            product[5 + side, r] += (1.0 - decay) * held
    for r in range(YAW):
        for c in range(r, YAW):
            matrix[r, c] = value[r, c]
        for c in range(COLUMNS):
            matrix[r, YAW + c] = product[c, r]
        matrix[r, r] += weight[r]
        vector[r] = linear[r] + gradient[r]
    for c in range(COLUMNS):
        for b in range(c, COLUMNS):
            total = 0.0
            for j in range(CHANGED):
                total += forward[c, j] * product[b, j]
            if 3 <= c < 5:
                total += decay * product[b, c + 2]
            elif c >= 5:
                total += (1.0 - decay) * product[b, c]
            matrix[YAW + c, YAW + b] = total
        matrix[YAW + c, YAW + c] += weight[YAW + c]
        total = gradient[YAW + c]
        for j in range(CHANGED):
            total += forward[c, j] * linear[j]
        if 3 <= c < 5:
            total += decay * linear[c + 2]
        elif c >= 5:
            total += (1.0 - decay) * linear[c]
        vector[YAW + c] = total
    matrix[GIVEN_LEFT, LEFT] -= coupling
    matrix[GIVEN_RIGHT, RIGHT] -= coupling


@formula
def _eliminate(a, k, low, high):
    """Gains and offsets of stage k, then P and p of its beginning."""
    m, vector, gains = a.matrix, a.vector, a.gains[k]
    pp, pq, qq, p, q = m[LEFT, LEFT], m[LEFT, RIGHT], m[RIGHT, RIGHT], vector[LEFT], vector[RIGHT]
    d_p, d_q, first, second = bounded_minimum(pp, pq, qq, p, q, low, high)
    a.offsets[k, 0], a.offsets[k, 1] = d_p, d_q
    determinant = pp * qq - pq * pq
    for s in range(STATES):
        left, right = m[s, LEFT], m[s, RIGHT]
        if first and second:
            gains[0, s] = (pq * right - qq * left) / determinant
            gains[1, s] = (pq * left - pp * right) / determinant
        else:
            gains[0, s] = -left / pp if first else 0.0
            gains[1, s] = -right / qq if second else 0.0
    rest_p, rest_q = pp * d_p + pq * d_q + p, pq * d_p + qq * d_q + q
    for s in range(STATES):
        a.linear[s] = (
            vector[s] + m[s, LEFT] * d_p + m[s, RIGHT] * d_q
            + gains[0, s] * rest_p + gains[1, s] * rest_q
        )  # fmt: skip
        curve_p = m[s, LEFT] + pp * gains[0, s] + pq * gains[1, s]
        curve_q = m[s, RIGHT] + pq * gains[0, s] + qq * gains[1, s]
        for r in range(s + 1):
            entry = m[r, s] + gains[0, r] * curve_p + gains[1, r] * curve_q
            entry += m[r, LEFT] * gains[0, s] + m[r, RIGHT] * gains[1, s]
            a.value[r, s] = entry
            a.value[s, r] = entry


@loop
def improve(a, inputs, bounds, decay, coupling):
    """Offsets and gains of all stages for the problem in `a`, about inputs (N, 2).

    bounds (2,): of |u|; decay [-]: of the efforts over a stage; coupling: weight of |u - e|^2,
    which is in L and l already but for the entries between efforts and inputs.
    """
    count = inputs.shape[0]
    low, high = np.empty(2), np.empty(2)
    a.value[:, :] = 0.0
    for s in range(STATES):
        a.value[s, s] = a.weight[count, s]
        a.linear[s] = a.gradient[count, s]
    for back in range(count):
        k = count - 1 - back
        _quadratic(a, a.forward[k], a.weight[k], a.gradient[k], decay, coupling)
        for side in range(2):
            low[side] = -bounds[side] - inputs[k, side]
            high[side] = bounds[side] - inputs[k, side]
        _eliminate(a, k, low, high)


@formula
def improved(a, k, side, before, share, change, bound):
    """Input of stage k, within +-bound: the one before, a share of the offset, and the feedback of
    change (STATES,) of the state."""
    wanted = before + share * a.offsets[k, side]
    for s in range(STATES):
        wanted += a.gains[k, side, s] * change[s]
    return _clipped(wanted, -bound, bound)


class PredictiveSettings(NamedTuple):
    """Weights and horizon."""

    position: float = 100.0  # [1/m^2] q_p
    heading: float = 10.0  # [1/rad^2] q_psi
    speed: float = 1.0  # [s^2/m^2] q_v
    yaw_rate: float = 0.3  # [s^2/rad^2] q_w
    effort: float = 3.0  # [-] r
    effort_change: float = 200.0  # [-] r_c
    terminal: float = 5.0  # [-] factor on the weights of the last state
    stages: float = 30.0  # [-] N, a whole number
    duration: float = 0.04  # [s] h
    traction: float = 0.98  # [-] share of the effort that the soil carries, F_limit, to be used
    smoothing: float = 1.0  # [-] s of the turning friction in the model


TUNABLE = {  # name -> lowest, highest, whether on a logarithmic scale
    "position": (30.0, 1000.0, True),
    "heading": (1.0, 100.0, True),
    "speed": (0.1, 10.0, True),
    "yaw_rate": (0.03, 3.0, True),
    "effort": (0.1, 100.0, True),
    "effort_change": (1.0, 1000.0, True),
    "terminal": (1.0, 20.0, True),
    "traction": (0.5, 1.0, False),
    "smoothing": (0.1, 1.0, True),
}


@formula
def set_costs(a, ahead, states, inputs, settings, coupling):
    """Weights and gradients of all stages from states (N + 1, STATES) and inputs (N, 2)."""
    count, path = inputs.shape[0], ahead.path
    for k in range(count + 1):
        factor = settings.terminal if k == count else 1.0
        weight, gradient = a.weight[k], a.gradient[k]
        weight[X] = weight[Y] = factor * settings.position
        weight[YAW] = factor * settings.heading
        weight[SPEED], weight[YAW_RATE] = factor * settings.speed, factor * settings.yaw_rate
        weight[GIVEN_LEFT] = weight[GIVEN_RIGHT] = 0.0
        gradient[GIVEN_LEFT] = gradient[GIVEN_RIGHT] = 0.0
        gradient[X] = weight[X] * (states[k, X] - path[k, PATH_X])
        gradient[Y] = weight[Y] * (states[k, Y] - path[k, PATH_Y])
        gradient[YAW] = weight[YAW] * (states[k, YAW] - path[k, HEADING])
        gradient[SPEED] = weight[SPEED] * (states[k, SPEED] - path[k, PATH_SPEED])
        gradient[YAW_RATE] = weight[YAW_RATE] * (states[k, YAW_RATE] - path[k, PATH_YAW_RATE])
        if k < count:
            weight[LEFT] = weight[RIGHT] = settings.effort
            gradient[LEFT] = settings.effort * (inputs[k, 0] - ahead.efforts[k, 0])
            gradient[RIGHT] = settings.effort * (inputs[k, 1] - ahead.efforts[k, 1])
            for side in range(2):
                change = coupling * (inputs[k, side] - states[k, GIVEN_LEFT + side])
                weight[LEFT + side] += coupling
                weight[GIVEN_LEFT + side] = coupling
                gradient[LEFT + side] += change
                gradient[GIVEN_LEFT + side] = -change


@formula
def total_cost(ahead, states, inputs, settings, coupling):
    """The sum that is minimised, of states (N + 1, STATES) from row 1 on and inputs (N, 2)."""
    count, path, total = inputs.shape[0], ahead.path, 0.0
    for k in range(count):
        left = inputs[k, 0] - ahead.efforts[k, 0]
        right = inputs[k, 1] - ahead.efforts[k, 1]
        total += settings.effort * (left * left + right * right)
        left = inputs[k, 0] - states[k, GIVEN_LEFT]
        right = inputs[k, 1] - states[k, GIVEN_RIGHT]
        total += coupling * (left * left + right * right)
        s, r = states[k + 1], path[k + 1]
        x, y, turn = s[X] - r[PATH_X], s[Y] - r[PATH_Y], s[YAW] - r[HEADING]
        v, w = s[SPEED] - r[PATH_SPEED], s[YAW_RATE] - r[PATH_YAW_RATE]
        cost = settings.position * (x * x + y * y) + settings.heading * turn * turn
        cost += settings.speed * v * v + settings.yaw_rate * w * w
        total += settings.terminal * cost if k + 1 == count else cost
    return total
