"""What a training needs of what learns, whatever library it comes from."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import Policy

if TYPE_CHECKING:
    from agents.training.progress import Progress


class Trained(NamedTuple):
    """What an archive holds of an agent as it is now."""

    network: BasePolicy
    recipe: Mapping[str, Any]  # entries beside those of the run: its normalisation
    files: Mapping[str, bytes]  # beside its network


class Learner(Protocol):
    """An agent that learns, in its own environment.

    After `capture`, `resume` of a fresh learner of the same run and `learn`, it is the agent that
    learning on would have made, bit for bit: all random streams are part of the state.
    """

    column: str  # name of the number that it reports to `Progress`, a column of curve.csv
    recipe: Mapping[str, Any]  # entries of every archive and of config.json that the run lacks

    @property
    def steps(self) -> int:
        """Environment steps done, over all vehicles."""
        ...

    def learn(self, progress: "Progress") -> None:
        """Learn until `progress.schedule.total` steps are done.

        Calls `progress.count` after each step of all vehicles, `progress.between` between an
        update and the next samples, and `progress.finish` at the end. Raises Diverged for a
        network or a loss that is not finite, before anything of it is kept.
        """
        ...

    def policy(self, context: PolicyContext) -> Policy:
        """The agent as it is now, as a policy of the benchmark."""
        ...

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""
        ...

    def capture(self) -> dict[str, Any]:
        """Everything that the next step depends on, as `agents.training.state_file` can write."""
        ...

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took into a fresh learner of the same run.

        Raises any exception where it does not fit.
        """
        ...


class Diverged(Exception):
    """A network or a loss is not finite any more; the text says which one and when."""


def check_finite(network: nn.Module, losses: Mapping[str, Any], steps: int) -> None:
    """Raises Diverged for a parameter or a loss that is NaN or infinite. steps: done so far."""
    with torch.no_grad():
        named = dict(network.named_parameters())
        sums = torch.stack([value.abs().max() for value in named.values()])
        wrong = [name for name, sure in zip(named, torch.isfinite(sums), strict=True) if not sure]
    wrong += [name for name, value in losses.items() if not math.isfinite(value)]
    if wrong:
        raise Diverged(f"the training diverged at {steps:,} steps: {wrong[0]} is not finite")
