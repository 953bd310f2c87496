"""Curves between two poses: Dubins, Reeds-Shepp and clothoids, for N pairs at once.

Dubins: the shortest forwards with bounded curvature, six words of left arc (L), right arc (R) and
straight line (S). In the frame of the start and in radii, with v from the centre of the first to
that of the last circle, c = |v|, theta = atan2(v), goal yaw phi, angles in [0, 2 pi):
    LSL  t = theta              p = c               q = phi - t
    RSR  t = -theta             p = c               q = -phi - t
    LSR  t = theta + atan2(2, p)   p = sqrt(c^2 - 4)   q = t - phi
    RSL  t = -theta + atan2(2, p)  p = sqrt(c^2 - 4)   q = t + phi
    LRL  t = theta + p / 2      p = 2 pi - 2 asin(c / 4)   q = phi - t + p
    RLR  t = -theta + p / 2     p = 2 pi - 2 asin(c / 4)   q = -phi - t + p
An angle within SNAP below 2 pi is 0: rounding would add a whole circle otherwise.

Reeds-Shepp: the shortest forwards and in reverse. Twelve kinds of words, each with gears reversed,
sides mirrored, and both; L|R|L and L|R L have one formula. With the polar form (rho, theta) of (xi,
eta), | a change of gear and Q an arc of pi/2:
    xi = x - sin(phi), eta = y - 1 + cos(phi)    L S L, L|R|L, L|R L, L R|L, L|Q S L, L S Q|L
    xi = x + sin(phi), eta = y - 1 - cos(phi)    L S R, L R|L R, L|R L|R, L|Q S R, L S Q|R,
                                                 L|Q S Q|R
A negative segment is in reverse. The end of every candidate is computed before it is accepted, so a
branch of an inverse function that does not hold cannot pass.

Clothoid: one piece whose curvature is linear in the way along it, without a bound. With phi_0,
phi_1 the yaw at both ends relative to the line between them, in [-pi, pi], delta = phi_1 - phi_0
and u = s / length in [0, 1], the angle to that line is A u^2 + (delta - A) u + phi_0. A is the root
of
    g(A) = integral of sin(A u^2 + (delta - A) u + phi_0) du = 0
by Newton's method from the approximation of [4], integrals by Gauss-Legendre quadrature; then, with
the distance d and h = the same integral of the cosine,
    length = d / h    k_0 = (delta - A) / length    k' = 2 A / length^2

References: [1] Dubins, On curves of minimal length (1957). [2] Shkel and Lumelsky, Classification
of the Dubins set, Robotics and Autonomous Systems 34 (2001). [3] Reeds and Shepp, Optimal paths for
a car that goes both forwards and backwards, Pacific Journal of Mathematics 145 (1990).
[4] Bertolazzi and Frego, G1 fitting with clothoids, Mathematical Methods in the Applied Sciences 38
(2015). [F] Focchi et al. (2025), (50).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.speed_along_path import Path
from baselines.planners.trajectory import checked_table
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
HALF = 0.5 * math.pi
PARTS = 5  # segments of a Reeds-Shepp word at most
ACCEPTED = 1e-9  # [radii], [rad] by which the end of a candidate may miss, over 1 + distance
# Kinds of Reeds-Shepp words: side of every segment; which rho they need at least and at most.
KINDS = ("LSL", "LSR", "LRL", "LRL", "LRLR", "LRLR", "LRSL", "LSRL", "LRSR", "LSLR", "LRSLR")
SIDES = np.array([[{"L": 1.0, "R": -1.0}.get(s, 0.0) for s in k.ljust(PARTS)] for k in KINDS])
SAME = np.array([1.0 if kind.endswith("L") else -1.0 for kind in KINDS])  # last arc as the first
LEAST = np.array([0.0, 2.0, 0.0, 1e-300, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0, 4.0])
MOST = np.where([kind in (2, 3, 4) for kind in range(len(KINDS))], 4.0, np.inf)
ORDER = 18  # nodes of the quadrature: exact to rounding for all pairs of angles
ITERATIONS = 20  # of Newton's method at most; 3 or 4 are the rule
CLOSEST = 1e-9  # [m] between the poses, below which there is no clothoid
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(ORDER)
NODES, WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS  # [-] over [0, 1]
# Approximation of A by its symmetric polynomial in phi_0 / pi, phi_1 / pi.
GUESS = (2.989696028701907, 0.716228953608281, -0.458969738821509,
         -0.502821153340377, 0.261062141752652, -0.045854475238709)  # fmt: skip


class Curves(NamedTuple):
    """Pieces of N curves, at most P each; a piece that is not there has length 0."""

    start: Array  # (N, 3)
    segments: Array  # [m] (N, P) lengths, negative in reverse
    curvature: Array  # [1/m] (N, P) at the beginning of the piece, positive to the left
    sharpness: Array  # [1/m^2] (N, P) its change over the signed way

    @property
    def length(self) -> Array:
        """Way along each curve [m] (N,), in reverse too."""
        return np.abs(self.segments).sum(axis=1)

    def path(self, i: int = 0) -> Path:
        """Curve i as a path."""
        return Path.of(self.start[i], self.segments[i], self.curvature[i], self.sharpness[i])


def _pairs(start: ArrayLike, goal: ArrayLike, radius: ArrayLike = 1.0) -> tuple[Array, ...]:
    """Poses (N, 3) twice and radii (N,); one of either is that of all. Raises ValueError."""
    radii = np.ravel(radius).astype(float)
    for value in radii:
        checked_number("radius", float(value), RADIUS)
    rows = checked_table("start", start), checked_table("goal", goal), radii
    counts = sorted({len(row) for row in rows} - {1}) or [1]
    if len(counts) > 1:
        raise ValueError(f"{counts} poses; starts and goals must be as many, or one")
    shapes = ((counts[0], *row.shape[1:]) for row in rows)
    each = zip(rows, shapes, strict=True)
    return tuple(np.ascontiguousarray(np.broadcast_to(row, shape)) for row, shape in each)


@formula
def _positive(angle, snap):
    """The angle in [0, 2 pi), with 0 for what is within `snap` of a whole turn."""
    wrapped = angle - TURN * math.floor(angle / TURN)
    if wrapped > TURN - snap or wrapped < 0.0:
        return 0.0
    return wrapped


@formula
def _word(kind, x, y, phi, side, snap):
    """Segments of LSL, LSR or LRL (kind 0, 1, 2; side -1: mirrored); NaN where there is none."""
    flip = -1.0 if kind == 1 else 1.0
    across = side * y - 1.0 + flip * math.cos(phi)
    along = x - flip * side * math.sin(phi)
    square = along * along + across * across
    if kind == 1:
        if square - 4.0 < -TOUCHING:
            return math.nan, math.nan, math.nan
        line = math.sqrt(max(square - 4.0, 0.0))
        first = _positive(math.atan2(across, along) + math.atan2(2.0, line), snap)
        return first, line, _positive(first - side * phi, snap)
    line = math.sqrt(square)
    if kind == 2:
        if 0.25 * line > 1.0 + TOUCHING:
            return math.nan, math.nan, math.nan
        middle = TURN - 2.0 * math.asin(min(0.25 * line, 1.0))
        first = _positive(math.atan2(across, along) + 0.5 * middle, snap)
        return first, middle, _positive(side * phi - first + middle, snap)
    if line < snap:
        return _positive(side * phi, snap), 0.0, 0.0
    first = _positive(math.atan2(across, along), snap)
    return first, line, _positive(side * phi - first, snap)


@formula
def segments_of_words(x, y, phi, snap, angles):
    """All six words from the origin to (x, y) [radii], phi [rad]: angles (6, 3), NaN where none."""
    for kind in range(3):
        a, b = angles[2 * kind], angles[2 * kind + 1]
        a[0], a[1], a[2] = _word(kind, x, y, phi, 1.0, snap)
        b[0], b[1], b[2] = _word(kind, x, y, phi, -1.0, snap)


@formula
def relative(start, goal, radius):
    """A goal (3,) as seen from a start: x, y [radii], yaw [rad]."""
    away_x, away_y = goal[0] - start[0], goal[1] - start[1]
    cos, sin = math.cos(start[2]), math.sin(start[2])
    x = (cos * away_x + sin * away_y) / radius
    return x, (cos * away_y - sin * away_x) / radius, goal[2] - start[2]


@loop
def _words(start, goal, radius, out):
    """Segments (N, 6, 3) [m] of every word; NaN where a word does not exist."""
    for i in range(len(goal)):
        x, y, phi = relative(start[i], goal[i], radius[i])
        snap = SNAP / max(1.0, radius[i])
        segments_of_words(x, y, phi, snap, out[i])
        turned = abs(phi - TURN * round(phi / TURN))
        if x * x + y * y < snap * snap and turned < snap:
            out[i, 0] = 0.0
        for word in range(6):
            for part in range(3):
                out[i, word, part] *= radius[i]


def dubins(start: ArrayLike, goal: ArrayLike, radius: ArrayLike) -> Curves:
    """The shortest paths forwards of N pairs of poses.

    start, goal: (N, 3) or (3,) x, y [m], yaw [rad]; radius: (N,) or a number [m]. The first of the
    WORDS is taken where several are shortest. Raises ValueError.
    """
    starts, goals, radii = _pairs(start, goal, radius)
    lengths = np.empty((len(radii), len(WORDS), 3))
    _words(starts, goals, radii, lengths)
    total = np.where(np.isnan(lengths[..., 0]), np.inf, lengths.sum(axis=2))
    word = np.argmin(total, axis=1)
    segments = lengths[np.arange(len(word)), word]
    return Curves(starts, segments, SIGNS[word] / radii[:, None], np.zeros_like(segments))


@formula
def wrapped(angle):
    """The angle in [-pi, pi]."""
    return angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))


@formula
def _candidate(kind, x, y, phi, out):
    """Signed segments of one kind of word, as it is printed; False where there is none."""
    same = SAME[kind]
    xi, eta = x - same * math.sin(phi), y - 1.0 + same * math.cos(phi)
    rho = math.sqrt(xi * xi + eta * eta)
    if not LEAST[kind] <= rho <= MOST[kind]:
        return False
    for part in range(PARTS):
        out[part] = 0.0
    theta = math.atan2(eta, xi)
    across = theta + HALF
    if kind == 0:  # L S L
        out[0], out[1], out[2] = theta, rho, wrapped(phi - theta)
    elif kind == 1:  # L S R
        line = math.sqrt(rho * rho - 4.0)
        out[0] = wrapped(theta + math.atan2(2.0, line))
        out[1], out[2] = line, wrapped(out[0] - phi)
    elif kind == 2:  # L|R|L, L|R L
        lean = math.acos(0.25 * rho)
        middle = wrapped(math.pi - 2.0 * lean)
        out[0] = wrapped(across + lean)
        out[1], out[2] = -middle, wrapped(phi - out[0] - middle)
    elif kind == 3:  # L R|L
        middle = math.acos(1.0 - rho * rho / 8.0)
        out[0] = wrapped(across - math.asin(min(1.0, 2.0 * math.sin(middle) / rho)))
        out[1], out[2] = middle, -wrapped(out[0] - middle - phi)
    elif kind == 4:  # L R|L R
        lean = math.acos(0.25 * (rho + 2.0 if rho <= 2.0 else rho - 2.0))
        middle = lean if rho <= 2.0 else math.pi - lean
        out[0] = wrapped(across + lean if rho <= 2.0 else across - lean)
        out[1], out[2], out[3] = middle, -middle, -wrapped(phi - out[0] + 2.0 * middle)
    elif kind == 5:  # L|R L|R
        cosine = (20.0 - rho * rho) / 16.0
        if not 0.0 <= cosine <= 1.0:
            return False
        middle = math.acos(cosine)
        out[0] = wrapped(across + math.asin(min(1.0, 2.0 * math.sin(middle) / rho)))
        out[1], out[2], out[3] = -middle, -middle, wrapped(out[0] - phi)
    elif kind == 6:  # L|Q S L
        line = math.sqrt(rho * rho - 4.0) - 2.0
        out[0] = wrapped(across + math.atan2(2.0, line + 2.0))
        out[1], out[2], out[3] = -HALF, -line, -wrapped(out[0] - phi + HALF)
    elif kind == 7:  # L S Q|L
        line = math.sqrt(rho * rho - 4.0) - 2.0
        out[0] = wrapped(across - math.atan2(line + 2.0, 2.0))
        out[1], out[2], out[3] = line, HALF, -wrapped(out[0] - phi - HALF)
    elif kind == 8:  # L|Q S R
        out[0] = wrapped(across)
        out[1], out[2], out[3] = -HALF, 2.0 - rho, -wrapped(phi - out[0] - HALF)
    elif kind == 9:  # L S Q|R
        out[0] = wrapped(theta)
        out[1], out[2], out[3] = rho - 2.0, HALF, -wrapped(phi - out[0] - HALF)
    else:  # L|Q S Q|R
        line = math.sqrt(rho * rho - 4.0) - 4.0
        out[0] = wrapped(across + math.atan2(2.0, line + 4.0))
        out[1], out[2], out[3], out[4] = -HALF, -line, -HALF, wrapped(out[0] - phi)
    return True


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
    return max(abs(at_x - x), abs(at_y - y), abs(wrapped(yaw - phi)))


@loop
def shortest(x, y, phi, trial, lengths, turning):
    """The shortest word to one goal: segments [radii] and sides of them; returns its length."""
    best = math.inf
    allowed = ACCEPTED * (1.0 + math.sqrt(x * x + y * y))
    for symmetry in range(4):
        gear = 1.0 - 2.0 * (symmetry & 1)
        mirror = 1.0 - (symmetry & 2)
        for kind in range(len(KINDS)):
            exists = _candidate(kind, gear * x, mirror * y, gear * mirror * phi, trial)
            total = 0.0
            for part in range(PARTS):
                total += abs(trial[part])
                trial[part] *= gear
            if not exists or not total < best - 1e-12:
                continue
            if _missed(SIDES[kind], mirror, trial, x, y, phi) > allowed:
                continue
            best = total
            for part in range(PARTS):
                lengths[part], turning[part] = trial[part], mirror * SIDES[kind, part]
    return best


@loop
def _paths(start, goal, radius, segments, curvature):
    """The shortest Reeds-Shepp path of every pair."""
    trial = np.empty(PARTS)
    for i in range(len(goal)):
        x, y, phi = relative(start[i], goal[i], radius[i])
        phi = wrapped(phi)
        if x * x + y * y < 1e-18 and abs(phi) < 1e-9:
            x, y, phi = 0.0, 0.0, 0.0
        shortest(x, y, phi, trial, segments[i], curvature[i])
        for part in range(PARTS):
            segments[i, part] *= radius[i]
            curvature[i, part] /= radius[i]


def reeds_shepp(start: ArrayLike, goal: ArrayLike, radius: ArrayLike) -> Curves:
    """The shortest paths of N pairs of poses, forwards and in reverse; arguments as `dubins`.

    Of words of one length the first in the order of the reference is taken.
    """
    starts, goals, radii = _pairs(start, goal, radius)
    segments, curvature = np.zeros((len(radii), PARTS)), np.zeros((len(radii), PARTS))
    _paths(starts, goals, radii, segments, curvature)
    return Curves(starts, segments, curvature, np.zeros_like(segments))


@formula
def _signed_wrap(angle):
    """The angle in [-pi, pi]; a half turn changes its sign, as the library of [4] has it."""
    turns = angle / (2.0 * math.pi)
    return angle - 2.0 * math.pi * math.copysign(math.floor(abs(turns) + 0.5), turns)


@loop
def _fit(start, goal, curvature, sharpness, length):
    """The clothoid of every pair."""
    for i in range(len(goal)):
        away_x, away_y = goal[i, 0] - start[i, 0], goal[i, 1] - start[i, 1]
        distance, line = math.hypot(away_x, away_y), math.atan2(away_y, away_x)
        first, last = _signed_wrap(start[i, 2] - line), _signed_wrap(goal[i, 2] - line)
        u, v = first / math.pi, last / math.pi
        product, squares = u * v, u * u + v * v
        even = GUESS[0] + product * (GUESS[1] + product * GUESS[2])
        even += (GUESS[3] + product * GUESS[4]) * squares
        a, delta = (first + last) * (even + GUESS[5] * (u**4 + v**4)), last - first
        along = math.inf
        for _ in range(ITERATIONS):
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
            a -= value / slope
            if abs(value / slope) < 1e-14 * (1.0 + abs(a)):
                break
        length[i] = distance / along
        curvature[i] = (delta - a) / length[i]
        sharpness[i] = 2.0 * a / length[i] ** 2


def clothoid(start: ArrayLike, goal: ArrayLike) -> Curves:
    """The clothoid of each of N pairs of poses.

    start, goal: (N, 3) or (3,) x, y [m], yaw [rad]. Raises ValueError for what is not finite and
    where start and goal are one place, which no clothoid joins.
    """
    starts, goals, _ = _pairs(start, goal)
    apart = np.hypot(*(goals - starts)[:, :2].T)
    if np.any(apart < CLOSEST):
        raise ValueError(
            f"start and goal {np.argmin(apart)} are {apart.min():g} m apart; a clothoid needs at "
            f"least {CLOSEST:g} m. Turn on the spot, or plan with dubins."
        )
    curvature, sharpness, length = np.empty((3, len(goals)))
    _fit(starts, goals, curvature, sharpness, length)
    return Curves(starts, length[:, None], curvature[:, None], sharpness[:, None])
