"""Gymnasium environments of a skid-steering tracked vehicle on unknown soil.

Importing this package registers the ids; `gymnasium.make("tracked_env:tracked_env/Torque-v0")`
does both in one call.
"""

from pathlib import Path
from typing import Any

import gymnasium

__version__ = "0.2.0"

TORQUE_ID = "tracked_env/Torque-v0"
SPEED_ID = "tracked_env/Speed-v0"
TERRAIN_ID = "tracked_env/Terrain-v0"

# What Speed-v0 says differently from the defaults: a light vehicle, indoors, on patches.
SPEED: dict[str, Any] = {
    "vehicle": "focchi",
    "base_vehicle": "focchi",
    "plant": "distributed",
    "drive": "speed",
    "uncertainty": "friction",
    "sensors": "mocap",
    "reference": {
        "kind": "random",
        "speed_range": [0.1, 0.5],
        "yaw_rate_limit": 0.9,
        "lateral_acceleration_limit": 0.4,
        "vehicle": "focchi",  # another vehicle's speeds are in proportion to its top speed
    },
    "error_limit": 2.0,
}

# What Terrain-v0 says differently from Speed-v0: slopes and hills, unknown too, and the attitude.
TERRAIN: dict[str, Any] = {
    **SPEED,
    "plant": "terrain",
    "uncertainty": "hills",
    "observation": [
        "pose_error", "motion", "drive", "reference", "look_ahead", "action", "age",
        "attitude", "tangent_error",
    ],
}  # fmt: skip

for _id, _defaults in ((TORQUE_ID, {}), (SPEED_ID, SPEED), (TERRAIN_ID, TERRAIN)):
    if _id not in gymnasium.registry:
        gymnasium.register(
            id=_id,
            entry_point="tracked_env.env:TrackedVehicleEnv",
            vector_entry_point="tracked_env.vector_env:TrackedVehicleVectorEnv",
            kwargs=_defaults,
        )


def register_vehicle(name: str, vehicle: str | Path | dict[str, Any]) -> None:
    """Give a vehicle of one's own a name, as `tracked_env.vehicles.register_vehicle` says."""
    from tracked_env import vehicles  # here: it loads numba, which the ids do not need yet

    vehicles.register_vehicle(name, vehicle)
