"""From a name or a JSON-able dictionary to a terrain: kinds, checks, height maps from files.

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
              power spectral density falls as k^-(2 + 2 hurst); standard deviation `height`
    map       a grid of heights, with
        heights        numbers [m] or a NumPy array; rows along y, columns along x, both growing
        file           instead: an array in .npy; in .npz `height` with `x0`, `y0` (default: x0) and
                       `spacing`; a grey image in .png, its upper edge at the largest y, one count
                       = 1 m times `scale`; a GeoTIFF, first band, with cell and origin of its own;
                       one in coordinates of a survey, without (0, 0), where references start, is
                       centred, with a warning
        cell           [m] distance between heights; of the file where that says it
        origin         [m, m] x, y of heights[0][0]; default: of the file, else the middle of the
                       map is at (0, 0)
        scale          [-] factor on the heights as they are read
        interpolation  "bilinear" or "bicubic"
`tracked_env[terrain]` brings what reads .png and GeoTIFF. No terrain may be steeper than STEEPEST
anywhere: contact along the normal has no meaning on walls.
"""

import json
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import validation
from tracked_env.arrays import STEEPEST
from tracked_env.physics.parameters import Range
from tracked_env.physics.patches_on_terrain import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y
from tracked_env.terrain.ground import RAMP, STEP, Relief, fill_places
from tracked_env.validation import checked_choice, checked_number

Floats = NDArray[np.float64]
Rows = list[list[float]]
_HEIGHT = Range(-100.0, 100.0, "m", "Did you pass millimetres?")
_SLOPE = Range(-STEEPEST, STEEPEST, "-", "It is dz/dx, the tangent of the angle; not degrees.")
_PLACE = Range(-1e6, 1e6, "m", "It is a world coordinate.")
_LENGTH = Range(1e-3, 1e4, "m", "It is the length over which the ground rises, not 0.")
_ANGLE = Range(-100.0, 100.0, "rad", "Did you pass degrees?")
_DEVIATION = Range(0.0, 100.0, "m", "It is a standard deviation.")
_SEED = Range(0, 2**53, "-", "It is a seed.")
_HURST = Range(0.0, 1.0, "-", "1 is smooth, 0 is rough.")
_COUNT = Range(1, 1000, "-", "It is a number of sinusoids.")
_EDGE = {"start": (2.0, _PLACE), "length": (1.0, _LENGTH), "direction": (0.0, _ANGLE)}
# Kind -> its numbers: (default, range).
_NUMBERS: dict[str, dict[str, tuple[float, Range]]] = {
    "flat": {},
    "plane": {"height": (0.0, _HEIGHT), "slope_x": (0.0, _SLOPE), "slope_y": (0.0, _SLOPE)},
    "ramp": {"slope": (0.2, _SLOPE), **_EDGE},
    "step": {"height": (0.1, _HEIGHT), **_EDGE, "length": (0.5, _LENGTH)},
    "hills": {"height": (0.25, _HEIGHT), "wavelength": (8.0, _LENGTH)},
    "crossing": {"height": (0.2, _HEIGHT), "wavelength": (6.0, _LENGTH), "angle": (1.2, _ANGLE)},
    "fractal": {
        **{"height": (0.1, _DEVIATION), "seed": (0, _SEED), "hurst": (0.8, _HURST)},
        **{"longest": (12.0, _LENGTH), "shortest": (1.0, _LENGTH), "count": (16, _COUNT)},
    },
}
# Kind -> its keys.
KINDS: dict[str, Iterable[str]] = {
    **_NUMBERS,
    "waves": ("waves",),
    "map": ("heights", "file", "cell", "origin", "scale", "interpolation"),
}
INTERPOLATIONS = ("bilinear", "bicubic")
LARGEST = 10**8  # [-] heights of a map
_CELL = Range(1e-3, 1e4, "m", "It is the distance between two heights.")
_ORIGIN = Range(-1e7, 1e7, "m", "It is a world coordinate; subtract the origin of a survey.")
_SCALE = Range(-1e6, 1e6, "-", "It is the height of one count.")


