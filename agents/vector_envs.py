"""A vector environment with the observations of an agent and commands from its actions.

How a teacher's vehicles show it the truth while it learns (`privileged_inputs` of baselines).

`Privileged` is an observation augmentation that `TruthfulVectorEnv` fills from `info["truth"]`.

Several vector environments as one, for Stable-Baselines3: a part of the vehicles for each.

An environment of this project has one kind of sensors, and the augmentations that weigh
measurements (`baselines.learned.augmentation`) have one data sheet. An agent that is to cope with
several gets an environment with an augmentation for each, joined here row by row.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from baselines.learned.agent_policy import PRIVILEGED, privileged, true_motion
from baselines.learned.augmentation import Augmentation, Blind
from tracked_env.physics.parameters import PlantParameters
from tracked_env.wrappers import IdentifiedVectorObservation

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


class AgentVectorEnv(IdentifiedVectorObservation):
    """A vector env as the agent lives in it: widened observations, its own actions."""

    observer: Augmentation

    def step(self, actions: Floats) -> tuple[Floats, NDArray[np.float64], Bools, Bools, Any]:
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
        return self.observer.memories(), self._features.copy(), self._over.copy()

    def resume(self, snapshot: Any) -> None:
        """Go on from what `snapshot` returned."""
        memories, self._features, self._over = snapshot
        self.observer.restore(memories)


class Privileged(Blind):
    """An augmentation that is given the truth before each `observe`.

    count, control_period: as Blind.
    nominal: the vehicle and the soil that the inputs are ratios to and differences from.
    `present` (N, F) belongs to the observation that the environment shows. `last` is the same
    except in rows that have just ended, where it belongs to the last observation of the episode.
    """

    feature_names = PRIVILEGED

    def __init__(self, count: int, control_period: float, nominal: PlantParameters) -> None:
        super().__init__(count, control_period)
        self.nominal = nominal
        self.present: Floats = np.zeros((count, len(PRIVILEGED)), dtype=np.float32)
        self.last = self.present
        self.simulation: Any = None  # of the environment that fills it in

    def motion(self) -> Floats:
        """The true MOTION (N, 6) now, as an ideal observation shows it."""
        column = self.simulation.column
        reference = [column(f"reference_{name}") for name in ("x", "y", "yaw")]
        return true_motion(self.simulation.truth(), reference)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The privileged inputs (N, F); rows with `start` begin an episode."""
        return np.where(start[:, None], self.present, self.last)


class TruthfulVectorEnv(gymnasium.vector.VectorWrapper):
    """Tells a `Privileged` the truth after each step. env: with `expose_truth`.

    Raises ValueError for an environment that does not expose the truth, or of another vehicle.
    """

    def __init__(
        self, env: gymnasium.vector.VectorEnv[Any, Any, Any], augmentation: Privileged
    ) -> None:
        super().__init__(env)
        core: Any = env.unwrapped
        if not getattr(core, "expose_truth", False):
            raise ValueError("a teacher needs an environment made with expose_truth = True")
        if core.simulation.solver.nominal != augmentation.nominal:
            raise ValueError(
                "the environment and the augmentation have different nominal vehicles; a teacher "
                "needs `tracked_env.physics.parameters.VEHICLES` of the environment's `vehicle`"
            )
        self.augmentation = augmentation
        augmentation.simulation = core.simulation

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes."""
        observation, info = self.env.reset(seed=seed, options=options)
        augmentation = self.augmentation
        augmentation.present = privileged(info["truth"], augmentation.nominal)
        augmentation.last = augmentation.present
        return observation, info

    def step(self, actions: Floats) -> tuple[Any, NDArray[np.float64], Bools, Bools, Any]:
        """Advance all rows by one control period; actions (N, 2)."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        augmentation = self.augmentation
        augmentation.present = privileged(info["truth"], augmentation.nominal)
        augmentation.last = augmentation.present
        if "final_info" in info:  # the row shows its next episode already
            final = privileged(info["final_info"]["truth"], augmentation.nominal)
            ended = info["_final_info"][:, None]
            augmentation.last = np.where(ended, final, augmentation.present)
        return observation, reward, terminated, truncated, info


def shares(count: int, parts: int) -> list[int]:
    """`count` rows over `parts` environments as evenly as it goes, the first ones get one more.

    Raises ValueError where there are fewer rows than parts.
    """
    if count < parts:
        raise ValueError(
            f"{count} vehicles or held-out episodes for {parts} kinds of sensors; must be one each"
        )
    return [count // parts + (part < count % parts) for part in range(parts)]


class JoinedVecEnv(VecEnv):
    """The rows of all `parts` in their order; each does what it does alone, bit for bit.

    Row i of all is seeded seed + i. Raises ValueError for parts with different spaces.
    """

    def __init__(self, parts: Sequence[VecEnv]) -> None:
        self.parts = list(parts)
        first = self.parts[0]
        for part in self.parts:
            if (part.observation_space, part.action_space) != (
                first.observation_space,
                first.action_space,
            ):
                raise ValueError("parts with different spaces cannot be joined")
        edges = np.cumsum([0, *[part.num_envs for part in self.parts]])
        self._rows = [slice(int(low), int(high)) for low, high in pairwise(edges)]
        self.render_mode = first.render_mode
        super().__init__(int(edges[-1]), first.observation_space, first.action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed row i with seed + i at the next reset; None draws one."""
        drawn = int(np.random.randint(2**31)) if seed is None else seed  # noqa: NPY002, as SB3
        found: list[int | None] = []
        for part, rows in zip(self.parts, self._rows, strict=True):
            found += part.seed(drawn + rows.start)
        return found

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Options of the next reset, the same for all rows or one for each."""
        for part, rows in zip(self.parts, self._rows, strict=True):
            part.set_options(options[rows] if isinstance(options, list) else options)

    def reset(self) -> NDArray[np.float32]:
        """Start all rows."""
        observations = [np.asarray(part.reset()) for part in self.parts]
        self.reset_infos = [info for part in self.parts for info in part.reset_infos]
        return np.concatenate(observations)

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Hand each part its actions (N, 2) for `step_wait`."""
        for part, rows in zip(self.parts, self._rows, strict=True):
            part.step_async(actions[rows])

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all rows by one control period."""
        stepped = [part.step_wait() for part in self.parts]
        observations, rewards, dones = (
            np.concatenate([np.asarray(result[column]) for result in stepped])
            for column in range(3)
        )
        return observations, rewards, dones, [info for result in stepped for info in result[3]]

    def close(self) -> None:
        """Release what the parts hold."""
        for part in self.parts:
            part.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """One RGB array per row."""
        return [image for part in self.parts for image in part.get_images()]

    def _of(self, indices: VecEnvIndices) -> list[tuple[VecEnv, int]]:
        """The part and its row for each of the rows asked for."""
        where = [(part, row) for part in self.parts for row in range(part.num_envs)]
        return [where[i] for i in self._get_indices(indices)]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of each row's environment."""
        return [part.get_attr(attr_name, row)[0] for part, row in self._of(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """As the parts do."""
        for part, row in self._of(indices):
            part.set_attr(attr_name, value, row)

    def env_method(
        self,
        method_name: str,
        *method_args: Any,
        indices: VecEnvIndices = None,
        **method_kwargs: Any,
    ) -> list[Any]:
        """As the parts do."""
        return [
            part.env_method(method_name, *method_args, indices=row, **method_kwargs)[0]
            for part, row in self._of(indices)
        ]

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """As the parts do."""
        return [part.env_is_wrapped(wrapper_class, row)[0] for part, row in self._of(indices)]
