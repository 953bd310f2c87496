"""Every algorithm with every kind of augmentation: trains, is saved, and acts as it was trained."""

import json
import shlex

import numpy as np
import pytest

from agents.algorithms import ALGORITHMS
from agents.archive import agent_entry
from agents.environments import AgentVectorEnv
from agents.folder import HELD_OUT_SEED
from baselines.learned.augmentation import KINDS, make_augmentation
from baselines.learned.trained_agent import normalisation_of, read_recipe
from baselines.linearizing.linearizing_law import TUNED_GAINS
from tests.agents.agent_cases import (
    CONTEXT,
    STEPS,
    Recorded,
    actor,
    as_evaluated,
    small,
    vehicles,
)
from tracked_env import observation as obs
from tracked_env.vector_env import TrackedVehicleVectorEnv
from train import main


def as_trained(path):
    """Commands of the agent inside the wrapper of its training."""
    recipe = read_recipe(path)
    model, inner = actor(path), Recorded(vehicles())
    normalise = normalisation_of(recipe) or (lambda values: values)
    kind, options = recipe["augmentation"], recipe["augmentation_options"]
    env = AgentVectorEnv(inner, make_augmentation(kind, options, CONTEXT, 3))
    observation, _ = env.reset(seed=5)
    recurrent, start = None, np.ones(3, dtype=bool)
    for _ in range(STEPS):
        action, recurrent = model.predict(
            normalise(observation), recurrent, start, deterministic=True
        )
        observation, _, terminated, truncated, _ = env.step(action)
        start = terminated | truncated
    return np.array(inner.commands)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_agent_acts_in_the_benchmark_as_in_training(algorithm, kind, tmp_path):
    assert main(small(tmp_path, agent=algorithm, augmentation=kind, steps=256)) == 0
    trained, evaluated = as_trained(tmp_path / "last.zip"), as_evaluated(tmp_path / "last.zip")
    assert np.ptp(trained) > 0.0
    np.testing.assert_array_equal(trained, evaluated)


def test_running_normalisation_is_saved_with_the_agent_and_used(tmp_path):
    assert main(small(tmp_path, normalise=True, augmentation="history")) == 0
    path = tmp_path / "agent.zip"
    stored = normalisation_of(read_recipe(path))
    assert stored.mean.shape == stored.variance.shape and np.abs(stored.mean).max() > 0.01
    np.testing.assert_array_equal(as_trained(path), as_evaluated(path))


@pytest.mark.parametrize("kind", ["history", "residual"])
def test_the_state_is_all_that_an_agent_remembers(kind, tmp_path):
    """Going on from a state kept earlier gives the same action, in a fresh policy too."""
    assert main(small(tmp_path, agent="recurrent-ppo", augmentation=kind, steps=256)) == 0
    entry = agent_entry(tmp_path / "agent.zip")
    policy, fresh = entry.make(CONTEXT), entry.make(CONTEXT)
    env = vehicles()
    observation, _ = env.reset(seed=1)
    state = None
    for _ in range(10):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    first, _ = policy.predict(observation, state)
    policy.predict(np.zeros((3, obs.SIZE), np.float32), state)
    again, _ = policy.predict(observation, state)
    elsewhere, _ = fresh.predict(observation, state)
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, elsewhere)


def test_an_agent_drives_one_vehicle_or_many(tmp_path):
    assert main(small(tmp_path, augmentation="history", steps=256)) == 0
    entry = agent_entry(tmp_path / "agent.zip")
    batch = np.random.default_rng(0).normal(size=(4, obs.SIZE)).astype(np.float32)
    together, _ = entry.make(CONTEXT).predict(batch)
    for row, observation in zip(together, batch, strict=True):
        alone, _ = entry.make(CONTEXT).predict(observation)
        assert alone.shape == (2,)
        np.testing.assert_array_equal(alone, row)
    with pytest.raises(ValueError, match="widens it by itself"):
        entry.make(CONTEXT).predict(np.zeros((4, obs.SIZE + 1), np.float32))


def test_the_archive_says_how_the_agent_came_about(tmp_path, monkeypatch):
    typed = ["train.py", "--sensors", '{"preset": "rtk", "pose_delay": 0.2}']
    monkeypatch.setattr("sys.argv", typed)
    assert main(small(tmp_path, agent="td3", augmentation="residual", residual_scale=0.2)) == 0
    recipe = read_recipe(tmp_path / "agent.zip")
    assert recipe["algorithm"] == "td3" and recipe["augmentation_options"] == {
        "scale": 0.2, "gains": list(TUNED_GAINS)
    }  # fmt: skip
    assert recipe["config"]["seed"] == 3 and recipe["config"]["td3"]["batch_size"] == 32
    assert "ppo" not in recipe["config"]
    assert shlex.split(recipe["command"]) == ["python", *typed]
    assert recipe["versions"]["torch"] and recipe["seconds"] > 0 and recipe["steps"] <= 512
    assert recipe["environment"]["uncertainty"][0] == "soil-and-mass"
    assert "ood" not in recipe["environment"]["uncertainty"]
    assert json.loads((tmp_path / "config.json").read_text())["config"] == recipe["config"]


def test_trainings_share_no_episode_with_each_other_the_held_out_ones_or_the_benchmark(
    tmp_path, monkeypatch
):
    seeded = []
    original = TrackedVehicleVectorEnv._seed

    def watched(self, chosen, seed):
        seeds = [seed + i for i in chosen] if isinstance(seed, int) else list(seed or [])
        seeded.extend(s for s in seeds if s is not None)
        original(self, chosen, seed)

    monkeypatch.setattr(TrackedVehicleVectorEnv, "_seed", watched)
    used = {}
    for seed, sensors in ((0, None), (1, ("rtk", "strawa"))):
        seeded.clear()
        config = small(tmp_path / str(seed), seed=seed, sensors=sensors, held_out=4, steps=64)
        assert main(config) == 0
        used[seed] = set(seeded)
    benchmark, held_out = set(range(10_000)), set(range(HELD_OUT_SEED, HELD_OUT_SEED + 4))
    assert used[0] & used[1] == held_out
    trained = (used[0] | used[1]) - held_out
    assert len(trained) == 8 and not trained & benchmark
    assert main(small(tmp_path / "none", seed=-1)) == 2
