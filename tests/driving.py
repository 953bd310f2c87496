"""Environments that tests drive, their actions, and comparison of what they return bit for bit."""

import gymnasium
import numpy as np

from tracked_env import TORQUE_ID

ON_PATH = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0}
STILL = {**ON_PATH, "speed": 0.0, "yaw_rate": 0.0}


def make(env_id=TORQUE_ID, **arguments):
    """The unwrapped environment, with short episodes unless told."""
    return gymnasium.make(env_id, **{"duration": 4.0, **arguments}).unwrapped


def run(env, steps, actions=None, seed=0, options=None):
    """Observations, rewards and the last info of an episode under these or random actions."""
    observation, info = env.reset(seed=seed, options=options)
    observations, rewards = [observation], []
    rng = np.random.default_rng(1)
    for k in range(steps):
        action = rng.uniform(-1, 1, 2) if actions is None else actions[k]
        observation, reward, terminated, truncated, info = env.step(np.float32(action))
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(rewards), info


def wild_actions(steps, count, seed=0):
    """Actions that end some episodes early and others by time."""
    rng = np.random.default_rng(seed)
    scale = np.linspace(0.0, 1.0, count)[:, None]
    return (scale * rng.uniform(-1.0, 1.0, (steps, count, 2)) + 0.2).astype(np.float32)


def assert_equal(one, other):
    """Equal bit for bit, through tuples, lists, dicts and arrays of objects."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_equal(one[key], other[key])
    elif isinstance(one, (tuple, list)) or (isinstance(one, np.ndarray) and one.dtype.hasobject):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            assert_equal(left, right)
    else:
        assert np.array_equal(one, other)
