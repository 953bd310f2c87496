"""What an estimator is given: one sample of every sensor channel, per vehicle.

    values (N, 13)  SI, in the order of tracked_env.sensors.CHANNELS; pose in any
                    fixed frame; NaN where a sample is missing
    fresh  (N, 3)   whether pose, inertial, drive have a new sample since the last update
    age    (N, 3)   [s] how old each group's sample is
On slopes also ATTITUDE, of the last inertial sample; where it is not measured the ground counts as
level. A DataSheet holds what everybody may know of their sensors: noise and bias magnitudes.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 5.2.

What every estimator answers: values with covariance, excitation and status.

    excitation  smallest eigenvalue of the information that the (forgetting) window holds, in
                units of the prior information: 0 = the data say nothing about some direction of
                the parameters, 1 = data and prior weigh the same
    condition   ratio of the largest to the smallest eigenvalue of the same matrix
An estimator keeps everything it remembers in `memory`, float64 (N, columns): a copy of the array
can be put back, and the estimator goes on from there. It declares what it provides and what it
needs; the stack takes names, order and features from these declarations.

From observations to measurements: absolute pose, new samples, samples that belong together.

An observation holds the pose as an error against the reference. The reader integrates the
reference from the observed speed and yaw rate (cubic between two observations), so that
    p = p_ref - R(yaw) e_p,    yaw = yaw_ref - e_yaw
are coordinates in a frame fixed at the start of the episode. What the integration loses is
common to p and p_ref, hence nothing that a controller acts on. A group has a new sample when its
age has not grown by one control period. Inertial and drive samples of different age are paired
by the time at which they were taken, so that regressions see one moment; each pair is given once.

Assumption: one call per control step and vehicle.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range
from tracked_env.sensors import CHANNEL_COUNT, CHANNELS, GROUP_START, GROUPS
from tracked_env.validation import CONTROL_PERIOD, VEHICLES, checked_number, checked_whole

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


class Status(IntEnum):
    """What the last update did."""

    CONVERGING = 0  # the sample was used, and the data determine every parameter
    HOLDING = 1  # no new information in some direction: there the estimate is kept
    REJECTED = 2  # the sample was refused (missing, NaN, or an outlier)


class Estimate(NamedTuple):
    """Estimates of N vehicles; P parameters or states."""

    names: tuple[str, ...]  # (P,)
    value: NDArray[np.float64]  # (N, P) SI
    covariance: NDArray[np.float64]  # (N, P, P)
    excitation: NDArray[np.float64]  # (N,) [-]
    condition: NDArray[np.float64]  # (N,) [-] >= 1, inf when some direction has no information
    status: NDArray[np.int64]  # (N,) of Status
    nis: NDArray[np.float64]  # (N,) normalised innovation squared of this sample, NaN if none
    skipped: NDArray[np.int64]  # (N,) samples with NaN so far

    def of(self, name: str) -> NDArray[np.float64]:
        """Value of one parameter, (N,)."""
        return self.value[:, self.names.index(name)]

    def deviation(self, name: str) -> NDArray[np.float64]:
        """Standard deviation of one parameter, (N,)."""
        column = self.names.index(name)
        return np.sqrt(self.covariance[:, column, column])


Pair = tuple[NDArray[np.float64], NDArray[np.float64]]  # (N,) each


class Quantity(NamedTuple):
    """One quantity that an estimator provides, and how it is shown to an agent."""

    name: str
    unit: str
    # SI value shown as 1: a parameter by name, or a function (of a module, so that it can be
    # pickled) of the nominal parameters; empty: 1.
    nominal: str | Callable[[PlantParameters], float] = ""
    logarithmic: bool = False  # shown as ln(value / nominal), its deviation over the value
    inverse_of: str = ""  # the parameter of the Estimate is its inverse, of that name

    def read(self, estimate: Estimate) -> Pair:
        """(value, standard deviation), SI; of an inverse to first order."""
        if not self.inverse_of:
            return estimate.of(self.name), estimate.deviation(self.name)
        value = 1.0 / estimate.of(self.inverse_of)
        return value, estimate.deviation(self.inverse_of) * value**2

    def scale(self, nominal: PlantParameters) -> float:
        """SI value that is shown as 1."""
        if callable(self.nominal):
            return self.nominal(nominal)
        return float(getattr(nominal, self.nominal)) if self.nominal else 1.0

    def normalized(self, estimate: Estimate, nominal: PlantParameters) -> Pair:
        """(value, standard deviation) as numbers of order one."""
        value, deviation = self.read(estimate)
        scale = self.scale(nominal)
        if self.logarithmic:
            return np.log(value / scale), np.log1p(deviation / value)
        return value / scale, deviation / scale


@dataclass(frozen=True)
class Setting:
    """What an estimator of the stack is made from."""

    parameters: PlantParameters  # nominal
    control_period: float  # [s]
    data_sheet: DataSheet  # noise of the sensors
    count: int  # vehicles
    lateral: str = "sliding"  # lateral model of the nominal model
    attitude: bool = False  # whether roll, pitch and pitch rate are measured; else level ground


class Estimator(Protocol):
    """The interface of every estimator.

    needs: sensor channels, and quantities that estimators before it in the stack provide.
    paired: it takes inertial and drive samples of one moment, with the filtered velocity; else
    each group's latest sample.
    """

    memory: NDArray[np.float64]  # (N, columns)

    @property
    def provides(self) -> tuple[Quantity, ...]:
        """What it estimates."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of what it reads."""

    @property
    def paired(self) -> bool:
        """Which samples it takes."""

    def take_over(
        self, parts: Mapping[str, "Estimator"], estimates: Mapping[str, Estimate]
    ) -> None:
        """Before `update`: take what is needed of the estimators that have run, by name."""

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""


