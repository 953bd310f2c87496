"""Copied and unpickled environments: bit for bit the same, and independent of the original."""

import copy
import pickle

import cloudpickle
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit
from stable_baselines3.common.vec_env import SubprocVecEnv

from baselines.estimators.stack import IdentificationStack
from tests.driving import assert_equal
from tests.test_rewards import COSTS, SHARP, compiled, of_arrays
from tests.test_uncertainty import Heavier, heavy_then_light
from tracked_env import SPEED, SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sb3 import make_vec_env
from tracked_env.vector_env import TrackedVehicleVectorEnv
from tracked_env.wrappers import IdentifiedObservation, IdentifiedVectorObservation

COPIES = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
}
SHORT = {"duration": 0.5}
LATE = {"pose_delay": 0.1, "drive_rate": 10.0, "inertial_dropout": 0.2}
CHANGES = [
    {"parameter": "mass", "kind": "ramp", "target": 2500.0, "start": 0.1, "duration": 0.2},
    {"parameter": "cohesion", "kind": "line", "target": 5e3, "x": 0.5, "y": 0.0, "direction": 0.0},
]
RANGES = [{"mass": [1000.0, 2000.0]}, "mixed"]  # a mixture, its laws made for this environment
OUTAGES = {"pose_outage_gap": (0.05, 0.2), "pose_outage_length": (0.2, 0.8)}
TO_GOAL = {
    "reference": {"kind": "plan", "goals": "halton"},
    "error_limit": 0.2,
    "duration": 20.0,
    "observation": ["motion", "goal"],
}
SINGLE = {
    "bare": lambda: TrackedVehicleEnv(**SHORT),
    "made": lambda: gymnasium.make(TORQUE_ID, **SHORT, uncertainty=RANGES, expose_truth=True),
    "delays": lambda: gymnasium.make(TORQUE_ID, duration=2.0, sensors=LATE),  # noise twice drawn
    "constrained": lambda: gymnasium.make(TORQUE_ID, **SHORT, lateral="constrained"),
    "patches": lambda: gymnasium.make(SPEED_ID, **SHORT),
    "terrain": lambda: gymnasium.make(TERRAIN_ID, **SHORT, observation=["height_scan", "motion"]),
    "outages": lambda: TrackedVehicleEnv(duration=2.0, sensors={"preset": "rtk", **OUTAGES}),
    "goal": lambda: TrackedVehicleEnv(**{**SPEED, **TO_GOAL}),
    "law": lambda: TrackedVehicleEnv(**SHORT, uncertainty=heavy_then_light),
    "laws": lambda: TrackedVehicleEnv(**SHORT, uncertainty=["payload", Heavier(2.0)]),
    "reward": lambda: TrackedVehicleEnv(**SHORT, reward=SHARP, costs=COSTS),
    "own reward": lambda: TrackedVehicleEnv(**SHORT, reward=of_arrays, costs=COSTS),
    "compiled reward": lambda: TrackedVehicleEnv(**SHORT, reward=compiled, costs=COSTS),
    "groups": lambda: TrackedVehicleEnv(**SHORT, observation=["motion", "drive"]),
    "wrapped": lambda: RecordEpisodeStatistics(
        TimeLimit(gymnasium.make(TORQUE_ID, **SHORT), max_episode_steps=20)
    ),
    "identified": lambda: IdentifiedObservation(
        gymnasium.make(TORQUE_ID, **SHORT), IdentificationStack()
    ),
    "rendered": lambda: gymnasium.make(TORQUE_ID, **SHORT, render_mode="rgb_array"),
}


def action(k, count=None):
    """A changing action, (2,) or (count, 2)."""
    one = np.float32([0.3 + 0.2 * np.sin(k), 0.3 + 0.2 * np.cos(0.7 * k)])
    return one if count is None else np.tile(one, (count, 1))


def without_clock(info):
    """The info without what depends on the wall clock."""
    episode = {k: v for k, v in info.get("episode", {}).items() if k != "t"}
    return {**info, "episode": episode}


def drive(env, steps, first=0):
    """All that `steps` steps return, with a reset without a seed after every end."""
    readings = []
    for k in range(first, first + steps):
        observation, reward, terminated, truncated, info = env.step(action(k))
        readings.append((observation, reward, terminated, truncated, without_clock(info)))
        if terminated or truncated:
            readings.append(env.reset())
    return readings


@pytest.mark.parametrize("kind", SINGLE)
@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("steps", [0, 7])
def test_a_copy_goes_on_bit_for_bit_and_moves_nothing_of_the_original(kind, how, steps):
    env = SINGLE[kind]()
    options = {"schedule": CHANGES} if kind == "made" else None
    env.reset(seed=3, options=options)
    drive(env, steps)
    if kind == "rendered":
        env.render()
    twin = COPIES[how](env)
    ahead = drive(env, 110, steps)
    assert any(len(entry) == 2 for entry in ahead)  # over the end of an episode
    assert_equal(ahead, drive(twin, 110, steps))
    if kind == "rendered":
        assert env.render().shape == twin.render().shape
    twin.close()
    env.close()


@pytest.mark.parametrize("how", COPIES)
def test_a_copy_made_before_the_first_reset_draws_the_same_episode(how):
    env = gymnasium.make(TORQUE_ID, **SHORT)
    twin = COPIES[how](env)
    assert_equal(env.reset(seed=5), twin.reset(seed=5))
    assert_equal(drive(env, 40), drive(twin, 40))
    unseeded = COPIES[how](TrackedVehicleEnv())
    assert unseeded.reset()[0].shape == env.observation_space.shape


