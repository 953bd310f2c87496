"""What passes between sensors and estimators: measurements, estimates, and the base of estimators.

A Measurement holds one sample of every sensor channel, per vehicle:
    values (N, 13)  SI, in the order of tracked_env.sensors.CHANNELS; pose in any fixed frame; NaN
                    where a sample is missing
    fresh  (N, 3)   whether pose, inertial, drive have a new sample since the last update
    age    (N, 3)   [s] how old each group's sample is
On slopes also ATTITUDE, of the last inertial sample; where it is not measured the ground counts as
level. A DataSheet holds what everybody may know of their sensors: noise and bias magnitudes.

An Estimate holds values with covariance, excitation and status:
    excitation  smallest eigenvalue of the information that the (forgetting) window holds, in
                units of the prior information: 0 = the data say nothing about some direction of
                the parameters, 1 = data and prior weigh the same
    condition   ratio of the largest to the smallest eigenvalue of the same matrix
An estimator holds its whole state in `memory`, float64 (N, columns), and where it has one in a
ring of past samples, `ring` (N, columns): the estimator goes on from copies that are put back.
Kernels read them as rows with named fields (`rows_of`).
"""

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics.jit import COMPILED, BoundOnce
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.sensors import CHANNEL_COUNT, CHANNELS, GROUPS
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

Floats = NDArray[np.float64]
COLUMN = {name: column for column, name in enumerate(CHANNELS)}
ATTITUDE = ("roll", "pitch", "pitch_rate")  # fields of the observation group of that name
POSE, INERTIAL, DRIVE = range(len(GROUPS))  # columns of `fresh` and `age`
LONGEST_AGE = 1.0  # [s] older samples are not paired
TORQUE_MARGIN = 1.5  # [-] of the drives' limit: a larger torque is not one, and would weigh much
SLOWEST = 0.2  # [m/s] slower tracks may be held by the soil, and say nothing about it
POSE_DELAY = Range(0.0, LONGEST_AGE, "s", "Did you pass milliseconds?")
_CHECKED = (  # nominal parameters that the kernels divide by, or take logarithms of
    "mass", "track_width", "track_gauge", "contact_length", "sprocket_radius", "cohesion",
    "friction_angle", "shear_deformation_modulus",
)  # fmt: skip


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


class _Samples(NamedTuple):
    """One sample of all channels of N vehicles; see the head of the file."""

    values: Floats  # (N, CHANNEL_COUNT)
    fresh: NDArray[np.bool_]  # (N, 3)
    age: Floats  # (N, 3) [s]


class Measurement(_Samples):
    """One sample of all channels of N vehicles; see the head of the file.

    added: fields of registered observation groups by name, (N,) SI each; the last sample, also
    where the others are of one moment.
    """

    added: Mapping[str, Floats] = MappingProxyType({})
    _attitude: Floats | None = None  # once it was asked for

    def copy(self) -> "Measurement":
        """The same samples in arrays of their own, without the fields added."""
        return Measurement(self.values.copy(), self.fresh.copy(), self.age.copy())

    def with_fields(self, added: Mapping[str, Floats]) -> "Measurement":
        """The same samples with the fields `added`."""
        wider = Measurement(*self)
        wider.added = added
        return wider

    def channel(self, name: str) -> Floats:
        """One channel or one registered field, (N,)."""
        return self.added[name] if name in self.added else self.values[:, COLUMN[name]]

    @property
    def attitude(self) -> Floats:
        """ATTITUDE (N, 3); zeros where it is not measured."""
        if self._attitude is None:
            self._attitude = np.zeros((len(self.values), len(ATTITUDE)))
            if ATTITUDE[0] in self.added:
                self._attitude = np.stack([self.added[name] for name in ATTITUDE], axis=1)
        return self._attitude


def make_measurement(
    fresh: ArrayLike = True, age: ArrayLike = 0.0, **channels: ArrayLike
) -> Measurement:
    """A Measurement from channels by name, each a number or (N,); what is not named is NaN.

    fresh, age: a number for all, or shape (3,) or (N, 3). Raises ValueError for an unknown
    channel.
    """
    if unknown := set(channels) - set(CHANNELS):
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


