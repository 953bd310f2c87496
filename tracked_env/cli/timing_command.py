"""`tracked-env timing`: time and memory of a call of a policy that drives one vehicle.

Each policy drives one after the other of the episodes of a set, in a process of its own with one
thread of BLAS, and every call of `predict` is timed alone: neither the environment nor the reset of
an episode is in it. An attribute `observer` of a policy, if it has one, is an object whose method
`update` runs inside `predict`: its calls are timed as well. The steps of one policy:
    first call    with the kernels as they are on disk, or else compiled
    WARM calls    not counted
    calls         timed; before them what is there is kept out of the garbage collection, if asked
    RECORDED      calls whose observations are kept
    the same      ROUNDS of calls on these, without the environment, with `tracemalloc`: what they
                  keep, and the most that a call holds beside
"""

import gc
import json
import os
import shutil
import time
import tracemalloc
from argparse import BooleanOptionalAction
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba.core import event

from tracked_env.benchmark import files, policies, report, table_model
from tracked_env.benchmark.executors import SentComparison, WorkerPool, received, sent
from tracked_env.benchmark.policy_interface import (
    PolicyEntry,
    agent_of,
    blamed,
    checked_answer,
    checked_policy,
    needs_truth,
    tell_plant,
)
from tracked_env.benchmark.runner import progress_bar
from tracked_env.benchmark.table_model import Table
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import (
    add_episode_options,
    add_option,
    episode_config,
    first_policies,
)
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

WARM = 100  # calls before those that are timed
RECORDED = 1000  # calls of which the memory is measured
ROUNDS = 3  # of them, of which the last counts: lists of free blocks fill before
CALLS = Range(1, 10**8, "-", "It is the number of calls that are timed.")
BLOCK = "timing table"  # of a page


class Times(NamedTuple):
    """Durations [s] of the calls of a function, and how many exceed the period of a control."""

    first: float  # of the process
    median: float
    p99: float
    p99_9: float
    worst: float
    misses_50_hz: int
    misses_100_hz: int


class Timing(NamedTuple):
    """What was measured of a policy."""

    policy: str
    predict: Times
    observer: Times | None
    compiled: bool  # whether the first call compiled kernels
    collections: int  # of garbage, during the calls that were timed
    growth: float  # [bytes] that stay allocated, per call
    peak: float  # [bytes] beside what is there before a call, at most; median over the calls


