"""Laws of heavy vehicles on soil: the uncertainty sets of the nominal vehicle of [1].

Soils: c, phi, K with a source each. The resistance coefficients mu_l and mu_t are drawn, not
tabulated: [1] uses 0.5 .. 0.9 on its maps.

References: [1] Strawa et al., Electronics 10 (2021) 187. [2] J. Y. Wong, Theory of Ground
Vehicles, table of terrain values (c, phi) and the ranges of K in its section on shear.
"""

import math

import numpy as np

from tracked_env.events import Event, line_events, ramp_events, wave
from tracked_env.physics.parameters import HEAVY_CLAY, PlantParameters, SoilParameters
from tracked_env.references import ReferenceProfile
from tracked_env.uncertainty.law import Draw, Law


def _soil(cohesion_kpa: float, friction_angle_deg: float, modulus: float) -> SoilParameters:
    return HEAVY_CLAY._replace(
        cohesion=1e3 * cohesion_kpa,
        friction_angle=math.radians(friction_angle_deg),
        shear_deformation_modulus=modulus,
    )


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


def _firm_ground(rng: np.random.Generator, nominal: PlantParameters) -> PlantParameters:
    """Firm soil and a payload that the nominal model does not know."""
    soil = SOILS[FIRM[rng.integers(len(FIRM))]]
    return nominal._replace(
        mass=nominal.mass * rng.uniform(0.7, 1.5),  # *U(0.7, 1.5)
        inertia=nominal.inertia * rng.uniform(0.7, 1.5),  # *U(0.7, 1.5)
        cohesion=soil.cohesion * rng.uniform(0.8, 1.2),  # =soil *U(0.8, 1.2)
        friction_angle=soil.friction_angle * rng.uniform(0.9, 1.1),  # =soil *U(0.9, 1.1)
        shear_deformation_modulus=soil.shear_deformation_modulus
        * rng.uniform(0.7, 1.3),  # =soil *U(0.7, 1.3)
        longitudinal_resistance=rng.uniform(0.3, 0.7),  # =U(0.3, 0.7)
        lateral_resistance=rng.uniform(0.5, 0.9),  # =U(0.5, 0.9)
    )


