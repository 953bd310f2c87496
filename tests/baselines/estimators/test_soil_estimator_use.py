"""Soil estimator in use: new soils, faulty data, and what it claims where soils change.

The traction is that of soil_drives, Janosi-Hanamoto in its printed form.
"""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from baselines.estimators.measurement import Status
from baselines.estimators.soil_estimator import EFFORT_RANGE, WINDOW, nominal_effort_maximum
from baselines.estimators.soil_regression import SOJOURN
from tests.baselines.estimators.soil_drives import (
    CLAY,
    FIRM,
    IDEAL,
    LOAM,
    PERIOD,
    RADIUS,
    RTK,
    SAND,
    WEAK,
    drive,
    effort,
    last,
    make,
    sample,
)
from tracked_env.physics.parameters import RANGES

STEEP = (4.4e3, 0.006)  # clayey soil
SANDY_LOAM = (11.7e3, 0.02)


@pytest.mark.parametrize("before", [FIRM, (12e3, 0.025)])
def test_a_new_soil_is_known_within_little_more_than_a_window(before):
    estimator = make(32)
    last(drive(estimator, before, (0.002, 0.02) if before == FIRM else (0.02, 0.4), 100))
    values = [e.value for e in drive(estimator, WEAK, (0.02, 0.6), 60, seed=1)]
    error = np.abs(np.log(np.array(values)[:, :, 0] / WEAK[0]))
    assert np.median(error[15]) < 0.05
    assert error[-1].max() < 0.05


def test_a_single_outlier_is_refused():
    estimator = make(8)
    estimate = last(drive(estimator, WEAK, (0.02, 0.6), 80))
    bad = sample(np.full((8, 2), 0.3), 1.5, 3.0 * WEAK[0], WEAK[1], np.random.default_rng(1))
    refused = estimator.update(bad)
    assert (refused.status == Status.REJECTED).all()
    assert np.array_equal(refused.value, estimate.value)
    assert (refused.nis > 25.0).all()


def test_missing_values_are_skipped_and_counted():
    estimator = make(2)
    rng = np.random.default_rng(1)
    for step in range(60):
        measurement = sample(rng.uniform(0.02, 0.6, (2, 2)), 1.5, *WEAK, rng)
        if step % 3 == 0:
            measurement.values[1, 12] = np.nan
        estimate = estimator.update(measurement)
    assert estimate.skipped.tolist() == [0, 20]
    assert np.isfinite(estimate.value).all()


def test_nothing_breaks_it_in_a_long_run_of_everything():
    count, rng = 8, np.random.default_rng(7)
    estimator = make(count)
    bounds = RANGES["shear_deformation_modulus"]
    for step in range(15_000):
        soil = (FIRM, WEAK, LOAM, SAND)[step // 700 % 4]
        scene = step // 150 % 6
        slip = np.sign(np.sin(step / 40.0)) * rng.uniform(0.0, 0.9, (count, 2))
        ground = (1.5, -1.0, 0.0, 2.0, 0.02, 0.5)[scene]
        if scene == 3:
            slip[:] = 0.2  # constant
        measurement = sample(slip, ground, *soil, rng)
        measurement.values[rng.random(measurement.values.shape) < 0.002] = np.nan
        spoilt = rng.random(measurement.values.shape) < 0.003
        measurement.values[spoilt] *= 30.0 * rng.standard_normal(spoilt.sum())
        measurement.fresh[:] = rng.random((count, 3)) < 0.9
        estimate = estimator.update(measurement)
        assert np.isfinite(estimate.value).all()
        assert np.isfinite(estimate.covariance).all()
        if step % 50 == 0:
            assert (estimate.value[:, 0] >= EFFORT_RANGE[0] * 0.999).all()
            assert (estimate.value[:, 0] <= EFFORT_RANGE[1] * 1.001).all()
            assert (estimate.value[:, 1] >= bounds.low * 0.999).all()
            assert (estimate.value[:, 1] <= bounds.high * 1.001).all()
            assert (
                np.linalg.eigvalsh(
                    estimate.covariance / estimate.value[:, :, None] / estimate.value[:, None, :]
                )
                > 0.0
            ).all()
            relative = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2)) / estimate.value
            gap = np.log(estimate.value / (nominal_effort_maximum(CLAY), 0.02))
            assert (np.log1p(relative) <= np.hypot((1.0, 0.7), gap) + 1e-9).all()  # another soil
    # And it still works.
    estimate = last(drive(estimator, WEAK, (0.02, 0.6), 120))
    assert estimate.value[:, 0] == pytest.approx(WEAK[0], rel=0.05)


