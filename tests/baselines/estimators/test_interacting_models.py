"""Interacting models: walks, outliers, jumps, slow trends, memory; and noise of a regressor."""

import numpy as np
import pytest
from scipy.stats import chi2

from baselines.estimators import interacting_models as im
from baselines.estimators.measurement import HOLDING, REJECTED
from tests.baselines.estimators.regression_cases import (
    LIVELY,
    PLAIN,
    SIGMA,
    TABLE,
    TRUE,
    WALKS,
    interact,
    nees,
    prior_draws,
    regression,
    run,
)


def same_walk(variance):
    """A table whose models all expect this walk of parameter 2, in units of sigma_2^2."""
    table = TABLE.copy()
    table[:, im.WALK_1], table[:, im.WALK_2] = 0.0, variance
    table[im.SLOW, im.GATE] = np.inf
    return table


def test_models_that_expect_the_same_are_one_kalman_filter():
    q = 1e-3
    samples = regression(TRUE, 300)
    result = run(samples, PLAIN._replace(sigma_1=1e3, sigma_2=1e3), table=same_walk(q * 1e-6))
    theta, p = np.array([PLAIN.mean_1, PLAIN.mean_2]), 1e6 * np.eye(2)
    for k in range(300):
        y, phi = samples[0, k, 0], samples[0, k, 1:3]
        p = p + np.diag([0.0, q])
        gain = p @ phi / (samples[0, k, 3] + phi @ p @ phi)
        theta, p = theta + gain * (y - phi @ theta), p - np.outer(gain, phi @ p)
        if k >= 5:
            assert result.value[0, k] == pytest.approx(theta, rel=1e-5)
            assert result.covariance[0, k] == pytest.approx(p, rel=1e-4, abs=1e-11)


def test_errors_of_a_walking_parameter_are_as_large_as_the_covariance_says():
    count, steps, drift = 1000, 300, 1e-4
    walk = np.random.default_rng(2).standard_normal((count, steps)) * np.sqrt(drift) * SIGMA[1]
    theta = np.repeat(prior_draws(count)[:, None], steps, axis=1)
    theta[..., 1] += np.cumsum(walk, axis=1)
    result = run(regression(theta, steps, count=count), PLAIN, table=same_walk(drift))
    low, high = chi2.ppf([5e-5, 1.0 - 5e-5], 2 * count)
    for step in (20, 100, 299):
        # An innovation beyond five sigma is skipped once in two million: no effect here.
        assert low < nees(result, theta[:, step], step).sum() < high


def test_odds_are_shares_and_an_exchange_leaves_what_all_models_agree_on():
    result = interact(regression(TRUE, 400, count=20))
    odds = result.rows["odds"]
    assert odds.sum(axis=1) == pytest.approx(np.ones(20), rel=1e-12)
    assert (odds > 0.0).all()
    assert (odds[:, im.CALM] > 0.9).mean() > 0.9


def test_doubt_between_the_models_is_part_of_what_is_claimed():
    # In the first samples after a jump models differ: the claim covers their differences.
    theta = np.tile(TRUE, (100, 520, 1))
    theta[:, 500:, 0] *= 1.5
    result = interact(regression(theta, 520, count=100))
    before = np.sqrt(result.covariance[:, 499, 0, 0])
    assert (np.sqrt(result.covariance[:, 502, 0, 0]) > 3.0 * before).mean() > 0.9
    error = np.abs(result.value[:, 510:, 0] - theta[:, 510:, 0])
    assert (error < 3.0 * np.sqrt(result.covariance[:, 510:, 0, 0])).mean() > 0.97


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
        assert result.rows["estimates"]["j_11"][:, 0].mean() == pytest.approx(signal, rel=0.02)
        assert value.mean() == pytest.approx(theta[0], rel=0.006)
    else:
        assert value.mean() == pytest.approx(theta[0] / 1.25, rel=0.01)


