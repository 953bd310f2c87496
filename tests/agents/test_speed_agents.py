"""Agents that drive by sprocket speeds are trained and drive."""

import json
from pathlib import Path

import numpy as np
import pytest

import train
from agents.archive import agent_entry
from agents.options import Options
from tests.agents.agent_cases import small
from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID
from tracked_env import observation as obs
from tracked_env.benchmark import BenchmarkConfig, PolicyContext
from tracked_env.env import TrackedVehicleEnv
from tracked_env.sensors import MOCAP

CONTEXT = PolicyContext(0.02, "sliding", MOCAP, "speed", "focchi")


@pytest.mark.parametrize("env", [SPEED_ID, SPEED_ID.rpartition("/")[2]])
def test_an_environment_is_known_with_and_without_its_name_space(env):
    options = Options(env=env)
    assert options.env == SPEED_ID and options.folder == Path("runs/Speed-v0/ppo-blind-seed0")
    assert Options(env="Unknown-v0").env == "Unknown-v0"  # refused by its own name


@pytest.mark.parametrize("kind", ["blind", "history", "estimates", "residual", "teacher"])
def test_every_kind_of_agent_trains_on_speed_v0(kind, tmp_path):
    config = small(tmp_path, env=SPEED_ID, augmentation=kind, uncertainty=("mixture",))
    assert train.main(config) == 0
    if kind == "teacher":
        return
    policy = agent_entry(tmp_path / "agent.zip").make(CONTEXT)
    observation, _ = TrackedVehicleEnv(**SPEED).reset(seed=0)
    action, _ = policy.predict(observation)
    assert action.shape == (2,)
    assert np.isfinite(action).all()
    assert observation.shape == (obs.SIZE,)
    with pytest.raises(ValueError, match="trained to command"):
        agent_entry(tmp_path / "agent.zip").make(CONTEXT._replace(drive="torque"))


SEEN = tuple(TERRAIN["observation"])


@pytest.mark.parametrize(("kind", "shown"), [("blind", (*SEEN, "height_scan")), ("residual", SEEN)])
def test_agents_of_terrain_v0_train_and_drive_in_its_evaluation_sets(kind, shown, tmp_path):
    """The sets show heights behind what the id shows; an agent finds its columns by name."""
    arguments = json.dumps({"observation": list(shown)})
    config = small(
        tmp_path, env=TERRAIN_ID, augmentation=kind, uncertainty=("mixture",), env_args=arguments
    )
    assert train.main(config) == 0
    sets = BenchmarkConfig(sets=("hills",))
    env = sets.environment("hills", 2, truth=False)
    observation, _ = env.reset(seed=[0, 1])
    entry = agent_entry(tmp_path / "agent.zip")
    action, _ = entry.make(sets.context("hills")).predict(observation)
    assert action.shape == (2, 2) and np.isfinite(action).all()
    with pytest.raises(ValueError, match="lacks group attitude"):
        entry.make(CONTEXT)
