"""Laws of vehicles on soil: `nominal`, and the uncertainty sets of the vehicle of [1].

mu_l and mu_t are drawn, not tabulated: [1] uses 0.5 .. 0.9 on its maps. Numbers are those of the
vehicle of [1]. Of another one the resistances of firm ground are in proportion to its nominal ones,
edges to its contact length, and no load is heavier than its drives can turn on the spot.

References: [1] Strawa et al., Electronics 10 (2021) 187. [2] J. Y. Wong, Theory of Ground
Vehicles, table of terrain values (c, phi) and the ranges of K in its section on shear.
"""

import math

import numpy as np
from numpy.typing import NDArray

from tracked_env.events import Event, encode_schedule
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import HEAVY_CLAY, SoilParameters
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.streams import integer, random, uniform
from tracked_env.uncertainty.drawing_laws import (
    CHANGES_LIMIT,
    LOAD,
    RESISTANCES,
    ROW,
    SOIL,
    border,
    fixed,
    law,
    line,
    ramp,
)


@law("nominal")
def _nominal(rng, nominal, path, truth, changes):
    """The nominal vehicle on the nominal soil, no change."""


def _soil(cohesion_kpa: float, friction_angle_deg: float, modulus: float) -> SoilParameters:
    return SoilParameters(1e3 * cohesion_kpa, math.radians(friction_angle_deg), modulus)


SOILS: dict[str, SoilParameters] = {
    "heavy_clay": HEAVY_CLAY,  # [1] Table 2
    "sandy_loam": _soil(9.65, 35.0, 0.02),  # [1] section 8.2.3; K of its Table 2
    "lete_sand": _soil(1.3, 31.1, 0.012),  # [2]; K as in the SCM terrain demos of Project Chrono
    "dry_sand": _soil(1.04, 28.0, 0.025),  # [2]; K of loose sand (firm: 0.010)
    "clayey_soil": _soil(4.14, 13.0, 0.006),  # [2] 38 % moisture; K of compact clay
}
FIRM = ("heavy_clay", "sandy_loam")
WEAK = ("lete_sand", "dry_sand", "clayey_soil")
LOOSE = ("sandy_loam", "lete_sand", "dry_sand")
ALTERNATION = 2.0  # [s] from one soil to the other
OFTEN, OFTEN_CHANGES = 2.5, 11  # [s], [-] of each load, ground or pair of drives, in an episode
# The vehicle of [1] on heavy clay, for which the numbers are: mu_l, mu_t, contact length [m].
ALONG, ACROSS = HEAVY_CLAY.longitudinal_resistance, HEAVY_CLAY.lateral_resistance
EDGE_LENGTH = 2.0
CARRIED = 0.75  # [-] of the torque limit, that a turn on the spot may take under the largest load
TURNING = 1.125  # [-] of the nominal mu_t: the largest of firm ground, 0.9 / 0.8
LOADED = 10.0  # [-] of the nominal mass: no load of these laws is larger

# (44): mu_l = 0.7 + 0.02 X cos(0.3 Y);  (45): mu_t = 0.6 + 0.03 X sin(0.2 X) exp(-0.01 Y)
STRAWA_MAPS: list[Event] = [
    {"parameter": "longitudinal_resistance", "kind": "wave", "target": 0.7}
    | {"amplitude": 0.02, "k_y": 0.3},
    {"parameter": "lateral_resistance", "kind": "wave", "target": 0.6}
    | {"amplitude": 0.03, "k_x": 0.2, "phase": -0.5 * math.pi, "decay": 0.01},
]
_MAPS = encode_schedule(STRAWA_MAPS)


def _table(names: tuple[str, ...]) -> NDArray[np.float64]:
    """(M, 3): c [Pa], phi [rad], K [m] of those soils."""
    return np.array([SOILS[name][:3] for name in names])


_FIRM, _WEAK, _LOOSE = _table(FIRM), _table(WEAK), _table(LOOSE)


