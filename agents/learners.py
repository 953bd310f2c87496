"""What learns: the algorithms of Stable-Baselines3, and students of a privileged teacher.

A student drives from the first step on; what it meets, with the true inputs beside, goes into a
buffer on which the inference of the hidden parameters is regressed (DAgger [1]: the samples are
those of the student's own driving, not of the teacher's; as the adaptation module of RMA [2]).
Truth is needed for that regression alone; the policy that is evaluated and saved is an
`AgentPolicy` with a history. With an LSTM (`baselines.learned.student`) samples go into
the buffer in blocks of `n_steps`, with the state of the LSTM when the block began; the inference is
regressed on sequences of that length by back-propagation through time. That state comes from
earlier blocks, so that the memory reaches further back than a block does.

References: [1] Ross et al., arXiv:1011.0686. [2] Kumar et al., arXiv:2107.04034.
"""

import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from agents import checkpoint
from agents.algorithms import FallingRate, check_budget, check_buffer, make_model
from agents.archive import StudentModel, inference_weights, load_teacher, make_inference
from agents.environments import make_environment, make_taught
from agents.folder import Diverged, Learner, Progress, Trained, check_finite
from agents.run import Run
from baselines.learned.agent_policy import STUDENT, AgentPolicy, Normalisation
from baselines.learned.student import INFERENCE, policy_of, widened_by
from baselines.learned.trained_agent import drive_of, groups_of, normalisation_of
from tracked_env.benchmark.policy_interface import PolicyContext
from tracked_env.vehicles import vehicle_record

LARGEST_GRADIENT = 1.0  # [-] norm that a gradient of an LSTM is shortened to


def make_learner(run: Run) -> Learner:
    """What learns in a run, untrained. Raises ValueError."""
    usual = StudentLearner if run.options.learns == STUDENT else Sb3Learner
    learner: Learner = (run.algorithm.learner or usual)(run)
    return learner


