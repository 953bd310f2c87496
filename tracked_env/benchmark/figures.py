"""Figures of a finished benchmark, as SVG.

errors.svg          distance to the reference over time: median and quartiles
paths-<set>.svg     reference and driven paths of the first episodes, and their errors over time
drive-<set>.svg     error, torque and slip of one episode over time
beliefs-<set>.svg   true and estimated parameters over time, if a policy estimates any
and on the page of the leaderboard performance profiles.

Colours are those of Okabe and Ito, distinguishable with any colour vision; every policy has a
line style and a marker of its own as well.
"""

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.leaderboard import MAX_DRAWN, Leaderboard, figure_agents
from tracked_env.benchmark.metrics import CHANNELS
from tracked_env.benchmark.policy_interface import agent_of
from tracked_env.benchmark.statistics import profile
from tracked_env.benchmark.store import Record, Store
from tracked_env.benchmark.summary import Row
from tracked_env.benchmark.table_model import Drawing, inline_svg

PALETTE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe-Ito
LINE_STYLES = ("--", "-", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)))
MARKERS = ("v", "o", "s", "D", "^", "P")
REFERENCE_COLOUR = "0.55"
DPI = 120  # [1/inch]
WIDTH = 7.0  # [inch] of pictures on pages: 9 pt are 11.6 px where 650 px are 7 inch
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "figure.titlesize": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "path.simplify_threshold": 0.3,  # [px] keeps vector files of long episodes small
}
# Names of policies are shown as they are: a dollar sign in one begins no formula.
_OF_POLICIES = {**STYLE, "text.parse_math": False}
BELIEFS = {  # drawn, with their labels
    "mass": "mass [kg]",
    "inertia": "inertia [kg m²]",
    "longitudinal_resistance": "longitudinal resistance [-]",
    "lateral_resistance": "lateral resistance [-]",
}
SMALLEST_DRAWN = 1e-3  # [m] of errors on a logarithmic axis
MARKER_TIME = 5.0  # [s] between two markers on a path
THRESHOLDS = 80  # of the performance profile
Traces = dict[str, dict[str, NDArray[Any]]]  # of one set, by policy


class Look(NamedTuple):
    """How one policy is drawn."""

    colour: str
    line_style: Any
    marker: str

    def line(self, width: float, size: float = 0.0, **more: Any) -> dict[str, Any]:
        """Arguments of a line of this width, with markers of this size."""
        line = {"linestyle": self.line_style, "color": self.colour, "linewidth": width, **more}
        return {**line, "marker": self.marker, "markersize": size} if size else line


