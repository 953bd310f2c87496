"""The filter without a model: kinematics, covariances by a second method, biases, late poses."""

import math

import numpy as np
import pytest

from baselines.estimators.measurement import COLUMN, DataSheet, Rows, Stateful, columns_of
from baselines.learned import kinematic_filter as kinematic
from baselines.learned.kinematic_filter import MOVED, SIZE, Noise
from baselines.learned.vehicle_features import ROW, VehicleFeatures
from tracked_env.sensors import CHANNEL_COUNT

PERIOD = 0.02
RTK = DataSheet()


class Filter(Stateful):
    """The filter alone, of `count` vehicles."""

    rows = Rows("memory", ROW)

    def __init__(self, count=1, sheet=RTK):
        self.memory = np.zeros((count, columns_of(ROW)))
        self.rings = np.zeros((count, 52, MOVED))
        self.misses, self.noise = np.zeros((count, MOVED)), Noise.of(sheet, PERIOD)

    def step(self, values, fresh=True, age=0.0):
        count = len(self.memory)
        groups = (count, 3)
        seen = np.broadcast_to(np.asarray(fresh), groups).copy()
        ages = np.broadcast_to(np.asarray(age, float), groups).copy()
        kinematic.navigate(values, seen, ages, self.rows, self.rings, self.noise, self.misses)
        return self.rows["mean"]


def circle(n, v=2.0, w=0.4, v_y=-0.1):
    """Noise-free samples (1, CHANNELS) of a steady turn after n steps, and the true motion."""
    t, values = n * PERIOD, np.full((1, CHANNEL_COUNT), np.nan)
    yaw = w * t
    x = (v * math.sin(yaw) - v_y * (1.0 - math.cos(yaw))) / w
    y = (v * (1.0 - math.cos(yaw)) + v_y * math.sin(yaw)) / w
    by_name = {
        "x": x, "y": y, "yaw": math.remainder(yaw, 2.0 * math.pi), "v_x": v, "v_y": v_y,
        "acceleration_x": -w * v_y, "acceleration_y": w * v, "yaw_rate": w,
        "sprocket_speed_left": (v - 0.8 * w) / 0.3, "sprocket_speed_right": (v + 0.8 * w) / 0.3,
    }  # fmt: skip
    for name, value in by_name.items():
        values[0, COLUMN[name]] = value
    return values, np.array([x, y, by_name["yaw"], v, v_y])


def test_a_steady_turn_is_followed_and_its_radius_and_side_slip_are_found():
    filtered = Filter()
    for n in range(1500):
        values, true = circle(n)
        mean = filtered.step(values)[0]
    np.testing.assert_allclose(mean[:MOVED], true, atol=2e-3)
    assert math.exp(mean[kinematic.LOG_RADIUS]) == pytest.approx(0.3, rel=0.02)
    assert mean[kinematic.SIDE] == pytest.approx(0.25, rel=0.1)  # v_y + d w = 0


@pytest.mark.parametrize("radius", [0.05, 0.9])
def test_belts_do_not_drag_the_speed_before_their_radius_is_known(radius):
    """It is known to a factor of 2.7; to first order a single sample would settle it, wrongly."""
    filtered, rng, errors = Filter(), np.random.default_rng(3), []
    for n in range(250):
        values, true = circle(n)
        for side in ("left", "right"):
            values[0, COLUMN[f"sprocket_speed_{side}"]] *= 0.3 / radius
        for name, spread in zip(("v_x", "v_y"), filtered.noise.pose[3:], strict=True):
            values[0, COLUMN[name]] += spread * rng.normal()
        mean = filtered.step(values)[0]
        errors.append(abs(mean[kinematic.V_X] - true[3]))
    assert max(errors) < 0.1
    assert math.exp(mean[kinematic.LOG_RADIUS]) == pytest.approx(radius, rel=0.02)


