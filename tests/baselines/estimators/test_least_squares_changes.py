"""Least squares for two parameters: noisy regressors, outliers, changes, memory."""

import numpy as np
import pytest

from baselines.estimators import least_squares as ls
from tests.baselines.estimators.regression_cases import LIVELY, PLAIN, prior_draws, regression, run

TRUE = np.array([1.5, 2.4])
HOLDING, REJECTED = 1, 2

# --- noisy regressor ------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False])
def test_noise_of_the_regressor_biases_the_estimate_unless_it_is_known(known):
    # phi_1 varies by 1 about its mean; noise of 0.25 attenuates what only the variation tells.
    count, theta = 400, np.array([1.5, 0.0])
    samples = regression(theta, 2000, count=count, noise_1=0.25, know_noise=known)
    samples[..., 1] -= 3.0
    samples[..., 0] -= 3.0 * theta[0]
    result = run(samples, PLAIN)
    value = result.value[:, -1, 0]
    if known:
        signal = 2000 / samples[0, 0, 3]  # what phi_1 without its noise tells
        assert result.memory[:, ls.J_11].mean() == pytest.approx(signal, rel=0.02)
        assert value.mean() == pytest.approx(theta[0], rel=0.006)
    else:
        assert value.mean() == pytest.approx(theta[0] / 1.25, rel=0.01)


def test_where_the_regressor_varies_by_its_noise_alone_parameter_1_is_kept():
    count, rng = 50, np.random.default_rng(5)
    before = run(regression(TRUE, 1000, count=count, noise_1=0.01), LIVELY)
    still = np.zeros((count, 20_000, 5))
    seen = 3.0 + 0.1 * rng.standard_normal((count, 20_000))
    still[..., 0] = 3.0 * TRUE[0] - 1.8 * TRUE[1] + 0.2 * rng.standard_normal((count, 20_000))
    still[..., 1], still[..., 2], still[..., 4] = seen, -1.8, 0.01
    still[..., 3] = 0.04 + 0.01 * TRUE[0] ** 2
    after = run(still, LIVELY, before.memory)
    drift = after.value[:, -1, 0] - before.value[:, -1, 0]
    deviation = np.sqrt(after.covariance[:, -1, 0, 0])
    assert np.abs(drift).max() < 3.0 * deviation.mean()
    assert (after.status[:, -1000:] == HOLDING).mean() > 0.99
    assert deviation == pytest.approx(np.sqrt(before.covariance[:, -1, 0, 0]), rel=0.3)
    assert after.value[:, -1, 1] == pytest.approx(TRUE[1], abs=0.15)  # parameter 2 still learns


def test_slow_variation_does_not_pass_for_knowledge_of_parameter_1():
    # Noise-free: all is explained by a wrong parameter 1 and a parameter 2 that walks.
    t = np.arange(1000)
    phi = np.stack([3.0 + 0.3 * np.sin(0.01 * t), np.full(1000, -1.0)], axis=-1)
    samples = np.concatenate([phi @ TRUE[:, None], phi, np.full((1000, 2), 0.04)], axis=1)
    samples[:, 4] = 0.0
    result = run(samples[None], LIVELY._replace(follows_changes=False))
    error = np.abs(result.value[0, :, 0] - TRUE[0])
    assert (error < 1.5 * np.sqrt(result.covariance[0, :, 0, 0])).all()


# --- outliers and changes -------------------------------------------------------------------


def test_single_outliers_leave_no_trace():
    samples = regression(TRUE, 1000)
    wild = np.zeros(1000, dtype=bool)
    wild[[60, 150, 151, 400, 777]] = True
    bad = samples.copy()
    bad[0, wild, 0] += np.where(np.arange(5) % 2, -60.0, 60.0)
    result = run(bad, LIVELY)
    assert (result.status[0, wild] == REJECTED).all()
    assert result.memory[0, ls.CHANGES] == 0
    clean = run(samples[:, ~wild], LIVELY)
    assert np.array_equal(result.value[0, ~wild], clean.value[0])


def changed(jump_1, jump_2, count=200, at=500, steps=1200):
    """Truth (count, steps, 2) and run of a regression whose parameters jump by these shares."""
    theta = np.tile(TRUE, (count, steps, 1))
    theta[:, at:] *= [1.0 + jump_1, 1.0 + jump_2]
    return theta, run(regression(theta, steps, count=count), LIVELY)


@pytest.mark.parametrize("jump", [-0.3, 0.3, 1.0])
def test_a_jump_of_parameter_1_is_found_and_put_down_to_parameter_1(jump):
    theta, result = changed(jump, 0.0)
    assert (result.memory[:, ls.JUMPS] == 1).mean() > 0.97
    error = np.abs(result.value / theta - 1.0)
    assert np.quantile(error[:, 600:, 0], 0.95) < 0.03
    assert np.quantile(error[:, 600:, 1], 0.95) < 0.08


@pytest.mark.parametrize("jump", [-0.5, 0.5])
def test_a_jump_of_parameter_2_is_found_and_put_down_to_parameter_2(jump):
    theta, result = changed(0.0, jump)
    assert (result.memory[:, ls.CHANGES] >= 1).mean() > 0.97
    assert (result.memory[:, ls.JUMPS] == 0).mean() > 0.97
    error = np.abs(result.value / theta - 1.0)
    assert np.quantile(error[:, 520:, 1], 0.95) < 0.15
    assert np.quantile(error[:, :, 0][:, 100:], 0.95) < 0.02


def test_without_a_change_none_is_found():
    result = run(regression(TRUE, 5000, count=200), LIVELY)
    assert result.memory[:, ls.CHANGES].mean() < 0.05


# --- memory ---------------------------------------------------------------------------------


def test_it_goes_on_from_a_copied_memory_as_if_nothing_had_happened():
    theta = np.tile(TRUE, (3, 400, 1))
    theta[:, 200:, 0] *= 1.5  # in the middle of a trial
    samples = regression(theta, 400, count=3, noise_1=0.01)
    whole = run(samples, LIVELY)
    first = run(samples[:, :210], LIVELY)
    second = run(samples[:, 210:], LIVELY, first.memory)
    assert np.array_equal(second.memory, whole.memory)
    assert np.array_equal(second.value, whole.value[:, 210:])


def test_a_row_of_a_batch_equals_the_same_vehicle_alone_bit_for_bit():
    samples = regression(prior_draws(7), 300, count=7, noise_1=0.01)
    batch = run(samples, LIVELY)
    for i in range(7):
        alone = run(samples[i : i + 1], LIVELY)
        assert np.array_equal(alone.memory[0], batch.memory[i])
        assert np.array_equal(alone.value[0], batch.value[i])
