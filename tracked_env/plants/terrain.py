"""The plant on terrain: six degrees of freedom, patches under the tracks on uneven ground.

Contact and shear are in `physics.patches_on_terrain`, equations of motion and integrator in
`physics.terrain_motion`, terrains in `terrain.height_field`. Options:
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
    centre_of_mass_height [m], nominal, roll_inertia, pitch_inertia [kg m^2]: numbers, or None for
                  those of F's vehicle in proportion, see `physics.terrain_motion`
    longest_step  [s] longer integration steps are divided
    tilt_limit    [rad] of the up axis against the vertical, beyond which an episode ends

The state is that of a point of the hull, where the centre of mass is without a payload. The body
moves about its true centre of mass, which is at c = (c_x, c_y, c_z) from there in body axes:
    p_c = p + R c,   v_c = v + W x c,   a = v_c' + W x v_c - W' x c - W x (W x c)
So the hull stays where it is, and as fast as it is, when a payload is put down or taken up and c
changes: a load that leaves takes its own momentum with it, and one that comes has the hull's
velocity already. The momentum of a load that moves over the hull is not modelled. Sensors are at
the point of the hull. The state keeps the attitude as yaw, pitch, roll, and z above the height at
rest on level ground with the parameters at the start of the episode.

Reference: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env.arrays import RELIEF_COLUMNS, RELIEF_SIZE
from tracked_env.physics import lumped
from tracked_env.physics import parameters as s
from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import terrain_motion as m
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import Drives
from tracked_env.physics.patches_on_level_ground import Belts, middles
from tracked_env.physics.rigid_body import Twist, angles_of, at_point, matrix_of, quaternion_of
from tracked_env.plants import NO_COMMANDS, Ground, Plant, Prepared, distributed
from tracked_env.plants.distributed import LATERAL_LAW, checked_patches, demands, rolling
from tracked_env.plants.lumped_block import derive_free
from tracked_env.step import Block, Pace, advance_blocks, hold_blocks
from tracked_env.terrain.ground import MOST_ROWS, WAVE_SCRATCH, soil_at
from tracked_env.terrain.pool import fill_patches, ground_at, make_pool, member_of
from tracked_env.validation import checked_choice, checked_number

Floats = NDArray[np.float64]
LOADS = ("nonuniform", "uniform")
SOIL_AT = ("centre", "patches")
LONGEST_STEP = m.BodyOptions._field_defaults["longest_step"]  # [s] of an integration step
ROTATIONAL = ("roll_inertia", "pitch_inertia")
FAILURES = ("tilted", "off_map", "overloaded")
_NUMBERS = {
    "stiffness": s.Range(1e4, 1e9, "N/m^3", "It is per area of contact."),
    "damping": s.Range(0.0, 1e8, "N s/m^3", "It is per area of contact."),
    "stiffening": s.Range(0.0, 100.0, "s/m^2", "F table 2 prints N s/m^2."),
    "longest_step": s.Range(1e-5, 5e-3, "s", "Did you pass milliseconds?"),
    "tilt_limit": s.Range(0.01, math.pi, "rad", "Did you pass degrees?"),
}
_HEIGHT = s.Range(1e-4, 10.0, "m", "It is the height above the tracks' plane.")
_INERTIA = s.Range(0.01, 1e6, "kg m^2", "It is about the centre of mass.")
_SCALED = {  # option -> fields of BodyOptions: the number, and the share that it replaces
    "centre_of_mass_height": ("height", "height_ratio"),
    "roll_inertia": ("roll_inertia", "roll_share"),
    "pitch_inertia": ("pitch_inertia", "pitch_share"),
}
_PATCHES = s.Range(1, MOST_ROWS, "-", "Did you pass a length?")
_MOST = g.LANES // 2  # patches of a track
_TORQUE_LEFT, _TORQUE_RIGHT = b.STATE + s.TORQUE_LEFT, b.STATE + s.TORQUE_RIGHT

# Columns of its own: at the end of the last step, then the relief drawn for the episode, see
# `terrain.pool`.
RESISTANCE_LEFT, RESISTANCE_RIGHT, LOAD_LEFT, LOAD_RIGHT, LARGEST_LOAD = range(b.PLANT, b.PLANT + 5)
TOUCHING, OFF_MAP, SATURATED, RELIEF = range(LARGEST_LOAD + 1, LARGEST_LOAD + 5)
OWN_COLUMNS = RELIEF + RELIEF_COLUMNS - b.PLANT


class Options(NamedTuple):
    """Options of the plant, as its kernels take them."""

    reliefs: Any  # of the pool, `terrain.relief.Relief`
    columns: Floats  # middles of the patches over half the contact length
    rows: Floats  # middles of the patches over the track's width
    body: m.BodyOptions
    by_torque: bool
    uniform: bool  # load
    per_patch: bool  # soil


# --- from a row of the batch to a moving body and back ------------------------------------------
@formula
def _shifted(pose, x, y, z):
    """Pose of the point (x, y, z) [m] of the body, in body axes from where `pose` is."""
    r = matrix_of(pose.q)
    return m.Pose3(
        pose.x + (r.xx * x + r.xy * y + r.xz * z),
        pose.y + (r.yx * x + r.yy * y + r.yz * z),
        pose.z + (r.zx * x + r.zy * y + r.zz * z),
        pose.q,
    )


@formula
def _moving_body(floats, i, p, rest_height):
    """(pose, twist, belts) of vehicle i, of its centre of mass."""
    f, row, radius = floats, b.STATE, p.sprocket_radius
    c_x, c_y, c_z = p.centre_of_mass_x, p.centre_of_mass_y, p.centre_of_mass_z
    q = quaternion_of(f[i, row + s.YAW], f[i, row + s.PITCH], f[i, row + s.ROLL])
    pose = m.Pose3(f[i, row + s.X], f[i, row + s.Y], f[i, row + s.Z] + rest_height, q)
    v_x, v_y, v_z = f[i, row + s.V_X], f[i, row + s.V_Y], f[i, row + s.V_Z]
    roll, pitch, yaw = f[i, row + s.ROLL_RATE], f[i, row + s.PITCH_RATE], f[i, row + s.YAW_RATE]
    left, right = f[i, row + s.SPROCKET_SPEED_LEFT], f[i, row + s.SPROCKET_SPEED_RIGHT]
    twist = at_point(Twist(v_x, v_y, v_z, roll, pitch, yaw), c_x, c_y, c_z)
    return _shifted(pose, c_x, c_y, c_z), twist, Belts(left * radius, right * radius)


@formula
def _failure(pitch, roll, off_map, saturated, tilt_limit):
    """Why the vehicle cannot go on: 1, 2, ... of FAILURES, or 0."""
    if math.cos(pitch) * math.cos(roll) < math.cos(tilt_limit):
        return 1.0
    if off_map > 0.0:
        return 2.0
    return 3.0 if saturated > 0.0 else 0.0


@formula
def _rates(wrench, i):
    """Rates of the twist of a body with Inertia i by a Wrench."""
    roll, pitch, yaw = wrench.roll / i.roll, wrench.pitch / i.pitch, wrench.yaw / i.yaw
    return Twist(wrench.x / i.mass, wrench.y / i.mass, wrench.z / i.mass, roll, pitch, yaw)


@formula
def _write(floats, i, w, advanced, p, body, rest_height, tilt_limit):
    """State of vehicle i after the step, its algebraic rows and the plant's columns included.

    w, advanced: scratch and result of `terrain_motion.advance`, of the centre of mass.
    """
    moved, torques, kick, off_map = advanced
    f, row, count = floats, b.STATE, body.patches
    load_left, effort_left, resistance_left = g.track_totals(w, 0, count)
    load_right, effort_right, resistance_right = g.track_totals(w, count, 2 * count)
    largest, touching = 0.0, 0.0
    for lane in range(2 * count):
        largest = max(largest, w[g.LOAD, lane])
        touching += 1.0 if w[g.LOAD, lane] > 0.0 else 0.0
    c_x, c_y, c_z = p.centre_of_mass_x, p.centre_of_mass_y, p.centre_of_mass_z
    twist, belts = at_point(moved[1], -c_x, -c_y, -c_z), moved[2]
    rates = at_point(_rates(kick.wrench, body.inertia), -c_x, -c_y, -c_z)
    pose = _shifted(moved[0], -c_x, -c_y, -c_z)
    yaw, pitch, roll = angles_of(pose.q, f[i, row + s.YAW])
    f[i, row + s.X], f[i, row + s.Y], f[i, row + s.Z] = pose.x, pose.y, pose.z - rest_height
    f[i, row + s.YAW], f[i, row + s.PITCH], f[i, row + s.ROLL] = yaw, pitch, roll
    f[i, row + s.V_X], f[i, row + s.V_Y], f[i, row + s.V_Z] = twist.x, twist.y, twist.z
    f[i, row + s.ROLL_RATE], f[i, row + s.PITCH_RATE] = twist.roll, twist.pitch
    f[i, row + s.YAW_RATE] = twist.yaw
    height = body.footing.height - c_z
    over_ground = lumped.Motion(twist.x - height * twist.pitch, twist.y, twist.yaw)
    left, right = lumped.track_speeds(over_ground, 0.5 * p.track_gauge)
    f[i, row + s.SLIP_LEFT] = soil.slip_ratio(belts.left, left)
    f[i, row + s.SLIP_RIGHT] = soil.slip_ratio(belts.right, right)
    f[i, row + s.SPROCKET_SPEED_LEFT] = belts.left / p.sprocket_radius
    f[i, row + s.SPROCKET_SPEED_RIGHT] = belts.right / p.sprocket_radius
    f[i, row + s.EFFORT_LEFT], f[i, row + s.EFFORT_RIGHT] = effort_left, effort_right
    if body.inverse_belt_mass == 0.0:
        torques = Belts(effort_left * p.sprocket_radius, effort_right * p.sprocket_radius)
    f[i, row + s.TORQUE_LEFT], f[i, row + s.TORQUE_RIGHT] = torques.left, torques.right
    f[i, row + s.ACCELERATION_X] = rates.x + twist.pitch * twist.z - twist.yaw * twist.y
    f[i, row + s.ACCELERATION_Y] = rates.y + twist.yaw * twist.x - twist.roll * twist.z
    f[i, row + s.ACCELERATION_Z] = rates.z + twist.roll * twist.y - twist.pitch * twist.x
    f[i, row + s.YAW_ACCELERATION] = rates.yaw
    f[i, b.FAILURE] = _failure(pitch, roll, off_map, kick.tilt.saturated, tilt_limit)
    f[i, RESISTANCE_LEFT], f[i, RESISTANCE_RIGHT] = resistance_left, resistance_right
    f[i, LOAD_LEFT], f[i, LOAD_RIGHT] = load_left, load_right
    f[i, LARGEST_LOAD], f[i, TOUCHING] = largest, touching / (2 * count)
    f[i, OFF_MAP], f[i, SATURATED] = off_map, kick.tilt.saturated


# --- motion -------------------------------------------------------------------------------------
@formula
def _soil_under_patches(batch, i, period, w, pose, body):
    """Rows of the soil of the scratch, each patch with that of its place; pose: centre of mass."""
    time, count = batch.counters[i, b.STEP] * period, 2 * body.patches
    g.locate(w, count, (pose.x, pose.y, pose.z), matrix_of(pose.q), body.footing.height)
    for lane in range(count):
        x, y = w[g.PLACE_X, lane], w[g.PLACE_Y, lane]
        there = soil_at(batch, i, time, x, y)
        m.set_soil(w, lane, lane + 1, there, body.footing.patch_area)


@formula
def _move(batch, scratch, block, pace, commanded):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    commanded: (commands, Options), as `plants.Prepared` says.
    """
    (w, waves), (commands, options) = scratch, commanded
    i, by_torque, floats = block.vehicles[block.first], options.by_torque, batch.floats
    columns, rows = options.columns, options.rows
    relief = member_of(options.reliefs, int(floats[i, RELIEF + RELIEF_SIZE]))
    p = s.row_parameters(floats, i, b.PARAMETERS)
    base = s.row_parameters(floats, i, b.BASE)
    body = m.body_of(p, columns.size, rows.size, options.body, by_torque, options.uniform)
    lanes = g.place_patches(w, columns, rows, 0.5 * p.track_gauge, p.track_width, body.footing)
    rest_height = m.height_at_rest(base, options.body)
    pose, twist, belts = _moving_body(floats, i, p, rest_height)
    m.set_soil(w, 0, lanes, p, body.footing.patch_area)
    if options.per_patch and batch.counters[i, b.EVENT_COUNT] > 0:
        _soil_under_patches(batch, i, pace.period, w, pose, body)
    command = belts
    if by_torque:
        command = Belts(floats[i, _TORQUE_LEFT], floats[i, _TORQUE_RIGHT])
    demand, decay, steps, h = command, 0.0, 0, 0.0
    if pace.substeps > 0:
        begin, demand, linear = demands(floats, i, p, by_torque, commands)
        steps = math.ceil(pace.substeps * pace.h / options.body.longest_step - 1e-9)
        h = pace.substeps * pace.h / steps
        decay = lumped.torque_decay(h, p.drive_time_constant)
        if linear:
            command, decay = begin, m.LINEAR
    under, start = ((relief, floats, i, RELIEF), waves), (pose, twist, belts)
    drives = Drives(command, demand, decay)
    advanced = m.advance(fill_patches, under, w, start, drives, steps, h, body)
    _write(floats, i, w, advanced, p, body, rest_height, options.body.tilt_limit)


