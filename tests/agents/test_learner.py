"""An algorithm of one's own: the page that says how is followed, to the benchmark and back."""

import importlib.util
import os
import re
import subprocess
import sys

import numpy as np
import pytest

import train
from agents.algorithms import ALGORITHMS, Algorithm, register
from agents.archive import agent_entry
from agents.folder import Diverged, Progress
from agents.options import options_of_train
from baselines.learned.trained_agent import read_recipe
from tests.agents.agent_cases import parameters, same_parameters
from tests.test_documentation import python_blocks
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext

BUDGET = [
    "--agent", "cross-entropy", "--cross-entropy.horizon", "20", "--steps", "1600", "--vehicles",
    "8", "--held-out", "2", "--duration", "1", "--quiet", "--seed", "3", "--checkpoint-every",
    "160",
]  # fmt: skip


@pytest.fixture(scope="module")
def blocks(repository):
    """The file and its use, as the page has them."""
    text = (repository / "CONTRIBUTING.md").read_text()
    return python_blocks(text.split("## How to add an algorithm")[1].split("\n## ")[0])


@pytest.fixture
def cross_entropy(blocks, tmp_path):
    """The module of the page, registered while a test runs."""
    path = tmp_path / "cross_entropy.py"
    path.write_text(blocks[0])
    spec = importlib.util.spec_from_file_location("cross_entropy", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cross_entropy"] = module
    spec.loader.exec_module(module)
    yield module
    del ALGORITHMS["cross-entropy"], sys.modules["cross_entropy"]


@pytest.mark.slow
def test_the_page_can_be_followed_in_a_folder_of_ones_own(blocks, repository, tmp_path):
    assert len(blocks) == 2 and blocks[0].startswith("# cross_entropy.py\n")
    (tmp_path / "cross_entropy.py").write_text(blocks[0])
    (tmp_path / "use.py").write_text(blocks[1])
    path = os.pathsep.join([str(tmp_path), str(repository)])
    done = subprocess.run(
        [sys.executable, "use.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"done: 25,600 steps in .*\n(mine \d+\.\d+\n){2}$", done.stdout), done.stdout
    curve = np.genfromtxt(tmp_path / "mine" / "curve.csv", delimiter=",", names=True)
    assert curve["mean_return"][-1] > curve["mean_return"][0]  # it learns


def test_its_agent_acts_as_its_weights_say(cross_entropy, tmp_path):
    assert train.command([*BUDGET, "--output", str(tmp_path / "out")]) == 0
    path = tmp_path / "out" / "last.zip"
    recipe = read_recipe(path)
    assert recipe["config"]["agent"] == "cross-entropy" and recipe["steps"] == 1600
    assert recipe["config"]["cross_entropy"] == {"horizon": 20, "elite": 0.2, "spread": 0.1}
    assert not {"ppo", "sac", "student"} & set(recipe["config"])
    weights = parameters(path)
    batch = np.random.default_rng(0).normal(size=(3, obs.SIZE)).astype(np.float32)
    action, _ = agent_entry(path).make(PolicyContext(0.02, "sliding")).predict(batch)
    expected = batch @ weights["action_net.weight"].T + weights["action_net.bias"]
    np.testing.assert_allclose(action, np.clip(expected, -1.0, 1.0), atol=1e-6)
    assert np.ptp(action) > 0.01


def test_its_training_goes_on_after_a_kill_as_if_nothing_had_been(
    cross_entropy, tmp_path, monkeypatch, capsys
):
    whole, torn = ([*BUDGET, "--output", str(tmp_path / name)] for name in ("whole", "torn"))
    assert train.command(whole) == 0
    between = Progress.between

    def killed(progress, value):
        between(progress, value)
        if progress.learner.steps >= 800:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Progress, "between", killed)
        assert train.command(torn) == 130
    assert train.command([*torn, "--resume"]) == 0
    assert "going on after 800 steps" in capsys.readouterr().out
    assert same_parameters(tmp_path / "whole" / "last.zip", tmp_path / "torn" / "last.zip")
    curves = [
        np.genfromtxt(tmp_path / name / "curve.csv", delimiter=",", names=True)
        for name in ("whole", "torn")
    ]
    for column in ("steps", "mean_return", "held_out_rmse"):
        np.testing.assert_array_equal(curves[0][column], curves[1][column])


def test_the_last_agent_is_evaluated_once(cross_entropy, tmp_path):
    arguments = [*BUDGET, "--output", str(tmp_path / "out"), "--evaluate-every", "800"]
    assert train.command(arguments) == 0
    curve = np.genfromtxt(tmp_path / "out" / "curve.csv", delimiter=",", names=True)
    evaluated = ~np.isnan(curve["held_out_rmse"])
    assert curve["steps"][evaluated].tolist() == [800, 1600]


def test_a_learner_that_diverges_without_a_learning_rate_ends_in_one_line(
    cross_entropy, tmp_path, monkeypatch, capsys
):
    def diverge(learner, progress):
        raise Diverged("the training diverged at 160 steps")

    monkeypatch.setattr(cross_entropy.CrossEntropyLearner, "generation", diverge)
    assert train.command([*BUDGET, "--output", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "diverged at 160 steps. Train anew with --overwrite" in line


def test_its_settings_are_options_with_the_help_of_their_docstrings(cross_entropy, capsys):
    with pytest.raises(SystemExit):
        train.command(["--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "cross-entropy" in shown and "--cross-entropy.elite NUMBER" in shown
    assert "Share of the candidates around which the next ones are drawn." in shown


def test_a_name_that_is_taken_or_no_option_is_refused():
    record: Algorithm = ALGORITHMS["ppo"]
    with pytest.raises(ValueError, match="'ppo' is registered already"):
        register("ppo", record)
    for name in ("My Own", "a_b", "", "3a"):
        with pytest.raises(ValueError, match="must be lower-case letters"):
            register(name, record)
    assert list(ALGORITHMS) == ["ppo", "sac", "td3", "tqc", "recurrent-ppo"]


def test_an_algorithm_that_is_not_registered_is_refused_with_those_that_are():
    with pytest.raises(
        ValueError, match="agent = 'dqn'; must be one of ppo, sac, td3, tqc, recurrent-ppo"
    ):
        options_of_train()(agent="dqn")


def test_an_algorithm_that_is_called_like_an_option_is_refused(monkeypatch):
    monkeypatch.setitem(ALGORITHMS, "residual-scale", ALGORITHMS["ppo"])
    with pytest.raises(ValueError, match="--residual-scale is another option; rename it"):
        options_of_train()
