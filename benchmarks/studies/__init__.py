"""Studies of ours on episodes of the benchmark, out of the wheel.

    python -m benchmarks.studies.choice_of_sets     which evaluation sets decide
    python -m benchmarks.studies.adaptation         what adapting inside an episode is worth
    python -m benchmarks.studies.breaking_points    how much of one difficulty a policy stands
    python -m benchmarks.studies.break_headline     what changes the ranking
    python -m benchmarks.studies.vehicle_sizes      how vehicles of every size are driven
    python -m benchmarks.studies.untold_vehicles    one policy for all vehicles, told and untold
    python -m benchmarks.studies.filtering          how well the position is known, and could be
    python -m benchmarks.studies.ablation           what each part of `adaptive` is worth
    python -m benchmarks.studies.long_episodes      what an hour does to error and memory

Each but the last and `filtering` keeps the episodes that it drives in a folder under results/ and
runs only what is missing.
"""

import csv
import io
import math
import shutil
from argparse import Namespace
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.policies import policies_for
from tracked_env.benchmark.policy_interface import PolicyEntry, agent_of
from tracked_env.benchmark.runner import run_with_bar
from tracked_env.benchmark.store import Record, Store
from tracked_env.benchmark.table_model import aligned
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import add_env, add_option
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_whole

Cells = list[list[str]]  # rows of a table, the header first


def study_parser(
    program: str, description: str, episodes: int, env: dict[str, Any] | None = None
) -> Parser:
    """The options of every study; episodes: default; env: how `add_env` is called."""
    parser = Parser(program, description)
    add_env(parser, **(env or {}))
    every = "as in `tracked-env evaluate --policies`; by default all that are registered"
    add_option(parser, "policies", every)
    add_option(parser, "episodes", "of each set", default=episodes)
    text = "trainings of every agent, at most (default: all)"
    parser.add_argument("--seeds", type=int, metavar="N", help=text)
    add_option(parser, "output", "folder of the results")
    add_option(parser, "workers")
    return parser


def policies_of(options: Namespace, env: str) -> list[PolicyEntry]:
    """Those that are named, else all of the environment; of each agent its first trainings."""
    count = options.seeds or math.inf
    if options.seeds is not None:
        checked_whole("--seeds", options.seeds, Range(1, 1000, "-", "It counts trainings."))
    first = list[PolicyEntry]()
    for entry in policies_for(env, options.policies):
        if sum(agent_of(one.name) == agent_of(entry.name) for one in first) < count:
            first.append(entry)
    return first


def records_of(
    config: BenchmarkConfig, entries: Sequence[PolicyEntry], store: Store, workers: int | None
) -> list[Record]:
    """Records of all episodes; what the store has is not run again."""
    return run_with_bar(config, entries, store, make_executor(workers))


def show(cells: Cells, names: int) -> None:
    """Print a table as wide as the terminal; names: columns of names."""
    print(f"\n{aligned(cells, names, shutil.get_terminal_size().columns)}\n")


def write_csv(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """A table of numbers as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    write_atomically(path, text.getvalue().encode())
