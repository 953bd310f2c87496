"""The folder of one training and its progress: curve, held-out episodes, best agent, checkpoints.

config.json                     the recipe; `"finished": true` when the training has ended
agent.zip, last.zip, curve.csv  of the training that config.json describes
checkpoint*.zip                 of `agents.checkpoint`, until it has ended
Files of these names are never replaced or deleted where config.json is not that of a training:
training there is refused.

A learner calls `Progress.between` at the moments at which its state is smallest: what is due then
is done. Held-out episodes tell how far from its path an agent is on vehicles that it is not trained
on. They are seeded from HELD_OUT_SEED on; trainings (`agents.run.random_seed`) and the benchmark's
episodes have other seeds. They are driven in one batch, with the policy in its benchmark form, and
draw nothing from the training's random streams: evaluating more often does not change the agent.
"""

import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from agents import checkpoint
from agents.archive import save_agent
from agents.run import Part, Run
from baselines.learned.trained_agent import current
from tracked_env import make_vec
from tracked_env.benchmark.files import temporary, write_atomically
from tracked_env.benchmark.policy_interface import Policy, PolicyContext
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]

CONFIG, CURVE = "config.json", "curve.csv"
ARCHIVES = ("agent.zip", "last.zip")
PRODUCTS = (*ARCHIVES, CURVE)
# Entries of every config.json that a training has written.
_RECIPE = {"algorithm", "augmentation", "config", "environment", "versions", "command"}
MAY_DIFFER = ("resume", "overwrite", "output", "tensorboard", "quiet", "trust")  # of a resumed one
HELD_OUT_SEED = 1_000_000
CURVE_ROWS = 200  # of a whole training, about
_STATE = {  # what a checkpoint holds of the progress
    "curve": None, "best": 0.0, "evaluated": 0, "saved": 0, "last_row": 0, "evaluating": 0.0,
    "spent": 0.0, "worked": 0.0,
}  # fmt: skip


class AlreadyFinished(Exception):
    """The training that is asked for has ended; its text says where the agent is."""


# What lies in the folder


def _recorded(folder: Path) -> dict[str, Any]:
    """The recipe in config.json, nothing in a folder without any file of a training.

    Raises ValueError for files of these names where config.json is not that of a training.
    """
    with suppress(OSError, ValueError, RecursionError, AttributeError):  # damaged, or no object
        recipe = current(json.loads((folder / CONFIG).read_text(encoding="utf-8")))
        if recipe.keys() >= _RECIPE and isinstance(recipe["config"], dict):
            return dict(recipe)
    names = (CONFIG, *PRODUCTS, checkpoint.FILE, checkpoint.PREVIOUS)
    foreign = [name for name in names if os.path.lexists(folder / name)]
    if foreign:
        raise ValueError(
            f"{folder} holds {', '.join(foreign)}, but no {CONFIG} that a training has written: "
            "nothing is changed there. Choose another --output, or move it away"
        )
    return {}


def going_on(run: Run) -> dict[str, Any] | None:
    """The checkpoint that a training goes on from, None where it begins.

    Raises AlreadyFinished where that training has ended, and ValueError where it would overwrite
    one or is another one.
    """
    options, folder = run.options, run.options.folder
    if options.resume and options.overwrite:
        raise ValueError("--resume goes on and --overwrite trains anew: choose one of them")
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"--output {folder} is a file; must be a folder, or not yet there")
    recorded = _recorded(folder)
    if options.overwrite:
        return None
    finished = recorded.get("finished") is True
    then, now = recorded.get("config", {}), run.recipe["config"]
    changed = [name for name in now if name not in MAY_DIFFER and then.get(name) != now[name]]
    if options.resume and recorded and changed:
        raise ValueError(
            "--resume goes on with the same configuration, but different are "
            + ", ".join(f"{name} (then {then.get(name)}, now {now[name]})" for name in changed)
            + ". Choose another --output, or give --overwrite instead"
        )
    if options.resume and finished:
        agent = folder / ARCHIVES[0]
        if not agent.exists():
            raise ValueError(
                f"{folder} holds a finished training, but {agent.name} is missing: put it back, "
                "or give --overwrite to train anew"
            )
        checkpoint.remove(folder)  # one may be left of a kill in the last moment
        raise AlreadyFinished(f"already finished: {agent}")
    captured = checkpoint.read(folder) if options.resume else None
    if captured is not None:
        return captured
    if finished:
        holds = "a finished training"
    elif checkpoint.present(folder):
        holds = "an unfinished training: add --resume to go on with it"
    elif any((folder / name).exists() for name in PRODUCTS):
        holds = "an agent"
    else:
        return None
    raise ValueError(
        f"{folder} holds {holds}; choose another --output, or give --overwrite to train anew"
    )


