"""The policy of PPO in Stable-Baselines3, computed with fewer and faster operations.

    action a = m(o) + s e,   e ~ N(0, 1),   log p(a) = -sum(e^2 / 2 + log s + log(2 pi) / 2)
    entropy  = sum(log s + (1 + log(2 pi)) / 2)
m is a multilayer perceptron, log s a parameter, the sums go over the components of the action. The
networks and the names of their weights are those of `ActorCriticPolicy`. `torch.tanh` takes about
ten times as long as NumPy's, and torch.distributions checks each value of each distribution.
"""

import math
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

_LOG_2_PI = math.log(2.0 * math.pi)


class _Tanh(torch.autograd.Function):
    """tanh of a tensor of the processor, by NumPy."""

    @staticmethod
    def forward(ctx: Any, x: torch.Tensor) -> torch.Tensor:
        y = torch.from_numpy(np.tanh(x.detach().numpy()))
        ctx.save_for_backward(y)
        return y

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> torch.Tensor:
        (y,) = ctx.saved_tensors
        return torch.ops.aten.tanh_backward(gradient, y)


class Tanh(nn.Module):
    """torch.nn.Tanh, to the rounding of single precision."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """tanh(x)."""
        y: torch.Tensor = _Tanh.apply(x)
        return y


class GaussianPolicy(ActorCriticPolicy):
    """ActorCriticPolicy of a Gaussian action, for observations and actions that are vectors."""

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Action (N, 2), value (N, 1) and logarithm of the density of the action (N,)."""
        latent_pi, latent_vf = self.mlp_extractor(obs)
        mean = self.action_net(latent_pi)
        drawn = torch.zeros_like(mean) if deterministic else torch.randn_like(mean)
        action = mean + drawn * self.log_std.exp()
        return action, self.value_net(latent_vf), self._log_density(drawn)

    def evaluate_actions(
        self, obs: Any, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Value (N, 1), logarithm of the density of actions (N,), and entropy (N,)."""
        latent_pi, latent_vf = self.mlp_extractor(obs)
        drawn = (actions - self.action_net(latent_pi)) * torch.exp(-self.log_std)
        entropy = self.log_std.sum() + 0.5 * (1.0 + _LOG_2_PI) * actions.shape[1]
        return self.value_net(latent_vf), self._log_density(drawn), entropy.expand(len(actions))

    def _log_density(self, drawn: torch.Tensor) -> torch.Tensor:
        """Of actions that are `drawn` (N, 2) standard deviations from the mean, (N,)."""
        constant = self.log_std.sum() + 0.5 * _LOG_2_PI * drawn.shape[1]
        return -0.5 * (drawn * drawn).sum(dim=1) - constant
