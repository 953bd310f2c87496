"""Laws of weak drives, of light vehicles on firm floors, and of light vehicles on uneven ground.

Weak drives are those of the heavy vehicle of `soils`, the others are for the nominal vehicle of
[1]. On floors, friction mu = tan(phi) is drawn over what a rubber track meets between wet ice and
dry concrete. On uneven ground (`tracked_env/Terrain-v0`) a law draws a plane and eight sinusoids,
which are added to the terrain that all share; plants on level ground have the same vehicles and
soils without them. Heights and wavelengths are over the contact length l, so that hills mean the
same to vehicles of every size. With a friction below the grade a vehicle slides down whatever it
does, so it is drawn above. Where only mass and inertia are drawn the load sits in the centre of
mass; `slope-payload` has a box that shifts it.

References: [1] Focchi et al., "Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles" (2025), Table 2 and section 4.
"""

import math

from tracked_env.physics.jit import formula
from tracked_env.physics.rigid_body import Inertia, with_payload
from tracked_env.streams import integer, random, uniform
from tracked_env.uncertainty.drawing_laws import (
    LOAD,
    ROW,
    border,
    hills,
    law,
    line,
    patch,
    ramp,
    slope,
)
from tracked_env.uncertainty.soils import (
    OFTEN,
    OFTEN_CHANGES,
    firm_ground,
    load_step,
    next_resistances,
)

GAIN_PERIOD = 4.0  # [s] from one pair of gains to the next
GAIN_CHANGES = 8  # [-] of each drive, in an episode
FLICKER_PERIOD, FLICKER_CHANGES = 1.5, 19  # [s], [-] of one drive that fails and comes back
FLOOR_PERIOD = 3.0  # [s] from one floor to the other
FLOOR_CHANGES = 12  # [-] in an episode
GROUND_PERIOD, GROUND_CHANGES = 2.0, 14  # [s], [-] of slippery and rough ground in turn
BOX_PERIOD, BOX_CHANGES = 4.5, 6  # [s], [-] of a box that is put down and taken up
# Parameters that change together: of drives, of floors, and by a load that is put on.
GAINS = (ROW.actuator_gain_left, ROW.actuator_gain_right)
FLOOR = (ROW.friction_angle, ROW.shear_deformation_modulus, ROW.longitudinal_resistance)
CENTRE_OF_MASS = (ROW.centre_of_mass_x, ROW.centre_of_mass_y, ROW.centre_of_mass_z)
PAYLOAD = (*LOAD, *CENTRE_OF_MASS, ROW.roll_inertia_ratio, ROW.pitch_inertia_ratio)


@law("slow-drive")
def _slow_drive(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose motors answer late."""
    firm_ground(rng, nominal, truth)
    truth.drive_time_constant = uniform(rng, 0.15, 0.3)  # =U(0.15, 0.3)


@law("weak-actuator")
def _weak_actuator(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose drives, one or both, give less torque than commanded."""
    firm_ground(rng, nominal, truth)
    weak = integer(rng, 3)  # the left drive, the right drive or both, with equal odds
    left, right = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7) each
    if weak != 1:
        truth.actuator_gain_left = left
    if weak != 0:
        truth.actuator_gain_right = right


