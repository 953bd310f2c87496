"""A choice of terrains, of which every episode draws one.

    {"kind": "drawn", "of": {"kind": "fractal", "seed": 3}, "count": 16}     seeds 3, 4, ... 18
    {"kind": "drawn", "of": {"kind": "map", "heights": maps, "cell": 0.1}}   one of the maps
    {"kind": "drawn", "terrains": ["hills", {"kind": "ramp", "slope": 0.3}]}
`of` is any terrain; member k of the choice has k added to the seeds of its fractals and the k-th
of maps (count, rows, columns). A list with one such part is a choice of sums. Every other
terrain is a choice of one. Kernels take all members as one `Relief` whose arrays have the member as
their first axis; sinusoids and edges that a member does not have are there without height.

The ground of one vehicle in one episode: a terrain of the pool, and what was drawn on top.

    h(x, y) = h_k(x, y) + a x + b y + sum_i A_i sin(kx_i x + ky_i y + phi_i)
What is drawn is RELIEF_SIZE numbers a, b, (A, kx, ky, phi) ... of the vehicle's row of the batch;
unused sinusoids have A = 0. The laws are in `tracked_env.uncertainty.laws`. The column behind
them has k, the member of `terrain.pool` that the episode has drawn.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import Range
from tracked_env.physics.patches_on_terrain import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y
from tracked_env.terrain.ground import DRAWN_WAVES, RELIEF_SIZE
from tracked_env.terrain.height_field import (
    KINDS,
    LARGEST,
    HeightField,
    make_height_field,
)
from tracked_env.terrain.relief import STEP, Relief, add_wave, fill
from tracked_env.validation import checked_choice, checked_keys, checked_whole

KIND = "drawn"
_COUNT = Range(1, 10**5, "-", "It is the number of terrains to draw from.")
_NO_EDGE = (STEP, 0.0, 1.0, 0.0, 0.0, 1.0)  # a step without height


class Pool(NamedTuple):
    """Terrains to draw from."""

    fields: tuple[HeightField, ...]
    reliefs: Relief  # of all of them, the member as the first axis


@formula
def member_of(reliefs, k):
    """Relief of member k."""
    return Relief(
        reliefs.plane[k], reliefs.edges[k], reliefs.waves[k], reliefs.heights[k], reliefs.frame[k]
    )


def _parts(given: object) -> list[Any]:
    """The parts of a terrain, whether it is a sum or not."""
    several = isinstance(given, Sequence) and not isinstance(given, str)
    return list(given) if several else [given]  # type: ignore[call-overload]


def _kind(part: object) -> object:
    """Kind of a part, as it is given."""
    if isinstance(part, Mapping):
        return part.get("kind")
    return part if isinstance(part, str) else None


def _is_drawn(part: object) -> bool:
    return _kind(part) == KIND


def _read(part: object) -> object:
    """A part whose heights, where they are in three dimensions, are an array."""
    if not isinstance(part, Mapping) or _kind(part) != "map":
        return part
    try:
        heights = np.asarray(part.get("heights"), dtype=np.float64)
    except (TypeError, ValueError):
        return part  # said where the map is checked
    return {**part, "heights": heights} if heights.ndim == 3 else part


def _maps(part: object) -> int:
    """How many maps a part has to draw from; 0 where its heights are one map, or it is none."""
    heights = part.get("heights") if isinstance(part, Mapping) else None
    return len(heights) if isinstance(heights, np.ndarray) and heights.ndim == 3 else 0


def _member(part: object, k: int) -> object:
    """A part as member k has it."""
    if isinstance(part, str):
        part = {"kind": part}
    if isinstance(part, Mapping) and _kind(part) == "fractal":
        seed = part.get("seed", 0)  # one that is no number is told where the fractal is checked
        return {**part, "seed": seed + k if isinstance(seed, (int, float)) else seed}
    if isinstance(part, Mapping) and _maps(part):
        return {**part, "heights": part["heights"][k]}
    return part


def _members(drawn: object) -> list[object]:
    """The terrains of one part of kind "drawn". Raises ValueError."""
    given = drawn if isinstance(drawn, Mapping) else {}
    checked_keys(f"terrain of kind '{KIND}'", given, ("kind", "of", "count", "terrains"))
    if ("of" in given) == ("terrains" in given):
        raise ValueError(f"terrain of kind '{KIND}'; must have either 'of' or 'terrains'")
    if "terrains" in given:
        listed = given["terrains"]
        if isinstance(listed, (str, Mapping)) or not isinstance(listed, Sequence) or not listed:
            raise ValueError(f"terrains = {listed!r}; must be a list of terrains to draw from")
        if "count" in given:
            raise ValueError("count of drawn terrains; goes with 'of'. 'terrains' are all listed")
        return list(listed)
    parts = [_read(part) for part in _parts(given["of"])]
    maps = [count for count in map(_maps, parts) if count]
    seeded = any(_kind(part) == "fractal" for part in parts)
    if not maps and not seeded:
        raise ValueError(
            f"terrain of kind '{KIND}'; 'of' must have a fractal, or a map with heights of shape "
            "(count, rows, columns): else all its terrains are the same"
        )
    count = checked_whole(
        "count of drawn terrains", given.get("count", min(maps, default=16)), _COUNT
    )
    if maps and count > min(maps):
        raise ValueError(
            f"count of drawn terrains = {count} with {min(maps)} maps; must be at most as many"
        )
    return [[_member(part, k) for part in parts] for k in range(count)]


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

    def filled(arrays: list[NDArray[np.float64]], row: Sequence[float]) -> NDArray[np.float64]:
        most = max(len(array) for array in arrays)
        rows = [np.concatenate([a, np.tile(row, (most - len(a), 1))]) for a in arrays]
        return np.ascontiguousarray(rows)

    return Relief(
        np.array([relief.plane for relief in reliefs]),
        filled([relief.edges for relief in reliefs], _NO_EDGE),
        filled([relief.waves for relief in reliefs], (0.0,) * 4),
        np.array([relief.heights for relief in reliefs]),
        np.array([relief.frame for relief in reliefs]),
    )


def make_pool(given: object) -> Pool:
    """Terrains to draw from, or the one that is given. Raises ValueError as make_height_field."""
    parts = [given] if isinstance(given, HeightField) else _parts(given)
    for part in parts:
        if isinstance(part, str | Mapping):
            checked_choice("terrain kind", _kind(part), (*KINDS, KIND))
    drawn = [k for k, part in enumerate(parts) if _is_drawn(part)]
    if len(drawn) > 1:
        raise ValueError(f"terrain with {len(drawn)} drawn parts; must be one at most")
    if not drawn:
        fields = [make_height_field(given)]
    else:
        k = drawn[0]
        sums = [[*parts[:k], *_parts(member), *parts[k + 1 :]] for member in _members(parts[k])]
        fields = [make_height_field(terrain) for terrain in sums]
    return Pool(tuple(fields), _stacked(fields))


SCAN_ROWS = 5  # of the scratch: places, heights, slopes


@formula
def fill_there(there, w, count):
    """As `relief.fill`; there: its relief, floats (N, W), row of the vehicle, column of a."""
    relief, floats, i, first = there
    off = fill(relief, w, count)
    a, b = floats[i, first], floats[i, first + 1]
    if a != 0.0 or b != 0.0:
        for lane in range(count):
            w[HEIGHT, lane] += a * w[PLACE_X, lane] + b * w[PLACE_Y, lane]
            w[SLOPE_X, lane] += a
            w[SLOPE_Y, lane] += b
    for k in range(DRAWN_WAVES):
        at = first + 2 + 4 * k
        if floats[i, at] != 0.0:
            add_wave(
                w, count, floats[i, at], floats[i, at + 1], floats[i, at + 2], floats[i, at + 3]
            )
    return off


@loop
def fill_rows(reliefs, floats, first, rows, x, y, found):
    """Heights and slopes found (n, 3, M) at places x, y (n, M) on the ground of `rows` (n,)."""
    count = x.shape[1]
    w = np.empty((SCAN_ROWS, count))
    for k in range(rows.size):
        w[PLACE_X], w[PLACE_Y] = x[k], y[k]
        relief = member_of(reliefs, int(floats[rows[k], first + RELIEF_SIZE]))
        fill_there((relief, floats, rows[k], first), w, count)
        found[k, 0], found[k, 1], found[k, 2] = w[HEIGHT], w[SLOPE_X], w[SLOPE_Y]


def ground_at(
    reliefs: Relief,
    floats: NDArray[np.float64],
    first: int,
    rows: NDArray[np.int64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n, 3, M) height [m] and slopes [-] at places x, y (n, M) [m] on the ground of `rows`.

    reliefs: of a `Pool`.
    """
    found = np.empty((x.shape[0], 3, x.shape[1]))
    fill_rows(
        reliefs, floats, first, np.asarray(rows, dtype=np.int64),
        np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64), found,
    )  # fmt: skip
    return found
