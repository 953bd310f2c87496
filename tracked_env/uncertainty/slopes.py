"""Laws of light vehicles on uneven ground: the uncertainty sets of `tracked_env/Terrain-v0`.

A law draws the ground of one vehicle for one episode, which is added to the terrain that all share:
a plane and eight sinusoids (`compiled.slope`, `compiled.hills`). Plants on level ground have the
same vehicles and soils without it. Heights and wavelengths are over the contact length l, so that
hills mean the same to vehicles of every size. Friction is drawn over what climbs the slopes: with
mu below the grade a vehicle slides down whatever it does. Where only mass and inertia are drawn the
load sits in the centre of mass; `slope-payload` has a box that shifts it.
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula, loop
from tracked_env.physics.rigid_body import Inertia, with_payload
from tracked_env.streams import random, uniform
from tracked_env.uncertainty import compiled as c


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


LAWS = c.laws(
    ("slope", _each_slope, _slope),
    ("hills", _each_hills, _hills),
    ("slope-step", _each_slope_step, _slope_step),
    ("slope-payload", _each_slope_payload, _slope_payload),
    ("soft-patches", _each_soft_patches, _soft_patches),
    ("hills-ood", _each_hills_ood, _hills_ood),
)
