"""Columns of numbers by name, out of a CSV file, in any common unit, and checks of their size.

Separator and decimal sign are decided by all lines of the file, since the first ones may be whole
numbers. Files may be packed with gzip; lines that begin with # or % are comments. The first line is
a header if any cell is no number; a name there may carry its unit, `speed [rpm]`, and so may
a line of units below it. Without a header columns are told apart by their position, counted from 1.
A cell that is empty or no number is NaN, and so is what a truncated line lacks.
"""

import csv
import gzip
import math
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import unknown

Floats = NDArray[np.float64]
Columns = dict[str, Floats]  # (N,) each, by name

LARGEST_FILE = 2_000_000_000  # [bytes], unpacked
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
ALIKE = 0.5  # [-] share of the lines that have the usual number of separators, at least
UNIT = re.compile(r"[\[(]?[a-zA-Zµ°%/^²³0-9 ·*-]{0,12}[\])]?")

# Units of a column by its SI unit: factor from each to SI.
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "in": 0.0254},
    "rad": {"rad": 1.0, "deg": math.pi / 180},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6, "ft/s": 0.3048},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30, "rps": 2.0 * math.pi},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": GRAVITY},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180},
    "N m": {"N m": 1.0, "Nm": 1.0, "kN m": 1e3, "N cm": 1e-2, "N mm": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "-": {"-": 1.0},
}
SPELLED = {"°": "deg", "°/s": "deg/s", "m/s²": "m/s^2", "m/s2": "m/s^2", "µs": "us"}
SPELLED |= {"rad/s²": "rad/s^2", "rad/s2": "rad/s^2", "r/min": "rpm", "1/min": "rpm"}
PERCENTILE = 99.0  # [%] of the values are looked at: a few outliers say nothing of the unit
ALIKE_RATIO = (0.7, 1.4)  # [-] within it a ratio is explained
SPEED_MARGIN = 1.5  # [-] times the limit of a sprocket, which brakes downhill too


class Column(NamedTuple):
    """A column that a command reads."""

    name: str
    unit: str  # SI, a key of UNITS
    largest: float  # [SI] magnitude that all but a few values stay below
    meaning: str
    needed: bool = True
    synonyms: str = ""  # further names of a header that mean the same, between blanks


class Table(NamedTuple):
    """Columns by name in SI units, (N,) each, and what was noticed."""

    values: Columns
    truncated: int  # lines with fewer cells than the others
    unreadable: int  # cells that are no numbers
    summary: str  # how the file was read, one line
    faults: tuple[str, ...] = ()  # the first lines that could not be read, a sentence each


class Cells(NamedTuple):
    """A file of N lines with W columns."""

    header: list[str]  # (W,) names, or none
    units: list[str]  # (W,) that the header has, or the line below it; "" where there is none
    numbers: Floats  # (N, W), NaN where a cell is empty or no number
    truncated: int  # lines with fewer cells than the others
    unreadable: list[tuple[int, int, str]]  # line of the file, column, text of what is no number
    separator: str


# --- the cells of a file --------------------------------------------------------------------


def _text(path: Path) -> str:
    """The text of a file in UTF-8 or UTF-16, packed or not. Raises ValueError for another one."""
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    try:
        with gzip.open(path) if packed else path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(f"this is a damaged gzip file: {error}") from error
    if len(data) > LARGEST_FILE:
        raise ValueError(f"more than {LARGEST_FILE:.2g} bytes; must be fewer. Cut the file")
    utf_16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    return data.decode("utf-16" if utf_16 else "utf-8-sig", errors="replace")


def read_cells(path: Path) -> Cells:
    """The cells of a file. Raises ValueError for an empty one, and one that can mean two things."""
    lines = enumerate(re.split("\r\n|\n|\r", _text(path)), 1)
    body = [(number, line) for number, line in lines if re.match(r"\s*[^\s#%]", line)]
    declared = re.fullmatch(r"\"?sep=(.)\"?", body[0][1].strip()) if body else None  # Excel
    body = body[1:] if declared else body
    if not body:
        raise ValueError("the file is empty; must be lines of numbers. Was the export interrupted?")
    separator = declared[1] if declared else _separator([line for _, line in body])
    first = body[0][1].strip()
    header, names, units = _split([first], separator)[0], list[str](), list[str]()
    if any(map(_is_text, header)):  # it may stand there again, where files were joined
        body = [(number, line) for number, line in body[1:] if line.strip() != first]
        while not header[-1]:  # a separator at the end of the line
            header.pop()
        below = [cell for _, line in body[:1] for cell in _split([line], separator)[0]]
        words = any(below) and all(not cell or _is_text(cell) for cell in below)
        if words and all(map(UNIT.fullmatch, below)):
            body = body[1:]
        else:
            below = []
        named = [_name_and_unit(cell) for cell in header]
        names, own = [name for name, _ in named], [unit for _, unit in named]
        both = zip_longest(own, below[: len(own)], fillvalue="")
        units = [unit or cell.strip("[]() ") for unit, cell in both]
    table = _numbers(body, separator, len(names))
    return Cells(names, units, *table, SEPARATORS.get(separator, repr(separator)))


