"""The command: a tiny run, an interruption, its help, and one line where something is wrong."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import evaluate as evaluate_module
from baselines.registry import POLICIES
from tests.processes import REPOSITORY, python
from tracked_env import SPEED_ID, TERRAIN_ID
from tracked_env.benchmark.evaluation_sets import (
    EPISODES,
    NEWEST,
    SETS,
    VERSIONS,
    default_sets,
    names_of,
)
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.summary import SEPARATION_RATIO
from tracked_env.observation import SIZE

TINY = ("--sets", "payload", "--episodes", "2", "--duration", "1", "--no-figures")
THREE = ("--policies", "nominal", "adaptive", "oracle")


@pytest.fixture
def evaluate(tmp_path):
    """Run evaluate.py in an empty folder; returns the finished process."""

    return partial(python, REPOSITORY / "evaluate.py", cwd=tmp_path, COLUMNS="200")


def result(folder):
    (file,) = folder.glob("results/*/results.json")
    return dict(json.loads(file.read_text()))


@pytest.mark.slow
def test_a_small_run_prints_the_summary_and_writes_results_and_figures(evaluate, tmp_path):
    process = evaluate(*TINY[:-1], *THREE, "--sensors", '{"preset": "rtk", "pose_delay": 0.02}')
    assert "clearly worse" in process.stdout
    document = result(tmp_path)
    assert [(r["policy"], r["episode"]) for r in document["episodes"]] == [
        ("nominal", 0), ("nominal", 1), ("adaptive", 0), ("adaptive", 1), ("oracle", 0),
        ("oracle", 1),
    ]  # fmt: skip
    assert document["benchmark"]["comparable"] is False
    assert "sets of your own, not v2: sensors" in process.stdout
    assert "Leaderboard" in process.stdout
    assert document["identity"]["sensors"] == {"preset": "rtk", "pose_delay": 0.02}
    (folder,) = (tmp_path / "results").iterdir()
    assert "distance to reference [m]" in (folder / "leaderboard.html").read_text()
    assert len(json.loads((folder / "leaderboard.json").read_text())["agents"]) == 3
    assert folder.name.startswith("rtk-1s-seed0-")
    assert {path.name for path in (folder / "figures").iterdir()} == {
        "errors.svg",
        "paths-payload.svg",
        "drive-payload.svg",
        "beliefs-payload.svg",
    }


@pytest.mark.slow
def test_a_policy_of_another_package_is_compared_from_its_folder(evaluate, tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Coast:\n"
        "    def predict(self, observation, state=None, episode_start=None, deterministic=True):\n"
        "        return np.zeros((len(observation), 2), dtype=np.float32), state\n"
    )
    evaluate(*TINY, "--policies", "mine:Coast", "oracle")
    assert {r["policy"] for r in result(tmp_path)["episodes"]} == {"mine:Coast", "oracle"}


@pytest.mark.slow
@pytest.mark.parametrize(("env", "duration"), [(SPEED_ID, 12.0), (TERRAIN_ID, 6.0)])
def test_other_environments_have_their_own_policies_sets_and_score(env, duration, tmp_path):
    policies, few = ("uc", "slc-oracle"), {"episodes": 1, "figures": False}
    config = evaluate_module.Config(
        env=env, policies=policies, duration=duration, output=tmp_path / "results", **few
    )
    assert evaluate_module.main(config) == 0
    document = result(tmp_path)
    assert {r["set"] for r in document["episodes"]} == set(default_sets(env))
    assert {r["policy"] for r in document["episodes"]} == set(policies)
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.startswith(f"{env.partition('/')[2].lower()}-{duration:g}s-seed0-")
    agents = json.loads((folder / "leaderboard.json").read_text())["agents"]
    scores = {agent["agent"]: agent["overall"]["score"]["value"] for agent in agents}
    assert scores == {"uc": 0.0, "slc-oracle": 1.0}


WHILE_IT_DRIVES = [pytest.param(delay, marks=pytest.mark.slow) for delay in (2.0, None)]


@pytest.mark.parametrize("delay", [0.2, *WHILE_IT_DRIVES])  # [s] of imports; None: it compiles
def test_an_interruption_while_it_starts_is_one_line(repository, tmp_path, delay):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    # In the background of a shell SIGINT is ignored, and children inherit that.
    heed = partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    command = [sys.executable, str(repository / "evaluate.py"), *TINY, "--policies", "adaptive"]
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, preexec_fn=heed, **streams)
    until = time.monotonic() + (60.0 if delay is None else delay)
    while time.monotonic() < until and (delay is not None or not [*tmp_path.rglob("*.kernel")]):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in error
    lines = [line for line in error.splitlines() if line.strip() and "steps/s" not in line]
    assert lines == ["evaluate.py: interrupted; finished episodes are kept, run it again"]


def test_the_help_explains_every_option(evaluate):
    text = evaluate("--help").stdout
    for option in ("policies", "sets", "episodes", "seed", "sensors", "reference", "duration",
                   "lateral", "output", "figures", "video", "chunk"):  # fmt: skip
        assert f"--{option}" in text
    assert "the first one is the baseline" in text


def test_the_page_on_evaluation_shows_every_metric_and_policy_and_its_examples_run(
    repository, tmp_path, monkeypatch
):
    docs = repository / "docs"
    text, sets, metrics = (
        (docs / f"{page}.md").read_text(encoding="utf-8")
        for page in ("evaluation", "evaluation_sets", "metrics")
    )
    for name, metric in METRICS.items():
        assert f"| `{name}` | {metric.unit} | {metric.meaning} |" in metrics
    assert all(f"| `{name}` |" in text for name in POLICIES)
    assert f"at least {SEPARATION_RATIO}" in metrics
    default = [SETS[name] for version in NEWEST for name in names_of(version)]
    assert all(f"| `{s.name}` | `{s.uncertainty}` |" in sets for s in default)
    assert f"first {EPISODES} episodes" in sets
    assert all(name in sets for name in VERSIONS)
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        candidates = {}
        exec(compile(block, "evaluation.md", "exec"), candidates)
        if "Proportional" in candidates:
            action, _ = candidates["Proportional"]().predict(np.zeros((3, SIZE), np.float32))
            assert action.shape == (3, 2)
    assert (tmp_path / "results" / "mine" / "episodes.jsonl").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policies": ("uc",)}, "the environment takes its torque"),
        ({"policies": ("oracle",), "env": SPEED_ID}, "the environment takes its speed"),
        ({"sets": ("friction", "payload")}, "must be of one environment"),
        ({"sensors": "gps"}, "unknown sensor preset 'gps'"),
        ({"sets": ("mud",)}, "unknown evaluation set 'mud'"),
        ({"policies": ("agent.zip",)}, "no such file"),
        ({"reference": '{"kind": '}, "not a JSON object"),
        ({"env": "CartPole-v1"}, "CartPole-v1 is not an environment of tracked vehicles"),
        ({"env": "Cart-v1"}, "unknown environment 'Cart-v1'"),
        ({"policies": ("json:dumps",)}, "policy 'json:dumps', when it was made: TypeError"),
        ({"policies": ("sys:exit",)}, "policy 'sys:exit', when it was made: it called sys.exit"),
        ({"policies": ("a\nb=nominal",)}, "that can be printed"),
    ],
)
def test_a_wrong_argument_is_one_line_and_starts_nothing(tmp_path, capsys, arguments, message):
    output = tmp_path / "results"
    assert evaluate_module.main(evaluate_module.Config(output=output, **arguments)) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize("paper", ["none", "strawa2021"])
@pytest.mark.parametrize("kind", ["file", "proc", "too long"])
def test_an_output_that_cannot_be_written_is_one_line_before_anything_runs(
    tmp_path, capsys, kind, paper
):
    (tmp_path / "file").write_text("mine")
    places = {"proc": Path("/proc/nothing"), "too long": tmp_path / ("x" * 999)}
    output = places.get(kind, tmp_path / "file")
    config = evaluate_module.Config(output=output, policies=("nominal",), duration=1.0, paper=paper)
    assert evaluate_module.main(config) in (1, 2)
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("evaluate.py: ")
    assert captured.out == ""
    assert (tmp_path / "file").read_text() == "mine"


@pytest.fixture
def config(tmp_path):
    """A tiny comparison that has been run once."""
    config = evaluate_module.Config(
        output=tmp_path, policies=("nominal", "oracle"), sets=("payload",), episodes=2, duration=0.5
    )
    assert evaluate_module.main(config) == 0
    return config


def test_damaged_results_are_one_line_and_damaged_traces_are_left_out_with_a_notice(config, capsys):
    (file,) = config.output.glob("*/episodes.jsonl")
    whole = file.read_text()
    capsys.readouterr()
    file.write_text("[]\n")
    assert evaluate_module.main(config) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"evaluate.py: {file}") and captured.err.count("\n") == 1
    file.write_text(whole.replace('"digest": "', '"digest": "x', 1))
    assert evaluate_module.main(config) == 1
    assert "did not meet the same episodes" in capsys.readouterr().err
    file.write_text(whole)
    for trace in file.parent.glob("traces/*oracle.npz"):
        trace.write_bytes(b"mine")
    assert evaluate_module.main(config) == 0
    assert "oracle.npz is damaged and left out of the figures" in capsys.readouterr().out
    for trace in file.parent.glob("traces/*.npz"):
        trace.unlink()
    assert evaluate_module.main(config) == 0


def test_results_that_cannot_be_written_at_the_end_are_one_line(config, capsys):
    (file,) = config.output.glob("*/results.json")
    file.unlink()
    file.mkdir()
    capsys.readouterr()
    assert evaluate_module.main(config) == 1
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("evaluate.py: ")]
    assert "results.json" in line
    assert "Traceback" not in "".join(lines)
    assert list(file.parent.glob(".*.tmp")) == []
