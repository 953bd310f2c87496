"""The lumped plant: closed-form forces of each track, after Strawa et al. (2021).

Forces and equations of motion are in `physics.lumped_forces`; the torques follow their demand by
the drive's lag. Option `lateral`: "sliding", or "constrained" to v_y = -d w at all times.

Vehicles are copied into a scratch array, `LANES` at a time, moved there (`lumped_block`), and
copied back.

What the tracked plants derive from their parameters, and the columns that hold it.

Sub-steps of the lumped plant, on a block of vehicles copied into a scratch array.

One quantity per row, one vehicle per lane. The row distance is a compile-time constant, `LANES`:
that is what lets the compiler vectorise the loops over lanes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracked_env import arrays as b
from tracked_env.arrays import Batch
from tracked_env.physics import lumped
from tracked_env.physics import parameters as s
from tracked_env.physics.elementary import rotation, small_rotation
from tracked_env.physics.jit import formula, loop, template
from tracked_env.physics.lumped import Coefficients, DriveLimits, rk4_step
from tracked_env.physics.parameters import (
    IN_SPACE,
    PARAMETER_INDEX,
    PARAMETER_NAMES,
    PlantParameters,
    VehicleState,
    row_parameters,
)
from tracked_env.plants.base import Plant, Prepared
from tracked_env.step import advance_blocks, hold_blocks
from tracked_env.validation import checked_choice

RESISTANCE = b.COEFFICIENTS + Coefficients._fields.index("resistance")
REST = 1e-12  # [m/s, rad/s] slower is rest: decaying velocities would end as slow denormals


@formula
def derive(floats, i, substep, constrained):
    """Refresh what follows from the parameters of vehicle i; substep h [s]."""
    p = row_parameters(floats, i, b.PARAMETERS)
    k = lumped.coefficients(p, constrained)
    drive = lumped.drive_limits(p)
    for row in range(b.COEFFICIENT_COUNT):
        floats[i, b.COEFFICIENTS + row] = k[row]
    for row in range(b.DRIVE_COUNT):
        floats[i, b.DRIVE + row] = drive[row]
    floats[i, b.TORQUE_DECAY] = lumped.torque_decay(0.5 * substep, p.drive_time_constant)


@formula
def derive_free(floats, i, substep):
    """The same where nothing constrains the lateral motion."""
    derive(floats, i, substep, False)


@formula
def derived(floats, i):
    """Coefficients and drive limits of vehicle i."""
    f, c, d = floats, b.COEFFICIENTS, b.DRIVE
    k = Coefficients(
        f[i, c], f[i, c + 1], f[i, c + 2], f[i, c + 3], f[i, c + 4],
        f[i, c + 5], f[i, c + 6], f[i, c + 7], f[i, c + 8],
    )  # fmt: skip
    return k, DriveLimits(f[i, d], f[i, d + 1], f[i, d + 2], f[i, d + 3])


LANES = 64
OPEN_LIMIT = 1e30  # [N] traction limit that does not bind

INTEGRATED = s.TORQUE_RIGHT + 1  # rows of the state x .. torque_right
PLANAR = s.YAW_ACCELERATION + 1  # rows with those that follow from them
# Rows of the scratch block: those of the state, then
COSINE, SINE, DEMAND_LEFT, DEMAND_RIGHT, DECAY, DERIVED = range(PLANAR, PLANAR + 6)
_LIMITS = DERIVED + b.COEFFICIENT_COUNT  # drive limits; the coefficients start at row DERIVED
SCRATCH_ROWS = _LIMITS + b.DRIVE_COUNT


@formula
def _coefficients(w, row, i):
    """Coefficients of lane i, from row `row` of the scratch block on."""
    return lumped.Coefficients(
        w[row, i], w[row + 1, i], w[row + 2, i], w[row + 3, i], w[row + 4, i],
        w[row + 5, i], w[row + 6, i], w[row + 7, i], w[row + 8, i],
    )  # fmt: skip


@formula
def _drive(w, row, i):
    """DriveLimits of lane i, from row `row` of the scratch block on."""
    return lumped.DriveLimits(w[row, i], w[row + 1, i], w[row + 2, i], w[row + 3, i])


@formula
def _limits_bind(w, lanes):
    """True when some lane's drive could reach its traction limit in the coming sub-step."""
    binding = 0.0
    for i in range(lanes):
        motion = lumped.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
        left = max(abs(w[s.TORQUE_LEFT, i]), abs(w[DEMAND_LEFT, i])) * k.inverse_radius
        right = max(abs(w[s.TORQUE_RIGHT, i]), abs(w[DEMAND_RIGHT, i])) * k.inverse_radius
        safe = lumped.safe_effort(motion, max(left, right), k.half_gauge, drive)
        binding += 0.0 if safe else 1.0
    return binding > 0.0


