"""Data sets of driven episodes for offline learning, in Minari's format.

    create_dataset("tracked_env/payload/adaptive-v0", AdaptivePolicy(), 100, uncertainty="payload")
drives all episodes in batches and leaves a data set that `minari.load_dataset` finds. Needs the
extra `data`. Minari's own DataCollector works as well, with one vehicle and the package jax.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    import minari
    from minari.data_collector import EpisodeBuffer
except ImportError as error:
    raise ImportError(f"{error}. Data sets need pip install 'tracked-env[data]'") from error

from tracked_env import TORQUE_ID, make
from tracked_env.benchmark.policy_interface import Policy, needs_truth
from tracked_env.vector_env import TrackedVehicleVectorEnv

BATCH = 64  # [vehicles] driven together; no influence on the data


def collect(
    policy: Policy, episodes: int, seed: int = 0, record_truth: bool = False, **env_kwargs: Any
) -> list[EpisodeBuffer]:
    """Drive episodes; episode i is that of an environment after `reset(seed=seed + i)`.

    policy: any object of `tracked_env.benchmark.Policy`; an oracle is handed the truth.
    record_truth: put the true state and parameters (SI) into the infos, for identification.
    env_kwargs: arguments of the environment, but no render mode. About 0.2 MB per episode of
    30 s, three times that with the truth, are kept in memory.
    An episode has T actions and rewards and T + 1 observations and infos. Actions are recorded
    as they act, clipped to [-1, 1]. Raises ValueError for wrong numbers or arguments.
    """
    if episodes < 1:
        raise ValueError(f"episodes = {episodes}; must be at least 1")
    buffers: list[EpisodeBuffer] = []
    for first in range(0, episodes, BATCH):
        seeds = range(seed + first, seed + min(first + BATCH, episodes))
        buffers += _drive(policy, seeds, first, record_truth, env_kwargs)
    return buffers


def _drive(
    policy: Policy, seeds: Sequence[int], first: int, record_truth: bool, env_kwargs: dict[str, Any]
) -> list[EpisodeBuffer]:
    """One batch: one episode per seed, numbered from `first`."""
    count, oracle = len(seeds), needs_truth(policy)
    mode = {"autoreset_mode": "Disabled", "expose_truth": oracle or record_truth}
    env = TrackedVehicleVectorEnv(count, **{**env_kwargs, **mode})
    observation, info = env.reset(seed=list(seeds))
    observations, truths, steps = [observation], [_truth(info)], list[tuple[Any, ...]]()
    state, start, over = None, np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    while not over.all():
        if oracle:
            policy.observe_truth(truths[-1])  # type: ignore[attr-defined]
        demand, state = policy.predict(observation, state, start, deterministic=True)
        action = np.clip(np.asarray(demand, dtype=np.float32), -1.0, 1.0)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        truths.append(_truth(info))
        steps.append((action, reward, terminated, truncated))
        start, over = np.zeros(count, dtype=bool), terminated | truncated
    env.close()
    names = ("actions", "rewards", "terminations", "truncations")
    parts = dict(zip(names, map(np.array, zip(*steps, strict=True)), strict=True))
    ended = parts["terminations"] | parts["truncations"]
    lengths = 1 + np.argmax(ended, axis=0)  # an ended row keeps its flags up
    shown, buffers = np.array(observations), []
    for i, length in enumerate(lengths.tolist()):
        infos = {n: np.array([t[n][i] for t in truths[: length + 1]]) for n in truths[0]}
        buffers.append(
            EpisodeBuffer(
                id=first + i,
                seed=seeds[i],
                observations=shown[: length + 1, i],
                infos={"truth": infos} if record_truth else None,
                **{name: part[:length, i] for name, part in parts.items()},
            )
        )
    return buffers


def _truth(info: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
    """The true values by name, (N,) each, without Gymnasium's masks; empty when hidden."""
    return {k: v for k, v in info.get("truth", {}).items() if not k.startswith("_")}


def create_dataset(
    dataset_id: str,
    policy: Policy,
    episodes: int,
    seed: int = 0,
    record_truth: bool = False,
    description: dict[str, Any] | None = None,
    **env_kwargs: Any,
) -> minari.MinariDataset:
    """Collect episodes as `collect` does and store them as a data set of Minari.

    dataset_id: such as "tracked_env/payload/adaptive-v0". description: what Minari keeps with
    it, such as algorithm_name, author, description (see minari.create_dataset_from_buffers).
    Data sets lie in ~/.minari, or where MINARI_DATASETS_PATH points. The environment with its
    arguments and the number of steps of an episode is in the data set:
    `dataset.recover_environment()` makes it again.
    Raises ValueError when there is a data set of that name already; then nothing is driven.
    """
    if dataset_id in minari.list_local_datasets():
        raise ValueError(
            f"data set {dataset_id!r} exists already; take a new name or version, or delete it "
            f"with `minari delete {dataset_id}`"
        )
    about: dict[str, Any] = {
        "algorithm_name": type(policy).__name__,
        "requirements": ["tracked-env"],
    }
    env = make(TORQUE_ID, **env_kwargs)
    try:
        buffers = collect(policy, episodes, seed, record_truth, **env_kwargs)
        return minari.create_dataset_from_buffers(
            dataset_id, buffers, env=env, eval_env=env, **{**about, **(description or {})}
        )
    finally:
        env.close()
