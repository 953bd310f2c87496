"""Gymnasium environments of a skid-steering tracked vehicle on unknown soil.

Importing this package registers the ids; `gymnasium.make("tracked_env:tracked_env/Torque-v0")`
does both in one call. `make` and `make_vec` of this package do the same, and their `spec` says how
many steps an episode has.
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


def make(id: str = TORQUE_ID, **arguments: Any) -> gymnasium.Env[Any, Any]:
    """As `gymnasium.make`, with `spec.max_episode_steps` = duration * control_rate.

    Some tools need the number: Gymnasium's TimeAwareObservation, or TimeLimit around an environment
    that a data set recovers. No episode is cut: the limit is that of the environment itself. One of
    the id or of the arguments stays. Raises ValueError for a wrong argument.
    """
    env = gymnasium.make(id, **arguments)
    if env.spec is None or env.spec.max_episode_steps is not None:
        return env
    simulation: Any = env.get_wrapper_attr("simulation")
    return gymnasium.wrappers.TimeLimit(env, simulation.settings.max_steps)


def make_vec(
    id: str = TORQUE_ID, num_envs: int = 1, **arguments: Any
) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    """As `gymnasium.make_vec` with the batched simulation; its `spec` has the number of steps.

    Raises ValueError for an id whose environment has no batched simulation.
    """
    from tracked_env.environment_ids import vector_spec  # here: it loads numba

    arguments = {"vectorization_mode": "vector_entry_point", **arguments}
    env = gymnasium.make_vec(vector_spec(id), num_envs, **arguments)
    simulation: Any = getattr(env.unwrapped, "simulation", None)
    if simulation is not None and env.spec is not None and env.spec.max_episode_steps is None:
        env.spec.max_episode_steps = simulation.settings.max_steps
    return env


def register_vehicle(name: str, vehicle: str | Path | dict[str, Any]) -> None:
    """Give a vehicle of one's own a name, as `tracked_env.vehicles.register_vehicle` says."""
    from tracked_env import vehicles  # here: it loads numba, which the ids do not need yet

    vehicles.register_vehicle(name, vehicle)
