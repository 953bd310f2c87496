"""Slip looked up over sprocket speeds and the direction of gravity in the body: F (34).

The direction of gravity is given as the grade along and across the vehicle,
    t_x = g_x / |g_z| = tan(pitch) / cos(roll),    t_y = g_y / |g_z| = -tan(roll)
forces along the ground over the normal load, and the tables are over t / mu: a vehicle slides
where |t| reaches mu, on every soil, and what the slope does to slip hardly depends on mu otherwise.
    speeds   linear on the triangles on both sides of omega_L = omega_R: in a turn all patches
             slide sideways, and gravity then drags the vehicle along in proportion to |w|, so
             that slip has an edge at w = 0, which a bilinear surface would cut off
    slopes   bilinear;   friction: linear in 1 / mu, as on level ground
Beyond a share STEEPEST of what friction can hold, and at nodes where no motion is steady (a vehicle
that slides, or turns downhill), slip is that of a gentler slope in the same direction, the
nearest one that has a steady motion; `holds` says False there. Speeds beyond the table have the
value at its edge. NaN in gives NaN.

References: [F] Focchi et al. (2025), section 4.5.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.slip.slip_tables import CHANNELS, Grid, cell, layers, slip_angle
from tracked_env.physics.jit import formula, loop

STEEPEST = 0.875  # [-] of |t| / mu, up to which slip is looked up

Array = NDArray[np.float64]


def grades(roll: ArrayLike, pitch: ArrayLike) -> Array:
    """(N, 2) grade t_x, t_y [-] that a vehicle at roll and pitch [rad], (N,), feels."""
    roll, pitch = np.atleast_1d(roll).astype(float), np.atleast_1d(pitch).astype(float)
    return np.stack([np.tan(pitch) / np.cos(roll), -np.tan(roll)], axis=1)


@formula
def _slopes(flat, at, beside, c, d):
    """(beta_left, beta_right, v_y) bilinear over slopes: node at, the next along t_y CHANNELS
    further, along t_x `beside` further; shares c along t_x, d along t_y."""
    right, ahead, both = at + CHANNELS, at + beside, at + beside + CHANNELS
    near, w_right, w_ahead, w_both = (1.0 - c) * (1.0 - d), (1.0 - c) * d, c * (1.0 - d), c * d
    return (
        near * flat[at] + w_right * flat[right] + w_ahead * flat[ahead] + w_both * flat[both],
        near * flat[at + 1] + w_right * flat[right + 1]
        + w_ahead * flat[ahead + 1] + w_both * flat[both + 1],
        near * flat[at + 2] + w_right * flat[right + 2]
        + w_ahead * flat[ahead + 2] + w_both * flat[both + 2],
    )  # fmt: skip


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
    return (
        p * x[0] + q * y[0] + r * z[0],
        p * x[1] + q * y[1] + r * z[1],
        p * x[2] + q * y[2] + r * z[2],
    )


@formula
def _within(along, across):
    """A slope over mu, in its direction, within STEEPEST."""
    square = along * along + across * across
    shrink = STEEPEST / math.sqrt(square) if square > STEEPEST * STEEPEST else 1.0
    return along * shrink, across * shrink


@loop
def look_up_on_slopes(table, grid, spacing, radius, speeds, grade, friction, layer, share, out):
    """Slip of N vehicles: out (N, 3) gets beta_left, beta_right [m/s], alpha [rad].

    table (M, count_left, count_right, count, count, CHANNELS); spacing [-] of t / mu, 0 in the
    middle. speeds (2, N) [rad/s], left then right. grade (n, 2), friction (k,) repeat. layer, share
    (N,): of `slip_tables.layers`.
    """
    flat, count = table.reshape(-1), table.shape[3]
    beside = count * CHANNELS
    steps = (grid.count_right * count * beside, count * beside, beside)
    whole, middle = grid.count_left * steps[0], 0.5 * (count - 1)
    row, soil = 0, 0
    for n in range(speeds.shape[1]):
        left, right = speeds[0, n], speeds[1, n]
        i, a = cell(left, grid.spacing, grid.zero_left, grid.count_left)
        j, b = cell(right, grid.spacing, grid.zero_right, grid.count_right)
        along, across = _within(grade[row, 0] / friction[soil], grade[row, 1] / friction[soil])
        x, c = cell(along, spacing, middle, count)
        y, d = cell(across, spacing, middle, count)
        row, soil = row + 1, soil + 1
        row = row if row < grade.shape[0] else 0
        soil = soil if soil < friction.size else 0
        at = layer[n] * whole + i * steps[0] + j * steps[1] + x * beside + y * CHANNELS
        slip = _interpolated(flat, at, steps, a, b, c, d)
        if share[n] > 0.0:
            more = _interpolated(flat, at + whole, steps, a, b, c, d)
            s, rest = share[n], 1.0 - share[n]
            slip = (
                rest * slip[0] + s * more[0], rest * slip[1] + s * more[1],
                rest * slip[2] + s * more[2],
            )  # fmt: skip
        v_x = 0.5 * (radius * (left + right) - (slip[0] + slip[1]))
        out[n, 0], out[n, 1], out[n, 2] = slip[0], slip[1], slip_angle(v_x, slip[2])


class SlopeSlipFamily:
    """Slip over sprocket speeds, gravity direction and friction; made by `slope_sweep`.

    table (M, count_left, count_right, n, n, CHANNELS): beta_left, beta_right, v_y [m/s] on a
    Grid of speeds and of t / mu, `spacing` apart and 0 in the middle; NaN outside what is looked
    up. steady: of the same shape without CHANNELS, whether a node has a steady motion of its own.
    frictions: mu [-] of each, rising. sprocket_radius [m]. Raises ValueError for a table that does
    not fit or is not finite where it is looked up.
    """

    def __init__(
        self, table: ArrayLike, steady: ArrayLike, grid: Grid, spacing: float,
        sprocket_radius: float, frictions: ArrayLike,
    ) -> None:  # fmt: skip
        self.grid, self.spacing = grid, float(spacing)
        self.sprocket_radius = float(sprocket_radius)
        self.frictions = np.array(frictions, dtype=np.float64)
        if not (len(self.frictions) and (np.diff(self.frictions, prepend=0.0) > 0.0).all()):
            raise ValueError(f"frictions = {self.frictions}; must be positive and rising")
        self.table = np.ascontiguousarray(table, dtype=np.float64)
        side = self.table.shape[3] if self.table.ndim == 6 else 0
        self.steady = np.array(steady, dtype=np.bool_)
        shape = (len(self.frictions), grid.count_left, grid.count_right, side, side, CHANNELS)
        if (
            self.table.shape != shape
            or self.steady.shape != shape[:-1]
            or side % 2 == 0
            or (side // 2) * spacing < STEEPEST - 1e-9
        ):
            raise ValueError(
                f"slip table has shape {self.table.shape}; must be {shape}, an odd number of "
                f"slopes up to {STEEPEST} of what friction can hold"
            )
        place = spacing * np.abs(np.arange(side) - side // 2)
        near = np.hypot(*np.meshgrid(place, place)) < STEEPEST + np.sqrt(2.0) * spacing
        wrong = ~np.isfinite(self.table[:, :, :, near])
        if wrong.any():
            raise ValueError(
                f"slip table has {wrong.sum()} values that are not finite on slopes that "
                "are looked up; all must be. Did a run of the sweep not settle?"
            )

    def slip(
        self, sprocket_left: ArrayLike, sprocket_right: ArrayLike, grade: ArrayLike,
        friction: ArrayLike,
    ) -> tuple[Array, Array, Array]:  # fmt: skip
        """(beta_left, beta_right [m/s], alpha [rad]), (N,), at sprocket speeds [rad/s].

        grade (n, 2): t_x, t_y [-], see `grades`; friction (k,) mu [-]. N may be a multiple of n
        and of k: they repeat. Raises ValueError for other numbers of vehicles.
        """
        speeds = np.array(
            [np.atleast_1d(sprocket_left), np.atleast_1d(sprocket_right)], dtype=float
        )
        count = speeds.shape[1]
        slopes = np.ascontiguousarray(grade, dtype=np.float64).reshape(-1, 2)
        mu = np.ascontiguousarray(friction, dtype=np.float64).reshape(-1)
        if count % len(slopes) or count % len(mu):
            raise ValueError(
                f"{count} sprocket speeds for {len(slopes)} slopes and {len(mu)} frictions; must "
                "be as many or a multiple. Is the model made for another number of vehicles?"
            )
        layer, share = np.zeros(count, dtype=np.int64), np.zeros(count)
        if len(self.frictions) > 1:
            layers(self.frictions, mu, layer, share)
        out = np.empty((count, 3))
        look_up_on_slopes(
            self.table, self.grid, self.spacing, self.sprocket_radius,
            speeds, slopes, mu, layer, share, out,
        )  # fmt: skip
        return out[:, 0], out[:, 1], out[:, 2]

    def holds(
        self, sprocket_left: ArrayLike, sprocket_right: ArrayLike, grade: ArrayLike, friction: float
    ) -> NDArray[np.bool_]:
        """(N,) whether there is a steady motion, at the nearest node, on soil of mu `friction`."""
        ratio = np.asarray(grade, dtype=float).reshape(-1, 2) / friction
        middle = self.table.shape[3] // 2
        x, y = np.rint(ratio / self.spacing).astype(int).clip(-middle, middle).T + middle
        grid = self.grid
        i, j = (
            np.rint(np.atleast_1d(speed) / grid.spacing).astype(int).clip(-zero, zero) + zero
            for speed, zero in ((sprocket_left, grid.zero_left), (sprocket_right, grid.zero_right))
        )
        layer = int(np.abs(np.log(self.frictions / friction)).argmin())
        steady: NDArray[np.bool_] = self.steady[layer, i, j, x, y]
        return steady & (np.linalg.norm(ratio, axis=1) <= STEEPEST)

    def at(self, friction: ArrayLike) -> "SlopeSlipModel":
        """The slip model of vehicles whose mu [-], a number or (N,), is known; on level ground."""
        return SlopeSlipModel(self, np.atleast_1d(np.array(friction, dtype=np.float64)), LEVEL)


LEVEL: Array = np.zeros((1, 2))


class SlopeSlipModel(NamedTuple):
    """A family at known friction on known slopes; a SlipModel."""

    family: SlopeSlipFamily
    friction: Array  # [-] mu, (1,) or (N,)
    grade: Array  # [-] (1, 2) or (N, 2)

    def on(self, grade: Array) -> "SlopeSlipModel":
        """The same on slopes (N, 2)."""
        return self._replace(grade=grade)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s]."""
        return self.family.slip(sprocket_left, sprocket_right, self.grade, self.friction)