class AnsweringEstimator:
    """An estimator that answers with bare arrays; the Estimate is made of them where it is read.

    Faster than `update` where few read the Estimate. `update` is `estimate(compute(...))`.
    """

    def compute(self, measurement: Measurement) -> Any:
        """Take one sample of every vehicle; an answer that the next call leaves as it is."""
        raise NotImplementedError

    def estimate(self, answer: Any) -> Estimate:
        """The Estimate that `answer` says; depends on nothing else that changes."""
        raise NotImplementedError


LONGEST_AGE = 1.0  # [s] older samples are not paired
POSE_DELAY = Range(0.0, LONGEST_AGE, "s", "Did you pass milliseconds?")
DELAY_RISE = 0.2  # [-] slope at which the delay of a group follows ages that stay up

# Columns of `memory`: reference pose and motion, ages, steps, when the last pair was taken (plus
# one, 0 = none yet); then two rings of samples.
(
    REF_X, REF_Y, REF_YAW, SPEED, ACCELERATION, YAW_RATE, YAW_ACCELERATION,
    AGE, _AGE_INERTIAL, _AGE_DRIVE, STEP, DELAY, LAST_PAIR,
) = range(13)  # fmt: skip
RINGS = 13
GROUP_SIZE = 4  # channels of the inertial and of the drive group
SLOT = 1 + GROUP_SIZE  # step at which it was taken (plus one, 0 = empty), values

_I, _SCALE = layout.INDEX, layout.SCALE
_ERRORS = ("position_error_x", "position_error_y", "heading_error")
_PATH = ("reference_speed", "reference_acceleration", "reference_yaw_rate",
         "reference_yaw_acceleration")  # fmt: skip
_CHANNELS = CHANNELS[COLUMN["v_x"] :]  # taken as they are
NEEDS = (*_ERRORS, *_CHANNELS, *_PATH, *(f"{group}_age" for group in GROUPS))
_ERROR_X, _ERROR_Y, _ERROR_YAW = (_I[name] for name in _ERRORS)
_SPEED, _ACCELERATION, _REF_YAW_RATE, _BEND = (_I[name] for name in _PATH)
_AGES = _I["pose_age"]
_OLDEST = float(layout.FIELDS[_AGES].bound)  # [s] at which ages are clipped
_COPIED = np.array([(_I[name], COLUMN[name]) for name in _CHANNELS])  # observation column, channel
FIRST = np.array([0, COLUMN["acceleration_x"], COLUMN["sprocket_speed_left"]])  # of each group
assert [_I["inertial_age"], _I["drive_age"]] == [_AGES + 1, _AGES + 2]


