"""Lyapunov tracking control of the speed-driven vehicle: laws, pose filter, policies."""
