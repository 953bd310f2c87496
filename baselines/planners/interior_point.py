"""Primal-dual interior point method for plans of N intervals with held belt speeds.

    minimise   T + w_s N / 40 sum_k [(p_{k+1} - p_k)^2 + (w_{k+1} - w_k)^2]     w = 2 q / B
    subject to pose_N = goal,  g(p_k, q_k, p_{k-1}, q_{k-1}, T) >= 0
F (51a) sums over N = 40 intervals, without N: its smoothing halves when N doubles. With the factor
it is w_s / 40 times the integral of the squared derivatives over the share t / T of the plan, and
at N = 40 it is the sum of F.

The unknowns are T and the belt speeds alone: poses follow from them exactly (arc_motion), and their
derivatives too. Each iteration solves for slacks s = g and multipliers y, s y = mu, by Newton's
method with exact second derivatives; the step is found by a Riccati recursion. It is shortened
to 99.5 % of the way to s = 0 and y = 0, then until a merit function falls. Where the problem is not
convex, or no such step is found, second derivatives of motion and limits are left out (Gauss-
Newton). mu follows the mean of s y downwards.

References: [1] J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), ch. 19.
[F] Focchi et al. (2025), section 6.3.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners import arc_motion as arc
from baselines.planners import interval_limits, riccati
from baselines.planners.arc_motion import arc_jet
from baselines.planners.riccati import BEFORE_P, BEFORE_Q, DURATION, YAW, P, Q
from baselines.planners.slip_surface import COLUMNS, ROWS, motion_jets
from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]

VARIABLES = (BEFORE_P, BEFORE_Q, DURATION, P, Q)  # of the limits' derivatives, as in z
NODES = 40.0  # [-] intervals for which w_s is that of F
RHO = 30.0  # [s/m^2, s/rad^2] weight of the terminal error that makes the problem convex
BOUNDARY = 0.995  # [-] share of the way to the boundary
FIRST_BARRIER = 1e-2  # [s] mu at first
BARRIER_FALL = 0.15  # [-] of mu in an iteration after a full step
GAP = 2e-4  # [s] sum of s y at which a plan is good enough
MISSED = 1e-8  # [m, rad] terminal error at which it is
STILL = 1e-3  # [m/s, s] step at which it is; the next one is its square
LEAST_SLACK = 1e-2  # [m/s] slack at first
SUFFICIENT = 1e-4  # [-] share of the predicted fall of the merit function
HALVINGS = 8  # of a step
DAMPING = 1e-3  # [s/(m/s)^2] added where the step is Gauss-Newton's


class Task(NamedTuple):
    """A plan to be made, from (0, 0) at `yaw`."""

    yaw: float  # [rad] at the start
    goal_x: float  # [m] from the start, world axes
    goal_y: float
    turning: float  # [rad] change of yaw, whole turns included
    before_p: float  # [m/s] belt speeds at the start
    before_q: float
    ramp: bool  # whether the first interval must be reached from these
    smoothing: float  # [-] w_s


class Work(NamedTuple):
    """Work space of a solver for N intervals."""

    belts: Array  # (N, 2) p, q
    trial: Array  # (N, 2)
    moves: NDArray[np.complex128]  # (N, 10) moves of the intervals with derivatives, world
    turns: Array  # (N, 9) turns with derivatives
    values: Array  # (N, COUNT) g
    slopes: Array  # (N, COUNT, 5) its gradient in p_, q_, T, p, q
    bends: Array  # (N, COUNT, 3) its second derivatives
    slacks: Array  # (N, COUNT) s
    kept: Array  # (N, COUNT) s before a step
    duals: Array  # (N, COUNT) y
    slack_steps: Array  # (N, COUNT)
    dual_steps: Array  # (N, COUNT)
    rows: Array  # (3, ROWS)
    columns: Array  # (3, 2 COLUMNS)
    chosen: NDArray[np.int64]  # (COUNT,)
    error: Array  # (3,) terminal error: x, y [m], yaw [rad]
    nu: Array  # (3,)
    new_nu: Array  # (3,)


@formula
def make_work(n):
    """Work space for n intervals."""
    c = interval_limits.COUNT
    return Work(
        np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 10), np.complex128), np.empty((n, 9)),
        np.empty((n, c)), np.empty((n, c, 5)), np.empty((n, c, 3)),
        np.empty((n, c)), np.empty((n, c)), np.empty((n, c)), np.empty((n, c)), np.empty((n, c)),
        np.empty((3, ROWS)), np.empty((3, 2 * COLUMNS)), np.empty(c, np.int64),
        np.empty(3), np.empty(3), np.empty(3),
    )  # fmt: skip


@loop
def evaluate(task, bounds, surface, duration, belts, active, w):
    """Cost [s] at a duration and belts (N, 2); terminal error, motion and limits into `w`."""
    n = len(belts)
    share = 1.0 / n
    d = duration * share
    place, yaw = 0j, 0.0
    direction = complex(math.cos(task.yaw), math.sin(task.yaw))
    weight = task.smoothing * n / NODES
    turn_weight = weight / (bounds.half_gauge * bounds.half_gauge)
    cost = duration
    for k in range(n):
        p, q = belts[k, 0], belts[k, 1]
        v_x, v_y, rate = motion_jets(surface, p, q, w.rows, w.columns)
        direction = arc_jet(v_x, v_y, rate, d, share, direction, w.moves[k], w.turns[k])
        place += w.moves[k, arc.MOVE]
        yaw += w.turns[k, arc.TURN]
        before = (belts[k - 1, 0], belts[k - 1, 1]) if k > 0 else (task.before_p, task.before_q)
        if k > 0:
            cost += weight * (p - before[0]) ** 2 + turn_weight * (q - before[1]) ** 2
        for a in range(active):
            i = w.chosen[a]
            w.values[k, a] = interval_limits.inequality(
                i, bounds, (p, q), before, k > 0 or task.ramp, (d, share), v_x, v_y, rate,
                w.slopes[k, a], w.bends[k, a],
            )  # fmt: skip
    w.error[0] = place.real - task.goal_x
    w.error[1] = place.imag - task.goal_y
    w.error[2] = yaw - task.turning
    return cost


@loop
def _assemble_motion(a, w, n, exact):
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
        else:
            h[P, P] = DAMPING
            h[Q, Q] = DAMPING


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
def _newton_step(a, w, weights, belts, active, barrier, fixed, exact):
    """Step of all unknowns into a.step, w.slack_steps, w.dual_steps; False where there is none."""
    n = len(belts)
    _assemble_motion(a, w, n, exact)
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


@formula
def _to_boundary(values, steps, n, active):
    """Share [0, 1] of the steps that keeps values (n, active) positive."""
    share = 1.0
    for k in range(n):
        for i in range(active):
            if values[k, i] + share * steps[k, i] < (1.0 - BOUNDARY) * values[k, i]:
                share = -BOUNDARY * values[k, i] / steps[k, i]
    return share


@formula
def _infeasibility(w, n, active):
    """Sum of what terminal equations and slacks miss."""
    total = abs(w.error[0]) + abs(w.error[1]) + abs(w.error[2])
    for k in range(n):
        for i in range(active):
            total += abs(w.values[k, i] - w.slacks[k, i])
    return total


@formula
def _log_sum(slacks, n, active):
    """Sum of log s, from products of a row: one logarithm for each interval."""
    total = 0.0
    for k in range(n):
        product = 1.0
        for i in range(active):
            product *= slacks[k, i]
        total += math.log(product)
    return total


@formula
def _predicted(a, w, n, active, barrier):
    """Derivative of the merit function's smooth part along the step, from the assembled gradient.

    The gradient holds that of the cost and -mu / s of the limits with s = g; what slacks miss is in
    the penalty.
    """
    total = a.step[0, DURATION]
    for k in range(n):
        for i in range(active):
            total -= barrier * w.slack_steps[k, i] / w.slacks[k, i]
    return total


@formula
def _cost_slope(a, weights, belts, fixed):
    """Derivative of the smoothing along the step."""
    total = 0.0
    for k in range(1, len(belts)):
        for u in range(2):
            if not (fixed and u == 0):
                step = belts[k, u] - belts[k - 1, u]
                total += 2.0 * weights[u] * step * (a.step[k, P + u] - a.step[k, BEFORE_P + u])
    return total


@loop
def _merit(cost, barrier, penalty, w, n, active):
    """Cost, minus mu times the logarithms of the slacks, plus what is missed."""
    return cost - barrier * _log_sum(w.slacks, n, active) + penalty * _infeasibility(w, n, active)


@formula
def _largest_dual(w, n, active):
    """Weight from which the merit function is exact."""
    largest = max(abs(w.new_nu[0]), abs(w.new_nu[1]), abs(w.new_nu[2]))
    for k in range(n):
        for i in range(active):
            largest = max(largest, w.duals[k, i] + w.dual_steps[k, i])
    return largest


@loop
def _line_search(task, bounds, surface, duration, cost, barrier, weights, active, a, w):
    """Take the step as far as the merit function falls enough.

    Returns (share of the step, duration, cost); share 0: nowhere, all is as before. w.belts,
    w.slacks, w.duals, w.nu are moved.
    """
    n = len(w.belts)
    share = _to_boundary(w.slacks, w.slack_steps, n, active)
    dual_share = _to_boundary(w.duals, w.dual_steps, n, active)
    if duration + share * a.step[0, DURATION] < 0.3 * duration:
        share = -0.7 * duration / a.step[0, DURATION]
    penalty = 1.1 * _largest_dual(w, n, active) + 1e-3
    missed = _infeasibility(w, n, active)
    before = _merit(cost, barrier, penalty, w, n, active)
    slope = _predicted(a, w, n, active, barrier) + _cost_slope(a, weights, w.belts, bounds.fixed)
    slope -= penalty * missed
    w.kept[:, :active] = w.slacks[:, :active]
    for _ in range(HALVINGS):
        for k in range(n):
            w.trial[k, 0] = w.belts[k, 0] + share * a.step[k, P]
            w.trial[k, 1] = w.belts[k, 1] + share * a.step[k, Q]
        at = duration + share * a.step[0, DURATION]
        new_cost = evaluate(task, bounds, surface, at, w.trial, active, w)
        for k in range(n):
            for i in range(active):
                s = w.kept[k, i] + share * w.slack_steps[k, i]
                w.slacks[k, i] = max(s, w.values[k, i])
        after = _merit(new_cost, barrier, penalty, w, n, active)
        if after <= before + SUFFICIENT * share * slope + 1e-9:
            w.belts[:, :] = w.trial
            for k in range(n):
                for i in range(active):
                    w.duals[k, i] += dual_share * w.dual_steps[k, i]
            for i in range(3):
                w.nu[i] += share * (w.new_nu[i] - w.nu[i])
            return share, at, new_cost
        share *= 0.5
    w.slacks[:, :active] = w.kept[:, :active]
    evaluate(task, bounds, surface, duration, w.belts, active, w)
    return 0.0, duration, cost


@formula
def _still(a, n):
    """Largest step of the unknowns."""
    largest = abs(a.step[0, DURATION])
    for k in range(n):
        largest = max(largest, abs(a.step[k, P]), abs(a.step[k, Q]))
    return largest


@loop
def solve(task, bounds, surface, duration, w, a, iterations):
    """Improve the plan in w.belts of a duration [s].

    Returns (duration, cost [s], whether it converged, iterations).
    """
    n = len(w.belts)
    active = interval_limits.choose(bounds, w.chosen)
    weight = task.smoothing * n / NODES
    weights = (weight, weight / (bounds.half_gauge * bounds.half_gauge))
    cost = evaluate(task, bounds, surface, duration, w.belts, active, w)
    barrier = FIRST_BARRIER
    for k in range(n):
        for i in range(active):
            w.slacks[k, i] = max(w.values[k, i], LEAST_SLACK)
            w.duals[k, i] = barrier / w.slacks[k, i]
    w.nu[:] = 0.0
    least = 0.5 * GAP / (n * active)
    for it in range(1, iterations + 1):
        share = 0.0
        for exact in (True, False):
            if _newton_step(a, w, weights, w.belts, active, barrier, bounds.fixed, exact):
                share, duration, cost = _line_search(
                    task, bounds, surface, duration, cost, barrier, weights, active, a, w
                )
            if share > 0.0:
                break
        if share == 0.0:
            return duration, cost, False, it
        gap = 0.0
        for k in range(n):
            for i in range(active):
                gap += w.slacks[k, i] * w.duals[k, i]
        missed = _infeasibility(w, n, active)
        if missed <= MISSED and gap <= GAP and _still(a, n) <= STILL:
            return duration, cost, True, it
        fall = BARRIER_FALL if share > 0.9 else (0.5 if share > 0.4 else 1.0)
        barrier = max(least, min(barrier, fall * gap / (n * active)))
    return duration, cost, False, iterations
