"""The policy that a training evaluates and saves."""

from baselines.learned.agent_policy import AgentPolicy, AgentState, Normalisation, Predictor

__all__ = ["AgentPolicy", "AgentState", "Normalisation", "Predictor"]
