"""Unscented Kalman filter for the slips of both tracks, and a filtered pose: S 7.2, batched.

The model is in slip_kinematics, delayed samples in dead_reckoning, the filter in slip_unscented,
the rest of a step in slip_step. slip_filterpy is the same observer around the filter of filterpy.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from baselines.estimators import (
    dead_reckoning,
    slip_covariance,
    slip_kinematics,
    slip_outage,
    slip_unscented,
)
from baselines.estimators import slip_step as step
from baselines.estimators.estimate import AnsweringEstimator, Estimate, Estimator, Quantity, Setting
from baselines.estimators.observation_reader import POSE_DELAY
from baselines.estimators.sensor_samples import ATTITUDE, DataSheet, Measurement, attitude_of
from baselines.estimators.slip_kinematics import ROWS, STATES
from tracked_env.physics.attitude import LEVEL
from tracked_env.physics.channels import CHANNEL_COUNT, GROUPS
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

# Value, covariance, (N, 4) excitation, condition, NIS, skipped, and status.
Answer = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
FALSE_ALARM = 1e-6  # [-] share of good samples that the outlier gate rejects


@loop
def forget(memory, rows):
    """Vehicles `rows` as nothing were known of them."""
    for i in rows:
        memory[i, :] = 0.0
        memory[i, step.HELD_L] = memory[i, step.HELD_R] = step.LARGEST_READING
        for a in range(STATES):
            memory[i, step.COVARIANCE + (STATES + 1) * a] = slip_covariance.largest_variance(a)


@loop
def motion_all(memory, k, motion):
    """(X, Y, psi, v_x, v_y, w) of all vehicles into motion (N, 6)."""
    for i in range(memory.shape[0]):
        belt_left, belt_right = memory[i, step.BELT_L], memory[i, step.BELT_R]
        slip_left, slip_right = (
            memory[i, step.STATE + slip_kinematics.SLIP_LEFT],
            memory[i, step.STATE + slip_kinematics.SLIP_RIGHT],
        )
        alpha = memory[i, step.STATE + slip_kinematics.SIDE_SLIP]
        u = slip_kinematics.make_inputs(
            belt_left, belt_right, belt_left, belt_right, slip_left, slip_right, alpha,
            LEVEL, 0.0, -1.0, k,
        )  # fmt: skip
        left, right, tangent = slip_kinematics.gains(slip_left, slip_right, alpha, u)
        velocity = slip_kinematics.body_velocity(left, right, belt_left, belt_right, tangent, k)
        gap = step.OUTAGE + slip_outage.GAP_X
        for a in range(3):
            motion[i, a] = memory[i, step.STATE + a] + memory[i, gap + a]
            motion[i, 3 + a] = velocity[a]
        motion[i, 3] += memory[i, step.OUTAGE + slip_outage.GAP_SPEED]


@loop
def read_slips(memory, k, slips, variances):
    """i_L, i_R and their variances of all vehicles, (N, 2) each; inf in an outage, where slips are
    what the soil is thought to be."""
    for i in range(memory.shape[0]):
        for side in range(2):
            state = slip_kinematics.SLIP_LEFT + side
            slips[i, side] = memory[i, step.STATE + state]
            variances[i, side] = memory[i, step.COVARIANCE + (STATES + 1) * state]
            if slip_outage.silent(memory, i, step.OUTAGE, k):
                variances[i, side] = math.inf


@loop
def take_ground_all(memory, k, soil, covariance, friction):
    """soil (N, 2) F_max, K, their covariance (N, 2, 2) and mu_t (N,), for outages."""
    for i in range(memory.shape[0]):
        maximum, modulus = soil[i, 0], soil[i, 1]
        slip_outage.take_ground(
            memory, i, step.OUTAGE, maximum, modulus,
            covariance[i, 0, 0] / (maximum * maximum),
            covariance[i, 0, 1] / (maximum * modulus),
            covariance[i, 1, 1] / (modulus * modulus),
            friction[i], k,
        )  # fmt: skip


class Motion(NamedTuple):
    """Filtered pose and velocities of N vehicles, each (N,)."""

    x: NDArray[np.float64]  # [m] world
    y: NDArray[np.float64]  # [m] world
    yaw: NDArray[np.float64]  # [rad] not wrapped
    v_x: NDArray[np.float64]  # [m/s] body
    v_y: NDArray[np.float64]  # [m/s] body
    yaw_rate: NDArray[np.float64]  # [rad/s]


_DRIFT = Range(0.0, 10.0, "SI/sqrt(s)", "It is no variance.")
_DELAY = Range(0.0, 10.0, "s", "Did you pass milliseconds?")


class SlipObserver(AnsweringEstimator):
    """Slip ratios, side slip angle and pose of N vehicles from pose and sprocket speeds.

    parameters: nominal; track gauge and sprocket radius are used, in outages contact length and
    icr_forward too. control_period [s]:
    time between two updates. data_sheet: noise of the sensors. count: N.
    velocity: True uses v_x, v_y of the pose group and the gyro too, False the paper's pose alone.
    Process noise, standard deviations that grow with the square root of time:
    position_drift [m/sqrt(s)], yaw_drift [rad/sqrt(s)]: what the kinematics leave out, bumps and
    flexing tracks. slip_drift [1/sqrt(s)]: a slip changes by 0.02 in a second, straight into a
    turn on clay. side_slip_drift [rad/sqrt(s)]: likewise.
    longest_delay [s]: of the pose group; older samples count as that old. lateral: lateral model
    of the nominal vehicle, used in outages.

    Raises ValueError for arguments outside their range.
    """

    names = slip_kinematics.NAMES
    provides = (
        Quantity("slip_left", "-"), Quantity("slip_right", "-"), Quantity("side_slip", "rad"),
    )  # fmt: skip
    needs: tuple[str, ...] = (
        "x", "y", "yaw", "v_x", "v_y", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right",
        "acceleration_x", "acceleration_y", "torque_left", "torque_right",
    )  # fmt: skip
    paired = False

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        velocity: bool = True,
        position_drift: float = 0.01,
        yaw_drift: float = 0.003,
        slip_drift: float = 0.02,
        side_slip_drift: float = 0.03,
        longest_delay: float = 1.0,
        lateral: str = "sliding",
    ) -> None:
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        for name in ("track_gauge", "sprocket_radius"):
            checked_number(name, getattr(parameters, name), RANGES[name])
        for name, number in data_sheet._asdict().items():
            checked_number(name, number, POSE_DELAY if name == "pose_delay" else SIGMA)
        drifts = (position_drift, yaw_drift, slip_drift, side_slip_drift)
        for name, drift in zip(("position", "yaw", "slip", "side_slip"), drifts, strict=True):
            checked_number(f"{name}_drift", drift, _DRIFT)
        checked_number("longest_delay", longest_delay, _DELAY)
        self.velocity = bool(velocity)
        rows = ROWS if velocity else 3
        gate = float(chi2.isf(FALSE_ALARM, rows))
        self._constants = slip_kinematics.make_constants(
            parameters, self.control_period, data_sheet, drifts, gate, rows, lateral
        )
        self._slots = dead_reckoning.slots_for(longest_delay, self.control_period)
        columns = step.RING + dead_reckoning.columns_for(self._slots)
        self.memory = np.zeros((int(count), columns))
        self.reset()

    @classmethod
    def for_stack(cls, setting: Setting) -> "SlipObserver":
        """As a part of the identification stack."""
        part = cls(
            setting.parameters, setting.control_period, setting.data_sheet, setting.count,
            lateral=setting.lateral,
        )  # fmt: skip
        if setting.attitude:
            part.needs = (*cls.needs, *ATTITUDE)
        return part

    @property
    def constants(self) -> slip_kinematics.Constants:
        """Numbers of the model, as the kernels take them."""
        return self._constants

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Nothing is needed of other estimators."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        every = np.arange(len(self.memory))
        forget(self.memory, every if rows is None else np.atleast_1d(every[np.asarray(rows)]))

    def take_ground(
        self,
        soil: NDArray[np.float64],
        covariance: NDArray[np.float64],
        friction: NDArray[np.float64],
    ) -> None:
        """What is known of the ground, for outages: F_max [N] of a track and K [m] (N, 2), their
        covariance (N, 2, 2), mu_t (N,)."""
        take_ground_all(self.memory, self._constants, soil, covariance, friction)

    def compute(self, measurement: Measurement) -> Answer:
        """Take one sample; returns the bare answer: value, covariance, summary, status."""
        n = len(self.memory)
        value, covariance = np.empty((n, STATES)), np.empty((n, STATES, STATES))
        summary, status = np.empty((n, 4)), np.empty(n, dtype=np.int64)
        self._advance(measurement, value, covariance, summary, status)
        return value, covariance, summary, status

    def estimate(self, answer: Answer) -> Estimate:
        """The bare answer as an Estimate."""
        value, covariance, summary, status = answer
        return Estimate(
            self.names, value, covariance, summary[:, 0], summary[:, 1], status,
            summary[:, 2], summary[:, 3].astype(np.int64),
        )  # fmt: skip

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle. NIS is NaN without a new pose sample.

        Raises ValueError for arrays whose shape is not that of a Measurement of N vehicles.
        """
        n = len(self.memory)
        shapes = ((n, CHANNEL_COUNT), (n, len(GROUPS)), (n, len(GROUPS)))
        for name, array, shape in zip(Measurement._fields, measurement, shapes, strict=True):
            if array.shape != shape:
                raise ValueError(
                    f"measurement.{name} has shape {array.shape}; must be {shape}. "
                    f"Is the observer made for count = {n} vehicles?"
                )
        return self.estimate(self.compute(measurement))

    def _advance(
        self,
        measurement: Measurement,
        value: NDArray[np.float64],
        covariance: NDArray[np.float64],
        summary: NDArray[np.float64],
        status: NDArray[np.int64],
    ) -> None:
        """The filter itself: writes its results into the arrays, all but the first out."""
        slip_unscented.update_all(
            measurement.values, measurement.fresh, measurement.age, attitude_of(measurement),
            self._constants, self._slots, self.memory, value, covariance, summary, status,
        )  # fmt: skip

    def motion_rows(self) -> NDArray[np.float64]:
        """The columns of a Motion, (N, 6)."""
        columns = np.empty((len(self.memory), 6))
        motion_all(self.memory, self._constants, columns)
        return columns

    def motion(self) -> Motion:
        """Filtered pose; velocities by the model from the last belt speeds and the slips."""
        return Motion(*self.motion_rows().T)

    @property
    def slips(self) -> NDArray[np.float64]:
        """(N, 2) i_L, i_R [-]."""
        return self.slips_and_variances()[0]

    @property
    def slip_variances(self) -> NDArray[np.float64]:
        """(N, 2) variances of i_L, i_R [-]."""
        return self.slips_and_variances()[1]

    def slips_and_variances(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`slips` and `slip_variances`."""
        count = len(self.memory)
        slips, variances = np.empty((count, 2)), np.empty((count, 2))
        read_slips(self.memory, self._constants, slips, variances)
        return slips, variances
