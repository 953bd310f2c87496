"""Observation augmentation: what an agent sees besides the present observation, by kind.

    blind       nothing: one policy for all vehicles and soils
    history     what was measured and done some steps ago, at lags that double
    reckoned    the pose error by dead reckoning with the belts, without any identification
    estimates   the filtered motion, the identified parameters and their standard deviations
    residual    the estimates and the adaptive controller's action; the agent only corrects it
Any of them can have the data sheet of the sensors behind its features: their noise, which
controllers may read as well. The last three are in `controller_augmentation`;
`agent_policy.make_augmentation` makes them all.
An augmentation turns the observations of N vehicles into features that are appended to them, as
the observers of `tracked_env.wrappers` do. `command` turns the agent's action into the vehicle's.
Training and driving (`baselines.learned.agent_policy`) use the same object, so they cannot differ.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Bools as Bools
from baselines.batch_policy import Floats as Floats
from baselines.estimators.measurement import DataSheet
from tracked_env import observation as layout
from tracked_env.observation import append_features
from tracked_env.physics.parameters import PlantParameters

KINDS = ("blind", "history", "reckoned", "estimates", "residual")
BASE = "adaptive"  # the policy that a residual agent corrects
RESIDUAL_SCALE = 0.3  # [-] of the torque limit, how far the agent may correct the controller
# Reckoned errors, reference minus vehicle in body axes, and the speed by the belts, and what is
# shown as 1 [SI].
RECKONED = {
    "reckoned_error_x": 0.2, "reckoned_error_y": 0.2, "reckoned_heading_error": 0.1,
    "belt_speed": 2.0,
}  # fmt: skip
# Errors of the filtered motion, as the estimators know it, and what is shown as 1 [SI].
FILTERED = {
    "filtered_error_x": 0.2, "filtered_error_y": 0.2, "filtered_heading_error": 0.1,
    "filtered_speed_error": 0.2, "filtered_v_y": 0.2, "filtered_yaw_rate_error": 0.1,
}  # fmt: skip
# What the data sheet says, and what is shown as 0 [SI]: logarithms to base 10, because sensors
# differ from millimetres to metres.
SHEET = {
    "position_noise": 0.02, "yaw_noise": 0.005, "velocity_noise": 0.03, "gyro_bias": 0.001,
    "sprocket_speed_noise": 0.02,
}  # fmt: skip
_NO_NOISE = 1e-3  # of the value that is shown as 0: less is shown as this


class PlainContext(NamedTuple):
    """A context that shows V0."""

    drive: str
    vehicle: PlantParameters
    control_period: float = 0.02
    lateral: str = "sliding"
    sensors: Any = DataSheet()
    observation: Sequence[str] = layout.NAMES


def merge_rows(old: Any, new: Any, rows: Bools) -> Any:
    """`old` in the rows marked, `new` in the others; arrays (N, ...), tuples of them, or None of
    a network that carries nothing on."""
    if old is None or new is None:
        return new if old is None else old
    if isinstance(old, tuple):
        parts = [merge_rows(one, other, rows) for one, other in zip(old, new, strict=True)]
        return type(old)(*parts) if hasattr(old, "_fields") else tuple(parts)
    return np.where(rows.reshape(-1, *[1] * (old.ndim - 1)), old, new)


LAGS = (1, 2, 4, 8, 16, 32)  # [control steps] 20 ms to 0.64 s: drive, sensor delay, slow pole
# What shows the vehicle's response; references and ages of the past say nothing about it.
REMEMBERED = (
    "position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate",
    "acceleration_x", "acceleration_y", "yaw_acceleration", "sprocket_speed_left",
    "sprocket_speed_right", "torque_left", "torque_right", "previous_action_left",
    "previous_action_right",
)  # fmt: skip


class Augmentation:
    """Features of N vehicles, and the vehicle's action from the agent's. This one has none (blind).

    count: number of vehicles. control_period [s]: between two observations.
    """

    feature_names: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()  # fields of the observation that are read
    learned: tuple[str, ...] = ()  # features that say what has been learned of the vehicle

    def __init__(self, count: int, control_period: float) -> None:
        self.count, self.control_period = count, control_period
        self._memory: tuple[Any, ...] = ()  # arrays (N, ...) of what is remembered
        self._sheet: Floats | None = None  # what is shown of the data sheet, (N, F)

    def show_sheet(self, sheet: DataSheet) -> None:
        """Show SHEET of the sensors behind the features."""
        values = np.array([getattr(sheet, name) for name in SHEET]) / np.array([*SHEET.values()])
        shown = np.log10(np.maximum(values, _NO_NOISE)).astype(np.float32)
        self._sheet = np.tile(shown, (self.count, 1))
        self.feature_names = (*self.feature_names, *SHEET)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """Features (N, F) after observations (N, D), and the data sheet if it is shown; rows with
        `start` begin an episode."""
        features = self.features(observation, start)
        return features if self._sheet is None else np.concatenate([features, self._sheet], axis=1)

    def features(self, observation: Floats, start: Bools) -> Floats:
        """The features of `observe` without the data sheet."""
        return np.empty((self.count, 0), dtype=np.float32)

    def memories(self) -> Any:
        """A copy of all that is remembered."""
        return tuple(values.copy() for values in self._memory)

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all.

        Raises ValueError, before anything is changed, for memories of another shape.
        """
        for array, memory in zip(self._memory, memories, strict=True):
            if array.shape != np.shape(memory):
                raise ValueError(f"state of shape {np.shape(memory)}; must be {array.shape}")
        where = slice(None) if rows is None else rows
        for array, memory in zip(self._memory, memories, strict=True):
            array[where] = memory[where]

    def freeze(self, rows: Bools) -> None:
        """A controller inside keeps what it knows of these rows (N,)."""

    def command(self, action: Floats, features: Floats) -> Floats:
        """The vehicle's action (N, 2) in [-1, 1] from the agent's and the present features."""
        return action


class History(Augmentation):
    """Past samples of REMEMBERED at LAGS; before an episode's first, its first one.

    `samples` (N, longest lag + 1, fields) holds the latest ones, the newest first. Raises
    ValueError unless the lags rise from 1 on.
    """

    needs = REMEMBERED

    def __init__(self, count: int, control_period: float, lags: tuple[int, ...] = LAGS) -> None:
        super().__init__(count, control_period)
        if not lags or list(lags) != sorted(set(lags)) or lags[0] < 1:
            raise ValueError(f"lags = {lags}; must rise, from 1 control step on")
        self.lags = np.array(lags)
        self._columns = np.array([layout.INDEX[name] for name in REMEMBERED])
        names = tuple(f"{name}_{lag}_before" for lag in lags for name in REMEMBERED)
        self.learned = self.feature_names = names
        self.samples: Floats = np.zeros((count, lags[-1] + 1, len(REMEMBERED)), dtype=np.float32)
        self._memory = (self.samples,)

    def features(self, observation: Floats, start: Bools) -> Floats:
        """The samples at the lags, (N, lags * fields); rows with `start` forget."""
        sample = np.nan_to_num(observation[:, self._columns])
        self.samples[:, 1:] = self.samples[:, :-1]
        self.samples[:, 0] = sample
        if start.any():
            self.samples[start] = sample[start, None]
        return self.samples[:, self.lags].reshape(self.count, -1)


def network_inputs(observation: Floats, features: Floats) -> Floats:
    """What the network sees: observation (N, SIZE) and features, 0 for what is not measured."""
    return np.nan_to_num(append_features(observation, features), copy=False)