def _soil_and_mass(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Unknown vehicle on unknown firm soil, constant over the episode."""
    return Draw(_firm_ground(rng, nominal), [])


def _payload(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Nominal vehicle and soil; mass and inertia step once, up or down, in mid-episode."""
    start = duration * rng.uniform(0.3, 0.6)  # =U(0.3, 0.6) of the episode
    factor = rng.uniform(1.5, 2.0) if rng.random() < 0.5 else rng.uniform(0.5, 0.65)
    inertia = factor * rng.uniform(0.9, 1.1)  # of the mass factor *U(0.9, 1.1)
    targets = {"mass": nominal.mass * factor, "inertia": nominal.inertia * inertia}
    return Draw(nominal, ramp_events(targets, start, 0.0))


def _resistance_map(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Resistance coefficients vary in the plane as in (44), (45) of [1]."""
    return Draw(nominal, STRAWA_MAPS)


def _weak_soil(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Loose soil that hardly carries the turning moment: traction-limited."""
    soil = SOILS[WEAK[rng.integers(len(WEAK))]]
    parameters = nominal._replace(
        mass=nominal.mass * rng.uniform(0.8, 1.3),  # *U(0.8, 1.3)
        inertia=nominal.inertia * rng.uniform(0.8, 1.3),  # *U(0.8, 1.3)
        cohesion=soil.cohesion * rng.uniform(0.8, 1.2),  # =soil *U(0.8, 1.2)
        friction_angle=soil.friction_angle * rng.uniform(0.95, 1.05),  # =soil *U(0.95, 1.05)
        shear_deformation_modulus=soil.shear_deformation_modulus
        * rng.uniform(0.7, 1.3),  # =soil *U(0.7, 1.3)
        longitudinal_resistance=rng.uniform(0.1, 0.16),  # =U(0.1, 0.16)
        lateral_resistance=rng.uniform(0.45, 0.65),  # =U(0.45, 0.65)
    )
    return Draw(parameters, [])


def _terrain_transition(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Nominal vehicle; the path crosses a border to another soil, edge U(0.5, 2) m wide."""
    time = duration * rng.uniform(0.3, 0.6)  # =U(0.3, 0.6) of the episode
    soil = SOILS[FIRM[rng.integers(len(FIRM))]]
    targets = {
        "cohesion": soil.cohesion,
        "friction_angle": soil.friction_angle,
        "shear_deformation_modulus": soil.shear_deformation_modulus,
        # Far from the nominal 0.6 and 0.8, to either side:
        "longitudinal_resistance": rng.uniform(0.2, 0.4),  # =U(0.2, 0.4)
        "lateral_resistance": rng.uniform(0.4, 0.55)  # =U(0.4, 0.55) or U(1.0, 1.15)
        if rng.random() < 0.5
        else rng.uniform(1.0, 1.15),
    }
    return Draw(nominal, line_events(targets, profile, time, rng.uniform(0.5, 2.0)))


def _drift(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Everything slides slowly from nominal to a firm-ground draw, U(0.5, 0.8) of the episode."""
    there = _firm_ground(rng, nominal)
    names = ("mass", "inertia", "longitudinal_resistance", "lateral_resistance")
    targets = {name: getattr(there, name) for name in names}
    start = duration * rng.uniform(0.1, 0.2)  # =U(0.1, 0.2) of the episode
    return Draw(nominal, ramp_events(targets, start, duration * rng.uniform(0.5, 0.8)))


def _mixed(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """An unknown vehicle on unknown soil, then a payload step, then a border, then drift."""
    parameters = _firm_ground(rng, nominal)
    events: list[Event] = []
    if rng.random() < 0.5:  # payload with odds 1/2
        factor = rng.uniform(0.7, 1.5)  # *U(0.7, 1.5)
        targets = {"mass": parameters.mass * factor, "inertia": parameters.inertia * factor}
        events += ramp_events(targets, duration * rng.uniform(0.2, 0.8), 0.0)
    if rng.random() < 0.5:  # border with odds 1/2
        targets = {
            "longitudinal_resistance": rng.uniform(0.3, 0.7),  # =U(0.3, 0.7)
            "lateral_resistance": rng.uniform(0.5, 0.9),  # =U(0.5, 0.9)
        }
        time = duration * rng.uniform(0.2, 0.8)
        events += line_events(targets, profile, time, rng.uniform(0.5, 2.0))
    if rng.random() < 0.5:  # drift of the lateral resistance with odds 1/2
        targets = {"lateral_resistance": rng.uniform(0.5, 0.9)}  # =U(0.5, 0.9)
        events += ramp_events(targets, 0.0, duration)
    return Draw(parameters, events)


def _ood(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Outside the ranges of every other set."""
    heavy = rng.random() < 0.5
    factor = rng.uniform(1.6, 2.2) if heavy else rng.uniform(0.4, 0.6)  # *U(1.6, 2.2) or lighter
    parameters = nominal._replace(
        mass=nominal.mass * factor,
        inertia=nominal.inertia * factor * rng.uniform(0.8, 1.2),  # of the mass factor
        longitudinal_resistance=rng.uniform(0.1, 0.25)  # =U(0.1, 0.25) or U(0.75, 1.0)
        if rng.random() < 0.5
        else rng.uniform(0.75, 1.0),
        lateral_resistance=rng.uniform(0.25, 0.4)  # =U(0.25, 0.4) or U(1.0, 1.2)
        if rng.random() < 0.5
        else rng.uniform(1.0, 1.2),
        drive_time_constant=rng.uniform(0.1, 0.15),  # =U(0.1, 0.15)
    )
    return Draw(parameters, [])


def _slow_drive(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """A `soil-and-mass` vehicle whose motors answer late."""
    parameters = _firm_ground(rng, nominal)
    lag = rng.uniform(0.15, 0.3)  # =U(0.15, 0.3)
    return Draw(parameters._replace(drive_time_constant=lag), [])


def _loose_soil(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Soil whose shear a turn takes up; for the distributed plant, where nothing else does."""
    soil = SOILS[LOOSE[rng.integers(len(LOOSE))]]
    parameters = nominal._replace(
        mass=nominal.mass * rng.uniform(0.8, 1.3),  # *U(0.8, 1.3)
        inertia=nominal.inertia * rng.uniform(0.8, 1.3),  # *U(0.8, 1.3)
        cohesion=soil.cohesion * rng.uniform(0.8, 1.2),  # =soil *U(0.8, 1.2)
        friction_angle=soil.friction_angle * rng.uniform(0.95, 1.05),  # =soil *U(0.95, 1.05)
        shear_deformation_modulus=soil.shear_deformation_modulus
        * rng.uniform(0.7, 1.3),  # =soil *U(0.7, 1.3)
        longitudinal_resistance=rng.uniform(0.1, 0.2),  # =U(0.1, 0.2)
    )
    return Draw(parameters, [])


# (44): mu_l = 0.7 + 0.02 X cos(0.3 Y);  (45): mu_t = 0.6 + 0.03 X sin(0.2 X) exp(-0.01 Y)
STRAWA_MAPS: list[Event] = [
    wave("longitudinal_resistance", mean=0.7, amplitude=0.02, k_y=0.3),
    wave("lateral_resistance", mean=0.6, amplitude=0.03, k_x=0.2, phase=-0.5 * math.pi, decay=0.01),
]

LAWS: dict[str, Law] = {
    "soil-and-mass": _soil_and_mass,
    "payload": _payload,
    "resistance-map": _resistance_map,
    "weak-soil": _weak_soil,
    "terrain-transition": _terrain_transition,
    "drift": _drift,
    "mixed": _mixed,
    "ood": _ood,
    "slow-drive": _slow_drive,
    "loose-soil": _loose_soil,
}
