"""TQC: SAC with a distribution of returns, its upper tail cut off.

Reference: Kuznetsov et al., arXiv:2005.04269.
"""

from dataclasses import dataclass

from sb3_contrib import TQC

from agents.algorithms.algorithm import Algorithm
from agents.algorithms.stable_baselines import (
    OFF_POLICY_STEPS,
    OffPolicySettings,
    learner_of,
    maker,
)


@dataclass(frozen=True)
class TQCSettings(OffPolicySettings):
    """Settings of TQC."""

    batch_size: int = 512
    """Samples of one gradient step: half of SAC's, each costs twice as much."""

    ent_coef: str = "auto_0.002"
    """Weight of the entropy: learned, from this value on; small, as rewards are scaled."""

    top_quantiles_to_drop_per_net: int = 2
    """Of 25: more makes the values more careful."""


ALGORITHM = Algorithm(
    TQC, TQCSettings, learner_of, OFF_POLICY_STEPS, network="tqc", make=maker(TQC), scaled=True
)
