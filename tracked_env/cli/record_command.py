"""`tracked-env record`: the log of one episode as CSV, as `tracked-env identify` reads it."""

import json
from collections.abc import Sequence
from pathlib import Path

from baselines.identify.csv_log import record_log
from tracked_env.benchmark.policies import by_name, load_policies, open_archive, registered_policies
from tracked_env.benchmark.policy_interface import checked_policy, needs_truth
from tracked_env.cli.evaluate_command import benchmark_config
from tracked_env.cli.evaluate_options import add_episode_options, config_of
from tracked_env.cli.exit_status import Parser, explained, reported


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Record a log; returns the exit status."""
    parser = Parser(
        program,
        "Drive one episode of an evaluation set and write what the sensors say as a "
        "CSV log with a row per control step, for `tracked-env identify`.",
    )
    parser.add_argument("policy", help="as in `tracked-env evaluate --policies`")
    parser.add_argument("--file", type=Path, default=Path("log.csv"), metavar="FILE",
                        help="(default: log.csv)")  # fmt: skip
    parser.add_argument("--truth", type=Path, metavar="FILE",
                        help="write the true values at the end as JSON too")  # fmt: skip
    add_episode_options(parser)
    given = parser.parse_args(arguments)
    benchmark = benchmark_config(config_of(given))
    name = benchmark.sets[0]
    registry, trained = by_name(registered_policies(), benchmark.env)
    entry = load_policies([given.policy], registry, trained, open_archive)[0]
    with explained():
        policy = checked_policy(entry, benchmark.context(name))
        if needs_truth(policy):
            raise ValueError(f"policy {entry.name!r} needs the truth; a log is driven without it")
        env = benchmark.environment(name, 1, truth=False)
        truth = record_log(env, policy, given.file, benchmark.seed)
    print(f"{entry.name}, set {name}, seed {benchmark.seed}: {given.file}")
    if given.truth is not None:
        given.truth.write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
        print(given.truth)
    return 0
