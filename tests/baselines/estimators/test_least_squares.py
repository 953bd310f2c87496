"""Least squares and interacting models: closed forms, consistency, bounds, outliers, trends."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import chi2

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import HOLDING, REJECTED, columns_of, rows_of
from tracked_env.physics.jit import loop

# Nothing but recursive least squares with a prior: no forgetting.
PLAIN = ls.Prior(1.0, 2.0, 1.0, 0.5, -1e9, -1e9, 1e9, 1e9, forgetting=1.0)
SIGMA, MEAN = np.array(PLAIN[2:4]), np.array(PLAIN[:2])
TRUE = np.array([1.5, 2.4])  # parameters, where a test needs any
# As the vehicle's regressions use it: with interacting models.
LIVELY = PLAIN._replace(forgetting=0.9995)
WALKS = {
    im.CALM: (0.0, 0.01), im.FAST: (0.005, 0.3), im.BORDER: (0.0, 2.0), im.JUMP: (3.0, 0.01),
    im.ALARMED: (0.04, 0.1), im.SLOW: (0.0, 0.006),
}  # fmt: skip
TABLE = im.table(WALKS, 9.0, PLAIN.sigma_2, 0.02)


class Run(NamedTuple):
    """What was known after each of T samples of N vehicles."""

    value: NDArray[np.float64]  # (N, T, 2)
    covariance: NDArray[np.float64]  # (N, T, 2, 2)
    eigenvalues: NDArray[np.float64]  # (N, T, 2) smallest, largest, of the information
    status: NDArray[np.int64]  # (N, T)
    nis: NDArray[np.float64]  # (N, T)
    memory: NDArray[np.float64]  # (N, columns) at the end

    @property
    def rows(self):
        """The memory as rows (N,)."""
        return rows_of(self.memory, im.ROW)


@loop
def _run_all(samples, rows, prior, table, value, covariance, eigenvalues, status, nis):
    for i in range(samples.shape[0]):
        for k in range(samples.shape[1]):
            s = samples[i, k]
            sample = ls.Sample(s[0], s[1], s[2], s[3], s[4])
            status[i, k], nis[i, k] = im.take(rows[i], sample, prior, table)
            value[i, k, 0], value[i, k, 1] = ls.values(rows[i].estimates[0], prior)
            p_11, p_12, p_22 = ls.covariance(rows[i].estimates[0], prior)
            covariance[i, k, 0, 0], covariance[i, k, 1, 1] = p_11, p_22
            covariance[i, k, 0, 1] = covariance[i, k, 1, 0] = p_12
            smallest, largest = ls.excitations(rows[i].estimates[0])
            eigenvalues[i, k, 0], eigenvalues[i, k, 1] = smallest, largest


def run(samples, prior, memory=None, table=im.PLAIN):
    """Feed samples (N, T, 5), columns as in ls.Sample; memory: where to go on from."""
    samples = np.ascontiguousarray(samples, dtype=float)
    count, steps = samples.shape[:2]
    prior = ls.Prior(*(float(x) for x in prior))
    memory = np.zeros((count, columns_of(im.ROW))) if memory is None else memory.copy()
    value, eigenvalues = np.empty((count, steps, 2)), np.empty((count, steps, 2))
    covariance = np.empty((count, steps, 2, 2))
    status, nis = np.empty((count, steps), dtype=np.int64), np.empty((count, steps))
    _run_all(
        samples, rows_of(memory, im.ROW), prior, table, value, covariance, eigenvalues, status, nis
    )
    return Run(value, covariance, eigenvalues, status, nis, memory)


def interact(samples, prior=LIVELY, memory=None):
    """The same with interacting models."""
    return run(samples, prior, memory, TABLE)


def prior_draws(count, seed=7):
    """Parameters (count, 2) drawn from the prior of PLAIN."""
    return MEAN + SIGMA * np.random.default_rng(seed).standard_normal((count, 2))


def regression(theta, steps, seed=0, count=1, variance=0.04, noise_1=0.0, know_noise=True):
    """Samples (count, steps, 5) of y = phi . theta + e with white regressors, phi_1 of mean 3.

    theta: (2,), (count, 2) or (count, steps, 2). noise_1: variance of what is added to phi_1;
    know_noise: whether the sample says so.
    """
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal((count, steps, 2)) + np.array([3.0, -1.0])
    theta = np.asarray(theta, dtype=float)
    theta = theta[:, None, :] if theta.ndim == 2 else theta
    y = (phi * theta).sum(-1) + np.sqrt(variance) * rng.standard_normal((count, steps))
    seen = phi[..., 0] + np.sqrt(noise_1) * rng.standard_normal((count, steps))
    total = variance + noise_1 * np.broadcast_to(theta, phi.shape)[..., 0] ** 2
    known = np.full((count, steps), noise_1 if know_noise else 0.0)
    return np.stack([y, seen, phi[..., 1], total, known], axis=-1)


def exact(phi):
    """Samples (1, steps, 5) without noise of regressors (steps, 2)."""
    more = np.tile([0.04, 0.0], (len(phi), 1))  # variance of the sample, and of phi_1
    return np.concatenate([phi @ TRUE[:, None], phi, more], axis=1)[None]


def inside(result, theta, first):
    """Share of the samples from `first` on with parameter 1 within three sigma."""
    error = np.abs(result.value - theta)[:, first:, 0]
    return np.mean(error < 3.0 * np.sqrt(result.covariance[:, first:, 0, 0]))


def nees(result, theta, step=-1):
    """Normalised estimation error squared (N,) after a step."""
    error = result.value[:, step] - theta
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance[:, step]), error)


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


def test_errors_and_innovations_are_as_large_as_the_covariance_says():
    count = 1000
    theta = prior_draws(count)
    result = run(regression(theta, 100, count=count), PLAIN)
    assert within_chi_square(result.nis.sum(), count * 100)
    assert result.nis.mean() == pytest.approx(1.0, abs=0.02)
    for step in (0, 2, 10, 99):
        assert within_chi_square(nees(result, theta, step).sum(), 2 * count)
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
    assert shares.min() > 0.0 and shares.max() <= 1.0 + 1e-4  # rounding of an information of 1e12
    assert np.abs(result.value).max() <= 9.0  # and no NaN


BOTH = pytest.mark.parametrize("follow", [run, interact])


@BOTH
def test_alternating_huge_and_tiny_inputs_keep_the_covariance_definite(follow):
    rng = np.random.default_rng(4)
    phi = rng.standard_normal((20_000, 2)) * 10.0 ** rng.uniform(-12.0, 12.0, (20_000, 2))
    result = follow(exact(phi), LIVELY)
    shares = np.linalg.eigvalsh(result.covariance[0] / np.outer(SIGMA, SIGMA))
    assert shares.min() > 0.0 and shares.max() <= 1.0 + 1e-9


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
        assert (value >= low).all() and (value <= high).all()
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
    assert (result.value >= [0.0, 0.1]).all() and (result.value <= [1.1, 2.3]).all()
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
def test_samples_without_information_are_held_and_age_nothing_as_collinear_ones_are(follow):
    before = follow(regression(TRUE, 50), LIVELY)
    after = follow(np.array([[[0.1, 0.0, 0.0, 0.04, 0.0]] * 9]), LIVELY, before.memory)
    assert (after.status == HOLDING).all()
    assert np.array_equal(after.memory, before.memory)
    samples = np.array([[[7.0, 3.0, 1.0, 0.04, 0.0]] * 200])
    result = follow(samples, LIVELY)
    assert (result.status == HOLDING).all()
    assert result.eigenvalues[0, :, 0].max() < ls.EXCITED


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
    theta, p = MEAN.copy(), 1e6 * np.eye(2)
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
    for step in (20, 100, 299):
        # An innovation beyond five sigma is skipped once in two million: no effect here.
        assert within_chi_square(nees(result, theta[:, step], step).sum(), 2 * count)


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
    assert inside(result, theta, 510) > 0.97


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
    result = interact(exact(phi))
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
    assert inside(result, theta, 1200) > 0.9
    assert inside(without, theta, 1200) < 0.8


def test_without_a_trend_there_is_no_alarm_and_a_jump_is_none():
    theta = np.tile(TRUE, (100, 700, 1))
    theta[:, 500:, 0] *= 1.6
    result = interact(regression(theta, 700, count=100))
    assert (result.rows["alarm"] > 0.0).mean() < 0.15
    samples = regression(TRUE, 3000, count=100)
    memory, alarmed = None, []
    for first in range(0, 3000, 100):
        result = interact(samples[:, first : first + 100], memory=memory)
        memory = result.memory
        alarmed.append(result.rows["alarm"] > 0.0)
    assert np.mean(alarmed) < 0.05


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
