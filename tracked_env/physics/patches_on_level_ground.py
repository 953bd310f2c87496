"""Shear of the soil under two tracks that are divided into patches.

Equations (F = Focchi et al. 2025 section 2.1; symbols in NOTATION.md), for a patch at
(x, y) of a track whose belt moves at v_s = r omega over a vehicle that moves at v_x, v_y, w:
    s   = (v_x - w y - v_s, v_y + w x)             shear velocity, F (2)
    t   = (l_e - x) / v_s,  l_e = sign(v_s) l      time since the patch touched the soil, F (3)
    th  = w t                                      rotation of the vehicle meanwhile, F (4)
    j_x = t [ b S - v_s - (v_y + w x) th C ]       shear displacement, b = v_x - w y,
    j_y = t [ b th C + (v_y + w x) S ]             S = sin(th)/th, C = (1 - cos(th))/th^2
    tau A = (c A + N tan(phi)) (1 - exp(-j/K))     Janosi-Hanamoto over the patch's area A
    f   = -tau A s / |s|                           force on the vehicle
F (6) is misprinted: this is the integral of F (5) in body axes; here without 1/w, so that w -> 0
needs no special case. F (1) prints the cohesion outside the bracket.
Limits: K -> 0 is Coulomb friction; s -> 0 has no force from a shear history that is straight;
v_s -> 0 gives t -> inf, full sliding friction. Beyond HISTORY_TURN of rotation the formula would
claim that soil comes back under the patch unsheared: there the displacement is raised, so that a
belt that stands tends to full sliding in every motion.

A force is returned as a resistance: with k = tau A / |s| of each patch the sums of k, k x, k y
and k (x^2 + y^2) give force, moment and their steepest slope alike.

Assumptions: level ground, uniform pressure, steady motion while a patch is in contact.
References: [1] Focchi et al. (2025). [2] Wong, Theory of Ground Vehicles, shear displacement.

Linearly implicit steps of a vehicle on a soil that resists with k (belt - track).

The resistance k = tau A / |s| of a patch grows without bound where the shear velocity s vanishes:
explicit steps of any size chatter there. A step of length h from the state v = (motion, belts),
with F(v) its rates and A(v) their drag, the secant that the sums of k give for nothing:
    v_m = v + (h/2) (1 + (h/2) A)^-1 F(v)                 middle of the step, linearly implicit
    dz/dt = F(v_m) - A(v_m) z,  z(0) = v - v_m            over the step, z = departure from v_m
    v(h) = v_m + z(h)                                     by an L-stable method of order two
F(v_m) - A z passes through F at the middle, and v(t) - v_m is odd there but for O(h^2): whatever A
is, the error of a step is O(h^3). That makes it a W-method: a Rosenbrock method that does not need
the Jacobian. The secant is not the slope but steeper: with Coulomb friction a (K -> 0, or a belt
that stands) the middle is v^2 / (v + a h/2), which never crosses v = 0, and z is damped at its
rate. So a vehicle comes to rest and stays there; with the slope, which is zero while a
patch slides, the step would be explicit.

Assumptions: all that A leaves out (rolling resistance, turning of the axes) changes slowly.
References: [1] Hairer, Wanner, Solving Ordinary Differential Equations II, IV.7. [2] Verwer,
Spee, Blom, Hundsdorfer, "A second-order Rosenbrock method applied to photochemical dispersion
problems", SIAM J. Sci. Comput. 20 (1999).

A tracked vehicle on patches of soil, driven by its sprocket speeds or by their torques.

Equations (F = Focchi et al. 2025 section 2.1; symbols in NOTATION.md):
    m (dv_x/dt - w v_y) = F_L + F_R - R_L - R_R                  F (11)
    m (dv_y/dt + w v_x) = F_y
    I dw/dt             = M - (B/2) (R_R - R_L)
    (J / r^2) db_k/dt   = torque_k / r - F_k,   b_k = r omega_k   driven by torques, k = L, R
F_k, F_y and M are sums over the patches (`track_patches`); driven by speeds, b_k is given. F (11)
prints the sum of R_R and R_L in the yaw equation, and F (22) a resistance along the motion.

Two integrators:
    rosenbrock  linearly implicit, second order (`physics/patches_on_level_ground.py`): no chatter.
    euler       explicit, the pose with the new velocities, as published simulators do: velocities
                chatter by up to strength h / m near rolling. Here to be compared with them.

Assumptions: planar motion, no load transfer, parameters constant over one control step.
References: [1] Focchi et al. (2025).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import exponential, rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import (
    Coefficients,
    DriveLimits,
    Loads,
    Motion,
    coefficients,
    drive_limits,
    track_speeds,
)
from tracked_env.physics.parameters import row_parameters

BELT_SPEED_FLOOR = 1e-6  # [m/s] a slower belt counts as this fast: keeps 1/0 out of the time
SHEAR_SPEED_FLOOR = 1e-9  # [m/s] added in squares to |s|: keeps 0/0 out at exact rolling
HISTORY_TURN = 4.0 * math.pi  # [rad] two whole turns in contact: no history is left
HISTORY_RISE = 0.1  # [1/rad] extra displacement over half a track length, beyond HISTORY_TURN
TURN_LIMIT = 1e5  # [rad] larger rotations add nothing, and would lose digits
SMALLEST_TURN = 1e-150  # [rad] below it sin(x)/x is 1
COLUMN_LIMIT = 64  # [-] patches along a track
_WIDE = 8  # lanes are filled up to a multiple of this: the vectors of the processor
LANES = 4 * COLUMN_LIMIT

# Rows of the scratch array: one lane per side, half of the rows, and column.
(
    _TIME, _SINE, _VERSINE, _LATERAL, _FORWARD, _BELT, _STRENGTH, _MIRROR, _EXTRA, _X,
    _MODULUS, _K, _KY, _KYY,
) = range(14)  # fmt: skip
SCRATCH_ROWS = 14


class Patches(NamedTuple):
    """How each track is divided; the same for every vehicle of a batch."""

    columns: NDArray[np.float64]  # (C,) middle of a patch over half the contact length, entry first
    rows: NDArray[np.float64]  # (H,) its distance from the centre line over the track width
    weights: NDArray[np.float64]  # (H,) 1, or 1/2 for the middle row, which counts twice


class Contact(NamedTuple):
    """What the shear of a vehicle's soil needs, the motion apart."""

    half_length: float  # [m] l
    half_gauge: float  # [m] B/2
    track_width: float  # [m] w
    strength: float  # [N] c A + N tan(phi) of one patch
    inverse_modulus: float  # [1/m] 1/K


