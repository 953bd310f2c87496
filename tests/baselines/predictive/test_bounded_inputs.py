"""The Newton step: its limit without bounds, and the conditions of optimality with them."""

import itertools

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from baselines.predictive.stages import improve, make_work
from baselines.predictive.tracked_prediction import COLUMNS, EFFORT_LEFT, LEFT, ROWS, STATES, YAW
from baselines.riccati import bounded_minimum
from tests.baselines.predictive.predictive_cases import Problem, observed

DECAY = 0.6
MOVING = [0, 1, 4, 5, 6]  # states that `forward` has
WITH_ERRORS = {"position_error_x": 0.05, "position_error_y": 0.03, "heading_error": 0.02}


def linear_system(seed):
    """forward (COLUMNS, ROWS), and A (STATES, STATES), B (STATES, 2) that it means."""
    rng = np.random.default_rng(seed)
    forward = 0.3 * rng.standard_normal((COLUMNS, ROWS))
    for c in range(3):
        forward[c, 2 + c] += 0.8
    a, b = np.zeros((STATES, STATES)), np.zeros((STATES, 2))
    a[:2, :2] = np.eye(2)
    a[np.ix_(MOVING, [4, 5, 6, 2, 3])] = forward[[0, 1, 2, 5, 6]].T
    b[MOVING] = forward[[3, 4]].T
    for side in range(2):
        a[EFFORT_LEFT + side, EFFORT_LEFT + side] = DECAY
        b[EFFORT_LEFT + side, side] = 1.0 - DECAY
    return forward, a, b


