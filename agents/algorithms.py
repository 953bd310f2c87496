"""What a training must know of an algorithm: one record, registered by name.

Ranges of the settings of trainings, and the check of a dataclass of settings against them.

A student of a privileged teacher: regression of the hidden parameters on past samples.

It is chosen by `--augmentation student`, not by `--agent`: its network is that of its teacher,
whatever algorithm trained that one. The training itself: `agents.learners`.

The policy of PPO in Stable-Baselines3, computed with fewer and faster operations.

    action a = m(o) + s e,   e ~ N(0, 1),   log p(a) = -sum(e^2 / 2 + log s + log(2 pi) / 2)
    entropy  = sum(log s + (1 + log(2 pi)) / 2)
m is a multilayer perceptron, log s a parameter, the sums go over the components of the action. The
networks and the names of their weights are those of `ActorCriticPolicy`. `torch.tanh` takes about
ten times as long as NumPy's, and torch.distributions checks each value of each distribution.

What the algorithms of Stable-Baselines3 have in common, tuned for 64 vehicles at 50 Hz on two
processor cores.

The names of settings are those of Stable-Baselines3, so that its documentation holds for them too;
`hidden`, `log_std_init` and `lstm_hidden` describe the networks. Each default stands with its
reason.

Common to all: observations are of order one, and where the record says `scaled` rewards come times
1 - gamma (`agents.reward`), so nothing is normalised; a horizon of 1 to 1.3 s is long
against the slowest pole of the vehicle, and with two seconds learning is slower; the learning rate
falls linearly to zero, so that the last agent is a settled one. A value outside
`agents.algorithms.LIMITS` is a ValueError. All run on the CPU: networks of this size are
slower on a GPU.

PPO: many cheap samples, few gradient steps; the fastest on two cores.

Reference: Schulman et al., arXiv:1707.06347.

SAC: uses each sample many times; fewer steps, more time per step than PPO.

Rewards are not scaled: scaled, SAC had learned nothing after 150 000 steps. With an action-rate
penalty it learns less.

Reference: Haarnoja et al., arXiv:1812.05905.

TD3: like SAC with a deterministic policy and noise of fixed size.

Rewards are not scaled: scaled, TD3 had learned nothing after 150 000 steps. With an action-rate
penalty it learns nothing.

Reference: Fujimoto et al., arXiv:1802.09477.

TQC: SAC with a distribution of returns, its upper tail cut off.

Reference: Kuznetsov et al., arXiv:2005.04269.

The policy of recurrent PPO: an LSTM beside the observation, not in its way.

    action = MLP(LSTM(o_1 ... o_t), o_t)        value = MLP(o_t)
sb3-contrib's own policy shows its layers nothing but what the LSTM lets through, and a value that
shares the LSTM sends no gradient into it. Driving needs the errors of the moment, sharp and from
the first update on; the LSTM then only has to add what they do not tell.

PPO with an LSTM: it remembers what it has seen, at several times the cost of PPO.

Reference: Schulman et al., arXiv:1707.06347; policy of `agents.algorithms`.

The algorithms by name: a file for each, registered here.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
import torch
import tyro.conf
from sb3_contrib import TQC, RecurrentPPO
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from agents.reward import SMOOTHNESS

if TYPE_CHECKING:
    from agents.progress import Learner
    from agents.run import Run

Make = Callable[..., BaseAlgorithm]  # (settings, environment, seed, folder of TensorBoard logs)


class Algorithm(NamedTuple):
    """The record of an algorithm.

    settings: a frozen dataclass whose docstrings become the help of `--NAME.FIELD`. One that has
    `learning_rate` should be lowered when a training diverges.
    """

    model: Any  # class of Stable-Baselines3, None for any other algorithm
    settings: type[Any]
    learner: Callable[["Run"], "Learner"]  # an untrained agent in the environment of a run
    steps: int  # of a training, over all vehicles, where --steps is not given
    network: str  # algorithm of Stable-Baselines3 whose form of network an archive holds
    make: Make | None = None  # an untrained model of Stable-Baselines3
    smoothness: float = 0.0  # [-] action-rate penalty (agents.reward) without --smoothness
    scaled: bool = False  # whether rewards come times 1 - gamma; settings have `gamma` then
    checkpoint_every: int = 20_000  # [steps] without --checkpoint-every; 0: before every rollout


ALGORITHMS: dict[str, Algorithm] = {}


def register(name: str, algorithm: Algorithm) -> None:
    """Make an algorithm known as `--agent NAME`, with its settings as `--NAME.FIELD`.

    Raises ValueError for a name that is taken, or is no word of lower-case letters and hyphens.
    """
    if name in ALGORITHMS:
        raise ValueError(f"algorithm {name!r} is registered already")
    field = name.replace("-", "_")
    if not field.isidentifier() or name != name.lower() or "_" in name:
        raise ValueError(f"algorithm {name!r}; must be lower-case letters, digits and hyphens")
    ALGORITHMS[name] = algorithm


# Of the settings of every algorithm and of train.py; a parenthesis leaves the bound out. Advantages
# are normalised over a batch, so one has two samples. Upper bounds leave out what cannot be meant:
# an update that moves every weight by more than 1, or more samples than a large machine can hold.
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


def _inside(value: Any, interval: str) -> bool:
    """Whether a number is in an interval; of `auto_0.1`, the number behind `auto_`."""
    low, high = (float(bound) for bound in interval[1:-1].split(","))
    if isinstance(value, str):
        try:
            value = float("1" if value == "auto" else value.removeprefix("auto_"))
        except ValueError:
            return False
    above = value > low if interval[0] == "(" else value >= low
    return above and (value < high if interval[-1] == ")" else value <= high)


def check(settings: Any) -> None:
    """Raises ValueError for a field of a dataclass that is outside LIMITS; None is inside."""
    for name in (field.name for field in fields(settings) if field.name in LIMITS):
        value, interval = getattr(settings, name), LIMITS[name]
        entries = value if isinstance(value, tuple) else (value,)
        if not all(entry is None or _inside(entry, interval) for entry in entries):
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


if TYPE_CHECKING:
    from agents.progress import Learner
    from agents.run import Run


@dataclass(frozen=True)
class StudentSettings:
    """Settings of augmentation student: how the inference of the hidden parameters is regressed."""

    n_steps: int = 64
    """Control steps per vehicle between two regressions."""

    gradient_steps: int = 20
    """Gradient steps of a regression, for 4096 new samples of 64 vehicles."""

    batch_size: int = 1024
    """Samples of one gradient step, of all that the buffer holds."""

    buffer_size: int = 200_000
    """Samples kept, the latest 62 s of 64 vehicles; 100 MB."""

    learning_rate: float = 1e-3
    """At the start; it falls linearly towards 0 over the training."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers."""

    lstm_hidden: Annotated[int | None, tyro.conf.arg(metavar="INTEGER")] = None
    """Units of an LSTM that sees `features` instead of past samples, and infers the true motion
    too, for a teacher that was trained with ideal sensors; without: none. It is regressed on
    sequences of n_steps, of which batch_size / n_steps make a gradient step."""

    features: Literal["reckoned", "estimates"] = "reckoned"
    """What the LSTM sees besides the observation: dead reckoning, or, on Torque-v0, the filtered
    motion and the parameters that the adaptive controller identifies."""

    def __post_init__(self) -> None:
        check(self)


