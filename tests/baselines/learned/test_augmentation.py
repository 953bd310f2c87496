"""Observation augmentation: closed forms, forgetting, going on from a state, the residual."""

import numpy as np
import pytest

from baselines.learned.agent_policy import make_augmentation
from baselines.learned.augmentation import KINDS, LAGS, REMEMBERED, network_inputs
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.linearizing.linearizing_law import Gains
from tracked_env import SPEED as SPEED_V0
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import MOCAP, make_sensors
from tracked_env.vector_env import TrackedVehicleVectorEnv

CONTEXT = PolicyContext(0.02, "sliding")
BY_SPEED = PolicyContext(0.02, "sliding", MOCAP, "speed", VEHICLES["focchi"])
NEVER = np.zeros(2, dtype=bool)
ALWAYS = np.ones(2, dtype=bool)
SPEED = obs.INDEX["v_x"]


def observations(steps, count=2):
    """Observations whose speed is the number of the step, plus 100 per row."""
    for step in range(steps):
        batch = np.zeros((count, obs.SIZE), dtype=np.float32)
        batch[:, SPEED] = step + 100.0 * np.arange(count)
        yield batch


def past_speeds(features):
    return features.reshape(len(features), len(LAGS), len(REMEMBERED))[
        :, :, REMEMBERED.index("v_x")
    ]


def test_history_holds_the_samples_at_its_lags():
    history = make_augmentation("history", {}, CONTEXT, 2)
    for step, batch in enumerate(observations(50)):
        features = history.observe(batch, ALWAYS if step == 0 else NEVER)
        expected = np.maximum(step - np.array(LAGS), 0)
        np.testing.assert_array_equal(past_speeds(features)[0], expected)
        np.testing.assert_array_equal(past_speeds(features)[1], expected + 100)
    assert features.shape == (2, len(history.feature_names))


def test_history_forgets_the_rows_that_start_and_no_others():
    history = make_augmentation("history", {"lags": [1, 3]}, CONTEXT, 2)
    for step, batch in enumerate(observations(10)):
        features = history.observe(batch, np.array([step == 0, step in (0, 9)]))
    speeds = features.reshape(2, 2, -1)[:, :, REMEMBERED.index("v_x")]
    np.testing.assert_array_equal(speeds, [[8, 6], [109, 109]])


@pytest.mark.parametrize("kind", KINDS)
def test_a_row_remembers_the_same_alone_and_in_a_batch(kind):
    env = TrackedVehicleVectorEnv(3, uncertainty="payload", duration=1.0)
    batch = make_augmentation(kind, {}, CONTEXT, 3)
    alone = make_augmentation(kind, {}, CONTEXT, 1)
    observation, _ = env.reset(seed=0)
    for step in range(20):
        start = np.full(3, step == 0)
        together = batch.observe(observation, start)
        single = alone.observe(observation[1:2], start[:1])
        np.testing.assert_array_equal(together[1:2], single)
        observation = env.step(np.full((3, 2), 0.3, np.float32))[0]


@pytest.mark.parametrize("context", [CONTEXT, BY_SPEED], ids=["torque", "speed"])
@pytest.mark.parametrize("kind", KINDS)
def test_memories_put_back_in_some_rows_leave_the_others(kind, context):
    options = {"uncertainty": "payload"} if context is CONTEXT else SPEED_V0
    env = TrackedVehicleVectorEnv(3, **options)
    one, other, expected = (make_augmentation(kind, {}, context, 3) for _ in range(3))
    observation, _ = env.reset(seed=0)
    for step in range(10):
        start = np.full(3, step == 0)
        one.observe(observation, start)
        other.observe(observation, start)
        observation = env.step(np.full((3, 2), 0.3, np.float32))[0]
    kept = one.memories()
    stranger = np.roll(observation, 1, axis=0)
    np.testing.assert_array_equal(
        one.observe(stranger, np.zeros(3, bool)), other.observe(stranger, np.zeros(3, bool))
    )
    one.restore(kept, np.array([True, False, True]))
    expected.restore(kept)
    last = expected.observe(observation, np.zeros(3, bool))
    moved = other.observe(observation, np.zeros(3, bool))
    mixed = one.observe(observation, np.zeros(3, bool))
    np.testing.assert_array_equal(mixed[[0, 2]], last[[0, 2]])
    np.testing.assert_array_equal(mixed[1], moved[1])
    assert kind == "blind" or not np.array_equal(mixed[1], last[1])


def test_the_residual_of_zero_is_the_adaptive_policy():
    agents = pytest.importorskip("agents.environments", reason="its wrapper needs the extra `rl`")
    inner = TrackedVehicleVectorEnv(2, uncertainty="mixed", duration=2.0, autoreset_mode="SameStep")
    env = agents.AgentVectorEnv(inner, make_augmentation("residual", {}, CONTEXT, 2))
    plain = TrackedVehicleVectorEnv(2, uncertainty="mixed", duration=2.0, autoreset_mode="SameStep")
    env.reset(seed=0)
    observation, _ = plain.reset(seed=0)
    policy, state, start = AdaptivePolicy(gains=Gains()), None, ALWAYS
    for _ in range(150):  # over the end of an episode
        action, state = policy.predict(observation, state, start)
        observation, *_, terminated, truncated, _ = plain.step(action)
        start = terminated | truncated
        widened = env.step(np.zeros((2, 2), np.float32))[0]
        np.testing.assert_array_equal(widened[:, : obs.SIZE], observation)


