"""The command: a tiny run, a kill in the middle, wrong arguments, and its help."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evaluate as evaluate_module
from baselines.registry import POLICIES
from tracked_env import SPEED_ID, TERRAIN_ID
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.report import SEPARATION_RATIO
from tracked_env.benchmark.sets import EPISODES, SETS, VERSIONS, default_sets
from tracked_env.observation import SIZE

TINY = ("--sets", "payload", "--episodes", "2", "--duration", "1", "--no-figures")
THREE = ("--policies", "nominal", "adaptive", "oracle")


@pytest.fixture
def evaluate(repository: Path, tmp_path: Path) -> Any:
    """Run evaluate.py in an empty folder; returns the finished process."""

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(repository / "evaluate.py"), *arguments]
        environment = {**os.environ, "PYTHONPATH": str(repository), "COLUMNS": "200"}
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
        )

    return run


def result(folder: Path) -> dict[str, Any]:
    (file,) = folder.glob("results/*/results.json")
    return dict(json.loads(file.read_text()))


def test_a_small_run_prints_the_summary_and_writes_results_and_figures(
    evaluate: Any, tmp_path: Path
) -> None:
    done = evaluate(*TINY[:-1], *THREE, "--sensors", '{"preset": "rtk", "pose_delay": 0.02}')
    assert done.returncode == 0, done.stderr
    assert "clearly worse" in done.stdout
    document = result(tmp_path)
    assert [(r["policy"], r["episode"]) for r in document["episodes"]] == [
        ("nominal", 0), ("nominal", 1), ("adaptive", 0), ("adaptive", 1), ("oracle", 0),
        ("oracle", 1),
    ]  # fmt: skip
    assert document["benchmark"]["comparable"] is False
    assert "sets of your own, not v2: sensors" in done.stdout
    assert "Leaderboard" in done.stdout
    assert document["identity"]["sensors"] == {"preset": "rtk", "pose_delay": 0.02}
    (folder,) = (tmp_path / "results").iterdir()
    assert "data:image/png" in (folder / "leaderboard.html").read_text()
    assert len(json.loads((folder / "leaderboard.json").read_text())["agents"]) == 3
    assert folder.name.startswith("rtk-1s-seed0-")
    assert {path.name for path in (folder / "figures").iterdir()} == {
        "overview.png", "errors.png", "paths-payload.png", "drive-payload.png",
        "beliefs-payload.png",
    }  # fmt: skip


def test_a_run_that_was_killed_continues_with_what_it_had(
    evaluate: Any, repository: Path, tmp_path: Path
) -> None:
    arguments = ("--sets", "payload", "--episodes", "6", "--chunk", "1", "--no-figures",
                 "--duration", "15", *THREE)  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, str(repository / "evaluate.py"), *arguments],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    began = time.monotonic()
    kept: list[str] = []
    while len(kept) < 3 and process.poll() is None and time.monotonic() - began < 200:
        time.sleep(0.02)
        files = list(tmp_path.glob("results/*/episodes.jsonl"))
        kept = files[0].read_text().splitlines() if files else []
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = files[0].read_text().splitlines()
    assert 3 <= len(kept) < 1 + 18, "killed too early or too late to show anything"
    again = evaluate(*arguments)
    assert again.returncode == 0, again.stderr
    assert f"{len(kept) - 1} of 18 episodes are already in" in again.stdout
    lines = files[0].read_text().splitlines()
    assert lines[: len(kept)] == kept
    assert len(lines) == 1 + 18
    assert len(result(tmp_path)["episodes"]) == 18


def test_a_policy_of_another_package_is_compared_from_its_folder(
    evaluate: Any, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "class Coast:\n"
        "    def predict(self, observation, state=None, episode_start=None, deterministic=True):\n"
        "        return np.zeros((len(observation), 2), dtype=np.float32), state\n"
    )
    done = evaluate(*TINY, "--policies", "mine:Coast", "oracle")
    assert done.returncode == 0, done.stderr
    assert {r["policy"] for r in result(tmp_path)["episodes"]} == {"mine:Coast", "oracle"}


@pytest.mark.parametrize(("env", "duration"), [(SPEED_ID, 3), (TERRAIN_ID, 12)])
def test_other_environments_have_their_own_policies_sets_and_score(
    env: str, duration: int, evaluate: Any, tmp_path: Path
) -> None:
    policies = ("uc", "slc", "slc-adaptive", "slc-oracle")
    done = evaluate(
        "--env", env, "--policies", *policies, "--episodes", "2",
        "--duration", str(duration), "--no-figures",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = result(tmp_path)
    assert {r["set"] for r in document["episodes"]} == set(default_sets(env))
    assert {r["policy"] for r in document["episodes"]} == set(policies)
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.startswith(f"{env.partition('/')[2].lower()}-{duration}s-seed0-")
    agents = json.loads((folder / "leaderboard.json").read_text())["agents"]
    scores = {agent["agent"]: agent["overall"]["score"]["value"] for agent in agents}
    assert scores["uc"] == 0.0
    assert scores["slc-oracle"] == 1.0


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
        ({"env": "CartPole-v1"}, "unknown environment 'CartPole-v1'"),
        ({"policies": ("json:dumps",)}, "policy 'json:dumps', when it was made: TypeError"),
        ({"policies": ("sys:exit",)}, "policy 'sys:exit', when it was made: it called sys.exit"),
        ({"policies": ("a\nb=nominal",)}, "that can be printed"),
    ],
)
def test_a_wrong_argument_is_one_line_and_starts_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: dict[str, Any], message: str
) -> None:
    output = tmp_path / "results"
    assert evaluate_module.main(evaluate_module.Config(output=output, **arguments)) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize("paper", ["none", "strawa2021"])
@pytest.mark.parametrize("kind", ["file", "proc", "too long"])
def test_an_output_that_cannot_be_written_is_one_line_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, paper: Any
) -> None:
    (tmp_path / "file").write_text("mine")
    output = {
        "file": tmp_path / "file", "proc": Path("/proc/nothing"), "too long": tmp_path / ("x" * 999)
    }[kind]  # fmt: skip
    config = evaluate_module.Config(output=output, policies=("nominal",), duration=1.0, paper=paper)
    assert evaluate_module.main(config) in (1, 2)
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("evaluate.py: ")
    assert captured.out == ""
    assert (tmp_path / "file").read_text() == "mine"


WRONG = """
import sys
import numpy as np

