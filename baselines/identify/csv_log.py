"""Cells of a CSV file as numbers: encoding, separator, decimal sign, header.

Separator and decimal sign are decided by all lines of the file, since the first ones may be whole
numbers. Files may be packed with gzip; lines that begin with # or % are comments. `numpy.loadtxt`
reads what it can, about nine times as fast as cell by cell.

Columns of numbers by name, out of a CSV file, in any common unit, and checks of their size.

The cells come from `csv_cells`. The first line is a header if any of its cells is no number; a name
there may carry its unit, `speed [rpm]`, and so may a line of units below it. Without a header
columns are told apart by their position, counted from 1. A cell that is empty or no number is NaN,
and so is what a truncated line lacks.

The rows of a log on a grid of steps of one length.

Writes what the sensors of an environment say as a CSV log, as a vehicle of a user would.

Columns are those that `tracked-env identify` reads, one row a control step. A sensor without a new
sample leaves its cells empty; a delay is taken off, so that every row is of one moment.
"""

import csv
import gzip
import math
import re
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env import arrays
from tracked_env.physics.parameters import PlantParameters
from tracked_env.sensors import CHANNEL_COUNT, CHANNELS, GROUP_START, GROUPS
from tracked_env.validation import unknown

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


Floats = NDArray[np.float64]

# Units of a column by its SI unit: factor from each to SI.
UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "in": 0.0254},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/h": 1.0 / 3.6, "ft/s": 0.3048},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0,
              "rps": 2.0 * math.pi},
    "m/s^2": {"m/s^2": 1.0, "mm/s^2": 1e-3, "g": 9.81},
    "rad/s^2": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180.0},
    "N m": {"N m": 1.0, "Nm": 1.0, "kN m": 1e3, "N cm": 1e-2, "N mm": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "-": {"-": 1.0},
}  # fmt: skip
SHARE = 99.0  # [%] of the values are looked at: a few outliers say nothing of the unit
FASTER = 1.5  # [-] times the limit of a sprocket, which brakes downhill too
SPELLED = {"°": "deg", "°/s": "deg/s", "m/s²": "m/s^2", "m/s2": "m/s^2", "rad/s²": "rad/s^2",
           "rad/s2": "rad/s^2", "r/min": "rpm", "1/min": "rpm", "µs": "us"}  # fmt: skip


class Column(NamedTuple):
    """A column that a command reads."""

    name: str
    unit: str  # SI, a key of UNITS
    largest: float  # [SI] magnitude that all but a few values stay below
    meaning: str
    needed: bool = True
    others: tuple[str, ...] = ()  # further names of a header that mean the same


class Table(NamedTuple):
    """Columns by name in SI units, (N,) each, and what was noticed."""

    values: dict[str, Floats]
    truncated: int  # lines with fewer cells than the others
    unreadable: int  # cells that are no numbers
    said: str  # how the file was read, one line
    faults: tuple[str, ...] = ()  # the first lines that could not be read, a sentence each


def pairs(text: str, what: str) -> dict[str, str]:
    """{name: value} of "name=value,name=value". Raises ValueError; what: the option."""
    found: dict[str, str] = {}
    for part in filter(None, (one.strip() for one in text.split(","))):
        name, equals, value = part.partition("=")
        if not (equals and name.strip() and value.strip()):
            raise ValueError(f"{what}: {part!r}; must be NAME=VALUE, separated by commas")
        if name.strip() in found:
            raise ValueError(
                f"{what}: {name.strip()} stands there twice, as {found[name.strip()]!r} and "
                f"{value.strip()!r}; must be named once"
            )
        found[name.strip()] = value.strip()
    return found


def _named(cell: str) -> tuple[str, str]:
    """Name and unit ("" if none) of a cell of the header."""
    found = re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]", cell.strip())
    name, unit = (found[1], found[2]) if found else (cell.strip(), "")
    return name.strip().lower().replace(" ", "_"), SPELLED.get(unit, unit)


