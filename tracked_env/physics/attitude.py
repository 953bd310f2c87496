"""Attitude of a body in space: unit quaternion, rotation matrix, and yaw, pitch, roll.

Equations (symbols in NOTATION.md; body axes to world axes):
    q' = q (0, W) / 2,   q(t + h) = q(t) exp(h W / 2)          W constant in body axes
    R  = rotation matrix of q;  a_world = R a_body
    R  = R_z(yaw) R_y(pitch) R_x(roll)                         yaw, then pitch, then roll
    R^T (0, 0, -g) = g (s_p, -c_p s_r, -c_p c_r)               gravity in body axes
Between calls the attitude is kept as three angles, so that a state is complete as it is written;
within a call it is a quaternion, which has no singular attitude. Near pitch = +-90 degrees, where
yaw and roll turn about one axis, the yaw keeps its last value and the roll takes up the rest.

Reference: [1] Diebel, "Representing Attitude" (2006).
"""

import math
from typing import NamedTuple

from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula

UPRIGHT_FLOOR = 1e-12  # [-] cosine of the pitch below which yaw and roll turn about one axis
SMALL_TURN = 1e-4  # [rad] below it sin(a) / a is its series


class Quaternion(NamedTuple):
    """Unit quaternion, body to world."""

    w: float  # [-]
    x: float  # [-]
    y: float  # [-]
    z: float  # [-]


class Rotation(NamedTuple):
    """Rotation matrix, body to world; columns are the body's axes x, y, z."""

    xx: float
    xy: float
    xz: float
    yx: float
    yy: float
    yz: float
    zx: float
    zy: float
    zz: float


@formula
def quaternion_of(yaw, pitch, roll):
    """Quaternion of the three angles [rad]."""
    c_yaw, s_yaw = rotation(0.5 * yaw)
    c_pitch, s_pitch = rotation(0.5 * pitch)
    c_roll, s_roll = rotation(0.5 * roll)
    return Quaternion(
        c_yaw * c_pitch * c_roll + s_yaw * s_pitch * s_roll,
        c_yaw * c_pitch * s_roll - s_yaw * s_pitch * c_roll,
        c_yaw * s_pitch * c_roll + s_yaw * c_pitch * s_roll,
        s_yaw * c_pitch * c_roll - c_yaw * s_pitch * s_roll,
    )


@formula
def matrix_of(q):
    """Rotation matrix of a unit quaternion."""
    w, x, y, z = q
    return Rotation(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@formula
def angles_of(q, last_yaw):
    """(yaw, pitch, roll) [rad]; yaw not wrapped, the one next to last_yaw."""
    r = matrix_of(q)
    level = math.sqrt(r.xx * r.xx + r.yx * r.yx)
    yaw = last_yaw
    if level > UPRIGHT_FLOOR:
        yaw = last_yaw + wrap_angle(math.atan2(r.yx, r.xx) - last_yaw)
    cosine, sine = rotation(yaw)
    pitch = math.atan2(-r.zx, level)
    roll = math.atan2(sine * r.xz - cosine * r.yz, cosine * r.yy - sine * r.xy)
    return yaw, pitch, roll


class Incline(NamedTuple):
    """Gravity in body axes, and what a motion in the vehicle's plane is on the map."""

    down_x: float  # [-] s_p, share of gravity along the body's x axis
    down_y: float  # [-] -c_p s_r, along its y axis
    press: float  # [-] c_p c_r, onto the vehicle's plane
    cos_pitch: float  # [-] c_p
    cos_roll: float  # [-] c_r
    sin_roll: float  # [-] s_r


LEVEL = Incline(0.0, 0.0, 1.0, 1.0, 1.0, 0.0)


@formula
def incline_of(pitch, roll):
    """Incline of the measured angles [rad]; LEVEL where one is missing (NaN)."""
    if (pitch == 0.0 and roll == 0.0) or not math.isfinite(pitch + roll):
        return LEVEL
    c_pitch, s_pitch = rotation(pitch)
    c_roll, s_roll = rotation(roll)
    return Incline(s_pitch, -c_pitch * s_roll, c_pitch * c_roll, c_pitch, c_roll, s_roll)


@formula
def on_map(forward, left, incline):
    """(along the heading, to the left of it) on the map, of a motion in the vehicle's plane."""
    cross = incline.down_x * incline.sin_roll
    return incline.cos_pitch * forward + cross * left, incline.cos_roll * left


@formula
def in_plane_above(ahead, left, incline):
    """(forward, left) in the vehicle's plane, of what lies below it on the map: `on_map`, inverted.

    A path that is given on the map and laid on a plane has these components, and so have all of
    its derivatives. Needs |pitch|, |roll| < 90 degrees.
    """
    aside = left / incline.cos_roll
    cross = incline.down_x * incline.sin_roll
    return (ahead - cross * aside) / incline.cos_pitch, aside


@formula
def heading_rate(incline, pitch_rate):
    """(a [-], b [rad/s]) with d yaw/dt = a W_z + b, from the rate of pitch W_y [rad/s].

    b is 0 where that is missing (NaN).
    """
    carried = incline.sin_roll * pitch_rate / incline.cos_pitch
    return incline.cos_roll / incline.cos_pitch, carried if math.isfinite(carried) else 0.0


@formula
def turned(q, x, y, z):
    """q after a rotation by the vector (x, y, z) [rad] in body axes, normalised."""
    angle2 = x * x + y * y + z * z
    half = 0.5 * math.sqrt(angle2)
    cosine, sine = rotation(half)
    ratio = 0.5 * sine / half if half >= SMALL_TURN else 0.5 - angle2 / 48.0
    x, y, z = ratio * x, ratio * y, ratio * z
    new_w = q.w * cosine - q.x * x - q.y * y - q.z * z
    new_x = q.w * x + q.x * cosine + q.y * z - q.z * y
    new_y = q.w * y - q.x * z + q.y * cosine + q.z * x
    new_z = q.w * z + q.x * y - q.y * x + q.z * cosine
    scale = 1.0 / math.sqrt(new_w * new_w + new_x * new_x + new_y * new_y + new_z * new_z)
    return Quaternion(scale * new_w, scale * new_x, scale * new_y, scale * new_z)


@formula
def in_body_plane(ahead, left, turn, pitch, roll):
    """A pose error in the plane of the vehicle: R^T (e_x, e_y, 0) and z_b . (0, 0, e_yaw).

    ahead, left [m]: the horizontal error along the heading and to the left of it, so that the yaw
    is in it once; turn [rad] about the vertical; pitch, roll: (cosine, sine). Numbers, or arrays.
    F (2025), 5.3, (49).
    """
    c_pitch, s_pitch = pitch
    c_roll, s_roll = roll
    return c_pitch * ahead, s_roll * s_pitch * ahead + c_roll * left, c_pitch * c_roll * turn
