"""What the algorithms of Stable-Baselines3 have in common, tuned for 64 vehicles at 50 Hz on two
processor cores.

The names of settings are those of Stable-Baselines3, so that its documentation holds for them too;
`hidden`, `log_std_init` and `lstm_hidden` describe the networks. Each default stands with its
reason.

Common to all: observations are of order one, and where the record says `scaled` rewards come times
1 - gamma (`agents.training.reward`), so nothing is normalised; a horizon of 1 to 1.3 s is long
against the slowest pole of the vehicle, and with two seconds learning is slower; the learning rate
falls linearly to zero, so that the last agent is a settled one. A value outside
`agents.algorithms.settings.LIMITS` is a ValueError. All run on the CPU: networks of this size are
slower on a GPU.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv

from agents.algorithms.algorithm import ALGORITHMS, Algorithm, Make
from agents.algorithms.settings import check, check_buffer
from agents.gaussian_policy import Tanh

if TYPE_CHECKING:
    from agents.training.learner import Learner
    from agents.training.run import Run


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
    from agents.training.sb3_learner import Sb3Learner  # imports the archives, which import this

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
