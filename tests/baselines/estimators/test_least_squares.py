"""Least squares for two parameters: closed forms, consistency, bounds, changes, noisy regressors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from baselines.estimators import least_squares as ls
from tests.baselines.estimators.regression_cases import LIVELY, PLAIN, nees, regression, run

TRUE = np.array([1.5, 2.4])
CONVERGING, HOLDING, REJECTED = 0, 1, 2
SIGMA = np.array([PLAIN.sigma_1, PLAIN.sigma_2])
MEAN = np.array([PLAIN.mean_1, PLAIN.mean_2])


def prior_draws(count, seed=7):
    """Parameters (count, 2) drawn from the prior."""
    return MEAN + SIGMA * np.random.default_rng(seed).standard_normal((count, 2))


# --- closed forms ---------------------------------------------------------------------------


def test_without_forgetting_it_is_the_batch_weighted_least_squares_with_the_prior():
    samples = regression(TRUE, 200)
    samples[0, :, 3] *= np.random.default_rng(1).uniform(0.3, 3.0, 200)
    result = run(samples, PLAIN)
    y, phi, variance = samples[0, :, 0], samples[0, :, 1:3], samples[0, :, 3]
    for k in (1, 2, 5, 50, 200):
        weighted = phi[:k] / variance[:k, None]
        information = np.diag(SIGMA**-2) + weighted.T @ phi[:k]
        theta = np.linalg.solve(information, SIGMA**-2 * MEAN + weighted.T @ y[:k])
        assert result.value[0, k - 1] == pytest.approx(theta, rel=1e-11)
        assert result.covariance[0, k - 1] == pytest.approx(np.linalg.inv(information), rel=1e-9)


def test_with_a_negligible_prior_it_is_the_recursion_of_the_paper():
    wide, factor = 1e4, 0.998
    samples = regression(TRUE, 1500, variance=1.0)
    prior = PLAIN._replace(sigma_1=wide, sigma_2=wide, forgetting=factor)
    result = run(samples, prior)
    theta, p = MEAN.copy(), wide**2 * np.eye(2)
    for k in range(1500):
        y, phi = samples[0, k, 0], samples[0, k, 1:3]
        gain = p @ phi / (factor + phi @ p @ phi)
        theta = theta + gain * (y - phi @ theta)  # line 1 of S 7.1.1, from theta(k - 1)
        p = (p - np.outer(gain, phi @ p)) / factor
        if k >= 200:  # by then nothing is left of either's prior
            assert result.value[0, k] == pytest.approx(theta, rel=1e-9)
            assert result.covariance[0, k] == pytest.approx(p, rel=1e-8)


def test_a_walking_parameter_is_that_of_a_kalman_filter():
    q = 1e-3
    samples = regression(TRUE, 300)
    result = run(samples, PLAIN._replace(sigma_1=1e3, sigma_2=1e3, drift_2=q * 1e-6))
    theta, p = MEAN.copy(), 1e6 * np.eye(2)
    for k in range(300):
        y, phi = samples[0, k, 0], samples[0, k, 1:3]
        p = p + np.diag([0.0, q])
        gain = p @ phi / (samples[0, k, 3] + phi @ p @ phi)
        theta, p = theta + gain * (y - phi @ theta), p - np.outer(gain, phi @ p)
        if k >= 5:
            assert result.value[0, k] == pytest.approx(theta, rel=1e-6)
            assert result.covariance[0, k] == pytest.approx(p, rel=1e-5, abs=1e-12)


def test_the_excitation_is_the_smallest_eigenvalue_of_the_weighted_information():
    factor = 0.97
    samples = regression(TRUE, 200)
    result = run(samples, PLAIN._replace(forgetting=factor))
    information = np.zeros((2, 2))
    for k in range(200):
        phi = SIGMA * samples[0, k, 1:3]
        information = factor * information + np.outer(phi, phi) / samples[0, k, 3]
        expected = np.linalg.eigvalsh(information)
        assert result.eigenvalues[0, k] == pytest.approx(expected, rel=1e-7, abs=1e-9)


# --- consistency ----------------------------------------------------------------------------


def within_chi_square(total, freedom, probability=1e-4):
    """Whether a sum of squares is one that chi-square with that freedom gives."""
    low, high = chi2.ppf([probability / 2, 1.0 - probability / 2], freedom)
    return low < total < high


def test_errors_are_as_large_as_the_covariance_says():
    count = 1000
    theta = prior_draws(count)
    result = run(regression(theta, 100, count=count), PLAIN)
    for step in (0, 2, 10, 99):
        assert within_chi_square(nees(result, theta, step).sum(), 2 * count)


def test_innovations_are_as_large_as_predicted():
    count = 1000
    result = run(regression(prior_draws(count), 100, count=count), PLAIN)
    assert within_chi_square(result.nis.sum(), count * 100)
    assert result.nis.mean() == pytest.approx(1.0, abs=0.02)
    for step in (0, 10, 99):
        assert within_chi_square(result.nis[:, step].sum(), count)


def test_errors_of_a_walking_parameter_are_as_large_as_the_covariance_says():
    count, steps, drift = 1000, 300, 1e-4
    walk = np.random.default_rng(2).standard_normal((count, steps)) * np.sqrt(drift) * SIGMA[1]
    theta = np.repeat(prior_draws(count)[:, None], steps, axis=1)
    theta[..., 1] += np.cumsum(walk, axis=1)
    result = run(regression(theta, steps, count=count), PLAIN._replace(drift_2=drift))
    for step in (20, 100, 299):
        assert within_chi_square(nees(result, theta[:, step], step).sum(), 2 * count)


def test_with_forgetting_the_covariance_is_twice_that_of_the_errors():
    # Weights lambda^k give errors of covariance P sum(lambda^2k) / sum(lambda^k) = P / (1 + lambda).
    count, factor = 2000, 0.98
    theta = prior_draws(count)
    result = run(regression(theta, 600, count=count), PLAIN._replace(forgetting=factor))
    assert nees(result, theta).mean() == pytest.approx(2.0 / (1.0 + factor), rel=0.1)


# --- bounded, whatever comes ----------------------------------------------------------------

LONG = 100_000
INPUTS = {
    "constant": (3.0, -1.0),
    "zeros": (0.0, 0.0),
    "one of them": (0.0, 2.0),
    "large": (3e6, -1e6),
    "huge": (3e90, -1e90),
    "beyond numbers": (1e200, 1e200),
}


@pytest.mark.parametrize("phi", INPUTS.values(), ids=list(INPUTS))
@pytest.mark.parametrize("noise_1", [0.0, 0.01])
def test_no_input_winds_the_covariance_up_or_makes_it_indefinite(phi, noise_1):
    noise = np.random.default_rng(3).standard_normal((2, LONG))
    seen = phi[0] + np.sqrt(noise_1) * noise[0]
    y = seen * TRUE[0] + phi[1] * TRUE[1] + 0.2 * noise[1]
    samples = np.stack(
        [y, seen, np.full(LONG, phi[1]), np.full(LONG, 0.04), np.full(LONG, noise_1)], axis=-1
    )[None]
    result = run(samples, LIVELY._replace(low_1=-9.0, low_2=-9.0, high_1=9.0, high_2=9.0))
    scaled = result.covariance[0] / np.outer(SIGMA, SIGMA)
    shares = np.linalg.eigvalsh(scaled)
    assert shares.min() > 0.0
    assert shares.max() <= 1.0 + 1e-4  # rounding of an information of 1e12
    assert np.isfinite(result.value).all()
    assert np.abs(result.value).max() <= 9.0


def test_alternating_huge_and_tiny_inputs_keep_the_covariance_definite():
    rng = np.random.default_rng(4)
    phi = rng.standard_normal((20_000, 2)) * 10.0 ** rng.uniform(-12.0, 12.0, (20_000, 2))
    samples = np.concatenate([phi @ TRUE[:, None], phi, np.full((20_000, 2), 0.04)], axis=1)
    samples[:, 4] = 0.0
    result = run(samples[None], LIVELY)
    shares = np.linalg.eigvalsh(result.covariance[0] / np.outer(SIGMA, SIGMA))
    assert shares.min() > 0.0
    assert shares.max() <= 1.0 + 1e-9


NUMBERS = st.one_of(
    st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e-300, 1e300])
)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(
            NUMBERS, NUMBERS, NUMBERS, st.floats(0.0, 1e6), st.sampled_from([0.0, 1.0, 1e6])
        ),
        min_size=1,
        max_size=40,
    ),
    st.booleans(),
)
def test_the_estimate_is_inside_its_bounds_whatever_comes(samples, follows):
    prior = LIVELY._replace(
        mean_1=0.55, low_1=0.0, high_1=1.1, low_2=0.1, high_2=2.3, follows_changes=follows
    )
    result = run(np.array([samples]), prior)
    assert (result.value >= [0.0, 0.1]).all()
    assert (result.value <= [1.1, 2.3]).all()
    assert (np.linalg.eigvalsh(result.covariance[0] / np.outer(SIGMA, SIGMA)) > 0.0).all()


def test_a_sample_that_is_not_a_number_is_counted_and_changes_nothing_else():
    samples = regression(TRUE, 51)
    samples[0, 50, 0] = np.nan
    before = run(samples[:, :50], LIVELY)
    after = run(samples[:, 50:], LIVELY, before.memory)
    assert after.status[0, 0] == REJECTED
    expected = before.memory.copy()
    expected[0, ls.SKIPPED] += 1.0
    assert np.array_equal(after.memory, expected)


def test_a_sample_without_information_is_held_and_ages_nothing():
    before = run(regression(TRUE, 50), LIVELY)
    after = run(np.array([[[0.1, 0.0, 0.0, 0.04, 0.0]] * 9]), LIVELY, before.memory)
    assert (after.status == HOLDING).all()
    assert np.array_equal(after.memory, before.memory)


def test_collinear_regressors_are_reported_as_holding():
    samples = np.array([[[7.0, 3.0, 1.0, 0.04, 0.0]] * 200])
    result = run(samples, LIVELY)
    assert (result.status == HOLDING).all()
    assert result.eigenvalues[0, :, 0].max() < ls.EXCITED


# --- noisy regressor ------------------------------------------------------------------------


@pytest.mark.parametrize("known", [True, False])
def test_noise_of_the_regressor_biases_the_estimate_unless_it_is_known(known):
    # phi_1 varies by 1 about its mean; noise of 0.25 attenuates what only the variation tells.
    count, theta = 400, np.array([1.5, 0.0])
    samples = regression(theta, 2000, count=count, noise_1=0.25, know_noise=known)
    samples[..., 1] -= 3.0
    samples[..., 0] -= 3.0 * theta[0]
    value = run(samples, PLAIN).value[:, -1, 0]
    if known:
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
