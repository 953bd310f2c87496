"""Tables of text, rows of cells with the header first: for a terminal, as Markdown, for a page."""

import re
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

from tracked_env.benchmark.figures import Mark


def aligned(rows: Sequence[Sequence[str]], names: int = 2, width: int | None = None) -> str:
    """A table for the terminal: the first `names` columns left, the others right.

    Of these names, what the row above has as well is left out, but for the last. A table that is
    wider than `width` is folded: several tables below each other, each with the names.
    """
    if width is not None:
        blocks = _blocks(rows, names, width)
        return "\n\n".join(aligned([[r[i] for i in of] for r in rows], names) for of in blocks)
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    before: Sequence[str] = ()
    for number, row in enumerate(rows):
        cells = list(row)
        for i in range(names - 1):
            if row[: i + 1] == before[: i + 1]:
                cells[i] = ""
        before = row
        parts = [c.ljust(w) for c, w in zip(cells[:names], widths[:names], strict=True)]
        parts += [c.rjust(w) for c, w in zip(cells[names:], widths[names:], strict=True)]
        lines.append("  ".join(parts).rstrip())
        if number == 0:
            lines.append("-" * len(lines[0]))
    return "\n".join(lines)


def _blocks(rows: Sequence[Sequence[str]], names: int, width: int) -> list[list[int]]:
    """Columns of the tables that a table is folded into; each has one beside the names."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    first = list(range(names))
    blocks = [[*first]]
    for column in range(names, len(widths)):
        wide = sum(widths[i] + 2 for i in blocks[-1]) + widths[column]
        if wide > width and len(blocks[-1]) > names:
            blocks.append([*first])
        blocks[-1].append(column)
    return blocks


def folded(text: str, width: int) -> str:
    """Text in lines of at most `width`; a line after a colon and one with a star stay lines."""
    for line in ("\n*", ":\n"):
        text = text.replace(line, line.replace("\n", "\0"))
    paragraphs = (" ".join(part.split("\n")) for part in text.split("\0"))
    return "\n".join(
        textwrap.fill(part, width, break_long_words=False, break_on_hyphens=False)
        for part in paragraphs
    )


def markdown_rows(rows: Sequence[Sequence[str]], names: int = 2) -> str:
    """The same as a Markdown table."""
    head, *body = ([escaped(cell) for cell in row] for row in rows)
    rule = ["--" if i < names else "--:" for i in range(len(head))]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, rule, *body])


# What ends a cell or a line, or starts HTML, code or a link.
_MARKUP = {"\\": "\\\\", "|": "\\|", "`": "\\`", "&": "&amp;", "<": "&lt;", "]": "\\]"}


def escaped(text: str) -> str:
    """Text that Markdown shows as it is, in one line; brackets stay where they cannot be a link."""
    marks = _MARKUP if "](" in text else {**_MARKUP, "]": "]"}
    return "".join(marks.get(c, c) if c.isprintable() else " " for c in text)


def escaped_lines(text: str) -> str:
    """The same of every line of a text."""
    return "\n".join(map(escaped, text.split("\n")))


class Cell(NamedTuple):
    """One cell of a table; `number` sorts it, None of text."""

    text: str
    number: float | None = None
    kind: str = ""  # class of the style sheet
    more: tuple[str, ...] = ()  # lines below the text
    colours: tuple[str, str] | None = None  # of background and text
    mark: Mark | None = None


class Table(NamedTuple):
    """A table of the page; the first `pinned` columns stay in view."""

    caption: str
    head: list[str]
    rows: list[list[Cell]]
    pinned: int
    notes: list[str]


def unit_signs(text: str) -> str:
    """The head of a column with the signs of its units: µs, m/s²."""
    return text.replace("[us]", "[µs]").replace("^2", "²")


def cell(text: str, kind: str = "") -> Cell:
    """A cell of text, sorted by the number that it begins with."""
    found = re.match(r"[~<>]?(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)", text)
    return Cell(text, float(found[1]) if found else None, kind)


def verdict_cell(text: str) -> Cell:
    """A verdict in colour; the word says the same."""
    first = text.partition(",")[0].partition(" ")[0]
    kind = {"better": "better", "worse": "worse", "loses": "worse", "NO": ""}.get(first, "")
    return Cell(text, None, kind)


def plain_table(
    caption: str, rows: Sequence[Sequence[str]], front: Sequence[int], notes: Sequence[str]
) -> Table:
    """A table of text with the columns `front` first, which stay in view."""
    order = [*front, *(i for i in range(len(rows[0])) if i not in front)]
    head = [unit_signs(rows[0][i]) for i in order]
    texts = {"agent", "policy", "set", "parameter", "filter", "worst set", "training"}
    words = ("clearly", "than ")
    body = [
        [
            Cell(row[i], None, "name") if rows[0][i] in texts
            else verdict_cell(row[i]) if rows[0][i].startswith(words)
            else cell(row[i])
            for i in order
        ]
        for row in rows[1:]
    ]  # fmt: skip
    return Table(caption, head, body, len(front), [note.replace("\n", " ") for note in notes])
