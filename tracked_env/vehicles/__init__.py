"""Vehicles by name, file or values: each is a vehicle on the soil that its controllers expect.

A vehicle is what `vehicle=` of an environment and `--vehicle` of a command take:
    "focchi"                       a name: of this package, of `register_vehicle`, or of another
                                   package's entry point in the group `tracked_env.vehicles`
    "robots:robot"                 a name that a module registers, which is imported first
    "robot.toml"                   a file, as below
    {"base": "focchi", "mass": 60.0}    the same as values

    # robot.toml
    title = "Delivery robot"       # what it is, optional
    source = "data sheet, 2026"    # where the numbers come from, optional
    base = "focchi"                # whose values hold where none is said; else the environment's;
                                   # a file is looked for beside this one first
    mass = 60.0                    # [kg]
    track_gauge = 0.5              # [m]

The keys are the fields of `PlantParameters`, in SI units. An entry point or `register_vehicle`
names such a file, such values, or `PlantParameters`.
"""

import os
import tomllib
import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from tracked_env.entry_points import declared, registered_name
from tracked_env.physics.parameters import (
    GROUPS,
    PARAMETER_NAMES,
    RANGES,
    VEHICLES,
    PlantParameters,
)
from tracked_env.validation import checked_keys, checked_parameter

GROUP = "tracked_env.vehicles"  # of entry points
FILES = Path(__file__).parent  # of the catalogue, NAME.toml
TEXTS = ("title", "source")  # keys that describe a vehicle
SIZES = ("mass", "contact_length", "track_gauge")
ANOTHER_SIZE = 0.3  # [-] of the base, from which on the rest of the base is unlikely to fit
# What depends on the size of a vehicle; ratios, gains and offsets do not.
SIZED = GROUPS["vehicle"][: GROUPS["vehicle"].index("centre_of_mass_x")]
Spec = str | Path | Mapping[str, Any] | PlantParameters

_registered: dict[str, Spec] = {}


def register_vehicle(name: str, vehicle: Spec) -> None:
    """Give a vehicle a name, by which environments and commands of this process find it.

    vehicle: file, values or parameters, see the head of this module; a file is read at each use.
    Raises ValueError for a name that is taken or looks like a file, and for a vehicle that makes
    no sense.
    """
    if name in vehicle_names() or _is_file(name):
        taken = sorted(vehicle_names())
        raise ValueError(f"vehicle name = {name!r}; must be none of {taken}, and not end in .toml")
    find_vehicle(vehicle)
    if isinstance(vehicle, (str, os.PathLike)) and _is_file(vehicle):
        vehicle = Path(vehicle).resolve()  # whatever the current folder is later
    _registered[name] = vehicle


@cache
def _declared() -> dict[str, Spec | EntryPoint]:
    """The vehicles of this package and of entry points, ours first."""
    others = {entry.name: entry for _, entry in reversed(declared(GROUP))}
    return {**others, **{path.stem: path for path in sorted(FILES.glob("*.toml"))}, **VEHICLES}


def vehicle_names() -> list[str]:
    """The names of all vehicles: of this package, of entry points, registered ones."""
    return [*_declared(), *_registered]


def _is_file(spec: object) -> bool:
    return isinstance(spec, os.PathLike) or str(spec).endswith(".toml")


def beside(file: str | Path | os.PathLike[str], spec: Any) -> Any:
    """A vehicle that `file` names: a file that lies beside it, where there is one, else `spec`."""
    if not isinstance(spec, str) or not _is_file(spec):
        return spec
    path = Path(file).parent / spec
    return str(path) if path.exists() else spec


def _loaded(entry: EntryPoint) -> Spec:
    """What an entry point refers to, or returns if it is a function. Raises ValueError."""
    try:
        vehicle: Any = entry.load()
        return vehicle() if callable(vehicle) else vehicle
    except Exception as error:
        raise ValueError(
            f"vehicle {entry.name!r}: its entry point {entry.value!r} cannot be loaded: {error}"
        ) from error


