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

Motion of a vehicle on a plane whose slope, seen from the vehicle, stays what it is.

A vehicle that turns on a slope has no steady motion: the direction of gravity in its axes turns
with it. F 4.5 identifies slip as a function of that direction, so here it is held: after every
few steps the world is turned about the centre of mass until gravity is back where it was, the
ground and all motion with it. What is then steady is the motion of a vehicle at that moment of a
turn, as long as its direction changes slowly against the time in which slip settles.

State (STATE_SIZE): twist v_x, v_y, v_z, roll, pitch, yaw rate; n_x, n_y of the ground's normal in
body axes; distance of the centre of mass from the ground along that normal. The model is that of
`physics.terrain_motion`, springs, load transfer and all. Attitude: (roll, pitch), the yaw is 0.

References: [F] Focchi et al. (2025), section 4.5.

Slip on slopes identified from runs at constant sprocket speeds and gravity direction: F 4.5.

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
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RBFInterpolator

from baselines.slip.slip_models import (
    STEEPEST,
    Array,
    Grid,
    SlipFamily,
    SlopeSlipFamily,
    SlopeSlipModel,
    TableSlipModel,
)
from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import terrain_motion
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import Drives, hold_speeds
from tracked_env.physics.parameters import RANGES, PlantParameters, row_parameters
from tracked_env.physics.patches_on_level_ground import Belts, Patches, make_patches
from tracked_env.physics.rigid_body import Twist, matrix_of, quaternion_of, turned
from tracked_env.physics.terrain_motion import (
    NOMINAL_BODY,
    BodyOptions,
    Pose3,
    body_of,
    set_soil,
    sinkage_at_rest,
)
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


NORMAL_X, NORMAL_Y, DISTANCE = 6, 7, 8
STATE_SIZE = 9
PLANAR, CONTACT = [0, 1, 5], [2, 3, 4, 6, 7, 8]  # v_x, v_y, yaw rate; and all the rest


@formula
def _fill_plane(plane, w, count):
    """The ground a x + b y in lanes 0 .. count - 1; plane: (a, b). Nothing is off it."""
    a, b = plane
    for lane in range(count):
        w[g.HEIGHT, lane] = a * w[g.PLACE_X, lane] + b * w[g.PLACE_Y, lane]
        w[g.SLOPE_X, lane] = a
        w[g.SLOPE_Y, lane] = b
    return 0.0


@formula
def _rest(states, i, body, sink):
    """Set the contact of vehicle i: sunk in by `sink` [m], no tilt."""
    states[i, NORMAL_X], states[i, NORMAL_Y] = 0.0, 0.0
    states[i, DISTANCE] = body.footing.height - sink


@formula
def _move(states, i, w, q, belts, steps, h, body):
    """Advance vehicle i by `steps` steps of h [s]; q: its attitude in the middle of them."""
    twist = Twist(
        states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5]
    )  # fmt: skip
    back = -0.5 * steps * h
    q = turned(q, back * twist.roll, back * twist.pitch, back * twist.yaw)
    r = matrix_of(q)
    n_x, n_y = states[i, NORMAL_X], states[i, NORMAL_Y]
    n_z = math.sqrt(max(1.0 - n_x * n_x - n_y * n_y, 0.0))
    up_x = r.xx * n_x + r.xy * n_y + r.xz * n_z
    up_y = r.yx * n_x + r.yy * n_y + r.yz * n_z
    up_z = r.zx * n_x + r.zy * n_y + r.zz * n_z
    plane = (-up_x / up_z, -up_y / up_z)
    pose = Pose3(0.0, 0.0, states[i, DISTANCE] / up_z, q)
    (pose, twist, _belts), _command, _kick, _off = terrain_motion.advance(
        _fill_plane, plane, w, (pose, twist, belts), Drives(belts, belts, 0.0), steps, h, body
    )
    r = matrix_of(pose.q)
    states[i, 0], states[i, 1], states[i, 2] = twist.x, twist.y, twist.z
    states[i, 3], states[i, 4], states[i, 5] = twist.roll, twist.pitch, twist.yaw
    states[i, NORMAL_X] = r.xx * up_x + r.yx * up_y + r.zx * up_z
    states[i, NORMAL_Y] = r.xy * up_x + r.yy * up_y + r.zy * up_z
    states[i, DISTANCE] = up_x * pose.x + up_y * pose.y + up_z * pose.z


