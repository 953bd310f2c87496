"""Checkpoints of a training: everything that its next step depends on, in one file.

    networks, optimisers, counters     of the algorithm
    replay buffer                      of SAC, TD3, TQC
    vehicles, soils, noise streams     of the environment, in mid-episode
    memory and normalisation           of the wrappers
    random states                      of Python, NumPy, PyTorch and the exploration
A training that goes on from here does what it would have done: same parameters, bit for bit.
The file is plain data (`agents.state_file`): reading one runs no code of whoever wrote it. It is
written beside the one before, which is kept until the new one is whole.
"""

import os
import random
import secrets
import zipfile
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize

from agents import checkpoint_fit
from agents.joined import JoinedVecEnv
from agents.memory import AgentVectorEnv
from agents.privileged import TruthfulVectorEnv
from agents.state_file import read_state, write_state
from tracked_env.sb3 import TrackedVehicleVecEnv

FILE = "checkpoint.zip"
PREVIOUS = "checkpoint-before.zip"
FORMAT = 2
_MODEL = (  # attributes of a model that change while it learns
    "num_timesteps", "_episode_num", "_n_updates", "_last_obs", "_last_episode_starts",
    "_last_original_obs", "_last_lstm_states", "_current_progress_remaining", "ep_info_buffer",
    "ep_success_buffer",
)  # fmt: skip
_SAMPLES = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_NORMALISE = ("returns", "old_obs", "old_reward")
_RUNNING, _STATISTICS = ("obs_rms", "ret_rms"), ("mean", "var", "count")  # of VecNormalize
_ENDED = {"r": 0.0, "l": 0, "t": 0.0}  # what VecMonitor says of an episode
_TRAINER = {  # what `agents.training.Trainer` keeps
    "curve": None, "best": 0.0, "evaluated": 0, "saved": 0, "drawn": 0, "evaluating": 0.0,
    "spent": 0.0, "worked": 0.0,
}  # fmt: skip
_MONITOR = ("episode_returns", "episode_lengths", "episode_count")


def layers(env: VecEnv | None) -> list[Any]:
    """The environment's wrappers from the outside in, the vector or joined environment last."""
    found: list[Any] = []
    layer: Any = env
    while layer is not None:
        found.append(layer)
        layer = getattr(layer, "venv", None) or getattr(layer, "env", None)
    return found


def _named(holder: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: getattr(holder, name) for name in names}


def environment(env: VecEnv | None) -> list[Any]:
    """What each layer remembers, None where it is nothing; in the order of `layers`."""
    states: list[Any] = []
    for layer in layers(env):
        if isinstance(layer, VecNormalize):
            statistics = {name: _named(getattr(layer, name), _STATISTICS) for name in _RUNNING}
            states.append({**_named(layer, _NORMALISE), **statistics})
        elif isinstance(layer, VecMonitor):
            states.append(_named(layer, _MONITOR))
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
    """Put back what `environment` took. env: has been reset.

    Raises ValueError, before anything is put back, for what another environment has left.
    """
    checkpoint_fit.check(environment(env), states, "environment")
    _put_back(env, states)


def _put_back(env: VecEnv | None, states: list[Any]) -> None:
    for layer, state in zip(layers(env), states, strict=True):
        if isinstance(layer, VecNormalize):
            for name in _NORMALISE:
                setattr(layer, name, state[name])
            for name in _RUNNING:
                for part in _STATISTICS:
                    setattr(getattr(layer, name), part, state[name][part])
        elif isinstance(layer, VecMonitor):
            for name in _MONITOR:
                setattr(layer, name, state[name])
        elif isinstance(layer, JoinedVecEnv):
            for part, its in zip(layer.parts, state, strict=True):
                _put_back(part, its)
        elif isinstance(layer, AgentVectorEnv):
            layer.resume(state)
        elif isinstance(layer, TruthfulVectorEnv):
            layer.memory.present, layer.memory.last = state
        elif isinstance(layer, TrackedVehicleVecEnv):
            layer.env.unwrapped.simulation.resume(state)


def _samples(model: BaseAlgorithm) -> dict[str, Any] | None:
    """The rows of a replay buffer that have been written, None where there is no buffer."""
    buffer: Any = getattr(model, "replay_buffer", None)
    if buffer is None:
        return None
    filled = buffer.size()
    arrays = {name: getattr(buffer, name)[:filled] for name in _SAMPLES}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _put_samples_back(model: BaseAlgorithm, samples: Any) -> None:
    buffer: Any = getattr(model, "replay_buffer", None)
    if buffer is None:
        return
    position, full = int(samples["pos"]), bool(samples["full"])
    if not 0 <= position < buffer.buffer_size:
        raise ValueError(f"pos = {position}; must be in [0, {buffer.buffer_size})")
    filled = buffer.buffer_size if full else position
    for name in _SAMPLES:
        stored, kept = samples["arrays"][name], getattr(buffer, name)[:filled]
        checkpoint_fit.check(kept, stored, name)
        kept[:] = stored
    buffer.pos, buffer.full = position, full


