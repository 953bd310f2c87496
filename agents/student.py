"""The training of a student of a privileged teacher (`agents.inference`, `agents.privileged`).

The student drives from the first step on; what it meets, with the true inputs beside, goes into a
buffer on which the inference is regressed (DAgger [1]: the samples are those of the student's own
driving, not of the teacher's; as the adaptation module of RMA [2]). Truth is needed for that
regression alone; the policy that is evaluated and saved is an `AgentPolicy` with a history.

References: [1] Ross et al., arXiv:1011.0686. [2] Kumar et al., arXiv:2107.04034.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from agents import checkpoints
from agents.archive import normalisation_of, save_agent
from agents.configs import StudentConfig, check_buffer
from agents.environment import (
    HeldOut,
    control_period,
    driven,
    make_held_out,
    make_taught,
    random_seed,
)
from agents.inference import WEIGHTS, StudentModel, make_inference, weights
from agents.loading import load_teacher
from agents.policy import AgentPolicy, Normalisation
from agents.privileged import PRIVILEGED, Privileged
from agents.training import Schedule, check_finite, held_out_rmse, write_curve
from tracked_env import TORQUE_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.benchmark.store import write_atomically
from tracked_env.engine.env_config import EnvConfig

CURVE = ("steps", "seconds", "cpu_seconds", "loss", "held_out_rmse")
_CHANGING = (  # attributes that change while it learns
    "_filled", "_observation", "_state", "_start", "curve", "best", "steps", "evaluated", "saved",
    "spent", "worked",
)  # fmt: skip


class Student:
    """The training of a student.

    env, truths: of `make_taught`. teacher: its network and normalisation. held_out: of each kind
    of sensors; without, it evaluates never. After `learn`: `best` [m], `curve`.
    """

    def __init__(
        self,
        env: VecEnv,
        truths: Sequence[Privileged],
        teacher: tuple[BasePolicy, Normalisation | None],
        lags: tuple[int, ...],
        config: StudentConfig,
        seed: int,
        held_out: Sequence[HeldOut] = (),
    ) -> None:
        torch.manual_seed(seed)
        self.teacher = teacher[0]
        self.config, self.lags = config, lags
        self.env, self.truths = env, truths
        self.model = StudentModel(make_inference(lags, config.hidden), *teacher)
        self.optimiser = torch.optim.Adam(self.model.inference.parameters())
        size = max(config.buffer_size // env.num_envs, config.n_steps)
        shown = env.observation_space.shape
        assert shown is not None
        self._seen = torch.zeros(size, env.num_envs, *shown)
        self._true = torch.zeros(size, env.num_envs, len(PRIVILEGED))
        self._filled = 0  # rows of the buffer ever written
        self._random = np.random.default_rng(seed)
        self._observation: Any = env.reset()
        self._state: Any = None
        self._start = np.ones(env.num_envs, dtype=bool)
        self.held_out = held_out
        self.curve: list[tuple[float, ...]] = []
        self.best, self.steps, self.evaluated, self.saved = float("inf"), 0, 0, 0
        self.spent, self.worked = 0.0, 0.0  # [s] wall and processor time, in all processes

    @property
    def truth(self) -> Any:
        """What the teacher would see beside the present observation, (N, F) of all rows."""
        return self.model.told(np.concatenate([memory.present for memory in self.truths]))

    def policy(self, context: PolicyContext) -> AgentPolicy:
        """The student as the benchmark has it."""
        return AgentPolicy(self.model, "history", {"lags": self.lags}, context)

    def collect(self) -> float:
        """Drive `n_steps`; returns the mean square of how wrong the inference was meanwhile."""
        errors = 0.0
        for _ in range(self.config.n_steps):
            row = self._filled % len(self._seen)
            self._seen[row] = torch.from_numpy(self._observation)
            truth = self.truth
            self._true[row] = torch.from_numpy(truth)
            found = self.model.infer(self._observation)
            errors += float(np.mean((found - truth) ** 2))
            action, self._state = self.model.predict(
                self._observation, self._state, self._start, deterministic=True
            )
            self._observation, _, self._start, _ = self.env.step(action)
            self._filled += 1
        self.steps += self.config.n_steps * self.env.num_envs
        return errors / self.config.n_steps

    def regress(self, rate: float) -> None:
        """Gradient steps on samples of the buffer. rate: learning rate."""
        count = min(self._filled, len(self._seen)) * self.env.num_envs
        seen, true = self._seen.flatten(0, 1), self._true.flatten(0, 1)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        for _ in range(self.config.gradient_steps):
            rows = torch.from_numpy(self._random.integers(count, size=self.config.batch_size))
            loss = nn.functional.mse_loss(self.model.inference(seen[rows]), true[rows])
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()

    def capture(self) -> dict[str, Any]:
        """Everything that the next samples and regressions depend on."""
        filled = min(self._filled, len(self._seen))
        return {
            **{name: getattr(self, name) for name in _CHANGING},
            "inference": self.model.inference.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "buffer": (self._seen[:filled].numpy(), self._true[:filled].numpy()),
            "random": self._random.bit_generator.state,
            "environment": checkpoints.environment(self.env),
        }

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put everything that `capture` took into a fresh student of the same configuration."""
        for name in _CHANGING:
            setattr(self, name, captured[name])
        self.model.inference.load_state_dict(captured["inference"])
        self.optimiser.load_state_dict(captured["optimiser"])
        for buffer, stored in zip((self._seen, self._true), captured["buffer"], strict=True):
            buffer[: len(stored)] = torch.from_numpy(stored)
        self._random.bit_generator.state = captured["random"]
        checkpoints.resume_environment(self.env, captured["environment"])

    def learn(
        self,
        schedule: Schedule,
        folder: Path,
        recipe: Mapping[str, Any],
        on_steps: Callable[[int], None] = lambda steps: None,
        on_text: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Train to the end of the schedule. recipe: what stands in every archive.

        Between a regression and the next samples a checkpoint is written, when one is due. Raises
        Diverged for an inference that is not finite, before anything of it is kept.
        """
        began, total = time.perf_counter() - self.spent, schedule.total
        started = time.process_time() - self.worked
        while self.steps < total:
            before = self.steps
            loss = self.collect()
            self.regress(self.config.learning_rate * (1.0 - before / total))
            check_finite(self.model.inference, {"loss": loss}, self.steps)
            on_steps(self.steps - before)
            due = self.steps - self.evaluated >= schedule.evaluate_every or self.steps >= total
            rmse = held_out_rmse(self.policy, self.held_out) if due else float("nan")
            self.spent = time.perf_counter() - began
            self.worked = time.process_time() - started
            times = round(self.spent, 2), round(self.worked, 2)
            self.curve.append((self.steps, *times, round(loss, 5), rmse))
            on_text(f"loss {loss:.3f}, held out {self.best:.3f} m")
            if due:
                self.evaluated = self.steps
                self._save(folder, recipe, rmse)
            if self.steps - self.saved >= schedule.checkpoint_every:
                self.saved = self.steps
                checkpoints.write(folder, {"recipe": dict(recipe), "student": self.capture()})

    def _save(self, folder: Path, recipe: Mapping[str, Any], rmse: float) -> None:
        """Keep the student, and apart from it the best one."""
        reached = {
            "steps": self.steps, "seconds": round(self.spent, 2),
            "held_out_rmse": rmse if rmse == rmse else None,
        }  # fmt: skip
        files = {WEIGHTS: weights(self.model.inference)}
        save_agent(folder / "last.zip", self.teacher, {**recipe, **reached}, files)
        if rmse < self.best or not self.held_out:
            self.best = min(self.best, rmse)  # which a NaN does not change
            write_atomically(folder / "agent.zip", (folder / "last.zip").read_bytes())
        write_curve(folder, CURVE, self.curve)


def check_teacher(config: Any, arguments: Mapping[str, Any], recipe: Mapping[str, Any]) -> None:
    """Raises ValueError for a teacher of another control period, drive or nominal vehicle.

    Its privileged inputs would be ratios to other values, its actions other commands.
    """
    environment = recipe.get("environment", {})
    theirs = driven(environment.get("id", TORQUE_ID), environment)
    ours = driven(config.env, arguments)
    pairs: dict[str, tuple[Any, Any]] = {}
    pairs["control_period"] = (recipe["control_period"], control_period(config.env, arguments))
    for name in ("drive", "vehicle"):
        usual = EnvConfig._field_defaults[name]
        pairs[name] = theirs.get(name, usual), ours.get(name, usual)
    for name, (of_teacher, of_student) in pairs.items():
        if of_teacher != of_student:
            raise ValueError(
                f"teacher {config.teacher} was trained with {name} = {of_teacher}; its student "
                f"would have {of_student}. Is --env or --env-args another one?"
            )


def make_student(
    config: Any, arguments: Mapping[str, Any], captured: Mapping[str, Any] | None = None
) -> tuple[Student, dict[str, Any]]:
    """A student that is untrained or goes on, and what its recipe has from its teacher.

    config: of train.py. arguments: of the environment. captured: a checkpoint. Raises ValueError.
    """
    teacher, recipe = load_teacher(config.teacher, config.trust)
    check_teacher(config, arguments, recipe)
    check_buffer(config.student, config.vehicles)
    env, truths = make_taught(config, arguments)
    student = Student(
        env, truths, (teacher, normalisation_of(recipe)), tuple(config.lags), config.student,
        random_seed(config.seed), make_held_out(config, arguments),
    )  # fmt: skip
    if captured is not None:
        try:
            student.resume(captured["student"])
        except Exception as error:  # what is not as `capture` left it raises all sorts
            raise checkpoints.misfit(error) from error
    names = ("algorithm", "normalisation")
    return student, {**{name: recipe[name] for name in names}, "teacher": recipe}
