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

from baselines.registry import POLICIES
from tracked_env import SPEED_ID
from tracked_env.benchmark.metrics import METRICS
from tracked_env.benchmark.report import SEPARATION_RATIO
from tracked_env.benchmark.sets import EPISODES, SETS, VERSION, default_sets
from tracked_env.observation import SIZE

pytest.importorskip("tyro", reason="the command line needs the extra `cli`")

import evaluate as evaluate_module

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


def test_the_other_environment_has_its_own_policies_sets_and_score(
    evaluate: Any, tmp_path: Path
) -> None:
    policies = ("uc", "slc", "slc-adaptive", "slc-oracle")
    done = evaluate(
        "--env", "tracked_env/Speed-v0", "--policies", *policies, "--episodes", "2",
        "--duration", "3", "--no-figures",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = result(tmp_path)
    assert {r["set"] for r in document["episodes"]} == set(default_sets(SPEED_ID))
    assert {r["policy"] for r in document["episodes"]} == set(policies)
    (folder,) = (tmp_path / "results").iterdir()
    assert folder.name.startswith("speed-v0-3s-seed0-")
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
    assert f"version {VERSION}" in text
    monkeypatch.chdir(tmp_path)
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        found: dict[str, Any] = {}
        exec(compile(block, "evaluation.md", "exec"), found)
        if "Proportional" in found:
            action, _ = found["Proportional"]().predict(np.zeros((3, SIZE), np.float32))
            assert action.shape == (3, 2)
    assert (tmp_path / "results" / "mine" / "episodes.jsonl").exists()
