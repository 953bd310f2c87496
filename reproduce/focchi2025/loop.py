"""A closed loop around any plant: the pseudo-kinematic model (27), the patches with either
integrator, or the plant on terrain, on any reference: all that `plants.standalone` calls `Driven`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from reproduce.focchi2025.runs import Floats, Run
from tracked_env import observation as layout
from tracked_env.physics import state as s
from tracked_env.physics.attitude import in_body_plane
from tracked_env.physics.parameters import PlantParameters
from tracked_env.plants.standalone import Driven, Rig
from tracked_env.references.profile import ReferenceProfile, sample

Samples = Mapping[str, Floats]


def patches(parameters: PlantParameters, count: int, euler: bool, step: float = 1e-3) -> Rig:
    """The distributed plant driven by its speeds: euler explicit, else as the environment; [s]."""
    integrator = "euler" if euler else "rosenbrock"
    return Rig("distributed", parameters, count, "speed", step, {"integrator": integrator})


class Kinematic:
    """The pseudo-kinematic model as a `Driven`."""

    def __init__(self, model: Any, count: int = 1) -> None:
        self._model = model
        self.states: Floats = np.zeros((count, 6))

    def advance(self, commands: Floats, duration: float) -> None:
        """Sprocket speeds [rad/s] held for `duration` [s]."""
        state = self.states
        state[:, :3] = self._model.step(state[:, :3], commands, duration)
        motion, alpha = self._model.motion(commands)
        state[:, 3], state[:, 4] = motion[:, 0], motion[:, 0] * np.tan(alpha)
        state[:, 5] = motion[:, 1]


def _observations(
    shown: layout.Layout, state: Floats, sprockets: Floats, reference: Samples, k: int
) -> np.ndarray[Any, np.dtype[np.float32]]:
    """What ideal sensors show at step k."""
    cosine, sine = np.cos(state[:, 2]), np.sin(state[:, 2])
    ahead_x, ahead_y = reference["x"][k] - state[:, 0], reference["y"][k] - state[:, 1]
    turn = reference["yaw"][k] - state[:, 2]
    values: dict[str, Any] = dict.fromkeys(shown.names, np.zeros(len(state))) | {
        "position_error_x": cosine * ahead_x + sine * ahead_y,
        "position_error_y": cosine * ahead_y - sine * ahead_x,
        "heading_error": (turn + np.pi) % (2.0 * np.pi) - np.pi,
        "v_x": state[:, 3],
        "v_y": state[:, 4],
        "yaw_rate": state[:, 5],
        "sprocket_speed_left": sprockets[:, 0],
        "sprocket_speed_right": sprockets[:, 1],
    }
    for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        values[f"reference_{name}"] = reference[name][k]
    if "attitude" in shown.groups:
        values |= {"roll": state[:, s.ROLL], "pitch": state[:, s.PITCH]}
    if "tangent_error" in shown.groups:
        ahead, left = values["position_error_x"], values["position_error_y"]
        pitch, roll = ((np.cos(values[n]), np.sin(values[n])) for n in ("pitch", "roll"))
        shown_errors = in_body_plane(ahead, left, values["heading_error"], pitch, roll)
        values |= dict(
            zip((f.name for f in layout.GROUPS["tangent_error"].fields), shown_errors, strict=True)
        )
    return shown.pack(values)


def sampled(profiles: Sequence[ReferenceProfile], rate: float, duration: float) -> Samples:
    """References of N vehicles at the control steps, each field (T, N); rate [Hz]."""
    time = np.arange(round(duration * rate), dtype=np.float64) * (1.0 / rate)
    each = [sample(profile, time)._asdict() for profile in profiles]
    return {name: np.stack([one[name] for one in each], axis=1) for name in each[0]}


def follow(
    policy: Any,
    plant: Driven,
    reference: Samples,
    start: tuple[float, float, float] | None,
    parameters: PlantParameters,
    rate: float,
    noise: float = 0.0,
    seed: int = 0,
    shown: layout.Layout = layout.V0,
    sprockets: Floats | None = None,
) -> Run:
    """Drive one vehicle per reference from rest at `start` (x, y [m], yaw [rad]); plant: as many.

    reference: at the T control steps. start: None, from where and as the plant has them. rate
    [Hz] of control. shown: what the policy sees; with the attitude the run has z, roll and pitch
    too. noise [rad/s]: sigma on the sprocket speeds, new at every control step. sprockets [rad/s]
    (N, 2): in force before the first step, None at rest.
    """
    steps, count = reference["x"].shape
    limit, period = parameters.sprocket_speed_limit, 1.0 / rate
    time = np.arange(steps, dtype=np.float64) * period
    rng, memory = np.random.default_rng(seed), None
    state = plant.states
    sprockets = np.zeros((count, 2)) if sprockets is None else sprockets
    kept = [*range(6), *((s.Z, s.ROLL, s.PITCH) if "attitude" in shown.groups else ())]
    if start is not None:
        state[:, :6] = (*start, 0.0, 0.0, 0.0)
    states, speeds = np.empty((steps, len(kept), count)), np.empty((steps, 2, count))
    for k in range(steps):
        states[k], speeds[k] = state[:, kept].T, sprockets.T
        seen = _observations(shown, state, sprockets, reference, k)
        action, memory = policy.predict(seen, memory)
        sprockets = limit * action.astype(np.float64) + noise * rng.standard_normal((count, 2))
        sprockets = np.clip(sprockets, -limit, limit)
        plant.advance(sprockets, period)
    goal = np.stack([reference[name] for name in ("x", "y", "yaw")], axis=1)
    return Run(time, states, speeds, goal, {})
