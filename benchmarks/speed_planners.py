"""Planners, for rows of the speed table: (what is repeated, calls that belong together)."""

from collections.abc import Callable
from typing import Any

import numpy as np

PATHS = ("dubins", "reeds-shepp", "clothoid")
Calls = tuple[Callable[[], object], int]


def _goals(count: int) -> Any:
    """Goals (N, 3) from 1 to 4 m away."""
    drawn = np.random.default_rng(0).uniform((1.0, 0.0, 0.0), (4.0, 6.28, 6.28), (count, 3))
    distance, direction, yaw = drawn.T
    return np.stack([distance * np.cos(direction), distance * np.sin(direction), yaw], axis=1)


def paths(method: str) -> Calls:
    """Paths to 1000 goals, without sampling them in time."""
    from baselines.planners.curves import clothoid, dubins, reeds_shepp

    start, goals = np.zeros(3), _goals(1000)
    if method == "clothoid":
        return lambda: clothoid(start, goals), 1
    make = dubins if method == "dubins" else reeds_shepp
    return lambda: make(start, goals, 0.2), 1


def _slip(v_min: float) -> tuple[Any, Any, Any]:
    from baselines.planners.trajectory import Limits
    from baselines.slip.slip_sweep import identified_slip
    from tracked_env.physics.parameters import VEHICLES

    vehicle = VEHICLES["focchi"]
    return Limits.of(vehicle, v_min=v_min, v_max=0.4), vehicle, identified_slip(vehicle)


def one_by_one(v_min: float) -> Calls:
    """Slippage-aware plans of the light vehicle, to one of 100 goals after another."""
    from baselines.planners.optimal import optimal

    known, goals, turn = _slip(v_min), _goals(100), [0]

    def call() -> object:
        turn[0] = (turn[0] + 1) % len(goals)
        return optimal((0, 0, 0), goals[turn[0]], *known)

    return call, len(goals)


def at_once(v_min: float) -> Calls:
    """The same, all goals at once on two threads."""
    from baselines.planners.optimal import optimal

    known, goals = _slip(v_min), _goals(100)
    return lambda: optimal((0, 0, 0), goals, *known, threads=2), 1
