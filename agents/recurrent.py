"""The policy of recurrent PPO: an LSTM beside the observation, not in its way.

    action = MLP(LSTM(o_1 ... o_t), o_t)        value = MLP(o_t)
sb3-contrib's own policy shows its layers nothing but what the LSTM lets through, and a value that
shares the LSTM sends no gradient into it. Driving needs the errors of the moment, sharp and from
the first update on; the LSTM then only has to add what they do not tell.
"""

from typing import Any

import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy
from torch import nn


class BypassedLSTM(nn.LSTM):
    """An LSTM whose output is followed by its input."""

    def forward(self, input: Any, hx: Any = None) -> tuple[torch.Tensor, Any]:  # type: ignore[override]
        """Output and input (T, N, hidden + input), and the state."""
        output, state = super().forward(input, hx)
        return torch.cat([output, input], dim=-1), state


class BypassedLstmPolicy(RecurrentActorCriticPolicy):
    """RecurrentActorCriticPolicy with that LSTM for the action and none for the value."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Arguments as RecurrentActorCriticPolicy's; the value has no LSTM."""
        super().__init__(*arguments, **{**options, "enable_critic_lstm": False})
        hidden = self.lstm_actor.hidden_size
        self.lstm_actor = BypassedLSTM(self.features_dim, hidden)
        self.critic = nn.Linear(self.features_dim, self.lstm_output_dim)
        options = {**self.optimizer_kwargs, "lr": self.optimizer.param_groups[0]["lr"]}
        self.optimizer = self.optimizer_class(self.parameters(), **options)

    def _build_mlp_extractor(self) -> None:
        self.lstm_output_dim += self.features_dim
        super()._build_mlp_extractor()
