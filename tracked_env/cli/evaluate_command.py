"""`tracked-env evaluate`: the paired comparison of policies, from options to files and tables.

What only a clone of the repository has: training, the papers' experiments, pickled archives.

The first look of `tracked-env evaluate`: few policies on few sets, and their kernels.

Kernels are compiled once after an installation, which takes most of the time of the first look. A
second process compiles from the other end, and each loads what the other has finished.
"""

import os
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import (
    BenchmarkConfig,
    Store,
    check,
    default_sets,
    leaderboard,
    leaderboard_page,
    report,
)
from tracked_env.benchmark.executors import WorkerPool, make_executor
from tracked_env.benchmark.policies import (
    archives,
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import (
    SEED_MARK,
    PolicyEntry,
    PolicyError,
    checked_policy,
)
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.runner import Task, pending, run, run_task
from tracked_env.benchmark.store import identity_hash
from tracked_env.benchmark.summary import rows_of
from tracked_env.benchmark.training_curves import read_costs, read_curves
from tracked_env.cli.evaluate_options import ENVIRONMENTS, Config, env_of, parsed
from tracked_env.cli.exit_status import explained, one_line
from tracked_env.validation import checked_choice, name_or_json

ROOT = Path(__file__).resolve().parents[2]  # the clone, where this package lies in one


def script(name: str) -> Path | None:
    """A script of the clone, None where this package is installed without one."""
    path = ROOT / name
    return path if path.is_file() and (ROOT / "pyproject.toml").is_file() else None


def run_script(name: str, arguments: Sequence[str]) -> NoReturn:
    """Go on as `python NAME ARGUMENTS` of the clone."""
    command = [sys.executable, str(ROOT / name), *arguments]
    sys.stdout.flush()
    if sys.platform == "win32":  # where exec returns to the shell at once
        sys.exit(subprocess.run(command, check=False).returncode)
    os.execv(sys.executable, command)


def main_clone(arguments: Sequence[str], program: str) -> int:
    """`tracked-env train`: train.py of the clone. Returns the exit status."""
    if script("train.py") is None:
        print(
            f"{program}: training is not part of the installed package. Clone the repository and "
            "run `make install` there, then `python train.py`",
            file=sys.stderr,
        )
        return 2
    run_script("train.py", arguments)


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


class Extras(NamedTuple):
    """What only a clone can do; None where it cannot."""

    open_trusted: Callable[[Path], PolicyEntry] | None = None  # an archive with pickled objects
    reproduce: Callable[[Config], int] | None = None  # a paper's experiments


INSTALLED = Extras()
STEP_TIME = 25e-6  # [s] of a processor for a control step of one vehicle, a mean of all policies
LONG = 5_000_000  # control steps of vehicles, about two minutes


def benchmark_config(config: Config) -> BenchmarkConfig:
    """The part of the command line that the benchmark knows. Raises ValueError."""
    env = env_of(config.env, config.sets)
    checked_choice("environment", env, ENVIRONMENTS)
    return BenchmarkConfig(
        sets=chosen_sets(config, env),
        episodes=config.episodes_per_set,
        seed=config.seed,
        reference=name_or_json(config.reference, "reference"),
        sensors=name_or_json(config.sensors, "sensors"),
        duration=config.duration,
        lateral=config.lateral,
        chunk=config.chunk,
        version=config.sets_version,
    )


def chosen_sets(config: Config, env: str) -> tuple[str, ...]:
    """Those that are named, else those of the first look or all."""
    if config.is_first_look:
        return FIRST_LOOKS[env].sets
    return config.sets or default_sets(env, config.sets_version)


def result_folder(output: Path, benchmark: BenchmarkConfig) -> Path:
    """One folder per configuration: the readable part of it, and the hash of all of it."""
    labels = [
        spec if isinstance(spec, str) else spec.get(key, "custom")
        for spec, key in ((benchmark.reference, "kind"), (benchmark.sensors, "preset"))
        if spec is not None
    ]
    if benchmark.duration is not None:
        labels.append(f"{benchmark.duration:g}s")
    version = benchmark.frozen_version
    usual = ["own"] if version is None else [version.name]
    named = not labels and version is not None and bool(version.groups)  # the environment's
    track = [] if named or benchmark.env == TORQUE_ID else [benchmark.env.rpartition("/")[2]]
    name = "-".join(
        [*(part.lower() for part in track), *(labels or usual), f"seed{benchmark.seed}"]
    )
    return output / f"{name}-{identity_hash(benchmark.identity())[:8]}"


def draw(
    config: Config,
    benchmark: BenchmarkConfig,
    entries: list[PolicyEntry],
    store: Store,
    records: list[dict[str, Any]],
    agents: Sequence[str],
) -> list[Path]:
    """Figures and videos, as far as they are asked for and their packages are installed.

    agents: those in the figures. Returns the files of figures.
    """
    folder = store.folder
    files: list[Path] = []
    try:
        if config.figures:
            from tracked_env.benchmark import figures as episode_figures

            files = episode_figures.save_all(
                folder / "figures", store, records, benchmark.sets, benchmark.seed, agents
            )
            print(f"{len(files)} figures in {folder / 'figures'}")
        if config.video:
            from tracked_env.benchmark import video

            for entry in entries:
                path = video.record(benchmark, entry, benchmark.sets[0], 0, folder / "videos")
                print(f"video {path}")
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
    return files


def origin(benchmark: BenchmarkConfig, store: Store) -> dict[str, str]:
    """Where the numbers of a page come from, by what it is."""
    of_machine = store.header["machine"]
    return {
        "environment": benchmark.env,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "sets": check(benchmark).message,
        "episodes": f"{benchmark.episodes} per set, seeds from {benchmark.seed}",
        "hash of the configuration": store.header["hash"],
        "hash of the source": str(benchmark.identity()["source"]),
        "versions": ", ".join(f"{name} {of}" for name, of in store.header["versions"].items()),
        "machine": ", ".join(f"{name} {of}" for name, of in of_machine.items() if of),
    }


def open_with(config: Config, extras: Extras) -> Callable[[Path], PolicyEntry]:
    """What opens archives. Raises ValueError where `--trust` cannot be followed."""
    if config.trust and extras.open_trusted is None:
        raise ValueError(
            "--trust needs PyTorch and the package `agents`, which is not part of the installed "
            "package. Clone the repository, run `make install` there, then `python evaluate.py`"
        )
    return extras.open_trusted if config.trust and extras.open_trusted else open_archive


def run_config(config: Config, program: str, extras: Extras = INSTALLED) -> int:
    """Run what a configuration says; returns the exit status.

    program: begins the line on stderr that says what failed.
    """
    try:
        if config.paper == "none":
            return compare(config, program, extras)
        if extras.reproduce is None:
            raise ValueError(
                f"--paper {config.paper} needs the package `reproduce`, which is not part of the "
                "installed package. Clone the repository, run `make install` there, then "
                "`make paper`"
            )
        return extras.reproduce(config)
    except (PolicyError, OSError) as error:
        print(f"{program}: {one_line(error)}", file=sys.stderr)
        return 1
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2


def main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env evaluate`; returns the exit status."""
    config = parsed(arguments, program)
    if (config.trust or config.paper != "none") and script("evaluate.py"):
        run_script("evaluate.py", arguments)
    return run_config(config, program)


def compare(config: Config, program: str, extras: Extras) -> int:
    """The benchmark: run, print the summary, write the results; returns the exit status."""
    began = time.perf_counter()
    try:
        benchmark = benchmark_config(config)
        policies = registered_policies()
        registry, trained = by_name(policies, benchmark.env)
        specs = config.policies or default_names(policies, benchmark.env)
        if config.is_first_look:
            specs = first_policies(benchmark.env, specs)
        entries = load_policies(specs, registry, trained, open_with(config, extras))
        for entry in entries:  # reject incompatible policies first
            checked_policy(entry, benchmark.context(benchmark.sets[0]))
        executor = make_executor(config.workers, config.ray, config.shard)
        folder = result_folder(config.output, benchmark)
        store = Store(folder, benchmark.identity(), config.shard)
        tasks = list(pending(benchmark, entries, store, executor.workers if executor else 1))
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    checked = check(benchmark)
    for notice in (*store.notices, checked.message):
        print(notice)
    known = len(store.notices)
    asked = len(entries) * len(benchmark.sets) * benchmark.episodes
    missing = sum(len(task.episodes) for task in tasks)
    if config.shard is not None:
        print(f"shard {config.shard}: {missing} of {asked} episodes run here")
    elif missing < asked:
        print(f"{asked - missing} of {asked} episodes are already in {store.folder}")
    if config.is_first_look and not config.quiet:
        print(f"a first look: {', '.join(specs)}; --all compares everything")
    if config.is_first_look and executor is None and tasks:
        compile_kernels(benchmark, specs, entries)
    steps = sum(len(task.episodes) * benchmark.max_steps(task.uncertainty_set) for task in tasks)
    if steps > LONG and executor is None and not config.quiet:
        print(
            f"{missing} episodes take about {steps * STEP_TIME / 60:.0f} min of one processor; "
            "--workers N shares them, and an interrupted run goes on where it was"
        )
    with progress_bar(steps, config.quiet) as progress:
        records = run(benchmark, entries, store, progress, executor)
    if config.shard is not None:
        print(
            f"shard {config.shard} is done in {time.perf_counter() - began:.1f} s: {store.path}. "
            "When all are, the same command without --shard writes the tables"
        )
        return 0
    try:
        rows = rows_of(records)
    except ValueError as error:  # stored episodes that contradict each other
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    summary = report.summarise(records, rows)
    report.write(store.folder, {**store.header, "benchmark": checked._asdict()}, records, summary)
    conditions = f"{checked.message}; source {benchmark.identity()['source']}"
    folders: dict[str, list[Path]] = {}
    for name, path in (found for spec in specs for found in archives(spec, trained)):
        folders.setdefault(name, []).append(path.parent)
    board = leaderboard.leaderboard(summary, rows, conditions, read_costs(folders))
    leaderboard.write(store.folder, board)
    if not config.quiet:
        width = shutil.get_terminal_size().columns
        if not config.is_first_look:
            print(f"\n{report.terminal(summary, width)}\n")
        print(f"\nLeaderboard\n\n{leaderboard.terminal(board, width)}\n")
    files = draw(config, benchmark, entries, store, records, leaderboard.shown(board))
    curves = read_curves(folders)
    page = leaderboard_page.write(
        store.folder, board, rows, curves, config.figures, files, summary, origin(benchmark, store)
    )
    print(f"results.json, episodes.csv, summary.md and leaderboard.html in {store.folder}")
    for notice in store.notices[known:]:
        print(notice)
    print(f"done in {time.perf_counter() - began:.1f} s; the page: {page}")
    return 0
