"""A tracked vehicle on patches of level soil, driven by its sprocket speeds or by their torques.

Equations (F = Focchi et al. 2025 section 2.1; symbols in NOTATION.md):
    m (dv_x/dt - w v_y) = F_L + F_R - R_L - R_R                  F (11)
    m (dv_y/dt + w v_x) = F_y
    I dw/dt             = M - (B/2) (R_R - R_L)
    (J / r^2) db_k/dt   = torque_k / r - F_k,   b_k = r omega_k   driven by torques, k = L, R
F_k, F_y and M are sums over the patches; driven by speeds, b_k is given. F (11) prints the sum of
R_R and R_L in the yaw equation, and F (22) a resistance along the motion.

The resistance k = tau A / |s| of a patch grows without bound where the shear velocity s vanishes:
explicit steps of any size chatter there. Two integrators:
    euler       explicit, the pose with the new velocities, as published simulators do: velocities
                chatter by up to strength h / m near rolling. Here to be compared with them.
    rosenbrock  linearly implicit, second order, without chatter. From the state v = (motion, belts)
                with its rates F(v) and their drag A(v), the secant that the sums of k give:
        v_m = v + (h/2) (1 + (h/2) A)^-1 F(v)             middle of the step, linearly implicit
        dz/dt = F(v_m) - A(v_m) z,  z(0) = v - v_m        over the step, z = departure from v_m
        v(h) = v_m + z(h)                                 by an L-stable method of order two
F(v_m) - A z passes through F at the middle, and v(t) - v_m is odd there but for O(h^2): whatever A
is, the error of a step is O(h^3) (a W-method: no Jacobian needed). The secant is steeper than the
slope: with Coulomb friction a (K -> 0, or a belt that stands) the middle is v^2 / (v + a h/2),
which never crosses v = 0, and z is damped at its rate. So a vehicle comes to rest and stays there.

Assumptions: planar motion, no load transfer, parameters constant over one control step; what A
leaves out (rolling resistance, turning of the axes) changes slowly.
References: [1] Focchi et al. (2025). [2] Hairer, Wanner, Solving Ordinary Differential Equations
II, IV.7. [3] Verwer, Spee, Blom, Hundsdorfer, "A second-order Rosenbrock method applied to
photochemical dispersion problems", SIAM J. Sci. Comput. 20 (1999).
"""

import math
from typing import NamedTuple

import numpy as np

from tracked_env.physics import lumped
from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import Coefficients, DriveLimits, Loads, Motion
from tracked_env.physics.parameters import row_parameters
from tracked_env.physics.patches_on_level_ground import Belts, Contact

FADE = 0.1  # [-] share of the top speed over which the driving torque fades to nothing
SPEED_DRIVEN = 0.0  # [1/kg] inverse belt mass r^2 / J where the belt's speed is given
GAMMA = 1.0 - math.sqrt(0.5)  # [-] of the method: L-stable with the exact Jacobian


class Rates(NamedTuple):
    """What changes during a step."""

    v_x: float  # [m/s^2] in body axes
    v_y: float  # [m/s^2]
    yaw_rate: float  # [rad/s^2]
    left: float  # [m/s^2] of the left belt
    right: float  # [m/s^2]


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


class Drives(NamedTuple):
    """What the drives give and what is asked of them: torques [N m] or belt speeds [m/s]."""

    command: Belts  # at the start of the step
    demand: Belts
    decay: float  # [-] what the lag leaves of the difference after one sub-step, 0 without lag


class Moved(NamedTuple):
    """The end of a step, with the loads and accelerations there."""

    pose: Pose
    motion: Motion
    belts: Belts
    loads: Loads
    rates: Rates


@formula
def on_one_soil(k, drive, contact, inverse_belt_mass):
    """TrackedVehicle with the same soil under both tracks."""
    resistances = (k.resistance, k.resistance)
    return TrackedVehicle(k, drive, (contact, contact), resistances, inverse_belt_mass)


@formula
def loads_of(r, motion, belts, k, resistances):
    """Loads on the vehicle from the soil's resistance r; the turning moment is the whole one.

    resistances [N]: the largest motion resistances of the left and the right track.
    """
    left = r.left * (belts.left - motion.v_x) + r.left_arm * motion.yaw_rate
    right = r.right * (belts.right - motion.v_x) + r.right_arm * motion.yaw_rate
    lateral = -((r.left + r.right) * motion.v_y + r.forward * motion.yaw_rate)
    pulled = r.left_arm * (motion.v_x - belts.left) + r.right_arm * (motion.v_x - belts.right)
    turned = r.polar * motion.yaw_rate + r.forward * motion.v_y
    track_left, track_right = lumped.track_speeds(motion, k.half_gauge)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    resistance_left = soil.resisting(track_left, left, resistances[0], inverse_width)
    resistance_right = soil.resisting(track_right, right, resistances[1], inverse_width)
    moment = (pulled - turned) - k.half_gauge * (resistance_right - resistance_left)
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
    effort = loads.effort_left + loads.effort_right
    push = effort - (loads.resistance_left + loads.resistance_right)
    return Rates(
        push * k.inverse_mass + motion.yaw_rate * motion.v_y,
        loads.lateral_force * k.inverse_mass - motion.yaw_rate * motion.v_x,
        loads.turning_moment * k.inverse_inertia,
        inverse_belt_mass * (left - loads.effort_left),
        inverse_belt_mass * (right - loads.effort_right),
    )


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
    reduced = turn - arm * arm / mass - shift * shift / side
    yaw = (twist + arm * push / mass - shift * slide / side) / reduced
    forward = (push + arm * yaw) / mass
    pull = duration * inverse_belt_mass
    left = give_left * (rates.left + pull * (r.left * forward - r.left_arm * yaw))
    right = give_right * (rates.right + pull * (r.right * forward - r.right_arm * yaw))
    return Rates(forward, (slide - shift * yaw) / side, yaw, left, right)


