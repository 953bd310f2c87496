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
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib
import numpy as np
from numpy.typing import NDArray

from benchmarks.studies import (
    Cells,
    driven,
    policies_of,
    show,
    study_parser,
    write_csv,
    write_figure,
)
from tracked_env.benchmark import statistics
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.figures import STYLE, looks, new_figure, plain_ticks
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.policy_interface import (
    FROZEN_NAME,
    PolicyEntry,
    agent_of,
    can_freeze,
    checked_policy,
    frozen,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Store
from tracked_env.benchmark.summary import Row, rows_of
from tracked_env.benchmark.table_model import markdown_rows
from tracked_env.cli.command_line import reported
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import add_option, env_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
Trace = Mapping[str, NDArray[Any]]
AROUND = (-1.0, 6.0)  # [s] of the change, what the figure shows
GRID = 141  # times in it
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
    found = {}
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
        draws = statistics.Redraws([int(counted.sum())])
        whole, seeds = statistics.redraw(values[:, counted], draws, number), len(values)
        regret = worth = None
        if ceiling is not None:
            gap = values[:, counted] - anchor[:, counted].mean(axis=0)
            apart = statistics.redraw(gap, draws, number)
            regret = statistics.estimate(float(gap.mean()), apart.mean, seeds)
        if stopped is not None:
            other = statistics.redraw(stopped[:, counted], draws, number)  # the same episodes
            value = float(statistics.ratio(other.values.mean(), whole.values.mean()))
            ratio = statistics.ratio(other.mean, whole.mean)
            worth = statistics.estimate(value, ratio, seeds)
        rmse = statistics.estimate(float(whole.values.mean()), whole.mean, seeds)
        recovery = float(np.nanmean(row.matrix(agent, "recovery_time")))
        found[agent] = AdaptationScore(int(counted.sum()), rmse, regret, recovery, worth)
    return found


def table(by_set: Mapping[str, Mapping[str, AdaptationScore]]) -> Cells:
    """One row per set and agent."""
    cells = [["set", "policy", "episodes", "RMSE after [m]", "regret [m]", "recovery [s]", "worth"]]

    def text(e: Estimate | None, digits: int) -> str:
        if e is None:
            return "-"
        return f"{e.value:.{digits}f} [{e.low:.{digits}f}, {e.high:.{digits}f}]"

    for name, by_agent in by_set.items():
        for agent, score in by_agent.items():
            errors = text(score.rmse, 3), text(score.regret, 3)
            numbers = [*errors, f"{score.recovery:.2f}", text(score.worth, 2)]
            cells.append([name, agent, f"{score.episodes}", *numbers])
    return cells


def aligned_errors(trace: Trace) -> Floats:
    """Errors [m] of a kept trace on the GRID times around the change: (episodes with one, GRID).

    NaN before the start and past the end.
    """
    grid, time, change = np.linspace(*AROUND, GRID), trace["time"], trace["change"]
    lines = [
        np.interp(change[k] + grid, time, trace["error"][:, k], left=np.nan, right=np.nan)
        for k in np.flatnonzero(np.isfinite(change))
    ]
    return np.array(lines, dtype=np.float64).reshape(len(lines), GRID)


def figure(name: str, traces: Mapping[str, Sequence[Trace]]) -> "Figure":
    """Median error around the change, a colour per agent, dashed where it learns no more.

    name: of the set. traces: of each agent, those of its seeds.
    """
    style = looks([agent for agent in traces if not agent.endswith(f" {FROZEN_NAME}")])
    grid = np.linspace(*AROUND, GRID)
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        drawn, panels = new_figure((6.5, 3.4))
        axes = panels[0, 0]
        for agent, parts in traces.items():
            errors = np.concatenate([aligned_errors(part) for part in parts])
            if not len(errors):
                continue
            look, stopped = style[agent.removesuffix(f" {FROZEN_NAME}")], agent not in style
            shown = np.isfinite(errors).mean(axis=0) > 0.5
            median = np.nanmedian(errors[:, shown], axis=0)
            (line,) = axes.plot(grid[shown], median, color=look.colour, label=agent, linewidth=1.3)
            if stopped:
                line.set_linestyle("--")
            else:
                line.set(marker=look.marker, markevery=20, markersize=4.0)
        axes.axvline(0.0, color="0.6", linewidth=1.0)
        axes.set_yscale("log")
        plain_ticks(axes.yaxis)
        axes.set_xlabel("time after the change [s]")
        axes.set_ylabel("median distance to the reference [m]")
        axes.set_title(f"Errors aligned at the first change: {name}", loc="left")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return drawn


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
    rows = rows_of(driven(config, entries, store, options.workers))
    cells = table({name: scores(rows[name]) for name in config.sets})
    write_csv(store.folder / "adaptation.csv", cells)
    page = f"{markdown_rows(cells, 2)}\n\n{LEGEND}\n"
    write_atomically(store.folder / "adaptation.md", page.encode())
    for name in config.sets:
        traces: dict[str, list[Trace]] = {}
        for entry in entries:
            if (trace := store.load_trace(entry.name, name)) is not None:
                traces.setdefault(agent_of(entry.name), []).append(trace)
        write_figure(store.folder / f"adaptation-{name}.png", figure(name, traces))
    show(cells, 2)
    print(f"{LEGEND}\n\nadaptation.csv, adaptation.md and figures in {store.folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "adaptation"))
