"""The ground of one vehicle in one episode: a terrain of the pool, and what was drawn on top.

    h(x, y) = h_k(x, y) + a x + b y + sum_i A_i sin(kx_i x + ky_i y + phi_i)
What is drawn is RELIEF_SIZE numbers a, b, (A, kx, ky, phi) ... of the vehicle's row of the batch;
unused sinusoids have A = 0. The laws are in `tracked_env.uncertainty.slopes`. The column behind
them has k, the member of `terrain.pool` that the episode has drawn.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.ground_contact import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y
from tracked_env.physics.jit import formula, loop
from tracked_env.terrain.height_field import STEEPEST
from tracked_env.terrain.pool import member_of
from tracked_env.terrain.relief import Relief, add_wave, fill

DRAWN_WAVES = 8
RELIEF_SIZE = 2 + 4 * DRAWN_WAVES
RELIEF_COLUMNS = RELIEF_SIZE + 1  # and the member of the pool
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


def checked_relief(given: Any) -> tuple[float, ...]:
    """A drawn relief as numbers; empty for none. Raises ValueError."""
    numbers = tuple(float(value) for value in given)
    if len(numbers) not in (0, RELIEF_SIZE) or not all(math.isfinite(value) for value in numbers):
        raise ValueError(
            f"relief of {len(numbers)} numbers; must be {RELIEF_SIZE} finite ones, two slopes and "
            f"{DRAWN_WAVES} rows [A, kx, ky, phi], or none"
        )
    steep = math.hypot(*numbers[:2]) if numbers else 0.0
    for k in range(2, len(numbers), 4):
        steep += abs(numbers[k]) * math.hypot(numbers[k + 1], numbers[k + 2])
    if steep > STEEPEST:
        raise ValueError(
            f"relief with a slope of up to {steep:.3g}; must be at most {STEEPEST:g}. "
            "Are the wave numbers in rad/m?"
        )
    return numbers


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
