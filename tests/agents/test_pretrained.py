"""The shipped agents are what their table says: files, recipes, a score that comes out again."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch", reason="agents need the extra `rl`")

from agents.loading import agent_entry, read_recipe
from tracked_env.benchmark import BenchmarkConfig, Store
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.statistics import interquartile_mean

FOLDER = Path(__file__).resolve().parents[2] / "agents" / "pretrained"
AGENTS = sorted(path.parent for path in FOLDER.glob("*/agent.zip"))
PUBLISHED = json.loads((FOLDER / "scores.json").read_text(encoding="utf-8"))


def test_there_are_agents_of_five_seeds() -> None:
    names = [folder.name.rpartition("-seed")[0] for folder in AGENTS]
    assert {"ppo-blind", "ppo-residual"} <= {name for name in names if names.count(name) >= 5}


@pytest.mark.parametrize("folder", AGENTS, ids=[folder.name for folder in AGENTS])
def test_an_agent_comes_with_the_command_that_made_it_and_its_learning_curve(folder: Path) -> None:
    config = json.loads((folder / "config.json").read_text(encoding="utf-8"))
    assert config["command"].startswith("python train.py")
    assert f"--seed {folder.name.rpartition('-seed')[2]}" in config["command"]
    recipe = read_recipe(folder / "agent.zip")
    assert recipe is not None
    curve = np.genfromtxt(folder / "curve.csv", delimiter=",", names=True)
    assert curve["steps"][-1] >= 250_000
    assert (folder / "agent.zip").stat().st_size < 1.2e6


@pytest.mark.parametrize("name", ["ppo-residual-seed0", "ppo-blind-seed0"])
def test_a_score_that_was_published_comes_out_again(name: str, tmp_path: Path) -> None:
    episodes = PUBLISHED["episodes"]
    entry = agent_entry(FOLDER / name / "agent.zip")._replace(name=name)
    config = BenchmarkConfig(sets=("soil-and-mass",), episodes=episodes)
    records = run(config, [entry], Store(tmp_path, config.identity()))
    found = interquartile_mean(np.array([record["tracking_rmse"] for record in records]))
    agent, _, seed = name.rpartition("-seed")
    published = PUBLISHED["seeds"][agent][seed]["soil-and-mass"]
    assert published["low"] <= found <= published["high"]
    assert found == pytest.approx(published["iqm"], rel=0.02)