class Resistance(NamedTuple):
    """Sums over patches of k = tau A / |s| [N s/m], the sides apart where belts enter."""

    left: float  # [N s/m] sum of k
    right: float  # [N s/m]
    left_arm: float  # [N s] sum of k y
    right_arm: float  # [N s]
    forward: float  # [N s] sum of k x, both sides
    polar: float  # [N m s] sum of k (x^2 + y^2), both sides


def make_patches(along: int = 10, across: int = 4) -> Patches:
    """Divide each track into `along` x `across` equal patches, forces at their middles.

    Raises ValueError unless both are whole numbers in [1, COLUMN_LIMIT].
    """
    for name, value in (("along", along), ("across", across)):
        if value != int(value) or not 1 <= value <= COLUMN_LIMIT:
            raise ValueError(
                f"patches {name} the track = {value!r}; must be a whole number in "
                f"[1, {COLUMN_LIMIT}]. Did you pass a length?"
            )
    columns = 1.0 - (2.0 * np.arange(along) + 1.0) / along
    half = (int(across) + 1) // 2
    rows = (np.arange(half) + 0.5 * (1 - across % 2)) / across
    weights = np.ones(half)
    if across % 2:
        weights[0] = 0.5
    columns = 0.5 * (columns - columns[::-1])  # exactly antisymmetric
    return Patches(np.ascontiguousarray(columns), rows, weights)