def test_where_the_regressor_varies_by_its_noise_alone_parameter_1_is_kept():
    count, rng = 50, np.random.default_rng(5)
    before = interact(regression(TRUE, 1000, count=count, noise_1=0.01))
    still = np.zeros((count, 20_000, 5))
    shares = 3.0 + 0.1 * rng.standard_normal((count, 20_000))
    still[..., 0] = 3.0 * TRUE[0] - 1.8 * TRUE[1] + 0.2 * rng.standard_normal((count, 20_000))
    still[..., 1], still[..., 2], still[..., 4] = shares, -1.8, 0.01
    still[..., 3] = 0.04 + 0.01 * TRUE[0] ** 2
    after = interact(still, memory=before.memory)
    drift = after.value[:, -1, 0] - before.value[:, -1, 0]
    deviation = np.sqrt(after.covariance[:, -1, 0, 0])
    assert np.abs(drift).max() < 3.0 * deviation.mean()
    assert (after.status[:, -1000:] == HOLDING).mean() > 0.99
    # Nothing forgotten, but a jump of it could not have been seen for 400 s: the claim widens.
    assert (deviation > np.sqrt(before.covariance[:, -1, 0, 0])).all()
    assert np.median(deviation) < 0.2 * TRUE[0]
    assert after.value[:, -1, 1] == pytest.approx(TRUE[1], abs=0.15)  # parameter 2 still learns


def test_slow_variation_does_not_pass_for_knowledge_of_parameter_1():
    # Noise-free: all is explained by a wrong parameter 1 and a parameter 2 that walks.
    t = np.arange(1000)
    phi = np.stack([3.0 + 0.3 * np.sin(0.01 * t), np.full(1000, -1.0)], axis=-1)
    samples = np.concatenate([phi @ TRUE[:, None], phi, np.full((1000, 2), 0.04)], axis=1)
    samples[:, 4] = 0.0
    result = interact(samples[None])
    error = np.abs(result.value[0, :, 0] - TRUE[0])
    assert (error < 1.5 * np.sqrt(result.covariance[0, :, 0, 0])).all()


def test_single_outliers_leave_no_trace():
    samples = regression(TRUE, 1000)
    wild = np.zeros(1000, dtype=bool)
    wild[[60, 150, 152, 400, 777]] = True
    bad = samples.copy()
    bad[0, wild, 0] += np.where(np.arange(5) % 2, -60.0, 60.0)
    result = interact(bad)
    assert (result.status[0, wild] == REJECTED).all()
    clean = interact(samples[:, ~wild])
    assert np.array_equal(result.value[0, ~wild], clean.value[0])
    assert np.array_equal(result.memory, clean.memory)


def test_the_third_outlier_in_a_row_counts_whatever_they_say():
    samples = regression(TRUE, 104)
    samples[0, 100:, 0] += [60.0, -60.0, 60.0, -60.0]
    result = interact(samples)
    assert (result.status[0, 100:102] == REJECTED).all()
    assert np.array_equal(result.value[0, 101], result.value[0, 99])
    assert result.status[0, 102] != REJECTED
    assert not np.array_equal(result.value[0, 102], result.value[0, 101])


def test_two_outliers_in_a_row_that_agree_are_a_change():
    samples = regression(TRUE, 102)
    samples[0, 100:, 1:3] = [3.0, -1.0]  # as in the vehicle, where regressors hardly change
    for factor in (1.3, 2.0):
        theta = TRUE * [factor, 1.0]
        samples[0, 100:, 0] = samples[0, 100:, 1:3] @ theta
        result = interact(samples)
        assert result.status[0, 100] == REJECTED
        assert np.array_equal(result.value[0, 100], result.value[0, 99])
        # and the second is enough: most of the step, put down to parameter 1
        assert result.value[0, 101, 0] - TRUE[0] > 0.8 * (theta[0] - TRUE[0])
        assert result.rows["odds"][0, im.JUMP] > 0.5


@pytest.mark.parametrize("share", [0.005, 0.02])
def test_many_outliers_do_not_spoil_the_estimate(share):
    samples = regression(TRUE, 3000, count=50)
    wild = np.random.default_rng(9).random((50, 3000)) < share
    samples[wild, 0] += 60.0
    result = interact(samples)
    error = np.abs(result.value[:, -1] / TRUE - 1.0)
    assert np.quantile(error, 0.95) < 0.06


