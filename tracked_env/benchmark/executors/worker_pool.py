"""Processes of this machine, started afresh (spawn), each with one job at a time.

A process that ends, however it ends, costs the job that it ran; another takes its place. When the
process that asks ends, its workers end at once. Ctrl-C reaches that process alone.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from tracked_env.benchmark.executors import Failure, Function, lost, outcome

PATIENCE = 5.0  # [s] for a process that has nothing left to do
_SPAWN = multiprocessing.get_context("spawn")
# One thread of BLAS per process, as the processes share the processor.
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


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

    def end(self) -> None:
        """End the process: one that waits for a job by itself, another one at once."""
        self.connection.close()
        if self.job is None:
            self.process.join(PATIENCE)
        self.process.kill()
        self.process.join()

    def ended(self) -> str:
        """How it ended."""
        self.process.join()
        code = self.process.exitcode or 0
        kind = f"signal {-code}" if code < 0 else f"exit status {code}"
        return f"its process ended ({kind})"


class WorkerPool:
    """An executor of `workers` processes."""

    def __init__(self, workers: int) -> None:
        """Raises ValueError for a number that is not positive."""
        if workers < 1:
            raise ValueError(f"workers = {workers}; must be at least 1. Leave it out for one")
        self.workers = workers

    def results(
        self, function: Function, shared: Any, jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any]]:
        """As `Executor.results`."""
        left, attempts = deque(range(len(jobs))), [0] * len(jobs)
        pool: list[_Worker] = []
        failure: Failure | None = None
        try:
            while True:
                while left and failure is None and len(pool) < self.workers:
                    pool.append(_Worker(function, shared))
                for worker in pool:
                    if worker.job is None and left and failure is None:
                        attempts[left[0]] += 1
                        worker.ask(left[0], jobs[left.popleft()])
                busy = {worker.connection: worker for worker in pool if worker.job is not None}
                if not busy:
                    break
                for connection in wait(list(busy)):
                    worker = busy[connection]  # type: ignore[index]
                    assert worker.job is not None
                    number, worker.job = worker.job, None
                    try:
                        result = worker.connection.recv()
                    except (EOFError, OSError):
                        pool.remove(worker)
                        lost(jobs[number], worker.ended(), attempts[number])
                        left.appendleft(number)
                        continue
                    if isinstance(result, Failure):
                        failure = failure or result
                    else:
                        yield number, result
            if failure is not None:
                raise failure.error
        finally:
            for worker in pool:
                worker.end()
