"""The network of a training as plain data: its architecture for JSON, its weights for an npz file.

    {"inputs": 31, "hidden": [64, 64], "activation": "tanh", "lstm_hidden": null}
The policy of Stable-Baselines3 is built from the architecture, then given the weights: nothing is
unpickled. Weights are those of the action alone; values, which only learning needs, are left out.
"""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from agents.algorithms import ALGORITHMS
from agents.gaussian_policy import Tanh
from agents.recurrent import BypassedLstmPolicy
from baselines.learned.forward_pass import RECURRENT, Arrays, check_weights

ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": Tanh, "relu": nn.ReLU}
# Prefixes of parameters that only learning needs: values, their targets, the target of the action.
_VALUES = (
    "value_net.", "mlp_extractor.value_net.", "critic.", "critic_target.", "actor_target.",
    "lstm_critic.",
)  # fmt: skip


def network_of(policy: BasePolicy) -> dict[str, Any]:
    """The architecture of a policy of train.py."""
    made: Any = policy
    names: dict[Any, str] = {nn.Tanh: "tanh", **{kind: n for n, kind in ACTIVATIONS.items()}}
    return {
        "inputs": int(policy.observation_space.shape[0]),  # type: ignore[index]
        "hidden": list(made.net_arch),
        "activation": names[made.activation_fn],
        "lstm_hidden": getattr(getattr(made, "lstm_actor", None), "hidden_size", None),
    }


def weights_of(policy: BasePolicy) -> Arrays:
    """The parameters that its action depends on, by name."""
    return {
        name: value.detach().cpu().numpy()
        for name, value in policy.state_dict().items()
        if not name.startswith(_VALUES)
    }


def build(algorithm: str, network: Mapping[str, Any], weights: Mapping[str, Any]) -> BasePolicy:
    """The policy with this architecture and these weights. Raises ValueError where they differ.

    Draws nothing from the random stream of PyTorch.
    """
    made: Any = ALGORITHMS[algorithm][0].policy_aliases.get("MlpPolicy")
    more: dict[str, Any] = {}
    if algorithm == RECURRENT:
        made, more = BypassedLstmPolicy, {"lstm_hidden_size": network["lstm_hidden"]}
    seen = Box(-np.inf, np.inf, (network["inputs"],), np.float32)
    act = Box(-1.0, 1.0, (2,), np.float32)
    activation = ACTIVATIONS[network["activation"]]
    with torch.random.fork_rng(devices=[]):
        policy: BasePolicy = made(
            seen, act, lambda _: 0.0, net_arch=list(network["hidden"]), activation_fn=activation,
            **more,
        )  # fmt: skip
    fill(policy, weights, weights_of(policy))
    policy.set_training_mode(False)
    return policy


def fill(module: nn.Module, weights: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Put weights into a network; expected: arrays as they must be, in name and shape.

    Raises ValueError for others, and for one that is not finite.
    """
    check_weights(weights, {name: value.shape for name, value in expected.items()})
    state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    module.load_state_dict(state, strict=False)


def to_npz(weights: Mapping[str, NDArray[Any]]) -> bytes:
    """Arrays as the content of an npz file."""
    buffer = io.BytesIO()
    arrays: Any = weights
    np.savez(buffer, **arrays)
    return buffer.getvalue()