def _place(
    column: Column, header: Sequence[str], given: Mapping[str, str], width: int, path: Path
) -> int | None:
    """Where a column is; None where it is not. Raises ValueError for a wrong mapping."""
    if (wanted := given.get(column.name)) is not None:
        if wanted.lower() in header:
            return _only(wanted.lower(), column, header, path)
        if wanted.isdigit() and 1 <= int(wanted) <= width:
            return int(wanted) - 1
        if wanted.isdigit():
            raise ValueError(
                f"--columns {column.name}={wanted}: {path} has {width} columns; must be in "
                f"[1, {width}]. Positions are counted from 1"
            )
        raise unknown(f"column of {path}", wanted, header or ["(it has no header)"])
    known = [name for name in (column.name, *column.others) if name in header]
    return _only(known[0], column, header, path) if known else None


def _only(name: str, column: Column, header: Sequence[str], path: Path) -> int:
    """Where a name of the header is. Raises ValueError for one that stands there twice."""
    places = [k for k, one in enumerate(header) if one == name]
    if len(places) > 1:
        raise ValueError(
            f"{path} has {len(places)} columns {name}, at the positions "
            f"{', '.join(str(k + 1) for k in places)}; must be one. Choose it with "
            f"--columns {column.name}={places[0] + 1}"
        )
    return places[0]


def _factor(column: Column, given: Mapping[str, str], headed: str) -> float:
    """From the unit of the file to SI. Raises ValueError for a unit of something else."""
    side = re.sub(r"_(left|right)$", "", column.name)
    unit = given.get(column.name, given.get(side, headed or column.unit))
    unit = SPELLED.get(unit, unit)
    if unit not in UNITS[column.unit]:
        raise unknown(f"unit of {column.name}", unit, UNITS[column.unit])
    return UNITS[column.unit][unit]


def check_size(column: Column, values: Floats, path: Path) -> None:
    """Raise ValueError where values are larger than any vehicle's, naming the likely unit."""
    finite = np.abs(values[np.isfinite(values)])
    largest = float(np.percentile(finite, SHARE)) if len(finite) else 0.0
    if largest <= column.largest:
        return
    fitting = [
        unit for unit, factor in UNITS[column.unit].items()
        if factor < 1.0 and largest * factor <= column.largest
    ]  # fmt: skip
    likely = (
        f"Is it in {' or '.join(fitting[:2])}? Then --units {column.name}={fitting[0]}"
        if fitting
        else "Is it another column?"
    )
    raise ValueError(
        f"{path}: {column.name} reaches {largest:.4g} {column.unit}; must be within "
        f"{column.largest:g} {column.unit}. {likely}"
    )


