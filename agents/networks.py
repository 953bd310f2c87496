"""The network of an agent as plain data: its architecture for JSON, its weights for an npz file.

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
from agents.recurrent import BypassedLstmPolicy

Arrays = dict[str, NDArray[Any]]

RECURRENT = "recurrent-ppo"
ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": nn.Tanh, "relu": nn.ReLU}
MOST_UNITS, MOST_LAYERS = 4096, 16  # of a network that is built from a file
# Prefixes of parameters that only learning needs: values, their targets, the target of the action.
_VALUES = (
    "value_net.", "mlp_extractor.value_net.", "critic.", "critic_target.", "actor_target.",
    "lstm_critic.",
)  # fmt: skip


def network_of(policy: BasePolicy) -> dict[str, Any]:
    """The architecture of a policy of train.py."""
    made: Any = policy
    names = {kind: name for name, kind in ACTIVATIONS.items()}
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


def _is_size(value: Any) -> bool:
    return type(value) is int and 1 <= value <= MOST_UNITS


def are_sizes(value: Any) -> bool:
    """Whether a value of JSON is a list of sizes of layers."""
    return isinstance(value, list) and len(value) <= MOST_LAYERS and all(map(_is_size, value))


def checked_network(given: Any, algorithm: str) -> dict[str, Any]:
    """An architecture from JSON. Raises ValueError for one that cannot be built."""
    network = given if isinstance(given, dict) else {}
    recurrent = algorithm == RECURRENT
    lstm = network.get("lstm_hidden")
    activation = network.get("activation")
    if not (
        _is_size(network.get("inputs"))
        and are_sizes(network.get("hidden"))
        and isinstance(activation, str)
        and activation in ACTIVATIONS
        and (_is_size(lstm) if recurrent else lstm is None)
    ):
        raise ValueError(
            f"network = {str(given)[:200]!r}; must have `inputs`, a list `hidden` of at most "
            f"{MOST_LAYERS} sizes, `lstm_hidden` (null without LSTM), all within "
            f"[1, {MOST_UNITS}], and `activation`, one of {', '.join(ACTIVATIONS)}"
        )
    return network


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
    """Put weights into a network; expected: arrays as they must be, in name, shape and type.

    Raises ValueError for others, and for one that is not finite.
    """
    if set(weights) != set(expected):
        changed = sorted(set(weights) ^ set(expected))
        raise ValueError(f"its weights lack or have too much: {', '.join(changed)[:200]}")
    for name, value in weights.items():
        wanted = expected[name]
        if value.shape != wanted.shape or value.dtype != wanted.dtype:
            raise ValueError(
                f"weights {name} are {value.dtype} {value.shape}; must be {wanted.dtype} "
                f"{wanted.shape}, as its recipe says"
            )
        if not np.isfinite(value).all():
            raise ValueError(f"weights {name} are not finite. Did its training diverge?")
    state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    module.load_state_dict(state, strict=False)


def to_npz(weights: Mapping[str, NDArray[Any]]) -> bytes:
    """Arrays as the content of an npz file."""
    buffer = io.BytesIO()
    arrays: Any = weights
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def from_npz(content: bytes, name: str) -> Arrays:
    """The arrays of an npz file of that name. Raises ValueError for others, pickled ones too."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            if not hasattr(stored, "files"):
                raise ValueError("it is a single array")
            return {entry: stored[entry] for entry in stored.files}
    except Exception as error:  # a damaged file raises what happens to go wrong
        raise ValueError(f"{name} is no npz file of plain arrays ({str(error)[:200]})") from error
