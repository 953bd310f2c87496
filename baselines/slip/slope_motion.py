"""Motion of a vehicle on a plane whose slope, seen from the vehicle, stays what it is.

A vehicle that turns on a slope has no steady motion: the direction of gravity in its axes turns
with it. F 4.5 identifies slip as a function of that direction, so here it is held: after every
few steps the world is turned about the centre of mass until gravity is back where it was, the
ground and all motion with it. What is then steady is the motion of a vehicle at that moment of a
turn, as long as its direction changes slowly against the time in which slip settles.

State (STATE_SIZE): twist v_x, v_y, v_z, roll, pitch, yaw rate; n_x, n_y of the ground's normal in
body axes; distance of the centre of mass from the ground along that normal. The model is that of
`physics.terrain_motion`, springs, load transfer and all. Attitude: (roll, pitch), the yaw is 0.

References: [F] Focchi et al. (2025), section 4.5.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import terrain_motion
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import Drives
from tracked_env.physics.parameters import PlantParameters, row_parameters
from tracked_env.physics.patches_on_level_ground import Belts
from tracked_env.physics.rigid_body import Twist, matrix_of, quaternion_of, turned
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.validation import checked_choice

Array = NDArray[np.float64]

NORMAL_X, NORMAL_Y, DISTANCE = 6, 7, 8
STATE_SIZE = 9
PLANAR, CONTACT = [0, 1, 5], [2, 3, 4, 6, 7, 8]  # v_x, v_y, yaw rate; and all the rest
STEP = 0.01  # [s] of the integration; steady motions depend on it by less than 1e-6 m/s
STEPS = 2  # between two turns of the world back to its slope
TOLERANCE = 5e-4  # [m/s^2] change of a motion that is steady: leaves 1e-4 m/s
SETTLING = 20.0  # [-] times top speed / (mu g), until then it must be
SHORTEST, LONGEST = 3.0, 20.0  # [s] and at least and at most this
LOADS = ("nonuniform", "uniform")
PATCHES = (10, 4)  # along, across a track
TOGETHER = 64  # runs that a thread does at a time


class Schedule(NamedTuple):
    """How long sprocket speeds are held: `most` times `steps` steps."""

    steps: int  # between two turns of the world back to its slope
    step: float  # [s]
    most: int
    tolerance: float  # [m/s^2, of the outer track] change of a motion that ends it


class Tracks(NamedTuple):
    """The tracks of the plant: middles of the patches, see `place_patches`, and the load model."""

    columns: Array  # over half the contact length
    rows: Array  # over the track's width
    body: terrain_motion.BodyOptions  # springs and inertias
    uniform: bool  # load model


def tracks_of(
    patches: tuple[int, int] = PATCHES,
    body: terrain_motion.BodyOptions = terrain_motion.NOMINAL_BODY,
    load: str = "nonuniform",
) -> Tracks:
    """Tracks with so many patches along and across. Raises ValueError for an unknown load."""
    checked_choice("load", load, LOADS)
    along, across = patches
    columns = 1.0 - (2.0 * np.arange(along) + 1.0) / along
    rows = (np.arange(across) + 0.5) / across - 0.5
    middles = 0.5 * (columns - columns[::-1]), 0.5 * (rows - rows[::-1])
    return Tracks(*middles, body, load == "uniform")


@formula
def _fill_plane(plane, w, count, grid):
    """The ground a x + b y in lanes 0 .. count - 1; plane: (a, b). Nothing is off it."""
    a, b = plane
    for lane in range(count):
        w[g.HEIGHT, lane] = a * w[g.PLACE_X, lane] + b * w[g.PLACE_Y, lane]
        w[g.SLOPE_X, lane] = a
        w[g.SLOPE_Y, lane] = b
    return 0.0


@formula
def _move(states, i, w, q, belts, schedule, body):
    """Advance vehicle i by one batch of steps; q: its attitude in the middle of them."""
    s = states[i]
    twist = Twist(s[0], s[1], s[2], s[3], s[4], s[5])
    steps, h = schedule.steps, schedule.step
    back = -0.5 * steps * h
    q = turned(q, back * twist.roll, back * twist.pitch, back * twist.yaw)
    r = matrix_of(q)
    n_x, n_y = s[NORMAL_X], s[NORMAL_Y]
    n_z = math.sqrt(max(1.0 - n_x * n_x - n_y * n_y, 0.0))
    up_x = r.xx * n_x + r.xy * n_y + r.xz * n_z
    up_y = r.yx * n_x + r.yy * n_y + r.yz * n_z
    up_z = r.zx * n_x + r.zy * n_y + r.zz * n_z
    plane = (-up_x / up_z, -up_y / up_z)
    pose = terrain_motion.Pose3(0.0, 0.0, s[DISTANCE] / up_z, q)
    (pose, twist, _belts), _command, _kick, _off = terrain_motion.advance(
        _fill_plane, plane, w, (pose, twist, belts), Drives(belts, belts, 0.0), steps, h, body
    )
    r = matrix_of(pose.q)
    s[0], s[1], s[2] = twist.x, twist.y, twist.z
    s[3], s[4], s[5] = twist.roll, twist.pitch, twist.yaw
    s[NORMAL_X] = r.xx * up_x + r.yx * up_y + r.zx * up_z
    s[NORMAL_Y] = r.xy * up_x + r.yy * up_y + r.zy * up_z
    s[DISTANCE] = up_x * pose.x + up_y * pose.y + up_z * pose.z


@loop
def hold_on_slope(states, attitude, sprockets, rows, tracks, schedule, durations):
    """Hold sprocket speeds (N, 2) [rad/s] on slopes, as a Schedule says.

    states (N, STATE_SIZE) in and out; a DISTANCE of 0 begins with a contact at rest. attitude
    (N, 2) roll, pitch [rad]. rows: PlantParameters (N, ...). durations (N,) [s] out: time held, or
    infinity where it was not steady by then.
    """
    columns, across = tracks.columns.size, tracks.rows.size
    w = np.empty((g.SCRATCH_ROWS, g.padded(2 * columns * across)))
    for i in range(states.shape[0]):
        p = row_parameters(rows, i, 0)
        half_gauge = 0.5 * p.track_gauge
        body = terrain_motion.body_of(p, columns, across, tracks.body, False, tracks.uniform)
        lanes = g.place_patches(
            w, tracks.columns, tracks.rows, half_gauge, p.track_width, body.footing
        )
        terrain_motion.set_soil(w, 0, lanes, p, body.footing.patch_area)
        roll, pitch = attitude[i, 0], attitude[i, 1]
        if states[i, DISTANCE] == 0.0:  # sunk in, no tilt
            sink = terrain_motion.sinkage_at_rest(p, tracks.body) * math.cos(pitch) * math.cos(roll)
            states[i, NORMAL_X], states[i, NORMAL_Y] = 0.0, 0.0
            states[i, DISTANCE] = body.footing.height - sink
        q = quaternion_of(0.0, pitch, roll)
        belts = Belts(p.sprocket_radius * sprockets[i, 0], p.sprocket_radius * sprockets[i, 1])
        durations[i] = math.inf
        for k in range(schedule.most):
            v_x, v_y, yaw_rate = states[i, 0], states[i, 1], states[i, 5]
            _move(states, i, w, q, belts, schedule, body)
            change = abs(states[i, 0] - v_x) + abs(states[i, 1] - v_y)
            change += half_gauge * abs(states[i, 5] - yaw_rate)
            if change < schedule.tolerance * schedule.steps * schedule.step:
                durations[i] = (k + 1) * schedule.steps * schedule.step
                break


def attitudes(grade: ArrayLike) -> Array:
    """(N, 2) roll, pitch [rad] of a vehicle that feels the grade t (N, 2)."""
    slopes = np.asarray(grade, dtype=np.float64).reshape(-1, 2)
    roll = -np.arctan(slopes[:, 1])
    return np.stack([roll, np.arctan(slopes[:, 0] * np.cos(roll))], axis=1)


def strength_over_weight(parameters: PlantParameters) -> float:
    """mu [-]: the soil's strength under both tracks over the weight; tan(phi) without cohesion."""
    area = 2.0 * parameters.track_width * parameters.contact_length
    weight = parameters.mass * GRAVITY
    return parameters.cohesion * area / weight + float(np.tan(parameters.friction_angle))


