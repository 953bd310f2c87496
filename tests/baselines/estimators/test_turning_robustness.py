"""Inertia and lateral resistance: symmetry, what is held or refused, bounds, and memory."""

import numpy as np
import pytest

from baselines.estimators import interacting_models as im
from baselines.estimators.estimate import Status
from baselines.estimators.sensor_samples import COLUMN, DRIVE, INERTIAL, Measurement
from baselines.estimators.turning import TurningEstimator
from tests.baselines.estimators.motion_cases import CLAY, KINDS, RTK, measurements, mirrored
from tests.baselines.estimators.turning_cases import (
    LATERAL_MODELS,
    TRUTH,
    estimator,
    follow,
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_exchanging_left_and_right_changes_nothing(kind, lateral_model):
    samples = measurements(TRUTH, kind, lateral_model, sheet=RTK, steps=300)
    one, other = estimator(RTK, lateral=lateral_model), estimator(RTK, lateral=lateral_model)
    follow(one, samples)
    follow(other, [mirrored(sample) for sample in samples])
    one.memory[:, im.TREND] *= -1.0  # the innovation changes its sign
    assert np.array_equal(one.memory, other.memory)


def test_at_standstill_and_with_old_samples_everything_is_kept():
    found = estimator(RTK)
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=300)
    before = follow(found, samples)[-1]
    memory = found.memory.copy()
    still = samples[0]._replace(values=samples[0].values.copy())
    still.values[:, COLUMN["v_x"]] = 0.0
    still.values[:, COLUMN["yaw_rate"]] = 0.1  # the tracks are slower than the soil lets go
    for _ in range(2000):
        assert found.update(still).status[0] == Status.HOLDING
    for group in (INERTIAL, DRIVE):
        old = samples[0].fresh.copy()
        old[:, group] = False
        assert found.update(samples[0]._replace(fresh=old)).status[0] == Status.HOLDING
    assert np.array_equal(found.memory, memory)
    assert np.array_equal(found.read().value, before.value)


@pytest.mark.parametrize("channel", ["v_x", "yaw_rate", "yaw_acceleration", "acceleration_y"])
def test_a_missing_number_is_skipped_and_counted(channel):
    found = estimator(RTK)
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=200)
    before = follow(found, samples)[-1]
    samples[0].values[:, COLUMN[channel]] = np.nan
    after = found.update(samples[0])
    assert after.status[0] == Status.REJECTED
    assert after.skipped[0] == 1
    assert np.array_equal(after.value, before.value)
    assert np.array_equal(after.covariance, before.covariance)


def test_a_torque_that_no_drive_has_is_refused():
    found = estimator(RTK)
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=50)
    follow(found, samples)
    memory = found.memory.copy()
    for channel in ("torque_left", "torque_right"):
        wild = samples[0]._replace(values=samples[0].values.copy())
        wild.values[:, COLUMN[channel]] = -2.0 * CLAY.torque_limit
        assert found.update(wild).status[0] == Status.REJECTED
    assert np.array_equal(found.memory, memory)


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_bounds_hold_under_dropouts_outliers_and_reversals(lateral_model):
    rng = np.random.default_rng(6)
    found = estimator(RTK, 20, lateral=lateral_model)
    samples = []
    for seed, kind in enumerate(("curves", "reverse", "pivot", "straight", "curves")):
        samples += measurements(TRUTH, kind, lateral_model, RTK, count=20, seed=seed, steps=300)
    for sample in samples:
        wild = rng.random(sample.values.shape) < 0.01
        sample.values[wild] *= rng.choice([-50.0, 0.0, 50.0, np.nan], wild.sum())
        estimate = found.update(sample)
        assert (estimate.value >= [CLAY.inertia / 6.0, 0.0]).all()
        assert (estimate.value <= [6.0 * CLAY.inertia, 2.0]).all()
        assert (np.linalg.eigvalsh(estimate.covariance * [[1e-6, 1e-3], [1e-3, 1.0]]) > 0.0).all()


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_a_batch_equals_single_vehicles_and_a_copied_memory_goes_on(lateral_model):
    samples = measurements(TRUTH, "curves", lateral_model, sheet=RTK, count=4, steps=200)
    batch = estimator(RTK, 4, lateral=lateral_model)
    last = follow(batch, samples)[-1]
    for i in range(4):
        alone, other = estimator(RTK, lateral=lateral_model), estimator(RTK, lateral=lateral_model)
        mine = [Measurement(*(part[i : i + 1] for part in sample)) for sample in samples]
        follow(alone, mine[:90])
        other.memory[:] = alone.memory.copy()
        single = follow(other, mine[90:])[-1]
        assert np.array_equal(other.memory[0], batch.memory[i])
        assert np.array_equal(single.value[0], last.value[i])
        assert np.array_equal(single.covariance[0], last.covariance[i])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lateral": "slide"}, "lateral"),
        ({"regression": "simple"}, "regression"),
        ({"regression": "printed", "lateral": "sliding"}, "must be 'constrained'"),
        ({"control_period": -0.02}, "control_period"),
        ({"count": 0}, "count"),
        ({"forgetting": 0.002}, "lambda"),
    ],
)
def test_nonsense_is_refused_with_a_reason(options, message):
    with pytest.raises(ValueError, match=message):
        TurningEstimator(CLAY, **options)
