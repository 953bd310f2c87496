"""Feedback-linearizing control of the torque-driven vehicle: law, controller, adaptive policies."""