@formula
def _substep(accelerations, w, lanes, h, limited):
    """One RK4 sub-step of length h [s] of every lane of the scratch block."""
    for i in range(lanes):
        motion = lumped.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k = _coefficients(w, DERIVED, i)
        if limited:
            limits = lumped.traction_limits(motion, k.half_gauge, _drive(w, _LIMITS, i))
        else:
            limits = lumped.TractionLimits(-OPEN_LIMIT, OPEN_LIMIT, -OPEN_LIMIT, OPEN_LIMIT)
        decay = w[DECAY, i]
        demand_left, demand_right = w[DEMAND_LEFT, i], w[DEMAND_RIGHT, i]
        start = (w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i])
        middle = (
            demand_left + decay * (start[0] - demand_left),
            demand_right + decay * (start[1] - demand_right),
        )
        end = (
            demand_left + decay * (middle[0] - demand_left),
            demand_right + decay * (middle[1] - demand_right),
        )
        moved, travel_x, travel_y, turn = rk4_step(
            accelerations, motion, start, middle, end, k, limits, h
        )
        cosine, sine = w[COSINE, i], w[SINE, i]
        w[s.X, i] += cosine * travel_x - sine * travel_y
        w[s.Y, i] += sine * travel_x + cosine * travel_y
        w[s.YAW, i] += turn
        turn_cosine, turn_sine = small_rotation(turn)
        w[COSINE, i] = cosine * turn_cosine - sine * turn_sine
        w[SINE, i] = sine * turn_cosine + cosine * turn_sine
        w[s.V_X, i] = moved.v_x
        w[s.V_Y, i] = moved.v_y
        w[s.YAW_RATE, i] = moved.yaw_rate
        w[s.TORQUE_LEFT, i] = end[0]
        w[s.TORQUE_RIGHT, i] = end[1]


@formula
def _come_to_rest(w, lanes):
    """Let velocities below REST be zero."""
    for row in range(s.V_X, s.YAW_RATE + 1):
        for lane in range(lanes):
            w[row, lane] = w[row, lane] if abs(w[row, lane]) > REST else 0.0


@formula
def integrate_sliding(w, lanes, substeps, h):
    """Integrate the scratch block over one control step."""
    for _ in range(substeps):
        if _limits_bind(w, lanes):
            _substep(lumped.sliding_accelerations, w, lanes, h, True)
        else:
            _substep(lumped.sliding_accelerations, w, lanes, h, False)
    _come_to_rest(w, lanes)


@formula
def integrate_constrained(w, lanes, substeps, h):
    """The same where nothing slides sideways."""
    for _ in range(substeps):
        _substep(lumped.constrained_accelerations, w, lanes, h, True)
    _come_to_rest(w, lanes)


