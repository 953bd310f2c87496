"""Motion at held belt speeds: exact arcs, with first and second derivatives.

At held belt speeds v = v_x + i v_y and w are constant, so that over a duration d the position in
the axes of its beginning moves by
    a = d sigma(w d) v      sigma(theta) = (exp(i theta) - 1) / (i theta)
and the yaw by theta = w d. In the world it moves by exp(i yaw) a: complex numbers are positions.
No sub-steps are needed, whatever d. d = T / N: all intervals are equally long.

References: [F] Focchi et al. (2025), section 3.2 (27); 6.3 integrates by sub-steps of RK4.
"""

import math

from tracked_env.physics.jit import formula, loop

SMALL = 0.2  # [rad] below it sigma is a series: the closed forms lose digits like 1e-16 / theta^2


# Columns of the derivatives of a move (complex) and a turn; a turn is linear in T.
MOVE, MOVE_T, MOVE_P, MOVE_Q, MOVE_TT, MOVE_TP, MOVE_TQ, MOVE_PP, MOVE_PQ, MOVE_QQ = range(10)
TURN, TURN_T, TURN_P, TURN_Q, TURN_TP, TURN_TQ, TURN_PP, TURN_PQ, TURN_QQ = range(9)


@formula
def _chord_series(x):
    """sigma, sigma', sigma'' for |x| <= SMALL, error below 1e-15."""
    t = x * x
    s = 1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0)))
    c = 0.5 * x * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0 * (1.0 - t / 90.0))))
    s_1 = x * (
        -1.0 / 3.0 + t * (1.0 / 30.0 - t * (1.0 / 840.0 - t * (1.0 / 45360.0 - t / 3991680.0)))
    )
    c_1 = 0.5 - t * (0.125 - t * (1.0 / 144.0 - t * (1.0 / 5760.0 - t / 403200.0)))
    s_2 = -1.0 / 3.0 + t * (0.1 - t * (1.0 / 168.0 - t * (1.0 / 6480.0 - t / 443520.0)))
    c_2 = x * (-0.25 + t * (1.0 / 36.0 - t * (1.0 / 960.0 - t * (1.0 / 50400.0 - t / 4354560.0))))
    return complex(s, c), complex(s_1, c_1), complex(s_2, c_2)


@formula
def chord(x):
    """sigma, its first and second derivative, and exp(i x), at an angle x [rad]."""
    cosine, sine = math.cos(x), math.sin(x)
    if abs(x) <= SMALL:
        sigma, sigma_1, sigma_2 = _chord_series(x)
    else:
        s, c = sine / x, (1.0 - cosine) / x
        s_1, c_1 = (cosine - s) / x, (sine - c) / x
        sigma, sigma_1 = complex(s, c), complex(s_1, c_1)
        sigma_2 = complex((-sine - 2.0 * s_1) / x, (cosine - 2.0 * c_1) / x)
    return sigma, sigma_1, sigma_2, complex(cosine, sine)


@loop
def arc_jet(v_x, v_y, w, duration, per_interval, direction, move, turn):
    """Move [m] and turn [rad] of an interval with their derivatives in T, p, q.

    v_x, v_y, w: jets in p, q. per_interval = 1 / N. direction = exp(i yaw) at its beginning: turns
    the moves into the world. move (10,), turn (9,): out. Returns `direction` at its end.
    """
    d, n, u = duration, per_interval, direction
    sigma, sigma_1, sigma_2, end = chord(w.value * d)
    v = complex(v_x.value, v_y.value)
    v_p, v_q = complex(v_x.p, v_y.p), complex(v_x.q, v_y.q)
    a, b = u * (d * sigma), u * (d * d * sigma_1)
    bv, cv, last = b * v, u * (d * d * d * sigma_2) * v, n * u * end
    move[MOVE] = a * v
    move[MOVE_T] = last * v
    move[MOVE_P] = a * v_p + w.p * bv
    move[MOVE_Q] = a * v_q + w.q * bv
    move[MOVE_TT] = last * v * complex(0.0, n * w.value)
    move[MOVE_TP] = last * (v_p + v * complex(0.0, d * w.p))
    move[MOVE_TQ] = last * (v_q + v * complex(0.0, d * w.q))
    move[MOVE_PP] = a * complex(v_x.pp, v_y.pp) + 2.0 * w.p * b * v_p + w.pp * bv + w.p * w.p * cv
    move[MOVE_PQ] = (
        a * complex(v_x.pq, v_y.pq) + b * (w.p * v_q + w.q * v_p) + w.pq * bv + w.p * w.q * cv
    )
    move[MOVE_QQ] = a * complex(v_x.qq, v_y.qq) + 2.0 * w.q * b * v_q + w.qq * bv + w.q * w.q * cv
    turn[TURN], turn[TURN_T] = w.value * d, n * w.value
    turn[TURN_P], turn[TURN_Q] = d * w.p, d * w.q
    turn[TURN_TP], turn[TURN_TQ] = n * w.p, n * w.q
    turn[TURN_PP], turn[TURN_PQ], turn[TURN_QQ] = d * w.pp, d * w.pq, d * w.qq
    return u * end
