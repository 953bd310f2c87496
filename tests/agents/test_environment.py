"""Further arguments of the environment reach the vehicles, the policies and the recipe."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from agents.archive import agent_entry
from agents.checkpoint import layers
from agents.environments import (
    TrainingReward,
    make_environment,
    make_part,
)
from agents.folder import (
    AlreadyFinished,
    going_on,
    make_held_out,
)
from agents.options import Options
from agents.run import MIXTURE, PRECISION, environment_of, resolve
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import CONTEXT, archive_of, small
from tests.test_vehicles import ROBOT
from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env import observation as obs
from tracked_env.benchmark import BenchmarkConfig, PolicyContext
from tracked_env.env import TrackedVehicleEnv
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import make_vec_env
from tracked_env.sensors import MOCAP
from tracked_env.vehicles import find_vehicle, vehicle_toml
from train import main

BY_SPEED = '{"plant": "distributed", "drive": "speed", "error_limit": 2, "control_rate": 25}'


def simulation_of(env):
    """The simulation of an environment of a training."""
    return layers(env)[-1]


def test_an_agent_of_another_plant_trains_and_loads(tmp_path):
    config = small(tmp_path, env_args='{"plant": "distributed", "patches": [4, 2]}', steps=256)
    run = resolve(config)
    driven = [simulation_of(make_environment(run))]
    driven += [part.env.simulation for part in make_held_out(run)]
    assert len(driven) == 2
    for simulation in driven:
        solver = simulation.solver
        assert solver.plant.name == "distributed"
        assert len(solver.prepared.options.patches.columns) == 4
    recipe = read_recipe(archive_of(config))
    assert recipe["environment"]["plant"] == "distributed"
    assert recipe["environment"]["patches"] == [4, 2]
    assert recipe["config"]["env_args"] == config.env_args
    agent_entry(tmp_path / "agent.zip").make(CONTEXT)


def test_drive_vehicle_and_control_rate_reach_policy_reward_and_recipe(tmp_path):
    config = small(
        tmp_path,
        vehicle="focchi",
        env_args=BY_SPEED,
        augmentation="residual",
        uncertainty=("friction",),
        sensors=("mocap",),
        steps=256,
    )
    run = resolve(config)
    (part,) = run.parts
    assert (part.context.drive, part.context.vehicle) == ("speed", VEHICLES["focchi"])
    assert part.context.control_period == 0.04
    (held_out,) = make_held_out(run)
    assert held_out.context == part.context
    (reward,) = (
        layer for layer in layers(make_part(run, part)) if isinstance(layer, TrainingReward)
    )
    assert reward.precision == PRECISION * VEHICLES["focchi"].contact_length
    entry = agent_entry(archive_of(config))
    policy = entry.make(part.context)
    assert policy.augmentation.policy.parameters == VEHICLES["focchi"]
    assert read_recipe(tmp_path / "last.zip")["control_period"] == 0.04
    with pytest.raises(ValueError, match="trained to command each sprocket's speed"):
        entry.make(CONTEXT._replace(control_period=0.04))
    with pytest.raises(ValueError, match=r"period of 0\.04 s; this environment has 0\.02 s"):
        entry.make(part.context._replace(control_period=0.02))


def test_estimators_inside_an_agent_know_the_nominal_vehicle(tmp_path):
    config = small(tmp_path, vehicle="focchi", augmentation="estimates", steps=128)
    (part,) = resolve(config).parts
    augmentation = agent_entry(archive_of(config)).make(part.context).augmentation
    assert augmentation.stack.parameters == VEHICLES["focchi"]


def test_an_environment_id_keeps_its_arguments_where_none_is_given(tmp_path):
    config = small(tmp_path, env=SPEED_ID, vehicle="focchi-short")
    run = resolve(config)
    (part,) = run.parts
    assert (part.context.drive, part.context.vehicle) == ("speed", VEHICLES["focchi-short"])
    solver = simulation_of(make_part(run, part)).solver
    assert solver.plant.name == "distributed" and solver.nominal == VEHICLES["focchi-short"]
    assert solver.error_limit == 2.0


def test_an_agent_keeps_the_values_of_a_vehicle_and_not_the_name_of_its_file(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(vehicle_toml(ROBOT), encoding="utf-8")
    config = small(tmp_path / "out", vehicle=str(path), steps=128)
    (part,) = resolve(config).parts
    own = find_vehicle(ROBOT)
    assert part.context.vehicle == own
    assert simulation_of(make_part(resolve(config), part)).solver.nominal == own
    recipe = read_recipe(archive_of(config))
    assert recipe["environment"]["vehicle"] == recipe["config"]["vehicle"] == own._asdict()
    path = path.rename(tmp_path / "another.toml")
    again = replace(config, vehicle=str(path), resume=True)
    with pytest.raises(AlreadyFinished):
        going_on(resolve(again))
    path.write_text(vehicle_toml({**ROBOT, "mass": 61.0}), encoding="utf-8")
    with pytest.raises(ValueError, match="different are vehicle"):
        going_on(resolve(again))


def test_an_agent_learns_on_an_id_of_another_project(tmp_path, monkeypatch):
    (tmp_path / "field.py").write_text(
        "import gymnasium\n"
        "gymnasium.register(id='field/Own-v0', \n"
        "    kwargs={'vehicle': 'focchi-short', 'lateral': 'constrained'},\n"
        "    entry_point='tracked_env.env:TrackedVehicleEnv',\n"
        "    vector_entry_point='tracked_env.vector_env:TrackedVehicleVectorEnv')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    config = small(tmp_path / "out", env="field:field/Own-v0", uncertainty=("mixture",), steps=128)
    assert config.folder == tmp_path / "out"
    assert replace(config, output=None).folder == Path("runs/Own-v0/ppo-blind-seed3")
    recipe = read_recipe(archive_of(config))
    assert recipe["environment"]["id"] == "field:field/Own-v0"
    assert recipe["environment"]["vehicle"] == "focchi-short"
    assert recipe["environment"]["lateral"] == recipe["config"]["lateral"] == "constrained"
    assert len(recipe["environment"]["uncertainty"]) == len(MIXTURE[TORQUE_ID])
    del gymnasium.registry["field/Own-v0"]
    sys.modules.pop("field")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ('{"plnt": "lumped"}', "unknown --env-args key 'plnt'.*Did you mean 'plant'"),
        ('{"expose_truth": true}', "unknown --env-args key 'expose_truth'"),
        ('{"observation": ["motin"]}', "unknown observation group 'motin'.*Did you mean 'motion'"),
        ('{"observation": []}', r"observation = \[\]; must be 'v0' or a list of groups"),
        ('{"plant": "distribted"}', "Did you mean 'distributed'"),
        ('{"time_step": 1}', "time_step = 1.0 s; must be a number in"),
        ('{"patches": 5}', '--env-args {"patches": 5}: '),
        ('{"drive": "speed"}', "needs plant"),
        ('{"reward": "mine"}', "unknown reward 'mine'; known are"),
        ('{"costs": {"tlit": 0.1}}', "costs key 'tlit'.*Did you mean 'tilt'"),
        ("plant=lumped", "--env-args = 'plant=lumped'; must be a dict"),
        ('{"plant": ', "not a JSON object"),
        *(
            (f'{{"{name}": 1}}', f"{name} has an option of its own, --{name}$")
            for name in ("uncertainty", "sensors", "reference", "duration", "lateral", "vehicle")
        ),
    ],
)
def test_a_wrong_argument_is_one_clear_line(arguments, message, tmp_path):
    with pytest.raises(ValueError, match=message) as raised:
        environment_of(small(tmp_path, env_args=arguments))
    assert "\n" not in str(raised.value)


REWARD = {"position": {"scale": 0.015}, "smoothness": {"weight": 0.0}}


def test_a_reward_of_ones_own_is_what_the_agent_gets_and_stands_in_the_recipe(tmp_path):
    config = small(tmp_path, env_args=json.dumps({"reward": REWARD, "costs": {"slip": 0.0}}))
    run = resolve(config)
    assert run.recipe["environment"]["reward"] == REWARD
    assert (run.options.precision, run.options.smoothness) == (0.0, 0.0)
    with pytest.raises(ValueError, match="--smoothness 1 with a reward of your own; must be 0"):
        resolve(replace(config, smoothness=1.0))
    part = run.parts[0]
    trained = make_part(run, part)
    plain = make_vec_env(n_envs=part.rows, env_kwargs=dict(part.arguments), monitor=False)
    for env in (trained, plain):
        env.seed(5)
        env.reset()
    actions = np.full((part.rows, 2), 0.1, np.float32)
    for _ in range(5):
        _, rewards, _, infos = trained.step(actions)
        _, expected, _, _ = plain.step(actions)
        np.testing.assert_array_equal(rewards, expected)
        assert all(info["cost"] == info["cost_slip"] for info in infos)


# Agents that drive by sprocket speeds

BY_SPROCKETS = PolicyContext(0.02, "sliding", MOCAP, "speed", VEHICLES["focchi"])


@pytest.mark.parametrize("env", [SPEED_ID, SPEED_ID.rpartition("/")[2]])
def test_an_environment_is_known_with_and_without_its_name_space(env):
    options = Options(env=env)
    assert options.env == SPEED_ID and options.folder == Path("runs/Speed-v0/ppo-blind-seed0")
    assert Options(env="Unknown-v0").env == "Unknown-v0"  # refused by its own name


@pytest.mark.parametrize("kind", ["blind", "history", "estimates", "residual"])
def test_every_kind_of_agent_trains_on_speed_v0(kind, tmp_path):
    config = small(tmp_path, env=SPEED_ID, augmentation=kind, uncertainty=("mixture",))
    assert main(config) == 0
    policy = agent_entry(tmp_path / "agent.zip").make(BY_SPROCKETS)
    observation, _ = TrackedVehicleEnv(**SPEED).reset(seed=0)
    action, _ = policy.predict(observation)
    assert action.shape == (2,)
    assert np.isfinite(action).all()
    assert observation.shape == (obs.SIZE,)
    with pytest.raises(ValueError, match="trained to command"):
        agent_entry(tmp_path / "agent.zip").make(BY_SPROCKETS._replace(drive="torque"))


SEEN = tuple(TERRAIN["observation"])


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        ("blind", (*SEEN, "height_scan")),
        pytest.param("residual", SEEN, marks=pytest.mark.slow),  # slip tables of every slope
    ],
)
def test_agents_of_terrain_v0_train_and_drive_in_its_evaluation_sets(kind, shown, tmp_path):
    """The sets show heights behind what the id shows; an agent finds its columns by name."""
    arguments = json.dumps({"observation": list(shown)})
    config = small(
        tmp_path, env=TERRAIN_ID, augmentation=kind, uncertainty=("mixture",), env_args=arguments
    )
    assert main(config) == 0
    sets = BenchmarkConfig(sets=("hills",))
    env = sets.environment("hills", 2, truth=False)
    observation, _ = env.reset(seed=[0, 1])
    entry = agent_entry(tmp_path / "agent.zip")
    action, _ = entry.make(sets.context("hills")).predict(observation)
    assert action.shape == (2, 2) and np.isfinite(action).all()
    with pytest.raises(ValueError, match="lacks group attitude"):
        entry.make(BY_SPROCKETS)
