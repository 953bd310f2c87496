"""Adaptive augmentation of the linearizing law: L1 and model-reference adaptive control."""

from baselines.augmented.augmented_policy import L1Policy, L1Settings
from baselines.augmented.mrac import MracPolicy, MracSettings

__all__ = ["L1Policy", "L1Settings", "MracPolicy", "MracSettings"]
