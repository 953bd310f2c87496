"""Slip on slopes identified from runs at constant sprocket speeds and gravity direction: F 4.5.

    steady_on_slopes       motion at given speeds and grades, all of them as one batch
    slope_sweep            every pair of sprocket speeds on every slope of a grid
    identified_slope_slip  the table of a vehicle on its soil
    slope_slip_family      the same over friction, for a soil that is not known
F sweeps pitch alone, in steps that the paper prints as 0.5 rad over a range of 0.3 rad. Here both
directions of the slope are swept, in steps of the grade over mu (`slope_models`): 0.125, which is
0.05 rad at mu = 0.4.

References: [F] Focchi et al. (2025), sections 4.2 and 4.5.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.slip.slip_models import Array, Grid
from baselines.slip.slip_sweep import strength_over_weight, with_friction
from baselines.slip.slope_models import STEEPEST, SlopeSlipFamily, SlopeSlipModel
from baselines.slip.slope_motion import STATE_SIZE, hold_on_slope
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.physics.tracked_body import SCALED

SPEED_STEP = 1.25  # [rad/s] between sprocket speeds; slip is nearly linear between them
SLOPE_STEP = 0.125  # [-] of t / mu, for one soil
FAMILY_SPEED_STEP, FAMILY_SLOPE_STEP = 2.5, 0.21875  # [rad/s], [-] for a family of soils
SLOPE_FRICTIONS = (0.1, 0.175, 0.3, 0.5, 0.85)  # [-] mu of a family
NEAREST = 0.95  # [-] of t / mu: a steeper node of the grid has the slip of this slope
STEP = 0.01  # [s] of the integration; steady motions depend on it by less than 1e-6 m/s
STEPS = 2  # between two turns of the world back to its slope
TOLERANCE = 5e-4  # [m/s^2] change of a motion that is steady: leaves 1e-4 m/s
SETTLING = 20.0  # [-] times top speed / (mu g), until then it must be
SHORTEST, LONGEST = 3.0, 20.0  # [s] and at least and at most this
INWARD = 0.7  # [-] a slope without a steady motion is followed by one so much gentler ...
TRIES = 6  # ... so often; the last one is level ground
LOADS = ("nonuniform", "uniform")
PATCHES = (10, 4)  # along, across a track


def middles(patches: tuple[int, int]) -> tuple[Array, Array]:
    """Middles of the patches over half the contact length and over the track's width."""
    along, across = patches
    columns = 1.0 - (2.0 * np.arange(along) + 1.0) / along
    rows = (np.arange(across) + 0.5) / across - 0.5
    return 0.5 * (columns - columns[::-1]), 0.5 * (rows - rows[::-1])


def attitudes(grade: ArrayLike) -> Array:
    """(N, 2) roll, pitch [rad] of a vehicle that feels the grade t (N, 2)."""
    slopes = np.asarray(grade, dtype=np.float64).reshape(-1, 2)
    roll = -np.arctan(slopes[:, 1])
    return np.stack([roll, np.arctan(slopes[:, 0] * np.cos(roll))], axis=1)


def steady_on_slopes(
    parameters: PlantParameters,
    sprockets: ArrayLike,
    grade: ArrayLike,
    load: str = "nonuniform",
    patches: tuple[int, int] = PATCHES,
    made: Array = SCALED,
    tolerance: float = TOLERANCE,
) -> Array:
    """(N, 3) v_x, v_y [m/s], yaw rate [rad/s] at sprocket speeds (N, 2) [rad/s], left then right,
    and grades t (N, 2), see `slope_models`; NaN where no motion is steady.

    load, patches: of the terrain plant. made: its springs and inertias, `tracked_body.SCALED`.
    Raises ValueError for an unknown load.
    """
    if load not in LOADS:
        raise ValueError(f"load = {load!r}; must be one of {', '.join(LOADS)}")
    speeds = np.ascontiguousarray(sprockets, dtype=np.float64)
    count, radius = len(speeds), parameters.sprocket_radius
    fastest = SETTLING * radius * np.abs(speeds).max(initial=0.0)
    duration = fastest / (strength_over_weight(parameters) * GRAVITY)
    most = math.ceil(min(max(duration, SHORTEST), LONGEST) / (STEPS * STEP))
    states, taken = np.zeros((count, STATE_SIZE)), np.empty(count)
    states[:, 0] = 0.5 * radius * (speeds[:, 0] + speeds[:, 1])
    states[:, 5] = radius * (speeds[:, 1] - speeds[:, 0]) / parameters.track_gauge
    rows = np.tile(np.array(parameters, dtype=np.float64), (count, 1))
    hold_on_slope(
        states, attitudes(grade), speeds, rows, *middles(patches), made,
        load == "uniform", STEPS, STEP, tolerance, most, taken,
    )  # fmt: skip
    motion = states[:, [0, 1, 5]]
    motion[~np.isfinite(taken)] = np.nan
    return motion


def _codes(index: NDArray[np.int64], base: int) -> NDArray[np.int64]:
    code = np.zeros(len(index), dtype=np.int64)
    for column in index.T:
        code = code * base + column + base // 2
    return code


