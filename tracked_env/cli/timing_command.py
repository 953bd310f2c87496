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

from tracked_env.benchmark import files, report, table_model
from tracked_env.benchmark.executors import SentComparison, WorkerPool, received, sent
from tracked_env.benchmark.policies import default_names, policies_for, registered_policies
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
from tracked_env.cli.command_line import Parser, reported
from tracked_env.cli.evaluate_command import benchmark_config, first_policies
from tracked_env.cli.evaluate_options import add_episode_options, add_option, config_of
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

WARM = 100  # calls before those that are timed
RECORDED = 1000  # calls of which the memory is measured
ROUNDS = 3  # of them, of which the last counts
PERIODS = {50: 0.02, 100: 0.01}  # [s] of the control, by its rate [Hz]
CALLS = Range(1, 10**8, "-", "It is the number of calls that are timed.")
BLOCK = "timing table"  # of a page


class Times(NamedTuple):
    """Durations [s] of the calls of a function."""

    first: float  # of the process
    median: float
    p99: float
    p99_9: float
    worst: float
    misses: dict[int, int]  # calls longer than the period, by the rate of the control [Hz]


class Timing(NamedTuple):
    """What was measured of a policy."""

    policy: str
    predict: Times
    observer: Times | None
    compiled: bool  # whether the first call compiled kernels
    collections: int  # of garbage, during the calls that were timed
    kept: float  # [bytes] that stay allocated, per call
    temporary: float  # [bytes] beside what is there before a call, at most; median over the calls


def times_of(first: int, durations: Any) -> Times:
    """Statistics of durations (N,) [ns]; percentiles are durations that occurred."""
    seconds = durations * 1e-9
    p50, p99, p99_9 = np.percentile(seconds, (50.0, 99.0, 99.9), method="higher").tolist()
    misses = {rate: int((seconds > period).sum()) for rate, period in PERIODS.items()}
    return Times(first * 1e-9, p50, p99, p99_9, float(seconds.max()), misses)


