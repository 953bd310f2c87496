"""The vehicles of a training, as its agent sees them, and those of the held-out episodes.

    TrackedVehicleVectorEnv   of one kind of sensors
    TrainingReward            reward' = reward + 1 / (1 + (d / precision)^2) - smoothness * c
    AgentVectorEnv            observations widened by the augmentation, commands from actions
    JoinedVecEnv              one part for each kind of sensors
    VecMonitor, ScaledReward  rewards times 1 - gamma, where the algorithm asks for it
d: true distance to the reference [m]; c: mean square of the change of the command from one control
step to the next [-]. The environment's own position term, with a scale of 0.5 m for a contact
length of 2 m, is worth 0.7 per cent at 5 cm, less than what exploring costs; with 0.15 m it is 10
per cent. Near the path the added term falls with d^2, so its sum over an episode ranks policies as
the RMSE does. The environment's own action-rate penalty, 0.0125 c, is negligible beside that: an
agent that answers the noise of each sample with torque loses a thousandth by it. Scaled by
1 - gamma, values are of order one whatever the horizon: a value of 100 or 200, as a sum over the
horizon is, takes a fresh network longer to reach than driving takes to learn.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from agents.algorithms import SMOOTHNESS
from agents.run import Part, Run
from baselines.learned.agent_policy import make_augmentation
from baselines.learned.augmentation import Augmentation, Bools, Floats
from tracked_env.sb3 import make_vec_env
from tracked_env.step import WEIGHTS
from tracked_env.wrappers import IdentifiedVectorObservation

Step = tuple[Any, NDArray[np.float64], Bools, Bools, Any]
Vehicles = gymnasium.vector.VectorEnv[Any, Any, Any]

MEAN_SQUARE = 4.0 / WEIGHTS["smoothness"]  # the environment's term is over its largest value, 4


class AgentVectorEnv(IdentifiedVectorObservation):
    """A vector env as the agent lives in it: widened observations, its own actions."""

    observer: Augmentation

    def step(self, actions: Floats) -> Step:
        """Advance all rows by the commands that follow from the agent's actions (N, 2)."""
        commands = self.observer.command(np.asarray(actions, np.float32), self._features)
        observation, reward, terminated, truncated, info = super().step(commands)
        for last in info.get("final_obs", ()):
            if last is not None:
                np.nan_to_num(last, copy=False)
        return np.nan_to_num(observation, copy=False), reward, terminated, truncated, info

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start episodes on all rows, or on those of `options["reset_mask"]`."""
        observation, info = super().reset(seed=seed, options=options)
        return np.nan_to_num(observation, copy=False), info

    def snapshot(self) -> Any:
        """All that is remembered, to go on from later."""
        return self.observer.memories(), self._features.copy()

    def resume(self, snapshot: Any) -> None:
        """Go on from what `snapshot` returned."""
        memories, self._features = snapshot
        self.observer.restore(memories)


class TrainingReward(gymnasium.vector.VectorWrapper):
    """Adds both terms to every row's reward, at the end of an episode too.

    precision [m], smoothness [-]: see above; 0 leaves a term out. It remembers nothing: the change
    of the command is read from the environment's own term.
    """

    def __init__(self, env: Vehicles, precision: float, smoothness: float = SMOOTHNESS) -> None:
        super().__init__(env)
        self.precision, self.smoothness = precision, smoothness

    def _terms(self, info: Mapping[str, Any]) -> NDArray[np.float64]:
        """Both terms (N,)."""
        terms = np.zeros(self.num_envs)
        if self.precision:
            terms += 1.0 / (1.0 + (info["tracking_error"][:, 0] / self.precision) ** 2)
        if self.smoothness:
            terms -= self.smoothness * MEAN_SQUARE * info["reward_smoothness"]
        return np.nan_to_num(terms)

    def step(self, actions: Floats) -> Step:
        """Advance all rows by one control period; actions (N, 2)."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        terms = self._terms(info)
        if "final_info" in info:  # the row shows its next episode already
            terms = np.where(info["_final_info"], self._terms(info["final_info"]), terms)
        return observation, reward + terms, terminated, truncated, info


