"""PPO with an LSTM: it remembers what it has seen, at several times the cost of PPO.

Reference: Schulman et al., arXiv:1707.06347; policy of `agents.recurrent`.
"""

from dataclasses import dataclass

from sb3_contrib import RecurrentPPO

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.stable_baselines import OnPolicySettings, learner_of, maker
from agents.recurrent import BypassedLstmPolicy
from agents.training.reward import SMOOTHNESS


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


ALGORITHM = Algorithm(
    RecurrentPPO, RecurrentPPOSettings, learner_of, steps=1_000_000, network="recurrent-ppo",
    make=maker(RecurrentPPO, BypassedLstmPolicy), smoothness=SMOOTHNESS, scaled=True,
    checkpoint_every=0,
)  # fmt: skip