class Reading(NamedTuple):
    """What an observation says."""

    latest: Measurement  # each group's last sample
    paired: Measurement  # inertial and drive of one moment; not fresh where there is no pair
    reference: NDArray[np.float64]  # (N, 3) pose of the reference now [m, m, rad]
    drive_delay: NDArray[np.float64]  # (N,) [s] the delay of the drive group; dropouts apart


@formula
def advance_reference(memory, i, speed, acceleration, yaw_rate, yaw_acceleration, period):
    """Move the reference pose of vehicle i by one period [s] to the motion now observed.

    Cubic Hermite interpolation of speed and yaw rate, Simpson's rule for the position.
    """
    v, a, w, bend = (
        memory[i, SPEED], memory[i, ACCELERATION],
        memory[i, YAW_RATE], memory[i, YAW_ACCELERATION],
    )  # fmt: skip
    half = period * ((13.0 * w + 3.0 * yaw_rate) / 32.0) + period * period * (
        (11.0 * bend - 5.0 * yaw_acceleration) / 192.0
    )
    whole = 0.5 * period * (w + yaw_rate) + period * period * (bend - yaw_acceleration) / 12.0
    v_middle = 0.5 * (v + speed) + period * (a - acceleration) / 8.0
    yaw = memory[i, REF_YAW]
    c_0, s_0 = rotation(yaw)
    c_1, s_1 = rotation(yaw + half)
    c_2, s_2 = rotation(yaw + whole)
    memory[i, REF_X] += period / 6.0 * (v * c_0 + 4.0 * v_middle * c_1 + speed * c_2)
    memory[i, REF_Y] += period / 6.0 * (v * s_0 + 4.0 * v_middle * s_1 + speed * s_2)
    memory[i, REF_YAW] = yaw + whole


@formula
def _pair(memory, i, taken_inertial, taken_drive, slots, paired):
    """Fill the inertial and drive channels of `paired` with samples of one moment, the last for
    which both can have come; True when both are there and were not given before."""
    drive_ring = RINGS + slots * SLOT
    when = min(taken_inertial, taken_drive)
    a = RINGS + (when % slots) * SLOT
    b = drive_ring + (when % slots) * SLOT
    together = memory[i, a] == when + 1.0 and memory[i, b] == when + 1.0
    for c in range(GROUP_SIZE):
        paired[i, FIRST[INERTIAL] + c] = memory[i, a + 1 + c]
        paired[i, FIRST[DRIVE] + c] = memory[i, b + 1 + c]
    if not together or memory[i, LAST_PAIR] > when:
        return False
    memory[i, LAST_PAIR] = when + 1.0
    return True


