"""Primal-dual interior point method for the plans of planning_problem.

Each iteration takes a step of Newton's method towards s = g, s y = mu, pose_N = goal (newton_step).
The step is shortened to 99.5 % of the way to s = 0 and y = 0, then until a merit function falls:
the cost, minus mu times the logarithms of the slacks, plus a penalty on what is missed. Where the
problem is not convex, or no such step is found, the second derivatives are damped, and in the end
Gauss-Newton's are taken. mu follows the mean of s y downwards. Where vehicles turn on the spot the
cost hardly depends on how: once it is flat, damped Gauss-Newton steps only mend what is missed.

References: [1] J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), ch. 19.
"""

import math

from baselines.planners import interval_limits
from baselines.planners.newton_step import newton_step
from baselines.planners.planning_problem import NODES, evaluate
from baselines.planners.riccati import BEFORE_P, DURATION, P, Q
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
    copy_table(w.slacks[:, :active], w.kept)
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
            copy_table(w.trial, w.belts)
            for k in range(n):
                for i in range(active):
                    w.duals[k, i] += dual_share * w.dual_steps[k, i]
            for i in range(3):
                w.nu[i] += share * (w.new_nu[i] - w.nu[i])
            return share, at, new_cost
        share *= 0.5
    copy_table(w.kept[:, :active], w.slacks)
    evaluate(task, bounds, surface, duration, w.belts, active, w)
    return 0.0, duration, cost


@formula
def _still(a, n):
    """Largest step of the unknowns."""
    largest = abs(a.step[0, DURATION])
    for k in range(n):
        largest = max(largest, abs(a.step[k, P]), abs(a.step[k, Q]))
    return largest


@formula
def _iterate(
    task, bounds, surface, duration, cost, barrier, weights, active, usual, finishing, a, w
):
    """One step, with more and more damping until the merit function falls.

    finishing: only towards what is missed. Returns (share of the step, duration, cost, damping that
    served); share 0: there is none.
    """
    share, damping = 0.0, 0.0
    for attempt in range(ATTEMPTS):
        exact = attempt < ATTEMPTS - 1 and not finishing
        if attempt == 1:
            damping = max(LESS_DAMPING * usual, LEAST_DAMPING)
        elif attempt > 1:
            damping = MORE_DAMPING * damping if exact else LEAST_DAMPING
        if finishing:
            damping = FINISHING
        if newton_step(a, w, weights, w.belts, active, barrier, bounds.fixed, exact, damping):
            share, duration, cost = _line_search(
                task, bounds, surface, duration, cost, barrier, weights, active, a, w
            )
        if share > 0.0 or finishing:
            break
    return share, duration, cost, damping if attempt < ATTEMPTS - 1 else 0.0


@loop
def solve(task, bounds, surface, duration, w, a, iterations, enough):
    """Improve the plan in w.belts of a duration [s].

    enough: cost [s] above which it is given up after SETTLED iterations, as a better plan is known.
    Returns (duration, cost [s], whether it converged, iterations).
    """
    n = len(w.belts)
    active = interval_limits.choose(bounds, w.chosen)
    weight = task.smoothing * n / NODES
    weights = (weight, weight / (bounds.half_gauge * bounds.half_gauge))
    cost = evaluate(task, bounds, surface, duration, w.belts, active, w)
    barrier, least = FIRST_BARRIER, 0.5 * GAP / (n * active)
    for k in range(n):
        for i in range(active):
            w.slacks[k, i] = max(w.values[k, i], LEAST_SLACK)
            w.duals[k, i] = barrier / w.slacks[k, i]
    w.nu[:] = 0.0
    usual, flat, finished = 0.0, 0, 0
    for it in range(1, iterations + 1):
        before, finishing = cost, flat >= FLAT_STEPS
        share, duration, cost, usual = _iterate(
            task, bounds, surface, duration, cost, barrier, weights, active, usual, finishing, a, w
        )
        if share == 0.0 and not finishing:
            return duration, cost, False, it
        gap = 0.0
        for k in range(n):
            for i in range(active):
                gap += w.slacks[k, i] * w.duals[k, i]
        near = gap <= GAP and (finishing or _still(a, n) <= STILL)
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
