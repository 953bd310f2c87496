"""From a name or a JSON-able dictionary to a terrain: kinds, checks, and the arrays of the kernels.

    make_height_field("hills")
    make_height_field({"kind": "ramp", "slope": 0.3, "start": 2.0, "length": 1.5})
    make_height_field({"kind": "map", "file": "field.tif", "interpolation": "bicubic"})
    make_height_field([{"kind": "plane", "slope_y": 0.1}, {"kind": "fractal", "seed": 3}])
A list is the sum of its parts.

Kinds, heights in m over x, y in m, slopes as dz/dx [-], directions in rad from the x axis:
    plane     height + slope_x x + slope_y y; "flat" is the one without slope
    ramp      level up to `start` along `direction`, then the slope over `length`, then straight on
    step      rises by `height` over `length`, never steeper than 2 height / length
    hills     height sin(k x) sin(k y), k = 2 pi / wavelength
    crossing  two trains of ridges that cross: height (sin(k x) + sin(k (x cos(a) + y sin(a)))) / 2
    waves     sum of A sin(kx x + ky y + phi), rows [A, kx, ky, phi]
    fractal   seeded: `count` sinusoids with random directions and phases, wave numbers in equal
              ratios from 2 pi / longest to 2 pi / shortest, amplitudes ~ k^-hurst, so that the
              power spectral density over the plane of wave vectors falls as k^-(2 + 2 hurst);
              standard deviation `height`
    map       a grid of heights, see `tracked_env.terrain.height_field`
No terrain may be steeper than STEEPEST anywhere: contact along the normal has no meaning on walls.

Height maps: from an array or a file to a checked grid of heights.

    {"kind": "map", "heights": [[...], ...], "cell": 0.1}       heights[row][column], y and x grow
    {"kind": "map", "file": "field.npz"}                        .npy, .npz, 16-bit .png, .tif
with
    heights        numbers [m], or a NumPy array; rows along y, columns along x, both growing
    file           an array in .npy; in .npz `height` with `x0`, `y0` (default: x0) and `spacing`;
                   an image in .png, its upper edge at the largest y, one count = 1 m times `scale`;
                   a GeoTIFF, first band, with cell and origin of its own; one in coordinates of
                   a survey, without (0, 0), where references start, is centred, with a warning
    cell           [m] distance between heights; of the file where that says it
    origin         [m, m] x, y of heights[0][0]; default: of the file, else the middle of the map
                   is at (0, 0)
    scale          [-] factor on the heights as they are read
    interpolation  "bilinear" or "bicubic"
`tracked_env[terrain]` brings what reads .png and GeoTIFF.
"""

import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.parameters import Range
from tracked_env.physics.patches_on_terrain import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y
from tracked_env.terrain.ground import STEEPEST
from tracked_env.terrain.relief import RAMP, STEP, Relief, fill_places
from tracked_env.validation import (
    checked_choice,
    checked_keys,
    checked_number,
    checked_whole,
    plain_arrays,
)

Floats = NDArray[np.float64]


MAP_KEYS = ("heights", "file", "cell", "origin", "scale", "interpolation")
INTERPOLATIONS = ("bilinear", "bicubic")
LARGEST = 10**8  # [-] heights of a map
_CELL = Range(1e-3, 1e4, "m", "It is the distance between two heights.")
_PLACE_HEIGHT_MAP = Range(
    -1e7, 1e7, "m", "It is a world coordinate; subtract the origin of a survey."
)
_SCALE = Range(-1e6, 1e6, "-", "It is the height of one count.")
_READERS = {".png": "pillow", ".tif": "rasterio", ".tiff": "rasterio"}


class _MapError(ValueError):
    """What a file lacks, in words of its own."""


def _lacks(path: Path, error: ImportError) -> _MapError:
    needed = _READERS[path.suffix.lower()]
    return _MapError(
        f"terrain file = {str(path)!r}; needs {needed} ({error}). Did you run "
        "`pip install tracked-env[terrain]`?"
    )


