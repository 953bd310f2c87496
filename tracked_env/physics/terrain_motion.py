"""Six degrees of freedom of a tracked vehicle on uneven ground: one integration step.

State: centre of mass p (world), unit quaternion q (body to world), twist (v, W) in body axes, belt
speeds. A step of length h is a symmetric splitting:
    drift  p' = R v, q' = q (0, W)/2 over h/2 with the twist held
    kick   M (v, W)' = wrench(v, W) over h with the pose, and so springs and normals, held
    drift  over h/2 with the new twist
The kick is linearly implicit as in `rosenbrock`: to the middle of the step with the drag A of y,
    y_m = y + (h/2) (M + (h/2) A)^-1 f(y)
and over the departure z from the middle by the L-stable method of order two with the drag of y_m.
The drag of a patch that slides faster than at the evaluation before is the slope of its force along
the motion and not the secant: a secant holds a patch that breaks away for as long as it takes to
gain a few orders of magnitude of speed. Whatever the matrix, the order is two. With sprocket
torques the belts have rates of their own, and are eliminated side by side. The terrain is asked
once a step. The springs are explicit, stable up to h = 2 / (largest eigenfrequency).

References: [1] McLachlan, Quispel, "Splitting methods", Acta Numerica 11 (2002). [2] those of
`rosenbrock`.
"""

from typing import NamedTuple

from tracked_env.physics import contact_totals, uniform_load
from tracked_env.physics import ground_contact as g
from tracked_env.physics.attitude import Quaternion, matrix_of, turned
from tracked_env.physics.contact_totals import BeltDrag, Drag, Wrench
from tracked_env.physics.ground_contact import Footing, Twist
from tracked_env.physics.jit import formula
from tracked_env.physics.patch_dynamics import Belts, driving_torque, followed
from tracked_env.physics.patch_forces import BELT_SPEED_FLOOR
from tracked_env.physics.rigid_body import (
    Inertia,
    factors,
    momentum,
    moved,
    solved,
    summed,
    with_inertia,
    with_weight,
)
from tracked_env.physics.rosenbrock import GAMMA
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.physics.uniform_load import Rocking

