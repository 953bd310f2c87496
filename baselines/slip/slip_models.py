"""Slip models that are looked up in the control loop: sprocket speeds in, beta and alpha out.

    beta_k = r omega_k - v_k,  v_L = v_x - w B/2, v_R = v_x + w B/2     F (30), (31) in the sign of
                                                                        F's text and data
    v_x    = (r omega_L - beta_L + r omega_R - beta_R) / 2              F (29), sign of F's text
    alpha  = atan(v_y v_x / (v_x^2 + e^2))                              F (28), e = SLOW
    SlipFamily            tables over sprocket speeds, friction and slope, on level ground one slope
    TableSlipModel        a family at known friction, on known slopes
    NoSlip                zero
F fits alpha itself, apart for both signs of v_x, where it flips by pi. The side velocity v_y has no
such jump: a table holds beta_L, beta_R and v_y, and alpha follows; e keeps it continuous.

Slopes. The direction of gravity is the grade along and across the vehicle,
    t_x = g_x / |g_z| = tan(pitch) / cos(roll),    t_y = g_y / |g_z| = -tan(roll)          F (34)
and the tables are over t / mu: a vehicle slides where |t| reaches mu, on every soil, and what the
slope does to slip hardly depends on mu otherwise.
    friction linear in 1 / mu: slip grows with the side force over friction
    slopes   bilinear
    speeds   on slopes linear on the triangles on both sides of omega_L = omega_R: in a turn all
             patches slide sideways, and gravity drags the vehicle along in proportion to |w|, so
             that slip has an edge at w = 0. On level ground there is none: bilinear
Beyond a share STEEPEST of what friction can hold, and at nodes where no motion is steady, slip is
that of a gentler slope in the same direction, the nearest one that has a steady motion; `holds`
says False there. Outside the table the value at its edge is taken. At standstill on level ground
slip is exactly zero. NaN speeds give NaN.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2, 4, 4.5.
"""

import math
from pathlib import Path
from typing import IO, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.jit import formula, loop
from tracked_env.validation import plain_arrays

Array = NDArray[np.float64]
Slip = tuple[Array, Array, Array]  # beta_left, beta_right [m/s], alpha [rad], (N,) each


class SlipModel(Protocol):
    """Steady slip of a vehicle as a function of its sprocket speeds."""

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""


class NoSlip:
    """The slip model of a unicycle: none."""

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """Three arrays of zeros, (N,)."""
        none = np.zeros(np.shape(sprocket_left))
        return none, none.copy(), none.copy()


SLOW = 0.005  # [m/s] e: below it alpha fades out; alpha is 1 % small at ten times this speed
CHANNELS = 3  # of a table: beta_left, beta_right, v_y [m/s]
STEEPEST = 0.875  # [-] of |t| / mu, up to which slip is looked up
LEVEL: Array = np.zeros((1, 2))  # grade


class Grid(NamedTuple):
    """A regular grid of sprocket speeds with a node at standstill."""

    spacing: float  # [rad/s]
    zero_left: int  # index of the node where the left sprocket stands
    zero_right: int
    count_left: int
    count_right: int


class Table(NamedTuple):
    """What is looked up."""

    values: Array  # (M, left, right, n, n, CHANNELS): friction, speeds, t_x, t_y; level: n = 1
    grid: Grid  # of the speeds
    spacing: float  # [-] of t / mu between slopes, 0 in the middle
    radius: float  # [m] of the sprockets


class FrictionLayers(NamedTuple):
    """Where N vehicles lie between the frictions of a table."""

    friction: Array  # [-] mu (n,), repeats
    layer: NDArray[np.int64]  # (N,)
    share: Array  # (N,) of the next layer

    @classmethod
    def of(cls, frictions: Array, friction: ArrayLike, count: int) -> "FrictionLayers":
        """For `count` vehicles whose mu repeats."""
        mu = np.ascontiguousarray(friction, dtype=np.float64).reshape(-1)
        places = cls(mu, np.zeros(count, dtype=np.int64), np.zeros(count))
        if len(frictions) > 1:
            layers(frictions, *places)
        return places


def grades(roll: ArrayLike, pitch: ArrayLike) -> Array:
    """(N, 2) grade t_x, t_y [-] that a vehicle at roll and pitch [rad], (N,), feels."""
    roll, pitch = np.atleast_1d(roll).astype(float), np.atleast_1d(pitch).astype(float)
    return np.stack([np.tan(pitch) / np.cos(roll), -np.tan(roll)], axis=1)


@formula
def slip_angle(v_x, v_y):
    """alpha [rad] of body velocities [m/s]; 0 at v_x = 0, odd in both."""
    return math.atan(v_y * v_x / (v_x * v_x + SLOW * SLOW))


