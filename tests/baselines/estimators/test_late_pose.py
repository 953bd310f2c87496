"""A pose that comes late: estimators at its time, inertial samples from there to the present."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from baselines.estimators import motion_filter
from baselines.estimators.measurement import COLUMN, INERTIAL, DataSheet, columns_of, rows_of
from baselines.estimators.motion_filter import MotionFilter
from baselines.estimators.observation_reader import FIRST, ObservationReader
from baselines.estimators.pose_outages import BIAS
from baselines.estimators.slip_kinematics import ROW
from baselines.estimators.stack import IdentificationStack
from baselines.registry import POLICIES
from tracked_env.benchmark import BenchmarkConfig, metrics
from tracked_env.benchmark.runner import drive
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

PERIOD, LAG = 0.02, 10
CLAY = VEHICLES["strawa"]
LATE = {"preset": "ideal", "pose_delay": LAG * PERIOD}


def observations(sensors, steps, count=3):
    """What the same vehicles under the same commands show with these sensors, (steps, N, D)."""
    env = TrackedVehicleVectorEnv(
        count, uncertainty="weak-soil", sensors=sensors, error_limit=1e3, duration=60.0
    )
    rng = np.random.default_rng(1)
    rows = [env.reset(seed=71000)[0]]
    action = np.zeros((count, 2))
    for _ in range(steps - 1):
        action = np.clip(action + rng.uniform(-0.1, 0.11, (count, 2)), -0.3, 0.6)
        rows.append(env.step(action.astype(np.float32))[0])
    return np.array(rows)


def test_the_filter_of_a_late_pose_knows_what_that_of_a_pose_in_time_knew():
    sheets = [DataSheet.of(make_sensors(sensors)) for sensors in ("ideal", LATE)]
    stacks = [IdentificationStack(CLAY, PERIOD, sheet, 3) for sheet in sheets]
    drives = [observations(sensors, 150) for sensors in ("ideal", LATE)]
    estimates = []
    for stack, rows in zip(stacks, drives, strict=True):
        answers = [stack.update(observation).parts.answers for observation in rows]
        estimates.append(
            [[a[name]["value"] for name in ("slip", "soil", "longitudinal")] for a in answers]
        )
    for n in range(LAG, 150):
        for in_time, late in zip(estimates[0][n - LAG], estimates[1][n], strict=True):
            np.testing.assert_allclose(late, in_time, rtol=2e-4, atol=2e-5)
    slips = np.array([one[0][:, 3:5] for one in estimates[0]])
    assert np.ptp(slips, axis=0).max() > 0.2  # or there was nothing to know


def test_slips_of_a_late_pose_are_those_of_now():
    """The stack with a pose in time is the truth: sensors are ideal. Slips change by 0.2."""
    sheets = [DataSheet.of(make_sensors(sensors)) for sensors in ("ideal", LATE)]
    stacks = [IdentificationStack(CLAY, PERIOD, sheet, 3) for sheet in sheets]
    in_time, late = observations("ideal", 150), observations(LATE, 150)
    errors, old = [], []
    for n, (one, other) in enumerate(zip(in_time, late, strict=True)):
        truth = stacks[0].update(one).slip.value[:, 3:5].copy()
        estimates = stacks[1].update(other)
        if n > 2 * LAG:
            errors.append(estimates.slip.value[:, 3:5] - truth)
            old.append(estimates.parts.answers["slip"]["value"][:, 3:5] - truth)
    for share in (0.5, 0.8, 0.9):
        assert np.quantile(np.abs(errors), share) < 0.25 * np.quantile(np.abs(old), share)


def test_until_the_first_late_pose_what_is_shown_is_the_first_pose_and_the_way_since():
    motions = MotionFilter(CLAY, PERIOD, DataSheet.of(make_sensors(LATE)), 3)
    in_time, start = observations("ideal", LAG + 1), np.array([True] * 3)
    truth = MotionFilter(CLAY, PERIOD, DataSheet.of(make_sensors("ideal")), 3)
    for late, now in zip(observations(LATE, LAG + 1), in_time, strict=True):
        shown, right = motions.update(late, start).rows, truth.update(now, start).rows
        np.testing.assert_allclose(shown[:, :3], right[:, :3], atol=0.01)
        start = np.zeros(3, dtype=bool)


def filters(bias):
    """A row of the slip observer with these biases of accelerometer and gyro."""
    rows = rows_of(np.zeros((1, columns_of(ROW))), ROW)
    rows["speed"][:, BIAS] = rows["heading"][:, BIAS] = bias
    return rows


@pytest.mark.parametrize("bias", [0.0, 0.3])
def test_the_way_since_is_that_of_the_equations_of_motion(bias):
    """Against solve_ivp: x' = v c - v_y s, y' = v s + v_y c, psi' = w, v' = f + w v_y."""
    reader = ObservationReader(PERIOD, 1, LAG * PERIOD)
    reader.rows["step"] = LAG + 1  # steps 0 to LAG have been read

    def inertial(t):
        return 1.5 * np.cos(9.0 * t), 0.8 * np.sin(7.0 * t) - 0.3

    for step in range(LAG + 1):
        slot = reader.rings[0, 0, step : step + 1]
        slot["taken"] = step + 1.0
        values = slot["values"][0]
        f, w = inertial(step * PERIOD)
        values[COLUMN["acceleration_x"] - FIRST[INERTIAL]] = f + bias
        values[COLUMN["yaw_rate"] - FIRST[INERTIAL]] = w + bias
    x, y, yaw, v, v_y = 3.0, -2.0, 0.7, 1.2, 0.1

    def rates(t, s):
        f, w = inertial(t)
        c, sine = np.cos(s[2]), np.sin(s[2])
        return [s[3] * c - v_y * sine, s[3] * sine + v_y * c, w, f + w * v_y]

    exact = solve_ivp(rates, (0.0, LAG * PERIOD), [x, y, yaw, v], rtol=1e-10).y[:, -1]
    motion = np.array([[x, y, yaw, v, v_y, inertial(0.0)[1]]])
    motion_filter.carry(
        motion, reader.rows, reader.rings, PERIOD, np.array([LAG]), filters(bias), np.zeros((1, 3))
    )
    np.testing.assert_allclose(motion[0, :4], exact, atol=1e-3)
    assert motion[0, 5] == pytest.approx(inertial(LAG * PERIOD)[1])
    assert np.hypot(*(exact[:2] - (x, y))) > 0.2 and abs(exact[2] - yaw) > 0.02


def test_beyond_the_last_inertial_sample_its_accelerations_go_on():
    motions = []
    for last in (LAG, LAG - 5):
        reader = ObservationReader(PERIOD, 1, LAG * PERIOD)
        reader.rows["step"] = LAG + 1
        for step in range(last + 1):
            slot = reader.rings[0, 0, step : step + 1]
            slot["taken"] = step + 1.0
            values = slot["values"][0]
            values[COLUMN["acceleration_x"] - FIRST[INERTIAL]] = 0.7
            values[COLUMN["yaw_rate"] - FIRST[INERTIAL]] = 0.2 + 1.1 * step * PERIOD
            values[COLUMN["yaw_acceleration"] - FIRST[INERTIAL]] = 1.1
        motion = np.array([[3.0, -2.0, 0.7, 1.2, 0.1, 0.2]])
        motion_filter.carry(
            motion, reader.rows, reader.rings, PERIOD, np.array([LAG]), filters(0.0),
            np.zeros((1, 3)),
        )  # fmt: skip
        motions.append(motion)
    np.testing.assert_allclose(motions[1], motions[0], rtol=1e-12)


@pytest.mark.parametrize("name", ["adaptive", pytest.param("mpc-adaptive", marks=pytest.mark.slow)])
def test_a_late_pose_on_weak_soil_costs_little(name):
    """Before, slips that were constant over the delay turned the filter's heading away: 0.19 m."""
    errors = {}
    for chosen in ("weak-soil", "late-weak-soil"):
        config = BenchmarkConfig(sets=(chosen,))
        policy = POLICIES[name](config.context(chosen))
        env = config.environment(chosen, 16, False)
        found = metrics.evaluate(drive(policy, env, range(72000, 72016), lambda: None)[0])
        env.close()
        errors[chosen] = np.sort(found["tracking_rmse"])[4:12].mean()
    assert errors["late-weak-soil"] < 1.35 * errors["weak-soil"] < 0.06
