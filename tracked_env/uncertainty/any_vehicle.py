"""Vehicles of any size, drawn for each episode: `any-vehicle`, and their ground: `any-soil`.

`any-vehicle` draws the nominal vehicle of an episode before its reference, which is then scaled to
it as for a `vehicle=` of that size. Sizes are correlated as those of the catalogue are, with the
contact length l, the gauge B and W = m g:
    l = 0.5 to 6 m, evenly in log l      B = l U(0.6, 1)      track width = l U(0.14, 0.3)
    m = min(420 kg (l / m)^2.6 e^U(-0.7, 0.7), 60 t)           I = m (l^2 + B^2) U(0.1, 0.22)
    sprocket radius r = l U(0.08, 0.18)                        J = m r^2 U(0.05, 0.12)
    top speed = sqrt(l / m) e^U(ln 1, ln 8) m/s
    torque limit = r W (0.1 + need) U(1.25, 2.8), need: effort over W of a turn on the spot, nominal
    drive lag = 0.06 s sqrt(l / 2 m) e^U(-0.7, 0.7)
The ground is in units of the vehicle, so that it means the same to all: with the mean ground
pressure p of the nominal vehicle
    tan(phi) =U(0.45, 0.75)   c = p U(0, 0.2)   K = l 0.004 e^U(0, ln 4)
    mu_l = 0.04 e^U(0, ln 6.25)   mu_t =U(0.3, 0.6)   mass, inertia *U(0.8, 1.5), both the same
and in four of five episodes something changes on the way. Nominal is the middle of it. No load is
heavier, no resistance larger and no drive weaker than leaves the vehicle, of what its drive and its
ground can give, MARGIN times the effort of a turn on the spot and of ACCELERATING W beside it.
`any-soil` is the same ground for the vehicle of the environment.
"""

import math

import numpy as np

from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import drive_limits, turning_effort
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, maximum_tractive_effort
from tracked_env.references.catalogue import ACCELERATING
from tracked_env.streams import addresses, integer, uniform
from tracked_env.uncertainty.drawing_laws import (
    LOAD,
    RECORD,
    RESISTANCES,
    ROW,
    SOIL,
    UNCERTAINTY_SETS,
    CompiledLaw,
    border,
    hills,
    law,
    line,
    ramp,
    slope,
)

NAME = "any-vehicle"
SHORTEST, LONGEST = 0.5, 6.0  # [m] contact length
HEAVIEST = 6e4  # [kg]
MARGIN = 1.15  # [-] of the effort that is needed
LOWEST_SHARE = 0.02  # [-] of resistances that are drawn, for a vehicle that can hardly move
SINKING = 6200.0  # [Pa/m] ground pressure over contact length where the ground is of factor 1
ALTERNATIONS = 9  # [-] of two soils, in an episode
GAINS = (ROW.actuator_gain_left, ROW.actuator_gain_right)


@formula
def _even_ratio(rng, low, high):
    """A number from low to high > 0, evenly in its logarithm."""
    return low * math.exp(uniform(rng, 0.0, math.log(high / low)))


@formula
def _pressure(v):
    """Mean ground pressure [Pa]."""
    return v.mass * GRAVITY / (2.0 * v.track_width * v.contact_length)


@formula
def draw_vehicle(rng, v):
    """Draw a vehicle into the record v, on the middle of its ground; other entries stay."""
    length = _even_ratio(rng, SHORTEST, LONGEST)
    v.contact_length, v.track_gauge = length, length * uniform(rng, 0.6, 1.0)
    v.track_width = length * uniform(rng, 0.14, 0.3)
    v.mass = min(420.0 * math.pow(length, 2.6) * _even_ratio(rng, 0.5, 2.0), HEAVIEST)
    square = length * length + v.track_gauge * v.track_gauge
    v.inertia = v.mass * square * uniform(rng, 0.1, 0.22)
    v.sprocket_radius = radius = length * uniform(rng, 0.08, 0.18)
    v.sprocket_inertia = v.mass * radius * radius * uniform(rng, 0.05, 0.12)
    v.sprocket_speed_limit = math.sqrt(length) * _even_ratio(rng, 1.0, 8.0) / radius
    v.drive_time_constant = 0.06 * math.sqrt(0.5 * length) * _even_ratio(rng, 0.5, 2.0)
    v.friction_angle, v.cohesion = math.atan(0.6), 0.1 * _pressure(v)
    v.shear_deformation_modulus = 0.008 * length
    v.longitudinal_resistance, v.lateral_resistance = 0.1, 0.45
    v.ground_stiffness_factor = _pressure(v) / (SINKING * length)
    v.icr_forward = 0.025 * length
    needed = turning_effort(v) + ACCELERATING * v.mass * GRAVITY
    v.torque_limit = radius * needed * uniform(rng, 1.25, 2.8)


@formula
def _spare(v, mass):
    """Effort [N] of a track over MARGIN, less that for accelerating: by drive or ground.

    v: a vehicle on its ground; mass [kg] with its load.
    """
    ground = drive_limits(v)
    strength = maximum_tractive_effort(
        v.cohesion, v.friction_angle, v.track_width, v.contact_length, mass
    )
    traction = strength * ground.effort_limit / ground.effort_maximum
    effort = min(v.torque_limit / v.sprocket_radius, traction)
    return effort / MARGIN - ACCELERATING * mass * GRAVITY


