"""`tracked-env evaluate`: the paired comparison of policies, from options to files and tables.

Where neither policies nor sets are named it is a first look: few policies on few sets. Kernels are
compiled once after an installation, which takes most of the time of the first look, and several
processes do it (`compile_command`).
"""

import shlex
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

from tracked_env import TORQUE_ID
from tracked_env.benchmark import leaderboard, policies, report
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.frozen import check
from tracked_env.benchmark.policies import Opener
from tracked_env.benchmark.policy_interface import PolicyEntry, PolicyError, checked_policy
from tracked_env.benchmark.runner import pending, run_with_bar
from tracked_env.benchmark.store import Record, Store, identity_hash
from tracked_env.benchmark.summary import rows_of, summarise
from tracked_env.benchmark.table_model import terminal
from tracked_env.cli.command_line import Parser, reported, run_script
from tracked_env.cli.compile_command import compile_kernels
from tracked_env.cli.evaluate_options import (
    ENVIRONMENTS,
    Config,
    add_env,
    add_options,
    benchmark_config,
    config_of,
    first_policies,
    parsed,
)
from tracked_env.environment_ids import PUBLISHED
from tracked_env.vehicles import find_vehicle, vehicle_record

# What the options of a leaderboard are; everything else it has in its own way.
BOARD = (
    *("vehicle", "env_args", "sets_version", "episodes", "seed", "output", "quiet", "chunk"),
    *("workers", "shard", "ray"),
)


def result_folder(output: Path, benchmark: BenchmarkConfig) -> Path:
    """One folder per configuration: the readable part of it, and the hash of all of it."""
    labels = [
        spec if isinstance(spec, str) else spec.get(key, "custom")
        for spec, key in ((benchmark.reference, "kind"), (benchmark.sensors, "preset"))
        if spec is not None
    ]
    if benchmark.vehicle is not None:
        record = vehicle_record(find_vehicle(benchmark.vehicle))
        labels.append(record if isinstance(record, str) else "own-vehicle")
    if benchmark.duration is not None:
        labels.append(f"{benchmark.duration:g}s")
    version = benchmark.frozen_version
    usual = ["own"] if version is None or benchmark.own_sets else [version.name]
    says_env = not labels and version is not None and bool(version.groups)
    track = benchmark.env.rpartition("/")[2].lower()
    prefix = [] if says_env or benchmark.env == TORQUE_ID else [track]
    name = "-".join([*prefix, *(labels or usual), f"seed{benchmark.seed}"])
    return output / f"{name}-{identity_hash(benchmark.identity())[:8]}"


def origin(benchmark: BenchmarkConfig, store: Store, sets: str) -> dict[str, str]:
    """Where the numbers of a page come from, by what it is."""
    firsts = sorted({benchmark.first_seed(name) for name in benchmark.sets})
    return {
        "environment": benchmark.env,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        "sets": sets,
        "episodes": f"{benchmark.episodes} per set, seeds from {', '.join(map(str, firsts))}",
        "hash of the configuration": store.header["hash"],
        "hash of the source": str(benchmark.identity()["source"]),
        "versions": ", ".join(f"{name} {of}" for name, of in store.header["versions"].items()),
        "machine": ", ".join(f"{name} {of}" for name, of in store.header["machine"].items() if of),
    }


@reported
def run_config(
    config: Config,
    program: str,
    open_trusted: Opener | None = None,
    reproduce: Callable[[Config], int] | None = None,
) -> int:
    """Run what a configuration says; returns the exit status.

    program: begins the line on stderr that says what failed. What only a clone has: open_trusted
    opens an archive with pickled objects, reproduce runs a paper's experiments.
    """
    if config.paper == "none":
        return compare(config, program, open_trusted)
    if reproduce is None:
        raise ValueError(
            f"--paper {config.paper} needs the package `reproduce`, which is not part of the "
            "installed package. Clone the repository, run `make install` there, then `make paper`"
        )
    return reproduce(config)


