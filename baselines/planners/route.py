"""A route around obstacles: hybrid A* over arcs and lines, with a Dubins path at its end.

States are cells of (x, y, yaw); from each, arcs of STEP length to the left, to the right and
straight on are driven exactly, so that every state keeps the pose in which it was reached. The
order of expansion is the way so far plus a lower bound: the larger of the distance around the
obstacles on the grid (Dijkstra, disc of the vehicle's half width) and the straight line. Now and
then, and near the goal always, the Dubins path to the goal ends the search if it is free.

The route is feasible for the turning radius, and near the shortest: cells are coarse. Every pose
along it has been checked against the clearance, every CHECKED metres.

References: [1] Dolgov, Thrun, Montemerlo and Diebel, Path planning for autonomous vehicles in
unknown semi-structured environments, International Journal of Robotics Research 29 (2010).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.dubins import SIGNS, SNAP, segments_of_words
from baselines.planners.obstacles import Clearance, Footprint, clearances, vehicle_clearance
from baselines.planners.path import Path, places
from tracked_env.physics.jit import copy_entries, formula, loop

Array = NDArray[np.float64]

CELL = 0.1  # [m] of a state
YAWS = 48  # cells of the yaw
CHECKED = 0.03  # [m] between poses that are checked
ARCS = 5  # curvatures of a step: -1, -1/2, 0, 1/2, 1 over the radius
EVERY = 16  # states between two tries of a Dubins path
TURNING_COST = 1.05  # [-] of way on an arc: straight on where it does not matter
TURN = 2.0 * math.pi


class Grid(NamedTuple):
    """Cells over a rectangle."""

    x: float  # [m] of its corner
    y: float  # [m]
    columns: int
    rows: int
    cell: float  # [m]


class Route(NamedTuple):
    """A path around obstacles, or none."""

    path: Path | None  # None: no free path was found
    expanded: int  # states
    least_clearance: float  # [m] along the path, margin taken off


@formula
def _moved(x, y, yaw, way, curvature):
    """The pose after a way [m] at a curvature [1/m]."""
    half = 0.5 * curvature * way
    chord = way if half == 0.0 else way * math.sin(half) / half
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + 2.0 * half


@loop
def _free(field, footprint, x, y, yaw, way, curvature):
    """Whether the vehicle touches nothing along an arc."""
    parts = max(1, math.ceil(way / CHECKED))
    for part in range(1, parts + 1):
        at = _moved(x, y, yaw, way * part / parts, curvature)
        if vehicle_clearance(field, footprint, at[0], at[1], at[2]) <= 0.0:
            return False
    return True


@loop
def _push(heap, keys, size, key, value):
    """Add to a binary heap; returns its size."""
    at = size
    while at > 0:
        parent = (at - 1) // 2
        if keys[parent] <= key:
            break
        keys[at], heap[at] = keys[parent], heap[parent]
        at = parent
    keys[at], heap[at] = key, value
    return size + 1


@loop
def _pop(heap, keys, size):
    """Take the least from a binary heap: its value; one less is in it."""
    top, last_key, last = heap[0], keys[size - 1], heap[size - 1]
    size -= 1
    at = 0
    while 2 * at + 1 < size:
        child = 2 * at + 1
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= last_key:
            break
        keys[at], heap[at] = keys[child], heap[child]
        at = child
    keys[at], heap[at] = last_key, last
    return top


@loop
def _distances(field, least, grid, goal_x, goal_y, away):
    """Way [m] to the goal around the obstacles from every cell, 8 neighbours (Dijkstra)."""
    count = grid.columns * grid.rows
    heap, keys = np.empty(8 * count, np.int64), np.empty(8 * count)
    away[:] = math.inf
    column = min(max(int((goal_x - grid.x) / grid.cell), 0), grid.columns - 1)
    row = min(max(int((goal_y - grid.y) / grid.cell), 0), grid.rows - 1)
    away[row * grid.columns + column] = 0.0
    size = _push(heap, keys, 0, 0.0, row * grid.columns + column)
    while size > 0:
        key, here = keys[0], _pop(heap, keys, size)
        size -= 1
        if key > away[here]:
            continue
        row, column = here // grid.columns, here % grid.columns
        for down in range(-1, 2):
            for aside in range(-1, 2):
                r, c = row + down, column + aside
                if not (0 <= r < grid.rows and 0 <= c < grid.columns):
                    continue
                u = int((grid.x + (c + 0.5) * grid.cell - field.x) / field.spacing + 0.5)
                v = int((grid.y + (r + 0.5) * grid.cell - field.y) / field.spacing + 0.5)
                v, u = min(v, field.distance.shape[0] - 1), min(u, field.distance.shape[1] - 1)
                if field.distance[v, u] < least:
                    continue
                way = key + grid.cell * math.sqrt(down * down + aside * aside)
                if way < away[r * grid.columns + c] - 1e-12:
                    away[r * grid.columns + c] = way
                    size = _push(heap, keys, size, way, r * grid.columns + c)


@loop
def _shot(field, footprint, x, y, yaw, goal, radius, words, out):
    """The shortest free Dubins path to the goal: its word into out[0], segments into out[1:4]."""
    away_x, away_y = goal[0] - x, goal[1] - y
    cos, sin = math.cos(yaw), math.sin(yaw)
    segments_of_words(
        (cos * away_x + sin * away_y) / radius, (cos * away_y - sin * away_x) / radius,
        goal[2] - yaw, SNAP, words,
    )  # fmt: skip
    best = math.inf
    for word in range(6):
        total = words[word, 0] + words[word, 1] + words[word, 2]
        if not total < best:
            continue
        at_x, at_y, at_yaw, free = x, y, yaw, True
        for part in range(3):
            way, bend = words[word, part] * radius, SIGNS[word, part] / radius
            free = free and _free(field, footprint, at_x, at_y, at_yaw, way, bend)
            at_x, at_y, at_yaw = _moved(at_x, at_y, at_yaw, way, bend)
        if free:
            best = total
            out[0] = word
            for part in range(3):
                out[1 + part] = words[word, part] * radius
    return best * radius


@loop
def _search(
    field, footprint, grid, start, goal, radius, step, away, poses, cost, parent, bend, shot
):
    """States by number of cell; returns (last state, number expanded), last -1: none found."""
    count = len(cost)
    heap, keys = np.empty(4 * count + 64, np.int64), np.empty(4 * count + 64)
    closed = np.zeros(count, np.bool_)
    words, trial = np.empty((6, 3)), np.empty(4)
    cost[:] = math.inf
    first = _cell(grid, start[0], start[1], start[2])
    cost[first], parent[first] = 0.0, -1
    copy_entries(start, poses[first])
    size = _push(heap, keys, 0, 0.0, first)
    expanded, best, last = 0, math.inf, -1
    while size > 0 and keys[0] < best:
        here = _pop(heap, keys, size)
        size -= 1
        if closed[here]:
            continue
        closed[here] = True
        x, y, yaw = poses[here, 0], poses[here, 1], poses[here, 2]
        ahead = away[here // YAWS]
        if expanded % EVERY == 0 or ahead < 4.0 * radius:
            found = _shot(field, footprint, x, y, yaw, goal, radius, words, trial)
            if cost[here] + found < best:
                best, last = cost[here] + found, here
                copy_entries(trial, shot)
        expanded += 1
        for arc in range(ARCS):
            curvature = (2.0 * arc / (ARCS - 1) - 1.0) / radius
            to_x, to_y, to_yaw = _moved(x, y, yaw, step, curvature)
            cell = _cell(grid, to_x, to_y, to_yaw)
            if cell < 0 or closed[cell] or not away[cell // YAWS] < math.inf:
                continue
            way = cost[here] + step * (TURNING_COST if curvature != 0.0 else 1.0)
            if way >= cost[cell] - 1e-9 or size >= len(heap) - 1:
                continue
            if not _free(field, footprint, x, y, yaw, step, curvature):
                continue
            cost[cell], parent[cell], bend[cell] = way, here, curvature
            poses[cell, 0], poses[cell, 1], poses[cell, 2] = to_x, to_y, to_yaw
            line = math.hypot(goal[0] - to_x, goal[1] - to_y)
            size = _push(heap, keys, size, way + max(line, away[cell // YAWS] * 0.92), cell)
    return last, expanded


@formula
def _cell(grid, x, y, yaw):
    """Number of the state's cell, -1 outside."""
    column, row = math.floor((x - grid.x) / grid.cell), math.floor((y - grid.y) / grid.cell)
    if not (0 <= column < grid.columns and 0 <= row < grid.rows):
        return -1
    turned = yaw - TURN * math.floor(yaw / TURN)
    return (row * grid.columns + column) * YAWS + int(turned / TURN * YAWS) % YAWS


