"""Laws of light vehicles on firm floors: the uncertainty sets of the nominal vehicle of [1].

Friction mu = tan(phi) is drawn over what a rubber track meets between wet ice and dry concrete;
[1] identifies its slip at 0.1, 0.4 and 0.6.

References: [1] Focchi et al., "Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles" (2025), Table 2 and section 4.
"""

import math

from tracked_env.physics.jit import formula, loop
from tracked_env.streams import random, uniform
from tracked_env.uncertainty import compiled as c

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
