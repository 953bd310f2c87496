"""Height maps: from an array or a file to a checked grid of heights.

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

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_choice, checked_number, plain_arrays

Floats = NDArray[np.float64]
MAP_KEYS = ("heights", "file", "cell", "origin", "scale", "interpolation")
INTERPOLATIONS = ("bilinear", "bicubic")
LARGEST = 10**8  # [-] heights of a map
_CELL = Range(1e-3, 1e4, "m", "It is the distance between two heights.")
_PLACE = Range(-1e7, 1e7, "m", "It is a world coordinate; subtract the origin of a survey.")
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
    x, y = (checked_number("origin of a map", value, _PLACE) for value in origin)
    return heights, np.array([x, y, 1.0 / cell, float(interpolation == "bicubic")])
