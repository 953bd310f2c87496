"""Abrupt changes of the true parameters inside an episode, and how a policy gets over the first.

A parameter of CHANGING changes in step k when its value in force differs from that of step k - 1
by more than RESOLUTION of it. Steps less than JOIN_TIME apart make one run, per parameter; a run is
    abrupt    when it lasts less than ABRUPT_TIME and moves the parameter by at least
              ABRUPT_CHANGE of its value before it (a payload step, the crossing of a border),
              and, unless it is a single step, lies JOIN_TIME away from both ends of the episode
    slow      otherwise (drift, a resistance map): it is no change in the sense of this file
Abrupt runs of all parameters that overlap are one change. With t_s and t_e start and end of the
first change, t_n the start of the next (or the end of the episode) and e(t) the distance to the
reference, counted as in `metrics`:
    recovery time        smallest tau >= 0 with e(t) < RECOVERED l for all t_e + tau < t <= t_n;
                         t_n - t_e when there is none
    peak after change    max of e(t) over t_s < t <= t_n
    RMSE after change    sqrt(mean e(t)^2) over t_s < t <= t_n
All are NaN without an abrupt change in the time driven.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CHANGING = (
    "mass",
    "inertia",
    "longitudinal_resistance",
    "lateral_resistance",
    "friction_angle",
    "actuator_gain_left",
    "actuator_gain_right",
)
RESOLUTION = 1e-9  # [-] smaller relative changes are rounding
ABRUPT_TIME = 2.0  # [s] a change that takes longer is a drift, which a policy can follow
ABRUPT_CHANGE = 0.02  # [-] less is not felt: a graze of a border
JOIN_TIME = 0.5  # [s] a vehicle that stops on a border and goes on crosses it once
RECOVERED = 0.05  # [-] of the contact length l: 0.1 m for 2 m, a fifth of a failure


class Change(NamedTuple):
    """One abrupt change; the parameters are new from step `first`, and constant from `last`."""

    first: int  # [control steps] it starts at time `first` times the control period
    last: int  # [control steps] and ends at time `last` times the control period


def _runs(values: FloatArray, join: int) -> list[Change]:
    """Runs of changing steps of one parameter, (T,), that lie less than `join` steps apart."""
    step = np.abs(np.diff(values))
    moved = np.flatnonzero(step > RESOLUTION * np.abs(values[:-1])) + 1
    if moved.size == 0:
        return []
    breaks = np.flatnonzero(np.diff(moved) >= join)
    firsts = moved[np.concatenate([[0], breaks + 1])]
    lasts = moved[np.concatenate([breaks, [moved.size - 1]])]
    return [Change(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]


def abrupt_changes(parameters: FloatArray, period: float) -> list[Change]:
    """The abrupt changes of one episode, in their order.

    parameters: (T, P) values in force during each control step driven; period [s] of a step.
    """
    join = max(round(JOIN_TIME / period), 2)
    found = []
    for values in parameters.T:
        if values[0] == values[-1] and (values == values[0]).all():
            continue
        for run in _runs(values, join):
            before, after = values[run.first - 1], values[run.last]
            large = abs(after - before) >= ABRUPT_CHANGE * abs(before)
            whole = run.first == run.last or join < run.first <= run.last < len(values) - join
            if large and whole and (run.last - run.first) * period < ABRUPT_TIME:
                found.append(run)
    merged: list[Change] = []
    for run in sorted(found):
        if merged and run.first <= merged[-1].last:
            merged[-1] = Change(merged[-1].first, max(merged[-1].last, run.last))
        else:
            merged.append(run)
    return merged


def last_outside(outside: NDArray[np.bool_]) -> int:
    """Number of leading entries up to the last that is True; 0 when none is."""
    found = np.flatnonzero(outside)
    return int(found[-1]) + 1 if found.size else 0


def recovery(
    error: FloatArray, changes: list[Change], period: float, recovered: float
) -> tuple[float, float, float]:
    """Recovery time [s], peak and RMSE [m] after the first change; NaN when there is none.

    error: (T,) counted distance to the reference [m] after each control step of the whole
    episode, also past an early end; period [s] of a step; recovered [m]: what counts as such.
    """
    if not changes:
        return np.nan, np.nan, np.nan
    first, last = changes[0]
    until = changes[1].first if len(changes) > 1 else len(error)
    # Entry k of the error is taken at time (k + 1) periods.
    after = error[last:until]
    since = error[first:until]
    time = period * last_outside(after >= recovered)
    return time, float(since.max()), float(np.sqrt(np.mean(since * since)))
