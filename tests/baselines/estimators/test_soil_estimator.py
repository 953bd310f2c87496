"""Soil estimator: exact on exact data, consistent under noise, honest about what is observable."""

import math

import numpy as np
import pytest

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import Status
from tests.baselines.estimators.soil_drives import (
    FIRM,
    IDEAL,
    LENGTH,
    LOAM,
    SAND,
    WEAK,
    drive,
    effort,
    last,
    make,
    sample,
)


@pytest.mark.parametrize("soil", [LOAM, SAND, (6e3, 0.06), (47.6e3, 0.02)])
def test_exact_data_give_the_exact_soil(soil):
    estimator = make(sheet=IDEAL)
    estimate = last(drive(estimator, soil, (0.01, 0.8), 120, sheet=IDEAL))
    assert estimate.value[0] == pytest.approx(soil, rel=1e-6)
    assert estimate.status[0] == Status.CONVERGING
    assert estimator.limit_determined[0]


@pytest.mark.parametrize("ground", [-1.5, 1.5])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_reverse_and_braking_tell_the_same_soil(ground, sign):
    estimator = make(sheet=IDEAL)
    rng = np.random.default_rng(1)
    for _ in range(100):
        slip = sign * rng.uniform(0.02, 0.7, (1, 2))
        estimate = estimator.update(sample(slip, ground, *WEAK, rng, IDEAL))
    assert estimate.value[0] == pytest.approx(WEAK, rel=1e-6)


def model_of(**changes) -> sr.Model:
    return make()._model._replace(**changes)


@pytest.mark.parametrize("star", [1e-4, 0.003, 0.02, 0.3, 0.9, -0.02])
def test_the_jacobian_is_that_of_finite_differences(star):
    # Residual F_m - F(i*): with i* = i_m the slope drops out. S section 7.3.2.
    model, step = model_of(), 1e-6

    def error(log_f, log_k):
        shear_length = LENGTH * math.exp(-log_k)
        return sr.residual(star, 4e3, 1e-4, star, math.exp(log_f), shear_length, model)

    at = math.log(9e3), math.log(0.02)
    force, twist = error(*at)[:2]
    by_f = (error(at[0] + step, at[1])[2] - error(at[0] - step, at[1])[2]) / (2.0 * step)
    by_k = (error(at[0], at[1] + step)[2] - error(at[0], at[1] - step)[2]) / (2.0 * step)
    assert force == pytest.approx(effort(star, 9e3, 0.02), rel=1e-9)
    assert by_f == pytest.approx(-force, rel=1e-5)
    assert by_k == pytest.approx(twist, rel=1e-4, abs=1e-4)


def window_of(soil, slips, model, guess):
    """A window of exact samples, as fit takes it."""
    window = np.zeros((sr.BLOCKS, len(slips)))
    window[0], window[1], window[2] = slips, effort(slips, *soil), 1e-8
    for k in range(len(slips)):
        window[3, k] = sr.sample_slips(window[:3, k], window[:3, k], *guess, model)[0]
    return window, np.zeros((2 * sr.ROWS + 1, len(slips)))


STARTS = [(f, k) for f in (500.0, 5e3, 1e5, 9e5) for k in (2e-4, 0.02, 0.9)]
SLIPS = np.linspace(0.02, 0.8, 40)


def undamped(maximum, modulus, slips, efforts):
    """The iteration printed in S 7.3.2, on [F_max, K] without weights or damping."""
    for _ in range(60):
        u = slips * LENGTH / modulus
        by_f = 1.0 - (1.0 - np.exp(-u)) / u
        by_k = maximum / modulus * (np.exp(-u) - (1.0 - np.exp(-u)) / u)
        jacobian = np.stack([by_f, by_k], axis=1)
        if not np.isfinite(jacobian).all():
            return math.nan, math.nan
        step = np.linalg.lstsq(jacobian, maximum * by_f - efforts, rcond=None)[0]
        maximum, modulus = maximum - step[0], modulus - step[1]
    return maximum, modulus


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_printed_iteration_diverges_from_far_starts():
    fits = [undamped(*start, SLIPS, effort(SLIPS, *WEAK)) for start in STARTS]
    good = [np.allclose(values, WEAK, rtol=1e-3) for values in fits]
    assert 0.2 < np.mean(good) < 0.8


@pytest.mark.parametrize("start", STARTS)
def test_the_fit_converges_from_far_starts(start):
    model = model_of(information_f=1e-9, information_k=1e-9)
    guess = (math.log(start[0]), math.log(start[1]))
    window, scratch = window_of(WEAK, SLIPS, model, guess)
    log_f, log_k, _, iterations, converged = sr.fit(window, 40, scratch, guess, guess, model)
    assert converged
    assert iterations <= 20
    assert (math.exp(log_f), math.exp(log_k)) == pytest.approx(WEAK, rel=1e-3)


