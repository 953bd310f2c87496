"""Shards: parts of a run in processes that know nothing of each other, and what joins them."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmark.executor_cases import (
    CONFIG,
    episodes_stored,
    policies,
    records_of,
    values,
)
from tracked_env.benchmark import Store, run
from tracked_env.benchmark.executors import Shard
from tracked_env.benchmark.runner import pending
from tracked_env.cli.main import main


def test_shards_share_the_chunks_and_what_they_wrote_is_read_together(tmp_path: Path) -> None:
    entries = policies("nominal", "adaptive", "oracle")
    serial = records_of(tmp_path / "serial", entries)
    shards = [Shard(part, 3) for part in (1, 2, 3)]
    open_together = [Store(tmp_path / "shards", CONFIG.identity(), shard) for shard in shards]
    for store in open_together:
        run(CONFIG, entries, store)
        assert {c["policy"] for c in store.chunks} == {"nominal", "adaptive", "oracle"}
    stored = episodes_stored(tmp_path / "shards")
    assert len(stored) == len(set(stored)) == len(serial)
    merged = Store(tmp_path / "shards", CONFIG.identity())
    assert list(pending(CONFIG, entries, merged)) == []
    assert values(run(CONFIG, entries, merged)) == values(serial)
    assert merged.chunks == []  # nothing was copied or done twice
    assert merged.load_trace("adaptive", "drift") is not None


def test_a_shard_that_is_lost_is_made_up_for_by_the_run_that_merges(tmp_path: Path) -> None:
    entries = policies("nominal")
    run(CONFIG, entries, Store(tmp_path / "shards", CONFIG.identity(), Shard(1, 2)))
    torn = tmp_path / "shards" / "shard-1-of-2" / "episodes.jsonl"
    torn.write_bytes(torn.read_bytes()[:-20])
    store = Store(tmp_path / "shards", CONFIG.identity())
    merged = run(CONFIG, entries, store)
    assert store.notices == []
    assert values(merged) == values(records_of(tmp_path / "serial", entries))
    assert not torn.read_bytes().endswith(b"\n")  # the file of another process is left alone


def test_two_processes_of_one_shard_are_refused(tmp_path: Path, repository: Path) -> None:
    store = Store(tmp_path, CONFIG.identity(), Shard(1, 2))
    code = (
        "import sys; from pathlib import Path; from tracked_env.benchmark import *; "
        "from tracked_env.benchmark.executors import Shard; "
        "c = BenchmarkConfig(sets=('payload', 'drift'), episodes=36, duration=1.0); "
        f"Store(Path({str(tmp_path)!r}), c.identity(), Shard(int(sys.argv[1]), 2))"
    )
    environment = {**os.environ, "PYTHONPATH": str(repository)}

    def opened(part: int) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", code, str(part)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100)

    same, other = opened(1), opened(2)
    assert "shard-1-of-2: another process writes results there" in same.stderr
    assert other.returncode == 0, other.stderr
    assert store.chunks == []


def test_the_parts_of_all_shards_are_everything_and_share_nothing() -> None:
    for parts in (1, 2, 3, 7, 30):
        dealt = [job for part in range(1, parts + 1) for job in Shard(part, parts).of(range(20))]
        assert sorted(dealt) == list(range(20))


def test_shards_from_the_command_line_end_in_the_tables_of_one_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["evaluate", "--sets", "payload", "--episodes", "40", "--duration", "0.5",
               "--no-figures", "--policies", "nominal", "oracle"]  # fmt: skip
    for part in ("1/2", "2/2"):
        assert main([*command, "--shard", part]) == 0
        assert f"shard {part} is done" in capsys.readouterr().out
    assert not list(tmp_path.rglob("results.json"))
    assert main(command) == 0
    assert "80 of 80 episodes are already in" in capsys.readouterr().out
    (document,) = tmp_path.rglob("results.json")
    assert len(json.loads(document.read_text())["episodes"]) == 80
