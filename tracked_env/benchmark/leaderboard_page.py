"""The leaderboard as one HTML page that needs no other file and asks for none.

It is made of tables, whose columns of names and verdicts stay in view, of figures as SVG, and of
where the numbers come from.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from tracked_env.benchmark import figures, report
from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark.figures import LEARNING, Curves
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.leaderboard import Leaderboard, Place
from tracked_env.benchmark.report import TOO_FEW
from tracked_env.benchmark.statistics import FEW_EPISODES, FEW_SEEDS
from tracked_env.benchmark.summary import Row, Summary
from tracked_env.benchmark.table_model import (
    MARK_LIMIT,
    Cell,
    Drawing,
    Section,
    Table,
    colour,
    inline_svg,
    marks,
    number_cell,
    page_text,
    verdict_cell,
)

FILES = {
    "results.json": "configuration, versions, units, all intervals and all records",
    "episodes.csv": "one row per set, policy and episode",
    "leaderboard.json": "the leaderboard as numbers",
    "summary.md": "the tables of every set as text",
}


class Provenance(NamedTuple):
    """What a page shows beside the leaderboard."""

    facts: Mapping[str, str] = {}  # where the numbers come from, by what it is
    summary: Summary | None = None  # for the tables of every set
    episodes: Sequence[Path] = ()  # figures of episodes as SVG files


def main_table(board: Leaderboard) -> Table:
    """What leads the leaderboard, with intervals as marks and as text."""
    table = lb.main_table(board)
    head, *rows = table.rows
    columns = {
        3: marks([place.relative.whole for place in board.places]),
        4: marks([place.relative.settled for place in board.places]),
    }
    body: list[list[str | Cell]] = []
    for number, (*cells, whole, settled) in enumerate(rows):
        row: list[str | Cell] = list(cells)
        for column, of in columns.items():
            row[column] = number_cell(str(cells[column]))._replace(mark=of[number])
        more = () if settled == whole else (f"after 5 s: {settled}",)
        body.append([*row, verdict_cell(str(whole))._replace(more=more)])
    title = (
        f"{table.title}. A mark is the ratio, its bar the 95 % interval, the dashed line 1; the "
        f"axis is logarithmic and ends at {MARK_LIMIT:g}"
    )
    return table._replace(title=title, rows=[["place", *head[1:-1]], *body])


def _set_cell(place: Place, name: str, board: Leaderboard, row: Row) -> Cell:
    """Ratio of the errors in one set: value, interval and verdict in words, error in metres."""
    metres = f"{place.rmse[name].value:.3f} m"
    if place.against is None:
        return Cell("1", 1.0, "heat", ("reference", metres), colour(1.0))
    ratio = stats.relative_error([(row.redrawn[place.agent], row.redrawn[board.reference])])
    word = lb.said(ratio) if stats.enough(min(row.sizes), place.seeds) else TOO_FEW
    interval = () if place.seeds == 1 else (f"[{ratio.low:.2f}, {ratio.high:.2f}]",)
    more = (*interval, word, metres)
    return Cell(f"{ratio.value:.2f}", ratio.value, "heat", more, colour(ratio.value))


def set_table(board: Leaderboard, rows: Mapping[str, Row]) -> Table:
    """Error of every agent over that of the reference on every set."""
    body: list[list[str | Cell]] = [
        [
            place.agent,
            lb.verdict(place),
            *(_set_cell(place, name, board, rows[name]) for name in board.sets),
        ]
        for place in board.places
    ]
    note = (
        f"IQM of the RMSE over that of {board.reference}, its 95 % interval, what that says, and "
        "the IQM in metres. Blue: a smaller error than the reference; red: a larger one; white: 1. "
        f"No verdict ({TOO_FEW}) below {FEW_EPISODES + 1} episodes or {FEW_SEEDS + 1} seeds."
    )
    head = ["agent", f"than {board.reference}", *board.sets]
    return Table("Error of every agent on every set", [head, *body], 2, [note], (0, 1))


def _drawn_agents(board: Leaderboard) -> str:
    shown = lb.shown(board)
    if len(shown) == len(board.places):
        return "All agents are drawn."
    return f"Drawn: {', '.join(shown)}, of {len(board.places)} agents; --policies names others."


def _drawings(board: Leaderboard, row: Row, curves: Curves) -> list[Drawing]:
    """The figures of all sets; row: that of all sets."""
    trained = ", ".join(agent for agent in lb.shown(board) if agent in curves)
    captions = {LEARNING: f"Those of {trained}."}
    return [
        Drawing(
            title,
            captions.get(title, _drawn_agents(board)),
            inline_svg(figures.svg_text(figure, title), title),
        )
        for title, figure in figures.figures(board, row, curves).items()
    ]


def _of_episodes(board: Leaderboard, files: Sequence[Path]) -> list[Drawing]:
    """Figures of episodes, titled by their names."""
    return [
        Drawing(
            path.stem.replace("-", " of ", 1),
            f"{_drawn_agents(board)} As a file: figures/{path.name}",
            inline_svg(path.read_text(encoding="utf-8"), path.stem),
            folded=path.stem not in ("overview", "errors"),
        )
        for path in files
    ]


def write(
    folder: Path,
    board: Leaderboard,
    rows: Mapping[str, Row],
    curves: Curves,
    draw: bool = True,
    more: Provenance = Provenance(),  # noqa: B008, it does not change
) -> Path:
    """Write leaderboard.html into `folder`.

    rows: of every set and, last, of all; draw: with figures.
    """
    drawings = _drawings(board, list(rows.values())[-1], curves) if draw else []
    costs = [table for table in (lb.cost_table(board), lb.goal_table(board)) if len(table.rows) > 1]
    details = report.tables_of(more.summary) if more.summary else []
    sections = [
        Section("Leaderboard", "leaderboard", [main_table(board)]),
        Section("Every set", "sets", [set_table(board, rows)]),
        Section("Figures", "figures", figures=drawings),
        Section("Episodes", "episodes", figures=_of_episodes(board, more.episodes)),
        Section("Scores", "scores", [lb.score_table(board)]),
        Section("Costs", "costs", costs),
        Section("Details", "details", details),
        Section("Provenance", "provenance", facts=more.facts),
        Section("Files", "files", links=FILES),
    ]
    subject = more.facts.get("environment", "")
    text = page_text("Leaderboard", subject, [board.conditions], sections)
    write_atomically(folder / "leaderboard.html", text.encode())
    return folder / "leaderboard.html"
