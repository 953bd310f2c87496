"""Feedback-linearizing control of the torque-driven vehicle: law, controller, adaptive policies."""

from baselines.linearizing.adaptive_policy import AdaptivePolicy, IntegralPolicy
from baselines.linearizing.linearizing_law import TUNED_GAINS, Gains
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController
from baselines.linearizing.oracle_policy import OraclePolicy

__all__ = [
    "TUNED_GAINS",
    "AdaptivePolicy",
    "FeedbackLinearizingController",
    "Gains",
    "IntegralPolicy",
    "OraclePolicy",
]
