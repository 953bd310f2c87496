"""Interquartile mean and bootstrap against closed forms and published values."""

import numpy as np
import pytest
from scipy.stats import kendalltau, trim_mean

from tracked_env.benchmark import statistics as stats

# Efron and Tibshirani (1993), Table 2.1: survival of treated mice [days]; Table 2.2 gives the
# bootstrap standard errors of mean and median in the limit of many resamples.
MICE = [94.0, 197.0, 16.0, 38.0, 99.0, 141.0, 23.0]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 9, 32, 101])
def test_the_interquartile_mean_is_the_mean_trimmed_by_a_quarter_at_each_end(count: int) -> None:
    values = np.random.default_rng(count).standard_cauchy(count)
    assert stats.interquartile_mean(values) == pytest.approx(trim_mean(values, 0.25), rel=1e-12)


def test_the_interquartile_mean_of_a_worked_example_is_six_and_a_half() -> None:
    assert stats.interquartile_mean([5, 8, 4, 38, 8, 6, 9, 7, 7, 3, 1, 6]) == 6.5


def test_one_wild_episode_does_not_move_the_interquartile_mean() -> None:
    values = np.linspace(0.1, 0.2, 16)
    wild = values.copy()
    wild[-1] = 1e6
    assert stats.interquartile_mean(wild) == stats.interquartile_mean(values)


def test_statistics_work_on_the_last_axis_of_any_array() -> None:
    values = np.random.default_rng(0).normal(size=(3, 4, 10))
    assert stats.interquartile_mean(values).shape == (3, 4)
    assert stats.interquartile_mean(values)[1, 2] == stats.interquartile_mean(values[1, 2])


@pytest.mark.parametrize(
    ("statistic", "published"), [(stats.mean, 23.36), (lambda v: np.median(v, axis=-1), 37.83)]
)
def test_bootstrap_standard_errors_of_the_mouse_data_are_those_published(
    statistic: stats.Statistic, published: float
) -> None:
    distribution = stats.bootstrap([MICE], statistic, resamples=100_000)
    assert distribution.std() == pytest.approx(published, rel=0.01)


def test_the_bootstrap_interval_of_a_mean_tends_to_the_normal_one() -> None:
    values = np.random.default_rng(1).normal(2.0, 3.0, 400)
    value, low, high = stats.estimate([values], stats.mean)
    half = 1.96 * values.std() / np.sqrt(400)
    assert value == pytest.approx(values.mean())
    assert (low, high) == pytest.approx((value - half, value + half), abs=0.06 * half)


@pytest.mark.parametrize("statistic", [stats.mean, stats.interquartile_mean])
def test_about_95_percent_of_the_intervals_cover_the_true_value(
    statistic: stats.Statistic,
) -> None:
    rng = np.random.default_rng(2)
    covered = []
    for seed in range(400):
        values = rng.normal(1.0, 0.5, 32)
        low, high = stats.interval(stats.bootstrap([values], statistic, 500, seed))
        covered.append(low <= 1.0 <= high)
    assert 0.90 <= np.mean(covered) <= 0.97  # 0.92 .. 0.95 expected of a percentile interval


def test_strata_are_redrawn_within_themselves() -> None:
    strata = [np.zeros(10), np.ones(30)]
    distribution = stats.bootstrap(strata, stats.mean, resamples=200)
    assert np.all(distribution == 0.75)  # no resample mixes them
    assert stats.bootstrap([np.concatenate(strata)], stats.mean, resamples=200).std() > 0.05


def test_the_same_values_give_the_same_interval() -> None:
    values = np.random.default_rng(4).normal(size=20)
    assert stats.estimate([values]) == stats.estimate([values])


def test_an_empty_stratum_is_refused() -> None:
    with pytest.raises(ValueError, match="no values"):
        stats.bootstrap([np.ones(3), np.ones(0)], stats.mean)


def test_kendalls_tau_is_that_of_scipy_with_and_without_ties() -> None:
    rng = np.random.default_rng(4)
    for largest in (3, 1000):
        for _ in range(20):
            first, second = rng.integers(largest, size=(2, 9))
            expected = kendalltau(first, second).statistic
            assert stats.kendalls_tau(first, second) == pytest.approx(expected, nan_ok=True)
    assert stats.kendalls_tau([1, 2, 3], [10, 20, 30]) == 1.0
    assert stats.kendalls_tau([1, 2, 3], [3, 2, 1]) == -1.0
    assert np.isnan(stats.kendalls_tau([1.0], [1.0]))
