"""A tracked vehicle on springs and patches, made of its parameters and the numbers of the ground.

Stiffness and damping are those of F table 2, read per track. The height of the centre of mass,
0.25 m, and the inertias about roll and pitch, 2.18 and 2.81 kg m^2, are F's for its vehicle with
4.5 kg m^2 about yaw and 0.7 m of contact. None scales them with the contact length and with the
yaw inertia in force: an ASSUMPTION for every other vehicle (0.71 m and 572, 737 kg m^2 for the one
of Strawa et al., who do not give them).

Reference: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math

import numpy as np

from tracked_env.physics import ground_contact as g
from tracked_env.physics.ground_contact import Footing
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import FOCCHI_VEHICLE
from tracked_env.physics.rigid_body import Inertia
from tracked_env.physics.terrain_motion import BeltDrive, Tracked
from tracked_env.physics.uniform_load import rocking_of

_FOCCHI_AREA = FOCCHI_VEHICLE.track_width * FOCCHI_VEHICLE.contact_length  # [m^2] of one track
STIFFNESS = 1e5 / _FOCCHI_AREA  # [N/m^3] F table 2
DAMPING = 5e3 / _FOCCHI_AREA  # [N s/m^3]
_HEIGHT, _ROLL_INERTIA, _PITCH_INERTIA = 0.25, 2.18, 2.81  # [m], [kg m^2] of F's vehicle
HEIGHT_RATIO = _HEIGHT / FOCCHI_VEHICLE.contact_length
ROLL_RATIO = _ROLL_INERTIA / FOCCHI_VEHICLE.inertia
PITCH_RATIO = _PITCH_INERTIA / FOCCHI_VEHICLE.inertia

# Numbers that `body_of` reads: height, roll and pitch inertia as (number, ratio to contact length
# or yaw inertia), one of them 0; stiffness, damping, stiffening. Here none is given.
SCALED = np.array(
    [0.0, HEIGHT_RATIO, 0.0, ROLL_RATIO, 0.0, PITCH_RATIO, STIFFNESS, DAMPING, 0.0]
)  # fmt: skip


@formula
def body_of(p, lanes, count, made, by_torque, uniform):
    """Tracked from PlantParameters with `count` patches a track; made: numbers as in SCALED."""
    footing = Footing(
        made[0] + made[1] * p.contact_length, 0.5 * p.contact_length,
        p.contact_length * p.track_width / count, made[6], made[7], made[8],
    )  # fmt: skip
    inertia = Inertia(
        p.mass, made[2] + made[3] * p.inertia, made[4] + made[5] * p.inertia, p.inertia
    )
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
