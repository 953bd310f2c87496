"""Newton step of an optimal control problem with three terminal equations, in O(N).

State s = (x, y, p_, q_, yaw, T): position, belt speeds of the interval before, yaw, duration (a
constant). Input u = (p, q). With z = (s, u), F = ds_next / dz, stage Hessians L and gradients l,
and the terminal error c of the pose (x, y, yaw),
    minimise   sum (z' L z / 2 + l' z)   subject to   s_next = F z,  pose_N = -c
Adding rho / 2 |pose_N|^2 to the objective changes no minimum, and it makes the problem convex
where the original is so on the constraint. The recursion eliminates u from the last interval on:
    M = L + F' P F,   K = -M_uu^-1 M_us,   P <- M_ss - M_su M_uu^-1 M_us
It fails exactly where the problem is not convex (a pivot of M_uu is not positive), which is the
inertia test of the interior point method. The three multipliers enter as three more linear terms;
G nu = c - G_0 gives them, G the inverse Hessian seen from the terminal pose.

F changes the columns of yaw, T, p and q alone: `forward` has d(x, y, yaw)_next in these four.

References: [1] C. V. Rao, S. J. Wright, J. B. Rawlings, Application of interior-point methods to
model predictive control, J. Optim. Theory Appl. 99 (1998).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]

X, Y, BEFORE_P, BEFORE_Q, YAW, DURATION, P, Q = range(8)  # places in z
STATES, ALL = 6, 8
MOVING = 4  # columns of `forward`: yaw, T, p, q, the last of z
TERMS = 4  # linear terms: that of the objective, and of three multipliers
PIVOT = 1e-9  # [-] least pivot


class Stages(NamedTuple):
    """The problem of one step, and its solution."""

    forward: Array  # (N, MOVING, 3) d(x, y, yaw)_next
    hessian: Array  # (N, ALL, ALL) L, upper triangle; none in x and y
    gradient: Array  # (N, ALL) l; none in x, y and yaw
    gains: Array  # (N, 2, STATES) K
    offsets: Array  # (N, TERMS, 2) inputs of each linear term
    step: Array  # (N, ALL) z of the solution
    value: Array  # (STATES, STATES) P
    linear: Array  # (TERMS, STATES) of the value
    product: Array  # (MOVING, STATES) P F
    matrix: Array  # (ALL, ALL) M, upper triangle
    vector: Array  # (TERMS, ALL)
    terminal: Array  # (3, TERMS) c - G_0 and G


@formula
def make_stages(count):
    """Work space for `count` intervals."""
    return Stages(
        np.zeros((count, MOVING, 3)), np.zeros((count, ALL, ALL)), np.zeros((count, ALL)),
        np.empty((count, 2, STATES)), np.empty((count, TERMS, 2)), np.empty((count, ALL)),
        np.empty((STATES, STATES)), np.empty((TERMS, STATES)), np.empty((MOVING, STATES)),
        np.zeros((ALL, ALL)), np.empty((TERMS, ALL)), np.empty((3, TERMS)),
    )  # fmt: skip


@formula
def _quadratic(value, forward, hessian, product, matrix):
    """M of one interval from P."""
    for r in range(STATES):
        x, y, yaw = value[X, r], value[Y, r], value[YAW, r]
        for c in range(MOVING):
            product[c, r] = forward[c, 0] * x + forward[c, 1] * y + forward[c, 2] * yaw
        product[1, r] += value[DURATION, r]
        product[2, r] += value[BEFORE_P, r]
        product[3, r] += value[BEFORE_Q, r]
    for b in range(BEFORE_P, ALL):
        for c in range(BEFORE_P, b + 1):
            matrix[c, b] = hessian[c, b]
    matrix[X, X], matrix[X, Y], matrix[Y, Y] = value[X, X], value[X, Y], value[Y, Y]
    for b in range(MOVING):
        g = product[b]
        matrix[X, YAW + b], matrix[Y, YAW + b] = g[X], g[Y]
        for c in range(b + 1):
            f = forward[c]
            matrix[YAW + c, YAW + b] += f[0] * g[X] + f[1] * g[Y] + f[2] * g[YAW]
        if b >= 1:
            matrix[DURATION, YAW + b] += g[DURATION]
        if b >= 2:
            matrix[P, YAW + b] += g[BEFORE_P]
        if b >= 3:
            matrix[Q, YAW + b] += g[BEFORE_Q]


@formula
def _linear(linear, forward, gradient, vector):
    """Linear terms of one interval from those of the value."""
    for j in range(TERMS):
        v, m = linear[j], vector[j]
        for c in range(MOVING):
            m[YAW + c] = forward[c, 0] * v[X] + forward[c, 1] * v[Y] + forward[c, 2] * v[YAW]
        m[X], m[Y], m[BEFORE_P], m[BEFORE_Q] = v[X], v[Y], 0.0, 0.0
        m[DURATION] += v[DURATION]
        m[P] += v[BEFORE_P]
        m[Q] += v[BEFORE_Q]
    for s in range(BEFORE_P, ALL):
        vector[0, s] += gradient[s]


@formula
def _eliminate(m, vector, gains, offsets, value, linear, terminal):
    """Gains of one interval, P and linear terms of its beginning; False: M_uu is not positive."""
    pp, pq, qq = m[P, P], m[P, Q], m[Q, Q]
    rest = qq - pq * pq / pp
    if not (pp > PIVOT and rest > PIVOT):
        return False
    i_qq = 1.0 / rest
    i_pq = -pq / pp * i_qq
    i_pp = (1.0 - pq * i_pq) / pp
    for s in range(STATES):
        gains[0, s] = -(i_pp * m[s, P] + i_pq * m[s, Q])
        gains[1, s] = -(i_pq * m[s, P] + i_qq * m[s, Q])
    for b in range(STATES):
        for c in range(b + 1):
            entry = m[c, b] + m[c, P] * gains[0, b] + m[c, Q] * gains[1, b]
            value[c, b] = entry
            value[b, c] = entry
    for j in range(TERMS):
        p, q = vector[j, P], vector[j, Q]
        offsets[j, 0] = -(i_pp * p + i_pq * q)
        offsets[j, 1] = -(i_pq * p + i_qq * q)
        for s in range(STATES):
            linear[j, s] = vector[j, s] + gains[0, s] * p + gains[1, s] * q
    for i in range(3):
        for j in range(TERMS):
            terminal[i, j] -= vector[i + 1, P] * offsets[j, 0] + vector[i + 1, Q] * offsets[j, 1]
    return True


@formula
def _solve_three(g, x):
    """x of g[:, 1:] x = g[:, 0] for a symmetric positive definite matrix; False where it is not."""
    l_0 = g[0, 1]
    if not l_0 > 0.0:
        return False
    a, b = g[0, 2] / l_0, g[0, 3] / l_0
    l_1 = g[1, 2] - a * g[0, 2]
    if not l_1 > 0.0:
        return False
    c = (g[1, 3] - a * g[0, 3]) / l_1
    l_2 = g[2, 3] - b * g[0, 3] - c * c * l_1
    if not l_2 > 0.0:
        return False
    y_1 = g[1, 0] - a * g[0, 0]
    y_2 = g[2, 0] - b * g[0, 0] - c * y_1
    x[2] = y_2 / l_2
    x[1] = y_1 / l_1 - c * x[2]
    x[0] = g[0, 0] / l_0 - a * x[1] - b * x[2]
    return True


@formula
def _forward(a, count, nu):
    """Steps of all intervals from a.step[0, DURATION] and the multipliers."""
    z = a.step
    for k in range(count):
        for u in range(2):
            total = a.offsets[k, 0, u]
            for j in range(3):
                total += nu[j] * a.offsets[k, j + 1, u]
            for s in range(STATES):
                total += a.gains[k, u, s] * z[k, s]
            z[k, P + u] = total
        if k + 1 < count:
            for r in range(3):
                total = 0.0
                for c in range(MOVING):
                    total += a.forward[k, c, r] * z[k, YAW + c]
                if r < 2:
                    total += z[k, r]
                z[k + 1, YAW if r == 2 else r] = total
            z[k + 1, DURATION] = z[k, DURATION]
            z[k + 1, BEFORE_P], z[k + 1, BEFORE_Q] = z[k, P], z[k, Q]


@loop
def solve(a, count, error, rho, nu):
    """Solve the problem of `a` for the terminal error (3,): steps into a.step, multipliers into nu.

    Returns False where the problem is not convex on its constraint, or the terminal pose cannot be
    moved. nu (3,) [s/m, s/m, s/rad]: of the original objective, without rho.
    """
    a.value[:, :] = 0.0
    a.linear[:, :] = 0.0
    a.terminal[:, :] = 0.0
    for i in range(3):
        place = YAW if i == 2 else i
        a.value[place, place] = rho
        a.linear[i + 1, place] = 1.0
    for back in range(count):
        k = count - 1 - back
        _quadratic(a.value, a.forward[k], a.hessian[k], a.product, a.matrix)
        _linear(a.linear, a.forward[k], a.gradient[k], a.vector)
        if not _eliminate(
            a.matrix, a.vector, a.gains[k], a.offsets[k], a.value, a.linear, a.terminal
        ):
            return False
    bend = a.value[DURATION, DURATION]
    if not bend > PIVOT:
        return False
    for i in range(3):
        for j in range(TERMS):
            a.terminal[i, j] += a.linear[i + 1, DURATION] * a.linear[j, DURATION] / bend
        a.terminal[i, 0] = error[i] - a.terminal[i, 0]
    if not _solve_three(a.terminal, nu):
        return False
    a.step[0, :] = 0.0
    total = a.linear[0, DURATION]
    for i in range(3):
        total += nu[i] * a.linear[i + 1, DURATION]
    a.step[0, DURATION] = -total / bend
    _forward(a, count, nu)
    for i in range(3):
        nu[i] -= rho * error[i]
    return True
