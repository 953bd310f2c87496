"""train.py from the command line, and the agent that it leaves behind in the benchmark."""

import json
import subprocess
import sys

import numpy as np
import pytest

from agents.ppo import agent_entry
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext

BUDGET = ["--steps", "2048", "--ppo.n-envs", "8", "--ppo.n-steps", "64", "--ppo.batch-size", "256"]


def train(repository, *arguments):
    """Run train.py with a tiny budget."""
    return subprocess.run(
        [sys.executable, str(repository / "train.py"), *BUDGET, *arguments],
        capture_output=True, text=True, cwd=repository, timeout=300,
    )  # fmt: skip


@pytest.fixture(scope="module")
def trained(repository, tmp_path_factory):
    """Folder of a trained agent."""
    folder = tmp_path_factory.mktemp("agent")
    result = train(repository, "--output", str(folder), "--seed", "3", "--uncertainty", "payload")
    assert result.returncode == 0, result.stderr
    assert "steps/s" in result.stdout
    return folder


def test_the_agent_comes_with_its_configuration_and_learning_curve(trained):
    config = json.loads((trained / "config.json").read_text())
    assert config["environment"]["uncertainty"] == "payload"
    assert config["steps"] == 2048 and config["settings"]["n_envs"] == 8
    assert "torch" in config["versions"] or "numpy" in config["versions"]
    curve = np.genfromtxt(trained / "curve.csv", delimiter=",", names=True)
    assert curve["steps"].tolist() == [512, 1024, 1536, 2048]


def test_the_agent_is_a_policy_of_the_benchmark(trained):
    entry = agent_entry(trained / "agent.zip")
    policy = entry.make(PolicyContext(0.02, "sliding"))
    action, _ = policy.predict(np.zeros((5, obs.SIZE), np.float32), deterministic=True)
    assert action.shape == (5, 2) and np.all(np.abs(action) <= 1.0)


def test_evaluate_accepts_the_archive(trained, repository, tmp_path):
    command = [
        sys.executable, str(repository / "evaluate.py"), "--no-figures", "--episodes", "2",
        "--duration", "2", "--sets", "payload", "--output", str(tmp_path),
        "--policies", "nominal", str(trained / "agent.zip"),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, cwd=repository, timeout=300)
    assert result.returncode == 0, result.stderr
    assert "agent" in result.stdout


def test_wrong_settings_and_damaged_archives_are_clear_errors(repository, tmp_path):
    result = train(repository, "--uncertainty", "nope", "--output", str(tmp_path / "none"))
    assert result.returncode == 2 and "soil-and-mass" in result.stderr
    assert not (tmp_path / "none").exists()
    with pytest.raises(ValueError, match="no such file"):
        agent_entry(tmp_path / "agent.zip")
    (tmp_path / "agent.zip").write_bytes(b"not an archive")
    with pytest.raises(ValueError, match="cannot be loaded"):
        agent_entry(tmp_path / "agent.zip")
