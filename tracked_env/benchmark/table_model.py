"""One table, as text of a terminal, as Markdown, and as a part of a page of HTML.

A table is rows of cells, the header first; its first columns name a row. `rows_of` makes the rows
from one function per column. A page is one file that needs no other one and asks for none; it is
filled by a template, and one short script sorts and filters its tables.

A ratio r is coloured by x = ln r / (|ln r| + ln SOFT): blue below 1, red above, white at 1; the
slope is largest at 1, where the leaders differ, and no finite ratio reaches the end of the scale.
"""

import html
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracked_env.benchmark.statistics import Estimate

TEMPLATES = Path(__file__).with_name("templates")
SOFT = 1.25  # [-] ratio at half of the colour scale
BLUE, WHITE, RED = (np.array(c, np.float64) for c in ((20, 88, 160), (255,) * 3, (172, 50, 14)))
# Columns of a page that hold names, and the beginnings of those that hold verdicts.
NAMES = {"agent", "policy", "set", "parameter", "filter", "worst set", "training"}
VERDICTS = ("clearly", "than ")
# What ends a cell or a line of Markdown, or starts HTML, code or a link.
_MARKUP = {"\\": "\\\\", "|": "\\|", "`": "\\`", "&": "&amp;", "<": "&lt;", "]": "\\]"}


class Cell(NamedTuple):
    """One cell; `number` sorts it on a page, None of text."""

    text: str
    number: float | None = None
    kind: str = ""  # class of the style sheet
    more: tuple[str, ...] = ()  # lines below the text, on a page
    colours: tuple[str, str] | None = None  # of background and text

    def __str__(self) -> str:
        return self.text


class Table(NamedTuple):
    """A table with what explains it."""

    title: str
    rows: Sequence[Sequence[str | Cell]]  # the header first
    names: int = 1  # leading columns that name a row, of which a page keeps two in view at most
    notes: Sequence[str] = ()  # below it

    @property
    def texts(self) -> list[list[str]]:
        """All cells as text."""
        return [[str(cell) for cell in row] for row in self.rows]

    @property
    def head(self) -> list[str]:
        """Names of the columns of a page, with the signs of their units: µs, m/s²."""
        return [name.replace("[us]", "[µs]").replace("^2", "²") for name in self.texts[0]]

    @property
    def body(self) -> list[list[Cell]]:
        """Rows of a page."""
        kinds = [_kind(name) for name in self.texts[0]]
        return [
            [c if isinstance(c, Cell) else kind(c) for kind, c in zip(kinds, row, strict=True)]
            for row in self.rows[1:]
        ]


class Drawing(NamedTuple):
    """A figure of a page; a folded one is opened by its title."""

    title: str
    caption: str
    svg: str
    folded: bool = False


class Section(NamedTuple):
    """A part of a page."""

    title: str
    anchor: str
    tables: Sequence[Table] = ()
    figures: Sequence[Drawing] = ()
    facts: Mapping[str, str] = {}
    links: Mapping[str, str] = {}
    notes: Sequence[str] = ()  # sentences


def rows_of(
    columns: Mapping[str, Callable[..., str | Cell]], items: Iterable[Any]
) -> list[list[str | Cell]]:
    """Rows of a table, the header first; columns: by its name what the cell of an item is."""
    return [[*columns], *([cell(item) for cell in columns.values()] for item in items)]


def between(estimate: Estimate, digits: int = 3, seeds: int = 0) -> str:
    """Value and interval; the value alone of an agent with one seed."""
    value, low, high = (f"{number:.{digits}f}" for number in estimate)
    return value if seeds == 1 else f"{value} [{low}, {high}]"


def aligned(rows: Sequence[Sequence[str]], names: int = 2, width: int | None = None) -> str:
    """A table for the terminal: the first `names` columns left, the others right.

    Of these names, what the row above has as well is left out, but for the last. A table that is
    wider than `width` is folded: several tables below each other, each with the names.
    """
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    blocks = [[*range(names)]]  # columns of each table
    for column in range(names, len(widths)):
        wide = sum(widths[i] + 2 for i in blocks[-1]) + widths[column]
        if width is not None and wide > width and len(blocks[-1]) > names:
            blocks.append([*range(names)])
        blocks[-1].append(column)
    tables = []
    for block in blocks:
        lines = []
        for above, row in zip([[], *rows], rows, strict=False):
            cells = [
                "" if i < names - 1 and row[: i + 1] == above[: i + 1] else row[i] for i in block
            ]
            padded = (
                cell.ljust(widths[i]) if i < names else cell.rjust(widths[i])
                for i, cell in zip(block, cells, strict=True)
            )
            lines.append("  ".join(padded).rstrip())
        lines.insert(1, "-" * len(lines[0]))
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def folded(text: str, width: int) -> str:
    """Text in lines of at most `width`; a line after a colon and one with a star stay lines."""
    paragraphs = re.sub(r"(?<!:)\n(?!\*)", " ", text).split("\n")
    return "\n".join(
        textwrap.fill(part, width, break_long_words=False, break_on_hyphens=False)
        for part in paragraphs
    )


