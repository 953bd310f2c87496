"""SAC: uses each sample many times; fewer steps, more time per step than PPO.

Rewards are not scaled: scaled, SAC had learned nothing after 150 000 steps. With an action-rate
penalty it learns less.

Reference: Haarnoja et al., arXiv:1812.05905.
"""

from dataclasses import dataclass

from stable_baselines3 import SAC

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.stable_baselines import (
    OFF_POLICY_STEPS,
    OffPolicySettings,
    learner_of,
    maker,
)


@dataclass(frozen=True)
class SACSettings(OffPolicySettings):
    """Settings of SAC."""

    ent_coef: str = "auto_0.1"
    """Weight of the entropy: learned, from this value on."""


ALGORITHM = Algorithm(
    SAC, SACSettings, learner_of, OFF_POLICY_STEPS, network="sac", make=maker(SAC)
)
