"""A video of one episode per policy; needs pygame and moviepy (extra `render`)."""

import os
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.files import file_name
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyEntry,
    blamed,
    checked_answer,
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
    name = file_name(uncertainty_set, entry.name)
    path = folder / f"{name}--seed-{config.seed + episode}.mp4"
    folder.mkdir(parents=True, exist_ok=True)
    ours = f".{os.getpid()}.tmp"  # as `files.temporary` has it: a later run removes what is left
    with tempfile.TemporaryDirectory(prefix=".video", suffix=ours, dir=folder) as place:
        _record(config, policy, entry.name, uncertainty_set, config.seed + episode, f"{place}/new")
        os.replace(next(Path(place).glob("new/*.mp4")), path)
    return path


def _record(
    config: BenchmarkConfig,
    policy: Policy,
    name: str,
    uncertainty_set: str,
    seed: int,
    folder: str,
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
    try:
        _drive(env, policy, observation, info)
    except (Exception, SystemExit) as error:
        raise blamed(error, name, f"video of set {uncertainty_set!r}") from error
    finally:
        env.close()  # writes the file


def _drive(env: Any, policy: Policy, observation: Any, info: dict[str, Any]) -> None:
    state, start, over = None, np.ones(1, dtype=bool), False
    while not over:
        if needs_truth(policy):
            policy.observe_truth(  # type: ignore[attr-defined]
                {key: np.array([value]) for key, value in info["truth"].items()}
            )
        answer = policy.predict(observation[None], state, start, deterministic=True)
        action, state = checked_answer(answer, 1)
        start = np.zeros(1, dtype=bool)
        observation, _, terminated, truncated, info = env.step(action[0])
        over = terminated or truncated
