"""train.py from the command line: a folder with an agent, killed and resumed, in the benchmark."""

import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from tests.agents.agent_cases import same_parameters
from train import command as command_of_train

SHORT = [
    "--quiet", "--vehicles", "8", "--held-out", "2", "--duration", "2", "--uncertainty", "payload",
    "drift", "--evaluate-every", "1024",
]  # fmt: skip
BUDGET = [*SHORT, "--ppo.n-steps", "64", "--ppo.batch-size", "256"]


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


@pytest.mark.slow
def test_the_agent_comes_with_its_configuration_and_learning_curve(trained):
    recipe = json.loads((trained / "config.json").read_text())
    assert recipe["environment"]["uncertainty"] == ["payload", "drift"]
    assert recipe["config"]["vehicles"] == 8 and recipe["config"]["ppo"]["n_steps"] == 64
    assert "torch" in recipe["versions"]
    curve = np.genfromtxt(trained / "curve.csv", delimiter=",", names=True)
    evaluated = ~np.isnan(curve["held_out_rmse"])
    assert curve["steps"][evaluated].tolist() == [1024, 2048, 3072, 4096]
    assert {path.name for path in trained.iterdir()} == {
        "agent.zip",
        "last.zip",
        "config.json",
        "curve.csv",
    }


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_loop_over_seeds_can_be_started_again(trained, repository):
    arguments = ("--steps", "4096", "--output", str(trained), "--seed", "3")
    modified = (trained / "agent.zip").stat().st_mtime_ns
    again = train(repository, *arguments, "--resume")
    assert again.returncode == 0, again.stderr
    assert again.stdout == f"already finished: {trained / 'agent.zip'}\n"
    unasked = train(repository, *arguments)
    assert unasked.returncode == 2
    assert str(trained) in unasked.stderr and "--overwrite" in unasked.stderr
    assert (trained / "agent.zip").stat().st_mtime_ns == modified


@pytest.mark.slow
def test_evaluate_accepts_the_archive(trained, repository, tmp_path):
    call = [
        sys.executable, str(repository / "evaluate.py"), "--no-figures", "--episodes", "2",
        "--duration", "2", "--sets", "payload", "--output", str(tmp_path),
        "--policies", "nominal", str(trained / "agent.zip"),
    ]  # fmt: skip
    result = subprocess.run(call, capture_output=True, text=True, cwd=repository, timeout=300)
    assert result.returncode == 0, result.stderr
    assert trained.name in result.stdout


def test_the_help_lists_what_there_is(capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        command_of_train(["--help"])
    text = capsys.readouterr().out
    for name in (
        "recurrent-ppo", "residual", "--uncertainty", "--sensors", "--resume", "--tensorboard",
        "--normalise", "--sac.gradient-steps", "--tqc.tau", "horizon of one second",
        "--overwrite", "--env-args", "1 000 000 for recurrent PPO", "a tenth of all",
    ):  # fmt: skip
        assert name in " ".join(text.split())
    assert "{None" not in text and "INTEGER" in text
    assert not re.search(r"\b(INT|FLOAT|STR)\b", text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--uncertainty", "nope"), "soil-and-mass"),
        (("--sensors", "rtk", '{"preset": "rtk",'), "not a JSON object"),
        (("--sensors", "rtk", "nope"), "ideal"),
        (("--sensors", "mixture"), "2 vehicles or held-out episodes for 6 kinds of sensors"),
        (("--sensors", '{"pose_delay": -1}'), "pose_delay"),
        (("--augmentation", "residual", "--residual-scale", "0"), "must be in"),
        (("--augmentation", "residual", "--base", "nobody"), "base = 'nobody'; must be a regist"),
        (
            ("--augmentation", "residual", "--base", "adaptive", "--env", "tracked_env/Speed-v0"),
            "base = 'adaptive' on a vehicle driven by its sprocket speeds; must be left out",
        ),
        (("--env", "tracked_env/Nothing-v0"), "Nothing"),
        (("--env", "CartPole-v1"), "--env CartPole-v1 is not an environment of tracked vehicles"),
        (("--env", "nothing_at_all:Torque-v0"), "--env nothing_at_all:Torque-v0: "),
        (("--env-args", '{"plant": "lumpy"}'), "lumped"),
        (("--agent", "sac", "--sac.buffer-size", "10"), "must be at least 32"),
    ],
)
def test_wrong_settings_are_clear_errors_and_leave_nothing(arguments, message, tmp_path, capsys):
    output = tmp_path / "none"
    assert command_of_train([*SHORT, "--output", str(output), *arguments]) == 2
    values = capsys.readouterr().err
    assert message in values and values.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--steps", "0"), "steps = 0; must be in [1, 1e12]"),
        (("--vehicles", "0"), "vehicles = 0; must be in [1, 65536]"),
        (("--held-out", "-3"), "held_out = -3; must be in [0, 65536]"),
        (("--ppo.batch-size", "0"), "batch_size = 0; must be in [2, 1e8]"),
        (("--ppo.learning-rate", "1e30"), "learning_rate = 1e+30; must be in (0, 1]"),
        (("--teacher", "a.zip"), "--teacher has no effect with augmentation blind"),
        (("--output", ""), "--output: is empty"),
        (("--sac.n-steps", "0"), "n_steps = 0; must be in [1, 1000000]"),
    ],
)
def test_a_number_outside_its_limits_is_a_clear_error(arguments, message, tmp_path, capsys):
    assert command_of_train([*BUDGET, "--output", str(tmp_path / "none"), *arguments]) == 2
    values = capsys.readouterr().err
    assert message in values and values.count("\n") == 1