@loop
def advance(batch, rows, clock, options):
    """Kernel of the control step, see `tracked_env.step`."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES)), np.empty(WAVE_SCRATCH)
    return advance_blocks(derive_free, _move, 1, scratch, batch, rows, clock, options)


@loop
def hold(batch, vehicles, pace, options):
    """Kernel of the plant alone, on uniform soil."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES)), np.empty(WAVE_SCRATCH)
    hold_blocks(derive_free, _move, 1, scratch, batch, vehicles, pace, options)


@loop
def patch_loads(batch, options):
    """Settle vehicle 0 of a batch; returns the load [N] of each patch (2, rows, columns)."""
    w = np.empty((g.SCRATCH_ROWS, g.LANES))
    block = Block(np.zeros(1, dtype=np.int64), 0, 1)
    scratch, still = (w, np.empty(WAVE_SCRATCH)), Pace(0, 0.0, 0.0)
    _move(batch, scratch, block, still, (NO_COMMANDS, options))
    rows, columns = options.rows.size, options.columns.size
    return w[g.LOAD, : 2 * rows * columns].copy().reshape(2, rows, columns)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, RESISTANCE_LEFT], floats[i, RESISTANCE_RIGHT]


# --- options --------------------------------------------------------------------------------------
def body_options(options: Mapping[str, Any]) -> m.BodyOptions:
    """Numbers of the options, as `physics.terrain_motion` takes them. Raises ValueError."""
    numbers = {
        name: checked_number(name, options[name], allowed) for name, allowed in _NUMBERS.items()
    }
    for option, (name, share) in _SCALED.items():
        if options[option] is not None:  # else the share of the vehicle's own
            allowed = _HEIGHT if name == "height" else _INERTIA
            numbers |= {name: checked_number(option, options[option], allowed), share: 0.0}
    return m.BodyOptions(**numbers)


