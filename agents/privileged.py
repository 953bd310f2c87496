"""How a teacher's vehicles show it the truth while it learns (`privileged_inputs` of baselines).

`Privileged` is an observation augmentation that `TruthfulVectorEnv` fills from `info["truth"]`.
"""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from baselines.learned.history_augmentation import Blind
from baselines.learned.privileged_inputs import PRIVILEGED, privileged, true_motion
from tracked_env.physics.parameters import PlantParameters

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


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
