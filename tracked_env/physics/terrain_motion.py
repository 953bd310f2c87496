"""Six degrees of freedom of a tracked vehicle on uneven ground: one integration step.

State: centre of mass p (world), unit quaternion q (body to world), twist (v, W) in body axes, belt
speeds. A step of length h is a symmetric splitting:
    drift  p' = R v, q' = q (0, W)/2 over h/2 with the twist held
    kick   M (v, W)' = wrench(v, W) over h with the pose, and so springs and normals, held
    drift  over h/2 with the new twist
The kick is linearly implicit as in `level_motion`: to the middle of the step with the drag A of y,
    y_m = y + (h/2) (M + (h/2) A)^-1 f(y)
and over the departure z from the middle by the L-stable method of order two with the drag of y_m.
The drag of a patch that slides faster than at the evaluation before is the slope of its force along
the motion and not the secant, which would hold a patch that breaks away. Whatever the matrix, the
order is two. The springs are explicit, stable up to h = 2 / (largest eigenfrequency).

With sprocket torques the belts have rates of their own. A belt is coupled to the vehicle by the
last row c of its drag (`belt_drag`) and eliminated by hand: what is left of M + d A is the matrix
of the vehicle less a share of c c^T for each belt.

Stiffness and damping are those of F table 2, read per track, times `ground_stiffness_factor`. The
height of the centre of mass, 0.25 m, is F's for its vehicle with 0.7 m of contact. NOMINAL_BODY
scales it with the contact length and gives the inertias about roll and pitch by their ratios to the
yaw inertia (`roll_inertia_ratio`): an ASSUMPTION for every other vehicle.

References: [1] Focchi et al. (2025), table 2 and section 8. [2] McLachlan, Quispel, "Splitting
methods", Acta Numerica 11 (2002). [3] those of `level_motion`.
"""

import math
from typing import NamedTuple

from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import rigid_body as rigid
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula
from tracked_env.physics.level_motion import GAMMA, driving_torque, followed
from tracked_env.physics.parameters import FOCCHI_VEHICLE
from tracked_env.physics.patches_on_level_ground import BELT_SPEED_FLOOR, Belts
from tracked_env.physics.patches_on_terrain import Footing, Rocking, Tilt
from tracked_env.physics.rigid_body import BeltDrag, Drag, Inertia, Quaternion, Twist, Wrench

_FOCCHI_AREA = FOCCHI_VEHICLE.track_width * FOCCHI_VEHICLE.contact_length  # [m^2] of one track
NO_BELTS = Belts(0.0, 0.0)
_NO_WRENCH = Wrench(*[0.0] * 6)
_NO_BELT_DRAG = BeltDrag(*[0.0] * 8)
_NO_TILT = Tilt(*[0.0] * 6)
_NO_DRAG = Drag(*[0.0] * 21)
LINEAR = -1.0  # decay of a command that changes linearly in time
_A = (2.0 * GAMMA - 1.0) / GAMMA
_B = (1.0 - GAMMA) / GAMMA


class BodyOptions(NamedTuple):
    """Numbers of the plant that no parameter holds; of a number and a ratio one is 0."""

    height: float = 0.0  # [m] of the nominal centre of mass above the plane of the tracks
    height_ratio: float = 0.25 / FOCCHI_VEHICLE.contact_length  # [-] over the contact length
    roll_inertia: float = 0.0  # [kg m^2]
    roll_share: float = 1.0  # [-] of the parameter's ratio to the yaw inertia
    pitch_inertia: float = 0.0  # [kg m^2]
    pitch_share: float = 1.0  # [-] likewise
    stiffness: float = 1e5 / _FOCCHI_AREA  # [N/m^3] F table 2
    damping: float = 5e3 / _FOCCHI_AREA  # [N s/m^3]
    stiffening: float = 0.0  # [s/m^2]
    longest_step: float = 2e-3  # [s] of an integration step; docs/terrain.md: step halving
    tilt_limit: float = math.radians(60.0)  # [rad] beyond the tipping angles of F's vehicle


