"""Soil estimator in use: new soils, faulty data, batches, memory and bad input."""

import numpy as np
import pytest

from baselines.estimators.measurement import Measurement, Status, make_measurement
from baselines.estimators.soil_estimator import EFFORT_RANGE, SoilEstimator, nominal_effort_maximum
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
    last,
    make,
    sample,
)
from tests.baselines.estimators.state_columns import go_on, state
from tracked_env.physics.parameters import RANGES

# --- changes and faults ---------------------------------------------------------------------


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


@pytest.mark.parametrize(("slip", "ground"), [(0.3, 0.01), (0.0, 0.0), (0.0, 1.5)])
def test_standstill_and_rolling_without_effort_leave_the_window_empty(slip, ground):
    estimator = make()
    rng = np.random.default_rng(0)
    measurement = sample([[slip, slip]], ground, *WEAK, rng, IDEAL)
    measurement.values[0, 7] = 0.0
    measurement.values[0, 9:11] = ground / (1.0 - slip) / RADIUS
    estimate = estimator.update(measurement)
    assert estimator.rows["filled"][0] == 0.0
    assert estimate.status[0] == Status.HOLDING
    assert np.isnan(estimate.nis[0])


def test_an_effort_against_the_slip_is_not_used():
    estimator = make()
    measurement = sample([[0.3, 0.3]], 1.5, *WEAK, np.random.default_rng(0))
    measurement.values[0, 11:] *= -1.0
    estimator.update(measurement)
    assert estimator.rows["filled"][0] == 0.0


# --- interface ------------------------------------------------------------------------------


def test_a_vehicle_in_a_batch_equals_the_same_vehicle_alone():
    batch, alone = make(5), make(1)
    rng = np.random.default_rng(3)
    for _ in range(120):
        measurement = sample(rng.uniform(0.01, 0.7, (5, 2)), 1.5, *WEAK, rng)
        many = batch.update(measurement)
        one = alone.update(Measurement(*(array[3:4] for array in measurement)))
    for ours, theirs in zip(many[1:], one[1:], strict=True):
        assert np.array_equal(ours[3:4], theirs, equal_nan=True)
    assert np.array_equal(state(batch)[3:4], state(alone))


def test_a_copy_of_the_memory_resumes_exactly():
    first, second = make(3), make(3)
    last(drive(first, LOAM, (0.01, 0.5), 70))
    go_on(second, first)
    ours = last(drive(first, SAND, (0.01, 0.5), 70, seed=9))
    theirs = last(drive(second, SAND, (0.01, 0.5), 70, seed=9))
    for a, b in zip(ours[1:], theirs[1:], strict=True):
        assert np.array_equal(a, b, equal_nan=True)


def test_reset_forgets_the_chosen_vehicles_only():
    estimator, new = make(3), make(3)
    last(drive(estimator, LOAM, (0.01, 0.5), 70))
    before = state(estimator)
    estimator.reset([1])
    assert np.array_equal(state(estimator)[[0, 2]], before[[0, 2]])
    assert np.array_equal(state(estimator)[1], state(new)[1])
    estimator.reset()
    assert np.array_equal(state(estimator), state(new))


def test_provided_slips_are_used_once_and_their_correlation_costs_information():
    rng = np.random.default_rng(4)
    spreads = []
    for correlation, steps in ((0.0, 1.0), (1.0, 1.0), (0.0, 5.0)):
        estimator = make(correlation_steps=steps)
        for slip in np.random.default_rng(5).uniform(0.02, 0.5, (60, 1, 2)):
            estimator.provide_slip(slip, np.full((1, 2), 1e-4), correlation)
            measurement = sample(slip, 1.5, *WEAK, rng)
            measurement.values[:, 3] = np.nan  # v_x is not needed
            estimate = estimator.update(measurement)
        spreads.append(estimate.deviation("shear_deformation_modulus")[0])
        assert estimate.skipped[0] == 0
        assert estimator.update(measurement).skipped[0] == 1  # now it is
    assert spreads[0] < spreads[1] < spreads[2]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 0}, "count = 0"),
        ({"window": 1}, "window = 1"),
        ({"iterations": 0}, "iterations = 0"),
        ({"residual": "slip"}, "'slip'"),
        ({"correlation_steps": 0.5}, "correlation_steps = 0.5"),
        ({"control_period": 50.0}, "rate or milliseconds"),
        ({"parameters": CLAY._replace(shear_deformation_modulus=2.0)}, "centimetres"),
        ({"data_sheet": RTK._replace(torque_noise=-1.0)}, "torque_noise = -1"),
    ],
)
def test_bad_input_says_what_is_wrong(options, words):
    arguments = {"parameters": CLAY, "control_period": PERIOD, "data_sheet": RTK, **options}
    with pytest.raises(ValueError, match=words):
        SoilEstimator(**arguments)


def test_wrong_shapes_are_refused():
    estimator = make(2)
    with pytest.raises(ValueError, match="must be"):
        estimator.provide_slip(np.zeros(2), np.ones(2))
    with pytest.raises(ValueError, match="made for count"):
        estimator.update(make_measurement(v_x=np.zeros(3)))
