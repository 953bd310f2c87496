"""Small runs, their records, and what they stored."""

import json

from tracked_env.benchmark import BenchmarkConfig, Store, run
from tracked_env.benchmark.policies import policies_for

CONFIG = BenchmarkConfig(sets=("payload", "drift"), episodes=36, duration=1.0)


TIMING = ("predict_time", "beside")


def policies(*specs):
    """Policies as the command line finds them."""
    return policies_for("torque", specs)


def values(records):
    """Records without what depends on the time that a computer took."""
    return [{k: v for k, v in record.items() if k not in TIMING} for record in records]


def records_of(folder, entries, executor=None):
    return run(CONFIG, entries, Store(folder, CONFIG.identity()), executor=executor)


def episodes_stored(folder):
    """Every episode in the files of a folder, as often as it is there."""
    return [
        (chunk["set"], chunk["policy"], episode["episode"])
        for path in folder.rglob("episodes.jsonl")
        for chunk in map(json.loads, path.read_text().splitlines()[1:])
        for episode in chunk["episodes"]
    ]
