"""One training: learn, look at held-out episodes now and then, keep the best, write checkpoints.

Held-out episodes are seeded from HELD_OUT_SEED on; trainings (`environment.random_seed`) and the
benchmark's episodes have other seeds. They are driven in one batch, with the policy in its
benchmark form, and draw nothing from the training's random streams: evaluating more often does not
change the agent.
"""

import math
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from torch import nn

from agents import checkpoints
from agents.archive import save_agent
from agents.environment import HeldOut
from agents.policy import Normalisation
from agents.privileged import policy_of
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.policy_interface import Policy, needs_truth
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.benchmark.store import write_atomically
from tracked_env.vector_env import TrackedVehicleVectorEnv

Floats = NDArray[np.float64]

HELD_OUT_SEED = 1_000_000
CURVE = ("steps", "seconds", "cpu_seconds", "mean_return", "held_out_rmse")
CURVE_ROWS = 200  # of a whole training, about
CHECKPOINT_EVERY = 20_000  # [steps] where a buffer of samples is written too


@dataclass(frozen=True)
class Schedule:
    """When what happens, all in environment steps over all vehicles."""

    total: int
    evaluate_every: int
    checkpoint_every: int  # 0: before every rollout


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


def normalisation(model: BaseAlgorithm) -> Normalisation | None:
    """The running normalisation of a model's environment, as it is now."""
    layer = model.get_vec_normalize_env()
    if layer is None:
        return None
    statistics: Any = layer.obs_rms
    return Normalisation(
        statistics.mean.copy(), statistics.var.copy(), layer.epsilon, layer.clip_obs
    )


def write_curve(folder: Path, names: Sequence[str], curve: Sequence[Sequence[float]]) -> None:
    """Write a learning curve; its first column are steps."""
    rows = [
        ",".join(f"{value:g}" if i else f"{value:.0f}" for i, value in enumerate(row))
        for row in curve
    ]
    write_atomically(folder / "curve.csv", "\n".join([",".join(names), *rows]).encode())


def held_out_errors(policy: Policy, env: TrackedVehicleVectorEnv, seed: int) -> Floats:
    """RMSE of the distance [m] of each held-out episode, (N,); row i is seeded seed + i.

    env: a batch in DISABLED mode, one row per episode. Steps after a vehicle has left its path
    count as the error at which it left, so leaving early is never the better score.
    """
    simulation = env.simulation
    steps, limit = simulation.settings.max_steps, simulation.solver.error_limit
    observation, info = env.reset(seed=seed)
    state, start = None, np.ones(env.num_envs, dtype=bool)
    squares = np.zeros(env.num_envs)
    gone = np.zeros(env.num_envs, dtype=bool)
    for _ in range(steps):
        observation[gone] = np.nan_to_num(observation[gone])  # one may have diverged
        if needs_truth(policy):
            policy.observe_truth(info["truth"])  # type: ignore[attr-defined]
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


def held_out_rmse(
    policy_in: Callable[[PolicyContext], Policy], held_out: Sequence[HeldOut]
) -> float:
    """Interquartile mean of the RMSE of held-out episodes [m]; mean over the kinds of sensors.

    policy_in: makes the policy of a context. Of all episodes together the interquartile mean
    would leave out whole kinds of sensors, the best and the worst. NaN without episodes.
    """
    means = [
        interquartile_mean(
            held_out_errors(policy_in(part.context), part.env, HELD_OUT_SEED + part.first)
        )
        for part in held_out
    ]
    return float(np.mean(means)) if means else float("nan")


