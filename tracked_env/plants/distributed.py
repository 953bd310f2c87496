"""The distributed plant: patches of soil under each track, after Focchi et al. (2025).

Shear of the soil is in `physics.patch_forces`, equations of motion and integrators in
`physics.patch_dynamics`. Options:
    patches     (along, across) a track
    integrator  "rosenbrock", or "euler": explicit, to compare with published simulators
    soil_at     "centre": one soil under the whole vehicle, that of its centre of mass; "tracks":
                under each track the soil of the middle of that track
The vector lanes are the patches of one vehicle, so vehicles are taken one by one.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tracked_env import arrays as b
from tracked_env.arrays import Batch
from tracked_env.physics import lumped, patches_on_level_ground
from tracked_env.physics import parameters as s
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import (
    IN_SPACE,
    OF_TORQUE_DRIVES,
    PARAMETER_NAMES,
    PlantParameters,
    Range,
    VehicleState,
    row_parameters,
)
from tracked_env.physics.patches_on_level_ground import SPEED_DRIVEN, Belts, Pose, TrackedVehicle
from tracked_env.plants.base import Plant, Prepared
from tracked_env.plants.lumped import REST, derive_free, derived
from tracked_env.step import advance_blocks, hold_blocks
from tracked_env.terrain import ground
from tracked_env.terrain.ground import level
from tracked_env.validation import checked_choice, checked_whole

INTEGRATORS = ("rosenbrock", "euler")
SOIL_AT = ("centre", "tracks")
_PATCHES = Range(1, patches_on_level_ground.COLUMN_LIMIT, "-", "Did you pass a length?")
NO_REST = -1.0  # [m/s, rad/s] every speed is a motion: the plant alone changes no digit
_RESISTANCE_LEFT, _RESISTANCE_RIGHT = b.PLANT, b.PLANT + 1  # [N] at the end of the last step
# What the lumped law of the lateral friction needs, and shear has no use for.
LATERAL_LAW = {"lateral_resistance", "turning_resistance_factor", "icr_forward"}


@formula
def _state(floats, i, radius):
    """Pose, motion and belts of vehicle i."""
    row = b.STATE
    cosine, sine = rotation(floats[i, row + s.YAW])
    pose = Pose(floats[i, row + s.X], floats[i, row + s.Y], floats[i, row + s.YAW], cosine, sine)
    motion = Motion(floats[i, row + s.V_X], floats[i, row + s.V_Y], floats[i, row + s.YAW_RATE])
    left, right = row + s.SPROCKET_SPEED_LEFT, row + s.SPROCKET_SPEED_RIGHT
    return pose, motion, Belts(floats[i, left] * radius, floats[i, right] * radius)


@formula
def _rested(speed, rest):
    """The speed, or 0 where it is too small to be a motion."""
    return speed if abs(speed) > rest else 0.0


@formula
def _write(floats, i, moved, torques, k, rest):
    """State of vehicle i after the step, its algebraic rows included; slower than rest is rest."""
    row = b.STATE
    motion, loads, rates = moved.motion, moved.loads, moved.rates
    floats[i, row + s.X], floats[i, row + s.Y] = moved.pose.x, moved.pose.y
    floats[i, row + s.YAW] = moved.pose.yaw
    floats[i, row + s.V_X] = _rested(motion.v_x, rest)
    floats[i, row + s.V_Y] = _rested(motion.v_y, rest)
    floats[i, row + s.YAW_RATE] = _rested(motion.yaw_rate, rest)
    floats[i, row + s.TORQUE_LEFT], floats[i, row + s.TORQUE_RIGHT] = torques.left, torques.right
    left, right = lumped.track_speeds(motion, k.half_gauge)
    floats[i, row + s.SLIP_LEFT] = soil.slip_ratio(moved.belts.left, left)
    floats[i, row + s.SLIP_RIGHT] = soil.slip_ratio(moved.belts.right, right)
    floats[i, row + s.SPROCKET_SPEED_LEFT] = moved.belts.left * k.inverse_radius
    floats[i, row + s.SPROCKET_SPEED_RIGHT] = moved.belts.right * k.inverse_radius
    floats[i, row + s.EFFORT_LEFT] = loads.effort_left
    floats[i, row + s.EFFORT_RIGHT] = loads.effort_right
    forward, lateral = lumped.inertial_acceleration(motion, rates.v_x, rates.v_y)
    floats[i, row + s.ACCELERATION_X], floats[i, row + s.ACCELERATION_Y] = forward, lateral
    floats[i, row + s.YAW_ACCELERATION] = rates.yaw_rate
    floats[i, _RESISTANCE_LEFT] = loads.resistance_left
    floats[i, _RESISTANCE_RIGHT] = loads.resistance_right


@formula
def _asked(floats, i, p, by_torque, options):
    """Torques [N m] or belt speeds [m/s] that the action of vehicle i asks for."""
    largest = p.torque_limit if by_torque else p.sprocket_speed_limit * p.sprocket_radius
    return Belts(floats[i, b.ACTION] * largest, floats[i, b.ACTION + 1] * largest)


@formula
def _held(floats, i, p, by_torque, options):
    """The same from options[0] (N, 2): torques [N m] or sprocket speeds [rad/s]."""
    factor = 1.0 if by_torque else p.sprocket_radius
    return Belts(options[0][i, 0] * factor, options[0][i, 1] * factor)


@formula
def given_by_drives(asked, p, by_torque):
    """What drives with these gains settle at: torques [N m], or belt speeds [m/s] as asked."""
    if not by_torque:
        return asked
    return Belts(p.actuator_gain_left * asked.left, p.actuator_gain_right * asked.right)


@formula
def _one_soil(batch, i, period, p, parts, inverse_belt_mass, patches):
    """TrackedVehicle on the soil of its centre of mass; parts: coefficients, drive limits."""
    k, drive = parts
    contact = patches_on_level_ground.contact_of(p, k, drive, patches)
    return patches_on_level_ground.on_one_soil(k, drive, contact, inverse_belt_mass)


@formula
def _track_soil(terrain, p, x, y, patches):
    """(Contact, largest motion resistance [N]) of a track whose middle is at (x, y) [m]."""
    there = ground.on_soil(p, ground.at(level, terrain, x, y).soil)
    k = lumped.coefficients(there, False)
    contact = patches_on_level_ground.contact_of(there, k, lumped.drive_limits(there), patches)
    return contact, k.resistance


@formula
def _two_soils(batch, i, period, p, parts, inverse_belt_mass, patches):
    """The same with the soil of the middle of each track."""
    k, drive = parts
    floats = batch.floats
    time = batch.counters[i, b.STEP] * period
    terrain = ground.Terrain(floats, batch.events, i, batch.counters[i, b.EVENT_COUNT], time)
    cosine, sine = rotation(floats[i, b.STATE + s.YAW])
    x, y = floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
    aside_x, aside_y = -sine * k.half_gauge, cosine * k.half_gauge
    left, left_resistance = _track_soil(terrain, p, x + aside_x, y + aside_y, patches)
    right, right_resistance = _track_soil(terrain, p, x - aside_x, y - aside_y, patches)
    return TrackedVehicle(
        k, drive, (left, right), (left_resistance, right_resistance), inverse_belt_mass
    )


@formula
def _move(demand_of, soils, rest, batch, w, block, pace, chosen, options):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    demand_of: `_asked` or `_held`. soils: `_one_soil` or `_two_soils`. rest [m/s, rad/s]: slower
    is no motion. chosen: patches, by_torque (the action is a torque, else a speed), euler.
    """
    i = block.chosen[block.first]
    patches, by_torque, euler = chosen
    floats, substeps = batch.floats, pace.substeps
    p = row_parameters(floats, i, b.PARAMETERS)
    k, drive = derived(floats, i)
    start = _state(floats, i, p.sprocket_radius)
    if by_torque:
        inverse_belt_mass = p.sprocket_radius * p.sprocket_radius / p.sprocket_inertia
        torque = b.STATE + s.TORQUE_LEFT
        command = Belts(floats[i, torque], floats[i, torque + 1])
    else:
        inverse_belt_mass = SPEED_DRIVEN
        command = start[2]
    demand = command
    if substeps > 0:
        demand = given_by_drives(demand_of(floats, i, p, by_torque, options), p, by_torque)
    half_decay = floats[i, b.TORQUE_DECAY]
    body = soils(batch, i, pace.period, p, (k, drive), inverse_belt_mass, patches)
    moved, given = patches_on_level_ground.advance(
        w, start, command, demand, half_decay * half_decay, substeps, pace.h, body, patches, euler
    )
    if not by_torque:
        given = Belts(
            moved.loads.effort_left * p.sprocket_radius,
            moved.loads.effort_right * p.sprocket_radius,
        )
    _write(floats, i, moved, given, k, rest)