def _name_and_unit(cell: str) -> tuple[str, str]:
    """Name and unit ("" if none) of a cell of the header."""
    parts = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", cell)
    name, unit = (parts[1], parts[2]) if parts else (cell, "")
    return name.strip().lower().replace(" ", "_"), unit


def _separator(lines: list[str]) -> str:
    """The mark that stands as often in most lines."""
    for mark in (";", "\t", "|"):
        common, lines_with = Counter(line.count(mark) for line in lines).most_common(1)[0]
        if common > 0 and lines_with > ALIKE * len(lines):
            return mark
    # `0,02 1,5` has decimal commas between blanks, `0.02, 1.5` commas.
    by_blanks = sum(bool(re.search(r"[\d.\"]\s+[-+.\d\"]", line)) for line in lines)
    comma = sum("," in line for line in lines)
    return "," if comma > ALIKE * len(lines) and by_blanks <= ALIKE * len(lines) else " "


def _split(lines: list[str], separator: str) -> list[list[str]]:
    """Cells of each line, without blanks around them."""
    if separator == " ":
        return [line.split() for line in lines]
    rows = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    return [[cell.strip() for cell in row] for row in rows]


def _number(cell: str) -> float | None:
    """The number in a cell with either decimal sign, NaN of an empty one, None of text."""
    try:
        return float(cell.replace(",", ".")) if cell else math.nan
    except ValueError:
        return None


def _is_text(cell: str) -> bool:
    return _number(cell) is None


def _numbers(
    body: list[tuple[int, str]], separator: str, width: int
) -> tuple[Floats, int, list[tuple[int, int, str]]]:
    """(numbers (N, W), truncated lines, what is no number) of numbered lines."""
    rows = _split([line for _, line in body], separator)
    usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    if rows and not any(row[-1] for row in rows if len(row) == usual):  # ends with separators
        rows, usual = [row[:-1] if len(row) == usual else row for row in rows], usual - 1
    if width and usual > width:
        raise ValueError(
            f"the header has {width} cells and most lines have {usual}; must be as many. "
            "Are there decimal commas between commas? Export with semicolons"
        )
    width = width or usual
    table = np.full((len(rows), width), math.nan)
    signs, unreadable = set[str](), []
    for k, row in enumerate(rows):
        for at, cell in enumerate(row[:width]):
            value = _number(cell)
            if value is None:
                unreadable.append((body[k][0], at, cell))
            else:
                table[k, at] = value
                signs |= {sign for sign in ".," if sign in cell}
    if len(signs) > 1:
        raise ValueError(
            "there are numbers with decimal points and numbers with decimal commas; must be one "
            "of the two. Were files of two programs joined?"
        )
    return table, sum(len(row) < width for row in rows), unreadable


# --- columns by name ------------------------------------------------------------------------


def pairs(text: str, option: str) -> dict[str, str]:
    """{name: value} of "name=value,name=value". Raises ValueError."""
    parsed: dict[str, str] = {}
    for part in filter(None, (word.strip() for word in text.split(","))):
        name, equals, value = (word.strip() for word in part.partition("="))
        if not (equals and name and value):
            raise ValueError(f"{option}: {part!r}; must be NAME=VALUE, separated by commas")
        if name in parsed:
            twice = f"as {parsed[name]!r} and {value!r}"
            raise ValueError(f"{option}: {name} stands there twice, {twice}; must be named once")
        parsed[name] = value
    return parsed


def _place(
    column: Column, header: Sequence[str], mapping: Mapping[str, str], width: int
) -> int | None:
    """Where a column is; None where it is not. Raises ValueError for a wrong mapping, and for a
    name of the header that stands there twice."""
    choice = mapping.get(column.name)
    if choice is None:
        names = [name for name in (column.name, *column.synonyms.split()) if name in header][:1]
    elif choice.lower() in header:
        names = [choice.lower()]
    elif choice.isdigit():
        if not 1 <= int(choice) <= width:
            raise ValueError(
                f"--columns {column.name}={choice}: the file has {width} columns; must be in "
                f"[1, {width}]. Positions are counted from 1"
            )
        return int(choice) - 1
    else:
        raise unknown("column of the file", choice, header or ["(it has no header)"])
    places = [place for place, name in enumerate(header) if [name] == names]
    if len(places) > 1:
        raise ValueError(
            f"there are {len(places)} columns {names[0]}, at the positions "
            f"{', '.join(str(place + 1) for place in places)}; must be one. Choose it with "
            f"--columns {column.name}={places[0] + 1}"
        )
    return places[0] if places else None


def side_name(name: str) -> str:
    """The name without its side: `torque` of `torque_left`."""
    return re.sub(r"_(left|right)$", "", name)


def _factor(column: Column, units: Mapping[str, str], header_unit: str) -> float:
    """From the unit of the file to SI. Raises ValueError for a unit of something else."""
    unit = units.get(column.name, units.get(side_name(column.name), header_unit or column.unit))
    unit = SPELLED.get(unit, unit)
    if unit not in UNITS[column.unit]:
        raise unknown(f"unit of {column.name}", unit, UNITS[column.unit])
    return UNITS[column.unit][unit]