def slipping(share, radius=0.25, gauge=1.6):
    """Samples (T, CHANNELS) and v_x (T,) where each belt slips by a share (T,) of its speed, the
    outer one ahead and the inner one back, on a way of changing speed and curvature."""
    t = PERIOD * np.arange(len(share))
    v, w = 1.5 + 0.4 * np.sin(0.7 * t), 0.6 * np.sin(0.9 * t)
    yaw = 0.6 / 0.9 * (1.0 - np.cos(0.9 * t))
    x, y = (np.cumsum(v * each) * PERIOD for each in (np.cos(yaw), np.sin(yaw)))
    outer = np.sign(w) * share
    by_name = {
        "x": x, "y": y, "yaw": yaw, "v_x": v, "v_y": 0.0 * t,
        "acceleration_x": 0.28 * np.cos(0.7 * t), "acceleration_y": v * w, "yaw_rate": w,
        "sprocket_speed_left": (v - 0.5 * gauge * w) / radius / (1.0 + outer),
        "sprocket_speed_right": (v + 0.5 * gauge * w) / radius / (1.0 - outer),
    }  # fmt: skip
    values = np.full((len(t), CHANNEL_COUNT), np.nan)
    for name, each in by_name.items():
        values[:, COLUMN[name]] = each
    return values, v


def test_forced_belts_hold_the_speed_without_a_pose_while_the_ground_changes():
    """Poses end at 30 s; how much belts slip in turns changes before and after."""
    forced, sheet = kinematic.FORCED, RTK._replace(acceleration_noise=0.1)
    values, v = slipping(0.1 + 0.08 * np.sin(0.8 * PERIOD * np.arange(2000)))
    values[:, COLUMN["acceleration_x"]] += 0.1 * np.random.default_rng(0).normal(size=2000)

    def error(rules):
        filtered = Filter(sheet=sheet)
        filtered.noise = filtered.noise._replace(rules=rules)
        for n in range(len(v)):
            found[n] = filtered.step(values[n : n + 1], [n < 1500, True, True])[0, kinematic.V_X]
        return np.sqrt(np.mean((found[1500:] / v[1500:] - 1.0) ** 2))

    found = np.empty(len(v))
    right = error(forced)
    assert right < 0.012
    assert error(forced._replace(turning=0.0, turning_drift=0.0)) > 2.0 * right
    assert error(forced._replace(changing=0.0, changing_spread=0.0)) > 1.5 * right
    assert error(kinematic.Rules()) > 2.5 * right


def test_over_a_border_of_friction_it_finds_back_with_a_pose_a_second():
    """Where belts suddenly slip, it is sure of a wrong speed; poses that miss by far more than it
    claims have to count."""
    from tracked_env import SPEED
    from tracked_env.vector_env import TrackedVehicleVectorEnv

    laws = {"uncertainty": ["friction-step"], "sensors": {"preset": "mocap", "pose_rate": 1.0}}
    env = TrackedVehicleVectorEnv(48, **{**SPEED, **laws, "duration": 29.0})
    seen = VehicleFeatures(PERIOD, DataSheet.of(env.simulation.settings.sensors), 48, "speed")
    observation, _ = env.reset(seed=11)
    start, squares, column = np.ones(48, bool), [], env.simulation.batch.column
    for n in range(1400):
        places = np.stack([column("x"), column("y")], axis=1).copy()
        seen.see(observation, start)
        start = np.zeros(48, bool)
        if n >= 250:
            squares.append(((seen.rows["mean"][:, :2] - places) ** 2).sum(axis=1))
        observation, *_ = env.step(np.clip(seen.steady, -1.0, 1.0).astype(np.float32))
    away = np.sqrt(np.mean(squares, axis=0)) / column("contact_length")
    env.close()
    assert np.quantile(away, 0.9) < 0.04


