"""A closed loop around any plant: the pseudo-kinematic model (27), or the patches with either
integrator, on any reference. The environment has the patches with its own integrator only.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from reproduce.focchi2025.runs import Floats, Run
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.patch_dynamics import hold_speeds
from tracked_env.physics.patch_forces import make_patches
from tracked_env.references.profile import ReferenceProfile, sample


class Plant(Protocol):
    """N vehicles driven by their sprocket speeds."""

    def advance(self, state: Floats, sprockets: Floats, period: float) -> None:
        """state (N, 6) as in `Run` after `period` [s] at sprockets (N, 2) [rad/s], in place."""


class Patches:
    """The distributed model: euler explicit, else the method of the environment; step [s]."""

    def __init__(self, parameters: PlantParameters, euler: bool, step: float = 1e-3) -> None:
        self._row = np.array(parameters, dtype=np.float64)
        self._patches, self._euler, self._step = make_patches(), euler, step

    def advance(self, state: Floats, sprockets: Floats, period: float) -> None:
        """As Plant."""
        rows, loads = np.tile(self._row, (len(state), 1)), np.empty((len(state), 6))
        steps = max(round(period / self._step), 1)
        hold_speeds(
            state, sprockets, rows, self._patches, steps, period / steps, self._euler, loads
        )  # fmt: skip


class Kinematic:
    """The pseudo-kinematic model that `Tools.kinematic` makes."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def advance(self, state: Floats, sprockets: Floats, period: float) -> None:
        """As Plant."""
        state[:, :3] = self._model.step(state[:, :3], sprockets, period)
        motion, alpha = self._model.motion(sprockets)
        state[:, 3], state[:, 4] = motion[:, 0], motion[:, 0] * np.tan(alpha)
        state[:, 5] = motion[:, 1]


def _observations(
    state: Floats, sprockets: Floats, reference: dict[str, Floats], k: int
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """What ideal sensors show at step k."""
    cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
    ahead_x, ahead_y = reference["x"][k] - state[:, 0], reference["y"][k] - state[:, 1]
    turn = reference["yaw"][k] - state[:, 2]
    values: dict[str, Any] = dict.fromkeys(layout.NAMES, np.zeros(len(state))) | {
        "position_error_x": cosine * ahead_x + sine * ahead_y,
        "position_error_y": cosine * ahead_y - sine * ahead_x,
        "heading_error": (turn + np.pi) % (2.0 * np.pi) - np.pi,
        "v_x": state[:, 3], "v_y": state[:, 4], "yaw_rate": state[:, 5],
        "sprocket_speed_left": sprockets[:, 0], "sprocket_speed_right": sprockets[:, 1],
    }  # fmt: skip
    for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        values[f"reference_{name}"] = reference[name][k]
    return layout.pack(values)


def follow(
    policy: Any,
    plant: Plant,
    profiles: Sequence[ReferenceProfile],
    start: tuple[float, float, float],
    parameters: PlantParameters,
    rate: float,
    duration: float,
    noise: float = 0.0,
    seed: int = 0,
) -> Run:
    """Drive one vehicle per profile from rest at `start` (x, y [m], yaw [rad]).

    rate [Hz] of control. noise [rad/s]: sigma on the sprocket speeds, new at every control step.
    """
    count, steps, period = len(profiles), round(duration * rate), 1.0 / rate
    limit = parameters.sprocket_speed_limit
    time = np.arange(steps, dtype=np.float64) * period
    sampled = [sample(profile, time)._asdict() for profile in profiles]
    reference = {name: np.stack([one[name] for one in sampled], axis=1) for name in sampled[0]}
    rng, memory = np.random.default_rng(seed), None
    state, sprockets = np.zeros((count, 6)), np.zeros((count, 2))
    state[:, :3] = start
    states, speeds = np.empty((steps, 6, count)), np.empty((steps, 2, count))
    for k in range(steps):
        states[k], speeds[k] = state.T, sprockets.T
        action, memory = policy.predict(_observations(state, sprockets, reference, k), memory)
        sprockets = limit * action.astype(np.float64) + noise * rng.standard_normal((count, 2))
        sprockets = np.clip(sprockets, -limit, limit)
        plant.advance(state, sprockets, period)
    goal = np.stack([reference[name] for name in ("x", "y", "yaw")], axis=1)
    return Run(time, states, speeds, goal, {})
