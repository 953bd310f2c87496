"""The lumped plant: closed-form forces of each track, after Strawa et al. (2021).

Forces and equations of motion are in `physics.lumped`; the torques follow their demand by the
drive's lag. Option `lateral`: "sliding", or "constrained" to v_y = -d w at all times.

Vehicles are copied into a scratch array, `LANES` at a time, moved there and copied back. It has one
quantity per row, one vehicle per lane. The row distance is a compile-time constant: that is what
lets the compiler vectorise the loops over lanes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracked_env import arrays as b
from tracked_env.physics import lumped as physics
from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation, small_rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import Coefficients, DriveLimits
from tracked_env.plants import Plant, Prepared
from tracked_env.step import advance_blocks, hold_blocks
from tracked_env.validation import checked_choice

LANES = 64
WIDTH = 8  # lanes that the loops do at once; the rest of a block would go one by one
OPEN_LIMIT = 1e30  # [N] traction limit that does not bind
REST = 1e-12  # [m/s, rad/s] slower is rest: decaying velocities would end as slow denormals
LATERAL = ("sliding", "constrained")
RESISTANCE = b.COEFFICIENTS + Coefficients._fields.index("resistance")

INTEGRATED = s.TORQUE_RIGHT + 1  # rows of the state x .. torque_right
PLANAR = s.YAW_ACCELERATION + 1  # rows with those that follow from them
# Rows of the scratch block: those of the state, then
COSINE, SINE, DEMAND_LEFT, DEMAND_RIGHT, DECAY, DERIVED = range(PLANAR, PLANAR + 6)
_LIMITS = DERIVED + b.COEFFICIENT_COUNT  # drive limits; the coefficients start at row DERIVED
SCRATCH_ROWS = _LIMITS + b.DRIVE_COUNT
_TORQUE_LIMIT = b.PARAMETERS + s.PARAMETER_INDEX["torque_limit"]
_GAIN_LEFT = b.PARAMETERS + s.PARAMETER_INDEX["actuator_gain_left"]
_GAIN_RIGHT = b.PARAMETERS + s.PARAMETER_INDEX["actuator_gain_right"]


# --- what the tracked plants derive from their parameters ---------------------------------------
@formula
def derive(floats, i, substep, constrained):
    """Refresh what follows from the parameters of vehicle i; substep h [s]."""
    p = s.row_parameters(floats, i, b.PARAMETERS)
    k = physics.coefficients(p, constrained)
    drive = physics.drive_limits(p)
    for row in range(b.COEFFICIENT_COUNT):
        floats[i, b.COEFFICIENTS + row] = k[row]
    for row in range(b.DRIVE_COUNT):
        floats[i, b.DRIVE + row] = drive[row]
    floats[i, b.TORQUE_DECAY] = physics.torque_decay(0.5 * substep, p.drive_time_constant)


@formula
def derive_free(floats, i, substep):
    """The same where nothing constrains the lateral motion."""
    derive(floats, i, substep, False)


def _gathered(kind: Any, arguments: str, entry: str) -> Any:
    fields = {name: entry.format(row) for row, name in enumerate(kind._fields)}
    return s.gathering(kind, arguments, fields)


# (floats, i, first): those of vehicle i from column `first` on.
_row_coefficients = _gathered(Coefficients, "floats, i, first", "floats[i, first + {}]")
row_motion = _gathered(physics.Motion, "floats, i, first", "floats[i, first + {}]")
_row_limits = _gathered(DriveLimits, "floats, i, first", "floats[i, first + {}]")
# (w, first, lane): those of a lane from row `first` of the scratch block on.
_coefficients = _gathered(Coefficients, "w, first, lane", "w[first + {}, lane]")
_drive = _gathered(DriveLimits, "w, first, lane", "w[first + {}, lane]")
_motion = _gathered(physics.Motion, "w, first, lane", "w[first + {}, lane]")


@formula
def derived(floats, i):
    """Coefficients and drive limits of vehicle i."""
    return _row_coefficients(floats, i, b.COEFFICIENTS), _row_limits(floats, i, b.DRIVE)


# --- sub-steps of a scratch block ---------------------------------------------------------------
@formula
def _limits_bind(w, lanes):
    """True when some lane's drive could reach its traction limit in the coming sub-step."""
    binding = 0.0
    for i in range(lanes):
        motion = _motion(w, s.V_X, i)
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
        left = max(abs(w[s.TORQUE_LEFT, i]), abs(w[DEMAND_LEFT, i])) * k.inverse_radius
        right = max(abs(w[s.TORQUE_RIGHT, i]), abs(w[DEMAND_RIGHT, i])) * k.inverse_radius
        safe = physics.safe_effort(motion, max(left, right), k.half_gauge, drive)
        binding += 0.0 if safe else 1.0
    return binding > 0.0


