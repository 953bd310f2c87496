"""A reference motion: speed v(t) and yaw rate w(t), and the pose that follows from them.

    v(t), w(t) = polynomials of degree 5 in tau = t - t_k on segment k
    x' = v cos(yaw),  y' = v sin(yaw),  yaw' = w                    (unicycle)
A reference is a table, one row a segment, in SI units and ascending powers of tau:
    0..5    v(tau) [m/s], 6..11  w(tau) [rad/s]
On the uniform grid, t_k = k h with h = 0.5 s, a table ends there, shape (S, 12). Jumps at a knot
are possible; it belongs to the segment that it starts. Before t = 0 the reference stands at its
start values; after the last segment v and w keep their end values.

A planner makes tables (K, W) with knots of their own, for held inputs, stops and a final stand:
    12      t_k [s], not decreasing; infinite in rows that are not used
    13..15  x, y [m], yaw [rad] at t_k, world frame
    16..33  v_x(tau), v_y(tau), w(tau), how the pose moves, in tables that are as wide
A table that ends before column 16 is a unicycle's: v_x = v, v_y = 0. The wider form is for a
vehicle that slips: its pose moves otherwise than its belts.
    x' = v_x cos(yaw) - v_y sin(yaw),  y' = v_x sin(yaw) + v_y cos(yaw),  yaw' = w
The pose is integrated from the row's own one, and may jump there. The last row in use holds for
ever: a plan stands there at its goal. A row that lasts no time, before another one at 0, tells at
what speed the vehicle is before the reference begins.

The heading is integrated exactly; the position by Gauss-Legendre quadrature of three points,
within one segment and at most `PIECE_LIMIT` at a time, in the frame where the piece starts.

References: [1] Davis, Rabinowitz, Methods of Numerical Integration, 2.7 (error of the rule).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.elementary import rotation, small_rotation
from tracked_env.physics.jit import formula, loop

SEGMENT_DURATION = 0.5  # [s] h
INVERSE_DURATION = 1.0 / SEGMENT_DURATION  # [1/s]
YAW_RATE_LIMIT = 5.0  # [rad/s] of a reference: |w| * PIECE_LIMIT stays within 0.125 rad
PIECE_LIMIT = 0.025  # [s] the rule's error is 3e-18 v w^6 m there: 1e-13 m at 2 m/s, 5 rad/s

NODE = 0.7745966692414834  # [-] sqrt(3/5): Gauss-Legendre on [-1, 1], three points
WEIGHT_MIDDLE = 8.0 / 9.0  # [-]
WEIGHT_OUTER = 5.0 / 9.0  # [-]
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


class ReferenceRates(NamedTuple):
    """What a reference prescribes at one instant; its pose apart."""

    speed: float  # [m/s] v, signed
    acceleration: float  # [m/s^2] v'
    jerk: float  # [m/s^3] v''
    yaw_rate: float  # [rad/s] w
    yaw_acceleration: float  # [rad/s^2] w'


@formula
def profile_value(c, tau):
    """Return the value of the polynomial with ascending coefficients c (6,) at tau [s]."""
    return c[0] + tau * (c[1] + tau * (c[2] + tau * (c[3] + tau * (c[4] + tau * c[5]))))


@formula
def profile_first(c, tau):
    """Return the first derivative of `profile_value` by tau, in its unit per second."""
    p = 4.0 * c[4] + tau * 5.0 * c[5]
    return c[1] + tau * (2.0 * c[2] + tau * (3.0 * c[3] + tau * p))


@formula
def profile_second(c, tau):
    """Return the second derivative of `profile_value` by tau, in its unit per second^2."""
    return 2.0 * c[2] + tau * (6.0 * c[3] + tau * (12.0 * c[4] + tau * 20.0 * c[5]))


@formula
def profile_integral(c, tau):
    """Return the integral of `profile_value` from 0 to tau, in its unit times second."""
    p = c[3] * (1 / 4) + tau * (c[4] * (1 / 5) + tau * c[5] * (1 / 6))
    return tau * (c[0] + tau * (c[1] * (1 / 2) + tau * (c[2] * (1 / 3) + tau * p)))


@formula
def coefficients_at(table, row, first):
    """Six coefficients of a row of a table (K, W), from column `first` on."""
    c, k = table, first
    return (c[row, k], c[row, k + 1], c[row, k + 2], c[row, k + 3], c[row, k + 4], c[row, k + 5])


@formula
def locate(segments, time):
    """(k, tau): segment and local time [s] of `time` [s]; k = `segments` after the end.

    Times before 0, and NaN, count as 0.
    """
    time = time if time > 0.0 else 0.0
    time = min(time, segments * SEGMENT_DURATION)
    k = int(time * INVERSE_DURATION)
    return k, time - k * SEGMENT_DURATION


@formula
def segment_polynomial(coefficients, k):
    """Return the six coefficients of segment k of (S, 6); the constant end value for k >= S."""
    last = coefficients.shape[0] - 1
    if k > last:
        end = profile_value(coefficients_at(coefficients, last, 0), SEGMENT_DURATION)
        return (end, 0.0, 0.0, 0.0, 0.0, 0.0)
    return coefficients_at(coefficients, k, 0)


@formula
def _velocity(v, w, tau, heading):
    """Velocity [m/s] at tau in the frame where the heading integral was `heading` [rad]."""
    cosine, sine = small_rotation(profile_integral(w, tau) - heading)
    value = profile_value(v, tau)
    return value * cosine, value * sine


@formula
def piece_travel(v, w, tau, duration):
    """Travel (x, y) [m] and rotation [rad] from tau over `duration` <= PIECE_LIMIT [s], in the
    frame of the piece's start; v, w: six coefficients each, one segment."""
    half = 0.5 * duration
    middle = tau + half
    heading = profile_integral(w, tau)
    x1, y1 = _velocity(v, w, middle - half * NODE, heading)
    x2, y2 = _velocity(v, w, middle, heading)
    x3, y3 = _velocity(v, w, middle + half * NODE, heading)
    x = half * (WEIGHT_OUTER * (x1 + x3) + WEIGHT_MIDDLE * x2)
    y = half * (WEIGHT_OUTER * (y1 + y3) + WEIGHT_MIDDLE * y2)
    return x, y, profile_integral(w, tau + duration) - heading


