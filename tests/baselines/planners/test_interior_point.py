"""The interior point method's parts: exact arcs and their derivatives, the Riccati recursion."""

import cmath

import numpy as np
import pytest

from baselines.planners import interior_point as method
from baselines.planners import planning_problem as arc
from baselines.planners import slip_surface
from baselines.planners.interior_point import DURATION, TERMS, YAW, P, Q, solve_stages
from baselines.planners.planning_problem import SMALL, arc_jet, chord
from baselines.planners.slip_surface import Jet, motion_jets, surface_of
from baselines.riccati import make_stages
from baselines.slip.slip_regression import ExponentialSlipModel
from baselines.slip.slip_sweep import identified_slip
from tests.baselines.planners.planner_cases import motion_on
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
EXPONENTIAL = ExponentialSlipModel([[0.1, 2.0], [-0.12, 2.5], [0.4, 1.5]], FOCCHI.track_gauge)
LIMIT = FOCCHI.sprocket_speed_limit
SURFACES = {
    "none": surface_of(None, FOCCHI, LIMIT, 0.4),
    "identified": surface_of(identified_slip(FOCCHI), FOCCHI, LIMIT, 0.4),
    "exponential": surface_of(EXPONENTIAL, FOCCHI, LIMIT, 0.4),
}
# Orders of the derivatives in (T, p, q), as the columns of a move and of a turn.
ORDERS = ((0,), (1,), (2,), (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
TURNS = {(0,): arc.TURN_T, (1,): arc.TURN_P, (2,): arc.TURN_Q, (0, 1): arc.TURN_TP}
TURNS |= {(0, 2): arc.TURN_TQ, (1, 1): arc.TURN_PP, (1, 2): arc.TURN_PQ, (2, 2): arc.TURN_QQ}


def evaluate(surface, duration, p, q, count=10, yaw=0.0):
    """Moves (10,) and turns (9,) of one of `count` intervals of a plan of `duration`."""
    rows = np.empty((3, slip_surface.ROWS))
    columns = np.empty((3, 2 * slip_surface.COLUMNS))
    v_x, v_y, w = (Jet(*jet) for jet in motion_jets(surface, p, q, rows, columns))
    move, turn = np.empty(10, complex), np.empty(9)
    arc_jet(v_x, v_y, w, duration / count, 1.0 / count, cmath.exp(1j * yaw), move, turn)
    return move, turn


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("point", [(8.0, 0.3, 0.2), (2.0, 0.2, -0.02), (20.0, 0.35, 0.35)])
def test_derivatives_are_those_of_differences(name, point):
    surface, step = SURFACES[name], 1e-4
    move, turn = evaluate(surface, *point, yaw=0.7)
    for column, order in enumerate(ORDERS, start=1):
        axis, rest = order[-1], order[:-1]
        shift = step * np.eye(3)[axis] * (10.0 if axis == 0 else 1.0)
        ends = [evaluate(surface, *(np.array(point) + s * shift), yaw=0.7) for s in (1, -1, 2, -2)]
        lower = 0 if not rest else ORDERS.index(rest) + 1
        values = [e[0][lower] for e in ends]
        slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * shift[axis])
        assert abs(slope - move[column]) < 1e-6 * max(1.0, abs(move[column]))
        if order in TURNS:
            place = 0 if not rest else TURNS[rest]
            values = [e[1][place] for e in ends]
            slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * shift[axis])
            assert slope == pytest.approx(turn[TURNS[order]], rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-9, -0.05, SMALL, -SMALL])
def test_the_series_of_a_small_angle_is_the_closed_form(angle):
    """sigma from numerical quadrature of exp(i x t) over t in [0, 1], and of its derivatives."""
    nodes, weights = np.polynomial.legendre.leggauss(20)
    t = 0.5 * (nodes + 1.0)
    for order, value in enumerate(chord(angle)[:3]):
        exact = np.sum(0.5 * weights * (1j * t) ** order * np.exp(1j * angle * t))
        assert abs(value - exact) < 3e-15
    assert abs(chord(angle * 1.000001 + 1e-12)[2] - chord(angle)[2]) < 1e-6


