"""Laws of light vehicles on firm floors: the uncertainty sets of the nominal vehicle of [1].

Friction mu = tan(phi) is drawn over what a rubber track meets between wet ice and dry concrete;
[1] identifies its slip at 0.1, 0.4 and 0.6.

References: [1] Focchi et al., "Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles" (2025), Table 2 and section 4.

Laws of light vehicles on uneven ground: the uncertainty sets of `tracked_env/Terrain-v0`.

A law draws the ground of one vehicle for one episode, which is added to the terrain that all share:
a plane and eight sinusoids (`compiled.slope`, `compiled.hills`). Plants on level ground have the
same vehicles and soils without it. Heights and wavelengths are over the contact length l, so that
hills mean the same to vehicles of every size. Friction is drawn over what climbs the slopes: with
mu below the grade a vehicle slides down whatever it does. Where only mass and inertia are drawn the
load sits in the centre of mass; `slope-payload` has a box that shifts it.

Laws of heavy vehicles whose drives answer late, or give less torque than commanded.
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula, loop
from tracked_env.physics.rigid_body import Inertia, with_payload
from tracked_env.streams import integer, random, uniform
from tracked_env.uncertainty import drawing_laws as c
from tracked_env.uncertainty.soils import firm_ground

FLOOR_PERIOD = 3.0  # [s] from one floor to the other
FLOOR_CHANGES = 12  # [-] in an episode


@formula
def _floor(rng, nominal, truth):
    """Unknown floor, unknown load."""
    truth.mass = nominal.mass * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.inertia = nominal.inertia * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.friction_angle = math.atan(uniform(rng, 0.1, 0.8))  # mu =U(0.1, 0.8)
    modulus = nominal.shear_deformation_modulus * uniform(rng, 0.5, 3.0)  # *U(0.5, 3)
    truth.shear_deformation_modulus = modulus
    truth.longitudinal_resistance = uniform(rng, 0.01, 0.05)  # =U(0.01, 0.05)


@formula
def _friction(rng, nominal, path, truth, changes):
    """Unknown vehicle on an unknown floor, constant over the episode."""
    _floor(rng, nominal, truth)


@formula
def _friction_step(rng, nominal, path, truth, changes):
    """The path crosses a border between a slippery floor and a rough one, edge 0.1 m wide."""
    slippery = math.atan(uniform(rng, 0.1, 0.15))  # mu =U(0.1, 0.15)
    rough = math.atan(uniform(rng, 0.5, 0.8))  # mu =U(0.5, 0.8)
    first, second = (slippery, rough) if random(rng) < 0.5 else (rough, slippery)
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    c.line(changes, c.FRICTION_ANGLE, second, c.border(path, time), 0.1)
    truth.friction_angle = first


@formula
def _friction_drift(rng, nominal, path, truth, changes):
    """The floor gets wet, or dries, slowly: one draw to another, U(0.5, 0.8) of the episode."""
    there = changes.there
    _floor(rng, nominal, truth)
    _floor(rng, nominal, there)
    start = path.duration * uniform(rng, 0.1, 0.2)  # =U(0.1, 0.2) of the episode
    duration = path.duration * uniform(rng, 0.5, 0.8)
    modulus = there.shear_deformation_modulus
    c.ramp(changes, c.FRICTION_ANGLE, there.friction_angle, start, duration)
    c.ramp(changes, c.SHEAR_DEFORMATION_MODULUS, modulus, start, duration)
    c.ramp(changes, c.LONGITUDINAL_RESISTANCE, there.longitudinal_resistance, start, duration)


@formula
def _floor_mixed(rng, nominal, path, truth, changes):
    """An unknown vehicle on an unknown floor; then a load, and another floor."""
    _floor(rng, nominal, truth)
    if random(rng) < 0.5:  # load with odds 1/2
        factor = uniform(rng, 0.7, 1.5)  # *U(0.7, 1.5)
        start = path.duration * uniform(rng, 0.2, 0.8)
        c.ramp(changes, c.MASS, truth.mass * factor, start, 0.0)
        c.ramp(changes, c.INERTIA, truth.inertia * factor, start, 0.0)
    if random(rng) < 0.5:  # border with odds 1/2
        friction_angle = math.atan(uniform(rng, 0.1, 0.8))  # mu =U(0.1, 0.8)
        time = path.duration * uniform(rng, 0.2, 0.8)
        edge = uniform(rng, 0.1, 0.5)
        c.line(changes, c.FRICTION_ANGLE, friction_angle, c.border(path, time), edge)


@formula
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


@formula
def _alternating_floors(rng, nominal, path, truth, changes):
    """Every 3 s another floor, for 36 s: a slippery one, a rough one, and back; unknown load."""
    share = uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.mass, truth.inertia = nominal.mass * share, nominal.inertia * share
    slippery = math.atan(uniform(rng, 0.1, 0.15))  # mu =U(0.1, 0.15)
    rough = math.atan(uniform(rng, 0.5, 0.8))  # mu =U(0.5, 0.8)
    first, second = (slippery, rough) if random(rng) < 0.5 else (rough, slippery)
    truth.friction_angle = first
    for k in range(1, FLOOR_CHANGES + 1):
        c.ramp(changes, c.FRICTION_ANGLE, second if k % 2 == 1 else first, k * FLOOR_PERIOD, 0.0)


@formula
def _slow_floor_drive(rng, nominal, path, truth, changes):
    """A `friction` vehicle whose motors answer late."""
    _floor(rng, nominal, truth)
    truth.drive_time_constant = uniform(rng, 0.15, 0.3)  # =U(0.15, 0.3)


@loop
def _each_friction(*call):
    c.draw_each(_friction, call)


@loop
def _each_friction_step(*call):
    c.draw_each(_friction_step, call)


@loop
def _each_friction_drift(*call):
    c.draw_each(_friction_drift, call)


@loop
def _each_floor_mixed(*call):
    c.draw_each(_floor_mixed, call)


@loop
def _each_floor_ood(*call):
    c.draw_each(_floor_ood, call)


@loop
def _each_alternating_floors(*call):
    c.draw_each(_alternating_floors, call)


@loop
def _each_slow_floor_drive(*call):
    c.draw_each(_slow_floor_drive, call)


LAWS = c.laws(
    ("friction", _each_friction, _friction),
    ("friction-step", _each_friction_step, _friction_step),
    ("friction-drift", _each_friction_drift, _friction_drift),
    ("floor-mixed", _each_floor_mixed, _floor_mixed),
    ("floor-ood", _each_floor_ood, _floor_ood),
    ("alternating-floors", _each_alternating_floors, _alternating_floors),
    ("slow-floor-drive", _each_slow_floor_drive, _slow_floor_drive),
)


@formula
def _vehicle(rng, nominal, truth):
    """Unknown load, unknown rough ground."""
    truth.mass = nominal.mass * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.inertia = nominal.inertia * uniform(rng, 0.8, 1.5)  # *U(0.8, 1.5)
    truth.friction_angle = math.atan(uniform(rng, 0.4, 0.8))  # mu =U(0.4, 0.8)
    modulus = nominal.shear_deformation_modulus * uniform(rng, 0.5, 3.0)  # *U(0.5, 3)
    truth.shear_deformation_modulus = modulus
    truth.longitudinal_resistance = uniform(rng, 0.01, 0.05)  # =U(0.01, 0.05)


@formula
def _incline(rng, changes, steepest):
    """A plane of unknown grade =U(0, steepest) and direction =U(-pi, pi)."""
    grade = uniform(rng, 0.0, steepest)
    c.slope(changes, grade, uniform(rng, -math.pi, math.pi))


@formula
def _ground(rng, nominal, changes):
    """A plane of unknown slope with hills on it."""
    length = nominal.contact_length
    _incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    height = length * uniform(rng, 0.05, 0.15)  # standard deviation =U(0.05, 0.15) l
    c.hills(rng, changes, height, 14.0 * length, 3.5 * length)  # wavelengths 14 l to 3.5 l


@formula
def _slope(rng, nominal, path, truth, changes):
    """Unknown vehicle on a plane of unknown slope, constant over the episode."""
    _vehicle(rng, nominal, truth)
    _incline(rng, changes, 0.3)  # grade =U(0, 0.3)


@formula
def _hills(rng, nominal, path, truth, changes):
    """Unknown vehicle on unknown hills on an unknown slope."""
    _vehicle(rng, nominal, truth)
    _ground(rng, nominal, changes)


@formula
def _slope_step(rng, nominal, path, truth, changes):
    """On a slope the path crosses a border between slippery and rough ground, edge 0.1 m wide."""
    _incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    slippery = math.atan(uniform(rng, 0.25, 0.35))  # mu =U(0.25, 0.35)
    rough = math.atan(uniform(rng, 0.6, 0.8))  # mu =U(0.6, 0.8)
    first, second = (slippery, rough) if random(rng) < 0.5 else (rough, slippery)
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    c.line(changes, c.FRICTION_ANGLE, second, c.border(path, time), 0.1)
    truth.friction_angle = first


class _Body(NamedTuple):
    """What a payload changes, as `PlantParameters` has it."""

    mass: float
    inertia: float
    centre_of_mass_x: float
    centre_of_mass_y: float
    centre_of_mass_z: float
    roll_inertia_ratio: float
    pitch_inertia_ratio: float


@formula
def _carrying(p, mass, place, size):
    """The vehicle p with a box, see `rigid_body.with_payload`."""
    roll, pitch = p.roll_inertia_ratio * p.inertia, p.pitch_inertia_ratio * p.inertia
    i, shift = with_payload(Inertia(p.mass, roll, pitch, p.inertia), mass, place, size)
    return _Body(
        i.mass, i.yaw, p.centre_of_mass_x + shift[0], p.centre_of_mass_y + shift[1],
        p.centre_of_mass_z + shift[2], i.roll / i.yaw, i.pitch / i.yaw,
    )  # fmt: skip


@formula
def _put_on(truth, body):
    truth.mass, truth.inertia = body.mass, body.inertia
    truth.centre_of_mass_x, truth.centre_of_mass_y = body.centre_of_mass_x, body.centre_of_mass_y
    truth.centre_of_mass_z = body.centre_of_mass_z
    truth.roll_inertia_ratio = body.roll_inertia_ratio
    truth.pitch_inertia_ratio = body.pitch_inertia_ratio


@formula
def _step_to(changes, body, time):
    c.ramp(changes, c.MASS, body.mass, time, 0.0)
    c.ramp(changes, c.INERTIA, body.inertia, time, 0.0)
    c.ramp(changes, c.CENTRE_OF_MASS_X, body.centre_of_mass_x, time, 0.0)
    c.ramp(changes, c.CENTRE_OF_MASS_Y, body.centre_of_mass_y, time, 0.0)
    c.ramp(changes, c.CENTRE_OF_MASS_Z, body.centre_of_mass_z, time, 0.0)
    c.ramp(changes, c.ROLL_INERTIA_RATIO, body.roll_inertia_ratio, time, 0.0)
    c.ramp(changes, c.PITCH_INERTIA_RATIO, body.pitch_inertia_ratio, time, 0.0)


@formula
def _slope_payload(rng, nominal, path, truth, changes):
    """On a slope the vehicle takes up or puts down a box that shifts its centre of mass."""
    _incline(rng, changes, 0.2)  # grade =U(0, 0.2)
    length, gauge = nominal.contact_length, nominal.track_gauge
    mass = nominal.mass * uniform(rng, 0.2, 0.5)  # of the box, *U(0.2, 0.5)
    # Its middle from the centre of mass:
    x = length * uniform(rng, -0.3, 0.3)  # ahead =U(-0.3, 0.3) l
    y = gauge * uniform(rng, -0.2, 0.2)  # to the left =U(-0.2, 0.2) B
    z = length * uniform(rng, 0.1, 0.3)  # above =U(0.1, 0.3) l
    edge = length * uniform(rng, 0.2, 0.5)  # a cube, =U(0.2, 0.5) l
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    without = _carrying(nominal, 0.0, (x, y, z), (edge, edge, edge))
    carrying = _carrying(nominal, mass, (x, y, z), (edge, edge, edge))
    first, second = (carrying, without) if random(rng) < 0.5 else (without, carrying)
    _put_on(truth, first)
    _step_to(changes, second, time)


@formula
def _soft_patch(rng, nominal, path, truth, changes, first):
    """A soft disc on the path, at U(first, first + 0.2) of the episode; returns place, radius."""
    time = path.duration * (first + uniform(rng, 0.0, 0.2))  # =U(first, first + 0.2)
    place = c.border(path, time)
    radius = nominal.contact_length * uniform(rng, 1.0, 3.0)  # =U(1, 3) l
    friction = truth.friction_angle * uniform(rng, 0.6, 0.9)  # *U(0.6, 0.9)
    modulus = truth.shear_deformation_modulus * uniform(rng, 3.0, 10.0)  # *U(3, 10)
    resistance = truth.longitudinal_resistance + uniform(rng, 0.05, 0.15)  # +U(0.05, 0.15)
    c.patch(changes, c.FRICTION_ANGLE, friction, place, radius, 0.2)
    c.patch(changes, c.SHEAR_DEFORMATION_MODULUS, modulus, place, radius, 0.2)
    c.patch(changes, c.LONGITUDINAL_RESISTANCE, resistance, place, radius, 0.2)
    return place, radius


@formula
def _soft_patches(rng, nominal, path, truth, changes):
    """Hills of unknown stiffness with two soft patches on the path, where tracks sink and slip."""
    _vehicle(rng, nominal, truth)
    _ground(rng, nominal, changes)
    one, its = _soft_patch(rng, nominal, path, truth, changes, 0.2)
    other, others = _soft_patch(rng, nominal, path, truth, changes, 0.6)
    stiffness = nominal.ground_stiffness_factor * uniform(rng, 0.5, 1.5)  # *U(0.5, 1.5)
    truth.ground_stiffness_factor = stiffness
    first, second = uniform(rng, 0.2, 0.6), uniform(rng, 0.2, 0.6)  # *U(0.2, 0.6) on each patch
    c.patch(changes, c.GROUND_STIFFNESS_FACTOR, stiffness * first, one, its, 0.2)
    c.patch(changes, c.GROUND_STIFFNESS_FACTOR, stiffness * second, other, others, 0.2)


@formula
def _hills_ood(rng, nominal, path, truth, changes):
    """Steeper hills, heavier loads and less friction than in any other set of slopes."""
    _vehicle(rng, nominal, truth)
    length = nominal.contact_length
    truth.mass = nominal.mass * uniform(rng, 1.5, 2.0)  # *U(1.5, 2)
    truth.inertia = nominal.inertia * uniform(rng, 1.5, 2.0)  # *U(1.5, 2)
    truth.friction_angle = math.atan(uniform(rng, 0.35, 0.4))  # mu =U(0.35, 0.4)
    _incline(rng, changes, 0.25)  # grade =U(0, 0.25)
    height = length * uniform(rng, 0.15, 0.2)  # standard deviation =U(0.15, 0.2) l
    c.hills(rng, changes, height, 14.0 * length, 3.5 * length)  # wavelengths 14 l to 3.5 l


@loop
def _each_slope(*call):
    c.draw_each(_slope, call)


@loop
def _each_hills(*call):
    c.draw_each(_hills, call)


@loop
def _each_slope_step(*call):
    c.draw_each(_slope_step, call)


@loop
def _each_slope_payload(*call):
    c.draw_each(_slope_payload, call)


@loop
def _each_soft_patches(*call):
    c.draw_each(_soft_patches, call)


@loop
def _each_hills_ood(*call):
    c.draw_each(_hills_ood, call)


LAWS_SLOPES = c.laws(
    ("slope", _each_slope, _slope),
    ("hills", _each_hills, _hills),
    ("slope-step", _each_slope_step, _slope_step),
    ("slope-payload", _each_slope_payload, _slope_payload),
    ("soft-patches", _each_soft_patches, _soft_patches),
    ("hills-ood", _each_hills_ood, _hills_ood),
)


GAIN_PERIOD = 4.0  # [s] from one pair of gains to the next
GAIN_CHANGES = 8  # [-] of each drive, in an episode


@formula
def _slow_drive(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose motors answer late."""
    firm_ground(rng, nominal, truth)
    truth.drive_time_constant = uniform(rng, 0.15, 0.3)  # =U(0.15, 0.3)


