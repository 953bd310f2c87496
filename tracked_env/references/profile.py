"""The value of a reference: coefficients of speed and yaw rate, and how they are fitted.

    v(t), w(t): polynomials of degree 5 on segments of h = 0.5 s; see
    tracked_env/physics/reference_profile.py for their evaluation and the path they imply.
The Hermite fit reproduces value, first and second derivative at both ends of each segment; in
between its error is h^6 f^(6) / 46080.

References: [1] Davis, Interpolation and Approximation, 2.5 (Hermite interpolation, error).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tracked_env.physics import reference_profile as kernels
from tracked_env.physics.elementary import rotation
from tracked_env.physics.parameters import Range
from tracked_env.physics.reference_profile import SEGMENT_DURATION, UNIFORM_COLUMNS

FloatArray = NDArray[np.float64]
DEGREE = 5  # [-] of the polynomials
PLAN = "plan"  # the kind that a planner makes
START_POSE = ("x", "y", "yaw")  # of every kind
ANGLE = Range(-100.0, 100.0, "rad", "Did you pass degrees?")
GRID_TOLERANCE = 1e-9  # [-] of a segment: 20.000000000000004 s is still 40 segments


class ReferenceProfile(NamedTuple):
    """One reference: profile and start pose, world frame."""

    speed: FloatArray  # [m/s, s] (S, 6), ascending powers of the time within the segment
    yaw_rate: FloatArray  # [rad/s, s] (S, 6), likewise
    x: float = 0.0  # [m]
    y: float = 0.0  # [m]
    yaw: float = 0.0  # [rad]
    # (S, 4) or (S, 22) further columns of `physics.reference_profile`; empty: the uniform grid
    knots: FloatArray = np.zeros((0, 0))

    @property
    def table(self) -> FloatArray:
        """(S, W) all columns, as the kernels take them."""
        parts = [self.speed, self.yaw_rate, *([self.knots] if self.knots.size else [])]
        return np.concatenate(parts, axis=1)


def of_table(table: FloatArray, x: float, y: float, yaw: float) -> ReferenceProfile:
    """The reference of a table (S, W) with its start pose; rows that are not used are left out."""
    if table.shape[1] == UNIFORM_COLUMNS:
        return ReferenceProfile(table[:, :6].copy(), table[:, 6:].copy(), x, y, yaw)
    used = table[np.isfinite(table[:, kernels.START])]
    speed, yaw_rate, knots = (a.copy() for a in np.split(used, (6, UNIFORM_COLUMNS), axis=1))
    return ReferenceProfile(speed, yaw_rate, x, y, yaw, knots)


def with_knots(profile: ReferenceProfile, width: int) -> FloatArray:
    """The table (K, W) with knots of a reference, W = `width` >= that of its own."""
    table = profile.table
    if not profile.knots.size:
        ends = knot_times(len(table))
        at = sample(profile, ends)
        table = np.vstack([table, np.zeros(UNIFORM_COLUMNS)])
        table[-1, 0], table[-1, DEGREE + 1] = at.speed[-1], at.yaw_rate[-1]
        table = np.column_stack([table, ends, at.x, at.y, at.yaw])
    if table.shape[1] < width:
        moving = np.zeros((len(table), width - table.shape[1]))
        moving[:, : DEGREE + 1], moving[:, -DEGREE - 1 :] = table[:, :6], table[:, 6:12]
        table = np.concatenate([table, moving], axis=1)
    return table


class ReferenceSamples(NamedTuple):
    """A reference at T times, each field (T,), world frame; yaw is not wrapped."""

    x: FloatArray  # [m]
    y: FloatArray  # [m]
    yaw: FloatArray  # [rad]
    speed: FloatArray  # [m/s]
    acceleration: FloatArray  # [m/s^2] derivative of the signed speed
    jerk: FloatArray  # [m/s^3] its second derivative
    yaw_rate: FloatArray  # [rad/s]
    yaw_acceleration: FloatArray  # [rad/s^2]


def number_of_segments(duration: float) -> int:
    """Return S for an episode of `duration` [s]: those that cover it, and one beyond."""
    return math.ceil(duration / SEGMENT_DURATION - GRID_TOLERANCE) + 1


def knot_times(segments: int) -> FloatArray:
    """Return the ends of the segments [s], shape (S + 1,)."""
    return SEGMENT_DURATION * np.arange(segments + 1, dtype=np.float64)


def derivative_row(time: float, order: int) -> FloatArray:
    """Return the row r (6,) with r @ coefficients = derivative of that order at `time` [s].

    Order -1 is the integral from 0 to `time`, order -2 the integral of that integral.
    """
    row = np.zeros(DEGREE + 1)
    for n in range(max(order, 0), DEGREE + 1):
        row[n] = math.gamma(n + 1) / math.gamma(n - order + 1) * time ** (n - order)
    return row


_END_CONDITIONS = [derivative_row(t, order) for t in (0.0, SEGMENT_DURATION) for order in (0, 1, 2)]
_HERMITE = np.linalg.inv(np.array(_END_CONDITIONS)).T  # (6, 6): end values @ this


def fit(value: ArrayLike, first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Return coefficients (S, 6) from value, first and second derivative at the knots (S + 1,)."""
    at_knots = np.stack(np.broadcast_arrays(value, first, second), axis=-1)
    return np.concatenate([at_knots[:-1], at_knots[1:]], axis=1) @ _HERMITE


def constant(value: float, segments: int) -> FloatArray:
    """Return the coefficients (S, 6) of a quantity that does not change."""
    coefficients = np.zeros((segments, DEGREE + 1))
    coefficients[:, 0] = value
    return coefficients


def sample(profile: ReferenceProfile, times: ArrayLike) -> ReferenceSamples:
    """Return the reference at sorted `times` (T,) [s] >= 0, by the kernels of the simulation.

    Raises ValueError when the times are not sorted, negative or not finite.
    """
    times = np.ascontiguousarray(times, dtype=np.float64)
    ordered = times.ndim == 1 and np.all(np.isfinite(times)) and np.all(np.diff(times) >= 0.0)
    if not ordered or (times.size > 0 and times[0] < 0.0):
        raise ValueError(
            f"times = {times} s; must be one-dimensional, finite, >= 0 and sorted. "
            "Sort them first, or pass the time since the start of the episode."
        )
    out, table = np.empty((len(ReferenceSamples._fields), times.size)), profile.table
    if profile.knots.size:
        x, y, yaw = table[0, kernels.POSE : kernels.POSE + 3].tolist()
        kernels.sample_table(table, times, (x, y, *rotation(yaw), yaw), out)
        return ReferenceSamples(*out)
    turned = math.cos(profile.yaw), math.sin(profile.yaw)
    kernels.sample_table(table, times, (0.0, 0.0, *turned, 0.0), out)
    out[:3] += [[profile.x], [profile.y], [profile.yaw]]
    return ReferenceSamples(*out)