def _largest(values: Floats) -> float:
    """Magnitude that all but a few values stay below, 0 without a number."""
    finite = np.abs(values[np.isfinite(values)])
    return float(np.percentile(finite, PERCENTILE)) if len(finite) else 0.0


def explained(factor: float) -> bool:
    """Whether a ratio, times the factor of a unit, is about 1: the unit explains it."""
    return ALIKE_RATIO[0] < factor < ALIKE_RATIO[1]


def unit_advice(
    names: str, unit: str, fits: Callable[[float], bool], otherwise: str = "Is it another column?"
) -> str:
    """The unit other than SI whose factor fits, as options of columns; else `otherwise`."""
    likely = [u for u, factor in UNITS[unit].items() if factor != 1.0 and fits(factor)]
    if not likely:
        return otherwise
    options = ",".join(f"{name}={likely[0]}" for name in names.split())
    return f"Is it in {' or '.join(likely[:2])}? Then --units {options}"


def _check_size(column: Column, values: Floats) -> None:
    """Raise ValueError where values are larger than any vehicle's, naming the likely unit."""
    largest = _largest(values)
    if largest > column.largest:
        raise ValueError(
            f"{column.name} reaches {largest:.4g} {column.unit}; must be within "
            f"{column.largest:g} {column.unit}. "
            + unit_advice(column.name, column.unit, lambda f: largest * f <= column.largest)
        )


@contextmanager
def errors_of(path: Path) -> Iterator[None]:
    """ValueErrors with the name of the file."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def check_speeds(speeds: ArrayLike, vehicle: PlantParameters) -> None:
    """Raise ValueError where sprockets [rad/s] run faster than those of the vehicle can."""
    largest, limit = _largest(np.asarray(speeds, dtype=float)), vehicle.sprocket_speed_limit
    if largest > SPEED_MARGIN * limit:
        raise ValueError(
            f"sprockets reach {largest:.4g} rad/s; must be within {SPEED_MARGIN:g} times "
            f"the sprocket_speed_limit of the vehicle, {limit:g} rad/s. Are they speeds of motors "
            "(--gear RATIO), in rpm or deg/s (--units sprocket_speed=rpm), or is the vehicle "
            "another one (--vehicle)?"
        )


def read(
    path: Path,
    columns: Sequence[Column],
    mapping: Mapping[str, str],
    units: Mapping[str, str],
    order: Sequence[str] = (),
) -> Table:
    """The columns of a file, those that are not there left out.

    mapping: name or position of columns in the file. units: of columns, or of both sides of a pair
    (`torque=N m`). order: names by position, for a file without header and mapping.
    Raises ValueError for a file that lacks a needed column, and for a column of implausible size.
    """
    names = {column.name for column in columns}
    sides = names | {side_name(name) for name in names}
    for option, words, allowed in (("columns", mapping, names), ("units", units, sides)):
        for name in words:
            if name not in allowed:
                raise unknown(f"--{option} name", name, sorted(allowed))
    cells = read_cells(path)
    header, (lines, width) = cells.header, cells.numbers.shape
    if not lines:
        raise ValueError("there is a header and no number. Was the export interrupted?")
    if not header and not mapping:
        if width != len(order):
            raise ValueError(
                f"there is no header, and there are {width} columns; without --columns must be "
                f"{len(order) or 'named'}{': ' + ', '.join(order) if order else ''}"
            )
        mapping = {name: str(place + 1) for place, name in enumerate(order)}
    places = {c.name: _place(c, header, mapping, width) for c in columns}
    lacking = [c.name for c in columns if c.needed and places[c.name] is None]
    if lacking:
        raise ValueError(
            f"the file lacks {', '.join(lacking)}; its columns are {', '.join(header) or width}. "
            f"Map them with --columns {lacking[0]}=NAME, a name of its header or a position from 1"
        )
    mapped: dict[int, str] = {}
    values: Columns = {}
    for column in columns:
        name, place = column.name, places[column.name]
        if place is None:
            continue
        if name in mapping and mapped.setdefault(place, name) != name:
            raise ValueError(
                f"--columns: {mapped[place]} and {name} are both column {mapping[name]}; "
                "must be two columns"
            )
        factor = _factor(column, units, cells.units[place] if header else "")
        values[name] = factor * cells.numbers[:, place]
        _check_size(column, values[name])
    names_by_place = {place: name for name, place in places.items()}
    faults = tuple(
        f"Line {line}: {names_by_place[place]} is {text[:30]!r}, which is no number."
        for line, place, text in cells.unreadable
        if place in names_by_place
    )
    summary = f"{lines} lines, {cells.separator}, {'a' if header else 'no'} header"
    return Table(values, cells.truncated, len(cells.unreadable), summary, faults)


def table_of(columns: Sequence[Column]) -> str:
    """The columns for --help: name, unit, meaning."""
    width = max(len(column.name) for column in columns)
    return "\n".join(
        f"  {c.name:<{width}}  [{c.unit}]{'' if c.needed else ' optional:'} {c.meaning}"
        for c in columns
    )
