"""Checkpoints of a training: everything that its next step depends on, in one file.

    networks, optimisers, counters     of the algorithm
    replay buffer                      of SAC, TD3, TQC
    vehicles, soils, noise streams     of the environment, in mid-episode
    memory and normalisation           of the wrappers
    random states                      of Python, NumPy, PyTorch and the exploration
A training that goes on from here does what it would have done: same parameters, bit for bit.
The file is written beside the one before, which is kept until the new one is whole.
"""

import os
import pickle
import random
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents.joined import JoinedVecEnv
from agents.memory import AgentVectorEnv
from agents.privileged import TruthfulVectorEnv
from tracked_env.sb3 import TrackedVehicleVecEnv

FILE = "checkpoint.zip"
PREVIOUS = "checkpoint-before.zip"
FORMAT = 1
_STATE = "state.pkl"
_MODEL = (  # attributes of a model that change while it learns
    "num_timesteps", "_episode_num", "_n_updates", "_last_obs", "_last_episode_starts",
    "_last_original_obs", "_last_lstm_states", "_current_progress_remaining", "ep_info_buffer",
    "ep_success_buffer", "replay_buffer",
)  # fmt: skip
_NORMALISE = ("obs_rms", "ret_rms", "returns", "old_obs", "old_reward")
_MONITOR = ("episode_returns", "episode_lengths", "episode_count")


def layers(env: VecEnv | None) -> list[Any]:
    """The environment's wrappers from the outside in, the vector or joined environment last."""
    found: list[Any] = []
    layer: Any = env
    while layer is not None:
        found.append(layer)
        layer = getattr(layer, "venv", None) or getattr(layer, "env", None)
    return found


def environment(env: VecEnv | None) -> list[Any]:
    """What each layer remembers; the simulation's comes last."""
    states: list[Any] = []
    for layer in layers(env):
        if isinstance(layer, VecNormalize):
            states.append({name: getattr(layer, name, None) for name in _NORMALISE})
        elif isinstance(layer, VecMonitor):
            states.append({name: getattr(layer, name) for name in _MONITOR})
        elif isinstance(layer, JoinedVecEnv):
            states.append([environment(part) for part in layer.parts])
        elif isinstance(layer, AgentVectorEnv):
            states.append(layer.snapshot())
        elif isinstance(layer, TruthfulVectorEnv):
            states.append((layer.memory.present, layer.memory.last))
        elif isinstance(layer, TrackedVehicleVecEnv):
            states.append(layer.env.unwrapped.simulation.snapshot())
        else:
            states.append(None)
    return states


def resume_environment(env: VecEnv | None, states: list[Any]) -> None:
    """Put back what `environment` took."""
    for layer, state in zip(layers(env), states, strict=True):
        if isinstance(layer, (VecNormalize, VecMonitor)):
            for name, value in state.items():
                setattr(layer, name, value)
        elif isinstance(layer, JoinedVecEnv):
            for part, its in zip(layer.parts, state, strict=True):
                resume_environment(part, its)
        elif isinstance(layer, AgentVectorEnv):
            layer.resume(state)
        elif isinstance(layer, TruthfulVectorEnv):
            layer.memory.present, layer.memory.last = state
        elif isinstance(layer, TrackedVehicleVecEnv):
            layer.env.unwrapped.simulation.resume(state)


def capture(model: BaseAlgorithm) -> dict[str, Any]:
    """Everything that the next rollout of a model depends on."""
    _, variables = model._get_torch_save_params()
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name) for name in variables},
        "attributes": {name: getattr(model, name) for name in _MODEL if hasattr(model, name)},
        "environment": environment(model.get_env()),
        "random": {
            "python": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002, what SB3 draws from
            "torch": torch.get_rng_state(),
            "action": model.action_space.np_random.bit_generator.state,
        },
    }


def resume(model: BaseAlgorithm, captured: dict[str, Any]) -> None:
    """Put everything that `capture` took into a fresh model of the same configuration."""
    model.set_parameters(captured["parameters"], exact_match=True, device="cpu")
    for name, value in captured["variables"].items():
        if value is not None:
            recursive_setattr(model, f"{name}.data", value.data)
    for name, value in captured["attributes"].items():
        setattr(model, name, value)
    resume_environment(model.get_env(), captured["environment"])
    states = captured["random"]
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])
    model.action_space.np_random.bit_generator.state = states["action"]


def write(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; until it is whole, the one before stays. A kill loses neither."""
    temporary = folder / f".{FILE}.tmp"
    with (
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive,
        archive.open(_STATE, "w", force_zip64=True) as file,
    ):
        pickle.dump({"format": FORMAT, **state}, file, protocol=5)
    if (folder / FILE).exists():
        os.replace(folder / FILE, folder / PREVIOUS)
    os.replace(temporary, folder / FILE)


def _load(path: Path) -> dict[str, Any]:
    """Raises ValueError for a damaged file."""
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.testzip() is not None:
                raise ValueError("its checksum is wrong")
            with archive.open(_STATE) as file:
                state = pickle.load(file)
    except Exception as error:  # unpickling raises what happens to go wrong
        raise ValueError(f"checkpoint {path} is damaged: {error}") from error
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ValueError(f"checkpoint {path} is not of format {FORMAT}; start anew")
    return state


def read(folder: Path) -> tuple[dict[str, Any] | None, list[str]]:
    """The latest whole checkpoint of a folder, or None where there is none, and what to say.

    Raises ValueError when there are checkpoints, but all are damaged.
    """
    notices: list[str] = []
    for path in (folder / FILE, folder / PREVIOUS):
        if path.exists():
            try:
                return _load(path), notices
            except ValueError as error:
                notices.append(str(error))
    if notices:
        raise ValueError(
            f"{'; '.join(notices)}. Nothing to resume: delete {folder} and train anew."
        )
    return None, []


def exist(folder: Path) -> bool:
    """Whether a folder holds checkpoints."""
    return any((folder / name).exists() for name in (FILE, PREVIOUS))


def remove(folder: Path) -> None:
    """Delete the checkpoints of a folder."""
    for name in (FILE, PREVIOUS, f".{FILE}.tmp"):
        (folder / name).unlink(missing_ok=True)
