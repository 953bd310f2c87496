"""The algorithms by name: settings, networks, and the record that is registered for each.

    PPO            many cheap samples, few gradient steps; the fastest on two cores [1]
    recurrent PPO  PPO with an LSTM: it remembers what it has seen, at several times the cost
    SAC            uses each sample many times; fewer steps, more time per step than PPO [2]
    TD3            like SAC with a deterministic policy and noise of fixed size [3]
    TQC            SAC with a distribution of returns, its upper tail cut off [4]
Names of settings are those of Stable-Baselines3, so that its documentation holds for them too. The
defaults are tuned for 64 vehicles at 50 Hz on two processor cores, each stands with its reason.
Observations are of order one, and where the record says `scaled` rewards come times 1 - gamma, so
nothing is normalised. The learning rate falls linearly to zero, so that the last agent is a settled
one. SAC and TD3 had learned nothing after 150 000 steps with scaled rewards, and learn less or
nothing with an action-rate penalty. All run on the CPU: networks of this size are slower on a GPU.

GaussianPolicy is the policy of PPO in Stable-Baselines3 with fewer and faster operations:
    action a = m(o) + s e,   e ~ N(0, 1),   log p(a) = -sum(e^2 / 2 + log s + log(2 pi) / 2)
    entropy  = sum(log s + (1 + log(2 pi)) / 2)
m is a multilayer perceptron, log s a parameter, the sums go over the components of the action.
`torch.tanh` takes about ten times as long as NumPy's, and torch.distributions checks every value.
BypassedLstmPolicy has its LSTM beside the observation, not in its way as in sb3-contrib:
    action = MLP(LSTM(o_1 ... o_t), o_t)        value = MLP(o_t)
Driving needs the errors of the moment from the first update on; the LSTM only has to add what they
do not tell.

References: [1] Schulman et al., arXiv:1707.06347. [2] Haarnoja et al., arXiv:1812.05905.
[3] Fujimoto et al., arXiv:1802.09477. [4] Kuznetsov et al., arXiv:2005.04269.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from sb3_contrib import TQC, RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

# Ranges of the settings of every algorithm and of train.py; a parenthesis leaves the bound out.
# Advantages are normalised over a batch, so one has two samples. Upper bounds leave out what cannot
# be meant: an update that moves every weight by more than 1, or more samples than memory holds.
LIMITS = {
    "steps": "[1, 1e12]", "vehicles": "[1, 65536]", "held_out": "[0, 65536]",
    "evaluate_every": "[1, 1e12]", "checkpoint_every": "[0, 1e12]", "threads": "[1, 1024]",
    "lags": "[1, 10000]", "residual_scale": "[0, 2]", "precision": "[0, 1000]",
    "smoothness": "[0, 1e6]",
    "n_steps": "[1, 1000000]", "batch_size": "[2, 1e8]", "n_epochs": "[1, 10000]",
    "learning_rate": "(0, 1]", "gamma": "[0, 1)", "gae_lambda": "[0, 1]",
    "clip_range": "(0, 100]", "ent_coef": "[0, 1000]", "log_std_init": "[-20, 5]",
    "hidden": "[1, 16384]", "lstm_hidden": "[1, 16384]", "buffer_size": "[1, 1e9]",
    "learning_starts": "[0, 1e12]", "train_freq": "[1, 1000000]", "gradient_steps": "[1, 1000000]",
    "tau": "(0, 1]", "action_noise": "[0, 10]", "top_quantiles_to_drop_per_net": "[0, 24]",
}  # fmt: skip
SMOOTHNESS = 1.0  # [-] penalty of a change of the whole torque limit on both sides (environments)
LOG_2_PI = math.log(2.0 * math.pi)


def inside(value: Any, interval: str) -> bool:
    """Whether a number is in an interval; of `auto_0.1`, the number behind `auto_`."""
    low, high = (float(bound) for bound in interval[1:-1].split(","))
    try:
        value = float(str(value).removeprefix("auto_")) if value != "auto" else 1.0
    except ValueError:
        return False
    above = value > low if interval[0] == "(" else value >= low
    return bool(above and (value < high if interval[-1] == ")" else value <= high))


def check(settings: Any) -> None:
    """Raises ValueError for a field of a dataclass that is outside LIMITS; None is inside."""
    for name in (field.name for field in fields(settings) if field.name in LIMITS):
        value, interval = getattr(settings, name), LIMITS[name]
        entries = value if isinstance(value, tuple) else (value,)
        if not all(entry is None or inside(entry, interval) for entry in entries):
            word = ", auto or auto_ and a number" if isinstance(value, str) else ""
            raise ValueError(f"{name} = {value!r}; must be in {interval}{word}")


def check_buffer(settings: Any, vehicles: int) -> None:
    """Raises ValueError for a buffer of samples that cannot hold `n_steps` of all vehicles."""
    least = settings.n_steps * vehicles
    if settings.buffer_size < least:
        raise ValueError(
            f"buffer_size = {settings.buffer_size}; must be at least {least}: n_steps = "
            f"{settings.n_steps} of {vehicles} vehicles"
        )


def check_budget(settings: Any, steps: int) -> None:
    """Raises ValueError for a training of `steps` that ends before its first gradient."""
    begin = getattr(settings, "learning_starts", -1)
    if steps <= begin:
        raise ValueError(
            f"steps = {steps}; must be above learning_starts = {begin}: until then actions are "
            "random and nothing is learned. Train longer, or lower learning_starts"
        )


@dataclass(frozen=True)
class Settings:
    """Settings of an algorithm, within LIMITS."""

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class PPOSettings(Settings):
    """Settings of PPO."""

    n_steps: int = 128
    """Control steps per vehicle between two updates: 2.5 s, longer than the horizon."""
    batch_size: int = 2048
    """Samples of one gradient step; large ones keep two cores busy with few calls."""
    n_epochs: int = 10
    """Passes over the samples of an update; half as many need twice the steps."""
    learning_rate: float = 7e-4
    """At the start; it falls linearly towards 0 over the training."""
    gamma: float = 0.985
    """Discount per control step: a horizon of 1.3 s at 50 Hz."""
    gae_lambda: float = 0.99
    """Trade-off of bias and variance in the advantage. Torque moves the vehicle sideways only after
    half a second: 0.95 looks 0.3 s ahead, and unlearns to come back to the path."""
    clip_range: float = 0.2
    """How far the probability of an action may move in one update."""
    ent_coef: float = 0.0
    """Weight of the entropy bonus; the reward leads without it."""
    log_std_init: float = -1.0
    """Logarithm of the initial standard deviation of the action; 0 shakes the vehicle."""
    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, for the policy and for the value."""