NOMINAL_BODY = BodyOptions()


class Pose3(NamedTuple):
    """Where the vehicle is."""

    x: float  # [m] centre of mass, world
    y: float  # [m]
    z: float  # [m]
    q: Quaternion


class Grid(NamedTuple):
    """Evenly spaced places of the patches on the map, in steps from the middle of a column."""

    x: float  # [m] world, between the tracks beside the first patches
    y: float  # [m]
    column_x: float  # [m] to the next patch of a row
    column_y: float  # [m]
    track_x: float  # [m] to the first row of the left track; the right one is its mirror image
    track_y: float  # [m]
    row_x: float  # [m] to the next row of a track
    row_y: float  # [m]
    columns: int  # patches of a row, whose lanes are side by side
    rows: int  # of a track, one after another; then those of the right track


class Tracked(NamedTuple):
    """A vehicle on its soil, for one control step."""

    inertia: Inertia
    footing: Footing
    rocking: Rocking
    inverse_belt_mass: float  # [1/kg] r^2 / J, or 0 where the belts' speed is given
    inverse_radius: float  # [1/m]
    inverse_belt_limit: float  # [s/m] 1 / (r omega_max)
    lanes: int
    columns: int  # patches of a row
    patches: int  # of one track
    uniform: bool


class Kick(NamedTuple):
    """Wrench and drag at one motion."""

    wrench: Wrench  # [N, N m] weight and turning of the axes included
    drag: Drag
    left: BeltDrag
    right: BeltDrag
    tilt: Tilt


@formula
def nominal_height(p, options):
    """Height [m] of the nominal centre of mass above the plane of the tracks."""
    return options.height + options.height_ratio * p.contact_length


@formula
def sinkage_at_rest(p, options):
    """Sinkage [m] of the tracks at rest on level ground."""
    area = 2.0 * p.contact_length * p.track_width
    return soil.GRAVITY * p.mass / (options.stiffness * p.ground_stiffness_factor * area)


@formula
def height_at_rest(p, options):
    """Height [m] of the nominal centre of mass at rest on level ground at height 0."""
    return nominal_height(p, options) - sinkage_at_rest(p, options)


@formula
def body_of(p, columns, rows, options, by_torque, uniform):
    """Tracked from PlantParameters, patches of a track (columns, rows); options: BodyOptions."""
    count = columns * rows
    firmness = p.ground_stiffness_factor if uniform else 1.0  # else of each patch
    footing = Footing(
        height=nominal_height(p, options) + p.centre_of_mass_z,
        half_length=0.5 * p.contact_length,
        patch_area=p.contact_length * p.track_width / count,
        stiffness=options.stiffness * firmness,
        damping=options.damping * firmness,
        stiffening=options.stiffening,
        ahead=p.centre_of_mass_x,
        aside=p.centre_of_mass_y,
    )
    roll, pitch = p.roll_inertia_ratio * p.inertia, p.pitch_inertia_ratio * p.inertia
    roll = options.roll_inertia + options.roll_share * roll
    pitch = options.pitch_inertia + options.pitch_share * pitch
    inertia = Inertia(p.mass, roll, pitch, p.inertia)
    radius = p.sprocket_radius
    return Tracked(
        inertia=inertia,
        footing=footing,
        rocking=g.rocking_of(footing, 0.5 * p.track_gauge, p.track_width, 2 * count),
        inverse_belt_mass=radius * radius / p.sprocket_inertia if by_torque else 0.0,
        inverse_radius=1.0 / radius,
        inverse_belt_limit=1.0 / (radius * p.sprocket_speed_limit),
        lanes=g.padded(2 * count),
        columns=columns,
        patches=count,
        uniform=uniform,
    )


