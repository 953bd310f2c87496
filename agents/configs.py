"""Settings of each algorithm, tuned for 64 vehicles at 50 Hz on two processor cores.

The names are those of Stable-Baselines3, so that its documentation holds for them too; `hidden`,
`log_std_init` and `lstm_hidden` describe the networks. Each default stands with its reason.

Common to all: observations are of order one, and where `scaled` is set rewards are multiplied by
1 - gamma (`agents.reward`), so nothing is normalised; `smoothness` is the weight of the action-rate
penalty there, `steps` the length of the training; a horizon of 1 to 1.3 s is long compared with the
slowest pole of the vehicle, and learning is slower with two seconds; the learning rate falls
linearly to zero, so that the last agent is a settled one. A value outside LIMITS is a ValueError.

References: [1] Schulman et al., arXiv:1707.06347 (PPO). [2] Haarnoja et al., arXiv:1812.05905
(SAC). [3] Fujimoto et al., arXiv:1802.09477 (TD3). [4] Kuznetsov et al., arXiv:2005.04269 (TQC).
"""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from agents.reward import SMOOTHNESS

# Of the settings here and in train.py; a parenthesis leaves the bound out. Advantages are
# normalised over a batch, so one has two samples. Upper bounds leave out what cannot be meant: an
# update that moves every weight by more than 1, or more samples than a large machine can hold.
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


@dataclass(frozen=True)
class OnPolicyConfig:
    """What PPO and recurrent PPO have in common."""

    scaled: ClassVar[bool] = True
    smoothness: ClassVar[float] = SMOOTHNESS
    steps: ClassVar[int] = 2_000_000

    n_steps: int = 128
    """Control steps per vehicle between two updates: 2.5 s, longer than the horizon."""

    batch_size: int = 2048
    """Samples of one gradient step; large ones keep two cores busy with few calls."""

    n_epochs: int = 10
    """Passes over the samples of an update; half as many need twice the steps."""

    learning_rate: float = 7e-4
    """At the start; it falls linearly to 0 over the training."""

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
class PPOConfig(OnPolicyConfig):
    """PPO [1]: many cheap samples, few gradient steps; the fastest on two cores."""


@dataclass(frozen=True)
class RecurrentPPOConfig(OnPolicyConfig):
    """PPO [1] with an LSTM: remembers what it has seen, at several times the cost of PPO."""

    steps: ClassVar[int] = 1_000_000

    n_epochs: int = 4
    """Passes over the samples of an update; each one costs a run of the LSTM."""

    learning_rate: float = 1e-3
    """At the start; it falls linearly to 0 over the training."""

    hidden: tuple[int, ...] = (64,)
    """Units of the layers after the LSTM."""

    lstm_hidden: int = 64
    """Units of the action's LSTM; the value has none. A dozen hidden parameters need no more."""


@dataclass(frozen=True)
class OffPolicyConfig:
    """What the algorithms with a replay buffer have in common."""

    scaled: ClassVar[bool] = False  # scaled, SAC and TD3 had learned nothing after 150 000 steps
    smoothness: ClassVar[float] = 0.0  # with an action-rate penalty TD3 learns nothing, SAC less
    steps: ClassVar[int] = 300_000

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
    """At the start, high because batches are large; it falls linearly to 0."""

    gamma: float = 0.98
    """Discount per control step: a horizon of one second at 50 Hz."""

    tau: float = 0.01
    """Share of the network that its target takes over per gradient step."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers, for the policy and for the values."""

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class SACConfig(OffPolicyConfig):
    """SAC [2]: uses each sample many times; fewer steps, more time per step than PPO."""

    ent_coef: str = "auto_0.1"
    """Weight of the entropy: learned, from this value on."""


@dataclass(frozen=True)
class TD3Config(OffPolicyConfig):
    """TD3 [3]: like SAC with a deterministic policy and noise of fixed size."""

    action_noise: float = 0.1
    """Standard deviation of the noise added to the action while exploring."""


@dataclass(frozen=True)
class TQCConfig(OffPolicyConfig):
    """TQC [4]: SAC with a distribution of returns, its upper tail cut off."""

    scaled: ClassVar[bool] = True

    batch_size: int = 512
    """Samples of one gradient step: half of SAC's, each costs twice as much."""

    ent_coef: str = "auto_0.002"
    """Weight of the entropy: learned, from this value on; small, as rewards are scaled."""

    top_quantiles_to_drop_per_net: int = 2
    """Of 25: more makes the values more careful."""


AgentConfig = PPOConfig | RecurrentPPOConfig | SACConfig | TD3Config | TQCConfig


@dataclass(frozen=True)
class StudentConfig:
    """A student of a teacher: how the inference of the hidden parameters is regressed."""

    steps: ClassVar[int] = 500_000

    n_steps: int = 64
    """Control steps per vehicle between two regressions."""

    gradient_steps: int = 20
    """Gradient steps of a regression, for 4096 new samples of 64 vehicles."""

    batch_size: int = 1024
    """Samples of one gradient step, of all that the buffer holds."""

    buffer_size: int = 200_000
    """Samples kept, the latest 62 s of 64 vehicles; 100 MB."""

    learning_rate: float = 1e-3
    """At the start; it falls linearly to 0 over the training."""

    hidden: tuple[int, ...] = (128, 128)
    """Units of the hidden layers."""

    def __post_init__(self) -> None:
        check(self)
