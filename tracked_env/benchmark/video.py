"""A video of one episode per policy; needs pygame and moviepy (extra `render`)."""

import os
import tempfile
from pathlib import Path

import gymnasium
import numpy as np

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyEntry,
    checked_policy,
    needs_truth,
)
from tracked_env.env import TrackedVehicleEnv


def record(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int, folder: Path
) -> Path:
    """Record one episode of the benchmark, the same vehicle, soil, reference and noise.

    Returns the file. Raises ImportError that names the extra to install.
    """
    policy = checked_policy(entry, config.context(uncertainty_set))
    name = "".join(c if c.isalnum() or c in "-_." else "_" for c in entry.name)
    path = folder / f"{uncertainty_set}--{name}--seed-{config.seed + episode}.mp4"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        _record(config, policy, uncertainty_set, config.seed + episode, f"{temporary}/new")
        os.replace(next(Path(temporary).glob("new/*.mp4")), path)
    return path


def _record(
    config: BenchmarkConfig, policy: Policy, uncertainty_set: str, seed: int, folder: str
) -> None:
    """Run one episode under RecordVideo, which writes one file into `folder`."""
    try:
        env = gymnasium.wrappers.RecordVideo(
            TrackedVehicleEnv(
                **config.arguments(uncertainty_set, needs_truth(policy)), render_mode="rgb_array"
            ),
            video_folder=folder,
            episode_trigger=lambda number: True,
            disable_logger=True,
        )
        observation, info = env.reset(seed=seed)
    except (ImportError, gymnasium.error.DependencyNotInstalled) as error:
        raise ImportError(f"{error}. Videos need: pip install 'tracked-env[render]'") from error
    state, start, over = None, np.ones(1, dtype=bool), False
    while not over:
        if needs_truth(policy):
            policy.observe_truth(  # type: ignore[attr-defined]
                {key: np.array([value]) for key, value in info["truth"].items()}
            )
        action, state = policy.predict(observation[None], state, start, deterministic=True)
        start = np.zeros(1, dtype=bool)
        observation, _, terminated, truncated, info = env.step(np.asarray(action, np.float32)[0])
        over = terminated or truncated
    env.close()  # writes the file