@formula
def _substep(accelerations, w, lanes, h, limited):
    """One RK4 sub-step of length h [s] of every lane of the scratch block."""
    for i in range(lanes):
        motion = _motion(w, s.V_X, i)
        k = _coefficients(w, DERIVED, i)
        if limited:
            limits = physics.traction_limits(motion, k.half_gauge, _drive(w, _LIMITS, i))
        else:
            limits = physics.TractionLimits(-OPEN_LIMIT, OPEN_LIMIT, -OPEN_LIMIT, OPEN_LIMIT)
        decay = w[DECAY, i]
        to_left, to_right = w[DEMAND_LEFT, i], w[DEMAND_RIGHT, i]
        start = (w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i])
        middle = (to_left + decay * (start[0] - to_left), to_right + decay * (start[1] - to_right))
        end = (to_left + decay * (middle[0] - to_left), to_right + decay * (middle[1] - to_right))
        moved, travel_x, travel_y, turn = physics.rk4_step(
            accelerations, motion, start, middle, end, k, limits, h
        )
        cosine, sine = w[COSINE, i], w[SINE, i]
        w[s.X, i] += cosine * travel_x - sine * travel_y
        w[s.Y, i] += sine * travel_x + cosine * travel_y
        w[s.YAW, i] += turn
        turn_cosine, turn_sine = small_rotation(turn)
        w[COSINE, i] = cosine * turn_cosine - sine * turn_sine
        w[SINE, i] = sine * turn_cosine + cosine * turn_sine
        w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i] = moved.v_x, moved.v_y, moved.yaw_rate
        w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i] = end[0], end[1]


@formula
def _settle(loads_of, accelerations, w, lanes):
    """Come to rest, and the algebraic rows of every lane: efforts, slips, accelerations."""
    for row in range(s.V_X, s.YAW_RATE + 1):
        for lane in range(lanes):
            w[row, lane] = w[row, lane] if abs(w[row, lane]) > REST else 0.0
    for i in range(lanes):
        motion = _motion(w, s.V_X, i)
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
        limits = physics.traction_limits(motion, k.half_gauge, drive)
        left, right = w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i]
        loads = loads_of(motion, left, right, k, limits)
        rates = accelerations(motion, left, right, k, limits)
        forward, lateral = physics.inertial_acceleration(motion, rates[0], rates[1])
        speed_left, speed_right = physics.track_speeds(motion, k.half_gauge)
        slip_left, belt_left = physics.track_slip(loads.effort_left, speed_left, drive)
        slip_right, belt_right = physics.track_slip(loads.effort_right, speed_right, drive)
        w[s.SLIP_LEFT, i], w[s.SLIP_RIGHT, i] = slip_left, slip_right
        w[s.SPROCKET_SPEED_LEFT, i] = belt_left * k.inverse_radius
        w[s.SPROCKET_SPEED_RIGHT, i] = belt_right * k.inverse_radius
        w[s.EFFORT_LEFT, i], w[s.EFFORT_RIGHT, i] = loads.effort_left, loads.effort_right
        w[s.ACCELERATION_X, i], w[s.ACCELERATION_Y, i] = forward, lateral
        w[s.YAW_ACCELERATION, i] = rates[2]


# --- from the batch to the scratch block and back -----------------------------------------------
@formula
def _demands(floats, i, commands):
    """Torques [N m] of vehicle i, left and right: of its action, or commands (N, 2)."""
    if commands.shape[1] == 0:
        limit = floats[i, _TORQUE_LIMIT]
        return limit * floats[i, b.ACTION], limit * floats[i, b.ACTION + 1]
    return commands[i, 0], commands[i, 1]


