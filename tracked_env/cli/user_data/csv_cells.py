"""Cells of a CSV file as numbers: encoding, separator, decimal sign, header.

Separator and decimal sign are decided by all lines of the file, since the first ones may be whole
numbers. Files may be packed with gzip; lines that begin with # or % are comments. `numpy.loadtxt`
reads what it can, about nine times as fast as cell by cell.
"""

import csv
import gzip
import math
import re
import zlib
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LARGEST = 2_000_000_000  # [bytes] of a file, unpacked
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
ALIKE = 0.5  # [-] share of the lines that have the usual number of separators, at least
NUMBER = re.compile(r"[-+]?(\d[\d., \u00a0\u202f'’]*|\.\d+|,\d+)(e[-+]?\d+)?|[-+]?(nan|inf)", re.I)  # noqa: RUF001
UNIT = re.compile(r"[\[(]?[a-zA-Zµ°%/^²³0-9 ·*-]{0,12}[\])]?")


class Cells(NamedTuple):
    """A file of N lines with W columns."""

    header: list[str]  # (W,), or none
    units: list[str]  # (W,) of the line below the header, or none
    numbers: NDArray[np.float64]  # (N, W), NaN where a cell is empty or no number
    truncated: int  # lines with fewer cells than the others
    unreadable: list[tuple[int, int, str]]  # line of the file, column, text of what is no number
    separator: str


