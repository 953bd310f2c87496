"""Primal-dual interior point method for the plans of planning_problem, and its Newton step.

Each iteration takes a step of Newton's method towards s = g, s y = mu, pose_N = goal. The step is
shortened to 99.5 % of the way to s = 0 and y = 0, then until a merit function falls: the cost,
minus mu times the logarithms of the slacks, plus a penalty on what is missed. Where the problem is
not convex, or no such step is found, the second derivatives are damped, and in the end
Gauss-Newton's are taken. mu follows the mean of s y downwards. Once the cost is flat (turns on the
spot), damped Gauss-Newton steps only mend what is missed.

Newton step. With multipliers nu of the terminal pose and y of the limits, s y = mu, eliminating
slacks and their multipliers leaves the stages of a Riccati recursion (`baselines.riccati`) with
    L = cost'' + (nu' pose_N)'' - sum y g'' + sum (y / s) g' g'^T
    l = cost' - sum g' (mu / s - (y / s) (g - s))
State (x, y, p_, q_, yaw, T): position, belt speeds of the interval before, yaw, duration (a
constant); input (p, q). Second derivatives of pose_N need no more than those of one interval; the
derivative of nu' pose_N in the yaw is summed from the end. Adding rho / 2 |pose_N|^2 to the
objective changes no minimum, and it makes the problem convex where the original is so on the
constraint pose_N = -c (the terminal error): the recursion fails exactly where it is not (a pivot of
M_uu is not positive), which is the inertia test of the method. The three multipliers enter as three
more linear terms; G nu = c - G_0 gives them, G the inverse Hessian seen from the terminal pose.

References: [1] J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), ch. 19.
"""

import math

from baselines.planners import planning_problem as arc
from baselines.planners.planning_problem import NODES, choose, evaluate
from baselines.riccati import inverse_of, recursion
from tracked_env.physics.jit import copy_table, formula, loop

BOUNDARY = 0.995  # [-] share of the way to the boundary
FIRST_BARRIER = 1e-2  # [s] mu at first
BARRIER_FALL = 0.08  # [-] of mu in an iteration after a full step
GAP = 2e-4  # [s] sum of s y at which a plan is good enough
MISSED = 1e-8  # [m, rad] terminal error at which it is
STILL = 1e-3  # [m/s, s] step at which it is; the next one is its square
LEAST_SLACK = 1e-2  # [m/s] slack at first
SUFFICIENT = 1e-4  # [-] share of the predicted fall of the merit function
HALVINGS = 8  # of a step
ATTEMPTS = 5  # at a step: with more and more damping, the last one Gauss-Newton's
FLAT, FLAT_STEPS = 1e-4, 2  # [s] change of the cost, and steps of it in turn: good enough
FINISHING, FINISHING_STEPS = 1e3, 5  # [s/(m/s)^2] damping that leaves the plan as it is; steps
SETTLED = 6  # iterations after which the cost of a plan is nearly the one that it ends at
PAUSE = 6  # flat steps until finishing is tried again
LEAST_DAMPING, MORE_DAMPING, LESS_DAMPING = 0.3, 6.0, 0.3  # [s/(m/s)^2], [-], [-]
X, Y, BEFORE_P, BEFORE_Q, YAW, DURATION, P, Q = range(8)  # places in z = (state, input)
STATES, ROWS, COLUMNS = 6, 3, 4  # x, y, yaw move with yaw, T, p, q
TERMS = 4  # linear terms: that of the objective, and of three multipliers
VARIABLES = (BEFORE_P, BEFORE_Q, DURATION, P, Q)  # of the limits' derivatives, as in z
PIVOT = 1e-9  # [-] least pivot
RHO = 30.0  # [s/m^2, s/rad^2] weight of the terminal error that makes the problem convex
condense, _fix_inputs, eliminate = recursion(STATES, ROWS, COLUMNS, TERMS)


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
                for c in range(COLUMNS):
                    total += a.forward[k, c, r] * z[k, YAW + c]
                if r < 2:
                    total += z[k, r]
                z[k + 1, YAW if r == 2 else r] = total
            z[k + 1, DURATION] = z[k, DURATION]
            z[k + 1, BEFORE_P], z[k + 1, BEFORE_Q] = z[k, P], z[k, Q]


