"""Laws of light vehicles on uneven ground: the uncertainty sets of `tracked_env/Terrain-v0`.

A law draws the ground of one vehicle for one episode, which is added to the terrain that all share:
a plane and eight sinusoids (`compiled.slope`, `compiled.hills`). Plants on level ground have the
same vehicles and soils without it. Heights and wavelengths are over the contact length l, so that
hills mean the same to vehicles of every size. Friction is drawn over what climbs the slopes: with
mu below the grade a vehicle slides down whatever it does. A payload sits where the centre of mass
was: a shifted one is not modelled.
"""

import math

from tracked_env.physics.jit import formula, loop
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


@formula
def _soft_patches(rng, nominal, path, truth, changes):
    """Hills with two soft patches on the path: less friction, more shear and motion resistance."""
    _vehicle(rng, nominal, truth)
    _ground(rng, nominal, changes)
    for part in range(2):
        time = path.duration * (0.2 + 0.4 * part + uniform(rng, 0.0, 0.2))  # =U of the episode
        place = c.border(path, time)
        radius = nominal.contact_length * uniform(rng, 1.0, 3.0)  # =U(1, 3) l
        friction = truth.friction_angle * uniform(rng, 0.6, 0.9)  # *U(0.6, 0.9)
        modulus = truth.shear_deformation_modulus * uniform(rng, 3.0, 10.0)  # *U(3, 10)
        resistance = truth.longitudinal_resistance + uniform(rng, 0.05, 0.15)  # +U(0.05, 0.15)
        c.patch(changes, c.FRICTION_ANGLE, friction, place, radius, 0.2)
        c.patch(changes, c.SHEAR_DEFORMATION_MODULUS, modulus, place, radius, 0.2)
        c.patch(changes, c.LONGITUDINAL_RESISTANCE, resistance, place, radius, 0.2)


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
def _each_soft_patches(*call):
    c.draw_each(_soft_patches, call)


@loop
def _each_hills_ood(*call):
    c.draw_each(_hills_ood, call)


LAWS = c.laws(
    ("slope", _each_slope, _slope),
    ("hills", _each_hills, _hills),
    ("slope-step", _each_slope_step, _slope_step),
    ("soft-patches", _each_soft_patches, _soft_patches),
    ("hills-ood", _each_hills_ood, _hills_ood),
)