@pytest.mark.parametrize(
    ("slip", "ground", "sign"),
    [(0.3, 0.01, 1), (0.0, 0.0, 1), (0.0, 1.5, 1), (0.3, 1.5, -1)],
    ids=["standing", "at rest", "rolling", "effort against the slip"],
)
def test_what_says_nothing_of_the_soil_leaves_the_window_empty(slip, ground, sign):
    estimator = make()
    measurement = sample([[slip, slip]], ground, *WEAK, np.random.default_rng(0), IDEAL)
    measurement.values[0, 7] = 0.0
    measurement.values[0, 9:11] = ground / (1.0 - slip) / RADIUS
    measurement.values[0, 11:] *= sign
    estimate = estimator.update(measurement)
    assert estimator.rows["filled"][0] == 0.0
    assert estimate.status[0] == Status.HOLDING
    assert np.isnan(estimate.nis[0])


def test_provided_slips_are_used_once_and_their_correlation_costs_information():
    rng = np.random.default_rng(4)
    spreads = []
    for steps in (1.0, 5.0):
        estimator = make(correlation_steps=steps)
        for slip in np.random.default_rng(5).uniform(0.02, 0.5, (60, 1, 2)):
            estimator.provide_slip(slip, np.full((1, 2), 1e-4))
            measurement = sample(slip, 1.5, *WEAK, rng)
            measurement.values[:, 3] = np.nan  # v_x is not needed
            estimate = estimator.update(measurement)
        spreads.append(estimate.deviation("shear_deformation_modulus")[0])
        assert estimate.skipped[0] == 0
        assert estimator.update(measurement).skipped[0] == 1  # now it is
    assert spreads[0] < spreads[1]
    with pytest.raises(ValueError, match="must be"):
        estimator.provide_slip(np.zeros(2), np.ones(2))


def score(estimate, soil):
    """(error over the claimed deviation, squared) of F_max and K, (N, 2)."""
    sigma = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    return np.square((estimate.value - soil) / sigma)


def pull(estimator, soil, force, rng):
    """One sample in which both tracks pull with `force` [N]: little slip on firm soil, noisy."""
    u = np.geomspace(1e-6, 1.0, 4000)
    slip = np.interp(force, effort(u, *soil), u)
    count = len(estimator.memory)
    true = np.full((count, 2), slip)
    estimator.provide_slip(
        true + 0.005 * rng.standard_normal((count, 2)), np.full((count, 2), 2.5e-5)
    )
    return estimator.update(sample(true, 1.5, *soil, rng))


@pytest.mark.parametrize("before", [STEEP, WEAK])
@pytest.mark.parametrize("after", [FIRM, SANDY_LOAM])
def test_a_second_after_weak_soil_has_become_firm_the_claim_covers_the_error(before, after):
    estimator, rng = make(32, window=WINDOW, correlation_steps=10.0), np.random.default_rng(3)
    last(drive(estimator, before, (0.05, 0.7), 100))
    squared = []
    for step in range(100):
        share = 0.5 + 0.4 * math.sin(0.3 * step)  # of what the soil before carries
        estimate = pull(estimator, after, share * before[0], rng)
        if step >= 50:
            squared.append(score(estimate, after))
    assert np.mean(np.array(squared) <= 9.0, axis=(0, 1)).min() >= 0.97
    assert np.mean(squared, axis=(0, 1)).max() <= 3.0


