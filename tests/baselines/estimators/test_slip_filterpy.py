"""The batched slip observer equals the one around filterpy's unscented Kalman filter."""

import numpy as np
import pytest

from baselines.estimators.measurement import Measurement
from baselines.estimators.slip_filterpy import FilterpySlipObserver
from baselines.estimators.slip_observer import SlipObserver
from tests.baselines.estimators.slip_cases import PARAMETERS, PERIOD, RTK, simulate, weaving
from tests.baselines.estimators.state_columns import go_on, state


def _hard_samples(count=3, steps=500):
    """Delayed, lost, wrong samples, a jump of the pose and a reversal."""
    belts = weaving(steps, count, speed=1.5)
    belts[250:] *= -1.0
    run = simulate(belts, 0.1 * np.sign(belts), 0.04, delay=6)
    rng = np.random.default_rng(1)
    for k, m in enumerate(run.measurements):
        values = m.values
        values[rng.random(values.shape) < 0.02] = np.nan
        values[:, 0] += 30.0 if k > 300 else 0.0
        values[:, 2] = (values[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        values[k % count, 1] += 1e3 if k % 50 == 0 else 0.0
        yield Measurement(values, rng.random((count, 3)) < 0.7, m.age)


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "pose_only"])
def test_both_observers_agree_over_a_long_run_of_hard_samples(velocity):
    one = SlipObserver(PARAMETERS, PERIOD, RTK, 3, velocity=velocity)
    other = FilterpySlipObserver(PARAMETERS, PERIOD, RTK, 3, velocity=velocity)
    seen = set()
    for k, m in enumerate(_hard_samples()):
        limit = 1e-9 if k >= 50 else 1e-8  # while slips are unknown, rounding is amplified
        a, b = one.update(m), other.update(m)
        assert np.abs(a.value - b.value).max() < limit
        assert np.abs(a.covariance - b.covariance).max() < limit
        assert np.allclose(a.nis, b.nis, rtol=1e-7, atol=1e-9, equal_nan=True)
        assert np.array_equal(a.status, b.status)
        assert np.array_equal(a.skipped, b.skipped)
        assert np.allclose(a.excitation, b.excitation, rtol=1e-6, atol=1e-9)
        seen |= set(a.status.tolist())
    assert seen == {0, 1, 2}
    assert np.abs(state(one) - state(other)).max() < 1e-9


def test_the_memory_of_one_observer_continues_in_the_other():
    one = SlipObserver(PARAMETERS, PERIOD, RTK, 3)
    other = FilterpySlipObserver(PARAMETERS, PERIOD, RTK, 3)
    samples = list(_hard_samples())
    for m in samples[:100]:
        one.update(m)
    go_on(other, one)
    for m in samples[100:130]:
        assert np.abs(one.update(m).value - other.update(m).value).max() < 1e-9