def looks(policies: Sequence[str]) -> dict[str, Look]:
    """Line style of each policy, the same in every figure; 36 different ones."""
    return {
        name: Look(PALETTE[i % 6], LINE_STYLES[(i + i // 6) % 6], MARKERS[(i + i // 6) % 6])
        for i, name in enumerate(policies)
    }


def new_figure(
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
    width = left + columns * panel[0] + (columns - 1) * gap[0]
    height = rows * panel[1] + (rows - 1) * gap[1]
    figure = Figure(figsize=(width + 0.15, height + 1.45), dpi=DPI)
    grid = {"left": left / (width + 0.15), "right": width / (width + 0.15)}
    grid |= {"bottom": 0.55 / (height + 1.45), "top": 1.0 - 0.9 / (height + 1.45)}
    grid |= {"wspace": gap[0] / panel[0], "hspace": gap[1] / panel[1]}
    return figure, figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **shared)


@contextmanager
def picture(file: Path, height: float) -> Iterator[Figure]:
    """A picture of a page, WIDTH wide and this high [inch]: written when the block has drawn it."""
    with matplotlib.rc_context(_OF_POLICIES):
        figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout=ConstrainedLayoutEngine())
        yield figure
        figure.savefig(file)


def plain_ticks(axis: Axis, places: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """Ticks of a logarithmic axis at these places of each decade, written as plain numbers."""
    axis.set_major_locator(LogLocator(subs=places))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def head(figure: Figure, axes: Axes, title: str, style: dict[str, Look]) -> None:
    """Above all panels one legend with a title; where it needs the space, a picture grows."""
    width, height = figure.get_size_inches()
    top = max(panel.get_position().y1 for panel in figure.axes)
    by_label = {line.get_label(): line for line in axes.get_legend_handles_labels()[0]}
    order = [label for label in ("reference", "true", *style) if label in by_label]
    entry = 0.7 + 0.08 * max(map(len, order), default=0)  # [inch] with its handle
    figure.legend(
        [by_label[label] for label in order],
        order,
        loc="lower left",
        bbox_to_anchor=(0.0, top + 0.25 / height),
        ncols=max(int(width / entry), 1),
        title=title,
        title_fontsize=11,
        alignment="left",
    )


def svg_text(figure: Figure, title: str) -> str:
    """A figure as SVG, the same text for the same figure; its letters stay text."""
    buffer, without = io.StringIO(), dict.fromkeys(("Date", "Creator", "Format", "Type"))
    size: dict[str, Any] = {"bbox_inches": "tight", "pad_inches": 0.1}
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(buffer, format="svg", metadata=without, **size)
    # A tenth of a point is not seen; the digits behind it are half of a file.
    return re.sub(r' d="[^"]+"', lambda of: re.sub(r"(\.\d)\d+", r"\1", of[0]), buffer.getvalue())


def errors(traces: dict[str, Traces], style: dict[str, Look]) -> Figure:
    """One panel per set: median of the error over the episodes, and the quartiles as a band."""
    columns = min(len(traces), 4)
    rows = -(-len(traces) // columns)
    figure, grid = new_figure((2.4, 1.8), rows, columns, gap=(0.2, 0.45), sharex=True, sharey=True)
    panels = grid.ravel()
    for axes, (name, by_policy) in zip(panels, traces.items(), strict=False):
        for policy, trace in by_policy.items():
            low, median, high = np.quantile(trace["error"], [0.25, 0.5, 0.75], axis=1)
            look = style[policy]
            axes.fill_between(trace["time"], low, high, color=look.colour, alpha=0.25, linewidth=0)
            axes.plot(trace["time"], median, **look.line(1.5), label=policy)
        axes.set_title(name)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
    for number, axes in enumerate(panels):
        if number >= len(traces):
            axes.remove()
        elif number + columns >= len(traces):  # the last one of its column
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
    for axes in grid[:, 0]:
        axes.set_ylabel("distance to reference [m]")
    head(figure, panels[0], "Tracking error over time: median and quartiles", style)
    return figure


def _motion(trace: dict[str, NDArray[Any]], name: str, episode: int) -> NDArray[np.float64]:
    """One channel of one shown episode, (T,); NaN after its end."""
    return np.asarray(trace["motion"][:, episode, CHANNELS.index(name)], dtype=np.float64)


def paths(name: str, traces: Traces, style: dict[str, Look], seed: int) -> Figure:
    """Reference and driven paths of the first episodes of a set, and their errors over time.

    Errors of centimetres are not seen beside paths of many metres: hence the lower row. Markers
    every MARKER_TIME show who is where at the same time: a delay is an error as well.
    """
    longest = max(traces.values(), key=lambda trace: len(trace["motion"]))
    count = min(trace["motion"].shape[1] for trace in traces.values())
    every = max(round(MARKER_TIME / float(longest["control_period"])), 1)
    figure, grid = new_figure((2.4, 2.2), 2, count, gap=(0.5, 0.5))
    for episode, (axes, below) in enumerate(grid.T):
        x, y = (_motion(longest, f"reference_{axis}", episode) for axis in "xy")
        wide = Look(REFERENCE_COLOUR, "-", "o").line(5.0, 6.0, markevery=(every - 1, every))
        axes.plot(x, y, alpha=0.5, label="reference", **wide)
        for policy, trace in reversed(traces.items()):  # the baseline on top
            look = style[policy]
            x, y = _motion(trace, "x", episode), _motion(trace, "y", episode)
            axes.plot(x, y, label=policy, **look.line(1.3, 4.0, markevery=(every - 1, every)))
            if np.isnan(x).any() or len(x) < len(longest["motion"]):  # it ended early: mark where
                end = np.flatnonzero(np.isfinite(x))[-1]
                axes.plot(x[end], y[end], "X", color=look.colour, markersize=8.0)
            error = _motion(trace, "error", episode)
            time = np.arange(1, len(error) + 1) * trace["control_period"]
            below.plot(time, np.maximum(error, SMALLEST_DRAWN), **look.line(1.1))
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"episode {episode} (seed {seed + episode})")
        axes.set_xlabel("x [m]")
        below.set_yscale("log")
        below.yaxis.set_major_formatter("{x:g}")
        below.set_xlabel("time [s]")
    grid[0, 0].set_ylabel("y [m]")
    grid[1, 0].set_ylabel("distance to reference [m]")
    head(figure, grid[0, 0], f"{name}: paths, a marker every {MARKER_TIME:g} s", style)
    return figure


def drive(name: str, traces: Traces, style: dict[str, Look], episode: int = 0) -> Figure:
    """Error, torque and slip of one episode of a set over time; a column per side."""
    figure, grid = new_figure((4.0, 1.6), 3, 2, gap=(0.75, 0.4), sharex=True)
    for row in grid[1:]:
        row[1].sharey(row[0])
    for policy, trace in reversed(traces.items()):  # the baseline on top
        line = style[policy].line(1.1)
        time = np.arange(1, len(trace["motion"]) + 1) * trace["control_period"]
        grid[0, 0].plot(time, _motion(trace, "error", episode), label=policy, **line)
        heading = np.degrees(_motion(trace, "heading_error", episode))
        grid[0, 1].plot(time, heading, **line)
        for column, side in enumerate(("left", "right")):
            grid[1, column].plot(time, _motion(trace, f"torque_{side}", episode) / 1e3, **line)
            grid[2, column].plot(time, 100.0 * _motion(trace, f"slip_{side}", episode), **line)
    labels = {(0, 0): "distance to reference [m]", (0, 1): "heading error [deg]"}
    labels |= {(1, 0): "sprocket torque [kN m]", (2, 0): "slip [%]"}
    for place, label in labels.items():
        grid[place].set_ylabel(label)
    for column, side in enumerate(("left", "right")):
        grid[1, column].set_title(f"{side} track")
        grid[2, column].set_xlabel("time [s]")
    figure.align_ylabels(grid[:, 0])
    head(figure, grid[0, 0], f"{name}: episode {episode}", style)
    return figure


def _believed(trace: dict[str, NDArray[Any]], name: str, episode: int) -> NDArray[np.float64]:
    """Time, true value, estimate and its standard deviation, (4, points); NaN after the end."""
    row = list(trace["believed_names"]).index(name)
    parts = [trace[f"believed_{part}"][:, row, episode] for part in ("truth", "value", "deviation")]
    return np.array([trace["believed_time"], *parts], dtype=np.float64)


def beliefs(name: str, traces: Traces, style: dict[str, Look], seed: int) -> Figure | None:
    """True and estimated parameters with a band of two claimed sigma; a column per episode.

    None when no policy estimates one of BELIEFS. The axes show truth and estimates, a band that
    is wider is cut off.
    """
    names = {policy: set(map(str, t.get("believed_names", ()))) for policy, t in traces.items()}
    rows = [parameter for parameter in BELIEFS if any(parameter in of for of in names.values())]
    if not rows:
        return None
    count = min(traces[policy]["believed_value"].shape[2] for policy, of in names.items() if of)
    figure, grid = new_figure(
        (2.5, 1.35), len(rows), count, left=0.75, gap=(0.25, 0.2), sharex=True, sharey="row"
    )
    for parameter, panels in zip(rows, grid, strict=True):
        policies = [policy for policy, of in names.items() if parameter in of]
        extremes = []
        for episode, axes in enumerate(panels):
            by_policy = {p: _believed(traces[p], parameter, episode) for p in policies}
            time, truth, _, _ = max(by_policy.values(), key=lambda d: np.isfinite(d[1]).sum())
            axes.plot(time, truth, color=REFERENCE_COLOUR, linewidth=4.0, alpha=0.5, label="true")
            extremes.append([np.nanmin(truth), np.nanmax(truth)])
            for policy, (time, _, value, deviation) in reversed(by_policy.items()):
                look = style[policy]
                band = value - 2.0 * deviation, value + 2.0 * deviation
                axes.fill_between(time, *band, color=look.colour, alpha=0.2, linewidth=0)
                axes.plot(time, value, label=policy, **look.line(1.2))
                finite = value[np.isfinite(value)]
                if finite.size:
                    extremes.append(list(np.quantile(finite, [0.01, 0.99])))
        low, high = np.min(extremes), np.max(extremes)
        margin = 0.15 * (high - low) + 0.05 * abs(high)
        panels[0].set_ylim(low - margin, high + margin)
        panels[0].set_ylabel(BELIEFS[parameter])
    for episode in range(count):
        grid[0, episode].set_title(f"episode {episode} (seed {seed + episode})")
        grid[-1, episode].set_xlabel("time [s]")
    figure.align_ylabels(grid[:, 0])
    head(figure, grid[0, 0], f"{name}: parameters, estimates ± 2 standard deviations", style)
    return figure


def save_all(
    folder: Path,
    store: Store,
    records: Sequence[Record],
    sets: Sequence[str],
    seed: int,
    agents: Sequence[str] | None = None,
) -> list[Path]:
    """Draw everything into `folder`; returns the files.

    seed: of the first episode of a set without records. agents: those that are drawn, by default
    the first ones; MAX_DRAWN of them. Of an agent with several seeds the first one is drawn.
    """
    first: dict[str, str] = {}
    seeds = {record["set"]: record["seed"] - record["episode"] for record in records}
    for record in records:
        first.setdefault(agent_of(record["policy"]), record["policy"])
    style = looks([first[agent] for agent in (first if agents is None else agents)][:MAX_DRAWN])
    by_set: dict[str, Traces] = {}
    for name in sets:
        loaded = {policy: store.load_trace(policy, name) for policy in style}
        by_set[name] = {policy: trace for policy, trace in loaded.items() if trace is not None}
    by_set = {name: traces for name, traces in by_set.items() if traces}
    with matplotlib.rc_context(_OF_POLICIES):
        figures = {"errors": errors(by_set, style)} if by_set else {}
        for name, traces in by_set.items():
            figures[f"paths-{name}"] = paths(name, traces, style, seeds.get(name, seed))
            figures[f"drive-{name}"] = drive(name, traces, style)
            if (figure := beliefs(name, traces, style, seeds.get(name, seed))) is not None:
                figures[f"beliefs-{name}"] = figure
        for title, figure in figures.items():
            write_atomically(folder / f"{title}.svg", svg_text(figure, title).encode())
    return [folder / f"{title}.svg" for title in figures]


def profiles(board: Leaderboard, row: Row) -> Drawing:
    """Share of seeds and episodes with an RMSE below a threshold, with 95 % bands.

    row: that of all sets.
    """
    style = looks(figure_agents(board))
    values = np.concatenate([row.redrawn[agent].values.ravel() for agent in style])
    low, high = max(float(values.min()), 1e-3), max(float(values.max()), 2e-3)
    tau = np.geomspace(low, high, THRESHOLDS)
    title = "Performance profile over all sets: further left is better"
    with matplotlib.rc_context(_OF_POLICIES):
        figure, ((axes,),) = new_figure((6.5, 3.2))
        for agent, look in style.items():
            share, below, above = profile(row.redrawn[agent], row.redraws, tau)
            axes.fill_between(tau, below, above, color=look.colour, alpha=0.2, linewidth=0)
            axes.plot(tau, share, label=agent, **look.line(1.5, 4.0, markevery=(5, 15)))
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("threshold of the RMSE [m]")
        axes.set_ylabel("share of episodes with RMSE ≤ threshold")
        head(figure, axes, title, style)
        svg = inline_svg(svg_text(figure, title), title)
    return Drawing("Performance profile", f"Drawn: {', '.join(style)}", svg)