def check_speeds(speeds: ArrayLike, vehicle: PlantParameters, path: Path) -> None:
    """Raise ValueError where sprockets [rad/s] run faster than those of the vehicle can."""
    found = np.abs(np.asarray(speeds, dtype=np.float64))
    largest = float(np.nanpercentile(found, SHARE)) if np.isfinite(found).any() else 0.0
    limit = vehicle.sprocket_speed_limit
    if largest > FASTER * limit:
        raise ValueError(
            f"{path}: sprockets reach {largest:.4g} rad/s; must be within {FASTER:g} times the "
            f"sprocket_speed_limit of the vehicle, {limit:g} rad/s. Are they speeds of motors "
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
    names = [column.name for column in columns]
    both = {re.sub(r"_(left|right)$", "", name) for name in names}
    for name in mapping:
        if name not in names:
            raise unknown("--columns name", name, names)
    for name in units:
        if name not in names and name not in both:
            raise unknown("--units name", name, sorted({*names, *both}))
    cells = read_cells(path)
    header = [_named(cell) for cell in cells.header]
    if cells.units:
        header = [(n, unit or _named(f"[{below}]" if below[:1] not in "[(" else below)[1])
                  for (n, unit), below in zip(header, cells.units, strict=True)]  # fmt: skip
    whole = cells.numbers
    if not len(whole):
        raise ValueError(f"{path} has a header and no numbers. Was the export interrupted?")
    width = whole.shape[1]
    if not header and not mapping:
        if width != len(order):
            raise ValueError(
                f"{path} has no header and {width} columns; without --columns must be "
                f"{len(order) or 'named'}{': ' + ', '.join(order) if order else ''}"
            )
        mapping = {name: str(place + 1) for place, name in enumerate(order)}
    known = [name for name, _ in header]
    places = {c.name: _place(c, known, mapping, width, path) for c in columns}
    lacking = [c.name for c in columns if c.needed and places[c.name] is None]
    if lacking:
        raise ValueError(
            f"{path} lacks {', '.join(lacking)}; its columns are {', '.join(known) or width}. Map "
            f"them with --columns {lacking[0]}=NAME, a name of its header or a position from 1"
        )
    users: dict[int, str] = {}
    for name in mapping:
        place = places[name]
        if place is not None and users.setdefault(place, name) != name:
            raise ValueError(
                f"--columns: {users[place]} and {name} are both column {mapping[name]} of {path}; "
                "must be two columns"
            )
    values = {}
    for column in columns:
        if (place := places[column.name]) is not None:
            factor = _factor(column, units, header[place][1] if header else "")
            values[column.name] = factor * whole[:, place]
            check_size(column, values[column.name], path)
    said = f"{len(whole)} lines, {cells.separator}, {'a' if header else 'no'} header"
    at = {place: name for name, place in places.items() if place is not None}
    faults = tuple(
        f"Line {line}: {at[place]} is {text[:30]!r}, which is no number."
        for line, place, text in cells.unreadable if place in at
    )  # fmt: skip
    return Table(values, cells.truncated, len(cells.unreadable), said, faults)


def table_of(columns: Sequence[Column]) -> str:
    """The columns for --help: name, unit, meaning."""
    width = max(len(column.name) for column in columns)
    return "\n".join(
        f"  {c.name:<{width}}  [{c.unit}]{'' if c.needed else ' optional:'} {c.meaning}"
        for c in columns
    )


EVEN = 0.1  # [-] of a step: farther off the grid in more than one row of a hundred is uneven
STEPS = (1e-3, 0.2)  # [s] of a log
LEAST = 5.0  # [s] a log lasts at least
LOST = 0.1  # [-] share of rows with a wrong time that is too much
JUMP = 60.0  # [s] between two rows: a longer one is no gap of a log, but another clock


def in_order(values: dict[str, Floats], path: Path) -> tuple[dict[str, Floats], int]:
    """Rows whose time rises, and how many were left out."""
    time = values["time"]
    known = np.isfinite(time)
    latest = np.maximum.accumulate(np.where(known, time, -math.inf))
    late = time > np.concatenate([[-math.inf], latest[:-1]])
    # One row ahead of all others would leave out the others: then it is that row.
    earliest = np.minimum.accumulate(np.where(known, time, math.inf)[::-1])[::-1]
    early = time < np.concatenate([earliest[1:], [math.inf]])
    rising = known & (late if late.sum() >= early.sum() else early)
    dropped = int(len(time) - rising.sum())
    if dropped > LOST * len(time):
        raise ValueError(
            f"{path}: in {dropped} of {len(time)} rows the time does not rise; must be less than "
            f"{LOST:.0%}. Are several logs in one file, or is `time` another column?"
        )
    rows = np.flatnonzero(rising)
    gaps = np.diff(time[rows])
    if len(gaps) and (longest := float(gaps.max())) > JUMP:
        at = int(np.argmax(gaps))
        raise ValueError(
            f"{path}: the clock jumps by {longest:.4g} s between the rows {rows[at] + 1} and "
            f"{rows[at + 1] + 1}; must be {JUMP:g} s or less. Was the clock set while logging? "
            "Then cut the log there"
        )
    return {name: column[rows] for name, column in values.items()}, dropped


def middle_step(time: Floats, path: Path) -> float:
    """Median [s] between two rows. Raises ValueError for one that no log has, and a short log."""
    middle = float(np.median(np.diff(time))) if len(time) > 1 else math.nan
    if not STEPS[0] <= middle <= STEPS[1]:
        likely = [u for u, f in UNITS["s"].items() if STEPS[0] <= middle * f <= STEPS[1]]
        advice = f" Is the time in {likely[0]}? Then --units time={likely[0]}" if likely else ""
        allowed = f"[{STEPS[0]:g}, {STEPS[1]:g}] s"
        raise ValueError(f"{path}: a row every {middle:.3g} s; must be in {allowed}.{advice}")
    if (lasts := float(time[-1] - time[0])) < LEAST:
        raise ValueError(f"{path} lasts {lasts:.3g} s; must be {LEAST:g} s or more")
    return middle


def on_grid(
    values: dict[str, Floats], path: Path, notes: list[str]
) -> tuple[float, dict[str, Floats], NDArray[np.bool_]]:
    """(step [s], columns (T,), (T,) whether a row is there)."""
    time = values["time"] - values["time"][0]
    values = {name: column for name, column in values.items() if name != "time"}
    gaps, middle = np.diff(time), middle_step(time, path)
    period = float(np.mean(gaps[gaps < 1.5 * middle]))
    place = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(gaps / period), 1.0))])
    off = np.abs(gaps / period - np.maximum(np.round(gaps / period), 1.0))
    even = np.mean(off > EVEN) < 0.01
    count = int(place[-1]) + 1 if even else int(time[-1] / period) + 1
    seen = np.zeros(count, dtype=bool)
    grid = {}
    if even:
        where = place.astype(np.int64)
        seen[where] = True
        for name, column in values.items():
            grid[name] = np.full(count, math.nan)
            grid[name][where] = column
    else:
        at = period * np.arange(count)
        nearest = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
        seen = time[nearest] - time[nearest - 1] < 2.5 * period
        for name, column in values.items():
            grid[name] = np.where(seen, np.interp(at, time, column), math.nan)
    lost = int(count - seen.sum())
    notes.append(
        f"{count} steps of {1e3 * period:.4g} ms, {'as logged' if even else 'resampled'}"
        + (f", {lost} of them without a row" if lost else "")
        + ("." if even else ": rows are unevenly spaced, and were interpolated linearly.")
    )
    return period, grid, seen


