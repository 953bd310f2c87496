"""Slip models that are looked up in the control loop: sprocket speeds in, beta and alpha out.

    beta_k = r omega_k - v_k,  v_L = v_x - w B/2, v_R = v_x + w B/2     F (30), (31) in the sign of
                                                                        F's text and data
    alpha  = atan(v_y / v_x)                                            F (28)
    TableSlipModel        bilinear in a regular table; fast, continuous, the one to use
    SlipFamily            such tables over friction
    TreeSlipModel         decision trees as in F 4.2 and 4.3, as arrays: steps, but no library
    ExponentialSlipModel  F (54) on the turning radius: coarse
    NoSlip                zero

Outside the table, and outside the data of a tree, the value at its edge is taken: slip is not
extrapolated. At standstill slip is exactly zero. NaN speeds give NaN, but for a tree's: there they
lead to some leaf. The kernels are in slip_tables.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2, 4, 7.2.3.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.lyapunov.pseudo_kinematic import NoSlip, SlipModel
from baselines.slip.slip_tables import CHANNELS, Grid, descend, exponentials, layers, look_up
from tracked_env.validation import plain_arrays

Array = NDArray[np.float64]


def _speeds(sprocket_left: ArrayLike, sprocket_right: ArrayLike) -> tuple[Array, Array]:
    """Both sprocket speeds as arrays (N,). Raises ValueError for shapes that differ."""
    left = np.asarray(sprocket_left, dtype=np.float64)
    right = np.asarray(sprocket_right, dtype=np.float64)
    if not left.ndim or not right.ndim:
        left, right = np.atleast_1d(left), np.atleast_1d(right)
    if left.ndim != 1 or left.shape != right.shape:
        raise ValueError(
            f"sprocket speeds have shapes {left.shape} and {right.shape}; must be one (N,). "
            "Did you pass an array (N, 2) for both sides?"
        )
    return left, right


def _checked_table(table: Array, grid: Grid, layers: int | None) -> Array:
    """The table as float64; raises ValueError where it does not fit the grid."""
    made = np.ascontiguousarray(table, dtype=np.float64)
    shape = (layers or len(made), grid.count_left, grid.count_right, CHANNELS)
    if made.shape != shape or min(grid.count_left, grid.count_right) < 2:
        raise ValueError(f"slip table has shape {made.shape}; must be {shape}, two nodes a side")
    if not np.isfinite(made).all():
        raise ValueError(
            f"slip table has {np.sum(~np.isfinite(made))} values that are not finite; all must "
            "be. Did a point of the sweep not settle?"
        )
    return made


class TableSlipModel:
    """Slip by bilinear interpolation: table (count_left, count_right, CHANNELS) on a Grid.

    sprocket_radius [m]: of the vehicle the table was made for. Raises ValueError for a table
    of another shape or with values that are not finite.
    """

    def __init__(self, table: ArrayLike, grid: Grid, sprocket_radius: float) -> None:
        self.grid = Grid(float(grid.spacing), *(int(value) for value in grid[1:]))
        self.table = _checked_table(np.array(table, dtype=float)[None], self.grid, 1)
        self.sprocket_radius = float(sprocket_radius)
        self.table[0, self.grid.zero_left, self.grid.zero_right] = 0.0

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        left, right = _speeds(sprocket_left, sprocket_right)
        out = np.empty((len(left), 3))
        first, none = np.zeros(len(left), dtype=np.int64), np.zeros(len(left))
        look_up(self.table, self.grid, self.sprocket_radius, left, right, first, none, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def save(self, path: str | Path) -> None:
        """Write the model as .npz, in single precision."""
        np.savez_compressed(
            path, kind="table", table=self.table[0].astype(np.float32),
            grid=np.array(self.grid), sprocket_radius=self.sprocket_radius,
        )  # fmt: skip


class SlipFamily:
    """Slip over friction: a table for each of several mu, linear in 1 / mu between them.

    Slip grows with the side force over friction, hence with 1 / mu. table (M, count_left,
    count_right, CHANNELS); frictions: mu [-] of each, rising. Raises ValueError for a table of
    another shape or frictions that do not rise.
    """

    def __init__(
        self, table: ArrayLike, grid: Grid, sprocket_radius: float, frictions: ArrayLike
    ) -> None:
        self.frictions = np.array(frictions, dtype=np.float64)
        if len(self.frictions) < 2 or not (np.diff(self.frictions, prepend=0.0) > 0.0).all():
            raise ValueError(f"frictions = {self.frictions}; must be two or more, positive, rising")
        self.grid = grid
        self.table = _checked_table(np.array(table, dtype=float), grid, len(self.frictions))
        self.table[:, grid.zero_left, grid.zero_right] = 0.0
        self.sprocket_radius = float(sprocket_radius)

    def slip(
        self, sprocket_left: Array, sprocket_right: Array, friction: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]), (N,) each; friction [-]: mu, a number or
        (n,), brought into the range of the family. N may be a multiple of n: mu repeats, as where a
        controller asks for several speeds of each vehicle. Raises ValueError for another n."""
        left, right = _speeds(sprocket_left, sprocket_right)
        mu = np.asarray(friction, dtype=np.float64).reshape(-1)
        if len(left) % len(mu):
            raise ValueError(
                f"{len(left)} sprocket speeds for {len(mu)} frictions; must be as many or a "
                "multiple. Is the model made for another number of vehicles?"
            )
        layer, share = np.empty(len(left), dtype=np.int64), np.empty(len(left))
        layers(self.frictions, mu, layer, share)
        out = np.empty((len(left), 3))
        look_up(self.table, self.grid, self.sprocket_radius, left, right, layer, share, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def at(self, friction: ArrayLike) -> "FrictionSlipModel":
        """The slip model of vehicles whose mu [-], a number or (N,), is known."""
        return FrictionSlipModel(self, np.array(friction, dtype=np.float64))


class FrictionSlipModel(NamedTuple):
    """A family at known friction."""

    family: SlipFamily
    friction: Array  # [-] mu, () or (N,)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s]."""
        return self.family.slip(sprocket_left, sprocket_right, self.friction)


class TreeSlipModel:
    """Slip by four decision trees: beta_left, beta_right, alpha forward and alpha in reverse.

    trees: arrays (roots (4,), feature, threshold, below, above, value); feature -1 is a leaf,
    children count from the tree's root. sprocket_radius [m]. Made by
    slip_identification.train_trees.
    """

    def __init__(self, trees: tuple[NDArray, ...], sprocket_radius: float) -> None:
        kinds = (np.int64, np.int64, np.float64, np.int64, np.int64, np.float64)
        if len(trees) != len(kinds) or len(trees[0]) != 4:
            raise ValueError(
                f"trees: {len(trees)} arrays, {len(trees[0])} roots; must be 6 arrays and 4 roots"
            )
        self.trees = tuple(
            np.ascontiguousarray(a, dtype=k) for a, k in zip(trees, kinds, strict=True)
        )
        self.sprocket_radius = float(sprocket_radius)

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        left, right = _speeds(sprocket_left, sprocket_right)
        out = np.empty((len(left), 3))
        descend(self.trees, self.sprocket_radius, left, right, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def save(self, path: str | Path) -> None:
        """Write the model as .npz."""
        np.savez_compressed(
            path, kind="tree", sprocket_radius=self.sprocket_radius,
            tree_0=self.trees[0], tree_1=self.trees[1], tree_2=self.trees[2],
            tree_3=self.trees[3], tree_4=self.trees[4], tree_5=self.trees[5],
        )  # fmt: skip


class ExponentialSlipModel:
    """F (54): -c_1 exp(-c_2 R) for R >= 0, c_1 exp(c_2 R) otherwise, R = v_x / w of the belts.

    constants (3, 2): c_1, c_2 of beta_left, beta_right [m/s] and alpha [rad]; c_1 of
    beta_right is negative, which F excludes. With R alone reverse would have the sign of
    forward; all three change it with both sprocket speeds, so here the sign is that of -w.
    """

    def __init__(self, constants: ArrayLike, track_gauge: float) -> None:
        self.constants = np.array(constants, dtype=np.float64)
        self.track_gauge = float(track_gauge)
        if self.constants.shape != (3, 2) or not np.isfinite(self.constants).all():
            raise ValueError(
                f"constants = {self.constants.tolist()}; must be finite, (3, 2): c_1 and c_2 of "
                "beta_left, beta_right and alpha"
            )
        if (self.constants[:, 1] < 0.0).any():
            raise ValueError(
                f"c_2 = {self.constants[:, 1].min():g} 1/m; must not be negative, or slip grows "
                "towards straight driving. Are the two constants in the order c_1, c_2?"
            )

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], (N,) each."""
        left, right = _speeds(sprocket_left, sprocket_right)
        out = np.empty((len(left), 3))
        exponentials(self.constants, 0.5 * self.track_gauge, left, right, out)
        return out[:, 0], out[:, 1], out[:, 2]

    def save(self, path: str | Path) -> None:
        """Write the model as .npz."""
        np.savez_compressed(
            path, kind="exponential", constants=self.constants, track_gauge=self.track_gauge
        )


def load(path: str | Path) -> TableSlipModel | TreeSlipModel | ExponentialSlipModel:
    """A model from the .npz that its `save` wrote. Raises ValueError for any other file."""
    try:
        file = plain_arrays(path)
        kind = str(file["kind"]) if "kind" in file else "missing"
        if kind == "table":
            spacing, *counts = file["grid"]
            grid = Grid(float(spacing), *(int(count) for count in counts))
            return TableSlipModel(file["table"], grid, float(file["sprocket_radius"]))
        if kind == "tree":
            trees = tuple(file[f"tree_{k}"] for k in range(6))
            return TreeSlipModel(trees, float(file["sprocket_radius"]))
        if kind == "exponential":
            return ExponentialSlipModel(file["constants"], float(file["track_gauge"]))
        raise ValueError(f"kind of slip model is {kind}; must be table, tree or exponential")
    except (ValueError, KeyError, TypeError, IndexError) as error:  # a part is missing or differs
        raise ValueError(f"slip model {path}: {error}") from error


__all__ = [
    "CHANNELS", "ExponentialSlipModel", "FrictionSlipModel", "Grid", "NoSlip", "SlipFamily",
    "SlipModel", "TableSlipModel", "TreeSlipModel", "load",
]  # fmt: skip
