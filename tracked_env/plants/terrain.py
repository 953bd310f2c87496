"""The plant on terrain: six degrees of freedom, patches under the tracks on uneven ground.

Contact and shear are in `physics.ground_contact` and `physics.uniform_load`, equations of motion
and integrator in `physics.terrain_motion`, terrains in `terrain.height_field`. Options:
    terrain       a kind, a dict or a list of them, see `terrain.height_field`
    load          "nonuniform": every patch on its own springs; "uniform": one foot on the tangent
                  plane, its load shared by all patches
    patches       (along, across) a track
    soil_at       "centre": one soil under the vehicle, that of its centre of mass; "patches": under
                  each patch the soil of its place at the beginning of the control step
    stiffness     [N/m^3] k_A of the ground, per area;  damping [N s/m^3] d_A
    stiffening    [s/m^2] K_tp of the stiffness with speed
    centre_of_mass_height [m], roll_inertia, pitch_inertia [kg m^2]: numbers, or None
    longest_step  [s] longer integration steps are divided
    tilt_limit    [rad] of the up axis against the vertical, beyond which an episode ends
Defaults and their sources are in `plants.terrain_options`.
The state keeps the attitude as yaw, pitch, roll and z above the height at rest on level ground.
References: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine.columns import Batch
from tracked_env.engine.kernels import advance_blocks, hold_blocks
from tracked_env.physics import ground_contact as g
from tracked_env.physics import state as s
from tracked_env.physics import terrain_motion, vehicle
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.attitude import angles_of, matrix_of, quaternion_of
from tracked_env.physics.ground_contact import Twist
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import (
    PARAMETER_INDEX,
    PARAMETER_NAMES,
    PlantParameters,
    row_parameters,
)
from tracked_env.physics.patch_dynamics import Belts
from tracked_env.physics.state import VehicleState
from tracked_env.physics.terrain_motion import LINEAR, Pose3
from tracked_env.physics.tracked_body import body_of, set_soil
from tracked_env.plants.base import Ground, Plant, Prepared
from tracked_env.plants.derived import derive_free
from tracked_env.plants.distributed import DISTRIBUTED, LATERAL_LAW, rolling
from tracked_env.plants.terrain_options import (
    DEFAULTS,
    LOADS,
    SOIL_AT,
    height_at_rest,
    made_of,
    patches_of,
    resting,
)
from tracked_env.terrain import ground as terrain_ground
from tracked_env.terrain.drawn_relief import RELIEF_SIZE, fill_there, ground_at
from tracked_env.terrain.flat import level
from tracked_env.terrain.height_field import make_height_field
from tracked_env.validation import checked_choice

# Columns of its own, all at the end of the last step.
(
    RESISTANCE_LEFT, RESISTANCE_RIGHT, LOAD_LEFT, LOAD_RIGHT, LARGEST_LOAD, TOUCHING, OFF_MAP,
    SATURATED,
) = range(b.PLANT, b.PLANT + 8)  # fmt: skip
# Relief drawn for the vehicle and its episode, see `terrain.drawn_relief`.
RELIEF = SATURATED + 1
_COLUMNS = RELIEF + RELIEF_SIZE - b.PLANT
FAILURES = ("tilted", "off_map", "overloaded")
Floats = NDArray[np.float64]
_NOTHING_HELD = np.zeros((1, 0))  # commands come from the actions
_BASE_MASS = b.BASE + PARAMETER_INDEX["mass"]
_BASE_LENGTH = b.BASE + PARAMETER_INDEX["contact_length"]
_BASE_WIDTH = b.BASE + PARAMETER_INDEX["track_width"]


@formula
def _soil_under_patches(batch, i, period, w, pose, body):
    """The same, each patch with the soil of its place."""
    terrain = terrain_ground.Terrain(
        batch.floats, batch.events, i, batch.counters[i, b.EVENT_COUNT],
        batch.counters[i, b.STEP] * period,
    )  # fmt: skip
    g.locate(w, 2 * body.patches, (pose.x, pose.y, pose.z), matrix_of(pose.q), body.footing.height)
    for lane in range(2 * body.patches):
        there = terrain_ground.at(level, terrain, w[g.PLACE_X, lane], w[g.PLACE_Y, lane])
        set_soil(w, lane, lane + 1, there.soil, body.footing.patch_area)


@formula
def _failure(pitch, roll, settled, tilt_limit):
    """Why the vehicle cannot go on: 1, 2, ... of FAILURES, or 0."""
    if math.cos(pitch) * math.cos(roll) < math.cos(tilt_limit):
        return 1.0
    if settled.off_map > 0.0:
        return 2.0
    return 3.0 if settled.saturated > 0.0 else 0.0


@formula
def _write(floats, i, moved, given, settled, p, body, rest_height, tilt_limit):
    """State of vehicle i after the step, its algebraic rows and the plant's columns included."""
    row = b.STATE
    pose, twist, belts = moved
    yaw, pitch, roll = angles_of(pose.q, floats[i, row + s.YAW])
    floats[i, row + s.X], floats[i, row + s.Y] = pose.x, pose.y
    floats[i, row + s.Z] = pose.z - rest_height
    floats[i, row + s.YAW], floats[i, row + s.PITCH], floats[i, row + s.ROLL] = yaw, pitch, roll
    floats[i, row + s.V_X], floats[i, row + s.V_Y] = twist.x, twist.y
    floats[i, row + s.V_Z], floats[i, row + s.YAW_RATE] = twist.z, twist.yaw
    floats[i, row + s.ROLL_RATE], floats[i, row + s.PITCH_RATE] = twist.roll, twist.pitch
    over_ground = vehicle.Motion(twist.x - body.footing.height * twist.pitch, twist.y, twist.yaw)
    left, right = vehicle.track_speeds(over_ground, 0.5 * p.track_gauge)
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
    rates = settled.rates
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


