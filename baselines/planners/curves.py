"""One clothoid between two poses: curvature linear in the way along it (G1 interpolation).

    yaw(s) = yaw_0 + k_0 s + k' s^2 / 2        k(s) = k_0 + k' s
With phi_0, phi_1 the yaw at both ends relative to the line between them, in [-pi, pi], delta =
phi_1 - phi_0 and u = s / length in [0, 1], the angle to that line is A u^2 + (delta - A) u + phi_0.
A is the root of

    g(A) = integral of sin(A u^2 + (delta - A) u + phi_0) du = 0
by Newton's method from the approximation of [1]; then, with the distance d and h = the same
integral of the cosine,

    length = d / h    k_0 = (delta - A) / length    k' = 2 A / length^2
Integrals by Gauss-Legendre quadrature. The curvature has no bound: look at it
before driving (`plan` does).

References: [1] Bertolazzi and Frego, G1 fitting with clothoids, Mathematical Methods in the
Applied Sciences 38 (2015). [F] Focchi et al. (2025), (50).

Shortest path forwards between two poses with bounded curvature, in closed form.

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

A path in the plane as pieces whose curvature is linear in the way along them.

    k(s) = k_0 + k' s        yaw(s) = yaw_0 + k_0 s + k' s^2 / 2
A piece is driven forwards or in reverse; s is the signed way along it, so that yaw' = k s' holds in
both directions. Straight lines and arcs are evaluated in closed form, clothoids by Gauss-Legendre
quadrature on as many parts as their turning needs.

Frame: world, SI units; yaw is continuous.

Shortest path between two poses with bounded curvature, forwards and in reverse.

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
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import checked_pairs
from tracked_env.physics.jit import copy_entries, formula, loop
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]


ORDER = 18  # nodes of the quadrature: exact to rounding for all pairs of angles
ITERATIONS = 20  # of Newton's method at most; 3 or 4 are the rule
CLOSEST = 1e-9  # [m] between the poses, below which there is no clothoid
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(ORDER)
NODES, WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # [-] over [0, 1]
# Approximation of A by its symmetric polynomial in phi_0 / pi, phi_1 / pi.
GUESS = (2.989696028701907, 0.716228953608281, -0.458969738821509,
         -0.502821153340377, 0.261062141752652, -0.045854475238709)  # fmt: skip


class Clothoid(NamedTuple):
    """The clothoids of N pairs of poses."""

    curvature: Array  # [1/m] (N,) k_0, at the start
    sharpness: Array  # [1/m^2] (N,) k'
    length: Array  # [m] (N,)
    iterations: NDArray[np.int64]  # (N,) of Newton's method
    residual: Array  # [-] (N,) |g| there

    @property
    def end_curvature(self) -> Array:
        """k_1 [1/m] (N,)."""
        return self.curvature + self.sharpness * self.length

    @property
    def largest_curvature(self) -> Array:
        """Largest |k| [1/m] (N,)."""
        return np.maximum(np.abs(self.curvature), np.abs(self.end_curvature))

    @property
    def turning(self) -> Array:
        """Change of yaw along the clothoid [rad] (N,), whole turns included."""
        return self.length * (self.curvature + 0.5 * self.sharpness * self.length)


@formula
def _wrapped(angle):
    """The angle in [-pi, pi]; a half turn changes its sign, as the library of [1] has it."""
    turns = angle / (2.0 * math.pi)
    return angle - 2.0 * math.pi * math.copysign(math.floor(abs(turns) + 0.5), turns)


@formula
def _guess(first, last):
    """Approximate A for the angles phi_0, phi_1 [rad]."""
    x, y = first / math.pi, last / math.pi
    product, squares = x * y, x * x + y * y
    a, b, c, d, e, f = GUESS
    even = a + product * (b + product * c) + (d + product * e) * squares
    return (first + last) * (even + f * (x**4 + y**4))


@loop
def _fit(start, goal, curvature, sharpness, length, iterations, residual):
    """The clothoid of every pair."""
    for i in range(len(goal)):
        away_x, away_y = goal[i, 0] - start[i, 0], goal[i, 1] - start[i, 1]
        distance, line = math.hypot(away_x, away_y), math.atan2(away_y, away_x)
        first, last = _wrapped(start[i, 2] - line), _wrapped(goal[i, 2] - line)
        delta, a = last - first, _guess(first, last)
        value = along = math.inf
        rounds = 0
        while rounds < ITERATIONS:
            value = along = slope = 0.0
            for node in range(len(NODES)):
                u, weight = NODES[node], WEIGHTS[node]
                angle = (a * u + delta - a) * u + first
                cos = weight * math.cos(angle)
                value += weight * math.sin(angle)
                along += cos
                slope += cos * u * (u - 1.0)
            if abs(value) < 1e-15:
                break
            rounds += 1
            a -= value / slope
            if abs(value / slope) < 1e-14 * (1.0 + abs(a)):
                break
        length[i] = distance / along
        curvature[i] = (delta - a) / length[i]
        sharpness[i] = 2.0 * a / length[i] ** 2
        iterations[i], residual[i] = rounds, abs(value)


def clothoid(start: ArrayLike, goal: ArrayLike) -> Clothoid:
    """The clothoid of each of N pairs of poses.

    start, goal: (N, 3) or (3,) x, y [m], yaw [rad]. Raises ValueError for what is not finite and
    where start and goal are one place, which no clothoid joins.
    """
    starts, goals = checked_pairs(start, goal)
    apart = np.hypot(*(goals - starts)[:, :2].T)
    if np.any(apart < CLOSEST):
        raise ValueError(
            f"start and goal {np.argmin(apart)} are {apart.min():g} m apart; a clothoid needs at "
            f"least {CLOSEST:g} m. Turn on the spot, or plan with dubins."
        )
    fitted = np.empty((3, len(goals)))
    rounds, residual = np.zeros(len(goals), dtype=np.int64), np.empty(len(goals))
    curvature, sharpness, length = fitted
    _fit(starts, goals, curvature, sharpness, length, rounds, residual)
    return Clothoid(curvature, sharpness, length, rounds, residual)


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


_NODES_PATH, _WEIGHTS_PATH = np.polynomial.legendre.leggauss(16)
PART = 3.0  # [rad] of turning a part of the quadrature at most


class Path(NamedTuple):
    """A path of P pieces from a pose."""

    start: Array  # (3,) x, y [m], yaw [rad]
    length: Array  # [m] (P,) of each piece, signed: negative in reverse
    curvature: Array  # [1/m] (P,) at the beginning of the piece, positive to the left
    sharpness: Array  # [1/m^2] (P,) k', over the signed way

    @classmethod
    def of(
        cls, start: ArrayLike, length: Sequence[float] | Array,
        curvature: Sequence[float] | Array, sharpness: Sequence[float] | Array | None = None,
    ) -> "Path":  # fmt: skip
        """A path without the pieces that have no length."""
        lengths, curvatures = np.asarray(length, dtype=float), np.asarray(curvature, dtype=float)
        changes = (
            np.zeros_like(lengths) if sharpness is None else np.asarray(sharpness, dtype=float)
        )
        kept = np.abs(lengths) > 0.0
        begin = np.array(start, dtype=np.float64)
        return cls(begin, lengths[kept], curvatures[kept], changes[kept])

    @property
    def whole_length(self) -> float:
        """Way along all pieces [m], in reverse too."""
        return float(np.sum(np.abs(self.length)))

    @property
    def largest_curvature(self) -> float:
        """Largest |k| [1/m]; 0 for a path without pieces."""
        ends = np.abs([self.curvature, self.curvature + self.sharpness * self.length])
        return float(np.max(ends, initial=0.0))


class Place(NamedTuple):
    """A path at M distances, each field (M,)."""

    x: Array  # [m]
    y: Array  # [m]
    yaw: Array  # [rad]
    curvature: Array  # [1/m]
    sharpness: Array  # [1/m^2] over the signed way
    gear: Array  # [-] 1 forwards, -1 in reverse


@formula
def along(way, curvature, sharpness, yaw):
    """Displacement (x, y) [m] after the signed way [m] from a point with that yaw [rad]."""
    turned = (curvature + 0.5 * sharpness * way) * way
    if sharpness == 0.0:
        half = 0.5 * turned
        chord = way * (1.0 - half * half / 6.0) if abs(half) < 1e-4 else way * math.sin(half) / half
        return chord * math.cos(yaw + half), chord * math.sin(yaw + half)
    parts = 1 + int((abs(curvature * way) + abs(sharpness) * way * way) / PART)
    x, y, width = 0.0, 0.0, way / parts
    for part in range(parts):
        for node in range(len(_NODES_PATH)):
            s = width * (part + 0.5 * (_NODES_PATH[node] + 1.0))
            angle = yaw + (curvature + 0.5 * sharpness * s) * s
            x += 0.5 * width * _WEIGHTS_PATH[node] * math.cos(angle)
            y += 0.5 * width * _WEIGHTS_PATH[node] * math.sin(angle)
    return x, y


@loop
def _places(start, length, curvature, sharpness, distances, out):
    """Rows x, y, yaw, curvature, sharpness, gear at sorted distances [m] along the path."""
    x, y, yaw = start[0], start[1], start[2]
    piece, begun = 0, 0.0
    for i in range(len(distances)):
        while piece < len(length) - 1 and distances[i] > begun + abs(length[piece]):
            way = length[piece]
            step_x, step_y = along(way, curvature[piece], sharpness[piece], yaw)
            x, y = x + step_x, y + step_y
            yaw += (curvature[piece] + 0.5 * sharpness[piece] * way) * way
            begun += abs(way)
            piece += 1
        gear = math.copysign(1.0, length[piece])
        way = gear * min(distances[i] - begun, abs(length[piece]))
        step_x, step_y = along(way, curvature[piece], sharpness[piece], yaw)
        out[0, i], out[1, i] = x + step_x, y + step_y
        out[2, i] = yaw + (curvature[piece] + 0.5 * sharpness[piece] * way) * way
        out[3, i] = curvature[piece] + sharpness[piece] * way
        out[4, i], out[5, i] = sharpness[piece], gear


def places(path: Path, distances: ArrayLike) -> Place:
    """The path at sorted distances (M,) [m] from its start, counted forwards in either gear."""
    ways = np.ascontiguousarray(distances, dtype=np.float64)
    out = np.zeros((len(Place._fields), len(ways)))
    if len(path.length):
        _places(*path, ways, out)
    else:
        out[:3], out[5] = path.start[:, None], 1.0
    return Place(*out)


@loop
def _integrated(start, length, curvature, sharpness, steps, pose):
    """The pose at the end by Runge-Kutta's method of order 4 on yaw' = k, x' = cos, y' = sin."""
    copy_entries(start, pose)
    for piece in range(len(length)):
        step = length[piece] / steps
        for i in range(steps):
            k = curvature[piece] + sharpness[piece] * step * i
            middle = pose[2] + 0.5 * step * (k + 0.25 * sharpness[piece] * step)
            last = pose[2] + step * (k + 0.5 * sharpness[piece] * step)
            pose[0] += step / 6.0 * (math.cos(pose[2]) + 4.0 * math.cos(middle) + math.cos(last))
            pose[1] += step / 6.0 * (math.sin(pose[2]) + 4.0 * math.sin(middle) + math.sin(last))
            pose[2] = last


def end_errors(path: Path, goal: ArrayLike, steps: int = 200) -> tuple[float, float]:
    """(distance [m], yaw [rad]) from the goal after integrating the path numerically."""
    pose = np.empty(3)
    _integrated(*path, steps, pose)
    away = np.asarray(goal, dtype=np.float64) - pose
    return math.hypot(away[0], away[1]), abs(math.remainder(float(away[2]), 2.0 * math.pi))


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
def _wrapped_reeds_shepp(angle):
    """The angle in [-pi, pi]."""
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))


@formula
def _same(kind, xi, eta, phi, out):
    """Kinds whose first and last arc are on one side; False where there is none."""
    rho, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    if kind == 0:
        out[0], out[1], out[2] = theta, rho, _wrapped_reeds_shepp(phi - theta)
        return True
    if kind <= 4:
        if rho > 4.0:
            return False
        if kind == 4:
            if rho == 0.0:
                return False
            middle = math.acos(1.0 - rho * rho / 8.0)
            lean = math.asin(min(1.0, 2.0 * math.sin(middle) / rho))
            out[0] = _wrapped_reeds_shepp(theta + HALF - lean)
            out[1], out[2] = middle, -_wrapped_reeds_shepp(out[0] - middle - phi)
            return True
        lean = math.acos(0.25 * rho)
        out[0] = _wrapped_reeds_shepp(theta + HALF + lean)
        middle = _wrapped_reeds_shepp(math.pi - 2.0 * lean)
        out[1], out[2] = -middle, _wrapped_reeds_shepp(phi - out[0] - middle)
        return True
    if rho < 2.0:
        return False
    line = math.sqrt(rho * rho - 4.0) - 2.0
    if kind == 7:
        out[0] = _wrapped_reeds_shepp(theta + HALF + math.atan2(2.0, line + 2.0))
        out[1], out[2], out[3] = -HALF, -line, -_wrapped_reeds_shepp(out[0] - phi + HALF)
        return True
    out[0] = _wrapped_reeds_shepp(theta + HALF - math.atan2(line + 2.0, 2.0))
    out[1], out[2], out[3] = line, HALF, -_wrapped_reeds_shepp(out[0] - phi - HALF)
    return True


@formula
def _other(kind, xi, eta, phi, out):
    """Kinds whose last arc is on the other side than the first; False where there is none."""
    rho, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    if kind == 1:
        if rho < 2.0:
            return False
        line = math.sqrt(rho * rho - 4.0)
        out[0] = _wrapped_reeds_shepp(theta + math.atan2(2.0, line))
        out[1], out[2] = line, _wrapped_reeds_shepp(out[0] - phi)
        return True
    if kind == 5:
        if rho > 4.0:
            return False
        if rho <= 2.0:
            lean = math.acos(0.25 * (rho + 2.0))
            out[0], middle = _wrapped_reeds_shepp(theta + HALF + lean), lean
        else:
            lean = math.acos(0.25 * (rho - 2.0))
            out[0], middle = _wrapped_reeds_shepp(theta + HALF - lean), math.pi - lean
        out[1], out[2] = middle, -middle
        out[3] = -_wrapped_reeds_shepp(phi - out[0] + 2.0 * middle)
        return True
    if kind == 6:
        cosine = (20.0 - rho * rho) / 16.0
        if not 0.0 <= cosine <= 1.0 or rho == 0.0:
            return False
        middle = math.acos(cosine)
        lean = math.asin(min(1.0, 2.0 * math.sin(middle) / rho))
        out[0] = _wrapped_reeds_shepp(theta + HALF + lean)
        out[1], out[2], out[3] = -middle, -middle, _wrapped_reeds_shepp(out[0] - phi)
        return True
    if kind == 11:
        if rho < 4.0:
            return False
        line = math.sqrt(rho * rho - 4.0) - 4.0
        out[0] = _wrapped_reeds_shepp(theta + HALF + math.atan2(2.0, line + 4.0))
        out[1], out[2], out[3], out[4] = -HALF, -line, -HALF, _wrapped_reeds_shepp(out[0] - phi)
        return True
    if rho < 2.0:
        return False
    if kind == 9:
        out[0] = _wrapped_reeds_shepp(theta + HALF)
        out[1], out[2], out[3] = -HALF, 2.0 - rho, -_wrapped_reeds_shepp(phi - out[0] - HALF)
        return True
    out[0] = _wrapped_reeds_shepp(theta)
    out[1], out[2], out[3] = rho - 2.0, HALF, -_wrapped_reeds_shepp(phi - out[0] - HALF)
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
    return max(abs(at_x - x), abs(at_y - y), abs(_wrapped_reeds_shepp(yaw - phi)))


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
        phi = _wrapped_reeds_shepp(phi)
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
