"""What adapting to a change inside an episode is worth, from paired episodes.

    python -m benchmarks.studies.adaptation [--env Speed-v0] [--policies ..] [--sets ..]

Every policy drives beside itself without learning from the first abrupt change of an episode on
(`frozen`). After that change, until the next one or the end:
    regret    RMSE of a policy minus that of the ceiling, the best policy that reads the truth [m]
    recovery  time [s] until the distance stays small
    worth     RMSE of the frozen policy over that of the same policy
Where a border is met depends on the driver, so each policy counts from its own crossing. An episode
that ends before the ceiling's change counts with the error at which it ended: to be lost early is
never better. Means and ratios are over episodes and, of agents, seeds, with intervals of
`statistics`. Up to the change the frozen policy drives as the other does, to the bit.
"""

import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies import Cells, policies_of, records_of, show, study_parser, write_csv
from tracked_env.benchmark import statistics
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policy_interface import (
    FROZEN_NAME,
    PolicyEntry,
    can_freeze,
    checked_policy,
    frozen,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Store
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.table_model import between
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import add_option, env_of

Floats = NDArray[np.float64]
# Sets with a change inside the episode, by environment.
CHANGING = {
    "tracked_env/Torque-v0": ("alternating", "actuator-fault", "late-gains", "reversing-payload"),
    "tracked_env/Speed-v0": ("friction-step", "floor-mixed", "floor-outages-alternating"),
    "tracked_env/Terrain-v0": ("slope-payload", "slope-step-late", "slope-payload-outages"),
}
LEGEND = (
    "After the first abrupt change of an episode, until the next one or the end. Regret: RMSE "
    "minus that of the best policy\nthat reads the truth. Recovery: time until the distance stays "
    "below 0.05 contact lengths. Worth: RMSE of the same policy\nthat learns no more from the "
    "change on, over its own; 1: learning on is worth nothing; '-': it cannot be held.\nMeans, "
    "with 95 % intervals over episodes and seeds."
)


class AdaptationScore(NamedTuple):
    """One agent on one set with abrupt changes."""

    episodes: int  # with a change, of one seed
    rmse: Estimate  # [m] after the change, mean
    regret: Estimate | None  # [m] None without a ceiling
    recovery: float  # [s] mean
    worth: Estimate | None  # [-] None of a policy without a frozen one


def after_change(row: Row, agent: str) -> Floats:
    """RMSE [m] after the change (S, N); an episode that ended early before any: its last error."""
    values = row.matrix(agent, "rmse_after_change")
    lost = np.isnan(values) & (row.matrix(agent, "terminated") > 0.5)
    return np.where(lost, row.matrix(agent, "max_error"), values)


def scores(row: Row) -> dict[str, AdaptationScore]:
    """By agent; those that are frozen are not listed by themselves. Empty without any change.

    An episode counts where the ceiling (without one, the first policy) meets a change and the agent
    meets one or is lost.
    """
    ceiling = row.ceiling()
    anchor = row.matrix(ceiling or row.names[0], "rmse_after_change")
    by_agent = {}
    for number, agent in enumerate(row.names):
        if agent.endswith(f" {FROZEN_NAME}"):
            continue
        values, twin = after_change(row, agent), f"{agent} {FROZEN_NAME}"
        counted = ~np.isnan(anchor).any(axis=0) & ~np.isnan(values).any(axis=0)
        stopped = after_change(row, twin) if twin in row.names else None
        if stopped is not None:
            counted &= ~np.isnan(stopped).any(axis=0)
        if not counted.any():
            continue
        draws, seeds = statistics.Redraws([int(counted.sum())]), len(values)

        def mean(rmse: Floats) -> tuple[statistics.Redrawn, Estimate]:
            of = statistics.redraw(rmse, draws, number)  # noqa: B023
            return of, statistics.estimate(float(rmse.mean()), of.mean, seeds)  # noqa: B023

        whole, rmse = mean(values[:, counted])
        regret = worth = None
        if ceiling is not None:
            _, regret = mean(values[:, counted] - anchor[:, counted].mean(axis=0))
        if stopped is not None:
            other, _ = mean(stopped[:, counted])  # the same episodes
            value = float(statistics.ratio(other.values.mean(), whole.values.mean()))
            worth = statistics.estimate(value, statistics.ratio(other.mean, whole.mean), seeds)
        recovery = float(np.nanmean(row.matrix(agent, "recovery_time")))
        by_agent[agent] = AdaptationScore(int(counted.sum()), rmse, regret, recovery, worth)
    return by_agent


def table(by_set: Mapping[str, Mapping[str, AdaptationScore]]) -> Cells:
    """One row per set and agent."""
    cells = [["set", "policy", "episodes", "RMSE after [m]", "regret [m]", "recovery [s]", "worth"]]
    for name, by_agent in by_set.items():
        for agent, of in by_agent.items():
            rmse, regret = (between(e) if e else "-" for e in (of.rmse, of.regret))
            worth = between(of.worth, 2) if of.worth else "-"
            cells.append([name, agent, f"{of.episodes}", rmse, regret, f"{of.recovery:.2f}", worth])
    return cells


def with_frozen(entries: Sequence[PolicyEntry], config: BenchmarkConfig) -> list[PolicyEntry]:
    """Each policy and, of those that can stop learning, the frozen one behind it."""
    context, pairs = config.context(config.sets[0]), list[PolicyEntry]()
    for entry in entries:
        stops = can_freeze(checked_policy(entry, context))
        pairs += [entry, frozen(entry)] if stops else [entry]
    return pairs


@reported
def main(arguments: Sequence[str], program: str) -> int:
    """Run what is missing, print and write the table and a figure of every set."""
    parser = study_parser(program, "Compare each policy with itself where it stops learning.", 100)
    add_option(parser, "sets", "by default those of the environment with a change inside")
    add_option(parser, "seed", "of the first episode")
    options = parser.parse_args(arguments)
    env = env_of(options.env, options.sets)
    config = BenchmarkConfig(tuple(options.sets or CHANGING[env]), options.episodes, options.seed)
    entries = with_frozen(policies_of(options, env), config)
    store = Store(result_folder(options.output, config), config.identity())
    rows = rows_of(records_of(config, entries, store, options.workers))
    cells = table({name: scores(rows[name]) for name in config.sets})
    write_csv(store.folder / "adaptation.csv", cells)
    show(cells, 2)
    print(f"{LEGEND}\n\nadaptation.csv in {store.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "adaptation"))