def _read_png(path: Path) -> tuple[Any, dict[str, Any]]:
    try:
        from PIL import Image
    except ImportError as error:
        raise _lacks(path, error) from error
    with Image.open(path) as image:
        if len(image.getbands()) > 1 or image.mode == "P":
            raise _MapError(
                f"terrain file = {str(path)!r} of mode {image.mode}; must be a grey image, whose "
                "counts are heights. Did you save it in colour, or with a palette?"
            )
        _check_size(path, image.width * image.height)
        counts = np.asarray(image)
    return counts[::-1], {}


def _read_geotiff(path: Path) -> tuple[Any, dict[str, Any]]:
    try:
        import rasterio  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ImportError as error:
        raise _lacks(path, error) from error
    with rasterio.open(path) as source:
        _check_size(path, source.width * source.height)
        heights = source.read(1, masked=True).astype(np.float64).filled(np.nan)
        t = source.transform
    if t.b or t.d or not math.isclose(t.a, -t.e, rel_tol=1e-6):
        raise _MapError(
            f"terrain file = {str(path)!r} with cells of {t.a:g} x {-t.e:g}; must be square and "
            "along x and y. Is it in degrees? Reproject it to metres."
        )
    rows = heights.shape[0]
    origin = [t.c + 0.5 * t.a, t.f + (rows - 0.5) * t.e]  # middles of cells, lowest y first
    return heights[::-1], {"cell": t.a, "origin": origin}


def _read_npz(path: Path) -> tuple[Any, dict[str, Any]]:
    found = plain_arrays(path, 8 * LARGEST + 2**20)
    if "height" not in found:
        raise _MapError(
            f"terrain file = {str(path)!r} with {sorted(found)}; must hold an array 'height'"
        )
    known: dict[str, Any] = {}
    if "spacing" in found:
        known["cell"] = float(found["spacing"])
    if "x0" in found:
        known["origin"] = [float(found["x0"]), float(found.get("y0", found["x0"]))]
    return found["height"], known


def _read(given: object) -> tuple[Any, dict[str, Any]]:
    """(heights as they are in the file, cell and origin where it says them). Raises ValueError."""
    path = Path(str(given))
    readers = {
        ".npy": lambda path: (np.load(path), {}), ".npz": _read_npz, ".png": _read_png,
        ".tif": _read_geotiff, ".tiff": _read_geotiff,
    }  # fmt: skip
    if path.suffix.lower() not in readers:
        raise ValueError(f"terrain file = {str(path)!r}; must end in one of {sorted(readers)}")
    if not path.is_file():
        raise ValueError(f"terrain file = {str(path)!r}; no such file. Is the path relative?")
    try:
        return readers[path.suffix.lower()](path)
    except _MapError:
        raise
    except Exception as error:  # a damaged file raises what happens to go wrong
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(f"terrain file = {str(path)!r}; cannot be read: {reason}") from error


def _check_size(path: Path, size: int) -> None:
    """Raise _MapError for a picture of more heights than a map may have, before it is unpacked."""
    if size > LARGEST:
        raise _MapError(
            f"terrain file = {str(path)!r} of {size:.1e} heights; must be at most {LARGEST:.0e}"
        )


def _checked_heights(given: object, scale: float) -> Floats:
    """Heights (rows, columns) [m]. Raises ValueError."""
    try:
        heights = np.asarray(given)
        if heights.dtype.kind not in "biuf":
            raise TypeError(f"they are of type {heights.dtype}")
        heights = heights.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"heights of a map are not numbers in rows of equal length: {error}"
        ) from error
    if heights.ndim != 2:
        raise ValueError(
            f"heights of a map of shape {heights.shape}; must be (rows, columns), rows along y. "
            "Did you pass coordinates as well?"
        )
    if min(heights.shape) < 2 or heights.size > LARGEST:
        raise ValueError(
            f"heights of a map of shape {heights.shape}; must be at least 2 x 2 and at most "
            f"{LARGEST:.0e} in all: one cell has four heights"
        )
    if not np.isfinite(heights).all():
        row, column = np.argwhere(~np.isfinite(heights))[0]
        raise ValueError(
            f"heights[{row}][{column}] of a map = {heights[row, column]}; must be finite. "
            "Are there holes in the survey? Fill them first."
        )
    return np.ascontiguousarray(scale * heights)


