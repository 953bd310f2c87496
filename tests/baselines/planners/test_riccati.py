"""The Riccati recursion solves the same problem as the dense system of its equations."""

import numpy as np
import pytest

from baselines.planners.interior_point import ALL, DURATION, YAW, P, Q, make_stages, solve_riccati
from tracked_env.physics.jit import loop

COUNT = 12
FREE = 1 + 2 * COUNT  # T and the inputs


@loop
def _stages(count):
    return make_stages(count)


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
        stages.gradient[k] = rng.standard_normal(ALL)
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
    zeros = np.zeros((3, 3))
    solution = np.linalg.solve(
        np.block([[hessian, jacobian.T], [jacobian, zeros]]), -np.append(gradient, error)
    )
    nu = np.empty(3)
    assert solve_riccati(stages, COUNT, error, rho, nu)
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
        assert solve_riccati(stages, COUNT, error, rho, np.empty(3)) == (smallest > 0.0)
        verdicts.add(bool(smallest > 0.0))
    assert verdicts == {True, False}
