"""The command `tracked-env`: comparisons, its options and errors, and what only a clone has."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.cli import command_line, evaluate_command
from tracked_env.cli.evaluate_options import Config, env_of, parsed
from tracked_env.cli.main import COMMANDS, main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

TINY = ("--sets", "payload", "--episodes", "1", "--duration", "0.5")


def test_evaluate_compares_and_writes_what_evaluate_py_writes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert (
        main(["evaluate", *TINY, "--policies", "nominal,oracle", "ppo-blind", "--no-figures"]) == 0
    )
    assert "Leaderboard" in capsys.readouterr().out
    (file,) = Path("results").glob("*/results.json")
    found = {record["policy"] for record in json.loads(file.read_text())["episodes"]}
    assert found == {"nominal", "oracle", *(f"ppo-blind@{seed}" for seed in range(5))}
    assert "ppo-blind" in (file.parent / "leaderboard.html").read_text()


def test_quiet_shows_where_the_results_are_and_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", *TINY, "--policies", "nominal,oracle", "--no-figures", "--quiet"]) == 0
    shown = capsys.readouterr()
    (page,) = Path("results").glob("*/leaderboard.html")
    assert shown.out.rstrip().endswith(f"the page: {page}")
    assert "RMSE" not in shown.out and "Leaderboard" not in shown.out
    assert shown.err == ""
    text = page.read_text()
    assert "<dt>command</dt>" in text and "<dt>machine</dt>" in text
    assert json.loads((page.parent / "results.json").read_text())["hash"] in text


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["evaluate", "--policies", "nominal"], "--sets"),
        (["tune", "adaptive"], "--sets"),
        (["render", "nominal"], "--set"),
        (["record", "nominal"], "--set"),
        (["drive", "--observer", "adaptive"], "--set"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_a_set_of_another_environment_than_the_named_one_is_refused_in_one_line(
    command: list[str], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, message in (
        ("payload", rf"{option} 'payload' is of Torque-v0, which contradicts --env Speed-v0.*envs"),
        ("friction-stp", r"unknown evaluation set 'friction-stp'.*Did you mean 'friction-step'\?"),
    ):
        assert ended([*command, "--env", "Speed-v0", option, name]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"tracked-env {command[0]}: ") and error.count("\n") == 1
        assert re.search(message, error)
    assert not list(Path().iterdir())


def test_the_environment_is_that_of_the_sets_where_none_is_named() -> None:
    assert env_of(None, None) == TORQUE_ID
    assert env_of(None, ("floor-mixed",)) == SPEED_ID
    assert env_of(TERRAIN_ID, None) == TERRAIN_ID
    with pytest.raises(ValueError, match="'floor' is of Speed-v0, which contradicts 'payload'"):
        env_of(None, ("payload", "floor"))
    benchmark = evaluate_command.benchmark_config(parsed(["--sets", "slope"], "test"))
    assert benchmark.env == TERRAIN_ID


def ended(arguments: list[str]) -> int:
    """Exit status of a command that ends by itself or by its parser."""
    try:
        return main(arguments)
    except SystemExit as error:
        return int(str(error.code or 0))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--polices", "nominal"], "--polices nominal; did you mean --policies?"),
        (["evaluat"], "tracked-env: COMMAND: invalid choice: 'evaluat'"),
        (["evaluat"], "did you mean evaluate?"),
        (["evaluate", "--episodes", "1.5"], "--episodes: 1.5; must be a whole number"),
        (["evaluate", "--duration", "3s"], "--duration: 3s; must be a number, with a point"),
        (["evaluate", "--episode", "3"], "unrecognized arguments: --episode 3"),
        (["evaluate", *TINY, "--policies", "nominl"], "tracked-env evaluate: unknown policy"),
    ],
)
def test_a_wrong_argument_is_told_with_its_value_what_is_allowed_and_what_is_near(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"train"}))
@pytest.mark.parametrize("wrong", ["--nosuch", "--env=Sped-v0"])
def test_an_option_or_environment_that_a_command_does_not_know_is_one_line(
    wrong: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended([command, wrong]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"tracked-env {command}: ") and error.count("\n") == 1
    has_env = command not in ("plan", "identify", "slip")
    assert ("Did you mean 'Speed-v0'?" in error) == (has_env and wrong != "--nosuch")


def test_without_a_command_all_commands_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    shown = capsys.readouterr().err
    assert all(f"\n  {name} " in shown for name in COMMANDS)


def test_commands_that_drive_one_episode_take_no_option_that_they_do_not_follow(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for command in ("record", "render", "drive"):
        assert ended([command, "--help"]) == 0
        shown = capsys.readouterr().out
        assert "--seed" in shown and "--set " in shown
        assert not any(f"--{name}" in shown for name in ("all", "sets-version", "episodes"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], {}),
        (["--policies", "a,b", "c"], {"policies": ("a", "b", "c")}),
        (["--policies", "a,,b", "a"], {"policies": ("a", "b")}),
        (["--sets", "payload", "ood"], {"sets": ("payload", "ood")}),
        (["--env", "Speed-v0"], {"env": "tracked_env/Speed-v0"}),
        (["--env", "tracked_env/Speed-v0"], {"env": "tracked_env/Speed-v0"}),
        (["--no-figures", "--video"], {"figures": False, "video": True}),
        (
            ["--sensors", '{"preset": "rtk", "pose_delay": 0.1}'],
            {"sensors": '{"preset": "rtk", "pose_delay": 0.1}'},
        ),
        (
            ["--seed", "3", "--duration", "2.5", "--output", "x"],
            {"seed": 3, "duration": 2.5, "output": Path("x")},
        ),
    ],
)
def test_a_command_line_is_the_configuration_that_it_says(
    arguments: list[str], expected: dict[str, Any]
) -> None:
    assert parsed(arguments, "test") == Config(**expected)


def test_a_file_with_a_comma_in_its_name_is_one_policy() -> None:
    Path("a,b.zip").write_bytes(b"")
    assert parsed(["--policies", "a,b.zip", "mine=a,b.zip"], "test").policies == (
        "a,b.zip",
        "mine=a,b.zip",
    )


def test_leaderboard_evaluates_everything_on_every_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Config] = []
    monkeypatch.setattr(
        "tracked_env.cli.evaluate_command.run_config",
        lambda config, program: asked.append(config) or 0,
    )
    assert main(["leaderboard", "--episodes", "3", "--output", "board"]) == 0
    shown = {"all": True, "episodes": 3, "output": Path("board"), "figures": False}
    assert asked == [Config(env=env, **shown) for env in (TORQUE_ID, SPEED_ID, TERRAIN_ID)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "--augmentation", "estimates"], "training is not part of the installed package"),
        (["evaluate", "--paper", "strawa2021"], "needs the package `reproduce`"),
        (["evaluate", "--trust"], "needs PyTorch and the package `agents`"),
    ],
)
def test_what_only_a_clone_has_is_one_line_that_says_how_to_get_it(
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(command_line, "ROOT", tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and "Clone the repository" in error and error.count("\n") == 1
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "train"])
def test_every_command_has_a_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert "usage:" in shown and len(shown.splitlines()) > 5


def test_the_training_which_replaces_the_process_has_a_help(repository: Path) -> None:
    pytest.importorskip("torch", reason="train.py needs the extra `rl`")
    environment = {**os.environ, "PYTHONPATH": str(repository), "COLUMNS": "100"}
    command = [sys.executable, "-m", "tracked_env.cli.main", "train", "--help"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert "usage:" in done.stdout and len(done.stdout.splitlines()) > 5


def test_an_interruption_is_one_line_that_names_the_command(
    repository: Path, tmp_path: Path
) -> None:
    environment = {**os.environ, "PYTHONPATH": str(repository), "NUMBA_CACHE_DIR": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-m", "tracked_env.cli.main", "evaluate", "--policies", "adaptive"],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        # In the background of a shell SIGINT is ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    until = time.monotonic() + 60.0
    while not [*tmp_path.rglob("*.kernel")] and time.monotonic() < until:  # then it compiles
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    lines = [line for line in error.splitlines() if line.strip() and "steps/s" not in line]
    assert lines == ["tracked-env evaluate: interrupted; finished episodes are kept, run it again"]


def test_the_options_of_the_front_and_of_the_command_are_the_same() -> None:
    import evaluate

    assert evaluate.Config is Config
