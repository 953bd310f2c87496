"""The batched slip observer equals the one around filterpy's unscented Kalman filter."""

import numpy as np
import pytest

from baselines.estimators.measurement import COLUMN, DataSheet, Measurement
from baselines.estimators.slip_filterpy import FilterpySlipObserver
from baselines.estimators.slip_observer import SlipObserver
from baselines.estimators.stack import IdentificationStack
from tests.baselines.estimators.motion_cases import go_on, state
from tests.baselines.estimators.slip_cases import PARAMETERS, PERIOD, RTK, part, simulate, weaving
from tests.baselines.estimators.test_identification_on_slopes import hills
from tests.baselines.estimators.test_late_pose import CLAY, LATE, observations
from tests.baselines.estimators.test_slip_outage import accelerated, blind
from tracked_env.sensors import make_sensors

COUNT = 3
GROUND = (
    np.tile([9e3, 0.02], (COUNT, 1)), np.tile(np.diag([1e5, 1e-6]), (COUNT, 1, 1)),
    np.linspace(0.6, 0.8, COUNT),
)  # fmt: skip


def level():
    """Late, missing, wrong samples, a jump of the pose and a reversal."""
    belts = weaving(500, COUNT, speed=1.5)
    belts[250:] *= -1.0
    run = simulate(belts, 0.1 * np.sign(belts), 0.04, delay=6)
    rng = np.random.default_rng(1)
    for k, m in enumerate(run.measurements):
        values = m.values
        values[rng.random(values.shape) < 0.02] = np.nan
        values[:, 0] += 30.0 if k > 300 else 0.0
        values[:, 2] = (values[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        values[k % COUNT, 1] += 1e3 if k % 50 == 0 else 0.0
        yield Measurement(values, rng.random((COUNT, 3)) < 0.7, m.age)


def slopes():
    return hills(150, COUNT, 0.1, 0.05)


def outages():
    """Two, with the thrust and, for a step of the first, no sample at all."""
    run = accelerated(simulate(weaving(500, COUNT), 0.1, 0.03), np.random.default_rng(2))
    for k, m in enumerate(blind(blind(run.measurements, 100, 250), 320, 420)):
        m.values[:, COLUMN["torque_left"]] = m.values[:, COLUMN["torque_right"]] = 1500.0
        if k == 150:
            m.values[:] = np.nan
        yield m


@pytest.mark.parametrize(
    ("drive", "velocity", "statuses"),
    [
        (level, True, {0, 1, 2}), (level, False, {0, 1, 2}), (slopes, True, {0, 1}),
        (slopes, False, {0, 1}), (outages, True, {0, 1}),
    ],
)  # fmt: skip
def test_both_observers_say_the_same(drive, velocity, statuses):
    one, other = (
        kind(PARAMETERS, PERIOD, RTK, COUNT, velocity=velocity)
        for kind in (SlipObserver, FilterpySlipObserver)
    )
    seen = set()
    for k, m in enumerate(drive()):
        one.take_ground(*GROUND), other.take_ground(*GROUND)
        limit = 1e-9 if k >= 50 else 1e-8  # while slips are unknown, rounding is amplified
        a, b = one.update(m), other.update(m)
        assert np.abs(a.value - b.value).max() < limit
        assert np.abs(a.covariance - b.covariance).max() < limit
        assert np.allclose(a.nis, b.nis, rtol=1e-7, atol=1e-9, equal_nan=True)
        assert np.array_equal(a.status, b.status)
        assert np.array_equal(a.skipped, b.skipped)
        assert np.allclose(a.excitation, b.excitation, rtol=1e-6, atol=1e-9)
        seen |= set(a.status.tolist())
    assert seen == statuses
    assert np.abs(state(one) - state(other)).max() < 1e-9


def test_the_memory_of_one_observer_continues_in_the_other_and_a_batch_is_its_vehicles():
    one = SlipObserver(PARAMETERS, PERIOD, RTK, COUNT)
    other = FilterpySlipObserver(PARAMETERS, PERIOD, RTK, COUNT)
    alone = FilterpySlipObserver(PARAMETERS, PERIOD, RTK, 1)
    samples = list(level())
    for m in samples[:100]:
        one.update(m), alone.update(part(m, slice(1, 2)))
    go_on(other, one)
    for memory, whole in zip((alone.memory, alone.ring), (other.memory, other.ring), strict=True):
        memory[:] = whole[1:2]
    for m in samples[100:130]:
        a, b, c = one.update(m), other.update(m), alone.update(part(m, slice(1, 2)))
        assert np.abs(a.value - b.value).max() < 1e-9
        assert np.array_equal(b.value[1], c.value[0])
        assert np.array_equal(b.covariance[1], c.covariance[0])


def test_both_stacks_say_the_same_where_poses_are_late():
    sheet = DataSheet.of(make_sensors(LATE))
    one, other = (
        IdentificationStack(CLAY, PERIOD, sheet, COUNT, slip=slip)
        for slip in ("batched", "filterpy")
    )
    for observation in observations(LATE, 80):
        a, b = one.update(observation), other.update(observation)
        np.testing.assert_allclose(a.slip.value, b.slip.value, atol=1e-7)
        np.testing.assert_allclose(a.motion_rows, b.motion_rows, atol=1e-7)
    assert isinstance(other.slip, FilterpySlipObserver)
    assert type(one.slip) is SlipObserver
