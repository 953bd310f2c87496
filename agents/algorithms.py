"""The algorithms by name, and how a model is made from its settings.

All run on the CPU: networks of this size are slower on a GPU.
"""

from dataclasses import asdict
from typing import Any

import numpy as np
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from agents.configs import (
    AgentConfig,
    PPOConfig,
    RecurrentPPOConfig,
    SACConfig,
    TD3Config,
    TQCConfig,
    check_buffer,
)
from agents.recurrent import BypassedLstmPolicy

ALGORITHMS: dict[str, tuple[type[BaseAlgorithm], type[AgentConfig]]] = {
    "ppo": (PPO, PPOConfig),
    "sac": (SAC, SACConfig),
    "td3": (TD3, TD3Config),
    "tqc": (TQC, TQCConfig),
    "recurrent-ppo": (RecurrentPPO, RecurrentPPOConfig),
}


def make_model(
    algorithm: str, config: AgentConfig, env: VecEnv, seed: int, tensorboard: str | None = None
) -> BaseAlgorithm:
    """An untrained model on `env`. seed: of the networks, the exploration and the vehicles.

    Raises ValueError for settings that the algorithm refuses.
    """
    made, expected = ALGORITHMS[algorithm]
    if not isinstance(config, expected):
        raise ValueError(f"{algorithm} needs a {expected.__name__}, not {type(config).__name__}")
    if hasattr(config, "buffer_size"):
        check_buffer(config, env.num_envs)
    settings: dict[str, Any] = asdict(config)
    network: dict[str, Any] = {"net_arch": list(settings.pop("hidden"))}
    if "log_std_init" in settings:  # on-policy
        network["log_std_init"] = settings.pop("log_std_init")
        network["activation_fn"] = nn.Tanh
    if "lstm_hidden" in settings:
        network["lstm_hidden_size"] = settings.pop("lstm_hidden")
    noise = settings.pop("action_noise", None)
    if noise is not None:
        settings["action_noise"] = NormalActionNoise(np.zeros(2), np.full(2, noise))
    rate = settings.pop("learning_rate")
    try:
        return made(
            BypassedLstmPolicy if algorithm == "recurrent-ppo" else "MlpPolicy",
            env,
            learning_rate=LinearSchedule(rate, 0.0, 1.0),
            policy_kwargs=network,
            seed=seed,
            device="cpu",
            tensorboard_log=tensorboard,
            **settings,
        )
    except AssertionError as error:  # how SB3 refuses settings
        raise ValueError(f"{algorithm}: {error}") from error
