"""Sub-steps of the lumped plant, on a block of vehicles copied into a scratch array.

One quantity per row, one vehicle per lane. The row distance is a compile-time constant, `LANES`:
that is what lets the compiler vectorise the loops over lanes.
"""

from tracked_env.engine import columns as b
from tracked_env.physics import lumped_forces, vehicle
from tracked_env.physics import state as s
from tracked_env.physics.elementary import small_rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.rk4 import rk4_step
from tracked_env.plants.derived import REST

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
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
        left = max(abs(w[s.TORQUE_LEFT, i]), abs(w[DEMAND_LEFT, i])) * k.inverse_radius
        right = max(abs(w[s.TORQUE_RIGHT, i]), abs(w[DEMAND_RIGHT, i])) * k.inverse_radius
        safe = lumped_forces.safe_effort(motion, max(left, right), k.half_gauge, drive)
        binding += 0.0 if safe else 1.0
    return binding > 0.0


@formula
def _substep(accelerations, w, lanes, h, limited):
    """One RK4 sub-step of length h [s] of every lane of the scratch block."""
    for i in range(lanes):
        motion = vehicle.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k = _coefficients(w, DERIVED, i)
        if limited:
            limits = lumped_forces.traction_limits(motion, k.half_gauge, _drive(w, _LIMITS, i))
        else:
            limits = lumped_forces.TractionLimits(-OPEN_LIMIT, OPEN_LIMIT, -OPEN_LIMIT, OPEN_LIMIT)
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
            _substep(lumped_forces.sliding_accelerations, w, lanes, h, True)
        else:
            _substep(lumped_forces.sliding_accelerations, w, lanes, h, False)
    _come_to_rest(w, lanes)


@formula
def integrate_constrained(w, lanes, substeps, h):
    """The same where nothing slides sideways."""
    for _ in range(substeps):
        _substep(lumped_forces.constrained_accelerations, w, lanes, h, True)
    _come_to_rest(w, lanes)


@formula
def _settle(loads_of, accelerations, w, lanes):
    """Algebraic rows of the state of every lane: efforts, slips, accelerations."""
    for i in range(lanes):
        motion = vehicle.Motion(w[s.V_X, i], w[s.V_Y, i], w[s.YAW_RATE, i])
        k, drive = _coefficients(w, DERIVED, i), _drive(w, _LIMITS, i)
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
def settle_sliding(w, lanes):
    """Settle every lane."""
    _settle(lumped_forces.sliding_loads, lumped_forces.sliding_accelerations, w, lanes)


@formula
def settle_constrained(w, lanes):
    """The same with the lateral motion constrained."""
    _settle(lumped_forces.constrained_loads, lumped_forces.constrained_accelerations, w, lanes)