@formula
def _one_of(rng, soils):
    """c, phi, K of one of the soils, with equal odds."""
    k = integer(rng, soils.shape[0])
    return soils[k, 0], soils[k, 1], soils[k, 2]


@formula
def resistance(value, nominal, of_clay):
    """mu_l or mu_t drawn for the vehicle of [1], on heavy clay, as one around the nominal one."""
    return value * (nominal / of_clay)


@formula
def _edge(rng, nominal):
    """Width [m] of a border, =U(0.25, 1) l."""
    return uniform(rng, 0.5, 2.0) * (nominal.contact_length / EDGE_LENGTH)


@formula
def largest_load(nominal, most):
    """`most`, or the factor on the mass with which a turn on the spot takes CARRIED of the torque,
    on ground of TURNING times the nominal mu_t."""
    lateral = 0.25 * TURNING * nominal.turning_resistance_factor * nominal.lateral_resistance
    effort = lateral * nominal.contact_length / nominal.track_gauge
    effort = (effort + 0.5 * nominal.longitudinal_resistance) * nominal.mass * GRAVITY
    return min(most, CARRIED * nominal.torque_limit / (nominal.sprocket_radius * effort))


@formula
def _soil_and_load(rng, nominal, truth, soils, load, angle):
    """One of the soils and a payload: mass and inertia *U(*load), friction angle *U(*angle)."""
    cohesion, friction_angle, modulus = _one_of(rng, soils)
    lightest, heaviest = load[0], max(largest_load(nominal, load[1]), load[0])
    truth.mass = nominal.mass * uniform(rng, lightest, heaviest)
    truth.inertia = nominal.inertia * uniform(rng, lightest, heaviest)
    truth.cohesion = cohesion * uniform(rng, 0.8, 1.2)  # =soil *U(0.8, 1.2)
    truth.friction_angle = friction_angle * uniform(rng, angle[0], angle[1])  # =soil *U(*angle)
    truth.shear_deformation_modulus = modulus * uniform(rng, 0.7, 1.3)  # =soil *U(0.7, 1.3)


@formula
def firm_ground(rng, nominal, truth):
    """Firm soil and a payload that the nominal model does not know."""
    _soil_and_load(rng, nominal, truth, _FIRM, (0.7, 1.5), (0.9, 1.1))
    along, across = uniform(rng, 0.3, 0.7), uniform(rng, 0.5, 0.9)  # =U(0.3, 0.7), =U(0.5, 0.9)
    truth.longitudinal_resistance = resistance(along, nominal.longitudinal_resistance, ALONG)
    truth.lateral_resistance = resistance(across, nominal.lateral_resistance, ACROSS)


@formula
def _soft_ground(rng, nominal, truth, soils):
    """One of the soils, and a payload, of the sets where the ground is loose or weak."""
    _soil_and_load(rng, nominal, truth, soils, (0.8, 1.3), (0.95, 1.05))


@formula
def load_step(rng, nominal, path, truth, changes):
    """With odds 1/2 mass and inertia *U(0.7, 1.5), at U(0.2, 0.8) of the episode."""
    if random(rng) < 0.5:
        factor = uniform(rng, 0.7, 1.5)
        start = path.duration * uniform(rng, 0.2, 0.8)
        factor = min(factor, largest_load(nominal, LOADED) * nominal.mass / truth.mass)
        ramp(changes, LOAD, (truth.mass * factor, truth.inertia * factor), start, 0.0)


@law("soil-and-mass")
def _soil_and_mass(rng, nominal, path, truth, changes):
    """Unknown vehicle on unknown firm soil, constant over the episode."""
    firm_ground(rng, nominal, truth)