@formula
def _load(floats, w, block, commands):
    """Copy the vehicles of the block into the scratch array.

    Returns the number of lanes with copies of the last one up to a multiple of WIDTH; 1 stays 1.
    """
    lanes = block.lanes
    for lane in range(lanes):
        i = block.vehicles[block.first + lane]
        for row in range(INTEGRATED):
            w[row, lane] = floats[i, b.STATE + row]
        for row in range(b.COEFFICIENT_COUNT + b.DRIVE_COUNT):
            w[DERIVED + row, lane] = floats[i, b.COEFFICIENTS + row]
        left, right = _demands(floats, i, commands)
        w[DEMAND_LEFT, lane] = floats[i, _GAIN_LEFT] * left
        w[DEMAND_RIGHT, lane] = floats[i, _GAIN_RIGHT] * right
        w[DECAY, lane] = floats[i, b.TORQUE_DECAY]
    for lane in range(lanes):
        w[COSINE, lane], w[SINE, lane] = rotation(w[s.YAW, lane])
    if lanes == 1:
        return 1
    filled = -(-lanes // WIDTH) * WIDTH
    for row in range(SCRATCH_ROWS):
        for lane in range(lanes, filled):
            w[row, lane] = w[row, lanes - 1]
    return filled


@formula
def _store(floats, w, block):
    """Copy the states of the block back."""
    for lane in range(block.lanes):
        i = block.vehicles[block.first + lane]
        for row in range(PLANAR):
            floats[i, b.STATE + row] = w[row, lane]


@formula
def _move_sliding(batch, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle one block of vehicles in the scratch array w.

    options: (commands, ()), as `plants.Prepared` says.
    """
    lanes = _load(batch.floats, w, block, options[0])
    for _ in range(pace.substeps):
        if _limits_bind(w, lanes):
            _substep(physics.sliding_accelerations, w, lanes, pace.h, True)
        else:
            _substep(physics.sliding_accelerations, w, lanes, pace.h, False)
    _settle(physics.sliding_loads, physics.sliding_accelerations, w, lanes)
    _store(batch.floats, w, block)


@formula
def _move_constrained(batch, w, block, pace, options):
    lanes = _load(batch.floats, w, block, options[0])
    for _ in range(pace.substeps):
        _substep(physics.constrained_accelerations, w, lanes, pace.h, True)
    _settle(physics.constrained_loads, physics.constrained_accelerations, w, lanes)
    _store(batch.floats, w, block)


@formula
def _derive_constrained(floats, i, substep):
    derive(floats, i, substep, True)


@loop
def advance_sliding(batch, rows, clock, options):
    """Kernel of the control step, see `tracked_env.step`."""
    w = np.empty((SCRATCH_ROWS, LANES))
    return advance_blocks(derive_free, _move_sliding, LANES, w, batch, rows, clock, options)


@loop
def advance_constrained(batch, rows, clock, options):
    """The same with the lateral motion constrained."""
    w, derive_it = np.empty((SCRATCH_ROWS, LANES)), _derive_constrained
    return advance_blocks(derive_it, _move_constrained, LANES, w, batch, rows, clock, options)


@loop
def hold_sliding(batch, vehicles, pace, options):
    """Kernel of the plant alone."""
    w = np.empty((SCRATCH_ROWS, LANES))
    hold_blocks(derive_free, _move_sliding, LANES, w, batch, vehicles, pace, options)


@loop
def hold_constrained(batch, vehicles, pace, options):
    """The same with the lateral motion constrained."""
    w = np.empty((SCRATCH_ROWS, LANES))
    hold_blocks(_derive_constrained, _move_constrained, LANES, w, batch, vehicles, pace, options)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    motion = row_motion(floats, i, b.STATE + s.V_X)
    k, drive = derived(floats, i)
    limits = physics.traction_limits(motion, k.half_gauge, drive)
    left, right = floats[i, b.STATE + s.TORQUE_LEFT], floats[i, b.STATE + s.TORQUE_RIGHT]
    loads = physics.sliding_loads(motion, left, right, k, limits)
    return loads.resistance_left, loads.resistance_right


def _start_constrained(parameters: s.PlantParameters, state: s.VehicleState) -> s.VehicleState:
    """The lateral velocity is what the yaw rate makes it."""
    return state._replace(v_y=-parameters.icr_forward * state.yaw_rate)


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    if checked_choice("lateral model", options["lateral"], LATERAL) == "constrained":
        start, words = _start_constrained, " with constrained tracks"
        return Prepared(advance_constrained, hold_constrained, start=start, variant=words)
    emerging = frozenset({"icr_forward"})  # the instantaneous centre of rotation follows
    words, kernels = " with sliding tracks", (advance_sliding, hold_sliding)
    return Prepared(*kernels, unread=emerging, variant=words)


_SOIL = ("lateral_resistance", "longitudinal_resistance", "cohesion", "friction_angle")
PLANT = Plant(
    name="lumped",
    reads={"torque": frozenset(s.PARAMETER_NAMES) - {"sprocket_inertia"} - s.IN_SPACE},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={"lateral": "sliding"},
    lanes=LANES,
    panel=("mass", "inertia", *_SOIL, "shear_deformation_modulus"),
    soil_map=(*_SOIL, "shear_deformation_modulus"),
)
