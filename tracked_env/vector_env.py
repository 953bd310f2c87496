"""N tracked vehicles behind Gymnasium's vector interface: the simulation core with N > 1."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from tracked_env.arrays import Report
from tracked_env.engine.env_config import EnvConfig, PlainSpec, environment_arguments
from tracked_env.engine.episode import OPTION_KEYS
from tracked_env.engine.simulation import Simulation
from tracked_env.env import ObsType, make_renderer
from tracked_env.physics.parameters import Range
from tracked_env.step import INFO_KEYS
from tracked_env.validation import checked_choice, checked_flag, checked_keys, checked_whole

Bools = NDArray[np.bool_]
_STEPS = Range(1, 10**9, "-", "It counts control steps. Did you pass seconds?")
_SEED = Range(0, 2**128, "-", "It is one for all rows or one per row.")
_KEYS = ("reset_mask", "rows", "staggered")  # of the options, beside those of one environment
_REWARD_KEYS = tuple((name, f"_{name}") for name in INFO_KEYS)


class TrackedVehicleVectorEnv(
    PlainSpec, gymnasium.vector.VectorEnv[ObsType, ObsType, NDArray[Any]]
):
    """N vehicles in one process; action, observation and arguments as `TrackedVehicleEnv`.

    Row i, seeded seed + i, gives the same numbers as a single environment, bit for bit.
    `reset(options=...)` takes the keys of the single environment for every row, and

    * `reset_mask` (N,) bool: which rows to reset, the others go on; a row that was never reset
      cannot be stepped;
    * `rows`: a list of N dicts (or None), options per row; they win over the common ones;
    * `staggered` bool: these episodes are cut short, the k-th of K after k/K of its length, so
      that rows are not in step from then on. Else all begin anew in the same step for long.

    Autoreset modes as Gymnasium defines them: NEXT_STEP (default; the step after the end
    resets, ignores the action, reward 0), SAME_STEP (the last observation and info are in
    `final_obs` and `final_info`), DISABLED (an ended row rests, with reward 0 and its flags
    up, until it is reset by `reset_mask`). The environment truncates by itself.

    Extra arguments: `threads` (default 2) is used from 512 vehicles on; numbers do not change.
    `max_episode_steps` truncates as TimeLimit does for one environment: an episode that it cuts
    short of `duration` is no success. Gymnasium passes it when an id is registered with it.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012, an instance variable in Gymnasium
        "render_modes": ["rgb_array"],
        "render_fps": 50,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    expose_truth: bool

    @environment_arguments
    def __init__(
        self,
        num_envs: int = 1,
        *,
        config: EnvConfig,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int = 2,
        max_episode_steps: int | None = None,
    ) -> None:
        if max_episode_steps is not None:
            max_episode_steps = checked_whole("max_episode_steps", max_episode_steps, _STEPS)
        if not isinstance(autoreset_mode, AutoresetMode):
            names = [mode.value for mode in AutoresetMode]
            autoreset_mode = checked_choice("autoreset_mode", autoreset_mode, names)
        self.simulation = Simulation(num_envs, config._replace(threads=threads))
        self.num_envs = num_envs = self.simulation.count
        self.layout = self.simulation.layout
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        changes = {"autoreset_mode": self.autoreset_mode, "render_fps": round(config.control_rate)}
        self.metadata = {**self.metadata, **changes}
        self.single_observation_space = gymnasium.spaces.Box(*self.layout.limits, dtype=np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._every = np.ones(num_envs, dtype=np.bool_)
        self.cost_budget = self.simulation.cost_budget
        self._max_steps = max_episode_steps
        self._renderers: list[Any] = []

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[ObsType, dict[str, Any]]:
        """Start an episode on all rows, or on those of `options["reset_mask"]`.

        seed: an int seeds row i with seed + i, a sequence seeds each row; None keeps the
        streams. Raises ValueError for options that are unknown or out of range.
        """
        common = dict(checked_keys("options", options, (*OPTION_KEYS, *_KEYS)))
        mask = self._mask(common.pop("reset_mask", None))
        rows = self._rows(common.pop("rows", None))
        staggered = checked_flag("options['staggered']", common.pop("staggered", False))
        vehicles = np.flatnonzero(mask)
        self._seed(vehicles, seed)
        each = None
        if common or rows:
            each = [{**common, **(rows[i] if rows else {})} for i in vehicles]
        self._start(vehicles, each)
        if staggered:
            share = np.arange(1, len(vehicles) + 1) / len(vehicles)
            limits = self.simulation.batch.counter("max_step")
            limits[vehicles] = np.ceil(share * limits[vehicles])
        success = self._success(self.simulation.truncated)
        return self.simulation.observations.copy(), self._info(mask, success)

    def _start(
        self, vehicles: NDArray[np.int64], options: Sequence[Mapping[str, Any]] | None = None
    ) -> None:
        self.simulation.reset(vehicles, options)
        if self._max_steps is not None:
            limits = self.simulation.batch.counter("max_step")
            limits[vehicles] = np.minimum(limits[vehicles], self._max_steps)

    def _success(self, truncated: Bools) -> Bools:
        """An episode that `max_episode_steps` has cut short has not been driven to its end."""
        if not np.count_nonzero(truncated):
            return np.zeros_like(truncated)
        steps = self.simulation.batch.counter("step")
        return self.simulation.success & (steps >= self.simulation.settings.max_steps)

    def _mask(self, mask: Any) -> Bools:
        if mask is None:
            return self._every
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(
                f"options['reset_mask'] has shape {mask.shape} and dtype {mask.dtype}; must be a "
                f"bool array of shape ({self.num_envs},) with at least one True"
            )
        return mask

    def _rows(self, rows: Any) -> list[Mapping[str, Any]]:
        """Options of every row, empty where no row has its own."""
        if rows is None:
            return []
        is_list = isinstance(rows, (list, tuple, np.ndarray)) and len(rows) == self.num_envs
        if not is_list or not all(row is None or isinstance(row, Mapping) for row in rows):
            raise ValueError(f"options['rows'] must be a list of {self.num_envs} dicts or None")
        return [row or {} for row in rows]

    def _seed(self, vehicles: NDArray[np.int64], seed: Any) -> None:
        """Give the chosen rows the random streams of `seed`, or new ones where they have none."""
        each = isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, str)
        seeds: list[Any] = list(seed) if each else [seed]
        seeds = [s if s is None else checked_whole("seed", s, _SEED) for s in seeds]
        if not each:
            seeds = [None if seeds[0] is None else seeds[0] + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries; must have {self.num_envs}")
        for i in vehicles:
            if seeds[i] is not None or self.simulation.rngs[i] is None:
                self.simulation.rngs[i] = seeding.np_random(seeds[i])[0]

    def step(
        self, actions: ObsType
    ) -> tuple[ObsType, NDArray[np.float64], Bools, Bools, dict[str, Any]]:
        """Advance every row by one control period; actions (N, 2).

        Raises ResetNeeded when a row was never reset, ValueError for an action that is not finite.
        """
        simulation, resting = self.simulation, None
        if not np.count_nonzero(simulation.ended):
            simulation.step(actions)
        else:
            resting, others = simulation.ended.nonzero()[0], (~simulation.ended).nonzero()[0]
            simulation.step(actions, others)
            if self.autoreset_mode is AutoresetMode.NEXT_STEP:
                self._start(resting)  # with flags and rewards of 0
                resting = None
        report, final = simulation.report(), dict[str, Any]()
        rewards = report.reward
        if resting is None and not simulation.some_ended:  # nearly always: nothing to look up
            terminated, truncated, success = np.zeros((3, self.num_envs), dtype=np.bool_)
        else:
            terminated, truncated = simulation.terminated, simulation.truncated
            success = self._success(truncated)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                final = self._final(terminated | truncated, success)
                report = simulation.report()
                success = np.zeros_like(success)
            elif resting is not None:
                rewards[resting] = 0.0
        info = {**self._info(self._every, success, report), **final}
        return simulation.observations.copy(), rewards, terminated, truncated, info

    def _final(self, over: Bools, success: Bools) -> dict[str, Any]:
        """Last observation and info of the ended rows, of which SAME_STEP then starts others."""
        vehicles = np.flatnonzero(over)
        final_obs = np.full(self.num_envs, None, dtype=object)
        for i, last in zip(vehicles, self.simulation.observations[vehicles], strict=True):
            final_obs[i] = last
        final_info = self._info(over, success)
        self._start(vehicles)
        observations = {"final_obs": final_obs, "_final_obs": over}
        return {**observations, "final_info": final_info, "_final_info": over}

    def _info(self, mask: Bools, success: Bools, report: Report | None = None) -> dict[str, Any]:
        """Info of every row as arrays, each with its mask `_name`, as Gymnasium has it."""
        report = self.simulation.report() if report is None else report
        info: dict[str, Any] = {
            **{"tracking_error": report.tracking_error, "_tracking_error": mask},
            **{"is_success": success, "_is_success": mask},
            "reference_scale": self.simulation.reference_scale.copy(),
            "_reference_scale": mask,
        }
        for (name, masked), value in zip(_REWARD_KEYS, report.terms, strict=True):
            info[name], info[masked] = value, mask
        for name, value in self.simulation.costs().items() if self.simulation.cost_names else ():
            info[name], info["_" + name] = value, mask
        if self.simulation.ending_flags:
            for name, flag in self.simulation.endings().items():
                info[name], info["_" + name] = flag, mask
        if self.expose_truth:
            truth: dict[str, Any] = {}
            for name, value in self.simulation.truth().items():
                truth[name], truth["_" + name] = value, mask
            info["truth"], info["_truth"] = truth, mask
        return info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One RGB array (height, width, 3) per row; None without a render mode."""
        if self.render_mode is None:
            return None
        if not self._renderers:
            rows = range(self.num_envs)
            self._renderers = [make_renderer(self.simulation, i, "rgb_array") for i in rows]
        return tuple(r.draw(self.simulation, i) for i, r in enumerate(self._renderers))

    def close_extras(self, **kwargs: Any) -> None:
        """Release the threads and the renderers."""
        for renderer in self._renderers:
            renderer.close()
        self._renderers = []
        self.simulation.close()
