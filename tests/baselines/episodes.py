"""Closed loops of whole episodes in the vector environment, for the tests of adaptive policies."""

from typing import NamedTuple

import numpy as np

from tracked_env.benchmark import PolicyContext
from tracked_env.sensors import RTK
from tracked_env.vector_env import TrackedVehicleVectorEnv

PERIOD = 0.02  # [s]
FAILED = 0.5  # [m] RMSE of an episode that counts as failed
LOST = 5.0  # [m] error after a termination


def context(sensors=RTK, lateral="sliding"):
    """What a factory of baselines.registry is told."""
    return PolicyContext(PERIOD, lateral, sensors)


def seen_by(policy):
    """Observations (200, 3, SIZE) of three vehicles driven by the policy."""
    env = TrackedVehicleVectorEnv(3, uncertainty="mixed", autoreset_mode="Disabled")
    seen, state = [], None
    observation, _ = env.reset(seed=4)
    for _ in range(200):
        seen.append(observation)
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
    return np.array(seen)


def replay(policy, observations, state=None):
    """Actions and the last state."""
    actions = []
    for observation in observations:
        action, state = policy.predict(observation, state)
        actions.append(action)
    return np.array(actions), state


class Episodes(NamedTuple):
    """What a closed loop gave."""

    error: np.ndarray  # [m] (steps, N)
    action: np.ndarray  # [-] (steps, N, 2)
    over: np.ndarray  # (N,) terminated

    @property
    def rmse(self):
        """Of each episode [m]."""
        return np.sqrt(np.mean(self.error**2, axis=0))

    @property
    def settled(self):
        """RMSE of each episode's second half [m]."""
        return np.sqrt(np.mean(self.error[len(self.error) // 2 :] ** 2, axis=0))


def interquartile_mean(values):
    """Mean of the middle half."""
    ordered, quarter = np.sort(values), len(values) // 4
    return ordered[quarter : len(ordered) - quarter].mean()


def run(policy, uncertainty, count=32, duration=12.0, sensors="rtk", spoil=None, seed=0, **options):
    """Drive `count` paired episodes. spoil(step, observation): changes what the policy sees.

    Further arguments are those of the environment; `reset` are options of its reset.
    """
    reset = options.pop("reset", None)
    truthful = getattr(policy, "needs_truth", False)
    env = TrackedVehicleVectorEnv(
        count, uncertainty=uncertainty, sensors=sensors, duration=duration,
        expose_truth=truthful, autoreset_mode="Disabled", **options,
    )  # fmt: skip
    observation, info = env.reset(seed=seed, options=reset)
    over, state, errors, actions = np.zeros(count, dtype=bool), None, [], []
    for step in range(round(duration / PERIOD)):
        if truthful:
            policy.observe_truth(info["truth"])
        if spoil is not None:
            spoil(step, observation)
        action, state = policy.predict(observation, state)
        observation, _, terminated, _, info = env.step(action)
        distance = np.minimum(info["tracking_error"][:, 0], LOST)
        errors.append(np.where(over, LOST, distance))
        actions.append(action)
        over |= terminated
    return Episodes(np.array(errors), np.array(actions), over)
