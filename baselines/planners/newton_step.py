"""Newton step of the interior point method: the problem to second order on every interval.

With multipliers nu of the terminal pose, slacks s = g and multipliers y of the limits, s y = mu,
eliminating slacks and their multipliers leaves stages (riccati) with
    L = cost'' + (nu' pose_N)'' - sum y g'' + sum (y / s) g' g'^T
    l = cost' - sum g' (mu / s - (y / s) (g - s))
Second derivatives of pose_N need no more than those of one interval: the position at the end is the
same function of the position after it, and the derivative of nu' pose_N in the yaw is summed from
the end. Gauss-Newton: without second derivatives of motion and limits.
"""

from baselines.planners import arc_motion as arc
from baselines.planners import riccati
from baselines.planners.riccati import BEFORE_P, BEFORE_Q, DURATION, YAW, P, Q
from tracked_env.physics.jit import formula, loop

VARIABLES = (BEFORE_P, BEFORE_Q, DURATION, P, Q)  # of the limits' derivatives, as in z
RHO = 30.0  # [s/m^2, s/rad^2] weight of the terminal error that makes the problem convex


@loop
def _assemble_motion(a, w, n, exact, damping):
    """F of each interval, and second derivatives of motion weighted by nu, from the last one on."""
    m = complex(w.nu[0], -w.nu[1])
    i_m = m * 1j
    yaw_nu = w.nu[2]  # derivative of nu' pose_N in the yaw at the end of the interval
    for back in range(n):
        k = n - 1 - back
        e, r = w.moves[k], w.turns[k]
        f, h = a.forward[k], a.hessian[k]
        for u in range(3):  # T, p, q
            move = e[arc.MOVE_T + u]
            f[1 + u, 0], f[1 + u, 1], f[1 + u, 2] = move.real, move.imag, r[arc.TURN_T + u]
        f[0, 0], f[0, 1], f[0, 2] = -e[arc.MOVE].imag, e[arc.MOVE].real, 1.0
        h[:, :] = 0.0
        if exact:
            h[YAW, YAW] = -(m * e[arc.MOVE]).real
            h[YAW, DURATION] = (i_m * e[arc.MOVE_T]).real
            h[YAW, P] = (i_m * e[arc.MOVE_P]).real
            h[YAW, Q] = (i_m * e[arc.MOVE_Q]).real
            h[DURATION, DURATION] = (m * e[arc.MOVE_TT]).real
            h[DURATION, P] = (m * e[arc.MOVE_TP]).real + yaw_nu * r[arc.TURN_TP]
            h[DURATION, Q] = (m * e[arc.MOVE_TQ]).real + yaw_nu * r[arc.TURN_TQ]
            h[P, P] = (m * e[arc.MOVE_PP]).real + yaw_nu * r[arc.TURN_PP]
            h[P, Q] = (m * e[arc.MOVE_PQ]).real + yaw_nu * r[arc.TURN_PQ]
            h[Q, Q] = (m * e[arc.MOVE_QQ]).real + yaw_nu * r[arc.TURN_QQ]
            yaw_nu += (i_m * e[arc.MOVE]).real
        h[P, P] += damping
        h[Q, Q] += damping


@formula
def _assemble_cost(a, weights, belts, fixed):
    """Gradient and second derivatives of the cost; weights of the squared steps of p and q."""
    for k in range(len(belts)):
        g, h = a.gradient[k], a.hessian[k]
        g[:] = 0.0
        for u in range(2):
            if k == 0 or (fixed and u == 0):
                continue
            double = 2.0 * weights[u]
            step = belts[k, u] - belts[k - 1, u]
            g[BEFORE_P + u] -= double * step
            g[P + u] += double * step
            h[BEFORE_P + u, BEFORE_P + u] += double
            h[BEFORE_P + u, P + u] -= double
            h[P + u, P + u] += double
    a.gradient[0, DURATION] += 1.0


@loop
def _assemble_limits(a, w, n, active, barrier, exact):
    """Limits, with their slacks eliminated, into the gradient and the second derivatives."""
    for k in range(n):
        g, h = a.gradient[k], a.hessian[k]
        for i in range(active):
            s, y, slope = w.slacks[k, i], w.duals[k, i], w.slopes[k, i]
            stiff = y / s
            pull = barrier / s - stiff * (w.values[k, i] - s)
            for c in range(5):
                if slope[c] == 0.0:
                    continue
                z_c = VARIABLES[c]
                g[z_c] -= slope[c] * pull
                scaled = slope[c] * stiff
                for b in range(c + 1):
                    h[VARIABLES[b], z_c] += scaled * slope[b]
            if exact:
                h[P, P] -= y * w.bends[k, i, 0]
                h[P, Q] -= y * w.bends[k, i, 1]
                h[Q, Q] -= y * w.bends[k, i, 2]


@formula
def _give_speed(a, n):
    """p is given: no step of it."""
    for k in range(n):
        a.forward[k, 2, :] = 0.0
        a.gradient[k, P] = 0.0
        a.hessian[k, :, P] = 0.0
        a.hessian[k, P, :] = 0.0
        a.hessian[k, P, P] = 1.0


@loop
def newton_step(a, w, weights, belts, active, barrier, fixed, exact, damping):
    """Step of all unknowns into a.step, w.slack_steps, w.dual_steps; False where there is none.

    exact: with second derivatives of motion and limits. damping [s/(m/s)^2]: added to those of
    p and q.
    """
    n = len(belts)
    _assemble_motion(a, w, n, exact, damping)
    _assemble_cost(a, weights, belts, fixed)
    _assemble_limits(a, w, n, active, barrier, exact)
    if fixed:
        _give_speed(a, n)
    if not riccati.solve(a, n, w.error, RHO, w.new_nu):
        return False
    for k in range(n):
        z = a.step[k]
        for i in range(active):
            slope, s, y = w.slopes[k, i], w.slacks[k, i], w.duals[k, i]
            change = w.values[k, i] - s
            for c in range(5):
                change += slope[c] * z[VARIABLES[c]]
            w.slack_steps[k, i] = change
            w.dual_steps[k, i] = (barrier - y * change) / s - y
    return True
