"""Laws of light vehicles on firm floors: the uncertainty sets of the nominal vehicle of [1].

Friction mu = tan(phi) is drawn over what a rubber track meets between wet ice and dry concrete;
[1] identifies its slip at 0.1, 0.4 and 0.6.

References: [1] Focchi et al., "Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles" (2025), Table 2 and section 4.
"""

import math

import numpy as np

from tracked_env.events import line_events, ramp_events
from tracked_env.physics.parameters import PlantParameters
from tracked_env.references import ReferenceProfile
from tracked_env.uncertainty.law import Draw, Law


def _floor(rng: np.random.Generator, nominal: PlantParameters) -> PlantParameters:
    """Unknown floor, unknown load."""
    return nominal._replace(
        mass=nominal.mass * rng.uniform(0.8, 1.5),  # *U(0.8, 1.5)
        inertia=nominal.inertia * rng.uniform(0.8, 1.5),  # *U(0.8, 1.5)
        friction_angle=math.atan(rng.uniform(0.1, 0.8)),  # mu =U(0.1, 0.8)
        shear_deformation_modulus=nominal.shear_deformation_modulus
        * rng.uniform(0.5, 3.0),  # *U(0.5, 3)
        longitudinal_resistance=rng.uniform(0.01, 0.05),  # =U(0.01, 0.05)
    )


def _friction(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Unknown vehicle on an unknown floor, constant over the episode."""
    return Draw(_floor(rng, nominal), [])


def _friction_step(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """The path crosses a border between a slippery floor and a rough one, edge 0.1 m wide."""
    slippery = math.atan(rng.uniform(0.1, 0.15))  # mu =U(0.1, 0.15)
    rough = math.atan(rng.uniform(0.5, 0.8))  # mu =U(0.5, 0.8)
    first, second = (slippery, rough) if rng.random() < 0.5 else (rough, slippery)
    time = duration * rng.uniform(0.3, 0.6)  # =U(0.3, 0.6) of the episode
    events = line_events({"friction_angle": second}, profile, time, 0.1)
    return Draw(nominal._replace(friction_angle=first), events)


def _friction_drift(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """The floor gets wet, or dries, slowly: one draw to another, U(0.5, 0.8) of the episode."""
    before, after = _floor(rng, nominal), _floor(rng, nominal)
    names = ("friction_angle", "shear_deformation_modulus", "longitudinal_resistance")
    targets = {name: getattr(after, name) for name in names}
    start = duration * rng.uniform(0.1, 0.2)  # =U(0.1, 0.2) of the episode
    return Draw(before, ramp_events(targets, start, duration * rng.uniform(0.5, 0.8)))


def _floor_mixed(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """An unknown vehicle on an unknown floor; then a load, and another floor."""
    parameters = _floor(rng, nominal)
    events = []
    if rng.random() < 0.5:  # load with odds 1/2
        factor = rng.uniform(0.7, 1.5)  # *U(0.7, 1.5)
        targets = {"mass": parameters.mass * factor, "inertia": parameters.inertia * factor}
        events += ramp_events(targets, duration * rng.uniform(0.2, 0.8), 0.0)
    if rng.random() < 0.5:  # border with odds 1/2
        targets = {"friction_angle": math.atan(rng.uniform(0.1, 0.8))}  # mu =U(0.1, 0.8)
        time = duration * rng.uniform(0.2, 0.8)
        events += line_events(targets, profile, time, rng.uniform(0.1, 0.5))
    return Draw(parameters, events)


def _floor_ood(
    rng: np.random.Generator, nominal: PlantParameters, profile: ReferenceProfile, duration: float
) -> Draw:
    """Ice, or soil, outside the ranges of every other set of floors; drives that lag."""
    ice = rng.random() < 0.5
    friction = rng.uniform(0.05, 0.08) if ice else rng.uniform(0.9, 1.0)  # mu
    parameters = nominal._replace(
        mass=nominal.mass * rng.uniform(1.6, 2.2),  # *U(1.6, 2.2)
        inertia=nominal.inertia * rng.uniform(1.6, 2.2),  # *U(1.6, 2.2)
        friction_angle=math.atan(friction),
        shear_deformation_modulus=nominal.shear_deformation_modulus
        * rng.uniform(4.0, 8.0),  # *U(4, 8)
        longitudinal_resistance=rng.uniform(0.06, 0.1) if not ice else 0.01,  # =U(0.06, 0.1)
        drive_time_constant=rng.uniform(0.05, 0.1),  # =U(0.05, 0.1)
    )
    return Draw(parameters, [])


LAWS: dict[str, Law] = {
    "friction": _friction,
    "friction-step": _friction_step,
    "friction-drift": _friction_drift,
    "floor-mixed": _floor_mixed,
    "floor-ood": _floor_ood,
}