@law("actuator-fault")
def _actuator_fault(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle, one of whose drives loses a part of its torque on the way."""
    firm_ground(rng, nominal, truth)
    start = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    gain = uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7)
    side = ROW.actuator_gain_left if random(rng) < 0.5 else ROW.actuator_gain_right  # odds 1/2
    ramp(changes, (side,), (gain,), start, 0.0)


@law("alternating-gains")
def _alternating_gains(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle; every 4 s, for 32 s, both drives settle at another torque."""
    firm_ground(rng, nominal, truth)
    truth.actuator_gain_left = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    truth.actuator_gain_right = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    for k in range(1, GAIN_CHANGES + 1):
        gains = uniform(rng, 0.4, 1.0), uniform(rng, 0.4, 1.0)  # =U(0.4, 1) each
        ramp(changes, GAINS, gains, k * GAIN_PERIOD, 0.0)


@law("flickering-drive")
def _flickering_drive(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle, one of whose drives fails and comes back every 1.5 s."""
    firm_ground(rng, nominal, truth)
    side = ROW.actuator_gain_left if random(rng) < 0.5 else ROW.actuator_gain_right  # odds 1/2
    for k in range(1, FLICKER_CHANGES + 1):
        gain = uniform(rng, 0.3, 0.5) if k % 2 == 1 else 1.0  # =U(0.3, 0.5)
        ramp(changes, (side,), (gain,), k * FLICKER_PERIOD, 0.0)


@law("alternating-all")
def _alternating_all(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle; every 2.5 s other resistances and other torques of the drives."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        next_resistances(rng, nominal, changes, k * OFTEN)
        gains = uniform(rng, 0.4, 1.0), uniform(rng, 0.4, 1.0)  # =U(0.4, 1) each
        ramp(changes, GAINS, gains, k * OFTEN, 0.0)


@formula
def floor(rng, nominal, truth, lowest):
    """Unknown load, unknown floor or rough ground with a friction of at least `lowest`."""
    truth.mass = nominal.mass * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.inertia = nominal.inertia * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.friction_angle = math.atan(uniform(rng, lowest, 0.8))  # mu =U(lowest, 0.8)
    modulus = nominal.shear_deformation_modulus * uniform(rng, 0.5, 3.0)  # *U(0.5, 3)
    truth.shear_deformation_modulus = modulus
    truth.longitudinal_resistance = uniform(rng, 0.01, 0.05)  # =U(0.01, 0.05)


@law("friction")
def _friction(rng, nominal, path, truth, changes):
    """Unknown vehicle on an unknown floor, constant over the episode."""
    floor(rng, nominal, truth, 0.1)


@formula
def _two_floors(rng, slippery, rough):
    """Friction angles of a slippery floor and a rough one, mu =U(..) each, in either order."""
    low = math.atan(uniform(rng, slippery[0], slippery[1]))
    high = math.atan(uniform(rng, rough[0], rough[1]))
    return (low, high) if random(rng) < 0.5 else (high, low)


@formula
def _border(rng, path, truth, changes, slippery, rough):
    """A border between two floors, edge 0.1 m wide, where the path is at U(0.3, 0.6) of it."""
    first, second = _two_floors(rng, slippery, rough)
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    line(changes, (ROW.friction_angle,), (second,), border(path, time), 0.1)
    truth.friction_angle = first


@law("friction-step")
def _friction_step(rng, nominal, path, truth, changes):
    """The path crosses a border between a slippery floor and a rough one, edge 0.1 m wide."""
    _border(rng, path, truth, changes, (0.1, 0.15), (0.5, 0.8))


@law("friction-drift")
def _friction_drift(rng, nominal, path, truth, changes):
    """The floor gets wet, or dries, slowly: one draw to another, U(0.5, 0.8) of the episode."""
    there = changes.there
    floor(rng, nominal, truth, 0.1)
    floor(rng, nominal, there, 0.1)
    start = path.duration * uniform(rng, 0.1, 0.2)  # =U(0.1, 0.2) of the episode
    duration = path.duration * uniform(rng, 0.5, 0.8)
    friction, modulus = there.friction_angle, there.shear_deformation_modulus
    targets = friction, modulus, there.longitudinal_resistance
    ramp(changes, FLOOR, targets, start, duration)


@law("floor-mixed")
def _floor_mixed(rng, nominal, path, truth, changes):
    """An unknown vehicle on an unknown floor; then a load, and another floor."""
    floor(rng, nominal, truth, 0.1)
    load_step(rng, nominal, path, truth, changes)
    if random(rng) < 0.5:  # border with odds 1/2
        friction_angle = math.atan(uniform(rng, 0.1, 0.8))  # mu =U(0.1, 0.8)
        time = path.duration * uniform(rng, 0.2, 0.8)
        edge = uniform(rng, 0.1, 0.5)
        line(changes, (ROW.friction_angle,), (friction_angle,), border(path, time), edge)


@law("floor-ood")
def _floor_ood(rng, nominal, path, truth, changes):
    """Ice, or soil, outside the ranges of every other set of floors; drives that lag."""
    ice = random(rng) < 0.5
    friction = uniform(rng, 0.05, 0.08) if ice else uniform(rng, 0.9, 1.0)  # mu
    truth.mass = nominal.mass * uniform(rng, 1.6, 2.2)  # *U(1.6, 2.2)
    truth.inertia = nominal.inertia * uniform(rng, 1.6, 2.2)  # *U(1.6, 2.2)
    truth.friction_angle = math.atan(friction)
    modulus = nominal.shear_deformation_modulus * uniform(rng, 4.0, 8.0)  # *U(4, 8)
    truth.shear_deformation_modulus = modulus
    truth.longitudinal_resistance = 0.01 if ice else uniform(rng, 0.06, 0.1)  # =U(0.06, 0.1)
    truth.drive_time_constant = uniform(rng, 0.05, 0.1)  # =U(0.05, 0.1)


@law("alternating-floors")
def _alternating_floors(rng, nominal, path, truth, changes):
    """Every 3 s another floor, for 36 s: a slippery one, a rough one, and back; unknown load."""
    share = uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.mass, truth.inertia = nominal.mass * share, nominal.inertia * share
    first, second = _two_floors(rng, (0.1, 0.15), (0.5, 0.8))
    truth.friction_angle = first
    for k in range(1, FLOOR_CHANGES + 1):
        friction_angle = second if k % 2 == 1 else first
        ramp(changes, (ROW.friction_angle,), (friction_angle,), k * FLOOR_PERIOD, 0.0)


@formula
def _changing_friction(rng, truth, changes, slippery, rough):
    """Every 2 s slippery ground or rough one in turn, mu =U(..) drawn anew each time."""
    odd = 1 if random(rng) < 0.5 else 0  # which comes first
    for k in range(GROUND_CHANGES + 1):
        low, high = slippery if (k + odd) % 2 == 0 else rough
        friction_angle = math.atan(uniform(rng, low, high))
        if k == 0:
            truth.friction_angle = friction_angle
        else:
            ramp(changes, (ROW.friction_angle,), (friction_angle,), k * GROUND_PERIOD, 0.0)


@law("changing-floors")
def _changing_floors(rng, nominal, path, truth, changes):
    """A `friction` vehicle; every 2 s another floor, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.1)
    _changing_friction(rng, truth, changes, (0.1, 0.15), (0.5, 0.8))


@law("slow-floor-drive")
def _slow_floor_drive(rng, nominal, path, truth, changes):
    """A `friction` vehicle whose motors answer late."""
    floor(rng, nominal, truth, 0.1)
    truth.drive_time_constant = uniform(rng, 0.15, 0.3)  # =U(0.15, 0.3)


@formula
def incline(rng, changes, steepest):
    """A plane of unknown grade =U(0, steepest) and direction =U(-pi, pi)."""
    grade = uniform(rng, 0.0, steepest)
    slope(changes, grade, uniform(rng, -math.pi, math.pi))


@formula
def uneven_ground(rng, nominal, changes):
    """A plane of unknown slope with hills on it."""
    length = nominal.contact_length
    incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    height = length * uniform(rng, 0.05, 0.15)  # standard deviation =U(0.05, 0.15) l
    hills(rng, changes, height, 14.0 * length, 3.5 * length)  # wavelengths 14 l to 3.5 l


@law("slope")
def _slope(rng, nominal, path, truth, changes):
    """Unknown vehicle on a plane of unknown slope, constant over the episode."""
    floor(rng, nominal, truth, 0.4)
    incline(rng, changes, 0.3)  # grade =U(0, 0.3)


@law("hills")
def _hills(rng, nominal, path, truth, changes):
    """Unknown vehicle on unknown hills on an unknown slope."""
    floor(rng, nominal, truth, 0.4)
    uneven_ground(rng, nominal, changes)


@law("slope-step")
def _slope_step(rng, nominal, path, truth, changes):
    """On a slope the path crosses a border between slippery and rough ground, edge 0.1 m wide."""
    incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    _border(rng, path, truth, changes, (0.25, 0.35), (0.6, 0.8))


@formula
def _carrying(p, mass, place, size):
    """Parameters PAYLOAD of the vehicle p with a box, see `rigid_body.with_payload`."""
    roll, pitch = p.roll_inertia_ratio * p.inertia, p.pitch_inertia_ratio * p.inertia
    i, shift = with_payload(Inertia(p.mass, roll, pitch, p.inertia), mass, place, size)
    x, y = p.centre_of_mass_x + shift[0], p.centre_of_mass_y + shift[1]
    z = p.centre_of_mass_z + shift[2]
    return i.mass, i.yaw, x, y, z, i.roll / i.yaw, i.pitch / i.yaw


@formula
def box(rng, nominal):
    """Parameters PAYLOAD of the nominal vehicle without a box, and with one that is drawn."""
    length, gauge = nominal.contact_length, nominal.track_gauge
    mass = nominal.mass * uniform(rng, 0.2, 0.5)  # of the box, *U(0.2, 0.5)
    # Its middle from the centre of mass:
    x = length * uniform(rng, -0.3, 0.3)  # ahead =U(-0.3, 0.3) l
    y = gauge * uniform(rng, -0.2, 0.2)  # to the left =U(-0.2, 0.2) B
    z = length * uniform(rng, 0.1, 0.3)  # above =U(0.1, 0.3) l
    edge = length * uniform(rng, 0.2, 0.5)  # a cube, =U(0.2, 0.5) l
    place, size = (x, y, z), (edge, edge, edge)
    return _carrying(nominal, 0.0, place, size), _carrying(nominal, mass, place, size)


@formula
def begin_with(truth, values):
    """The parameters PAYLOAD at the start."""
    truth.mass, truth.inertia = values[:2]
    truth.centre_of_mass_x, truth.centre_of_mass_y, truth.centre_of_mass_z = values[2:5]
    truth.roll_inertia_ratio, truth.pitch_inertia_ratio = values[5:]


@law("slope-payload")
def _slope_payload(rng, nominal, path, truth, changes):
    """On a slope the vehicle takes up or puts down a box that shifts its centre of mass."""
    incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    without, carrying = box(rng, nominal)
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    first, second = (carrying, without) if random(rng) < 0.5 else (without, carrying)
    begin_with(truth, first)
    ramp(changes, PAYLOAD, second, time, 0.0)


@formula
def _soft_patch(rng, nominal, path, truth, changes, first):
    """A soft disc on the path, at U(first, first + 0.2) of the episode; returns place, radius."""
    time = path.duration * (first + uniform(rng, 0.0, 0.2))  # =U(first, first + 0.2)
    place = border(path, time)
    radius = nominal.contact_length * uniform(rng, 1.0, 3.0)  # =U(1, 3) l
    friction = truth.friction_angle * uniform(rng, 0.6, 0.9)  # *U(0.6, 0.9)
    modulus = truth.shear_deformation_modulus * uniform(rng, 3.0, 10.0)  # *U(3, 10)
    resistance = truth.longitudinal_resistance + uniform(rng, 0.05, 0.15)  # +U(0.05, 0.15)
    patch(changes, FLOOR, (friction, modulus, resistance), place, radius, 0.2)
    return place, radius


@law("soft-patches")
def _soft_patches(rng, nominal, path, truth, changes):
    """Hills of unknown stiffness with two soft patches on the path, where tracks sink and slip."""
    floor(rng, nominal, truth, 0.4)
    uneven_ground(rng, nominal, changes)
    one, its = _soft_patch(rng, nominal, path, truth, changes, 0.2)
    other, others = _soft_patch(rng, nominal, path, truth, changes, 0.6)
    stiffness = nominal.ground_stiffness_factor * uniform(rng, 0.5, 1.5)  # *U(0.5, 1.5)
    truth.ground_stiffness_factor = stiffness
    first, second = uniform(rng, 0.2, 0.6), uniform(rng, 0.2, 0.6)  # *U(0.2, 0.6) on each patch
    factor = (ROW.ground_stiffness_factor,)
    patch(changes, factor, (stiffness * first,), one, its, 0.2)
    patch(changes, factor, (stiffness * second,), other, others, 0.2)


@law("hills-ood")
def _hills_ood(rng, nominal, path, truth, changes):
    """Steeper hills, heavier loads and less friction than in any other set of slopes."""
    floor(rng, nominal, truth, 0.4)
    length = nominal.contact_length
    truth.mass = nominal.mass * uniform(rng, 1.5, 2.0)  # *U(1.5, 2)
    truth.inertia = nominal.inertia * uniform(rng, 1.5, 2.0)  # *U(1.5, 2)
    truth.friction_angle = math.atan(uniform(rng, 0.35, 0.4))  # mu =U(0.35, 0.4)
    incline(rng, changes, 0.25)  # grade =U(0, 0.25)
    height = length * uniform(rng, 0.15, 0.2)  # standard deviation =U(0.15, 0.2) l
    hills(rng, changes, height, 14.0 * length, 3.5 * length)  # wavelengths 14 l to 3.5 l


@law("changing-slope")
def _changing_slope(rng, nominal, path, truth, changes):
    """Unknown slope; every 2 s another ground, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.4)
    incline(rng, changes, 0.3)  # grade =U(0, 0.3)
    _changing_friction(rng, truth, changes, (0.4, 0.5), (0.7, 0.9))


@law("changing-hills")
def _changing_hills(rng, nominal, path, truth, changes):
    """Unknown hills; every 2 s another ground, a slippery one and a rough one in turn."""
    floor(rng, nominal, truth, 0.4)
    uneven_ground(rng, nominal, changes)
    _changing_friction(rng, truth, changes, (0.4, 0.5), (0.7, 0.9))


@law("slope-boxes")
def _slope_boxes(rng, nominal, path, truth, changes):
    """A vehicle of `slope` that takes up a box, another one each time, or puts it down, in turn."""
    floor(rng, nominal, truth, 0.4)
    incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    odd = 1 if random(rng) < 0.5 else 0  # whether it begins with a box
    for k in range(BOX_CHANGES + 1):
        without, carrying = box(rng, nominal)
        values = carrying if (k + odd) % 2 == 1 else without
        if k == 0:
            begin_with(truth, values)
        else:
            ramp(changes, PAYLOAD, values, k * BOX_PERIOD, 0.0)
