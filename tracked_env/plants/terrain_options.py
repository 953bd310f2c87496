"""Options of the plant on terrain: defaults with their sources, checks, and where a vehicle rests.

Stiffness and damping are those of F table 2, read per track. The height of the centre of mass,
0.25 m, and the inertias about roll and pitch, 2.18 and 2.81 kg m^2, are F's for its vehicle with
4.5 kg m^2 about yaw and 0.7 m of contact. None scales them with the contact length and with the
yaw inertia in force: an ASSUMPTION for every other vehicle (0.71 m and 572, 737 kg m^2 for the one
of Strawa et al., who do not give them).

Reference: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.ground_contact import LANES
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import FOCCHI_VEHICLE, PlantParameters, Range
from tracked_env.plants.distributed import checked_patches
from tracked_env.terrain.height_field import HeightField
from tracked_env.validation import checked_number

LOADS = ("nonuniform", "uniform")
SOIL_AT = ("centre", "patches")
_FOCCHI_AREA = FOCCHI_VEHICLE.track_width * FOCCHI_VEHICLE.contact_length  # [m^2] of one track
STIFFNESS = 1e5 / _FOCCHI_AREA  # [N/m^3] F table 2
DAMPING = 5e3 / _FOCCHI_AREA  # [N s/m^3]
_HEIGHT, _ROLL_INERTIA, _PITCH_INERTIA = 0.25, 2.18, 2.81  # [m], [kg m^2] of F's vehicle
HEIGHT_RATIO = _HEIGHT / FOCCHI_VEHICLE.contact_length
ROLL_RATIO = _ROLL_INERTIA / FOCCHI_VEHICLE.inertia
PITCH_RATIO = _PITCH_INERTIA / FOCCHI_VEHICLE.inertia
LONGEST_STEP = 2e-3  # [s] of an integration step; docs/terrain.md has the table of step halving
_NUMBERS = {
    "stiffness": Range(1e4, 1e9, "N/m^3", "It is per area of contact."),
    "damping": Range(0.0, 1e8, "N s/m^3", "It is per area of contact."),
    "stiffening": Range(0.0, 100.0, "s/m^2", "F table 2 prints N s/m^2."),
    "longest_step": Range(1e-5, 5e-3, "s", "Did you pass milliseconds?"),
}
_SCALED = {
    "centre_of_mass_height": Range(1e-4, 10.0, "m", "It is the height above the tracks' plane."),
    "roll_inertia": Range(0.01, 1e6, "kg m^2", "It is about the centre of mass."),
    "pitch_inertia": Range(0.01, 1e6, "kg m^2", "It is about the centre of mass."),
}
_PATCHES = Range(1, 80, "-", "Did you pass a length?")
_MOST = LANES // 2  # patches of a track

DEFAULTS: Mapping[str, Any] = {
    "terrain": "flat", "load": "nonuniform", "patches": (10, 4), "soil_at": "centre",
    "centre_of_mass_height": None, "roll_inertia": None, "pitch_inertia": None,
    "stiffness": STIFFNESS, "damping": DAMPING, "stiffening": 0.0, "longest_step": LONGEST_STEP,
}  # fmt: skip


class Resting(NamedTuple):
    """Pose of a vehicle that stands on the tangent plane under its foot."""

    z: float  # [m] as the state has it
    pitch: float  # [rad]
    roll: float  # [rad]


@formula
def height_at_rest(mass, length, width, made):
    """Height [m] of the centre of mass at rest on level ground at height 0."""
    height = made[0] + made[1] * length
    return height - soil.GRAVITY * mass / (2.0 * made[6] * length * width)


def made_of(options: Mapping[str, Any]) -> NDArray[np.float64]:
    """Numbers of the options, as the kernel takes them. Raises ValueError.

    Height, roll and pitch inertia as (number, ratio to contact length or yaw inertia), one of them
    0; stiffness, damping, stiffening, longest step.
    """
    made: list[float] = []
    ratios = (HEIGHT_RATIO, ROLL_RATIO, PITCH_RATIO)
    for (name, allowed), ratio in zip(_SCALED.items(), ratios, strict=True):
        given = options[name]
        made += [0.0, ratio] if given is None else [checked_number(name, given, allowed), 0.0]
    made += [checked_number(name, options[name], allowed) for name, allowed in _NUMBERS.items()]
    return np.array(made)


def patches_of(given: object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles of the patches over half the contact length and over the track's width.

    given: (along, across) a track. Raises ValueError.
    """
    along, across = checked_patches(given, _PATCHES)
    if along * across > _MOST:
        raise ValueError(f"patches = {given!r}; must be at most {_MOST} a track in all")
    columns = 1.0 - (2.0 * np.arange(along) + 1.0) / along
    rows = (np.arange(across) + 0.5) / across - 0.5
    return 0.5 * (columns - columns[::-1]), 0.5 * (rows - rows[::-1])  # exactly antisymmetric


def resting(
    field: HeightField, parameters: PlantParameters, made: NDArray[np.float64],
    x: float, y: float, yaw: float,
) -> Resting:  # fmt: skip
    """Pose with the centre of mass above (x, y) [m], world, and that yaw [rad].

    Sunk in as far as the springs need on that slope. The tilt that they add and the curvature of
    the ground are not in it: a vehicle that starts there settles by milliradians on a plane and by
    hundredths of a radian on hills.
    """
    p = parameters
    height = made[0] + made[1] * p.contact_length
    weight = soil.GRAVITY * p.mass
    sink = weight / (2.0 * made[6] * p.contact_length * p.track_width)
    foot_x, foot_y = x, y
    for _ in range(8):
        ground, slope_x, slope_y = (float(value) for value in field.at(foot_x, foot_y))
        upright = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
        above = height - sink * upright
        foot_x, foot_y = x + above * upright * slope_x, y + above * upright * slope_y
    along = slope_x * math.cos(yaw) + slope_y * math.sin(yaw)
    aside = slope_y * math.cos(yaw) - slope_x * math.sin(yaw)
    z = ground + above * upright
    rest = height_at_rest(p.mass, p.contact_length, p.track_width, made)
    return Resting(z - rest, -math.atan(along), math.atan2(aside, math.sqrt(1.0 + along * along)))
