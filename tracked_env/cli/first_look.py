"""The first look of `tracked-env evaluate`: few policies on few sets, and their kernels.

Kernels are compiled once after an installation, which takes most of the time of the first look. A
second process compiles from the other end, and each loads what the other has finished.
"""

import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.chunks import Task
from tracked_env.benchmark.executors.worker_pool import WorkerPool
from tracked_env.benchmark.policy_interface import PolicyEntry, checked_policy
from tracked_env.benchmark.policy_lookup import load_policies
from tracked_env.benchmark.registered_policies import by_name, open_archive, registered_policies
from tracked_env.benchmark.runner import run_task
from tracked_env.benchmark.summary import SEED_MARK
from tracked_env.cli.waiting import explained

DURATION = 0.5  # [s] of an episode that is driven so that its kernels are compiled
PATIENCE = 1.5  # [s] after which there must be something to compile


class FirstLook(NamedTuple):
    """What is compared where neither policies nor sets are named."""

    policies: tuple[str, ...]
    sets: tuple[str, ...]  # one of each group of the frozen version


FIRST_LOOKS = {
    TORQUE_ID: FirstLook(
        ("integral", "adaptive", "mpc-adaptive", "oracle", "ppo-residual@0", "ppo-blind@0"),
        ("outages-alternating", "actuator-fault", "distributed", "noisy-fast"),
    ),
    SPEED_ID: FirstLook(
        ("slc", "slc-adaptive", "mpc-adaptive", "slc-oracle", "ppo-residual@0", "ppo-blind@0"),
        ("floor-outages-alternating", "friction-step", "floor-slow-drive-late", "floor-ood"),
    ),
    TERRAIN_ID: FirstLook(
        ("uc", "slc", "slc-adaptive", "slc-oracle", "ppo-residual@0", "ppo-blind@0"),
        ("hills-outages", "slope", "slope-payload", "hills-ood"),
    ),
}  # fmt: skip


def first_policies(env: str, known: Sequence[str]) -> tuple[str, ...]:
    """Those of the first look that are registered, all that are where there are fewer than two."""
    chosen = FIRST_LOOKS[env].policies
    found = tuple(name for name in chosen if name.partition(SEED_MARK)[0] in known)
    return found if len(found) > 1 else tuple(known)


class _Ahead(NamedTuple):
    """What the process that compiles from the other end is told."""

    config: BenchmarkConfig
    specs: tuple[str, ...]


def compile_from_the_end(ahead: _Ahead, job: int) -> None:
    """Compile what the policies call, from its end, then what each plant needs.

    Where anything fails, the main process finds it out and says it.
    """
    del job
    with suppress(Exception):
        registry, trained = by_name(registered_policies(lambda warning: None), ahead.config.env)
        context = ahead.config.context(ahead.config.sets[0])
        for entry in load_policies(ahead.specs, registry, trained, open_archive):
            compile_kernels = getattr(checked_policy(entry, context), "compile_kernels", None)
            if compile_kernels is not None:
                compile_kernels()
        for name in reversed(ahead.config.sets):
            run_task(Task(entry, name, (0,)), ahead.config)


def compile_kernels(
    benchmark: BenchmarkConfig, specs: tuple[str, ...], entries: Sequence[PolicyEntry]
) -> None:
    """Drive every policy on every set for DURATION; a line says so where it compiles.

    Raises PolicyError.
    """
    short = replace(benchmark, duration=DURATION)
    pool = WorkerPool(1)

    def beside() -> None:
        with suppress(OSError):  # without a second process it takes longer, nothing else
            for _ in pool.results(compile_from_the_end, _Ahead(short, specs), [0]):
                pass

    helper = threading.Timer(PATIENCE, beside)
    helper.daemon = True
    helper.start()
    try:
        with explained(after=PATIENCE):
            for name in benchmark.sets:
                for entry in entries:
                    run_task(Task(entry, name, (0,)), short)
    finally:
        helper.cancel()
