"""Feedback-linearizing control of the torque-driven vehicle: law, controller, adaptive policies."""

from baselines.linearizing.adaptive_policy import AdaptivePolicy, IntegralPolicy, OraclePolicy
from baselines.linearizing.linearizing_law import TUNED_GAINS, Gains
from baselines.linearizing.linearizing_policy import FeedbackLinearizingController

__all__ = [
    "TUNED_GAINS",
    "AdaptivePolicy",
    "FeedbackLinearizingController",
    "Gains",
    "IntegralPolicy",
    "OraclePolicy",
]
