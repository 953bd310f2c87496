"""The experiments of the two papers, run again with the project's own models, a page for each: its
claims beside what comes out, figures and tables.

The words of a page stand in the `page.toml` of the paper's folder, its numbers come from the runs:
    head      title, conditions, and what is not covered
    claims    place in the paper, what it claims, what comes out (`ours`) and why, with {names} of
              the values of an `Outcome`; `each`: text of one of its `rows`, all of them are {lines}
    tables    title, text, names of the columns (`head`), and the cells of a row by its names
    figures   captions, in the order of the page
    names     of conditions, in tables
Texts are filled in as by `str.format`, with two more formats: `percent` and a factor, `100*.2f`.
"""

import string
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

from tracked_env.benchmark.figures import DPI, REFERENCE_COLOUR, STYLE, WIDTH
from tracked_env.benchmark.table_model import aligned, markdown_rows

Cells = list[str]  # of one line of a table
Say = Callable[[str], None]

REFERENCE: dict[str, Any] = {  # line of a reference in a figure
    "color": REFERENCE_COLOUR,
    "linewidth": 4.0,
    "alpha": 0.45,
    "label": "reference",
}


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


class Texts(string.Formatter):
    """`str.format` with the formats of this file's header."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """One value."""
        if format_spec == "percent":
            return percent(value)
        factor, star, plain = format_spec.rpartition("*")
        return format(float(factor) * value if star else value, plain)


def fill(text: str, values: Mapping[str, Any]) -> str:
    """A text of page.toml with values in place of its names."""
    return Texts().vformat(text, (), values)


def claims_table(claims: Sequence[Claim]) -> list[Cells]:
    """One line per claim, the header first."""
    head = ["place", "claim of the paper", "our number", "agrees?", "why / conditions"]
    return [head, *(list(claim) for claim in claims)]


@dataclass(frozen=True)
class PaperPage:
    """What the page of one paper is made of; results are those of the paper's `run_everything`.

    words: content of page.toml. outcomes: of the results. tables: of the results, by key; each row
    is the values of its cells, or finished cells. drawings: of the results, figures by key.
    constants: numbers that the texts of tables name.
    """

    name: str
    words: Mapping[str, Any]
    outcomes: Callable[[Any], Iterable[Outcome]]
    tables: Mapping[str, Callable[[Any], Iterable[Mapping[str, Any] | Cells]]]
    drawings: Sequence[Callable[[Any], dict[str, Figure]]]
    constants: Mapping[str, Any] = field(default_factory=dict)

    def claims(self, results: Any) -> list[Claim]:
        """All, in the order of the paper."""
        claims = []
        for key, agrees, values in self.outcomes(results):
            texts = self.words["claims"][key]
            lines = "; ".join(fill(texts["each"], row) for row in values.get("rows", ()))
            place, claim, ours, why = (
                fill(texts[part], {**values, "lines": lines})
                for part in ("place", "claim", "ours", "why")
            )
            claims.append(Claim(place, claim, ours, agrees, why))
        return claims

    def table(self, key: str, results: Any) -> list[Cells]:
        """A table, the header first."""
        words = self.words["tables"][key]
        lines = (
            row if isinstance(row, list) else [fill(cell, row) for cell in words["cells"]]
            for row in self.tables[key](results)
        )
        return [list(words["head"]), *lines]

    def markdown(self, results: Any, figures: Sequence[str] = ()) -> str:
        """The page. figures: keys of those that are linked."""
        rows = claims_table(self.claims(results))
        parts = [self.words["head"], "## Claims\n", markdown_rows(rows, names=len(rows[0])) + "\n"]
        captions = self.words["figures"]
        links = [f"![{key}]({self.name}-{key}.png)\n\n{captions[key]}\n" for key in figures]
        parts += ["## Figures\n", *links] if links else []
        parts.append("## Tables\n")
        for key, words in self.words["tables"].items():
            text, table = fill(words["text"], self.constants), self.table(key, results)
            parts.append(f"### {words['title']}\n\n{text}\n\n{markdown_rows(table)}\n")
        return "\n".join(parts)

    def write(self, results: Any, folder: Path, draw: bool = True) -> list[Path]:
        """Write page.md and the figures beside it. Returns the files."""
        folder.mkdir(parents=True, exist_ok=True)
        figures: dict[str, Figure] = {}
        with matplotlib.rc_context(STYLE):
            for drawings in self.drawings if draw else ():
                figures |= drawings(results)
            keys = [key for key in self.words["figures"] if key in figures]
            files = [folder / "page.md", *(folder / f"{self.name}-{key}.png" for key in keys)]
            for key, file in zip(keys, files[1:], strict=True):
                figures[key].savefig(file)
        files[0].write_text(self.markdown(results, keys), encoding="utf-8")
        return files


def words_of(package: str) -> dict[str, Any]:
    """The page.toml of a paper; package: the file of its `__init__`."""
    return tomllib.loads(Path(package).with_name("page.toml").read_text(encoding="utf-8"))


def terminal(claims: Sequence[Claim], width: int = 118) -> str:
    """The claims as a table that fits a terminal; the reasons are on the page only."""
    rows = [["place", "claim of the paper", "here", "agrees?"], *(list(c[:4]) for c in claims)]
    place = max(len(row[0]) for row in rows)
    free = width - 8 - place - 12
    limits = (place, int(0.42 * free), free - int(0.42 * free), 12)
    lines = []
    for row in rows:
        cells = [textwrap.wrap(*pair) or [""] for pair in zip(row, limits, strict=True)]
        height = max(len(cell) for cell in cells)
        lines += [[cell[k] if k < len(cell) else "" for cell in cells] for k in range(height)]
    return aligned(lines, names=4)


# What the figures of the papers share


def panels(height: float, rows: int, columns: int, **shared: Any) -> tuple[Figure, Any]:
    """A figure of this height [inch] and its axes (rows, columns).

    shared: further arguments of `Figure.subplots`.
    """
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def legend_below(figure: Figure, axes: Any, columns: int = 0) -> None:
    """One legend for all axes, made of the lines of these; in a row, or in so many columns."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns or len(labels))