@dataclass(frozen=True)
class HeightField:
    """A checked terrain. `relief` is what kernels take; `specification` can be written as JSON."""

    specification: list[dict[str, Any]]
    relief: Relief

    def at(self, x: Any, y: Any) -> tuple[Floats, Floats, Floats]:
        """Heights [m] and slopes dz/dx, dz/dy [-] at arrays of places (x, y) [m]."""
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        w = np.zeros((5, x.size))
        w[PLACE_X], w[PLACE_Y] = x.ravel(), y.ravel()
        fill_places(self.relief, w)
        height, slope_x, slope_y = (w[row].reshape(x.shape) for row in (HEIGHT, SLOPE_X, SLOPE_Y))
        return height, slope_x, slope_y

    def to_json(self) -> str:
        """The specification as JSON; `make_height_field(json.loads(text))` is this terrain."""
        return json.dumps(self.specification, default=lambda array: array.tolist())


def _fractal(p: Mapping[str, float]) -> Rows:
    """Waves of a fractal. Raises ValueError."""
    count = validation.checked_whole("fractal count", p["count"], _COUNT)
    seed = validation.checked_whole("fractal seed", p["seed"], _SEED)
    if p["shortest"] > p["longest"]:
        raise ValueError(
            f"fractal shortest = {p['shortest']!r} m; must be at most longest = "
            f"{p['longest']!r} m. Did you exchange the two wavelengths?"
        )
    rng = np.random.default_rng(seed)
    k = 2.0 * math.pi / np.geomspace(p["longest"], p["shortest"], count)
    directions, phases = rng.uniform(0.0, 2.0 * math.pi, (2, count))
    amplitudes = k ** -p["hurst"]
    amplitudes *= p["height"] / math.sqrt(0.5 * float(amplitudes @ amplitudes))
    rows = np.stack([amplitudes, k * np.cos(directions), k * np.sin(directions), phases], axis=1)
    waves: Rows = rows.tolist()
    return waves


def _shape(p: Mapping[str, Any]) -> tuple[list[float], Rows, Rows]:
    """Plane c, a, b and the rows of edges and sinusoids of a part, as `ground.Relief` has them."""
    plane, edges, waves = [0.0, 0.0, 0.0], Rows(), Rows()
    match p["kind"]:
        case "plane":
            plane = [p["height"], p["slope_x"], p["slope_y"]]
        case "ramp" | "step" as kind:
            form = (RAMP, p["slope"]) if kind == "ramp" else (STEP, p["height"])
            along = math.cos(p["direction"]), math.sin(p["direction"])
            edges = [[*form, *along, p["start"], p["length"]]]
        case "waves":
            waves = p["waves"]
        case "fractal":
            waves = _fractal(p)
        case "hills":  # sin a sin b = (cos(a - b) - cos(a + b)) / 2
            half, k = 0.5 * p["height"], 2.0 * math.pi / p["wavelength"]
            waves = [[half, k, -k, 0.5 * math.pi], [-half, k, k, 0.5 * math.pi]]
        case "crossing":
            half, k, a = 0.5 * p["height"], 2.0 * math.pi / p["wavelength"], p["angle"]
            waves = [[half, k, 0.0, 0.0], [half, k * math.cos(a), k * math.sin(a), 0.0]]
    return plane, edges, waves


def _checked_waves(rows: object) -> Rows:
    """Rows [A, kx, ky, phi]. Raises ValueError."""
    try:
        waves = np.asarray(rows, dtype=float)
    except (TypeError, ValueError):
        waves = np.empty(0)
    if waves.ndim != 2 or waves.shape[1:] != (4,) or not np.isfinite(waves).all():
        raise ValueError(
            f"waves of shape {waves.shape}; must be finite rows [A, kx, ky, phi] in m, rad/m, rad"
        )
    result: Rows = waves.tolist()
    return result


def _steepest(plane: Floats, edges: Rows, waves: Rows) -> float:
    """An upper bound [-] of the slope of all parts but the map."""
    bound = math.hypot(plane[1], plane[2])
    for kind, size, *_, length in edges:
        bound += abs(size) if kind == RAMP else 2.0 * abs(size) / length
    return bound + sum(abs(a) * math.hypot(k_x, k_y) for a, k_x, k_y, _ in waves)


def _checked_part(part: object) -> dict[str, Any]:
    """One part of a terrain with all its numbers filled in. Raises ValueError."""
    part = {"kind": part} if isinstance(part, str) else part
    if isinstance(part, np.ndarray):
        raise ValueError(
            f"terrain = array of shape {part.shape}; heights need the distance between them: "
            '{"kind": "map", "heights": array, "cell": 0.1}'
        )
    if not isinstance(part, Mapping):
        raise ValueError(f"terrain = {part!r}; must be a kind, a dict with 'kind', or a list")
    kind = checked_choice("terrain kind", part.get("kind"), KINDS)
    validation.checked_keys(f"terrain of kind '{kind}'", part, ("kind", *KINDS[kind]))
    if kind == "map":
        return dict(part)
    if kind == "waves":
        return {"kind": kind, "waves": _checked_waves(part.get("waves"))}
    return {"kind": kind} | {
        name: checked_number(f"{kind} {name}", part.get(name, default), allowed)
        for name, (default, allowed) in _NUMBERS[kind].items()
    }


