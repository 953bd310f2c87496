"""The generalised Newton-Raphson method of section 7.3 as it is printed, for one vehicle.

For the last fifty control steps (`window`), both tracks, f = F_max g(K) - tau / r with
g = 1 - K / (i l) (1 - exp(-i l / K)); (F_max, K) <- (F_max, K) - J^+ f, J the printed derivatives,
J^+ the least-squares inverse, at most twenty times; not converged -> the last converged values.
No weights, no damping, no prior: what the estimators of this project add.

References: [1] Strawa et al., Electronics 10 (2021) 187, 7.3 and 8.3.3.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

WINDOW = 50  # [control steps] 8.3.3
ITERATIONS = 20  # at most, 8.3.3
CONVERGED = 1e-6  # [-] relative step; the paper names none


class Fit(NamedTuple):
    """Time histories (T,)."""

    effort_maximum: Floats  # [N]
    modulus: Floats  # [m] K
    iterations: Floats
    converged: NDArray[np.bool_]


def printed_gnr(
    slip: Floats,
    effort: Floats,
    contact_length: float,
    first_guess: tuple[float, float],
    window: int = WINDOW,
) -> Fit:
    """Fit every window of slip [-] and effort tau / r [N], both (T, 2) for left and right.

    Samples with an effort and slip of opposite sign or without slip are left out.
    """
    steps = len(slip)
    fit = Fit(np.empty(steps), np.empty(steps), np.zeros(steps), np.zeros(steps, dtype=bool))
    known = first_guess
    for k in range(steps):
        rows = slice(max(k + 1 - window, 0), k + 1)
        distance, force = np.abs(slip[rows].ravel()) * contact_length, effort[rows].ravel()
        used = (slip[rows].ravel() * force > 0.0) & (distance > 1e-12)
        found, count, done = _newton(distance[used], np.abs(force[used]), known)
        if done:
            known = found
        fit.effort_maximum[k], fit.modulus[k] = known
        fit.iterations[k], fit.converged[k] = count, done
    return fit


def _newton(
    distance: Floats, force: Floats, guess: tuple[float, float]
) -> tuple[tuple[float, float], int, bool]:
    """(F_max, K), iterations, converged; distance = |i| l [m]."""
    maximum, modulus = guess
    if distance.size < 2:
        return guess, 0, False
    for count in range(1, ITERATIONS + 1):
        u = distance / modulus
        decay = np.exp(-u)
        share = 1.0 + np.expm1(-u) / u  # df/dF_max
        slope = maximum * (decay + np.expm1(-u) / u) / modulus  # df/dK
        residual = maximum * share - force
        a, b, c = float(share @ share), float(share @ slope), float(slope @ slope)
        determinant = a * c - b * b
        if not determinant > 1e-12 * a * c:
            return guess, count, False
        p, q = float(share @ residual), float(slope @ residual)
        step = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        maximum, modulus = maximum - step[0], modulus - step[1]
        if not (0.0 < maximum < 1e7 and 1e-5 < modulus < 10.0):
            return guess, count, False
        if abs(step[0]) < CONVERGED * maximum and abs(step[1]) < CONVERGED * modulus:
            return (maximum, modulus), count, True
    return guess, ITERATIONS, False
