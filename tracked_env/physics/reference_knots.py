"""A reference with knots of its own, as planners make them: held inputs, stops, a final stand.

Each row of its table (K, W) begins at a time and a pose, and holds from there until the next row:
    0..5    v(tau) [m/s], 6..11  w(tau) [rad/s]: what the reference shows, ascending powers of
            tau = t - t_k
    12      t_k [s], not decreasing; infinite in rows that are not used
    13..15  x, y [m], yaw [rad] at t_k, world frame
    16..33  v_x(tau), v_y(tau), w(tau), how the pose moves, in tables that are as wide
Where a table ends before column 16 the pose moves as is shown: v_x = v, v_y = 0 (unicycle). The
wider form is for a vehicle that slips: its pose moves otherwise than its belts.
    x' = v_x cos(yaw) - v_y sin(yaw),  y' = v_x sin(yaw) + v_y cos(yaw),  yaw' = w
The pose is integrated from the row's own one, so it has no drift, and may jump there. The last row
in use holds for ever: a plan stands there at its goal. A row that lasts no time, before
another one at 0, tells at what speed the vehicle is before the reference begins.

A table of 12 columns is one of `reference_profile`, on its uniform grid; the functions below take
either. Assumptions as there.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import reference_profile as uniform
from tracked_env.physics.elementary import rotation, small_rotation
from tracked_env.physics.jit import formula, loop

UNIFORM_COLUMNS = 12  # of a table on the uniform grid
START = 12  # [s] t_k
POSE = 13  # x, y [m], yaw [rad]
COURSE_COLUMNS = 16  # of a table whose pose moves as is shown
FORWARD, SIDEWAYS, TURN = 16, 22, 28  # first columns of v_x, v_y, w
BODY_COLUMNS = 34  # of a table whose pose moves otherwise


class PlannedRows(NamedTuple):
    """What a planner gives: rows of a table, and whether they may be driven."""

    rows: NDArray[np.float64]  # (K, W), W = COURSE_COLUMNS or BODY_COLUMNS; the last one stands
    converged: bool
    message: str  # why not, or what has to be known


@formula
def row_at(profile, time):
    """The row of (K, W) that holds at `time` [s]; the first one before 0."""
    low, high = 0, profile.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if profile[middle, START] <= time:
            low = middle
        else:
            high = middle
    return low


@formula
def rates_at(profile, time):
    """The `ReferenceRates` at `time` [s] of one table."""
    if profile.shape[1] == UNIFORM_COLUMNS:
        return uniform.evaluate(profile[:, :6], profile[:, 6:], time)
    k = row_at(profile, time)
    tau = max(time, 0.0) - profile[k, START]
    v, w = profile[k, :6], profile[k, 6:12]
    return uniform.ReferenceRates(
        uniform.profile_value(v, tau),
        uniform.profile_first(v, tau),
        uniform.profile_second(v, tau),
        uniform.profile_value(w, tau),
        uniform.profile_first(w, tau),
    )


@formula
def speeds_at(profile, time):
    """(v [m/s], w [rad/s]) at `time` [s]: the look-ahead needs no derivatives."""
    if profile.shape[1] == UNIFORM_COLUMNS:
        return uniform.speed_and_yaw_rate(profile[:, :6], profile[:, 6:], time)
    k = row_at(profile, time)
    tau = max(time, 0.0) - profile[k, START]
    return uniform.profile_value(profile[k, :6], tau), uniform.profile_value(profile[k, 6:12], tau)


@formula
def _travel(row, tau, duration):
    """Travel (x, y) [m] and rotation [rad] of one piece, in the frame of its start."""
    if row.size < BODY_COLUMNS:
        return uniform.piece_travel(row[:6], row[6:12], tau, duration)
    w = row[TURN:BODY_COLUMNS]
    x, y, angle = uniform.piece_travel(row[FORWARD:SIDEWAYS], w, tau, duration)
    along, across, _ = uniform.piece_travel(row[SIDEWAYS:TURN], w, tau, duration)
    return x - across, y + along, angle


@formula
def _move(profile, time, end, x, y, cos_yaw, sin_yaw, yaw):
    """Pose (x, y, cos, sin, yaw) of a table with knots at `end` [s], from the one at `time`."""
    k = row_at(profile, end)
    row = profile[k]
    tau = max(time, 0.0) - row[START]
    if k != row_at(profile, time):
        x, y, yaw, tau = row[POSE], row[POSE + 1], row[POSE + 2], 0.0
        cos_yaw, sin_yaw = rotation(yaw)
    last = max(end, 0.0) - row[START]
    pieces = max(math.ceil((last - tau) / uniform.PIECE_LIMIT), 1)
    step = (last - tau) / pieces
    for n in range(pieces):
        travel_x, travel_y, angle = _travel(row, tau + n * step, step)
        x += cos_yaw * travel_x - sin_yaw * travel_y
        y += sin_yaw * travel_x + cos_yaw * travel_y
        cosine, sine = small_rotation(angle)
        c = cos_yaw * cosine - sin_yaw * sine
        s = sin_yaw * cosine + cos_yaw * sine
        norm = 1.5 - 0.5 * (c * c + s * s)
        cos_yaw, sin_yaw = c * norm, s * norm
        yaw += angle
    return x, y, cos_yaw, sin_yaw, yaw


@formula
def advance(profile, time, end, duration, x, y, cos_yaw, sin_yaw, yaw):
    """Pose (x, y, cos, sin, yaw) of one table at `end` [s], from the one at `time`, world frame.

    duration [s]: from the one to the other; end = time + duration but for rounding. What is `end`
    of one step has to be `time` of the next, to the bit, for no knot to be passed twice.
    """
    if profile.shape[1] == UNIFORM_COLUMNS:
        x, y, cos_yaw, sin_yaw, turned = uniform.advance_pose(
            profile[:, :6], profile[:, 6:], time, duration, x, y, cos_yaw, sin_yaw
        )
        return x, y, cos_yaw, sin_yaw, yaw + turned
    return _move(profile, time, end, x, y, cos_yaw, sin_yaw, yaw)


@formula
def goal_of(profile):
    """(x, y [m], yaw [rad], time [s]) of the goal of a table with knots: its last row in use."""
    k = row_at(profile, 1e300)
    return profile[k, POSE], profile[k, POSE + 1], profile[k, POSE + 2], profile[k, START]


@loop
def sample_knots(profile, times, out):
    """Fill out (8, T) at the sorted times (T,) [s] >= 0 of a table with knots, world frame.

    Rows: x, y [m], yaw [rad], v, v', v'', w, w'.
    """
    x, y, yaw, before = profile[0, POSE], profile[0, POSE + 1], profile[0, POSE + 2], -1.0
    cos_yaw, sin_yaw = rotation(yaw)
    for n in range(times.size):
        time = times[n]
        x, y, cos_yaw, sin_yaw, yaw = _move(profile, before, time, x, y, cos_yaw, sin_yaw, yaw)
        before = time
        rates = rates_at(profile, time)
        out[0, n], out[1, n], out[2, n] = x, y, yaw
        out[3, n], out[4, n], out[5, n] = rates.speed, rates.acceleration, rates.jerk
        out[6, n], out[7, n] = rates.yaw_rate, rates.yaw_acceleration
