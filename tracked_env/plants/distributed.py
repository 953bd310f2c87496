"""The distributed plant: patches of soil under each track, after Focchi et al. (2025).

Shear of the soil is in `physics.patches_on_level_ground`, the rest in `physics.level_motion`.
Options:
    patches     (along, across) a track
    integrator  "rosenbrock", or "euler": explicit, to compare with published simulators
    soil_at     "centre": one soil under the whole vehicle, that of its centre of mass; "tracks":
                under each track the soil of the middle of that track
The vector lanes are the patches of one vehicle, so vehicles are taken one by one.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tracked_env import arrays as b
from tracked_env.physics import level_motion, lumped
from tracked_env.physics import parameters as s
from tracked_env.physics import patches_on_level_ground as physics
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import SPEED_DRIVEN, Drives, Pose, TrackedVehicle
from tracked_env.physics.patches_on_level_ground import Belts
from tracked_env.plants import Plant, Prepared
from tracked_env.plants.lumped_block import REST, derive_free, derived, row_motion
from tracked_env.step import advance_blocks, hold_blocks
from tracked_env.terrain import ground
from tracked_env.validation import checked_choice, checked_whole

INTEGRATORS = ("rosenbrock", "euler")
SOIL_AT = ("centre", "tracks")
_PATCHES = s.Range(1, physics.COLUMN_LIMIT, "-", "Did you pass a length?")
NO_REST = -1.0  # [m/s, rad/s] every speed is a motion: the plant alone changes no digit
_RESISTANCE_LEFT, _RESISTANCE_RIGHT = b.PLANT, b.PLANT + 1  # [N] at the end of the last step
# What the lumped law of the lateral friction needs, and shear has no use for.
LATERAL_LAW = {"lateral_resistance", "turning_resistance_factor", "icr_forward"}


class Options(NamedTuple):
    """Options of the plant, as its kernels take them."""

    patches: Any  # `patches_on_level_ground.Patches`
    by_torque: bool  # the action is a torque, else a speed
    euler: bool


@formula
def _state(floats, i, radius):
    row = b.STATE
    cosine, sine = rotation(floats[i, row + s.YAW])
    pose = Pose(floats[i, row + s.X], floats[i, row + s.Y], floats[i, row + s.YAW], cosine, sine)
    left, right = floats[i, row + s.SPROCKET_SPEED_LEFT], floats[i, row + s.SPROCKET_SPEED_RIGHT]
    return pose, row_motion(floats, i, row + s.V_X), Belts(left * radius, right * radius)


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
    acceleration = lumped.inertial_acceleration(motion, rates.v_x, rates.v_y)
    floats[i, row + s.ACCELERATION_X], floats[i, row + s.ACCELERATION_Y] = acceleration
    floats[i, row + s.YAW_ACCELERATION] = rates.yaw_rate
    floats[i, _RESISTANCE_LEFT] = loads.resistance_left
    floats[i, _RESISTANCE_RIGHT] = loads.resistance_right


@formula
def _with_gains(demand, p, by_torque):
    """What drives with their gains settle at: torques [N m], or belt speeds [m/s] as they are."""
    if not by_torque:
        return demand
    return Belts(p.actuator_gain_left * demand.left, p.actuator_gain_right * demand.right)


@formula
def demands(floats, i, p, by_torque, commands):
    """What the drives of vehicle i are to give: belt speeds [m/s] or torques [N m].

    commands: sprocket speeds [rad/s] or torques of all vehicles, (N, 2), or (N, 4) with those at
    the beginning first and those at the end last; (N, 0) where the action says it. Returns (at the
    beginning, at the end, whether the change is linear in time).
    """
    last = commands.shape[1] - 2
    if last < 0:
        largest = p.torque_limit if by_torque else p.sprocket_speed_limit * p.sprocket_radius
        action = Belts(floats[i, b.ACTION] * largest, floats[i, b.ACTION + 1] * largest)
        steady = _with_gains(action, p, by_torque)
        return steady, steady, False
    factor = 1.0 if by_torque else p.sprocket_radius
    begin = Belts(commands[i, 0] * factor, commands[i, 1] * factor)
    end = Belts(commands[i, last] * factor, commands[i, last + 1] * factor)
    return _with_gains(begin, p, by_torque), _with_gains(end, p, by_torque), last > 0


@formula
def _one_soil(batch, i, period, p, parts, inverse_belt_mass, patches):
    """TrackedVehicle on the soil of its centre of mass; parts: coefficients, drive limits."""
    k, drive = parts
    contact = physics.contact_of(p, k, drive, patches)
    return level_motion.on_one_soil(k, drive, contact, inverse_belt_mass)


@formula
def _track_soil(batch, i, time, p, x, y, patches):
    """(Contact, largest motion resistance [N]) of a track whose middle is at (x, y) [m]."""
    there = ground.on_soil(p, ground.soil_at(batch, i, time, x, y))
    k = lumped.coefficients(there, False)
    return physics.contact_of(there, k, lumped.drive_limits(there), patches), k.resistance


@formula
def _two_soils(batch, i, period, p, parts, inverse_belt_mass, patches):
    k, drive = parts
    floats, time = batch.floats, batch.counters[i, b.STEP] * period
    cosine, sine = rotation(floats[i, b.STATE + s.YAW])
    x, y = floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
    aside_x, aside_y = -sine * k.half_gauge, cosine * k.half_gauge
    left = _track_soil(batch, i, time, p, x + aside_x, y + aside_y, patches)
    right = _track_soil(batch, i, time, p, x - aside_x, y - aside_y, patches)
    contacts, resistances = (left[0], right[0]), (left[1], right[1])
    return TrackedVehicle(k, drive, contacts, resistances, inverse_belt_mass)


@formula
def _move(soils, batch, w, block, pace, commanded):
    """Advance (pace.substeps > 0) and settle the vehicle of the block.

    soils: `_one_soil` or `_two_soils`. commanded: (commands, Options), as `plants.Prepared` says.
    """
    commands, options = commanded
    i, by_torque, patches = block.vehicles[block.first], options.by_torque, options.patches
    floats, substeps = batch.floats, pace.substeps
    p = s.row_parameters(floats, i, b.PARAMETERS)
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
        _, demand, _ = demands(floats, i, p, by_torque, commands)
    half_decay = floats[i, b.TORQUE_DECAY]
    decay = half_decay * half_decay
    body = soils(batch, i, pace.period, p, (k, drive), inverse_belt_mass, patches)
    drives = Drives(command, demand, decay)
    moved, torques = level_motion.advance(
        w, start, drives, substeps, pace.h, body, patches, options.euler
    )
    if not by_torque:
        loads, radius = moved.loads, p.sprocket_radius
        torques = Belts(loads.effort_left * radius, loads.effort_right * radius)
    rest = REST if commands.shape[1] == 0 else NO_REST
    _write(floats, i, moved, torques, k, rest)


@formula
def _move_on_one_soil(batch, w, block, pace, options):
    _move(_one_soil, batch, w, block, pace, options)


@formula
def _move_on_two_soils(batch, w, block, pace, options):
    _move(_two_soils, batch, w, block, pace, options)


@loop
def advance(batch, rows, clock, options):
    """Kernel of the control step, see `tracked_env.step`."""
    w = np.empty((physics.SCRATCH_ROWS, physics.LANES))
    return advance_blocks(derive_free, _move_on_one_soil, 1, w, batch, rows, clock, options)


@loop
def advance_on_two_soils(batch, rows, clock, options):
    """The same with a soil under each track."""
    w = np.empty((physics.SCRATCH_ROWS, physics.LANES))
    return advance_blocks(derive_free, _move_on_two_soils, 1, w, batch, rows, clock, options)


@loop
def hold(batch, vehicles, pace, options):
    """Kernel of the plant alone, on uniform soil."""
    w = np.empty((physics.SCRATCH_ROWS, physics.LANES))
    hold_blocks(derive_free, _move_on_one_soil, 1, w, batch, vehicles, pace, options)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    return floats[i, _RESISTANCE_LEFT], floats[i, _RESISTANCE_RIGHT]


def rolling(parameters: s.PlantParameters, state: s.VehicleState) -> s.VehicleState:
    """Belts that roll over the ground without slip."""
    turn = 0.5 * parameters.track_gauge * state.yaw_rate
    return state._replace(
        sprocket_speed_left=(state.v_x - turn) / parameters.sprocket_radius,
        sprocket_speed_right=(state.v_x + turn) / parameters.sprocket_radius,
    )


def checked_patches(patches: object, allowed: s.Range = _PATCHES) -> tuple[int, int]:
    """Numbers of patches along and across a track. Raises ValueError."""
    is_sequence = isinstance(patches, Sequence) and not isinstance(patches, (str, Mapping))
    if not is_sequence or len(patches) != 2:  # type: ignore[arg-type]
        raise ValueError(f"patches = {patches!r}; must be two numbers: along, across a track")
    numbers: Any = patches
    along = checked_whole("patches along the track", numbers[0], allowed)
    return along, checked_whole("patches across the track", numbers[1], allowed)


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    patches = physics.make_patches(*checked_patches(options["patches"]))
    euler = checked_choice("integrator", options["integrator"], INTEGRATORS) == "euler"
    split = checked_choice("soil_at", options["soil_at"], SOIL_AT) == "tracks"
    kernel_options = Options(patches, drive == "torque", euler)
    return Prepared(advance_on_two_soils if split else advance, hold, kernel_options, rolling)


_READ = frozenset(s.PARAMETER_NAMES) - LATERAL_LAW - s.IN_SPACE
_SOIL = ("cohesion", "friction_angle", "shear_deformation_modulus")
PLANT = Plant(
    name="distributed",
    reads={"torque": _READ, "speed": _READ - s.OF_TORQUE_DRIVES},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={"patches": (10, 4), "integrator": "rosenbrock", "soil_at": "centre"},
    columns=2,
    threads_from=16,
    panel=("mass", "inertia", "friction", "longitudinal_resistance", *_SOIL),
    soil_map=("friction_angle", "cohesion", "longitudinal_resistance", "shear_deformation_modulus"),
)