@formula
def set_soil(w, first, last, soil_there, patch_area):
    """Rows of the soil in lanes first .. last - 1 of the scratch of `patches_on_terrain`."""
    tangent = math.tan(soil_there.friction_angle)
    for lane in range(first, last):
        w[g.FRICTION, lane] = tangent
        w[g.ADHESION, lane] = soil_there.cohesion * patch_area
        w[g.INVERSE_MODULUS, lane] = 1.0 / soil_there.shear_deformation_modulus
        w[g.ROLLING, lane] = soil_there.longitudinal_resistance
        w[g.FIRMNESS, lane] = soil_there.ground_stiffness_factor


@formula
def _less(drag, c, share):
    """drag - share c c^T, of a belt's BeltDrag c."""
    x, y, z = share * c.x, share * c.y, share * c.z
    roll, pitch, yaw = share * c.roll, share * c.pitch, share * c.yaw
    xx, yx, yy = drag.xx - x * c.x, drag.yx - y * c.x, drag.yy - y * c.y
    zx, zy, zz = drag.zx - z * c.x, drag.zy - z * c.y, drag.zz - z * c.z
    rx, ry, rz = drag.rx - roll * c.x, drag.ry - roll * c.y, drag.rz - roll * c.z
    rr = drag.rr - roll * c.roll
    px, py, pz = drag.px - pitch * c.x, drag.py - pitch * c.y, drag.pz - pitch * c.z
    pr, pp = drag.pr - pitch * c.roll, drag.pp - pitch * c.pitch
    wx, wy, wz = drag.wx - yaw * c.x, drag.wy - yaw * c.y, drag.wz - yaw * c.z
    wr, wp, ww = drag.wr - yaw * c.roll, drag.wp - yaw * c.pitch, drag.ww - yaw * c.yaw
    return Drag(xx, yx, yy, zx, zy, zz, rx, ry, rz, rr, px, py, pz, pr, pp, wx, wy, wz, wr, wp, ww)


@formula
def eliminated(kick, body, d):
    """Factors of M + d A with the belts eliminated, and what a belt keeps of its own rate."""
    mass = body.inverse_belt_mass
    if mass == 0.0:
        return rigid.factors(kick.drag, body.inertia, d), 1.0, 1.0
    keep_left = 1.0 / (1.0 + d * mass * kick.left.belt)
    keep_right = 1.0 / (1.0 + d * mass * kick.right.belt)
    drag = _less(kick.drag, kick.left, d * mass * keep_left)
    drag = _less(drag, kick.right, d * mass * keep_right)
    return rigid.factors(drag, body.inertia, d), keep_left, keep_right


@formula
def _on(c, twist):
    """Force [N] on the belt per time [s] of a twist: c . twist."""
    pulled = c.x * twist.x + c.y * twist.y + c.z * twist.z + c.roll * twist.roll
    return pulled + c.pitch * twist.pitch + c.yaw * twist.yaw


@formula
def solve(factored, kick, body, d, wrench, belts):
    """(twist, belts) y with (1 + d A) y = (M^-1 wrench, belts), belts included."""
    f, keep_left, keep_right = factored
    mass = body.inverse_belt_mass
    if mass == 0.0:
        return rigid.solved(f, wrench), NO_BELTS
    wrench = rigid.summed(wrench, kick.left, d * keep_left * belts.left)
    wrench = rigid.summed(wrench, kick.right, d * keep_right * belts.right)
    twist = rigid.solved(f, wrench)
    left = keep_left * (belts.left + d * mass * _on(kick.left, twist))
    right = keep_right * (belts.right + d * mass * _on(kick.right, twist))
    return twist, Belts(left, right)


@formula
def belt_rates(kick, belts, torques, body):
    """Rates [m/s^2] of belts driven by torques [N m]."""
    limit, mass = body.inverse_belt_limit, body.inverse_belt_mass
    if mass == 0.0:
        return NO_BELTS
    left = driving_torque(torques.left, belts.left, limit) * body.inverse_radius
    right = driving_torque(torques.right, belts.right, limit) * body.inverse_radius
    return Belts(mass * (left - kick.left.effort), mass * (right - kick.right.effort))


