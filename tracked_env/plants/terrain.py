"""The plant on terrain: six degrees of freedom, patches under the tracks on uneven ground.

Contact and shear are in `physics.ground_contact` and `physics.uniform_load`, equations of motion
and integrator in `physics.terrain_motion`, terrains in `terrain.height_field`. Options:
    terrain       a kind, a dict or a list of them, see `terrain.height_field`, or a choice of
                  terrains of which each episode draws one, see `terrain.pool`
    load          "nonuniform": every patch on its own springs; "uniform": one foot on the tangent
                  plane, its load shared by all patches
    patches       (along, across) a track
    soil_at       "centre": one soil under the vehicle, that of its centre of mass; "patches": under
                  each patch the soil of its place at the beginning of the control step
    stiffness     [N/m^3] k_A of the ground, per area;  damping [N s/m^3] d_A; both times the
                  parameter `ground_stiffness_factor`
    stiffening    [s/m^2] K_tp of the stiffness with speed
    centre_of_mass_height [m], nominal, roll_inertia, pitch_inertia [kg m^2]: numbers, or None
    longest_step  [s] longer integration steps are divided
    tilt_limit    [rad] of the up axis against the vertical, beyond which an episode ends
Defaults and their sources are in `plants.terrain_options`.
How a row of the batch becomes a moving body, and back, is in `plants.terrain_state`.
References: [1] Focchi et al. (2025), table 2 and section 8.

Options of the plant on terrain: defaults with their sources, checks, and where a vehicle rests.

The numbers of F's vehicle and what they mean for others are in `physics.tracked_body`.

Reference: [1] Focchi et al. (2025), table 2 and section 8.

From a row of the batch to a moving body and back: the state of the plant on terrain.

The state is that of a point of the hull, where the centre of mass is without a payload. The body
moves about its true centre of mass, which is at c = (c_x, c_y, c_z) from there in body axes:
    p_c = p + R c,   v_c = v + W x c,   a = v_c' + W x v_c - W' x c - W x (W x c)
So the hull stays where it is, and as fast as it is, when a payload is put down or taken up and c
changes: a load that leaves takes its own momentum with it, and one that comes has the hull's
velocity already. The momentum of a load that moves over the hull is not modelled. Sensors are at
the point of the hull. The state keeps the attitude as yaw, pitch, roll, and z above the height at
rest on level ground with the parameters at the start of the episode.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.arrays import Batch
from tracked_env.physics import lumped, terrain_motion
from tracked_env.physics import parameters as s
from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import (
    OF_TORQUE_DRIVES,
    PARAMETER_NAMES,
    PlantParameters,
    Range,
    VehicleState,
    row_parameters,
)
from tracked_env.physics.patches_on_level_ground import Belts
from tracked_env.physics.patches_on_terrain import LANES, Twist
from tracked_env.physics.rigid_body import angles_of, at_point, matrix_of, quaternion_of
from tracked_env.physics.terrain_motion import (
    DAMPING,
    HEIGHT_RATIO,
    LINEAR,
    STIFFNESS,
    Pose3,
    body_of,
    height_at_rest,
    nominal_height,
    set_soil,
    sinkage_at_rest,
)
from tracked_env.plants.base import Ground, Plant, Prepared
from tracked_env.plants.distributed import (
    DISTRIBUTED,
    LATERAL_LAW,
    checked_patches,
    given_by_drives,
    rolling,
)
from tracked_env.plants.lumped import derive_free
from tracked_env.step import Block, Pace, advance_blocks, hold_blocks
from tracked_env.terrain import ground as terrain_ground
from tracked_env.terrain.ground import level
from tracked_env.terrain.pool import (
    RELIEF_COLUMNS,
    RELIEF_SIZE,
    fill_there,
    ground_at,
    make_pool,
    member_of,
)
from tracked_env.validation import checked_choice, checked_number

LOADS = ("nonuniform", "uniform")
SOIL_AT = ("centre", "patches")
TILT_LIMIT = math.radians(60.0)  # [rad] beyond the tipping angles of F's vehicle: it has fallen
LONGEST_STEP = 2e-3  # [s] of an integration step; docs/terrain.md has the table of step halving
_NUMBERS = {
    "stiffness": Range(1e4, 1e9, "N/m^3", "It is per area of contact."),
    "damping": Range(0.0, 1e8, "N s/m^3", "It is per area of contact."),
    "stiffening": Range(0.0, 100.0, "s/m^2", "F table 2 prints N s/m^2."),
    "longest_step": Range(1e-5, 5e-3, "s", "Did you pass milliseconds?"),
    "tilt_limit": Range(0.01, math.pi, "rad", "Did you pass degrees?"),
}
_SCALED = {
    "centre_of_mass_height": Range(1e-4, 10.0, "m", "It is the height above the tracks' plane."),
    "roll_inertia": Range(0.01, 1e6, "kg m^2", "It is about the centre of mass."),
    "pitch_inertia": Range(0.01, 1e6, "kg m^2", "It is about the centre of mass."),
}
ROTATIONAL = ("roll_inertia", "pitch_inertia")
_PATCHES = Range(1, 80, "-", "Did you pass a length?")
_MOST = LANES // 2  # patches of a track

DEFAULTS: Mapping[str, Any] = {
    "terrain": "flat", "load": "nonuniform", "patches": (10, 4), "soil_at": "centre",
    "centre_of_mass_height": None, "roll_inertia": None, "pitch_inertia": None,
    "stiffness": STIFFNESS, "damping": DAMPING, "stiffening": 0.0, "longest_step": LONGEST_STEP,
    "tilt_limit": TILT_LIMIT,
}  # fmt: skip


class Resting(NamedTuple):
    """Pose of a vehicle that stands on the tangent plane under its foot."""

    z: float  # [m] as the state has it
    pitch: float  # [rad]
    roll: float  # [rad]


def made_of(options: Mapping[str, Any]) -> NDArray[np.float64]:
    """Numbers of the options, as the kernel takes them. Raises ValueError.

    Height as (number, ratio to the contact length), roll and pitch inertia as (number, 1 for the
    parameter's ratio to the yaw inertia), one of the two 0; stiffness, damping, stiffening,
    longest step, tilt limit.
    """
    made: list[float] = []
    ratios = (HEIGHT_RATIO, 1.0, 1.0)
    for (name, allowed), ratio in zip(_SCALED.items(), ratios, strict=True):
        given = options[name]
        made += [0.0, ratio] if given is None else [checked_number(name, given, allowed), 0.0]
    made += [checked_number(name, options[name], allowed) for name, allowed in _NUMBERS.items()]
    return np.array(made)


def patches_of(given: object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the patches over half the contact length and over the track's width.

    given: (along, across) a track. Raises ValueError.
    """
    along, across = checked_patches(given, _PATCHES)
    if along * across > _MOST:
        raise ValueError(f"patches = {given!r}; must be at most {_MOST} a track in all")
    columns = 1.0 - (2.0 * np.arange(along) + 1.0) / along
    rows = (np.arange(across) + 0.5) / across - 0.5
    return 0.5 * (columns - columns[::-1]), 0.5 * (rows - rows[::-1])  # exactly antisymmetric


def resting(
    ground: Callable[[float, float], Any], parameters: PlantParameters, made: NDArray[np.float64],
    x: float, y: float, yaw: float,
) -> Resting:  # fmt: skip
    """Pose with the nominal centre of mass above (x, y) [m], world, and that yaw [rad].

    ground: (x, y) [m] -> height [m], dz/dx, dz/dy [-].
    Sunk in as far as the springs need on that slope, and tilted by a shifted centre of mass as they
    allow. The tilt that the slope adds and the curvature of the ground are not in it: a vehicle
    that starts there settles by milliradians on a plane and by hundredths of a radian on hills.
    """
    p = parameters
    height, sink = nominal_height(p, made), sinkage_at_rest(p, made)
    foot_x, foot_y = x, y
    for _ in range(8):
        height_there, slope_x, slope_y = (float(value) for value in ground(foot_x, foot_y))
        upright = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
        above = height - sink * upright
        foot_x, foot_y = x + above * upright * slope_x, y + above * upright * slope_y
    along = slope_x * math.cos(yaw) + slope_y * math.sin(yaw)
    aside = slope_y * math.cos(yaw) - slope_x * math.sin(yaw)
    z = height_there + above * upright
    pitch, roll = -math.atan(along), math.atan2(aside, math.sqrt(1.0 + along * along))
    # The springs turn by the moment of the shift over their stiffness, while all patches carry.
    ahead = min(max(p.centre_of_mass_x, -p.contact_length / 6.0), p.contact_length / 6.0)
    left = min(max(p.centre_of_mass_y, -p.track_gauge / 2.0), p.track_gauge / 2.0)
    pitch += 12.0 * sink * ahead / p.contact_length**2
    roll -= sink * left / (p.track_gauge**2 / 4.0 + p.track_width**2 / 12.0)
    return Resting(z - height_at_rest(p, made), pitch, roll)


# Columns of its own, all at the end of the last step.
(
    RESISTANCE_LEFT, RESISTANCE_RIGHT, LOAD_LEFT, LOAD_RIGHT, LARGEST_LOAD, TOUCHING, OFF_MAP,
    SATURATED,
) = range(b.PLANT, b.PLANT + 8)  # fmt: skip
# Relief drawn for the vehicle and its episode, see `terrain.drawn_relief`.
RELIEF = SATURATED + 1
OWN_COLUMNS = RELIEF + RELIEF_COLUMNS - b.PLANT
FAILURES = ("tilted", "off_map", "overloaded")


@formula
def _shifted(pose, x, y, z):
    """Pose of the point (x, y, z) [m] of the body, in body axes from where `pose` is."""
    r = matrix_of(pose.q)
    return Pose3(
        pose.x + (r.xx * x + r.xy * y + r.xz * z),
        pose.y + (r.yx * x + r.yy * y + r.yz * z),
        pose.z + (r.zx * x + r.zy * y + r.zz * z),
        pose.q,
    )


@formula
def moving_body(floats, i, p, rest_height):
    """(pose, twist, belts) of vehicle i, of its centre of mass."""
    row = b.STATE
    c_x, c_y, c_z = p.centre_of_mass_x, p.centre_of_mass_y, p.centre_of_mass_z
    q = quaternion_of(floats[i, row + s.YAW], floats[i, row + s.PITCH], floats[i, row + s.ROLL])
    pose = Pose3(floats[i, row + s.X], floats[i, row + s.Y], floats[i, row + s.Z] + rest_height, q)
    twist = Twist(
        floats[i, row + s.V_X], floats[i, row + s.V_Y], floats[i, row + s.V_Z],
        floats[i, row + s.ROLL_RATE], floats[i, row + s.PITCH_RATE], floats[i, row + s.YAW_RATE],
    )  # fmt: skip
    belts = Belts(
        floats[i, row + s.SPROCKET_SPEED_LEFT] * p.sprocket_radius,
        floats[i, row + s.SPROCKET_SPEED_RIGHT] * p.sprocket_radius,
    )
    return _shifted(pose, c_x, c_y, c_z), at_point(twist, c_x, c_y, c_z), belts


@formula
def _failure(pitch, roll, settled, tilt_limit):
    """Why the vehicle cannot go on: 1, 2, ... of FAILURES, or 0."""
    if math.cos(pitch) * math.cos(roll) < math.cos(tilt_limit):
        return 1.0
    if settled.off_map > 0.0:
        return 2.0
    return 3.0 if settled.saturated > 0.0 else 0.0


@formula
def write(floats, i, moved, given, settled, p, body, rest_height, tilt_limit):
    """State of vehicle i after the step, its algebraic rows and the plant's columns included.

    moved: (pose, twist, belts) and settled: Settled, of the centre of mass; given: what the drives
    give.
    """
    row = b.STATE
    c_x, c_y, c_z = p.centre_of_mass_x, p.centre_of_mass_y, p.centre_of_mass_z
    twist, belts = at_point(moved[1], -c_x, -c_y, -c_z), moved[2]
    rates = at_point(settled.rates, -c_x, -c_y, -c_z)
    pose = _shifted(moved[0], -c_x, -c_y, -c_z)
    yaw, pitch, roll = angles_of(pose.q, floats[i, row + s.YAW])
    floats[i, row + s.X], floats[i, row + s.Y] = pose.x, pose.y
    floats[i, row + s.Z] = pose.z - rest_height
    floats[i, row + s.YAW], floats[i, row + s.PITCH], floats[i, row + s.ROLL] = yaw, pitch, roll
    floats[i, row + s.V_X], floats[i, row + s.V_Y] = twist.x, twist.y
    floats[i, row + s.V_Z], floats[i, row + s.YAW_RATE] = twist.z, twist.yaw
    floats[i, row + s.ROLL_RATE], floats[i, row + s.PITCH_RATE] = twist.roll, twist.pitch
    height = body.footing.height - c_z
    over_ground = lumped.Motion(twist.x - height * twist.pitch, twist.y, twist.yaw)
    left, right = lumped.track_speeds(over_ground, 0.5 * p.track_gauge)
    floats[i, row + s.SLIP_LEFT] = soil.slip_ratio(belts.left, left)
    floats[i, row + s.SLIP_RIGHT] = soil.slip_ratio(belts.right, right)
    floats[i, row + s.SPROCKET_SPEED_LEFT] = belts.left / p.sprocket_radius
    floats[i, row + s.SPROCKET_SPEED_RIGHT] = belts.right / p.sprocket_radius
    floats[i, row + s.EFFORT_LEFT] = settled.effort_left
    floats[i, row + s.EFFORT_RIGHT] = settled.effort_right
    if body.drive.inverse_belt_mass == 0.0:
        given = Belts(
            settled.effort_left * p.sprocket_radius, settled.effort_right * p.sprocket_radius
        )
    floats[i, row + s.TORQUE_LEFT], floats[i, row + s.TORQUE_RIGHT] = given.left, given.right
    floats[i, row + s.ACCELERATION_X] = rates.x + twist.pitch * twist.z - twist.yaw * twist.y
    floats[i, row + s.ACCELERATION_Y] = rates.y + twist.yaw * twist.x - twist.roll * twist.z
    floats[i, row + s.ACCELERATION_Z] = rates.z + twist.roll * twist.y - twist.pitch * twist.x
    floats[i, row + s.YAW_ACCELERATION] = rates.yaw
    floats[i, b.FAILURE] = _failure(pitch, roll, settled, tilt_limit)
    floats[i, RESISTANCE_LEFT] = settled.resistance_left
    floats[i, RESISTANCE_RIGHT] = settled.resistance_right
    floats[i, LOAD_LEFT], floats[i, LOAD_RIGHT] = settled.load_left, settled.load_right
    floats[i, LARGEST_LOAD], floats[i, TOUCHING] = settled.largest, settled.touching
    floats[i, OFF_MAP], floats[i, SATURATED] = settled.off_map, settled.saturated


Floats = NDArray[np.float64]
_TORQUE_LEFT, _TORQUE_RIGHT = b.STATE + s.TORQUE_LEFT, b.STATE + s.TORQUE_RIGHT
_NOTHING_HELD = np.zeros((1, 0))  # commands come from the actions


@formula
def _soil_under_patches(batch, i, period, w, pose, body):
    """The same, each patch with the soil of its place; pose: of the centre of mass."""
    terrain = terrain_ground.Terrain(
        batch.floats, batch.events, i, batch.counters[i, b.EVENT_COUNT],
        batch.counters[i, b.STEP] * period,
    )  # fmt: skip
    g.locate(w, 2 * body.patches, (pose.x, pose.y, pose.z), matrix_of(pose.q), body.footing.height)
    for lane in range(2 * body.patches):
        there = terrain_ground.at(level, terrain, w[g.PLACE_X, lane], w[g.PLACE_Y, lane])
        set_soil(w, lane, lane + 1, there.soil, body.footing.patch_area)


@formula
def _demanded(floats, i, p, by_torque, held):
    """What the drives of vehicle i are to give: belt speeds [m/s] or torques [N m].

    held: sprocket speeds [rad/s] or torques of all vehicles, (N, 2), or (N, 4) with those at the
    beginning first and those at the end last; empty where the action says it. Returns (at the
    beginning, at the end, whether the change is linear in time).
    """
    last = held.shape[1] - 2
    if last < 0:
        largest = p.torque_limit if by_torque else p.sprocket_speed_limit * p.sprocket_radius
        asked = Belts(floats[i, b.ACTION] * largest, floats[i, b.ACTION + 1] * largest)
        asked = given_by_drives(asked, p, by_torque)
        return asked, asked, False
    factor = 1.0 if by_torque else p.sprocket_radius
    begin = Belts(held[i, 0] * factor, held[i, 1] * factor)
    end = Belts(held[i, last] * factor, held[i, last + 1] * factor)
    return given_by_drives(begin, p, by_torque), given_by_drives(end, p, by_torque), last > 0


@formula
def _move(batch, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    options: held commands as in `_demanded`, reliefs of the pool, columns and rows of the patches,
    numbers of the plant's options, by_torque, uniform, per_patch.
    """
    i = block.chosen[block.first]
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch = options
    floats = batch.floats
    relief = member_of(reliefs, int(floats[i, RELIEF + RELIEF_SIZE]))
    p = row_parameters(floats, i, b.PARAMETERS)
    base, count = row_parameters(floats, i, b.BASE), columns.size * rows.size
    body = body_of(p, g.padded(2 * count), count, made, by_torque, uniform)
    lanes = g.place_patches(w, columns, rows, 0.5 * p.track_gauge, p.track_width, body.footing)
    rest_height = height_at_rest(base, made)
    pose, twist, belts = moving_body(floats, i, p, rest_height)
    set_soil(w, 0, lanes, p, body.footing.patch_area)
    if per_patch and batch.counters[i, b.EVENT_COUNT] > 0:
        _soil_under_patches(batch, i, pace.period, w, pose, body)
    command = belts
    if by_torque:
        command = Belts(floats[i, _TORQUE_LEFT], floats[i, _TORQUE_RIGHT])
    demand, decay, steps, h = command, 0.0, 0, 0.0
    if pace.substeps > 0:
        begin, demand, linear = _demanded(floats, i, p, by_torque, held)
        steps = math.ceil(pace.substeps * pace.h / made[9] - 1e-9)
        h = pace.substeps * pace.h / steps
        decay = lumped.torque_decay(h, p.drive_time_constant)
        if linear:
            command, decay = begin, LINEAR
    end, command, kick, off = terrain_motion.advance(
        fill_there, (relief, floats, i, RELIEF), w, (pose, twist, belts), command, demand, decay,
        steps, h, body,
    )  # fmt: skip
    settled = terrain_motion.settled_of(w, kick, off, body)
    write(floats, i, end, command, settled, p, body, rest_height, made[10])


@loop
def advance(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    clock = (start, stop, moving, substeps, substep, error_limit)
    rest = (*clock, held, reliefs, columns, rows, made, by_torque, uniform, per_patch)
    return advance_blocks(derive_free, _move, 1, scratch, batch, given, rest)


@loop
def hold(*call):
    """Kernel of the plant alone, on uniform soil; what is held comes before the plant's options."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    return hold_blocks(derive_free, _move, 1, scratch, call[:12] + call[13:])


@loop
def settle(
    floats, counters, profile, events, noise, history, period,
    held, reliefs, columns, rows, made, by_torque, uniform, per_patch,
):  # fmt: skip
    """Settle vehicle 0 of a batch; returns the load [N] of each patch (2, rows, columns)."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    rest = (held, reliefs, columns, rows, made, by_torque, uniform, per_patch)
    _move(batch, scratch, Block(np.zeros(1, dtype=np.int64), 0, 1), Pace(0, 0.0, period), rest)
    found = scratch[g.LOAD, : 2 * rows.size * columns.size].copy()
    return found.reshape(2, rows.size, columns.size)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, RESISTANCE_LEFT], floats[i, RESISTANCE_RIGHT]


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    pool = make_pool(options["terrain"])
    columns, rows = patches_of(options["patches"])
    uniform = checked_choice("load", options["load"], LOADS) == "uniform"
    per_patch = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "patches"
    made = made_of(options)

    def at(floats: Floats, row: int, x: float, y: float) -> Floats:
        places = np.array([[x]]), np.array([[y]])
        return ground_at(pool.reliefs, floats, RELIEF, np.array([row]), *places)[0, :, 0]

    def place(floats: Floats, chosen: NDArray[np.int64]) -> None:
        """Belts that roll over the ground without slip, the vehicle on its slope."""
        for i in chosen.tolist():
            own = floats[i]
            parameters = PlantParameters(*own[b.BASE : b.BASE + len(PARAMETER_NAMES)].tolist())
            state = VehicleState(*own[b.STATE : b.STATE + s.STATE_ROWS].tolist())
            pose = resting(partial(at, floats, i), parameters, made, state.x, state.y, state.yaw)
            placed = rolling(parameters, state)._replace(z=pose.z, pitch=pose.pitch, roll=pose.roll)
            own[b.STATE : b.STATE + s.STATE_ROWS] = placed

    def heights(floats: Floats, chosen: NDArray[np.int64], x: Floats, y: Floats) -> Floats:
        return ground_at(pool.reliefs, floats, RELIEF, chosen, x, y)[:, 0]

    def loads(batch: Batch, row: int) -> Floats:
        own = b.allocate(1, 1, OWN_COLUMNS)._replace(
            floats=batch.floats[[row]], counters=batch.counters[[row]], events=batch.events[[row]]
        )  # a copy of the row: nothing of the episode changes
        along = np.argsort(columns)  # from the rear to the front
        return settle(*own, 0.0, *chosen)[:, :, along].transpose(0, 2, 1)

    def centre_height(p: PlantParameters) -> float:
        return float(height_at_rest(p, made))

    unread = frozenset(name + "_ratio" for name in ROTATIONAL if options[name] is not None)
    flags = (drive == "torque", uniform, per_patch)
    chosen = (_NOTHING_HELD, pool.reliefs, columns, rows, made, *flags)
    ground = Ground(place, heights, loads, centre_height, float(made[10]))
    terrains = len(pool.fields)
    return Prepared(advance, hold, chosen, unread=unread, ground=ground, terrains=terrains)


_READ = frozenset(PARAMETER_NAMES) - LATERAL_LAW
TERRAIN = Plant(
    name="terrain",
    reads={"torque": _READ, "speed": _READ - OF_TORQUE_DRIVES},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options=DEFAULTS,
    columns=OWN_COLUMNS,
    failures=FAILURES,
    relief_column=RELIEF,
    threads_from=16,
    panel=DISTRIBUTED.panel,
    soil_map=(*DISTRIBUTED.soil_map, "ground_stiffness_factor"),
)
