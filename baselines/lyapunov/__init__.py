"""Lyapunov tracking control of the speed-driven vehicle: laws, pose filter, policies."""

from baselines.lyapunov.lyapunov_laws import LyapunovGains
from baselines.lyapunov.slippage_aware import (
    AdaptiveSlipPolicy,
    OracleSlipPolicy,
    SlippageAwarePolicy,
    UnicyclePolicy,
)

__all__ = [
    "AdaptiveSlipPolicy",
    "LyapunovGains",
    "OracleSlipPolicy",
    "SlippageAwarePolicy",
    "UnicyclePolicy",
]
