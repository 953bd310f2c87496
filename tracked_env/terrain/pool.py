"""The ground of an episode: one terrain of a choice, and what is drawn on top of it.

    {"kind": "drawn", "of": {"kind": "fractal", "seed": 3}, "count": 16}     seeds 3, 4, ... 18
    {"kind": "drawn", "of": {"kind": "map", "heights": maps, "cell": 0.1}}   one of the maps
    {"kind": "drawn", "terrains": ["hills", {"kind": "ramp", "slope": 0.3}]}
`of` is any terrain; member k of the choice has k added to the seeds of its fractals and the k-th
of maps (count, rows, columns). A list with one such part is a choice of sums. Every other
terrain is a choice of one. Kernels take all members as one `Relief` whose arrays have the member as
their first axis; sinusoids and edges that a member does not have are there without height.

On the member k that an episode has, a law of uncertainty may draw
    h(x, y) = h_k(x, y) + a x + b y + sum_i A_i sin(kx_i x + ky_i y + phi_i)
RELIEF_SIZE numbers a, b, (A, kx, ky, phi) ... of the vehicle's row of the batch; unused sinusoids
have A = 0. The laws are in `tracked_env.uncertainty.laws`. The column behind them has k.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.arrays import DRAWN_WAVES, RELIEF_SIZE
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import Range
from tracked_env.physics.patches_on_terrain import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y, WIDE
from tracked_env.terrain.ground import (
    AMPLITUDE,
    K_X,
    K_Y,
    PHASE,
    STEP,
    Relief,
    add_wave,
    add_waves,
    fill_even,
)
from tracked_env.terrain.height_field import KINDS, LARGEST, HeightField, make_height_field
from tracked_env.validation import checked_choice, checked_keys, checked_whole

KIND = "drawn"
SCAN_ROWS = 5  # of the scratch: places, heights, slopes
_COUNT = Range(1, 10**5, "-", "It is the number of terrains to draw from.")
_NO_EDGE = (STEP, 0.0, 1.0, 0.0, 0.0, 1.0)  # a step without height
_NO_WAVE = (0.0, 0.0, 0.0, 0.0)
Floats = NDArray[np.float64]


class Pool(NamedTuple):
    """Terrains to draw from."""

    fields: tuple[HeightField, ...]
    reliefs: Relief  # of all of them, the member as the first axis


@formula
def member_of(reliefs, k):
    """Relief of member k."""
    plane, edges, waves, heights, frame = reliefs
    return Relief(plane[k], edges[k], waves[k], heights[k], frame[k])


@formula
def _wave(there, k):
    """(A, kx, ky, phi) of sinusoid k: first those of the member, then those drawn, then none."""
    relief, floats, i, first = there
    waves = relief.waves
    if k < waves.shape[0]:
        return waves[k, 0], waves[k, 1], waves[k, 2], waves[k, 3]
    at = first + 2 + 4 * (k - waves.shape[0])
    if at < first + RELIEF_SIZE:
        return floats[i, at], floats[i, at + 1], floats[i, at + 2], floats[i, at + 3]
    return 0.0, 0.0, 0.0, 0.0


@formula
def _waves(there):
    """How many sinusoids there are, up to the last one that has a height."""
    relief, floats, i, first = there
    count = relief.waves.shape[0]
    for k in range(DRAWN_WAVES):
        if floats[i, first + 2 + 4 * k] != 0.0:
            count = relief.waves.shape[0] + k + 1
    return count


@formula
def fill_there(there, w, count):
    """As `ground.fill`; there: its relief, floats (N, W), row of the vehicle, column of a."""
    relief, floats, i, first = there
    off = fill_even(relief, w, count, floats[i, first], floats[i, first + 1])
    for k in range(_waves(there)):
        amplitude, k_x, k_y, phase = _wave(there, k)
        add_wave(w, count, amplitude, k_x, k_y, phase)
    return off


@formula
def fill_patches(under, w, count, grid):
    """The same under the tracks; under: `there`, scratch (WAVE_SCRATCH,)."""
    there, t = under
    relief, floats, i, first = there
    off = fill_even(relief, w, count, floats[i, first], floats[i, first + 1])
    for begin in range(0, _waves(there), WIDE):
        for k in range(WIDE):
            wave = _wave(there, begin + k)
            t[AMPLITUDE + k], t[K_X + k], t[K_Y + k], t[PHASE + k] = wave
        add_waves(w, t, grid)
    return off


@loop
def fill_rows(reliefs, floats, first, rows, x, y, ground):
    """Heights and slopes ground (n, 3, M) at places x, y (n, M) on the ground of `rows` (n,)."""
    count = x.shape[1]
    w = np.empty((SCAN_ROWS, count))
    for k in range(rows.size):
        w[PLACE_X], w[PLACE_Y] = x[k], y[k]
        relief = member_of(reliefs, int(floats[rows[k], first + RELIEF_SIZE]))
        fill_there((relief, floats, rows[k], first), w, count)
        ground[k, 0], ground[k, 1], ground[k, 2] = w[HEIGHT], w[SLOPE_X], w[SLOPE_Y]


def ground_at(
    reliefs: Relief, floats: Floats, first: int, rows: NDArray[np.int64], x: Floats, y: Floats
) -> Floats:
    """(n, 3, M) height [m] and slopes [-] at places x, y (n, M) [m] on the ground of `rows`."""
    ground = np.empty((x.shape[0], 3, x.shape[1]))
    x, y = (np.ascontiguousarray(each, dtype=np.float64) for each in (x, y))
    fill_rows(reliefs, floats, first, np.asarray(rows, dtype=np.int64), x, y, ground)
    return ground


def _parts(terrain: object) -> list[Any]:
    """The parts of a terrain, whether it is a sum or not."""
    several = isinstance(terrain, Sequence) and not isinstance(terrain, str)
    return list(terrain) if several else [terrain]  # type: ignore[call-overload]


def _kind(part: object) -> object:
    """Kind of a part, as the user wrote it."""
    if isinstance(part, Mapping):
        return part.get("kind")
    return part if isinstance(part, str) else None


def _maps(part: object) -> Floats | None:
    """Maps (count, rows, columns) that a part has to draw from; None where it has no such maps."""
    if not isinstance(part, Mapping) or _kind(part) != "map":
        return None
    try:
        heights = np.asarray(part.get("heights"), dtype=np.float64)
    except (TypeError, ValueError):
        return None  # said where the map is checked
    return heights if heights.ndim == 3 else None


def _member(part: Any, maps: Floats | None, k: int) -> object:
    """A part as member k has it; maps: those of `_maps`."""
    if maps is not None:
        return {**part, "heights": maps[k]}
    if _kind(part) != "fractal":
        return part
    part = {"kind": part} if isinstance(part, str) else part
    seed = part.get("seed", 0)  # one that is no number is told where the fractal is checked
    return {**part, "seed": seed + k if isinstance(seed, (int, float)) else seed}


def _members(choice: object) -> list[object]:
    """The terrains of one part of kind "drawn". Raises ValueError."""
    what, names = f"terrain of kind '{KIND}'", ("kind", "of", "count", "terrains")
    keys = checked_keys(what, choice if isinstance(choice, Mapping) else {}, names)
    if ("of" in keys) == ("terrains" in keys):
        raise ValueError(f"{what}; must have either 'of' or 'terrains'")
    if "terrains" in keys:
        terrains = keys["terrains"]
        is_list = isinstance(terrains, Sequence) and not isinstance(terrains, (str, Mapping))
        if not is_list or not terrains:
            raise ValueError(f"terrains = {terrains!r}; must be a list of terrains to draw from")
        if "count" in keys:
            raise ValueError("count of drawn terrains; goes with 'of'. 'terrains' are all listed")
        return list(terrains)
    parts = _parts(keys["of"])
    maps = [_maps(part) for part in parts]
    counts = [len(each) for each in maps if each is not None]
    if not counts and not any(_kind(part) == "fractal" for part in parts):
        raise ValueError(
            f"{what}; 'of' must have a fractal, or a map with heights (count, rows, columns): "
            "else all its terrains are the same"
        )
    name = "count of drawn terrains"
    count = checked_whole(name, keys.get("count", min(counts, default=16)), _COUNT)
    if counts and count > min(counts):
        raise ValueError(f"{name} = {count} with {min(counts)} maps; must be at most as many")
    return [[*map(_member, parts, maps, [k] * len(parts))] for k in range(count)]


def _padded(arrays: list[Floats], row: Sequence[float]) -> Floats:
    """Arrays of rows as one array: all as long as the longest, filled with `row`."""
    most = max(len(array) for array in arrays)
    return np.array([np.concatenate([a, np.tile(row, (most - len(a), 1))]) for a in arrays])


def _stacked(fields: Sequence[HeightField]) -> Relief:
    """Reliefs of all members. Raises ValueError for maps of different shapes."""
    reliefs = [field.relief for field in fields]
    shapes = sorted({relief.heights.shape for relief in reliefs})
    if len(shapes) > 1:
        raise ValueError(
            f"drawn terrains with maps of shapes {shapes}; must be of one shape, and all or none "
            "must have a map. Crop them, or sample them on the same grid"
        )
    size = len(reliefs) * reliefs[0].heights.size
    if size > LARGEST:
        raise ValueError(f"drawn terrains with {size:.1e} heights; must be at most {LARGEST:.0e}")
    planes, edges, waves, heights, frames = (list(arrays) for arrays in zip(*reliefs, strict=True))
    edge_rows, wave_rows = _padded(edges, _NO_EDGE), _padded(waves, _NO_WAVE)
    return Relief(np.array(planes), edge_rows, wave_rows, np.array(heights), np.array(frames))


def make_pool(terrain: object) -> Pool:
    """Terrains to draw from, or the one that is given. Raises ValueError as make_height_field."""
    parts = [terrain] if isinstance(terrain, HeightField) else _parts(terrain)
    for part in parts:
        if isinstance(part, str | Mapping):
            checked_choice("terrain kind", _kind(part), (*KINDS, KIND))
    choices = [k for k, part in enumerate(parts) if _kind(part) == KIND]
    if len(choices) > 1:
        raise ValueError(f"terrain with {len(choices)} drawn parts; must be one at most")
    fields = [make_height_field(terrain)] if not choices else []
    for k in choices:
        for member in _members(parts[k]):
            fields.append(make_height_field([*parts[:k], *_parts(member), *parts[k + 1 :]]))
    return Pool(tuple(fields), _stacked(fields))