@formula
def patch_count(patches):
    """Patches of one track, as their weights have it [-]."""
    total = 0.0
    for weight in patches.weights:
        total += 2.0 * weight
    return total * patches.columns.size


@formula
def _place(w, belt, half_length, patches, base, mirror):
    """Lanes base .. base + C - 1: where the patches of one half of a side are."""
    ahead = belt >= 0.0  # which end of the track is the first to touch the soil
    speed = max(abs(belt), BELT_SPEED_FLOOR)
    moving = abs(belt) / speed  # 1, or less below the floor: a belt that stands has no first end
    for c in range(patches.columns.size):
        position = patches.columns[c]
        w[_X, base + c] = (position if ahead else -position) * half_length
        w[_TIME, base + c] = (1.0 - position * moving) * half_length / speed
        w[_BELT, base + c] = belt
        w[_MIRROR, base + c] = mirror


@formula
def _columns(w, lanes, motion, belt_left, belt_right, contacts, patches):
    """All that does not depend on the row: positions, times and rotations."""
    count = patches.columns.size
    for side in range(2):
        belt = belt_right if side else belt_left
        contact = contacts[1] if side else contacts[0]
        arm = -contact.half_gauge if side else contact.half_gauge
        forward = motion.v_x - motion.yaw_rate * arm
        for half in range(2):
            base = (2 * side + half) * count
            _place(w, belt, contact.half_length, patches, base, 1.0 if side == half else -1.0)
            for c in range(base, base + count):
                w[_FORWARD, c] = forward
                w[_STRENGTH, c] = contact.strength
                w[_MODULUS, c] = contact.inverse_modulus
    for lane in range(4 * count, lanes):
        for row in range(_K):
            w[row, lane] = 0.0
    rise = HISTORY_RISE * contacts[0].half_length
    for lane in range(lanes):
        turn = min(max(motion.yaw_rate * w[_TIME, lane], -TURN_LIMIT), TURN_LIMIT)
        half_turn = 0.5 * turn
        cosine, sine = rotation(half_turn)
        small = abs(half_turn) < SMALLEST_TURN
        ratio = 1.0 if small else sine / (1.0 if small else half_turn)
        w[_SINE, lane] = ratio * cosine  # S
        w[_VERSINE, lane] = 0.5 * turn * ratio * ratio  # th C
        w[_LATERAL, lane] = motion.v_y + motion.yaw_rate * w[_X, lane]
        w[_EXTRA, lane] = rise * max(abs(turn) - HISTORY_TURN, 0.0)
        w[_K, lane] = 0.0
        w[_KY, lane] = 0.0
        w[_KYY, lane] = 0.0


@formula
def _row(w, lanes, offset, weight, yaw_rate):
    """Add the patches at `offset` [m] from the centre lines, outside on one half, inside on
    the other."""
    for lane in range(lanes):
        y = offset * w[_MIRROR, lane]
        b = w[_FORWARD, lane] - yaw_rate * y
        lateral, belt = w[_LATERAL, lane], w[_BELT, lane]
        slip = b - belt
        sine, versine = w[_SINE, lane], w[_VERSINE, lane]
        j_x = w[_TIME, lane] * (b * sine - belt - lateral * versine)
        j_y = w[_TIME, lane] * (b * versine + lateral * sine)
        j = math.sqrt(j_x * j_x + j_y * j_y) + w[_EXTRA, lane]
        speed = math.sqrt(slip * slip + lateral * lateral + SHEAR_SPEED_FLOOR * SHEAR_SPEED_FLOOR)
        mobilised = 1.0 - exponential(-j * w[_MODULUS, lane])
        k = weight * w[_STRENGTH, lane] * mobilised / speed
        w[_K, lane] += k
        w[_KY, lane] += k * y
        w[_KYY, lane] += k * y * y