def label_all(axes: Sequence[Any], texts: Mapping[str, Sequence[str] | str]) -> None:
    """Set properties (title, xlabel, ylabel) of axes: one text for all, or one for each."""
    for k, panel in enumerate(axes):
        panel.set(
            **{name: text if isinstance(text, str) else text[k] for name, text in texts.items()}
        )


def surfaces(
    height: float,
    rows: int,
    titles: Sequence[str],
    labels: tuple[str, str],
    view: Mapping[str, float],
) -> tuple[Figure, list[Any]]:
    """A figure of surfaces in space with a title each, in rows; labels: of both axes."""
    figure = Figure(figsize=(WIDTH, height), dpi=DPI)
    figure.subplots_adjust(left=0.0, right=0.95, bottom=0.06, top=0.95, wspace=0.06, hspace=0.06)
    axes = []
    for k, title in enumerate(titles):
        panel: Any = figure.add_subplot(rows, len(titles) // rows, k + 1, projection="3d")
        panel.set_title(title, y=0.97)
        panel.set_xlabel(labels[0], labelpad=-2.0)
        panel.set_ylabel(labels[1], labelpad=-2.0)
        panel.tick_params(pad=-1.0)
        panel.locator_params(nbins=4)
        panel.view_init(**view)
        panel.set_box_aspect(None, zoom=0.85)
        axes.append(panel)
    return figure, axes


def main(paper: str, output: Path = Path("results"), figures: bool = True) -> int:
    """Run a paper, print its claims beside what comes out, write OUTPUT/PAPER/page.md.

    paper: a package beside this file. figures: draw them. Returns the exit status.
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
    print(f"page.md and {len(files) - 1} figures in {folder}; {time.perf_counter() - began:.0f} s")
    return 0