def begin(folder: Path, recipe: Mapping[str, Any], done: int) -> None:
    """Write the configuration. What lies there goes, unless the training goes on after `done`.

    Nothing is deleted before the new configuration is on the disk. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps(recipe, indent=2).encode()
    partial = temporary(folder / CONFIG)
    try:
        partial.write_bytes(content)
        if done:
            print(f"going on after {done:,} steps")
        else:
            checkpoint.remove(folder)
            for name in PRODUCTS:
                (folder / name).unlink(missing_ok=True)
        os.replace(partial, folder / CONFIG)
    finally:
        partial.unlink(missing_ok=True)


def finish(folder: Path, recipe: Mapping[str, Any]) -> None:
    """Say in the folder that its training has ended, and delete its checkpoints."""
    content = json.dumps({**recipe, "finished": True}, indent=2).encode()
    write_atomically(folder / CONFIG, content)
    checkpoint.remove(folder)


# What learns


class Trained(NamedTuple):
    """What an archive holds of an agent as it is now."""

    network: BasePolicy
    recipe: Mapping[str, Any]  # entries beside those of the run: its normalisation


class Learner(Protocol):
    """An agent that learns, in its own environment, whatever library it comes from.

    After `capture`, `resume` of a fresh learner of the same run and `learn`, it is the agent that
    learning on would have made, bit for bit: all random streams are part of the state.
    """

    column: str  # name of the number that it reports to `Progress`, a column of curve.csv

    @property
    def steps(self) -> int:
        """Environment steps done, over all vehicles."""

    def learn(self, progress: "Progress") -> None:
        """Learn until `progress.options.steps` steps are done.

        Calls `progress.count` after each step of all vehicles, `progress.between` between an
        update and the next samples, and `progress.finish` at the end. Raises Diverged for a
        network or a loss that is not finite, before anything of it is kept.
        """

    def policy(self, context: PolicyContext) -> Policy:
        """The agent as it is now, as a policy of the benchmark."""

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""

    def capture(self) -> dict[str, Any]:
        """Everything that the next step depends on, as `agents.checkpoint` can write."""

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put `capture` back into a fresh learner of the run. Raises any error if it misfits."""


class Diverged(Exception):
    """A network or a loss is not finite any more; the text says which one and when."""


def check_finite(network: nn.Module, losses: Mapping[str, Any], steps: int) -> None:
    """Raises Diverged for a parameter or a loss that is NaN or infinite. steps: done so far."""
    with torch.no_grad():
        named = dict(network.named_parameters())
        sums = torch.stack([value.abs().max() for value in named.values()])
        wrong = [name for name, sure in zip(named, torch.isfinite(sums), strict=True) if not sure]
    wrong += [name for name, value in losses.items() if not math.isfinite(value)]
    if wrong:
        raise Diverged(f"the training diverged at {steps:,} steps: {wrong[0]} is not finite")


# Held-out episodes


def make_held_out(run: Run) -> list[Part]:
    """The held-out episodes with their vehicles, none where there are to be none.

    Raises ValueError.
    """
    held_out = []
    for part in run.held_out:
        arguments: Any = {**part.arguments, "autoreset_mode": "Disabled"}
        env = make_vec(run.options.env, part.rows, **arguments)
        held_out.append(part._replace(env=env.unwrapped))
    return held_out


def held_out_errors(policy: Policy, env: TrackedVehicleVectorEnv, seed: int) -> Floats:
    """RMSE of the distance [m] of each held-out episode, (N,); row i is seeded seed + i.

    env: a batch in DISABLED mode, one row per episode. Steps after a vehicle has left its path
    count as the error at which it left, so leaving early is never the better score.
    """
    simulation = env.simulation
    steps = simulation.settings.max_steps
    observation, info = env.reset(seed=seed)
    limit = simulation.column("error_limit")
    state, start = None, np.ones(env.num_envs, dtype=bool)
    squares, gone = np.zeros(env.num_envs), np.zeros(env.num_envs, dtype=bool)
    for _ in range(steps):
        observation[gone] = np.nan_to_num(observation[gone])  # one may have diverged
        action, state = policy.predict(observation, state, start)
        start = np.zeros_like(start)
        observation, _, terminated, truncated, info = env.step(action)
        gone |= terminated
        distance = np.where(gone, limit, info["tracking_error"][:, 0])
        squares += distance**2
        if (terminated | truncated).all() and not truncated.any():
            squares += (steps - simulation.steps.max()) * limit**2
            break
    errors: Floats = np.sqrt(squares / steps)
    return errors


