"""Least squares for two parameters: closed forms, consistency, and bounds whatever comes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import HOLDING, REJECTED
from tests.baselines.estimators.regression_cases import (
    LIVELY,
    PLAIN,
    SIGMA,
    TRUE,
    interact,
    nees,
    prior_draws,
    regression,
    run,
)

MEAN = np.array([PLAIN.mean_1, PLAIN.mean_2])


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


def test_with_forgetting_the_covariance_is_twice_that_of_the_errors():
    # Errors have the covariance P sum(lambda^2k) / sum(lambda^k) = P / (1 + lambda).
    count, factor = 2000, 0.98
    theta = prior_draws(count)
    result = run(regression(theta, 600, count=count), PLAIN._replace(forgetting=factor))
    assert nees(result, theta).mean() == pytest.approx(2.0 / (1.0 + factor), rel=0.1)


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
@pytest.mark.parametrize("follow", [run, interact])
def test_no_input_winds_the_covariance_up_or_makes_it_indefinite(phi, noise_1, follow):
    noise = np.random.default_rng(3).standard_normal((2, LONG))
    seen = phi[0] + np.sqrt(noise_1) * noise[0]
    y = seen * TRUE[0] + phi[1] * TRUE[1] + 0.2 * noise[1]
    samples = np.stack(
        [y, seen, np.full(LONG, phi[1]), np.full(LONG, 0.04), np.full(LONG, noise_1)], axis=-1
    )[None]
    result = follow(samples, LIVELY._replace(low_1=-9.0, low_2=-9.0, high_1=9.0, high_2=9.0))
    scaled = result.covariance[0] / np.outer(SIGMA, SIGMA)
    shares = np.linalg.eigvalsh(scaled)
    assert shares.min() > 0.0
    assert shares.max() <= 1.0 + 1e-4  # rounding of an information of 1e12
    assert np.isfinite(result.value).all()
    assert np.abs(result.value).max() <= 9.0


BOTH = pytest.mark.parametrize("follow", [run, interact])


@BOTH
def test_alternating_huge_and_tiny_inputs_keep_the_covariance_definite(follow):
    rng = np.random.default_rng(4)
    phi = rng.standard_normal((20_000, 2)) * 10.0 ** rng.uniform(-12.0, 12.0, (20_000, 2))
    samples = np.concatenate([phi @ TRUE[:, None], phi, np.full((20_000, 2), 0.04)], axis=1)
    samples[:, 4] = 0.0
    result = follow(samples[None], LIVELY)
    shares = np.linalg.eigvalsh(result.covariance[0] / np.outer(SIGMA, SIGMA))
    assert shares.min() > 0.0
    assert shares.max() <= 1.0 + 1e-9


def test_an_estimate_on_its_bound_does_not_pass_it_by_rounding():
    rng = np.random.default_rng(8)
    for _ in range(300):
        low, mean, high = np.sort(rng.uniform(0.0, 2.0, (3, 2)), axis=0)
        prior = PLAIN._replace(
            mean_1=mean[0], mean_2=mean[1], sigma_1=rng.uniform(0.1, 1.0), low_1=low[0],
            low_2=low[1], high_1=high[0], high_2=high[1], sigma_2=rng.uniform(0.1, 1.0),
        )  # fmt: skip
        y = rng.choice([-1e3, 1e3])
        value = run([[[y, 1.0, 0.0, 0.04, 0.0], [y, 0.0, 1.0, 0.04, 0.0]]], prior).value[0]
        assert (value >= low).all()
        assert (value <= high).all()
        assert value[1] == pytest.approx(low if y < 0.0 else high, rel=1e-12)


NUMBERS = st.one_of(
    st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1e-300, 1e300])
)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(NUMBERS, NUMBERS, NUMBERS, st.floats(0.0, 1e6), st.sampled_from([0.0, 1.0, 1e6])),
        min_size=1,
        max_size=40,
    ),
    st.sampled_from([run, interact]),
)
def test_the_estimate_is_inside_its_bounds_whatever_comes(samples, follow):
    prior = LIVELY._replace(mean_1=0.55, low_1=0.0, high_1=1.1, low_2=0.1, high_2=2.3)
    result = follow(np.array([samples]), prior)
    assert (result.value >= [0.0, 0.1]).all()
    assert (result.value <= [1.1, 2.3]).all()
    assert (np.linalg.eigvalsh(result.covariance[0] / np.outer(SIGMA, SIGMA)) > 0.0).all()


@BOTH
def test_a_sample_that_is_not_a_number_is_counted_and_changes_nothing_else(follow):
    samples = regression(TRUE, 51)
    samples[0, 50, 0] = np.nan
    before = follow(samples[:, :50], LIVELY)
    after = follow(samples[:, 50:], LIVELY, before.memory)
    assert after.status[0, 0] == REJECTED
    assert after.rows["skipped"][0] == 1.0
    after.rows["skipped"] = 0.0
    assert np.array_equal(after.memory, before.memory)


@BOTH
def test_a_sample_without_information_is_held_and_ages_nothing(follow):
    before = follow(regression(TRUE, 50), LIVELY)
    after = follow(np.array([[[0.1, 0.0, 0.0, 0.04, 0.0]] * 9]), LIVELY, before.memory)
    assert (after.status == HOLDING).all()
    assert np.array_equal(after.memory, before.memory)


@BOTH
def test_collinear_regressors_are_reported_as_holding(follow):
    samples = np.array([[[7.0, 3.0, 1.0, 0.04, 0.0]] * 200])
    result = follow(samples, LIVELY)
    assert (result.status == HOLDING).all()
    assert result.eigenvalues[0, :, 0].max() < ls.EXCITED