def test_an_arc_is_what_fine_runge_kutta_steps_find():
    surface, steps = SURFACES["identified"], 2000
    v_x, v_y, w = motion_on(surface, 0.3, 0.25)[0]
    move, turn = evaluate(surface, 15.0, 0.3, 0.25, yaw=-0.4)
    yaws = -0.4 + w * 1.5 * (np.arange(steps) + 0.5) / steps
    middle = np.sum(np.exp(1j * yaws)) * 1.5 / steps * complex(v_x, v_y)
    assert turn[arc.TURN] == pytest.approx(1.5 * w)
    assert abs(move[arc.MOVE] - middle) < 1e-7


COUNT = 12
FREE = 1 + 2 * COUNT  # T and the inputs


@loop
def _stages(count):
    return make_stages(count, method.STATES, method.ROWS, method.COLUMNS, TERMS)


def random_stages(seed, shift=0.0):
    """Stages of random motions with random second derivatives, those of the inputs raised."""
    rng = np.random.default_rng(seed)
    stages = _stages(COUNT)
    stages.forward[:] = 0.3 * rng.standard_normal(stages.forward.shape)
    stages.forward[:, 0, 2] = 1.0  # yaw at the end of an interval is that at its beginning and more
    for k in range(COUNT):
        root = rng.standard_normal((6, 6))
        stages.hessian[k, 2:, 2:] = 0.1 * (root + root.T)
        stages.hessian[k, P, P] += 3.0 + shift
        stages.hessian[k, Q, Q] += 3.0 + shift
        stages.gradient[k] = rng.standard_normal(8)
        stages.gradient[k, : YAW + 1] = 0.0
    stages.hessian[0, DURATION, DURATION] += 10.0 * shift
    stages.hessian[:] = np.triu(stages.hessian)
    return stages, rng.standard_normal(3)


def dense(stages):
    """(Z, H, g, J): z of all intervals is Z u; Hessian, gradient and terminal Jacobian in u."""
    state, blocks = np.zeros((6, FREE)), []
    state[DURATION, 0] = 1.0
    for k in range(COUNT):
        z = np.vstack([state, np.zeros((2, FREE))])
        z[P, 1 + 2 * k] = z[Q, 2 + 2 * k] = 1.0
        blocks.append(z)
        moved = stages.forward[k].T @ z[YAW:]
        state = np.vstack([moved[:2] + z[:2], z[P], z[Q], moved[2], z[DURATION]])
    hessian, gradient = np.zeros((FREE, FREE)), np.zeros(FREE)
    for k, z in enumerate(blocks):
        full = np.triu(stages.hessian[k])
        full = full + np.triu(full, 1).T
        hessian += z.T @ full @ z
        gradient += z.T @ stages.gradient[k]
    return blocks, hessian, gradient, state[[0, 1, YAW]]


@pytest.mark.parametrize("rho", [0.0, 30.0])
def test_it_solves_the_dense_system_whatever_the_weight_of_the_terminal_error(rho):
    stages, error = random_stages(0, shift=30.0)
    blocks, hessian, gradient, jacobian = dense(stages)
    system = np.block([[hessian, jacobian.T], [jacobian, np.zeros((3, 3))]])
    solution = np.linalg.solve(system, -np.append(gradient, error))
    nu = np.empty(3)
    assert solve_stages(stages, np.empty((3, TERMS)), COUNT, error, rho, nu)
    np.testing.assert_allclose(nu, solution[FREE:], rtol=1e-7, atol=1e-9)
    for k, z in enumerate(blocks):
        np.testing.assert_allclose(stages.step[k], z @ solution[:FREE], rtol=1e-7, atol=1e-9)


def test_it_is_refused_exactly_where_it_is_not_convex():
    """With the weighted terminal error in it, the condensed Hessian has a negative eigenvalue."""
    verdicts, rho = set(), 30.0
    for seed in range(60):
        stages, error = random_stages(seed, shift=seed - 20.0)
        _, hessian, _, jacobian = dense(stages)
        smallest = np.linalg.eigvalsh(hessian + rho * jacobian.T @ jacobian)[0]
        solved = solve_stages(stages, np.empty((3, TERMS)), COUNT, error, rho, np.empty(3))
        assert solved == (smallest > 0.0)
        verdicts.add(bool(smallest > 0.0))
    assert verdicts == {True, False}
