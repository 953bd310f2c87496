"""Try to break the headline: do settings that are chosen from outside beat those of a controller?

    python -m benchmarks.studies.break_headline                  # controllers and shipped agents
    python -m benchmarks.studies.break_headline --policies adaptive mpc-adaptive l1 --budget 60

All settings that a controller declares are searched together (`tracked_env.benchmark.tuning`), on
episodes of the audit split on which nothing was chosen, from `--seed` on. What is best there over
whole episodes, after the start, and by the objective of the search, at no more than RATE of the
action rate of the default, is then driven on other episodes, from CONFIRMED seeds further on.
Other trainings, fewer episodes and other statistics are those of `tracked-env evaluate`.

The headline stands if there none of them is more than TOLERATED better than the default, of whole
episodes or after the start, without losing a set or acting faster; exit status 1 if one is.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import AUDIT, default_sets
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.leaderboard import REFERENCES, RelativeError, relative
from tracked_env.benchmark.metrics import ACTION_RATES
from tracked_env.benchmark.policies import registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry, agent_of
from tracked_env.benchmark.runner import progress_bar
from tracked_env.benchmark.store import Record, Store, identity_hash
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.tuning import RATE_LIMIT, Candidate, Search, searched, tunable
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_options import add_option, env_of

TOLERATED = 0.03  # [-] that settings from outside may be better
RATE = RATE_LIMIT  # [-] of the action rate of the default
CONFIRMED = 3000  # [-] seeds from those on which settings are chosen to those that confirm


class Challenger(NamedTuple):
    """Settings of a controller that were best where they were chosen."""

    controller: str
    best: str  # of what
    settings: Mapping[str, float]
    entry: PolicyEntry


class Result(NamedTuple):
    """A challenger where it is confirmed, over its controller with the default settings."""

    challenger: Challenger
    error: RelativeError
    rate: float  # [-] action rate


def best_of(candidates: Sequence[Candidate]) -> dict[str, Candidate]:
    """The best by each measure that may act as fast as they do; none where it is the default."""
    default = candidates[0]
    allowed = [one for one in candidates if one.mean("rate") <= one.rate_limit]
    measures: dict[str, Any] = {
        "whole episodes": lambda one: (one.mean("lost") > default.mean("lost"), one.mean("rmse")),
        "after 5 s": lambda one: (one.mean("lost") > default.mean("lost"), one.mean("settled")),
        "objective": lambda one: one.cost,
    }
    picked: dict[str, Candidate] = {}
    for name, measure in measures.items():
        best = min(allowed, key=measure)
        if best.settings not in [default.settings, *(each.settings for each in picked.values())]:
            picked[name] = best
    return picked


def challengers(
    name: str, factory: Any, sets: tuple[str, ...], options: Any, folder: Path
) -> list[Challenger]:
    """Search the settings of one controller; what was driven before is not driven again."""
    policy, found = tunable(name, factory), list[Challenger]()
    search = Search(policy, sets, options.episodes, folder, seed=options.seed, rate_limit=RATE)
    with progress_bar(options.budget * search.max_steps * options.episodes) as progress:
        search.progress = progress
        ranges, default = policy.ranges, search.default
        candidates = list(searched(ranges, default, options.budget, search.evaluate))
    source = source_fingerprint(factory.__module__)
    for what, one in best_of(candidates).items():
        mark = f"{source}:{sorted(one.settings.items())}"
        entry = PolicyEntry(f"{name}, best {what}", partial(factory, **one.settings), mark)
        found.append(Challenger(name, what, one.settings, entry))
    return found


def ranking(sets: Mapping[str, Row], agents: Sequence[str], reference: str) -> dict[str, float]:
    """Geometric mean of the errors over the reference's, the best first."""
    values = {agent: relative(sets, agent, reference).whole.value for agent in agents}
    return dict(sorted(values.items(), key=lambda pair: pair[1]))


def _rate(sets: Mapping[str, Row], name: str) -> float:
    """Mean action rate over all sets."""
    rates = [of for r in sets.values() for of in r.pooled(name)]
    metric = next(key for key in ACTION_RATES.values() if rates[0][key] is not None)
    return float(sum(record[metric] for record in rates) / len(rates))


