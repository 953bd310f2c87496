"""Where independent jobs run: in this process, in others of this machine, or on other machines.

    serial          no executor: one job after the other, in this process
    WorkerPool      processes of this machine, of the standard library
    RayCluster      the machines of a Ray cluster (extra `cluster`)
    Shard           a fixed part of the jobs, with results of its own (arrays of SLURM); no executor

An executor calls one function of an importable module for many jobs. The process that asks writes
all results, so no two processes write one file. A job that was lost with its process or its machine
runs again elsewhere.

A policy is sent to another process as the function that finds it and its arguments
(`PolicyEntry.source`); that process compares fingerprints and says where its source differs.
"""

import logging
import multiprocessing
import os
import pickle
import platform
import re
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple, Protocol

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import SETS
from tracked_env.benchmark.policy_interface import PolicyEntry

ATTEMPTS = 3  # times that a job is begun before the loss of its process counts as its own fault
JOIN_LIMIT = 5.0  # [s] for a process that has nothing left to do
INSTALL = "pip install 'tracked-env[cluster]'"
REACH = 5.0  # [s] for the head node of a cluster to answer
AHEAD = 2  # tasks given out per processor of a cluster: one that runs, one that waits there
_SPAWN = multiprocessing.get_context("spawn")
# One thread of BLAS per process, as the processes share the processor.
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

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


class Shard(NamedTuple):
    """One part of several, counted from 1; written 2/3."""

    part: int
    parts: int

    def __str__(self) -> str:
        return f"{self.part}/{self.parts}"

    def of(self, jobs: Iterable[Any]) -> Iterator[Any]:
        """The jobs of this part; those of all parts are everything, and no two parts share one.

        Jobs are dealt out in rounds, each begun one part later: policies take turns in them, and
        no part is to get all chunks of the slowest one.
        """
        return (
            job for i, job in enumerate(jobs) if (i + i // self.parts) % self.parts == self.part - 1
        )


def parse_shard(text: str) -> Shard:
    """I/N with 1 <= I <= N. Raises ValueError."""
    match = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    shard = Shard(int(match[1]), int(match[2])) if match else Shard(0, 0)
    if not 1 <= shard.part <= shard.parts:
        raise ValueError(
            f"shard {text!r:.40}; must be I/N with 1 <= I <= N, as 1/8 to 8/8. Is the array of "
            "SLURM counted from 0? Use --array=1-N"
        )
    return shard


class Failure(NamedTuple):
    """What a job raised, as a result that any process can read."""

    error: Exception


class Loss(NamedTuple):
    """In the place of a result: its process or its machine has ended, and how."""

    how: str


def outcome(function: Function, shared: Any, job: Any) -> Any:
    """The result of a job, or a Failure."""
    try:
        return function(shared, job)
    except Exception as error:
        with suppress(Exception):
            pickle.loads(pickle.dumps(error))
            return Failure(error)
        return Failure(RuntimeError(f"{type(error).__name__}: {error}"))


def _dispatched(
    jobs: Sequence[Any],
    most: Callable[[], int],
    begin: Callable[[int], None],
    ended: Callable[[], list[tuple[int, Any]]],
) -> Generator[tuple[int, Any]]:
    """`Executor.results` of any executor.

    most: jobs at the same time; begin: starts a job of this number; ended: waits for jobs to end,
    number and result (or Failure, or Loss) of each.
    """
    left, attempts, running = deque(range(len(jobs))), [0] * len(jobs), 0
    failure: Failure | None = None
    while running or (left and failure is None):
        while left and failure is None and running < most():
            attempts[left[0]] += 1
            begin(left.popleft())
            running += 1
        for number, result in ended():
            running -= 1
            if isinstance(result, Failure):
                failure = failure or result
            elif not isinstance(result, Loss):
                yield number, result
            elif attempts[number] < ATTEMPTS:
                print(
                    f"\n{jobs[number]} was lost because {result.how}; it runs again",
                    file=sys.stderr,
                    flush=True,
                )
                left.appendleft(number)
            else:
                raise OSError(
                    f"{jobs[number]} was lost {ATTEMPTS} times, the last time because "
                    f"{result.how}. Does it need more memory than there is? Finished results are "
                    "kept"
                )
    if failure is not None:
        raise failure.error


def make_executor(
    workers: int | None = None, ray: str | None = None, shard: Shard | None = None
) -> Executor | None:
    """What `--workers`, `--ray` and `--shard` ask for; None for this process.

    Raises ValueError, and where Ray is not installed, says what to install.
    """
    options = {"--workers": workers, "--ray": ray, "--shard": shard}
    options_set = [name for name, value in options.items() if value is not None]
    if len(options_set) > 1:
        raise ValueError(f"{' and '.join(options_set)} are given; choose one of them")
    if workers is not None:
        return WorkerPool(workers)
    return None if ray is None else RayCluster(ray)


def _serve(connection: Connection) -> None:
    """What a worker does: jobs, until there are no more."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        function, shared = connection.recv()
        while True:
            connection.send(outcome(function, shared, connection.recv()))


def _end_with_parent() -> None:
    """End this process when the one that started it has ended."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def _inherited() -> Iterator[None]:
    """What a process that starts now inherits: one thread of BLAS, and no Ctrl-C."""
    missing = {name: value for name, value in _THREADS.items() if name not in os.environ}
    os.environ.update(missing)
    mask = getattr(signal, "pthread_sigmask", None)  # Windows has none
    before = mask(signal.SIG_BLOCK, {signal.SIGINT}) if mask else None
    try:
        yield
    finally:
        if mask:
            mask(signal.SIG_SETMASK, before)
        for name in missing:
            del os.environ[name]


class _Worker:
    """One process, and the job that it runs."""

    def __init__(self, function: Function, shared: Any) -> None:
        self.connection, theirs = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_serve, args=(theirs,), daemon=True)
        with _inherited():
            self.process.start()
        theirs.close()
        self.job: int | None = None
        with suppress(OSError):  # one that has ended already is seen to have ended
            self.connection.send((function, shared))

    def ask(self, number: int, job: Any) -> None:
        """Begin a job."""
        self.job = number
        with suppress(OSError):
            self.connection.send(job)

    def answer(self) -> tuple[int, Any]:
        """The job that has ended, and its result or Loss."""
        number, self.job = self.job, None
        assert number is not None
        try:
            return number, self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode or 0
            kind = f"signal {-code}" if code < 0 else f"exit status {code}"
            return number, Loss(f"its process ended ({kind})")

    def end(self) -> None:
        """End the process: one that waits for a job by itself, another one at once."""
        self.connection.close()
        if self.job is None:
            self.process.join(JOIN_LIMIT)
        self.process.kill()
        self.process.join()


