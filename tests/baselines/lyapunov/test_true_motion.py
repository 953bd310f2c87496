"""Policies with the true pose: they drive as those with perfect sensors, whatever poses say."""

import numpy as np
import pytest

from baselines.registry import POLICIES
from tracked_env import SPEED_ID, TERRAIN_ID, make_vec
from tracked_env.benchmark import BenchmarkConfig, PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sensors import make_sensors

NAMES = {SPEED_ID: ("slc-adaptive", "mpc-adaptive"), TERRAIN_ID: ("slc-adaptive",)}
CASES = [(env, name) for env, names in NAMES.items() for name in names]


def drive(env_id, name, sensors, steps=60, count=4):
    """Actions (steps, count, 2)."""
    env = make_vec(env_id, num_envs=count, sensors=sensors, expose_truth=True)
    sheet = make_sensors(sensors, torque_limit=VEHICLES["focchi"].torque_limit)
    context = PolicyContext(0.02, "sliding", sheet, "speed", VEHICLES["focchi"])
    context = context._replace(observation=env.unwrapped.layout.names)
    policy, state, actions = POLICIES[name](context), None, []
    observation, info = env.reset(seed=3)
    for _ in range(steps):
        if name.endswith("true-motion"):
            policy.observe_truth(info["truth"])
        action, state = policy.predict(observation, state)
        actions.append(action)
        observation, _, _, _, info = env.step(action)
    return np.array(actions)


@pytest.mark.parametrize(("env_id", "name"), CASES)
def test_with_perfect_sensors_the_truth_changes_nothing(env_id, name):
    plain = drive(env_id, name, "ideal")
    told = drive(env_id, f"{name}-true-motion", "ideal")
    np.testing.assert_allclose(told, plain, atol=2e-4)
    assert np.abs(np.diff(told, axis=0)).max() > 0.005


@pytest.mark.parametrize(("env_id", "name"), CASES)
def test_errors_of_the_position_do_not_reach_it(env_id, name):
    noisy = {"preset": "ideal", "position_noise": 0.05}
    exact = drive(env_id, f"{name}-true-motion", "ideal")
    np.testing.assert_array_equal(drive(env_id, f"{name}-true-motion", noisy), exact)
    assert np.abs(drive(env_id, name, noisy) - exact).max() > 0.01


def test_in_outages_it_stays_on_its_path():
    """A set where dead reckoning has to bridge outages: the true pose is worth a third."""
    config, errors = BenchmarkConfig(sets=("often-floors-outages",)), {}
    for name in ("slc-adaptive", "slc-adaptive-true-motion"):
        env = config.environment("often-floors-outages", 8, True)
        policy, state = POLICIES[name](config.context("often-floors-outages")), None
        observation, info = env.reset(seed=[*range(50000, 50008)])
        column, away = env.simulation.batch.column, []
        for _ in range(1490):
            if name.endswith("true-motion"):
                policy.observe_truth(info["truth"])
            action, state = policy.predict(observation, state)
            observation, _, _, _, info = env.step(action)
            gone = column("reference_x") - column("x"), column("reference_y") - column("y")
            away.append(np.hypot(*gone))
        errors[name] = np.sqrt(np.mean(np.square(away[250:])))
    assert errors["slc-adaptive-true-motion"] < 0.8 * errors["slc-adaptive"]
