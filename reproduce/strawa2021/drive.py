"""A batch of vehicles driven by one policy, with the time histories that the figures need.

Row k of every history belongs to the time k h, h the control period: the true state then, and the
estimates of the policy after the observation of that time.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.policy_interface import Policy
from tracked_env.engine.columns import columns
from tracked_env.physics.parameters import PARAMETER_NAMES, PARAMETER_ROWS
from tracked_env.physics.state import STATE_NAMES, STATE_ROWS
from tracked_env.vector_env import TrackedVehicleVectorEnv

CONTROL_RATE = 100.0  # [Hz] the paper's step is 0.01 s
_REFERENCE = columns(("reference_x", "reference_y"))
PERIOD = 1.0 / CONTROL_RATE  # [s]

Floats = NDArray[np.float64]


class Drive(NamedTuple):
    """Time histories of N vehicles over T control steps, SI units."""

    time: Floats  # (T,)
    truth: dict[str, Floats]  # (T, N) by name of state or parameter
    reference: Floats  # (T, N, 2) [m]
    error: Floats  # (T, N) distance to the reference [m]
    belief: dict[str, Floats]  # (T, N) estimates by name, empty when the policy has none
    observations: NDArray[np.float32]  # (T, N, SIZE), empty unless asked for

    def rmse(self, start: float = 0.0) -> Floats:
        """Root mean square distance to the reference from `start` [s] on, (N,) [m]."""
        late = self.error[self.time >= start]
        return np.asarray(np.sqrt(np.mean(late**2, axis=0)))


def drive(
    policy: Policy,
    rows: Sequence[Mapping[str, Any]],
    duration: float,
    sensors: str | Mapping[str, Any] = "ideal",
    lateral: str = "constrained",
    seed: int = 0,
    keep: bool = False,
) -> Drive:
    """Drive one vehicle per entry of `rows` (options of reset), all by `policy`.

    policy: its `estimates`, where it has them, are kept. duration [s]. sensors: of all rows, which
    their options may change. seed: row i has seed + i. keep: keep the observations.
    Raises ValueError for options that are unknown or out of range.
    """
    count, steps = len(rows), round(duration * CONTROL_RATE)
    env = TrackedVehicleVectorEnv(
        count, reference="straight", uncertainty="nominal", sensors=sensors,
        duration=duration + 1.0, control_rate=CONTROL_RATE, lateral=lateral, error_limit=1e3,
    )  # fmt: skip
    observation, _ = env.reset(seed=seed, options={"rows": [dict(row) for row in rows]})
    truth = np.empty((steps, STATE_ROWS + PARAMETER_ROWS, count))
    reference = np.empty((steps, count, 2))
    kept = np.empty((steps if keep else 0, *observation.shape), dtype=np.float32)
    belief: dict[str, Floats] = {}
    state: Any = None
    for k in range(steps):
        batch = env.simulation.batch
        truth[k, :STATE_ROWS] = batch.state().T
        truth[k, STATE_ROWS:] = batch.parameters().T
        reference[k] = batch.floats[:, _REFERENCE]
        if keep:
            kept[k] = observation
        action, state = policy.predict(observation, state)
        if hasattr(policy, "estimates"):
            for name, (value, _) in policy.estimates().items():
                belief.setdefault(name, np.empty((steps, count)))[k] = value
        observation = env.step(action)[0]
    env.close()
    by_name = dict(zip((*STATE_NAMES, *PARAMETER_NAMES), truth.transpose(1, 0, 2), strict=True))
    error: Floats = np.hypot(reference[:, :, 0] - by_name["x"], reference[:, :, 1] - by_name["y"])
    time: Floats = np.arange(steps, dtype=np.float64) * PERIOD
    return Drive(time, by_name, reference, error, belief, kept)


def rms(values: Floats) -> float:
    """Root mean square of all values; nan of none."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan
