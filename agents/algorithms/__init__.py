"""The algorithms by name. A file for each registers its record when it is imported."""

from agents.algorithms import ppo, recurrent_ppo, sac, td3, tqc
from agents.algorithms.algorithm import ALGORITHMS, Algorithm, register
from agents.algorithms.stable_baselines import make_model

__all__ = [
    "ALGORITHMS", "Algorithm", "make_model", "ppo", "recurrent_ppo", "register", "sac", "td3",
    "tqc",
]  # fmt: skip
