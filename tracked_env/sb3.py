"""Stable-Baselines3's vector interface over the project's own vector environment.

`make_vec_env` gives SB3 all vehicles in one process, stepped by one call, instead of one
environment per vehicle. Ended rows restart in the same step, as SB3 expects; their last
observation is in `infos[i]["terminal_observation"]`. Needs the extra `rl`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from tracked_env import TORQUE_ID, make_vec
from tracked_env.step import INFO_KEYS
from tracked_env.validation import checked_flag
from tracked_env.vector_env import TrackedVehicleVectorEnv


class TrackedVehicleVecEnv(VecEnv):
    """An SB3 `VecEnv` over a `TrackedVehicleVectorEnv`, wrapped or not, in SAME_STEP mode.

    `infos` are empty dicts except for rows that ended: `terminal_observation`,
    `TimeLimit.truncated`, `is_success`, `tracking_error` (2,) [m, rad], the terms of
    the reward, `reward_position` and so on, and the flags `ended_*` of plants that have them. With
    `costs` the infos of all rows have `cost` and its terms in every step.
    staggered: the first episodes end at different times, see `TrackedVehicleVectorEnv`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], staggered: bool = False) -> None:
        core = env.unwrapped
        if not isinstance(core, TrackedVehicleVectorEnv):
            raise ValueError(f"{core} is no TrackedVehicleVectorEnv")
        if core.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                f"autoreset_mode = {core.autoreset_mode}; must be SAME_STEP, which is what SB3 does"
            )
        self.env: Any = env
        self.staggered = checked_flag("staggered", staggered)
        self.render_mode = core.render_mode
        self._actions: NDArray[np.float32] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Start all rows; uses and forgets what `seed` and `set_options` have left."""
        seeds = None if all(s is None for s in self._seeds) else self._seeds
        options: dict[str, Any] = {"staggered": True} if self.staggered else {}
        if any(self._options):
            options["rows"] = list(self._options)
        observations, _ = self.env.reset(seed=seeds, options=options)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: NDArray[np.float32]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        assert self._actions is not None, "step_async comes before step_wait"
        observations, rewards, terminated, truncated, info = self.env.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        costs = [name for name in info if name.startswith("cost")]
        for name in costs:
            for one, value in zip(infos, info[name].tolist(), strict=True):
                one[name] = value
        if dones.any():
            final = info["final_info"]
            for i in np.flatnonzero(dones):
                infos[i] = {
                    "terminal_observation": info["final_obs"][i],
                    "TimeLimit.truncated": bool(truncated[i]),
                    "is_success": bool(final["is_success"][i]),
                    "tracking_error": final["tracking_error"][i],
                    **{name: float(final[name][i]) for name in (*INFO_KEYS, *costs)},
                    **{name: bool(final[name][i]) for name in final if name.startswith("ended_")},
                }
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        self.env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        return self.env.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the one environment that all rows share, once per row."""
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refused: rows share one environment, an attribute cannot differ between them."""
        raise NotImplementedError(
            f"rows of this VecEnv share one environment; build another one to change {attr_name!r}"
        )

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Refused: rows are not environments of their own."""
        raise NotImplementedError(f"rows of this VecEnv share one environment: {method_name!r}")

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]


def make_vec_env(
    env_id: str = TORQUE_ID,
    n_envs: int = 64,
    seed: int | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    monitor: bool = True,
    wrapper: Callable[[VectorEnv[Any, Any, Any]], VectorEnv[Any, Any, Any]] | None = None,
    staggered: bool = False,
) -> VecEnv:
    """N vehicles for SB3, e.g. `PPO("MlpPolicy", make_vec_env(n_envs=64))`.

    env_kwargs: arguments of the environment. seed: row i is seeded seed + i at the first
    reset. monitor: wrap in `VecMonitor`, so that SB3 logs episode returns and success.
    wrapper: applied to the vector env, such as IdentifiedVectorObservation with its observer.
    staggered: the first episodes end at different times, so that rows are not in step: better
    for training, and the first episodes are no measure of success.
    """
    monitor = checked_flag("monitor", monitor)
    env = make_vec(
        env_id,
        num_envs=n_envs,
        **{**(env_kwargs or {}), "autoreset_mode": AutoresetMode.SAME_STEP},
    )
    vec_env: VecEnv = TrackedVehicleVecEnv(env if wrapper is None else wrapper(env), staggered)
    if seed is not None:
        vec_env.seed(seed)
    return VecMonitor(vec_env, info_keywords=("is_success",)) if monitor else vec_env
