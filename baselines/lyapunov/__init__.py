"""Lyapunov tracking control of the speed-driven vehicle: laws, model, policies."""