class Sb3Learner:
    """A model of Stable-Baselines3 in the environment of a run. Raises ValueError."""

    column = "mean_return"
    recipe: Mapping[str, Any] = {}

    def __init__(self, run: Run) -> None:
        self.augmentation, self.groups = run.augmentation, run.groups
        env = make_environment(run)
        log = str(run.options.folder) if run.options.tensorboard else None
        self.model = make_model(run.options.learns, run.settings, env, run.seed, log)
        check_budget(run.settings, run.options.steps)

    @property
    def steps(self) -> int:
        """Environment steps done, over all vehicles."""
        return self.model.num_timesteps

    @property
    def normalisation(self) -> Normalisation | None:
        """The running normalisation of the environment, as it is now."""
        layer = self.model.get_vec_normalize_env()
        if layer is None:
            return None
        rms: Any = layer.obs_rms
        return Normalisation(rms.mean.copy(), rms.var.copy(), layer.epsilon, layer.clip_obs)

    @property
    def mean_return(self) -> float:
        """Of the last episodes that ended; NaN before the first one."""
        ended: Any = self.model.ep_info_buffer or []
        returns = [float(info["r"]) for info in ended]
        return round(sum(returns) / len(returns), 3) if returns else float("nan")

    def learn(self, progress: Progress) -> None:
        """Learn to the end of the schedule.

        Raises Diverged, also for the errors that networks of NaN cause in a library.
        """
        left, first = progress.options.steps - self.steps, self.steps == 0
        if left <= 0:
            return
        try:
            self.model.learn(left, RolloutCallback(self, progress), reset_num_timesteps=first)
        except (ValueError, RuntimeError, ArithmeticError) as error:
            try:
                check_finite(self.model.policy, {}, self.steps)
            except Diverged as diverged:
                raise diverged from error
            # Finite parameters too may make a deviation that is not: exp(log_std).
            frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
            if frames[-1].f_globals["__name__"].startswith("torch.distributions"):
                raise Diverged(
                    f"the training diverged at {self.steps:,} steps: the distribution of the "
                    "action is not finite"
                ) from error
            raise

    def check(self) -> None:
        """Raises Diverged after an update that has spoilt the networks."""
        logged = self.model.logger.name_to_value
        losses = {name: value for name, value in logged.items() if name.endswith("loss")}
        check_finite(self.model.policy, losses, self.steps)

    def policy(self, context: PolicyContext) -> AgentPolicy:
        """The agent as it is now, as a policy of the benchmark."""
        return policy_of(self.model, *self.augmentation, context, self.normalisation, self.groups)

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""
        now = self.normalisation
        stored = now and {k: np.asarray(value).tolist() for k, value in now._asdict().items()}
        return Trained(self.model.policy, {"normalisation": stored}, {})

    def capture(self) -> dict[str, Any]:
        """Everything that the next rollout depends on."""
        return checkpoint.capture_model(self.model)

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises any exception where it does not fit."""
        checkpoint.resume_model(self.model, captured)


class RolloutCallback(BaseCallback):
    """Tells the progress of a training what Stable-Baselines3 says between rollouts and steps."""

    def __init__(self, learner: Sb3Learner, progress: Progress) -> None:
        super().__init__()
        self.learner, self.progress = learner, progress

    def _on_step(self) -> bool:
        self.progress.count(self.training_env.num_envs)
        return True

    def _on_rollout_start(self) -> None:
        """Between an update and the next rollout the state of a training is smallest."""
        self.learner.check()
        rate = self.model.learning_rate
        if isinstance(rate, FallingRate):
            rate.remaining = 1.0 - self.learner.steps / self.progress.options.steps
        before = self.progress.evaluated
        self.progress.between(self.learner.mean_return)
        if self.progress.evaluated > before and self.progress.held_out:
            self.logger.record("held_out/rmse", self.progress.curve[-1][-1])

    def _on_training_end(self) -> None:
        self.learner.check()
        self.progress.finish(self.learner.mean_return)


class StudentLearner:
    """A student of the teacher of a run, with an LSTM or without.

    The loss of an LSTM is the squared error / 2 below 1 and its magnitude - 1/2 above: a vehicle
    far off its path counts, but does not outweigh all others. Raises ValueError for a missing
    teacher, or one that has learned to drive something else, for an observation that lacks what an
    LSTM infers or reads, and for estimates where sprocket speeds are commanded.
    """

    column = "loss"
    recipe: Mapping[str, Any]
    _CHANGING = ("_filled", "_observation", "_state", "_start", "steps")  # while it learns
    _BUFFERS = ("_seen", "_true", "_began")  # whose first rows are filled

    def __init__(self, run: Run) -> None:
        self.teacher, recipe = load_teacher(run.options.teacher)
        check_teacher(run, recipe)
        self.settings = settings = run.settings
        check_buffer(settings, run.options.vehicles)
        self.augmentation, self.groups = widened_by(run.augmentation.options), run.groups
        self.recipe = {name: recipe[name] for name in ("algorithm", "normalisation")}
        self.recipe |= {"teacher": recipe}
        self.env, self.truths = make_taught(run)
        torch.manual_seed(run.seed)
        shape, count = self.env.observation_space.shape, self.env.num_envs
        assert shape is not None
        self.model = StudentModel(
            make_inference(shape[0], settings.hidden, settings.lstm_hidden),
            self.teacher,
            normalisation_of(recipe),
            [field for of_group in run.groups.values() for field in of_group],
            self.augmentation[0],
        )
        self.loss = nn.MSELoss() if settings.lstm_hidden is None else nn.SmoothL1Loss()
        self.optimiser = torch.optim.Adam(self.model.inference.parameters(), fused=True)
        blocks = max(settings.buffer_size // count // settings.n_steps, 1)
        self._rows = blocks * settings.n_steps
        self._observation: Any = self.env.reset()
        self._seen = torch.zeros(self._rows, count, *shape)
        self._true = torch.zeros(self._rows, *self.truth.shape)
        self._began = torch.zeros(self._rows, count, 1)  # whether an episode
        self._carried = torch.zeros(2, blocks, count, settings.lstm_hidden or 0)
        self._filled = 0  # rows of the buffer ever written
        self._random = np.random.default_rng(run.seed)
        self._state: Any = None
        self._start = np.ones(count, dtype=bool)
        self.steps = 0

    @property
    def truth(self) -> Any:
        """What the inference should say of the present observation, (N, F) of all rows."""
        motion = None
        if self.model.motion is not None:
            motion = np.concatenate([truth.motion() for truth in self.truths])
        hidden = np.concatenate([of.truth.present for of in self.truths])
        return self.model.right(self._observation, motion, hidden)

    def policy(self, context: PolicyContext) -> AgentPolicy:
        """The student as the benchmark has it."""
        return AgentPolicy(self.model, *self.augmentation, context, groups=self.groups)

    def collect(self) -> float:
        """Drive one block, of `n_steps`; returns the mean loss of the inference meanwhile."""
        block = self._filled % self._rows // self.settings.n_steps
        carried = None if self._state is None else self._state[0]
        for rows, values in zip(self._carried[:, block], carried or (0.0, 0.0), strict=True):
            rows[:] = torch.as_tensor(values)
        losses = 0.0
        for _ in range(self.settings.n_steps):
            row = self._filled % self._rows
            self._seen[row] = torch.from_numpy(self._observation)
            self._true[row] = torch.from_numpy(self.truth)
            self._began[row, :, 0] = torch.from_numpy(self._start.astype(np.float32))
            action, self._state = self.model.predict(
                self._observation, self._state, self._start, deterministic=True
            )
            self._observation, _, self._start, _ = self.env.step(action)
            losses += float(self.loss(torch.from_numpy(self.model.inferred), self._true[row]))
            self._filled += 1
        self.steps += self.settings.n_steps * self.env.num_envs
        return losses / self.settings.n_steps

    def regress(self, rate: float) -> None:
        """Gradient steps on samples of the buffer. rate: learning rate."""
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        recurrent = self.settings.lstm_hidden is not None
        for _ in range(self.settings.gradient_steps):
            inferred, true = self._sequences() if recurrent else self._samples()
            self.optimiser.zero_grad()
            self.loss(inferred, true).backward()
            if recurrent:
                nn.utils.clip_grad_norm_(self.model.inference.parameters(), LARGEST_GRADIENT)
            self.optimiser.step()

    def _samples(self) -> tuple[torch.Tensor, torch.Tensor]:
        """What is inferred of samples of the buffer, and the truth, (B, F) each."""
        count = min(self._filled, self._rows) * self.env.num_envs
        rows = torch.from_numpy(self._random.integers(count, size=self.settings.batch_size))
        seen, true = self._seen.flatten(0, 1), self._true.flatten(0, 1)
        return self.model.inference(seen[rows]), true[rows]

    def _sequences(self) -> tuple[torch.Tensor, torch.Tensor]:
        """What is inferred of sequences of the buffer, and the truth, (T, B, F) each."""
        length, count = self.settings.n_steps, self.env.num_envs
        blocks = min(self._filled, self._rows) // length
        size = max(self.settings.batch_size // length, 1)
        block, row = (
            torch.from_numpy(self._random.integers(most, size=size)) for most in (blocks, count)
        )
        seen, began, true = (
            values.view(-1, length, *values.shape[1:])[block, :, row].transpose(0, 1)
            for values in (self._seen, self._began, self._true)
        )
        state = self._carried[0, block, row], self._carried[1, block, row]
        return self.model.inference(seen, began, state)[0], true

    def learn(self, progress: Progress) -> None:
        """Learn to the end of the schedule.

        Raises Diverged for an inference that is not finite, before anything of it is kept.
        """
        total = progress.options.steps
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
        return Trained(self.teacher, {}, {INFERENCE: inference_weights(self.model.inference)})

    def capture(self) -> dict[str, Any]:
        """Everything that the next samples and regressions depend on."""
        filled = min(self._filled, self._rows)
        return {
            **{name: getattr(self, name) for name in self._CHANGING},
            **{name: getattr(self, name)[:filled].numpy() for name in self._BUFFERS},
            "carried": self._carried.numpy(),
            "inference": self.model.inference.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": self._random.bit_generator.state,
            "environment": checkpoint.capture_environment(self.env),
        }

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises any exception where it does not fit."""
        for name in ("_filled", "_observation", "_start", "steps"):
            checkpoint.check(getattr(self, name), captured[name], name)
        for name in self._CHANGING:
            setattr(self, name, captured[name])
        for name in self._BUFFERS:
            getattr(self, name)[: len(captured[name])] = torch.from_numpy(captured[name])
        self._carried[:] = torch.from_numpy(captured["carried"])
        self.model.inference.load_state_dict(captured["inference"])
        self.optimiser.load_state_dict(captured["optimiser"])
        self._random.bit_generator.state = captured["random"]
        checkpoint.resume_environment(self.env, captured["environment"])


def check_teacher(run: Run, recipe: Mapping[str, Any]) -> None:
    """Raises ValueError for a teacher of another control period, drive, vehicle or observation.

    Its privileged inputs would be ratios to other values, its actions other commands, and its
    network would see other fields.
    """
    teacher, context = run.options.teacher, run.parts[0].context
    theirs = {"control_period": recipe["control_period"], **drive_of(recipe)._asdict()}
    for name, of_teacher in theirs.items():
        ours = getattr(context, name)
        if of_teacher != ours:
            both = (vehicle_record(v) if name == "vehicle" else v for v in (of_teacher, ours))
            raise ValueError(
                "teacher {} was trained with {} = {}; its student would have {}. Is --env, "
                "--vehicle or --env-args another one?".format(teacher, name, *both)
            )
    groups = groups_of(recipe)
    if [*groups.items()] != [*run.groups.items()]:
        raise ValueError(
            f"teacher {teacher} was trained with observation = {[*groups]}; its student would "
            f"have {[*run.groups]}. Give both the same groups, in one order, in --env-args"
        )