@dataclass(frozen=True)
class RecurrentPPOSettings(PPOSettings):
    """Settings of RecurrentPPO."""

    n_epochs: int = 4
    """Passes over the samples of an update; each one costs a run of the LSTM."""
    learning_rate: float = 1e-3
    """At the start; it falls linearly to 0 over the training."""
    hidden: tuple[int, ...] = (64,)
    """Units of the layers after the LSTM."""
    lstm_hidden: int = 64
    """Units of the action's LSTM; the value has none. A dozen hidden parameters need no more."""


@dataclass(frozen=True)
class OffPolicySettings(Settings):
    """What the algorithms with a replay buffer have in common."""

    buffer_size: int = 300_000
    """Transitions kept, the latest 94 s of 64 vehicles; 75 MB with a blind agent."""
    learning_starts: int = 10_000
    """Steps of random actions before the first gradient."""
    train_freq: int = 1
    """Steps of all vehicles between two updates."""
    gradient_steps: int = 2
    """Gradient steps of an update, for 64 new samples: what two cores manage."""
    batch_size: int = 1024
    """Samples of one gradient step: makes up for there being few."""
    n_steps: int = 4
    """Rewards that a target sums before it trusts the values: torque acts late. With 1, seeds of
    TD3 fail; with 8 it learns slowly."""
    learning_rate: float = 1e-3
    """At the start, high because batches are large; it falls linearly towards 0."""
    gamma: float = 0.98
    """Discount per control step: a horizon of one second at 50 Hz."""
    tau: float = 0.01
    """Share of the network that its target takes over per gradient step."""
    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers, for the policy and for the values."""


@dataclass(frozen=True)
class SACSettings(OffPolicySettings):
    """Settings of SAC."""

    ent_coef: str = "auto_0.1"
    """Weight of the entropy: learned, from this value on."""


@dataclass(frozen=True)
class TD3Settings(OffPolicySettings):
    """Settings of TD3."""

    action_noise: float = 0.1
    """Standard deviation of the noise added to the action while exploring."""


@dataclass(frozen=True)
class TQCSettings(OffPolicySettings):
    """Settings of TQC."""

    batch_size: int = 512
    """Samples of one gradient step: half of SAC's, each costs twice as much."""
    ent_coef: str = "auto_0.002"
    """Weight of the entropy: learned, from this value on; small, as rewards are scaled."""
    top_quantiles_to_drop_per_net: int = 2
    """Of 25: more makes the values more careful."""