class Exits:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        sys.exit(0)

class Exiting:
    def __init__(self):
        sys.exit(0)

class Raises(Exits):
    def predict(self, *args, **kwargs):
        raise RuntimeError("lost\\nit")
"""


@pytest.mark.parametrize(
    ("attribute", "status", "message"),
    [
        ("Exits", 1, "set 'payload', step 0: it called sys.exit(0)"),
        ("Exiting", 2, "when it was made: it called sys.exit(0)"),
        ("Raises", 1, "set 'payload', step 0: RuntimeError: lost it ("),
    ],
)
def test_a_policy_that_raises_or_exits_is_a_failure_in_one_line_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    attribute: str, status: int, message: str,
) -> None:  # fmt: skip
    (tmp_path / "wrong_policies.py").write_text(WRONG)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "wrong_policies", raising=False)
    config = evaluate_module.Config(
        output=tmp_path / "results", policies=("nominal", f"wrong_policies:{attribute}"),
        sets=("payload",), episodes=1, duration=0.5, figures=False,
    )  # fmt: skip
    assert evaluate_module.main(config) == status
    (line,) = [
        line for line in capsys.readouterr().err.splitlines() if line.startswith("evaluate.py")
    ]
    assert f"policy 'wrong_policies:{attribute}', {message}" in line


def test_damaged_results_are_one_line_and_damaged_traces_are_left_out_with_a_notice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = evaluate_module.Config(
        output=tmp_path, policies=("nominal", "oracle"), sets=("payload",), episodes=2,
        duration=0.5,
    )  # fmt: skip
    assert evaluate_module.main(config) == 0
    (file,) = tmp_path.glob("*/episodes.jsonl")
    whole = file.read_text()
    capsys.readouterr()
    for text in (
        "[]\n",
        whole + "null\n",
        whole.replace('"tracking_rmse": ', '"tracking_rmse": -'),
    ):
        file.write_text(text)
        assert evaluate_module.main(config) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith(f"evaluate.py: {file}")
        assert captured.err.count("\n") == 1
    file.write_text(whole.replace('"digest": "', '"digest": "x', 1))
    assert evaluate_module.main(config) == 1
    assert "did not meet the same episodes" in capsys.readouterr().err
    file.write_text(whole)
    pytest.importorskip("matplotlib", reason="figures need the extra `render`")
    for trace in file.parent.glob("traces/*oracle.npz"):
        trace.write_bytes(b"mine")
    assert evaluate_module.main(config) == 0
    assert "oracle.npz is damaged and left out of the figures" in capsys.readouterr().out
    for trace in file.parent.glob("traces/*.npz"):
        trace.unlink()
    assert evaluate_module.main(config) == 0


def test_results_that_cannot_be_written_at_the_end_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = evaluate_module.Config(
        output=tmp_path, policies=("nominal",), sets=("payload",), episodes=1, duration=0.5,
        figures=False,
    )  # fmt: skip
    assert evaluate_module.main(config) == 0
    (file,) = tmp_path.glob("*/results.json")
    file.unlink()
    file.mkdir()
    capsys.readouterr()
    assert evaluate_module.main(config) == 1
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("evaluate.py: ")]
    assert "results.json" in line
    assert "Traceback" not in "".join(lines)
    assert list(file.parent.glob(".*.tmp")) == []


@pytest.mark.parametrize("delay", [0.2, 2.0, 9.0])  # [s] of imports, then of compilation
def test_an_interruption_while_it_starts_is_one_line(
    repository: Path, tmp_path: Path, delay: float
) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    process = subprocess.Popen(
        [sys.executable, str(repository / "evaluate.py"), *TINY, "--policies", "adaptive"],
        cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        # In the background of a shell SIGINT is ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in error
    lines = [line for line in error.splitlines() if line.strip() and "steps/s" not in line]
    assert lines == ["evaluate.py: interrupted; finished episodes are kept, run it again"]


def test_two_runs_in_one_folder_are_refused_with_a_clear_message(
    evaluate: Any, repository: Path, tmp_path: Path
) -> None:
    arguments = ("--sets", "payload", "--episodes", "64", "--chunk", "1", "--no-figures",
                 "--duration", "20", "--policies", "oracle")  # fmt: skip
    first = subprocess.Popen(
        [sys.executable, str(repository / "evaluate.py"), *arguments],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        began = time.monotonic()
        while not list(tmp_path.glob("results/*/episodes.jsonl")):
            assert first.poll() is None
            assert time.monotonic() - began < 200
            time.sleep(0.05)
        second = evaluate(*arguments)
        assert first.poll() is None, "it ended before the second one could be refused"
    finally:
        first.kill()
        first.wait()
    assert second.returncode == 2
    assert "another process writes results there" in second.stderr
    assert second.stderr.count("\n") == 1
    fewer = [*arguments]
    fewer[3] = "2"
    assert evaluate(*fewer).returncode == 0  # a killed process holds nothing


def test_the_help_explains_every_option(evaluate: Any) -> None:
    text = evaluate("--help").stdout
    for option in ("policies", "sets", "episodes", "seed", "sensors", "reference", "duration",
                   "lateral", "output", "figures", "video", "chunk"):  # fmt: skip
        assert f"--{option}" in text
    assert "the first one is the baseline" in text


def test_the_page_on_evaluation_shows_every_metric_and_policy_and_its_examples_run(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (repository / "docs" / "evaluation.md").read_text(encoding="utf-8")
    for name, metric in METRICS.items():
        assert f"| `{name}` | {metric.unit} | {metric.meaning} |" in text
    assert all(f"| `{name}` |" in text for name in POLICIES)
    assert f"at least {SEPARATION_RATIO}" in text
    assert all(f"| `{s.name}` | `{s.uncertainty}` |" in text for s in SETS.values())
    assert f"first {EPISODES} episodes" in text
    assert all(f"version {name}" in text for name in VERSIONS)
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        found: dict[str, Any] = {}
        exec(compile(block, "evaluation.md", "exec"), found)
        if "Proportional" in found:
            action, _ = found["Proportional"]().predict(np.zeros((3, SIZE), np.float32))
            assert action.shape == (3, 2)
    assert (tmp_path / "results" / "mine" / "episodes.jsonl").exists()