def after_improving(forward, q, r, coupling, count, gradient=0.0, bounds=(np.inf, np.inf)):
    """Stages of the linear system, improved about no input."""
    work = make_work(count)
    work.stages.forward[:] = forward
    work.weight[:, :STATES], work.weight[:, LEFT:] = q, r + coupling
    work.gradient[:] = gradient
    improve(work, np.zeros((count, 2)), np.array(bounds), DECAY, coupling)
    return work.stages


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("coupling", [0.0, 0.5])
def test_over_a_long_horizon_it_is_the_regulator_of_the_algebraic_riccati_equation(seed, coupling):
    forward, a, b = linear_system(seed)
    q, r = np.array([1.0, 2.0, coupling, coupling, 3.0, 0.5, 0.2]), 0.7
    work = after_improving(forward, q, r, coupling, 600)
    cross = np.zeros((STATES, 2))
    cross[EFFORT_LEFT:YAW] = -coupling * np.eye(2)
    effort = (r + coupling) * np.eye(2)
    value = solve_discrete_are(a, b, np.diag(q), effort, s=cross)
    gains = -np.linalg.solve(effort + b.T @ value @ b, b.T @ value @ a + cross.T)
    np.testing.assert_allclose(work.value, value, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(work.gains[0], gains, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("side", [0, 1])
def test_an_input_at_its_bound_has_no_gain_and_the_other_one_is_the_regulator_by_itself(side):
    """Riccati recursion with the other column of B; the bound leaves no room, the gradient asks."""
    forward, a, b = linear_system(0)
    q, r, coupling, count = np.array([1.0, 2.0, 0.5, 0.5, 3.0, 0.5, 0.2]), 0.7, 0.5, 15
    gradient, bounds = np.zeros((count + 1, STATES + 2)), [1e6, 1e6]
    gradient[:, LEFT + side], bounds[side] = 30.0, 0.0
    work = after_improving(forward, q, r, coupling, count, gradient, bounds)
    other = 1 - side
    free, cross = b[:, [other]], np.zeros((STATES, 1))
    cross[EFFORT_LEFT + other] = -coupling
    value = np.diag(q)
    for _ in range(count):
        curve = r + coupling + free.T @ value @ free
        gains = -(free.T @ value @ a + cross.T) / curve
        value = np.diag(q) + a.T @ value @ a + (a.T @ value @ free + cross) @ gains
    np.testing.assert_allclose(work.gains[0, other], gains[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(work.value, value, rtol=1e-9, atol=1e-12)
    assert not work.gains[:, side].any()


@pytest.mark.parametrize("seed", range(3))
def test_without_bounds_one_step_is_the_minimum_of_a_linear_quadratic_problem(seed):
    forward, a, b = linear_system(seed)
    q, r, coupling, count = np.array([1.0, 2.0, 0.5, 0.5, 3.0, 0.5, 0.2]), 0.7, 0.5, 15
    gradient = np.random.default_rng(9).standard_normal((count + 1, STATES + 2))
    work = after_improving(forward, q, r, coupling, count, gradient)
    change, inputs = np.zeros(STATES), np.empty((count, 2))
    for k in range(count):
        inputs[k] = work.offsets[k, 0] + work.gains[k] @ change
        change = a @ change + b @ inputs[k]

    def cost(efforts):
        total, s = 0.0, np.zeros(STATES)
        for k, u in enumerate(efforts.reshape(-1, 2)):
            total += 0.5 * (q @ s**2 + (r + coupling) * u @ u) - coupling * s[EFFORT_LEFT:YAW] @ u
            total += gradient[k] @ np.concatenate([s, u])
            s = a @ s + b @ u
        return total + 0.5 * q @ s**2 + gradient[count, :STATES] @ s

    steps = 1e-2 * np.eye(inputs.size)  # exact differences of a quadratic function
    at = inputs.reshape(-1)
    slopes = np.array([cost(at + step) - cost(at - step) for step in steps]) / 2e-2
    assert np.abs(slopes).max() < 1e-9
    assert np.abs(inputs).max() > 0.1


def test_the_least_value_in_a_box_is_that_of_a_fine_search():
    rng = np.random.default_rng(1)
    for _ in range(50):
        root = rng.standard_normal((2, 2))
        h = root @ root.T + 0.1 * np.eye(2)
        g = 2.0 * rng.standard_normal(2)
        low, high = -rng.random(2), rng.random(2)
        d = np.array(bounded_minimum(h[0, 0], h[0, 1], h[1, 1], g[0], g[1], low, high)[:2])
        assert ((d >= low) & (d <= high)).all()
        cost = 0.5 * d @ h @ d + g @ d
        axes = [np.linspace(low[k], high[k], 41) for k in range(2)]
        for point in itertools.product(*axes):
            z = np.array(point)
            assert cost <= 0.5 * z @ h @ z + g @ z + 1e-12


@pytest.mark.parametrize(("limit", "change"), [(1.0, 0.01), (0.4, 0.01), (0.3, 200.0)])
def test_its_solution_meets_the_conditions_of_karush_kuhn_and_tucker(limit, change):
    weights = {"position": 55.0, "effort": 3.0, "effort_change": change}  # 1.0 binds no input
    problem = Problem(observed(**WITH_ERRORS), stages=12, limit=limit, **weights)
    for _ in range(60):
        problem.step()
    gradient, u = problem.gradient(problem.inputs), problem.inputs
    free = np.abs(u) < limit
    assert np.abs(gradient[free]).max() < 1e-4
    assert (gradient[u >= limit] <= 0.0).all()  # more would be better, less not
    assert (gradient[u <= -limit] >= 0.0).all()
    assert free.all() == (limit == 1.0)  # the others do meet their bounds


def test_sequential_quadratic_programming_of_scipy_finds_the_same_plan():
    problem = Problem(observed(**WITH_ERRORS), stages=6, limit=0.31, effort=3.0)
    for _ in range(60):
        problem.step()
    options = {"bounds": [(-0.31, 0.31)] * 12, "options": {"ftol": 1e-15, "maxiter": 500}}
    gradient = lambda u: problem.gradient(u.reshape(-1, 2)).reshape(-1)  # noqa: E731
    other = minimize(problem.cost, np.zeros(12), jac=gradient, method="SLSQP", **options)
    assert problem.cost(problem.inputs) == pytest.approx(other.fun, rel=1e-6)
    np.testing.assert_allclose(problem.inputs.reshape(-1), other.x, atol=2e-5)
    assert (np.abs(problem.inputs) == 0.31).any()