def learner_of_student(run: "Run") -> "Learner":
    """A student of the teacher of a run. Raises ValueError."""
    # They import the archives.
    from agents.learners import RecurrentStudentLearner, StudentLearner

    return (RecurrentStudentLearner if run.settings.lstm_hidden else StudentLearner)(run)


STUDENT_ALGORITHM = Algorithm(
    None, StudentSettings, learner_of_student, steps=500_000, network="that of its teacher"
)


_LOG_2_PI = math.log(2.0 * math.pi)


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
        drawn = torch.zeros_like(mean) if deterministic else torch.randn_like(mean)
        action = mean + drawn * self.log_std.exp()
        return action, self.value_net(latent_vf), self._log_density(drawn)

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Value (N, 1), logarithm of the density of actions (N,), and entropy (N,)."""
        latent_pi, latent_vf = self.mlp_extractor(obs)
        drawn = (actions - self.action_net(latent_pi)) * torch.exp(-self.log_std)
        entropy = self.log_std.sum() + 0.5 * (1.0 + _LOG_2_PI) * actions.shape[1]
        return self.value_net(latent_vf), self._log_density(drawn), entropy.expand(len(actions))

    def _log_density(self, drawn: torch.Tensor) -> torch.Tensor:
        """Of actions that are `drawn` (N, 2) standard deviations from the mean, (N,)."""
        constant = self.log_std.sum() + 0.5 * _LOG_2_PI * drawn.shape[1]
        return -0.5 * (drawn * drawn).sum(dim=1) - constant


if TYPE_CHECKING:
    from agents.progress import Learner
    from agents.run import Run


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


@dataclass(frozen=True)
class OnPolicySettings:
    """What PPO and recurrent PPO have in common."""

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
    """Trade-off of bias and variance in the advantage. Torque moves the vehicle sideways only
    after half a second: 0.95 looks 0.3 s ahead, and unlearns to come back to the path."""

    clip_range: float = 0.2
    """How far the probability of an action may move in one update."""

    ent_coef: float = 0.0
    """Weight of the entropy bonus; the reward leads without it."""

    log_std_init: float = -1.0
    """Logarithm of the initial standard deviation of the action; 0 shakes the vehicle."""

    hidden: tuple[int, ...] = (64, 64)
    """Units of the hidden layers, for the policy and for the value."""

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class OffPolicySettings:
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

    def __post_init__(self) -> None:
        check(self)


OFF_POLICY_STEPS = 300_000


def learner_of(run: "Run") -> "Learner":
    """A model of Stable-Baselines3 in the environment of a run. Raises ValueError."""
    from agents.learners import Sb3Learner  # imports the archives, which import this

    return Sb3Learner(run)


def maker(
    model: type[BaseAlgorithm],
    policy: str | type[BasePolicy] = "MlpPolicy",
    **derived: Callable[[Any], Any],
) -> Make:
    """The function that makes an untrained model from settings, environment, seed and log folder.

    derived: arguments of the model that are no settings as they stand, as functions of them.
    """

    def make(settings: Any, env: VecEnv, seed: int, log: str | None = None) -> BaseAlgorithm:
        given: dict[str, Any] = asdict(settings)
        optimizer: dict[str, Any] = {"fused": True}
        network: dict[str, Any] = {"net_arch": list(given.pop("hidden"))}
        if "log_std_init" in given:  # on-policy
            network["log_std_init"] = given.pop("log_std_init")
            network["activation_fn"] = Tanh
            optimizer["eps"] = 1e-5  # Stable-Baselines3 takes it where no other option is given
        if "lstm_hidden" in given:
            network["lstm_hidden_size"] = given.pop("lstm_hidden")
        network["optimizer_kwargs"] = optimizer
        rate = given.pop("learning_rate")
        given.update({name: value(settings) for name, value in derived.items()})
        return model(
            policy, env, learning_rate=FallingRate(rate), policy_kwargs=network,
            seed=seed, device="cpu", tensorboard_log=log, **given,
        )  # fmt: skip

    return make


def make_model(
    name: str, settings: Any, env: VecEnv, seed: int, log: str | None = None
) -> BaseAlgorithm:
    """An untrained model on `env`. seed: of the networks, the exploration and the vehicles.

    Raises ValueError for settings that the algorithm refuses, or of another algorithm.
    """
    algorithm: Algorithm = ALGORITHMS[name]
    if not isinstance(settings, algorithm.settings):
        expected = algorithm.settings.__name__
        raise ValueError(f"{name} needs a {expected}, not {type(settings).__name__}")
    if hasattr(settings, "buffer_size"):
        check_buffer(settings, env.num_envs)
    assert algorithm.make is not None, f"{name} is no algorithm of Stable-Baselines3"
    try:
        return algorithm.make(settings, env, seed, log)
    except AssertionError as error:  # how SB3 refuses settings
        raise ValueError(f"{name}: {error}") from error


@dataclass(frozen=True)
class PPOSettings(OnPolicySettings):
    """Settings of PPO."""


ALGORITHM = Algorithm(
    PPO, PPOSettings, learner_of, steps=2_000_000, network="ppo",
    make=maker(PPO, GaussianPolicy), smoothness=SMOOTHNESS, scaled=True, checkpoint_every=0,
)  # fmt: skip


@dataclass(frozen=True)
class SACSettings(OffPolicySettings):
    """Settings of SAC."""

    ent_coef: str = "auto_0.1"
    """Weight of the entropy: learned, from this value on."""


ALGORITHM_SAC = Algorithm(
    SAC, SACSettings, learner_of, OFF_POLICY_STEPS, network="sac", make=maker(SAC)
)


@dataclass(frozen=True)
class TD3Settings(OffPolicySettings):
    """Settings of TD3."""

    action_noise: float = 0.1
    """Standard deviation of the noise added to the action while exploring."""


def noise(settings: TD3Settings) -> NormalActionNoise:
    """The exploration noise of both sprockets."""
    return NormalActionNoise(np.zeros(2), np.full(2, settings.action_noise))


ALGORITHM_TD3 = Algorithm(
    TD3, TD3Settings, learner_of, OFF_POLICY_STEPS, network="td3",
    make=maker(TD3, action_noise=noise),
)  # fmt: skip


@dataclass(frozen=True)
class TQCSettings(OffPolicySettings):
    """Settings of TQC."""

    batch_size: int = 512
    """Samples of one gradient step: half of SAC's, each costs twice as much."""

    ent_coef: str = "auto_0.002"
    """Weight of the entropy: learned, from this value on; small, as rewards are scaled."""

    top_quantiles_to_drop_per_net: int = 2
    """Of 25: more makes the values more careful."""