def _origin_in_file(
    given: Mapping[str, Any], known: Mapping[str, Any], middle: list[float]
) -> list[float]:
    """[x, y] [m] of the first height where the map itself says nothing: of its file, or `middle`.

    Coordinates of a survey are those of a GeoTIFF that does not reach (0, 0), and of another file
    that is farther away than it is long. A warning names them.
    """
    origin: list[float] = known.get("origin", middle)
    lengths = [-2.0 * half for half in middle]
    distance = max(
        max(first, -first - length) for first, length in zip(origin, lengths, strict=True)
    )
    is_geotiff = Path(str(given.get("file", ""))).suffix.lower() in (".tif", ".tiff")
    if not distance > (0.0 if is_geotiff else max(lengths)):
        return origin
    warnings.warn(
        f"terrain file = {str(given['file'])!r} reaches from {origin} on over {lengths} m, without "
        "(0, 0), where references start: its middle is put at (0, 0). Give 'origin': [x, y] to "
        "place it yourself",
        stacklevel=2,
    )
    return middle


def load_map(given: Mapping[str, Any]) -> tuple[Floats, Floats]:
    """(heights (rows, columns) [m], frame) of a map, as `relief.Relief` has them.

    Raises ValueError for a map that cannot be read, is not a grid of numbers, or lacks its cell.
    """
    if ("heights" in given) == ("file" in given):
        raise ValueError("terrain of kind 'map'; must have either 'heights' or 'file'")
    known: dict[str, Any] = {}
    if "file" in given:
        found, known = _read(given["file"])
    else:
        found = given["heights"]
    scale = checked_number("scale of a map", given.get("scale", 1.0), _SCALE)
    heights = _checked_heights(found, scale)
    cell = given.get("cell", known.get("cell"))
    if cell is None:
        raise ValueError("terrain of kind 'map' lacks 'cell', the distance between heights in m")
    cell = checked_number("cell of a map", cell, _CELL)
    interpolation = checked_choice(
        "interpolation", given.get("interpolation", "bilinear"), INTERPOLATIONS
    )
    rows, columns = heights.shape
    middle = [-0.5 * cell * (columns - 1), -0.5 * cell * (rows - 1)]
    origin = given["origin"] if "origin" in given else _origin_in_file(given, known, middle)
    if not isinstance(origin, (list, tuple, np.ndarray)) or len(origin) != 2:
        raise ValueError(f"origin of a map = {origin!r}; must be [x, y] in m of heights[0][0]")
    x, y = (checked_number("origin of a map", value, _PLACE_HEIGHT_MAP) for value in origin)
    return heights, np.array([x, y, 1.0 / cell, float(interpolation == "bicubic")])


_HEIGHT = Range(-100.0, 100.0, "m", "Did you pass millimetres?")
_SLOPE = Range(-STEEPEST, STEEPEST, "-", "It is dz/dx, the tangent of the angle; not degrees.")
_PLACE = Range(-1e6, 1e6, "m", "It is a world coordinate.")
_LENGTH = Range(1e-3, 1e4, "m", "It is the length over which the ground rises, not 0.")
_ANGLE = Range(-100.0, 100.0, "rad", "Did you pass degrees?")
# Kind -> its numbers: (default, None: must be given; range).
_NUMBERS: dict[str, dict[str, tuple[float | None, Range]]] = {
    "flat": {},
    "plane": {"height": (0.0, _HEIGHT), "slope_x": (0.0, _SLOPE), "slope_y": (0.0, _SLOPE)},
    "ramp": {
        "slope": (0.2, _SLOPE), "start": (2.0, _PLACE), "length": (1.0, _LENGTH),
        "direction": (0.0, _ANGLE),
    },
    "step": {
        "height": (0.1, _HEIGHT), "start": (2.0, _PLACE), "length": (0.5, _LENGTH),
        "direction": (0.0, _ANGLE),
    },
    "hills": {"height": (0.25, _HEIGHT), "wavelength": (8.0, _LENGTH)},
    "crossing": {"height": (0.2, _HEIGHT), "wavelength": (6.0, _LENGTH), "angle": (1.2, _ANGLE)},
    "fractal": {
        "height": (0.1, Range(0.0, 100.0, "m", "It is a standard deviation.")),
        "seed": (0, Range(0, 2**53, "-", "It is a seed.")),
        "hurst": (0.8, Range(0.0, 1.0, "-", "1 is smooth, 0 is rough.")),
        "longest": (12.0, _LENGTH), "shortest": (1.0, _LENGTH),
        "count": (16, Range(1, 1000, "-", "It is a number of sinusoids.")),
    },
}  # fmt: skip
KINDS = (*_NUMBERS, "waves", "map")


