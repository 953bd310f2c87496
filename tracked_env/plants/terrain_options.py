"""Options of the plant on terrain: defaults with their sources, checks, and where a vehicle rests.

The numbers of F's vehicle and what they mean for others are in `physics.tracked_body`.

Reference: [1] Focchi et al. (2025), table 2 and section 8.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.ground_contact import LANES
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.physics.tracked_body import (
    DAMPING,
    HEIGHT_RATIO,
    PITCH_RATIO,
    ROLL_RATIO,
    STIFFNESS,
)
from tracked_env.plants.distributed import checked_patches
from tracked_env.validation import checked_number

LOADS = ("nonuniform", "uniform")
SOIL_AT = ("centre", "patches")
TILT_LIMIT = math.radians(60.0)  # [rad] beyond the tipping angles of F's vehicle: it has fallen
LONGEST_STEP = 2e-3  # [s] of an integration step; docs/terrain.md has the table of step halving
_NUMBERS = {
    "stiffness": Range(1e4, 1e9, "N/m^3", "It is per area of contact."),
    "damping": Range(0.0, 1e8, "N s/m^3", "It is per area of contact."),
    "stiffening": Range(0.0, 100.0, "s/m^2", "F table 2 prints N s/m^2."),
    "longest_step": Range(1e-5, 5e-3, "s", "Did you pass milliseconds?"),
    "tilt_limit": Range(0.01, math.pi, "rad", "Did you pass degrees?"),
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
    "tilt_limit": TILT_LIMIT,
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
    0; stiffness, damping, stiffening, longest step, tilt limit.
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
    ground: Callable[[float, float], Any], parameters: PlantParameters, made: NDArray[np.float64],
    x: float, y: float, yaw: float,
) -> Resting:  # fmt: skip
    """Pose with the centre of mass above (x, y) [m], world, and that yaw [rad].

    ground: (x, y) [m] -> height [m], dz/dx, dz/dy [-].
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
        height_there, slope_x, slope_y = (float(value) for value in ground(foot_x, foot_y))
        upright = 1.0 / math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
        above = height - sink * upright
        foot_x, foot_y = x + above * upright * slope_x, y + above * upright * slope_y
    along = slope_x * math.cos(yaw) + slope_y * math.sin(yaw)
    aside = slope_y * math.cos(yaw) - slope_x * math.sin(yaw)
    z = height_there + above * upright
    rest = height_at_rest(p.mass, p.contact_length, p.track_width, made)
    return Resting(z - rest, -math.atan(along), math.atan2(aside, math.sqrt(1.0 + along * along)))
