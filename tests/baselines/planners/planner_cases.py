"""Poses, vehicles, limits and scenes for the tests of planners, and ways to drive."""

import csv
import math
import re
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import qmc

from baselines.planners.obstacles import Obstacles
from baselines.planners.slip_surface import COLUMNS, ROWS, SlipSurface, motion_jets
from baselines.planners.trajectory import Limits
from baselines.slip.slip_sweep import identified_slip, with_friction
from tracked_env.physics.parameters import VEHICLES

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


def refused(call, message, error=ValueError):
    """That a call raises an error of one line that has the message (a regular expression)."""
    with pytest.raises(error) as raised:
        call()
    text = str(raised.value)
    assert re.search(message, text) and "\n" not in text, text


def end_of_plan(plan):
    """Its last pose (3,)."""
    return np.array([plan.x[-1], plan.y[-1], plan.yaw[-1]])


GOAL = (2.0, 2.5, -0.4)  # F, figure 16
ORIGIN = (0.0, 0.0, 0.0)


def vehicle_on(mu, name="focchi", limit=18.0):
    """A vehicle of F on friction mu with fast sprockets, and its slip."""
    vehicle = with_friction(VEHICLES[name], mu)._replace(sprocket_speed_limit=limit)
    return vehicle, identified_slip(vehicle)


FOCCHI, SLIP = vehicle_on(0.4)


def limits_of(vehicle, v_min, **options):
    """Limits of F 7.2: up to 0.4 m/s."""
    return Limits.of(vehicle, **{"v_min": v_min, "v_max": 0.4, "acceleration": math.inf, **options})


def halton_goals(nearest):
    """The first hundred goals that the code of F draws in an annulus from `nearest` to 4 m."""
    draws = qmc.Halton(d=3, scramble=True, seed=0).random(400)
    x, y, yaw = 4.0 * (2.0 * draws[:, 0] - 1.0), 4.0 * (2.0 * draws[:, 1] - 1.0), draws[:, 2]
    distance = np.hypot(x, y)
    inside = (nearest < distance) & (distance < 4.0)
    return np.stack([x, y, 2.0 * math.pi * yaw], axis=1)[inside][:100]


def random_goals(count=500):
    """Goals from 0.1 to 4 m away, in any direction and yaw."""
    rng = np.random.default_rng(1)
    distance, direction = rng.uniform(0.1, 4.0, count), rng.uniform(-math.pi, math.pi, count)
    yaw = rng.uniform(-math.pi, math.pi, count)
    return np.stack([distance * np.cos(direction), distance * np.sin(direction), yaw], axis=1)


def belts_of(vehicle, plan):
    """Belt speeds p, q [m/s] (N,) of a plan's intervals."""
    left, right = plan.sprocket_left[:-1], plan.sprocket_right[:-1]
    return 0.5 * vehicle.sprocket_radius * np.stack([left + right, right - left])


def replayed(model, plan, parts=8):
    """The pose at the end of a plan's sprocket speeds on a pseudo-kinematic model."""
    pose = np.array([[plan.x[0], plan.y[0], plan.yaw[0]]])
    for k, duration in enumerate(np.diff(plan.time)):
        speeds = np.array([[plan.sprocket_left[k], plan.sprocket_right[k]]])
        for _ in range(parts):
            pose = model.step(pose, speeds, duration / parts)
    return pose[0]


def motion_on(surface, p, q):
    """(N, 3) v_x, v_y [m/s], w [rad/s] of a surface at belt speeds p, q [m/s], in both gears."""
    p, q = np.broadcast_arrays(np.atleast_1d(p), np.atleast_1d(q))
    work = np.empty((3, ROWS)), np.empty((3, 2 * COLUMNS))
    jets = [motion_jets(surface, abs(a), b, *work) for a, b in zip(p, q, strict=True)]
    motion = np.array([[jet[0] for jet in each] for each in jets])
    return motion * np.where(p[:, None] < 0.0, [-1.0, -1.0, 1.0], 1.0)


class SurfaceSlip(NamedTuple):
    """The slip model of a slip surface."""

    surface: SlipSurface

    def slip(self, sprocket_left, sprocket_right):
        left, right = (self.surface.radius * side for side in (sprocket_left, sprocket_right))
        v_x, v_y, turn = motion_on(self.surface, 0.5 * (left + right), 0.5 * (right - left)).T
        across = self.surface.half_gauge * turn
        return left - (v_x - across), right - (v_x + across), np.arctan(v_y / v_x)


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
    others = np.broadcast_to(other, (len(one), *other.shape[1:]))
    for ring in (one, others):
        edge = np.roll(ring, -1, axis=1) - ring
        normal = np.stack([-edge[..., 1], edge[..., 0]], axis=-1)
        u, v = (np.einsum("mkc,mac->mka", normal, corners) for corners in (one, others))
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
        along, across = np.maximum(u - front, -back - u), np.maximum(v - left, -right - v)
        away = np.hypot(np.maximum(0.0, along), np.maximum(0.0, across))
        least = min(least, float(away.min()) - radius)
    for polygon in convex:
        ring = np.asarray(polygon, dtype=float)[None]
        reach = np.hypot(max(front, back), max(left, right))
        low, high = ring[0].min(0) - reach - 0.5, ring[0].max(0) + reach + 0.5
        near = np.all((poses[:, :2] >= low) & (poses[:, :2] <= high), axis=1)
        if not near.any():
            continue
        some = body[near]
        rings = np.broadcast_to(ring, (len(some), *ring.shape[1:]))
        away = np.minimum(_points_to_edges(some, ring), _points_to_edges(rings, some))
        least = min(least, float(np.where(_overlap(some, ring), 0.0, away).min()))
    return least


def poses_of(plan):
    """Poses (M, 3) of a trajectory."""
    return np.stack([plan.x, plan.y, plan.yaw], axis=1)


class Scene(NamedTuple):
    """Obstacles twice: for the planner, and as convex shapes for the oracle."""

    circles: np.ndarray
    convex: list
    obstacles: Obstacles


def bar(x, y, yaw, length, thickness):
    """A rectangle (4, 2) around (x, y)."""
    box = np.array([length, length, thickness, thickness]) / 2
    return corners_of(np.array([[x, y, yaw]]), box)[0]


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
    obstacles = Obstacles.of(circles=circles, polygons=bars, **grid)
    return Scene(np.array(circles).reshape(-1, 3), [*bars, *squares], obstacles)
