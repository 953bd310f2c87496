"""What is under a vehicle at a place: soil, height and slope, as kernels evaluate them.

The soil starts with the parameters of the episode; each event changes one of them in turn, by
time and place (`tracked_env.events`). `soil_at` gives the soil at any place, under a track or under
a patch, so that a plant decides where its soil is asked for.

    h(x, y) = c + a x + b y + sum of ramps and steps + sum_i A_i sin(kx_i x + ky_i y + phi_i) + grid
A ramp or a step rises along a direction e from the distance s0 on, over the length L. With
u = (e . (x, y) - s0) / L:
    ramp  0;  tan(s) L (u/2 - sin(pi u)/(2 pi));  tan(s) L (u - 1/2)        u < 0; 0..1; u > 1
    step  0;  H (u - sin(2 pi u)/(2 pi));         H
The slope of a ramp rises as (1 - cos(pi u))/2, that of a step never exceeds 2 H / L. The grid is a
height map on a square mesh:
    bilinear  continuous; the slope jumps at the edges of cells by curvature times cell
    bicubic   Catmull-Rom: continuous slope, through all heights
Beyond its edge the map keeps the height of the nearest place on it, and the place counts as off the
map. Loops here fill whole arrays, one term at a time, so that they vectorise.

Under the tracks places are evenly spaced: column c, row j of the left track at P + c d + g + j e,
of the right one, its mirror image, at P + c d - g - j e. By the addition theorem,
    sin(K . (P + c d + g + j e) + phi) = Im(U_c V_j),   U_c = U_(c-1) exp(i K . d),  V_j likewise
with the conjugate of V_j on the right, so that a sinusoid takes four sines and cosines and not one
for each patch: `add_waves`.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.events import changed_value
from tracked_env.physics import parameters
from tracked_env.physics.elementary import apart, rotation
from tracked_env.physics.jit import formula, loop, summation
from tracked_env.physics.parameters import GROUPS, PARAMETER_INDEX, PlantParameters, SoilParameters
from tracked_env.physics.patches_on_terrain import HEIGHT, PLACE_X, PLACE_Y, SLOPE_X, SLOPE_Y, WIDE

RAMP, STEP = 0.0, 1.0  # kinds of an edge
MOST_ROWS = 80  # of patches, of a track

# Places in the scratch of `add_waves`, where WIDE sinusoids lie side by side; they are constants of
# the compiler, or else its loops could not vectorise.
AMPLITUDE, K_X, K_Y, PHASE = range(0, 4 * WIDE, WIDE)
_ANGLES = 4 * WIDE  # [rad] of: the first patch, the next column, the left track, the next row
_COSINE, _SINE = 8 * WIDE, 12 * WIDE  # of these
_U, _U_SINE, _V, _V_SINE = range(16 * WIDE, 20 * WIDE, WIDE)  # A U_c and V_j
_SUMS = 20 * WIDE  # height and slopes of WIDE patches of one column
_TABLE, _TABLE_SINE = 24 * WIDE, (24 + WIDE) * WIDE  # V_j of WIDE rows: [sinusoid, j]
_ROWS = (24 + 2 * WIDE) * WIDE  # V_j of the left track: [j, cosine or sine, sinusoid]
WAVE_SCRATCH = _ROWS + 2 * WIDE * MOST_ROWS


@formula
def parameter_at(value, parameter, events, i, count, time, x, y):
    """One parameter (its row) at `time` [s] and (x, y) [m]: `value`, changed by each event."""
    for e in range(count):
        if int(events[i, e, 1]) == parameter:
            value = changed_value(value, events, i, e, time, x, y)
    return value


@formula
def _value(batch, i, time, parameter, x, y):
    """One parameter of the soil of vehicle i at `time` [s] and (x, y) [m]."""
    first, count = batch.floats[i, b.BASE + parameter], batch.counters[i, b.EVENT_COUNT]
    return parameter_at(first, parameter, batch.events, i, count, time, x, y)


# (batch, i, time, x, y): SoilParameters at (x, y) [m] and `time` [s] in the episode of vehicle i.
soil_at = parameters.gathering(
    SoilParameters,
    "batch, i, time, x, y",
    {name: f"value(batch, i, time, {PARAMETER_INDEX[name]}, x, y)" for name in GROUPS["soil"]},
    value=_value,
)
# (p, soil): PlantParameters p with another soil.
on_soil = parameters.gathering(
    PlantParameters,
    "p, soil",
    {n: f"soil.{n}" if n in GROUPS["soil"] else f"p.{n}" for n in PlantParameters._fields},
)


class Relief(NamedTuple):
    """A terrain as plain arrays; made by `tracked_env.terrain.height_field`."""

    plane: NDArray[np.float64]  # (3,) c [m], a, b [-]
    edges: NDArray[np.float64]  # (E, 6) kind, tan(s) or H [m], e_x, e_y, s0 [m], L [m]
    waves: NDArray[np.float64]  # (S, 4) A [m], kx, ky [rad/m], phi [rad]
    heights: NDArray[np.float64]  # (rows, columns) [m] along y, along x; (0, 0): no map
    frame: NDArray[np.float64]  # (4,) x, y [m] of heights[0, 0], 1/cell [1/m], 1 = bicubic


@formula
def _add_edge(w, count, edge):
    """Add one ramp or step to lanes 0 .. count - 1."""
    kind, size, e_x, e_y, first = edge[0], edge[1], edge[2], edge[3], edge[4]
    inverse = 1.0 / edge[5]
    ramp = kind == RAMP
    half = 0.5 if ramp else 1.0
    rise = 0.5 * size * edge[5] if ramp else size  # at u = 1
    end = size if ramp else 0.0  # slope beyond u = 1
    steep = size if ramp else 2.0 * size * inverse  # largest slope
    for lane in range(count):
        u = (e_x * w[PLACE_X, lane] + e_y * w[PLACE_Y, lane] - first) * inverse
        inside = min(max(u, 0.0), 1.0)
        cosine, sine = rotation(half * math.pi * inside)
        # Half angles: sin(2 a) = 2 sin(a) cos(a) and 1 - cos(2 a) = 2 sin(a)^2.
        along = inside - sine * cosine / (half * math.pi)
        beyond = max(u, 1.0) - 1.0
        w[HEIGHT, lane] += rise * along + end * beyond * edge[5]
        slope = steep * sine * sine
        w[SLOPE_X, lane] += slope * e_x
        w[SLOPE_Y, lane] += slope * e_y


@formula
def add_wave(w, count, amplitude, k_x, k_y, phase):
    """Add one sinusoid to lanes 0 .. count - 1."""
    steep_x, steep_y = amplitude * k_x, amplitude * k_y
    for lane in range(count):
        cosine, sine = rotation(k_x * w[PLACE_X, lane] + k_y * w[PLACE_Y, lane] + phase)
        w[HEIGHT, lane] += amplitude * sine
        w[SLOPE_X, lane] += steep_x * cosine
        w[SLOPE_Y, lane] += steep_y * cosine


@formula
def _cell(position, last):
    """(first node, share of the way to the next one, 1 on the map or 0) of a position [cells]."""
    clamped = min(max(position, 0.0), last)
    inside = 1.0 if clamped == position else 0.0
    node = max(min(int(clamped), int(last) - 1), 0)  # NaN has no node
    return node, clamped - node, inside


@formula
def _cubic(u):
    """Catmull-Rom weights of the four nodes around u in [0, 1], and their derivatives."""
    v = u - 1.0
    first, second = -0.5 * u * v * v, 1.0 + u * u * (1.5 * u - 2.5)
    third, fourth = -u * (1.5 * u * u - 2.0 * u - 0.5), 0.5 * u * u * v
    slope_1, slope_2 = -0.5 * v * (3.0 * u - 1.0), u * (4.5 * u - 5.0)
    slope_3, slope_4 = -4.5 * u * u + 4.0 * u + 0.5, 0.5 * u * (3.0 * u - 2.0)
    return (first, second, third, fourth), (slope_1, slope_2, slope_3, slope_4)


@formula
def _bilinear(heights, i, j, u, v):
    """(height, rise per cell along x, along y) between four nodes."""
    h00, h01 = heights[i, j], heights[i, j + 1]
    h10, h11 = heights[i + 1, j], heights[i + 1, j + 1]
    low, high = h01 - h00, h11 - h10
    along_x = low + v * (high - low)
    along_y = (h10 - h00) + u * (high - low)
    return h00 + u * low + v * along_y, along_x, along_y


@formula
def _bicubic(heights, i, j, u, v):
    """The same between sixteen nodes; at the edge of the map the last node stands for the next."""
    in_x, slope_x = _cubic(u)
    in_y, slope_y = _cubic(v)
    height, along_x, along_y = 0.0, 0.0, 0.0
    for k in range(4):
        row = min(max(i + k - 1, 0), heights.shape[0] - 1)
        value, slope = 0.0, 0.0
        for m in range(4):
            node = heights[row, min(max(j + m - 1, 0), heights.shape[1] - 1)]
            value += in_x[m] * node
            slope += slope_x[m] * node
        height += in_y[k] * value
        along_x += in_y[k] * slope
        along_y += slope_y[k] * value
    return height, along_x, along_y


@formula
def _add_map(w, count, heights, frame):
    """Add the height map to lanes 0 .. count - 1; returns how many of them are on it."""
    inverse = frame[2]
    last_x, last_y = heights.shape[1] - 1.0, heights.shape[0] - 1.0
    bicubic = frame[3] > 0.5
    inside = 0.0
    for lane in range(count):
        j, u, in_x = _cell((w[PLACE_X, lane] - frame[0]) * inverse, last_x)
        i, v, in_y = _cell((w[PLACE_Y, lane] - frame[1]) * inverse, last_y)
        if bicubic:
            height, along_x, along_y = _bicubic(heights, i, j, u, v)
        else:
            height, along_x, along_y = _bilinear(heights, i, j, u, v)
        w[HEIGHT, lane] += height
        w[SLOPE_X, lane] += in_x * inverse * along_x
        w[SLOPE_Y, lane] += in_y * inverse * along_y
        inside += in_x * in_y
    return inside


@formula
def _turned(t, at, by):
    """Multiply the WIDE complex numbers at `at` by those at `by`; at: (cosine, sine)."""
    for k in range(WIDE):
        cosine, sine = t[at[0] + k], t[at[1] + k]
        c, s = t[by[0] + k], t[by[1] + k]
        t[at[0] + k] = cosine * c - sine * s
        t[at[1] + k] = cosine * s + sine * c


@formula
def _eight(t, first):
    """The WIDE numbers from t[first] on."""
    a, b, c, d = t[first], t[first + 1], t[first + 2], t[first + 3]
    return a, b, c, d, t[first + 4], t[first + 5], t[first + 6], t[first + 7]


@summation
def _sum_column(t, cosines, sines, k_x, k_y):
    """Height and slopes at WIDE places of one column; cosines, sines: those of A U_c."""
    for j in range(WIDE):
        height, slope_x, slope_y = 0.0, 0.0, 0.0
        for k in range(WIDE):
            cosine, sine = t[_TABLE + k * WIDE + j], t[_TABLE_SINE + k * WIDE + j]
            along = cosines[k] * cosine - sines[k] * sine
            height += sines[k] * cosine + cosines[k] * sine
            slope_x += k_x[k] * along
            slope_y += k_y[k] * along
        t[_SUMS + j] = height
        t[_SUMS + WIDE + j] = slope_x
        t[_SUMS + 2 * WIDE + j] = slope_y


@formula
def _rotate_grid(t, grid):
    """Sines and cosines of the steps of the grid, and V_j of all rows."""
    for k in range(WIDE):
        k_x, k_y = t[K_X + k], t[K_Y + k]
        t[_ANGLES + k] = k_x * grid.x + k_y * grid.y + t[PHASE + k]
        t[_ANGLES + WIDE + k] = k_x * grid.column_x + k_y * grid.column_y
        t[_ANGLES + 2 * WIDE + k] = k_x * grid.track_x + k_y * grid.track_y
        t[_ANGLES + 3 * WIDE + k] = k_x * grid.row_x + k_y * grid.row_y
    for k in range(4 * WIDE):
        t[_COSINE + k], t[_SINE + k] = rotation(t[_ANGLES + k])
    for k in range(WIDE):
        t[_V + k], t[_V_SINE + k] = t[_COSINE + 2 * WIDE + k], t[_SINE + 2 * WIDE + k]
    for j in range(grid.rows):
        at = _ROWS + 2 * WIDE * j
        for k in range(WIDE):
            t[at + k], t[at + WIDE + k] = t[_V + k], t[_V_SINE + k]
        _turned(t, (_V, _V_SINE), (_COSINE + 3 * WIDE, _SINE + 3 * WIDE))


@formula
def add_waves(w, t, grid):
    """Add WIDE sinusoids to the lanes of the patches; grid: `terrain_motion.Grid`.

    t (WAVE_SCRATCH,): their amplitudes, wave numbers and phases, see AMPLITUDE. A function apart in
    the machine code: within a larger one not all of its loops are vectorised. It is a formula, so
    that a kernel has the only copy; another one might add up in another order.
    """
    apart()
    _rotate_grid(t, grid)
    rows, k_x, k_y = grid.rows, _eight(t, K_X), _eight(t, K_Y)
    for first in range(0, 2 * rows, WIDE):
        for j in range(WIDE):
            row = min(first + j, 2 * rows - 1)
            at, sign = _ROWS + 2 * WIDE * row, 1.0
            if row >= rows:
                at, sign = _ROWS + 2 * WIDE * (2 * rows - 1 - row), -1.0
            for k in range(WIDE):
                t[_TABLE + k * WIDE + j] = t[at + k]
                t[_TABLE_SINE + k * WIDE + j] = sign * t[at + WIDE + k]
        for k in range(WIDE):
            t[_U + k] = t[AMPLITUDE + k] * t[_COSINE + k]
            t[_U_SINE + k] = t[AMPLITUDE + k] * t[_SINE + k]
        for c in range(grid.columns):
            _sum_column(t, _eight(t, _U), _eight(t, _U_SINE), k_x, k_y)
            for j in range(min(WIDE, 2 * rows - first)):
                lane = (first + j) * grid.columns + c
                w[HEIGHT, lane] += t[_SUMS + j]
                w[SLOPE_X, lane] += t[_SUMS + WIDE + j]
                w[SLOPE_Y, lane] += t[_SUMS + 2 * WIDE + j]
            _turned(t, (_U, _U_SINE), (_COSINE + WIDE, _SINE + WIDE))


@formula
def fill_even(relief, w, count, slope_x, slope_y):
    """As `fill`, without the sinusoids; slope_x, slope_y [-]: of a plane that is added."""
    c, a, b = relief.plane[0], relief.plane[1] + slope_x, relief.plane[2] + slope_y
    for lane in range(count):
        w[HEIGHT, lane] = c + (a * w[PLACE_X, lane] + b * w[PLACE_Y, lane])
        w[SLOPE_X, lane] = a
        w[SLOPE_Y, lane] = b
    for e in range(relief.edges.shape[0]):
        _add_edge(w, count, relief.edges[e])
    inside = float(count)
    if relief.heights.size > 0:
        inside = _add_map(w, count, relief.heights, relief.frame)
    return count - inside


@formula
def fill(relief, w, count):
    """Rows HEIGHT [m], SLOPE_X, SLOPE_Y [-] of w at rows PLACE_X, PLACE_Y [m], lanes 0 .. count-1.

    Returns how many of these places lie off the map.
    """
    off = fill_even(relief, w, count, 0.0, 0.0)
    waves = relief.waves
    for k in range(waves.shape[0]):
        add_wave(w, count, waves[k, 0], waves[k, 1], waves[k, 2], waves[k, 3])
    return off


@loop
def fill_places(relief, w):
    """The same for all lanes of w, from Python."""
    return fill(relief, w, w.shape[1])
