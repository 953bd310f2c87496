"""Motion of one vehicle over one control step: the distributed plant.

The vector lanes are the patches of this vehicle, so vehicles are taken one by one.
"""

from tracked_env.engine import columns as b
from tracked_env.physics import lumped_forces, patch_dynamics
from tracked_env.physics import state as s
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.lumped_forces import Coefficients, DriveLimits, Motion
from tracked_env.physics.parameters import row_parameters
from tracked_env.physics.patch_dynamics import SPEED_DRIVEN, Belts, Pose
from tracked_env.plants.lumped import REST


@formula
def _derived(floats, i):
    """Coefficients and drive limits of vehicle i."""
    f, c, d = floats, b.COEFFICIENTS, b.DRIVE
    k = Coefficients(
        f[i, c], f[i, c + 1], f[i, c + 2], f[i, c + 3], f[i, c + 4],
        f[i, c + 5], f[i, c + 6], f[i, c + 7], f[i, c + 8],
    )  # fmt: skip
    return k, DriveLimits(f[i, d], f[i, d + 1], f[i, d + 2], f[i, d + 3])


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
def _rested(speed):
    """The speed, or 0 where it is too small to be a motion."""
    return speed if abs(speed) > REST else 0.0


@formula
def _write(floats, i, moved, torques, k):
    """State of vehicle i after the step, its algebraic rows included."""
    row = b.STATE
    motion, loads, rates = moved.motion, moved.loads, moved.rates
    floats[i, row + s.X], floats[i, row + s.Y] = moved.pose.x, moved.pose.y
    floats[i, row + s.YAW] = moved.pose.yaw
    floats[i, row + s.V_X] = _rested(motion.v_x)
    floats[i, row + s.V_Y] = _rested(motion.v_y)
    floats[i, row + s.YAW_RATE] = _rested(motion.yaw_rate)
    floats[i, row + s.TORQUE_LEFT], floats[i, row + s.TORQUE_RIGHT] = torques.left, torques.right
    left, right = lumped_forces.track_speeds(motion, k.half_gauge)
    floats[i, row + s.SLIP_LEFT] = soil.slip_ratio(moved.belts.left, left)
    floats[i, row + s.SLIP_RIGHT] = soil.slip_ratio(moved.belts.right, right)
    floats[i, row + s.SPROCKET_SPEED_LEFT] = moved.belts.left * k.inverse_radius
    floats[i, row + s.SPROCKET_SPEED_RIGHT] = moved.belts.right * k.inverse_radius
    floats[i, row + s.EFFORT_LEFT] = loads.effort_left
    floats[i, row + s.EFFORT_RIGHT] = loads.effort_right
    forward, lateral = lumped_forces.inertial_acceleration(motion, rates.v_x, rates.v_y)
    floats[i, row + s.ACCELERATION_X], floats[i, row + s.ACCELERATION_Y] = forward, lateral
    floats[i, row + s.YAW_ACCELERATION] = rates.yaw_rate


@formula
def move(floats, w, i, substeps, h, patches, by_torque):
    """Advance (substeps > 0) and settle vehicle i; its action is a torque or a sprocket speed."""
    p = row_parameters(floats, i, b.PARAMETERS)
    k, drive = _derived(floats, i)
    contact = patch_dynamics.contact_of(p, k, drive, patches)
    start = _state(floats, i, p.sprocket_radius)
    left, right = floats[i, b.PREVIOUS_ACTION], floats[i, b.PREVIOUS_ACTION + 1]
    if by_torque:
        compliance = p.sprocket_radius * p.sprocket_radius / p.sprocket_inertia
        largest = p.torque_limit
        torque = b.STATE + s.TORQUE_LEFT
        command = Belts(floats[i, torque], floats[i, torque + 1])
    else:
        compliance = SPEED_DRIVEN
        largest = p.sprocket_speed_limit * p.sprocket_radius
        command = start[2]
    demand = Belts(left * largest, right * largest) if substeps > 0 else command
    half_decay = floats[i, b.TORQUE_DECAY]
    moved, given = patch_dynamics.advance(
        w, start, command, demand, half_decay * half_decay, substeps, h,
        (k, drive, contact, compliance), patches, False,
    )  # fmt: skip
    if not by_torque:
        given = Belts(
            moved.loads.effort_left * p.sprocket_radius,
            moved.loads.effort_right * p.sprocket_radius,
        )
    _write(floats, i, moved, given, k)
