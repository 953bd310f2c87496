"""Slip of a tracked vehicle identified from runs at constant sprocket speeds: F section 4.

    sweep         every pair of sprocket speeds on a grid, held until the motion is steady
    read_measured the same from a file of runs of a real vehicle
    upsample      smooth surfaces through the points by radial basis functions, F 4.2
    identified_slip  sweep of a vehicle on its soil: the table for the loop
    slip_family      the same over friction, for a soil that is not known
slip_regression goes on with decision trees and the exponential form.
F holds each pair for 2 s from rest and averages. At mu = 0.1 the motion is steady to 1 % after
4 s only, so here a run starts as a unicycle would move, lasts SETTLING times the time in which
friction stops the vehicle from its top speed, and the mean is taken over the last AVERAGED.
The integrator's steady motions do not depend on its step, so steps may be long.

Where sprockets stand, or the vehicle turns on the spot, alpha has no value: 0 is recorded, and
the side velocity v_y beside it.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 4, 7.2.3.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RBFInterpolator

from baselines.slip.slip_models import (
    Array,
    Grid,
    SlipFamily,
    TableSlipModel,
)
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.physics.patch_dynamics import hold_speeds
from tracked_env.physics.patch_forces import Patches, make_patches
from tracked_env.physics.terramechanics import GRAVITY

STEP = 0.65  # [rad/s] between sprocket speeds, F 4.2
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

    def rows(self, chosen: ArrayLike) -> "SlipData":
        """The runs named by indices or a mask."""
        return SlipData(*(column[np.asarray(chosen)] for column in self))


def strength_over_weight(parameters: PlantParameters) -> float:
    """mu [-]: the soil's strength under both tracks over the weight; tan(phi) without cohesion."""
    area = 2.0 * parameters.track_width * parameters.contact_length
    weight = parameters.mass * GRAVITY
    return parameters.cohesion * area / weight + float(np.tan(parameters.friction_angle))


def with_friction(parameters: PlantParameters, mu: float) -> PlantParameters:
    """The vehicle on a soil without cohesion whose strength over weight is mu [-].

    Raises ValueError for mu outside its range.
    """
    highest = math.tan(RANGES["friction_angle"].high)
    if not 0.0 < mu <= highest:
        raise ValueError(f"mu = {mu}; must be in (0, {highest:.3g}]. Did you pass an angle?")
    return parameters._replace(cohesion=0.0, friction_angle=math.atan(mu))


def steady_motion(
    parameters: PlantParameters, left: ArrayLike, right: ArrayLike, patches: Patches | None = None
) -> Array:
    """(N, 3) v_x, v_y [m/s], yaw rate [rad/s] after sprocket speeds [rad/s] were held for long."""
    speeds = np.stack([np.asarray(left, dtype=float), np.asarray(right, dtype=float)], axis=1)
    patches = make_patches() if patches is None else patches
    rows = np.tile(np.array(parameters, dtype=np.float64), (len(speeds), 1))
    loads, states = np.empty((len(speeds), 6)), np.zeros((len(speeds), 6))
    radius = parameters.sprocket_radius
    states[:, 3] = 0.5 * radius * (speeds[:, 0] + speeds[:, 1])
    states[:, 5] = radius * (speeds[:, 1] - speeds[:, 0]) / parameters.track_gauge
    fastest = radius * np.abs(speeds).max(initial=0.0)
    duration = SETTLING * fastest / (strength_over_weight(parameters) * GRAVITY)
    steps = math.ceil(min(max(duration, SHORTEST), LONGEST) / LONG_STEP)
    hold_speeds(states, speeds, rows, patches, steps, LONG_STEP, False, loads)
    total = np.zeros((len(speeds), 3))
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
    return SlipData(
        left, right, radius * left - (v_x - half * yaw_rate),
        radius * right - (v_x + half * yaw_rate), alpha, v_x, v_y, yaw_rate,
    )  # fmt: skip


def sweep(
    parameters: PlantParameters,
    step: float = STEP,
    limit: float | None = None,
    patches: Patches | None = None,
) -> SlipData:
    """Steady slip at all pairs of sprocket speeds on a grid, left speed first.

    step [rad/s]: wanted; the nearest one that divides `limit` is used, so that standstill and
    both ends are in the grid (0.65 does not divide F's 10). limit [rad/s]: None is the
    vehicle's sprocket_speed_limit. Only a quarter of the pairs is simulated: mirrored left to
    right and front to back the plant moves in the same way, to the last bit.
    Raises ValueError for a step or limit that is not positive.
    """
    limit = parameters.sprocket_speed_limit if limit is None else limit
    if not (0.0 < limit < math.inf and 0.0 < step <= limit):
        raise ValueError(
            f"step = {step} rad/s up to {limit} rad/s; must be 0 < step <= limit. "
            "Did you swap them?"
        )
    half = round(limit / step)
    index = np.arange(-half, half + 1)
    i, j = (a.ravel() for a in np.meshgrid(index, index, indexing="ij"))
    turned = np.where(i + j < 0, -1, 1)  # reverse is forward with the front behind
    a, b = turned * i, turned * j
    mirrored = a > b  # a right turn is a left turn mirrored
    low, high = np.minimum(a, b), np.maximum(a, b)
    codes, place = np.unique(low * (4 * half + 1) + high, return_inverse=True)
    first = np.zeros(len(codes), dtype=np.int64)
    first[place] = np.arange(len(i))
    unit = float(limit / half)
    motion = steady_motion(parameters, unit * low[first], unit * high[first], patches)[place]
    # Mirrored left to right v_y and w change sign; front to back v_x and w do.
    flip = np.where(mirrored, -1.0, 1.0)
    motion = motion * np.stack([turned, flip, flip * turned], axis=1)
    motion[low == high, 1:] = 0.0
    motion[low == -high, :2] = 0.0
    return slip_data(parameters, np.asarray(unit * i), np.asarray(unit * j), motion)


