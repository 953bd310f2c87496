"""What the tests of agents share: trainings of a second, vehicles, archives with changes."""

import copy
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import VectorWrapper

import train
from agents import algorithms
from agents.archive import agent_entry
from agents.folder import Progress
from agents.learners import RolloutCallback
from agents.options import options_of_train
from baselines.learned.agent_policy import Actor
from baselines.learned.trained_agent import WEIGHTS, read_arrays, read_recipe
from tracked_env.benchmark import PolicyContext
from tracked_env.vector_env import TrackedVehicleVectorEnv

Config = options_of_train()  # as the command line has it
CONTEXT = PolicyContext(0.02, "sliding")
STEPS = 120  # more than two episodes of 1 s

OFF_POLICY = {"buffer_size": 2000, "learning_starts": 64, "batch_size": 32, "hidden": (16,)}
ON_POLICY = {"n_steps": 32, "batch_size": 128, "n_epochs": 2, "hidden": (16,)}

SETTINGS = {
    "ppo": algorithms.PPOSettings(**ON_POLICY),
    "recurrent_ppo": algorithms.RecurrentPPOSettings(**ON_POLICY),
    "sac": algorithms.SACSettings(**OFF_POLICY),
    "td3": algorithms.TD3Settings(**OFF_POLICY),
    "tqc": algorithms.TQCSettings(**OFF_POLICY),
}


def small(output, **changes):
    """A configuration that trains in about a second; episodes last 1 s, so that many end."""
    defaults = {
        "steps": 512, "vehicles": 4, "duration": 1.0, "held_out": 2, "evaluate_every": 256,
        "uncertainty": ("mixture",), "output": output, "quiet": True, "seed": 3,
    }  # fmt: skip
    name = (changes.get("agent") or "ppo").replace("-", "_")
    defaults[name] = SETTINGS[name]
    return Config(**{**defaults, **changes})


def archive_of(config):
    """Train; the archive of the best agent."""
    assert train.main(config) == 0
    return config.folder / "agent.zip"


def parameters(path):
    """Network parameters in an archive, by name."""
    return read_arrays(path, WEIGHTS)


def same_arrays(one, other):
    """Whether two archives hold the same networks, bit for bit."""
    first, second = parameters(one), parameters(other)
    assert list(first) == list(second)
    return all(np.array_equal(first[name], second[name]) for name in first)


def assert_same_curves(one, other, *columns):
    """Two folders have learning curves with the same columns, apart from times."""
    curves = [
        np.genfromtxt(folder / "curve.csv", delimiter=",", names=True) for folder in (one, other)
    ]
    for column in ("steps", "held_out_rmse", *columns):
        np.testing.assert_array_equal(curves[0][column], curves[1][column])


def actor(path):
    """The network in an archive, as it drives."""
    recipe = read_recipe(path)
    return Actor(recipe["algorithm"], recipe["network"], parameters(path))


def one_line(capsys):
    """The only line on stderr."""
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1 and shown.endswith("\n"), shown
    return shown


# Vehicles


class Recorded(VectorWrapper):
    """Keeps the commands that reach the vehicles."""

    def __init__(self, env):
        super().__init__(env)
        self.commands = []

    def step(self, actions):
        self.commands.append(np.array(actions))
        return super().step(actions)


def vehicles(count=3, **more):
    """Vehicles whose episodes last 1 s."""
    usual = {"uncertainty": "payload", "duration": 1.0, "autoreset_mode": "SameStep"}
    return TrackedVehicleVectorEnv(count, **{**usual, **more})


def commands(policy, env, steps=STEPS, seed=5):
    """Actions of a policy over the ends of episodes."""
    observation, _ = env.reset(seed=seed)
    state, start, actions = None, np.ones(env.num_envs, dtype=bool), []
    for _ in range(steps):
        action, state = policy.predict(observation, state, start, deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        start = terminated | truncated
        actions.append(np.array(action))
    return np.array(actions)


def as_evaluated(path):
    """Commands of the agent in an archive as a policy of the benchmark."""
    return commands(agent_entry(path).make(CONTEXT), vehicles())


# Trainings that end before their time


class Killed(Exception):
    """Stands for a signal that leaves no time for anything."""


def killed_after(steps, config, monkeypatch):
    """Run a training until `steps`, then stop it in the middle of a rollout."""
    done = 0
    original = RolloutCallback._on_step

    def step(callback):
        nonlocal done
        done += callback.training_env.num_envs
        if done > steps:
            raise Killed
        return original(callback)

    with monkeypatch.context() as patch:
        patch.setattr(RolloutCallback, "_on_step", step)
        with pytest.raises(Killed):
            train.main(config)


def interrupted_at(steps, config):
    """Run a training that gets a Ctrl-C before the first rollout after `steps`."""
    between = Progress.between

    def interrupt(progress, value):
        between(progress, value)
        if progress.learner.steps >= steps:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Progress, "between", interrupt)
        assert train.main(config) == 130


def interrupted_and_resumed(steps, config, folder):
    """Train, and in `folder` with a Ctrl-C after `steps`; the networks and curves are equal."""
    assert train.main(config) == 0
    parts = replace(config, output=folder)
    interrupted_at(steps, parts)
    assert train.main(parts) == 2  # would overwrite it
    assert train.main(replace(parts, resume=True)) == 0
    assert same_arrays(config.folder / "last.zip", folder / "last.zip")
    assert_same_curves(config.folder, folder, "mean_return")
    assert not list(folder.glob("*checkpoint*"))


def torn_in_two(steps, config, folder, monkeypatch):
    """Train, and in `folder` with a kill after `steps`; returns whether the networks are equal."""
    assert train.main(config) == 0
    torn = replace(config, output=folder)
    killed_after(steps, torn, monkeypatch)
    assert train.main(replace(torn, resume=True)) == 0
    return same_arrays(config.folder / "last.zip", folder / "last.zip")


# Archives with changes


class Harm:
    """Makes a folder when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.mkdir, (self.mark, 0o777, True, True)


# Values of every wrong type.
WRONG = (
    None, True, 0, -1, 5, 10**9, 1e308, float("nan"), float("inf"), "", "ppo", "\n", [], ["ppo"],
    [None], {}, {"ppo": 1}, [[]], -0.5,
)  # fmt: skip


def entries(path):
    """The files of an archive, by name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(path, files):
    """An archive of these files."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def branches(tree, where=(), width=2):
    """The place of everything in a tree of JSON; of lists the first `width` entries."""
    yield where
    inside = range(min(len(tree), width)) if isinstance(tree, list) else tree
    for key in inside if isinstance(tree, (dict, list)) else ():
        yield from branches(tree[key], (*where, key), width)


def put(tree, where, value):
    """A copy of a tree with something else in one place."""
    if not where:
        return value
    changed = copy.deepcopy(tree)
    place = changed
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = value
    return changed
