"""TD3: like SAC with a deterministic policy and noise of fixed size.

Rewards are not scaled: scaled, TD3 had learned nothing after 150 000 steps. With an action-rate
penalty it learns nothing.

Reference: Fujimoto et al., arXiv:1802.09477.
"""

from dataclasses import dataclass

import numpy as np
from stable_baselines3 import TD3
from stable_baselines3.common.noise import NormalActionNoise

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.stable_baselines import (
    OFF_POLICY_STEPS,
    OffPolicySettings,
    learner_of,
    maker,
)


@dataclass(frozen=True)
class TD3Settings(OffPolicySettings):
    """Settings of TD3."""

    action_noise: float = 0.1
    """Standard deviation of the noise added to the action while exploring."""


def noise(settings: TD3Settings) -> NormalActionNoise:
    """The exploration noise of both sprockets."""
    return NormalActionNoise(np.zeros(2), np.full(2, settings.action_noise))


ALGORITHM = Algorithm(
    TD3, TD3Settings, learner_of, OFF_POLICY_STEPS, network="td3",
    make=maker(TD3, action_noise=noise),
)  # fmt: skip
