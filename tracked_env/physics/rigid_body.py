"""A rigid body in space: attitude, Newton and Euler in its own axes, linearly implicit steps.

Equations (symbols in NOTATION.md), W the angular velocity, v that of the centre of mass, both in
body axes, q the unit quaternion from body to world axes:
    q' = q (0, W) / 2,   q(t + h) = q(t) exp(h W / 2)          W constant in body axes
    R  = rotation matrix of q;  a_world = R a_body
    R  = R_z(yaw) R_y(pitch) R_x(roll)                         yaw, then pitch, then roll
    R^T (0, 0, -g) = g (s_p, -c_p s_r, -c_p c_r)               gravity in body axes
    m (v' + W x v)     = F
    I W' + W x (I W)   = M                 I diagonal: the body's axes are principal axes
Between calls the attitude is kept as three angles, within a call as a quaternion. Near pitch = +-90
degrees, where yaw and roll turn about one axis, the yaw keeps its last value and the roll takes up
the rest.
A step with the drag A of the forces solves (M + d A) a = wrench, where M = diag(m, m, m, I) and
A is symmetric and positive semidefinite, by L D L^T without square roots or pivots.
A payload m_p at r from the centre of mass of a vehicle of mass m_v moves that by c, and its inertia
about the new centre of mass follows from the parallel axes of both:
    c = r m_p / (m_v + m_p),   I_z = I_z,v + I_z,p + (x^2 + y^2) m_v m_p / (m_v + m_p)    and so on

Assumption: the products of inertia vanish, those of a payload out of the axes too.
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


class Twist(NamedTuple):
    """Velocity of the centre of mass and angular velocity, body axes; or six of their rates."""

    x: float  # [m/s]
    y: float  # [m/s]
    z: float  # [m/s]
    roll: float  # [rad/s]
    pitch: float  # [rad/s]
    yaw: float  # [rad/s]


class Wrench(NamedTuple):
    """Force [N] and moment [N m] about the centre of mass, body axes."""

    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float


class Drag(NamedTuple):
    """Lower triangle of the symmetric matrix A in wrench = -A twist + ..., row by row."""

    xx: float  # [N s/m]
    yx: float
    yy: float
    zx: float
    zy: float
    zz: float
    rx: float  # [N s] moment about the body's x axis by v_x, v_y, v_z
    ry: float
    rz: float
    rr: float  # [N m s]
    px: float
    py: float
    pz: float
    pr: float
    pp: float
    wx: float  # yaw
    wy: float
    wz: float
    wr: float
    wp: float
    ww: float


class BeltDrag(NamedTuple):
    """How the belt of one track is coupled to the vehicle: the last row of its Drag."""

    x: float  # [N s/m] force of the belt's speed on the vehicle, body axes
    y: float
    z: float
    roll: float  # [N s] and its moment
    pitch: float
    yaw: float
    belt: float  # [N s/m] resistance to the belt itself
    effort: float  # [N] tractive effort of the track


class Inertia(NamedTuple):
    """Mass and principal moments of inertia about the centre of mass."""

    mass: float  # [kg]
    roll: float  # [kg m^2]
    pitch: float  # [kg m^2]
    yaw: float  # [kg m^2]


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
    xx, xy, xz = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    yx, yy, yz = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    zx, zy, zz = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    return Rotation(xx, xy, xz, yx, yy, yz, zx, zy, zz)


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

    Of a path on the map and of its derivatives alike. Needs |pitch|, |roll| < 90 degrees.
    """
    aside = left / incline.cos_roll
    cross = incline.down_x * incline.sin_roll
    return (ahead - cross * aside) / incline.cos_pitch, aside


@formula
def heading_rate(incline, pitch_rate):
    """(a [-], b [rad/s]) with d yaw/dt = a W_z + b; b from the rate of pitch, 0 without (NaN)."""
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
    """A pose error in the plane of the vehicle: R^T (e_x, e_y, 0) and z_b . (0, 0, e_yaw), F (49).

    ahead, left [m]: the horizontal error along the heading and to the left of it; turn [rad] about
    the vertical; pitch, roll: (cosine, sine). Numbers, or arrays.
    """
    c_pitch, s_pitch = pitch
    c_roll, s_roll = roll
    return c_pitch * ahead, s_roll * s_pitch * ahead + c_roll * left, c_pitch * c_roll * turn


@formula
def with_payload(i, mass, place, size):
    """(Inertia, shift (x, y, z) [m] of the centre of mass) of a vehicle with a box on it.

    i: Inertia of the vehicle; mass [kg] of the box, its middle at `place` (x, y, z) [m] from the
    vehicle's centre of mass, its edges `size` [m] along the body's axes; 0: a point.
    """
    share = mass / (i.mass + mass)
    reduced, box = i.mass * share, mass / 12.0
    x2, y2, z2 = place[0] * place[0], place[1] * place[1], place[2] * place[2]
    a2, b2, c2 = size[0] * size[0], size[1] * size[1], size[2] * size[2]
    loaded = Inertia(
        i.mass + mass,
        i.roll + box * (b2 + c2) + reduced * (y2 + z2),
        i.pitch + box * (a2 + c2) + reduced * (x2 + z2),
        i.yaw + box * (a2 + b2) + reduced * (x2 + y2),
    )
    return loaded, (share * place[0], share * place[1], share * place[2])


