"""Trained agents as policies, without the library that trained them: recipe, weights, network."""
