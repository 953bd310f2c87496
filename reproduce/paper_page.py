"""The page of a paper: its claims beside what comes out, figures and tables.

The words of a page stand in the `page.toml` of the paper's folder, its numbers come from the runs:
    head      title, conditions, and what is not covered
    claims    place in the paper, what it claims, what comes out (`ours`) and why, with {names} of
              the values of an `Outcome`, as `str.format` has them
    tables    title, text, and the names of the columns
    figures   captions, in the order of the page
The page is Markdown, and HTML where markdown-it is installed.
"""

import math
import textwrap
import time
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.figure import Figure

from tracked_env.benchmark.figures import DPI, REFERENCE_COLOUR, STYLE
from tracked_env.benchmark.table_model import aligned, markdown_rows

Rows = list[list[str]]  # of a table
Say = Callable[[str], None]

PAPERS = ("strawa2021", "focchi2025")  # packages beside this file
REFERENCE: dict[str, Any] = {  # line of a reference in a figure
    "color": REFERENCE_COLOUR, "linewidth": 4.0, "alpha": 0.45, "label": "reference",
}  # fmt: skip
HTML = """<meta charset="utf-8"><style>
body { font: 15px/1.45 sans-serif; max-width: 72em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; display: block; overflow-x: auto; font-size: 13px; }
td, th { border: 1px solid #ccc; padding: 0.25em 0.5em; text-align: left; vertical-align: top; }
img { max-width: 100%; }
</style>
"""


class Outcome(NamedTuple):
    """What the runs say of a claim."""

    key: str  # of the claim in page.toml
    agrees: str
    values: Mapping[str, Any] = {}


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


def claims_table(claims: Sequence[Claim]) -> Rows:
    """One line per claim, the header first."""
    head = ["place", "claim of the paper", "our number", "agrees?", "why / conditions"]
    return [head, *(list(claim) for claim in claims)]


def panels(size: tuple[float, float], rows: int, columns: int, **shared: Any) -> tuple[Figure, Any]:
    """A figure of size (width, height) [inch] and its axes (rows, columns).

    shared: further arguments of `Figure.subplots`.
    """
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


@dataclass(frozen=True)
class PaperPage:
    """What the page of one paper is made of; results are those of the paper's `run_everything`.

    words: content of page.toml. claims: of the results. tables: rows without header, by key.
    drawings: of the results, figures by key. constants: numbers that the texts of tables name.
    """

    name: str
    words: Mapping[str, Any]
    outcomes: Callable[[Any], Iterable[Outcome]]
    tables: Mapping[str, Callable[[Any], Rows]]
    drawings: Sequence[Callable[[Any], dict[str, Figure]]]
    constants: Mapping[str, Any] = field(default_factory=dict)

    def claims(self, results: Any) -> list[Claim]:
        """All, in the order of the paper."""
        claims = []
        for key, agrees, values in self.outcomes(results):
            texts = self.words["claims"][key]
            place, claim, ours, why = (
                texts[part].format_map(values) for part in ("place", "claim", "ours", "why")
            )
            claims.append(Claim(place, claim, ours, agrees, why))
        return claims

    def table(self, key: str, results: Any) -> Rows:
        """A table, the header first."""
        return [list(self.words["tables"][key]["head"]), *self.tables[key](results)]

    def markdown(self, results: Any, figures: Sequence[str] = ()) -> str:
        """The page. figures: keys of those that are linked."""
        rows = claims_table(self.claims(results))
        parts = [self.words["head"], "## Claims\n", markdown_rows(rows, names=len(rows[0])) + "\n"]
        if figures:
            parts.append("## Figures\n")
            captions = self.words["figures"]
            parts += [f"![{key}]({self.name}-{key}.png)\n\n{captions[key]}\n" for key in figures]
        parts.append("## Tables\n")
        for key, words in self.words["tables"].items():
            text = words["text"].format_map(self.constants)
            rows = self.table(key, results)
            parts.append(f"### {words['title']}\n\n{text}\n\n{markdown_rows(rows)}\n")
        return "\n".join(parts)

    def write(self, results: Any, folder: Path, draw: bool = True) -> list[Path]:
        """Write page.md, figures beside it, and page.html if possible. Returns the files."""
        folder.mkdir(parents=True, exist_ok=True)
        figures: dict[str, Figure] = {}
        with matplotlib.rc_context(STYLE):
            for drawings in self.drawings if draw else ():
                figures |= drawings(results)
            shown = [key for key in self.words["figures"] if key in figures]
            for key in shown:
                figures[key].savefig(folder / f"{self.name}-{key}.png")
        text = self.markdown(results, shown)
        files = [folder / "page.md", *(folder / f"{self.name}-{key}.png" for key in shown)]
        files[0].write_text(text, encoding="utf-8")
        page = html(text)
        if page is not None:
            files.insert(1, folder / "page.html")
            files[1].write_text(page, encoding="utf-8")
        return files


def words_of(package: str) -> dict[str, Any]:
    """The page.toml of a paper; package: the file of its `__init__`."""
    text = Path(package).with_name("page.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def html(text: str) -> str | None:
    """Markdown as HTML; None when markdown-it is not installed."""
    try:
        from markdown_it import MarkdownIt
    except ImportError:
        return None
    return HTML + str(MarkdownIt("commonmark").enable("table").render(text))


def terminal(claims: Sequence[Claim], width: int = 118) -> str:
    """The claims as a table that fits a terminal; the reasons are on the page only."""
    head = ["place", "claim of the paper", "here", "agrees?"]
    rows = [head, *([claim.place, claim.claim, claim.ours, claim.agrees] for claim in claims)]
    free = width - 8 - max(len(row[0]) for row in rows) - 12
    limits = [math.inf, int(0.42 * free), free - int(0.42 * free), 12]
    lines = []
    for row in rows:
        cells = [
            [cell] if limit == math.inf else textwrap.wrap(cell, int(limit)) or [""]
            for cell, limit in zip(row, limits, strict=True)
        ]
        height = max(len(cell) for cell in cells)
        lines += [[cell[k] if k < len(cell) else "" for cell in cells] for k in range(height)]
    return aligned(lines, names=len(head))


def main(paper: str, output: Path = Path("results"), figures: bool = True) -> int:
    """Run a paper of PAPERS, print its claims beside what comes out, write OUTPUT/PAPER/page.md.

    figures: draw them. Returns the exit status.
    """
    began = time.perf_counter()
    folder = output / paper
    folder.mkdir(parents=True, exist_ok=True)  # before minutes of work: it may be refused

    def say(text: str) -> None:
        print(f"{time.perf_counter() - began:5.0f} s  {text}", flush=True)

    package = import_module(f"reproduce.{paper}")
    results = package.run_everything(say)
    say("page")
    files = package.PAGE.write(results, folder, figures)
    print(f"\n{terminal(package.PAGE.claims(results))}\n")
    names = ", ".join(file.name for file in files if file.suffix != ".png")
    images = sum(file.suffix == ".png" for file in files)
    print(f"{names} and {images} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0