def slope_sweep(
    parameters: PlantParameters,
    speed_step: float = SPEED_STEP,
    slope_step: float = SLOPE_STEP,
    load: str = "nonuniform",
    patches: tuple[int, int] = PATCHES,
    made: Array = SCALED,
) -> tuple[Array, NDArray[np.bool_], Grid]:
    """Steady motion (nodes, nodes, slopes, slopes, 3) over left and right speed, t_x and t_y;
    whether it is that of the node; and the grid of the speeds.

    The steps are brought to divide the speed limit and STEEPEST. Only a quarter is simulated: the
    plant is mirrored from left to right, and turned about by half a turn it is itself. Nodes that
    are not looked up are NaN. A node without a steady motion has that of a gentler slope in the
    same direction. Raises ValueError for a step that is not positive.
    """
    limit = parameters.sprocket_speed_limit
    if not (0.0 < speed_step <= limit and 0.0 < slope_step <= STEEPEST):
        raise ValueError(
            f"speed_step = {speed_step} rad/s, slope_step = {slope_step}; must be positive, at "
            f"most {limit:g} rad/s and {STEEPEST}. Did you pass degrees?"
        )
    half, flank = round(limit / speed_step), round(STEEPEST / slope_step)
    unit, share = limit / half, STEEPEST / flank
    speed, slope = np.arange(-half, half + 1), np.arange(-flank, flank + 1)
    grids = np.meshgrid(speed, speed, slope, slope, indexing="ij")
    index = np.stack([grid.ravel() for grid in grids], axis=1)
    known = share * np.hypot(index[:, 2], index[:, 3]) < STEEPEST + math.sqrt(2.0) * share
    index = index[known]
    # Turned about: (L, R, x, y) -> (-R, -L, -x, -y); v_x and v_y change sign.
    turned = index[:, 0] + index[:, 1] < 0
    index[turned] = -index[turned][:, [1, 0, 2, 3]]
    # Mirrored: (L, R, x, y) -> (R, L, x, -y); v_y and the yaw rate change sign.
    mirrored = (index[:, 0] > index[:, 1]) | ((index[:, 0] == index[:, 1]) & (index[:, 3] < 0))
    index[mirrored] = index[mirrored][:, [1, 0, 2, 3]] * [1, 1, 1, -1]
    _code, first, place = np.unique(
        _codes(index, 2 * max(half, flank) + 3), return_index=True, return_inverse=True
    )
    runs = index[first]
    ratio = share * runs[:, 2:]
    ratio *= np.minimum(NEAREST / np.maximum(np.hypot(*ratio.T), NEAREST), 1.0)[:, None]
    found, own = (
        np.full((len(runs), 3), np.nan),
        np.hypot(*ratio.T) == share * np.hypot(*runs[:, 2:].T),
    )
    mu = strength_over_weight(parameters)
    for tried in range(TRIES):
        left = np.flatnonzero(np.isnan(found[:, 0]))
        own[left] &= tried == 0
        ratio[left] *= 0.0 if tried == TRIES - 1 else (INWARD if tried else 1.0)
        found[left] = steady_on_slopes(
            parameters, unit * runs[left, :2], mu * ratio[left], load, patches, made
        )
    flip, about = np.where(mirrored, -1.0, 1.0), np.where(turned, -1.0, 1.0)
    motion = np.full((len(known), 3), np.nan)
    motion[known] = found[place] * np.stack([about, flip * about, flip], axis=1)
    steady = np.zeros(len(known), dtype=np.bool_)
    steady[known] = own[place]
    nodes = len(speed)
    shape = (nodes, nodes, len(slope), len(slope))
    grid = Grid(float(unit), half, half, nodes, nodes)
    return motion.reshape(*shape, 3), steady.reshape(shape), grid


def _table(motion: Array, grid: Grid, parameters: PlantParameters) -> Array:
    """beta_left, beta_right, v_y [m/s] of the motions of a sweep."""
    belts = (
        parameters.sprocket_radius * grid.spacing * np.arange(-grid.zero_left, grid.zero_left + 1)
    )
    turn = 0.5 * parameters.track_gauge * motion[..., 2]
    left = belts[:, None, None, None] - (motion[..., 0] - turn)
    right = belts[None, :, None, None] - (motion[..., 0] + turn)
    return np.stack([left, right, motion[..., 1]], axis=-1)


@lru_cache(maxsize=64)
def identified_slope_slip(
    parameters: PlantParameters,
    load: str = "nonuniform",
    speed_step: float = SPEED_STEP,
    slope_step: float = SLOPE_STEP,
) -> SlopeSlipModel:
    """Slip of a vehicle on its soil over sprocket speeds and slopes; starts on level ground, and
    `on` puts it on a slope. A sweep takes seconds and is kept. Raises as `slope_sweep`."""
    mu = strength_over_weight(parameters)
    motion, steady, grid = slope_sweep(parameters, speed_step, slope_step, load)
    table = _table(motion, grid, parameters)[None]
    spacing = 2.0 * STEEPEST / (table.shape[3] - 1)
    radius = parameters.sprocket_radius
    return SlopeSlipFamily(table, steady[None], grid, spacing, radius, (mu,)).at(mu)


@lru_cache(maxsize=8)
def slope_slip_family(
    parameters: PlantParameters,
    frictions: tuple[float, ...] = SLOPE_FRICTIONS,
    load: str = "nonuniform",
    speed_step: float = FAMILY_SPEED_STEP,
    slope_step: float = FAMILY_SLOPE_STEP,
) -> SlopeSlipFamily:
    """Slip on slopes of soils without cohesion of the given mu [-]; kept as well."""
    soilless = parameters._replace(cohesion=0.0, friction_angle=0.0)
    soils = [with_friction(soilless, mu) for mu in frictions]
    models = [identified_slope_slip(soil, load, speed_step, slope_step) for soil in soils]
    first = models[0].family
    table = np.concatenate([model.family.table for model in models])
    steady = np.concatenate([model.family.steady for model in models])
    return SlopeSlipFamily(
        table, steady, first.grid, first.spacing, first.sprocket_radius, frictions
    )
