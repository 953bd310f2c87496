"""Held-out episodes: how far from its path an agent is on vehicles that it is not trained on.

They are seeded from HELD_OUT_SEED on; trainings (`agents.run.random_seed`) and the
benchmark's episodes have other seeds. They are driven in one batch, with the policy in its
benchmark form, and draw nothing from the training's random streams: evaluating more often does not
change the agent.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import Policy, needs_truth
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]

HELD_OUT_SEED = 1_000_000


class HeldOut(NamedTuple):
    """Held-out episodes of one kind of sensors."""

    env: TrackedVehicleVectorEnv  # in DISABLED mode, one row per episode
    context: PolicyContext
    first: int  # episodes before them, which their seeds go on from


def held_out_errors(policy: Policy, env: TrackedVehicleVectorEnv, seed: int) -> Floats:
    """RMSE of the distance [m] of each held-out episode, (N,); row i is seeded seed + i.

    env: a batch in DISABLED mode, one row per episode. Steps after a vehicle has left its path
    count as the error at which it left, so leaving early is never the better score.
    """
    simulation = env.simulation
    steps, limit = simulation.settings.max_steps, simulation.solver.error_limit
    observation, info = env.reset(seed=seed)
    state, start = None, np.ones(env.num_envs, dtype=bool)
    squares = np.zeros(env.num_envs)
    gone = np.zeros(env.num_envs, dtype=bool)
    for _ in range(steps):
        observation[gone] = np.nan_to_num(observation[gone])  # one may have diverged
        if needs_truth(policy):
            policy.observe_truth(info["truth"])  # type: ignore[attr-defined]
        action, state = policy.predict(observation, state, start)
        start = np.zeros_like(start)
        observation, _, terminated, truncated, info = env.step(action)
        gone |= terminated
        distance = np.where(gone, limit, info["tracking_error"][:, 0])
        squares += distance**2
        if (terminated | truncated).all() and not truncated.any():
            squares += (steps - simulation.steps.max()) * limit**2
            break
    errors: Floats = np.sqrt(squares / steps)
    return errors


def held_out_rmse(
    policy_in: Callable[[PolicyContext], Policy], held_out: Sequence[HeldOut]
) -> float:
    """Interquartile mean of the RMSE of held-out episodes [m]; mean over the kinds of sensors.

    policy_in: makes the policy of a context. Of all episodes together the interquartile mean
    would leave out whole kinds of sensors, the best and the worst. NaN without episodes.
    """
    means = [
        interquartile_mean(
            held_out_errors(policy_in(part.context), part.env, HELD_OUT_SEED + part.first)
        )
        for part in held_out
    ]
    return float(np.mean(means)) if means else float("nan")