def test_the_generator_of_an_environment_is_that_of_its_vehicle_also_in_copies():
    env = TrackedVehicleEnv()
    env.reset(seed=1)
    for one in (env, *(make(env) for make in COPIES.values())):
        assert one.np_random is one.simulation.rngs[0]
    env.np_random = np.random.default_rng(4)
    assert env.simulation.rngs[0] is env.np_random


@pytest.mark.parametrize("env_id", [TORQUE_ID, SPEED_ID])
def test_a_resumed_snapshot_restores_reward_flags_and_the_stream_of_the_next_episode(env_id):
    env = gymnasium.make(env_id, **SHORT).unwrapped
    env.reset(seed=2)
    drive(env, 5)
    snapshot = pickle.loads(pickle.dumps(env.simulation.snapshot()))
    ahead = drive(env, 60, 5)
    env.simulation.resume(snapshot)
    assert_equal(ahead, drive(env, 60, 5))
    fresh = gymnasium.make(env_id, **SHORT).unwrapped
    fresh.simulation.resume(snapshot)
    assert_equal(ahead, drive(fresh, 60, 5))


# --- many vehicles --------------------------------------------------------------------------

HARD = {"uncertainty": "mixed", "duration": 0.6, "error_limit": 0.5, "expose_truth": True}


def drive_all(env, steps, first=0):
    """Copies of all that `steps` steps of a vector environment return."""
    count = env.num_envs
    return [copy.deepcopy(env.step(action(k, count))) for k in range(first, first + steps)]


def assert_all_same(ahead, others):
    assert any((step[2] | step[3]).any() for step in ahead)
    assert_equal(ahead, others)


@pytest.mark.parametrize("how", COPIES)
@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_copied_vector_environment_goes_on_bit_for_bit(how, mode):
    env = TrackedVehicleVectorEnv(5, **HARD, sensors=LATE, autoreset_mode=mode)
    env.reset(seed=1, options={"staggered": True, "schedule": CHANGES})
    drive_all(env, 12)
    twin = COPIES[how](env)
    ahead = drive_all(env, 60, 12)
    assert_all_same(ahead, drive_all(twin, 60, 12))


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_snapshot_taken_while_rows_are_over_resumes_in_a_fresh_vector_environment(mode):
    env = TrackedVehicleVectorEnv(4, **HARD, autoreset_mode=mode)
    env.reset(seed=1, options={"staggered": True})
    drive_all(env, 8)  # the first row's episode has just ended
    assert env.simulation.some_ended
    snapshot = env.simulation.snapshot()
    ahead = drive_all(env, 60, 8)
    fresh = TrackedVehicleVectorEnv(4, **HARD, autoreset_mode=mode)
    fresh.simulation.resume(snapshot)
    assert_all_same(ahead, drive_all(fresh, 60, 8))


@pytest.mark.parametrize("how", COPIES)
def test_a_vector_environment_that_has_used_its_threads_can_be_copied(how):
    env = TrackedVehicleVectorEnv(600, threads=2)
    env.reset(seed=0)
    drive_all(env, 2)
    assert env.simulation._threads._pool
    twin = COPIES[how](env)
    for k in range(3):
        assert np.array_equal(env.step(action(k, 600))[0], twin.step(action(k, 600))[0])
    env.close()
    assert np.isfinite(twin.step(action(0, 600))[0]).all()  # its threads are its own
    twin.close()


@pytest.mark.parametrize("how", COPIES)
def test_observers_and_the_interface_of_stable_baselines3_are_copied_with_the_environment(how):
    arguments = {"duration": 0.4, "autoreset_mode": "SameStep"}
    env = IdentifiedVectorObservation(
        TrackedVehicleVectorEnv(3, **arguments), IdentificationStack(count=3)
    )
    env.reset(seed=0)
    drive_all(env, 5)
    twin = COPIES[how](env)
    assert_all_same(drive_all(env, 30, 5), drive_all(twin, 30, 5))
    adapter = make_vec_env(n_envs=3, seed=0, env_kwargs={"duration": 0.4}, monitor=False)
    adapter.reset()
    adapter.step(action(0, 3))
    other = COPIES[how](adapter)
    for k in range(30):
        one, two = adapter.step(action(k, 3)), other.step(action(k, 3))
        for left, right in zip(one[:3], two[:3], strict=True):
            assert np.array_equal(left, right)


@pytest.mark.slow
def test_copies_run_in_other_processes():
    env = gymnasium.make(TORQUE_ID, **SHORT)
    env.reset(seed=3)
    drive(env, 3)
    twin = pickle.loads(pickle.dumps(env))
    theirs = SubprocVecEnv([lambda: env])  # cloudpickled into the other process
    gymnasium_s = AsyncVectorEnv([lambda: twin])
    theirs.seed(3)
    first = theirs.reset()
    gymnasium_s.reset(seed=3)
    here, _ = env.reset(seed=3)
    assert np.array_equal(first[0], here)
    for k in range(25):
        observation, reward, _, truncated, _ = env.step(action(k))
        observations, rewards, dones, infos = theirs.step(action(k, 1))
        readings, gains, _, ends, _ = gymnasium_s.step(action(k, 1))
        assert rewards[0] == gains[0] == reward and dones[0] == ends[0] == truncated
        last = infos[0]["terminal_observation"] if truncated else observations[0]
        assert np.array_equal(last, observation) and np.array_equal(readings[0], observation)
    assert truncated
    theirs.close()
    gymnasium_s.close()