@loop
def solve_stages(a, terminal, count, error, rho, nu):
    """Solve the problem of `a` for the terminal error (3,): steps into a.step, multipliers into nu.

    terminal (3, TERMS): work space, c - G_0 and G. Returns False where the problem is not convex on
    its constraint, or the terminal pose cannot be moved. nu (3,) [s/m, s/m, s/rad]: of the original
    objective, without rho.
    """
    a.value[:, :] = 0.0
    a.linear[:, :] = 0.0
    terminal[:, :] = 0.0
    for i in range(3):
        place = YAW if i == 2 else i
        a.value[place, place] = rho
        a.linear[i + 1, place] = 1.0
    for back in range(count):
        k = count - 1 - back
        condense(a, k, 0.0)
        pp = a.matrix[P, P]
        i_pp, i_pq, i_qq, rest = inverse_of(pp, a.matrix[P, Q], a.matrix[Q, Q])
        if not (pp > PIVOT and rest > PIVOT):
            return False
        eliminate(a, k, (i_pp, i_pq, i_qq))
        for i in range(3):
            p, q = a.vector[i + 1, P], a.vector[i + 1, Q]
            for j in range(TERMS):
                terminal[i, j] -= p * a.offsets[k, j, 0] + q * a.offsets[k, j, 1]
    bend = a.value[DURATION, DURATION]
    if not bend > PIVOT:
        return False
    for i in range(3):
        for j in range(TERMS):
            terminal[i, j] += a.linear[i + 1, DURATION] * a.linear[j, DURATION] / bend
        terminal[i, 0] = error[i] - terminal[i, 0]
    if not _solve_three(terminal, nu):
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


@loop
def newton_step(w, weights, active, barrier, fixed, exact, damping):
    """Step of all unknowns into w.stages.step, w.slack_steps, w.dual_steps; False: there is none.

    exact: with second derivatives of motion and limits. damping [s/(m/s)^2]: added to those of
    p and q.
    """
    a, n = w.stages, len(w.belts)
    _assemble_motion(a, w, n, exact, damping)
    _assemble_cost(a, weights, w.belts, fixed)
    _assemble_limits(a, w, n, active, barrier, exact)
    for k in range(n if fixed else 0):  # p is prescribed: no step of it
        a.forward[k, 2, :] = 0.0
        a.gradient[k, P] = 0.0
        a.hessian[k, :, P] = 0.0
        a.hessian[k, P, :] = 0.0
        a.hessian[k, P, P] = 1.0
    if not solve_stages(a, w.terminal, n, w.error, RHO, w.new_nu):
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
def _merit_slope(w, n, active, barrier, weights, fixed):
    """Derivative of the merit function's smooth part along the step; the penalty has the rest."""
    step, belts, smoothing = w.stages.step, w.belts, 0.0
    total = step[0, DURATION]
    for k in range(n):
        for i in range(active):
            total -= barrier * w.slack_steps[k, i] / w.slacks[k, i]
        for u in range(2):
            if k > 0 and not (fixed and u == 0):
                change = belts[k, u] - belts[k - 1, u]
                smoothing += 2.0 * weights[u] * change * (step[k, P + u] - step[k, BEFORE_P + u])
    return total + smoothing


@loop
def _merit(cost, barrier, penalty, w, n, active):
    """Cost, minus mu times the logarithms of the slacks, plus what is missed."""
    total = 0.0
    for k in range(n):
        product = 1.0
        for i in range(active):
            product *= w.slacks[k, i]
        total += math.log(product)  # one for each interval
    return cost - barrier * total + penalty * _infeasibility(w, n, active)