def make_height_field(terrain: object) -> HeightField:
    """A terrain from a kind, a dict, a list of them (their sum), or a terrain itself.

    Raises ValueError for anything unknown, out of range, too steep, or a map that cannot be read.
    """
    if isinstance(terrain, HeightField):
        return terrain
    several = isinstance(terrain, Sequence) and not isinstance(terrain, str)
    specification = [_checked_part(part) for part in (terrain if several else [terrain])]  # type: ignore[attr-defined]
    plane, edges, waves = np.zeros(3), Rows(), Rows()
    heights, frame, steep = np.zeros((0, 0)), np.zeros(4), 0.0
    for part in specification:
        its_plane, its_edges, its_waves = _shape(part)
        plane += its_plane
        edges += its_edges
        waves += its_waves
        if part["kind"] == "map":
            if heights.size:
                raise ValueError("terrain with two maps; must be one at most. Add their heights")
            heights, frame = _load_map(part)
            gaps = [np.abs(np.diff(heights, axis=axis)).max() for axis in (0, 1)]
            steep = float(np.hypot(*gaps)) * frame[2]
    steep += _steepest(plane, edges, waves)
    if steep > STEEPEST:
        raise ValueError(
            f"terrain with a slope of up to {steep:.3g}; must be at most {STEEPEST:g}. "
            "Is a step too short, or are heights in other units than the cells?"
        )
    edge_rows = np.array(edges, dtype=float).reshape(-1, 6)
    wave_rows = np.array(waves, dtype=float).reshape(-1, 4)
    return HeightField(specification, Relief(plane, edge_rows, wave_rows, heights, frame))


class _MapError(ValueError):
    """What a file lacks, in words of its own."""


def _check_size(width: int, height: int) -> None:
    """Before a picture is unpacked. Raises _MapError."""
    if width * height > LARGEST:
        raise _MapError(f" of {width * height:.1e} heights; must be at most {LARGEST:.0e}")


def _read_png(path: Path) -> tuple[Any, dict[str, Any]]:
    from PIL import Image

    with Image.open(path) as image:
        if len(image.getbands()) > 1 or image.mode == "P":
            raise _MapError(f" of mode {image.mode}; must be a grey image. Did you save a palette?")
        _check_size(image.width, image.height)
        counts = np.asarray(image)
    return counts[::-1], {}


def _read_geotiff(path: Path) -> tuple[Any, dict[str, Any]]:
    import rasterio  # type: ignore[import-not-found, import-untyped, unused-ignore]

    with rasterio.open(path) as source:
        _check_size(source.width, source.height)
        heights = source.read(1, masked=True).astype(np.float64).filled(np.nan)
        t = source.transform
    if t.b or t.d or not math.isclose(t.a, -t.e, rel_tol=1e-6):
        raise _MapError(
            f" with cells of {t.a:g} x {-t.e:g}; must be square and along x and y. Is it in "
            "degrees? Reproject it to metres."
        )
    # The middles of cells, lowest y first.
    origin = [t.c + 0.5 * t.a, t.f + (heights.shape[0] - 0.5) * t.e]
    return heights[::-1], {"cell": t.a, "origin": origin}


def _read_npz(path: Path) -> tuple[Any, dict[str, Any]]:
    arrays = validation.plain_arrays(path, 8 * LARGEST + 2**20)
    if "height" not in arrays:
        raise _MapError(f" with {sorted(arrays)}; must hold an array 'height'")
    frame: dict[str, Any] = {}
    if "spacing" in arrays:
        frame["cell"] = float(arrays["spacing"])
    if "x0" in arrays:
        frame["origin"] = [float(arrays["x0"]), float(arrays.get("y0", arrays["x0"]))]
    return arrays["height"], frame


_READERS = {
    ".npy": lambda path: (np.load(path), {}),
    ".npz": _read_npz,
    ".png": _read_png,
    ".tif": _read_geotiff,
    ".tiff": _read_geotiff,
}


