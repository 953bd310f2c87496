"""Small trainings that the tests of agents share: a few hundred steps of a few vehicles."""

from pathlib import Path

import numpy as np

from agents.algorithms import (
    PPOSettings,
    RecurrentPPOSettings,
    SACSettings,
    TD3Settings,
    TQCSettings,
)
from agents.options import Options, options_of_train
from baselines.learned.agent_archive import WEIGHTS, from_npz, read_entry, read_recipe
from baselines.learned.agent_policy import Actor

Config = options_of_train()  # as the command line has it

OFF_POLICY = {"buffer_size": 2000, "learning_starts": 64, "batch_size": 32, "hidden": (16,)}
ON_POLICY = {"n_steps": 32, "batch_size": 128, "n_epochs": 2, "hidden": (16,)}

SETTINGS = {
    "ppo": PPOSettings(**ON_POLICY),
    "recurrent_ppo": RecurrentPPOSettings(**ON_POLICY),
    "sac": SACSettings(**OFF_POLICY),
    "td3": TD3Settings(**OFF_POLICY),
    "tqc": TQCSettings(**OFF_POLICY),
}


def small(output: Path, **changes) -> Options:
    """A configuration that trains in about a second; episodes last 1 s, so that many end."""
    defaults = {
        "steps": 512, "vehicles": 4, "duration": 1.0, "held_out": 2, "evaluate_every": 256,
        "uncertainty": ("mixture",), "output": output, "quiet": True, "seed": 3,
    }  # fmt: skip
    if changes.get("augmentation") != "student":
        name = (changes.get("agent") or "ppo").replace("-", "_")
        defaults[name] = SETTINGS[name]
    return Config(**{**defaults, **changes})


def parameters(path: Path) -> dict[str, np.ndarray]:
    """Network parameters in an archive, by name."""
    return from_npz(read_entry(path, WEIGHTS), WEIGHTS)


def same_parameters(one: Path, other: Path) -> bool:
    """Whether two archives hold the same networks, bit for bit."""
    first, second = parameters(one), parameters(other)
    assert list(first) == list(second)
    return all(np.array_equal(first[name], second[name]) for name in first)


def actor(path: Path) -> Actor:
    """The network in an archive, as it drives."""
    recipe = read_recipe(path)
    assert recipe is not None
    return Actor(recipe["algorithm"], recipe["network"], parameters(path))
