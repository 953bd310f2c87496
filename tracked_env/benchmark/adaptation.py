"""What adapting to a change inside an episode is worth, from paired episodes.

After the first abrupt change of an episode (see `changes`), until the next one or the end:
    regret    RMSE of a policy minus that of the ceiling, the best policy that reads the truth [m]
    recovery  time [s] until the distance stays small
    worth     RMSE of the same policy that learns no more from the change on (`frozen`) over its own
Where a border is met depends on the driver, so each policy counts from its own crossing. An episode
that ends before the ceiling's change counts with the error at which it ended: to be lost early is
never better. Means and ratios are over episodes and, of agents, seeds, with intervals of
`reliability`. Up to the change the frozen policy drives as the other does, to the bit.
"""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import reliability as rel
from tracked_env.benchmark.drawing import STYLE, looks, new_figure, plain_ticks
from tracked_env.benchmark.policy_interface import FROZEN_NAME
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import Row

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
