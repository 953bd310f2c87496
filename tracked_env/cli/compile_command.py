"""`tracked-env compile`: compile ahead what first calls of environments and policies compile.

Several processes drive the same short episodes, each in an order of its own. A kernel is compiled
by the process that needs it first, and loaded by the others (`physics.compiling`).
"""

import os
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from tracked_env import TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import WorkerPool
from tracked_env.benchmark.policies import default_names, policies_for, registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry, checked_policy
from tracked_env.benchmark.runner import Progress, Task, no_progress, progress_bar, run_task
from tracked_env.cli.command_line import Parser, explained, reported
from tracked_env.cli.evaluate_options import ENVIRONMENTS, FIRST_LOOKS, add_env, first_policies
from tracked_env.physics.kernel_cache import SUFFIX, folder
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

DURATION = 0.5  # [s] of the episodes
PATIENCE = 1.5  # [s] after which there must be something to compile
WORKERS = Range(1, 1024, "-", "It is the number of processes.")
Drives = Sequence[tuple[BenchmarkConfig, tuple[str, ...]]]  # policies by name, on the sets


def _pieces(drives: Drives) -> Iterator[tuple[BenchmarkConfig, str, PolicyEntry]]:
    """Configuration, set and policy of every episode that is driven. Raises ValueError."""
    for config, names in drives:
        entries = policies_for(config.env, names)
        for name in config.sets:
            for entry in entries:
                yield replace(config, duration=DURATION), name, entry


def _drive(drives: Drives, worker: int, workers: int, progress: Progress = no_progress) -> None:
    """Drive all of it: half of the processes forward, half backward, from places of their own.

    Those that go backward begin with what policies can compile without an environment.
    Raises PolicyError and ValueError.
    """
    pieces = list(_pieces(drives))
    if worker % 2:
        pieces.reverse()
        for config, name, entry in {piece[2]: piece for piece in pieces}.values():
            policy = checked_policy(entry, config.context(name))
            if compile_ahead := getattr(policy, "compile_kernels", None):
                compile_ahead()
    first = worker // 2 * len(pieces) // ((workers + 1) // 2)
    for config, name, entry in pieces[first:] + pieces[:first]:
        run_task(entry, Task(entry.name, name, (0,)), config, progress)


def _help(shared: tuple[Drives, int], worker: int) -> None:
    """What another process does; where anything fails, the first one finds it out and says it."""
    with suppress(Exception):
        _drive(shared[0], worker, shared[1])


def compile_kernels(drives: Drives, workers: int = 2, progress: Progress = no_progress) -> None:
    """Compile what these policies and their environments need, in this process and others.

    The others start after PATIENCE seconds, and a line then says what takes so long. Raises
    PolicyError and ValueError.
    """
    others = WorkerPool(max(workers - 1, 1)).results(
        _help, (tuple(drives), workers), range(1, workers)
    )
    start = threading.Timer(PATIENCE, list, [others])
    start.daemon = True
    start.start()
    try:
        with explained(after=PATIENCE):
            _drive(drives, 0, workers, progress)
    finally:
        start.cancel()


@reported
def main(arguments: Sequence[str] | None = None, program: str = "tracked-env compile") -> int:
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
    text = f"processes (default: {cores}, those that this machine has processors for)"
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help=text)
    options = parser.parse_args(arguments)
    workers = checked_whole("--workers", options.workers, WORKERS)
    known = registered_policies()
    drives = []
    everything = options.env is None and not options.policies
    for env in ENVIRONMENTS if everything else [options.env or TORQUE_ID]:
        names = first_policies(env, default_names(known, env))
        config = BenchmarkConfig(sets=FIRST_LOOKS[env].sets)
        drives.append((config, tuple(options.policies) or names))
    began, place = time.perf_counter(), folder()
    before = 0 if place is None else len(list(place.glob(f"*{SUFFIX}")))
    steps = sum(config.max_steps(name) for config, name, _ in _pieces(drives))
    with progress_bar(steps) as progress:
        compile_kernels(drives, workers, progress)
    if place is None:
        print("nothing could be kept on disk: every process compiles what it calls")
        return 1
    count = len(list(place.glob(f"*{SUFFIX}"))) - before
    print(f"{count} kernels compiled in {time.perf_counter() - began:.1f} s, kept in {place}")
    return 0
