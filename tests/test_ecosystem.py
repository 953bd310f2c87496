"""The environment with the tools that others bring: SB3, Gymnasium's wrappers, rl-zoo, RLlib."""

import json
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RecordVideo
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import tracked_env
from tests.driving import assert_equal
from tests.processes import python
from tracked_env.env import TrackedVehicleEnv, env_creator
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import PRESETS
from tracked_env.vector_env import TrackedVehicleVectorEnv

ID = "tracked_env:tracked_env/Torque-v0"
GENTLE = np.full((3, 2), 0.2, dtype=np.float32)


def statistics(env, steps):
    """(return, length) of every episode that the wrapper reports, and as added up here."""
    env.reset(seed=0)
    reported, counted = [], []
    total, length = np.zeros(3), np.zeros(3, dtype=int)
    for _ in range(steps):
        _, reward, terminated, truncated, info = env.step(GENTLE)
        over = terminated | truncated
        resting = (reward == 0.0) & ~over  # the step in which NEXT_STEP resets
        total, length = total + reward, length + ~resting
        if over.any():
            episode = info["episode"]
            reported += zip(episode["r"][over], episode["l"][over], strict=True)
            counted += zip(total[over], length[over], strict=True)
            total[over], length[over] = 0.0, 0
    return reported, counted


def test_an_agent_trained_by_id_learns_and_is_saved_normalised_and_loaded_again(tmp_path):
    model = PPO("MlpPolicy", ID, n_steps=64, batch_size=64, n_epochs=2, device="cpu", seed=0)
    before = [p.detach().clone() for p in model.policy.parameters()]
    env = VecNormalize(model.get_env())
    model.set_env(env)
    model.learn(128)
    after = list(model.policy.parameters())
    assert model.num_timesteps == 128 and all(p.isfinite().all() for p in after)
    assert not all((a == b).all() for a, b in zip(before, after, strict=True))
    model.save(tmp_path / "agent.zip")
    observation = env.reset()
    loaded = PPO.load(tmp_path / "agent.zip", device="cpu")
    ours, theirs = (one.predict(observation, deterministic=True)[0] for one in (model, loaded))
    assert ours.shape == (1, 2) and np.array_equal(ours, theirs)


def test_every_mode_of_make_vec_gives_the_same_numbers():
    modes = {
        None: TrackedVehicleVectorEnv,
        "sync": gymnasium.vector.SyncVectorEnv,
        "async": gymnasium.vector.AsyncVectorEnv,
    }
    readings = []
    for mode, kind in modes.items():
        env = gymnasium.make_vec(ID, num_envs=3, vectorization_mode=mode, uncertainty="payload")
        assert isinstance(env, kind)
        observations = [env.reset(seed=5)[0].copy()]
        observations += [env.step(GENTLE)[0].copy() for _ in range(10)]
        env.close()
        readings.append(np.array(observations))
    assert np.array_equal(readings[0], readings[1]) and np.array_equal(readings[0], readings[2])


def test_wrappers_of_single_environments_go_into_make_vec():
    rescale = partial(gymnasium.wrappers.RescaleAction, min_action=0.0, max_action=1.0)
    arguments = {"num_envs": 2, "duration": 0.2}
    env = gymnasium.make_vec(ID, **arguments, vectorization_mode="sync", wrappers=[rescale])
    twin = gymnasium.make_vec(ID, **arguments)
    assert np.array_equal(env.reset(seed=0)[0], twin.reset(seed=0)[0])
    half = env.step(np.full((2, 2), 0.75, np.float32))[0]
    assert np.array_equal(half, twin.step(np.full((2, 2), 0.5, np.float32))[0])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_statistics_of_a_vector_in_both_autoreset_modes(mode):
    env = gymnasium.make_vec(ID, num_envs=3, duration=0.4, autoreset_mode=mode)
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(env)
    reported, counted = statistics(env, 45)
    assert len(reported) == 6
    assert np.allclose(reported, counted, atol=1e-5)
    assert {length for _, length in reported} == {20}


