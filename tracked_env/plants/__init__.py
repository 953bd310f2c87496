"""Plants: one file for each, with all that the engine needs of it, and the names they have.

`plants.register(plant)` adds one; the environments' argument `plant` takes a registered name or a
`Plant` itself. `plants.standalone` drives a plant without an environment.
"""

from tracked_env.plants.base import (
    DRIVES,
    Drive,
    Ground,
    Plant,
    Prepared,
    find,
    known_plants,
    prepared,
    register,
)

__all__ = [
    "DRIVES",
    "Drive",
    "Ground",
    "Plant",
    "Prepared",
    "find",
    "known_plants",
    "prepared",
    "register",
]
