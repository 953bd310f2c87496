"""Columns of numbers by name, out of a CSV file, in any common unit, and checks of their size.

The cells come from `csv_cells`. The first line is a header if any of its cells is no number; a name
there may carry its unit, `speed [rpm]`, and so may a line of units below it. Without a header
columns are told apart by their position, counted from 1. A cell that is empty or no number is NaN,
and so is what a truncated line lacks.
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.cli.user_data.csv_cells import read_cells
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import unknown

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
