"""Pairs of poses for the tests of planners, degenerate ones among them, and ways to drive."""

import csv
import math

import numpy as np
import pytest

HALF = 0.5 * math.pi


def random_pairs(count, seed=0, size=4.0):
    """Starts and goals (N, 3): some at one place, straight ahead, straight behind, opposed."""
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-size, size, (2, count, 3))
    few = count // 8
    goal[:few, :2] = start[:few, :2]
    ahead = rng.uniform(-size, size, few)
    goal[few : 2 * few, :2] = start[few : 2 * few, :2] + ahead[:, None] * np.stack(
        [np.cos(start[few : 2 * few, 2]), np.sin(start[few : 2 * few, 2])], axis=1
    )
    goal[few : 2 * few, 2] = start[few : 2 * few, 2]
    goal[2 * few : 3 * few, 2] = start[2 * few : 3 * few, 2] + math.pi
    return start, goal


def drive(start, lengths, curvatures):
    """The pose at the end of signed lengths [m] at constant curvatures [1/m], in closed form."""
    x, y, yaw = start
    for length, curvature in zip(lengths, curvatures, strict=True):
        turned = yaw + curvature * length
        if curvature == 0.0:
            x, y = x + length * math.cos(yaw), y + length * math.sin(yaw)
        else:
            x += (math.sin(turned) - math.sin(yaw)) / curvature
            y -= (math.cos(turned) - math.cos(yaw)) / curvature
        yaw = turned
    return np.array([x, y, yaw])


def missed(pose, goal):
    """The larger of distance [m] and wrapped yaw [rad] between two poses."""
    away = np.asarray(goal) - pose
    return max(math.hypot(away[0], away[1]), abs(math.remainder(away[2], 2.0 * math.pi)))


def published_targets(reference_data, column):
    """Goals (N, 3) of F 7.2.1 and a column (N,) of their file; skips where that is absent."""
    path = reference_data / "planners" / "targets.csv"
    if not path.exists():
        pytest.skip(f"no targets at {path}: they are not part of the project")
    with path.open() as file:
        rows = list(csv.DictReader(file))
    goals = np.array([[float(row[name]) for name in ("x", "y", "yaw")] for row in rows])
    return goals, np.array([float(row[column]) for row in rows])
