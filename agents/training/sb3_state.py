"""What the next rollout of a model of Stable-Baselines3 depends on.

networks, optimisers, counters     of the algorithm
replay buffer                      of SAC, TD3, TQC
environment                        agents.training.environment_state
random states                      of Python, NumPy, PyTorch and the exploration
"""

import random
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import stable_baselines3
import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr

from agents.training import checkpoint_fit
from agents.training.environment_state import capture_environment, resume_environment

_MODEL = (  # attributes of a model that change while it learns
    "num_timesteps", "_episode_num", "_n_updates", "_last_obs", "_last_episode_starts",
    "_last_original_obs", "_current_progress_remaining", "ep_info_buffer", "ep_success_buffer",
)  # fmt: skip
_RECURRENT = ("_last_lstm_states",)  # of RecurrentPPO, beside them
_SAMPLES = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_ENDED = {"r": 0.0, "l": 0, "t": 0.0}  # what VecMonitor says of an episode


def capture_random() -> dict[str, Any]:
    """The states of the random streams that the whole process shares."""
    return {
        "python": random.getstate(),
        "numpy": np.random.get_state(),  # noqa: NPY002, what SB3 draws from
        "torch": torch.get_rng_state(),
    }


def put_random_back(states: Mapping[str, Any]) -> None:
    """Put back what `capture_random` took."""
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])  # noqa: NPY002
    torch.set_rng_state(states["torch"])


def _samples(model: BaseAlgorithm) -> dict[str, Any] | None:
    """The rows of a replay buffer that have been written, None where there is no buffer."""
    if not isinstance(model, OffPolicyAlgorithm):
        return None
    buffer: Any = model.replay_buffer
    filled = buffer.size()
    arrays = {name: getattr(buffer, name)[:filled] for name in _SAMPLES}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}


def _put_samples_back(model: BaseAlgorithm, samples: Any) -> None:
    if not isinstance(model, OffPolicyAlgorithm):
        return
    buffer: Any = model.replay_buffer
    position, full = int(samples["pos"]), bool(samples["full"])
    if not 0 <= position < buffer.buffer_size:
        raise ValueError(f"pos = {position}; must be in [0, {buffer.buffer_size})")
    filled = buffer.buffer_size if full else position
    for name in _SAMPLES:
        stored, kept = samples["arrays"][name], getattr(buffer, name)[:filled]
        checkpoint_fit.check(kept, stored, name)
        kept[:] = stored
    buffer.pos, buffer.full = position, full


def _attributes(model: BaseAlgorithm) -> dict[str, Any]:
    """Raises RuntimeError for one that the installed Stable-Baselines3 does not have."""
    names = (*_MODEL, *(_RECURRENT if isinstance(model, RecurrentPPO) else ()))
    missing = [name for name in names if not hasattr(model, name)]
    if missing:
        raise RuntimeError(
            f"{type(model).__name__} of stable-baselines3 {stable_baselines3.__version__} has no "
            f"attribute {missing[0]!r}, without which a training cannot go on from a checkpoint. "
            "Install the version that constraints.txt names"
        )
    return {name: getattr(model, name) for name in names}


def capture(model: BaseAlgorithm) -> dict[str, Any]:
    """Everything that the next rollout of a model depends on. Raises as `_attributes`."""
    _, variables = model._get_torch_save_params()
    return {
        "parameters": model.get_parameters(),
        "variables": {name: recursive_getattr(model, name) for name in variables},
        "attributes": _attributes(model),
        "samples": _samples(model),
        "environment": capture_environment(model.get_env()),
        "random": {
            **capture_random(),
            "action": model.action_space.np_random.bit_generator.state,
        },
    }


def resume(model: BaseAlgorithm, captured: Mapping[str, Any]) -> None:
    """Put everything that `capture` took into a fresh model of the same configuration.

    Raises any exception where it does not fit.
    """
    env = model.get_env()
    assert env is not None
    shown: Any = env.reset()
    model._last_obs = shown  # now it has everything that the checkpoint must have
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
    for success in attributes["ep_success_buffer"]:
        checkpoint_fit.check(False, success, "ep_success_buffer")
    for info in attributes["ep_info_buffer"]:
        checkpoint_fit.check(_ENDED, {name: info[name] for name in _ENDED}, "ep_info_buffer")
    checkpoint_fit.check_parameters(model, captured["parameters"])
    resume_environment(env, captured["environment"])
    model.set_parameters(captured["parameters"], exact_match=True, device="cpu")
    for name, value in captured["variables"].items():
        if value is not None:
            recursive_setattr(model, f"{name}.data", value.data)
    for name in fresh["attributes"]:
        setattr(model, name, attributes[name])
    _put_samples_back(model, captured["samples"])
    put_random_back(captured["random"])
    model.action_space.np_random.bit_generator.state = captured["random"]["action"]