@law("payload")
def _payload(rng, nominal, path, truth, changes):
    """Nominal vehicle and soil; mass and inertia step once, up or down, in mid-episode."""
    start = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    factor = uniform(rng, 1.5, 2.0) if random(rng) < 0.5 else uniform(rng, 0.5, 0.65)
    factor = largest_load(nominal, factor)
    inertia = factor * uniform(rng, 0.9, 1.1)  # of the mass factor *U(0.9, 1.1)
    ramp(changes, LOAD, (nominal.mass * factor, nominal.inertia * inertia), start, 0.0)


@law("resistance-map")
def _resistance_map(rng, nominal, path, truth, changes):
    """Resistance coefficients vary in the plane as in (44), (45) of [1]."""
    fixed(changes, _MAPS)


@law("weak-soil")
def _weak_soil(rng, nominal, path, truth, changes):
    """Loose soil that hardly carries the turning moment: traction-limited."""
    _soft_ground(rng, nominal, truth, _WEAK)
    truth.longitudinal_resistance = uniform(rng, 0.1, 0.16)  # =U(0.1, 0.16)
    truth.lateral_resistance = uniform(rng, 0.45, 0.65)  # =U(0.45, 0.65)


@law("terrain-transition")
def _terrain_transition(rng, nominal, path, truth, changes):
    """Nominal vehicle; the path crosses a border to another soil, edge U(0.5, 2) m wide."""
    time = path.duration * uniform(rng, 0.3, 0.6)  # =U(0.3, 0.6) of the episode
    soil = _one_of(rng, _FIRM)
    # Far from the nominal 0.6 and 0.8, to either side:
    longitudinal = uniform(rng, 0.2, 0.4)  # =U(0.2, 0.4)
    # =U(0.4, 0.55) or U(1.0, 1.15)
    lateral = uniform(rng, 0.4, 0.55) if random(rng) < 0.5 else uniform(rng, 1.0, 1.15)
    edge = _edge(rng, nominal)
    place = border(path, time)
    longitudinal = resistance(longitudinal, nominal.longitudinal_resistance, ALONG)
    lateral = resistance(lateral, nominal.lateral_resistance, ACROSS)
    line(changes, SOIL, soil, place, edge)
    line(changes, RESISTANCES, (longitudinal, lateral), place, edge)


@law("drift")
def _drift(rng, nominal, path, truth, changes):
    """Everything slides slowly from nominal to a firm-ground draw, U(0.5, 0.8) of the episode."""
    there = changes.there
    firm_ground(rng, nominal, there)
    start = path.duration * uniform(rng, 0.1, 0.2)  # =U(0.1, 0.2) of the episode
    duration = path.duration * uniform(rng, 0.5, 0.8)
    resistances = there.longitudinal_resistance, there.lateral_resistance
    ramp(changes, LOAD, (there.mass, there.inertia), start, duration)
    ramp(changes, RESISTANCES, resistances, start, duration)


@law("mixed")
def _mixed(rng, nominal, path, truth, changes):
    """An unknown vehicle on unknown soil, then a payload step, then a border, then drift."""
    firm_ground(rng, nominal, truth)
    load_step(rng, nominal, path, truth, changes)
    if random(rng) < 0.5:  # border with odds 1/2
        longitudinal = uniform(rng, 0.3, 0.7)  # =U(0.3, 0.7)
        lateral = uniform(rng, 0.5, 0.9)  # =U(0.5, 0.9)
        time = path.duration * uniform(rng, 0.2, 0.8)
        edge = _edge(rng, nominal)
        longitudinal = resistance(longitudinal, nominal.longitudinal_resistance, ALONG)
        lateral = resistance(lateral, nominal.lateral_resistance, ACROSS)
        line(changes, RESISTANCES, (longitudinal, lateral), border(path, time), edge)
    if random(rng) < 0.5:  # drift of the lateral resistance with odds 1/2
        lateral = uniform(rng, 0.5, 0.9)  # =U(0.5, 0.9)
        lateral = resistance(lateral, nominal.lateral_resistance, ACROSS)
        ramp(changes, (ROW.lateral_resistance,), (lateral,), 0.0, path.duration)


