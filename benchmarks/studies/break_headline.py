"""Try to break the headline: is the reference tuned, or would one other gain beat the agents?

    python -m benchmarks.studies.break_headline       # controllers and shipped agents
    python -m benchmarks.studies.break_headline --policies integral adaptive ppo-blind --episodes 16

On the audit split of the seeds, on which nothing was chosen, every setting that a controller
declares (see `tracked_env.benchmark.tuning`) is multiplied by FACTORS, one at a time; 0 and
infinity cannot be scaled. Other trainings, fewer episodes and other statistics are those of
`tracked-env evaluate`: NAME@SEED, `--episodes`, and Kendall's tau below its leaderboard.

The headline stands if no single gain makes the reference (`adaptive`, `slc-adaptive`) more than
TOLERATED better, of whole episodes or after the start, without being worse in the other or losing a
set, which would be another compromise; exit status 1 if one does.
"""

import sys
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import AUDIT, default_sets
from tracked_env.benchmark.files import source_fingerprint
from tracked_env.benchmark.leaderboard import REFERENCES, RelativeError, relative
from tracked_env.benchmark.policies import registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry, agent_of
from tracked_env.benchmark.store import Record, Store, identity_hash
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.tuning import default_settings, tunable, varied
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_options import add_option, env_of

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
    scaled = []
    for name in controllers:
        factory = registry.get(name)
        if factory is None or not hasattr(factory, "TUNABLE"):
            continue
        source = source_fingerprint(factory.__module__)
        defaults = default_settings(tunable(name, factory), config.context(config.sets[0]))
        for setting, factor, settings in varied(defaults):
            value = {setting: settings[setting]}
            make, mark = partial(factory, **value), f"{source}:{settings[setting]:.12g}"
            entry = PolicyEntry(f"{name} {setting} x{factor:g}", make, mark)
            scaled.append(Variant(name, setting, factor, entry))
    return scaled


def ranking(sets: Mapping[str, Row], agents: Sequence[str], reference: str) -> dict[str, float]:
    """Geometric mean of the errors over the reference's, the best first."""
    values = {agent: relative(sets, agent, reference).whole.value for agent in agents}
    return dict(sorted(values.items(), key=lambda pair: pair[1]))


def gain_table(
    sets: Mapping[str, Row], scaled: Sequence[Variant], usual: Mapping[str, float], reference: str
) -> tuple[Cells, dict[Variant, RelativeError]]:
    """The table, and the errors of the variants over their controllers'."""
    head = "controller|setting|factor|error / default|after 5 s|loses"
    cells, errors = [[*head.split("|"), f"/ {reference}", "rank", "tau"]], {}
    for variant in scaled:
        name, controller = variant.entry.name, variant.controller
        error = errors[variant] = relative(sets, name, controller)
        value = relative(sets, name, reference).whole.value
        if controller == reference:  # then it is all others that change
            order = {a: v / error.whole.value for a, v in usual.items()} | {reference: 1.0}
        else:
            order = dict(usual) | {controller: value}
        rank = 1 + sum(other < order[controller] for other in order.values())
        row = [controller, variant.setting, f"{variant.factor:g}"]
        row += [f"{e.value:.3f} [{e.low:.3f}, {e.high:.3f}]" for e in (error.whole, error.settled)]
        row += [", ".join(error.lost) or "-", f"{value:.3f}", f"{rank}"]
        tau = stats.kendalls_tau([*usual.values()], [order[agent] for agent in usual])
        cells.append([*row, f"{tau:.2f}"])
    return cells, errors


def broken(errors: Mapping[Variant, RelativeError], reference: str) -> list[str]:
    """What breaks the headline, in words: settings that make the reference better, each alone."""
    lines = []
    for variant, error in errors.items():
        whole, settled = error.whole, error.settled
        for when, ratio, other in (("", whole, settled), (" after the start", settled, whole)):
            compromise = error.lost or other.value > 1.0 + ROUNDING
            if variant.controller == reference and not compromise and ratio.value < 1.0 - TOLERATED:
                lines.append(
                    f"{variant.setting} of {reference} times {variant.factor:g}: "
                    f"{100.0 * (1.0 - ratio.value):.1f} % better{when}; "
                    f"at most {100 * TOLERATED:g} % may be left"
                )
    return lines


def of_sets(records: Sequence[Record]) -> dict[str, Row]:
    """A Row of each set."""
    names = dict.fromkeys(record["set"] for record in records)
    return {name: row for name, row in rows_of(records).items() if name in names}


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing and print what changes; returns the exit status."""
    parser = study_parser(program, "Try to break the headline.", 32)
    add_option(parser, "sets", "by default those of the leaderboard")
    add_option(parser, "seed", "of the first one, at first that of the audit split", default=AUDIT)
    options = parser.parse_args(arguments)
    env = env_of(options.env, options.sets)
    config = BenchmarkConfig(options.sets or default_sets(env), options.episodes, options.seed)
    entries = policies_of(options, env)
    agents = list(dict.fromkeys(agent_of(entry.name) for entry in entries))
    reference = next((name for name in REFERENCES if name in agents), None)
    if reference is None:
        raise ValueError(f"policies = {agents}; must hold one of {REFERENCES}")
    scaled = variants({one.name: one.policy for one in registered_policies()}, agents, config)
    if all(variant.controller != reference for variant in scaled):
        raise ValueError(
            f"policy {reference!r} declares no setting that could be scaled, so nothing would "
            "be tried; it needs the attributes TUNABLE and SETTINGS"
        )
    identity = config.identity()
    store = Store(
        options.output / f"headline-{options.seed}-{identity_hash(identity)[:8]}", identity
    )
    every = [*entries, *(variant.entry for variant in scaled)]
    records = records_of(config, every, store, options.workers)
    sets = of_sets(records)
    usual = ranking(sets, agents, reference)
    cells, errors = gain_table(sets, scaled, usual, reference)
    print(f"\nEvery gain alone, {options.episodes} episodes of each set from seed {options.seed}")
    show(cells, 2)
    lines = broken(errors, reference) or [
        f"The headline stands: no single gain makes {reference} more than {100 * TOLERATED:g} % "
        "better, of whole episodes or after the start."
    ]
    print("\n".join(lines))
    return 1 if broken(errors, reference) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "break_headline"))