@formula
def drifted(pose, twist, duration):
    """Pose after `duration` [s] at a constant twist; second order along the arc."""
    half = 0.5 * duration
    middle = rigid.turned(pose.q, half * twist.roll, half * twist.pitch, half * twist.yaw)
    r = rigid.matrix_of(middle)
    return Pose3(
        pose.x + duration * (r.xx * twist.x + r.xy * twist.y + r.xz * twist.z),
        pose.y + duration * (r.yx * twist.x + r.yy * twist.y + r.yz * twist.z),
        pose.z + duration * (r.zx * twist.x + r.zy * twist.y + r.zz * twist.z),
        rigid.turned(middle, half * twist.roll, half * twist.pitch, half * twist.yaw),
    )


@formula
def grid_of(w, p, r, height, columns, rows):
    """Grid of the patches; p, r, height as in `patches_on_terrain.locate`."""
    x, y = w[g.X, 0], w[g.Y, 0]
    middle = 0.5 * (y + w[g.Y, columns * (2 * rows - 1)])
    column, row = w[g.X, min(1, columns - 1)] - x, w[g.Y, columns * min(1, rows - 1)] - y
    return Grid(
        x=p[0] - r.xz * height + (r.xx * x + r.xy * middle),
        y=p[1] - r.yz * height + (r.yx * x + r.yy * middle),
        column_x=r.xx * column,
        column_y=r.yx * column,
        track_x=r.xy * (y - middle),
        track_y=r.yy * (y - middle),
        row_x=r.xy * row,
        row_y=r.yy * row,
        columns=columns,
        rows=rows,
    )


