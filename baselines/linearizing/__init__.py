"""Feedback linearization of the torque-driven vehicle: law, policy, adaptive policy."""
