"""From a row of the batch to a moving body and back: the state of the plant on terrain.

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

from tracked_env.engine import columns as b
from tracked_env.physics import state as s
from tracked_env.physics import terramechanics as soil
from tracked_env.physics import vehicle
from tracked_env.physics.attitude import angles_of, matrix_of, quaternion_of
from tracked_env.physics.ground_contact import Twist
from tracked_env.physics.jit import formula
from tracked_env.physics.patch_dynamics import Belts
from tracked_env.physics.rigid_body import at_point
from tracked_env.physics.terrain_motion import Pose3
from tracked_env.terrain.drawn_relief import RELIEF_COLUMNS

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
    over_ground = vehicle.Motion(twist.x - height * twist.pitch, twist.y, twist.yaw)
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