def test_without_samples_the_estimate_holds_and_the_claim_grows_to_that_of_any_soil():
    estimator, rng = make(4, sheet=IDEAL), np.random.default_rng(0)
    before = last(drive(estimator, WEAK, (0.02, 0.6), 100, sheet=IDEAL))
    odds = before.deviation("effort_maximum") / before.value[:, 0]
    variances = [np.log1p(odds) ** 2]
    blind = sample(np.full((4, 2), 0.1), 1.5, *WEAK, rng, IDEAL)
    for _ in range(int(20 * SOJOURN / PERIOD)):
        estimator.provide_slip(np.zeros((4, 2)), np.full((4, 2), np.inf))
        after = estimator.update(blind)
        variances.append(np.log1p(after.deviation("effort_maximum") / after.value[:, 0]) ** 2)
    assert np.array_equal(after.value, before.value)
    another = 1.0 + np.log(WEAK[0] / nominal_effort_maximum(CLAY)) ** 2
    time = PERIOD * np.arange(len(variances))[:, None]
    expected = another + (variances[0] - another) * np.exp(-time / SOJOURN)
    assert np.array(variances) == pytest.approx(expected, rel=1e-5)


def test_a_step_of_the_soil_seen_by_exact_slips_is_covered_within_the_window():
    estimator = make(8, sheet=IDEAL, window=WINDOW)
    last(drive(estimator, LOAM, (0.05, 0.7), 80, sheet=IDEAL))
    estimates = list(drive(estimator, WEAK, (0.05, 0.7), WINDOW + 10, seed=5, sheet=IDEAL))
    assert all((score(e, WEAK) <= 9.0).all() for e in estimates[WINDOW + 4 :])
    assert estimates[-1].value == pytest.approx(np.tile(WEAK, (8, 1)), rel=1e-3)


def test_soils_that_change_at_random_are_covered_as_a_chi_square_says():
    """Each vehicle changes its soil with the odds of the claim; the new one is drawn by the prior,
    as far as the vehicle still moves on it. A claim that allows for changes may be careful."""
    count, rng = 40, np.random.default_rng(11)
    estimator = make(count, window=WINDOW)
    nominal = np.log([nominal_effort_maximum(CLAY), CLAY.shear_deformation_modulus])

    def draw():
        log = nominal + np.clip(rng.standard_normal((count, 2)), -2.0, 1.0) * (1.0, 0.7)
        return np.exp(log)

    soil, squared, since = draw(), [], np.zeros(count)
    slip = np.full((count, 2), 0.05)
    for step in range(900):
        changes = rng.random(count) < PERIOD / SOJOURN
        soil = np.where(changes[:, None], draw(), soil)
        since = np.where(changes, 0.0, since + PERIOD)
        slip = np.clip(slip * np.exp(0.2 * rng.standard_normal((count, 2))), 0.01, 0.6)
        truth = soil[:, 0, None], soil[:, 1, None]
        measurement = sample(slip, 1.5, FIRM[0], FIRM[1], rng)
        measurement.values[:, 11:13] = RADIUS * effort(slip, *truth) + RTK.torque_noise * (
            rng.standard_normal((count, 2))
        )
        estimate = estimator.update(measurement)
        if step % 50 == 0 and step > 100:
            squared.append(np.where(since[:, None] > 1.0, score(estimate, soil), np.nan))
    values = np.array(squared).reshape(-1, 2)
    values = values[~np.isnan(values[:, 0])]
    upper = chi2.ppf(0.999, len(values)) / len(values)
    assert (values.mean(axis=0) <= upper).all()
    assert (np.mean(values <= 9.0, axis=0) >= 0.97).all()
    assert (values.mean(axis=0) > 1e-3).all()  # it is no empty claim
    assert math.isfinite(upper)