class ScaledReward(VecEnvWrapper):
    """Rewards times 1 - gamma, so that a discounted sum of them is their weighted mean.

    gamma: discount per control step, in [0, 1).
    """

    def __init__(self, venv: VecEnv, gamma: float) -> None:
        super().__init__(venv)
        self.scale = np.float32(1.0 - gamma)

    def reset(self) -> Any:
        """Start all rows."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all rows by one control period."""
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, self.scale * rewards, dones, infos


class JoinedVecEnv(VecEnv):
    """The rows of all `parts` in their order; each does what it does alone, bit for bit.

    An environment of this project has one kind of sensors, and the augmentations that weigh
    measurements have one data sheet: an agent that is to cope with several gets a part for each.
    Row i of all is seeded seed + i.
    """

    def __init__(self, parts: Sequence[VecEnv]) -> None:
        self.parts, first = list(parts), parts[0]
        edges = [0, *accumulate(part.num_envs for part in parts)]
        self._rows = list(zip(parts, map(slice, edges, edges[1:]), strict=False))
        self.render_mode = first.render_mode
        super().__init__(edges[-1], first.observation_space, first.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed row i with seed + i at the next reset; None draws one."""
        first = int(np.random.randint(2**31)) if seed is None else seed  # noqa: NPY002, as SB3
        return [each for part, rows in self._rows for each in part.seed(first + rows.start)]

    def reset(self) -> NDArray[np.float32]:
        """Start all rows."""
        observations = [np.asarray(part.reset()) for part in self.parts]
        self.reset_infos = [info for part in self.parts for info in part.reset_infos]
        return np.concatenate(observations)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Pass each part its actions (N, 2) for `step_wait`."""
        for part, rows in self._rows:
            part.step_async(actions[rows])

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all rows by one control period."""
        *arrays, infos = zip(*(part.step_wait() for part in self.parts), strict=True)
        observations, rewards, dones = map(np.concatenate, arrays)
        return observations, rewards, dones, [info for part in infos for info in part]

    def close(self) -> None:
        """Release what the parts hold."""
        for part in self.parts:
            part.close()

    def _each(self, name: str, indices: VecEnvIndices, *arguments: Any, **more: Any) -> list[Any]:
        """What the method of its part returns for each of the rows asked for."""
        where = [(part, row) for part in self.parts for row in range(part.num_envs)]
        rows = [where[i] for i in self._get_indices(indices)]
        values = [getattr(part, name)(*arguments, indices=row, **more) for part, row in rows]
        return [value and value[0] for value in values]  # a list of one, or None

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each row's environment."""
        return self._each("get_attr", indices, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """As the parts do."""
        self._each("set_attr", indices, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **more: Any
    ) -> list[Any]:
        """As the parts do."""
        return self._each("env_method", indices, method_name, *method_args, **more)

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """As the parts do."""
        return self._each("env_is_wrapped", indices, wrapper_class)


def make_part(run: Run, part: Part) -> Any:
    """The vehicles of one kind of sensors as the agent sees them. Raises ValueError."""

    def wrapper(env: Vehicles) -> AgentVectorEnv:
        observer = make_augmentation(*run.augmentation, part.context, part.rows)
        precision = run.options.precision * part.context.vehicle.contact_length
        return AgentVectorEnv(TrainingReward(env, precision, run.options.smoothness), observer)

    options = run.options
    return make_vec_env(
        options.env, part.rows, None, part.arguments, False, wrapper, options.staggered
    )


def make_environment(run: Run) -> VecEnv:
    """All vehicles as the agent sees them. Raises ValueError."""
    parts = [make_part(run, part) for part in run.parts]
    joined: VecEnv = parts[0] if len(parts) == 1 else JoinedVecEnv(parts)
    joined.seed(run.seed)
    env: VecEnv = VecMonitor(joined, info_keywords=("is_success",))
    if run.algorithm.scaled:
        env = ScaledReward(env, run.settings.gamma)
    return VecNormalize(env, norm_reward=False) if run.options.normalise else env