@formula
def _weak_actuator(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle whose drives, one or both, give less torque than commanded."""
    firm_ground(rng, nominal, truth)
    weak = integer(rng, 3)  # the left drive, the right drive or both, with equal odds
    left, right = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7) each
    if weak != 1:
        truth.actuator_gain_left = left
    if weak != 0:
        truth.actuator_gain_right = right


@formula
def _actuator_fault(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle, one of whose drives loses a part of its torque on the way."""
    firm_ground(rng, nominal, truth)
    start = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    gain = uniform(rng, 0.4, 0.7)  # =U(0.4, 0.7)
    side = c.ACTUATOR_GAIN_LEFT if random(rng) < 0.5 else c.ACTUATOR_GAIN_RIGHT  # odds 1/2
    c.ramp(changes, side, gain, start, 0.0)


@formula
def _alternating_gains(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle; every 4 s, for 32 s, both drives settle at another torque."""
    firm_ground(rng, nominal, truth)
    truth.actuator_gain_left = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    truth.actuator_gain_right = uniform(rng, 0.4, 1.0)  # =U(0.4, 1)
    for k in range(1, GAIN_CHANGES + 1):
        left, right = uniform(rng, 0.4, 1.0), uniform(rng, 0.4, 1.0)  # =U(0.4, 1) each
        c.ramp(changes, c.ACTUATOR_GAIN_LEFT, left, k * GAIN_PERIOD, 0.0)
        c.ramp(changes, c.ACTUATOR_GAIN_RIGHT, right, k * GAIN_PERIOD, 0.0)


@loop
def _each_slow_drive(*call):
    c.draw_each(_slow_drive, call)


@loop
def _each_weak_actuator(*call):
    c.draw_each(_weak_actuator, call)


@loop
def _each_actuator_fault(*call):
    c.draw_each(_actuator_fault, call)


@loop
def _each_alternating_gains(*call):
    c.draw_each(_alternating_gains, call)


LAWS_WEAK_DRIVES = c.laws(
    ("slow-drive", _each_slow_drive, _slow_drive),
    ("weak-actuator", _each_weak_actuator, _weak_actuator),
    ("actuator-fault", _each_actuator_fault, _actuator_fault),
    ("alternating-gains", _each_alternating_gains, _alternating_gains),
)