@formula
def _ground(rng, nominal, mass, there):
    """Draw the soil and the resistances of `there` for the heaviest load [kg] of the episode."""
    there.friction_angle = math.atan(uniform(rng, 0.45, 0.75))
    there.cohesion = _pressure(nominal) * uniform(rng, 0.0, 0.2)
    modulus = nominal.contact_length * _even_ratio(rng, 0.004, 0.016)
    there.shear_deformation_modulus = modulus
    there.longitudinal_resistance = _even_ratio(rng, 0.04, 0.25)
    there.lateral_resistance = uniform(rng, 0.3, 0.6)
    needed = turning_effort(there) * (mass / there.mass)
    share = min(max(_spare(there, mass) / needed, LOWEST_SHARE), 1.0)
    there.longitudinal_resistance *= share
    there.lateral_resistance *= share


@formula
def _load(rng, nominal):
    """Factor on mass and inertia =U(0.8, 1.5), no more than the drives carry on nominal ground."""
    needed = turning_effort(nominal) + ACCELERATING * nominal.mass * GRAVITY
    most = nominal.torque_limit / (nominal.sprocket_radius * needed * MARGIN)
    return min(uniform(rng, 0.8, 1.5), max(most, 0.8))


@formula
def _soil_of(there):
    return there.cohesion, there.friction_angle, there.shear_deformation_modulus


@formula
def _change_soil(changes, there, start):
    """All of the soil at once [s]."""
    ramp(changes, SOIL, _soil_of(there), start, 0.0)
    resistances = there.longitudinal_resistance, there.lateral_resistance
    ramp(changes, RESISTANCES, resistances, start, 0.0)


@law("any-soil")
def _any_soil(rng, nominal, path, truth, changes):
    """Ground and load that the vehicle, of whatever size, can bear; most change on the way."""
    kind = integer(rng, 5)  # with equal odds: constant, a border, a load, two soils in turn, drives
    start = path.duration * uniform(rng, 0.2, 0.6)  # =U(0.2, 0.6) of the episode
    first, second = _load(rng, nominal), _load(rng, nominal)
    heaviest = nominal.mass * (max(first, second) if kind == 2 else first)
    there, length = changes.there, nominal.contact_length
    truth.mass, truth.inertia = nominal.mass * first, nominal.inertia * first
    there.mass = truth.mass
    _ground(rng, nominal, heaviest, truth)
    _ground(rng, nominal, heaviest, there)
    stiffness = nominal.ground_stiffness_factor * uniform(rng, 0.7, 1.4)  # *U(0.7, 1.4)
    truth.ground_stiffness_factor = stiffness
    slope(changes, uniform(rng, 0.0, 0.1), uniform(rng, -math.pi, math.pi))  # grade =U(0, 0.1)
    height = length * uniform(rng, 0.01, 0.04)  # standard deviation =U(0.01, 0.04) l
    hills(rng, changes, height, 14.0 * length, 3.5 * length)  # wavelengths 14 l to 3.5 l
    if kind == 1:
        place = border(path, start)
        line(changes, SOIL, _soil_of(there), place, 0.5 * length)
        resistances = there.longitudinal_resistance, there.lateral_resistance
        line(changes, RESISTANCES, resistances, place, 0.5 * length)
    elif kind == 2:
        ramp(changes, LOAD, (nominal.mass * second, nominal.inertia * second), start, 0.0)
    elif kind == 3:
        period = uniform(rng, 2.5, 5.0)  # [s]
        for n in range(1, ALTERNATIONS + 1):
            if n % 2 == 1:
                _change_soil(changes, there, n * period)
            else:
                _change_soil(changes, truth, n * period)
    elif kind == 4:
        weight = truth.mass * GRAVITY
        needed = (turning_effort(truth) + ACCELERATING * weight) * MARGIN
        least = min(needed * truth.sprocket_radius / truth.torque_limit, 1.0)
        left = max(uniform(rng, 0.6, 1.0), least)  # =U(0.6, 1) each, no weaker than is needed
        right = max(uniform(rng, 0.6, 1.0), least)
        ramp(changes, GAINS, (left, right), start, 0.0)


@loop
def _draw_vehicles(rngs, rows, nominals):
    """The nominal vehicles of the chosen rows, from the generators at these addresses."""
    for k in range(rows.size):
        draw_vehicle(rngs[k], nominals[rows[k]])


_soils: CompiledLaw = UNCERTAINTY_SETS["any-soil"]  # type: ignore[assignment]
UNCERTAINTY_SETS[NAME] = CompiledLaw(
    NAME,
    _soils.kernel,
    "A vehicle of any size, drawn before its reference, on ground that it can bear.",
    _draw_vehicles,
)


def any_vehicle(seed: int, base: PlantParameters) -> PlantParameters:
    """A vehicle of the family on its nominal ground; what is not drawn is the base's."""
    nominals, rng = np.array([tuple(base)], dtype=RECORD), np.random.default_rng(seed)
    _draw_vehicles(addresses([rng]), np.zeros(1, np.int64), nominals)
    return PlantParameters(*nominals[0].item())