@pytest.mark.parametrize(
    ("jumps", "second", "bounds"),
    [
        *(((j, 0.0), 600, (0.03, 0.08)) for j in (-0.3, 0.3, 1.0)),
        *(((0.0, j), 540, (0.03, 0.15)) for j in (-0.5, 0.5)),
    ],
)
def test_a_jump_is_found_and_put_down_to_the_parameter_that_jumps(jumps, second, bounds):
    count, at, steps = 200, 500, 1200
    theta = np.tile(TRUE, (count, steps, 1))
    theta[:, at:] *= 1.0 + np.array(jumps)
    error = np.abs(interact(regression(theta, steps, count=count)).value / theta - 1.0)
    assert np.quantile(error[:, 600:, 0], 0.95) < bounds[0]
    assert np.quantile(error[:, second:, 1], 0.95) < bounds[1]


def test_the_jump_of_a_load_is_seen_as_one_and_a_border_of_the_soil_is_not():
    theta = np.tile(TRUE, (100, 520, 1))
    theta[:, 500:, 0] *= 1.6
    border = np.tile(TRUE, (100, 520, 1))
    border[:, 500:, 1] *= 1.0 - 0.4 * np.minimum(np.arange(1, 21) / 10.0, 1.0)  # within 0.2 s
    shares = []
    for truth in (theta, border):
        samples = regression(truth, 520, count=100)
        result, jumped = interact(samples[:, :500]), np.zeros(100, dtype=bool)
        for k in range(500, 520):
            result = interact(samples[:, k : k + 1], memory=result.memory)
            jumped |= result.rows["odds"][:, im.JUMP] > im.JUMPED
        shares.append(jumped.mean())
    assert shares[0] > 0.9
    assert shares[1] < 0.1


def test_a_slow_trend_of_both_is_noticed_and_what_is_claimed_holds():
    steps = 2500  # from step 800 on both parameters change by 3 % a second (50 Hz)
    gone = np.maximum(np.arange(steps) - 800, 0) * 0.02
    theta = np.tile(TRUE, (60, steps, 1)) * (1.0 + 0.03 * gone)[None, :, None]
    samples = regression(theta, steps, count=60, variance=1.0)
    result = interact(samples)
    deaf = TABLE.copy()
    deaf[im.SLOW, im.GATE] = np.inf
    without = run(samples, LIVELY, table=deaf)
    inside = [
        np.mean(
            np.abs(one.value - theta)[:, 1200:, 0] < 3.0 * np.sqrt(one.covariance[:, 1200:, 0, 0])
        )
        for one in (result, without)
    ]
    assert inside[0] > 0.9
    assert inside[1] < 0.8


def test_without_a_trend_there_is_no_alarm():
    samples = regression(TRUE, 3000, count=100)
    memory, alarmed = None, []
    for first in range(0, 3000, 100):
        result = interact(samples[:, first : first + 100], memory=memory)
        memory = result.memory
        alarmed.append(result.rows["alarm"] > 0.0)
    assert np.mean(alarmed) < 0.05


def test_a_jump_is_no_trend():
    theta = np.tile(TRUE, (100, 700, 1))
    theta[:, 500:, 0] *= 1.6
    result = interact(regression(theta, 700, count=100))
    assert (result.rows["alarm"] > 0.0).mean() < 0.15


def test_an_alarm_ends_by_itself_and_counts_time_not_samples():
    for period in (0.02, 0.05):
        table = im.table(WALKS, 9.0, PLAIN.sigma_2, period)
        before = interact(regression(TRUE, 200))
        before.rows["alarm"], memory = im.ALARM_TIME, before.memory
        steps = round(im.ALARM_TIME / period)
        samples = regression(TRUE, steps + 1)
        almost = run(samples[:, : steps - 1], LIVELY, memory, table)
        assert almost.rows["alarm"][0] > 0.0
        assert run(samples, LIVELY, memory, table).rows["alarm"][0] == 0.0
