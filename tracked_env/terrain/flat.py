"""Level ground, the default surface.

A surface is a compiled function (x, y) [m] -> `Surface`; another one is another such function,
passed to `tracked_env.terrain.ground.at` by the plant that drives on it.
"""

from typing import NamedTuple

from tracked_env.physics.jit import formula


class Surface(NamedTuple):
    """Geometry of the ground at one place, world frame."""

    height: float  # [m]
    slope_x: float  # [-] dz/dx
    slope_y: float  # [-] dz/dy


@formula
def level(x, y):
    """Height 0 and no slope, wherever (x, y) [m] is."""
    return Surface(0.0, 0.0, 0.0)