@loop
def hold_on_slope(
    states, attitude, sprockets, rows, columns, lines, numbers, uniform, steps, h,
    tolerance, most, taken,
):  # fmt: skip
    """Hold sprocket speeds (N, 2) [rad/s] on slopes: `most` times `steps` steps of h [s].

    states (N, STATE_SIZE) in and out; a DISTANCE of 0 begins with a contact at rest. attitude
    (N, 2) roll, pitch [rad]. rows: PlantParameters (N, ...). columns, lines: middles of the
    patches, see `ground_contact.place_patches`; numbers: BodyOptions; uniform:
    load model. A vehicle ends early when its motion changes by less than `tolerance` [m/s^2, of
    the outer track]. taken (N,) [s] out: time held, or infinity where it was not steady by then.
    """
    w = np.empty((g.SCRATCH_ROWS, g.padded(2 * columns.size * lines.size)))
    for i in range(states.shape[0]):
        p = row_parameters(rows, i, 0)
        count = columns.size * lines.size
        half_gauge = 0.5 * p.track_gauge
        body = body_of(p, g.padded(2 * count), count, numbers, False, uniform)
        lanes = g.place_patches(w, columns, lines, half_gauge, p.track_width, body.footing)
        set_soil(w, 0, lanes, p, body.footing.patch_area)
        roll, pitch = attitude[i, 0], attitude[i, 1]
        if states[i, DISTANCE] == 0.0:
            _rest(states, i, body, sinkage_at_rest(p, numbers) * math.cos(pitch) * math.cos(roll))
        q = quaternion_of(0.0, pitch, roll)
        belts = Belts(p.sprocket_radius * sprockets[i, 0], p.sprocket_radius * sprockets[i, 1])
        taken[i] = math.inf
        for k in range(most):
            v_x, v_y, yaw_rate = states[i, 0], states[i, 1], states[i, 5]
            _move(states, i, w, q, belts, steps, h, body)
            change = abs(states[i, 0] - v_x) + abs(states[i, 1] - v_y)
            change += half_gauge * abs(states[i, 5] - yaw_rate)
            if change < tolerance * steps * h:
                taken[i] = (k + 1) * steps * h
                break


SPEED_STEP = 1.25  # [rad/s] between sprocket speeds; slip is nearly linear between them
SLOPE_STEP = 0.125  # [-] of t / mu, for one soil
FAMILY_SPEED_STEP, FAMILY_SLOPE_STEP = 2.5, 0.21875  # [rad/s], [-] for a family of soils
SLOPE_FRICTIONS = (0.1, 0.175, 0.3, 0.5, 0.85)  # [-] mu of a family
NEAREST = 0.95  # [-] of t / mu: a steeper node of the grid has the slip of this slope
STEP_SLOPE_SWEEP = 0.01  # [s] of the integration; steady motions depend on it by less than 1e-6 m/s
STEPS = 2  # between two turns of the world back to its slope
TOLERANCE = 5e-4  # [m/s^2] change of a motion that is steady: leaves 1e-4 m/s
SETTLING_SLOPE_SWEEP = 20.0  # [-] times top speed / (mu g), until then it must be
SHORTEST_SLOPE_SWEEP, LONGEST_SLOPE_SWEEP = 3.0, 20.0  # [s] and at least and at most this
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
    numbers: BodyOptions = NOMINAL_BODY,
    tolerance: float = TOLERANCE,
) -> Array:
    """(N, 3) v_x, v_y [m/s], yaw rate [rad/s] at sprocket speeds (N, 2) [rad/s], left then right,
    and grades t (N, 2), see `slope_models`; NaN where no motion is steady.

    load, patches: of the terrain plant. numbers: its springs and inertias.
    Raises ValueError for an unknown load.
    """
    if load not in LOADS:
        raise ValueError(f"load = {load!r}; must be one of {', '.join(LOADS)}")
    speeds = np.ascontiguousarray(sprockets, dtype=np.float64)
    count, radius = len(speeds), parameters.sprocket_radius
    fastest = SETTLING_SLOPE_SWEEP * radius * np.abs(speeds).max(initial=0.0)
    duration = fastest / (strength_over_weight(parameters) * GRAVITY)
    most = math.ceil(
        min(max(duration, SHORTEST_SLOPE_SWEEP), LONGEST_SLOPE_SWEEP) / (STEPS * STEP_SLOPE_SWEEP)
    )
    states, taken = np.zeros((count, STATE_SIZE)), np.empty(count)
    states[:, 0] = 0.5 * radius * (speeds[:, 0] + speeds[:, 1])
    states[:, 5] = radius * (speeds[:, 1] - speeds[:, 0]) / parameters.track_gauge
    rows = np.tile(np.array(parameters, dtype=np.float64), (count, 1))
    hold_on_slope(
        states, attitudes(grade), speeds, rows, *middles(patches), numbers,
        load == "uniform", STEPS, STEP_SLOPE_SWEEP, tolerance, most, taken,
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
    numbers: BodyOptions = NOMINAL_BODY,
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
            parameters, unit * runs[left, :2], mu * ratio[left], load, patches, numbers
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
