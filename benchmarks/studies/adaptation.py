"""What adapting to a change inside an episode is worth, from paired episodes.

After the first abrupt change of an episode (see `changes`), until the next one or the end:
    regret    RMSE of a policy minus that of the ceiling, the best policy that reads the truth [m]
    recovery  time [s] until the distance stays small
    worth     RMSE of the same policy that learns no more from the change on (`frozen`) over its own
Where a border is met depends on the driver, so each policy counts from its own crossing. An episode
that ends before the ceiling's change counts with the error at which it ended: to be lost early is
never better. Means and ratios are over episodes and, of agents, seeds, with intervals of
`reliability`. Up to the change the frozen policy drives as the other does, to the bit.

`tracked-env adaptation`: every policy beside itself without learning from the change on.
"""

import csv
import io
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import reliability as rel
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import make_executor
from tracked_env.benchmark.figures import STYLE, looks, new_figure, plain_ticks
from tracked_env.benchmark.policies import (
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import (
    FROZEN_NAME,
    PolicyEntry,
    can_freeze,
    checked_policy,
    frozen,
)
from tracked_env.benchmark.progress_bar import progress_bar
from tracked_env.benchmark.runner import pending, run
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import Store, write_atomically
from tracked_env.benchmark.summary import Row, agent_of, rows_of
from tracked_env.benchmark.text_tables import aligned, folded, markdown_rows
from tracked_env.cli.evaluate_command import result_folder
from tracked_env.cli.evaluate_options import add_options, config_of, env_of
from tracked_env.cli.exit_status import Parser, reported

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
AROUND = (-1.0, 6.0)  # [s] of the change, what the figure shows
GRID = 141  # times in it


class AdaptationScore(NamedTuple):
    """One agent on one set with abrupt changes."""

    episodes: int  # with a change, of one seed
    rmse: Estimate  # [m] after the change, mean
    regret: Estimate | None  # [m] None without a ceiling
    recovery: float  # [s] mean
    worth: Estimate | None  # [-] None of a policy without a frozen one


def frozen_of(agent: str) -> str:
    """The name of an agent that learns no more after a change."""
    return f"{agent} {FROZEN_NAME}"


def after_change(row: Row, agent: str) -> FloatArray:
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
        values = after_change(row, agent)
        stopped = after_change(row, twin) if (twin := frozen_of(agent)) in row.names else None
        known = ~np.isnan(anchor).any(axis=0) & ~np.isnan(values).any(axis=0)
        if stopped is not None:
            known &= ~np.isnan(stopped).any(axis=0)
        if not known.any():
            continue
        draws = rel.Redraws([int(known.sum())])
        own, seeds = rel.redraw(values[:, known], draws, number), len(values)
        regret = worth = None
        if ceiling is not None:
            gap = rel.redraw(values[:, known] - anchor[:, known].mean(axis=0), draws, number)
            regret = rel.estimate(float(gap.values.mean()), gap.mean, seeds)
        if stopped is not None:
            other = rel.redraw(stopped[:, known], draws, number)  # the same seeds and episodes
            value = float(rel.ratio(other.values.mean(), own.values.mean()))
            worth = rel.estimate(value, rel.ratio(other.mean, own.mean), seeds)
        found[agent] = AdaptationScore(
            int(known.sum()),
            rel.estimate(float(own.values.mean()), own.mean, seeds),
            regret,
            float(np.nanmean(row.matrix(agent, "recovery_time"))),
            worth,
        )
    return found


def table(found: Mapping[str, Mapping[str, AdaptationScore]]) -> list[list[str]]:
    """Rows of cells, the header first: one row per set and agent; found: by set."""
    cells = [["set", "policy", "episodes", "RMSE after [m]", "regret [m]", "recovery [s]", "worth"]]

    def text(e: Estimate | None, digits: int) -> str:
        if e is None:
            return "-"
        return f"{e.value:.{digits}f} [{e.low:.{digits}f}, {e.high:.{digits}f}]"

    for name, by_agent in found.items():
        for agent, of in by_agent.items():
            cells.append(
                [name, agent, f"{of.episodes}", text(of.rmse, 3), text(of.regret, 3),
                 f"{of.recovery:.2f}", text(of.worth, 2)]
            )  # fmt: skip
    return cells


LEGEND = (
    "After the first abrupt change of an episode, until the next one or the end. Regret: RMSE "
    "minus that of the best policy\nthat reads the truth. Recovery: time until the distance stays "
    "below 0.05 contact lengths. Worth: RMSE of the same policy\nthat learns no more from the "
    "change on, over its own; 1: learning on is worth nothing; '-': it cannot be held.\nMeans, "
    "with 95 % intervals over episodes and seeds."
)


def aligned_errors(trace: Mapping[str, NDArray[Any]]) -> FloatArray:
    """Errors [m] of a kept trace on the GRID times around the change: (episodes with one, GRID).

    NaN before the start and past the end.
    """
    grid, time = np.linspace(*AROUND, GRID), trace["time"]
    changed = np.flatnonzero(np.isfinite(trace["change"]))
    lines = [
        np.interp(trace["change"][k] + grid, time, trace["error"][:, k], left=np.nan, right=np.nan)
        for k in changed
    ]
    return np.array(lines, dtype=np.float64).reshape(len(lines), GRID)


def figure(name: str, traces: Mapping[str, Sequence[Mapping[str, NDArray[Any]]]]) -> "Figure":
    """Median error around the change, a colour per agent, dashed where it learns no more.

    name: of the set. traces: of each agent, those of its seeds.
    """
    import matplotlib

    agents = [agent for agent in traces if not agent.endswith(f" {FROZEN_NAME}")]
    style, grid = looks(agents), np.linspace(*AROUND, GRID)
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        drawn, axes = new_figure((6.5, 3.4))
        for agent, parts in traces.items():
            errors = np.concatenate([aligned_errors(part) for part in parts])
            if not len(errors):
                continue
            stopped = agent.endswith(f" {FROZEN_NAME}")
            look = style[agent.removesuffix(f" {FROZEN_NAME}")]
            known = np.isfinite(errors).mean(axis=0) > 0.5
            median = np.nanmedian(errors[:, known], axis=0)
            axes[0, 0].plot(
                grid[known], median, "--" if stopped else "-", color=look.colour, label=agent,
                linewidth=1.3, marker=None if stopped else look.marker, markevery=20,
                markersize=4.0,
            )  # fmt: skip
        axes[0, 0].axvline(0.0, color="0.6", linewidth=1.0)
        axes[0, 0].set_yscale("log")
        plain_ticks(axes[0, 0].yaxis)
        axes[0, 0].set_xlabel("time after the change [s]")
        axes[0, 0].set_ylabel("median distance to the reference [m]")
        axes[0, 0].set_title(f"Errors aligned at the first change: {name}", loc="left")
        axes[0, 0].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return drawn


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
    page = f"{markdown_rows(cells, 2)}\n\n{LEGEND}\n"
    write_atomically(folder / "adaptation.md", page.encode())
    for name in sets if draw else ():
        traces: dict[str, list[dict[str, NDArray[Any]]]] = {}
        for entry in entries:
            kept = store.load_trace(entry.name, name)
            if kept is not None:
                traces.setdefault(agent_of(entry.name), []).append(kept)
        image = io.BytesIO()
        figure(name, traces).savefig(image, format="png", bbox_inches="tight")
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
    found = {name: scores(rows[name]) for name in benchmark.sets}
    cells = table(found)
    write(store.folder, store, cells, benchmark.sets, entries, config.figures)
    if not config.quiet:
        width = shutil.get_terminal_size().columns
        print(f"\n{aligned(cells, 2, width)}\n\n{folded(LEGEND, width)}\n")
    print(f"adaptation.csv, adaptation.md and figures in {store.folder}")
    return 0
