"""A sensor channel and its group are added in one file; nothing else changes, and agents drive."""

import json

import numpy as np
import pytest

from baselines.registry import POLICIES, shipped_agents
from tracked_env import SPEED, sensors
from tracked_env import observation as obs
from tracked_env.benchmark import (
    BenchmarkConfig,
    BenchmarkSet,
    PolicyContext,
    Store,
    evaluation_sets,
    run,
)
from tracked_env.benchmark.policies import open_archive
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.runner import episode_digest
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import ATTITUDE, Channel
from tracked_env.vector_env import TrackedVehicleVectorEnv

ACTION = np.array([0.3, 0.2], dtype=np.float32)
GROUPS = (*obs.VERSIONS["v0"], "wheel")
SIGMA, BIAS = 0.05, 0.02  # [m/s]


def wheel_speed(truth):
    """A fifth wheel on the left side of the hull."""
    return truth["v_x"] - 0.5 * truth["track_gauge"] * truth["yaw_rate"]


def sliding(inputs, outputs):
    """The wheel, and belt minus wheel on the left: the slip velocity, from what is measured."""
    outputs[:, 0], outputs[:, 1] = inputs[:, 0], 0.3 * inputs[:, 1] - inputs[:, 0]


WHEEL = Channel(
    "wheel_speed", "drive", "m/s", "wheel_noise", "wheel_bias", truth=wheel_speed,
    presets={"rtk": {"wheel_noise": SIGMA, "wheel_bias": BIAS}},
)  # fmt: skip
GROUP = obs.Group(
    "wheel",
    (
        obs.Field("wheel_speed", "m/s", 2.0, 40.0, "fifth wheel on the left"),
        obs.Field("left_sliding", "m/s", 0.5, 40.0, "left belt over that wheel"),
    ),
    channels=("wheel_speed",),
    compute=sliding,
    reads=("wheel_speed", "sprocket_speed_left"),
)


@pytest.fixture(autouse=True)
def wheel(registries):
    """The two registrations; see the functions above for the rest."""
    sensors.register(WHEEL)
    obs.register(GROUP)


def vehicles(count, **arguments):
    defaults = {"observation": GROUPS, "expose_truth": True}
    return TrackedVehicleVectorEnv(count, **{**defaults, **arguments})


def wheel_speeds(env, steps, seed=0):
    """Wheel speed as shown and as it is, (steps + 1, N) each."""
    column = env.layout.index["wheel_speed"]
    observation, info = env.reset(seed=seed)
    values, true = [observation[:, column] * 2.0], [wheel_speed(info["truth"])]
    for _ in range(steps):
        observation, *_, info = env.step(np.tile(ACTION, (env.num_envs, 1)))
        values.append(observation[:, column] * 2.0)
        true.append(wheel_speed(info["truth"]))
    return np.array(values), np.array(true)


def test_the_channel_has_the_noise_and_bias_of_the_preset():
    values, true = wheel_speeds(vehicles(200, error_limit=1e6), 150)
    error = values - true
    quiet = vehicles(200, sensors={"preset": "rtk", "wheel_noise": 0.0}, error_limit=1e6)
    bias = np.subtract(*wheel_speeds(quiet, 150))
    assert np.allclose(np.abs(bias), BIAS, atol=1e-5)
    assert np.ptp(bias, axis=0).max() < 1e-5  # the same for the whole episode
    assert 70 < (bias[0] > 0.0).sum() < 130  # 4 standard deviations of a coin to either side
    noise = error - bias
    assert noise.std() == pytest.approx(SIGMA, rel=0.02)
    products = (noise[1:] * noise[:-1]).mean(), (noise[:, 1:] * noise[:, :-1]).mean()
    assert np.abs(products).max() < 0.05 * SIGMA**2  # neither steps nor vehicles share it
    repeated = (noise[64:128] * noise[:64]).mean()
    assert abs(repeated) < 0.05 * SIGMA**2  # nor the blocks in which it is drawn


def test_two_channels_do_not_share_their_noise():
    sensors.register(WHEEL._replace(name="second_wheel"))
    obs.register(obs.Group("second", (obs.Field("second_wheel", "m/s", 2.0, 40.0, ""),)))
    env = vehicles(200, observation=("wheel", "second"), error_limit=1e6)
    readings = [env.reset(seed=0)[0]]
    readings += [env.step(np.tile(ACTION, (200, 1)))[0] for _ in range(50)]
    difference = np.ptp([[row[:, 0] - row[:, 2]] for row in readings], axis=0)
    assert (difference * 2.0 > SIGMA).all()