class Timed:
    """A function that adds up how long its calls take."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.duration = function, 0  # [ns]

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """What the function returns."""
        began = time.perf_counter_ns()
        answer = self.function(*arguments, **named)
        self.duration += time.perf_counter_ns() - began
        return answer

    def taken(self) -> int:
        """Duration [ns] since the last time that it was asked for."""
        duration, self.duration = self.duration, 0
        return duration


class Loop:
    """A policy that drives one vehicle, episode after episode."""

    def __init__(self, policy: Any, env: Any, seed: int) -> None:
        self.policy, self.env, self.seed = policy, env, seed
        self.predict = Timed(policy.predict)
        self.state: Any = None
        self.over = True

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

    def call(self, observation: Any, start: Any) -> Any:
        """What `predict` answers; its state goes to the next call."""
        answer = self.predict(observation, self.state, start, deterministic=True)
        action, self.state = checked_answer(answer, 1)
        return action

    def advance(self, action: Any) -> None:
        """A step of the environment."""
        self.observation, _, ended, timed_out, self.info = self.env.step(action)
        self.over = bool(ended[0] or timed_out[0])

    def step(self) -> tuple[Any, Any]:
        """A call and a step; returns the inputs of the call."""
        inputs = self.inputs()
        self.advance(self.call(*inputs))
        return inputs


def memory_of(loop: Loop) -> tuple[float, float]:
    """(kept, temporary) of a Timing: of the last of ROUNDS on the same observations, as the lists
    of free blocks of Python and NumPy fill before."""
    records = []
    for _ in range(RECORDED):
        observation, start = loop.step()
        records.append((observation.copy(), start))
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
    entry = received(comparison, name)
    policy: Any = checked_policy(entry, config.context(uncertainty_set))
    env = config.environment(uncertainty_set, 1, needs_truth(policy))
    try:
        loop, observer = Loop(policy, env, config.seed), getattr(policy, "observer", None)
        update = Timed(getattr(observer, "update", int))
        if observer is not None:
            observer.update = update
        inputs = loop.inputs()
        with event.install_recorder("numba:compile") as compilations:
            action = loop.call(*inputs)
        first = loop.predict.taken(), update.taken()
        loop.advance(action)
        for _ in range(WARM):
            loop.step()
        gc.collect()
        if freeze:
            gc.freeze()
        durations = np.empty((2, calls), dtype=np.int64)
        loop.predict.taken(), update.taken()
        collections = -_collections()
        for call in range(calls):
            loop.step()
            durations[0, call], durations[1, call] = loop.predict.taken(), update.taken()
        collections += _collections()
        times = [times_of(*each) for each in zip(first, durations, strict=True)]
        memory = memory_of(loop)
    except (Exception, SystemExit) as error:
        raise blamed(error, name, f"set {uncertainty_set!r}") from error
    finally:
        env.close()
    of_observer = None if observer is None else times[1]
    return Timing(name, times[0], of_observer, bool(compilations.buffer), collections, *memory)


def _collections() -> int:
    return sum(each["collections"] for each in gc.get_stats())


def table(timings: Sequence[Timing], conditions: str) -> Table:
    """The timings as a table, a row of each policy and one of its observer."""
    calls: list[tuple[Timing, str, Times]] = []
    for each in timings:
        calls.append((each, "predict", each.predict))
        if each.observer is not None:
            calls.append((each, "observer", each.observer))
    columns: dict[str, Callable[..., str]] = {
        "policy": lambda of: of[0].policy,
        "call": lambda of: of[1],
        "first [ms]": lambda of: f"{of[2].first * 1e3:.1f}{' c' if of[0].compiled else ''}",
    }
    for name in ("median", "p99", "p99_9", "worst"):
        title = f"{name.replace('_', '.').replace('p', 'P')} [us]"
        columns[title] = lambda of, name=name: f"{getattr(of[2], name) * 1e6:.1f}"
    for rate in PERIODS:
        columns[f"misses {rate} Hz"] = lambda of, rate=rate: f"{of[2].misses[rate]}"

    def of_policy(text: Callable[[Timing], str]) -> Callable[..., str]:
        return lambda of: text(of[0]) if of[1] == "predict" else ""

    columns["gc"] = of_policy(lambda timing: f"{timing.collections}")
    columns["kept [B]"] = of_policy(lambda timing: f"{max(timing.kept, 0.0):.0f}")
    columns["temporary [KiB]"] = of_policy(lambda timing: f"{timing.temporary / 1024:.1f}")
    return Table("Time of a call", table_model.rows_of(columns, calls), 2, [conditions])


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


def _parser(program: str) -> Parser:
    parser = Parser(
        program,
        "Time the calls of policies that drive one vehicle, each in a process of its own, and the "
        "memory that a call takes. Of an agent with several seeds the first is timed.",
    )
    text = "as in `tracked-env evaluate --policies` (default: those of its first look)"
    parser.add_argument("policies", nargs="*", metavar="POLICY", help=text)
    add_option(parser, "all", "all policies that are registered for the environment")
    text = "calls of each policy that are timed (default: 100000)"
    parser.add_argument("--calls", type=int, default=100_000, metavar="N", help=text)
    text = "keep what is there after the set-up out of the garbage collection (default: yes)"
    parser.add_argument("--freeze", action=BooleanOptionalAction, default=True, help=text)
    text = "write the measurements as JSON, in SI units"
    parser.add_argument("--json", type=Path, metavar="FILE", help=text)
    text = f"renew the table of a Markdown page, between the markers of its `{BLOCK}`"
    parser.add_argument("--page", type=Path, metavar="FILE", help=text)
    add_episode_options(parser)
    return parser


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Measure and print; returns the exit status."""
    options = _parser(program).parse_args(arguments)
    calls = checked_whole("--calls", options.calls, CALLS)
    config = benchmark_config(config_of(options))
    names = default_names(registered_policies(), config.env)
    names = options.policies or (names if options.all else first_policies(config.env, names))
    agents: dict[str, PolicyEntry] = {}
    for entry in policies_for(config.env, names):
        agents.setdefault(agent_of(entry.name), entry)
    entries = list(agents.values())
    for entry in entries:  # reject incompatible policies first
        checked_policy(entry, config.context(config.sets[0]))
    facts = {
        "env": config.env,
        "set": config.sets[0],
        "seed": config.seed,
        "calls": calls,
        "freeze": options.freeze,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "machine": files.machine(),
        "versions": files.versions(),
    }
    shared, timings = (sent(config, entries), calls, options.freeze), list[Timing]()
    with progress_bar(calls * len(entries)) as progress:
        for entry in entries:  # each in a process of its own
            progress(0, entry.name)
            timings += [one for _, one in WorkerPool(1).results(measure, shared, [entry.name])]
            progress(calls, entry.name)
    tables = [table(timings, note(facts))]
    print(table_model.terminal(tables, shutil.get_terminal_size().columns))
    if options.json is not None:
        text = json.dumps({**facts, "timings": [report.plain(one) for one in timings]}, indent=1)
        files.write_atomically(options.json, f"{text}\n".encode())
    if options.page is not None:
        files.replace_block(options.page, BLOCK, table_model.markdown(tables).rstrip())
    return 0
