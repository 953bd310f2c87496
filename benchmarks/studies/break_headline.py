"""Try to break the headline: what changes the ranking, and by how much?

    python benchmarks/studies/break_headline.py                            # controllers and shipped agents
    python benchmarks/studies/break_headline.py --policies integral adaptive ppo-blind oracle --episodes 16

On the audit split of the seeds, on which nothing was chosen, everything that an author could have
chosen well is chosen otherwise, one thing at a time:
    gains      every setting that a controller declares (see `tracked_env.benchmark.tuning`) times
               FACTORS; 0 and infinity cannot be scaled
    seeds      one training of each agent instead of all
    budget     half, a quarter and an eighth of the episodes
    statistic  the order by another one (see `relative_errors`)
The headline stands if no single gain makes the reference (`adaptive`, `slc-adaptive`) more than
TOLERATED better, of whole episodes or after the start, without being worse in the other or losing a
set, which would be another compromise; exit status 1 if one does. What was driven is kept under
results/, and run again only what is missing.
"""

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import AUDIT, default_sets
from tracked_env.benchmark.leaderboard import REFERENCES
from tracked_env.benchmark.policies import (
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import PolicyEntry, PolicyError, source_fingerprint
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.relative_errors import RelativeError, agreement, relative
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Record, Store, identity_hash
from tracked_env.benchmark.summary import Row, agent_of, rows_of
from tracked_env.benchmark.text_tables import aligned
from tracked_env.benchmark.tuning import default_settings, tunable
from tracked_env.cli.evaluate_options import add_env, add_option, env_of
from tracked_env.cli.exit_status import Parser

FACTORS = (0.5, 0.7, 1.4, 2.0)
TOLERATED = 0.05  # [-] that one gain may make the reference better
ROUNDING = 1e-9  # [-] of two errors that are the same


class Variant(NamedTuple):
    """A controller with one setting scaled."""

    controller: str
    setting: str
    factor: float
    entry: PolicyEntry


def variants(
    registry: Mapping[str, Any], controllers: Sequence[str], config: BenchmarkConfig
) -> list[Variant]:
    """Every setting of every controller that declares any, times FACTORS."""
    found = []
    for name in controllers:
        factory = registry.get(name)
        if factory is None or not hasattr(factory, "TUNABLE"):
            continue
        settings = default_settings(tunable(name, factory), config.context(config.sets[0]))
        for setting, value in settings.items():
            for factor in FACTORS if value not in (0.0, math.inf) else ():
                scaled = f"{name} {setting} x{factor:g}"
                make = partial(factory, **{setting: factor * value})
                mark = f"{source_fingerprint(factory.__module__)}:{factor * value:.12g}"
                found.append(Variant(name, setting, factor, PolicyEntry(scaled, make, mark)))
    return found


def ranking(sets: Mapping[str, Row], agents: Sequence[str], reference: str) -> dict[str, float]:
    """Geometric mean of the errors over the reference's, the best first."""
    values = {agent: relative(sets, agent, reference).whole.value for agent in agents}
    return dict(sorted(values.items(), key=lambda pair: pair[1]))


def tau(first: Mapping[str, float], second: Mapping[str, float]) -> float:
    """Kendall's tau of two rankings of the same agents."""
    return stats.kendalls_tau(list(first.values()), [second[agent] for agent in first])


def gain_table(
    sets: Mapping[str, Row], found: Sequence[Variant], usual: Mapping[str, float], reference: str
) -> tuple[list[list[str]], dict[Variant, RelativeError]]:
    """Rows of cells, the header first, and the errors of the variants over their controllers'."""
    cells = [["controller", "setting", "factor", "error / default", "after 5 s", "loses",
              f"/ {reference}", "rank", "tau"]]  # fmt: skip
    errors = {}
    for variant in found:
        own = relative(sets, variant.entry.name, variant.controller)
        value = relative(sets, variant.entry.name, reference).whole.value
        if variant.controller == reference:  # then it is all others that change
            order = {a: v / own.whole.value for a, v in usual.items()} | {reference: 1.0}
        else:
            order = dict(usual) | {variant.controller: value}
        rank = 1 + sum(other < order[variant.controller] for other in order.values())
        errors[variant] = own
        cells.append(
            [variant.controller, variant.setting, f"{variant.factor:g}",
             *(f"{e.value:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in (own.whole, own.settled)),
             ", ".join(own.lost) or "-", f"{value:.3f}", f"{rank}", f"{tau(usual, order):.2f}"]
        )  # fmt: skip
    return cells, errors


def broken(errors: Mapping[Variant, RelativeError], reference: str) -> list[str]:
    """What breaks the headline, in words: settings that make the reference better, each alone."""
    said = []
    for variant, error in errors.items():
        whole, settled = error.whole, error.settled
        for what, ratio, other in (("", whole, settled), (" after the start", settled, whole)):
            compromise = error.lost or other.value > 1.0 + ROUNDING
            if variant.controller != reference or compromise:
                continue
            if ratio.value < 1.0 - TOLERATED:
                better = 100.0 * (1.0 - ratio.value)
                said.append(
                    f"{variant.setting} of {reference} times {variant.factor:g}: {better:.1f} % "
                    f"better{what}; at most {100 * TOLERATED:g} % may be left"
                )
    return said


def other_choices(
    records: Sequence[Record], usual: Mapping[str, float], reference: str
) -> list[list[str]]:
    """Rows of cells, the header first: the order with other seeds and fewer episodes."""
    cells = [["choice", "tau", "the best", f"rank of {reference}", "order"]]

    def add(label: str, chosen: Sequence[Record]) -> None:
        order = ranking(of_sets(chosen), list(usual), reference)
        place = 1 + list(order).index(reference)
        cells.append([label, f"{tau(usual, order):.2f}", next(iter(order)), f"{place}",
                      ", ".join(order)])  # fmt: skip

    add("as it is", records)
    trainings: dict[str, list[str]] = {}
    for policy in dict.fromkeys(record["policy"] for record in records):
        trainings.setdefault(agent_of(policy), []).append(policy)
    for number in range(max(map(len, trainings.values()))):
        chosen = {policies[number % len(policies)] for policies in trainings.values()}
        if len(chosen) < sum(map(len, trainings.values())):
            add(f"training {number} alone", [r for r in records if r["policy"] in chosen])
    most = 1 + max(record["episode"] for record in records)
    for count in (most // 2, most // 4, most // 8):
        if count > 0:
            add(f"first {count} episodes", [r for r in records if r["episode"] < count])
    return cells


def of_sets(records: Sequence[Record]) -> dict[str, Row]:
    """A Row of each set."""
    names_of_sets = dict.fromkeys(record["set"] for record in records)
    return {name: row for name, row in rows_of(records).items() if name in names_of_sets}


def _options() -> argparse.Namespace:
    parser = Parser("break_headline.py", __doc__.split("\n")[0])
    add_env(parser)
    add_option(parser, "policies", "by default all that are registered")
    add_option(parser, "sets", "by default those of the leaderboard")
    add_option(parser, "episodes", "of a set", default=32)
    add_option(parser, "seed", "of the first one, at first that of the audit split", default=AUDIT)
    add_option(parser, "output", "folder of the results")
    return parser.parse_args()


def main() -> int:
    """Run what is missing and print what changes; returns the exit status."""
    given = _options()
    try:
        env = env_of(given.env, given.sets)
        chosen = given.sets or default_sets(env)
        config = BenchmarkConfig(chosen, given.episodes, given.seed)
        policies = registered_policies()
        registry, trained = by_name(policies, env)
        specs = given.policies or default_names(policies, env)
        entries = load_policies(specs, registry, trained, open_archive)
        agents = list(dict.fromkeys(agent_of(entry.name) for entry in entries))
        reference = next((name for name in REFERENCES if name in agents), None)
        if reference is None:
            raise ValueError(f"policies = {agents}; must hold one of {REFERENCES}")
        found = variants({one.name: one.found for one in policies}, agents, config)
        if all(variant.controller != reference for variant in found):
            raise ValueError(
                f"policy {reference!r} declares no setting that could be scaled, so nothing would "
                "be tried; it needs the attributes TUNABLE and SETTINGS"
            )
        identity = config.identity()
        folder = given.output / f"headline-{given.seed}-{identity_hash(identity)[:8]}"
        store = Store(folder, identity)
        driven = [*entries, *(variant.entry for variant in found)]
        steps = sum(config.max_steps(name) for name in chosen) * given.episodes * len(driven)
        with progress_bar(steps) as progress:
            records = run(config, driven, store, progress)
    except (ValueError, PolicyError, OSError) as error:
        print(f"break_headline: {error}", file=sys.stderr)
        return 2
    varied = {variant.entry.name for variant in found}
    usual_records = [record for record in records if record["policy"] not in varied]
    sets = of_sets(records)
    usual = ranking(sets, agents, reference)
    cells, errors = gain_table(sets, found, usual, reference)
    print(f"\nEvery gain alone, {given.episodes} episodes of each set from seed {given.seed}\n")
    print(aligned(cells, 2))
    print("\nOther trainings, fewer episodes\n")
    print(aligned(other_choices(usual_records, usual, reference), 1))
    by = ", ".join(f"{name} {value:.2f}" for name, value in agreement(sets, usual).items())
    print(f"\nKendall's tau of the order and that by another statistic: {by}\n")
    said = broken(errors, reference)
    print("\n".join(said) or f"The headline stands: no single gain makes {reference} more than "
          f"{100 * TOLERATED:g} % better, of whole episodes or after the start.")  # fmt: skip
    return 1 if said else 0


if __name__ == "__main__":
    sys.exit(main())