def find_route(
    start: ArrayLike, goal: ArrayLike, radius: float, field: Clearance, footprint: Footprint
) -> Route:
    """A free path of arcs and lines from one pose to another, x, y [m], yaw [rad].

    radius: least turning radius [m]. The search stays within the field.
    """
    begin, end = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    rows, columns = (int((n - 1) * field.spacing / CELL) for n in field.distance.shape)
    grid = Grid(field.x, field.y, columns, rows, CELL)
    away = np.empty(columns * rows)
    # The middle disc cannot come nearer: a lower bound, whatever the yaw.
    _distances(field, footprint.radius - field.spacing, grid, end[0], end[1], away)
    count = columns * rows * YAWS
    poses, cost = np.empty((count, 3)), np.empty(count)
    parent, bend, shot = np.empty(count, np.int64), np.empty(count), np.empty(4)
    step = max(1.5 * CELL, radius * TURN / YAWS * 1.5)
    last, expanded = _search(
        field, footprint, grid, begin, end, float(radius), step, away, poses, cost, parent, bend,
        shot,
    )  # fmt: skip
    if last < 0:
        return Route(None, expanded, -math.inf)
    bends = []
    while parent[last] >= 0:
        bends.append(bend[last])
        last = parent[last]
    word = int(shot[0])
    lengths = [*np.full(len(bends), step), *shot[1:]]
    curvatures = [*bends[::-1], *(SIGNS[word] / radius)]
    path = _merged(begin, lengths, curvatures)
    at = places(path, np.linspace(0.0, path.whole_length, 1 + int(path.whole_length / CHECKED)))
    poses = np.stack([at.x, at.y, at.yaw], axis=1)
    return Route(path, expanded, float(clearances(field, footprint, poses).min()))


def _merged(start: Array, lengths: list[float], curvatures: list[float]) -> Path:
    """A path in which neighbours of one curvature are one piece."""
    pieces: list[list[float]] = []
    for length, curvature in zip(lengths, curvatures, strict=True):
        if pieces and pieces[-1][1] == curvature:
            pieces[-1][0] += length
        elif length > 0.0:
            pieces.append([length, curvature])
    return Path.of(start, [piece[0] for piece in pieces], [piece[1] for piece in pieces])
