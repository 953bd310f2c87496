"""The page of a paper: its claims beside what comes out, figures and tables.

It is Markdown, and HTML where markdown-it is installed.

Run the experiments of a paper: progress and claims in the terminal, the page as a file.

What the figures of both papers share: axes, the reference line, files; needs matplotlib.
"""

import math
import sys
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import matplotlib
from matplotlib.figure import Figure

from tracked_env.benchmark.figures import DPI, REFERENCE_COLOUR
from tracked_env.benchmark.figures import STYLE as STYLE_drawing
from tracked_env.benchmark.text_tables import aligned, markdown_rows

R = TypeVar("R")


Rows = list[list[str]]  # of a table, header first
Figures = dict[str, tuple[Path, str]]  # {name: (file, caption)}
# results of all experiments of one paper

STYLE = """<meta charset="utf-8"><style>
body { font: 15px/1.45 sans-serif; max-width: 72em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; display: block; overflow-x: auto; font-size: 13px; }
td, th { border: 1px solid #ccc; padding: 0.25em 0.5em; text-align: left; vertical-align: top; }
img { max-width: 100%; }
</style>
"""


class Claim(NamedTuple):
    """One claim of the paper, and whether the runs agree with it."""

    place: str  # in the paper
    claim: str
    ours: str
    agrees: str
    why: str


def percent(value: float) -> str:
    """A share as a percentage: two digits, integers from 10 % on, tiny ones as a bound."""
    share = 100.0 * value
    if 0.0 < abs(share) < 0.001:
        return "below 0.001 %"
    return f"{share:.0f} %" if abs(share) >= 10.0 else f"{share:.2g} %"


def verdict(*agreed: bool) -> str:
    """yes when all agree, no when none does, else partly."""
    return "yes" if all(agreed) else "partly" if any(agreed) else "no"


def claims_table(found: Sequence[Claim]) -> Rows:
    """One line per claim."""
    return [
        ["place", "claim of the paper", "our number", "agrees?", "why / conditions"],
        *(list(claim) for claim in found),
    ]


def html(text: str) -> str | None:
    """Markdown as HTML; None when markdown-it is not installed."""
    try:
        from markdown_it import MarkdownIt
    except ImportError:
        return None
    return STYLE + str(MarkdownIt("commonmark").enable("table").render(text))


@dataclass(frozen=True)
class PaperPage(Generic[R]):
    """What the page of one paper is made of."""

    head: str  # title, conditions, and what is not covered
    claims: Callable[[R], list[Claim]]
    tables: Mapping[str, tuple[Callable[[R], Rows], str]]  # {title: (rows, text above them)}
    save_figures: Callable[[R, Path], Figures]  # to a folder; ImportError without matplotlib

    def markdown(self, results: R, figures: Figures) -> str:
        """The page; figures are linked by their names alone."""
        rows = claims_table(self.claims(results))
        parts = [self.head, "## Claims\n", markdown_rows(rows, names=len(rows[0])) + "\n"]
        if figures:
            parts.append("## Figures\n")
            parts += [
                f"![{name}]({file.name})\n\n{caption}\n"
                for name, (file, caption) in figures.items()
            ]
        parts.append("## Tables\n")
        for title, (table, text) in self.tables.items():
            parts.append(f"### {title}\n\n{text}\n\n{markdown_rows(table(results))}\n")
        return "\n".join(parts)

    def write(self, results: R, folder: Path, draw: bool = True) -> list[Path]:
        """Write page.md, figures beside it, and page.html if possible. Returns the files.

        draw: without figures when False. Raises ImportError when matplotlib is missing.
        """
        folder.mkdir(parents=True, exist_ok=True)
        figures = self.save_figures(results, folder) if draw else {}
        text = self.markdown(results, figures)
        files = [folder / "page.md"]
        files[0].write_text(text, encoding="utf-8")
        page = html(text)
        if page is not None:
            files.append(folder / "page.html")
            files[1].write_text(page, encoding="utf-8")
        return [*files, *(file for file, _ in figures.values())]


def terminal(found: Sequence[Claim], width: int = 118) -> str:
    """The claims as a table that fits a terminal; the reasons are on the page only."""
    rows = [[claim.place, claim.claim, claim.ours, claim.agrees] for claim in found]
    head = ["place", "claim of the paper", "here", "agrees?"]
    return aligned(_wrapped([head, *rows], width), names=len(head))


def _wrapped(rows: Rows, width: int) -> Rows:
    """Cells broken into lines of their own, so that no line is longer than `width`."""
    free = width - 8 - max(len(row[0]) for row in rows) - 12
    limits = [math.inf, int(0.42 * free), free - int(0.42 * free), 12]
    broken = []
    for row in rows:
        cells = [
            [cell] if limit == math.inf else textwrap.wrap(cell, int(limit)) or [""]
            for cell, limit in zip(row, limits, strict=True)
        ]
        height = max(len(cell) for cell in cells)
        broken += [[cell[k] if k < len(cell) else "" for cell in cells] for k in range(height)]
    return broken


PAPERS = ("strawa2021", "focchi2025")  # packages beside this file


def main(paper: str, output: Path = Path("results"), figures: bool = True) -> int:
    """Run a paper of PAPERS, print its claims beside what comes out, write OUTPUT/PAPER/page.md.

    figures: draw them; without matplotlib the page has none. Returns the exit status.
    """
    began = time.perf_counter()
    folder = output / paper
    folder.mkdir(parents=True, exist_ok=True)  # before minutes of work: it may be refused

    def say(text: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {text}", flush=True)

    package = import_module(f"reproduce.{paper}")
    results = package.run_everything(say)
    say("page")
    try:
        files = package.PAGE.write(results, folder, figures)
    except ImportError as error:
        print(f"not drawn: {error}", file=sys.stderr)
        files = package.PAGE.write(results, folder, draw=False)
    print(f"\n{terminal(package.PAGE.claims(results))}\n")
    names = ", ".join(file.name for file in files if file.suffix != ".png")
    drawn = sum(file.suffix == ".png" for file in files)
    print(f"{names} and {drawn} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0


Drawings = dict[str, tuple[Figure, str]]  # {name: (figure, caption)}
# results of all experiments of one paper

REFERENCE: dict[str, Any] = {
    "color": REFERENCE_COLOUR,
    "linewidth": 4.0,
    "alpha": 0.45,
    "label": "reference",
}


def panels(size: tuple[float, float], rows: int, columns: int, **shared: Any) -> tuple[Figure, Any]:
    """A figure of size (width, height) [inch] and its axes (rows, columns).

    shared: further arguments of `Figure.subplots`.
    """
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def save(results: R, folder: Path, paper: str, *draw: Callable[[R], Drawings]) -> Figures:
    """Draw all figures of a paper and write them as PAPER-NAME.png. Returns files and captions."""
    written: Figures = {}
    with matplotlib.rc_context(STYLE_drawing):
        for drawings in draw:
            for name, (figure, caption) in drawings(results).items():
                file = folder / f"{paper}-{name}.png"
                figure.savefig(file)
                written[name] = (file, caption)
    return written
