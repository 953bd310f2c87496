"""`tracked_env/Speed-v0`, and the distributed plant in both environments."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from tests.test_env import run
from tests.test_vector_env import assert_same, wild_actions
from tracked_env import SPEED, SPEED_ID, TORQUE_ID
from tracked_env import observation as obs
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import VEHICLES
from tracked_env.vector_env import TrackedVehicleVectorEnv

BY_TORQUE = {"plant": "distributed", "uncertainty": "loose-soil"}
STRAIGHT = {"kind": "straight", "speed": 0.3}
CALM = {"reference": STRAIGHT, "uncertainty": "nominal", "sensors": "ideal", "expose_truth": True}
ON_PATH = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0}


def make(env_id=SPEED_ID, **arguments):
    return gymnasium.make(env_id, **{"duration": 4.0, **arguments}).unwrapped


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "env_id, arguments",
    [
        (SPEED_ID, {}),
        *((SPEED_ID, {"uncertainty": name}) for name in ("friction-step", "floor-ood")),
        (SPEED_ID, {"vehicle": "focchi-short", "patches": [7, 3], "sensors": "rtk"}),
        (SPEED_ID, {"vehicle": "strawa", "uncertainty": "loose-soil"}),
        (TORQUE_ID, BY_TORQUE),
        (TORQUE_ID, {**BY_TORQUE, "vehicle": "focchi", "uncertainty": "friction"}),
    ],
)
def test_both_environment_checkers_pass_without_a_warning(env_id, arguments):
    check_env(make(env_id, **arguments), skip_render_check=True)
    sb3_check_env(make(env_id, **arguments), skip_render_check=True)


def test_both_ids_are_one_class_and_show_the_same_observation():
    speed, torque = make(), make(TORQUE_ID)
    assert type(speed) is type(torque) is TrackedVehicleEnv
    assert speed.observation_space == torque.observation_space
    assert speed.action_space == torque.action_space


def test_an_action_is_the_sprocket_speed_over_its_limit():
    env = make(**CALM)
    options = {"start": ON_PATH}
    observations, _, info = run(env, 100, np.tile([0.3, 0.5], (100, 1)), options=options)
    truth = info["truth"]
    limit = VEHICLES["focchi"].sprocket_speed_limit
    assert truth["sprocket_speed_left"] == pytest.approx(0.3 * limit, rel=1e-6)
    assert truth["sprocket_speed_right"] == pytest.approx(0.5 * limit, rel=1e-6)
    assert truth["yaw_rate"] > 0.05
    assert obs.unpack(observations[-1])["sprocket_speed_right"] == pytest.approx(0.5 * limit, 1e-5)


def test_a_drive_that_lags_follows_its_demand_exponentially():
    env = make(**CALM)
    options = {"start": {**ON_PATH, "speed": 0.0}, "vehicle": {"drive_time_constant": 0.1}}
    _, _, info = run(env, 5, np.full((5, 2), 0.4), options=options)  # 0.1 s
    expected = 4.0 * (1.0 - np.exp(-1.0))
    assert info["truth"]["sprocket_speed_left"] == pytest.approx(expected, rel=1e-6)


def test_straight_on_the_drag_is_the_rolling_resistance():
    env = make(**CALM)
    _, _, info = run(env, 200, np.full((200, 2), 0.35), options={"start": ON_PATH})
    truth = info["truth"]
    drag = 0.025 * 62.0 * 9.81 / 2.0
    assert truth["effort_left"] == pytest.approx(drag, rel=1e-3)
    assert truth["torque_left"] == pytest.approx(drag * 0.0856, rel=1e-3)
    assert 0.0 < truth["slip_left"] < 0.01


def test_torque_on_patches_spins_up_the_sprocket_before_the_vehicle():
    slippery = {"friction_angle": 0.05, "cohesion": 0.0, "longitudinal_resistance": 0.0}
    env = make(TORQUE_ID, plant="distributed", **{**CALM, "reference": "straight"})
    options = {"soil": slippery, "start": {**ON_PATH, "speed": 0.0}}
    _, _, info = run(env, 10, np.full((10, 2), 0.5), options=options)
    truth = info["truth"]
    belt = truth["sprocket_speed_left"] * truth["sprocket_radius"]
    strength = 0.5 * truth["mass"] * 9.81 * np.tan(0.05)
    assert truth["effort_left"] == pytest.approx(strength, rel=0.02)
    assert belt > 5.0 * truth["v_x"] > 0.0
    assert belt < truth["sprocket_speed_limit"] * truth["sprocket_radius"]


def test_a_sprocket_that_spins_is_held_back_by_its_inertia():
    slippery = {"friction_angle": 0.05, "cohesion": 0.0, "longitudinal_resistance": 0.0}
    env = make(TORQUE_ID, plant="distributed", **{**CALM, "reference": "straight"})
    options = {"soil": slippery, "start": {**ON_PATH, "speed": 0.0}}
    _, _, info = run(env, 3, np.full((3, 2), 0.5), options=options)
    truth, t, lag = info["truth"], 0.06, 0.05
    strength = 0.5 * truth["mass"] * 9.81 * np.tan(0.05)
    pushed = 0.5 * 8000.0 / 0.3 * (t - lag * (1.0 - np.exp(-t / lag)))
    belt = 0.3**2 / truth["sprocket_inertia"] * (pushed - strength * t)
    assert truth["sprocket_speed_left"] * 0.3 == pytest.approx(belt, rel=0.02)


def test_an_episode_starts_with_belts_that_roll():
    env = make(**CALM)
    start = {**ON_PATH, "speed": 0.4, "yaw_rate": 0.5}
    _, info = env.reset(seed=0, options={"start": start})
    truth = info["truth"]
    assert truth["sprocket_speed_left"] * 0.0856 == pytest.approx(0.4 - 0.303 * 0.5)
    assert truth["sprocket_speed_right"] * 0.0856 == pytest.approx(0.4 + 0.303 * 0.5)


@pytest.mark.parametrize(
    "env_id, arguments", [(SPEED_ID, CALM), (TORQUE_ID, {**CALM, **BY_TORQUE})]
)
def test_exchanging_left_and_right_mirrors_the_episode_exactly(env_id, arguments):
    actions = np.random.default_rng(3).uniform(-1, 1, (150, 2))
    arguments = {**arguments, "uncertainty": "nominal"}
    env = make(env_id, **arguments)
    one, reward, _ = run(env, 150, actions, options={"start": ON_PATH})
    other, mirrored, _ = run(env, 150, actions[:, ::-1], options={"start": ON_PATH})
    np.testing.assert_array_equal(obs.mirror(one), other)
    np.testing.assert_array_equal(reward, mirrored)


@pytest.mark.parametrize("arguments", [SPEED, BY_TORQUE], ids=["speed", "torque"])
def test_rows_threads_and_single_environments_agree_to_the_bit(arguments):
    hard = {**arguments, "duration": 1.0, "error_limit": 0.5, "expose_truth": True}
    count, mode = 20, AutoresetMode.SAME_STEP
    threaded = TrackedVehicleVectorEnv(count, **hard, autoreset_mode=mode, threads=3)
    plain = TrackedVehicleVectorEnv(count, **hard, autoreset_mode=mode, threads=1)
    single = TrackedVehicleEnv(**hard)
    first, _ = threaded.reset(seed=5)
    assert_same(first, plain.reset(seed=5)[0])
    assert_same(first[7], single.reset(seed=12)[0])
    alive, ends = True, 0
    for actions in wild_actions(120, count):
        one, other = threaded.step(actions), plain.step(actions)
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
        ends += int((one[2] | one[3]).sum())
        if alive:
            observation, reward, *over, _ = single.step(actions[7])
            alive = not any(over)
            if alive:
                assert_same(one[0][7], observation)
                assert one[1][7] == reward
    assert ends > 10
    threaded.close()


def test_a_snapshot_of_patches_resumes_to_the_bit():
    env = TrackedVehicleVectorEnv(6, **SPEED)
    env.reset(seed=1)
    actions = wild_actions(60, 6)
    for action in actions[:30]:
        env.step(action)
    kept = env.simulation.snapshot()
    ahead = [env.step(action)[0].copy() for action in actions[30:]]
    env.simulation.resume(kept)
    for action, expected in zip(actions[30:], ahead, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], expected)


@pytest.mark.parametrize(
    "arguments, says",
    [
        ({"drive": "speed"}, "needs plant"),
        ({"plant": "patches"}, "unknown plant 'patches'"),
        ({"drive": "sped"}, "Did you mean 'speed'"),
        ({"vehicle": "tank"}, "unknown vehicle 'tank'"),
        ({"plant": "distributed", "patches": [10]}, "must be two numbers"),
        ({"plant": "distributed", "patches": [0, 4]}, "patches along"),
        ({"plant": "distributed", "patches": [10, 4.5]}, "patches across"),
    ],
)
def test_wrong_arguments_are_refused(arguments, says):
    with pytest.raises(ValueError, match=says):
        TrackedVehicleEnv(**arguments)


def test_success_is_measured_in_contact_lengths():
    env = make(**{**CALM, "duration": 1.0})
    for speed, succeeds in ((0.35, True), (0.0, False)):
        # Standing still the vehicle is 0.3 m behind after 1 s: an RMSE of 0.17 m, and l/4 = 0.175.
        start = {**ON_PATH, "offset_x": 0.0 if succeeds else -0.1}
        _, _, info = run(env, 60, np.full((60, 2), speed), options={"start": start})
        assert info["is_success"] is succeeds


def test_nothing_becomes_nan_under_the_wildest_actions_on_ice():
    env = TrackedVehicleVectorEnv(
        32, **{**SPEED, "uncertainty": "floor-ood", "error_limit": 1e6}, autoreset_mode="SameStep"
    )
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for k in range(300):
        action = rng.choice([-1.0, 0.0, 1.0, 1e-7], (32, 2)).astype(np.float32)
        observation, reward, *_ = env.step(action if k % 3 else np.zeros_like(action))
        assert np.isfinite(observation).all()
        assert np.isfinite(reward).all()
