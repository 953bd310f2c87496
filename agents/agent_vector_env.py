"""A vector environment with the observations of an agent and commands from its actions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.learned.augmentation import Augmentation
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
