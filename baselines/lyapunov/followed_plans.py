"""Plans that vehicles follow to their goals, and the error to them.

Samples of a plan are in the frame of the goal, even in time and linear between. The error to the
plan follows from the error to the goal: with that of the goal at (e_x, e_y, e_psi) in body axes
and the plan at (x, y) with course chi,
    (e_x, e_y) - R(e_psi)^T (x, y)        e_psi - chi
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.slip.slip_models import Array
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import loop

INTERVALS, PER_INTERVAL = 40, 5  # of a plan, and samples kept of each
LAST = INTERVALS * PER_INTERVAL  # sample


class Plans(NamedTuple):
    """The plans of N vehicles, in the frame of each one's goal; never changed in place."""

    samples: Array  # (N, LAST + 1, 7) x, y [m], course [rad], V, chi', V', chi''; even in time
    duration: Array  # (N,) [s] of the plan
    since: Array  # (N,) [s] since it began; NaN: no plan yet
    asked: Array  # (N,) [s] since a plan was asked for, followed or not
    followed: NDArray[np.int64]  # (N,) plans that were, in this episode
    not_found: NDArray[np.int64]  # (N,) plans that did not converge
    refused: NDArray[np.int64]  # (N,) plans that went round

    @classmethod
    def none(cls, count: int) -> "Plans":
        """No plans yet."""
        zeros, counted = np.zeros(count), np.zeros(count, dtype=np.int64)
        return cls(
            np.zeros((count, LAST + 1, 7)), zeros, zeros + math.nan, zeros + math.inf,
            counted, counted.copy(), counted.copy(),
        )  # fmt: skip

    def begun(self, start: NDArray[np.bool_]) -> "Plans":
        """Those of vehicles whose episode starts are forgotten."""
        if not start.any():
            return self
        copies = Plans._make(values.copy() for values in self)
        for values, new in zip(copies, Plans.none(int(start.sum())), strict=True):
            values[start] = new
        return copies

    def way_left(self, i: int) -> float:
        """Way [m] of vehicle i until its plan ends; infinite without a plan."""
        if math.isnan(self.since[i]):
            return math.inf
        spacing = self.duration[i] / LAST
        first = min(int(self.since[i] / max(spacing, 1e-9)), LAST)
        return float(np.sum(np.abs(self.samples[i, first:, 3])) * spacing)


@loop
def follow(error, samples, since, duration, to_plan, motion):
    """Error to the plan (N, 3), body axes, and its v_d, w_d, v_d', w_d' (N, 4), both out.

    error (N, 3): to the goal. samples, since, duration: of Plans. Zeros without a plan.
    """
    at = np.empty(7)
    for i in range(error.shape[0]):
        to_plan[i], motion[i] = 0.0, 0.0
        if not math.isfinite(since[i]):
            continue
        place = min(since[i] / duration[i], 1.0) * LAST if duration[i] > 0.0 else LAST
        first = min(int(place), LAST - 1)
        share = place - first
        for k in range(7):
            at[k] = (1.0 - share) * samples[i, first, k] + share * samples[i, first + 1, k]
        cosine, sine = rotation(error[i, 2])
        # The plan's position in body axes, of the frame turned by yaw = error[i, 2].
        to_plan[i, 0] = error[i, 0] - (cosine * at[0] + sine * at[1])
        to_plan[i, 1] = error[i, 1] - (cosine * at[1] - sine * at[0])
        to_plan[i, 2] = wrap_angle(error[i, 2] - at[2])
        for k in range(4):
            motion[i, k] = at[3 + k]
