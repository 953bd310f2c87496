"""The grounds of section 8: the height map of the authors, and a seeded field with like slopes.

F drives on a mesh that was drawn in Blender and is published with the authors' code. Its height
map is not part of this project: `authors_map` reads it where it lies beside the project. `field` is
for everyone. Nine tenths of the map are nearly level and the rest are hills, so that its slopes
have a long tail: 90 % of them over the median is 10, where the heights of a Gaussian field (any
`fractal`) give 1.8. Therefore
    h = w ln(1 + exp((z - z_0) / w))
with z a fractal: hills where z exceeds z_0, level ground where it does not. Amplitude, z_0 and w
are fitted to the median, 90 % and 99 % of the slopes of the map; `slopes` computes them for both.

Reference: [1] Focchi et al. (2025), section 8.
"""

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from reproduce.focchi2025.runs import Floats
from tracked_env.terrain.height_field import HeightField, make_height_field

# In a folder beside that of the project.
MAP = Path(__file__).parents[3] / "shared" / "data" / "terrain_mesh" / "height_5cm.npz"
FRACTAL: dict[str, Any] = {
    "kind": "fractal", "height": 0.67, "seed": 2, "hurst": 1.0, "longest": 30.0, "shortest": 8.0,
    "count": 32,
}  # fmt: skip
LEVEL, ROUNDING = 0.124, 0.112  # [m] z_0, w
HALF_SIDE, CELL = 29.5, 0.1  # [m] of the field; that of the map is the same
SHARES = (50.0, 90.0, 99.0)  # [%] of the slopes that are compared


class UnevenGround(NamedTuple):
    """A ground of section 8."""

    name: str
    field: HeightField
    start: tuple[float, float]  # [m] x, y of 8.3, on a flank that falls towards -x


def authors_map(file: Path | None = None) -> tuple[UnevenGround | None, str]:
    """The authors' map, None is MAP, and why it is missing ("": it is there)."""
    file = MAP if file is None else file
    if not file.exists():
        return None, f"height map of the authors: no file {file}, left out; the seeded field is run"
    spec = {"kind": "map", "file": str(file), "interpolation": "bilinear"}
    return UnevenGround("authors' map", make_height_field(spec), (15.0, 2.0)), ""


@lru_cache(maxsize=1)
def field() -> UnevenGround:
    """The seeded field: the same numbers everywhere."""
    axis = np.linspace(-HALF_SIDE, HALF_SIDE, round(2.0 * HALF_SIDE / CELL) + 1)
    z = make_height_field(FRACTAL).at(*np.meshgrid(axis, axis))[0]
    heights = ROUNDING * np.logaddexp(0.0, (z - LEVEL) / ROUNDING)
    made = make_height_field({"kind": "map", "heights": heights, "cell": CELL})
    return UnevenGround("seeded field", made, (1.7, 10.4))


def slopes(ground: UnevenGround) -> Floats:
    """SHARES of the slopes |dz/dx, dz/dy| [-] over the whole of a ground."""
    axis = np.arange(-HALF_SIDE + 0.5 * CELL, HALF_SIDE, CELL)
    _, slope_x, slope_y = ground.field.at(*np.meshgrid(axis, axis))
    return np.asarray(np.percentile(np.hypot(slope_x, slope_y), SHARES))