_NO_BELTS = Belts(0.0, 0.0)
_NO_WRENCH = Wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_BELT_DRAG = BeltDrag(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_TILT = uniform_load.Tilt(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_NO_DRAG = Drag(*[0.0] * 21)
LINEAR = -1.0  # decay of a command that changes linearly in time
_A = (2.0 * GAMMA - 1.0) / GAMMA
_B = (1.0 - GAMMA) / GAMMA


class Pose3(NamedTuple):
    """Where the vehicle is."""

    x: float  # [m] centre of mass, world
    y: float  # [m]
    z: float  # [m]
    q: Quaternion


class BeltDrive(NamedTuple):
    """How the belts follow their drives."""

    inverse_belt_mass: float  # [1/kg] r^2 / J, or 0 where their speed is given
    inverse_radius: float  # [1/m]
    inverse_belt_limit: float  # [s/m] 1 / (r omega_max)


class Tracked(NamedTuple):
    """A vehicle on its soil, for one control step."""

    inertia: Inertia
    footing: Footing
    rocking: Rocking
    drive: BeltDrive
    lanes: int
    patches: int  # of one track
    uniform: bool


class Kick(NamedTuple):
    """Wrench and drag at one motion."""

    wrench: Wrench  # [N, N m] weight and turning of the axes included
    drag: Drag
    left: BeltDrag
    right: BeltDrag
    tilt: uniform_load.Tilt


@formula
def drifted(pose, twist, duration):
    """Pose after `duration` [s] at a constant twist; second order along the arc."""
    half = 0.5 * duration
    middle = turned(pose.q, half * twist.roll, half * twist.pitch, half * twist.yaw)
    r = matrix_of(middle)
    return Pose3(
        pose.x + duration * (r.xx * twist.x + r.xy * twist.y + r.xz * twist.z),
        pose.y + duration * (r.yx * twist.x + r.yy * twist.y + r.yz * twist.z),
        pose.z + duration * (r.zx * twist.x + r.zy * twist.y + r.zz * twist.z),
        turned(middle, half * twist.roll, half * twist.pitch, half * twist.yaw),
    )


@formula
def meet_ground(fill, relief, w, pose, r, body):
    """Where the patches are and which way the ground faces there; returns places off the map."""
    if body.uniform:
        few = min(body.lanes, g.WIDE)
        uniform_load.locate_foot(w, few, pose, r, body.footing.height)
        off = fill(relief, w, few)
        g.orient(w, few, r)
        uniform_load.share_plane(w, body.lanes)
        return off
    g.locate(w, body.lanes, pose, r, body.footing.height)
    off = fill(relief, w, body.lanes)
    g.orient(w, body.lanes, r)
    for lane in range(2 * body.patches, body.lanes):
        w[g.SINKAGE, lane] = -1.0
    return off


@formula
def set_belts(w, belts, body):
    """Belt speeds in all lanes; returns the longest contact time [s] of both tracks."""
    length = body.footing.half_length
    g.set_belt(w, 0, body.patches, belts.left, length)
    g.set_belt(w, body.patches, body.lanes, belts.right, length)
    slow = max(min(abs(belts.left), abs(belts.right)), BELT_SPEED_FLOOR)
    return 2.0 * length / slow


@formula
def kick_at(w, r, twist, longest, body, again):
    """Wrench and drag at a twist, in the pose that `meet_ground` has seen.

    longest [s]: contact time of the last patch. again: there was a motion before, to compare with.
    """
    footing = body.footing
    tilt, carrying = _NO_TILT, 1.0
    if body.uniform:
        tilt, carrying = uniform_load.tilt_of(w, twist, footing, body.rocking), 0.0
        uniform_load.share_load(w, 2 * body.patches, tilt.load)
    else:
        g.press(w, body.lanes, twist, footing)
    g.slide(w, body.lanes, twist, footing, longest)
    g.resist(w, body.lanes, again)
    wrench = contact_totals.total_wrench(w, body.lanes, footing.height, carrying)
    damping = carrying * footing.patch_area * footing.damping
    drag = contact_totals.total_drag(w, body.lanes, footing.height, damping)
    if body.uniform:
        wrench, drag = uniform_load.held(w, tilt, footing, body.rocking, wrench, drag)
    wrench = with_weight(wrench, r, body.inertia.mass * GRAVITY)
    wrench = with_inertia(wrench, twist, body.inertia)
    left, right = _NO_BELT_DRAG, _NO_BELT_DRAG
    if body.drive.inverse_belt_mass > 0.0:
        left = contact_totals.belt_drag(w, 0, body.patches, footing.height)
        right = contact_totals.belt_drag(w, body.patches, 2 * body.patches, footing.height)
    return Kick(wrench, drag, left, right, tilt)


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
def _factored(kick, body, d):
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
def _solve(factored, kick, body, d, wrench, belts):
    """(twist, belts) y with (1 + d A) y = (M^-1 wrench, belts), belts included."""
    f, keep_left, keep_right = factored
    mass = body.drive.inverse_belt_mass
    if mass == 0.0:
        return solved(f, wrench), _NO_BELTS
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
        return _NO_BELTS
    left = driving_torque(torques.left, belts.left, limit) * drive.inverse_radius
    right = driving_torque(torques.right, belts.right, limit) * drive.inverse_radius
    return Belts(mass * (left - kick.left.effort), mass * (right - kick.right.effort))


@formula
def _plus(a, b, factor):
    return Belts(a.left + factor * b.left, a.right + factor * b.right)


@formula
def _half_way(kick, factored, command, belts, h, body):
    """Rates of twist and belts, damped, that lead to the middle of a step."""
    rates = belt_rates(kick, belts, command, body.drive)
    return _solve(factored, kick, body, 0.5 * h, kick.wrench, rates)


@formula
def _departure(kick, factored, given, belts, first, first_belts, h, body):
    """What twist and belts are away from the middle of the step at its end.

    The departure z from the middle starts at -(h/2) first and follows dz/dt = rates - A z.
    """
    inertia = body.inertia
    rates = belt_rates(kick, belts, given, body.drive)
    half, d = 0.5 * h, GAMMA * h
    inner = summed(momentum(first, inertia, -half * _B), kick.wrench, (1.0 - GAMMA) * h)
    inner_belts = _plus(_plus(_NO_BELTS, first_belts, -half * _B), rates, (1.0 - GAMMA) * h)
    away, away_belts = _solve(factored, kick, body, d, inner, inner_belts)
    outer = summed(momentum(away, inertia, 1.0), momentum(first, inertia, -half), _A)
    outer_belts = _plus(_plus(away_belts, first_belts, -half * _A), rates, d)
    return _solve(factored, kick, body, d, summed(outer, kick.wrench, d), outer_belts)


@formula
def advance(fill, relief, w, start, command, demand, decay, steps, h, body):
    """Advance by `steps` steps of h [s], and see the forces of the end.

    fill: compiled (relief, w, lanes), writes HEIGHT and slopes, returns places off the map. w:
    scratch with patches and soil in place. start: (pose, twist, belts). command, demand: what the
    drives give now and what is asked of them, belt speeds [m/s] or torques [N m]; decay [-]: what
    the lag leaves of the difference after one step, 0 without lag, LINEAR for a command that
    reaches the demand at the end of the last step in a straight line.
    Returns (pose, twist, belts), what the drives give in the end, Kick, places off the map.
    """
    pose, twist, belts = start
    driven = body.drive.inverse_belt_mass > 0.0
    if decay == 0.0:
        command = demand
    if steps > 0:
        pose = drifted(pose, twist, 0.5 * h)
    belts = belts if driven else command
    coming, off, r = command, 0.0, matrix_of(pose.q)
    at, at_belts, given = twist, belts, command
    first, first_belts = Twist(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), _NO_BELTS
    kick = Kick(_NO_WRENCH, _NO_DRAG, _NO_BELT_DRAG, _NO_BELT_DRAG, _NO_TILT)
    for evaluation in range(2 * steps + 1):
        again = evaluation % 2 == 1
        if not again:
            r = matrix_of(pose.q)
            off = meet_ground(fill, relief, w, pose, r, body)
        kick = kick_at(w, r, at, set_belts(w, at_belts, body), body, evaluation > 0)
        if evaluation == 2 * steps:
            break
        factored = _factored(kick, body, (GAMMA if again else 0.5) * h)
        if again:
            away, away_belts = _departure(
                kick, factored, given, at_belts, first, first_belts, h, body
            )
            twist = moved(at, away, 1.0)
            belts = _plus(at_belts, away_belts, 1.0) if driven else coming
            command = coming
            at, at_belts, given = twist, belts, command
            pose = drifted(pose, twist, h if evaluation < 2 * steps - 1 else 0.5 * h)
        else:
            left = steps - evaluation // 2
            coming = followed(command, demand, 1.0 - 1.0 / left if decay == LINEAR else decay)
            given = followed(command, coming, 0.5)
            first, first_belts = _half_way(kick, factored, command, belts, h, body)
            at = moved(twist, first, 0.5 * h)
            at_belts = _plus(belts, first_belts, 0.5 * h) if driven else given
    return (pose, twist, belts), command, kick, off


class Settled(NamedTuple):
    """Forces and rates at one instant."""

    rates: Twist  # of the twist, body axes
    load: float  # [N] normal load of both tracks
    load_left: float  # [N]
    load_right: float  # [N]
    largest: float  # [N] of one patch
    touching: float  # [-] share of the patches in contact
    effort_left: float  # [N] tractive effort
    effort_right: float  # [N]
    resistance_left: float  # [N] motion resistance, against forward motion
    resistance_right: float  # [N]
    off_map: float  # [-] places off the map
    saturated: float  # [-] 1 where the uniform load cannot hold the vehicle from tipping


@formula
def settled_of(w, kick, off, body):
    """Settled of the last evaluation of `advance`."""
    i, n, f = body.inertia, body.patches, kick.wrench
    rates = Twist(
        f.x / i.mass, f.y / i.mass, f.z / i.mass, f.roll / i.roll, f.pitch / i.pitch, f.yaw / i.yaw
    )
    largest, touching = 0.0, 0.0
    for lane in range(2 * n):
        largest = max(largest, w[g.LOAD, lane])
        touching += 1.0 if w[g.LOAD, lane] > 0.0 else 0.0
    left, right = contact_totals.track_totals(w, 0, n), contact_totals.track_totals(w, n, 2 * n)
    return Settled(
        rates, left[0] + right[0], left[0], right[0], largest, touching / (2 * n),
        left[1], right[1], left[2], right[2], off, kick.tilt.saturated,
    )  # fmt: skip
