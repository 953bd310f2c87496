"""The lumped plant: closed-form forces of each track, after Strawa et al. (2021).

Forces and equations of motion are in `physics.lumped_forces`; the torques follow their demand by
the drive's lag. Option `lateral`: "sliding", or "constrained" to v_y = -d w at all times.

The sub-step loop runs over blocks of `LANES` vehicles copied into a scratch array whose row
distance is a compile-time constant: that is what lets the compiler vectorise it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tracked_env.engine import columns as b
from tracked_env.engine.columns import Batch
from tracked_env.engine.kernels import advance_blocks, hold_blocks
from tracked_env.physics import lumped_forces, vehicle
from tracked_env.physics import state as s
from tracked_env.physics.elementary import rotation, small_rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_NAMES, PlantParameters
from tracked_env.physics.rk4 import rk4_step
from tracked_env.physics.state import VehicleState
from tracked_env.plants.base import Plant, Prepared
from tracked_env.plants.derived import REST, derive, derive_free, derived
from tracked_env.validation import checked_choice

LANES = 64
WIDTH = 8  # lanes that the loops do at once; the rest of a block would go one by one
LATERAL = ("sliding", "constrained")
OPEN_LIMIT = 1e30  # [N] traction limit that does not bind
_TORQUE_LIMIT = b.PARAMETERS + PARAMETER_INDEX["torque_limit"]

INTEGRATED = s.TORQUE_RIGHT + 1  # rows of the state x .. torque_right
PLANAR = s.YAW_ACCELERATION + 1  # rows with those that follow from them
# Rows of the scratch block: those of the state, then
_COSINE, _SINE, _DEMAND_LEFT, _DEMAND_RIGHT, _DECAY, _K = range(PLANAR, PLANAR + 6)
_D = _K + b.COEFFICIENT_COUNT  # drive limits; the coefficients start at row _K
SCRATCH_ROWS = _D + b.DRIVE_COUNT


@formula
def _coefficients(w, row, i):
    """Coefficients of lane i, from row `row` of the scratch block on."""
    return vehicle.Coefficients(
        w[row, i], w[row + 1, i], w[row + 2, i], w[row + 3, i], w[row + 4, i],
        w[row + 5, i], w[row + 6, i], w[row + 7, i], w[row + 8, i],
    )  # fmt: skip


@formula
def _drive(w, row, i):
    """DriveLimits of lane i, from row `row` of the scratch block on."""
    return vehicle.DriveLimits(w[row, i], w[row + 1, i], w[row + 2, i], w[row + 3, i])


@formula
def _limits_bind(w, lanes):
    """True when some lane's drive could reach its traction limit in the coming sub-step."""
    binding = 0.0
    for i in range(lanes):
        motion = vehicle.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k, drive = _coefficients(w, _K, i), _drive(w, _D, i)
        left = max(abs(w[s.TORQUE_LEFT, i]), abs(w[_DEMAND_LEFT, i])) * k.inverse_radius
        right = max(abs(w[s.TORQUE_RIGHT, i]), abs(w[_DEMAND_RIGHT, i])) * k.inverse_radius
        safe = lumped_forces.safe_effort(motion, max(left, right), k.half_gauge, drive)
        binding += 0.0 if safe else 1.0
    return binding > 0.0


@formula
def _substep(accelerations, w, lanes, h, limited):
    """One RK4 sub-step of length h [s] of every lane of the scratch block."""
    for i in range(lanes):
        motion = vehicle.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k = _coefficients(w, _K, i)
        if limited:
            limits = lumped_forces.traction_limits(motion, k.half_gauge, _drive(w, _D, i))
        else:
            limits = lumped_forces.TractionLimits(-OPEN_LIMIT, OPEN_LIMIT, -OPEN_LIMIT, OPEN_LIMIT)
        decay = w[_DECAY, i]
        demand_left, demand_right = w[_DEMAND_LEFT, i], w[_DEMAND_RIGHT, i]
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
        cosine, sine = w[_COSINE, i], w[_SINE, i]
        w[s.X, i] += cosine * travel_x - sine * travel_y
        w[s.Y, i] += sine * travel_x + cosine * travel_y
        w[s.YAW, i] += turn
        turn_cosine, turn_sine = small_rotation(turn)
        w[_COSINE, i] = cosine * turn_cosine - sine * turn_sine
        w[_SINE, i] = sine * turn_cosine + cosine * turn_sine
        w[s.V_X, i] = moved.v_x
        w[s.V_Y, i] = moved.v_y
        w[s.YAW_RATE, i] = moved.yaw_rate
        w[s.TORQUE_LEFT, i] = end[0]
        w[s.TORQUE_RIGHT, i] = end[1]


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
            w[_K + row, lane] = floats[i, b.COEFFICIENTS + row]
        w[_DEMAND_LEFT, lane], w[_DEMAND_RIGHT, lane] = demand(floats, i, options)
        w[_DECAY, lane] = floats[i, b.TORQUE_DECAY]
    for lane in range(block.lanes):
        w[_COSINE, lane], w[_SINE, lane] = rotation(w[s.YAW, lane])


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