@formula
def _settle(loads_of, accelerations, w, lanes):
    """Algebraic rows of the state of every lane: efforts, slips, accelerations."""
    for i in range(lanes):
        motion = lumped.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
        limits = lumped.traction_limits(motion, k.half_gauge, drive)
        left, right = w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i]
        loads = loads_of(motion, left, right, k, limits)
        rates = accelerations(motion, left, right, k, limits)
        forward, lateral = lumped.inertial_acceleration(motion, rates[0], rates[1])
        speed_left, speed_right = lumped.track_speeds(motion, k.half_gauge)
        slip_left, belt_left = lumped.track_slip(loads.effort_left, speed_left, drive)
        slip_right, belt_right = lumped.track_slip(loads.effort_right, speed_right, drive)
        w[s.SLIP_LEFT, i], w[s.SLIP_RIGHT, i] = slip_left, slip_right
        w[s.SPROCKET_SPEED_LEFT, i] = belt_left * k.inverse_radius
        w[s.SPROCKET_SPEED_RIGHT, i] = belt_right * k.inverse_radius
        w[s.EFFORT_LEFT, i], w[s.EFFORT_RIGHT, i] = loads.effort_left, loads.effort_right
        w[s.ACCELERATION_X, i], w[s.ACCELERATION_Y, i] = forward, lateral
        w[s.YAW_ACCELERATION, i] = rates[2]


@formula
def settle_sliding(w, lanes):
    """Settle every lane."""
    _settle(lumped.sliding_loads, lumped.sliding_accelerations, w, lanes)


@formula
def settle_constrained(w, lanes):
    """The same with the lateral motion constrained."""
    _settle(lumped.constrained_loads, lumped.constrained_accelerations, w, lanes)


WIDTH = 8  # lanes that the loops do at once; the rest of a block would go one by one
LATERAL = ("sliding", "constrained")
_TORQUE_LIMIT = b.PARAMETERS + PARAMETER_INDEX["torque_limit"]
_GAIN_LEFT = b.PARAMETERS + PARAMETER_INDEX["actuator_gain_left"]
_GAIN_RIGHT = b.PARAMETERS + PARAMETER_INDEX["actuator_gain_right"]


@formula
def _asked(floats, i, options):
    """Torques [N m] that the action of vehicle i asks for, left and right."""
    limit = floats[i, _TORQUE_LIMIT]
    return limit * floats[i, b.ACTION], limit * floats[i, b.ACTION + 1]


@formula
def _held(floats, i, options):
    """Torques [N m] that are given for vehicle i, left and right: options[0] (N, 2)."""
    return options[0][i, 0], options[0][i, 1]


@formula
def _load(demand, floats, w, block, options):
    """Copy the vehicles of the block into the scratch array; demand: `_asked` or `_held`."""
    for lane in range(block.lanes):
        i = block.chosen[block.first + lane]
        for row in range(INTEGRATED):
            w[row, lane] = floats[i, b.STATE + row]
        for row in range(b.COEFFICIENT_COUNT + b.DRIVE_COUNT):
            w[DERIVED + row, lane] = floats[i, b.COEFFICIENTS + row]
        left, right = demand(floats, i, options)
        w[DEMAND_LEFT, lane] = floats[i, _GAIN_LEFT] * left
        w[DEMAND_RIGHT, lane] = floats[i, _GAIN_RIGHT] * right
        w[DECAY, lane] = floats[i, b.TORQUE_DECAY]
    for lane in range(block.lanes):
        w[COSINE, lane], w[SINE, lane] = rotation(w[s.YAW, lane])


