"""Policies in closed loop, and the time histories of the vehicles that they drive.

`drive` runs a batch of the environment, with its sensors and its events. `follow` runs any plant
that `plants.standalone` calls `Driven`, with ideal sensors, on any reference. Row k of a history
belongs to the time k h, h the control period: the true state then, and the estimates of the policy
after the observation of that time.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as layout
from tracked_env.arrays import columns
from tracked_env.physics.parameters import PARAMETER_NAMES, STATE_NAMES, PlantParameters
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.plants.standalone import Driven
from tracked_env.references import ReferenceProfile, sample
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]
Samples = Mapping[str, Floats]

MOTION = STATE_NAMES[:6]  # x, y, yaw, v_x, v_y, yaw_rate
ATTITUDE = ("z", "roll", "pitch")
GOAL = ("reference_x", "reference_y", "reference_yaw")
SPROCKETS = ("sprocket_speed_left", "sprocket_speed_right")
EVERYTHING = (*STATE_NAMES, *PARAMETER_NAMES, *GOAL, "action_left", "action_right")


class Drive(NamedTuple):
    """Time histories of N vehicles over T control steps, SI units."""

    time: Floats  # (T,)
    truth: dict[str, Floats]  # (T, N) by name: state, reference pose, and what was asked for
    belief: dict[str, Floats]  # (T, N) estimates by name, empty when the policy has none
    observations: NDArray[np.float32]  # (T, N, SIZE), empty unless asked for

    @property
    def distance(self) -> Floats:
        """Distance to the reference, (T, N) [m]."""
        truth = self.truth
        apart_x, apart_y = (truth[name] - truth[f"reference_{name}"] for name in "xy")
        return np.asarray(np.hypot(apart_x, apart_y))

    @property
    def heading(self) -> Floats:
        """Yaw less that of the reference, (T, N) [rad] in [-pi, pi)."""
        turned = self.truth["yaw"] - self.truth["reference_yaw"]
        return np.asarray((turned + math.pi) % (2.0 * math.pi) - math.pi)

    def part(self, rows: slice | int) -> "Drive":
        """Some of the vehicles; or one, with histories (T,)."""
        truth, belief = (
            {name: values[:, rows] for name, values in named.items()}
            for named in (self.truth, self.belief)
        )
        return Drive(self.time, truth, belief, self.observations[:, rows])

    def rmse(self, start: float = 0.0) -> Floats:
        """Root mean square distance to the reference from `start` [s] on, (N,) [m]."""
        return np.asarray(np.sqrt(np.mean(self.distance[self.time >= start] ** 2, axis=0)))


def drive(
    policies: Sequence[tuple[Any, slice]],
    rows: Sequence[Mapping[str, Any]],
    duration: float,
    rate: float,
    names: Sequence[str] = EVERYTHING,
    disturb: Callable[[NDArray[np.float32]], NDArray[np.float32]] | None = None,
    keep: bool = False,
    seed: int = 0,
    **settings: Any,
) -> Drive:
    """Drive one vehicle of the environment per entry of `rows` (options of reset).

    policies: each with the rows that it drives; its `estimates`, where it has them, are recorded.
    duration [s]; rate [Hz] of control; names: of the recorded columns; disturb: changes the actions
    (N, 2); keep: whether observations are recorded; seed: row i has seed + i; settings: of the
    environment. Raises ValueError for options that are unknown or out of range.
    """
    count, steps = len(rows), round(duration * rate)
    settings |= {"uncertainty": "nominal", "error_limit": 1e3}
    env = TrackedVehicleVectorEnv(count, duration=duration + 1.0, control_rate=rate, **settings)
    observation, _ = env.reset(seed=seed, options={"rows": [dict(row) for row in rows]})
    indices, history = columns(names), np.empty((steps, len(names), count))
    observations = np.empty((steps if keep else 0, *observation.shape), dtype=np.float32)
    belief: dict[str, Floats] = {}
    memories: list[Any] = [None] * len(policies)
    action = np.empty((count, 2), dtype=np.float32)
    for k in range(steps):
        history[k] = env.simulation.batch.floats[:, indices].T
        if keep:
            observations[k] = observation
        for i, (policy, part) in enumerate(policies):
            action[part], memories[i] = policy.predict(observation[part], memories[i])
            for name, (value, _) in getattr(policy, "estimates", dict)().items():
                if name not in belief:
                    belief[name] = np.full((steps, count), np.nan)
                belief[name][k, part] = value
        observation = env.step(action if disturb is None else disturb(action))[0]
    env.close()
    time: Floats = np.arange(steps, dtype=np.float64) * (1.0 / rate)
    truth = dict(zip(names, history.transpose(1, 0, 2), strict=True))
    return Drive(time, truth, belief, observations)


def sampled(profiles: Sequence[ReferenceProfile], rate: float, duration: float) -> Samples:
    """References of N vehicles at the control steps, each field (T, N); rate [Hz]."""
    time = np.arange(round(duration * rate), dtype=np.float64) * (1.0 / rate)
    return side_by_side([sample(profile, time)._asdict() for profile in profiles])


def side_by_side(references: Sequence[Samples]) -> dict[str, Floats]:
    """The fields (T,) of N references as fields (T, N)."""
    return {name: np.stack([one[name] for one in references], axis=1) for name in references[0]}


def _observations(
    fields: layout.Layout, state: dict[str, Floats], reference: Samples, k: int
) -> NDArray[np.float32]:
    """What ideal sensors show at step k."""
    cosine, sine = np.cos(state["yaw"]), np.sin(state["yaw"])
    ahead_x, ahead_y = reference["x"][k] - state["x"], reference["y"][k] - state["y"]
    turn = reference["yaw"][k] - state["yaw"]
    values: dict[str, Any] = dict.fromkeys(fields.names, np.zeros(len(turn))) | {
        "position_error_x": cosine * ahead_x + sine * ahead_y,
        "position_error_y": cosine * ahead_y - sine * ahead_x,
        "heading_error": (turn + np.pi) % (2.0 * np.pi) - np.pi,
        **{name: state[name] for name in ("v_x", "v_y", "yaw_rate", *SPROCKETS)},
    }
    for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        values[f"reference_{name}"] = reference[name][k]
    if "attitude" in fields.groups:
        values |= {name: state[name] for name in ("roll", "pitch")}
    if "tangent_error" in fields.groups:
        ahead, left = values["position_error_x"], values["position_error_y"]
        pitch, roll = ((np.cos(values[n]), np.sin(values[n])) for n in ("pitch", "roll"))
        errors = in_body_plane(ahead, left, values["heading_error"], pitch, roll)
        names = (field.name for field in layout.GROUPS["tangent_error"].fields)
        values |= dict(zip(names, errors, strict=True))
    return fields.pack(values)


def follow(
    policy: Any,
    plant: Driven,
    reference: Samples,
    start: tuple[float, float, float] | None,
    parameters: PlantParameters,
    rate: float,
    fields: layout.Layout = layout.V0,
    sprockets: Floats | None = None,
) -> Drive:
    """Drive one vehicle per reference from rest at `start` (x, y [m], yaw [rad]); plant: as many.

    reference: at the T control steps. start: None, from where and as the plant has them. rate
    [Hz] of control. fields: what the policy observes; with the attitude the history has z, roll and
    pitch too. sprockets [rad/s] (N, 2): in force before the first step, None at rest.
    """
    steps, count = reference["x"].shape
    limit, period = parameters.sprocket_speed_limit, 1.0 / rate
    memory = None
    sprockets = np.zeros((count, 2)) if sprockets is None else sprockets
    names = (*MOTION, *(ATTITUDE if "attitude" in fields.groups else ()))
    indices = [STATE_NAMES.index(name) for name in names]
    if start is not None:
        plant.states[:, :6] = (*start, 0.0, 0.0, 0.0)
    history = np.empty((len(names) + 2, steps, count))
    for k in range(steps):
        history[:, k] = (*plant.states[:, indices].T, *sprockets.T)
        state = dict(zip((*names, *SPROCKETS), history[:, k], strict=True))
        action, memory = policy.predict(_observations(fields, state, reference, k), memory)
        sprockets = np.clip(limit * action.astype(np.float64), -limit, limit)
        plant.advance(sprockets, period)
    goal = {name: reference[name.removeprefix("reference_")] for name in GOAL}
    truth = dict(zip((*names, *SPROCKETS), history, strict=True)) | goal
    time = np.arange(steps, dtype=np.float64) * period
    return Drive(time, truth, {}, np.empty((0, count, 0), dtype=np.float32))
