"""Belts driven by sprocket torques: their rates, and their elimination from an implicit step.

A step solves (M + d A) of vehicle and both belts together (symbols in NOTATION.md). A belt has one
speed, coupled to the vehicle by the last row c of its drag (`contact_totals.belt_drag`), so that it
is eliminated by hand: what is left is the vehicle's matrix less a share of c c^T for each belt.
Where the speeds of the belts are given there is nothing to eliminate.
"""

from typing import NamedTuple

from tracked_env.physics.contact_totals import Drag
from tracked_env.physics.jit import formula
from tracked_env.physics.patch_dynamics import Belts, driving_torque
from tracked_env.physics.rigid_body import factors, solved, summed

NO_BELTS = Belts(0.0, 0.0)


class BeltDrive(NamedTuple):
    """How the belts follow their drives."""

    inverse_belt_mass: float  # [1/kg] r^2 / J, or 0 where their speed is given
    inverse_radius: float  # [1/m]
    inverse_belt_limit: float  # [s/m] 1 / (r omega_max)


@formula
def _less(drag, c, share):
    """drag - share c c^T, of a belt's BeltDrag c."""
    x, y, z = share * c.x, share * c.y, share * c.z
    roll, pitch, yaw = share * c.roll, share * c.pitch, share * c.yaw
    return Drag(
        drag.xx - x * c.x, drag.yx - y * c.x, drag.yy - y * c.y,
        drag.zx - z * c.x, drag.zy - z * c.y, drag.zz - z * c.z,
        drag.rx - roll * c.x, drag.ry - roll * c.y, drag.rz - roll * c.z, drag.rr - roll * c.roll,
        drag.px - pitch * c.x, drag.py - pitch * c.y, drag.pz - pitch * c.z,
        drag.pr - pitch * c.roll, drag.pp - pitch * c.pitch,
        drag.wx - yaw * c.x, drag.wy - yaw * c.y, drag.wz - yaw * c.z,
        drag.wr - yaw * c.roll, drag.wp - yaw * c.pitch, drag.ww - yaw * c.yaw,
    )  # fmt: skip


@formula
def eliminated(kick, body, d):
    """Factors of M + d A with the belts eliminated, and what a belt keeps of its own rate."""
    mass = body.drive.inverse_belt_mass
    if mass == 0.0:
        return factors(kick.drag, body.inertia, d), 1.0, 1.0
    keep_left = 1.0 / (1.0 + d * mass * kick.left.own)
    keep_right = 1.0 / (1.0 + d * mass * kick.right.own)
    drag = _less(kick.drag, kick.left, d * mass * keep_left)
    drag = _less(drag, kick.right, d * mass * keep_right)
    return factors(drag, body.inertia, d), keep_left, keep_right


@formula
def _on(c, twist):
    """Force [N] on the belt per time [s] of a twist: c . twist."""
    return (
        c.x * twist.x + c.y * twist.y + c.z * twist.z
        + c.roll * twist.roll + c.pitch * twist.pitch + c.yaw * twist.yaw
    )  # fmt: skip


@formula
def solve(factored, kick, body, d, wrench, belts):
    """(twist, belts) y with (1 + d A) y = (M^-1 wrench, belts), belts included."""
    f, keep_left, keep_right = factored
    mass = body.drive.inverse_belt_mass
    if mass == 0.0:
        return solved(f, wrench), NO_BELTS
    wrench = summed(wrench, kick.left, d * keep_left * belts.left)
    wrench = summed(wrench, kick.right, d * keep_right * belts.right)
    twist = solved(f, wrench)
    left = keep_left * (belts.left + d * mass * _on(kick.left, twist))
    right = keep_right * (belts.right + d * mass * _on(kick.right, twist))
    return twist, Belts(left, right)


@formula
def belt_rates(kick, belts, torques, drive):
    """Rates [m/s^2] of belts driven by torques [N m]."""
    limit, mass = drive.inverse_belt_limit, drive.inverse_belt_mass
    if mass == 0.0:
        return NO_BELTS
    left = driving_torque(torques.left, belts.left, limit) * drive.inverse_radius
    right = driving_torque(torques.right, belts.right, limit) * drive.inverse_radius
    return Belts(mass * (left - kick.left.effort), mass * (right - kick.right.effort))
