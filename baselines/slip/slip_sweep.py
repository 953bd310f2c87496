"""Slip of a tracked vehicle identified from runs at constant sprocket speeds: F section 4.

    sweep            every pair of sprocket speeds on a grid, held until the motion is steady
    slope_sweep      the same on every slope of a grid (`slope_motion`)
    read_measured    runs of a real vehicle from a file
    upsample         smooth surfaces through the points by radial basis functions, F 4.2
    identified_slip, identified_slope_slip    the table of a vehicle on its soil, for the loop
    slip_family, slope_slip_family            the same over friction, for a soil that is not known
slip_regression goes on with decision trees and the exponential form.

F holds each pair for 2 s from rest and averages. At mu = 0.1 the motion is steady to 1 % after
4 s only, so here a run starts as a unicycle would move, lasts SETTLING times the time in which
friction stops the vehicle from its top speed, and the mean is taken over the last AVERAGED.
The integrator's steady motions do not depend on its step, so steps may be long. Where sprockets
stand, or the vehicle turns on the spot, alpha has no value: 0 is recorded, and the side velocity
v_y beside it.

Slopes. F sweeps pitch alone, in steps that the paper prints as 0.5 rad over a range of 0.3 rad.
Here both directions of the slope are swept, in steps of the grade over mu (`slip_models`): 0.125,
which is 0.05 rad at mu = 0.4. Level ground is the sweep of one slope, on the planar plant: without
springs and transfer of load.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 4, 4.2, 4.5, 7.2.3.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RBFInterpolator

from baselines.slip.slip_models import STEEPEST, Array, Grid, SlipFamily, TableSlipModel
from baselines.slip.slope_motion import steady_on_slopes
from baselines.slip.slope_motion import strength_over_weight as strength_over_weight
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.physics.patches_on_level_ground import make_patches
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import checked_number

STEP = 0.65  # [rad/s] between sprocket speeds, F 4.2
NODES = 15  # sprocket speeds to each side in a table for the loop: F has 15 up to 10 rad/s
SPACING = 0.1  # [rad/s] of the upsampled grid, F 4.2
SMOOTHING = 0.1  # [-] of the radial basis functions, F 4.2
SETTLING = 8.0  # [-] times top speed / (mu g): leaves 1e-4 m/s
SHORTEST = 1.0  # [s] a run lasts at least this
LONGEST = 60.0  # [s] and at most this
LONG_STEP = 0.02  # [s] of the integration
AVERAGED = 0.2  # [s] at the end, over which the mean is taken
SAMPLES = 5  # in that mean
STANDING = 1e-6  # [m/s] a slower v_x has no alpha
GEAR = 34.45  # [-] motor speed over sprocket speed of F's vehicle
ALL_POINTS = 2000  # up to so many points every one acts on every other; beyond, NEIGHBOURS do
NEIGHBOURS = 64
FRICTIONS = tuple(0.05 * 1.5**k for k in range(8))  # [-] mu of a family: 0.05 to 0.85
SLOPE_NODES = 8  # the same on slopes; slip is nearly linear between them
SLOPE_STEP = 0.125  # [-] of t / mu, for one soil
FAMILY_NODES, FAMILY_SLOPE_STEP = 4, 0.21875  # the same and [-] for a family of soils
SLOPE_FRICTIONS = (0.1, 0.175, 0.3, 0.5, 0.85)  # [-] mu of a family
NEAREST = 0.95  # [-] of t / mu: a steeper node of the grid has the slip of this slope
INWARD = 0.7  # [-] a slope without a steady motion is followed by one so much gentler ...
TRIES = 6  # ... so often; the last one is level ground
_STEP = "It is between two sprocket speeds."


class SlipData(NamedTuple):
    """Steady runs, (N,) each."""

    sprocket_left: Array  # [rad/s]
    sprocket_right: Array  # [rad/s]
    beta_left: Array  # [m/s]
    beta_right: Array  # [m/s]
    alpha: Array  # [rad] in (-pi/2, pi/2)
    v_x: Array  # [m/s]
    v_y: Array  # [m/s]
    yaw_rate: Array  # [rad/s]

    def rows(self, which: ArrayLike) -> "SlipData":
        """The runs of these indices or this mask."""
        return SlipData(*(column[np.asarray(which)] for column in self))


def with_friction(parameters: PlantParameters, mu: float) -> PlantParameters:
    """The vehicle on a soil without cohesion whose strength over weight is mu [-].

    Raises ValueError for mu outside its range.
    """
    highest = math.tan(RANGES["friction_angle"].high)
    checked_number("mu", mu, Range(1e-9, highest, "-", "Did you pass an angle?"))
    return parameters._replace(cohesion=0.0, friction_angle=math.atan(mu))


def steady_motion(parameters: PlantParameters, left: ArrayLike, right: ArrayLike) -> Array:
    """(N, 3) v_x, v_y [m/s], yaw rate [rad/s] after sprocket speeds [rad/s] were held for long."""
    speeds = np.stack([np.asarray(left, dtype=float), np.asarray(right, dtype=float)], axis=1)
    count, radius, patches = len(speeds), parameters.sprocket_radius, make_patches()
    rows = np.tile(np.array(parameters, dtype=np.float64), (count, 1))
    loads, states = np.empty((count, 6)), np.zeros((count, 6))
    states[:, 3] = 0.5 * radius * (speeds[:, 0] + speeds[:, 1])
    states[:, 5] = radius * (speeds[:, 1] - speeds[:, 0]) / parameters.track_gauge
    duration = SETTLING * radius * np.abs(speeds).max(initial=0.0)
    duration /= strength_over_weight(parameters) * GRAVITY
    steps = math.ceil(min(max(duration, SHORTEST), LONGEST) / LONG_STEP)
    hold_speeds(states, speeds, rows, patches, steps, LONG_STEP, False, loads)
    total = np.zeros((count, 3))
    between = round(AVERAGED / LONG_STEP / SAMPLES)
    for _ in range(SAMPLES):
        hold_speeds(states, speeds, rows, patches, between, LONG_STEP, False, loads)
        total += states[:, 3:]
    return total / SAMPLES


def slip_data(parameters: PlantParameters, left: Array, right: Array, motion: Array) -> SlipData:
    """SlipData of steady motions (N, 3) at sprocket speeds (N,) [rad/s]."""
    v_x, v_y, yaw_rate = motion.T
    half, radius = 0.5 * parameters.track_gauge, parameters.sprocket_radius
    moving = np.abs(v_x) > STANDING
    alpha = np.where(moving, np.arctan(v_y / np.where(moving, v_x, 1.0)), 0.0)
    beta_left = radius * left - (v_x - half * yaw_rate)
    beta_right = radius * right - (v_x + half * yaw_rate)
    return SlipData(left, right, beta_left, beta_right, alpha, v_x, v_y, yaw_rate)


def _quarter(index: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """(runs (K, 4), run of each node (N,), signs (N, 3) of v_x, v_y, w) of nodes L, R, t_x, t_y.

    Only a quarter is simulated, to the last bit: the plant is mirrored from left to right, and
    turned about by half a turn it is itself.
    """
    index = index.copy()
    # Turned about: (L, R, x, y) -> (-R, -L, -x, -y); v_x and v_y change sign.
    turned = index[:, 0] + index[:, 1] < 0
    index[turned] = -index[turned][:, [1, 0, 2, 3]]
    # Mirrored: (L, R, x, y) -> (R, L, x, -y); v_y and the yaw rate change sign.
    mirrored = (index[:, 0] > index[:, 1]) | ((index[:, 0] == index[:, 1]) & (index[:, 3] < 0))
    index[mirrored] = index[mirrored][:, [1, 0, 2, 3]] * [1, 1, 1, -1]
    codes = index @ (1 << np.arange(0, 64, 16))
    _, first, run = np.unique(codes, return_index=True, return_inverse=True)
    about, flip = np.where(turned, -1.0, 1.0), np.where(mirrored, -1.0, 1.0)
    return index[first], run, np.stack([about, flip * about, flip], axis=1)


def sweep(parameters: PlantParameters, step: float = STEP) -> SlipData:
    """Steady slip at all pairs of sprocket speeds on a grid, left speed first.

    step [rad/s]: the nearest one that divides the speed limit is used, so that standstill and both
    ends are in the grid (0.65 does not divide F's 10). Raises ValueError for one that does not fit.
    """
    limit = parameters.sprocket_speed_limit
    checked_number("step", step, Range(1e-3, limit, "rad/s", _STEP))
    half = round(limit / step)
    index = np.arange(-half, half + 1)
    i, j = (a.ravel() for a in np.meshgrid(index, index, indexing="ij"))
    runs, run, signs = _quarter(np.stack([i, j, 0 * i, 0 * i], axis=1))
    unit = float(limit / half)
    motion = steady_motion(parameters, unit * runs[:, 0], unit * runs[:, 1])[run] * signs
    motion[i == j, 1:] = 0.0
    motion[i == -j, :2] = 0.0
    return slip_data(parameters, np.asarray(unit * i), np.asarray(unit * j), motion)


def slope_sweep(
    parameters: PlantParameters,
    speed_step: float | None = None,
    slope_step: float = SLOPE_STEP,
    load: str = "nonuniform",
) -> tuple[Array, NDArray[np.bool_], Grid]:
    """Steady motion (nodes, nodes, slopes, slopes, 3) over left and right speed, t_x and t_y;
    whether it is that of the node; and the grid of the speeds.

    speed_step [rad/s]: None for SLOPE_NODES. The steps are brought to divide the speed limit and
    STEEPEST. Nodes that are not looked up are
    NaN. A node without a steady motion has that of a gentler slope in the same direction. Raises
    ValueError for a step that is not positive.
    """
    limit = parameters.sprocket_speed_limit
    speed_step = limit / SLOPE_NODES if speed_step is None else speed_step
    checked_number("speed_step", speed_step, Range(1e-3, limit, "rad/s", _STEP))
    checked_number("slope_step", slope_step, Range(1e-3, STEEPEST, "-", "Did you pass degrees?"))
    half, flank = round(limit / speed_step), round(STEEPEST / slope_step)
    unit, share = limit / half, STEEPEST / flank
    speed, slope = np.arange(-half, half + 1), np.arange(-flank, flank + 1)
    grids = np.meshgrid(speed, speed, slope, slope, indexing="ij")
    index = np.stack([grid.ravel() for grid in grids], axis=1)
    inner = share * np.hypot(index[:, 2], index[:, 3]) < STEEPEST + math.sqrt(2.0) * share
    runs, run, signs = _quarter(index[inner])
    ratio = share * runs[:, 2:]
    ratio *= np.minimum(NEAREST / np.maximum(np.hypot(*ratio.T), NEAREST), 1.0)[:, None]
    own_slope = np.hypot(*ratio.T) == share * np.hypot(*runs[:, 2:].T)
    steady_runs = np.full((len(runs), 3), np.nan)
    mu = strength_over_weight(parameters)
    for attempt in range(TRIES):
        rest = np.flatnonzero(np.isnan(steady_runs[:, 0]))
        own_slope[rest] &= attempt == 0
        ratio[rest] *= 0.0 if attempt == TRIES - 1 else (INWARD if attempt else 1.0)
        speeds = unit * runs[rest, :2]
        steady_runs[rest] = steady_on_slopes(parameters, speeds, mu * ratio[rest], load)
    motion, steady = np.full((len(inner), 3), np.nan), np.zeros(len(inner), dtype=np.bool_)
    motion[inner], steady[inner] = steady_runs[run] * signs, own_slope[run]
    nodes, slopes = len(speed), len(slope)
    shape = (nodes, nodes, slopes, slopes)
    grid = Grid(float(unit), half, half, nodes, nodes)
    return motion.reshape(*shape, 3), steady.reshape(shape), grid


def read_measured(path: str | Path, parameters: PlantParameters) -> SlipData:
    """Runs of a real vehicle from a file without header: motor speed left, right [rad/s],
    beta_left, beta_right [m/s], alpha [rad], comma separated.

    parameters: sprocket_radius and track_gauge are used. alpha there is that of atan2, brought into
    (-pi/2, pi/2). Raises ValueError for a file of another layout.
    """
    table = np.loadtxt(path, delimiter=",", ndmin=2)
    if table.shape[1] != 5 or not np.isfinite(table).all():
        raise ValueError(
            f"{path} has {table.shape[1]} columns; must be 5, all finite: motor speeds left, "
            "right, beta_left, beta_right, alpha"
        )
    (left, right), (beta_left, beta_right, alpha) = table.T[:2] / GEAR, table.T[2:]
    v_x, yaw_rate = _track_motion(parameters, left, right, beta_left, beta_right)
    tangent = np.tan(alpha)
    alpha, v_y = np.arctan(tangent), v_x * tangent
    return SlipData(left, right, beta_left, beta_right, alpha, v_x, v_y, yaw_rate)


def _track_motion(
    parameters: PlantParameters, left: Array, right: Array, beta_left: Array, beta_right: Array
) -> tuple[Array, Array]:
    """v_x [m/s] and yaw rate [rad/s] of tracks that slip at sprocket speeds [rad/s]."""
    track_left = parameters.sprocket_radius * left - beta_left
    track_right = parameters.sprocket_radius * right - beta_right
    yaw_rate = (track_right - track_left) / parameters.track_gauge
    return 0.5 * (track_left + track_right), yaw_rate


def upsample(
    data: SlipData, parameters: PlantParameters, spacing: float = SPACING
) -> tuple[SlipData, Grid]:
    """Smooth surfaces through the runs on a grid [rad/s] that has a node at standstill.

    Thin plate splines through beta_left, beta_right and v_y; alpha follows from them. F lays
    one through alpha of each direction, which ends at the jump. Returns the data, left speed
    first, and its grid. Raises ValueError for a spacing that is not positive.
    """
    checked_number("spacing", spacing, Range(1e-3, 1e3, "rad/s", _STEP))
    points = np.stack([data.sprocket_left, data.sprocket_right], axis=1)
    low = np.minimum(np.floor(points.min(axis=0) / spacing + 1e-9), 0).astype(int)
    high = np.maximum(np.ceil(points.max(axis=0) / spacing - 1e-9), 1).astype(int)
    axes = [spacing * np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
    values = np.stack([data.beta_left, data.beta_right, data.v_y], axis=1)
    neighbours = None if len(points) <= ALL_POINTS else NEIGHBOURS
    surface = RBFInterpolator(points, values, neighbors=neighbours, smoothing=SMOOTHING)
    left, right = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    beta_left, beta_right, v_y = surface(np.stack([left, right], axis=1)).T
    v_x, yaw_rate = _track_motion(parameters, left, right, beta_left, beta_right)
    motion = np.stack([v_x, v_y, yaw_rate], axis=1)
    grid = Grid(spacing, int(-low[0]), int(-low[1]), len(axes[0]), len(axes[1]))
    return slip_data(parameters, left, right, motion), grid


def make_table(data: SlipData, grid: Grid, parameters: PlantParameters) -> TableSlipModel:
    """The model for the loop from data on a grid, left speed first, as `upsample` gives it."""
    columns = np.stack([data.beta_left, data.beta_right, data.v_y], axis=1)
    table = columns.reshape(grid.count_left, grid.count_right, 3)
    return TableSlipModel.of(table, grid, parameters.sprocket_radius)


@lru_cache(maxsize=64)
def identified_slip(parameters: PlantParameters) -> TableSlipModel:
    """Table of the slip of a vehicle on its soil, as wide as its sprockets are fast.

    A sweep takes 0.02 to 0.2 s and is cached. Its points serve as they are: the surfaces of
    `upsample` are no nearer to the plant.
    """
    spacing, count = parameters.sprocket_speed_limit / NODES, 2 * NODES + 1
    data = sweep(parameters, spacing)
    return make_table(data, Grid(spacing, NODES, NODES, count, count), parameters)


@lru_cache(maxsize=64)
def identified_slope_slip(
    parameters: PlantParameters,
    load: str = "nonuniform",
    speed_step: float | None = None,
    slope_step: float = SLOPE_STEP,
) -> TableSlipModel:
    """Slip of a vehicle on its soil over sprocket speeds and slopes; starts on level ground, and
    `on` puts it on a slope. A sweep takes seconds and is cached. Raises as `slope_sweep`."""
    mu, radius = strength_over_weight(parameters), parameters.sprocket_radius
    motion, steady, grid = slope_sweep(parameters, speed_step, slope_step, load)
    belts = radius * grid.spacing * np.arange(-grid.zero_left, grid.zero_left + 1)
    turn = 0.5 * parameters.track_gauge * motion[..., 2]
    left = belts[:, None, None, None] - (motion[..., 0] - turn)
    right = belts[None, :, None, None] - (motion[..., 0] + turn)
    table = np.stack([left, right, motion[..., 1]], axis=-1)[None]
    spacing = 2.0 * STEEPEST / (table.shape[3] - 1)
    return SlipFamily(table, grid, radius, (mu,), spacing, steady[None]).at(mu)


@lru_cache(maxsize=16)
def slip_family(
    parameters: PlantParameters, frictions: tuple[float, ...] = FRICTIONS
) -> SlipFamily:
    """Tables of the slip of a vehicle on soils without cohesion of these frictions.

    The sweeps take a second in all, of a fast vehicle up to ten, and are cached.
    """
    models = [identified_slip(with_friction(parameters, mu)) for mu in frictions]
    return _family(models, frictions)


@lru_cache(maxsize=8)
def slope_slip_family(
    parameters: PlantParameters, frictions: tuple[float, ...] = SLOPE_FRICTIONS
) -> SlipFamily:
    """The same on slopes."""
    options = "nonuniform", parameters.sprocket_speed_limit / FAMILY_NODES, FAMILY_SLOPE_STEP
    soils = [with_friction(parameters, mu) for mu in frictions]
    return _family([identified_slope_slip(soil, *options) for soil in soils], frictions)


def _family(models: list[TableSlipModel], frictions: tuple[float, ...]) -> SlipFamily:
    """One family of models of one soil each."""
    families = [model.family for model in models]
    table, first = np.concatenate([family.table.values for family in families]), families[0].table
    steady = np.concatenate([family.steady for family in families])
    return SlipFamily(table, first.grid, first.radius, frictions, first.spacing, steady)