@formula
def _filled(w, lanes):
    """Lanes of the block with copies of the last one up to a multiple of WIDTH; 1 stays 1."""
    if lanes == 1:
        return 1
    filled = -(-lanes // WIDTH) * WIDTH
    for row in range(SCRATCH_ROWS):
        for lane in range(lanes, filled):
            w[row, lane] = w[row, lanes - 1]
    return filled


@formula
def _store(floats, w, block):
    """Copy the state of the scratch block back."""
    for lane in range(block.lanes):
        i = block.chosen[block.first + lane]
        for row in range(PLANAR):
            floats[i, b.STATE + row] = w[row, lane]


@template
def _move(demand, integrate, settle, floats, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle one block of vehicles in the scratch array w.

    integrate, settle: of one lateral model, so that a kernel does not compile the other as well.
    """
    _load(demand, floats, w, block, options)
    lanes = _filled(w, block.lanes)
    integrate(w, lanes, pace.substeps, pace.h)
    settle(w, lanes)
    _store(floats, w, block)


@formula
def _move_sliding(batch, w, block, pace, options):
    """As `advance_blocks` takes it."""
    _move(_asked, integrate_sliding, settle_sliding, batch.floats, w, block, pace, options)


@formula
def _move_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_asked, integrate_constrained, settle_constrained, batch.floats, w, block, pace, options)


@formula
def _hold_sliding(batch, w, block, pace, options):
    """As `hold_blocks` takes it."""
    _move(_held, integrate_sliding, settle_sliding, batch.floats, w, block, pace, options)


@formula
def _hold_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_held, integrate_constrained, settle_constrained, batch.floats, w, block, pace, options)


@formula
def _derive_constrained(floats, i, substep):
    """Refresh what follows from the parameters of vehicle i where v_y = -d w."""
    derive(floats, i, substep, True)


@loop
def advance_sliding(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
):  # fmt: skip
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit)
    return advance_blocks(derive_free, _move_sliding, LANES, scratch, batch, given, rest)


@loop
def advance_constrained(
    floats, counters, profile, events, noise, history, chosen, actions, observations,
    start, stop, moving, substeps, substep, error_limit,
):  # fmt: skip
    """The same with the lateral motion constrained."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    rest = (start, stop, moving, substeps, substep, error_limit)
    return advance_blocks(
        _derive_constrained, _move_constrained, LANES, scratch, batch, given, rest
    )


@loop
def hold_sliding(*call):
    """Kernel of the plant alone."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    return hold_blocks(derive_free, _hold_sliding, LANES, scratch, call)


@loop
def hold_constrained(*call):
    """The same with the lateral motion constrained."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    return hold_blocks(_derive_constrained, _hold_constrained, LANES, scratch, call)


@loop
def motion_resistances(floats, i):
    """Motion resistance [N] of the left and the right track of vehicle i."""
    state = b.STATE
    motion = lumped.Motion(
        floats[i, state + s.V_X], floats[i, state + s.V_Y], floats[i, state + s.YAW_RATE]
    )
    k, drive = derived(floats, i)
    limits = lumped.traction_limits(motion, k.half_gauge, drive)
    left, right = floats[i, state + s.TORQUE_LEFT], floats[i, state + s.TORQUE_RIGHT]
    loads = lumped.sliding_loads(motion, left, right, k, limits)
    return loads.resistance_left, loads.resistance_right


def _start_constrained(parameters: PlantParameters, state: VehicleState) -> VehicleState:
    """The lateral velocity is what the yaw rate makes it."""
    return state._replace(v_y=-parameters.icr_forward * state.yaw_rate)


def _prepare(drive: str, options: Mapping[str, Any]) -> Prepared:
    if checked_choice("lateral model", options["lateral"], LATERAL) == "constrained":
        return Prepared(
            advance_constrained, hold_constrained, (), _start_constrained,
            variant=" with constrained tracks",
        )  # fmt: skip
    emerging = frozenset({"icr_forward"})  # the instantaneous centre of rotation follows
    return Prepared(advance_sliding, hold_sliding, unread=emerging, variant=" with sliding tracks")


LUMPED = Plant(
    name="lumped",
    reads={"torque": frozenset(PARAMETER_NAMES) - {"sprocket_inertia"} - IN_SPACE},
    prepare=_prepare,
    motion_resistances=motion_resistances,
    options={"lateral": "sliding"},
    lanes=LANES,
    threads_from=512,
    panel=(
        "mass", "inertia", "lateral_resistance", "longitudinal_resistance", "cohesion",
        "friction_angle", "shear_deformation_modulus",
    ),
    soil_map=(
        "lateral_resistance", "longitudinal_resistance", "cohesion", "friction_angle",
        "shear_deformation_modulus",
    ),
)  # fmt: skip