class WorkerPool:
    """An executor of `workers` processes of this machine, started afresh (spawn).

    A process that ends, however it ends, costs the job that it ran; another takes its place. When
    the process that asks ends, its workers end at once. Ctrl-C reaches that process alone.
    """

    def __init__(self, workers: int) -> None:
        """Raises ValueError for a number that is not positive."""
        if workers < 1:
            raise ValueError(f"workers = {workers}; must be at least 1. Leave it out for one")
        self.workers = workers

    def results(
        self, function: Function, shared: Any, jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any]]:
        """As `Executor.results`."""
        pool: list[_Worker] = []

        def begin(number: int) -> None:
            idle = [worker for worker in pool if worker.job is None]
            if not idle:
                idle = [_Worker(function, shared)]
                pool.append(idle[0])
            idle[0].ask(number, jobs[number])

        def ended() -> list[tuple[int, Any]]:
            busy = {worker.connection: worker for worker in pool if worker.job is not None}
            workers = [busy[connection] for connection in wait(list(busy))]  # type: ignore[index]
            answers = [worker.answer() for worker in workers]
            for worker, (_, result) in zip(workers, answers, strict=True):
                if isinstance(result, Loss):
                    pool.remove(worker)
            return answers

        try:
            yield from _dispatched(jobs, lambda: self.workers, begin, ended)
        finally:
            for worker in pool:
                worker.end()


