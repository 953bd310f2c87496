"""A tracked vehicle on springs and patches, made of its parameters and the numbers of the ground.

Stiffness and damping are those of F table 2, read per track. The height of the centre of mass,
0.25 m, is F's for its vehicle with 0.7 m of contact. None scales it with the contact length, and
gives the inertias about roll and pitch by their ratios to the yaw inertia in force, which are
parameters (`roll_inertia_ratio`): an ASSUMPTION for every other vehicle (0.71 m and 572, 737 kg m^2
for the one of Strawa et al., who do not give them). `ground_stiffness_factor` multiplies stiffness
and damping.

Reference: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math

import numpy as np

from tracked_env.physics import ground_contact as g
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.driven_belts import BeltDrive
from tracked_env.physics.ground_contact import Footing
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import FOCCHI_VEHICLE
from tracked_env.physics.rigid_body import Inertia
from tracked_env.physics.terrain_motion import Tracked
from tracked_env.physics.uniform_load import rocking_of

_FOCCHI_AREA = FOCCHI_VEHICLE.track_width * FOCCHI_VEHICLE.contact_length  # [m^2] of one track
STIFFNESS = 1e5 / _FOCCHI_AREA  # [N/m^3] F table 2
DAMPING = 5e3 / _FOCCHI_AREA  # [N s/m^3]
HEIGHT_RATIO = 0.25 / FOCCHI_VEHICLE.contact_length

# Numbers that `body_of` reads: height as (number, ratio to the contact length), roll and pitch
# inertia as (number, 1 for the parameter's ratio to the yaw inertia), one of the two 0; stiffness,
# damping, stiffening. Here none is given.
SCALED = np.array([0.0, HEIGHT_RATIO, 0.0, 1.0, 0.0, 1.0, STIFFNESS, DAMPING, 0.0])


@formula
def nominal_height(p, made):
    """Height [m] of the nominal centre of mass above the plane of the tracks."""
    return made[0] + made[1] * p.contact_length


@formula
def sinkage_at_rest(p, made):
    """Sinkage [m] of the tracks at rest on level ground."""
    area = 2.0 * p.contact_length * p.track_width
    return soil.GRAVITY * p.mass / (made[6] * p.ground_stiffness_factor * area)


@formula
def height_at_rest(p, made):
    """Height [m] of the nominal centre of mass at rest on level ground at height 0."""
    return nominal_height(p, made) - sinkage_at_rest(p, made)


@formula
def body_of(p, lanes, count, made, by_torque, uniform):
    """Tracked from PlantParameters with `count` patches a track; made: numbers as in SCALED."""
    firmness = p.ground_stiffness_factor if uniform else 1.0  # else of each patch
    footing = Footing(
        nominal_height(p, made) + p.centre_of_mass_z, 0.5 * p.contact_length,
        p.contact_length * p.track_width / count, made[6] * firmness, made[7] * firmness, made[8],
        p.centre_of_mass_x, p.centre_of_mass_y,
    )  # fmt: skip
    roll, pitch = p.roll_inertia_ratio * p.inertia, p.pitch_inertia_ratio * p.inertia
    inertia = Inertia(p.mass, made[2] + made[3] * roll, made[4] + made[5] * pitch, p.inertia)
    radius = p.sprocket_radius
    drive = BeltDrive(
        radius * radius / p.sprocket_inertia if by_torque else 0.0,
        1.0 / radius,
        1.0 / (radius * p.sprocket_speed_limit),
    )
    rocking = rocking_of(footing, 0.5 * p.track_gauge, p.track_width, 2 * count)
    return Tracked(inertia, footing, rocking, drive, lanes, count, uniform)


@formula
def set_soil(w, first, last, soil_there, patch_area):
    """Rows of the soil in lanes first .. last - 1 of the scratch of `ground_contact`."""
    tangent = math.tan(soil_there.friction_angle)
    for lane in range(first, last):
        w[g.FRICTION, lane] = tangent
        w[g.ADHESION, lane] = soil_there.cohesion * patch_area
        w[g.INVERSE_MODULUS, lane] = 1.0 / soil_there.shear_deformation_modulus
        w[g.ROLLING, lane] = soil_there.longitudinal_resistance
        w[g.FIRMNESS, lane] = soil_there.ground_stiffness_factor