def steady_on_slopes(
    parameters: PlantParameters,
    sprockets: ArrayLike,
    grade: ArrayLike,
    load: str = "nonuniform",
    patches: tuple[int, int] = PATCHES,
    body: terrain_motion.BodyOptions = terrain_motion.NOMINAL_BODY,
    tolerance: float = TOLERANCE,
) -> Array:
    """(N, 3) v_x, v_y [m/s], yaw rate [rad/s] at sprocket speeds (N, 2) [rad/s], left then right,
    and grades t (N, 2), see `slip_models`; NaN where no motion is steady.

    load, patches: of the terrain plant. body: its springs, inertias. Raises
    ValueError for an unknown load.
    """
    speeds = np.ascontiguousarray(sprockets, dtype=np.float64)
    count, radius = len(speeds), parameters.sprocket_radius
    fastest = SETTLING * radius * np.abs(speeds).max(initial=0.0)
    duration = fastest / (strength_over_weight(parameters) * GRAVITY)
    most = math.ceil(min(max(duration, SHORTEST), LONGEST) / (STEPS * STEP))
    states, durations = np.zeros((count, STATE_SIZE)), np.empty(count)
    states[:, 0] = 0.5 * radius * (speeds[:, 0] + speeds[:, 1])
    states[:, 5] = radius * (speeds[:, 1] - speeds[:, 0]) / parameters.track_gauge
    rows = np.tile(np.array(parameters, dtype=np.float64), (count, 1))
    tracks, schedule = tracks_of(patches, body, load), Schedule(STEPS, STEP, most, tolerance)
    parts = [slice(at, at + TOGETHER) for at in range(0, count, TOGETHER)]
    rowwise = states, attitudes(grade), speeds, rows, durations

    def hold(part: slice) -> None:
        of_part, slope, speed, row, held = (each[part] for each in rowwise)
        hold_on_slope(of_part, slope, speed, row, tracks, schedule, held)

    with ThreadPoolExecutor() as pool:  # the kernel lets other threads run
        list(pool.map(hold, parts))
    motion = states[:, PLANAR]
    motion[~np.isfinite(durations)] = np.nan
    return motion
