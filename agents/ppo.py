"""PPO of Stable-Baselines3 on the batched environment: settings, training, loading.

The agent is blind to the hidden parameters: it sees one observation at a time, so what it learns
is one policy for all vehicles and soils of its set.

References: [1] Schulman et al., Proximal Policy Optimization Algorithms, arXiv:1707.06347.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from tracked_env.benchmark import PolicyContext, PolicyEntry


@dataclass(frozen=True)
class PPOConfig:
    """Settings of PPO; the names are those of Stable-Baselines3."""

    n_envs: int = 64
    """Vehicles stepped together."""

    n_steps: int = 128
    """Control steps per vehicle between two updates."""

    batch_size: int = 2048
    """Samples of one gradient step; large ones keep two cores busy with few calls."""

    n_epochs: int = 5
    """Passes over the samples of an update."""

    learning_rate: float = 1e-3
    """Falls linearly to 0 over the training."""

    gamma: float = 0.98
    """Discount per control step: a horizon of one second at 50 Hz."""

    gae_lambda: float = 0.95
    """Trade-off of bias and variance in the advantage."""

    ent_coef: float = 0.0
    """Weight of the entropy bonus."""

    log_std_init: float = -1.0
    """Logarithm of the initial standard deviation of the action; 0 shakes the vehicle."""

    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, for the policy and for the value."""


def make_model(env: VecEnv, config: PPOConfig, seed: int, tensorboard: str | None = None) -> PPO:
    """An untrained PPO on `env`, on the CPU."""
    settings = asdict(config)
    rate = settings.pop("learning_rate")
    network = {
        "net_arch": list(settings.pop("hidden")),
        "log_std_init": settings.pop("log_std_init"),
        "activation_fn": nn.Tanh,
    }
    settings.pop("n_envs")
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda remaining: rate * remaining,
        policy_kwargs=network,
        seed=seed,
        device="cpu",
        tensorboard_log=tensorboard,
        **settings,
    )


class Progress(BaseCallback):
    """Calls `report(steps so far, mean episode return)` after every rollout."""

    def __init__(self, report: Callable[[int, float], None]) -> None:
        super().__init__()
        self.report = report

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        ended = self.model.ep_info_buffer or []
        returns = [float(info["r"]) for info in ended]
        self.report(self.num_timesteps, sum(returns) / len(returns) if returns else float("nan"))


def agent_entry(path: Path) -> PolicyEntry:
    """A trained agent as a policy of the benchmark. Raises ValueError for a damaged file."""
    if not path.is_file():
        raise ValueError(f"agent {path}: no such file. Was it trained with another --output?")
    try:
        model = PPO.load(path, device="cpu")
    except Exception as error:
        raise ValueError(f"agent {path} cannot be loaded as PPO: {error}") from error

    def make(context: PolicyContext) -> PPO:
        return model

    return PolicyEntry(path.stem, make, hashlib.sha256(path.read_bytes()).hexdigest()[:12])


def describe(config: PPOConfig, extra: Mapping[str, Any]) -> dict[str, Any]:
    """What stands beside a saved agent: its settings and how it came about."""
    return {"algorithm": "PPO", "settings": asdict(config), **extra}
