"""What the tests of pictures share: environments to draw, and how to read their pictures."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.env import TrackedVehicleEnv

SHAPE = (640, 960, 3)
WEST_EAST = {"kind": "straight", "speed": 2.0, "x": 0.0, "y": 0.0, "yaw": 0.0}
CENTRED = {"offset_x": 0.0, "offset_y": 0.0, "offset_yaw": 0.0, "speed": 2.0, "yaw_rate": 0.0}
Picture = NDArray[np.uint8]


def started(options: dict[str, Any] | None = None, **arguments: Any) -> TrackedVehicleEnv:
    """An environment at rest over a vehicle that heads east from the origin."""
    given: dict[str, Any] = {"reference": WEST_EAST, "uncertainty": "nominal", "sensors": "ideal"}
    env = TrackedVehicleEnv(**{**given, "render_mode": "rgb_array", **arguments})
    env.reset(seed=3, options={"start": CENTRED, **(options or {})})
    return env


def driven(env: TrackedVehicleEnv, steps: int, left: float = 0.3, right: float = 0.3) -> Picture:
    """The last picture of some steps, each of them drawn."""
    for _ in range(steps):
        env.step(np.array([left, right], dtype=np.float32))
        picture = env.render()
    assert picture is not None
    return picture


def pixel(picture: Picture, x: float, y: float) -> list[int]:
    """Colour at a place [m] relative to the vehicle, away from the thin grid lines."""
    return picture[320 - round(40 * y), 340 + round(40 * x)].tolist()


def region(x: float, y: float, **change: Any) -> dict[str, Any]:
    """A disc of 2 m where the lateral resistance is 0."""
    disc = {"kind": "region", "x": x, "y": y, "radius": 2.0, "edge": 0.1}
    return {"parameter": "lateral_resistance", "target": 0.0, **disc, **change}