def held_out_rmse(policy: Callable[[PolicyContext], Policy], held_out: Sequence[Part]) -> float:
    """Interquartile mean of the RMSE of held-out episodes [m]; mean over the kinds of sensors.

    policy: makes that of a context. Of all episodes together the interquartile mean would leave
    out whole kinds of sensors, the best and the worst. NaN without episodes.
    """
    errors = [
        held_out_errors(policy(part.context), part.env, HELD_OUT_SEED + part.first)
        for part in held_out
    ]
    means = [interquartile_mean(each) for each in errors]
    return float(np.mean(means)) if means else float("nan")


class Progress:
    """Evaluates, saves and writes checkpoints between updates; counts steps in between.

    held_out: of each kind of sensors; without, it evaluates never. A learner calls `count` with the
    steps that it has done, which a progress bar may replace, as `on_text`, which gets a line to
    show. After the training: `best` [m].
    """

    count: Callable[[int], object] = staticmethod(lambda steps: None)
    on_text: Callable[[str], object] = staticmethod(lambda text: None)

    def __init__(self, run: Run, learner: Learner, held_out: Sequence[Part] = ()) -> None:
        self.options, self.folder = run.options, run.options.folder
        self.recipe = run.recipe
        self.learner, self.held_out = learner, held_out
        self.curve: list[tuple[float, ...]] = []
        self.best, self.evaluated, self.saved, self.last_row = float("inf"), 0, 0, 0
        self.spent, self.evaluating = 0.0, 0.0  # [s] before this process, and in evaluations
        self.worked = 0.0  # [s] of processor time before this process
        self._began, self._started = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """Time spent on this training so far, in all processes [s]."""
        return self.spent + time.perf_counter() - self._began

    @property
    def cpu_seconds(self) -> float:
        """Processor time of this training so far [s]: of one thread, its time on a free machine."""
        return self.worked + time.process_time() - self._started

    def between(self, value: float) -> None:
        """Do what is due after an update. value: of the learner's column in the curve."""
        done, options = self.learner.steps, self.options
        if done - self.last_row >= options.steps // CURVE_ROWS and done > self.last_row:
            self._note(value, float("nan"))
        if done - self.evaluated >= options.evaluate_every:
            self.evaluate(value)
        if done > self.saved and done - self.saved >= options.checkpoint_every:
            self.saved = done
            state = {"progress": self.capture(), "learner": self.learner.capture()}
            checkpoint.write(self.folder, state)

    def finish(self, value: float) -> None:
        """Evaluate and keep the last agent, unless `between` has just done so. value: as there."""
        if self.evaluated < self.learner.steps:
            self.evaluate(value)

    def evaluate(self, value: float) -> None:
        """Drive the held-out episodes, keep the agent, and apart from it the best one."""
        self.evaluated = self.learner.steps
        began = time.perf_counter()
        rmse = held_out_rmse(self.learner.policy, self.held_out)
        self.evaluating += time.perf_counter() - began
        better = rmse < self.best or not self.held_out
        self.best = rmse if rmse < self.best else self.best
        self._note(value, rmse)
        network, entries = self.learner.trained()
        recipe = {
            **self.recipe,
            **entries,
            "steps": self.learner.steps,
            "seconds": round(self.seconds, 1),
            "held_out_rmse": rmse if rmse == rmse else None,
        }
        best, last = (self.folder / name for name in ARCHIVES)
        save_agent(last, network, recipe)
        if better:
            write_atomically(best, last.read_bytes())
        lines = [f"steps,seconds,cpu_seconds,{self.learner.column},held_out_rmse"]
        lines += [f"{row[0]:.0f}," + ",".join(f"{of:g}" for of in row[1:]) for row in self.curve]
        write_atomically(self.folder / CURVE, "\n".join(lines).encode())

    def _note(self, value: float, rmse: float) -> None:
        """Add a row to the learning curve."""
        self.last_row = self.learner.steps
        times = round(self.seconds, 2), round(self.cpu_seconds, 2)
        self.curve.append((self.last_row, *times, value, rmse))
        name = self.learner.column.rpartition("_")[2]
        best = f", held out {self.best:.3f} m" if self.best < 1e9 else ""
        self.on_text(f"{name} {value:.4g}{best}")

    def capture(self) -> dict[str, Any]:
        """What a checkpoint holds of it."""
        state = {name: getattr(self, name) for name in _STATE}
        return {**state, "spent": self.seconds, "worked": self.cpu_seconds}

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises ValueError where it is something else."""
        checkpoint.check(_STATE, captured, "progress")
        checkpoint.check([], captured["curve"][:0], "curve")
        for row in captured["curve"]:
            checkpoint.check((0, 0.0, 0.0, np.nan, np.nan), row, "curve")
        for name, value in captured.items():
            setattr(self, name, value)
