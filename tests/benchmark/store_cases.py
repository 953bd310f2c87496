"""Chunks as the runner stores them."""

from pathlib import Path

from tracked_env.benchmark.metrics import METRICS, OPTIONAL
from tracked_env.benchmark.store import Record, Store

IDENTITY = {"seed": 0, "sensors": "rtk"}


PRINTS = {"a": "1"}


def record(episode: int, rmse: float = 0.5) -> Record:
    """What the runner stores of an episode."""
    known = {"episode": episode, "seed": episode, "digest": f"d{episode}", "ended": "time"}
    values = dict.fromkeys(METRICS, 0.5) | dict.fromkeys(OPTIONAL)
    return {**known, **values, "tracking_rmse": rmse}


def chunk(first: int = 0, policy: str = "a", fingerprint: str = "1", rmse: float = 0.5) -> Record:
    return {
        "policy": policy, "fingerprint": fingerprint, "set": "s", "predict_time": 1e-6,
        "episodes": [record(first + i, rmse) for i in range(2)],
    }  # fmt: skip


def two_chunks(folder: Path) -> Path:
    """A folder in which two finished chunks are stored."""
    store = Store(folder, IDENTITY)
    store.append(chunk(0))
    store.append(chunk(2))
    return store.folder
