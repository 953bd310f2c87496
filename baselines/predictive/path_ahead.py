"""The reference over the horizon of a predictive controller, from what the observation shows ahead.

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

from baselines.linearizing.linearizing_law import MAXIMUM_SIDE_SLIP, inverse_speed
from baselines.predictive.tracked_prediction import needed_efforts, side_velocity
from tracked_env import observation as layout
from tracked_env.physics.attitude import in_plane_above
from tracked_env.physics.elementary import rotation, signed
from tracked_env.physics.jit import formula, loop

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
