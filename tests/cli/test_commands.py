"""The command `tracked-env`: comparisons, options, how commands end, what only a clone has."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.processes import python
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID, entry_points
from tracked_env.benchmark.policy_interface import PolicyError
from tracked_env.cli import command_line
from tracked_env.cli.command_line import one_line, reported
from tracked_env.cli.evaluate_options import Config, benchmark_config, env_of, parsed
from tracked_env.cli.main import COMMANDS, main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

TINY = ("--sets", "payload", "--episodes", "1", "--duration", "0.5")


def test_quiet_shows_where_the_results_are_and_no_table(capsys):
    policies = ("--policies", "nominal,oracle", "ppo-blind")
    assert main(["evaluate", *TINY, *policies, "--no-figures", "--quiet"]) == 0
    shown = capsys.readouterr()
    (page,) = Path("results").glob("*/leaderboard.html")
    assert shown.out.rstrip().endswith(f"the page: {page}")
    assert "RMSE" not in shown.out and "Leaderboard" not in shown.out
    assert shown.err == ""
    text, results = page.read_text(), json.loads((page.parent / "results.json").read_text())
    assert "<dt>command</dt>" in text and "<dt>machine</dt>" in text
    assert results["hash"] in text and "ppo-blind" in text
    found = {record["policy"] for record in results["episodes"]}
    assert found == {"nominal", "oracle", *(f"ppo-blind@{seed}" for seed in range(5))}


def test_the_environment_is_that_of_the_sets_where_none_is_named():
    assert env_of(None, None) == TORQUE_ID
    assert env_of(None, ("floor-mixed",)) == SPEED_ID
    assert env_of(TERRAIN_ID, None) == TERRAIN_ID
    with pytest.raises(ValueError, match="'floor' is of Speed-v0, which contradicts 'payload'"):
        env_of(None, ("payload", "floor"))
    benchmark = benchmark_config(parsed(["--sets", "slope"], "test"))
    assert benchmark.env == TERRAIN_ID


def ended(arguments):
    """Exit status of a command that ends by itself or by its parser."""
    try:
        return main(arguments)
    except SystemExit as error:
        return int(str(error.code or 0))


PLAN = "plan --goal 2 2.5 -0.4 --method dubins --no-slip --no-figures"
# A command line, its exit status, and what the one line on stderr says.
WRONG = [
    ("evaluat", 2, r"COMMAND: invalid choice: 'evaluat'.*did you mean evaluate\?"),
    ("evaluate --polices nominal", 2, r"--polices nominal; did you mean --policies\?"),
    ("evaluate --episodes 1.5", 2, "--episodes: 1.5; must be a whole number"),
    ("evaluate --duration 3s", 2, "--duration: 3s; must be a number, with a point"),
    ("evaluate --episode 3", 2, "unrecognized arguments: --episode 3"),
    ("evaluate --sets payload --policies nominl", 2, "unknown policy"),
    (
        "render nominal --file one.bmp",
        2,
        "file one.bmp: must end in .mp4, .webp, .gif, .png or .html",
    ),
    ("render nominal --set mud", 2, "unknown evaluation set 'mud'"),
    ("render uc", 1, "this policy commands each sprocket's speed"),
    ("render nothing", 2, "unknown policy"),
    ("render nominal --file a.html --at 1", 2, "a page has its own time and view"),
    ("render nominal --file a.html --view 3d", 2, "a page has its own time and view"),
    ("timing adaptve", 2, "unknown policy .*'adaptve'.*Did you mean 'adaptive'"),
    ("timing slc-adaptive", 1, "this policy commands each sprocket's speed"),
    ("timing nominal --calls 0", 2, r"--calls = 0.0; must be a number in \[1, "),
    ("timing nominal --set payloud", 2, "unknown evaluation set 'payloud'"),
    ("compile nominal --workers 0", 2, "--workers = 0"),
    ("tune ppo-blind", 2, "declares no settings to be tuned"),
    ("tune adaptiv", 2, "unknown policy 'adaptiv'.*Did you mean 'adaptive'"),
    ("tune adaptive --budget 1", 2, r"--budget = 1.0; must be a number in \[3, 10000\]"),
    ("tune adaptive --episodes 2", 2, r"--episodes = 2.0; must be a number in \[4, 10000\]"),
    ("tune adaptive --sets payloud", 2, "unknown evaluation set 'payloud'"),
    ("tune slc --env Torque-v0", 2, "this policy commands each sprocket's speed"),
    ("drive --observer oracle", 2, "oracle: it is given the truth; must be .* as adaptive"),
    ("drive --observer nominal", 2, "nominal: it identifies nothing; must be .* as adaptive"),
    (f"{PLAN} --goal nan 0 0", 2, "goal x = nan"),
    (f"{PLAN} --method dubin", 2, "unknown method 'dubin'"),
    (f"{PLAN} --vehicle foci", 2, "unknown vehicle 'foci'"),
    (f"{PLAN} --v-min 0.5", 2, "Did you swap them"),
    (f"{PLAN} --reserve 0.9", 2, "Is the reserve too large"),
    (f"{PLAN} --friction -0.1", 2, "mu = -0.1"),
    (f"{PLAN} --obstacle-circle 2 2.5 0.3", 2, "the vehicle at its goal is"),
    (f"{PLAN} --reverse", 2, "must be False with method = 'dubins'"),
    (f"{PLAN} --margin -1", 2, "margin = -1.0 m; must be"),
    (f"{PLAN} --room nan", 2, "room = nan m; must be"),
    (f"{PLAN} --time-limit -1", 2, "time_limit = -1.0 s; must be"),
    (f"{PLAN} --slope 0.1 0", 2, "slope without slip"),
    (f"{PLAN} --goal 2 2 90", 2, "--goal yaw = 90.0 rad; must be a number in"),
    (f"{PLAN} --via 1 1 45", 2, r"Did you pass degrees\?"),
    (f"{PLAN} --v-max 100", 2, r"--v-max = 100.0 m/s; must be a number in \[0.001, 30\] m/s."),
    (f"{PLAN} --sprocket-acceleration -1", 2, r"--sprocket-acceleration = -1.0 rad/s\^2"),
]
# Sets of another environment than the one that is named, and sets that are not there.
CONTRADICTS = "'payload' is of Torque-v0, which contradicts --env Speed-v0.*envs"
NEAR = r"unknown evaluation set 'friction-stp'.*Did you mean 'friction-step'\?"
OF_SETS = ("evaluate --policies nominal --sets", "tune adaptive --sets", "render nominal --set")
for start in (*OF_SETS, "record nominal --set", "drive --observer adaptive --set"):
    WRONG.append((f"{start} payload --env Speed-v0", 2, f"{start.split()[-1]} {CONTRADICTS}"))
    WRONG.append((f"{start} friction-stp --env Speed-v0", 2, NEAR))


@pytest.mark.parametrize(("line", "status", "says"), WRONG, ids=lambda value: str(value)[:60])
def test_a_wrong_input_is_one_line_with_its_value_what_is_allowed_and_what_is_near(
    line, status, says, capsys
):
    command, *arguments = line.split()
    assert ended([command, *arguments]) == status
    error = capsys.readouterr().err
    program = f"tracked-env {command}: " if command in COMMANDS else "tracked-env: "
    assert error.startswith(program) and error.count("\n") == 1
    assert re.search(says, error)
    assert not list(Path().iterdir())


def test_a_planner_that_is_not_installed_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(entry_points, "_of_clone", lambda group: [])
    monkeypatch.setattr(entry_points, "entry_points", lambda group: ())
    assert main(PLAN.split()) == 2
    error = capsys.readouterr().err
    assert "no installed package registers 'plan'" in error and error.count("\n") == 1


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"train"}))
@pytest.mark.parametrize("wrong", ["--nosuch", "--env=Sped-v0"])
def test_an_option_or_environment_that_a_command_does_not_know_is_one_line(wrong, command, capsys):
    assert ended([command, wrong]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"tracked-env {command}: ") and error.count("\n") == 1
    has_env = command not in ("plan", "vehicle", "identify", "slip")
    assert ("Did you mean 'Speed-v0'?" in error) == (has_env and wrong != "--nosuch")


def test_without_a_command_all_commands_are_listed(capsys):
    assert main([]) == 2
    shown = capsys.readouterr().err
    assert all(f"\n  {name} " in shown for name in COMMANDS)


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
def test_a_command_line_is_the_configuration_that_it_says(arguments, expected):
    assert parsed(arguments, "test") == Config(**expected)


def test_a_file_with_a_comma_in_its_name_is_one_policy():
    Path("a,b.zip").write_bytes(b"")
    assert parsed(["--policies", "a,b.zip", "mine=a,b.zip"], "test").policies == (
        "a,b.zip",
        "mine=a,b.zip",
    )


def test_leaderboard_evaluates_everything_on_every_environment(monkeypatch):
    asked = []
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
    arguments, message, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr(command_line, "ROOT", tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error and "Clone the repository" in error and error.count("\n") == 1
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "train"])
def test_every_command_has_a_help(command, capsys):
    assert ended([command, "--help"]) == 0
    shown = capsys.readouterr().out
    assert "usage:" in shown and len(shown.splitlines()) > 5
    if command in ("record", "render", "drive"):  # no option that they do not follow
        assert "--seed" in shown and "--set " in shown
        assert not any(f"--{name}" in shown for name in ("all", "sets-version", "episodes"))


def test_the_training_which_replaces_the_process_has_a_help():
    pytest.importorskip("torch", reason="train.py needs the extra `rl`")
    shown = python("-m", "tracked_env.cli.main", "train", "--help", COLUMNS="100").stdout
    assert "usage:" in shown and len(shown.splitlines()) > 5


def test_an_interruption_is_one_line_that_names_the_command(repository, tmp_path):
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


def test_the_options_of_the_front_and_of_the_command_are_the_same():
    import evaluate

    assert evaluate.Config is Config


@pytest.mark.parametrize(
    ("error", "status"),
    [(ValueError("wrong"), 2), *((of("wrong"), 1) for of in (PolicyError, OSError, ImportError))],
    ids=lambda value: type(value).__name__,
)
def test_errors_of_a_command_are_one_line_and_an_exit_status(error, status, capsys):
    def fails(arguments, program):
        raise error

    assert reported(fails)([], "program") == status
    assert capsys.readouterr().err == "program: wrong\n"


def test_an_error_of_a_file_has_its_name_and_the_likely_cause(tmp_path):
    with pytest.raises(OSError) as missing:
        (tmp_path / "log.csv").read_text()
    said = one_line(missing.value)
    assert said.startswith(f"{tmp_path / 'log.csv'}: no such file or directory. Is the name right")
    (tmp_path / "taken").write_text("")
    with pytest.raises(OSError) as taken:
        (tmp_path / "taken").mkdir()
    assert "A file stands where a folder is needed" in one_line(taken.value)
    assert one_line(OSError("wrong")) == "wrong"


@pytest.mark.parametrize("error", [BrokenPipeError(), TypeError("a fault of ours")])
def test_a_closed_pipe_and_faults_of_the_program_are_not_reported_as_errors_of_the_user(error):
    def fails(arguments, program):
        raise error

    with pytest.raises(type(error)):
        reported(fails)([], "program")