@formula
def _moved(x, y, cos_yaw, sin_yaw, travel):
    """Pose (x, y, cos, sin) after a travel (x, y, angle) in the frame of its start."""
    travel_x, travel_y, angle = travel
    x += cos_yaw * travel_x - sin_yaw * travel_y
    y += sin_yaw * travel_x + cos_yaw * travel_y
    cosine, sine = small_rotation(angle)
    c = cos_yaw * cosine - sin_yaw * sine
    s = sin_yaw * cosine + cos_yaw * sine
    norm = 1.5 - 0.5 * (c * c + s * s)  # one Newton step: the pair stays a unit vector
    return x, y, c * norm, s * norm


@formula
def advance_pose(speed, yaw_rate, time, duration, x, y, cos_yaw, sin_yaw):
    """(x, y, cos_yaw, sin_yaw, turn [rad]) of one reference (S, 6) after time + duration [s].

    x, y, cos_yaw, sin_yaw: pose at `time`, world frame. Steps across knots are split there. Error
    of one step <= 0.2 s: < 1e-13 m and rad for |v| <= 5 m/s, |w| <= 3 rad/s.
    """
    segments, turn, remaining = speed.shape[0], 0.0, duration
    k, tau = locate(segments, time)
    while remaining > 0.0:
        room = SEGMENT_DURATION - tau if k < segments else remaining
        ends_segment = room <= min(remaining, PIECE_LIMIT)
        piece = min(min(remaining, PIECE_LIMIT), room)
        v, w = segment_polynomial(speed, k), segment_polynomial(yaw_rate, k)
        travel = piece_travel(v, w, tau, piece)
        x, y, cos_yaw, sin_yaw = _moved(x, y, cos_yaw, sin_yaw, travel)
        turn += travel[2]
        remaining -= piece
        tau = 0.0 if ends_segment else tau + piece
        k += 1 if ends_segment and k < segments else 0
    return x, y, cos_yaw, sin_yaw, turn


@formula
def row_at(profile, time):
    """The row of (K, W) that holds at `time` [s]; the first one before 0."""
    low, high = 0, profile.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        early = profile[middle, START] <= time
        low, high = (middle, high) if early else (low, middle)
    return low


