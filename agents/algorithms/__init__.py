"""The algorithms by name: a file for each, registered here."""

from agents.algorithms import ppo, recurrent_ppo, sac, td3, tqc
from agents.algorithms.algorithm import ALGORITHMS, Algorithm, register
from agents.algorithms.stable_baselines import make_model

register("ppo", ppo.ALGORITHM)
register("sac", sac.ALGORITHM)
register("td3", td3.ALGORITHM)
register("tqc", tqc.ALGORITHM)
register("recurrent-ppo", recurrent_ppo.ALGORITHM)

__all__ = ["ALGORITHMS", "Algorithm", "make_model", "register"]
