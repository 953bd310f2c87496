"""The slip observer's steps around filterpy's unscented Kalman filter say the same.

filterpy 2 draws new sigma points from (x, P + Q) before the update, 1.x did not; S 7.2.1 passes the
propagated ones on.
"""

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators import slip_observer
from baselines.estimators.measurement import COLUMN, Measurement
from baselines.estimators.slip_kinematics import ROWS, STATES
from baselines.estimators.slip_observer import BETA, SPREAD, SlipObserver
from tests.baselines.estimators.motion_cases import state
from tests.baselines.estimators.slip_cases import PARAMETERS, PERIOD, RTK, simulate, weaving
from tests.baselines.estimators.test_identification_on_slopes import hills
from tests.baselines.estimators.test_slip_outage import accelerated, blind

COUNT = 3
GROUND = (
    np.tile([9e3, 0.02], (COUNT, 1)), np.tile(np.diag([1e5, 1e-6]), (COUNT, 1, 1)),
    np.linspace(0.6, 0.8, COUNT),
)  # fmt: skip


def filterpy_filter(rows):
    """predict, compare and _correct of slip_observer, around one filter of the library."""

    def process(point, _period, u, k):
        return np.array([*kinematics.process(tuple(point), u, k), *point[3:]])

    def measured(point, u, way, gyro, k):
        return np.array(kinematics.measured(tuple(point), u, way, gyro, k))[:rows]

    points = MerweScaledSigmaPoints(STATES, alpha=SPREAD, beta=BETA, kappa=0.0)
    ukf = UnscentedKalmanFilter(STATES, rows, PERIOD, measured, process, points)

    def predict(x, p, u, k, scratch):
        """Without Q: the observer adds it."""
        ukf.x, ukf.P = x.copy(), np.triu(p) + np.triu(p, 1).T
        ukf.Q = np.zeros((STATES, STATES))
        ukf.predict(u=u, k=k)
        x[:], p[:] = ukf.x, ukf.P

    def compare(x, p, u, way, gyro, k, scratch):
        ukf.x, ukf.P = x.copy(), np.triu(p) + np.triu(p, 1).T
        ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
        noise = scratch.noise[:rows, :rows]
        ukf.update(scratch.z[:rows], R=noise, u=u, way=way, gyro=gyro, k=k)
        pose = ukf.y[:3]
        return float(pose @ np.linalg.solve(ukf.S[:3, :3], pose)), float(ukf.y @ ukf.SI @ ukf.y)

    def correct(x, p, rows, w, e):
        x[:], p[:] = ukf.x, ukf.P

    return {"predict": predict, "compare": compare, "_correct": correct}


@pytest.fixture
def observers(monkeypatch):
    """The observer, and one that runs the same steps without compilation around filterpy."""

    def make(velocity):
        one, other = (
            SlipObserver(PARAMETERS, PERIOD, RTK, COUNT, velocity=velocity) for _ in range(2)
        )
        library = filterpy_filter(ROWS if velocity else 3)

        def update_all(samples, k, rows, rings, answers):
            with monkeypatch.context() as patch:
                for name, function in library.items():
                    patch.setattr(slip_observer, name, function)
                records = (array.view(np.recarray) for array in (rows, rings, answers))
                slip_observer.update_all.py_func(samples, k, *records)

        other._compute = update_all
        return one, other

    return make


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
def test_both_filters_say_the_same(drive, velocity, statuses, observers):
    one, other = observers(velocity)
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