def test_the_residual_corrects_the_controller_with_the_gains_of_its_archive():
    """Without gains, as in archives before there were any to tune, those of the paper."""
    seen_by = {}
    for name, options in {
        "none": {},
        "paper": {"gains": list(Gains())},
        "own": {"gains": [200.0]},
    }.items():
        augmentation = make_augmentation("residual", options, CONTEXT, 1)
        observation = np.full((1, obs.SIZE), 0.05, np.float32)
        seen_by[name] = augmentation.observe(observation, np.ones(1, dtype=bool))[:, :2]
    assert np.array_equal(seen_by["none"], seen_by["paper"])
    assert np.abs(seen_by["own"] - seen_by["none"]).max() > 1e-3


def test_the_residual_is_scaled_and_stays_within_the_limits():
    augmentation = make_augmentation("residual", {"scale": 0.5}, CONTEXT, 2)
    features = np.zeros((2, len(augmentation.feature_names)), np.float32)
    features[:, :2] = [[0.1, -0.2], [0.9, -0.9]]
    command = augmentation.command(np.array([[1.0, -0.4], [1.0, -1.0]], np.float32), features)
    np.testing.assert_allclose(command, [[0.6, -0.4], [1.0, -1.0]], atol=1e-7)


def test_the_network_sees_zero_for_what_is_not_measured_and_bounded_features():
    observation = np.zeros((1, obs.SIZE), np.float32)
    observation[0, SPEED] = np.nan
    shown = network_inputs(observation, np.array([[np.inf, -1e9, np.nan]], np.float32))
    assert shown[0, SPEED] == 0.0 and shown[0, -3:].tolist() == [10.0, -10.0, 0.0]


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("elephant", {}, "kinds are blind, history"),
        ("blind", {"lags": [1]}, "options"),
        ("history", {"lags": [0, 1]}, "must rise, from 1"),
        ("history", {"lags": []}, "must rise, from 1"),
        ("residual", {"scale": 0.0}, r"must be in \(0, 2\]"),
        ("residual", {"gains": [50.0, 1.0, 15.0]}, "not Hurwitz"),
    ],
)
def test_wrong_kinds_and_options_are_clear_errors(kind, options, message):
    with pytest.raises(ValueError, match=message):
        make_augmentation(kind, options, CONTEXT, 2)


def test_the_filtered_errors_are_the_true_ones_with_ideal_sensors():
    """In their scales: position error 0.2 m, heading 0.1 rad, speed 0.2 m/s, yaw rate 0.1."""
    env = TrackedVehicleVectorEnv(2, uncertainty="nominal", sensors="ideal")
    augmentation = make_augmentation(
        "residual", {}, PolicyContext(0.02, "sliding", make_sensors("ideal")), 2
    )
    observation, _ = env.reset(seed=0)
    for step in range(20):
        features = augmentation.observe(observation, np.full(2, step == 0))
        known = obs.unpack(observation)
        expected = {
            "filtered_error_x": known["position_error_x"] / 0.2,
            "filtered_error_y": known["position_error_y"] / 0.2,
            "filtered_heading_error": known["heading_error"] / 0.1,
            "filtered_speed_error": (known["reference_speed"] - known["v_x"]) / 0.2,
            "filtered_v_y": known["v_y"] / 0.2,
            "filtered_yaw_rate_error": (known["reference_yaw_rate"] - known["yaw_rate"]) / 0.1,
        }
        for name, values in expected.items() if step > 2 else ():  # the filter has begun
            shown = features[:, augmentation.feature_names.index(name)]
            np.testing.assert_allclose(shown, values, atol=0.005, err_msg=name)
        command = augmentation.command(np.zeros((2, 2), np.float32), features)
        observation = env.step(command)[0]


def test_the_network_sees_how_far_the_filtered_pose_can_be_trusted():
    """Error of the filtered distance over the claimed deviation: its square is about 1."""
    shown = []
    for name in ("rtk", "strawa"):
        sensors = make_sensors(name)
        env = TrackedVehicleVectorEnv(32, sensors=sensors, expose_truth=True)
        augmentation = make_augmentation("residual", {}, CONTEXT._replace(sensors=sensors), 32)
        observation, info = env.reset(seed=0)
        ratios = []
        for step in range(150):
            features = augmentation.observe(observation, np.full(32, step == 0))
            named = dict(zip(augmentation.feature_names, features.T, strict=True))
            deviation = 0.05 * np.exp(named["filtered_position_log_deviation"])
            true = info["tracking_error"][:, 0]
            filtered = 0.2 * np.hypot(named["filtered_error_x"], named["filtered_error_y"])
            ratios.append((filtered - true) ** 2 / deviation**2)
            command = augmentation.command(np.zeros((32, 2), np.float32), features)
            observation, *_, info = env.step(command)
        shown.append(np.median(deviation))
        assert 0.1 < np.mean(ratios[50:]) < 1.5, name
    assert shown[1] > 5.0 * shown[0]