def test_other_presets_and_fields_give_other_errors():
    assert np.allclose(*wheel_speeds(vehicles(3, sensors="ideal"), 40), atol=1e-6)
    loud = vehicles(50, sensors={"preset": "ideal", "wheel_noise": 0.5})
    values, true = wheel_speeds(loud, 60)
    assert (values - true).std() == pytest.approx(0.5, rel=0.05)
    loud.reset(seed=1, options={"sensors": {"wheel_noise": 0.0}})
    values = loud.step(np.tile(ACTION, (50, 1)))
    true = wheel_speed(values[-1]["truth"])
    assert np.allclose(values[0][:, loud.layout.index["wheel_speed"]] * 2.0, true, atol=1e-6)
    sheet = sensors.make_sensors({"preset": "rtk", "wheel_noise": 0.5})
    assert sheet.value("wheel_noise") == 0.5 and sheet.value("wheel_bias") == BIAS
    assert sheet.value("gyro_noise") == sensors.RTK.gyro_noise
    assert sensors.make_sensors(sheet._asdict()) == sheet
    assert sensors.make_sensors(json.loads(json.dumps(sheet._asdict()))) == sheet
    with pytest.raises(ValueError, match=r"wheel_noise = -1\.0 .*must be a number in"):
        vehicles(1, sensors={"wheel_noise": -1.0})
    with pytest.raises(ValueError, match=r"unknown sensors key 'whel_noise'.*'wheel_noise'"):
        vehicles(1, sensors={"whel_noise": 1.0})


