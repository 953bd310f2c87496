"""The training of a student of a privileged teacher (`agents.inference`, `agents.privileged`).

The student drives from the first step on; what it meets, with the true inputs beside, goes into a
buffer on which the inference is regressed (DAgger [1]: the samples are those of the student's own
driving, not of the teacher's; as the adaptation module of RMA [2]). Truth is needed for that
regression alone; the policy that is evaluated and saved is an `AgentPolicy` with a history.

References: [1] Ross et al., arXiv:1011.0686. [2] Kumar et al., arXiv:2107.04034.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import nn

from agents.algorithms.settings import check_buffer
from agents.inference import StudentModel, make_inference, weights
from agents.loading import load_teacher
from agents.training import checkpoint_fit
from agents.training.arguments import control_period, driven
from agents.training.environment_state import capture_environment, resume_environment
from agents.training.environments import make_taught
from agents.training.learner import Trained, check_finite
from agents.training.progress import Progress
from agents.training.run import Run
from baselines.learned.agent_archive import INFERENCE
from baselines.learned.agent_policy import AgentPolicy, Normalisation
from baselines.learned.privileged_inputs import PRIVILEGED
from baselines.learned.recipe import groups_of, normalisation_of
from baselines.learned.student_network import widened_by
from tracked_env import TORQUE_ID
from tracked_env.benchmark import PolicyContext
from tracked_env.engine.env_config import EnvConfig

_CHANGING = ("_filled", "_observation", "_state", "_start", "steps")  # while it learns


class StudentLearner:
    """A student of the teacher of a run.

    Raises ValueError for a missing teacher, or one that has learned to drive something else.
    """

    column = "loss"
    outputs = len(PRIVILEGED)  # of the inference
    recipe: Mapping[str, Any]

    def __init__(self, run: Run) -> None:
        self.teacher, recipe = load_teacher(run.teacher, run.trust)
        check_teacher(run, recipe)
        self.settings = settings = run.settings
        check_buffer(settings, run.vehicles)
        self.options = run.augmentation.options
        self.groups = run.groups
        names = ("algorithm", "normalisation")
        self.recipe = {**{name: recipe[name] for name in names}, "teacher": recipe}
        env, self.truths = make_taught(run)
        self.env = env
        torch.manual_seed(run.seed)
        self.model = self._model(normalisation_of(recipe))
        self.optimiser = torch.optim.Adam(self.model.inference.parameters(), fused=True)
        size = max(settings.buffer_size // env.num_envs, settings.n_steps)
        self._rows = size - size % settings.n_steps
        shown = env.observation_space.shape
        assert shown is not None
        self._seen = torch.zeros(self._rows, env.num_envs, *shown)
        self._true = torch.zeros(self._rows, env.num_envs, self.outputs)
        self._filled = 0  # rows of the buffer ever written
        self._random = np.random.default_rng(run.seed)
        self._observation: Any = env.reset()
        self._state: Any = None
        self._start = np.ones(env.num_envs, dtype=bool)
        self.steps = 0

    def _model(self, scaling: Normalisation | None) -> Any:
        """The student with an inference that is not trained yet."""
        observed = sum(map(len, self.groups.values()))
        sheet = self.options.get("data_sheet", False)
        inference = make_inference(self.options["lags"], self.settings.hidden, observed, sheet)
        return StudentModel(inference, self.teacher, scaling, observed)

    @property
    def truth(self) -> Any:
        """What the teacher would see beside the present observation, (N, F) of all rows."""
        return self.model.privileged(np.concatenate([truth.present for truth in self.truths]))

    def policy(self, context: PolicyContext) -> AgentPolicy:
        """The student as the benchmark has it."""
        return AgentPolicy(self.model, *widened_by(self.options), context, groups=self.groups)

    def collect(self) -> float:
        """Drive `n_steps`; returns the mean square of how wrong the inference was meanwhile."""
        errors = 0.0
        for _ in range(self.settings.n_steps):
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
        self.steps += self.settings.n_steps * self.env.num_envs
        return errors / self.settings.n_steps

    def regress(self, rate: float) -> None:
        """Gradient steps on samples of the buffer. rate: learning rate."""
        count = min(self._filled, len(self._seen)) * self.env.num_envs
        seen, true = self._seen.flatten(0, 1), self._true.flatten(0, 1)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        for _ in range(self.settings.gradient_steps):
            rows = torch.from_numpy(self._random.integers(count, size=self.settings.batch_size))
            loss = nn.functional.mse_loss(self.model.inference(seen[rows]), true[rows])
            self.optimiser.zero_grad()
            loss.backward()
            self.optimiser.step()

    def learn(self, progress: Progress) -> None:
        """Learn to the end of the schedule.

        Raises Diverged for an inference that is not finite, before anything of it is kept.
        """
        total = progress.schedule.total
        while self.steps < total:
            before = self.steps
            loss = self.collect()
            self.regress(self.settings.learning_rate * (1.0 - before / total))
            check_finite(self.model.inference, {"loss": loss}, self.steps)
            progress.count(self.steps - before)
            progress.between(round(loss, 5))
        progress.finish(progress.curve[-1][3] if progress.curve else float("nan"))

    def trained(self) -> Trained:
        """The network of the teacher, and what infers its inputs."""
        return Trained(self.teacher, {}, {INFERENCE: weights(self.model.inference)})

    def capture(self) -> dict[str, Any]:
        """Everything that the next samples and regressions depend on."""
        filled = min(self._filled, len(self._seen))
        return {
            **{name: getattr(self, name) for name in _CHANGING},
            "inference": self.model.inference.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "buffer": (self._seen[:filled].numpy(), self._true[:filled].numpy()),
            "random": self._random.bit_generator.state,
            "environment": capture_environment(self.env),
        }

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises any exception where it does not fit."""
        for name in ("_filled", "_observation", "_start", "steps"):
            checkpoint_fit.check(getattr(self, name), captured[name], name)
        for name in _CHANGING:
            setattr(self, name, captured[name])
        self.model.inference.load_state_dict(captured["inference"])
        self.optimiser.load_state_dict(captured["optimiser"])
        for buffer, stored in zip((self._seen, self._true), captured["buffer"], strict=True):
            buffer[: len(stored)] = torch.from_numpy(stored)
        self._random.bit_generator.state = captured["random"]
        resume_environment(self.env, captured["environment"])


def check_teacher(run: Run, recipe: Mapping[str, Any]) -> None:
    """Raises ValueError for a teacher of another control period, drive, vehicle or observation.

    Its privileged inputs would be ratios to other values, its actions other commands, and its
    network would see other fields.
    """
    environment = recipe.get("environment", {})
    theirs = driven(environment.get("id", TORQUE_ID), environment)
    ours = driven(run.env, run.arguments)
    pairs: dict[str, tuple[Any, Any]] = {}
    pairs["control_period"] = (recipe["control_period"], control_period(run.env, run.arguments))
    for name in ("drive", "vehicle"):
        usual = EnvConfig._field_defaults[name]
        pairs[name] = theirs.get(name, usual), ours.get(name, usual)
    for name, (of_teacher, of_student) in pairs.items():
        if of_teacher != of_student:
            raise ValueError(
                f"teacher {run.teacher} was trained with {name} = {of_teacher}; its student "
                f"would have {of_student}. Is --env or --env-args another one?"
            )
    groups = groups_of(recipe)
    if list(groups.items()) != list(run.groups.items()):
        raise ValueError(
            f"teacher {run.teacher} was trained with observation = {[*groups]}; its student would "
            f"have {[*run.groups]}. Give both the same groups, in one order, in --env-args"
        )