@formula
def pushed(motion, rates, duration):
    """Motion after `duration` [s] at constant rates."""
    v_x, v_y = motion.v_x + duration * rates.v_x, motion.v_y + duration * rates.v_y
    return Motion(v_x, v_y, motion.yaw_rate + duration * rates.yaw_rate)


@formula
def combined(first, second, a, b):
    """a first + b second, of rates."""
    v_x, v_y = a * first.v_x + b * second.v_x, a * first.v_y + b * second.v_y
    turn = a * first.yaw_rate + b * second.yaw_rate
    left, right = a * first.left + b * second.left, a * first.right + b * second.right
    return Rates(v_x, v_y, turn, left, right)


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
def _stage(belts, command, rates, h, by_torque):
    """Belts of a later stage: moved by their torques, else at the commanded speed."""
    left = belts.left + h * rates.left if by_torque else command.left
    right = belts.right + h * rates.right if by_torque else command.right
    return Belts(left, right)


@formula
def followed(command, demand, decay):
    """What the drives give after a sub-step: the lag leaves `decay` of what was missing."""
    left = demand.left + decay * (command.left - demand.left)
    return Belts(left, demand.right + decay * (command.right - demand.right))


@formula
def _euler(pose, motion, rates, h):
    """Motion, and pose with the new velocities in the old heading, after an explicit step."""
    new = pushed(motion, rates, h)
    cosine, sine = rotation(pose.yaw)
    x = pose.x + h * (cosine * new.v_x - sine * new.v_y)
    y = pose.y + h * (sine * new.v_x + cosine * new.v_y)
    return new, Pose(x, y, pose.yaw + h * new.yaw_rate, cosine, sine)


@formula
def advance(w, start, drives, substeps, h, vehicle, patches, euler):
    """Advance one vehicle by `substeps` steps of h [s] and settle the loads of the end.

    w: scratch of `resistance`. start: (pose, motion, belts). drives: Drives. vehicle:
    TrackedVehicle. euler: explicit, or the Rosenbrock method. Returns Moved, and what the drives
    give in the end.
    """
    pose, motion, belts = start
    command, demand, decay = drives
    k, drive, inverse_belt_mass = vehicle.k, vehicle.drive, vehicle.inverse_belt_mass
    by_torque = inverse_belt_mass > SPEED_DRIVEN
    if decay == 0.0:
        command = demand
    coming = followed(command, demand, decay)
    belts = belts if by_torque else command
    stage_motion, stage_belts, acting = motion, belts, command
    first = Rates(0.0, 0.0, 0.0, 0.0, 0.0)
    loads, rates = Loads(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), first
    evaluations = substeps if euler else 2 * substeps
    for evaluation in range(evaluations + 1):
        r = level.resistance(w, stage_motion, stage_belts, vehicle.contacts, patches)
        loads = loads_of(r, stage_motion, stage_belts, k, vehicle.resistances)
        rates = rates_of(loads, stage_motion, stage_belts, acting, k, drive, inverse_belt_mass)
        if evaluation == evaluations:
            break
        if not euler and evaluation % 2 == 0:
            first = damped(r, rates, k, inverse_belt_mass, 0.5 * h)
            acting = followed(command, coming, 0.5)
            stage_motion = pushed(motion, first, 0.5 * h)
            stage_belts = _stage(belts, acting, first, 0.5 * h, by_torque)
            continue
        if euler:
            motion, pose = _euler(pose, motion, rates, h)
            belts = _stage(belts, coming, rates, h, by_torque)
        else:
            away = departure(r, first, rates, k, inverse_belt_mass, h)
            moved = pushed(stage_motion, away, 1.0)
            pose = _moved_pose(pose, motion, moved, h)
            motion = moved
            belts = _stage(stage_belts, coming, away, 1.0, by_torque)
        command = coming
        coming = followed(command, demand, decay)
        stage_motion, stage_belts, acting = motion, belts, command
    return Moved(pose, motion, belts, loads, rates), command


@loop
def hold_speeds(states, sprocket_speeds, parameters, patches, steps, h, euler, loads):
    """Advance N vehicles by `steps` steps of h [s] with their sprocket speeds held.

    states (N, 6): x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s], overwritten.
    sprocket_speeds (N, 2) [rad/s] left, right. parameters (N, PARAMETER_ROWS). loads (N, 6) gets
    the Loads at the end. Row i does not depend on the others.
    """
    w = np.empty((level.SCRATCH_ROWS, level.LANES))
    for i in range(states.shape[0]):
        p = row_parameters(parameters, i, 0)
        k, drive = lumped.coefficients(p, False), lumped.drive_limits(p)
        contact = level.contact_of(p, k, drive, patches)
        vehicle = on_one_soil(k, drive, contact, SPEED_DRIVEN)
        cosine, sine = rotation(states[i, 2])
        pose = Pose(states[i, 0], states[i, 1], states[i, 2], cosine, sine)
        motion = Motion(states[i, 3], states[i, 4], states[i, 5])
        radius = p.sprocket_radius
        belts = Belts(sprocket_speeds[i, 0] * radius, sprocket_speeds[i, 1] * radius)
        drives = Drives(belts, belts, 0.0)
        moved, _ = advance(w, (pose, motion, belts), drives, steps, h, vehicle, patches, euler)
        for row in range(3):
            states[i, row], states[i, 3 + row] = moved.pose[row], moved.motion[row]
        for row in range(6):
            loads[i, row] = moved.loads[row]