def test_the_channel_comes_late_and_seldom_as_its_group_does():
    late = {"preset": "ideal", "drive_delay": 0.1, "drive_rate": 10.0}
    env = vehicles(2, sensors=late)
    values, true = wheel_speeds(env, 60)
    sampled = true[[max((k - 5) // 5 * 5, 0) for k in range(61)]]  # every 5 steps, 5 steps late
    assert np.allclose(values, sampled, atol=1e-6)


def test_a_lost_sample_of_the_group_is_lost_for_the_channel():
    env = vehicles(4, sensors={"preset": "ideal", "drive_dropout": 0.5})
    values, _true = wheel_speeds(env, 0)
    age, wheel = env.layout.index["drive_age"], env.layout.index["wheel_speed"]
    snapshot = 0
    for _ in range(60):
        observation, *_, info = env.step(np.tile(ACTION, (4, 1)))
        new, old = wheel_speed(info["truth"]), values[-1]
        fresh = observation[:, age] == 0.0
        values = np.array([np.where(fresh, new, old)])
        assert np.allclose(observation[:, wheel] * 2.0, values[-1], atol=1e-6)
        snapshot += int(fresh.sum())
    assert 80 < snapshot < 160


def test_a_field_that_is_computed_from_samples_follows_them():
    env = vehicles(2)
    observation, _ = env.reset(seed=4)
    fields = env.layout.unpack(observation)
    left = 0.3 * fields["sprocket_speed_left"] - fields["wheel_speed"]
    assert fields["left_sliding"] == pytest.approx(left, abs=1e-5)


def test_all_that_was_there_before_stays_bit_for_bit():
    late = {"preset": "rtk", "pose_delay": 0.1}
    arguments = {"uncertainty": "mixed", "sensors": late, "duration": 1.0}
    arguments |= {"autoreset_mode": "SameStep"}
    plain, more = TrackedVehicleVectorEnv(3, **arguments), vehicles(3, **arguments)
    actions = np.tile(ACTION, (3, 1))
    before, after = plain.reset(seed=2)[0], more.reset(seed=2)[0]
    for _ in range(120):  # the next episodes too
        assert np.array_equal(after[:, : obs.SIZE], before)
        before, after = plain.step(actions)[0], more.step(actions)[0]
    digests = [episode_digest(episode) for episode in plain.simulation.episodes]
    sensors.ADDED.clear()
    again = TrackedVehicleVectorEnv(3, **arguments)
    again.reset(seed=2)
    for _ in range(120):
        again.step(actions)
    assert digests == [episode_digest(episode) for episode in again.simulation.episodes]


BY_SPEED = {"sensors": sensors.MOCAP, "drive": "speed", "vehicle": VEHICLES["focchi"]}


@pytest.mark.parametrize(
    ("name", "defaults", "known"),
    [("nominal", {}, {}), ("adaptive", {}, {}), *((n, SPEED, BY_SPEED) for n in ("uc", "slc"))],
)
def test_a_controller_drives_where_more_is_shown_or_what_it_does_not_need_is_left_out(
    name, defaults, known
):
    """In any order of the groups, with the same actions bit for bit."""
    # No look_ahead; without the actions before, nobody could identify the drives.
    shuffled = ("wheel", "action", "age", "reference", "motion", "drive", "pose_error")
    groups = (obs.VERSIONS["v0"], GROUPS, shuffled)
    envs = [vehicles(2, **{**defaults, "observation": values}) for values in groups]
    contexts = [PolicyContext(0.02, "sliding", observation=e.layout.names, **known) for e in envs]
    policies = [POLICIES[name](context) for context in contexts]
    readings, states = [env.reset(seed=1)[0] for env in envs], [None] * 3
    for _ in range(80):
        actions = []
        for k, policy in enumerate(policies):
            action, states[k] = policy.predict(readings[k], states[k])
            actions.append(action)
        assert np.array_equal(actions[0], actions[1]) and np.array_equal(actions[0], actions[2])
        readings = [env.step(action)[0] for env, action in zip(envs, actions, strict=True)]
    with pytest.raises(ValueError, match=r"lacks group pose_error \(.*reference \("):
        POLICIES[name](PolicyContext(0.02, "sliding", observation=("v_x", "pose_age"), **known))


def test_a_shipped_agent_drives_the_benchmark_where_more_is_shown(tmp_path):
    entry = open_archive(shipped_agents("torque")["ppo-blind"][0])
    assert isinstance(entry, PolicyEntry)
    arguments = {"observation": GROUPS[::-1]}
    evaluation_sets.register(BenchmarkSet("plain", "payload"))
    evaluation_sets.register(BenchmarkSet("wheeled", "payload", arguments=arguments))
    config = BenchmarkConfig(sets=("plain", "wheeled"), episodes=2, duration=1.0)
    records = run(config, [entry], Store(tmp_path, config.identity()))
    rmse = [record["tracking_rmse"] for record in records]
    assert rmse[:2] == rmse[2:]


@pytest.mark.parametrize(
    ("channel", "says"),
    [
        (WHEEL, "'wheel_speed' is registered already"),
        (WHEEL._replace(name="v_x"), "'v_x' is registered already"),
        (WHEEL._replace(name="a", group="lidar"), "unknown group of channel 'a' 'lidar'"),
        (WHEEL._replace(name="a", truth=None), "truth = None; must be a function"),
        (WHEEL._replace(name="a", noise="loudness"), "'loudness' must end in _noise or _bias"),
        (WHEEL._replace(name="a", presets={"gps": {}}), "unknown sensor preset of channel 'a'"),
        (WHEEL._replace(name="a", presets={"rtk": {"x_noise": 1.0}}), "unknown presets of 'a' key"),
    ],
)
def test_a_channel_that_does_not_fit_is_refused(channel, says):
    with pytest.raises(ValueError, match=says):
        sensors.register(channel)
    assert list(sensors.ADDED) == [*(channel.name for channel in ATTITUDE), "wheel_speed"]


def test_a_truth_or_a_field_of_the_wrong_shape_says_whose_it_is():
    sensors.register(WHEEL._replace(name="odd", truth=lambda truth: np.zeros(7)))
    obs.register(obs.Group("odd", (obs.Field("odd", "-", 1.0, 1.0, ""),)))
    env = TrackedVehicleVectorEnv(2, observation=["odd"])
    with pytest.raises(ValueError, match=r"truth of 'odd' has shape \(7,\); must be \(2,\)"):
        env.reset(seed=0)
    obs.register(obs.Group("missing", (obs.Field("missing", "-", 1.0, 1.0, ""),)))
    with pytest.raises(ValueError, match="no sensor channel 'missing'; registered are"):
        TrackedVehicleVectorEnv(2, observation=["missing"])