def test_belts_are_a_measurement_of_radius_slip_and_speed():
    """Against h by differences of what the belts say, and the textbook's update."""
    rng = np.random.default_rng(7)
    half, step = rng.normal(size=(SIZE, SIZE)), 1e-6
    z, p, rules = 0.3 * rng.normal(size=SIZE), half @ half.T, kinematic.FORCED
    z[kinematic.LOG_RADIUS], left, right, pull, missing = -1.2, 6.0, 9.0, 0.4, 0.2

    def missed(state):
        radius = math.exp(state[8])
        said = radius * (0.5 * (left + right) + state[10] * (right - left))
        return (
            state[3]
            - said
            - state[11] * (right - left) / (left + right) * missing
            - state[12] * pull
        )

    h = -np.array(
        [(missed(z + step * e) - missed(z - step * e)) / (2 * step) for e in np.eye(SIZE)]
    )
    bent = h[8] * p[8, 8]
    variance = (rules.rest + rules.share * abs(z[3])) ** 2 + 0.5 * bent**2
    mean, covariance = z.copy(), p.copy()
    kinematic.use_belts(
        mean, covariance, left, right, pull, missing, rules, 0.0, np.empty((1, SIZE))
    )
    gain = p @ h / (h @ p @ h + variance)
    np.testing.assert_allclose(mean, z + gain * missed(z), rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(covariance, p - np.outer(gain, h @ p), rtol=1e-3, atol=1e-4)


def test_without_a_pose_accelerometers_gyro_and_belts_carry_the_motion_on():
    filtered = Filter()
    for n in range(1500):
        values, true = circle(n)
        without = n >= 1000  # for 10 s, 20 m of way
        mean = filtered.step(values, [not without, True, True], [0.0, 0.0, 0.0])[0]
    assert np.hypot(*(mean[:2] - true[:2])) < 0.02
    assert abs(math.remainder(mean[2] - true[2], 2.0 * math.pi)) < 2e-3


def test_biases_of_accelerometers_and_gyro_are_found():
    biases = np.array([0.03, -0.02, 0.002])
    filtered = Filter(sheet=RTK._replace(gyro_bias=0.002, acceleration_bias=0.03))
    rng = np.random.default_rng(0)
    for n in range(3000):
        values, true = circle(n)
        for name, bias in zip(
            ("acceleration_x", "acceleration_y", "yaw_rate"), biases, strict=True
        ):
            values[0, COLUMN[name]] += bias
        noise = filtered.noise.pose * rng.normal(size=5)
        for name, error in zip(("x", "y", "yaw", "v_x", "v_y"), noise, strict=True):
            values[0, COLUMN[name]] += error
        mean = filtered.step(values)[0]
    spread = np.sqrt(np.diagonal(filtered.rows["covariance"][0])[5:8])
    assert (np.abs(mean[5:8] - biases) < 3.0 * spread).all()
    assert (spread < 0.4 * np.abs(biases)).all()  # they are known from the data, not the sheet
    np.testing.assert_allclose(mean[:2], true[:2], atol=0.02)  # of samples with 0.02 m


def test_the_covariance_moves_by_the_derivatives_of_the_motion():
    rng = np.random.default_rng(1)
    room, noise = np.empty((MOVED, SIZE)), Noise.of(RTK, PERIOD)
    z = rng.normal(size=SIZE)
    half = rng.normal(size=(SIZE, SIZE))
    p = half @ half.T

    def moved(state):
        after, nothing = state.copy(), np.zeros((SIZE, SIZE))
        kinematic.move(after, nothing, 0.7, -0.4, 0.9, 0.0, noise, room)
        return after, nothing

    (_, added), step = moved(z), 1e-6
    # Where noise enters and what its yaw rate turns within the step are left out of the equations.
    jacobian = np.stack(
        [(moved(z + step * e)[0] - moved(z - step * e)[0]) / (2.0 * step) for e in np.eye(SIZE)], 1
    )
    expected = jacobian @ p @ jacobian.T + added
    after = p.copy()
    kinematic.move(z.copy(), after, 0.7, -0.4, 0.9, 0.0, noise, room)
    np.testing.assert_allclose(after, expected, atol=2e-3 * np.abs(expected).max())
    assert np.abs(after - p).max() > 20.0 * np.abs(after - expected).max()


def test_a_measurement_is_that_of_the_kalman_filter_and_a_wild_one_weighs_less():
    rng = np.random.default_rng(2)
    half = rng.normal(size=(SIZE, SIZE))
    z, p, h = rng.normal(size=SIZE), half @ half.T, np.zeros(SIZE)
    h[3], h[8] = -1.0, 0.7
    for missed in (0.3, 1e3):
        mean, covariance = z.copy(), p.copy()
        variance, s = 0.04, h @ p @ h + 0.04
        shown = kinematic.correct(
            mean, covariance, 3, -1.0, 8, 0.7, missed, variance, np.empty((1, SIZE))
        )
        assert shown == pytest.approx(missed / math.sqrt(s))
        s = max(s, missed * math.sqrt(s) / kinematic.HUBER)
        gain = p @ h / s
        np.testing.assert_allclose(mean, z + gain * missed, rtol=1e-12)
        np.testing.assert_allclose(covariance, p - np.outer(gain, h @ p), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("late", [0.0, 0.1, 0.3])
def test_a_late_pose_is_compared_with_the_motion_of_its_time(late):
    filtered, errors = Filter(), []
    for n in range(1000):
        values, true = circle(n)
        if n * PERIOD >= late:
            older, _ = circle(n - round(late / PERIOD))
            for name in ("x", "y", "yaw", "v_x", "v_y"):
                values[0, COLUMN[name]] = older[0, COLUMN[name]]
        mean = filtered.step(values, True, [min(late, n * PERIOD), 0.0, 0.0])[0]
        errors.append(np.hypot(*(mean[:2] - true[:2])))
    assert max(errors[500:]) < 5e-3  # it drives 0.6 m within 0.3 s


def test_a_batch_has_the_bits_of_its_single_vehicles_and_nothing_spreads_from_a_missing_sample():
    batch, single = Filter(3), Filter(1)
    for n in range(60):
        values = np.concatenate([circle(n, v)[0] for v in (2.0, 1.0, -1.5)])
        values[2, n % CHANNEL_COUNT] = np.nan
        together, alone = batch.step(values), single.step(values[:1].copy())
    assert np.array_equal(together[:1], alone)
    assert np.isfinite(batch.memory).all()


def test_a_smoother_of_the_same_samples_is_closer_than_the_filter():
    from benchmarks.studies.filtering import derivative, smoothed

    rng, step, room = np.random.default_rng(4), 1e-6, np.empty((MOVED, SIZE))
    noise, z = Noise.of(RTK, PERIOD), rng.normal(size=SIZE)

    def moved(state):
        after = state.copy()
        kinematic.move(after, np.zeros((SIZE, SIZE)), 0.7, -0.4, 0.9, 0.0, noise, room)
        return after

    columns = [(moved(z + step * e) - moved(z - step * e)) / (2.0 * step) for e in np.eye(SIZE)]
    found = derivative(z, 0.9 - z[7], PERIOD)
    np.testing.assert_allclose(found, np.stack(columns, axis=1), atol=1e-3)
    rows, true = [], []
    for n in range(600):
        values, motion = circle(n)
        for name, spread in zip(("x", "y", "yaw", "v_x", "v_y"), noise.pose, strict=True):
            values[0, COLUMN[name]] += spread * rng.normal()
        rows.append(values[0])
        true.append(motion[:2])
    fresh = np.ones((600, 3), bool)
    fresh[250:400, 0] = False  # 3 s without a pose
    both = smoothed(np.array(rows), fresh, np.zeros((600, 3)), noise)
    filtered, smooth = (np.sqrt(np.mean((of - true)[100:] ** 2)) for of in both)
    assert smooth < 0.7 * filtered < 0.01


def test_innovations_of_a_drive_have_the_deviations_that_the_filter_claims():
    from tracked_env.vector_env import TrackedVehicleVectorEnv

    env = TrackedVehicleVectorEnv(24, uncertainty="any-vehicle", sensors="rtk", duration=8.0)
    seen = VehicleFeatures(PERIOD, RTK, 24)
    observation, _ = env.reset(seed=5)
    start, squares = np.ones(24, bool), []
    for n in range(390):
        seen.see(observation, start)
        start = np.zeros(24, bool)
        if n >= 100:
            squares.append(seen._misses.copy() ** 2)
        observation, *_ = env.step(np.clip(seen.begin, -1.0, 1.0).astype(np.float32))
    env.close()
    ratio = np.median(np.mean(squares, axis=0), axis=0)  # x, y, yaw, v_x, v_y of most vehicles
    assert (ratio > 0.8).all() and (ratio < 1.3).all(), ratio