class RayCluster:
    """An executor on a Ray cluster: `local` starts one here, `auto` finds one, or HOST:PORT.

    Each job runs on one processor. Tasks are functions of importable modules: every node has the
    same packages installed, and nothing is sent to it but arguments. Ray begins no task again by
    itself; a job whose worker or node has ended is given out anew from here, so that it is known
    and said what was lost.
    """

    def __init__(self, address: str) -> None:
        """Raises ValueError where Ray is not installed, or no cluster answers at the address."""
        # Before Ray is imported: it reports nothing about its users, and leaves GPUs alone.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            import ray
        except ImportError as error:
            raise ValueError(f"--ray needs Ray, which is not installed: {INSTALL}") from error
        _check_address(address)
        self.ray: Any = ray
        if ray.is_initialized():
            return
        more: dict[str, Any] = {"include_dashboard": False} if address == "local" else {}
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **more)
        except Exception as error:  # Ray raises what happens to go wrong
            reason = " ".join(str(error).split())[:300]
            raise ValueError(
                f"ray = {address!r}: cannot connect ({reason}). Does `ray start` run there, with "
                "the same versions of Python and Ray, and the same token (ray get-auth-token)?"
            ) from error

    @property
    def workers(self) -> int:
        """Processors of the cluster, as it is now."""
        return max(int(self.ray.cluster_resources().get("CPU", 0)), 1)

    def results(
        self, function: Function, shared: Any, jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any]]:
        """As `Executor.results`."""
        ray, errors = self.ray, self.ray.exceptions
        worker_gone = errors.WorkerCrashedError, errors.OutOfMemoryError, errors.ObjectLostError
        gone = (*worker_gone, errors.NodeDiedError, errors.LocalRayletDiedError)
        task = ray.remote(num_cpus=1, max_retries=0)(outcome)
        stored = ray.put(shared)
        under_way: dict[Any, int] = {}

        def begin(number: int) -> None:
            under_way[task.remote(function, stored, jobs[number])] = number

        def ended() -> list[tuple[int, Any]]:
            (done,), _ = ray.wait(list(under_way), num_returns=1)
            number = under_way.pop(done)
            try:
                return [(number, ray.get(done))]
            except gone as error:
                return [(number, Loss(f"its worker or its node ended ({type(error).__name__})"))]
            except errors.RayError as error:  # a worker without our packages
                reason = " ".join(str(error).split())[-300:]
                message = (
                    f"a worker of the cluster could not begin ({reason}). Is the same wheel "
                    "installed on every node?"
                )
                return [(number, Failure(ValueError(message)))]

        try:
            yield from _dispatched(jobs, lambda: AHEAD * self.workers, begin, ended)
        finally:
            for task_left in under_way:
                with suppress(Exception):
                    ray.cancel(task_left, force=True)


def _check_address(address: str) -> None:
    """Raises ValueError for an address that is none, or where nothing answers."""
    if address in ("local", "auto"):
        return
    match = re.fullmatch(r"([\w.-]+):(\d{1,5})", address)
    if match is None or not 0 < int(match[2]) < 2**16:
        raise ValueError(f"ray = {address!r:.60}; must be local, auto or HOST:PORT, as head:6379")
    try:
        socket.create_connection((match[1], int(match[2])), timeout=REACH).close()
    except OSError as error:
        raise ValueError(
            f"ray = {address!r}: nothing answers there ({error}). Does `ray start --head --port "
            f"{match[2]}` run on {match[1]}, and may this machine reach it?"
        ) from error


class SentComparison(NamedTuple):
    """What all chunks of a comparison share."""

    config: BenchmarkConfig
    source: str  # of the simulation
    # By name: fingerprint, whether it is frozen, a pickled `PolicyEntry.source` or factory.
    policies: Mapping[str, tuple[str, bool, bytes]]


_RECEIVED: dict[tuple[str, str], PolicyEntry] = {}  # by name and fingerprint, in this process


def sent(config: BenchmarkConfig, policies: Sequence[PolicyEntry]) -> SentComparison:
    """A comparison as other processes get it.

    Raises ValueError for a policy that cannot be sent.
    """
    parts = {}
    for entry in policies:
        try:
            data = pickle.dumps(entry.make if entry.source is None else entry.source)
        except Exception as error:
            raise ValueError(
                f"policy {entry.name!r} cannot be sent to another process ({error}). Name it as "
                "module:attribute, or define its factory at the top of a module"
            ) from error
        parts[entry.name] = entry.fingerprint, entry.frozen, data
    return SentComparison(config, config.identity()["source"], parts)


def received(comparison: SentComparison, name: str) -> PolicyEntry:
    """A policy in the process that has got it.

    Raises ValueError where this process has another source, of the policy or the simulation.
    """
    fingerprint, is_frozen, data = comparison.policies[name]
    key = name, fingerprint
    if key in _RECEIVED:
        return _RECEIVED[key]
    source: Any = pickle.loads(data)
    entry = PolicyEntry(name, source, fingerprint)
    if isinstance(source, tuple):
        function, arguments = source
        entry = function(*arguments)
    own = [each.name for each in comparison.config.own_sets]
    if unknown := [each for each in comparison.config.sets if each not in (*SETS, *own)]:
        raise ValueError(
            f"evaluation set {unknown[0]!r} is not known on {platform.node()}: register it in "
            "the module of a policy, which every process imports"
        )
    same = comparison.config.identity()["source"] == comparison.source
    if not same or entry.fingerprint != fingerprint:
        raise ValueError(
            f"{f'policy {name!r}' if same else 'the simulation'} has another source on "
            f"{platform.node()} than here: install the same version of the same packages there"
        )
    _RECEIVED[key] = entry._replace(name=name, frozen=is_frozen)
    return _RECEIVED[key]