def test_a_fit_that_does_not_converge_keeps_the_last_converged_values():
    estimator = make(sheet=IDEAL)
    estimator._model = estimator._model._replace(largest_iterations=1)
    before = estimator.update(sample([[np.nan] * 2], 1.5, *WEAK, np.random.default_rng(0), IDEAL))
    values = []
    for estimate in drive(estimator, WEAK, (0.02, 0.6), 30, sheet=IDEAL):
        assert estimator.iterations[0] <= 1
        if not estimator.converged[0]:
            values.append(estimate.value[0].copy())
    assert values
    assert np.array_equal(values[0], before.value[0])


def test_iterations_stay_below_the_limit_and_are_few_on_the_average():
    estimator = make(16)
    counts = [estimator.iterations for _ in drive(estimator, WEAK, (0.02, 0.6), 200)]
    assert np.max(counts) <= 20
    assert 0.5 < np.mean(counts[60:]) < 4.0


def test_nothing_new_costs_no_iteration_and_changes_no_value():
    estimator = make()
    estimate = last(drive(estimator, WEAK, (0.02, 0.6), 80))
    rng = np.random.default_rng(0)
    stale = sample([[0.3, 0.3]], 1.5, *WEAK, rng)._replace(fresh=np.zeros((1, 3), dtype=bool))
    again = estimator.update(stale)
    assert estimator.iterations[0] == 0
    assert np.array_equal(again.value, estimate.value)
    assert (again.deviation("effort_maximum") > estimate.deviation("effort_maximum")).all()


def test_the_window_forgets_what_is_older_than_itself():
    long, short = make(window=10), make(window=10)
    last(drive(long, (6e3, 0.03), (0.02, 0.6), 60, seed=3, sheet=IDEAL))
    for estimator in (long, short):
        last(drive(estimator, (6e3, 0.03), (0.02, 0.6), 40, seed=4, sheet=IDEAL))
    for block in range(3):
        rows = [e.ring[0, 20 * block : 20 * (block + 1)] for e in (long, short)]
        assert np.array_equal(np.sort(rows[0]), np.sort(rows[1]))


def test_small_slip_tells_the_stiffness_and_holds_the_rest():
    count = 64
    estimator = make(count)
    rng = np.random.default_rng(2)
    stiffness = 0.5 * LENGTH * 30e3 / 0.03
    for _ in range(100):
        slip = rng.uniform(0.001, 0.004, (count, 2))
        estimator.provide_slip(
            slip + 3e-4 * rng.standard_normal((count, 2)), np.full((count, 2), 9e-8)
        )
        estimate = estimator.update(sample(slip, 1.5, 30e3, 0.03, rng))
    assert (estimate.status == Status.HOLDING).all()
    assert estimator.ratio_only.all()
    assert not estimator.limit_determined.any()
    deviation = estimator.stiffness * np.sqrt(estimator._variance(-1.0, estimator._model))
    z = (estimator.stiffness - stiffness) / deviation
    assert np.mean(np.abs(z)) < 1.2
    assert np.median(np.abs(estimator.stiffness / stiffness - 1.0)) < 0.05
    # The other direction stays near the nominal soil; 1.2 is a standard deviation of the prior.
    nominal = 47.64e3 * 0.02
    assert np.abs(np.log(estimate.value[:, 0] * estimate.value[:, 1] / nominal)).max() < 2.0
    assert (estimate.condition > 100.0).all()


def test_high_slip_tells_the_limit_but_not_the_modulus():
    estimator = make(16)
    estimate = last(drive(estimator, SAND, (0.7, 0.95), 100))
    assert estimator.limit_determined.all()
    limit = effort(1.0, *estimate.value.T)
    assert limit == pytest.approx(effort(1.0, *SAND), rel=0.02)
    assert not estimator.ratio_only.any()
    assert (estimate.deviation("effort_maximum") < 0.02 * SAND[0]).all()
    assert (estimate.deviation("shear_deformation_modulus") > 0.1 * SAND[1]).all()


def test_errors_are_those_of_the_covariance_where_the_soil_is_observable():
    # Left and right share the error of v_x, hence a mean below 2 is right: chi-square bounds of
    # 200 independent vehicles above, and not ten times too careful below.
    count = 200
    estimator = make(count)
    estimate = last(drive(estimator, WEAK, (0.02, 0.6), 100))
    error = estimate.value - WEAK
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(estimator.fitted), error)
    assert 1.0 < nees.mean() < 2.0 + 3.0 * math.sqrt(4.0 / count)
    assert np.mean(estimate.status == Status.CONVERGING) > 0.95


def test_slip_noise_does_not_bias_the_stiffness():
    stiffness = 0.5 * LENGTH * WEAK[0] / WEAK[1]
    estimator = make(64)
    shares = [
        estimator.stiffness / stiffness
        for _ in drive(estimator, WEAK, (0.02, 0.6), 200, ground=1.0)
    ]
    assert np.median(shares[60:]) == pytest.approx(1.0, abs=0.03)


def test_the_estimate_does_not_drift_while_nothing_is_observable():
    estimator = make(4)
    values = np.array([e.value for e in drive(estimator, FIRM, (0.002, 0.01), 20_000)])
    medians = np.median(values[-2000:], axis=0) / FIRM
    assert (medians > 0.4).all()
    assert (medians < 2.5).all()