def text_of(path: Path) -> str:
    """The text of a file in UTF-8 or UTF-16, packed or not. Raises ValueError for another one."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    try:
        with gzip.open(path) if packed else path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"{path} is a damaged gzip file: {error}") from error
    if len(data) > LARGEST:
        raise ValueError(f"{path} has more than {LARGEST:.2g} bytes; must be fewer. Cut the log")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    zeros = [data[k:2000:2].count(0) for k in (0, 1)]
    if max(zeros) > len(data[:2000]) // 4:
        return data.decode("utf-16-le" if zeros[1] > zeros[0] else "utf-16-be", errors="replace")
    return data.decode("utf-8-sig", errors="replace")


def read_cells(path: Path) -> Cells:
    """The cells of a file. Raises ValueError for an empty one, and one that can mean two things."""
    lines, numbers = [], []  # and the numbers of the lines in the file
    for number, line in enumerate(re.split("\r\n|\n|\r", text_of(path)), 1):
        if line.strip() and line.lstrip()[0] not in "#%":
            lines.append(line)
            numbers.append(number)
    if lines and (declared := re.fullmatch(r"\"?sep=(.)\"?", lines[0].strip())):  # Excel
        lines, numbers = lines[1:], numbers[1:]
    if not lines:
        raise ValueError(f"{path} is empty; must be lines of numbers. Was the export interrupted?")
    separator = declared[1] if declared else _separator(lines)
    first = _split(lines[:1], separator)[0]
    headed = any(_is_text(cell) for cell in first)
    header = [cell.strip() for cell in first] if headed else []
    while header and not header[-1]:  # a separator at the end of the line
        header.pop()
    body, numbers = (lines[1:], numbers[1:]) if headed else (lines, numbers)
    if headed:  # the header again, where files were joined
        rest = [k for k, line in enumerate(body) if line.strip() != lines[0].strip()]
        body, numbers = [body[k] for k in rest], [numbers[k] for k in rest]
    units: list[str] = []
    if header and body:
        second = [cell.strip() for cell in _split(body[:1], separator)[0]]
        if any(map(_is_text, second)) and all(UNIT.fullmatch(c) for c in second) and not any(
            NUMBER.fullmatch(c) for c in second
        ):  # fmt: skip
            units = [*second, *[""] * len(header)][: len(header)]
            body, numbers = body[1:], numbers[1:]
    table = _numbers(body, separator, len(header), numbers, path)
    return Cells(header, units, *table, SEPARATORS.get(separator, repr(separator)))


def _is_text(cell: str) -> bool:
    return bool(cell.strip()) and not NUMBER.fullmatch(cell.strip())


def _separator(lines: list[str]) -> str:
    """The mark that stands as often in most lines."""
    for mark in (";", "\t", "|"):
        common, lines_with = Counter(line.count(mark) for line in lines).most_common(1)[0]
        if common > 0 and lines_with > ALIKE * len(lines):
            return mark
    # `0,02 1,5` has decimal commas between blanks, `0.02, 1.5` commas.
    by_blanks = [bool(re.search(r"[\d.\"]\s+[-+.\d\"]", line)) for line in lines]
    comma = sum("," in line for line in lines)
    if comma > ALIKE * len(lines) and sum(by_blanks) <= ALIKE * len(lines):
        return ","
    return " "


def _split(lines: list[str], separator: str) -> list[list[str]]:
    if separator == " ":
        return [line.split() for line in lines]
    return list(csv.reader(lines, delimiter=separator, skipinitialspace=separator != "\t"))


def _numbers(
    body: list[str], separator: str, width: int, numbers: list[int], path: Path
) -> tuple[NDArray[np.float64], int, list[tuple[int, int, str]]]:
    """(numbers (N, W), truncated lines, what is no number)."""
    plain = not any('"' in line for line in body)
    joined = "\n".join(body)
    if plain and separator != "," and "," in joined and "." not in joined:
        joined = joined.replace(",", ".")
    if plain and (separator == "," or "," not in joined):
        whole = _at_once(joined, separator)
        if whole is not None and (not width or whole.shape[1] == width):
            return whole, 0, []
    rows = _split(body, separator)
    usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    if rows and all(not row[-1].strip() for row in rows if len(row) == usual):
        rows, usual = [row[:-1] if len(row) == usual else row for row in rows], usual - 1
    if width and usual > width:
        raise ValueError(
            f"{path}: the header has {width} cells and most lines have {usual}; must be as many. "
            "Are there decimal commas between commas? Export with semicolons"
        )
    width = width or usual
    decimal = _decimal(rows, separator, path)
    whole = np.full((len(rows), width), math.nan)
    truncated, unreadable = 0, []
    for number, row in enumerate(rows):
        truncated += len(row) < width
        for at, cell in enumerate(row[:width]):
            value = _number(cell, decimal)
            if value is None:
                unreadable.append((numbers[number], at, cell.strip()))
            else:
                whole[number, at] = value
    return whole, truncated, unreadable


def _at_once(text: str, separator: str) -> NDArray[np.float64] | None:
    """The numbers by `numpy.loadtxt`, empty cells NaN; None where it cannot."""
    mark = None if separator == " " else separator
    if mark is not None:
        between = rf"(?:(?<=^)|(?<={re.escape(mark)}))[^\S\n\t]*(?={re.escape(mark)}|$)"
        text = re.sub(between, "nan", text, flags=re.MULTILINE)
    try:
        whole = np.loadtxt(text.split("\n"), delimiter=mark, comments=None, ndmin=2)
    except ValueError:
        return None
    if whole.shape[1] > 1 and np.isnan(whole[:, -1]).all():
        return None  # a separator at the end of every line
    return np.asarray(whole, dtype=np.float64)


def _decimal(rows: list[list[str]], separator: str, path: Path) -> str:
    """The decimal sign of all cells. Raises ValueError where it may be either."""
    point = comma = 0
    unclear = ""
    for row in rows:
        for cell in row:
            if "," not in cell:
                point += bool(re.search(r"\d\.\d{0,2}($|e)|\d\.\d{4,}|\.\d+\.|^\D?\d{4,}\.", cell))
            elif "." in cell:
                point, comma = (point + (cell.rfind(".") > cell.rfind(",")),
                                comma + (cell.rfind(",") > cell.rfind(".")))  # fmt: skip
            elif re.fullmatch(r"[-+]?[1-9]\d{0,2}(,\d{3})+", cell.strip()):
                unclear = unclear or cell
            else:
                comma += 1
    if point and comma:
        raise ValueError(
            f"{path} has numbers with decimal points and numbers with decimal commas; must be one "
            "of the two. Were files of two programs joined?"
        )
    if unclear and not (point or comma):
        comma = 1 if separator != "," else 0
    return "," if comma else "."


def _number(cell: str, decimal: str = ".") -> float | None:
    """The number in a cell, NaN of an empty one, None of text."""
    cell = cell.strip()
    if not cell:
        return math.nan
    if not NUMBER.fullmatch(cell):
        return None
    cell = re.sub(r"[ \u00a0\u202f'’]", "", cell)  # noqa: RUF001  of thousands
    cell = cell.replace("." if decimal == "," else ",", "").replace(decimal, ".")
    try:
        return float(cell)
    except ValueError:
        return None
