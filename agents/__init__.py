"""Reinforcement-learning agents: settings, training, loading. Needs the extra `rl`."""
