"""What the two regressions on the vehicle's motion share: memory, bounds, answers.

A regression turns a measurement into one equation per vehicle; least_squares takes it from
there. A sample that cannot be used (stale, standstill) holds, one with NaN is counted.
The parameters change by interacting models; with the table PLAIN there are none, as in the
regressions that are printed in S (`reproduce`).
"""

from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import (
    ATTITUDE,
    BatchEstimator,
    DataSheet,
    Estimate,
    Measurement,
    attitude_of,
    columns_of,
    empty_rows,
)
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import CONTROL_PERIOD, VEHICLES, checked_number, checked_whole

FORGETTING = 0.9995  # [-] per sample: at 50 Hz 40 s
CONVERGING, HOLDING, REJECTED = 0, 1, 2  # of measurement.Status, as plain numbers for kernels
TORQUE_MARGIN = 1.5  # [-] of the drives' limit: a larger torque is not one, and would weigh much
SLOWEST = 0.2  # [m/s] slower tracks may be held by the soil, and say nothing about it
# The answer of a kernel for one vehicle.
ANSWER = np.dtype([(name, float) for name in (
    "value_1", "value_2", "p_11", "p_12", "p_22", "excitation", "condition", "status", "nis",
    "skipped",
)])  # fmt: skip
PLAIN = np.empty((0, 4))  # no table of models


@formula
def take(row, sample, prior, table):
    """One sample of one vehicle, by interacting models where there is a table (R, 4) of them."""
    if table.shape[0] > 0:
        return im.step(row, sample, prior, table)
    return ls.step(row, sample, prior)


@formula
def write_answer(row, prior, status, nis, out):
    """Write the estimate of one vehicle into `out`, an ANSWER."""
    e = row.estimates[0]
    out.value_1, out.value_2 = ls.values(e, prior)
    out.p_11, out.p_12, out.p_22 = ls.covariance(e, prior)
    smallest, largest = ls.eigenvalues(e)
    out.excitation = smallest
    out.condition = largest / smallest if smallest > 0.0 else np.inf
    out.status = status
    out.nis = nis
    out.skipped = row.skipped


@loop
def write_answers(rows, prior, out):
    """The present answer of every vehicle, without a sample."""
    for i in range(rows.shape[0]):
        write_answer(rows[i], prior, HOLDING, np.nan, out[i])


def checked_forgetting(name: str, value: float) -> float:
    """A forgetting factor. Raises ValueError outside (0.5, 1]."""
    if not 0.5 < value <= 1.0:
        raise ValueError(
            f"{name} = {value}; must be in (0.5, 1]. It is the share of old information that is "
            "kept per sample: 0.998 remembers about 500 samples. Did you pass 1 - lambda?"
        )
    return float(value)


class TwoParameterEstimator(BatchEstimator):
    """Forgetting least squares for two parameters of N vehicles.

    parameters: nominal ones, the prior mean. control_period [s]. data_sheet: noise of the
    sensors. count: vehicles. prior: of the parameters. Subclasses name
    the parameters and give kernel and table of the interacting models (PLAIN without them).
    Raises ValueError for a period, count or forgetting factor that makes no sense.
    """

    paired = True
    row = im.ROW
    prior: ls.Prior
    table: NDArray[np.float64]
    _kernel: Callable[..., None]

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet | None,
        count: int,
        prior: ls.Prior,
    ) -> None:
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        self.parameters = PlantParameters(*(float(value) for value in parameters))
        self.data_sheet = DataSheet() if data_sheet is None else data_sheet
        self.prior = ls.Prior._make(float(x) for x in prior)
        self.memory = np.zeros((count, columns_of(im.ROW)))
        self.answer = np.empty(0, ANSWER)  # of the last sample

    def expect_constants(self) -> None:
        """From now on nothing is forgotten, and no parameter is expected to change."""
        self.table, self.prior = PLAIN, self.prior._replace(forgetting=1.0)

    def on_slopes(self) -> Self:
        """The same, which reads the attitude as well; returns itself."""
        self.needs = (*type(self).needs, *ATTITUDE)
        return self

    def constants(self) -> tuple[Any, ...]:
        """What the kernel needs besides the measurement."""
        return ()

    def compute(self, measurement: Measurement) -> NDArray[Any]:
        """Take one sample; returns the bare answers (N,), which `answer` holds too."""
        self.answer = out = empty_rows(len(self.memory), ANSWER)
        samples = measurement.values, measurement.fresh, attitude_of(measurement)
        type(self)._kernel(samples, self.rows, self.prior, self.table, *self.constants(), out)
        return out

    def read(self) -> Estimate:
        """The present estimate, without a sample."""
        return self.estimate(self.present_answers())

    def present_answers(self) -> NDArray[Any]:
        """The bare answers (N,) without a sample."""
        out = empty_rows(len(self.memory), ANSWER)
        write_answers(self.rows, self.prior, out)
        return out

    def estimate(self, answer: NDArray[Any]) -> Estimate:
        """The answers of the kernel as an Estimate."""
        a = answer
        covariance = np.stack([a["p_11"], a["p_12"], a["p_12"], a["p_22"]], axis=-1)
        return Estimate(
            self.names,
            np.stack([a["value_1"], a["value_2"]], axis=-1),
            covariance.reshape(-1, 2, 2),
            a["excitation"],
            a["condition"],
            a["status"].astype(np.int64),
            a["nis"],
            a["skipped"].astype(np.int64),
        )