def vehicle_values(spec: Spec, what: str = "vehicle") -> dict[str, Any]:
    """What is said of a vehicle, of "title", "source", "base" and the parameters.

    spec: as in the head of this module. what: it is, in messages. Values are not checked. Raises
    ValueError for an unknown name or key and for a file that is no TOML; OSError for one that
    cannot be read.
    """
    keys = (*TEXTS, "base", *PARAMETER_NAMES)
    if isinstance(spec, PlantParameters):
        return spec._asdict()
    if isinstance(spec, Mapping):
        return dict(checked_keys(what, spec, keys))
    if _is_file(spec):
        try:
            content = tomllib.loads(Path(spec).read_text(encoding="utf-8-sig"))  # Windows: a BOM
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(
                f"{what} {spec}: no TOML: {error}; must be lines as `mass = 60.0  # [kg]`"
            ) from error
        said = dict(checked_keys(f"{what} {spec}:", content, keys))
        return {**said, "base": beside(spec, said["base"])} if "base" in said else said
    name = registered_name(what, spec, vehicle_names, " A file must end in .toml.")
    entry: Any = (_declared() | _registered)[name]
    return vehicle_values(_loaded(entry) if isinstance(entry, EntryPoint) else entry)


def find_vehicle(spec: Spec, base: Spec = "strawa") -> PlantParameters:
    """Parameters of a vehicle on its soil.

    spec: as in the head of this module. base: where it names none. Warns of parameters that are
    the base's where mass, contact length or gauge are far from the base's. Raises ValueError for
    an unknown name or key, a value outside its range, and bases that name each other; OSError for
    a file that cannot be read.
    """
    return _found(spec, base, ())


def _found(spec: Spec, base: Spec, above: tuple[str, ...]) -> PlantParameters:
    if isinstance(spec, str) and spec in VEHICLES:
        return VEHICLES[spec]
    if isinstance(spec, (str, Path)) and str(spec) in above:
        raise ValueError(f"vehicle base {spec!r}; its own base is, in the end, {spec!r} again")
    said = vehicle_values(spec, "vehicle base" if above else "vehicle")
    base = said.pop("base", base)
    title = "" if isinstance(spec, Mapping) else f" {spec}"
    values = {n: checked_parameter(n, value) for n, value in said.items() if n not in TEXTS}
    if len(values) == len(PARAMETER_NAMES):
        return PlantParameters(**values)
    other = _found(base, "strawa", (*above, str(spec)))
    _warn_of_size(f"vehicle{title}", values, base, other._asdict())
    return other._replace(**values)


def _warn_of_size(
    what: str, values: Mapping[str, float], base: Spec, other: Mapping[str, float]
) -> None:
    """Warn where values are of another size than the base, of which the rest is taken."""
    far = [n for n in SIZES if abs(values.get(n, other[n]) / other[n] - 1.0) > ANOTHER_SIZE]
    lacking = [f"{n} = {other[n]:g} {RANGES[n].unit}" for n in SIZED if n not in values]
    if far and lacking:
        sizes = ", ".join(f"{n} = {values[n]:g} {RANGES[n].unit} ({other[n]:g})" for n in far)
        warnings.warn(
            f'{what}: {sizes} differs by more than {ANOTHER_SIZE:.0%} from the base "{base}" in '
            f"parentheses, from which the vehicle has {', '.join(lacking)}. Name these too, or "
            'another "base".',
            stacklevel=4,
        )


def written_out(spec: Spec) -> Spec:
    """The same vehicle as any process has it: what is said of one of a file or of this process.

    Names of this package and of entry points stay. Raises ValueError and OSError as
    `vehicle_values` does.
    """
    if isinstance(spec, PlantParameters) or (isinstance(spec, str) and spec in _declared()):
        return spec
    said = vehicle_values(spec)
    if "base" not in said:
        return said
    base = written_out(said.pop("base"))
    return {"base": base, **said} if isinstance(base, str) else {**vehicle_values(base), **said}


def vehicle_record(vehicle: PlantParameters) -> str | dict[str, float]:
    """A vehicle as records keep it: the name of one of VEHICLES, else all its values."""
    named = (name for name, parameters in VEHICLES.items() if parameters == vehicle)
    return next(named, vehicle._asdict())


def vehicle_toml(values: Mapping[str, Any], notes: Mapping[str, str] | None = None) -> str:
    """The text of a file with these values, each with its unit. Raises ValueError.

    values: as `vehicle_values` returns them. notes: what else is said of a parameter, by name.
    """
    checked_keys("vehicle", values, (*TEXTS, "base", *PARAMETER_NAMES))
    lines = [f"{key} = {_quoted(values[key])}" for key in (*TEXTS, "base") if key in values]
    for name in (each for each in PARAMETER_NAMES if each in values):
        note = (notes or {}).get(name, "")
        number = f"{name} = {checked_parameter(name, values[name])!r}"
        lines.append(f"{number}  # [{RANGES[name].unit}]{' ' + note if note else ''}")
    return "\n".join(lines) + "\n"


def _quoted(text: Any) -> str:
    """A basic string of TOML."""
    escaped = str(text).replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'
