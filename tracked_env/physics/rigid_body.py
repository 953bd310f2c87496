"""Newton and Euler for a rigid body in its own axes, and linearly implicit steps of it.

Equations (symbols in NOTATION.md), W the angular velocity, v that of the centre of mass:
    m (v' + W x v)     = F
    I W' + W x (I W)   = M                 I diagonal: the body's axes are principal axes
A step with the drag A of the forces solves (M + d A) a = wrench, where M = diag(m, m, m, I) and
A is symmetric and positive semidefinite, by L D L^T without square roots or pivots.
A payload m_p at r from the centre of mass of a vehicle of mass m_v moves that by c, and its inertia
about the new centre of mass follows from the parallel axes of both:
    c = r m_p / (m_v + m_p),   I_z = I_z,v + I_z,p + (x^2 + y^2) m_v m_p / (m_v + m_p)    and so on

Assumption: the products of inertia vanish, those of a payload out of the axes too.
"""

from typing import NamedTuple

from tracked_env.physics.contact_totals import Wrench
from tracked_env.physics.ground_contact import Twist
from tracked_env.physics.jit import formula


class Inertia(NamedTuple):
    """Mass and principal moments of inertia about the centre of mass."""

    mass: float  # [kg]
    roll: float  # [kg m^2]
    pitch: float  # [kg m^2]
    yaw: float  # [kg m^2]


class Factors(NamedTuple):
    """L below its diagonal, row by row, and 1/D."""

    l10: float
    l20: float
    l21: float
    l30: float
    l31: float
    l32: float
    l40: float
    l41: float
    l42: float
    l43: float
    l50: float
    l51: float
    l52: float
    l53: float
    l54: float
    d0: float
    d1: float
    d2: float
    d3: float
    d4: float
    d5: float


@formula
def with_payload(i, mass, place, size):
    """(Inertia, shift (x, y, z) [m] of the centre of mass) of a vehicle with a box on it.

    i: Inertia of the vehicle; mass [kg] of the box, its middle at `place` (x, y, z) [m] from the
    vehicle's centre of mass, its edges `size` [m] along the body's axes; 0: a point.
    """
    share = mass / (i.mass + mass)
    reduced, own = i.mass * share, mass / 12.0
    x2, y2, z2 = place[0] * place[0], place[1] * place[1], place[2] * place[2]
    a2, b2, c2 = size[0] * size[0], size[1] * size[1], size[2] * size[2]
    loaded = Inertia(
        i.mass + mass,
        i.roll + own * (b2 + c2) + reduced * (y2 + z2),
        i.pitch + own * (a2 + c2) + reduced * (x2 + z2),
        i.yaw + own * (a2 + b2) + reduced * (x2 + y2),
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
    return Wrench(
        m * t.x, m * t.y, m * t.z,
        factor * i.roll * t.roll, factor * i.pitch * t.pitch, factor * i.yaw * t.yaw,
    )  # fmt: skip


@formula
def factors(a, i, d):
    """L D L^T of M + d A; a: Drag, d [s]."""
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
    return Factors(
        l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54,
        d0, d1, d2, d3, d4, d5,
    )  # fmt: skip


@formula
def solved(f, b):
    """Twist a with (M + d A) a = b, from the Factors f and the wrench b."""
    y0 = b.x
    y1 = b.y - f.l10 * y0
    y2 = b.z - f.l20 * y0 - f.l21 * y1
    y3 = b.roll - f.l30 * y0 - f.l31 * y1 - f.l32 * y2
    y4 = b.pitch - f.l40 * y0 - f.l41 * y1 - f.l42 * y2 - f.l43 * y3
    y5 = b.yaw - f.l50 * y0 - f.l51 * y1 - f.l52 * y2 - f.l53 * y3 - f.l54 * y4
    x5 = y5 * f.d5
    x4 = y4 * f.d4 - f.l54 * x5
    x3 = y3 * f.d3 - f.l43 * x4 - f.l53 * x5
    x2 = y2 * f.d2 - f.l32 * x3 - f.l42 * x4 - f.l52 * x5
    x1 = y1 * f.d1 - f.l21 * x2 - f.l31 * x3 - f.l41 * x4 - f.l51 * x5
    x0 = y0 * f.d0 - f.l10 * x1 - f.l20 * x2 - f.l30 * x3 - f.l40 * x4 - f.l50 * x5
    return Twist(x0, x1, x2, x3, x4, x5)


@formula
def moved(v, rates, duration):
    """Twist after `duration` [s] at constant rates."""
    return Twist(
        v.x + duration * rates.x, v.y + duration * rates.y, v.z + duration * rates.z,
        v.roll + duration * rates.roll, v.pitch + duration * rates.pitch,
        v.yaw + duration * rates.yaw,
    )  # fmt: skip


@formula
def at_point(v, x, y, z):
    """Twist of the point (x, y, z) [m] of the body, from that of its origin; of rates likewise."""
    return Twist(
        v.x + (v.pitch * z - v.yaw * y), v.y + (v.yaw * x - v.roll * z),
        v.z + (v.roll * y - v.pitch * x), v.roll, v.pitch, v.yaw,
    )  # fmt: skip


@formula
def summed(a, b, factor):
    """a + factor b; a: Wrench, b: Wrench or anything with its six components."""
    return Wrench(
        a.x + factor * b.x, a.y + factor * b.y, a.z + factor * b.z,
        a.roll + factor * b.roll, a.pitch + factor * b.pitch, a.yaw + factor * b.yaw,
    )  # fmt: skip
