"""What both regressions on two parameters do alike: symmetry, what is held or refused, memory."""

from functools import partial

import numpy as np
import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import COLUMN, DRIVE, INERTIAL, Measurement, Status
from tests.baselines.estimators.motion_cases import CLAY, KINDS, RTK, follow, measurements, mirrored
from tests.baselines.estimators.state_columns import TREND
from tests.baselines.estimators.turning_cases import TRUTH, estimator

longitudinal = partial(LongitudinalEstimator, CLAY, 0.02, RTK)
turning = partial(estimator, RTK)
READ_ALONG = ("v_x", "yaw_rate", "acceleration_x", "torque_left", "torque_right")
READ_ACROSS = ("v_x", "yaw_rate", "yaw_acceleration", "acceleration_y")
BOTH = pytest.mark.parametrize("make", [longitudinal, turning], ids=["longitudinal", "turning"])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("make", "options"),
    [
        (longitudinal, {}),
        (turning, {"lateral": "sliding"}),
        (turning, {"lateral": "constrained"}),
    ],
)
def test_exchanging_left_and_right_changes_nothing(make, options, kind):
    lateral_model = options.get("lateral", "sliding")
    samples = measurements(TRUTH, kind, lateral_model, sheet=RTK, steps=300)
    one, other = make(**options), make(**options)
    follow(one, samples)
    follow(other, [mirrored(sample) for sample in samples])
    if make is turning:
        one.memory[:, TREND] *= -1.0  # the innovation changes its sign
    assert np.array_equal(one.memory, other.memory)


@pytest.mark.parametrize(
    ("make", "yaw_rate"),
    [(longitudinal, 0.0), (turning, 0.1)],  # the tracks are slower than the soil lets go
)
def test_at_standstill_and_with_old_samples_everything_is_kept(make, yaw_rate):
    found = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=300)
    before = follow(found, samples)[-1]
    memory = found.memory.copy()
    still = samples[0]._replace(values=samples[0].values.copy())
    still.values[:, COLUMN["v_x"]] = 0.0
    still.values[:, COLUMN["yaw_rate"]] = yaw_rate
    for _ in range(5000):
        after = found.update(still)
        assert after.status[0] == Status.HOLDING
    for group in (INERTIAL, DRIVE):
        old = samples[0].fresh.copy()
        old[:, group] = False
        assert found.update(samples[0]._replace(fresh=old)).status[0] == Status.HOLDING
    assert np.array_equal(found.memory, memory)
    assert np.array_equal(found.read().value, before.value)
    assert np.isnan(after.nis[0])


@pytest.mark.parametrize(
    ("make", "channel"),
    [*((longitudinal, n) for n in READ_ALONG), *((turning, n) for n in READ_ACROSS)],
)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_missing_number_is_skipped_and_counted(make, channel, value):
    found = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=200)
    before = follow(found, samples)[-1]
    samples[0].values[:, COLUMN[channel]] = value
    after = found.update(samples[0])
    assert after.status[0] == Status.REJECTED
    assert after.skipped[0] == before.skipped[0] + 1 == 1
    assert np.array_equal(after.value, before.value)
    assert np.array_equal(after.covariance, before.covariance)


@BOTH
def test_a_torque_that_no_drive_has_is_refused(make):
    found = make()
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=50)
    follow(found, samples)
    memory = found.memory.copy()
    for channel in ("torque_left", "torque_right"):
        wild = samples[0]._replace(values=samples[0].values.copy())
        wild.values[:, COLUMN[channel]] = -2.0 * CLAY.torque_limit
        assert found.update(wild).status[0] == Status.REJECTED
    assert np.array_equal(found.memory, memory)


@pytest.mark.parametrize(
    ("make", "options"),
    [(longitudinal, {}), (turning, {"lateral": "sliding"}), (turning, {"lateral": "constrained"})],
)
def test_a_batch_equals_single_vehicles_and_a_copied_memory_goes_on(make, options):
    lateral_model = options.get("lateral", "sliding")
    samples = measurements(TRUTH, "curves", lateral_model, sheet=RTK, count=5, steps=200)
    batch = make(count=5, **options)
    last = follow(batch, samples)[-1]
    for i in range(5):
        alone, other = make(**options), make(**options)
        mine = [Measurement(*(part[i : i + 1] for part in sample)) for sample in samples]
        follow(alone, mine[:90])
        other.memory[:] = alone.memory.copy()
        single = follow(other, mine[90:])[-1]
        assert np.array_equal(other.memory[0], batch.memory[i])
        assert np.array_equal(single.value[0], last.value[i])
        assert np.array_equal(single.covariance[0], last.covariance[i])