def test_a_video_of_one_environment(tmp_path):
    env = gymnasium.make(ID, duration=0.1, render_mode="rgb_array")
    env = RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: episode == 0)
    env.reset(seed=0)
    while not env.step(GENTLE[0])[3]:
        pass
    env.close()
    assert [path.name for path in tmp_path.glob("*.mp4")] == ["rl-video-episode-0.mp4"]


def test_a_time_limit_cuts_an_episode_which_is_then_no_success():
    for limit, length, success in ((10, 10, False), (1000, 20, True)):
        env = gymnasium.make(ID, duration=0.4, max_episode_steps=limit)
        env.reset(seed=0)
        for step in range(1, length + 1):
            _, _, terminated, truncated, info = env.step(GENTLE[0])
            assert not terminated and truncated == (step == length)
        assert info["is_success"] is success


def test_a_time_limit_of_the_registration_holds_for_the_vector():
    name = "tracked_env_tests/Limited-v0"
    gymnasium.register(
        name,
        vector_entry_point="tracked_env.vector_env:TrackedVehicleVectorEnv",
        max_episode_steps=10,
        kwargs={"duration": 0.4},
    )
    env = gymnasium.make_vec(name, num_envs=3)
    del gymnasium.registry[name]
    env.reset(seed=2)
    assert [env.step(GENTLE)[3].all() for _ in range(10)] == [False] * 9 + [True]


@pytest.mark.parametrize("name", [tracked_env.TORQUE_ID, tracked_env.SPEED_ID])
def test_an_id_has_no_step_limit_so_that_a_longer_duration_is_driven_to_its_end(name):
    assert gymnasium.spec(name).max_episode_steps is None
    env = gymnasium.make(
        name, duration=40.0, control_rate=40.0, error_limit=1e6, reference="circle"
    )
    env.reset(seed=0)
    for step in range(1, 1601):
        _, _, terminated, truncated, _ = env.step(np.zeros(2, np.float32))
        assert not terminated and truncated == (step == 1600)


@pytest.mark.parametrize(
    ("arguments", "steps"),
    [({}, 1500), ({"duration": 0.3}, 15), ({"duration": 0.33, "control_rate": 20.0}, 7)],
)
def test_an_environment_of_make_says_how_many_steps_it_has_and_cuts_none(arguments, steps):
    env = tracked_env.make(ID, error_limit=1e6, **arguments)
    envs = tracked_env.make_vec(ID, 3, error_limit=1e6, **arguments)
    assert env.spec.max_episode_steps == envs.spec.max_episode_steps == steps
    env.reset(seed=2), envs.reset(seed=2)
    for step in range(1, steps + 1):
        _, reward, terminated, truncated, info = env.step(GENTLE[0])
        many = envs.step(GENTLE)
        assert not terminated and truncated == (step == steps)
        assert (reward, truncated) == (many[1][0], many[3][0])
    assert info["is_success"] == many[4]["is_success"][0]


def test_a_limit_of_the_arguments_or_of_the_id_stays_and_other_vectors_are_made():
    assert tracked_env.make(ID, max_episode_steps=10).spec.max_episode_steps == 10
    env = tracked_env.make_vec(ID, 2, vectorization_mode="sync", duration=0.1)
    assert isinstance(env, gymnasium.vector.SyncVectorEnv)


def test_observations_with_the_time_go_to_its_end():
    env = tracked_env.make(tracked_env.SPEED_ID, duration=0.2)
    env = gymnasium.wrappers.TimeAwareObservation(env, normalize_time=True)
    assert env.reset(seed=0)[0][-1] == 0.0
    times = [env.step(GENTLE[0])[0][-1] for _ in range(10)]
    np.testing.assert_allclose(times, np.arange(1, 11) / 10, rtol=1e-6)


ROBOT = """
base = "focchi"
mass = 60.0
torque_limit = 90.0
"""
RECORDED = {
    "parameters": {"vehicle": VEHICLES["focchi"]._replace(mass=70.0)},
    "dict": {"vehicle": {"base": "focchi", "mass": 61.0}},
    "file": {"vehicle": Path("robot.toml")},
    "name of a file": {"vehicle": "robot.toml"},
    "sensors": {"sensors": PRESETS["strawa"]._replace(pose_delay=0.04)},
    "sensors of the vehicle": {"vehicle": "focchi", "sensors": "rtk"},
    "points": {"reference": {"kind": "waypoints", "points": np.array([[0, 0], [9.0, 1.0]])}},
    "tuples": {"observation": ("motion", "pose_error"), "patches": (np.int64(6), 2)},
    "reward": {"reward": {"speed": {"weight": np.float64(0.3)}}, "costs": {"slip": 0.0}},
}


