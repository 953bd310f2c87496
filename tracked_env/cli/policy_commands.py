"""Commands about one policy: `tracked-env timing`, `tracked-env tune` and `tracked-env export`.

timing: time and memory of a call of a policy that drives one vehicle.

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

tune: the settings of a controller are searched on the development episodes (`benchmark.tuning`).

export: the network of a trained agent as a file for a robot. What writes it is the function that an
installed package registers as `export` in `tracked_env.commands`: (archive, file, name of the
agent) -> metadata.
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

from tracked_env import TORQUE_ID
from tracked_env.benchmark import files, policies, report, table_model
from tracked_env.benchmark.evaluation_sets import AUDIT, LENGTH
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
from tracked_env.benchmark.tuning import (
    RATE_LIMIT,
    Search,
    Tunable,
    searched,
    tables_of,
    tunable,
    varied,
)
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import (
    Config,
    add_env,
    add_episode_options,
    add_option,
    benchmark_settings,
    chosen_sets,
    episode_config,
    first_policies,
)
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number, checked_whole, unknown

WARM = 100  # calls before those that are timed
RECORDED = 1000  # calls of which the memory is measured
ROUNDS = 3  # of them, of which the last counts: lists of free blocks fill before
CALLS = Range(1, 10**8, "-", "It is the number of calls that are timed.")
BLOCK = "timing table"  # of a page
BUDGET = Range(3, 10_000, "-", "It is the number of settings that are driven.")
RATE = Range(0.01, 1e9, "-", "It is a factor on the action rate of the default settings.")
EPISODES = Range(4, LENGTH, "-", "It is the number of episodes of each set.")
ARCHIVE = "agent.zip"  # in the folder of a training


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


def timing_main(arguments: Sequence[str], program: str) -> int:
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


# Tuning


def _tune_parser(program: str) -> Parser:
    parser = Parser(
        program,
        "Search the settings of a controller on the development episodes, and write a "
        "CSV file with all that was driven and a page of tables. An interrupted search goes on "
        "when the same command is given again.",
    )
    parser.add_argument("policy", help="a registered controller that declares its ranges")
    add_env(parser)
    add_option(parser, "vehicle")
    add_option(parser, "env_args")
    text = "evaluation sets (default: all that separate policies), or FILE.toml: sets of your own"
    add_option(parser, "sets", text)
    text = "settings to be driven, 3 to 10000, the default among them, without the sensitivity"
    parser.add_argument(
        "--budget", type=int, default=200, metavar="N", help=f"{text} (default: 200)"
    )
    add_option(parser, "episodes", f"of each set, 4 to {LENGTH}", default=32)
    add_option(parser, "duration")
    text = "drive default and best on the audit split at the end; look once"
    parser.add_argument("--audit", action="store_true", help=text)
    text = "largest action rate over that of the default settings, 0.01 to 1e9 (any)"
    parser.add_argument(
        "--rate-limit", type=float, default=RATE_LIMIT, metavar="X", help=f"{text} (default: 1.1)"
    )
    add_option(parser, "output", "folder of the files", default=Path("results/tuning"))
    return parser


def registered(name: str, env: str) -> Tunable:
    """The controller of that name for that environment. Raises ValueError."""
    every = policies.registered_policies()
    factories = {one.name: one.policy for one in every}
    for id_ in (*reversed(policies.ids_of(env)), None):
        factories |= {one.name: one.policy for one in every if one.env == id_}
    if name not in factories:
        tuned = [key for key, one in factories.items() if hasattr(one, "TUNABLE")]
        raise unknown("policy", name, tuned)
    return tunable(name, factories[name])


def tune(search: Search, budget: int, audit: bool) -> str:
    """Search, write the page beside the file, and return the tables for a terminal."""
    variations = 4 * len(search.policy.ranges) + 2 * audit
    with progress_bar((budget + variations) * search.max_steps * search.episodes) as progress:
        search.progress = progress
        candidates = list(searched(search.policy.ranges, search.default, budget, search.evaluate))
        best = min(candidates, key=lambda one: one.cost)
        around = {
            (name, factor): search.evaluate(f"{name} x {factor:g}", settings)
            for name, factor, settings in varied(best.settings)
        }
        judged = [(one.stage, one.settings) for one in (candidates[0], best) if audit]
        audited = [search.evaluate(*one, seed=AUDIT) for one in judged]
    config = search.config()
    firsts = sorted({config.first_seed(name) for name in search.sets})
    seeds = ", ".join(f"{first} to {first + search.episodes - 1}" for first in firsts)
    conditions = (
        f"{len(candidates)} settings on {len(search.sets)} sets ({', '.join(search.sets)}), "
        f"{search.episodes} episodes each, seeds {seeds}."
    )
    near = {place: one for place, one in around.items() if one is not None}
    checked = [one for one in audited if one is not None]
    tables = tables_of(search.policy, candidates, near, checked)
    text = f"## `{search.policy.name}` on {config.env}\n\n{conditions}\n\n"
    page = text + table_model.markdown(tables)
    search.file.with_suffix(".md").write_text(page, encoding="utf-8")
    return f"{conditions}\n\n{table_model.terminal(tables, 132)}"


def tune_main(arguments: Sequence[str], program: str) -> int:
    """Search and print; returns the exit status."""
    options = _tune_parser(program).parse_args(arguments)
    budget = checked_whole("--budget", options.budget, BUDGET)
    episodes = checked_whole("--episodes", options.episodes, EPISODES)
    env = chosen_sets(options.env, options.sets).env
    policy = registered(options.policy, env)
    own = Config(options.vehicle, options.env_args, env=env, sets=options.sets)
    settings = {"duration": options.duration, **benchmark_settings(own, "tuning")}
    settings["rate_limit"] = checked_number("--rate-limit", options.rate_limit, RATE)
    search = Search(policy, settings.pop("sets"), episodes, options.output, **settings)
    if search.candidates:
        print(f"going on with {len(search.candidates)} settings of {search.file}")
    print(tune(search, budget, options.audit))
    print(search.file, search.file.with_suffix(".md"), sep="\n")
    return 0


# Export


def archive_of(spec: str, env: str) -> Path:
    """The archive that an item of the command line names; of several seeds the first one.

    Raises ValueError for what is no trained agent.
    """
    known = policies.by_name(policies.registered_policies(), env)
    spec = str(Path(spec, ARCHIVE)) if Path(spec).is_dir() else spec
    found = policies.archives(spec, known)
    if not found:
        agents = ", ".join(name for name, one in known.items() if isinstance(one, list))
        raise ValueError(
            f"{spec!r} is no trained agent; must be one of {agents}, an archive of train.py, or "
            "its folder. A controller has no network"
        )
    return found[0][1]


def export_main(arguments: Sequence[str], program: str) -> int:
    """Export; returns the exit status."""
    parser = Parser(
        program,
        "Write the network of a trained agent as a file that onnxruntime runs: scaling, limits "
        "and memory are in it, names and units in its metadata. Needs the extra `export`.",
    )
    text = "NAME or NAME@SEED of a trained agent (`tracked-env policies`), agent.zip, or its folder"
    parser.add_argument("agent", metavar="AGENT", help=f"{text}; of several seeds the first one")
    add_env(parser, text="environment of the agent that is named (default: Torque-v0)")
    text = "format of the file (default: onnx)"
    parser.add_argument("--format", choices=("onnx",), default="onnx", help=text)
    text = "file to write (default: NAME-seedSEED.onnx, after the folder of the agent)"
    parser.add_argument("--file", type=Path, metavar="FILE", help=text)
    options = parser.parse_args(arguments)
    archive = archive_of(options.agent, options.env or TORQUE_ID)
    file = options.file or Path(f"{policies.own_name(archive)}.{options.format}")
    metadata = policies.command_function("export")(archive, file, policies.own_name(archive))
    fields, features = (len(json.loads(metadata[key])) for key in ("observation", "features"))
    rate = f"{metadata['control_rate']} Hz"
    print(f"{file}: {fields} fields of the observation, {features} features, {rate}")
    print(f"action: {metadata['action']}")
    return 0
