"""The algorithms of Stable-Baselines3 and sb3-contrib as learners."""

import traceback
from collections.abc import Mapping
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents.algorithms import make_model
from agents.algorithms.settings import check_budget
from agents.algorithms.stable_baselines import FallingRate
from agents.training import sb3_state
from agents.training.environments import make_environment
from agents.training.learner import Diverged, Trained, check_finite
from agents.training.progress import Progress
from agents.training.run import Run
from baselines.learned.agent_policy import AgentPolicy, Normalisation, TeacherPolicy, policy_of
from tracked_env.benchmark import PolicyContext


def normalisation(model: BaseAlgorithm) -> Normalisation | None:
    """The running normalisation of a model's environment, as it is now."""
    layer = model.get_vec_normalize_env()
    if layer is None:
        return None
    statistics: Any = layer.obs_rms
    return Normalisation(
        statistics.mean.copy(), statistics.var.copy(), layer.epsilon, layer.clip_obs
    )


class Sb3Learner:
    """A model of Stable-Baselines3 in the environment of a run. Raises ValueError."""

    column = "mean_return"
    recipe: Mapping[str, Any] = {}

    def __init__(self, run: Run) -> None:
        self.augmentation, self.groups = run.augmentation, run.groups
        env = make_environment(run)
        log = str(run.folder) if run.tensorboard else None
        self.model = make_model(run.name, run.settings, env, run.seed, log)
        check_budget(run.settings, run.schedule.total)

    @property
    def steps(self) -> int:
        """Environment steps done, over all vehicles."""
        return self.model.num_timesteps

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
        left = progress.schedule.total - self.steps
        if left <= 0:
            return
        callback = RolloutCallback(self, progress)
        try:
            self.model.learn(left, callback=callback, reset_num_timesteps=self.steps == 0)
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

    def policy(self, context: PolicyContext) -> AgentPolicy | TeacherPolicy:
        """The agent as it is now, as a policy of the benchmark."""
        statistics = normalisation(self.model)
        return policy_of(self.model, *self.augmentation, context, statistics, self.groups)

    def trained(self) -> Trained:
        """The agent as it is now, for an archive."""
        statistics, stored = normalisation(self.model), None
        if statistics is not None:
            stored = {
                "mean": statistics.mean.tolist(), "variance": statistics.variance.tolist(),
                "epsilon": statistics.epsilon, "clip": statistics.clip,
            }  # fmt: skip
        return Trained(self.model.policy, {"normalisation": stored}, {})

    def capture(self) -> dict[str, Any]:
        """Everything that the next rollout depends on."""
        return sb3_state.capture(self.model)

    def resume(self, captured: Mapping[str, Any]) -> None:
        """Put back what `capture` took. Raises any exception where it does not fit."""
        sb3_state.resume(self.model, captured)


class RolloutCallback(BaseCallback):
    """Hands the progress of a training what Stable-Baselines3 says between rollouts and steps."""

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
            rate.remaining = 1.0 - self.learner.steps / self.progress.schedule.total
        before = self.progress.evaluated
        self.progress.between(self.learner.mean_return)
        if self.progress.evaluated > before and self.progress.held_out:
            self.logger.record("held_out/rmse", self.progress.curve[-1][-1])

    def _on_training_end(self) -> None:
        self.learner.check()
        self.progress.finish(self.learner.mean_return)
