"""What a training must know of an algorithm: one record, registered by name."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from stable_baselines3.common.base_class import BaseAlgorithm

if TYPE_CHECKING:
    from agents.training.learner import Learner
    from agents.training.run import Run

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
    smoothness: float = 0.0  # [-] action-rate penalty (agents.training.reward) without --smoothness
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