@formula
def with_inertia(wrench, v, i):
    """The wrench [N, N m] less what turns the velocities with the axes."""
    return Wrench(
        wrench.x - i.mass * (v.pitch * v.z - v.yaw * v.y),
        wrench.y - i.mass * (v.yaw * v.x - v.roll * v.z),
        wrench.z - i.mass * (v.roll * v.y - v.pitch * v.x),
        wrench.roll - (i.yaw - i.pitch) * v.pitch * v.yaw,
        wrench.pitch - (i.roll - i.yaw) * v.yaw * v.roll,
        wrench.yaw - (i.pitch - i.roll) * v.roll * v.pitch,
    )


@formula
def with_weight(wrench, r, weight):
    """The wrench and the weight [N] of a body with axes r."""
    x, y, z = wrench.x - weight * r.zx, wrench.y - weight * r.zy, wrench.z - weight * r.zz
    return Wrench(x, y, z, wrench.roll, wrench.pitch, wrench.yaw)


@formula
def momentum(t, i, factor):
    """factor M t of a twist t, as a wrench."""
    m = factor * i.mass
    roll, pitch = factor * i.roll * t.roll, factor * i.pitch * t.pitch
    return Wrench(m * t.x, m * t.y, m * t.z, roll, pitch, factor * i.yaw * t.yaw)


@formula
def factors(a, i, d):
    """L D L^T of M + d A: L below its diagonal, row by row, and 1/D; a: Drag, d [s]."""
    m = i.mass
    d0 = 1.0 / (m + d * a.xx)
    c10, c20, c30, c40, c50 = d * a.yx, d * a.zx, d * a.rx, d * a.px, d * a.wx
    l10, l20, l30, l40, l50 = c10 * d0, c20 * d0, c30 * d0, c40 * d0, c50 * d0
    d1 = 1.0 / (m + d * a.yy - l10 * c10)
    c21, c31 = d * a.zy - l20 * c10, d * a.ry - l30 * c10
    c41, c51 = d * a.py - l40 * c10, d * a.wy - l50 * c10
    l21, l31, l41, l51 = c21 * d1, c31 * d1, c41 * d1, c51 * d1
    d2 = 1.0 / (m + d * a.zz - l20 * c20 - l21 * c21)
    c32 = d * a.rz - l30 * c20 - l31 * c21
    c42 = d * a.pz - l40 * c20 - l41 * c21
    c52 = d * a.wz - l50 * c20 - l51 * c21
    l32, l42, l52 = c32 * d2, c42 * d2, c52 * d2
    d3 = 1.0 / (i.roll + d * a.rr - l30 * c30 - l31 * c31 - l32 * c32)
    c43 = d * a.pr - l40 * c30 - l41 * c31 - l42 * c32
    c53 = d * a.wr - l50 * c30 - l51 * c31 - l52 * c32
    l43, l53 = c43 * d3, c53 * d3
    d4 = 1.0 / (i.pitch + d * a.pp - l40 * c40 - l41 * c41 - l42 * c42 - l43 * c43)
    c54 = d * a.wp - l50 * c40 - l51 * c41 - l52 * c42 - l53 * c43
    l54 = c54 * d4
    d5 = 1.0 / (i.yaw + d * a.ww - l50 * c50 - l51 * c51 - l52 * c52 - l53 * c53 - l54 * c54)
    low = (l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54)
    return low, (d0, d1, d2, d3, d4, d5)


@formula
def solved(factored, b):
    """Twist a with (M + d A) a = b, from `factors` and the wrench b."""
    (l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54), d = factored
    y0 = b.x
    y1 = b.y - l10 * y0
    y2 = b.z - l20 * y0 - l21 * y1
    y3 = b.roll - l30 * y0 - l31 * y1 - l32 * y2
    y4 = b.pitch - l40 * y0 - l41 * y1 - l42 * y2 - l43 * y3
    y5 = b.yaw - l50 * y0 - l51 * y1 - l52 * y2 - l53 * y3 - l54 * y4
    x5 = y5 * d[5]
    x4 = y4 * d[4] - l54 * x5
    x3 = y3 * d[3] - l43 * x4 - l53 * x5
    x2 = y2 * d[2] - l32 * x3 - l42 * x4 - l52 * x5
    x1 = y1 * d[1] - l21 * x2 - l31 * x3 - l41 * x4 - l51 * x5
    x0 = y0 * d[0] - l10 * x1 - l20 * x2 - l30 * x3 - l40 * x4 - l50 * x5
    return Twist(x0, x1, x2, x3, x4, x5)


@formula
def moved(v, rates, duration):
    """Twist after `duration` [s] at constant rates."""
    x, y, z = v.x + duration * rates.x, v.y + duration * rates.y, v.z + duration * rates.z
    roll, pitch = v.roll + duration * rates.roll, v.pitch + duration * rates.pitch
    return Twist(x, y, z, roll, pitch, v.yaw + duration * rates.yaw)


@formula
def at_point(v, x, y, z):
    """Twist of the point (x, y, z) [m] of the body, from that of its origin; of rates likewise."""
    v_x, v_y = v.x + (v.pitch * z - v.yaw * y), v.y + (v.yaw * x - v.roll * z)
    return Twist(v_x, v_y, v.z + (v.roll * y - v.pitch * x), v.roll, v.pitch, v.yaw)


@formula
def summed(a, b, factor):
    """a + factor b; a: Wrench, b: Wrench or anything with its six components."""
    x, y, z = a.x + factor * b.x, a.y + factor * b.y, a.z + factor * b.z
    roll, pitch = a.roll + factor * b.roll, a.pitch + factor * b.pitch
    return Wrench(x, y, z, roll, pitch, a.yaw + factor * b.yaw)
