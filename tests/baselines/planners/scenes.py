"""An oracle of its own for plans among obstacles, and random scenes.

Distances between the rectangle and convex polygons by separating axes and corner-edge distances,
over whole arrays of poses; motions are sampled every fraction of a millisecond, anew.
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.planners.obstacles import Obstacles


def corners_of(poses, box):
    """(M, 4, 2) corners of rectangles front, back, left, right at poses (M, 3)."""
    front, back, left, right = box
    local = np.array([[front, left], [-back, left], [-back, -right], [front, -right]])
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turn = np.stack([np.stack([cos, -sin], 1), np.stack([sin, cos], 1)], 1)
    return np.einsum("mij,kj->mki", turn, local) + poses[:, None, :2]


def _points_to_edges(points, ring):
    """Least distance of points (M, A, 2) from the edges of rings (M or 1, K, 2), over A and K."""
    a, b = ring[:, None], np.roll(ring, -1, axis=1)[:, None]
    e, p = b - a, points[:, :, None] - a
    part = np.clip((p * e).sum(-1) / np.maximum((e * e).sum(-1), 1e-300), 0.0, 1.0)
    return np.linalg.norm(p - part[..., None] * e, axis=-1).min(axis=(1, 2))


def _overlap(one, other):
    """Whether convex rings (M, A, 2) and (1, K, 2) overlap: no axis separates them."""
    apart = np.zeros(len(one), dtype=bool)
    for ring in (one, np.broadcast_to(other, (len(one), *other.shape[1:]))):
        edge = np.roll(ring, -1, axis=1) - ring
        normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
        u = np.einsum("mkc,mac->mka", normal, one)
        v = np.einsum("mkc,mac->mka", normal, np.broadcast_to(other, (len(one), *other.shape[1:])))
        apart |= ((u.max(2) < v.min(2)) | (v.max(2) < u.min(2))).any(axis=1)
    return ~apart


def least_distance(poses, box, circles=(), convex=()):
    """Least distance [m] between a rectangle at poses (M, 3) and circles or convex polygons."""
    body, least = corners_of(poses, box), math.inf
    front, back, left, right = box
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    for x, y, radius in circles:
        p, q = x - poses[:, 0], y - poses[:, 1]
        u, v = cos * p + sin * q, cos * q - sin * p
        away = np.hypot(np.maximum(0.0, np.maximum(u - front, -back - u)),
                        np.maximum(0.0, np.maximum(v - left, -right - v)))  # fmt: skip
        least = min(least, float(away.min()) - radius)
    for polygon in convex:
        ring = np.asarray(polygon, dtype=float)[None]
        reach = np.hypot(max(front, back), max(left, right))
        low, high = ring[0].min(0) - reach - 0.5, ring[0].max(0) + reach + 0.5
        near = np.all((poses[:, :2] >= low) & (poses[:, :2] <= high), axis=1)
        if not near.any():
            continue
        some = body[near]
        away = np.minimum(
            _points_to_edges(some, ring),
            _points_to_edges(np.broadcast_to(ring, (len(some), *ring.shape[1:])), some),
        )
        least = min(least, float(np.where(_overlap(some, ring), 0.0, away).min()))
    return least


def poses_of(made):
    """Poses (M, 3) of a trajectory."""
    return np.stack([made.x, made.y, made.yaw], axis=1)


class Scene(NamedTuple):
    """Obstacles twice: for the planner, and as convex shapes for the oracle."""

    circles: np.ndarray
    convex: list
    obstacles: Obstacles


def bar(x, y, yaw, length, thickness):
    """A rectangle (4, 2) around (x, y)."""
    return corners_of(
        np.array([[x, y, yaw]]), np.array([length, length, thickness, thickness]) / 2
    )[0]


def cells_of(occupied, cell, origin):
    """Squares (4, 2) of occupied cells in the world; origin x, y, yaw."""
    x0, y0, yaw = origin
    rows, columns = np.nonzero(occupied)
    u, v = columns * cell, rows * cell
    x, y = x0 + math.cos(yaw) * u - math.sin(yaw) * v, y0 + math.sin(yaw) * u + math.cos(yaw) * v
    return [bar(a, b, yaw, cell, cell) for a, b in zip(x, y, strict=True)]


def random_scene(rng, box, start, goal, size, margin=0.05, number=8):
    """Circles, bars, thin walls, and sometimes a turned map, that leave start and goal clear."""
    ends, span = np.array([start, goal], dtype=float), size
    circles, bars = [], []
    clear = 2.0 * margin + 0.02

    def place():
        middle = 0.5 * (ends[0, :2] + ends[1, :2])
        return middle + rng.uniform(-span, span, 2)

    for _ in range(number):
        x, y = place()
        if rng.random() < 0.4:
            ring = [(x, y, rng.uniform(0.05, 0.15) * size)]
            if least_distance(ends, box, circles=ring) > clear:
                circles += ring
        else:
            thin = rng.choice([1e-3, 0.01, 0.05, 0.2])
            wall = bar(x, y, rng.uniform(0, np.pi), rng.uniform(0.2, 0.9) * size, thin)
            if least_distance(ends, box, convex=[wall]) > clear:
                bars.append(wall)
    grid = {}
    squares = []
    if rng.random() < 0.4:
        occupied = rng.random((8, 8)) < 0.1
        cell, origin = 0.06 * size, (*place(), rng.uniform(-3, 3))
        squares = cells_of(occupied, cell, origin)
        if not squares or least_distance(ends, box, convex=squares) > clear:
            grid = {"occupied": occupied, "cell": cell, "origin": origin}
        else:
            squares = []
    made = Obstacles.of(circles=circles, polygons=bars, **grid)
    return Scene(np.array(circles).reshape(-1, 3), [*bars, *squares], made)
