"""What a training needs of what learns, whatever library it comes from.

The progress of one training: learning curve, held-out episodes, the best agent, checkpoints.

A learner calls `between` at the moments at which its state is smallest: what is due then is done.
Held-out episodes draw nothing from the training's random streams.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import torch
from stable_baselines3.common.policies import BasePolicy
from torch import nn

from agents import checkpoint
from agents.archive import save_agent
from agents.held_out import HeldOut, held_out_rmse
from agents.run import Run
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import Policy
from tracked_env.benchmark.store import write_atomically

if TYPE_CHECKING:
    pass


class Trained(NamedTuple):
    """What an archive holds of an agent as it is now."""

    network: BasePolicy
    recipe: Mapping[str, Any]  # entries beside those of the run: its normalisation
    files: Mapping[str, bytes]  # beside its network


class Learner(Protocol):
    """An agent that learns, in its own environment.

    After `capture`, `resume` of a fresh learner of the same run and `learn`, it is the agent that
    learning on would have made, bit for bit: all random streams are part of the state.
    """

    column: str  # name of the number that it reports to `Progress`, a column of curve.csv
    recipe: Mapping[str, Any]  # entries of every archive and of config.json that the run lacks

    @property
    def steps(self) -> int:
        """Environment steps done, over all vehicles."""
        ...

    def learn(self, progress: "Progress") -> None:
        """Learn until `progress.schedule.total` steps are done.

        Calls `progress.count` after each step of all vehicles, `progress.between` between an
        update and the next samples, and `progress.finish` at the end. Raises Diverged for a
        network or a loss that is not finite, before anything of it is kept.
        """
        ...

    def policy(self, context: PolicyContext) -> Policy:
        """The agent as it is now, as a policy of the benchmark."""
        ...

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""
        ...

    def capture(self) -> dict[str, Any]:
        """Everything that the next step depends on, as `agents.state_file` can write."""
        ...

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took into a fresh learner of the same run.

        Raises any exception where it does not fit.
        """
        ...


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


CURVE_ROWS = 200  # of a whole training, about
_STATE = {  # what a checkpoint keeps of it
    "curve": None, "best": 0.0, "evaluated": 0, "saved": 0, "drawn": 0, "evaluating": 0.0,
    "spent": 0.0, "worked": 0.0,
}  # fmt: skip


def write_curve(folder: Path, column: str, curve: Sequence[Sequence[float]]) -> None:
    """Write a learning curve; its first column are steps. column: name of the fourth one."""
    names = ("steps", "seconds", "cpu_seconds", column, "held_out_rmse")
    rows = [
        ",".join(f"{value:g}" if i else f"{value:.0f}" for i, value in enumerate(row))
        for row in curve
    ]
    write_atomically(folder / "curve.csv", "\n".join([",".join(names), *rows]).encode())


class Progress:
    """Evaluates, saves and writes checkpoints between updates; counts steps in between.

    held_out: of each kind of sensors; without, it evaluates never. A learner calls `count` with the
    steps that it has done, which a progress bar may replace, as `on_text`, which gets a line to
    show. After the training: `best` [m].
    """

    count: Callable[[int], object] = staticmethod(lambda steps: None)
    on_text: Callable[[str], object] = staticmethod(lambda text: None)

    def __init__(self, run: Run, learner: Learner, held_out: Sequence[HeldOut] = ()) -> None:
        self.folder, self.schedule = run.folder, run.schedule
        self.recipe = {**run.recipe, **learner.recipe}
        self.learner, self.held_out = learner, held_out
        self.curve: list[tuple[float, ...]] = []
        self.best, self.evaluated, self.saved, self.drawn = float("inf"), 0, 0, 0
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

    @property
    def throughput(self) -> float:
        """Environment steps per second of learning; held-out episodes not counted."""
        return self.learner.steps / max(self.seconds - self.evaluating, 1e-9)

    def between(self, value: float) -> None:
        """Do what is due after an update. value: of the learner's column in the curve."""
        done, schedule = self.learner.steps, self.schedule
        if done - self.drawn >= schedule.total // CURVE_ROWS and done > self.drawn:
            self._note(value, float("nan"))
        if done - self.evaluated >= schedule.evaluate_every:
            self.evaluate(value)
        if done > self.saved and done - self.saved >= schedule.checkpoint_every:
            self.saved = done
            state = {"recipe": self.recipe, "progress": self.capture()}
            checkpoint.write(self.folder, {**state, "learner": self.learner.capture()})

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
        network, entries, files = self.learner.trained()
        recipe = {
            **self.recipe, **entries, "steps": self.learner.steps,
            "seconds": round(self.seconds, 1), "held_out_rmse": rmse if rmse == rmse else None,
        }  # fmt: skip
        save_agent(self.folder / "last.zip", network, recipe, files)
        if better:
            write_atomically(self.folder / "agent.zip", (self.folder / "last.zip").read_bytes())
        write_curve(self.folder, self.learner.column, self.curve)

    def _note(self, value: float, rmse: float) -> None:
        """Add a row to the learning curve."""
        self.drawn = self.learner.steps
        times = round(self.seconds, 2), round(self.cpu_seconds, 2)
        self.curve.append((self.drawn, *times, value, rmse))
        name = self.learner.column.rpartition("_")[2]
        best = f", held out {self.best:.3f} m" if self.best < 1e9 else ""
        self.on_text(f"{name} {value:.4g}{best}")

    def capture(self) -> dict[str, Any]:
        """What a checkpoint keeps of it."""
        kept = {name: getattr(self, name) for name in _STATE}
        return {**kept, "spent": self.seconds, "worked": self.cpu_seconds}

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises ValueError where it is something else."""
        checkpoint.check(_STATE, captured, "progress")
        checkpoint.check_curve(captured["curve"])
        for name, value in captured.items():
            setattr(self, name, value)