@law("ood")
def _ood(rng, nominal, path, truth, changes):
    """Outside the ranges of every other set."""
    heavy = random(rng) < 0.5
    factor = uniform(rng, 1.6, 2.2) if heavy else uniform(rng, 0.4, 0.6)  # *U(1.6, 2.2) or lighter
    factor = largest_load(nominal, factor)
    truth.mass = nominal.mass * factor
    truth.inertia = nominal.inertia * factor * uniform(rng, 0.8, 1.2)  # of the mass factor
    # =U(0.1, 0.25) or U(0.75, 1.0)
    high = random(rng) >= 0.5
    value = uniform(rng, 0.75, 1.0) if high else uniform(rng, 0.1, 0.25)
    truth.longitudinal_resistance = resistance(value, nominal.longitudinal_resistance, ALONG)
    # =U(0.25, 0.4) or U(1.0, 1.2)
    high = random(rng) >= 0.5
    value = uniform(rng, 1.0, 1.2) if high else uniform(rng, 0.25, 0.4)
    truth.lateral_resistance = resistance(value, nominal.lateral_resistance, ACROSS)
    truth.drive_time_constant = uniform(rng, 0.1, 0.15)  # =U(0.1, 0.15)


@law("loose-soil")
def _loose_soil(rng, nominal, path, truth, changes):
    """Soil whose shear a turn takes up; for the distributed plant, where nothing else does."""
    _soft_ground(rng, nominal, truth, _LOOSE)
    truth.longitudinal_resistance = uniform(rng, 0.1, 0.2)  # =U(0.1, 0.2)


@law("alternating-soils")
def _alternating_soils(rng, nominal, path, truth, changes):
    """Every 2 s another soil, for 34 s: a firm one, a weak one, and back; mass *U(0.8, 1.3)."""
    weak_first = random(rng) < 0.5
    firm, weak = _one_of(rng, _FIRM), _one_of(rng, _WEAK)
    share = largest_load(nominal, uniform(rng, 0.8, 1.3))
    truth.mass, truth.inertia = nominal.mass * share, nominal.inertia * share
    truth.cohesion, truth.friction_angle, truth.shear_deformation_modulus = (
        weak if weak_first else firm
    )
    truth.longitudinal_resistance = uniform(rng, 0.1, 0.16)  # =U(0.1, 0.16): the weak soil must do
    truth.lateral_resistance = uniform(rng, 0.45, 0.65)  # =U(0.45, 0.65)
    for k in range(1, CHANGES_LIMIT // 3 + 1):
        soil = weak if weak_first == (k % 2 == 0) else firm
        ramp(changes, SOIL, soil, k * ALTERNATION, 0.0)


@law("alternating-loads")
def _alternating_loads(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle that takes up or puts down a load every 2.5 s."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        share = largest_load(nominal, uniform(rng, 0.6, 2.0))  # mass and inertia *U(0.6, 2)
        ramp(changes, LOAD, (nominal.mass * share, nominal.inertia * share), k * OFTEN, 0.0)


@formula
def next_resistances(rng, nominal, changes, time):
    """At `time` [s] mu_l becomes =U(0.1, 0.7), mu_t =U(0.3, 0.9), of heavy clay."""
    along, across = uniform(rng, 0.1, 0.7), uniform(rng, 0.3, 0.9)
    along = resistance(along, nominal.longitudinal_resistance, ALONG)
    across = resistance(across, nominal.lateral_resistance, ACROSS)
    ramp(changes, RESISTANCES, (along, across), time, 0.0)


@law("alternating-resistances")
def _alternating_resistances(rng, nominal, path, truth, changes):
    """A `soil-and-mass` vehicle on ground whose resistances are others every 2.5 s."""
    firm_ground(rng, nominal, truth)
    for k in range(1, OFTEN_CHANGES + 1):
        next_resistances(rng, nominal, changes, k * OFTEN)
