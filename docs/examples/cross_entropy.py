"""Cross-entropy search: linear policies are drawn, and the best of them say where to draw next."""

from dataclasses import dataclass

import numpy as np

from agents.algorithms import Algorithm, register
from agents.archive import build
from agents.checkpoint import capture_environment, resume_environment
from agents.environments import make_environment
from agents.folder import Diverged, Trained
from baselines.learned.agent_policy import AgentPolicy


@dataclass(frozen=True)
class CrossEntropySettings:
    """Settings of the cross-entropy search."""

    horizon: int = 100
    """Control steps for which each candidate drives one of the vehicles."""

    elite: float = 0.2
    """Share of the candidates around which the next ones are drawn."""

    spread: float = 0.1
    """Standard deviation of the first weights."""


class CrossEntropyLearner:
    """Every vehicle starts anew with weights of its own; the best share of them is kept."""

    column = "mean_return"

    def __init__(self, run):
        self.settings = run.settings
        self.augmentation, self.groups = run.augmentation, run.groups
        self.env = make_environment(run)
        self.random = np.random.default_rng(run.seed)
        self.mean = np.zeros((2, self.env.observation_space.shape[0] + 1))  # weights and bias
        self.deviation = np.full_like(self.mean, run.settings.spread)
        self.steps = 0

    def learn(self, progress):
        value = float("nan")
        while self.steps < progress.options.steps:
            value = self.generation(progress)
            progress.between(round(value, 3))
        progress.finish(round(value, 3))

    def generation(self, progress):
        """Draw candidates, let them drive, and move to the best of them; returns their mean."""
        count = self.env.num_envs
        noise = self.random.standard_normal((count, *self.mean.shape))
        weights, returns = self.mean + self.deviation * noise, np.zeros(count)
        observation = self.env.reset()
        for _ in range(self.settings.horizon):
            inputs = np.hstack([observation, np.ones((count, 1))])
            action = np.clip(np.einsum("nad,nd->na", weights, inputs), -1.0, 1.0)
            observation, reward, _, _ = self.env.step(action.astype(np.float32))
            returns += reward
            self.steps += count
            progress.count(count)
        best = weights[np.argsort(returns)[-max(int(self.settings.elite * count), 2) :]]
        self.mean, self.deviation = best.mean(axis=0), best.std(axis=0)
        if not np.isfinite(self.mean).all():
            raise Diverged(f"the training diverged at {self.steps:,} steps")
        return float(returns.mean())

    def network(self):
        """The mean of the candidates as a policy of PPO without hidden layers."""
        form = {"inputs": self.mean.shape[1] - 1, "hidden": [], "activation": "tanh"}
        weights = {
            "log_std": np.zeros(2, np.float32),
            "action_net.weight": self.mean[:, :-1].astype(np.float32),
            "action_net.bias": self.mean[:, -1].astype(np.float32),
        }
        return build("ppo", form, weights)

    def policy(self, context):
        return AgentPolicy(self.network(), *self.augmentation, context, groups=self.groups)

    def trained(self):
        return Trained(self.network(), {"normalisation": None})

    def capture(self):
        return {
            "weights": (self.mean, self.deviation),
            "steps": self.steps,
            "random": self.random.bit_generator.state,
            "environment": capture_environment(self.env),
        }

    def resume(self, captured):
        self.mean, self.deviation = captured["weights"]
        self.steps = captured["steps"]
        self.random.bit_generator.state = captured["random"]
        resume_environment(self.env, captured["environment"])


register(
    "cross-entropy",
    Algorithm(None, CrossEntropySettings, CrossEntropyLearner, steps=1_000_000, network="ppo"),
)
