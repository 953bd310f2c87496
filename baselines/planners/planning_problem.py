"""The optimal control problem of a plan: its unknowns, cost, terminal error and limits.

    minimise   T + w_s N / 40 sum_k [(p_{k+1} - p_k)^2 + (w_{k+1} - w_k)^2]     w = 2 q / B
    subject to pose_N = goal,  g(p_k, q_k, p_{k-1}, q_{k-1}, T) >= 0
F (51a) sums over N = 40 intervals: its smoothing halves when N doubles. With the factor N / 40 it
is w_s / 40 times the integral of the squared derivatives over the share t / T of the plan, and at
N = 40 it is the sum of F. The speeds in it are those of the belts, as in the code of F.

The unknowns are T and the belt speeds alone: poses follow from them exactly (arc_motion).

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 6.3.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners import arc_motion as arc
from baselines.planners import interval_limits
from baselines.planners.arc_motion import arc_jet
from baselines.planners.slip_surface import COLUMNS, ROWS, motion_jets
from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]

NODES = 40.0  # [-] intervals for which w_s is that of F


class Task(NamedTuple):
    """A plan to be made, from (0, 0) at `yaw`."""

    yaw: float  # [rad] at the start
    goal_x: float  # [m] from the start, world axes
    goal_y: float
    turning: float  # [rad] change of yaw, whole turns included
    before_p: float  # [m/s] belt speeds at the start
    before_q: float
    ramp: bool  # whether the first interval must be reached from these
    rising: int  # first intervals that may be slower than the slowest
    falling: int  # last intervals that may
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
        slow = k < task.rising or k >= n - task.falling
        place_in_plan = k > 0 or task.ramp, slow, k == n - 1
        for a in range(active):
            i = w.chosen[a]
            w.values[k, a] = interval_limits.inequality(
                i, bounds, (p, q), before, place_in_plan, (d, share), v_x, v_y, rate,
                w.slopes[k, a], w.bends[k, a],
            )  # fmt: skip
    w.error[0] = place.real - task.goal_x
    w.error[1] = place.imag - task.goal_y
    w.error[2] = yaw - task.turning
    return cost
