"""Adaptive augmentation of the linearizing law: L1 and model-reference adaptive control."""