@pytest.mark.parametrize("arguments", RECORDED.values(), ids=RECORDED)
@pytest.mark.parametrize("make", [gymnasium.make, tracked_env.make])
def test_a_specification_in_json_makes_an_equal_environment(make, arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot.toml").write_text(ROBOT)
    if "patches" in arguments:
        arguments = {**arguments, "plant": "distributed"}
    env = make(tracked_env.TORQUE_ID, duration=0.5, **arguments)
    text = env.spec.to_json()
    Path("robot.toml").unlink()  # what it said is in the text
    other = gymnasium.make(gymnasium.envs.registration.EnvSpec.from_json(text))
    assert other.spec.to_json() == text
    assert other.unwrapped.simulation.solver.nominal == env.unwrapped.simulation.solver.nominal
    assert_equal(other.reset(seed=3), env.reset(seed=3))
    for _ in range(5):
        assert_equal(other.step(GENTLE[0]), env.step(GENTLE[0]))


def test_the_specification_of_a_vector_in_json_makes_an_equal_vector():
    arguments = {"vehicle": VEHICLES["focchi"], "sensors": PRESETS["mocap"], "duration": 0.5}
    envs = tracked_env.make_vec(tracked_env.SPEED_ID, 2, **arguments)
    spec = gymnasium.envs.registration.EnvSpec.from_json(envs.spec.to_json())
    other = gymnasium.make_vec(spec, 2)
    assert spec.max_episode_steps == other.spec.max_episode_steps == 25
    assert_equal(other.reset(seed=3), envs.reset(seed=3))


@pytest.mark.slow
def test_rl_zoo_finds_the_id_after_importing_the_package():
    # What rl_zoo3.train does with --gym-packages tracked_env --env tracked_env/Torque-v0.
    code = """
import importlib, json
import gymnasium as gym
for module in ["tracked_env"]:
    importlib.import_module(module)
registered = set(gym.envs.registry.keys())
spec = gym.spec("tracked_env/Torque-v0")
from stable_baselines3.common.env_util import make_vec_env
env = make_vec_env(lambda **kwargs: spec.make(**kwargs), n_envs=1, env_kwargs={"duration": 1.0})
print(json.dumps([spec.id in registered, "tracked_env:" + spec.id in registered,
                  spec.entry_point, list(env.reset().shape)]))
"""
    # The form with the module in front is no registered id: rl-zoo would refuse it.
    entry_point = "tracked_env.env:TrackedVehicleEnv"
    assert json.loads(python("-c", code).stdout) == [True, False, entry_point, [1, 31]]


class EnvContext(dict):
    """As RLlib hands it over: the env_config with attributes about the worker."""

    def __init__(self, *args, worker_index=0, vector_index=0):
        super().__init__(*args)
        self.worker_index, self.vector_index = worker_index, vector_index


def test_the_env_creator_makes_what_rllib_asks_for():
    context = EnvContext({"uncertainty": "payload", "duration": 2.0}, worker_index=3)
    env = env_creator(context)
    assert isinstance(env, TrackedVehicleEnv)
    assert env.simulation.config.uncertainty == "payload"
    twin = TrackedVehicleEnv(uncertainty="payload", duration=2.0)
    assert np.array_equal(env.reset(seed=4)[0], twin.reset(seed=4)[0])
    assert env_creator(EnvContext()).simulation.config.uncertainty == "soil-and-mass"
    assert env_creator(None).observation_space == env.observation_space
    check_env(env_creator({}), skip_render_check=True)
    for wrong, says in (({"uncertanty": "payload"}, "mean 'uncertainty'"), ([1], "must be a dict")):
        with pytest.raises(ValueError, match=says):
            env_creator(wrong)