@formula
def _pair(w, c, base, count, arm):
    """Sums over both halves of columns c and its mirror: (k, k x, k y, k (x^2 + y^2))."""
    d = count - 1 - c
    k1, k2 = w[_K, base + c] + w[_K, base + count + c], w[_K, base + d] + w[_K, base + count + d]
    y1 = w[_KY, base + c] + w[_KY, base + count + c]
    y2 = w[_KY, base + d] + w[_KY, base + count + d]
    yy1 = w[_KYY, base + c] + w[_KYY, base + count + c]
    yy2 = w[_KYY, base + d] + w[_KYY, base + count + d]
    x1, x2 = w[_X, base + c], w[_X, base + d]
    k, ky = k1 + k2, y1 + y2
    polar = k1 * x1 * x1 + k2 * x2 * x2 + (yy1 + yy2) + arm * (2.0 * ky + arm * k)
    half = 0.5 if c == d else 1.0  # the middle column is its own mirror
    return half * k, half * (k1 * x1 + k2 * x2), half * (ky + arm * k), half * polar


@formula
def resistance(w, motion, belt_left, belt_right, contact, patches):
    """Resistance of one soil under both tracks to `motion` with belts at r omega [m/s]."""
    return tracks_resistance(w, motion, belt_left, belt_right, (contact, contact), patches)


