"""The environment for RLlib, which builds environments from a function and a dictionary.

    from ray.tune import register_env
    register_env("tracked_env", env_creator)
    config = PPOConfig().environment("tracked_env", env_config={"uncertainty": "payload"})
Ray is not needed here, and is no dependency of this package: it pins Gymnasium to one version.
"""

import inspect
from collections.abc import Mapping
from typing import Any

from tracked_env.env import TrackedVehicleEnv
from tracked_env.validation import checked_keys

ARGUMENTS = tuple(inspect.signature(TrackedVehicleEnv).parameters)


def env_creator(config: Mapping[str, Any] | None = None) -> TrackedVehicleEnv:
    """One vehicle. config: arguments of `TrackedVehicleEnv`; RLlib's EnvContext is such a dict.

    What RLlib adds to it as attributes (worker_index, vector_index) is not needed: RLlib seeds
    the environments of its workers itself. Raises ValueError for a key that is no argument, or a
    value out of range.
    """
    return TrackedVehicleEnv(**checked_keys("env_config", config, ARGUMENTS))