IDENTIFIED = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance",
              "effort_maximum", "shear_deformation_modulus")  # fmt: skip


def record_log(
    env: Any, policy: Any, path: Path | str, seed: int | None = None
) -> dict[str, float]:
    """Drive one episode and write its log; returns the true values at its end, SI by name.

    env: an environment of this package, single or a vector of one, perhaps wrapped. policy: any
    object with `predict(observation, state, episode_start)`, as Stable-Baselines3 has it.
    Raises ValueError for a vector of several vehicles.
    """
    return record_logs(env, policy, [path], seed)[0]


def record_logs(
    env: Any, policy: Any, paths: Sequence[Path | str], seed: Any = None
) -> list[dict[str, float]]:
    """The same for each vehicle of a vector environment; seed: as its `reset` takes it.

    Raises ValueError for another number of vehicles than of paths.
    """
    inner = env.unwrapped
    batch, count = inner.simulation.batch, len(paths)
    if len(batch.floats) != count:
        raise ValueError(f"the environment has {len(batch.floats)} vehicles, for {count} logs")
    observation, _ = env.reset(seed=seed)
    period = inner.simulation.solver.control_period
    rows = [[_row(batch, i, period)] for i in range(count)]
    state, start, over = None, np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    while not over.all():
        action, state = policy.predict(observation, state, start)
        observation, _reward, terminated, truncated, _info = env.step(action)
        for i in np.flatnonzero(~over).tolist():
            rows[i].append(_row(batch, i, period))
        over |= np.asarray(terminated) | np.asarray(truncated)
        start = np.zeros(count, dtype=bool)
    for path, log in zip(map(Path, paths), rows, strict=True):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time", *CHANNELS])
            writer.writerows(log)
    places = [arrays.COLUMN[name] for name in IDENTIFIED]
    return [
        dict(zip(IDENTIFIED, batch.floats[i, places].tolist(), strict=True)) for i in range(count)
    ]


def _row(batch: Any, i: int, period: float) -> list[str]:
    """Time and samples of vehicle i; empty where a group has no new one."""
    step = int(batch.counters[i, arrays.STEP])
    samples = batch.floats[i, arrays.SAMPLE : arrays.SAMPLE + CHANNEL_COUNT]
    taken = batch.floats[i, arrays.SAMPLE + CHANNEL_COUNT : arrays.SAMPLE + CHANNEL_COUNT + 3]
    new = [
        round(float(taken[group])) == step
        for group in range(len(GROUPS))
        for _ in range(GROUP_START[group + 1] - GROUP_START[group])
    ]
    cells = [f"{value:.9g}" if is_new else "" for value, is_new in zip(samples, new, strict=True)]
    return [f"{step * period:.6f}", *cells]
