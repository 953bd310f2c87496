"""Observation augmentation by dead reckoning, and by the data sheet of the sensors.

reckoned    the pose error, carried on by the belts while no pose comes, and the speed of the belts
data sheet  the noise of the sensors, which controllers may read as well, behind the other features
Dead reckoning is that of the Lyapunov controllers (`baselines.lyapunov.pose_filter`): gyro and
velocity, or belts without slip where no velocity is measured, pulled towards the samples of the
pose by the steady gain of the data sheet. It knows nothing of soil, mass or slip.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.sensor_samples import DataSheet
from baselines.learned.history_augmentation import Blind
from baselines.lyapunov.pose_filter import GYRO, PATH, POSE, filter_of, gyro_noise_of, locate
from baselines.lyapunov.pseudo_kinematic import PseudoKinematicModel
from tracked_env import observation as layout
from tracked_env.physics.parameters import PlantParameters

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]

# Reckoned errors, reference minus vehicle in body axes, and the speed by the belts, and what is
# shown as 1 [SI].
RECKONED = {
    "reckoned_error_x": 0.2, "reckoned_error_y": 0.2, "reckoned_heading_error": 0.1,
    "belt_speed": 2.0,
}  # fmt: skip
_SCALE = np.array(list(RECKONED.values()))
_BELTS = ("sprocket_speed_left", "sprocket_speed_right")
_SPROCKETS = [layout.INDEX[name] for name in _BELTS]

# What the data sheet says, and what is shown as 0 [SI]: logarithms to base 10, because sensors
# differ from millimetres to metres.
SHEET = {
    "position_noise": 0.02, "yaw_noise": 0.005, "velocity_noise": 0.03, "gyro_bias": 0.001,
    "sprocket_speed_noise": 0.02,
}  # fmt: skip
_NO_NOISE = 1e-3  # of the value that is shown as 0: less is shown as this


class Reckoned(Blind):
    """The reckoned pose error as features; the agent drives.

    count, control_period: as Blind. vehicle: nominal. sheet: of the sensors.
    """

    feature_names = tuple(RECKONED)
    needs = (*POSE, "pose_age", *_BELTS, *PATH)

    def __init__(
        self, count: int, control_period: float, vehicle: PlantParameters, sheet: DataSheet
    ) -> None:
        super().__init__(count, control_period)
        self._measured, self._gains = filter_of(sheet, control_period)
        self._belts = PseudoKinematicModel(vehicle)
        self._gyro_noise = gyro_noise_of(sheet, True)
        # error (N, 3), age (N,) of the pose, mean motion (N, 3), what is known of the gyro,
        # whether a pose has come (N,)
        self._memories = (
            np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3)), np.zeros((count, GYRO)),
            np.zeros(count, bool),
        )  # fmt: skip

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """RECKONED (N, F); rows with `start` forget."""
        for values in self._memories:
            values[start] = 0
        sprockets = observation[:, _SPROCKETS] * layout.SCALE[_SPROCKETS]
        motion, alpha = self._belts.motion(np.nan_to_num(sprockets))
        error, age, mean, gyro, located = self._memories
        locate(
            observation, motion, alpha, self._measured, self._gains, self._gyro_noise,
            self.control_period, error, age, mean, gyro, located, np.empty((self.count, 4)),
        )  # fmt: skip
        return (np.column_stack([-error, motion[:, 0]]) / _SCALE).astype(np.float32)

    def memories(self) -> Any:
        """A copy of all that is remembered."""
        return tuple(values.copy() for values in self._memories)

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        for own, given in zip(self._memories, memories, strict=True):
            if own.shape != np.shape(given):
                raise ValueError(f"state of shape {np.shape(given)}; must be {own.shape}")
        where = slice(None) if rows is None else rows
        for own, given in zip(self._memories, memories, strict=True):
            own[where] = given[where]


def sheet_features(sheet: DataSheet) -> Floats:
    """SHEET of a data sheet, (F,)."""
    known = np.array([getattr(sheet, name) for name in SHEET]) / np.array(list(SHEET.values()))
    return np.log10(np.maximum(known, _NO_NOISE)).astype(np.float32)


class WithDataSheet:
    """Another augmentation, with the data sheet of the sensors behind its features."""

    def __init__(self, inner: Any, sheet: DataSheet) -> None:
        self.inner, self.count, self.control_period = inner, inner.count, inner.control_period
        self.needs = inner.needs
        self.feature_names = (*inner.feature_names, *SHEET)
        self.learned: tuple[str, ...] = inner.learned
        self._shown = np.tile(sheet_features(sheet), (inner.count, 1))

    def freeze(self, rows: Bools) -> None:
        """A controller inside keeps what it knows of these rows (N,)."""
        self.inner.freeze(rows)

    def observe(self, observation: Floats, start: Bools) -> Floats:
        """The features of the other one, then SHEET, (N, F)."""
        return np.concatenate([self.inner.observe(observation, start), self._shown], axis=1)

    def memories(self) -> Any:
        """A copy of all that is remembered."""
        return self.inner.memories()

    def restore(self, memories: Any, rows: Bools | None = None) -> None:
        """Go on from `memories`, in the rows marked or in all."""
        self.inner.restore(memories, rows)

    def command(self, action: Floats, features: Floats) -> Floats:
        """As the other one."""
        command: Floats = self.inner.command(action, features)
        return command
