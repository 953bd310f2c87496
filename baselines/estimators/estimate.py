"""What every estimator answers: values with covariance, excitation and status.

    excitation  smallest eigenvalue of the information that the (forgetting) window holds, in
                units of the prior information: 0 = the data say nothing about some direction of
                the parameters, 1 = data and prior weigh the same
    condition   ratio of the largest to the smallest eigenvalue of the same matrix
An estimator keeps everything it remembers in `memory`, float64 (N, columns): a copy of the array
can be put back, and the estimator goes on from there. It declares what it provides and what it
needs; the stack takes names, order and features from these declarations.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.sensor_samples import DataSheet, Measurement
from tracked_env.physics.parameters import PlantParameters


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
    regression: str = "coupled"
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
