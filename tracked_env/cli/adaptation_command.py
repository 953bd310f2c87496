"""`tracked-env adaptation`: every policy beside itself without learning from the change on."""

import csv
import io
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from tracked_env.benchmark import adaptation
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.chunks import pending
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.policy_interface import (
    PolicyEntry,
    can_freeze,
    checked_policy,
    frozen,
)
from tracked_env.benchmark.policy_lookup import load_policies
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.registered_policies import (
    by_name,
    default_names,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store, write_atomically
from tracked_env.benchmark.summary import agent_of, rows_of
from tracked_env.benchmark.text_tables import aligned, folded, markdown_rows
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import add_options, config_of, env_of
from tracked_env.cli.exit_status import Parser, reported

# Sets with a change inside the episode, by environment.
CHANGING = {
    "tracked_env/Torque-v0": ("alternating", "actuator-fault", "late-gains", "reversing-payload"),
    "tracked_env/Speed-v0": ("friction-step", "floor-mixed", "floor-outages-alternating"),
    "tracked_env/Terrain-v0": ("slope-payload", "slope-step-late", "slope-payload-outages"),
}  # fmt: skip
_FIXED = ("trust", "sensors", "reference", "duration", "lateral", "video", "paper", "shard",
          "all", "sets_version")  # fmt: skip


def both(entries: Sequence[PolicyEntry], config: BenchmarkConfig) -> list[PolicyEntry]:
    """Each policy and, of those that can keep what they know, the frozen one behind it."""
    context = config.context(config.sets[0])
    found = list[PolicyEntry]()
    for entry in entries:
        found.append(entry)
        if can_freeze(checked_policy(entry, context)):
            found.append(frozen(entry))
    return found


def write(folder: Path, store: Store, cells: list[list[str]], sets: Sequence[str],
          entries: Sequence[PolicyEntry], draw: bool) -> None:  # fmt: skip
    """adaptation.csv, adaptation.md and a figure of every set."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(cells)
    write_atomically(folder / "adaptation.csv", text.getvalue().encode())
    page = f"{markdown_rows(cells, 2)}\n\n{adaptation.LEGEND}\n"
    write_atomically(folder / "adaptation.md", page.encode())
    for name in sets if draw else ():
        traces: dict[str, list[dict[str, NDArray[Any]]]] = {}
        for entry in entries:
            kept = store.load_trace(entry.name, name)
            if kept is not None:
                traces.setdefault(agent_of(entry.name), []).append(kept)
        image = io.BytesIO()
        adaptation.figure(name, traces).savefig(image, format="png", bbox_inches="tight")
        write_atomically(folder / f"adaptation-{name}.png", image.getvalue())


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print the table, write it and the figures; returns the exit status."""
    parser = Parser(
        program,
        "Compare each policy with itself where it learns no more from the first abrupt "
        "change of an episode on, and with the best policy that reads the truth.",
    )
    add_options(parser, without=_FIXED)
    config = config_of(parser.parse_args(arguments))
    sets = config.sets or CHANGING[env_of(config.env, None)]
    env_of(config.env, sets)
    benchmark = BenchmarkConfig(sets, config.episodes_per_set, config.seed, chunk=config.chunk)
    policies = registered_policies()
    registry, trained = by_name(policies, benchmark.env)
    specs = config.policies or default_names(policies, benchmark.env)
    entries = both(load_policies(specs, registry, trained, open_archive), benchmark)
    executor = make_executor(config.workers, config.ray, None)
    store = Store(result_folder(config.output, benchmark), benchmark.identity())
    tasks = pending(benchmark, entries, store, executor.workers if executor else 1)
    steps = sum(len(t.episodes) * benchmark.max_steps(t.uncertainty_set) for t in tasks)
    with progress_bar(steps, config.quiet) as progress:
        records = run(benchmark, entries, store, progress, executor)
    rows = rows_of(records)
    found = {name: adaptation.scores(rows[name]) for name in benchmark.sets}
    cells = adaptation.table(found)
    write(store.folder, store, cells, benchmark.sets, entries, config.figures)
    if not config.quiet:
        width = shutil.get_terminal_size().columns
        print(f"\n{aligned(cells, 2, width)}\n\n{folded(adaptation.LEGEND, width)}\n")
    print(f"adaptation.csv, adaptation.md and figures in {store.folder}")
    return 0