def result_table(
    sets: Mapping[str, Row],
    driven: Sequence[Challenger],
    usual: Mapping[str, float],
    reference: str,
) -> tuple[Cells, list[Result]]:
    """The table, and what is in it."""
    head = "controller|best|settings|error / default|after 5 s|action rate|loses"
    cells, results = [[*head.split("|"), f"/ {reference}", "rank"]], list[Result]()
    for one in driven:
        error = relative(sets, one.entry.name, one.controller)
        rate = _rate(sets, one.entry.name) / _rate(sets, one.controller)
        results.append(Result(one, error, rate))
        value = relative(sets, one.entry.name, reference).whole.value
        others = [v for agent, v in usual.items() if agent != one.controller]
        settings = ", ".join(f"{name} {value:.3g}" for name, value in one.settings.items())
        cells.append([
            one.controller, one.best, settings,
            *(f"{e.value:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in (error.whole, error.settled)),
            f"{rate:.2f}", ", ".join(error.lost) or "-", f"{value:.3f}",
            f"{1 + sum(other < value for other in others)}",
        ])  # fmt: skip
    return cells, results


def broken(results: Sequence[Result]) -> list[str]:
    """What breaks the headline, in words."""
    lines = []
    for one, error, rate in results:
        for when, ratio in (("", error.whole), (" after the start", error.settled)):
            if not error.lost and rate <= RATE and ratio.value < 1.0 - TOLERATED:
                lines.append(
                    f"{one.entry.name}: {100.0 * (1.0 - ratio.value):.1f} % better{when} at "
                    f"{rate:.2f} of the action rate; at most {100 * TOLERATED:g} % may be left"
                )
    return lines


def of_sets(records: Sequence[Record]) -> dict[str, Row]:
    """A Row of each set."""
    names = dict.fromkeys(record["set"] for record in records)
    return {name: row for name, row in rows_of(records).items() if name in names}


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Search, drive what is missing and print what changes; returns the exit status."""
    parser = study_parser(program, "Try to break the headline.", 32)
    add_option(parser, "sets", "by default those of the leaderboard")
    add_option(parser, "seed", "on which settings are chosen", default=AUDIT)
    text = "settings of each controller that are tried (default: 60)"
    parser.add_argument("--budget", type=int, default=60, metavar="N", help=text)
    text = "episodes that confirm (default: as many as choose)"
    parser.add_argument("--confirm", type=int, metavar="N", help=text)
    options = parser.parse_args(arguments)
    env = env_of(options.env, options.sets)
    sets = tuple(options.sets or default_sets(env))
    confirmed = options.episodes if options.confirm is None else options.confirm
    config = BenchmarkConfig(sets, confirmed, options.seed + CONFIRMED)
    entries = policies_of(options, env)
    agents = list(dict.fromkeys(agent_of(entry.name) for entry in entries))
    reference = next((name for name in REFERENCES if name in agents), agents[0])
    registry = {one.name: one.policy for one in registered_policies()}
    tuned = [name for name in agents if hasattr(registry.get(name), "TUNABLE")]
    identity = config.identity()
    folder = options.output / f"headline-{options.seed}-{identity_hash(identity)[:8]}"
    driven = [
        one for n in tuned for one in challengers(n, registry[n], sets, options, folder / "chosen")
    ]
    every = [*entries, *(one.entry for one in driven)]
    records = records_of(config, every, Store(folder, identity), options.workers)
    rows = of_sets(records)
    cells, results = result_table(rows, driven, ranking(rows, agents, reference), reference)
    print(f"\nSettings chosen from seed {options.seed}, driven from seed {config.seed} on")
    show(cells, 2)
    lines = broken(results)
    stands = (
        f"The headline stands: of {options.budget} settings each of {', '.join(tuned)}, none is "
        f"more than {100 * TOLERATED:g} % better, of whole episodes or after the start."
    )
    print("\n".join(lines or [stands]))
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "break_headline"))