@formula
def meet_ground(fill, relief, w, pose, r, body):
    """Where the patches are and which way the ground faces there; returns places off the map."""
    if body.uniform:
        few = min(body.lanes, g.WIDE)
        g.locate_foot(w, few, pose, r, body.footing)
        foot = Grid(w[g.PLACE_X, 0], w[g.PLACE_Y, 0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1, 1)
        off = fill(relief, w, few, foot)
        g.orient(w, few, r)
        g.share_plane(w, body.lanes)
        return off
    g.locate(w, body.lanes, pose, r, body.footing.height)
    rows = body.patches // body.columns
    grid = grid_of(w, pose, r, body.footing.height, body.columns, rows)
    off = fill(relief, w, body.lanes, grid)
    g.orient(w, body.lanes, r)
    for lane in range(2 * body.patches, body.lanes):
        w[g.SINKAGE, lane] = -1.0
    return off


@formula
def set_belts(w, belts, body):
    """Belt speeds in all lanes; returns the longest contact time [s] of both tracks."""
    length = body.footing.half_length
    g.set_belt(w, 0, body.patches, belts.left, body.footing)
    g.set_belt(w, body.patches, body.lanes, belts.right, body.footing)
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
        tilt, carrying = g.tilt_of(w, twist, footing, body.rocking), 0.0
        for lane in range(2 * body.patches):
            w[g.LOAD, lane] = tilt.load / (2 * body.patches)
    else:
        g.press(w, body.lanes, twist, footing)
    g.slide(w, body.lanes, twist, footing, longest)
    g.resist(w, body.lanes, again)
    wrench = g.total_wrench(w, body.lanes, footing.height, carrying)
    damping = carrying * footing.patch_area * footing.damping
    drag = g.total_drag(w, body.lanes, footing.height, damping)
    if body.uniform:
        wrench, drag = g.with_tilt(w, tilt, footing, body.rocking, wrench, drag)
    wrench = rigid.with_weight(wrench, r, body.inertia.mass * soil.GRAVITY)
    wrench = rigid.with_inertia(wrench, twist, body.inertia)
    left, right = _NO_BELT_DRAG, _NO_BELT_DRAG
    if body.inverse_belt_mass > 0.0:
        left = g.belt_drag(w, 0, body.patches, footing.height)
        right = g.belt_drag(w, body.patches, 2 * body.patches, footing.height)
    return Kick(wrench, drag, left, right, tilt)


@formula
def _plus(a, b, factor):
    return Belts(a.left + factor * b.left, a.right + factor * b.right)


@formula
def _departure(kick, factored, command, belts, first, first_belts, h, body):
    """What twist and belts are away from the middle of the step at its end.

    The departure z from the middle starts at -(h/2) first and follows dz/dt = rates - A z.
    """
    inertia = body.inertia
    rates = belt_rates(kick, belts, command, body)
    half, d = 0.5 * h, GAMMA * h
    inner = rigid.summed(rigid.momentum(first, inertia, -half * _B), kick.wrench, (1.0 - GAMMA) * h)
    inner_belts = _plus(_plus(NO_BELTS, first_belts, -half * _B), rates, (1.0 - GAMMA) * h)
    away, away_belts = solve(factored, kick, body, d, inner, inner_belts)
    outer = rigid.summed(
        rigid.momentum(away, inertia, 1.0), rigid.momentum(first, inertia, -half), _A
    )
    outer_belts = _plus(_plus(away_belts, first_belts, -half * _A), rates, d)
    return solve(factored, kick, body, d, rigid.summed(outer, kick.wrench, d), outer_belts)


@formula
def advance(fill, relief, w, start, drives, steps, h, body):
    """Advance by `steps` steps of h [s]: (pose, twist, belts), drives, Kick, places off the map.

    fill: compiled (relief, w, lanes, Grid), writes HEIGHT and slopes, returns places off the map.
    w: scratch with patches and soil in place. start: (pose, twist, belts). drives: Drives, decay
    LINEAR for a command that reaches the demand at the end of the last step in a straight line.
    """
    pose, twist, belts = start
    command, demand, decay = drives
    with_torque = body.inverse_belt_mass > 0.0
    if decay == 0.0:
        command = demand
    if steps > 0:
        pose = drifted(pose, twist, 0.5 * h)
    belts = belts if with_torque else command
    coming, off, r = command, 0.0, rigid.matrix_of(pose.q)
    at, at_belts, acting = twist, belts, command
    held, longest = at_belts, 0.0  # belts in the scratch
    first, first_belts = Twist(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), NO_BELTS
    kick = Kick(_NO_WRENCH, _NO_DRAG, _NO_BELT_DRAG, _NO_BELT_DRAG, _NO_TILT)
    for evaluation in range(2 * steps + 1):
        again = evaluation % 2 == 1
        if not again:
            r = rigid.matrix_of(pose.q)
            off = meet_ground(fill, relief, w, pose, r, body)
        if evaluation == 0 or at_belts != held:
            held, longest = at_belts, set_belts(w, at_belts, body)
        kick = kick_at(w, r, at, longest, body, evaluation > 0)
        if evaluation == 2 * steps:
            break
        factored = eliminated(kick, body, (GAMMA if again else 0.5) * h)
        if again:
            away, away_belts = _departure(
                kick, factored, acting, at_belts, first, first_belts, h, body
            )
            twist = rigid.moved(at, away, 1.0)
            belts = _plus(at_belts, away_belts, 1.0) if with_torque else coming
            command = coming
            at, at_belts, acting = twist, belts, command
            pose = drifted(pose, twist, h if evaluation < 2 * steps - 1 else 0.5 * h)
        else:
            left = steps - evaluation // 2
            coming = followed(command, demand, 1.0 - 1.0 / left if decay == LINEAR else decay)
            acting = followed(command, coming, 0.5)
            rates = belt_rates(kick, belts, command, body)
            first, first_belts = solve(factored, kick, body, 0.5 * h, kick.wrench, rates)
            at = rigid.moved(twist, first, 0.5 * h)
            at_belts = _plus(belts, first_belts, 0.5 * h) if with_torque else acting
    return (pose, twist, belts), command, kick, off
