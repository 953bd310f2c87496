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
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.trajectory import checked_pairs
from tracked_env.physics.jit import formula, loop

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