def capture(model: BaseAlgorithm) -> dict[str, Any]:
    """Everything that the next rollout of a model depends on."""
    _, variables = model._get_torch_save_params()
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name) for name in variables},
        "attributes": {name: getattr(model, name) for name in _MODEL if hasattr(model, name)},
        "samples": _samples(model),
        "environment": environment(model.get_env()),
        "random": {
            "python": random.getstate(),
            "numpy": np.random.get_state(),  # noqa: NPY002, what SB3 draws from
            "torch": torch.get_rng_state(),
            "action": model.action_space.np_random.bit_generator.state,
        },
    }


def resume(model: BaseAlgorithm, captured: dict[str, Any]) -> None:
    """Put everything that `capture` took into a fresh model of the same configuration.

    Raises ValueError where it does not fit.
    """
    try:
        _resume(model, captured)
    except Exception as error:  # what is not as `capture` left it raises what happens to go wrong
        raise misfit(error) from error


def misfit(error: Exception) -> ValueError:
    """Says that a checkpoint that could be read is not of this training."""
    reason = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    return ValueError(
        f"the checkpoint does not fit this training ({reason}). Was it changed, or written by "
        "another version? Give --overwrite to train anew"
    )


def _resume(model: BaseAlgorithm, captured: dict[str, Any]) -> None:
    env = model.get_env()
    assert env is not None
    model._last_obs = env.reset()  # now it has everything that the checkpoint must have
    fresh = capture(model)
    fresh["attributes"].update(
        _last_episode_starts=np.ones(env.num_envs, dtype=bool),
        ep_info_buffer=deque(),
        ep_success_buffer=deque(),
    )
    if model.get_vec_normalize_env() is not None:
        fresh["attributes"]["_last_original_obs"] = model._last_obs
    for part in ("variables", "random", "attributes"):
        checkpoint_fit.check(fresh[part], captured[part], part)
    attributes = captured["attributes"]
    for info in attributes["ep_info_buffer"]:
        checkpoint_fit.check(_ENDED, {name: info[name] for name in _ENDED}, "ep_info_buffer")
    if "trainer" in captured:
        checkpoint_fit.check(_TRAINER, captured["trainer"], "trainer")
        checkpoint_fit.check_curve(captured["trainer"]["curve"])
    checkpoint_fit.check_parameters(model, captured["parameters"])
    resume_environment(env, captured["environment"])
    model.set_parameters(captured["parameters"], exact_match=True, device="cpu")
    for name, value in captured["variables"].items():
        if value is not None:
            recursive_setattr(model, f"{name}.data", value.data)
    for name in fresh["attributes"]:
        setattr(model, name, attributes[name])
    _put_samples_back(model, captured["samples"])
    states = captured["random"]
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])
    model.action_space.np_random.bit_generator.state = states["action"]


def write(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint; until it is whole, the one before stays. A kill loses neither."""
    temporary = folder / f".{FILE}.{os.getpid()}-{secrets.token_hex(4)}.tmp"
    try:
        write_state(temporary, {"format": FORMAT, **state})
        if (folder / FILE).exists():
            os.replace(folder / FILE, folder / PREVIOUS)
        os.replace(temporary, folder / FILE)
    finally:
        temporary.unlink(missing_ok=True)


def _load(path: Path) -> dict[str, Any]:
    """Raises ValueError for a damaged file, and for one of another version."""
    try:
        with zipfile.ZipFile(path) as archive:
            pickled = "state.pkl" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        pickled = False  # what is wrong is said below
    if pickled:
        raise ValueError(
            f"checkpoint {path} is of a former version, which pickled it: opening it would run "
            "any code in it"
        )
    try:
        state = read_state(path)
    except ValueError as error:
        raise ValueError(f"checkpoint {path} is damaged: {error}") from error
    recipe = state.get("recipe")
    known = isinstance(recipe, dict) and isinstance(recipe.get("config"), dict)
    if state.get("format") != FORMAT or not known:
        raise ValueError(f"checkpoint {path} is not of format {FORMAT}, or lacks its configuration")
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
    for path in (folder / FILE, folder / PREVIOUS, *folder.glob(f".{FILE}*.tmp")):
        path.unlink(missing_ok=True)