@formula
def _demanded(floats, i, p, by_torque, held):
    """What the drives of vehicle i are asked for: belt speeds [m/s] or torques [N m].

    held: sprocket speeds [rad/s] or torques of all vehicles, (N, 2), or (N, 4) with those at the
    beginning first and those at the end last; empty where the action says it. Returns (at the
    beginning, at the end, whether the change is linear in time).
    """
    last = held.shape[1] - 2
    if last < 0:
        largest = p.torque_limit if by_torque else p.sprocket_speed_limit * p.sprocket_radius
        asked = Belts(floats[i, b.ACTION] * largest, floats[i, b.ACTION + 1] * largest)
        return asked, asked, False
    factor = 1.0 if by_torque else p.sprocket_radius
    begin = Belts(held[i, 0] * factor, held[i, 1] * factor)
    return begin, Belts(held[i, last] * factor, held[i, last + 1] * factor), last > 0


@formula
def _move(batch, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    options: held commands as in `_demanded`, relief, columns and rows of the patches, numbers of
    the plant's options, by_torque, uniform, per_patch.
    """
    i = block.chosen[block.first]
    held, relief, columns, rows, made, by_torque, uniform, per_patch = options
    floats = batch.floats
    p = row_parameters(floats, i, b.PARAMETERS)
    half_length, count = 0.5 * p.contact_length, columns.size * rows.size
    lanes = g.place_patches(w, columns, rows, half_length, 0.5 * p.track_gauge, p.track_width)
    body = body_of(p, lanes, count, made, by_torque, uniform)
    row = b.STATE
    rest_height = height_at_rest(
        floats[i, _BASE_MASS], floats[i, _BASE_LENGTH], floats[i, _BASE_WIDTH], made
    )
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
    set_soil(w, 0, lanes, p, body.footing.patch_area)
    if per_patch and batch.counters[i, b.EVENT_COUNT] > 0:
        _soil_under_patches(batch, i, pace.period, w, pose, body)
    command = belts
    if by_torque:
        command = Belts(floats[i, row + s.TORQUE_LEFT], floats[i, row + s.TORQUE_RIGHT])
    demand, decay, steps, h = command, 0.0, 0, 0.0
    if pace.substeps > 0:
        begin, demand, linear = _demanded(floats, i, p, by_torque, held)
        steps = math.ceil(pace.substeps * pace.h / made[9] - 1e-9)
        h = pace.substeps * pace.h / steps
        decay = vehicle.torque_decay(h, p.drive_time_constant)
        if linear:
            command, decay = begin, LINEAR
    end, command, kick, off = terrain_motion.advance(
        fill_there, (relief, floats, i, RELIEF), w, (pose, twist, belts), command, demand, decay,
        steps, h, body,
    )  # fmt: skip
    _write(
        floats, i, end, command, terrain_motion.settled_of(w, kick, off, body), p, body,
        rest_height, made[10],
    )  # fmt: skip


@loop
def advance(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
    held, relief, columns, rows, made, by_torque, uniform, per_patch,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    clock = (start, stop, moving, substeps, substep, error_limit)
    rest = (*clock, held, relief, columns, rows, made, by_torque, uniform, per_patch)
    return advance_blocks(derive_free, _move, 1, scratch, batch, given, rest)


@loop
def hold(*call):
    """Kernel of the plant alone, on uniform soil; what is held comes before the plant's options."""
    scratch = np.empty((g.SCRATCH_ROWS, g.LANES))
    return hold_blocks(derive_free, _move, 1, scratch, call[:12] + call[13:])


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, RESISTANCE_LEFT], floats[i, RESISTANCE_RIGHT]


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    field = make_height_field(options["terrain"])
    columns, rows = patches_of(options["patches"])
    uniform = checked_choice("load", options["load"], LOADS) == "uniform"
    per_patch = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "patches"
    made = made_of(options)

    def at(floats: Floats, row: int, x: float, y: float) -> Floats:
        places = np.array([[x]]), np.array([[y]])
        return ground_at(field.relief, floats, RELIEF, np.array([row]), *places)[0, :, 0]

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
        return ground_at(field.relief, floats, RELIEF, chosen, x, y)[:, 0]

    def loads(floats: Floats, row: int) -> Floats:
        return floats[row, [LOAD_LEFT, LOAD_RIGHT]].reshape(2, 1, 1)

    def centre_height(p: PlantParameters) -> float:
        return float(height_at_rest(p.mass, p.contact_length, p.track_width, made))

    flags = (drive == "torque", uniform, per_patch)
    chosen = (_NOTHING_HELD, field.relief, columns, rows, made, *flags)
    ground = Ground(place, heights, loads, centre_height, float(made[10]))
    return Prepared(advance, hold, chosen, ground=ground)


_READ = frozenset(PARAMETER_NAMES) - LATERAL_LAW
TERRAIN = Plant(
    name="terrain",
    reads={"torque": _READ, "speed": _READ - {"torque_limit", "sprocket_inertia"}},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options=DEFAULTS,
    columns=_COLUMNS,
    failures=FAILURES,
    relief_column=RELIEF,
    threads_from=16,
    panel=DISTRIBUTED.panel,
    soil_map=DISTRIBUTED.soil_map,
)