def _middles(patches: object) -> tuple[Floats, Floats]:
    """Middles of the patches over half the contact length and over the track's width.

    patches: (along, across) a track. Raises ValueError.
    """
    along, across = checked_patches(patches, _PATCHES)
    if along * across > _MOST:
        raise ValueError(f"patches = {patches!r}; must be at most {_MOST} a track in all")
    return middles(along), -0.5 * middles(across)


def resting(
    surface: Callable[[float, float], Any],
    p: s.PlantParameters,
    body: m.BodyOptions,
    x: float,
    y: float,
    yaw: float,
) -> tuple[float, float, float]:
    """z [m] as the state has it, pitch and roll [rad] of a vehicle at rest under its own weight.

    Its nominal centre of mass is above (x, y) [m], world, at that yaw [rad].
    surface: (x, y) [m] -> height [m], dz/dx, dz/dy [-].
    Sunk in as far as the springs need on that slope, and tilted by a shifted centre of mass as they
    allow. The tilt that the slope adds and the curvature of the ground are not in it: a vehicle
    that starts there settles by milliradians on a plane and by hundredths of a radian on hills.
    """
    height, sink = m.nominal_height(p, body), m.sinkage_at_rest(p, body)
    foot_x, foot_y = x, y
    for _ in range(8):
        height_there, slope_x, slope_y = (float(value) for value in surface(foot_x, foot_y))
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
    return z - m.height_at_rest(p, body), pitch, roll


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    pool = make_pool(options["terrain"])
    columns, rows = _middles(options["patches"])
    uniform = checked_choice("load", options["load"], LOADS) == "uniform"
    per_patch = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "patches"
    body = body_options(options)
    flags = (drive == "torque", uniform, per_patch)
    kernel_options = Options(pool.reliefs, columns, rows, body, *flags)

    def at(floats: Floats, row: int, x: float, y: float) -> Floats:
        places = np.array([[x]]), np.array([[y]])
        return ground_at(pool.reliefs, floats, RELIEF, np.array([row]), *places)[0, :, 0]

    def place(floats: Floats, rows: NDArray[np.int64]) -> None:
        """Belts that roll over the ground without slip, the vehicle on its slope."""
        for i in rows.tolist():
            parameters = floats[i, b.BASE : b.BASE + len(s.PARAMETER_NAMES)].tolist()
            p = s.PlantParameters(*parameters)
            state = s.VehicleState(*floats[i, b.STATE : b.STATE + s.STATE_ROWS].tolist())
            z, pitch, roll = resting(partial(at, floats, i), p, body, state.x, state.y, state.yaw)
            placed = rolling(p, state)._replace(z=z, pitch=pitch, roll=roll)
            floats[i, b.STATE : b.STATE + s.STATE_ROWS] = placed

    def heights(floats: Floats, rows: NDArray[np.int64], x: Floats, y: Floats) -> Floats:
        return ground_at(pool.reliefs, floats, RELIEF, rows, x, y)[:, 0]

    def loads(batch: b.Batch, row: int) -> Floats:
        alone = b.allocate(1, 1, OWN_COLUMNS)._replace(
            floats=batch.floats[[row]], counters=batch.counters[[row]], events=batch.events[[row]]
        )  # a copy of the row: nothing of the episode changes
        along = np.argsort(columns)  # from the rear to the front
        each: Floats = patch_loads(alone, kernel_options)[:, :, along].transpose(0, 2, 1)
        return each

    def centre_height(p: s.PlantParameters) -> float:
        return float(m.height_at_rest(p, body))

    unread = frozenset(name + "_ratio" for name in ROTATIONAL if options[name] is not None)
    ground = Ground(place, heights, loads, centre_height, body.tilt_limit)
    terrains = len(pool.fields)
    return Prepared(advance, hold, kernel_options, unread=unread, ground=ground, terrains=terrains)


_READ = frozenset(s.PARAMETER_NAMES) - LATERAL_LAW
PLANT = Plant(
    name="terrain",
    reads={"torque": _READ, "speed": _READ - s.OF_TORQUE_DRIVES},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={
        **{"terrain": "flat", "load": "nonuniform", "patches": (10, 4), "soil_at": "centre"},
        **dict.fromkeys(_SCALED),
        **{name: m.BodyOptions._field_defaults[name] for name in _NUMBERS},
    },
    columns=OWN_COLUMNS,
    failures=FAILURES,
    relief_column=RELIEF,
    threads_from=16,
    panel=distributed.PLANT.panel,
    soil_map=(*distributed.PLANT.soil_map, "ground_stiffness_factor"),
)
