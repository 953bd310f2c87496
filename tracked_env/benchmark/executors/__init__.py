"""Where independent jobs run: in this process, in others of this machine, or on other machines.

    serial          no executor: one job after the other, in this process
    worker_pool     processes of this machine, of the standard library
    ray_cluster     the machines of a Ray cluster (extra `cluster`)
    shard           a fixed part of the jobs, with results of its own (arrays of SLURM); no executor

An executor calls one function of an importable module for many jobs. The process that asks writes
all results, so no two processes write one file. A job that was lost with its process or its machine
runs again elsewhere.
"""

import pickle
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

from tracked_env.benchmark.executors.shard import Shard

ATTEMPTS = 3  # times that a job is begun before the loss of its process counts as its own fault

Function = Callable[[Any, Any], Any]  # (what all jobs share, job) -> result


class Executor(Protocol):
    """Runs jobs elsewhere."""

    @property
    def workers(self) -> int:
        """Jobs that run at the same time. Raises ValueError where that cannot be found out."""

    def results(
        self, function: Function, shared: Any, jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any]]:
        """The number of each job and its result, in the order in which they end.

        Each job has one result, whatever was lost meanwhile. The first error that `function` raises
        ends it: jobs that run are let end and have their results, no new one begins, then the
        error is raised. Raises OSError for a job that was lost ATTEMPTS times. Closing the iterator
        drops what runs.
        """


class Failure(NamedTuple):
    """What a job raised, as a result that any process can read."""

    error: Exception


def outcome(function: Function, shared: Any, job: Any) -> Any:
    """The result of a job, or a Failure."""
    try:
        return function(shared, job)
    except Exception as error:
        with suppress(Exception):
            pickle.loads(pickle.dumps(error))
            return Failure(error)
        return Failure(RuntimeError(f"{type(error).__name__}: {error}"))


def say(text: str) -> None:
    """A notice, on a line of its own."""
    print(f"\n{text}", file=sys.stderr, flush=True)


def lost(job: Any, how: str, attempts: int) -> None:
    """Say that a job was lost and runs again. Raises OSError after the last attempt."""
    name = str(job)
    if attempts >= ATTEMPTS:
        raise OSError(
            f"{name} was lost {attempts} times, the last time because {how}. Does it need more "
            "memory than there is? Finished results are kept"
        )
    say(f"{name} was lost because {how}; it runs again")


def make_executor(
    workers: int | None = None, ray: str | None = None, shard: Shard | None = None
) -> Executor | None:
    """What `--workers`, `--ray` and `--shard` ask for; None for this process.

    Raises ValueError, and where Ray is not installed, says what to install.
    """
    given = {"--workers": workers, "--ray": ray, "--shard": shard}
    chosen = [name for name, value in given.items() if value is not None]
    if len(chosen) > 1:
        raise ValueError(f"{' and '.join(chosen)} are given; choose one of them")
    if workers is not None:
        from tracked_env.benchmark.executors.worker_pool import WorkerPool

        return WorkerPool(workers)
    if ray is not None:
        from tracked_env.benchmark.executors.ray_cluster import RayCluster

        return RayCluster(ray)
    return None
