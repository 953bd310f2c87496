"""Further arguments of the environment reach the vehicles, the policies and the recipe."""

from dataclasses import replace

import pytest

from agents.archive import agent_entry
from agents.checkpoint import layers
from agents.environments import TrainingReward, make_environment, make_part, make_taught
from agents.folder import make_held_out
from agents.run import PRECISION, Augmentation, environment_arguments, resolve
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import small
from tracked_env import SPEED_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.physics.parameters import VEHICLES
from tracked_env.sb3 import TrackedVehicleVecEnv
from train import main

CONTEXT = PolicyContext(0.02, "sliding")
BY_SPEED = '{"plant": "distributed", "drive": "speed", "vehicle": "focchi", "error_limit": 2}'


def simulation_of(env):
    """The simulation of an environment of a training."""
    (inner,) = (layer for layer in layers(env) if isinstance(layer, TrackedVehicleVecEnv))
    return inner.env.unwrapped.simulation


def test_an_agent_of_another_plant_trains_and_loads(tmp_path):
    config = small(tmp_path, env_args='{"plant": "distributed", "patches": [4, 2]}', steps=256)
    run = resolve(config)
    taught = replace(run, augmentation=Augmentation("student", {"lags": [1, 2]}))
    driven = [simulation_of(make_environment(run))]
    driven += [part.env.simulation for part in make_held_out(run)]
    driven += [simulation_of(make_taught(taught)[0])]
    assert len(driven) == 3
    for simulation in driven:
        solver = simulation.solver
        assert solver.plant.name == "distributed"
        assert len(solver.prepared.options[0].columns) == 4
    assert main(config) == 0
    recipe = read_recipe(tmp_path / "agent.zip")
    assert recipe["environment"]["plant"] == "distributed"
    assert recipe["environment"]["patches"] == [4, 2]
    assert recipe["config"]["env_args"] == config.env_args
    agent_entry(tmp_path / "agent.zip").make(CONTEXT)


def test_drive_and_vehicle_reach_policy_reward_and_recipe(tmp_path):
    config = small(
        tmp_path, env_args=BY_SPEED, augmentation="residual", uncertainty=("friction",),
        sensors=("mocap",), steps=256,
    )  # fmt: skip
    run = resolve(config)
    (part,) = run.parts
    assert (part.context.drive, part.context.vehicle) == ("speed", "focchi")
    (held_out,) = make_held_out(run)
    assert held_out.context == part.context
    (reward,) = (
        layer for layer in layers(make_part(run, part)) if isinstance(layer, TrainingReward)
    )
    assert reward.precision == PRECISION * VEHICLES["focchi"].contact_length
    assert main(config) == 0
    entry = agent_entry(tmp_path / "agent.zip")
    policy = entry.make(part.context)
    assert policy.augmentation.policy.parameters == VEHICLES["focchi"]
    with pytest.raises(ValueError, match="trained to command each sprocket's speed"):
        entry.make(CONTEXT)


@pytest.mark.parametrize("kind", ["estimates", "residual"])
def test_controllers_inside_an_agent_know_the_nominal_vehicle(kind, tmp_path):
    config = small(tmp_path, env_args='{"vehicle": "focchi"}', augmentation=kind, steps=128)
    assert main(config) == 0
    run = resolve(config)
    (part,) = run.parts
    augmentation = agent_entry(tmp_path / "agent.zip").make(part.context).augmentation
    known = augmentation.parameters if kind == "estimates" else augmentation.policy.parameters
    assert known == VEHICLES["focchi"]


def test_another_control_rate_reaches_policies_and_recipe(tmp_path):
    config = small(tmp_path, env_args='{"control_rate": 25}', augmentation="history", steps=128)
    run = resolve(config)
    (part,) = run.parts
    assert part.context.control_period == 0.04
    assert main(config) == 0
    assert read_recipe(tmp_path / "last.zip")["control_period"] == 0.04
    entry = agent_entry(tmp_path / "last.zip")
    entry.make(part.context)
    with pytest.raises(ValueError, match=r"period of 0\.04 s; this environment has 0\.02 s"):
        entry.make(CONTEXT)


def test_an_environment_id_keeps_its_arguments_where_none_is_given(tmp_path):
    config = small(tmp_path, env=SPEED_ID, env_args='{"vehicle": "focchi-short"}')
    run = resolve(config)
    (part,) = run.parts
    assert (part.context.drive, part.context.vehicle) == ("speed", "focchi-short")
    solver = simulation_of(make_part(run, part)).solver
    assert solver.plant.name == "distributed" and solver.nominal == VEHICLES["focchi-short"]
    assert solver.error_limit == 2.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ('{"plnt": "lumped"}', "unknown --env-args key 'plnt'.*Did you mean 'plant'"),
        ('{"expose_truth": true}', "unknown --env-args key 'expose_truth'"),
        ('{"observation": ["motin"]}', "unknown observation group 'motin'.*Did you mean 'motion'"),
        ('{"observation": []}', r"observation = \[\]; must be 'v0' or a list of groups"),
        ('{"plant": "distribted"}', "Did you mean 'distributed'"),
        ('{"time_step": 1}', "time_step = 1.0 s; must be a number in"),
        ('{"patches": 5}', '--env-args {"patches": 5}: '),
        ('{"drive": "speed"}', "needs plant"),
        ("plant=lumped", "--env-args = 'plant=lumped'; must be a dict"),
        ('{"plant": ', "not a JSON object"),
        *(
            (f'{{"{name}": 1}}', f"{name} has an option of its own, --{name}$")
            for name in ("uncertainty", "sensors", "reference", "duration", "lateral")
        ),
    ],
)
def test_a_wrong_argument_is_one_clear_line(given, message, tmp_path):
    with pytest.raises(ValueError, match=message) as raised:
        environment_arguments(small(tmp_path, env_args=given))
    assert "\n" not in str(raised.value)