class Trainer(BaseCallback):
    """Evaluates, saves and writes checkpoints between rollouts; counts steps in between.

    output: folder. schedule: when. recipe: what stands in every archive. policy: kind
    and options of `policy_of`. held_out: of each kind of sensors; without, it evaluates never.
    captured: of a checkpoint, to go on from. on_steps(n) after each step of the batch.
    """

    def __init__(
        self,
        output: Path,
        schedule: Schedule,
        recipe: Mapping[str, Any],
        policy: tuple[str, Mapping[str, Any]],
        held_out: Sequence[HeldOut],
        captured: Mapping[str, Any] | None = None,
        on_steps: Callable[[int], None] = lambda steps: None,
        on_text: Callable[[str], None] = lambda text: None,
    ) -> None:
        super().__init__()
        self.output, self.schedule, self.recipe = output, schedule, dict(recipe)
        self.policy_arguments, self.held_out = policy, held_out
        self.on_steps, self.on_text = on_steps, on_text
        self.curve: list[tuple[float, ...]] = []
        self.best, self.evaluated, self.saved, self.drawn = float("inf"), 0, 0, 0
        self.spent, self.evaluating = 0.0, 0.0  # [s] before this process, and in evaluations
        self.worked = 0.0  # [s] of processor time before this process
        if captured is not None:
            for name, value in captured["trainer"].items():
                setattr(self, name, value)
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
        return self.model.num_timesteps / max(self.seconds - self.evaluating, 1e-9)

    def _on_step(self) -> bool:
        self.on_steps(self.training_env.num_envs)
        return True

    def _on_rollout_start(self) -> None:
        """Between an update and the next rollout the state of a training is smallest."""
        self.check()
        done, schedule = self.model.num_timesteps, self.schedule
        if done - self.drawn >= schedule.total // CURVE_ROWS and done > self.drawn:
            self._note(float("nan"))
        if done - self.evaluated >= schedule.evaluate_every:
            self.evaluate()
        if done > self.saved and done - self.saved >= schedule.checkpoint_every:
            self.saved = done
            self._write_checkpoint()

    def check(self) -> None:
        """Raises Diverged after an update that has spoilt the networks, before anything is kept."""
        logged = self.logger.name_to_value
        losses = {name: value for name, value in logged.items() if name.endswith("loss")}
        check_finite(self.model.policy, losses, self.model.num_timesteps)

    def _write_checkpoint(self) -> None:
        names = ("curve", "best", "evaluated", "saved", "drawn", "evaluating")
        trainer = {name: getattr(self, name) for name in names}
        trainer.update(spent=self.seconds, worked=self.cpu_seconds)
        state = {"recipe": self.recipe, "trainer": trainer}
        checkpoints.write(self.output, {**state, **checkpoints.capture(self.model)})

    def _note(self, rmse: float) -> None:
        """Add a row to the learning curve."""
        ended: Any = self.model.ep_info_buffer or []
        returns = [float(info["r"]) for info in ended]
        mean = sum(returns) / len(returns) if returns else float("nan")
        self.drawn = self.model.num_timesteps
        times = round(self.seconds, 2), round(self.cpu_seconds, 2)
        self.curve.append((self.drawn, *times, round(mean, 3), rmse))
        self.on_text(
            f"return {mean:.0f}" + (f", held out {self.best:.3f} m" if self.best < 1e9 else "")
        )

    def evaluate(self) -> None:
        """Drive the held-out episodes, keep the agent, and apart from it the best one."""
        self.evaluated = self.model.num_timesteps
        statistics = normalisation(self.model)
        began = time.perf_counter()
        rmse = held_out_rmse(
            lambda context: policy_of(self.model, *self.policy_arguments, context, statistics),
            self.held_out,
        )
        self.evaluating += time.perf_counter() - began
        if self.held_out:
            self.logger.record("held_out/rmse", rmse)
        better = rmse < self.best or not self.held_out
        self.best = rmse if rmse < self.best else self.best
        self._note(rmse)
        stored = None
        if statistics is not None:
            stored = {
                "mean": statistics.mean.tolist(), "variance": statistics.variance.tolist(),
                "epsilon": statistics.epsilon, "clip": statistics.clip,
            }  # fmt: skip
        recipe = {
            **self.recipe, "normalisation": stored, "steps": self.model.num_timesteps,
            "seconds": round(self.seconds, 1), "held_out_rmse": rmse if rmse == rmse else None,
        }  # fmt: skip
        save_agent(self.output / "last.zip", self.model, recipe)
        if better:
            write_atomically(self.output / "agent.zip", (self.output / "last.zip").read_bytes())
        write_curve(self.output, CURVE, self.curve)

    def _on_training_end(self) -> None:
        self.check()
        self.evaluate()


def learn(model: BaseAlgorithm, trainer: Trainer) -> None:
    """Train to the end of the trainer's schedule.

    Raises Diverged, also for the errors that networks of NaN cause in a library.
    """
    left = trainer.schedule.total - model.num_timesteps
    if left <= 0:
        return
    try:
        model.learn(left, callback=trainer, reset_num_timesteps=model.num_timesteps == 0)
    except (ValueError, RuntimeError, ArithmeticError) as error:
        try:
            check_finite(model.policy, {}, model.num_timesteps)
        except Diverged as diverged:
            raise diverged from error
        # Finite parameters too may make a deviation that is not: exp(log_std).
        frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
        if frames[-1].f_globals["__name__"].startswith("torch.distributions"):
            raise Diverged(
                f"the training diverged at {model.num_timesteps:,} steps: the distribution of the "
                "action is not finite"
            ) from error
        raise


def checkpoint_interval(model: BaseAlgorithm, asked: int | None) -> int:
    """Steps between checkpoints: every rollout, or fewer where a replay buffer is written too."""
    if asked is not None:
        return asked
    return 0 if isinstance(model, OnPolicyAlgorithm) else CHECKPOINT_EVERY
