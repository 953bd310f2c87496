"""Riccati recursion of optimal control problems with two inputs, in O(N).

State s = (x, y, u_, v_, ...): a position that only shifts, the inputs' memory (what the inputs of
the interval before have left: themselves, or the efforts of lagging drives), then the rest. With
z = (s, u), F = ds_next / dz, stage Hessians L and gradients l,
    minimise   sum (z' L z / 2 + l' z)   subject to   s_next = F z
    M = L + F' P F,   m = l + F' p                              `condense`
    K = -M_uu^-1 M_us,   P <- M_ss + M_su K,   p <- m_s + K' m_u    `eliminate`
from the last interval on. Several linear terms may be carried along (multipliers, which enter
linearly). An input at a bound is fixed: what it adds to m is taken in (`fix_inputs`), and K is that
of the inputs that are free; what one bounded input cannot give, the other one and later intervals
make up for [2].

F moves few states. Its C columns, in order, are those of the states after the memory, of the two
inputs, and of the memory where the motion depends on it. `forward` has the rows that a column
moves: the first R of (x, y, states after the memory). States behind these are constant. The memory
follows the inputs, u_' = lag u_ + (1 - lag) u.

References: [1] C. V. Rao, S. J. Wright, J. B. Rawlings, Application of interior-point methods to
model predictive control, J. Optim. Theory Appl. 99 (1998). [2] Y. Tassa, N. Mansard, E. Todorov,
Control-limited differential dynamic programming, ICRA 2014.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula

Array = NDArray[np.float64]
MEMORY = 2  # place in z of what the inputs have left; the position is before it
REST = 4  # place of the states after it


class Stages(NamedTuple):
    """The problem of one step, and its solution: N intervals, S states, T linear terms."""

    forward: Array  # (N, C, R) derivatives of the states that move
    hessian: Array  # (N, S + 2, S + 2) L, upper triangle
    gradient: Array  # (N, S + 2) l, the first linear term
    gains: Array  # (N, 2, S) K
    offsets: Array  # (N, T, 2) inputs of each linear term
    step: Array  # (N, S + 2) z of the solution
    value: Array  # (S, S) P
    linear: Array  # (T, S) p
    product: Array  # (C, S) P F
    matrix: Array  # (S + 2, S + 2) M, upper triangle
    vector: Array  # (T, S + 2) m


@formula
def make_stages(count, states, rows, columns, terms):
    """Work space for `count` intervals."""
    n, every = count, states + 2
    problem = np.zeros((n, columns, rows)), np.zeros((n, every, every)), np.zeros((n, every))
    solution = np.empty((n, 2, states)), np.empty((n, terms, 2)), np.empty((n, every))
    value = np.empty((states, states)), np.empty((terms, states)), np.empty((columns, states))
    return Stages(*problem, *solution, *value, np.zeros((every, every)), np.empty((terms, every)))


@formula
def inverse_of(pp, pq, qq):
    """Inverse (pp, pq, qq) of a symmetric matrix, and its second pivot."""
    rest = qq - pq * pq / pp
    i_qq = 1.0 / rest
    i_pq = -pq / pp * i_qq
    return (1.0 - pq * i_pq) / pp, i_pq, i_qq, rest


@formula
def clipped(value, low, high):
    """The value within its bounds."""
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
        side = edge % 2
        bound = low[side] if edge < 2 else high[side]
        if side == 0:
            d_p, free = bound, -(q + pq * bound) / qq
            d_q = clipped(free, low[1], high[1])
        else:
            d_q, free = bound, -(p + pq * bound) / pp
            d_p = clipped(free, low[0], high[0])
        cost = d_p * (0.5 * pp * d_p + pq * d_q + p) + d_q * (0.5 * qq * d_q + q)
        if cost < best:
            best, b_p, b_q = cost, d_p, d_q
            first = side == 1 and d_p == free
            second = side == 0 and d_q == free
    return b_p, b_q, first, second


def recursion(states: int, rows: int, columns: int, terms: int) -> tuple[Any, Any, Any]:
    """The kernels `condense`, `fix_inputs` and `eliminate` for Stages of these sizes.

    Sizes are constants when a kernel is compiled: loops of another length are a half slower.
    """
    free = states - 4  # columns before those of the inputs
    after, left, right = rows - 2, states, states + 1

    @formula
    def row_of(j):
        """Place in z of row j of `forward`."""
        return j if j < MEMORY else j + 2

    @formula
    def place_of(c):
        """Place in z of column c of `forward`."""
        return c + REST if c < free + 2 else c - free

    @formula
    def carried(c, lag):
        """State that a column moves beside those of `forward`, and by how much."""
        if c < free:
            return c + REST, 1.0
        return MEMORY + (c - free) % 2, lag if c >= free + 2 else 1.0 - lag

    @formula
    def condense(a, k, lag):
        """M and m of interval k from P and p behind it, into a.matrix and a.vector."""
        forward, hessian, matrix = a.forward[k], a.hessian[k], a.matrix
        for r in range(states):
            for c in range(columns):
                total = 0.0
                for j in range(rows):
                    total += forward[c, j] * a.value[r, row_of(j)]
                a.product[c, r] = total
        for c in range(after, columns):
            row, share = carried(c, lag)
            for r in range(states):
                a.product[c, r] += share * a.value[row, r]
        for b in range(states + 2):
            for c in range(b + 1):
                if c >= MEMORY or b < MEMORY:
                    matrix[c, b] = hessian[c, b]
        for c in range(MEMORY):
            for b in range(c, MEMORY):
                matrix[c, b] += a.value[c, b]
        for b in range(columns):
            g, place = a.product[b], place_of(b)
            matrix[0, place], matrix[1, place] = g[0], g[1]
            for c in range(b + 1):
                total = 0.0
                for j in range(rows):
                    total += forward[c, j] * g[row_of(j)]
                at = place_of(c)
                matrix[min(at, place), max(at, place)] += total
            for c in range(after, b + 1):
                row, share = carried(c, lag)
                at = place_of(c)
                matrix[min(at, place), max(at, place)] += share * g[row]
        for t in range(terms):
            p, m = a.linear[t], a.vector[t]
            m[0], m[1], m[MEMORY], m[MEMORY + 1] = p[0], p[1], 0.0, 0.0
            for c in range(columns):
                total = 0.0
                for j in range(rows):
                    total += forward[c, j] * p[row_of(j)]
                if c >= after:
                    row, share = carried(c, lag)
                    total += share * p[row]
                m[place_of(c)] = total
        for s in range(states + 2):
            a.vector[0, s] += a.gradient[k, s]

    @formula
    def fix_inputs(a, low, high):
        """Fix the inputs that end at a bound (2,), low or high: (step p, step q, inverse of M_ff).

        A step is 0 where the input is free; what the others add is in a.vector.
        """
        m, vector = a.matrix, a.vector[0]
        pp, pq, qq = m[left, left], m[left, right], m[right, right]
        d_p, d_q, p_free, q_free = bounded_minimum(
            pp, pq, qq, vector[left], vector[right], low, high
        )
        if p_free and q_free:
            i_pp, i_pq, i_qq, _rest = inverse_of(pp, pq, qq)
            return 0.0, 0.0, (i_pp, i_pq, i_qq)
        d_p, d_q = 0.0 if p_free else d_p, 0.0 if q_free else d_q
        for s in range(states):
            vector[s] += m[s, left] * d_p + m[s, right] * d_q
        vector[left] += pp * d_p + pq * d_q
        vector[right] += pq * d_p + qq * d_q
        return d_p, d_q, (1.0 / pp if p_free else 0.0, 0.0, 1.0 / qq if q_free else 0.0)

    @formula
    def eliminate(a, k, inverse):
        """Gains and offsets of interval k, then P and p of its beginning; inverse: of M_uu."""
        i_pp, i_pq, i_qq = inverse
        m, gains, offsets = a.matrix, a.gains[k], a.offsets[k]
        for s in range(states):
            gains[0, s] = -(i_pp * m[s, left] + i_pq * m[s, right])
            gains[1, s] = -(i_pq * m[s, left] + i_qq * m[s, right])
        for b in range(states):
            for c in range(b + 1):
                entry = m[c, b] + m[c, left] * gains[0, b] + m[c, right] * gains[1, b]
                a.value[c, b] = entry
                a.value[b, c] = entry
        for j in range(terms):
            p, q = a.vector[j, left], a.vector[j, right]
            offsets[j, 0] = -(i_pp * p + i_pq * q)
            offsets[j, 1] = -(i_pq * p + i_qq * q)
            for s in range(states):
                a.linear[j, s] = a.vector[j, s] + gains[0, s] * p + gains[1, s] * q

    return condense, fix_inputs, eliminate
