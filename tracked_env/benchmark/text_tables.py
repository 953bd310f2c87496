"""Tables of text, rows of cells with the header first: aligned for a terminal, or as Markdown."""

from collections.abc import Sequence


def aligned(rows: Sequence[Sequence[str]], names: int = 2) -> str:
    """A table for the terminal: the first `names` columns left, the others right.

    Of these names, what the row above has as well is left out, but for the last.
    """
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