@formula
def _move_on_one_soil(batch, w, block, pace, options):
    """As `advance_blocks` takes it."""
    _move(_asked, _one_soil, REST, batch, w, block, pace, options, options)


@formula
def _move_on_two_soils(batch, w, block, pace, options):
    """The same with a soil under each track."""
    _move(_asked, _two_soils, REST, batch, w, block, pace, options, options)


@formula
def _hold_on_one_soil(batch, w, block, pace, options):
    """As `hold_blocks` takes it."""
    _move(_held, _one_soil, NO_REST, batch, w, block, pace, options[1:], options)


@loop
def advance(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit, patches, by_torque, euler,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((patches_on_level_ground.SCRATCH_ROWS, patches_on_level_ground.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit, patches, by_torque, euler)
    return advance_blocks(derive_free, _move_on_one_soil, 1, scratch, batch, given, rest)


@loop
def advance_on_two_soils(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit, patches, by_torque, euler,
):  # fmt: skip
    """The same with a soil under each track."""
    scratch = np.empty((patches_on_level_ground.SCRATCH_ROWS, patches_on_level_ground.LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit, patches, by_torque, euler)
    return advance_blocks(derive_free, _move_on_two_soils, 1, scratch, batch, given, rest)


@loop
def hold(*call):
    """Kernel of the plant alone, on uniform soil."""
    scratch = np.empty((patches_on_level_ground.SCRATCH_ROWS, patches_on_level_ground.LANES))
    return hold_blocks(derive_free, _hold_on_one_soil, 1, scratch, call)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, _RESISTANCE_LEFT], floats[i, _RESISTANCE_RIGHT]


def rolling(parameters: PlantParameters, state: VehicleState) -> VehicleState:
    """Belts that roll over the ground without slip."""
    turn = 0.5 * parameters.track_gauge * state.yaw_rate
    return state._replace(
        sprocket_speed_left=(state.v_x - turn) / parameters.sprocket_radius,
        sprocket_speed_right=(state.v_x + turn) / parameters.sprocket_radius,
    )


def checked_patches(given: object, allowed: Range = _PATCHES) -> tuple[int, int]:
    """Numbers of patches along and across a track. Raises ValueError."""
    if isinstance(given, (str, Mapping)) or not isinstance(given, Sequence) or len(given) != 2:
        raise ValueError(f"patches = {given!r}; must be two numbers: along, across a track")
    along, across = (
        checked_whole(f"patches {way} the track", number, allowed)
        for way, number in zip(("along", "across"), given, strict=True)
    )
    return along, across


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    patches = patches_on_level_ground.make_patches(*checked_patches(options["patches"]))
    euler = checked_choice("integrator", options["integrator"], INTEGRATORS) == "euler"
    split = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "tracks"
    kernel = advance_on_two_soils if split else advance
    chosen = (patches, drive == "torque", euler)
    return Prepared(kernel, hold, chosen, rolling)


_READ = frozenset(PARAMETER_NAMES) - LATERAL_LAW - IN_SPACE
DISTRIBUTED = Plant(
    name="distributed",
    reads={"torque": _READ, "speed": _READ - OF_TORQUE_DRIVES},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={"patches": (10, 4), "integrator": "rosenbrock", "soil_at": "centre"},
    columns=2,
    threads_from=16,
    panel=(
        "mass", "inertia", "friction", "longitudinal_resistance", "cohesion", "friction_angle",
        "shear_deformation_modulus",
    ),
    soil_map=(
        "friction_angle", "cohesion", "longitudinal_resistance", "shear_deformation_modulus",
    ),
)  # fmt: skip
