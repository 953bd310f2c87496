"""Figures of a finished benchmark, as PNG; needs matplotlib (extra `render`).

    overview.png        tracking RMSE of every episode, per set and policy
    errors.png          distance to the reference over time: median and quartiles
    paths-<set>.png     reference and driven paths of the first episodes
    drive-<set>.png     error, torque and slip of one episode over time
Colours are those of Okabe and Ito, distinguishable with any colour vision; every policy has a
line style and a marker of its own as well.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.metrics import CHANNELS
from tracked_env.benchmark.store import Record, Store

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe-Ito
LINE_STYLES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKERS = ("v", "o", "s", "D", "^", "P")
REFERENCE_COLOUR = "0.55"
MARKER_TIME = 5.0  # [s] between two markers on a path
DPI = 120  # [1/inch]
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
}


class Look(NamedTuple):
    """How one policy is drawn."""

    colour: str
    line_style: Any
    marker: str


def looks(policies: Sequence[str]) -> dict[str, Look]:
    """A look per policy, the same in every figure."""
    return {
        name: Look(PALETTE[i % 6], LINE_STYLES[i % 6], MARKERS[i % 6])
        for i, name in enumerate(policies)
    }


def _new(
    panel: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    left: float = 0.65,
    gap: tuple[float, float] = (0.35, 0.4),
    **shared: Any,
) -> Any:
    """Figure and axes (rows, columns), without any global state.

    panel, gap: width and height of a panel and between two [inch]; left: left margin [inch].
    Fixed margins, because measuring the labels takes longer than drawing the figure.
    """
    from matplotlib.figure import Figure

    right, top, bottom = 0.15, 0.9, 0.55
    width = left + columns * panel[0] + (columns - 1) * gap[0] + right
    height = bottom + rows * panel[1] + (rows - 1) * gap[1] + top
    figure = Figure(figsize=(width, height), dpi=DPI)
    grid = {
        "left": left / width, "right": 1.0 - right / width, "wspace": gap[0] / panel[0],
        "bottom": bottom / height, "top": 1.0 - top / height, "hspace": gap[1] / panel[1],
    }  # fmt: skip
    return figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **shared)


def _head(figure: "Figure", axes: "Axes", title: str, style: dict[str, Look]) -> None:
    """Title at the upper left, and below it one legend for all panels."""
    width, height = figure.get_size_inches()
    handles, labels = axes.get_legend_handles_labels()
    by_label = dict(zip(labels, handles, strict=True))
    order = [label for label in ("reference", *style) if label in by_label]
    figure.legend(
        [by_label[label] for label in order], order,
        loc="upper left", bbox_to_anchor=(0.0, 1.0 - 0.3 / height), ncols=len(labels),
    )  # fmt: skip
    figure.suptitle(title, x=0.12 / width, y=1.0 - 0.12 / height, ha="left", va="top", fontsize=11)


def overview(records: Sequence[Record], sets: Sequence[str], style: dict[str, Look]) -> "Figure":
    """Every episode as a point, quartiles as a box; RMSE on a logarithmic axis."""
    figure, grid = _new((7.0, 0.24 * len(sets) * (len(style) + 1)), left=1.4)
    axes = grid[0, 0]
    rng = np.random.default_rng(0)  # of the vertical scatter of the points
    for row, name in enumerate(sets):
        for k, (policy, look) in enumerate(style.items()):
            rmse = np.array(
                [r["tracking_rmse"] for r in records if (r["set"], r["policy"]) == (name, policy)]
            )
            y = row + (k - 0.5 * (len(style) - 1)) * 0.8 / len(style)
            height = 0.55 / len(style)
            axes.boxplot(
                rmse, positions=[y], orientation="horizontal", widths=height, showfliers=False,
                manage_ticks=False, patch_artist=True,
                boxprops={"facecolor": look.colour, "alpha": 0.35, "edgecolor": look.colour},
                medianprops={"color": look.colour, "linewidth": 2.0},
                whiskerprops={"color": look.colour}, capprops={"color": look.colour},
            )  # fmt: skip
            scatter = y + height * rng.uniform(-0.4, 0.4, len(rmse))
            axes.plot(
                rmse, scatter, look.marker, color=look.colour, markersize=3.0, alpha=0.6,
                markeredgewidth=0.0, label=policy if row == 0 else None,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(sets)), sets)
    axes.set_ylim(len(sets) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    for row in range(1, len(sets)):
        axes.axhline(row - 0.5, color="0.85", linewidth=0.8)
    axes.set_xlabel("tracking RMSE of an episode [m]")
    _head(figure, axes, "Tracking error of every episode", style)
    return figure


Traces = dict[str, dict[str, NDArray[Any]]]  # of one set, by policy


def errors(traces: dict[str, Traces], style: dict[str, Look]) -> "Figure":
    """One panel per set: median of the error over the episodes, and the quartiles as a band."""
    columns = min(len(traces), 4)
    rows = -(-len(traces) // columns)
    figure, grid = _new((2.4, 1.8), rows, columns, gap=(0.2, 0.45), sharex=True, sharey=True)
    panels = grid.ravel()
    for axes, (name, by_policy) in zip(panels, traces.items(), strict=False):
        for policy, trace in by_policy.items():
            low, median, high = np.quantile(trace["error"], [0.25, 0.5, 0.75], axis=1)
            look = style[policy]
            axes.fill_between(trace["time"], low, high, color=look.colour, alpha=0.25, linewidth=0)
            axes.plot(
                trace["time"], median, linestyle=look.line_style, color=look.colour, label=policy
            )
        axes.set_title(name)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    for axes in panels[len(traces) :]:
        axes.remove()
    for column in range(columns):
        last = [row for row in range(rows) if row * columns + column < len(traces)][-1]
        grid[last, column].set_xlabel("time [s]")
        grid[last, column].tick_params(labelbottom=True)
    for row in range(rows):
        grid[row, 0].set_ylabel("distance to reference [m]")
    _head(figure, panels[0], "Tracking error over time: median and quartiles", style)
    return figure


def _motion(trace: dict[str, NDArray[Any]], name: str, episode: int) -> NDArray[np.float64]:
    """One channel of one shown episode, (T,); NaN after its end."""
    return np.asarray(trace["motion"][:, episode, CHANNELS.index(name)], dtype=np.float64)


def paths(name: str, traces: Traces, style: dict[str, Look], seed: int) -> "Figure":
    """Reference and driven paths of the first episodes of a set, one panel each.

    Markers every MARKER_TIME show who is where at the same time: a delay is an error as well.
    """
    longest = max(traces.values(), key=lambda trace: len(trace["motion"]))
    count = longest["motion"].shape[1]
    every = max(round(MARKER_TIME / float(longest["control_period"])), 1)
    figure, grid = _new((2.4, 2.6), 1, count, gap=(0.5, 0.0))
    for episode, axes in enumerate(grid[0]):
        x, y = (_motion(longest, f"reference_{axis}", episode) for axis in "xy")
        axes.plot(
            x, y, color=REFERENCE_COLOUR, linewidth=5.0, alpha=0.5, label="reference",
            marker="o", markersize=6.0, markevery=(every - 1, every),
        )  # fmt: skip
        for policy, trace in reversed(traces.items()):  # the baseline on top
            look = style[policy]
            x, y = _motion(trace, "x", episode), _motion(trace, "y", episode)
            axes.plot(
                x, y, linestyle=look.line_style, color=look.colour, linewidth=1.3, label=policy,
                marker=look.marker, markersize=4.0, markevery=(every - 1, every),
            )  # fmt: skip
            if np.isnan(x).any() or len(x) < len(longest["motion"]):  # it ended early: mark where
                end = np.flatnonzero(np.isfinite(x))[-1]
                axes.plot(x[end], y[end], "X", color=look.colour, markersize=8.0)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"episode {episode} (seed {seed + episode})")
        axes.set_xlabel("x [m]")
    grid[0, 0].set_ylabel("y [m]")
    _head(figure, grid[0, 0], f"{name}: paths, a marker every {MARKER_TIME:g} s", style)
    return figure


def drive(name: str, traces: Traces, style: dict[str, Look], episode: int = 0) -> "Figure":
    """Error, torque and slip of one episode of a set over time; a column per side."""
    figure, grid = _new((4.0, 1.6), 3, 2, gap=(0.75, 0.4), sharex=True)
    for row in grid[1:]:
        row[1].sharey(row[0])
    for policy, trace in reversed(traces.items()):  # the baseline on top
        look = style[policy]
        time = np.arange(1, len(trace["motion"]) + 1) * trace["control_period"]
        line = {"linestyle": look.line_style, "color": look.colour, "linewidth": 1.1}
        grid[0, 0].plot(time, _motion(trace, "error", episode), label=policy, **line)
        heading = np.degrees(_motion(trace, "heading_error", episode))
        grid[0, 1].plot(time, heading, **line)
        for column, side in enumerate(("left", "right")):
            grid[1, column].plot(time, _motion(trace, f"torque_{side}", episode) / 1e3, **line)
            grid[2, column].plot(time, 100.0 * _motion(trace, f"slip_{side}", episode), **line)
    for column, side in enumerate(("left", "right")):
        grid[1, column].set_title(f"{side} track")
        grid[2, column].set_xlabel("time [s]")
    grid[0, 0].set_ylabel("distance to reference [m]")
    grid[0, 1].set_ylabel("heading error [deg]")
    grid[1, 0].set_ylabel("sprocket torque [kN m]")
    grid[2, 0].set_ylabel("slip [%]")
    figure.align_ylabels(grid[:, 0])
    _head(figure, grid[0, 0], f"{name}: episode {episode}", style)
    return figure


def save_all(
    folder: Path, store: Store, records: Sequence[Record], sets: Sequence[str], seed: int
) -> list[Path]:
    """Draw everything into `folder`; returns the files. Raises ImportError without matplotlib."""
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError(
            "figures need matplotlib: pip install 'tracked-env[render]', or pass --no-figures"
        ) from error
    folder.mkdir(parents=True, exist_ok=True)
    style = looks(list(dict.fromkeys(record["policy"] for record in records)))
    found: dict[str, Traces] = {}
    for name in sets:
        loaded = {policy: store.load_trace(policy, name) for policy in style}
        found[name] = {policy: trace for policy, trace in loaded.items() if trace is not None}
    with matplotlib.rc_context(STYLE):
        drawn = {"overview": overview(records, sets, style), "errors": errors(found, style)}
        for name, traces in found.items():
            drawn[f"paths-{name}"] = paths(name, traces, style, seed)
            drawn[f"drive-{name}"] = drive(name, traces, style)
        files = []
        for title, figure in drawn.items():
            path = folder / f"{title}.png"
            figure.savefig(path)
            files.append(path)
    return files
