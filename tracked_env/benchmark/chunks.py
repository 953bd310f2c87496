"""Chunks of episodes: what one task of a benchmark is, and which of them a store lacks."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from tracked_env.benchmark.benchmark_config import CHUNK_MIN, BenchmarkConfig
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.store import Record, Store

TASKS = 3  # per worker, so that none is idle for long at the end


class Task(NamedTuple):
    """One chunk of one policy on one set."""

    policy: PolicyEntry
    uncertainty_set: str
    episodes: tuple[int, ...]

    @property
    def label(self) -> str:
        """What a progress bar shows of it."""
        return f"{self.uncertainty_set}: {self.policy.name}"


class SentTask(NamedTuple):
    """A task as another process gets it."""

    policy: str
    uncertainty_set: str
    episodes: tuple[int, ...]

    def __str__(self) -> str:
        first, last = self.episodes[0], self.episodes[-1]
        return f"{self.uncertainty_set}: {self.policy}, episodes {first} to {last},"


class Finished(NamedTuple):
    """What a store keeps of a task."""

    chunk: Record
    trace: dict[str, NDArray[Any]] | None  # of the first episodes, for the figures


def chunk_size(config: BenchmarkConfig, policies: int, workers: int) -> int:
    """Episodes of a chunk: smaller ones than asked for only below TASKS tasks a worker."""
    size = config.chunk
    while size > CHUNK_MIN:
        tasks = -(-config.episodes // size) * len(config.sets) * policies
        if tasks >= TASKS * workers:
            break
        size = max(size // 2, CHUNK_MIN)
    return size


def pending(
    config: BenchmarkConfig, policies: Sequence[PolicyEntry], store: Store, workers: int = 1
) -> Iterator[Task]:
    """The chunks that the store lacks, set by set, all policies on a chunk in turn.

    workers: how many run at the same time. The store of a shard gets the chunks of that shard.
    """
    return (
        task for task in store.share(_chunks(config, policies, store, workers)) if task.episodes
    )


def _chunks(
    config: BenchmarkConfig, policies: Sequence[PolicyEntry], store: Store, workers: int
) -> Iterator[Task]:
    """All chunks, with the episodes that the store lacks, if any: the same ones for every shard."""
    have = {
        (r["set"], r["policy"], r["episode"])
        for r in store.records({entry.name: entry.fingerprint for entry in policies})
    }
    size = chunk_size(config, len(policies), max(workers, store.shards))
    for name in config.sets:
        for first in range(0, config.episodes, size):
            chunk = range(first, min(first + size, config.episodes))
            for entry in policies:
                missing = tuple(i for i in chunk if (name, entry.name, i) not in have)
                yield Task(entry, name, missing)