def terminal(tables: Sequence[Table], width: int = 80) -> str:
    """Tables as plain text of at most `width` columns; wider ones are folded."""
    parts = []
    for t in tables:
        parts += [aligned(t.texts, t.names, width), *(folded(note, width) for note in t.notes)]
    return "\n\n".join(parts)


def markdown_rows(rows: Sequence[Sequence[str]], names: int = 2) -> str:
    """A Markdown table: the first `names` columns left, the others right."""
    head, *body = ([escaped(cell) for cell in row] for row in rows)
    rule = ["--" if i < names else "--:" for i in range(len(head))]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, rule, *body])


def markdown(tables: Sequence[Table]) -> str:
    """Tables as Markdown."""
    parts = []
    for t in tables:
        notes = ("\n".join(map(escaped, note.split("\n"))) for note in t.notes)
        parts += [markdown_rows(t.texts, t.names), *(n.replace("\n*", "\n\n\\*") for n in notes)]
    return "\n\n".join(parts) + "\n"


def escaped(text: str) -> str:
    """Text that Markdown shows as it is, in one line; brackets stay where they cannot be a link."""
    marks = _MARKUP if "](" in text else {**_MARKUP, "]": "]"}
    return "".join(marks.get(c, c) if c.isprintable() else " " for c in text)


def number_cell(text: str) -> Cell:
    """A cell of text, sorted by the number that it begins with."""
    number = re.match(r"[~<>]?(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)", text)
    return Cell(text, float(number[1]) if number else None)


def verdict_cell(text: str) -> Cell:
    """A verdict in colour; the word says the same."""
    first = text.partition(",")[0].partition(" ")[0]
    return Cell(text, kind={"better": "better", "worse": "worse", "loses": "worse"}.get(first, ""))


def _kind(column: str) -> Callable[[str], Cell]:
    """What makes the cells of a column of a page."""
    if column in NAMES:
        return lambda text: Cell(text, kind="name")
    return verdict_cell if column.startswith(VERDICTS) else number_cell


def colour(ratio: float) -> tuple[str, str]:
    """Background and text colour of a ratio of errors."""
    step = math.log(min(max(ratio, 1e-9), 1e9))
    x = step / (abs(step) + math.log(SOFT))
    mixed = (WHITE + abs(x) * ((BLUE if x < 0.0 else RED) - WHITE)).round()
    linear = np.where(mixed <= 10.31, mixed / 3294.6, ((mixed / 255 + 0.055) / 1.055) ** 2.4)
    light = float(linear @ (0.2126, 0.7152, 0.0722))  # relative luminance
    # Contrast is (light + 0.05) / 0.05 with black and 1.05 / (light + 0.05) with white.
    text = "#000" if (light + 0.05) ** 2 > 1.05 * 0.05 else "#fff"
    return "#" + "".join(f"{int(part):02x}" for part in mixed), text


# What a figure inside a page takes over from it: colours of text, grid and background.
_OF_PAGE = {"#000000": "currentColor", "#262626": "currentColor"}
_OF_PAGE |= {"#e6e6e6": "var(--grid)", "#ffffff": "none"}


def inline_svg(text: str, title: str) -> str:
    """An SVG file as an element of HTML; black, white and the grid follow the page's colours."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r' xmlns(?::\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r' id="\w+_\d+"', "", text)  # the same in every figure
    for colour_of_file, colour_of_page in _OF_PAGE.items():
        text = text.replace(colour_of_file, colour_of_page)
    label = html.escape(title, quote=True)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}" fill="currentColor"', 1)


def page_text(
    title: str,
    subject: str,
    introduction: Sequence[str],
    parts: Sequence[Section],
    filter_by: str = "agent, set or verdict",
) -> str:
    """A whole page, "TITLE of SUBJECT"; introduction: its first paragraphs. Empty parts are left
    out."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    loader = FileSystemLoader(TEMPLATES)
    blocks: Any = {"trim_blocks": True, "lstrip_blocks": True}
    engine = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, **blocks)
    return engine.get_template("leaderboard.html").render(
        title=title,
        subject=subject,
        introduction=introduction,
        sections=[s for s in parts if any(s[2:])],
        filter=filter_by,
        css=Markup((TEMPLATES / "page.css").read_text(encoding="utf-8")),
        script=Markup((TEMPLATES / "page.js").read_text(encoding="utf-8")),
    )
