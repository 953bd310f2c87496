"""PPO: many cheap samples, few gradient steps; the fastest on two cores.

Reference: Schulman et al., arXiv:1707.06347.
"""

from dataclasses import dataclass

from stable_baselines3 import PPO

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.stable_baselines import OnPolicySettings, learner_of, maker
from agents.gaussian_policy import GaussianPolicy
from agents.training.reward import SMOOTHNESS


@dataclass(frozen=True)
class PPOSettings(OnPolicySettings):
    """Settings of PPO."""


ALGORITHM = Algorithm(
    PPO, PPOSettings, learner_of, steps=2_000_000, network="ppo",
    make=maker(PPO, GaussianPolicy), smoothness=SMOOTHNESS, scaled=True, checkpoint_every=0,
)  # fmt: skip