class Timed:
    """A function whose calls are timed."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.durations = function, list[int]()  # [ns]

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """What the function returns."""
        began = time.perf_counter_ns()
        answer = self.function(*arguments, **named)
        self.durations.append(time.perf_counter_ns() - began)
        return answer

    def times(self, calls: int) -> Times:
        """Of the first call, and of the last ones; a percentile is the shortest duration that so
        many of them do not exceed."""
        seconds = np.sort(self.durations[-calls:]) * 1e-9
        ranks = [(per_mille * len(seconds) + 999) // 1000 for per_mille in (500, 990, 999, 1000)]
        median, p99, p99_9, worst = (seconds[rank - 1].item() for rank in ranks)
        misses = [int((seconds > period).sum()) for period in (0.02, 0.01)]
        return Times(self.durations[0] * 1e-9, median, p99, p99_9, worst, *misses)


class Loop:
    """A policy that drives one vehicle, episode after episode."""

    def __init__(self, policy: Any, env: Any, seed: int) -> None:
        self.policy, self.env, self.seed = policy, env, seed
        self.predict, self.state, self.over = Timed(policy.predict), None, True

    def inputs(self) -> tuple[Any, Any]:
        """Observation (1, D) and start (1,) of the coming call; the truth is told if need be."""
        start = np.full(1, self.over)
        if self.over:
            self.observation, self.info = self.env.reset(seed=[self.seed])
            self.seed += 1
            tell_plant(self.policy, self.env.simulation.solver.reads.names)
        if needs_truth(self.policy):
            truth = self.info["truth"].items()
            self.policy.observe_truth({k: v for k, v in truth if not k.startswith("_")})
        return self.observation, start

    def step(self) -> tuple[Any, Any]:
        """A call and a step of the environment; returns the inputs of the call."""
        observation, start = self.inputs()
        answer = self.predict(observation, self.state, start, deterministic=True)
        action, self.state = checked_answer(answer, 1)
        self.observation, _, ended, timed_out, self.info = self.env.step(action)
        self.over = bool(ended[0] or timed_out[0])
        return observation, start


def memory_of(loop: Loop) -> tuple[float, float]:
    """(growth, peak) of a Timing."""
    steps = (loop.step() for _ in range(RECORDED))
    records = [(observation.copy(), start) for observation, start in steps]
    predict, state, peaks = loop.policy.predict, loop.state, np.zeros(RECORDED)
    before = present = 0
    tracemalloc.start()
    try:
        for _ in range(ROUNDS):
            before = present = tracemalloc.get_traced_memory()[0]
            for number, (observation, start) in enumerate(records):
                tracemalloc.reset_peak()
                state = predict(observation, state, start, deterministic=True)[1]
                after, peak = tracemalloc.get_traced_memory()
                peaks[number], present = peak - present, after
    finally:
        tracemalloc.stop()
    return (present - before) / RECORDED, float(np.median(peaks))


def measure(shared: tuple[SentComparison, int, bool], name: str) -> Timing:
    """The Timing of a policy, in a process that has measured no other one. Raises PolicyError."""
    comparison, calls, freeze = shared
    config, uncertainty_set = comparison.config, comparison.config.sets[0]
    policy: Any = checked_policy(received(comparison, name), config.context(uncertainty_set))
    env = config.environment(uncertainty_set, 1, needs_truth(policy))
    try:
        env.reset(seed=[config.first_seed(uncertainty_set)])
        env.step(np.zeros((1, 2), dtype=np.float32))  # its kernels are there before the first call
        loop, update = Loop(policy, env, config.first_seed(uncertainty_set)), None
        observer: Any = getattr(policy, "observer", None)
        if observer is not None:
            observer.update = update = Timed(observer.update)
        with event.install_recorder("numba:compile") as compilations:
            loop.step()
        for _ in range(WARM):
            loop.step()
        gc.collect()
        if freeze:
            gc.freeze()
        collections = -_collections()
        for _ in range(calls):
            loop.step()
        collections += _collections()
        times = loop.predict.times(calls), None if update is None else update.times(calls)
        if update is not None:
            observer.update = update.function
        memory = memory_of(loop)
    except (Exception, SystemExit) as error:
        raise blamed(error, name, f"set {uncertainty_set!r}") from error
    finally:
        env.close()
    return Timing(name, *times, bool(compilations.buffer), collections, *memory)


def _collections() -> int:
    return sum(each["collections"] for each in gc.get_stats())


def table(timings: Sequence[Timing], conditions: str) -> Table:
    """The timings as a table, a row of each policy and one of its observer."""
    head = ["policy", "call", "first [ms]", "median [us]", "P99 [us]", "P99.9 [us]", "worst [us]"]
    head += ["misses 50 Hz", "100 Hz", "gc", "growth [B]", "peak [KiB]"]
    rows = [head]
    for of in timings:
        memory = [f"{of.collections}", f"{max(of.growth, 0.0):.0f}", f"{of.peak / 1024:.1f}"]
        for call, times in (("predict", of.predict), ("observer", of.observer)):
            if times is not None:
                first = f"{times.first * 1e3:.1f}{' c' if of.compiled else ''}"
                shares = [f"{seconds * 1e6:.1f}" for seconds in times[1:5]]
                rest = memory if call == "predict" else [""] * len(memory)
                rows.append([of.policy, call, first, *shares, *map(str, times[5:]), *rest])
    return Table("Time of a call", rows, 2, [conditions])


def note(facts: dict[str, Any]) -> str:
    """What was measured, on what."""
    machine, versions = facts["machine"], facts["versions"]
    load = "" if facts["load"] is None else f", load {facts['load']:.1f} before"
    packages = ", ".join(f"{name} {versions[name]}" for name in ("python", "numpy", "numba"))
    return (
        f"{facts['calls']} calls after the first {1 + WARM}, {facts['env']}, set {facts['set']}, "
        f"seeds from {facts['seed']}, {'with' if facts['freeze'] else 'without'} gc.freeze(). "
        f"{machine['processor']}, {machine['cores']} cores{load}; {packages}. "
        "c: the first call compiled kernels."
    )


def main(arguments: Sequence[str], program: str) -> int:
    """Measure and print; returns the exit status."""
    parser = Parser(
        program,
        "Time the calls of policies that drive one vehicle, each in a process of its own, and the "
        "memory that a call takes. Of an agent with several seeds the first is timed.",
    )
    text = "as in `tracked-env evaluate --policies` (default: those of its first look)"
    parser.add_argument("policies", nargs="*", metavar="POLICY", help=text)
    add_option(parser, "all", "all policies that are registered for the environment")
    text = "calls of each policy that are timed, 1 to 1e8 (default: 100000)"
    parser.add_argument("--calls", type=int, default=100_000, metavar="N", help=text)
    text = "keep what is there after the set-up out of the garbage collection (default: yes)"
    parser.add_argument("--freeze", action=BooleanOptionalAction, default=True, help=text)
    text = "write the measurements as JSON, in SI units (default: no)"
    parser.add_argument("--json", type=Path, metavar="FILE", help=text)
    text = f"renew the `{BLOCK}` of a Markdown page, between its markers (default: no)"
    parser.add_argument("--page", type=Path, metavar="FILE", help=text)
    add_episode_options(parser)
    options = parser.parse_args(arguments)
    calls = checked_whole("--calls", options.calls, CALLS)
    config = episode_config(options)
    names = policies.default_names(policies.registered_policies(), config.env)
    names = options.policies or (names if options.all else first_policies(config.env, names))
    agents: dict[str, PolicyEntry] = {}
    for entry in policies.policies_for(config.env, names):
        checked_policy(entry, config.context(config.sets[0]))  # reject incompatible ones first
        agents.setdefault(agent_of(entry.name), entry)
    entries = list(agents.values())
    facts = {"env": config.env, "set": config.sets[0], "calls": calls}
    facts |= {"seed": config.first_seed(config.sets[0])}
    facts |= {"freeze": options.freeze, "machine": files.machine(), "versions": files.versions()}
    facts["load"] = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    shared, timings = (sent(config, entries), calls, options.freeze), list[Timing]()
    with progress_bar(calls * len(entries)) as progress:
        for entry in entries:
            progress(0, entry.name)
            # a pool of its own for each, so that none finds kernels that another one has loaded
            timings += [one for _, one in WorkerPool(1).results(measure, shared, [entry.name])]
            progress(calls, entry.name)
    tables = [table(timings, note(facts))]
    print(table_model.terminal(tables, shutil.get_terminal_size().columns))
    if options.json is not None:
        document = {**facts, "timings": [report.plain(one) for one in timings]}
        files.write_atomically(options.json, f"{json.dumps(document, indent=1)}\n".encode())
    if options.page is not None:
        files.replace_block(options.page, BLOCK, table_model.markdown(tables).rstrip())
    return 0
