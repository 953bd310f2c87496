"""Paired runner: every policy drives the same episodes of the same sets.

Episode i of a set (see `evaluation_sets`) is seeded `seed + i`, whatever the policy and the size of
the batch: vehicle, soil, reference, start and every sensor noise sample are the same for all. A
chunk of episodes runs as one batch, here or elsewhere (`executors`), and is stored here at its end.
"""

import hashlib
import sys
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from functools import partial
from itertools import count
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.arrays import STEP, columns
from tracked_env.benchmark import identification_metrics, metrics
from tracked_env.benchmark.benchmark_config import CHUNK_MIN, BenchmarkConfig
from tracked_env.benchmark.executors import Executor, SentComparison, received, sent
from tracked_env.benchmark.identification_metrics import Recorder, optional
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyEntry,
    blamed,
    can_freeze,
    checked_answer,
    checked_policy,
    identifies,
    needs_truth,
    tell_plant,
)
from tracked_env.benchmark.store import FIGURE_ERRORS, READS_TRUTH, Record, Store, figure_data
from tracked_env.engine.episode import Episode
from tracked_env.vector_env import TrackedVehicleVectorEnv

# (vehicle steps done since the last call, what runs); with no steps: what begins
Progress = Callable[[int, str], None]

TASKS = 3  # per worker, so that none is idle for long at the end
LOG_PERIOD = 30.0  # [s] between two lines where stderr is not a terminal

# Channels of a trace that have another name in the simulation; of `speed_error` the vehicle's speed
# is subtracted.
_RENAMED = {"error": "distance", "speed_error": "reference_speed"}
_COLUMNS = columns(_RENAMED.get(name, name) for name in metrics.CHANNELS)
_SPEED_ERROR = metrics.CHANNELS.index("speed_error")


class Task(NamedTuple):
    """One chunk of one policy on one set."""

    policy: str
    uncertainty_set: str
    episodes: tuple[int, ...]

    @property
    def label(self) -> str:
        """What a progress bar shows of it."""
        return f"{self.uncertainty_set}: {self.policy}"

    def __str__(self) -> str:
        return f"{self.label}, episodes {self.episodes[0]} to {self.episodes[-1]},"


class Finished(NamedTuple):
    """What a store keeps of a task."""

    chunk: Record
    trace: dict[str, NDArray[Any]] | None  # of the first episodes, for the figures


def no_progress(steps: int, label: str) -> None:
    """Report no progress."""


@contextmanager
def progress_bar(total: int, quiet: bool = False) -> Iterator[Progress]:
    """A function that reports control steps of vehicles; nothing is shown when quiet.

    Where stderr is no terminal, it is a plain line at most every LOG_PERIOD.
    """
    from tqdm import tqdm

    is_terminal = sys.stderr.isatty()
    with tqdm(
        total=total,
        unit=" steps",
        unit_scale=True,
        bar_format="{desc:<28} {percentage:3.0f}% |{bar}| [{elapsed}<{remaining}, {rate_fmt}]",
        dynamic_ncols=True,
        disable=quiet,
        mininterval=0.1 if is_terminal else LOG_PERIOD,
        delay=0.0 if is_terminal else LOG_PERIOD,
        file=sys.stderr if is_terminal else SimpleNamespace(write=_line, flush=_line),
    ) as bar:

        def progress(steps: int, label: str) -> None:
            bar.set_description_str(label, refresh=is_terminal and steps == 0)
            bar.update(steps)

        yield progress


def _line(text: str = "") -> None:
    """Write a line of a log, which has no carriage returns."""
    if text := text.strip():
        print(text, file=sys.stderr, flush=True)


