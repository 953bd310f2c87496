"""Networks of agents in PyTorch, and the files that hold them.

    {"inputs": 31, "hidden": [64, 64], "activation": "tanh", "lstm_hidden": null}
is the architecture in the recipe of an archive (`baselines.learned.trained_agent`); its weights are
plain arrays. The policy of Stable-Baselines3 is built from the architecture, then given the
weights: nothing is unpickled. Weights are those of the action alone; values, which only learning
needs, are left out.

Archives of train.py need neither PyTorch nor this package to drive
(`baselines.learned.trained_agent`). Those of `model.save` of Stable-Baselines3 hold pickled
objects: opening one runs whatever its author put there, so it takes `trust`. One on the plain
environment is loaded as a blind agent, with a notice.
"""

import io
import json
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from agents.algorithms import ALGORITHMS, BypassedLstmPolicy, Tanh
from baselines.batch_policy import Context
from baselines.learned import agent_policy, trained_agent
from baselines.learned.agent_policy import RECURRENT, AgentPolicy, Arrays
from baselines.learned.trained_agent import RECIPE, WEIGHTS, TrainedAgent, open_agent, read_recipe
from tracked_env import observation as layout
from tracked_env.benchmark.files import write_atomically
from tracked_env.benchmark.policies import archive_entry
from tracked_env.benchmark.policy_interface import PolicyEntry

PACKAGE = Path(__file__).resolve().parent
ACTIVATIONS: dict[str, type[nn.Module]] = {"tanh": Tanh, "relu": nn.ReLU}
# Prefixes of parameters that only learning needs: values, their targets, the target of the action.
_VALUES = ("value_net.", "mlp_extractor.value_net.", "critic", "actor_target.", "lstm_critic.")
# Order in which an archive without a recipe is tried: who is the pickiest comes first.
_TRIED = ("recurrent-ppo", "tqc", "sac", "td3", "ppo")


# Networks


def network_of(policy: Any) -> dict[str, Any]:
    """The architecture of a policy of train.py."""
    names: dict[Any, str] = {nn.Tanh: "tanh", **{kind: n for n, kind in ACTIVATIONS.items()}}
    return {
        "inputs": int(policy.observation_space.shape[0]),
        "hidden": list(policy.net_arch),
        "activation": names[policy.activation_fn],
        "lstm_hidden": getattr(getattr(policy, "lstm_actor", None), "hidden_size", None),
    }


def weights_of(policy: BasePolicy) -> Arrays:
    """The parameters that its action depends on, by name."""
    return {
        name: value.detach().cpu().numpy()
        for name, value in policy.state_dict().items()
        if not name.startswith(_VALUES)
    }


def build(algorithm: str, network: Mapping[str, Any], weights: Mapping[str, Any]) -> BasePolicy:
    """The policy with this architecture and these weights.

    Draws nothing from the random stream of PyTorch. Raises ValueError for weights of other names or
    shapes, and for one that is not finite.
    """
    kind: Any = ALGORITHMS[algorithm].model.policy_aliases.get("MlpPolicy")
    more: dict[str, Any] = {"activation_fn": ACTIVATIONS[network["activation"]]}
    if algorithm == RECURRENT:
        kind, more["lstm_hidden_size"] = BypassedLstmPolicy, network["lstm_hidden"]
    inputs = Box(-np.inf, np.inf, (network["inputs"],), np.float32)
    actions = Box(-1.0, 1.0, (2,), np.float32)
    with torch.random.fork_rng(devices=[]):
        policy: BasePolicy = kind(inputs, actions, lambda _: 0.0, list(network["hidden"]), **more)
    agent_policy.check_weights(
        weights, {name: value.shape for name, value in weights_of(policy).items()}
    )
    state = {name: torch.from_numpy(np.array(value)) for name, value in weights.items()}
    policy.load_state_dict(state, strict=False)
    policy.set_training_mode(False)
    return policy


def to_npz(weights: Mapping[str, Any]) -> bytes:
    """Arrays as the content of an npz file."""
    buffer = io.BytesIO()
    np.savez(buffer, **weights)
    return buffer.getvalue()


# Archives


def save_agent(path: Path, policy: BasePolicy, recipe: Mapping[str, Any]) -> None:
    """Write recipe and network as one archive, whole or not at all."""
    whole = {**recipe, "format": trained_agent.FORMAT, "network": network_of(policy)}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(RECIPE, json.dumps(whole, indent=1))
        archive.writestr(WEIGHTS, to_npz(weights_of(policy)))
    write_atomically(path, buffer.getvalue())


def load_network(path: Path, recipe: Mapping[str, Any]) -> BasePolicy:
    """The network in an archive, as the policy of Stable-Baselines3. recipe: of `read_recipe`.

    Raises ValueError for weights that are damaged, not finite, or not those of the architecture.
    """
    try:
        return build(
            recipe["algorithm"], recipe["network"], trained_agent.read_arrays(path, WEIGHTS)
        )
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error


def unpickled(path: Path) -> BaseAlgorithm:
    """The model in an archive of Stable-Baselines3, by the first algorithm that can load it.

    Runs whatever code is in the archive. Raises ValueError where none can.
    """
    errors = []
    for name in _TRIED:
        try:
            model: BaseAlgorithm = ALGORITHMS[name].model.load(path, device="cpu")
            return model
        except Exception as error:  # SB3 raises what happens to go wrong
            errors.append(f"{name}: {type(error).__name__}: {str(error)[:200]}")
    raise ValueError(f"agent {path} cannot be loaded as {'; '.join(errors)}")


def open_trusted(path: Path) -> TrainedAgent:
    """An agent in an archive of train.py, or in one of Stable-Baselines3 as a blind agent.

    Opening the latter runs any code of its author. Raises ValueError for a missing, damaged or
    foreign file, for an agent that sees or does something else than this environment offers, and
    where the statistics of a normalisation lie beside it.
    """
    path = Path(path)
    if read_recipe(path) is not None:
        return open_agent(path)
    model = unpickled(path).policy
    shown = model.observation_space.shape
    if shown != (layout.SIZE,) or model.action_space.shape != (2,):
        raise ValueError(
            f"agent {path} sees {shown} and acts {model.action_space}; must see ({layout.SIZE},) "
            "and act (2,). Was it trained on another environment, or inside a wrapper? Then pass "
            "it as module:function."
        )
    for beside in sorted(path.parent.glob("*.pkl")):
        if "normal" in beside.name.lower():
            raise ValueError(
                f"agent {path} has no recipe, and {beside.name} beside it looks like a "
                "normalisation (VecNormalize), which would not be applied. Train with train.py "
                "--normalise, or pass a policy that normalises as module:attribute"
            )
    text = "has no recipe of train.py: taken as a blind agent, observations not normalised"
    print(f"agent {path} {text}", file=sys.stderr)

    def make(context: Context) -> AgentPolicy:
        return AgentPolicy(model, "blind", {}, context)

    return TrainedAgent(make, (PACKAGE, PACKAGE.parent / "baselines" / "learned"))


def agent_entry(path: Path, trust: bool = False) -> PolicyEntry:
    """A trained agent as a policy of the benchmark.

    trust: open an archive of pickled objects too, as `open_trusted`. Raises ValueError.
    """
    return archive_entry(Path(path), open_trusted if trust else open_agent)
