"""Plans against IPOPT: the same problem by multiple shooting and Runge-Kutta steps, in CasADi."""

import math

import numpy as np
import pytest

from baselines.planners.curves import dubins
from baselines.planners.least_time import optimal
from baselines.planners.slip_surface import surface_of
from baselines.planners.trajectory import Limits
from baselines.slip.slip_sweep import identified_slip
from tests.baselines.planners.planner_cases import drive
from tracked_env.physics.parameters import VEHICLES

casadi = pytest.importorskip("casadi", reason="CasADi is no dependency: run `make oracle`")

FOCCHI = VEHICLES["focchi"]
SLIP = identified_slip(FOCCHI)
COUNT = 40
GOALS = [(2.0, 2.5, -0.4), (-1.2, -0.9, 0.6), (2.8, -2.7, -3.1)]


def motion(surface):
    """CasADi function of belt speeds p, q: v_x, v_y, w, from the coefficients of a surface."""
    p, q = casadi.SX.sym("p"), casadi.SX.sym("q")
    rows, columns = surface.terms.shape[1:]

    def chebyshev(x, n):
        terms = [casadi.SX(1.0), x]
        while len(terms) < n:
            terms.append(2 * x * terms[-1] - terms[-2])
        return terms

    along = chebyshev(2 * p / surface.fastest - 1, rows)
    across = chebyshev(q / surface.fastest_turn, 2 * columns)
    s, d, y = (
        sum(
            surface.terms[c, i, j] * along[i] * across[2 * j + odd]
            for i in range(rows)
            for j in range(columns)
        )
        for c, odd in enumerate((0, 1, 1))
    )
    share = p / surface.fastest
    speeds = [p - share * s, share * y, (q - d) / surface.half_gauge]
    return casadi.Function("motion", [p, q], speeds)


def stepped(rates, state, belts, duration, parts=4):
    """State after Runge-Kutta steps."""
    v_x, v_y, w = rates(belts[0], belts[1])

    def rate(s):
        c, n = casadi.cos(s[2]), casadi.sin(s[2])
        return casadi.vertcat(v_x * c - v_y * n, v_x * n + v_y * c, w)

    h = duration / parts
    for _ in range(parts):
        a = rate(state)
        b = rate(state + h / 2 * a)
        c = rate(state + h / 2 * b)
        state = state + h / 6 * (a + 2 * b + 2 * c + rate(state + h * c))
    return state


def guess(goal, speed, radius=0.4):
    """Duration, belts (N, 2), states (N + 1, 3) along the Dubins path."""
    path = dubins((0, 0, 0), goal, radius)
    ends = np.append(0.0, np.cumsum(path.segments[0]))
    states, belts = [], []
    for way in np.linspace(0.0, path.length[0], COUNT + 1):
        lengths = np.clip(way - ends[:-1], 0.0, path.segments[0])
        states.append(drive((0, 0, 0), lengths, path.curvature[0]))
    for turn in np.diff(np.array(states)[:, 2]) * COUNT / path.length[0]:
        belts.append((speed, turn * speed * 0.5 * FOCCHI.track_gauge))
    return path.length[0] / speed, np.array(belts), np.array(states)


def ipopt(goal, limits, surface):
    """(cost, yaw at the end) of IPOPT's plan from the shortest Dubins path."""
    rates, half = motion(surface), surface.half_gauge
    symbol = casadi.SX.sym
    duration, u, s = symbol("T"), symbol("u", 2, COUNT), symbol("s", 3, COUNT + 1)
    cost, rows = duration, [(s[:, 0], 0.0, 0.0)]
    belt = FOCCHI.sprocket_radius * limits.sprocket_used
    for k in range(COUNT):
        if k:
            cost += (u[0, k] - u[0, k - 1]) ** 2 + ((u[1, k] - u[1, k - 1]) / half) ** 2
        rows.append((s[:, k + 1] - stepped(rates, s[:, k], u[:, k], duration / COUNT), 0.0, 0.0))
        v_x, v_y, w = rates(u[0, k], u[1, k])
        rows += [(u[0, k] + u[1, k], -np.inf, belt), (u[0, k] - u[1, k], -np.inf, belt)]
        rows.append((v_x * w, -limits.lateral_acceleration, limits.lateral_acceleration))
        if not limits.fixed:
            rows.append((v_x**2 + v_y**2, 0.0, limits.v_max**2))
    first, belts, states = guess(goal, limits.v_max if limits.fixed else 0.35)
    wanted = [goal[0], goal[1], states[-1, 2]]
    low = [np.full(row.shape[0], a) for row, a, _ in rows] + [wanted]
    high = [np.full(row.shape[0], b) for row, _, b in rows] + [wanted]
    unknown = casadi.vertcat(duration, casadi.vec(u), casadi.vec(s))
    free = np.full(states.size, 100.0)
    limited = casadi.vertcat(*(row for row, _, _ in rows), s[:, COUNT])
    quiet = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
    problem = {"x": unknown, "f": cost, "g": limited}
    solver = casadi.nlpsol("plan", "ipopt", problem, quiet)
    result = solver(
        x0=np.concatenate([[first], belts.ravel(), states.ravel()]),
        lbx=np.concatenate([[0.01], np.tile([limits.v_min, -9.0], COUNT), -free]),
        ubx=np.concatenate([[99.0], np.tile([limits.v_max, 9.0], COUNT), free]),
        lbg=np.concatenate(low),
        ubg=np.concatenate(high),
    )
    assert solver.stats()["success"]
    return float(result["f"]), states[-1, 2]


@pytest.mark.parametrize("goal", GOALS)
@pytest.mark.parametrize("v_min", [0.4, 0.15])
def test_the_cost_is_that_of_ipopt(goal, v_min):
    limits = Limits.of(FOCCHI, v_min=v_min, v_max=0.4, acceleration=math.inf)
    surface = surface_of(SLIP, FOCCHI, limits.sprocket_used, limits.v_max)
    plan = optimal((0, 0, 0), goal, limits, FOCCHI, SLIP)
    cost, yaw = ipopt(goal, limits, surface)
    assert plan.cost <= cost * (1.0 + 1e-4)
    if abs(plan.yaw[-1] - yaw) < 1e-6:  # the same whole turns: the same minimum
        assert plan.cost == pytest.approx(cost, rel=1e-3)