@formula
def cell(speed, spacing, zero, count):
    """(index, share [-]) of a speed [rad/s] between the nodes index and index + 1, clamped."""
    place = min(max(speed / spacing + zero, 0.0), count - 1.0)
    index = min(int(place), count - 2) if place == place else 0
    return index, place - index


@loop
def layers(frictions, friction, layer, share):
    """Where a friction [-] lies among `frictions` (M,), rising, both (N,) out: share of the way in
    1 / mu from `layer` to the next. friction (n,) repeats; beyond the ends it is theirs."""
    last = frictions.size - 1
    for n in range(layer.size):
        mu = friction[n % friction.size]
        mu = frictions[0] if mu < frictions[0] else mu
        mu = frictions[last] if mu > frictions[last] else mu
        k = 0
        while k < last - 1 and not frictions[k + 1] >= mu:
            k += 1
        low, high = 1.0 / frictions[k], 1.0 / frictions[k + 1]
        layer[n] = k
        share[n] = (low - 1.0 / mu) / (low - high)


@formula
def _bilinear(table, layer, i, a, j, b, channel):
    """Value of one channel of table (M, count_left, count_right, CHANNELS) in cell (i, j)."""
    low = table[layer, i, j, channel] * (1.0 - b) + table[layer, i, j + 1, channel] * b
    high = table[layer, i + 1, j, channel] * (1.0 - b) + table[layer, i + 1, j + 1, channel] * b
    return low * (1.0 - a) + high * a


@loop
def _look_up_level(table, left, right, soil, out):
    """Slip of N vehicles on level ground, as `look_up`."""
    grid, count = table.grid, table.values.shape[0]
    level = table.values.reshape((count, grid.count_left, grid.count_right, CHANNELS))
    for n in range(left.size):
        i, a = cell(left[n], grid.spacing, grid.zero_left, grid.count_left)
        j, b = cell(right[n], grid.spacing, grid.zero_right, grid.count_right)
        m, s = soil.layer[n], soil.share[n]
        for c in range(CHANNELS):
            value = _bilinear(level, m, i, a, j, b, c)
            if s > 0.0:
                value += s * (_bilinear(level, m + 1, i, a, j, b, c) - value)
            out[n, c] = value
        v_x = 0.5 * (table.radius * (left[n] + right[n]) - (out[n, 0] + out[n, 1]))
        out[n, 2] = slip_angle(v_x, out[n, 2])


@formula
def _slopes(flat, at, beside, c, d):
    """(beta_left, beta_right, v_y) bilinear over slopes: node at, the next along t_y CHANNELS
    further, along t_x `beside` further; shares c along t_x, d along t_y."""
    right, ahead, both = at + CHANNELS, at + beside, at + beside + CHANNELS
    near, wide, far, diagonal = (1.0 - c) * (1.0 - d), (1.0 - c) * d, c * (1.0 - d), c * d
    beta_left = near * flat[at] + wide * flat[right] + far * flat[ahead] + diagonal * flat[both]
    at, right, ahead, both = at + 1, right + 1, ahead + 1, both + 1
    beta_right = near * flat[at] + wide * flat[right] + far * flat[ahead] + diagonal * flat[both]
    at, right, ahead, both = at + 1, right + 1, ahead + 1, both + 1
    v_y = near * flat[at] + wide * flat[right] + far * flat[ahead] + diagonal * flat[both]
    return beta_left, beta_right, v_y


@formula
def _interpolated(flat, at, steps, a, b, c, d):
    """Linear over speeds on the triangle of a cell in which (a, b) lies, its long side a = b.

    at: first node of the cell in the flat table; steps: places to the next left and right speed
    and to the next t_x.
    """
    left, right, beside = steps
    corner = at + (left if a >= b else right)
    low, high = (b, a) if a >= b else (a, b)
    p, q, r = 1.0 - high, high - low, low
    x = _slopes(flat, at, beside, c, d)
    y = _slopes(flat, corner, beside, c, d)
    z = _slopes(flat, at + left + right, beside, c, d)
    beta_left = p * x[0] + q * y[0] + r * z[0]
    return beta_left, p * x[1] + q * y[1] + r * z[1], p * x[2] + q * y[2] + r * z[2]


@formula
def _within(along, across):
    """A slope over mu, in its direction, within STEEPEST."""
    square = along * along + across * across
    shrink = STEEPEST / math.sqrt(square) if square > STEEPEST * STEEPEST else 1.0
    return along * shrink, across * shrink