class _Tanh(torch.autograd.Function):
    """tanh of a tensor of the processor, by NumPy."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor) -> torch.Tensor:
        y = torch.from_numpy(np.tanh(x.detach().numpy()))
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> torch.Tensor:
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(gradient, y)


class Tanh(nn.Module):
    """torch.nn.Tanh, to the rounding of single precision."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """tanh(x)."""
        y: torch.Tensor = _Tanh.apply(x)
        return y


class GaussianPolicy(ActorCriticPolicy):
    """ActorCriticPolicy of a Gaussian action, for observations and actions that are vectors."""

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Action (N, 2), value (N, 1) and logarithm of the density of the action (N,)."""
        latent_pi, latent_vf = self.mlp_extractor(obs)
        mean = self.action_net(latent_pi)
        noise = torch.zeros_like(mean) if deterministic else torch.randn_like(mean)
        action = mean + noise * self.log_std.exp()
        return action, self.value_net(latent_vf), self._log_density(noise)

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Value (N, 1), logarithm of the density of actions (N,), and entropy (N,)."""
        latent_pi, latent_vf = self.mlp_extractor(obs)
        noise = (actions - self.action_net(latent_pi)) * torch.exp(-self.log_std)
        entropy = self.log_std.sum() + 0.5 * (1.0 + LOG_2_PI) * actions.shape[1]
        return self.value_net(latent_vf), self._log_density(noise), entropy.expand(len(actions))

    def _log_density(self, noise: torch.Tensor) -> torch.Tensor:
        """Of actions that are `noise` (N, 2) standard deviations from the mean, (N,)."""
        constant = self.log_std.sum() + 0.5 * LOG_2_PI * noise.shape[1]
        return -0.5 * (noise * noise).sum(dim=1) - constant


class BypassedLSTM(nn.LSTM):
    """An LSTM whose output is followed by its input."""

    def forward(self, input: Any, hx: Any = None) -> tuple[torch.Tensor, Any]:  # type: ignore[override]
        """Output and input (T, N, hidden + input), and the state."""
        output, state = super().forward(input, hx)
        return torch.cat([output, input], dim=-1), state


class BypassedLstmPolicy(RecurrentActorCriticPolicy):
    """RecurrentActorCriticPolicy with that LSTM for the action and none for the value."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{**options, "enable_critic_lstm": False})
        hidden = self.lstm_actor.hidden_size
        self.lstm_actor = BypassedLSTM(self.features_dim, hidden)
        self.critic = nn.Linear(self.features_dim, self.lstm_output_dim)
        options = {**self.optimizer_kwargs, "lr": self.optimizer.param_groups[0]["lr"]}
        self.optimizer = self.optimizer_class(self.parameters(), **options)

    def _build_mlp_extractor(self) -> None:
        self.lstm_output_dim += self.features_dim
        super()._build_mlp_extractor()


class FallingRate:
    """Learning rate of an update: `start` times the share of the training that was still to come
    when its samples began to be collected, so that no update has the rate 0.

    Stable-Baselines3 asks with the share behind the samples, 0 in the last update. A learner writes
    the other one to `remaining` at the beginning of each rollout; before the first it is 1.
    """

    def __init__(self, start: float) -> None:
        self.start, self.remaining = start, 1.0

    def __call__(self, progress_remaining: float) -> float:
        return self.start * self.remaining


