"""Terms of the reward that only the training sees: where the vehicle is, how calm its driving.

    reward' = reward + 1 / (1 + (d / precision)^2) - smoothness * c
    d: true distance to the reference [m]
    c: mean square of the change of the command from one control step to the next [-]
The environment's own position term, with a scale of 0.5 m for a contact length of 2 m, is worth
0.7 per cent at 5 cm, less than what exploring costs; with 0.15 m it is 10 per cent. Near the path
the added term falls with d^2, so its sum over an episode ranks policies as the RMSE does. The
environment's own action-rate penalty, 0.0125 c, is negligible beside that: an agent that
answers the noise of each sample with torque loses a thousandth by it.

`ScaledReward` then makes values of order one whatever the horizon. A value
of 100 or 200, as a sum over the horizon is, takes a fresh network longer to reach
than driving takes to learn.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from tracked_env.step import WEIGHTS

PRECISION = 0.075  # [-] over the contact length: distance at which the first term is 1/2
SMOOTHNESS = 1.0  # [-] penalty of a change of the whole torque limit on both sides
_MEAN_SQUARE = 4.0 / WEIGHTS["smoothness"]  # the environment's term is over its largest value, 4


class TrainingReward(gymnasium.vector.VectorWrapper):
    """Adds both terms to every row's reward, at the end of an episode too.

    precision [m], smoothness [-]: see above; 0 leaves a term out. It remembers nothing: the change
    of the command is read from the environment's own term.

    Raises ValueError for a negative or infinite value.
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        precision: float,
        smoothness: float = SMOOTHNESS,
    ) -> None:
        super().__init__(env)
        if not 0.0 <= precision < np.inf:
            raise ValueError(f"precision = {precision} m; must be at least 0, which omits the term")
        if not 0.0 <= smoothness < np.inf:
            raise ValueError(f"smoothness = {smoothness}; must be at least 0, which omits the term")
        self.precision, self.smoothness = precision, smoothness

    def _added(self, info: Mapping[str, Any]) -> NDArray[np.float64]:
        """Both terms (N,)."""
        added = np.zeros(self.num_envs)
        if self.precision:
            added += 1.0 / (1.0 + (info["tracking_error"][:, 0] / self.precision) ** 2)
        if self.smoothness:
            added -= self.smoothness * _MEAN_SQUARE * info["reward_smoothness"]
        return np.nan_to_num(added)

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Any]:
        """Advance all rows by one control period; actions (N, 2)."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        added = self._added(info)
        if "final_info" in info:  # the row shows its next episode already
            added = np.where(info["_final_info"], self._added(info["final_info"]), added)
        return observation, reward + added, terminated, truncated, info


class ScaledReward(VecEnvWrapper):
    """Rewards times 1 - gamma, so that a discounted sum of them is their weighted mean.

    gamma: discount per control step, in [0, 1). Raises ValueError for another one.
    """

    def __init__(self, venv: VecEnv, gamma: float) -> None:
        super().__init__(venv)
        if not 0.0 <= gamma < 1.0:
            raise ValueError(f"gamma = {gamma}; must be in [0, 1)")
        self.scale = np.float32(1.0 - gamma)

    def reset(self) -> Any:
        """Start all rows."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all rows by one control period."""
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, self.scale * rewards, dones, infos
