"""What the tests of pictures share: environments and terrains to draw, eyes, height grids."""

import numpy as np
from numpy.typing import NDArray

from tracked_env.env import TrackedVehicleEnv
from tracked_env.rendering import perspective
from tracked_env.rendering.raster import Eye, GroundGrid, project
from tracked_env.rendering.soil_map import LIGHT, brightness_on_grid

SHAPE = (640, 960, 3)
WEST_EAST = {"kind": "straight", "speed": 2.0, "x": 0.0, "y": 0.0, "yaw": 0.0}
CENTRED = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 2.0, "yaw_rate": 0.0}
Picture = NDArray[np.uint8]
Points = NDArray[np.float64]
WIDTH, HEIGHT = 320, 240  # [px]
SOIL = (200, 170, 130)


def episode(options=None, **arguments):
    """An environment at rest over a vehicle that heads east from the origin."""
    defaults = {"reference": WEST_EAST, "uncertainty": "nominal", "sensors": "ideal"}
    env = TrackedVehicleEnv(**{"render_mode": "rgb_array", **defaults, **arguments})
    env.reset(seed=3, options={"start": CENTRED, **(options or {})})
    return env


def last_picture(env, steps, left=0.3, right=0.3):
    """The last picture of some steps, each of them drawn."""
    for _ in range(steps):
        env.step(np.array([left, right], dtype=np.float32))
        picture = env.render()
    return picture


def pixel(picture, x, y):
    """Colour at a place [m] relative to the vehicle, away from the thin grid lines."""
    return picture[320 - round(40 * y), 320 + round(40 * x)].tolist()


def region(x, y, **change):
    """A disc of 2 m where the lateral resistance is 0."""
    disc = {"kind": "region", "x": x, "y": y, "radius": 2.0, "edge": 0.1}
    return {"parameter": "lateral_resistance", "target": 0.0, **disc, **change}


def bump(x0, y0, height=2.0, width=1.5):
    """A round hill."""
    return lambda x, y: height * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2.0 * width**2))


def eye(z=2.0, y=0.0):
    """At x = 0, looking east, with the horizon in the upper third."""
    return Eye(0.0, y, z, 1.0, 0.0, 200.0, 0.5 * WIDTH, 80.0, 0.5, 50.0)


def grid(heights, light=LIGHT, cell=0.125):
    """The ground 64 m ahead of x = -4 m and 24 m to both sides."""
    x, y = np.meshgrid(np.arange(-4.0, 60.0, cell), np.arange(-24.0, 24.0 + cell, cell))
    values = np.asarray(heights(x, y), dtype=np.float32) + np.zeros(x.shape, dtype=np.float32)
    bright = np.empty_like(values)
    brightness_on_grid(values, cell, light, bright)
    soil = np.array(SOIL, dtype=np.uint8).reshape(1, 1, 3)
    return GroundGrid(values, bright, -4.0, -24.0, 1.0 / cell, soil, 1e6, 2.0, 1.0)


def ground_picture(heights, at=None, **options):
    """A picture of that ground alone."""
    picture = perspective.Picture(WIDTH, HEIGHT)
    picture.ground(grid(heights, **options), at or eye())
    return picture


def put(picture, corners, colour, opacity=1.0):
    """Draw quads (Q, 4, 3) [m] as the usual eye sees them."""
    picture.quads(project(eye(), corners), colour, opacity)


def board(x, y, z, side=0.6):
    """An upright square (1, 4, 3) [m] that faces west, with its middle there."""
    h = 0.5 * side
    return np.array([[(x, y - h, z - h), (x, y + h, z - h), (x, y + h, z + h), (x, y - h, z + h)]])