@loop
def _line_search(problem, duration, cost, barrier, active, w):
    """Take the step as far as the merit function falls enough.

    problem: task, bounds, surface, weights. Returns (share of the step, duration, cost); share 0:
    nowhere, all is as before. w.belts, w.slacks, w.duals, w.nu are moved.
    """
    task, bounds, surface, weights = problem
    n, step = len(w.belts), w.stages.step
    share = _to_boundary(w.slacks, w.slack_steps, n, active)
    dual_share = _to_boundary(w.duals, w.dual_steps, n, active)
    if duration + share * step[0, DURATION] < 0.3 * duration:
        share = -0.7 * duration / step[0, DURATION]
    largest = max(abs(w.new_nu[0]), abs(w.new_nu[1]), abs(w.new_nu[2]))
    for k in range(n):
        for i in range(active):
            largest = max(largest, w.duals[k, i] + w.dual_steps[k, i])
    penalty = 1.1 * largest + 1e-3  # from there on the merit function is exact
    missed = _infeasibility(w, n, active)
    before = _merit(cost, barrier, penalty, w, n, active)
    slope = _merit_slope(w, n, active, barrier, weights, bounds.fixed) - penalty * missed
    copy_table(w.slacks[:, :active], w.old_slacks)
    for _ in range(HALVINGS):
        for k in range(n):
            w.trial[k, 0] = w.belts[k, 0] + share * step[k, P]
            w.trial[k, 1] = w.belts[k, 1] + share * step[k, Q]
        at = duration + share * step[0, DURATION]
        new_cost = evaluate(task, bounds, surface, at, w.trial, active, w)
        for k in range(n):
            for i in range(active):
                s = w.old_slacks[k, i] + share * w.slack_steps[k, i]
                w.slacks[k, i] = max(s, w.values[k, i])
        after = _merit(new_cost, barrier, penalty, w, n, active)
        if after <= before + SUFFICIENT * share * slope + 1e-9:
            copy_table(w.trial, w.belts)
            for k in range(n):
                for i in range(active):
                    w.duals[k, i] += dual_share * w.dual_steps[k, i]
            for i in range(3):
                w.nu[i] += share * (w.new_nu[i] - w.nu[i])
            return share, at, new_cost
        share *= 0.5
    copy_table(w.old_slacks[:, :active], w.slacks)
    evaluate(task, bounds, surface, duration, w.belts, active, w)
    return 0.0, duration, cost


@formula
def _iterate(problem, duration, cost, barrier, active, damping_before, finishing, w):
    """One step, with more and more damping until the merit function falls.

    finishing: only towards what is missed. Returns (share of the step, duration, cost, damping that
    served); share 0: there is none.
    """
    share, damping = 0.0, 0.0
    for attempt in range(ATTEMPTS):
        exact = attempt < ATTEMPTS - 1 and not finishing
        if attempt == 1:
            damping = max(LESS_DAMPING * damping_before, LEAST_DAMPING)
        elif attempt > 1:
            damping = MORE_DAMPING * damping if exact else LEAST_DAMPING
        if finishing:
            damping = FINISHING
        if newton_step(w, problem[3], active, barrier, problem[1].fixed, exact, damping):
            share, duration, cost = _line_search(problem, duration, cost, barrier, active, w)
        if share > 0.0 or finishing:
            break
    return share, duration, cost, damping if attempt < ATTEMPTS - 1 else 0.0


@loop
def solve(task, bounds, surface, duration, w, iterations, enough):
    """Improve the plan in w.belts of a duration [s].

    enough: cost [s] above which it is given up after SETTLED iterations, as a better plan is known.
    Returns (duration, cost [s], whether it converged, iterations).
    """
    n = len(w.belts)
    active = choose(bounds, w.chosen)
    weight = task.smoothing * n / NODES
    weights = (weight, weight / (bounds.half_gauge * bounds.half_gauge))
    problem = (task, bounds, surface, weights)
    cost = evaluate(task, bounds, surface, duration, w.belts, active, w)
    barrier, least = FIRST_BARRIER, 0.5 * GAP / (n * active)
    for k in range(n):
        for i in range(active):
            w.slacks[k, i] = max(w.values[k, i], LEAST_SLACK)
            w.duals[k, i] = barrier / w.slacks[k, i]
    w.nu[:] = 0.0
    damping, flat, finished = 0.0, 0, 0
    for it in range(1, iterations + 1):
        before, finishing = cost, flat >= FLAT_STEPS
        share, duration, cost, damping = _iterate(
            problem, duration, cost, barrier, active, damping, finishing, w
        )
        if share == 0.0 and not finishing:
            return duration, cost, False, it
        gap, step = 0.0, w.stages.step
        largest = abs(step[0, DURATION])
        for k in range(n):
            largest = max(largest, abs(step[k, P]), abs(step[k, Q]))
            for i in range(active):
                gap += w.slacks[k, i] * w.duals[k, i]
        near = gap <= GAP and (finishing or largest <= STILL)
        if near and _infeasibility(w, n, active) <= MISSED:
            return duration, cost, True, it
        if it >= SETTLED and cost > enough:
            return duration, cost, False, it
        finished = finished + 1 if finishing else 0
        if finishing and (share == 0.0 or finished == FINISHING_STEPS):
            flat = -PAUSE
        elif not finishing:
            flat = flat + 1 if gap <= GAP and abs(cost - before) <= FLAT else min(flat, 0)
        fall = BARRIER_FALL if share > 0.9 else (0.5 if share > 0.4 else 1.0)
        barrier = max(least, min(barrier, fall * gap / (n * active)))
    return duration, cost, False, iterations
