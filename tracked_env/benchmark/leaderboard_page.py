"""The leaderboard as one HTML page that needs no other file and asks for none.

The template is filled with tables, whose columns of names and verdicts stay in view, with figures
as SVG, and with where the numbers come from; one short script sorts and filters. Without matplotlib
(extra `render`) there are no figures; tables, intervals as marks, and colours remain.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import reliability as rel
from tracked_env.benchmark import report
from tracked_env.benchmark.figures import (
    MARK_LIMIT,
    STYLE,
    Look,
    colour,
    inline_svg,
    looks,
    marks,
    new_figure,
    plain_ticks,
    svg_text,
)
from tracked_env.benchmark.leaderboard import Leaderboard, Place
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import write_atomically
from tracked_env.benchmark.summary import Row, Summary
from tracked_env.benchmark.text_tables import Cell, Table, plain_table, verdict_cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curves = Mapping[str, Sequence[Sequence[tuple[float, float]]]]
LEARNING = "Learning curves"
THRESHOLDS = 80  # of the performance profile
TEMPLATES = Path(__file__).with_name("templates")
FILES = {
    "results.json": "configuration, versions, units, all intervals and all records",
    "episodes.csv": "one row per set, policy and episode",
    "leaderboard.json": "the leaderboard as numbers",
    "summary.md": "the tables of every set as text",
}


class Drawing(NamedTuple):
    """A figure of the page; a folded one is opened by its title."""

    title: str
    caption: str
    svg: str
    folded: bool = False


class Section(NamedTuple):
    """A part of the page."""

    title: str
    anchor: str
    tables: Sequence[Table] = ()
    figures: Sequence[Drawing] = ()
    facts: Mapping[str, str] = {}
    links: Mapping[str, str] = {}
    notes: Sequence[str] = ()  # sentences


def main_table(board: Leaderboard) -> Table:
    """What leads the leaderboard, with intervals as marks and as text."""
    head, *rows = lb.table(board)
    made = plain_table(
        f"Agents by their error over that of {board.reference}. A mark is the ratio, its bar the "
        f"95 % interval, the dashed line 1; the axis is logarithmic and ends at {MARK_LIMIT:g}",
        [["place", *head[1:-1]], *(row[:-1] for row in rows)],
        (1, 8),
        [lb.explanation(board), lb.agreement_text(board)],
    )
    for row, (*_, whole, settled) in zip(made.rows, rows, strict=True):
        if settled != whole:
            row[1] = row[1]._replace(more=(f"after 5 s: {settled}",))
    columns = [
        (4, marks([place.relative.whole for place in board.places])),
        (5, marks([place.relative.settled for place in board.places])),
    ]
    for column, of in columns:
        for row, mark in zip(made.rows, of, strict=True):
            row[column] = row[column]._replace(mark=mark)
    return made


def _of_set(place: Place, board: Leaderboard, row: Row, rmse: Estimate) -> Cell:
    """Ratio of the errors in one set: value, interval and verdict in words, error in metres."""
    metres = f"{rmse.value:.3f} m"
    if place.against is None:
        return Cell("1", 1.0, "heat", ("reference", metres), colour(1.0))
    ratio = rel.relative_error([(row.redrawn[place.agent], row.redrawn[board.reference])])
    said = lb.said(ratio) if rel.enough(min(row.sizes), place.seeds) else report.TOO_FEW
    interval = () if place.seeds == 1 else (f"[{ratio.low:.2f}, {ratio.high:.2f}]",)
    return Cell(
        f"{ratio.value:.2f}", ratio.value, "heat", (*interval, said, metres), colour(ratio.value)
    )


def set_table(board: Leaderboard, rows: Mapping[str, Row]) -> Table:
    """Error of every agent over that of the reference on every set."""
    body = [
        [
            Cell(place.agent, None, "name"),
            verdict_cell(lb.verdict(place)),
            *(_of_set(place, board, rows[name], place.rmse[name]) for name in board.sets),
        ]
        for place in board.places
    ]
    note = (
        f"IQM of the RMSE over that of {board.reference}, its 95 % interval, what that says, and "
        "the IQM in metres. Blue: a smaller error than the reference; red: a larger one; white: 1. "
        f"No verdict ({report.TOO_FEW}) below {rel.FEW_EPISODES + 1} episodes or "
        f"{rel.FEW_SEEDS + 1} seeds."
    )
    head = ["agent", f"than {board.reference}", *board.sets]
    return Table("Error of every agent on every set", head, body, 2, [note])


def profiles(row: Row, board: Leaderboard, style: dict[str, Look]) -> "Figure":
    """Share of seeds and episodes with an RMSE below a threshold, with 95 % bands."""
    values = np.concatenate([row.redrawn[agent].values.ravel() for agent in style])
    low, high = max(float(values.min()), 1e-3), max(float(values.max()), 2e-3)
    tau = np.geomspace(low, high, THRESHOLDS)
    figure, grid = new_figure((6.5, 3.2))
    axes = grid[0, 0]
    for place in [p for p in board.places if p.agent in style]:
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
    shown = [p for p in board.places if p.agent in curves and p.agent in style]
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
    """The figures of all sets by title; empty without matplotlib. row: that of all sets."""
    try:
        import matplotlib
    except ImportError:
        return {}
    style = looks(lb.shown(board))
    # Names of agents are shown as they are: a dollar sign in one begins no formula.
    with matplotlib.rc_context({**STYLE, "text.parse_math": False}):
        drawn = {"Performance profile": profiles(row, board, style)}
        if any(agent in curves for agent in style):
            drawn[LEARNING] = learning(curves, board, style)
    return drawn


def _drawings(board: Leaderboard, row: Row, curves: Curves) -> list[Drawing]:
    return [
        Drawing(
            title,
            f"Those of {', '.join(a for a in lb.shown(board) if a in curves)}."
            if title == LEARNING
            else _said_shown(board),
            inline_svg(svg_text(figure, title), title),
        )
        for title, figure in figures(board, row, curves).items()
    ]


def _said_shown(board: Leaderboard) -> str:
    shown = lb.shown(board)
    if len(shown) == len(board.places):
        return "All agents are drawn."
    return f"Drawn: {', '.join(shown)}, of {len(board.places)} agents; --policies names others."


def _of_episodes(board: Leaderboard, files: Sequence[Path]) -> list[Drawing]:
    """Figures of episodes, which `episode_figures` has written, titled by their names."""
    return [
        Drawing(
            path.stem.replace("-", " of ", 1),
            f"{_said_shown(board)} As a file: figures/{path.name}",
            inline_svg(path.read_text(encoding="utf-8"), path.stem),
            folded=path.stem not in ("overview", "errors"),
        )
        for path in files
    ]


def _details(summary: Summary) -> list[Table]:
    """The tables of every set, the policy first."""
    titles = {
        "RMSE": "Errors and costs", "clearly": f"Compared with {summary.baseline}",
        "recovery": "After abrupt changes", "goals": "Goals", "NEES": "Estimates",
        "NIS": "Innovations of the filters",
    }  # fmt: skip
    tables = []
    for rows, _, legend in report.parts(summary):
        text = " ".join(rows[0])
        keys = ("clearly", "recovery", "goals", "NEES", "NIS", "RMSE")
        title = titles[next(key for key in keys if key in text)]
        front = (1, rows[0].index("clearly worse")) if "clearly worse" in rows[0] else (1, 0)
        tables.append(plain_table(title, rows, front, [legend]))
    return tables


def sections(
    board: Leaderboard,
    rows: Mapping[str, Row],
    drawn: Sequence[Drawing],
    episodes: Sequence[Drawing],
    summary: Summary | None,
    origin: Mapping[str, str],
) -> list[Section]:
    """The parts of the page in their order; what is empty is left out."""
    costs = [plain_table("Cost metrics", lb.cost_table(board), (0,), [lb.COSTS])]
    if len(goals := lb.goal_table(board)) > 1:
        costs.append(plain_table("Goals", goals, (0,), [report.GOAL_LEGEND]))
    scores = plain_table("Score and errors in metres", lb.score_table(board), (0,), [lb.SCORES])
    found = [
        Section("Leaderboard", "leaderboard", [main_table(board)]),
        Section("Every set", "sets", [set_table(board, rows)]),
        Section("Figures", "figures", figures=drawn),
        Section("Episodes", "episodes", figures=episodes),
        Section("Scores", "scores", [scores]),
        Section("Costs", "costs", costs),
        Section("Details", "details", _details(summary) if summary else ()),
        Section("Provenance", "provenance", facts=origin),
        Section("Files", "files", links=FILES),
    ]
    return [part for part in found if part.tables or part.figures or part.facts or part.links]


def page_text(
    title: str,
    subject: str,
    introduction: Sequence[str],
    parts: Sequence[Section],
    filter_by: str = "agent, set or verdict",
) -> str:
    """A whole page of this style, "TITLE of SUBJECT"; introduction: its first paragraphs."""
    engine = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    own: dict[str, Any] = {
        name: (TEMPLATES / file).read_text(encoding="utf-8")
        for name, file in (("css", "page.css"), ("script", "page.js"))
    }
    return engine.get_template("leaderboard.html").render(
        title=title,
        subject=subject,
        introduction=introduction,
        sections=parts,
        filter=filter_by,
        **{name: Markup(text) for name, text in own.items()},
    )


def write(
    folder: Path,
    board: Leaderboard,
    rows: Mapping[str, Row],
    curves: Curves,
    draw: bool = True,
    episodes: Sequence[Path] = (),
    summary: Summary | None = None,
    origin: Mapping[str, str] | None = None,
) -> Path:
    """Write leaderboard.html into `folder`.

    rows: of every set and, last, of all; draw: with figures; episodes: figures as SVG files;
    summary: for the tables of every set; origin: where the numbers come from, by what it is.
    """
    path = folder / "leaderboard.html"
    given = origin or {}
    drawn = _drawings(board, list(rows.values())[-1], curves) if draw else []
    parts = sections(board, rows, drawn, _of_episodes(board, episodes), summary, given)
    text = page_text("Leaderboard", given.get("environment", ""), [board.conditions], parts)
    write_atomically(path, text.encode())
    return path
