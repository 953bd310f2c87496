"""Shortest path forwards between two poses with bounded curvature, in closed form.

Six words of left arc (L), right arc (R) and straight line (S). In the frame of the start and in
radii, with circles of centres S_L = (0, 1), S_R = (0, -1) there and G_L, G_R at the goal, v from
the first to the last circle, c = |v|, theta = atan2(v), goal yaw phi, angles in [0, 2 pi):

    LSL  t = theta              p = c               q = phi - t
    RSR  t = -theta             p = c               q = -phi - t
    LSR  t = theta + atan2(2, p)   p = sqrt(c^2 - 4)   q = t - phi
    RSL  t = -theta + atan2(2, p)  p = sqrt(c^2 - 4)   q = t + phi
    LRL  t = theta + p / 2      p = 2 pi - 2 asin(c / 4)   q = phi - t + p
    RLR  t = -theta + p / 2     p = 2 pi - 2 asin(c / 4)   q = -phi - t + p
An angle within SNAP below 2 pi is 0: rounding would add a whole circle otherwise. Two equal poses
are joined by a path of length 0.

References: [1] Dubins, On curves of minimal length (1957). [2] Shkel and Lumelsky, Classification
of the Dubins set, Robotics and Autonomous Systems 34 (2001).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import checked_pairs
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]

WORDS = ("LSL", "RSR", "LSR", "RSL", "LRL", "RLR")
SIGNS = np.array([[{"L": 1.0, "S": 0.0, "R": -1.0}[letter] for letter in word] for word in WORDS])
SNAP = 1e-9  # [rad], [radii] below which a segment is rounding
TOUCHING = 1e-11  # [-] by which c^2 may miss 4 (or c miss 4) where circles touch
TURN = 2.0 * math.pi
RADIUS = Range(1e-6, 1e6, "m", "It is the turning radius.")


class DubinsPath(NamedTuple):
    """The shortest path of each of N pairs of poses, or one word of it."""

    word: NDArray[np.int64]  # (N,) index into WORDS
    segments: Array  # [m] (N, 3) lengths of the three segments
    curvature: Array  # [1/m] (N, 3) of the segments, positive to the left
    length: Array  # [m] (N,)
    turning: Array  # [rad] (N,) change of yaw along the path, whole turns included


@formula
def _positive(angle, snap):
    """The angle in [0, 2 pi), with 0 for what is within `snap` of a whole turn."""
    wrapped = angle - TURN * math.floor(angle / TURN)
    if wrapped > TURN - snap or wrapped < 0.0:
        return 0.0
    return wrapped


@formula
def _outer(x, y, phi, side, snap):
    """LSL (side 1) or RSR (side -1): both circles on one side."""
    across = side * y - 1.0 + math.cos(phi)
    along = x - side * math.sin(phi)
    line = math.sqrt(along * along + across * across)
    if line < snap:
        return _positive(side * phi, snap), 0.0, 0.0
    first = _positive(math.atan2(across, along), snap)
    return first, line, _positive(side * phi - first, snap)


@formula
def _inner(x, y, phi, side, snap):
    """LSR (side 1) or RSL (side -1); NaN where the circles overlap."""
    across = side * y - 1.0 - math.cos(phi)
    along = x + side * math.sin(phi)
    square = along * along + across * across - 4.0
    if square < -TOUCHING:
        return math.nan, math.nan, math.nan
    line = math.sqrt(max(square, 0.0))
    first = _positive(math.atan2(across, along) + math.atan2(2.0, line), snap)
    return first, line, _positive(first - side * phi, snap)


@formula
def _arcs(x, y, phi, side, snap):
    """LRL (side 1) or RLR (side -1); NaN where the circles are too far apart."""
    across = side * y - 1.0 + math.cos(phi)
    along = x - side * math.sin(phi)
    quarter = 0.25 * math.sqrt(along * along + across * across)
    if quarter > 1.0 + TOUCHING:
        return math.nan, math.nan, math.nan
    middle = TURN - 2.0 * math.asin(min(quarter, 1.0))
    first = _positive(math.atan2(across, along) + 0.5 * middle, snap)
    return first, middle, _positive(side * phi - first + middle, snap)


@formula
def segments_of_words(x, y, phi, snap, angles):
    """All six words from the origin to (x, y) [radii], phi [rad]: angles (6, 3), NaN where none."""
    angles[0, 0], angles[0, 1], angles[0, 2] = _outer(x, y, phi, 1.0, snap)
    angles[1, 0], angles[1, 1], angles[1, 2] = _outer(x, y, phi, -1.0, snap)
    angles[2, 0], angles[2, 1], angles[2, 2] = _inner(x, y, phi, 1.0, snap)
    angles[3, 0], angles[3, 1], angles[3, 2] = _inner(x, y, phi, -1.0, snap)
    angles[4, 0], angles[4, 1], angles[4, 2] = _arcs(x, y, phi, 1.0, snap)
    angles[5, 0], angles[5, 1], angles[5, 2] = _arcs(x, y, phi, -1.0, snap)


@formula
def relative(start, goal, i, radius):
    """Goal i as seen from start i: x, y [radii], yaw [rad]."""
    away_x, away_y = goal[i, 0] - start[i, 0], goal[i, 1] - start[i, 1]
    cos, sin = math.cos(start[i, 2]), math.sin(start[i, 2])
    x = (cos * away_x + sin * away_y) / radius
    return x, (cos * away_y - sin * away_x) / radius, goal[i, 2] - start[i, 2]


@loop
def _words(start, goal, radius, out):
    """Segments (N, 6, 3) [m] of every word; NaN where a word does not exist."""
    for i in range(len(goal)):
        x, y, phi = relative(start, goal, i, radius[i])
        snap = SNAP / max(1.0, radius[i])
        segments_of_words(x, y, phi, snap, out[i])
        turned = abs(phi - TURN * round(phi / TURN))
        if x * x + y * y < snap * snap and turned < snap:
            out[i, 0] = 0.0
        for word in range(6):
            for part in range(3):
                out[i, word, part] *= radius[i]


def dubins(start: ArrayLike, goal: ArrayLike, radius: ArrayLike) -> DubinsPath:
    """The shortest path of N pairs of poses.

    start, goal: (N, 3) or (3,) x, y [m], yaw [rad]; radius: (N,) or a number [m]. The first of the
    WORDS is taken where several are shortest. Raises ValueError.
    """
    starts, goals, radii = prepared(start, goal, radius)
    lengths = _of_words(starts, goals, radii)
    total = np.where(np.isnan(lengths[..., 0]), np.inf, lengths.sum(axis=2))
    word = np.argmin(total, axis=1)
    return _path(lengths[np.arange(len(word)), word], word, radii)


def prepared(start: ArrayLike, goal: ArrayLike, radius: ArrayLike) -> tuple[Array, Array, Array]:
    """Poses (N, 3) twice and radii (N,) of what was given. Raises ValueError."""
    for value in np.ravel(radius):
        checked_number("radius", float(value), RADIUS)
    starts, goals = checked_pairs(start, goal, np.size(radius))
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64).ravel(), len(goals))
    return starts, goals, np.ascontiguousarray(radii)


def _of_words(starts: Array, goals: Array, radii: Array) -> Array:
    lengths = np.empty((len(radii), len(WORDS), 3))
    _words(starts, goals, radii, lengths)
    return lengths


def _path(segments: Array, word: NDArray[np.int64], radii: Array) -> DubinsPath:
    curvature = SIGNS[word] / radii[:, None]
    turning = np.sum(curvature * segments, axis=1)
    return DubinsPath(word, segments, curvature, segments.sum(axis=1), turning)
