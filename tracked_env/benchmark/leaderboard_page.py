"""The leaderboard as one HTML page that needs nothing else: no script, no other file.

Figures are PNG inside the page; without matplotlib (extra `render`) there are none, and tables and
heat map, which are HTML, remain.
"""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tracked_env.benchmark import reliability as rel
from tracked_env.benchmark.drawing import (
    REFERENCE_COLOUR,
    STYLE,
    Look,
    looks,
    new_figure,
    plain_ticks,
)
from tracked_env.benchmark.leaderboard import (
    COSTS,
    SCORES,
    Leaderboard,
    agreement_text,
    cost_table,
    explanation,
    score_table,
    table,
)
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import write_atomically
from tracked_env.benchmark.summary import Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curves = Mapping[str, Sequence[Sequence[tuple[float, float]]]]
FIGURE_DPI = 150  # [1/inch]
THRESHOLDS = 80  # of the performance profile
# Colours of the heat map at scores of 0, 1/2 and 1: red, pale yellow, blue; with any colour vision.
_COLOURS = np.array([(202, 86, 44), (246, 237, 200), (38, 112, 168)], dtype=np.float64)
_CSS = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 75em; margin: 2em auto;
  padding: 0 1em; }
h1 { font-size: 1.6em; } h2 { font-size: 1.2em; margin-top: 2em; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: 0.25em 0.7em; text-align: right; white-space: nowrap; }
th { border-bottom: 2px solid #888; font-weight: 600; }
td { border-bottom: 1px solid #ddd; }
th.name, td.name { text-align: left; }
.heat td { border: 2px solid #fff; text-align: center; }
.heat th { border: 0; text-align: center; }
.heat td.name { text-align: left; }
img { max-width: 100%; height: auto; }
.note { color: #555; max-width: 60em; }
"""


def colour(score: float) -> tuple[str, str]:
    """Background and text colour of a score, clipped to 0 .. 1."""
    place = 2.0 * min(max(score, 0.0), 1.0)
    low = min(int(place), 1)
    red, green, blue = (_COLOURS[low] + (place - low) * (_COLOURS[low + 1] - _COLOURS[low])).round()
    light = 0.299 * red + 0.587 * green + 0.114 * blue
    text = "#000" if light > 140.0 else "#fff"
    return f"#{int(red):02x}{int(green):02x}{int(blue):02x}", text


def _table(rows: Sequence[Sequence[str]], names: int = 2) -> str:
    def cells(row: Sequence[str], tag: str) -> str:
        kinds = [' class="name"' if i < names else "" for i in range(len(row))]
        return "".join(
            f"<{tag}{kind}>{html.escape(cell)}</{tag}>"
            for kind, cell in zip(kinds, row, strict=True)
        )

    head_row, *body = rows
    lines = [f"<tr>{cells(row, 'td')}</tr>" for row in body]
    return (
        f'<div class="scroll"><table><thead><tr>{cells(head_row, "th")}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _heat_cell(score: Estimate | None, rmse: Estimate) -> str:
    title = f"IQM of the RMSE: {rmse.value:.3f} m [{rmse.low:.3f}, {rmse.high:.3f}]"
    if score is None:
        return f'<td title="{title}">-</td>'
    back, text = colour(score.value)
    title += f"; score [{score.low:.2f}, {score.high:.2f}]"
    style = f"background:{back};color:{text}"
    return f'<td style="{style}" title="{title}">{score.value:.2f}<br>{rmse.value:.3f} m</td>'


def heat_map(board: Leaderboard) -> str:
    """Score of every agent on every set, as an HTML table."""
    header = "".join(f"<th>{html.escape(name)}</th>" for name in ("", *board.sets))
    lines = []
    for place in board.places:
        cells = "".join(_heat_cell(place.scores[name], place.rmse[name]) for name in board.sets)
        lines.append(f'<tr><td class="name">{html.escape(place.agent)}</td>{cells}</tr>')
    return (
        f'<div class="scroll"><table class="heat"><thead><tr>{header}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def intervals(board: Leaderboard, style: Mapping[str, Look]) -> "Figure":
    """Error over the reference's with its interval, whole episode and after the start."""
    panels = ("whole episode", "after the start")
    figure, grid = new_figure((3.6, 0.32 * len(board.places) + 0.3), columns=2, left=1.9)
    for axes, name, settled in zip(grid[0], panels, (False, True), strict=True):
        for row, place in enumerate(board.places):
            e = place.relative.settled if settled else place.relative.whole
            look = style[place.agent]
            axes.plot([e.low, e.high], [row, row], color=look.colour, linewidth=5.0, alpha=0.4,
                      solid_capstyle="butt")  # fmt: skip
            axes.plot(e.value, row, look.marker, color=look.colour, markersize=6.0)
        axes.axvline(1.0, color=REFERENCE_COLOUR, linewidth=1.0)
        names = [place.agent for place in board.places] if not settled else []
        axes.set_yticks(range(len(board.places)), names or [""] * len(board.places))
        axes.set_ylim(len(board.places) - 0.5, -0.5)
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
        axes.set_xlabel(f"{name}: error / {board.reference}")
    grid[0, 0].set_title("Tracking error and its 95 % interval, over all sets", loc="left")
    return figure


def profiles(row: Row, board: Leaderboard, style: dict[str, Look]) -> "Figure":
    """Share of seeds and episodes with an RMSE below a threshold, with 95 % bands."""
    values = np.concatenate([of.values.ravel() for of in row.redrawn.values()])
    low, high = max(float(values.min()), 1e-3), max(float(values.max()), 2e-3)
    tau = np.geomspace(low, high, THRESHOLDS)
    figure, grid = new_figure((6.5, 3.2))
    axes = grid[0, 0]
    for place in board.places:
        look = style[place.agent]
        share, below, above = rel.profile(row.redrawn[place.agent], row.redraws, tau)
        axes.fill_between(tau, below, above, color=look.colour, alpha=0.2, linewidth=0)
        axes.plot(
            tau, share, linestyle=look.line_style, color=look.colour, label=place.agent,
            marker=look.marker, markevery=(5, 15), markersize=4.0,
        )  # fmt: skip
    axes.set_xscale("log")
    plain_ticks(axes.xaxis)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("threshold of the RMSE [m]")
    axes.set_ylabel("share of episodes with RMSE ≤ threshold")
    _legend(axes, "Performance profile over all sets: further left is better")
    return figure


def learning(curves: Curves, board: Leaderboard, style: dict[str, Look]) -> "Figure":
    """RMSE on held-out episodes over the steps of the training, a line per seed."""
    figure, grid = new_figure((6.5, 3.2))
    axes = grid[0, 0]
    shown = [place for place in board.places if place.agent in curves]
    for place in shown:
        look = style[place.agent]
        for seed, curve in enumerate(curves[place.agent]):
            steps, rmse = np.array(curve).T
            axes.plot(
                steps, rmse, linestyle=look.line_style, color=look.colour, linewidth=1.2,
                label=place.agent if seed == 0 else None, marker=look.marker, markersize=3.5,
            )  # fmt: skip
    axes.set_yscale("log")
    plain_ticks(axes.yaxis)
    axes.xaxis.set_major_formatter(lambda x, _: f"{x / 1e6:g}")
    axes.set_xlabel("environment steps [millions]")
    axes.set_ylabel("RMSE on held-out episodes [m]")
    _legend(axes, "Learning curves, a line per seed")
    return figure


def _legend(axes: "Axes", title: str) -> None:
    """Title above, and beside the panel a legend in the order of the leaderboard."""
    axes.set_title(title, loc="left")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), handlelength=3.0)


def figures(board: Leaderboard, row: Row, curves: Curves) -> "dict[str, Figure]":
    """All figures by title; empty without matplotlib. row: that of all sets."""
    try:
        import matplotlib
    except ImportError:
        return {}
    style = looks([place.agent for place in board.places])
    # Names of agents are shown as they are: a dollar sign in one begins no formula.
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        drawn = {
            "Tracking error": intervals(board, style),
            "Performance profile": profiles(row, board, style),
        }
        if curves:
            drawn["Learning curves"] = learning(curves, board, style)
    return drawn


def _inline(figure: "Figure", title: str) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=FIGURE_DPI, bbox_inches="tight")
    picture = buffer.getvalue()
    width = int.from_bytes(picture[16:20], "big") * 96 // FIGURE_DPI  # [px] of its head
    data = base64.b64encode(picture).decode()
    return f'<img alt="{html.escape(title)}" width="{width}" src="data:image/png;base64,{data}">'


def render(board: Leaderboard, drawn: "Mapping[str, Figure]") -> str:
    """The whole page."""
    parts = [
        f'<p class="note">{html.escape(board.conditions)}</p>',
        _table(table(board)),
        f'<p class="note">{html.escape(explanation(board)).replace(chr(10), " ")}</p>',
        f'<p class="note">{html.escape(agreement_text(board))}</p>',
        "<h2>Scores</h2>",
        _table(score_table(board), 1),
        f'<p class="note">{html.escape(SCORES).replace(chr(10), " ")}</p>',
        "<h2>Score on every set</h2>",
        heat_map(board),
        '<p class="note">0 (red): as good as integral, or nominal; 1 (blue): as the ceiling; below '
        "it the IQM of the RMSE. Intervals appear under the pointer.</p>",
        "<h2>Cost metrics</h2>",
        _table(cost_table(board), 1),
        f'<p class="note">{html.escape(COSTS).replace(chr(10), " ")}</p>',
    ]
    for title, figure in drawn.items():
        parts.append(f"<h2>{html.escape(title)}</h2>\n{_inline(figure, title)}")
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Leaderboard</title>\n<style>{_CSS}</style>\n</head>\n<body>\n"
        f"<h1>Leaderboard: tracked vehicles on unknown soil</h1>\n{body}\n</body>\n</html>\n"
    )


def write(folder: Path, board: Leaderboard, row: Row, curves: Curves, draw: bool = True) -> Path:
    """Write leaderboard.html into `folder`; draw: with figures."""
    path = folder / "leaderboard.html"
    drawn = figures(board, row, curves) if draw else {}
    write_atomically(path, render(board, drawn).encode())
    return path