ALGORITHM_TQC = Algorithm(
    TQC, TQCSettings, learner_of, OFF_POLICY_STEPS, network="tqc", make=maker(TQC), scaled=True
)


class BypassedLSTM(nn.LSTM):
    """An LSTM whose output is followed by its input."""

    def forward(self, input: Any, hx: Any = None) -> tuple[torch.Tensor, Any]:  # type: ignore[override]
        """Output and input (T, N, hidden + input), and the state."""
        output, state = super().forward(input, hx)
        return torch.cat([output, input], dim=-1), state


class BypassedLstmPolicy(RecurrentActorCriticPolicy):
    """RecurrentActorCriticPolicy with that LSTM for the action and none for the value."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Arguments as RecurrentActorCriticPolicy's; the value has no LSTM."""
        super().__init__(*arguments, **{**options, "enable_critic_lstm": False})
        hidden = self.lstm_actor.hidden_size
        self.lstm_actor = BypassedLSTM(self.features_dim, hidden)
        self.critic = nn.Linear(self.features_dim, self.lstm_output_dim)
        options = {**self.optimizer_kwargs, "lr": self.optimizer.param_groups[0]["lr"]}
        self.optimizer = self.optimizer_class(self.parameters(), **options)

    def _build_mlp_extractor(self) -> None:
        self.lstm_output_dim += self.features_dim
        super()._build_mlp_extractor()


@dataclass(frozen=True)
class RecurrentPPOSettings(OnPolicySettings):
    """Settings of RecurrentPPO."""

    n_epochs: int = 4
    """Passes over the samples of an update; each one costs a run of the LSTM."""

    learning_rate: float = 1e-3
    """At the start; it falls linearly to 0 over the training."""

    hidden: tuple[int, ...] = (64,)
    """Units of the layers after the LSTM."""

    lstm_hidden: int = 64
    """Units of the action's LSTM; the value has none. A dozen hidden parameters need no more."""


ALGORITHM_RECURRENT_PPO = Algorithm(
    RecurrentPPO, RecurrentPPOSettings, learner_of, steps=1_000_000, network="recurrent-ppo",
    make=maker(RecurrentPPO, BypassedLstmPolicy), smoothness=SMOOTHNESS, scaled=True,
    checkpoint_every=0,
)  # fmt: skip


register("ppo", ALGORITHM)
register("sac", ALGORITHM_SAC)
register("td3", ALGORITHM_TD3)
register("tqc", ALGORITHM_TQC)
register("recurrent-ppo", ALGORITHM_RECURRENT_PPO)

__all__ = ["ALGORITHMS", "Algorithm", "make_model", "register"]
