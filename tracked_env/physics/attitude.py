"""Attitude of a body in space: unit quaternion, rotation matrix, and yaw, pitch, roll.

Equations (symbols in NOTATION.md; body axes to world axes):
    q' = q (0, W) / 2,   q(t + h) = q(t) exp(h W / 2)          W constant in body axes
    R  = rotation matrix of q;  a_world = R a_body
    R  = R_z(yaw) R_y(pitch) R_x(roll)                         yaw, then pitch, then roll
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
