"""`tracked-env compile`: compile ahead what first calls of environments and policies compile.

Short episodes are driven by several processes. A kernel is compiled by the process that needs it
first, and loaded by the others (`physics.kernel_cache`).
"""

import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

from tracked_env import TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import WorkerPool
from tracked_env.benchmark.policies import default_names, policies_for, registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry, checked_policy
from tracked_env.benchmark.runner import Progress, Task, no_progress, progress_bar, run_task
from tracked_env.cli.command_line import Parser, explained
from tracked_env.cli.evaluate_options import (
    ENVIRONMENTS,
    Config,
    add_env,
    benchmark_config,
    first_policies,
)
from tracked_env.environment_ids import bare
from tracked_env.physics.kernel_cache import SUFFIX, folder
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

DURATION = 0.5  # [s] of the episodes
PATIENCE = 1.5  # [s] after which there must be something to compile
WORKERS = Range(1, 1024, "-", "It is the number of processes.")
Drives = Sequence[tuple[BenchmarkConfig, tuple[str, ...]]]  # policies by name, on the sets


class Piece(NamedTuple):
    """A policy on all sets, or what it can compile ahead of them without an environment."""

    config: BenchmarkConfig
    entry: PolicyEntry
    ahead: bool = False

    def compile(self, progress: Progress = no_progress) -> None:
        """Raises PolicyError."""
        label = f"{bare(self.config.env)}: {self.entry.name}"
        progress(0, label)
        if not self.ahead:
            for name in self.config.sets:
                task = Task(self.entry.name, name, (0,))
                run_task(self.entry, task, self.config, lambda steps, _: progress(steps, label))
            return
        policy = checked_policy(self.entry, self.config.context(self.config.sets[0]))
        if compile_ahead := getattr(policy, "compile_kernels", None):
            compile_ahead()


def _pieces(drives: Drives) -> list[Piece]:
    """All there is to do, what can be compiled ahead for the first of `drives` at the end.

    Raises ValueError.
    """
    pieces = [
        Piece(replace(config, duration=DURATION), entry)
        for config, names in drives
        for entry in policies_for(config.env, names)
    ]
    first = [piece for piece in pieces if piece.config.env == drives[0][0].env]
    return pieces + [piece._replace(ahead=True) for piece in reversed(first)]


_own_pieces = cache(_pieces)  # once in each process


def _help(drives: Drives, number: int | None) -> None:
    """What another process does; where it fails, the first one finds that out and says it."""
    with suppress(Exception):
        if number is not None:
            _own_pieces(drives)[number].compile()


class _FromTheEnd(Sequence[int | None]):
    """Jobs of other processes: the last number that is left as each begins, None where none is."""

    def __init__(self, left: deque[int]) -> None:
        self._left, self._count = left, len(left)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, number: Any) -> Any:
        with suppress(IndexError):
            return self._left.pop()


def compile_kernels(drives: Drives, workers: int = 2, quiet: bool = True) -> None:
    """Compile what these policies and their environments need, in this process and others.

    This one begins with the first piece of work, the others with the last. They start after
    PATIENCE seconds, and a line then says what takes so long. Raises PolicyError and ValueError.
    """
    pieces = _pieces(drives)
    left = deque(range(len(pieces)))
    driven = [piece.config for piece in pieces if not piece.ahead]
    steps = sum(config.max_steps(name) for config in driven for name in config.sets)

    def others() -> None:
        if workers > 1:
            deque(WorkerPool(workers - 1).results(_help, tuple(drives), _FromTheEnd(left)), 0)

    start = threading.Timer(PATIENCE, others)
    start.daemon = True
    start.start()
    try:
        with explained(after=PATIENCE), progress_bar(steps, quiet) as progress:
            while left:
                pieces[left.popleft()].compile(progress)
    finally:
        start.cancel()
    start.join()


def main(arguments: Sequence[str], program: str) -> int:
    """Compile what is named; returns the exit status."""
    parser = Parser(
        program,
        "Compile what first calls would compile: once after an installation or an update, minutes "
        "of all processors. What is on disk already is not compiled again.",
    )
    text = "what to compile (default: the policies of the first look of `tracked-env evaluate`)"
    parser.add_argument("policies", nargs="*", metavar="POLICY", help=text)
    add_env(parser)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = f"processes, 1 to 1024 (default: {cores}, those that this machine has processors for)"
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help=text)
    options = parser.parse_args(arguments)
    workers = checked_whole("--workers", options.workers, WORKERS)
    known = registered_policies()
    drives = []
    everything = options.env is None and not options.policies
    for env in ENVIRONMENTS if everything else [options.env or TORQUE_ID]:
        names = first_policies(env, default_names(known, env))
        config = benchmark_config(Config(env=env))
        drives.append((config, tuple(options.policies) or names))
    began, place = time.perf_counter(), folder()
    before = 0 if place is None else len(list(place.glob(f"*{SUFFIX}")))
    compile_kernels(drives, workers, quiet=False)
    if place is None:
        print("nothing could be kept on disk: every process compiles what it calls")
        return 1
    count = len(list(place.glob(f"*{SUFFIX}"))) - before
    print(f"{count} kernels compiled in {time.perf_counter() - began:.1f} s, kept in {place}")
    return 0
