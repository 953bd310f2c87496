"""Shortest path between two poses with bounded curvature, forwards and in reverse.

There are nine formulas, here twelve kinds of words with those that are read from the goal to the
start; each holds with gears reversed, sides mirrored, and both. In radii, seen from the start, with
the polar form (rho, theta) of (xi, eta), | a change of gear and Q an arc of pi/2:

    xi = x - sin(phi), eta = y - 1 + cos(phi)    L S L, L|R|L, L|R L, L R|L, L|Q S L, L S Q|L
    xi = x + sin(phi), eta = y - 1 - cos(phi)    L S R, L R|L R, L|R L|R, L|Q S R, L S Q|R,
                                                 L|Q S Q|R
A negative segment is driven in reverse. Every candidate is driven to its end before it is accepted,
so a branch of an inverse function that does not hold cannot pass.

References: [1] Reeds and Shepp, Optimal paths for a car that goes both forwards and backwards,
Pacific Journal of Mathematics 145 (1990).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.dubins import prepared, relative
from tracked_env.physics.jit import formula, loop

Array = NDArray[np.float64]

KINDS = 12
PARTS = 5  # segments of a word at most
ACCEPTED = 1e-9  # [radii], [rad] by which the end of a candidate may miss, over 1 + distance
HALF = 0.5 * math.pi
L, S, R = 1.0, 0.0, -1.0
# Side of every segment for each kind of word.
SIDES = np.array(
    [
        [L, S, L, 0.0, 0.0], [L, S, R, 0.0, 0.0], [L, R, L, 0.0, 0.0], [L, R, L, 0.0, 0.0],
        [L, R, L, 0.0, 0.0], [L, R, L, R, 0.0], [L, R, L, R, 0.0], [L, R, S, L, 0.0],
        [L, S, R, L, 0.0], [L, R, S, R, 0.0], [L, S, L, R, 0.0], [L, R, S, L, R],
    ]
)  # fmt: skip


class ReedsSheppPath(NamedTuple):
    """The shortest path of each of N pairs of poses."""

    segments: Array  # [m] (N, 5) signed lengths, negative in reverse; 0 where there are fewer
    curvature: Array  # [1/m] (N, 5), positive to the left of the vehicle
    length: Array  # [m] (N,) forwards and in reverse
    reversals: NDArray[np.int64]  # (N,) changes of gear


@formula
def _wrapped(angle):
    """The angle in [-pi, pi]."""
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))


@formula
def _same(kind, xi, eta, phi, out):
    """Kinds whose first and last arc are on one side; False where there is none."""
    rho, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    if kind == 0:
        out[0], out[1], out[2] = theta, rho, _wrapped(phi - theta)
        return True
    if kind <= 4:
        if rho > 4.0:
            return False
        if kind == 4:
            if rho == 0.0:
                return False
            middle = math.acos(1.0 - rho * rho / 8.0)
            lean = math.asin(min(1.0, 2.0 * math.sin(middle) / rho))
            out[0] = _wrapped(theta + HALF - lean)
            out[1], out[2] = middle, -_wrapped(out[0] - middle - phi)
            return True
        lean = math.acos(0.25 * rho)
        out[0] = _wrapped(theta + HALF + lean)
        middle = _wrapped(math.pi - 2.0 * lean)
        out[1], out[2] = -middle, _wrapped(phi - out[0] - middle)
        return True
    if rho < 2.0:
        return False
    line = math.sqrt(rho * rho - 4.0) - 2.0
    if kind == 7:
        out[0] = _wrapped(theta + HALF + math.atan2(2.0, line + 2.0))
        out[1], out[2], out[3] = -HALF, -line, -_wrapped(out[0] - phi + HALF)
        return True
    out[0] = _wrapped(theta + HALF - math.atan2(line + 2.0, 2.0))
    out[1], out[2], out[3] = line, HALF, -_wrapped(out[0] - phi - HALF)
    return True


@formula
def _other(kind, xi, eta, phi, out):
    """Kinds whose last arc is on the other side than the first; False where there is none."""
    rho, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    if kind == 1:
        if rho < 2.0:
            return False
        line = math.sqrt(rho * rho - 4.0)
        out[0] = _wrapped(theta + math.atan2(2.0, line))
        out[1], out[2] = line, _wrapped(out[0] - phi)
        return True
    if kind == 5:
        if rho > 4.0:
            return False
        if rho <= 2.0:
            lean = math.acos(0.25 * (rho + 2.0))
            out[0], middle = _wrapped(theta + HALF + lean), lean
        else:
            lean = math.acos(0.25 * (rho - 2.0))
            out[0], middle = _wrapped(theta + HALF - lean), math.pi - lean
        out[1], out[2] = middle, -middle
        out[3] = -_wrapped(phi - out[0] + 2.0 * middle)
        return True
    if kind == 6:
        cosine = (20.0 - rho * rho) / 16.0
        if not 0.0 <= cosine <= 1.0 or rho == 0.0:
            return False
        middle = math.acos(cosine)
        lean = math.asin(min(1.0, 2.0 * math.sin(middle) / rho))
        out[0] = _wrapped(theta + HALF + lean)
        out[1], out[2], out[3] = -middle, -middle, _wrapped(out[0] - phi)
        return True
    if kind == 11:
        if rho < 4.0:
            return False
        line = math.sqrt(rho * rho - 4.0) - 4.0
        out[0] = _wrapped(theta + HALF + math.atan2(2.0, line + 4.0))
        out[1], out[2], out[3], out[4] = -HALF, -line, -HALF, _wrapped(out[0] - phi)
        return True
    if rho < 2.0:
        return False
    if kind == 9:
        out[0] = _wrapped(theta + HALF)
        out[1], out[2], out[3] = -HALF, 2.0 - rho, -_wrapped(phi - out[0] - HALF)
        return True
    out[0] = _wrapped(theta)
    out[1], out[2], out[3] = rho - 2.0, HALF, -_wrapped(phi - out[0] - HALF)
    return True


@formula
def _candidate(kind, x, y, phi, out):
    """Signed segments of one kind of word, as it is printed; False where there is none."""
    for part in range(PARTS):
        out[part] = 0.0
    same = kind == 0 or 2 <= kind <= 4 or 7 <= kind <= 8
    if same:
        return _same(kind, x - math.sin(phi), y - 1.0 + math.cos(phi), phi, out)
    return _other(kind, x + math.sin(phi), y - 1.0 - math.cos(phi), phi, out)


@formula
def _missed(sides, mirrored, lengths, x, y, phi):
    """How far the end of the segments is from (x, y) [radii], and phi [rad] from its yaw."""
    at_x, at_y, yaw = 0.0, 0.0, 0.0
    for part in range(PARTS):
        side, length = mirrored * sides[part], lengths[part]
        if side == 0.0:
            at_x += length * math.cos(yaw)
            at_y += length * math.sin(yaw)
        else:
            turned = yaw + side * length
            at_x += side * (math.sin(turned) - math.sin(yaw))
            at_y -= side * (math.cos(turned) - math.cos(yaw))
            yaw = turned
    return max(abs(at_x - x), abs(at_y - y), abs(_wrapped(yaw - phi)))


@formula
def _total(lengths):
    """Length of a word, in reverse too."""
    total = 0.0
    for part in range(PARTS):
        total += abs(lengths[part])
    return total


@loop
def shortest(x, y, phi, sides, trial, lengths, turning):
    """The shortest word to one goal: segments [radii] and sides of them; returns its length."""
    best = math.inf
    allowed = ACCEPTED * (1.0 + math.sqrt(x * x + y * y))
    for symmetry in range(4):
        gear = 1.0 - 2.0 * (symmetry & 1)
        mirror = 1.0 - (symmetry & 2)
        for kind in range(KINDS):
            found = _candidate(kind, gear * x, mirror * y, gear * mirror * phi, trial)
            if not found or not _total(trial) < best - 1e-12:
                continue
            for part in range(PARTS):
                trial[part] *= gear
            if _missed(sides[kind], mirror, trial, x, y, phi) > allowed:
                continue
            best = _total(trial)
            for part in range(PARTS):
                lengths[part], turning[part] = trial[part], mirror * sides[kind, part]
    return best


@loop
def _paths(start, goal, radius, segments, curvature, length, reversals):
    """The shortest path of every pair."""
    trial = np.empty(PARTS)
    for i in range(len(goal)):
        x, y, phi = relative(start, goal, i, radius[i])
        phi = _wrapped(phi)
        if x * x + y * y < 1e-18 and abs(phi) < 1e-9:
            x, y, phi = 0.0, 0.0, 0.0
        length[i] = radius[i] * shortest(x, y, phi, SIDES, trial, segments[i], curvature[i])
        gear = 0.0
        for part in range(PARTS):
            segments[i, part] *= radius[i]
            curvature[i, part] /= radius[i]
            if abs(segments[i, part]) > 1e-9 * radius[i]:
                sign = math.copysign(1.0, segments[i, part])
                reversals[i] += gear * sign < 0.0
                gear = sign


def reeds_shepp(start: ArrayLike, goal: ArrayLike, radius: ArrayLike) -> ReedsSheppPath:
    """The shortest path of N pairs of poses, forwards and in reverse.

    start, goal: (N, 3) or (3,) x, y [m], yaw [rad]; radius: (N,) or a number [m]. Of words of one
    length the first in the order of the reference is taken. Raises ValueError.
    """
    starts, goals, radii = prepared(start, goal, radius)
    count = len(radii)
    segments, curvature = np.zeros((count, PARTS)), np.zeros((count, PARTS))
    length, reversals = np.empty(count), np.zeros(count, dtype=np.int64)
    _paths(starts, goals, radii, segments, curvature, length, reversals)
    return ReedsSheppPath(segments, curvature, length, reversals)
