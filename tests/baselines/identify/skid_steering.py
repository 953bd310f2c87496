"""Steady skid steering by a second method: points under two tracks, Coulomb friction, fsolve.

No formula of the package is used. Faults are put into its runs as recording makes them.
"""

import numpy as np
from scipy.optimize import fsolve

RADIUS, GAUGE, LENGTH, MASS, GRAVITY = 0.0856, 0.606, 0.7, 62.0, 9.81
POINTS = LENGTH * ((np.arange(25) + 0.5) / 25 - 0.5)
SLIDING = 0.02  # [m/s] over which friction changes its sign


def motion(left, right, friction=(0.35, 0.35), ahead=0.03, rolling=0.025):
    """v_x, v_y, yaw rate at constant sprocket speeds; friction of both tracks, load `ahead` [m]."""
    load = MASS * GRAVITY / 2 / len(POINTS) * (1 + 12 * ahead * POINTS / LENGTH**2)

    def unbalanced(u):
        v_x, v_y, w = u
        total = np.array([MASS * w * v_y, -MASS * w * v_x, 0.0])
        for y, omega, mu in ((GAUGE / 2, left, friction[0]), (-GAUGE / 2, right, friction[1])):
            along, across = v_x - w * y - RADIUS * omega, v_y + w * POINTS
            each = -mu * load / np.sqrt(along**2 + across**2 + SLIDING**2)
            push = (each * along).sum() - rolling * load.sum() * np.tanh((v_x - w * y) / 0.02)
            total += [push, (each * across).sum(), (each * across * POINTS).sum() - y * push]
        return total / (MASS * GRAVITY)

    forward, turn = RADIUS * (left + right) / 2, RADIUS * (right - left) / GAUGE
    for share in (0.6, 0.4, 0.8, 0.2):
        start = [forward, -0.02 * turn, share * turn]
        solution, _, status, _ = fsolve(unbalanced, start, full_output=True)
        if status == 1:
            return solution
    raise ArithmeticError(f"no steady motion at {left}, {right} rad/s")


def runs(count, seed, noise=(0.012, 0.012, 0.03), **surface):
    """Sprocket speeds left, right (N,) [rad/s], motion (N, 3) with measurement noise."""
    rng = np.random.default_rng(seed)
    left, right = rng.uniform(-5.0, 5.0, (2, count))
    exact = np.array([motion(*speeds, **surface) for speeds in zip(left, right, strict=True)])
    return left, right, exact + rng.normal(size=exact.shape) * noise


def spoilt(left, right, motion, kind, count, seed):
    """The same with `count` runs of a fault, and which (N,)."""
    rng = np.random.default_rng(1000 + seed)
    bad = np.zeros(len(left), dtype=bool)
    bad[rng.permutation(len(left))[:count]] = True
    left, right, motion = left.copy(), right.copy(), motion.copy()
    if kind == "hull turned by 180 degrees":
        motion[bad, :2] *= -1.0
    elif kind == "left and right swapped":
        left[bad], right[bad] = right[bad], left[bad]
    elif kind == "sign of yaw":
        motion[bad, 2] *= -1.0
    elif kind == "dead encoder":
        side = rng.random(len(left)) < 0.5
        left[bad & side] = right[bad & ~side] = 0.0
    elif kind == "shifted in time":
        motion[bad] = np.roll(motion, 1, axis=0)[bad]
    return left, right, motion, bad
