"""What every estimator answers: values with covariance, excitation and status.

    excitation  smallest eigenvalue of the information that the (forgetting) window holds, in
                units of the prior information: 0 = the data say nothing about some direction of
                the parameters, 1 = data and prior weigh the same
    condition   ratio of the largest to the smallest eigenvalue of the same matrix
An estimator keeps everything it remembers in `memory`, float64 (N, columns): whoever copies
the array can put it back and go on from there.
"""

from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.sensor_samples import Measurement


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


class Estimator(Protocol):
    """The interface of every estimator."""

    names: tuple[str, ...]
    memory: NDArray[np.float64]  # (N, columns)

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
