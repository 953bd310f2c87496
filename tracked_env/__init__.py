"""Gymnasium environments of a skid-steering tracked vehicle on unknown soil.

Importing this package registers the ids; `gymnasium.make("tracked_env:tracked_env/Torque-v0")`
does both in one call.
"""

import gymnasium

__version__ = "0.1.0"

TORQUE_ID = "tracked_env/Torque-v0"

if TORQUE_ID not in gymnasium.registry:
    gymnasium.register(
        id=TORQUE_ID,
        entry_point="tracked_env.env:TrackedVehicleEnv",
        vector_entry_point="tracked_env.vector_env:TrackedVehicleVectorEnv",
    )