@formula
def _at(profile, time):
    """(v, w, tau): the six coefficients of both in the row that holds at `time`, and the local time
    [s]."""
    if profile.shape[1] == UNIFORM_COLUMNS:
        k, tau = locate(profile.shape[0], time)
        return segment_polynomial(profile[:, :6], k), segment_polynomial(profile[:, 6:], k), tau
    k = row_at(profile, time)
    tau = max(time, 0.0) - profile[k, START]
    return coefficients_at(profile, k, 0), coefficients_at(profile, k, 6), tau


@formula
def rates_at(profile, time):
    """The `ReferenceRates` at `time` [s] of one table."""
    v, w, tau = _at(profile, time)
    v_first, v_second = profile_first(v, tau), profile_second(v, tau)
    w_value, w_first = profile_value(w, tau), profile_first(w, tau)
    return ReferenceRates(profile_value(v, tau), v_first, v_second, w_value, w_first)


@formula
def speeds_at(profile, time):
    """(v [m/s], w [rad/s]) at `time` [s]: the look-ahead needs no derivatives."""
    v, w, tau = _at(profile, time)
    return profile_value(v, tau), profile_value(w, tau)


@formula
def _travel(profile, row, tau, duration):
    """Travel (x, y) [m] and rotation [rad] of one piece, in the frame of its start."""
    if profile.shape[1] < BODY_COLUMNS:
        v, w = coefficients_at(profile, row, 0), coefficients_at(profile, row, 6)
        return piece_travel(v, w, tau, duration)
    w = coefficients_at(profile, row, TURN)
    x, y, angle = piece_travel(coefficients_at(profile, row, FORWARD), w, tau, duration)
    sideways = coefficients_at(profile, row, SIDEWAYS)
    along, across, _ = piece_travel(sideways, w, tau, duration)
    return x - across, y + along, angle


@formula
def _move(profile, time, end, pose):
    """Pose (x, y, cos, sin, yaw) of a table with knots at `end` [s], from the one at `time`."""
    x, y, cos_yaw, sin_yaw, yaw = pose
    k = row_at(profile, end)
    tau = max(time, 0.0) - profile[k, START]
    if k != row_at(profile, time):
        x, y, yaw, tau = profile[k, POSE], profile[k, POSE + 1], profile[k, POSE + 2], 0.0
        cos_yaw, sin_yaw = rotation(yaw)
    last = max(end, 0.0) - profile[k, START]
    pieces = max(math.ceil((last - tau) / PIECE_LIMIT), 1)
    step = (last - tau) / pieces
    for n in range(pieces):
        travel = _travel(profile, k, tau + n * step, step)
        x, y, cos_yaw, sin_yaw = _moved(x, y, cos_yaw, sin_yaw, travel)
        yaw += travel[2]
    return x, y, cos_yaw, sin_yaw, yaw


@formula
def advance(profile, time, end, duration, pose):
    """Pose (x, y, cos, sin, yaw) of one table at `end` [s], from the one at `time`, world frame.

    duration [s] = end - time but for rounding. What is `end` of one step has to be `time` of the
    next, to the bit, for no knot to be passed twice.
    """
    if profile.shape[1] == UNIFORM_COLUMNS:
        v, w = profile[:, :6], profile[:, 6:]
        x, y, c, s, turn = advance_pose(v, w, time, duration, pose[0], pose[1], pose[2], pose[3])
        return x, y, c, s, pose[4] + turn
    return _move(profile, time, end, pose)


@formula
def goal_of(profile):
    """(x, y [m], yaw [rad], time [s]) of the goal of a table with knots: its last row in use."""
    k = row_at(profile, 1e300)
    return profile[k, POSE], profile[k, POSE + 1], profile[k, POSE + 2], profile[k, START]


@loop
def sample_table(profile, times, pose, out):
    """Fill out (8, T) at the sorted times (T,) [s] >= 0 of one table that begins at `pose`.

    Rows: x, y [m], yaw [rad], v, v', v'', w, w'. pose: (x, y, cos, sin, yaw).
    """
    before = 0.0 if profile.shape[1] == UNIFORM_COLUMNS else -1.0
    for n in range(times.size):
        pose = advance(profile, before, times[n], times[n] - before, pose)
        before = times[n]
        rates = rates_at(profile, before)
        out[0, n], out[1, n], out[2, n] = pose[0], pose[1], pose[4]
        out[3, n], out[4, n], out[5, n] = rates.speed, rates.acceleration, rates.jerk
        out[6, n], out[7, n] = rates.yaw_rate, rates.yaw_acceleration
