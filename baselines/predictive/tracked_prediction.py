"""Prediction model of a tracked vehicle for one stage of a model predictive controller.

State s = (x, y, yaw, v, w, e_L, e_R): pose of the centre of mass in body axes of the present,
forward speed, yaw rate, efforts of the drives in units of g c: gain, and torque limit over r.
Input u = (u_L, u_R): the command, constant over a stage of h seconds. With a' the value at the end
    F_k   = g_k c [u_k + (e_k - u_k) T (1 - exp(-h/T)) / h],   e_k' = u_k + (e_k - u_k) exp(-h/T)
    v'    = v + h [(F_L + F_R - R_L - R_R) / m + w v_y + g s_p]          R at v', w
    w'    = w + (h / I) [(B/2) (F_R - R_R - F_L + R_L) + f M(v_y, w')]   R at v', w'
    yaw'  = yaw + h (w + w') / 2,       x', y' by the mean velocity along the mean heading
The lag of the drives is exact. The side slip is algebraic, v_y = v_y(v, w) of a steady turn.
Friction is taken at the end of the stage: near standstill its slope is a rate of up to hundreds per
second, and an explicit step would oscillate. v' and w' are roots of increasing functions, each
between 0 and its value without friction. All loads are those of `tracked_env.physics`, friction
smoothed: M(s v_y, s w) has the limits of M and a transition 1/s times as wide.

Assumptions: those of lumped_forces, `sliding`; sprockets below their top speed; on a slope that of
linearizing_law, a plane. Validity: stages shorter than the time in which the path bends.

The reference over the horizon of a predictive controller, from what the observation shows ahead.

An observation shows speed v and yaw rate w of the reference now, with their derivatives, and 0.25,
0.5, 1 and 2 s ahead. Between them both are cubic: slopes of the parabola through three neighbours,
of the observed derivative now, and of the chord at the end. They are linear in the six numbers, so
a constant matrix gives them at the nodes of the horizon, where the pose follows by the rule of
`tracked_prediction`, in body axes of the present.
A vehicle that drives along the path with its centre of mass has the speed sqrt(v^2 - v_y^2) and the
heading of the path plus delta, sin(delta) = -v_y / v. Nothing else is known of the path ahead.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from baselines.linearizing import linearizing_law as law
from baselines.linearizing.linearizing_law import MAXIMUM_SIDE_SLIP, inverse_speed
from tracked_env import observation as layout
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation, saturated_sign, signed
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.lumped import Coefficients, torque_decay
from tracked_env.physics.rigid_body import in_plane_above

X, Y, YAW, SPEED, YAW_RATE, GIVEN_LEFT, GIVEN_RIGHT, LEFT, RIGHT = range(9)  # places in (s, u)
STATES, ALL = 7, 9
CHANGED = 5  # x, y, yaw, v, w: what `forward` holds; efforts keep the rest `decay` of theirs
COLUMNS = 7  # columns of `forward`: yaw, v, w, e_L, e_R, u_L, u_R
RESISTANCE_WIDTH = 0.2  # [m/s] slower tracks meet less motion resistance; twice that of the plant
SMALL = 1e-7  # [rad/s] and [m/s]: differences for slopes of the friction
ROOT_STEPS = 30  # bisection alone ends within 1e-9 of its bracket
ROOT_TOLERANCE = 1e-11  # [rad/s] and [m/s]


class Prediction(NamedTuple):
    """What one stage needs of one vehicle."""

    k: Coefficients  # of the normal load on the vehicle's plane
    duration: float  # [s] h
    decay: float  # [-] exp(-h / T)
    kept: float  # [-] T (1 - exp(-h / T)) / h, mean of that over the stage
    force_left: float  # [N] g_L c
    force_right: float  # [N] g_R c
    smoothing: float  # [-] s
    pull_x: float  # [m/s^2] gravity along the body's x axis
    pull_y: float  # [m/s^2] and y axis


@formula
def prediction(p, k, duration, smoothing, pull_x, pull_y):
    """Prediction from PlantParameters and Coefficients."""
    decay = torque_decay(duration, p.drive_time_constant)
    force = p.torque_limit * k.inverse_radius
    return Prediction(
        k, duration, decay, p.drive_time_constant * (1.0 - decay) / duration,
        p.actuator_gain_left * force, p.actuator_gain_right * force, smoothing, pull_x, pull_y,
    )  # fmt: skip


@formula
def side_velocity(speed, yaw_rate, m):
    """v_y [m/s] of a steady turn."""
    return law.steady_lateral_velocity(speed, yaw_rate, m.k, m.pull_y)


@formula
def friction_moment(v_y, yaw_rate, m):
    """f M [N m], smoothed, odd and falling in the yaw rate."""
    _force, moment = soil.lateral_friction(
        m.smoothing * v_y, m.smoothing * yaw_rate, m.k.friction_intensity, m.k.contact_length
    )
    return m.k.turning_resistance_factor * moment


@formula
def resistances(speed, yaw_rate, m):
    """(R_L, R_R) [N]."""
    turn = yaw_rate * m.k.half_gauge
    left = saturated_sign(speed - turn, 1.0 / RESISTANCE_WIDTH)
    right = saturated_sign(speed + turn, 1.0 / RESISTANCE_WIDTH)
    return m.k.resistance * left, m.k.resistance * right


@formula
def _resistance_slope(track_speed, m):
    """dR/dV [N s/m] of one track."""
    x = track_speed / RESISTANCE_WIDTH
    return m.k.resistance * max(1.5 * (1.0 - x * x), 0.0) / RESISTANCE_WIDTH


@formula
def _away_from_zero(value):
    """A small difference with the sign of `value`: mirrored motions have mirrored slopes."""
    return SMALL if value >= 0.0 else -SMALL


@formula
def _next_guess(at, excess, slope, low, high):
    """Newton step of an increasing function within [low, high], else the middle."""
    after = at - excess / slope
    return after if low <= after <= high else 0.5 * (low + high)


@loop
def end_speed(speed, free, yaw_rate, m):
    """(v', slope): the root of v' = free - (h / m) (R_L + R_R) at v' and w, and dv' / d free [-].

    free [m/s]: speed without resistance; speed [m/s]: where the search begins. Newton steps within
    a bracket that shrinks: at v' = 0 the resistances of both tracks cancel.
    """
    factor, turn = m.duration * m.k.inverse_mass, yaw_rate * m.k.half_gauge
    low, high = min(free, 0.0), max(free, 0.0)
    v, slope = min(max(speed, low), high), 1.0
    for _ in range(ROOT_STEPS):
        left, right = resistances(v, yaw_rate, m)
        slope = 1.0 + factor * (_resistance_slope(v - turn, m) + _resistance_slope(v + turn, m))
        excess = v - free + factor * (left + right)
        low, high = (low, v) if excess > 0.0 else (v, high)
        after = _next_guess(v, excess, slope, low, high)
        done = abs(after - v) <= ROOT_TOLERANCE
        v = after
        if done:
            break
    return v, 1.0 / slope


@loop
def end_yaw_rate(yaw_rate, free, speed, v_y, m):
    """(w', slope): the root of w' = free + (h / I) [f M(v_y, w') - (B/2) (R_R - R_L)], R at v', w',
    and d w' / d free [-].

    free [rad/s]: yaw rate without friction; yaw_rate [rad/s]: where the search begins; speed: v'.
    """
    k, factor = m.k, m.duration * m.k.inverse_inertia
    low, high = min(free, 0.0), max(free, 0.0)
    w, slope = min(max(yaw_rate, low), high), 1.0
    for _ in range(ROOT_STEPS):
        moment, small, turn = friction_moment(v_y, w, m), _away_from_zero(w), w * k.half_gauge
        left, right = resistances(speed, w, m)
        steep = _resistance_slope(speed - turn, m) + _resistance_slope(speed + turn, m)
        bend = min((friction_moment(v_y, w + small, m) - moment) / small, 0.0)
        slope = 1.0 + factor * (k.half_gauge * k.half_gauge * steep - bend)
        excess = w - free - factor * (moment - k.half_gauge * (right - left))
        low, high = (low, w) if excess > 0.0 else (w, high)
        after = _next_guess(w, excess, slope, low, high)
        done = abs(after - w) <= ROOT_TOLERANCE
        w = after
        if done:
            break
    return w, 1.0 / slope


@formula
def efforts(given_left, given_right, left, right, m):
    """Mean tractive efforts (F_L, F_R) [N] of a stage."""
    return (
        m.force_left * (left + (given_left - left) * m.kept),
        m.force_right * (right + (given_right - right) * m.kept),
    )


@formula
def needed_efforts(speed, yaw_rate, next_speed, next_yaw_rate, v_y, m):
    """Mean efforts (F_L, F_R) [N] that take (v, w) to (v', w') in one stage."""
    left, right = resistances(next_speed, yaw_rate, m)
    forward = (next_speed - speed) / m.duration - yaw_rate * v_y - m.pull_x
    total = forward / m.k.inverse_mass + left + right
    left, right = resistances(next_speed, next_yaw_rate, m)
    turning = (next_yaw_rate - yaw_rate) / (m.duration * m.k.inverse_inertia)
    turning -= friction_moment(v_y, next_yaw_rate, m)
    difference = turning / m.k.half_gauge + right - left
    return 0.5 * (total - difference), 0.5 * (total + difference)


@loop
def drive(s, u, m, after):
    """State after one stage, (STATES,) out, from s (STATES,) and u (2,).

    Returns what `differentiate` needs: v_y at both ends, dv' and dw' over those without friction.
    """
    h, k, v, w = m.duration, m.k, s[SPEED], s[YAW_RATE]
    y = side_velocity(v, w, m)
    left, right = efforts(s[GIVEN_LEFT], s[GIVEN_RIGHT], u[0], u[1], m)
    free = v + h * ((left + right) * k.inverse_mass + w * y + m.pull_x)
    next_v, share_v = end_speed(v, free, w, m)
    lever = h * k.inverse_inertia * k.half_gauge
    next_w, share_w = end_yaw_rate(w, w + lever * (right - left), next_v, y, m)
    next_y = side_velocity(next_v, next_w, m)
    mean_v, mean_y, half_turn = 0.5 * (v + next_v), 0.5 * (y + next_y), 0.25 * h * (w + next_w)
    cosine, sine = rotation(s[YAW] + half_turn)
    after[X] = s[X] + h * (mean_v * cosine - mean_y * sine)
    after[Y] = s[Y] + h * (mean_v * sine + mean_y * cosine)
    after[YAW] = s[YAW] + 2.0 * half_turn
    after[SPEED], after[YAW_RATE] = next_v, next_w
    after[GIVEN_LEFT] = u[0] + (s[GIVEN_LEFT] - u[0]) * m.decay
    after[GIVEN_RIGHT] = u[1] + (s[GIVEN_RIGHT] - u[1]) * m.decay
    return y, next_y, share_v, share_w


@formula
def _side_slopes(v, w, y, m):
    """d v_y / dv [-] and d v_y / dw [m] at v_y = y."""
    small_v, small_w = _away_from_zero(v), _away_from_zero(w)
    return (
        (side_velocity(v + small_v, w, m) - y) / small_v,
        (side_velocity(v, w + small_w, m) - y) / small_w,
    )


@loop
def differentiate(s, after, sides, m, forward):
    """forward (COLUMNS, CHANGED) out: derivatives of `drive` from s to after, `sides` its answer.

    forward[c, r] is d after[r] / d (s, u)[2 + c]; x and y shift x' and y' alone.
    """
    y, next_y, share_v, share_w = sides
    h, k, v, w = m.duration, m.k, s[SPEED], s[YAW_RATE]
    next_v, next_w = after[SPEED], after[YAW_RATE]
    y_v, y_w = _side_slopes(v, w, y, m)
    next_y_v, next_y_w = _side_slopes(next_v, next_w, next_y, m)
    lever = h * k.inverse_inertia * k.half_gauge
    front, back = friction_moment(y + SMALL, next_w, m), friction_moment(y - SMALL, next_w, m)
    by_y = h * k.inverse_inertia * (front - back) / (2.0 * SMALL)
    cosine, sine = rotation(0.5 * (s[YAW] + after[YAW]))
    way_x, way_y = after[X] - s[X], after[Y] - s[Y]

    forward[0, X], forward[0, Y], forward[0, YAW] = -way_y, way_x, 1.0
    forward[0, SPEED], forward[0, YAW_RATE] = 0.0, 0.0
    turn, next_turn = w * k.half_gauge, next_w * k.half_gauge
    uneven = _resistance_slope(next_v + turn, m) - _resistance_slope(next_v - turn, m)
    forward[1, SPEED] = share_v * (1.0 + h * w * y_v)
    drop = uneven * k.half_gauge * k.inverse_mass
    forward[2, SPEED] = share_v * h * (y + w * y_w - drop)
    uneven = _resistance_slope(next_v + next_turn, m) - _resistance_slope(next_v - next_turn, m)
    forward[1, YAW_RATE], forward[2, YAW_RATE] = by_y * y_v, 1.0 + by_y * y_w
    for side in range(2):
        force = m.force_right if side else -m.force_left
        push, spin = share_v * h * k.inverse_mass * abs(force), lever * force
        forward[3 + side, SPEED], forward[3 + side, YAW_RATE] = push * m.kept, spin * m.kept
        forward[5 + side, SPEED] = push * (1.0 - m.kept)
        forward[5 + side, YAW_RATE] = spin * (1.0 - m.kept)
    for c in range(1, COLUMNS):
        forward[c, YAW_RATE] = share_w * (forward[c, YAW_RATE] - lever * uneven * forward[c, SPEED])
        d_v, d_w = forward[c, SPEED], forward[c, YAW_RATE]
        d_y = next_y_v * d_v + next_y_w * d_w
        if c == 1:
            d_v += 1.0
            d_y += y_v
        elif c == 2:
            d_w += 1.0
            d_y += y_w
        turned = 0.25 * h * d_w
        forward[c, X] = 0.5 * h * (cosine * d_v - sine * d_y) - way_y * turned
        forward[c, Y] = 0.5 * h * (sine * d_v + cosine * d_y) + way_x * turned
        forward[c, YAW] = 2.0 * turned


Array = NDArray[np.float64]

TIMES = (0.0, 0.25, 0.5, 1.0, 2.0)  # [s] at which speed and yaw rate are shown
_AHEAD = ("0.25", "0.5", "1", "2")
_ERRORS = ("position_error_x", "position_error_y", "heading_error")
_SPEEDS = ("reference_speed", *(f"reference_speed_ahead_{t}" for t in _AHEAD),
           "reference_acceleration")  # fmt: skip
_TURNS = ("reference_yaw_rate", *(f"reference_yaw_rate_ahead_{t}" for t in _AHEAD),
          "reference_yaw_acceleration")  # fmt: skip
NEEDS = (*_ERRORS, *_SPEEDS, *_TURNS)  # fields of the observation
SHOWN = len(_SPEEDS)
_SPEED_COLUMNS = np.array([layout.INDEX[name] for name in _SPEEDS])
_TURN_COLUMNS = np.array([layout.INDEX[name] for name in _TURNS])
_ERROR_X, _ERROR_Y, _HEADING = (layout.INDEX[name] for name in _ERRORS)
_SCALE = layout.SCALE

PATH_X, PATH_Y, HEADING, PATH_SPEED, PATH_YAW_RATE = range(5)  # columns of a path


class Ahead(NamedTuple):
    """Reference of one vehicle, N stages."""

    path: Array  # (N + 1, 5) pose of the vehicle on the path, v_x and yaw rate
    efforts: Array  # (N, 2) [-] in units of the largest command, that drive it
    speed: Array  # (N + 1,) [m/s] along the path
    turn: Array  # (N + 1,) [rad/s]


def make_ahead(count: int) -> Ahead:
    """Work space for `count` stages."""
    return Ahead(
        np.zeros((count + 1, 5)), np.zeros((count, 2)), np.zeros(count + 1), np.zeros(count + 1)
    )


def interpolation(times: ArrayLike) -> Array:
    """Matrix (len(times), SHOWN): values at TIMES and the slope at 0, to values at `times` [s]."""
    nodes = np.array(TIMES)
    value = np.eye(len(nodes), SHOWN)
    chord = np.diff(value, axis=0) / np.diff(nodes)[:, np.newaxis]
    slope = np.zeros_like(value)
    slope[0, -1] = 1.0
    before, after = np.diff(nodes)[:-1, np.newaxis], np.diff(nodes)[1:, np.newaxis]
    slope[1:-1] = (after * chord[:-1] + before * chord[1:]) / (before + after)
    slope[-1] = chord[-1]
    at = np.asarray(times, dtype=np.float64)
    return np.asarray(CubicHermiteSpline(nodes, value, slope)(at), dtype=np.float64)


@formula
def _shown(observation, i, columns, weights, sign, out):
    for k in range(out.shape[0]):
        total = 0.0
        for c in range(SHOWN):
            column = columns[c]
            total += weights[k, c] * (observation[i, column] * _SCALE[column])
        out[k] = sign * total


@formula
def lay_path(observation, i, weights, facing, start, incline, h, ahead):
    """Pose, speed and yaw rate of the reference at the nodes of the horizon, into ahead.

    start: (x, y, heading) of the reference now, in body axes; facing: -1.0 where the path is
    followed in reverse; h [s]: of a stage.
    """
    v, w, path = ahead.speed, ahead.turn, ahead.path
    _shown(observation, i, _SPEED_COLUMNS, weights, facing, v)
    _shown(observation, i, _TURN_COLUMNS, weights, 1.0, w)
    x, y, heading = start
    for k in range(path.shape[0]):
        if k > 0:
            half_turn = 0.25 * h * (w[k - 1] + w[k])
            cosine, sine = rotation(heading + half_turn)
            way = 0.5 * h * (v[k - 1] + v[k])
            along, across = in_plane_above(way * cosine, way * sine, incline)
            x, y, heading = x + along, y + across, heading + 2.0 * half_turn
        path[k, PATH_X], path[k, PATH_Y], path[k, HEADING] = x, y, heading
        path[k, PATH_SPEED], path[k, PATH_YAW_RATE] = v[k], w[k]


@loop
def look_ahead(observation, i, weights, incline, m, ahead):
    """Fill `ahead` for vehicle i with the Prediction m, in body axes; incline of its plane.

    observation (N, >= SIZE); weights: of `interpolation`. A vehicle that faces backwards follows
    the same path in reverse.
    """
    heading = observation[i, _HEADING] * _SCALE[_HEADING]
    faces_back = abs(heading) > 0.5 * math.pi
    if faces_back:
        heading -= signed(math.pi, heading)
    x, y = in_plane_above(
        observation[i, _ERROR_X] * _SCALE[_ERROR_X], observation[i, _ERROR_Y] * _SCALE[_ERROR_Y],
        incline,
    )  # fmt: skip
    facing = -1.0 if faces_back else 1.0
    lay_path(observation, i, weights, facing, (x, y, heading), incline, m.duration, ahead)
    v, w, path, lateral = ahead.speed, ahead.turn, ahead.path, 0.0
    for k in range(path.shape[0]):
        forward, before = v[k], lateral
        for _ in range(2):
            lateral = side_velocity(forward, w[k], m)
            forward = signed(math.sqrt(v[k] * v[k] - lateral * lateral), v[k])
        slip = min(max(-lateral * inverse_speed(v[k]), -MAXIMUM_SIDE_SLIP), MAXIMUM_SIDE_SLIP)
        path[k, HEADING] += math.asin(slip)
        path[k, PATH_SPEED] = forward
        if k > 0:
            left, right = needed_efforts(
                path[k - 1, PATH_SPEED], w[k - 1], forward, w[k], before, m
            )
            ahead.efforts[k - 1, 0] = left / m.force_left
            ahead.efforts[k - 1, 1] = right / m.force_right
