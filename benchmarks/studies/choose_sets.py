"""`tracked-env choose-sets`: what every candidate set separates, on the development split.

Run it again with other policies: what was run is kept, and only what is missing is run.
"""

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from tracked_env.benchmark import choice_of_sets as choosing
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT, SETS, Version, names_of, version_of
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.files import replace_block
from tracked_env.benchmark.policies import (
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store, identity_hash, write_atomically
from tracked_env.benchmark.summary import agent_of, rows_of
from tracked_env.benchmark.text_tables import aligned, markdown_rows
from tracked_env.cli.evaluate_options import add_env, add_option, env_of
from tracked_env.cli.exit_status import Parser, reported

_KNOWN = ("nominal", "floor", "level")  # nothing is unknown there: no candidates


def seed_count(text: str) -> int:
    """How many trainings of each agent are run, of an argument."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(
            f"{text}; must be a whole number, at least 1: of the trainings of each agent"
        )
    return int(text)


def _options(arguments: Sequence[str], program: str) -> argparse.Namespace:
    parser = Parser(
        program,
        "Print what every candidate for the evaluation sets separates: policies with "
        "memory from blind ones, adaptive controllers from others; and which candidates rank the "
        "policies alike. Episodes are those of the development split.",
    )
    add_env(parser)
    add_option(
        parser, "policies", "as in `tracked-env evaluate`; by default all that are registered"
    )
    add_option(parser, "sets", "candidates; by default all sets of the environment")
    parser.add_argument("--sets-version", metavar="VERSION",
                        help="whose choice is judged, such as torque-unlike-v1 (default: newest of "
                        "the environment)")  # fmt: skip
    add_option(parser, "episodes", "per set", default=24)
    parser.add_argument("--seeds", type=seed_count, default=1, metavar="N",
                        help="of every agent, at most (default: 1)")  # fmt: skip
    add_option(parser, "output", "folder of the results")
    add_option(parser, "workers")
    parser.add_argument("--page", type=Path, metavar="FILE",
                        help="page whose block of this environment, or of the version that is "
                        "named, is renewed")  # fmt: skip
    return parser.parse_args(arguments)


def candidates(env: str, version: Version | None) -> tuple[str, ...]:
    """Every set of an environment id in which something is unknown, those of the version first."""
    chosen = () if version is None else names_of(version)
    known = [name for name, each in SETS.items() if each.env == env and name not in _KNOWN]
    return tuple(dict.fromkeys((*chosen, *known)))


def few_seeds(entries: Sequence[PolicyEntry], most: int) -> list[PolicyEntry]:
    """The policies, of every agent its first seeds."""
    kept = list[PolicyEntry]()
    for entry in entries:
        if sum(agent_of(one.name) == agent_of(entry.name) for one in kept) < most:
            kept.append(entry)
    return kept


def page_of(found: choosing.Choice, conditions: str) -> str:
    """The tables as Markdown."""
    parts = [
        markdown_rows(choosing.table(found)),
        "Rank correlations of the chosen sets:",
        markdown_rows(choosing.correlation_table(found), 1),
        "\n".join(f"- {line}" for line in choosing.verdict(found).split("\n")),
        conditions,
    ]
    return "\n\n".join(parts)


def _choose(options: argparse.Namespace) -> None:
    env = env_of(options.env, options.sets)
    version = version_of(env, (), options.sets_version)
    block = f"choice for {options.sets_version or env.partition('/')[2]}"
    if options.page is not None and not options.page.is_file():
        raise ValueError(
            f"--page {options.page}: no such file; must be a page with the block `{block}`"
        )
    config = BenchmarkConfig(
        sets=tuple(options.sets or candidates(env, version)),
        episodes=options.episodes,
        seed=DEVELOPMENT,
    )
    policies = registered_policies()
    registry, trained = by_name(policies, config.env)
    specs = options.policies or default_names(policies, config.env)
    entries = few_seeds(load_policies(specs, registry, trained, open_archive), options.seeds)
    folder = options.output / f"choice-{config.env.partition('/')[2].lower()}"
    store = Store(folder / identity_hash(config.identity())[:8], config.identity())
    executor = make_executor(options.workers, None, None)
    steps = sum(config.max_steps(name) for name in config.sets) * config.episodes * len(entries)
    with progress_bar(steps) as progress:
        records = run(config, entries, store, progress, executor)
    found = choosing.choice(rows_of(records), version)
    conditions = (
        f"{config.episodes} episodes of each set, from seed {config.seed} on (development split), "
        f"{len(entries)} policies; source {config.identity()['source']}."
    )
    width = shutil.get_terminal_size().columns
    print(f"\n{aligned(choosing.table(found), width=width)}\n\n{choosing.EXPLANATION}\n")
    print(f"{aligned(choosing.correlation_table(found), 1, width)}\n")
    print(f"{choosing.verdict(found)}\n\n{conditions}")
    values = {each.name: each.iqm for each in found.sets}
    write_atomically(store.folder / "choice.json", json.dumps(values, indent=1).encode())
    if options.page is not None:
        replace_block(options.page, block, page_of(found, conditions))


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run the command; returns the exit status."""
    options = _options(arguments, program)
    _choose(options)
    return 0
