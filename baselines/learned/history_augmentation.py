"""Observation augmentation without estimators: none, or samples of the past.

blind       nothing: one policy for all vehicles and soils
history     what was measured and done some steps ago, at lags that double
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env import observation as layout

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

LAGS = (1, 2, 4, 8, 16, 32)  # [control steps] 20 ms to 0.64 s: drive, sensor delay, slow pole
# What shows the vehicle's response; references and ages of the past say nothing about it.
REMEMBERED = (
    "position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate",
    "acceleration_x", "acceleration_y", "yaw_acceleration", "sprocket_speed_left",
    "sprocket_speed_right", "torque_left", "torque_right", "previous_action_left",
    "previous_action_right",
)  # fmt: skip


class Blind:
    """No augmentation. count: number of vehicles. control_period [s]."""

    feature_names: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    learned: tuple[str, ...] = ()

    def __init__(self, count: int, control_period: float) -> None:
        self.count = count
        self.control_period = control_period

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """No features, (N, 0)."""
        return np.empty((self.count, 0), dtype=np.float32)

    def memories(self) -> Any:
        """Nothing."""
        return ()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Nothing to put back."""

    def freeze(self, rows: Bools) -> None:
        """No controller that could learn."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The agent's action as it is."""
        return action


class History(Blind):
    """Past samples of REMEMBERED at LAGS; before an episode's first, its first one.

    `samples` (N, longest lag + 1, fields) holds the latest ones, the newest first.
    """

    needs = REMEMBERED

    def __init__(self, count: int, control_period: float, lags: tuple[int, ...] = LAGS) -> None:
        """Raises ValueError unless the lags rise from 1 on."""
        super().__init__(count, control_period)
        if not lags or list(lags) != sorted(set(lags)) or lags[0] < 1:
            raise ValueError(f"lags = {lags}; must rise, from 1 control step on")
        self._lags = np.array(lags)
        self._columns = np.array([layout.INDEX[name] for name in REMEMBERED])
        self.learned = self.feature_names = tuple(
            f"{name}_{lag}_before" for lag in lags for name in REMEMBERED
        )
        self.samples: Floats = np.zeros((count, lags[-1] + 1, len(REMEMBERED)), dtype=np.float32)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The samples at the lags, (N, lags * fields); rows with `start` forget."""
        sample = np.nan_to_num(observation[:, self._columns])
        self.samples[:, 1:] = self.samples[:, :-1]
        self.samples[:, 0] = sample
        if start.any():
            self.samples[start] = sample[start, None]
        return self.samples[:, self._lags].reshape(self.count, -1)

    def memories(self) -> Any:
        """A copy of the samples."""
        return self.samples.copy()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        if np.shape(memories) != self.samples.shape:
            raise ValueError(f"state of shape {np.shape(memories)}; must be {self.samples.shape}")
        where = slice(None) if rows is None else rows
        self.samples[where] = memories[where]