@formula
def tracks_resistance(w, motion, belt_left, belt_right, contacts, patches):
    """Resistance of the soils to `motion`; contacts: under the left and the right track.

    The contacts differ in soil, not in geometry.
    w: scratch (SCRATCH_ROWS, LANES). Sums run over pairs of columns that mirror each other, so
    that mirrored motions give mirrored sums to the last bit.
    """
    count = patches.columns.size
    lanes = (4 * count + _WIDE - 1) // _WIDE * _WIDE
    contact = contacts[0]
    _columns(w, lanes, motion, belt_left, belt_right, contacts, patches)
    for row in range(patches.rows.size):
        offset = patches.rows[row] * contact.track_width
        _row(w, lanes, offset, patches.weights[row], motion.yaw_rate)
    left, right, left_arm, right_arm = 0.0, 0.0, 0.0, 0.0
    forward, polar = 0.0, 0.0
    for c in range((count + 1) // 2):
        k_l, kx_l, ky_l, polar_l = _pair(w, c, 0, count, contact.half_gauge)
        k_r, kx_r, ky_r, polar_r = _pair(w, c, 2 * count, count, -contact.half_gauge)
        left += k_l
        right += k_r
        left_arm += ky_l
        right_arm += ky_r
        forward += kx_l + kx_r
        polar += polar_l + polar_r
    return Resistance(left, right, left_arm, right_arm, forward, polar)


GAMMA = 1.0 - math.sqrt(0.5)  # [-] of the method: L-stable with the exact Jacobian


class Belts(NamedTuple):
    """One number for each side: belt speeds r omega [m/s], their rates, or torques [N m]."""

    left: float
    right: float


class Rates(NamedTuple):
    """What changes during a step."""

    v_x: float  # [m/s^2] in body axes
    v_y: float  # [m/s^2]
    yaw_rate: float  # [rad/s^2]
    left: float  # [m/s^2] of the left belt
    right: float  # [m/s^2]


@formula
def damped(r, rates, k, inverse_belt_mass, duration):
    """(1 - duration A)^-1 rates, where A is the linear drag of the soil's resistance r.

    The belts are eliminated first: each is coupled to the body only.
    """
    give_left = 1.0 / (1.0 + duration * inverse_belt_mass * r.left)
    give_right = 1.0 / (1.0 + duration * inverse_belt_mass * r.right)
    s_left, s_right = r.left * give_left, r.right * give_right
    a_left, a_right = r.left_arm * give_left, r.right_arm * give_right
    mass = 1.0 / k.inverse_mass + duration * (s_left + s_right)
    side = 1.0 / k.inverse_mass + duration * (r.left + r.right)
    polar = r.polar - duration * inverse_belt_mass * (a_left * r.left_arm + a_right * r.right_arm)
    turn = 1.0 / k.inverse_inertia + duration * polar
    arm, shift = duration * (a_left + a_right), duration * r.forward
    push = rates.v_x / k.inverse_mass + duration * (s_left * rates.left + s_right * rates.right)
    slide = rates.v_y / k.inverse_mass
    twist = rates.yaw_rate / k.inverse_inertia
    twist -= duration * (a_left * rates.left + a_right * rates.right)
    yaw = (twist + arm * push / mass - shift * slide / side) / (
        turn - arm * arm / mass - shift * shift / side
    )
    forward = (push + arm * yaw) / mass
    pull = duration * inverse_belt_mass
    left = give_left * (rates.left + pull * (r.left * forward - r.left_arm * yaw))
    right = give_right * (rates.right + pull * (r.right * forward - r.right_arm * yaw))
    return Rates(forward, (slide - shift * yaw) / side, yaw, left, right)


@formula
def pushed(motion, rates, duration):
    """Motion after `duration` [s] at constant rates."""
    return Motion(
        motion.v_x + duration * rates.v_x,
        motion.v_y + duration * rates.v_y,
        motion.yaw_rate + duration * rates.yaw_rate,
    )


@formula
def combined(first, second, a, b):
    """a first + b second, of rates."""
    return Rates(
        a * first.v_x + b * second.v_x,
        a * first.v_y + b * second.v_y,
        a * first.yaw_rate + b * second.yaw_rate,
        a * first.left + b * second.left,
        a * first.right + b * second.right,
    )


@formula
def departure(r, first, rates, k, inverse_belt_mass, h):
    """What motion and belts are away from the middle of the step at its end.

    Solves dz/dt = rates - A z, z(0) = -(h/2) first, A of the middle, by an L-stable method of
    order two: z(h) = P [a z(0) + g h rates + P (b z(0) + (1 - g) h rates)], P = (1 + g h A)^-1.
    """
    back = -0.5 * h
    a, b = (2.0 * GAMMA - 1.0) / GAMMA, (1.0 - GAMMA) / GAMMA
    inner = combined(first, rates, b * back, (1.0 - GAMMA) * h)
    inner = damped(r, inner, k, inverse_belt_mass, GAMMA * h)
    outer = combined(first, rates, a * back, GAMMA * h)
    return damped(r, combined(outer, inner, 1.0, 1.0), k, inverse_belt_mass, GAMMA * h)


FADE = 0.1  # [-] share of the top speed over which the driving torque fades to nothing
SPEED_DRIVEN = 0.0  # [1/kg] inverse belt mass r^2 / J where the belt's speed is given


class Pose(NamedTuple):
    """Where the vehicle is, world frame; heading not wrapped, with its cosine and sine."""

    x: float  # [m]
    y: float  # [m]
    yaw: float  # [rad]
    cosine: float  # [-]
    sine: float  # [-]


class TrackedVehicle(NamedTuple):
    """A vehicle on the soils under its two tracks, for one control step."""

    k: Coefficients
    drive: DriveLimits
    contacts: tuple[Contact, Contact]  # left, right
    resistances: tuple[float, float]  # [N] mu_l N of the left and the right track
    inverse_belt_mass: float  # [1/kg] r^2 / J, or SPEED_DRIVEN


class Moved(NamedTuple):
    """The end of a step, with the loads and accelerations there."""

    pose: Pose
    motion: Motion
    belts: Belts
    loads: Loads
    rates: Rates


@formula
def contact_of(p, k, drive, patches):
    """Contact from parameters, coefficients and drive limits: the soil's strength is shared."""
    return Contact(
        0.5 * p.contact_length,
        k.half_gauge,
        p.track_width,
        drive.effort_maximum / patch_count(patches),
        1.0 / p.shear_deformation_modulus,
    )


@formula
def on_one_soil(k, drive, contact, inverse_belt_mass):
    """TrackedVehicle with the same soil under both tracks."""
    return TrackedVehicle(
        k, drive, (contact, contact), (k.resistance, k.resistance), inverse_belt_mass
    )


@formula
def loads_of(r, motion, belts, k):
    """Loads on the vehicle from the resistance r of one soil under both tracks."""
    return tracks_loads(r, motion, belts, k, (k.resistance, k.resistance))


@formula
def tracks_loads(r, motion, belts, k, resistances):
    """Loads on the vehicle from the soil's resistance r; the turning moment is the whole one.

    resistances [N]: the largest motion resistances of the left and the right track.
    """
    left = r.left * (belts.left - motion.v_x) + r.left_arm * motion.yaw_rate
    right = r.right * (belts.right - motion.v_x) + r.right_arm * motion.yaw_rate
    lateral = -((r.left + r.right) * motion.v_y + r.forward * motion.yaw_rate)
    pushed = r.left_arm * (motion.v_x - belts.left) + r.right_arm * (motion.v_x - belts.right)
    turned = r.polar * motion.yaw_rate + r.forward * motion.v_y
    track_left, track_right = track_speeds(motion, k.half_gauge)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    resistance_left = soil.resisting(track_left, left, resistances[0], inverse_width)
    resistance_right = soil.resisting(track_right, right, resistances[1], inverse_width)
    moment = (pushed - turned) - k.half_gauge * (resistance_right - resistance_left)
    return Loads(left, right, resistance_left, resistance_right, lateral, moment)


@formula
def driving_torque(torque, belt, inverse_belt_limit):
    """Torque [N m] that a drive gives at belt speed r omega [m/s]: fades near its top speed."""
    speed = abs(belt) * inverse_belt_limit if belt * torque > 0.0 else 0.0
    return torque * min(max((1.0 - speed) / FADE, 0.0), 1.0)


@formula
def rates_of(loads, motion, belts, torques, k, drive, inverse_belt_mass):
    """Rates from the loads; inverse_belt_mass r^2 / J [1/kg], or SPEED_DRIVEN."""
    left = driving_torque(torques.left, belts.left, drive.inverse_belt_limit) * k.inverse_radius
    right = driving_torque(torques.right, belts.right, drive.inverse_belt_limit) * k.inverse_radius
    push = (loads.effort_left + loads.effort_right) - (
        loads.resistance_left + loads.resistance_right
    )
    return Rates(
        push * k.inverse_mass + motion.yaw_rate * motion.v_y,
        loads.lateral_force * k.inverse_mass - motion.yaw_rate * motion.v_x,
        loads.turning_moment * k.inverse_inertia,
        inverse_belt_mass * (left - loads.effort_left),
        inverse_belt_mass * (right - loads.effort_right),
    )


@formula
def _moved_pose(pose, before, after, h):
    """Pose after a step of length h [s] from the velocities at both ends."""
    turn = 0.5 * h * (before.yaw_rate + after.yaw_rate)
    half_c, half_s = rotation(0.5 * turn)
    v_x, v_y = 0.5 * (before.v_x + after.v_x), 0.5 * (before.v_y + after.v_y)
    ahead, aside = h * (half_c * v_x - half_s * v_y), h * (half_s * v_x + half_c * v_y)
    c, s = half_c * half_c - half_s * half_s, 2.0 * half_c * half_s
    return Pose(
        pose.x + (pose.cosine * ahead - pose.sine * aside),
        pose.y + (pose.sine * ahead + pose.cosine * aside),
        pose.yaw + turn,
        pose.cosine * c - pose.sine * s,
        pose.sine * c + pose.cosine * s,
    )


@formula
def _stage(belts, command, rates, h, driven):
    """Belts of a later stage: moved by their torques, else at the commanded speed."""
    left = belts.left + h * rates.left if driven else command.left
    right = belts.right + h * rates.right if driven else command.right
    return Belts(left, right)


@formula
def followed(command, demand, decay):
    """What the drives give after a sub-step: the lag leaves `decay` of what was missing."""
    return Belts(
        demand.left + decay * (command.left - demand.left),
        demand.right + decay * (command.right - demand.right),
    )


@formula
def _euler(pose, motion, rates, h):
    """Motion, and pose with the new velocities in the old heading, after an explicit step."""
    new = pushed(motion, rates, h)
    cosine, sine = rotation(pose.yaw)
    x = pose.x + h * (cosine * new.v_x - sine * new.v_y)
    y = pose.y + h * (sine * new.v_x + cosine * new.v_y)
    return new, Pose(x, y, pose.yaw + h * new.yaw_rate, cosine, sine)


@formula
def advance(w, start, command, demand, decay, substeps, h, vehicle, patches, euler):
    """Advance one vehicle by `substeps` steps of h [s] and settle the loads of the end.

    w: scratch of `track_patches`. start: (pose, motion, belts). command, demand: what the drives
    give now and what is asked of them, torques [N m] or belt speeds [m/s]; decay [-] what the lag
    leaves of the difference after one sub-step, 0 without lag. vehicle: TrackedVehicle.
    Returns Moved, and what the drives give in the end.
    """
    pose, motion, belts = start
    k, drive, inverse_belt_mass = vehicle.k, vehicle.drive, vehicle.inverse_belt_mass
    driven = inverse_belt_mass > SPEED_DRIVEN
    if decay == 0.0:
        command = demand
    coming = followed(command, demand, decay)
    belts = belts if driven else command
    stage_motion, stage_belts, given = motion, belts, command
    first = Rates(0.0, 0.0, 0.0, 0.0, 0.0)
    stages = 1 if euler else 2
    stage = 0
    loads, rates = Loads(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), first
    for evaluation in range(stages * substeps + 1):
        r = tracks_resistance(
            w, stage_motion, stage_belts.left, stage_belts.right, vehicle.contacts, patches
        )
        loads = tracks_loads(r, stage_motion, stage_belts, k, vehicle.resistances)
        rates = rates_of(loads, stage_motion, stage_belts, given, k, drive, inverse_belt_mass)
        if evaluation == stages * substeps:
            break
        if stages == 2 and stage == 0:
            first = damped(r, rates, k, inverse_belt_mass, 0.5 * h)
            given = followed(command, coming, 0.5)
            stage_motion = pushed(motion, first, 0.5 * h)
            stage_belts = _stage(belts, given, first, 0.5 * h, driven)
            stage = 1
            continue
        if euler:
            motion, pose = _euler(pose, motion, rates, h)
            belts = _stage(belts, coming, rates, h, driven)
        else:
            away = departure(r, first, rates, k, inverse_belt_mass, h)
            moved = pushed(stage_motion, away, 1.0)
            pose = _moved_pose(pose, motion, moved, h)
            motion = moved
            belts = _stage(stage_belts, coming, away, 1.0, driven)
        command = coming
        coming = followed(command, demand, decay)
        stage_motion, stage_belts, given = motion, belts, command
        stage = 0
    return Moved(pose, motion, belts, loads, rates), command


@loop
def hold_speeds(states, sprocket_speeds, parameters, patches, steps, h, euler, loads):
    """Advance N vehicles by `steps` steps of h [s] with their sprocket speeds held.

    states (N, 6): x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s], overwritten.
    sprocket_speeds (N, 2) [rad/s] left, right. parameters (N, PARAMETER_ROWS). loads (N, 6) gets
    the Loads at the end. Row i does not depend on the others.
    """
    w = np.empty((SCRATCH_ROWS, LANES))
    for i in range(states.shape[0]):
        p = row_parameters(parameters, i, 0)
        k = coefficients(p, False)
        drive = drive_limits(p)
        contact = contact_of(p, k, drive, patches)
        cosine, sine = rotation(states[i, 2])
        pose = Pose(states[i, 0], states[i, 1], states[i, 2], cosine, sine)
        motion = Motion(states[i, 3], states[i, 4], states[i, 5])
        left, right = sprocket_speeds[i, 0], sprocket_speeds[i, 1]
        belts = Belts(left * p.sprocket_radius, right * p.sprocket_radius)
        moved, _ = advance(
            w, (pose, motion, belts), belts, belts, 0.0, steps, h,
            on_one_soil(k, drive, contact, SPEED_DRIVEN), patches, euler,
        )  # fmt: skip
        states[i, 0], states[i, 1], states[i, 2] = moved.pose.x, moved.pose.y, moved.pose.yaw
        states[i, 3], states[i, 4] = moved.motion.v_x, moved.motion.v_y
        states[i, 5] = moved.motion.yaw_rate
        for row in range(6):
            loads[i, row] = moved.loads[row]