def read_measured(path: str | Path, parameters: PlantParameters, gear: float = GEAR) -> SlipData:
    """Runs of a real vehicle from a file without header: motor speed left, right [rad/s],
    beta_left, beta_right [m/s], alpha [rad], comma separated.

    parameters: sprocket_radius and track_gauge are used. gear [-]: motor over sprocket speed.
    alpha there is that of atan2 and is brought into (-pi/2, pi/2). Raises ValueError for a file
    of another layout.
    """
    table = np.loadtxt(path, delimiter=",", ndmin=2)
    if table.shape[1] != 5 or not np.isfinite(table).all():
        raise ValueError(
            f"{path} has {table.shape[1]} columns; must be 5, all finite: motor speeds left, "
            "right, beta_left, beta_right, alpha. Does it have a header or other columns?"
        )
    left, right = table[:, 0] / gear, table[:, 1] / gear
    track_left = parameters.sprocket_radius * left - table[:, 2]
    track_right = parameters.sprocket_radius * right - table[:, 3]
    v_x = 0.5 * (track_left + track_right)
    tangent = np.tan(table[:, 4])
    yaw_rate = (track_right - track_left) / parameters.track_gauge
    return SlipData(
        left, right, table[:, 2], table[:, 3], np.arctan(tangent), v_x, v_x * tangent, yaw_rate
    )


def upsample(
    data: SlipData,
    parameters: PlantParameters,
    spacing: float = SPACING,
    smoothing: float = SMOOTHING,
) -> tuple[SlipData, Grid]:
    """Smooth surfaces through the runs on a grid [rad/s] that has a node at standstill.

    Thin plate splines through beta_left, beta_right and v_y; alpha follows from them. F lays
    one through alpha of each direction, which ends at the jump. Returns the data, left speed
    first, and its grid. Raises ValueError for a spacing that is not positive.
    """
    if not 0.0 < spacing < math.inf:
        raise ValueError(f"spacing = {spacing} rad/s; must be positive. Is it in rad/s?")
    columns = (data.sprocket_left, data.sprocket_right)
    ends = [
        (math.floor(c.min() / spacing + 1e-9), math.ceil(c.max() / spacing - 1e-9)) for c in columns
    ]
    ends = [(min(low, 0), max(high, 1)) for low, high in ends]
    axes = [spacing * np.arange(low, high + 1) for low, high in ends]
    points = np.stack(columns, axis=1)
    surface = RBFInterpolator(
        points, np.stack([data.beta_left, data.beta_right, data.v_y], axis=1),
        neighbors=None if len(points) <= ALL_POINTS else NEIGHBOURS, smoothing=smoothing,
    )  # fmt: skip
    left, right = (a.ravel() for a in np.meshgrid(*axes, indexing="ij"))
    beta_left, beta_right, v_y = surface(np.stack([left, right], axis=1)).T
    track_left = parameters.sprocket_radius * left - beta_left
    track_right = parameters.sprocket_radius * right - beta_right
    motion = np.stack(
        [0.5 * (track_left + track_right), v_y, (track_right - track_left) / parameters.track_gauge]
    )
    grid = Grid(spacing, -ends[0][0], -ends[1][0], len(axes[0]), len(axes[1]))
    return slip_data(parameters, left, right, motion.T), grid


def make_table(data: SlipData, grid: Grid, parameters: PlantParameters) -> TableSlipModel:
    """The model for the loop from data on a grid, left speed first, as `upsample` gives it."""
    columns = np.stack([data.beta_left, data.beta_right, data.v_y], axis=1)
    table = columns.reshape(grid.count_left, grid.count_right, 3)
    return TableSlipModel(table, grid, parameters.sprocket_radius)


@lru_cache(maxsize=64)
def identified_slip(
    parameters: PlantParameters, step: float = STEP, smooth: bool = False
) -> TableSlipModel:
    """Table of the slip of a vehicle on its soil, as wide as its sprockets are fast.

    A sweep takes 0.02 to 0.2 s and is kept. Its points serve as they are; smooth: upsampled as
    in F, 2 s more and no nearer to the plant. Raises as `sweep` does.
    """
    data = sweep(parameters, step)
    if smooth:
        data, grid = upsample(data, parameters)
    else:
        half = math.isqrt(len(data.alpha)) // 2
        grid = Grid(parameters.sprocket_speed_limit / half, half, half, 2 * half + 1, 2 * half + 1)
    return make_table(data, grid, parameters)


@lru_cache(maxsize=16)
def slip_family(
    parameters: PlantParameters, frictions: tuple[float, ...] = FRICTIONS, step: float = STEP
) -> SlipFamily:
    """Tables of the slip of a vehicle on soils without cohesion of the given mu [-].

    The sweeps take less than a second in all and are kept. Raises ValueError as
    `with_friction`, `sweep` and SlipFamily do.
    """
    soilless = parameters._replace(cohesion=0.0, friction_angle=0.0)
    models = [_of_friction(soilless, mu, step) for mu in frictions]
    table = np.concatenate([model.table for model in models])
    return SlipFamily(table, models[0].grid, parameters.sprocket_radius, frictions)


def _of_friction(parameters: PlantParameters, mu: float, step: float) -> TableSlipModel:
    return identified_slip(with_friction(parameters, mu), step)
