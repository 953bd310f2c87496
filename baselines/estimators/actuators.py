"""Estimator of the drives: gain of each, and their lag, from commands and torques.

Recursive least squares of `actuator_step` for N vehicles, with its prior from the nominal vehicle
and the data sheet. Both drives have the same lag; their gains may differ, and step on the way.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.actuator_step import (
    ANSWER,
    ANSWER_NIS,
    ANSWER_SKIPPED,
    ANSWER_STATUS,
    INERTIA,
    LARGEST_DECAY,
    LEAST_DECAY,
    RING,
    VARIANCES,
    Model,
    update_all,
)
from baselines.estimators.estimate import AnsweringEstimator, Estimate, Estimator, Quantity, Setting
from baselines.estimators.sensor_samples import DataSheet, Measurement
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.validation import CONTROL_PERIOD, VEHICLES, checked_number, checked_whole

COMMANDS = ("previous_action_left", "previous_action_right")  # fields of the observation
LONGEST_AGE = 1.0  # [s] of a drive sample that is used
LONGEST_SPAN = 0.2  # [s] between the neighbours of a sample that is used
GAIN_SIGMA = 0.3  # [-] prior standard deviation
DECAY_SIGMA = 0.2  # [-] the same of a, at 50 Hz; T = 0.05 s is a = 0.67, T = 0.3 s is a = 0.94
GAIN_WALK = 0.004  # [1/sqrt(s)] random walk of a gain
DECAY_WALK = 0.002  # [1/sqrt(s)] of a
DECAY_JUMP = 0.03  # [-] of a, where a gain seems to have changed
MODEL_NOISE = 0.0005  # [-] of the torque limit: what the model leaves out
FASTEST = 0.85  # [-] of the top speed: from here on a drive may give less


class ActuatorEstimator(AnsweringEstimator):
    """Estimates [drive_time_constant T [s], gains of the left and right drive [-]] of N vehicles.

    parameters: nominal ones. control_period [s]. data_sheet: noise of the sensors. count: vehicles.
    Raises ValueError for a period or count that makes no sense.
    """

    names = ("drive_time_constant", "actuator_gain_left", "actuator_gain_right")
    provides = (
        Quantity("drive_time_constant", "s"),
        Quantity("actuator_gain_left", "-"),
        Quantity("actuator_gain_right", "-"),
    )
    needs = (
        "v_x", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right", "torque_left",
        "torque_right", *COMMANDS,
    )  # fmt: skip
    paired = True

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
    ) -> None:
        period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        sheet = DataSheet() if data_sheet is None else data_sheet
        p = parameters
        lag = float(p.drive_time_constant)
        decay = math.exp(-period / lag) if lag > 0.0 else LEAST_DECAY
        bounds = RANGES["actuator_gain_left"]
        self._model = Model(
            period, round(LONGEST_AGE / period) + 2, float(p.torque_limit),
            float(p.sprocket_radius), 0.5 * float(p.track_gauge),
            FASTEST * float(p.sprocket_speed_limit),
            sheet.torque_noise**2 + (MODEL_NOISE * float(p.torque_limit)) ** 2,
            2.0 * sheet.sprocket_speed_noise**2, float(p.sprocket_inertia),
            max(LONGEST_SPAN / period, 2.0) + 0.5,
            min(max(decay, LEAST_DECAY), LARGEST_DECAY), GAIN_SIGMA**2, DECAY_SIGMA**2,
            GAIN_WALK**2 * period, DECAY_WALK**2 * period, DECAY_JUMP**2, bounds.low, bounds.high,
        )  # fmt: skip
        self.memory = np.zeros((count, RING + 2 * self._model.slots))

    @classmethod
    def for_stack(cls, setting: Setting) -> "ActuatorEstimator":
        """As a part of the identification stack."""
        return cls(setting.parameters, setting.control_period, setting.data_sheet, setting.count)

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Nothing is needed of other estimators."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0

    def compute(self, measurement: Measurement) -> NDArray[np.float64]:
        """Take one sample; the bare answer (N, ANSWER): g_L, g_R, a, their covariance (LL, LR, RR,
        La, Ra, aa), status, NIS, samples skipped."""
        out = np.empty((len(self.memory), ANSWER))
        left, right = (measurement.channel(name) for name in COMMANDS)
        update_all(
            measurement.values, measurement.fresh, measurement.age, left, right, self.memory,
            self._model, out,
        )  # fmt: skip
        return out

    def belt_inertia(self) -> NDArray[np.float64]:
        """J [kg m^2] of a drive and track that the torques show, (N,); 0 on a plant without."""
        return self.memory[:, INERTIA].copy()

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle."""
        return self.estimate(self.compute(measurement))

    def estimate(self, answer: NDArray[np.float64]) -> Estimate:
        """The answer of the kernel as an Estimate; the lag to first order."""
        model, value = self._model, np.empty((len(answer), 3))
        decay = answer[:, 2]
        value[:, 0] = lag(decay, model.period)
        value[:, 1:] = answer[:, :2]
        slope = value[:, 0] ** 2 / (model.period * decay)  # dT/da
        index = np.array([[5, 3, 4], [3, 0, 1], [4, 1, 2]])
        raw = answer[:, VARIANCES:ANSWER_STATUS][:, index]
        jacobian = np.ones_like(value)
        jacobian[:, 0] = slope
        prior = np.sqrt([model.decay_variance, model.gain_variance, model.gain_variance])
        information = np.linalg.eigvalsh(np.linalg.inv(raw / np.outer(prior, prior))) - 1.0
        smallest, largest = np.maximum(information[:, 0], 0.0), information[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            condition = np.where(smallest > 0.0, largest / smallest, np.inf)
        return Estimate(
            self.names,
            value,
            raw * jacobian[:, :, None] * jacobian[:, None, :],
            smallest,
            condition,
            answer[:, ANSWER_STATUS].astype(np.int64),
            answer[:, ANSWER_NIS],
            answer[:, ANSWER_SKIPPED].astype(np.int64),
        )


def lag(decay: NDArray[np.float64], period: float) -> NDArray[np.float64]:
    """T [s] from a = exp(-dt / T), dt = period [s]."""
    return np.asarray(-period / np.log(decay))
