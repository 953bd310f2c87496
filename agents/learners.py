"""What learns: a model of Stable-Baselines3 in the environment of a run, or what an algorithm
registered for it."""

import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from agents import checkpoint
from agents.algorithms import FallingRate, check_budget, make_model
from agents.environments import make_environment
from agents.folder import Diverged, Learner, Progress, Trained, check_finite
from agents.run import Run
from baselines.learned.agent_policy import AgentPolicy, Normalisation
from tracked_env.benchmark.policy_interface import PolicyContext


def make_learner(run: Run) -> Learner:
    """What learns in a run, untrained. Raises ValueError."""
    learner: Learner = (run.algorithm.learner or Sb3Learner)(run)
    return learner


class Sb3Learner:
    """A model of Stable-Baselines3 in the environment of a run. Raises ValueError."""

    column = "mean_return"

    def __init__(self, run: Run) -> None:
        self.augmentation, self.groups = run.augmentation, run.groups
        env = make_environment(run)
        log = str(run.options.folder) if run.options.tensorboard else None
        self.model = make_model(run.options.algorithm, run.settings, env, run.seed, log)
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
        return AgentPolicy(self.model, *self.augmentation, context, self.normalisation, self.groups)

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""
        now = self.normalisation
        stored = now and {k: np.asarray(value).tolist() for k, value in now._asdict().items()}
        return Trained(self.model.policy, {"normalisation": stored})

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