class Status(IntEnum):
    """What the last update did."""

    CONVERGING = 0  # the sample was used, and the data determine every parameter
    HOLDING = 1  # no new information in some direction: there the estimate stays
    REJECTED = 2  # the sample was refused (missing, NaN, or an outlier)


# The same as plain numbers, for kernels.
CONVERGING, HOLDING, REJECTED = (int(status) for status in Status)


class Estimate(NamedTuple):
    """Estimates of N vehicles; P parameters or states."""

    names: tuple[str, ...]  # (P,)
    value: Floats  # (N, P) SI
    covariance: Floats  # (N, P, P)
    excitation: Floats  # (N,) [-]
    condition: Floats  # (N,) [-] >= 1, inf when some direction has no information
    status: NDArray[np.int64]  # (N,) of Status
    nis: Floats  # (N,) normalised innovation squared of this sample, NaN if none
    skipped: NDArray[np.int64]  # (N,) samples with NaN so far

    def of(self, name: str) -> Floats:
        """Value of one parameter, (N,)."""
        return self.value[:, self.names.index(name)]

    def deviation(self, name: str) -> Floats:
        """Standard deviation of one parameter, (N,)."""
        column = self.names.index(name)
        return np.sqrt(self.covariance[:, column, column])


Pair = tuple[Floats, Floats]  # (N,) each


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


class Setting(NamedTuple):
    """What an estimator of the stack is made from."""

    parameters: PlantParameters  # nominal
    control_period: float  # [s]
    data_sheet: DataSheet  # noise of the sensors
    count: int  # type: ignore[assignment]  # vehicles
    lateral: str = "sliding"  # lateral model of the nominal model
    attitude: bool = False  # whether roll, pitch and pitch rate are measured; else level ground


def columns_of(row: np.dtype[Any]) -> int:
    """Columns of memory that a row with named fields takes."""
    return row.itemsize // 8


def rows_of(memory: Floats, row: np.dtype[Any]) -> Any:
    """memory (N, columns) as rows (N,), or a ring (N, K * columns) as (N, K) slots, that have
    named fields; the same numbers. Without compilation, records give the fields as attributes."""
    count, columns = memory.shape
    slots = columns // columns_of(row)
    # of the same buffer: `view` takes ten times as long
    rows = np.ndarray(count if slots == 1 else (count, slots), row, memory)
    return rows if COMPILED else rows.view(np.recarray)


class Rows:
    """Attribute: an array of its object by `rows_of`, made anew where the array is another one.

    array: name of the array; row: of it, by default `row` of the object; shape: of the slots of a
    vehicle, where it is not (K,).
    """

    def __init__(
        self, array: str, row: np.dtype[Any] | None = None, shape: tuple[int, ...] = ()
    ) -> None:
        self._array, self._row, self._shape = array, row, shape

    def __set_name__(self, owner: type, name: str) -> None:
        self._place = f"_{name}"

    def __get__(self, part: Any, owner: type | None = None) -> Any:
        if part is None:  # asked of the class, for the documentation
            return self
        state = part.__dict__
        memory, rows = state[self._array], state.get(self._place)
        if rows is None or rows.base is not memory:  # a copy of an object has copies of both
            rows = rows_of(memory, part.row if self._row is None else self._row)
            rows = rows.reshape(len(memory), *self._shape) if self._shape else rows
            state[self._place] = rows
        return rows


def empty_rows(count: int, row: np.dtype[Any]) -> Any:
    """Room for `count` rows."""
    rows = np.empty(count, row)
    return rows if COMPILED else rows.view(np.recarray)


def answer_row(size: int) -> np.dtype[Any]:
    """The answer of a kernel for one vehicle: an Estimate of `size` parameters."""
    return np.dtype([
        ("value", float, size), ("covariance", float, (size, size)), ("excitation", float),
        ("condition", float), ("status", np.int64), ("nis", float), ("skipped", float),
    ])  # fmt: skip


class Stateful:
    """What holds its whole state in `memory` (N, columns) and, if it has one, a `ring` of those."""

    memory: Floats

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        where = slice(None) if rows is None else np.asarray(rows)
        for array in arrays_of(self):
            array[where] = 0.0