@loop
def look_up_on_slopes(table, speeds, grade, soil, out):
    """Slip of N vehicles: out (N, 3) gets beta_left, beta_right [m/s], alpha [rad].

    speeds (2, N) [rad/s], left then right. grade (n, 2) and the friction of soil repeat.
    """
    grid, flat, count = table.grid, table.values.reshape(-1), table.values.shape[3]
    beside = count * CHANNELS
    steps = (grid.count_right * count * beside, count * beside, beside)
    whole, middle = grid.count_left * steps[0], 0.5 * (count - 1)
    row, mu = 0, 0
    for n in range(speeds.shape[1]):
        left, right = speeds[0, n], speeds[1, n]
        i, a = cell(left, grid.spacing, grid.zero_left, grid.count_left)
        j, b = cell(right, grid.spacing, grid.zero_right, grid.count_right)
        friction = soil.friction[mu]
        along, across = _within(grade[row, 0] / friction, grade[row, 1] / friction)
        x, c = cell(along, table.spacing, middle, count)
        y, d = cell(across, table.spacing, middle, count)
        row, mu = row + 1, mu + 1
        row = row if row < grade.shape[0] else 0
        mu = mu if mu < soil.friction.size else 0
        at = soil.layer[n] * whole + i * steps[0] + j * steps[1] + x * beside + y * CHANNELS
        slip = _interpolated(flat, at, steps, a, b, c, d)
        s = soil.share[n]
        if s > 0.0:
            more, rest = _interpolated(flat, at + whole, steps, a, b, c, d), 1.0 - s
            left_slip, right_slip = rest * slip[0] + s * more[0], rest * slip[1] + s * more[1]
            slip = left_slip, right_slip, rest * slip[2] + s * more[2]
        v_x = 0.5 * (table.radius * (left + right) - (slip[0] + slip[1]))
        out[n, 0], out[n, 1], out[n, 2] = slip[0], slip[1], slip_angle(v_x, slip[2])


def checked_speeds(sprocket_left: ArrayLike, sprocket_right: ArrayLike) -> tuple[Array, Array]:
    """Both sprocket speeds (N,). Raises ValueError for shapes that differ."""
    left, right = (np.asarray(side, dtype=np.float64) for side in (sprocket_left, sprocket_right))
    if not left.ndim or not right.ndim:
        left, right = np.atleast_1d(left), np.atleast_1d(right)
    if left.ndim != 1 or left.shape != right.shape:
        raise ValueError(
            f"sprocket speeds have shapes {left.shape} and {right.shape}; must be one (N,). "
            "Did you pass an array (N, 2) for both sides?"
        )
    return left, right