def main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env evaluate`; returns the exit status."""
    config = parsed(arguments, program)
    if config.trust or config.paper != "none":
        run_script("evaluate.py", arguments)
    return run_config(config, program)


def leaderboard_main(arguments: Sequence[str], program: str) -> int:
    """`tracked-env leaderboard`: everything that is registered, on one environment after the other.

    Returns the exit status.
    """
    parser = Parser(
        program,
        "Evaluate all registered policies on all sets, and write leaderboard.json, "
        "leaderboard.md and leaderboard.html.",
    )
    add_env(parser, text="this environment alone (default: all)", default=None)
    add_options(parser, BOARD)
    options = parser.parse_args(arguments)
    for env in [options.env] if options.env else ENVIRONMENTS:
        options.env, options.all, options.figures = env, True, False
        status = run_config(config_of(options), program)
        if status != 0:
            return status
    return 0


def compatible(
    entries: list[PolicyEntry], benchmark: BenchmarkConfig, leave_out: bool
) -> list[PolicyEntry]:
    """The policies, each seen to accept the environment before anything runs.

    leave_out: those that do not, with a line that says why. Raises PolicyError for one that does
    not, and where all are left out.
    """
    fitting, refused = list[PolicyEntry](), list[PolicyError]()
    for entry in entries:
        try:
            checked_policy(entry, benchmark.context(benchmark.sets[0]))
            fitting.append(entry)
        except PolicyError as error:
            if not leave_out:
                raise
            refused.append(error)
    if not fitting:
        raise refused[0]
    for each in refused:
        print(f"left out: {each}", file=sys.stderr)
    return fitting


def compare(config: Config, program: str, open_trusted: Opener | None = None) -> int:
    """The benchmark: run, print the summary, write the results; returns the exit status.

    Raises ValueError for what cannot be run.
    """
    began = time.perf_counter()
    if config.trust and open_trusted is None:
        raise ValueError(
            "--trust needs PyTorch and the package `agents`, which is not part of the installed "
            "package. Clone the repository, run `make install` there, then `python evaluate.py`"
        )
    try:
        executor = make_executor(config.workers, config.ray, config.shard)
        benchmark = benchmark_config(config)
        registered = policies.registered_policies()
        registry = policies.by_name(registered, benchmark.env)
        specs = config.policies or policies.default_names(registered, benchmark.env)
        if config.is_first_look:
            here = benchmark.env.rpartition(":")[2]
            own = [each.name for each in registered if each.env == here and here not in PUBLISHED]
            specs = tuple(dict.fromkeys((*own, *first_policies(benchmark.env, specs))))
        opener = (config.trust and open_trusted) or policies.open_archive
        entries = policies.load_policies(specs, registry, opener)
        is_own = benchmark.env not in PUBLISHED or benchmark.own_sets or benchmark.vehicle
        entries = compatible(entries, benchmark, bool(is_own and config.policies is None))
        store = Store(result_folder(config.output, benchmark), benchmark.identity(), config.shard)
        tasks = list(pending(benchmark, entries, store, executor.workers if executor else 1))
    except PolicyError as error:  # before anything runs: it was named wrongly
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    print("\n".join((*store.notices, check(benchmark).message)))
    notices = len(store.notices)
    total = len(entries) * len(benchmark.sets) * benchmark.episodes
    missing = sum(len(task.episodes) for task in tasks)
    if config.shard is not None:
        print(f"shard {config.shard}: {missing} of {total} episodes run here")
    elif missing < total:
        print(f"{total - missing} of {total} episodes are already in {store.folder}")
    if config.is_first_look and not config.quiet:
        print(f"a first look: {', '.join(specs)}; --all compares everything")
    if config.is_first_look and executor is None and tasks:
        compile_kernels([(benchmark, tuple(entry.name for entry in entries))])
    records = run_with_bar(benchmark, entries, store, executor, config.quiet)
    if config.shard is not None:
        print(
            f"shard {config.shard} is done in {time.perf_counter() - began:.1f} s: {store.path}. "
            "When all are, the same command without --shard writes the tables"
        )
        return 0
    try:
        archives = [one for spec in specs for one in policies.archives(spec, registry)]
        page = write_results(config, benchmark, entries, archives, store, records)
    except ValueError as error:  # stored episodes that contradict each other
        print(f"{program}: {error}", file=sys.stderr)
        return 1
    print(f"results.json, episodes.csv, summary.md and leaderboard.html in {store.folder}")
    for notice in store.notices[notices:]:
        print(notice)
    print(f"done in {time.perf_counter() - began:.1f} s; the page: {page}")
    return 0


def write_results(
    config: Config,
    benchmark: BenchmarkConfig,
    entries: Sequence[PolicyEntry],
    archives: Sequence[tuple[str, Path]],
    store: Store,
    records: list[Record],
) -> Path:
    """Write and print the tables, draw the figures; returns the page.

    archives: name of the agent and file of each. Raises ValueError.
    """
    rows, checked = rows_of(records), check(benchmark)
    summary = summarise(records, rows)
    report.write(store.folder, {**store.header, "benchmark": checked._asdict()}, records, summary)
    folders: dict[str, list[Path]] = {}
    for name, path in archives:
        folders.setdefault(name, []).append(path.parent)
    conditions = f"{checked.message}; source {benchmark.identity()['source']}"
    costs = leaderboard.read_costs(folders)
    calls = leaderboard.read_call_times(store.folder)
    board = leaderboard.leaderboard(summary, rows, conditions, costs, calls)
    if not config.quiet:
        width = shutil.get_terminal_size().columns
        if not config.is_first_look:
            print(f"\n{report.terminal(summary, width)}\n")
        print(f"\nLeaderboard\n\n{terminal(report.leaderboard_tables(board), width)}\n")
    drawings, files = [], []
    if config.figures:
        from tracked_env.benchmark import figures

        place, agents = store.folder / "figures", leaderboard.figure_agents(board)
        drawings = [figures.profiles(board, list(rows.values())[-1])]
        files = figures.save_all(place, store, records, benchmark.sets, benchmark.seed, agents)
        print(f"{len(files)} figures in {place}")
    if config.video:
        try:
            from tracked_env.benchmark import video

            for entry in entries:
                path = video.record(benchmark, entry, benchmark.sets[0], 0, store.folder / "videos")
                print(f"video {path}")
        except ImportError as error:
            print(f"not drawn: {error}", file=sys.stderr)
    facts = origin(benchmark, store, checked.message)
    return report.write_leaderboard(store.folder, board, summary, facts, drawings, files)