def _read(file: object) -> tuple[Any, dict[str, Any]]:
    """(heights as they are in the file, cell and origin where it says them). Raises ValueError."""
    path = Path(str(file))
    what, kind = f"terrain file = {str(path)!r}", path.suffix.lower()
    if kind not in _READERS:
        raise ValueError(f"{what}; must end in one of {sorted(_READERS)}")
    if not path.is_file():
        raise ValueError(f"{what}; no such file. Is the path relative?")
    try:
        return _READERS[kind](path)
    except _MapError as error:
        raise ValueError(f"{what}{error}") from error
    except ImportError as error:
        needed = "pillow" if kind == ".png" else "rasterio"
        raise ValueError(
            f"{what}; needs {needed} ({error}). Did you run `pip install tracked-env[terrain]`?"
        ) from error
    except Exception as error:  # a damaged file raises what happens to go wrong
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(f"{what}; cannot be read: {reason}") from error


def _checked_heights(numbers: object, scale: float) -> Floats:
    """Heights (rows, columns) [m]. Raises ValueError."""
    try:
        heights = np.asarray(numbers)
        if heights.dtype.kind not in "biuf":
            raise TypeError(f"they are of type {heights.dtype}")
        heights = heights.astype(np.float64)
    except (TypeError, ValueError) as error:
        reason = f"heights of a map are not numbers in rows of equal length: {error}"
        raise ValueError(reason) from error
    what = f"heights of a map of shape {heights.shape}"
    if heights.ndim != 2:
        raise ValueError(f"{what}; must be (rows, columns). Did you pass coordinates as well?")
    if min(heights.shape) < 2 or heights.size > LARGEST:
        raise ValueError(f"{what}; must be at least 2 x 2 and at most {LARGEST:.0e} in all")
    if not np.isfinite(heights).all():
        row, column = np.argwhere(~np.isfinite(heights))[0]
        raise ValueError(
            f"heights[{row}][{column}] of a map = {heights[row, column]}; must be finite. "
            "Are there holes in the survey? Fill them first."
        )
    return np.ascontiguousarray(scale * heights)


def _placed(part: Mapping[str, Any], origin: list[float], middle: list[float]) -> list[float]:
    """[x, y] [m] of the first height of a file that says so itself: `origin`, or, with a warning,
    `middle` for a GeoTIFF that does not reach (0, 0) and a file farther away than it is long."""
    lengths = [-2.0 * half for half in middle]
    distance = max(max(x, -x - length) for x, length in zip(origin, lengths, strict=True))
    is_geotiff = Path(str(part.get("file", ""))).suffix.lower() in (".tif", ".tiff")
    if not distance > (0.0 if is_geotiff else max(lengths)):
        return origin
    warnings.warn(
        f"terrain file = {str(part['file'])!r} reaches from {origin} on over {lengths} m, without "
        "(0, 0), where references start: its middle is put at (0, 0). Give 'origin': [x, y] to "
        "place it yourself",
        stacklevel=2,
    )
    return middle


def _load_map(part: Mapping[str, Any]) -> tuple[Floats, Floats]:
    """(heights (rows, columns) [m], frame) of a map, as `ground.Relief` has them.

    Raises ValueError for a map that cannot be read, is not a grid of numbers, or lacks its cell.
    """
    if ("heights" in part) == ("file" in part):
        raise ValueError("terrain of kind 'map'; must have either 'heights' or 'file'")
    numbers, frame = _read(part["file"]) if "file" in part else (part["heights"], {})
    scale = checked_number("scale of a map", part.get("scale", 1.0), _SCALE)
    heights = _checked_heights(numbers, scale)
    cell = part.get("cell", frame.get("cell"))
    if cell is None:
        raise ValueError("terrain of kind 'map' lacks 'cell', the distance between heights in m")
    cell = checked_number("cell of a map", cell, _CELL)
    interpolation = part.get("interpolation", "bilinear")
    bicubic = checked_choice("interpolation", interpolation, INTERPOLATIONS) == "bicubic"
    rows, columns = heights.shape
    middle = [-0.5 * cell * (columns - 1), -0.5 * cell * (rows - 1)]
    origin = part.get("origin")
    if "origin" not in part:
        origin = _placed(part, frame.get("origin", middle), middle)
    if not isinstance(origin, (list, tuple, np.ndarray)) or len(origin) != 2:
        raise ValueError(f"origin of a map = {origin!r}; must be [x, y] in m of heights[0][0]")
    x, y = (checked_number("origin of a map", value, _ORIGIN) for value in origin)
    return heights, np.array([x, y, 1.0 / cell, float(bicubic)])