class SlipFamily:
    """Slip over sprocket speeds, friction and gravity direction; made by `slip_sweep`.

    values (M, left, right, n, n, CHANNELS): beta_left, beta_right, v_y [m/s] on a Grid of speeds
    and of t / mu, `spacing` apart and 0 in the middle, NaN outside what is looked up; or (M, left,
    right, CHANNELS) on level ground. frictions: mu [-] of each, rising. sprocket_radius [m]: of the
    vehicle. steady (M, left, right, n, n): whether a node has a steady motion of its own. Raises
    ValueError for a table that does not fit or is not finite where it is looked up.
    """

    def __init__(
        self,
        values: ArrayLike,
        grid: Grid,
        sprocket_radius: float,
        frictions: ArrayLike,
        spacing: float = 1.0,
        steady: ArrayLike = True,
    ) -> None:
        self.grid = Grid(float(grid.spacing), *(int(value) for value in grid[1:]))
        self.frictions = np.array(frictions, dtype=np.float64)
        if not (len(self.frictions) and (np.diff(self.frictions, prepend=0.0) > 0.0).all()):
            raise ValueError(f"frictions = {self.frictions}; must be positive and rising")
        table = np.array(values, dtype=np.float64, order="C")
        table = table[:, :, :, None, None] if table.ndim == 4 else table
        side = table.shape[3] if table.ndim == 6 else 0
        shape = (len(self.frictions), *self.grid[3:], side, side, CHANNELS)
        reach = side // 2 * spacing if side > 1 else STEEPEST
        valid = table.shape == shape and min(self.grid[3:]) >= 2 and side % 2 == 1
        if not valid or reach < STEEPEST - 1e-9:
            raise ValueError(
                f"slip table has shape {table.shape}; must be {shape}, two speeds a side or more "
                f"and an odd number of slopes up to {STEEPEST} of what friction can hold"
            )
        self.steady = np.array(np.broadcast_to(steady, shape[:-1]), dtype=np.bool_)
        place = spacing * np.abs(np.arange(side) - side // 2)
        near = np.hypot(*np.meshgrid(place, place)) < STEEPEST + np.sqrt(2.0) * spacing
        wrong = np.count_nonzero(~np.isfinite(table[:, :, :, near]))
        if wrong:
            raise ValueError(
                f"slip table has {wrong} values that are not finite where they are looked up; all "
                "must be. Did a run of the sweep not settle?"
            )
        self.sloped = side > 1
        if not self.sloped:
            table[:, self.grid.zero_left, self.grid.zero_right] = 0.0
        self.table = Table(table, self.grid, float(spacing), float(sprocket_radius))

    def slip(
        self,
        sprocket_left: ArrayLike,
        sprocket_right: ArrayLike,
        friction: ArrayLike,
        grade: ArrayLike = LEVEL,
    ) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]), (N,), at sprocket speeds [rad/s].

        friction (k,): mu [-], brought into the range of the family; grade (n, 2): t_x, t_y [-], see
        `grades`, without effect where the family is of level ground. N may be a multiple of n and
        of k: they repeat, as where a controller asks for several speeds of each vehicle. Raises
        ValueError for other numbers of vehicles.
        """
        speeds = checked_speeds(sprocket_left, sprocket_right)
        count, frictions = speeds[0].size, np.size(friction)
        slopes = np.ascontiguousarray(grade if self.sloped else LEVEL, float).reshape(-1, 2)
        if count % len(slopes) or count % frictions:
            raise ValueError(
                f"{count} sprocket speeds for {len(slopes)} slopes and {frictions} frictions; must "
                "be as many or a multiple. Is the model made for another number of vehicles?"
            )
        soil, out = FrictionLayers.of(self.frictions, friction, count), np.empty((count, 3))
        if self.sloped:
            look_up_on_slopes(self.table, np.stack(speeds), slopes, soil, out)
        else:
            _look_up_level(self.table, *speeds, soil, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def holds(
        self, sprocket_left: ArrayLike, sprocket_right: ArrayLike, grade: ArrayLike, friction: float
    ) -> NDArray[np.bool_]:
        """(N,) whether there is a steady motion, at the nearest node, on soil of mu `friction`."""
        ratio = np.asarray(grade, dtype=float).reshape(-1, 2) / friction
        middle, grid = self.steady.shape[3] // 2, self.grid
        x, y = np.rint(ratio / self.table.spacing).astype(int).clip(-middle, middle).T + middle
        i, j = (
            np.rint(np.atleast_1d(speed) / grid.spacing).astype(int).clip(-zero, zero) + zero
            for speed, zero in ((sprocket_left, grid.zero_left), (sprocket_right, grid.zero_right))
        )
        layer = int(np.abs(np.log(self.frictions / friction)).argmin())
        gentle = np.linalg.norm(ratio, axis=1) <= STEEPEST
        return np.asarray(self.steady[layer, i, j, x, y] & gentle)

    def at(self, friction: ArrayLike) -> "TableSlipModel":
        """The slip model of vehicles whose mu [-], a number or (N,), is known; on level ground."""
        return TableSlipModel(self, np.atleast_1d(np.array(friction, dtype=np.float64)), LEVEL)


class TableSlipModel(NamedTuple):
    """A family at known friction on known slopes; a SlipModel."""

    family: SlipFamily
    friction: Array  # [-] mu, (1,) or (N,)
    grade: Array = LEVEL  # [-] (1, 2) or (N, 2)

    @classmethod
    def of(cls, table: ArrayLike, grid: Grid, sprocket_radius: float) -> "TableSlipModel":
        """One table (left, right, CHANNELS) of level ground, whatever its friction is."""
        return SlipFamily(np.array(table, dtype=float)[None], grid, sprocket_radius, (1.0,)).at(1.0)

    @property
    def sloped(self) -> bool:
        """Whether it was identified on slopes; else slip is that of level ground."""
        return self.family.sloped

    def on(self, grade: Array) -> "TableSlipModel":
        """The same on slopes (N, 2); without effect if identified on level ground."""
        return self._replace(grade=grade)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        return self.family.slip(sprocket_left, sprocket_right, self.friction, self.grade)

    def save(self, path: str | Path | IO[bytes]) -> None:
        """Write one table of level ground as .npz, in single precision."""
        family = self.family
        values = family.table.values[0, :, :, 0, 0].astype(np.float32)
        grid, radius = np.array(family.grid), family.table.radius
        np.savez_compressed(path, kind="table", table=values, grid=grid, sprocket_radius=radius)


def load(path: str | Path) -> TableSlipModel:
    """A table from the .npz that its `save` wrote. Raises ValueError for any other file."""
    try:
        file = plain_arrays(path)
        kind = str(file["kind"]) if "kind" in file else "missing"
        if kind != "table":
            raise ValueError(f"kind of slip model is {kind}; must be table")
        return TableSlipModel.of(file["table"], Grid(*file["grid"]), float(file["sprocket_radius"]))
    except (ValueError, KeyError, TypeError, IndexError) as error:  # a part is missing or differs
        raise ValueError(f"slip model {path}: {error}") from error
