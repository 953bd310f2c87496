"""Small runs, their records, and what they stored."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tracked_env.benchmark import BenchmarkConfig, Store, run
from tracked_env.benchmark.executors import Executor
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import PolicyEntry

CONFIG = BenchmarkConfig(sets=("payload", "drift"), episodes=36, duration=1.0)


TIMING = ("predict_time", "beside")


def policies(*specs: str) -> list[PolicyEntry]:
    """Policies as the command line finds them."""
    return policies_for("torque", specs)


def values(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Records without what depends on the time that a computer took."""
    return [{k: v for k, v in record.items() if k not in TIMING} for record in records]


def records_of(
    folder: Path, entries: Sequence[PolicyEntry], executor: Executor | None = None
) -> list[dict[str, Any]]:
    return run(CONFIG, entries, Store(folder, CONFIG.identity()), executor=executor)


def episodes_stored(folder: Path) -> list[tuple[str, str, int]]:
    """Every episode in the files of a folder, as often as it is there."""
    return [
        (chunk["set"], chunk["policy"], episode["episode"])
        for path in folder.rglob("episodes.jsonl")
        for chunk in map(json.loads, path.read_text().splitlines()[1:])
        for episode in chunk["episodes"]
    ]
