"""`tracked-env breaking-points`: how much of each difficulty every policy stands."""

import argparse
import csv
import io
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tracked_env import SPEED_ID, TORQUE_ID
from tracked_env.benchmark import breaking_points as breaking
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.policy_lookup import load_policies
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.registered_policies import (
    by_name,
    default_names,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store, identity_hash, write_atomically
from tracked_env.benchmark.summary import agent_of
from tracked_env.benchmark.text_tables import aligned
from tracked_env.cli.choose_command import few_seeds, seed_count
from tracked_env.cli.evaluate_options import JoinedNames, add_env, add_option, names
from tracked_env.cli.exit_status import Parser, reported
from tracked_env.uncertainty.law import fingerprint
from tracked_env.validation import checked_choice


def _options(arguments: Sequence[str], program: str) -> argparse.Namespace:
    parser = Parser(
        program,
        "Find, for each policy and difficulty, the level at which half of the episodes "
        "fail, on the same episodes. What was run is kept, and only what is missing is run.",
    )
    add_env(parser, (TORQUE_ID, SPEED_ID), text="environment id", default=TORQUE_ID)
    add_option(
        parser, "policies", "as in `tracked-env evaluate`; by default all that are registered"
    )
    parser.add_argument("--axes", nargs="+", type=names, action=JoinedNames, metavar="AXIS",
                        help=f"of {', '.join(breaking.AXES)}; by default all")  # fmt: skip
    add_option(parser, "episodes", "of a level", default=32)
    add_option(parser, "seed", "of the first episode")
    parser.add_argument("--seeds", type=seed_count, default=1, metavar="N",
                        help="trainings of an agent, at most (default: 1)")  # fmt: skip
    add_option(parser, "output", "folder of the results")
    return parser.parse_args(arguments)


def find(
    given: argparse.Namespace, entries: Sequence[PolicyEntry], axes: Sequence[str]
) -> tuple[Store, list[breaking.Point]]:
    """The points, and where their episodes are kept. Raises ValueError, PolicyError, OSError."""

    def config_of(axis: str, level: float) -> BenchmarkConfig:
        name = breaking.set_of(given.env, axis, level)
        return BenchmarkConfig((name,), given.episodes, given.seed)

    first = config_of(axes[0], breaking.AXES[axes[0]].easy)
    identity = {k: v for k, v in first.identity().items() if k != "own_sets"}
    identity["breaking_points"] = fingerprint(breaking.Scaled())
    track = given.env.rpartition("/")[2].lower()
    folder = (
        given.output / f"breaking-points-{track}-seed{given.seed}-{identity_hash(identity)[:8]}"
    )
    store, points = Store(folder, identity), list[breaking.Point]()
    by_agent: dict[str, list[PolicyEntry]] = {}
    for entry in entries:
        by_agent.setdefault(agent_of(entry.name), []).append(entry)
    levels = len(axes) * len(entries) * (breaking.BISECTIONS + 2)
    steps = given.episodes * first.max_steps(first.sets[0])
    with progress_bar(levels * steps) as progress:
        for axis in axes:
            for agent, trainings in by_agent.items():
                done = 0

                def success(level: float) -> float:
                    nonlocal done
                    done += 1
                    records = run(config_of(axis, level), trainings, store)  # noqa: B023
                    progress(steps * len(trainings), f"{axis}: {agent}")  # noqa: B023
                    return float(np.mean([record["success"] for record in records]))

                *_, point = breaking.bisect(axis, agent, given.episodes, success)
                points.append(point)
                rest = breaking.BISECTIONS + 2 - done  # levels that need not be run
                progress(rest * steps * len(trainings), f"{axis}: {agent}")
    return store, points


def write(folder: Path, env: str, points: Sequence[breaking.Point]) -> None:
    """breaking_points.csv and, with matplotlib, breaking_points.png."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((*breaking.Point._fields, "trained_low", "trained_high"))
    for point in points:
        writer.writerow((*point, *breaking.AXES[point.axis].trained[env]))
    write_atomically(folder / "breaking_points.csv", text.getvalue().encode())
    try:
        drawn, image = breaking.figure(env, points), io.BytesIO()
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        return
    drawn.savefig(image, format="png", bbox_inches="tight")
    write_atomically(folder / "breaking_points.png", image.getvalue())


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Find the points, print and write them; returns the exit status."""
    given = _options(arguments, program)
    axes = given.axes or list(breaking.AXES)
    for axis in axes:
        checked_choice("axis", axis, breaking.AXES)
    policies = registered_policies()
    registry, trained = by_name(policies, given.env)
    specs = given.policies or default_names(policies, given.env)
    entries = few_seeds(load_policies(specs, registry, trained, open_archive), given.seeds)
    store, points = find(given, entries, axes)
    write(store.folder, given.env, points)
    print(f"\n{aligned(breaking.table(points), 1, shutil.get_terminal_size().columns)}\n")
    print(
        f"Half or more of {given.episodes} episodes succeed at the first number, fewer at the "
        f"second.\nbreaking_points.csv and breaking_points.png in {store.folder}"
    )
    return 0
