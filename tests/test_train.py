"""train.py from the command line: a folder with an agent, killed and resumed, in the benchmark."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.agents.agent_cases import same_parameters

BUDGET = [
    "--quiet", "--vehicles", "8", "--held-out", "2", "--duration", "2", "--uncertainty", "payload",
    "drift", "--ppo.n-steps", "64", "--ppo.batch-size", "256", "--evaluate-every", "1024",
]  # fmt: skip


def command(repository, *arguments):
    return [sys.executable, str(repository / "train.py"), *BUDGET, *arguments]


def train(repository, *arguments):
    """Run train.py with a tiny budget."""
    return subprocess.run(
        command(repository, *arguments), capture_output=True, text=True, cwd=repository, timeout=300
    )


@pytest.fixture(scope="module")
def trained(repository, tmp_path_factory):
    """Folder of a trained agent."""
    folder = tmp_path_factory.mktemp("blind")
    result = train(repository, "--steps", "4096", "--output", str(folder), "--seed", "3")
    assert result.returncode == 0, result.stderr
    assert "steps/s with the learner" in result.stdout
    return folder


def test_the_agent_comes_with_its_configuration_and_learning_curve(trained):
    recipe = json.loads((trained / "config.json").read_text())
    assert recipe["environment"]["uncertainty"] == ["payload", "drift"]
    assert recipe["config"]["vehicles"] == 8 and recipe["config"]["ppo"]["n_steps"] == 64
    assert "torch" in recipe["versions"]
    curve = np.genfromtxt(trained / "curve.csv", delimiter=",", names=True)
    evaluated = ~np.isnan(curve["held_out_rmse"])
    assert curve["steps"][evaluated].tolist() == [1024, 2048, 3072, 4096]
    assert {path.name for path in trained.iterdir()} == {
        "agent.zip", "last.zip", "config.json", "curve.csv",
    }  # fmt: skip


def test_a_killed_training_goes_on_to_the_same_agent(trained, repository, tmp_path):
    arguments = ("--steps", "4096", "--output", str(tmp_path), "--seed", "3")
    process = subprocess.Popen(
        command(repository, *arguments), cwd=repository, stdout=subprocess.DEVNULL
    )
    until = time.monotonic() + 120
    while not (tmp_path / "checkpoint-before.zip").exists() and time.monotonic() < until:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "it ended before it could be killed"
    result = train(repository, *arguments, "--resume")
    assert result.returncode == 0, result.stderr
    assert "going on after" in result.stdout
    assert same_parameters(trained / "last.zip", tmp_path / "last.zip")


def test_evaluate_accepts_the_archive(trained, repository, tmp_path):
    call = [
        sys.executable, str(repository / "evaluate.py"), "--no-figures", "--episodes", "2",
        "--duration", "2", "--sets", "payload", "--output", str(tmp_path),
        "--policies", "nominal", str(trained / "agent.zip"),
    ]  # fmt: skip
    result = subprocess.run(call, capture_output=True, text=True, cwd=repository, timeout=300)
    assert result.returncode == 0, result.stderr
    assert trained.name in result.stdout


def test_the_help_lists_what_there_is(repository):
    result = train(repository, "--help")
    assert result.returncode == 0
    for name in (
        "recurrent-ppo", "residual", "--uncertainty", "--sensors", "--resume", "--tensorboard",
        "--normalise", "--sac.gradient-steps", "--tqc.tau", "horizon of one second",
    ):  # fmt: skip
        assert name in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--uncertainty", "nope"), "soil-and-mass"),
        (("--sensors", "rtk", '{"preset": "rtk",'), "not a JSON object"),
        (("--sensors", "rtk", "nope"), "ideal"),
        (("--sensors", "mixture"), "2 vehicles or held-out episodes for 4 kinds of sensors"),
        (("--sensors", '{"pose_delay": -1}'), "pose_delay"),
        (("--memory", "residual", "--residual-scale", "0"), "must be in"),
        (("--steps", "0"), "at least 1"),
        (("--env", "tracked_env/Nothing-v0"), "Nothing"),
    ],
)
def test_wrong_settings_are_clear_errors_and_leave_nothing(arguments, message, tmp_path, capsys):
    import tyro

    from train import Config, main

    output = tmp_path / "none"
    config = tyro.cli(Config, args=[*BUDGET, "--output", str(output), *arguments])
    assert main(config) == 2
    assert message in capsys.readouterr().err
    assert not output.exists()
