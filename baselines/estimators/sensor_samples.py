"""What an estimator is given: one sample of every sensor channel, per vehicle.

    values (N, 13)  SI, in the order of tracked_env.physics.channels.CHANNELS; pose in any
                    fixed frame; NaN where a sample is missing
    fresh  (N, 3)   whether pose, inertial, drive have a new sample since the last update
    age    (N, 3)   [s] how old each group's sample is
On slopes also ATTITUDE, of the last inertial sample; where it is not measured the ground counts as
level. A DataSheet holds what everybody may know of their sensors: noise and bias magnitudes.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 5.2.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.channels import CHANNEL_COUNT, CHANNELS, GROUP_START, GROUPS

COLUMN = {name: column for column, name in enumerate(CHANNELS)}
ATTITUDE = ("roll", "pitch", "pitch_rate")  # fields of the observation group of that name
POSE, INERTIAL, DRIVE = range(len(GROUPS))  # columns of `fresh` and `age`


class DataSheet(NamedTuple):
    """Standard deviations, bias magnitudes and delay of the sensors; default is the `rtk` set.

    Field names are those of tracked_env.sensors.Sensors.
    """

    position_noise: float = 0.02  # [m] sigma of x and of y
    yaw_noise: float = math.radians(0.3)  # [rad] sigma
    velocity_noise: float = 0.03  # [m/s] sigma, per body axis
    acceleration_noise: float = 0.05  # [m/s^2] sigma, per body axis
    acceleration_bias: float = 0.02  # [m/s^2] magnitude
    gyro_noise: float = 0.002  # [rad/s] sigma
    gyro_bias: float = 0.001  # [rad/s] magnitude
    accelerometer_distance: float = 1.0  # [m] D, between the two that give the yaw acceleration
    sprocket_speed_noise: float = 0.02  # [rad/s] sigma
    torque_noise: float = 10.0  # [N m] sigma, at the sprocket
    pose_delay: float = 0.0  # [s] of position, heading, velocity

    @classmethod
    def of(cls, sensors: Any) -> "DataSheet":
        """From any object that has these attributes, such as tracked_env.sensors.Sensors."""
        return cls(*(float(getattr(sensors, name)) for name in cls._fields))

    @property
    def yaw_acceleration_noise(self) -> float:
        """Sigma [rad/s^2] of the difference of two accelerometers over their distance."""
        return math.sqrt(2.0) * self.acceleration_noise / self.accelerometer_distance


class Measurement(NamedTuple):
    """One sample of all channels of N vehicles; see the head of the file."""

    values: NDArray[np.float64]  # (N, CHANNEL_COUNT)
    fresh: NDArray[np.bool_]  # (N, 3)
    age: NDArray[np.float64]  # (N, 3) [s]

    def channel(self, name: str) -> NDArray[np.float64]:
        """One channel, (N,)."""
        return self.values[:, COLUMN[name]]


class WiderMeasurement(Measurement):
    """A Measurement with fields of registered observation groups, such as registered channels.

    added: by name, (N,) SI each; the last sample, also where the others are of one moment.
    """

    added: Mapping[str, NDArray[np.float64]]

    @classmethod
    def of(
        cls, measurement: Measurement, added: Mapping[str, NDArray[np.float64]]
    ) -> "WiderMeasurement":
        """`measurement` with the fields `added`."""
        wider = cls(*measurement)
        wider.added = added
        return wider

    def channel(self, name: str) -> NDArray[np.float64]:
        """One channel or one registered field, (N,)."""
        return self.added[name] if name in self.added else super().channel(name)


def attitude_of(measurement: Measurement) -> NDArray[np.float64]:
    """ATTITUDE (N, 3) of a measurement: zeros where it is not measured."""
    if not isinstance(measurement, WiderMeasurement) or ATTITUDE[0] not in measurement.added:
        return np.zeros((len(measurement.values), len(ATTITUDE)))
    return np.stack([measurement.added[name] for name in ATTITUDE], axis=1)


def make_measurement(
    fresh: ArrayLike = True, age: ArrayLike = 0.0, **channels: ArrayLike
) -> Measurement:
    """A Measurement from channels by name, each a number or (N,); what is not named is NaN.

    fresh, age: a number for all, or shape (3,) or (N, 3). Raises ValueError for an unknown
    channel.
    """
    unknown = set(channels) - set(CHANNELS)
    if unknown:
        raise ValueError(f"unknown channels {sorted(unknown)}; known are {CHANNELS}")
    arrays = {name: np.atleast_1d(np.asarray(v, dtype=float)) for name, v in channels.items()}
    count = max((len(array) for array in arrays.values()), default=1)
    values = np.full((count, CHANNEL_COUNT), np.nan)
    for name, array in arrays.items():
        values[:, COLUMN[name]] = array
    groups = (count, len(GROUPS))
    return Measurement(
        values,
        np.array(np.broadcast_to(np.asarray(fresh, dtype=bool), groups)),
        np.array(np.broadcast_to(np.asarray(age, dtype=float), groups)),
    )


__all__ = [
    "ATTITUDE", "COLUMN", "DRIVE", "GROUP_START", "INERTIAL", "POSE", "DataSheet", "Measurement",
    "attitude_of", "make_measurement",
]  # fmt: skip