def chunk_size(config: BenchmarkConfig, policies: int, workers: int) -> int:
    """Episodes of a chunk: smaller ones than asked for only below TASKS tasks a worker."""
    size = config.chunk
    while size > CHUNK_MIN:
        tasks = -(-config.episodes // size) * len(config.sets) * policies
        if tasks >= TASKS * workers:
            break
        size = max(size // 2, CHUNK_MIN)
    return size


def pending(
    config: BenchmarkConfig, policies: Sequence[PolicyEntry], store: Store, workers: int = 1
) -> Iterator[Task]:
    """The chunks that the store lacks, set by set, all policies on a chunk in turn.

    workers: how many run at the same time. The store of a shard gets the chunks of that shard: all
    shards deal out the same ones.
    """
    done = {(r["set"], r["policy"], r["episode"]) for r in store.records(_fingerprints(policies))}
    size = chunk_size(config, len(policies), max(workers, store.shard.parts))

    def missing(name: str, policy: str, chunk: range) -> tuple[int, ...]:
        return tuple(i for i in chunk if (name, policy, i) not in done)

    tasks = (
        Task(entry.name, name, missing(name, entry.name, chunk))
        for name in config.sets
        for chunk in config.batches(name, config.episodes, size)
        for entry in policies
    )
    return (task for task in store.shard.of(tasks) if task.episodes)


def _fingerprints(policies: Sequence[PolicyEntry]) -> dict[str, str]:
    return {entry.name: entry.fingerprint for entry in policies}


def feed(digest: Any, value: Any, read: Callable[[Any], NDArray[Any]] = np.asarray) -> None:
    """Feed all numbers of nested tuples to a digest; read: makes the array of one value."""
    if isinstance(value, tuple):
        for part in value:
            feed(digest, part, read)
    else:
        digest.update(read(value).tobytes())


def episode_digest(episode: Episode) -> str:
    """Digest of all that an episode is: equal for two policies that met the same one."""
    digest = hashlib.sha256()
    feed(digest, tuple(episode))
    return digest.hexdigest()[:12]


class Step(NamedTuple):
    """What one control step of a batch has come to; the first one is the reset."""

    over: NDArray[np.bool_]  # (N,)
    terminated: NDArray[np.bool_]  # (N,)
    info: Mapping[str, Any]
    predict_time: float  # [s]


def steps_of(
    policy: Policy,
    env: TrackedVehicleVectorEnv,
    seeds: Sequence[int],
    recorder: Recorder | None = None,
    freeze_at: NDArray[np.int64] | None = None,
    options: dict[str, Any] | None = None,
) -> Iterator[Step]:
    """Drive one episode per seed to its end: the reset, then control step by control step.

    options: of the reset.
    recorder: takes down what a policy believes, beside the truth of that moment. freeze_at (N,):
    control step before which the policy's `freeze` is called for that vehicle, -1 for never.
    """
    observation, info = env.reset(seed=list(seeds), options=options)
    tell_plant(policy, env.simulation.solver.reads.names)
    over: NDArray[np.bool_] = np.zeros(env.num_envs, dtype=bool)
    state: Any = None
    yield Step(over, over, info, 0.0)
    for done in count():
        if needs_truth(policy):
            truth = {k: v for k, v in info["truth"].items() if not k.startswith("_")}
            policy.observe_truth(truth)  # type: ignore[attr-defined]
        if freeze_at is not None and (freeze_at == done).any():
            policy.freeze(freeze_at == done)  # type: ignore[attr-defined]
        start = np.full(env.num_envs, done == 0)
        began = time.perf_counter()
        answer = policy.predict(observation, state, start, deterministic=True)
        predict_time = time.perf_counter() - began
        action, state = checked_answer(answer, env.num_envs)
        if recorder is not None:
            recorder.take(policy, env.simulation.batch.floats)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated | truncated
        yield Step(over, terminated, info, predict_time)
        if over.all():
            return
        if terminated.any():  # a diverged vehicle must not disturb those that go on
            observation = np.nan_to_num(observation)


def drive(
    policy: Policy,
    env: TrackedVehicleVectorEnv,
    seeds: Sequence[int],
    on_step: Callable[[], None],
    recorder: Recorder | None = None,
    freeze_at: NDArray[np.int64] | None = None,
    options: dict[str, Any] | None = None,
) -> tuple[metrics.Trace, float]:
    """Run one episode per seed to its end. Returns their trace and the mean time of `predict` [s].

    The first call, which compiles and fills tables, is not timed, unless it is the only one.
    recorder, freeze_at, options: as in `steps_of`.
    """
    simulation = env.simulation
    steps = steps_of(policy, env, seeds, recorder, freeze_at, options)
    solver, max_steps = simulation.solver, simulation.settings.max_steps
    step = next(steps)
    goals = metrics.goals_of([episode for episode in simulation.episodes if episode is not None])
    values = np.empty((max_steps, env.num_envs, len(_COLUMNS)))
    times = list[float]()
    for step in steps:
        values[len(times)] = simulation.batch.floats[:, _COLUMNS]
        values[len(times), :, _SPEED_ERROR] -= simulation.batch.column("v_x")
        times.append(step.predict_time)
        on_step()
    trace = metrics.Trace(
        values[: len(times)],
        simulation.steps,
        max_steps,
        step.terminated,
        np.asarray(step.info["is_success"], dtype=bool),
        simulation.column(solver.drive.limit),
        simulation.column("contact_length"),
        simulation.column("error_limit"),
        solver.control_period,
        solver.drive.name,
        solver.nominal,
        goals,
    )
    return trace, float(np.mean(times[1:] or times))


def run_task(
    entry: PolicyEntry, task: Task, config: BenchmarkConfig, progress: Progress = no_progress
) -> Finished:
    """Run one chunk. Raises PolicyError."""
    size, first = len(task.episodes), task.episodes[0]
    context = config.context(task.uncertainty_set, first)
    options = config.options(task.uncertainty_set, task.episodes)
    policy = checked_policy(entry, context)
    if needs_truth(policy) and config.registered(task.uncertainty_set).fleet is not None:
        context = config.context(task.uncertainty_set, first, truth=True)
        policy = checked_policy(entry, context)
    env = config.environment(task.uncertainty_set, size, needs_truth(policy), first)
    recorder = None
    if identifies(policy):
        reads = frozenset(env.simulation.solver.reads.names)
        recorder = Recorder(size, env.simulation.settings.max_steps, reads)
    seeds = [config.first_seed(task.uncertainty_set) + i for i in task.episodes]
    try:
        freeze_at = None
        if entry.frozen and can_freeze(policy):
            # Up to the change a policy that is frozen there drives as it does otherwise.
            changes = drive(policy, env, seeds, lambda: None, options=options)[0].changes()
            freeze_at = np.array([of[0].first if of else -1 for of in changes])
            policy = checked_policy(entry, context)
        on_step = partial(progress, size, task.label)
        trace, predict_time = drive(policy, env, seeds, on_step, recorder, freeze_at, options)
    except (Exception, SystemExit) as error:
        step = int(env.simulation.batch.counters[:, STEP].max())
        raise blamed(error, entry.name, f"set {task.uncertainty_set!r}, step {step}") from error
    finally:
        env.close()
    values, endings = metrics.evaluate(trace), metrics.ending(trace)
    estimates: list[dict[str, Any]] = [{}] * size
    if recorder is not None:
        estimates = identification_metrics.evaluate(recorder, trace)
    episodes: list[Record] = []
    for row, (episode, seed) in enumerate(zip(task.episodes, seeds, strict=True)):
        drawn_episode = env.simulation.episodes[row]
        assert drawn_episode is not None
        head = {"episode": episode, "seed": seed, "digest": episode_digest(drawn_episode)}
        numbers = {name: optional(column[row]) for name, column in values.items()}
        episodes.append({**head, "ended": endings[row], **numbers, **estimates[row]})
    chunk = {
        "policy": entry.name,
        "fingerprint": entry.fingerprint,
        "set": task.uncertainty_set,
        "predict_time": predict_time / size,  # [s] per vehicle and step
        "episodes": episodes,
        **({READS_TRUTH: True} if needs_truth(policy) else {}),
    }
    progress((trace.max_steps - len(trace.values)) * size, task.label)
    is_drawn = task.episodes[0] < FIGURE_ERRORS
    return Finished(chunk, figure_data(trace, recorder, task.episodes) if is_drawn else None)


def run_sent(comparison: SentComparison, task: Task) -> Finished:
    """Run one chunk in the process that has got it. Raises PolicyError, ValueError."""
    return run_task(received(comparison, task.policy), task, comparison.config)


def run(
    config: BenchmarkConfig,
    policies: Sequence[PolicyEntry],
    store: Store,
    progress: Progress = no_progress,
    executor: Executor | None = None,
) -> list[Record]:
    """Run what the store lacks. Returns one record per episode, ordered as config and policies.

    executor: where; without one, in this process. Raises PolicyError, and ValueError for a policy
    that cannot be sent elsewhere; OSError where a chunk is lost again and again, or not stored.
    """
    entries = {entry.name: entry for entry in policies}
    tasks = list(pending(config, policies, store, executor.workers if executor else 1))
    results: Generator[tuple[int, Finished]] = (
        (number, run_task(entries[task.policy], task, config, progress))
        for number, task in enumerate(tasks)
    )
    if executor is not None:
        results = executor.results(run_sent, sent(config, policies), tasks)
    with closing(results):
        for number, (chunk, trace) in results:
            task = tasks[number]
            if trace is not None:
                store.save_trace(task.policy, task.uncertainty_set, trace, task.episodes[0])
            store.append(chunk, executor.workers if executor else store.shard.parts)
            if executor is not None:
                progress(config.max_steps(task.uncertainty_set) * len(task.episodes), task.label)
    return chosen_records(config, policies, store)


def run_with_bar(
    config: BenchmarkConfig,
    policies: Sequence[PolicyEntry],
    store: Store,
    executor: Executor | None = None,
    quiet: bool = False,
) -> list[Record]:
    """`run` with a bar of its progress."""
    tasks = pending(config, policies, store, executor.workers if executor else 1)
    steps = sum(len(task.episodes) * config.max_steps(task.uncertainty_set) for task in tasks)
    with progress_bar(steps, quiet) as progress:
        return run(config, policies, store, progress, executor)


def chosen_records(
    config: BenchmarkConfig, policies: Sequence[PolicyEntry], store: Store
) -> list[Record]:
    """The finished records of the sets and policies of a configuration, in their order."""
    sets = {name: i for i, name in enumerate(config.sets)}
    order = {entry.name: i for i, entry in enumerate(policies)}
    records = [
        record
        for record in store.records(_fingerprints(policies))
        if record["set"] in sets and record["episode"] < config.episodes
    ]
    return sorted(records, key=lambda r: (sets[r["set"]], order[r["policy"]], r["episode"]))
