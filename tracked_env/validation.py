"""Checks of everything that enters from outside; all raise ValueError in one manner.

A message says quantity, value, allowed range and the likely cause:
    cohesion = -3.0 Pa; must be in [0, 1e+06] Pa. Did you pass kPa, or change the sign?
"""

import difflib
import json
import math
import zipfile
from collections.abc import Iterable, Mapping
from numbers import Integral, Real
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.parameters import RANGES, ParametersRead, Range

CONTROL_PERIOD = Range(1e-4, 1.0, "s", "Did you pass a rate or milliseconds?")
VEHICLES = Range(1, 10**7, "-", "It is the number of vehicles.")
LARGEST = 2**28  # [bytes] that an archive may unpack to
DEEPEST = 64  # [-] levels of JSON
SIGMA = Range(0.0, 1e4, "its SI unit", "Did you pass a variance or degrees?")


def alternatives(name: object, allowed: Iterable[str]) -> str:
    """What an error says of a name that does not exist: those that do, and the nearest one."""
    names = sorted(allowed)
    near = difflib.get_close_matches(str(name), names, n=1)
    hint = f" Did you mean '{near[0]}'?" if near else ""
    return f"known are {names}.{hint}"


def unknown(what: str, name: object, allowed: Iterable[str]) -> ValueError:
    """The error for a name that does not exist, with the nearest ones that do."""
    return ValueError(f"unknown {what} {name!r}; {alternatives(name, allowed)}")


def checked_keys(what: str, value: object, allowed: Iterable[str]) -> Mapping[str, Any]:
    """`value` as a mapping whose keys are all allowed; None counts as empty."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise ValueError(f"{what} = {value!r}; must be a dict. Did you pass the value itself?")
    names = list(allowed)
    for key in value:
        if key not in names:
            raise unknown(what + " key", key, names)
    return value


def checked_choice(what: str, value: object, allowed: Iterable[str]) -> str:
    """`value` when it is one of the allowed names."""
    names = list(allowed)
    if value not in names:
        raise unknown(what, value, names)
    return str(value)


def checked_number(what: str, value: object, allowed: Range) -> float:
    """`value` as a float inside its range. Booleans, strings, arrays and NaN are refused."""
    low, high, unit, hint = allowed
    unit = "" if unit == "-" else f" {unit}"
    rule = f"must be a number in [{low:g}, {high:g}]{unit}. {hint}"
    if isinstance(value, bool) or not isinstance(value, Real):
        shape = getattr(value, "shape", None)
        of = f" of shape {shape}" if shape else ""
        raise ValueError(f"{what} = {value!r}{of}; {rule}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or not low <= number <= high:
        raise ValueError(f"{what} = {number!r}{unit}; {rule}")
    return number


def checked_interval(what: str, value: object, allowed: Range) -> tuple[float, float]:
    """[low, high] as two floats inside the range, low <= high."""
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        raise ValueError(f"{what} = {value!r}; must be [low, high], two numbers. Did you pass one?")
    low, high = (checked_number(what, bound, allowed) for bound in value)
    if low > high:
        raise ValueError(f"{what} = [{low:g}, {high:g}]; low must be <= high. Are they swapped?")
    return low, high


def checked_whole(what: str, value: object, allowed: Range) -> int:
    """`value` as an int inside its range; 64.0 is a whole number, 1.5 and True are not."""
    number = checked_number(what, value, allowed)
    if not number.is_integer():
        raise ValueError(
            f"{what} = {number!r}; must be a whole number in [{allowed.low:g}, {allowed.high:g}]. "
            f"{allowed.hint}"
        )
    return int(value) if isinstance(value, Integral) else int(number)


def checked_flag(what: str, value: object) -> bool:
    """`value` when it is True or False: "no" and 0 are neither."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(
            f"{what} = {value!r}; must be True or False. Did you pass text or a number?"
        )
    return bool(value)


def checked_parameter(name: str, value: object) -> float:
    """A parameter of vehicle, soil or lateral model inside its physical range."""
    if name not in RANGES:
        raise unknown("parameter", name, RANGES)
    return checked_number(name, value, RANGES[name])


def checked_effect(what: str, name: str, value: object, reads: ParametersRead) -> None:
    """Raises ValueError if the plant does not read the parameter `name`."""
    if name not in reads.names:
        raise ValueError(
            f"{what} {name} = {value!r}; the {reads.plant} does not read it, so it would change "
            f"nothing: must be one of {sorted(reads.names)}. Did you mean another plant, drive or "
            "lateral model?"
        )


def parsed_json(text: str) -> Any:
    """The value of JSON. Raises ValueError for other text, and where it is nested too deeply."""

    def depth(value: Any) -> int:
        parts = value.values() if isinstance(value, dict) else value
        return 1 + max(map(depth, parts), default=0) if isinstance(value, (dict, list)) else 0

    try:
        value = json.loads(text)
        deep = depth(value) > DEEPEST
    except RecursionError:
        deep = True
    if deep:
        raise ValueError(f"JSON of more than {DEEPEST} levels; must be nested less deeply")
    return value


def name_or_json(text: str | None, what: str) -> str | Mapping[str, Any] | None:
    """`text` itself, or the JSON object that it holds or, as FILE.json, names; what: the option.

    Raises ValueError, and OSError for a file that cannot be read.
    """
    is_file = text is not None and text.endswith(".json")
    if text is None or not (is_file or text.lstrip().startswith("{")):
        return text
    try:
        text = Path(text).read_text(encoding="utf-8-sig") if is_file else text
    except UnicodeDecodeError as error:
        raise ValueError(f"--{what} {text}: not a JSON object ({error})") from error
    try:
        return dict(parsed_json(text))
    except (ValueError, TypeError) as error:
        raise ValueError(f"--{what} {text:.100}: not a JSON object ({error})") from error


def plain_arrays(file: str | Path | IO[bytes], largest: int = LARGEST) -> dict[str, NDArray[Any]]:
    """The arrays of an npz file, which runs no code. largest: [bytes] that it may unpack to.

    Raises ValueError for any other content, for pickled objects, and before it unpacks too much.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            check_unpacked(archive, largest)
        if not isinstance(file, (str, Path)):
            file.seek(0)
        with np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception as error:  # a damaged file raises what happens to go wrong
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(f"not an npz file of plain arrays, or damaged ({reason})") from error


def check_unpacked(archive: zipfile.ZipFile, largest: int = LARGEST) -> None:
    """Raise ValueError if the files of an archive have more than `largest` bytes together."""
    size = sum(entry.file_size for entry in archive.infolist())
    if size > largest:
        raise ValueError(f"it unpacks to {size} bytes; must be at most {largest} bytes")
