"""The machines of a Ray cluster, each job on one processor of one of them.

Tasks are functions of importable modules: every node has the same packages installed, and nothing
is sent to it but arguments. Ray begins no task again by itself; a job whose worker or node has
ended is given out anew from here, so that it is known and said what was lost.
"""

import logging
import os
import re
import socket
import time
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from typing import Any

from tracked_env.benchmark.executors import Failure, Function, lost, outcome

INSTALL = "pip install 'tracked-env[cluster]'"
REACH = 5.0  # [s] for the head node to answer
REFRESH = 5.0  # [s] between two looks at the size of the cluster
AHEAD = 2  # tasks given out per processor: one that runs, one that waits there


class RayCluster:
    """An executor on a Ray cluster: `local` starts one here, `auto` finds one, or HOST:PORT."""

    def __init__(self, address: str) -> None:
        """Raises ValueError where Ray is not installed, or no cluster answers at the address."""
        # Before Ray is imported: it reports nothing about its users, and leaves GPUs alone.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        try:
            import ray
        except ImportError as error:
            raise ValueError(f"--ray needs Ray, which is not installed: {INSTALL}") from error
        _check(address)
        self.ray: Any = ray
        self._known = 0, -REFRESH  # processors, and when they were counted
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
        count, when = self._known
        if time.monotonic() - when >= REFRESH:
            count = max(int(self.ray.cluster_resources().get("CPU", 0)), 1)
            self._known = count, time.monotonic()
        return count

    def results(
        self, function: Function, shared: Any, jobs: Sequence[Any]
    ) -> Generator[tuple[int, Any]]:
        """As `Executor.results`."""
        ray = self.ray
        gone = (
            ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError,
            ray.exceptions.LocalRayletDiedError, ray.exceptions.ObjectLostError,
            ray.exceptions.OutOfMemoryError,
        )  # fmt: skip
        task = ray.remote(num_cpus=1, max_retries=0)(outcome)
        given = ray.put(shared)
        left, attempts = deque(range(len(jobs))), [0] * len(jobs)
        under_way: dict[Any, int] = {}
        failure: Failure | None = None
        try:
            while True:
                while left and failure is None and len(under_way) < AHEAD * self.workers:
                    number = left.popleft()
                    attempts[number] += 1
                    under_way[task.remote(function, given, jobs[number])] = number
                if not under_way:
                    break
                (done,), _ = ray.wait(list(under_way), num_returns=1)
                number = under_way.pop(done)
                try:
                    result = ray.get(done)
                except gone as error:
                    kind = type(error).__name__
                    lost(jobs[number], f"its worker or its node ended ({kind})", attempts[number])
                    left.appendleft(number)
                    continue
                except ray.exceptions.RayError as error:
                    failure = failure or Failure(_unusable(error))
                    continue
                if isinstance(result, Failure):
                    failure = failure or result
                else:
                    yield number, result
            if failure is not None:
                raise failure.error
        finally:
            for task_left in under_way:
                with suppress(Exception):
                    ray.cancel(task_left, force=True)


def _check(address: str) -> None:
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


def _unusable(error: Exception) -> ValueError:
    """What a worker without our packages ends with."""
    reason = " ".join(str(error).split())[-300:]
    return ValueError(
        f"a worker of the cluster could not begin ({reason}). Is the same wheel installed on "
        "every node?"
    )