class BatchEstimator(Stateful):
    """An estimator of N vehicles that answers with bare rows (N,) of `answer_row`.

    names: of the parameters of the Estimate; provides: what it estimates; needs: sensor channels,
    and quantities that estimators before it in the stack provide; paired: it takes inertial and
    drive samples of one moment, with the filtered velocity, else each group's latest sample.
    Every estimator has `provides`, `needs`, `paired`, `memory` and the methods `take_over`,
    `update` and `reset`; it may have a `ring` (N, columns) beside its memory.
    Arguments are those of a Setting: nominal parameters; control period [s]; noise of the sensors,
    `rtk` by default; number of vehicles; lateral model; whether the attitude is measured.
    `compute` is faster than `update` where few read the Estimate; `update` is
    `estimate(compute(...))`. Raises ValueError for a number outside its range.
    """

    names: tuple[str, ...]
    provides: tuple[Quantity, ...]
    needs: tuple[str, ...]
    row: ClassVar[np.dtype[Any]]  # of the memory
    reads_attitude: ClassVar[bool] = False
    paired: ClassVar[bool] = True
    kernel: ClassVar[Any] = None  # compiled: takes `inputs`, and writes the answers behind them
    initial: Mapping[str, Any] = MappingProxyType({})  # fields of a row that do not begin at 0
    answer: NDArray[Any]  # of the last sample
    rows = Rows("memory")

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        attitude: bool = False,
    ) -> None:
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        for name, number in self.data_sheet._asdict().items():
            checked_number(name, number, POSE_DELAY if name == "pose_delay" else SIGMA)
        for name in _CHECKED:
            checked_number(f"nominal {name}", getattr(parameters, name), RANGES[name])
        if lateral not in ("sliding", "constrained"):
            raise ValueError(f"lateral = {lateral!r}; must be 'sliding' or 'constrained'")
        self.parameters = PlantParameters(*(float(value) for value in parameters))
        self.lateral = lateral
        if attitude and self.reads_attitude:
            self.needs = (*self.needs, *ATTITUDE)
        self.memory = np.zeros((count, columns_of(self.row)))
        self._answer = answer_row(len(self.names))
        if type(self).kernel is not None:  # else `compute` is another one
            self._compute = BoundOnce(type(self).kernel)

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """What the kernel takes: the samples, state and constants."""
        raise NotImplementedError

    def compute(self, measurement: Measurement) -> NDArray[Any]:
        """Take one sample; the bare answers (N,), which the next call leaves as they are."""
        self.answer = answers = empty_rows(len(self.memory), self._answer)
        self._compute(*self.inputs(measurement), answers)
        return answers

    def estimate(self, answer: Any) -> Estimate:
        """The Estimate that `answer` says; depends on nothing else that changes."""
        a, skipped = answer, answer["skipped"].astype(np.int64)
        return Estimate(
            self.names, a["value"], a["covariance"], a["excitation"], a["condition"], a["status"],
            a["nis"], skipped,
        )  # fmt: skip

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle.

        Raises ValueError for a measurement that is not one of as many vehicles.
        """
        n = len(self.memory)
        shapes = ((n, CHANNEL_COUNT), (n, len(GROUPS)), (n, len(GROUPS)))
        for name, array, shape in zip(Measurement._fields, measurement, shapes, strict=True):
            if array.shape != shape:
                raise ValueError(
                    f"measurement.{name} has shape {array.shape}; must be {shape}. "
                    f"Is the estimator made for count = {n} vehicles?"
                )
        kinds = zip(measurement, (float, bool, float), strict=True)
        samples = Measurement(*(np.ascontiguousarray(array, kind) for array, kind in kinds))
        return self.estimate(self.compute(samples.with_fields(measurement.added)))

    def take_over(self, parts: Mapping[str, Any], estimates: Mapping[str, Estimate]) -> None:
        """Before `update`: take what is needed of the estimators that have run, by name."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        super().reset(rows)
        where = slice(None) if rows is None else np.asarray(rows)
        for name, value in self.initial.items():
            self.rows[name][where] = value


def arrays_of(part: Any) -> list[Floats]:
    """The arrays that hold the whole state of an estimator: its memory and, if any, its ring."""
    return [part.memory, part.ring] if hasattr(part, "ring") else [part.memory]