@loop
def read_all(
    observation, memory, start, period, slots, latest, paired, fresh, pair, age, pair_age, ref,
    delay,
):  # fmt: skip
    """Read every row: observation (N, >= SIZE), start (N,) bool; the others are written."""
    for i in range(observation.shape[0]):
        if start[i]:
            memory[i, :] = 0.0
        speed = observation[i, _SPEED] * _SCALE[_SPEED]
        acceleration = observation[i, _ACCELERATION] * _SCALE[_ACCELERATION]
        yaw_rate = observation[i, _REF_YAW_RATE] * _SCALE[_REF_YAW_RATE]
        bend = observation[i, _BEND] * _SCALE[_BEND]
        step = int(memory[i, STEP])
        if step > 0:
            advance_reference(memory, i, speed, acceleration, yaw_rate, bend, period)
        memory[i, SPEED], memory[i, ACCELERATION] = speed, acceleration
        memory[i, YAW_RATE], memory[i, YAW_ACCELERATION] = yaw_rate, bend
        for g in range(3):
            age[i, g] = observation[i, _AGES + g] * _SCALE[_AGES + g]
            newest = min(memory[i, AGE + g] + period, _OLDEST) - 0.5 * period
            fresh[i, g] = step == 0 or age[i, g] < newest
            memory[i, AGE + g] = age[i, g]
        risen = memory[i, DELAY] + DELAY_RISE * period
        memory[i, DELAY] = delay[i] = min(age[i, DRIVE], risen)
        for k in range(_COPIED.shape[0]):
            latest[i, _COPIED[k, 1]] = observation[i, _COPIED[k, 0]] * _SCALE[_COPIED[k, 0]]
        yaw = memory[i, REF_YAW] - observation[i, _ERROR_YAW] * _SCALE[_ERROR_YAW]
        c, s = rotation(yaw)
        e_x = observation[i, _ERROR_X] * _SCALE[_ERROR_X]
        e_y = observation[i, _ERROR_Y] * _SCALE[_ERROR_Y]
        latest[i, 0] = memory[i, REF_X] - (c * e_x - s * e_y)
        latest[i, 1] = memory[i, REF_Y] - (s * e_x + c * e_y)
        latest[i, 2] = yaw
        for g in range(3):
            ref[i, g] = memory[i, REF_X + g]
        for g in (INERTIAL, DRIVE):
            taken = max(step - int(age[i, g] / period + 0.5), 0)
            if fresh[i, g]:
                at = RINGS + ((g - 1) * slots + taken % slots) * SLOT
                memory[i, at] = taken + 1.0
                for k in range(GROUP_SIZE):
                    memory[i, at + 1 + k] = latest[i, FIRST[g] + k]
        for k in range(CHANNEL_COUNT):
            paired[i, k] = latest[i, k]
        taken_inertial = max(step - int(age[i, INERTIAL] / period + 0.5), 0)
        taken_drive = max(step - int(age[i, DRIVE] / period + 0.5), 0)
        together = _pair(memory, i, taken_inertial, taken_drive, slots, paired)
        oldest = max(age[i, INERTIAL], age[i, DRIVE])
        for g in range(3):
            pair[i, g] = fresh[i, POSE] if g == POSE else together
            pair_age[i, g] = age[i, POSE] if g == POSE else oldest
        memory[i, STEP] = step + 1.0


class ObservationReader:
    """Reads the observations of N vehicles, one call per control step.

    control_period [s]; count: vehicles; pose_delay [s], see late_pose. Its whole state is `memory`.
    Raises ValueError for a number that makes no sense.
    """

    def __init__(self, control_period: float, count: int = 1, pose_delay: float = 0.0) -> None:
        count = checked_whole("count", count, VEHICLES)
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        self.slots = round(LONGEST_AGE / control_period) + 2
        delay = checked_number("pose_delay", pose_delay, POSE_DELAY)
        self.lag = round(delay / self.control_period)  # [steps]
        self.memory = np.zeros((count, RINGS + 2 * self.slots * SLOT))
        self._none = np.zeros(count, dtype=bool)

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0

    def read(
        self, observation: NDArray[np.float32], start: NDArray[np.bool_] | None = None
    ) -> Reading:
        """Read (N, SIZE) observations; rows with `start` begin a new episode.

        Raises ValueError for a wrong shape.
        """
        count = len(self.memory)
        if observation.shape != (count, layout.SIZE):
            raise ValueError(
                f"observation has shape {observation.shape}; must be ({count}, {layout.SIZE}). "
                "Did a wrapper stack or append to it?"
            )
        return self.take(observation, self._none if start is None else start)

    def take(
        self,
        observation: NDArray[np.float32],
        start: NDArray[np.bool_],
    ) -> Reading:
        """`read` without its check, of observations (N, >= SIZE)."""
        count = len(self.memory)
        latest, paired = np.empty((count, CHANNEL_COUNT)), np.empty((count, CHANNEL_COUNT))
        fresh, pair = np.empty((count, 3), dtype=bool), np.empty((count, 3), dtype=bool)
        age, pair_age = np.empty((count, 3)), np.empty((count, 3))
        reference, delay = np.empty((count, 3)), np.empty(count)
        read_all(
            observation, self.memory, start, self.control_period, self.slots,
            latest, paired, fresh, pair, age, pair_age, reference, delay,
        )  # fmt: skip
        return Reading(
            Measurement(latest, fresh, age),
            Measurement(paired, pair, pair_age),
            reference,
            delay,
        )
