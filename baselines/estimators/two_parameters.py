"""What the two regressions on the vehicle's motion share: memory, bounds, answers.

A regression turns a measurement into one equation per vehicle; least_squares takes it from
there. A sample that cannot be used (stale, standstill) holds, one with NaN is counted.

    coupled  this project's: interacting models of how the parameters change
    paper    equations and forgetting factor of S, kept bounded: with the prior, the bounds, the
             gates and the compensation of torque noise of least_squares. Not what S prints
    printed  the same equations in the recursion that S 7.1.1 prints: no prior, bounds, gates or
             compensation, all samples of one weight, in whose units its covariance is. Only yaw
             rates below the regularisation of the friction stay out, where sign(w) is not +-1
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.estimate import AnsweringEstimator, Estimate, Estimator, Quantity
from baselines.estimators.sensor_samples import ATTITUDE, DataSheet, Measurement, attitude_of
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import VEHICLES, checked_whole

PAPER_FORGETTING = 0.998  # [-] S 8.3.1
REGRESSIONS = ("coupled", "paper", "printed")
WIDE = 1e3  # [-] times the prior's standard deviations, regression "printed": no prior to speak of
CONVERGING, HOLDING, REJECTED = 0, 1, 2  # of estimate.Status, as plain numbers for kernels
TORQUE_MARGIN = 1.5  # [-] of the drives' limit: a larger torque is not one, and would weigh much
SLOWEST = 0.2  # [m/s] slower tracks may be held by the soil, and say nothing about it
# Columns of the answer of a kernel, per vehicle.
(
    VALUE_1, VALUE_2, P_11, P_12, P_22, EXCITATION, CONDITION, STATUS, NIS, SKIPPED,
) = range(10)  # fmt: skip
ANSWER = 10
PLAIN = np.empty((0, 4))  # no table of models: regressions "paper" and "printed"


@formula
def take(memory, i, sample, prior, table):
    """One sample of vehicle i, by interacting models where there is a table (R, 4) of them."""
    if table.shape[0] > 0:
        return im.step(memory, i, sample, prior, table)
    return ls.step(memory, i, sample, prior)


@formula
def answer(memory, i, prior, status, nis, out):
    """Write what is known of vehicle i into out (N, ANSWER)."""
    out[i, VALUE_1], out[i, VALUE_2] = ls.values(memory, i, prior)
    out[i, P_11], out[i, P_12], out[i, P_22] = ls.covariance(memory, i, prior)
    smallest, largest = ls.eigenvalues(memory, i)
    out[i, EXCITATION] = smallest
    out[i, CONDITION] = largest / smallest if smallest > 0.0 else np.inf
    out[i, STATUS] = status
    out[i, NIS] = nis
    out[i, SKIPPED] = memory[i, ls.SKIPPED]


@loop
def read_all(memory, prior, out):
    """The present answer of every vehicle, without a sample."""
    for i in range(memory.shape[0]):
        answer(memory, i, prior, HOLDING, np.nan, out)


def checked_forgetting(name: str, value: float) -> float:
    """A forgetting factor. Raises ValueError outside (0.5, 1]."""
    if not 0.5 < value <= 1.0:
        raise ValueError(
            f"{name} = {value}; must be in (0.5, 1]. It is the share of old information that is "
            "kept per sample: 0.998 remembers about 500 samples. Did you pass 1 - lambda?"
        )
    return float(value)


def chosen_forgetting(regression: str, forgetting: float | None, own: float) -> float:
    """The forgetting factor: None takes `own`, or with regression "paper" or "printed" that of S.

    Raises ValueError for an unknown regression and a forgetting factor that makes no sense.
    """
    if regression not in REGRESSIONS:
        raise ValueError(f"regression = {regression!r}; must be one of {', '.join(REGRESSIONS)}")
    default = own if regression == "coupled" else PAPER_FORGETTING
    return checked_forgetting("forgetting", default if forgetting is None else forgetting)


def as_printed(prior: ls.Prior) -> ls.Prior:
    """The prior with which the kernel is the recursion of S 7.1.1: wide, and without bounds."""
    return prior._replace(
        sigma_1=WIDE * prior.sigma_1, sigma_2=WIDE * prior.sigma_2,
        low_1=-math.inf, low_2=-math.inf, high_1=math.inf, high_2=math.inf,
    )  # fmt: skip


class TwoParameterEstimator(AnsweringEstimator):
    """Forgetting least squares for two parameters of N vehicles.

    parameters: nominal ones, the prior mean. control_period [s]. data_sheet: noise of the
    sensors. count: vehicles. table: of the interacting models, PLAIN without them. Subclasses name
    the parameters and give prior, table and kernel.
    Raises ValueError for a period, count or forgetting factor that makes no sense.
    """

    names: tuple[str, ...]
    provides: tuple[Quantity, ...]
    needs: tuple[str, ...]
    paired = True
    columns = im.MEMORY  # of the memory
    _kernel: Callable[..., None]

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet | None,
        count: int,
        prior: ls.Prior,
        table: NDArray[np.float64],
    ) -> None:
        count = checked_whole("count", count, VEHICLES)
        self.parameters = PlantParameters(*(float(value) for value in parameters))
        self.control_period = control_period
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        self.prior = ls.Prior._make(float(x) for x in prior)
        self.table = table
        self.memory = np.zeros((count, self.columns))
        self.answer = np.empty((0, ANSWER))  # of the last sample

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Nothing is needed of other estimators."""

    def on_slopes(self) -> Self:
        """The same, which reads the attitude as well; returns itself."""
        self.needs = (*type(self).needs, *ATTITUDE)
        return self

    def known(self) -> tuple[Any, ...]:
        """What the kernel needs besides the measurement."""
        return ()

    def compute(self, measurement: Measurement) -> NDArray[np.float64]:
        """Take one sample; returns the bare answer (N, ANSWER), which is kept in `answer` too."""
        self.answer = out = np.empty((len(self.memory), ANSWER))
        type(self)._kernel(
            measurement.values, measurement.fresh, attitude_of(measurement), self.memory,
            self.prior, self.table, *self.known(), out,
        )  # fmt: skip
        return out

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle.

        Raises ValueError when the measurement is of another number of vehicles.
        """
        if len(measurement.values) != len(self.memory):
            raise ValueError(
                f"measurement of {len(measurement.values)} vehicles for an estimator of "
                f"{len(self.memory)}"
            )
        return self.estimate(self.compute(measurement))

    def read(self) -> Estimate:
        """What is known now, without a sample."""
        return self.estimate(self.answer_now())

    def answer_now(self) -> NDArray[np.float64]:
        """The bare answer (N, ANSWER) without a sample."""
        out = np.empty((len(self.memory), ANSWER))
        read_all(self.memory, self.prior, out)
        return out

    def estimate(self, answer: NDArray[np.float64]) -> Estimate:
        """The answer of the kernel as an Estimate."""
        out = answer
        covariance = out[:, [P_11, P_12, P_12, P_22]].reshape(-1, 2, 2)
        return Estimate(
            self.names,
            out[:, :2],
            covariance,
            out[:, EXCITATION],
            out[:, CONDITION],
            out[:, STATUS].astype(np.int64),
            out[:, NIS],
            out[:, SKIPPED].astype(np.int64),
        )