class Algorithm(NamedTuple):
    """What a training must know of an algorithm.

    settings: a frozen dataclass whose docstrings become the help of `--NAME.FIELD`. One that has
    `learning_rate` should be lowered when a training diverges. learner: makes an untrained agent in
    the environment of a run (`agents.learners.Learner`); None: one of Stable-Baselines3.
    """

    model: Any  # class of Stable-Baselines3, None for any other algorithm
    settings: type[Any]
    learner: Callable[[Any], Any] | None
    steps: int  # of a training, over all vehicles, where --steps is not given
    network: str  # algorithm of Stable-Baselines3 whose form of network an archive holds
    policy: str | type[BasePolicy] = "MlpPolicy"  # of a model of Stable-Baselines3
    smoothness: float = 0.0  # [-] action-rate penalty (agents.environments) without --smoothness
    scaled: bool = False  # whether rewards come times 1 - gamma; settings have `gamma` then
    checkpoint_every: int = 20_000  # [steps] without --checkpoint-every; 0: before every rollout


ALGORITHMS: dict[str, Algorithm] = {}


def register(name: str, algorithm: Algorithm) -> None:
    """Make an algorithm known as `--agent NAME`, with its settings as `--NAME.FIELD`.

    Raises ValueError for a name that is taken, or is no word of lower-case letters and hyphens.
    """
    if name in ALGORITHMS:
        raise ValueError(f"algorithm {name!r} is registered already")
    if not name.replace("-", "_").isidentifier() or name != name.lower() or "_" in name:
        raise ValueError(f"algorithm {name!r}; must be lower-case letters, digits and hyphens")
    ALGORITHMS[name] = algorithm


_ON: dict[str, Any] = {"smoothness": SMOOTHNESS, "scaled": True, "checkpoint_every": 0}
register("ppo", Algorithm(PPO, PPOSettings, None, 2_000_000, "ppo", GaussianPolicy, **_ON))
register("sac", Algorithm(SAC, SACSettings, None, 300_000, "sac"))
register("td3", Algorithm(TD3, TD3Settings, None, 300_000, "td3"))
register("tqc", Algorithm(TQC, TQCSettings, None, 300_000, "tqc", scaled=True))
_RECURRENT = RecurrentPPO, RecurrentPPOSettings, None, 1_000_000, "recurrent-ppo"
register("recurrent-ppo", Algorithm(*_RECURRENT, BypassedLstmPolicy, **_ON))


def make_model(
    name: str, settings: Any, env: VecEnv, seed: int, log: str | None = None
) -> BaseAlgorithm:
    """An untrained model on `env`. seed: of the networks, the exploration and the vehicles.

    log: folder of TensorBoard's logs. Raises ValueError for settings that the algorithm refuses.
    """
    if hasattr(settings, "buffer_size"):
        check_buffer(settings, env.num_envs)
    options: dict[str, Any] = asdict(settings)
    optimizer: dict[str, Any] = {"fused": True}
    network: dict[str, Any] = {"net_arch": list(options.pop("hidden"))}
    if "log_std_init" in options:  # on-policy
        network.update(log_std_init=options.pop("log_std_init"), activation_fn=Tanh)
        optimizer["eps"] = 1e-5  # Stable-Baselines3 takes it where no other option is given
    if "lstm_hidden" in options:
        network["lstm_hidden_size"] = options.pop("lstm_hidden")
    network["optimizer_kwargs"] = optimizer
    rate = FallingRate(options.pop("learning_rate"))
    if "action_noise" in options:  # of both sprockets
        deviation = np.full(2, options["action_noise"])
        options["action_noise"] = NormalActionNoise(np.zeros(2), deviation)
    options.update(seed=seed, device="cpu", tensorboard_log=log, policy_kwargs=network)
    try:
        kind, policy = ALGORITHMS[name].model, ALGORITHMS[name].policy
        model: BaseAlgorithm = kind(policy, env, learning_rate=rate, **options)
    except AssertionError as error:  # how SB3 refuses settings
        raise ValueError(f"{name}: {error}") from error
    return model
