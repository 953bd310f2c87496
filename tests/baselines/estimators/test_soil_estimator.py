"""Soil estimator: exact on exact data, consistent under noise, honest about what is observable and
where soils change. The traction is Janosi-Hanamoto in its printed form."""

import math
from collections import deque

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import chi2

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import DataSheet, Status, make_measurement
from baselines.estimators.soil_estimator import (
    EFFORT_RANGE,
    WINDOW,
    SoilEstimator,
    nominal_effort_maximum,
)
from baselines.estimators.soil_regression import SOJOURN
from tracked_env.physics.parameters import RANGES, plant_parameters

CLAY = plant_parameters()
RTK = DataSheet()
IDEAL = DataSheet(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
LENGTH, RADIUS, HALF = CLAY.contact_length, CLAY.sprocket_radius, 0.5 * CLAY.track_gauge
PERIOD = 0.02
LOAM, SAND, WEAK, FIRM = (9e3, 0.025), (5e3, 0.01), (5e3, 0.02), (43e3, 0.02)


def effort(slip, maximum, modulus):
    """S (7) in its printed form."""
    u = np.abs(slip) * LENGTH / modulus
    return np.sign(slip) * maximum * (1.0 + np.expm1(-u) / np.maximum(u, 1e-300))


def sample(slip, ground, maximum, modulus, rng, sheet=RTK):
    """Measurement of tracks with slip ratio (N, 2) [-] over the ground at v_x = `ground` [m/s]."""
    slip = np.asarray(slip, dtype=float)
    turn = 0.1
    track = ground + turn * HALF * np.array([-1.0, 1.0])
    driven = slip * track >= 0.0
    belt = np.where(driven, track / (1.0 - np.abs(slip)), track * (1.0 - np.abs(slip)))
    torque = RADIUS * effort(slip, maximum, modulus)
    noise = rng.standard_normal((6, len(slip)))
    return make_measurement(
        v_x=ground + sheet.velocity_noise * noise[0],
        yaw_rate=turn + sheet.gyro_noise * noise[1],
        sprocket_speed_left=belt[:, 0] / RADIUS + sheet.sprocket_speed_noise * noise[2],
        sprocket_speed_right=belt[:, 1] / RADIUS + sheet.sprocket_speed_noise * noise[3],
        torque_left=torque[:, 0] + sheet.torque_noise * noise[4],
        torque_right=torque[:, 1] + sheet.torque_noise * noise[5],
    )


def drive(estimator, soil, slips, steps, seed=0, ground=1.5, sheet=RTK):
    """Drive with slips that wander within `slips`; yields the estimate of every step."""
    rng = np.random.default_rng(seed)
    count = len(estimator.memory)
    walk = rng.standard_normal((count, 2))
    low, high = slips
    for _ in range(steps):
        slip = low * (high / low) ** ndtr(walk)
        walk = 0.95 * walk + math.sqrt(1.0 - 0.95**2) * rng.standard_normal((count, 2))
        yield estimator.update(sample(slip, ground, *soil, rng, sheet))


def last(estimates):
    """The last of an iterator."""
    return deque(estimates, maxlen=1)[0]


def make(count=1, sheet=RTK, window=50, correlation_steps=1.0):
    options = {"window": window, "correlation_steps": correlation_steps}
    return SoilEstimator(CLAY, PERIOD, sheet, count, **options)


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


def model_of(**changes):
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


@pytest.mark.slow
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