@formula
def _integrate(w, lanes, substeps, h, constrained):
    """Integrate the scratch block over one control step."""
    for _ in range(substeps):
        limited = _limits_bind(w, lanes)
        if constrained:
            _substep(lumped_forces.constrained_accelerations, w, lanes, h, True)
        elif limited:
            _substep(lumped_forces.sliding_accelerations, w, lanes, h, True)
        else:
            _substep(lumped_forces.sliding_accelerations, w, lanes, h, False)
    for row in range(s.V_X, s.YAW_RATE + 1):
        for lane in range(lanes):
            w[row, lane] = w[row, lane] if abs(w[row, lane]) > REST else 0.0


@formula
def _settle(loads_of, accelerations, w, lanes):
    """Algebraic rows of the state of every lane: efforts, slips, accelerations."""
    for i in range(lanes):
        motion = vehicle.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k, drive = _coefficients(w, _K, i), _drive(w, _D, i)
        limits = lumped_forces.traction_limits(motion, k.half_gauge, drive)
        left, right = w[s.TORQUE_LEFT, i], w[s.TORQUE_RIGHT, i]
        loads = loads_of(motion, left, right, k, limits)
        rates = accelerations(motion, left, right, k, limits)
        forward, lateral = vehicle.inertial_acceleration(motion, rates[0], rates[1])
        speed_left, speed_right = vehicle.track_speeds(motion, k.half_gauge)
        slip_left, belt_left = lumped_forces.track_slip(loads.effort_left, speed_left, drive)
        slip_right, belt_right = lumped_forces.track_slip(loads.effort_right, speed_right, drive)
        w[s.SLIP_LEFT, i], w[s.SLIP_RIGHT, i] = slip_left, slip_right
        w[s.SPROCKET_SPEED_LEFT, i] = belt_left * k.inverse_radius
        w[s.SPROCKET_SPEED_RIGHT, i] = belt_right * k.inverse_radius
        w[s.EFFORT_LEFT, i], w[s.EFFORT_RIGHT, i] = loads.effort_left, loads.effort_right
        w[s.ACCELERATION_X, i], w[s.ACCELERATION_Y, i] = forward, lateral
        w[s.YAW_ACCELERATION, i] = rates[2]


@formula
def _move(demand, constrained, floats, w, block, pace, options):
    """Advance (pace.substeps > 0) and settle one block of vehicles in the scratch array w."""
    _load(demand, floats, w, block, options)
    lanes = _filled(w, block.lanes)
    _integrate(w, lanes, pace.substeps, pace.h, constrained)
    if constrained:
        _settle(lumped_forces.constrained_loads, lumped_forces.constrained_accelerations, w, lanes)
    else:
        _settle(lumped_forces.sliding_loads, lumped_forces.sliding_accelerations, w, lanes)
    _store(floats, w, block)


@formula
def _move_sliding(batch, w, block, pace, options):
    """As `advance_blocks` takes it."""
    _move(_asked, False, batch.floats, w, block, pace, options)


@formula
def _move_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_asked, True, batch.floats, w, block, pace, options)


@formula
def _hold_sliding(batch, w, block, pace, options):
    """As `hold_blocks` takes it."""
    _move(_held, False, batch.floats, w, block, pace, options)


@formula
def _hold_constrained(batch, w, block, pace, options):
    """The same with the lateral motion constrained."""
    _move(_held, True, batch.floats, w, block, pace, options)


@formula
def _derive_constrained(floats, i, substep):
    """Refresh what follows from the parameters of vehicle i where v_y = -d w."""
    derive(floats, i, substep, True)


@loop
def advance_sliding(
    floats, counters, profile, events, noise, history, chosen, actions, observations, *rest
):
    """Kernel of the control step, see `engine.kernels`."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
    return advance_blocks(derive_free, _move_sliding, LANES, scratch, batch, given, rest)


@loop
def advance_constrained(
    floats, counters, profile, events, noise, history, chosen, actions, observations, *rest
):
    """The same with the lateral motion constrained."""
    scratch = np.empty((SCRATCH_ROWS, LANES))
    batch = Batch(floats, counters, profile, events, noise, history)
    given = (chosen, actions, observations)
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
    motion = vehicle.Motion(
        floats[i, state + s.V_X], floats[i, state + s.V_Y], floats[i, state + s.YAW_RATE]
    )
    k, drive = derived(floats, i)
    limits = lumped_forces.traction_limits(motion, k.half_gauge, drive)
    left, right = floats[i, state + s.TORQUE_LEFT], floats[i, state + s.TORQUE_RIGHT]
    loads = lumped_forces.sliding_loads(motion, left, right, k, limits)
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
    reads={"torque": frozenset(PARAMETER_NAMES) - {"sprocket_inertia"}},
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
