"""Columns of memories by the names of their rows, and states as a whole."""

import numpy as np

from baselines.estimators.interacting_models import ROW
from baselines.estimators.measurement import arrays_of


def column(name, row=ROW):
    """The first column of a field in a memory."""
    return row.fields[name][1] // 8


ODDS, ALARM, TREND, SKIPPED = (column(name) for name in ("odds", "alarm", "trend", "skipped"))
TURNED, BELTS, AGREEMENT = (column(name) for name in ("turned", "belts", "agreement"))
J_11, J_12, J_22 = 2, 3, 4


def state(estimator):
    """A copy of the whole state, (N, columns)."""
    return np.concatenate(arrays_of(estimator), axis=1)


def go_on(estimator, other):
    """Let `estimator` go on from the state of `other`."""
    for array, source in zip(arrays_of(estimator), arrays_of(other), strict=True):
        array[:] = source