@dataclass(frozen=True)
class HeightField:
    """A checked terrain. `relief` is what kernels take; `specification` can be written as JSON."""

    specification: list[dict[str, Any]]
    relief: Relief

    def at(self, x: Any, y: Any) -> tuple[Floats, Floats, Floats]:
        """Heights [m] and slopes dz/dx, dz/dy [-] at arrays of places (x, y) [m]."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        w, _ = self._filled(x.ravel(), y.ravel())
        height, slope_x, slope_y = (w[row].reshape(x.shape) for row in (HEIGHT, SLOPE_X, SLOPE_Y))
        return height, slope_x, slope_y

    def off_map(self, x: float, y: float) -> bool:
        """Whether (x, y) [m] lies beyond the edge of the height map; never without a map."""
        return self._filled(x, y)[1] > 0

    def _filled(self, x: Any, y: Any) -> tuple[Floats, float]:
        """Scratch of the kernel for these places, and how many of them are off the map."""
        w = np.zeros((5, np.size(x)))
        w[PLACE_X], w[PLACE_Y] = x, y
        return w, float(fill_places(self.relief, w))

    def to_json(self) -> str:
        """The specification as JSON; `make_height_field(json.loads(text))` is this terrain."""
        return json.dumps(self.specification, default=lambda array: array.tolist())


@dataclass
class _Parts:
    """What the kinds add up to."""

    plane: Floats
    edges: list[list[float]]
    waves: list[list[float]]


def _flat(given: Mapping[str, float], parts: _Parts) -> None:
    """Nothing to add."""


def _plane(given: Mapping[str, float], parts: _Parts) -> None:
    parts.plane += (given["height"], given["slope_x"], given["slope_y"])


def _edge(kind: float, size: float, given: Mapping[str, float], parts: _Parts) -> None:
    e_x, e_y = math.cos(given["direction"]), math.sin(given["direction"])
    parts.edges.append([kind, size, e_x, e_y, given["start"], given["length"]])


def _ramp(given: Mapping[str, float], parts: _Parts) -> None:
    _edge(RAMP, given["slope"], given, parts)


def _step(given: Mapping[str, float], parts: _Parts) -> None:
    _edge(STEP, given["height"], given, parts)


def _hills(given: Mapping[str, float], parts: _Parts) -> None:
    half, k = 0.5 * given["height"], 2.0 * math.pi / given["wavelength"]
    # sin a sin b = (cos(a - b) - cos(a + b)) / 2
    parts.waves.append([half, k, -k, 0.5 * math.pi])
    parts.waves.append([-half, k, k, 0.5 * math.pi])


def _crossing(given: Mapping[str, float], parts: _Parts) -> None:
    half, k = 0.5 * given["height"], 2.0 * math.pi / given["wavelength"]
    parts.waves.append([half, k, 0.0, 0.0])
    parts.waves.append([half, k * math.cos(given["angle"]), k * math.sin(given["angle"]), 0.0])


def _fractal(given: Mapping[str, float], parts: _Parts) -> None:
    count = checked_whole("fractal count", given["count"], _NUMBERS["fractal"]["count"][1])
    seed = checked_whole("fractal seed", given["seed"], _NUMBERS["fractal"]["seed"][1])
    if given["shortest"] > given["longest"]:
        raise ValueError(
            f"fractal shortest = {given['shortest']!r} m; must be at most longest = "
            f"{given['longest']!r} m. Did you exchange the two wavelengths?"
        )
    rng = np.random.default_rng(seed)
    k = 2.0 * math.pi / np.geomspace(given["longest"], given["shortest"], count)
    directions, phases = rng.uniform(0.0, 2.0 * math.pi, (2, count))
    amplitudes = k ** -given["hurst"]
    amplitudes *= given["height"] / math.sqrt(0.5 * float(amplitudes @ amplitudes))
    rows = np.stack([amplitudes, k * np.cos(directions), k * np.sin(directions), phases], axis=1)
    parts.waves.extend(rows.tolist())


_BUILD: dict[str, Callable[[Mapping[str, float], _Parts], None]] = {
    "flat": _flat, "plane": _plane, "ramp": _ramp, "step": _step, "hills": _hills,
    "crossing": _crossing, "fractal": _fractal,
}  # fmt: skip


def _checked_waves(given: object) -> list[list[float]]:
    """Rows [A, kx, ky, phi]. Raises ValueError."""
    try:
        rows = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim != 2 or rows.shape[1:] != (4,) or not np.isfinite(rows).all():
        raise ValueError(
            f"waves of shape {rows.shape}; must be finite rows [A, kx, ky, phi] in m, rad/m, rad"
        )
    return [[float(value) for value in row] for row in rows]


def _steepest(parts: _Parts) -> float:
    """An upper bound [-] of the slope of all parts but the map."""
    bound = math.hypot(parts.plane[1], parts.plane[2])
    bound += sum(
        abs(size) if kind == RAMP else 2.0 * abs(size) / length
        for kind, size, _, _, _, length in parts.edges
    )
    return bound + sum(abs(a) * math.hypot(k_x, k_y) for a, k_x, k_y, _ in parts.waves)


def _checked_part(given: object) -> dict[str, Any]:
    """One part of a terrain with all its numbers filled in. Raises ValueError."""
    if isinstance(given, str):
        given = {"kind": given}
    if isinstance(given, np.ndarray):
        raise ValueError(
            f"terrain = array of shape {given.shape}; heights need the distance between them: "
            '{"kind": "map", "heights": array, "cell": 0.1}'
        )
    if not isinstance(given, Mapping):
        raise ValueError(
            f"terrain = {given!r}; must be a kind or a dict with 'kind', or a list of them"
        )
    kind = checked_choice("terrain kind", given.get("kind"), KINDS)
    what = f"terrain of kind '{kind}'"
    if kind == "map":
        return dict(checked_keys(what, given, ("kind", *MAP_KEYS)))
    if kind == "waves":
        checked_keys(what, given, ("kind", "waves"))
        return {"kind": kind, "waves": _checked_waves(given.get("waves"))}
    numbers = _NUMBERS[kind]
    checked_keys(what, given, ("kind", *numbers))
    filled = {
        name: checked_number(f"{kind} {name}", given.get(name, default), allowed)
        for name, (default, allowed) in numbers.items()
    }
    return {"kind": kind, **filled}


def make_height_field(given: object) -> HeightField:
    """A terrain from a kind, a dict, a list of them (their sum), or a terrain itself.

    Raises ValueError for anything unknown, out of range, too steep, or a map that cannot be read.
    """
    if isinstance(given, HeightField):
        return given
    several = isinstance(given, Sequence) and not isinstance(given, str)
    specification = [_checked_part(part) for part in (given if several else [given])]  # type: ignore[attr-defined]
    parts = _Parts(np.zeros(3), [], [])
    heights, frame, steep = np.zeros((0, 0)), np.zeros(4), 0.0
    for part in specification:
        if part["kind"] == "map":
            if heights.size:
                raise ValueError("terrain with two maps; must be one at most. Add their heights")
            heights, frame = load_map(part)
            gaps = [np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1)]
            steep = float(np.hypot(*gaps)) * frame[2]
        elif part["kind"] == "waves":
            parts.waves.extend(part["waves"])
        else:
            _BUILD[part["kind"]](part, parts)
    steep += _steepest(parts)
    if steep > STEEPEST:
        raise ValueError(
            f"terrain with a slope of up to {steep:.3g}; must be at most {STEEPEST:g}. "
            "Is a step too short, or are heights in other units than the cells?"
        )
    edges = np.array(parts.edges, dtype=float).reshape(-1, 6)
    waves = np.array(parts.waves, dtype=float).reshape(-1, 4)
    return HeightField(specification, Relief(parts.plane, edges, waves, heights, frame))
