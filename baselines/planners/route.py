"""A route around obstacles: hybrid A* over arcs and lines, with a closed form at its end.

States are cells of (x, y, yaw); from each, arcs of STEP length to the left, to the right and
straight on are driven exactly, in reverse too and with turns on the spot where these are allowed,
so that every state keeps the pose in which it was reached. The order of expansion is the cost so
far plus a lower bound: the larger of the distance around the obstacles on the grid (Dijkstra, disc
of the vehicle's half width) and the straight line. Now and then, and near the goal always, a path
in closed form to the goal is tried: Dubins, Reeds-Shepp where it may reverse, and a turn, a line
and a turn where it may turn on the spot.

The route is feasible for the turning radius, and near the shortest: cells are coarse. Every pose
along it has been checked against the clearance, every CHECKED metres.

References: [1] Dolgov, Thrun, Montemerlo and Diebel, Path planning for autonomous vehicles in
unknown semi-structured environments, International Journal of Robotics Research 29 (2010).
"""

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.dubins import SIGNS, SNAP, segments_of_words
from baselines.planners.obstacles import Clearance, Footprint, clearances, vehicle_clearance
from baselines.planners.path import Path, places
from baselines.planners.reeds_shepp import PARTS, SIDES, shortest_word
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.jit import copy_table, formula, loop

Array = NDArray[np.float64]

CELL = 0.1  # [m] of a state, at least
YAWS = 48  # cells of the yaw
MOST_STATES = 1_500_000
CHECKED = 0.03  # [m] between poses that are checked, of the centre and by turning
ARCS = 5  # curvatures of a step: -1, -1/2, 0, 1/2, 1 over the radius
EVERY = 16  # states between two tries of a closed form
TURNING_COST = 1.05  # [-] of way on an arc: straight on where it does not matter
REVERSE_COST = 1.5  # [-] of way in reverse
CHANGE_COST = 0.3  # [m] of a change of gear
GREED = 1.1  # [-] times the lower bound: a route may be longer by that, and is found far sooner
PIVOT = 1e-3  # [m] radius of the arc that stands for a turn on the spot
BATCH = 5_000  # states between two looks at the clock
BETTER = 0.5  # [s] for which a shorter route is looked for once there is one
TURN = 2.0 * math.pi


class Grid(NamedTuple):
    """Cells over a rectangle."""

    x: float  # [m] of its corner
    y: float  # [m]
    columns: int
    rows: int
    cell: float  # [m]


class Moves(NamedTuple):
    """What the vehicle may do, and what it costs."""

    way: Array  # [m] (K,) of one step, signed
    curvature: Array  # [1/m] (K,)
    cost: Array  # [m] (K,)
    radius: float  # [m] least turning radius
    half_gauge: float  # [m] way of a track per angle of a turn on the spot
    reverse: bool
    pivot: bool  # whether it may turn on the spot


class Search(NamedTuple):
    """The memory of a search over C states."""

    poses: Array  # (C, 3)
    cost: Array  # [m] (C,)
    parent: NDArray[np.int64]  # (C,) state before it, -1 for the start
    move: NDArray[np.int64]  # (C,) that led to it
    closed: NDArray[np.bool_]  # (C,)
    heap: NDArray[np.int64]
    keys: Array  # [m] of the heap
    ahead: Array  # [m] (cells,) least way to the goal around the obstacles
    shot: Array  # (PARTS, 2) way, curvature of the closed form at the end
    counts: NDArray[np.int64]  # size of the heap, expanded states, last state of the best route
    best: Array  # [m] (1,) cost of the best route


class Route(NamedTuple):
    """A path around obstacles, or none."""

    path: Path | None  # None: no free path was found
    expanded: int  # states
    least_clearance: float  # [m] along the path, margin taken off
    exhausted: bool  # every state was tried; False: a path was found, or time was up


@formula
def _moved(x, y, yaw, way, curvature):
    """The pose after a way [m] at a curvature [1/m]."""
    half = 0.5 * curvature * way
    chord = way if half == 0.0 else way * math.sin(half) / half
    return x + chord * math.cos(yaw + half), y + chord * math.sin(yaw + half), yaw + 2.0 * half


@loop
def _free(field, footprint, x, y, yaw, way, curvature):
    """Whether the vehicle touches nothing along an arc."""
    swept = abs(way) * (1.0 + abs(curvature) * footprint.offset[-1])
    parts = max(1, math.ceil(swept / CHECKED))
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


@formula
def _clear(pieces):
    """No pieces."""
    for part in range(PARTS):
        pieces[part, 0] = pieces[part, 1] = 0.0


@loop
def _try(field, footprint, x, y, yaw, pieces, price, best, shot):
    """Cost [m] of pieces (PARTS, 2) from a pose, into `shot` where free and below `best`; else inf.

    price: what is added to the ways.
    """
    total, gear = price, 0.0
    for part in range(PARTS):
        way = pieces[part, 0]
        if abs(pieces[part, 1]) < 0.5 / PIVOT:
            total += abs(way) * (1.0 if way >= 0.0 else REVERSE_COST)
            sign = (way > 0.0) - (way < 0.0)
            total += CHANGE_COST if gear * sign < 0.0 else 0.0
            gear = sign if sign != 0.0 else gear
    if not total < best:
        return math.inf
    for part in range(PARTS):
        way, bend = pieces[part, 0], pieces[part, 1]
        if not _free(field, footprint, x, y, yaw, way, bend):
            return math.inf
        x, y, yaw = _moved(x, y, yaw, way, bend)
    copy_table(pieces, shot)
    return total


@loop
def _shoot(field, footprint, x, y, yaw, goal, moves, best, pieces, words, lengths, shot):
    """Cost [m] of the best free closed form to the goal below `best`, its pieces into `shot`."""
    radius = moves.radius
    away_x, away_y = goal[0] - x, goal[1] - y
    cos, sin = math.cos(yaw), math.sin(yaw)
    ahead, aside = (cos * away_x + sin * away_y) / radius, (cos * away_y - sin * away_x) / radius
    segments_of_words(ahead, aside, goal[2] - yaw, SNAP, words)
    found = math.inf
    for word in range(6):
        _clear(pieces)
        for part in range(3):
            pieces[part, 0] = words[word, part] * radius
            pieces[part, 1] = SIGNS[word, part] / radius
        if words[word, 0] + words[word, 1] + words[word, 2] < math.inf:
            found = min(
                found,
                _try(field, footprint, x, y, yaw, pieces, 0.0, min(best, found), shot),
            )
    if moves.reverse:
        turned = wrap_angle(goal[2] - yaw)
        trial, ways, sides = lengths[0], lengths[1], lengths[2]
        if shortest_word(ahead, aside, turned, SIDES, trial, ways, sides) < math.inf:
            for part in range(PARTS):
                pieces[part, 0], pieces[part, 1] = ways[part] * radius, sides[part] / radius
            found = min(
                found,
                _try(field, footprint, x, y, yaw, pieces, 0.0, min(best, found), shot),
            )
    if moves.pivot:
        line = math.hypot(away_x, away_y)
        for gear in (1.0, -1.0) if moves.reverse else (1.0, 1.0):
            course = math.atan2(gear * away_y, gear * away_x) if line > 1e-9 else yaw
            first, last = wrap_angle(course - yaw), wrap_angle(goal[2] - course)
            _clear(pieces)
            pieces[0, 0], pieces[0, 1] = PIVOT * abs(first), math.copysign(1.0 / PIVOT, first)
            pieces[1, 0] = gear * line
            pieces[2, 0], pieces[2, 1] = PIVOT * abs(last), math.copysign(1.0 / PIVOT, last)
            price = moves.half_gauge * (abs(first) + abs(last))
            found = min(
                found,
                _try(field, footprint, x, y, yaw, pieces, price, min(best, found), shot),
            )
    return found


@loop
def _expand(field, footprint, grid, goal, moves, search, budget):
    """Expand at most `budget` states; returns whether the search has ended."""
    words, pieces, shot = np.empty((6, 3)), np.empty((PARTS, 2)), np.empty((PARTS, 2))
    lengths = np.empty((3, PARTS))
    heap, keys, closed, cost, poses = (
        search.heap, search.keys, search.closed, search.cost, search.poses,
    )  # fmt: skip
    size, expanded, best = search.counts[0], search.counts[1], search.best[0]
    until = expanded + budget
    while size > 0 and keys[0] < best and expanded < until:
        here = _pop(heap, keys, size)
        size -= 1
        if closed[here]:
            continue
        closed[here] = True
        x, y, yaw = poses[here, 0], poses[here, 1], poses[here, 2]
        ahead = search.ahead[here // YAWS]
        if expanded % EVERY == 0 or ahead < 4.0 * moves.radius:
            found = _shoot(
                field, footprint, x, y, yaw, goal, moves, best - cost[here], pieces, words,
                lengths, shot,
            )  # fmt: skip
            if cost[here] + found < best:
                best, search.counts[2] = cost[here] + found, here
                copy_table(shot, search.shot)
        expanded += 1
        came = search.move[here]
        before = moves.way[came] if came >= 0 and abs(moves.curvature[came]) < 0.5 / PIVOT else 0.0
        for move in range(len(moves.way)):
            way, curvature = moves.way[move], moves.curvature[move]
            to_x, to_y, to_yaw = _moved(x, y, yaw, way, curvature)
            cell = _cell(grid, to_x, to_y, to_yaw)
            if cell < 0 or closed[cell] or not search.ahead[cell // YAWS] < math.inf:
                continue
            price = cost[here] + moves.cost[move] + (CHANGE_COST if before * way < 0.0 else 0.0)
            if price >= cost[cell] - 1e-9 or size >= len(heap) - 1:
                continue
            if not _free(field, footprint, x, y, yaw, way, curvature):
                continue
            cost[cell], search.parent[cell], search.move[cell] = price, here, move
            poses[cell, 0], poses[cell, 1], poses[cell, 2] = to_x, to_y, to_yaw
            line = math.hypot(goal[0] - to_x, goal[1] - to_y)
            bound = GREED * max(line, search.ahead[cell // YAWS] * 0.92)
            size = _push(heap, keys, size, price + bound, cell)
    search.counts[0], search.counts[1], search.best[0] = size, expanded, best
    return not (size > 0 and keys[0] < best)


@formula
def _cell(grid, x, y, yaw):
    """Number of the state's cell, -1 outside."""
    column, row = math.floor((x - grid.x) / grid.cell), math.floor((y - grid.y) / grid.cell)
    if not (0 <= column < grid.columns and 0 <= row < grid.rows):
        return -1
    turned = yaw - TURN * math.floor(yaw / TURN)
    return (row * grid.columns + column) * YAWS + int(turned / TURN * YAWS) % YAWS


def _moves(radius: float, half_gauge: float, cell: float, reverse: bool, pivot: bool) -> Moves:
    """Steps that reach another cell, over position or yaw."""
    step, angle = max(1.5 * cell, radius * TURN / YAWS * 1.5), 1.5 * TURN / YAWS
    bends = np.linspace(-1.0, 1.0, ARCS) / radius
    price = step * np.where(bends != 0.0, TURNING_COST, 1.0)
    ways, curvatures, costs = [np.full(ARCS, step)], [bends], [price]
    if reverse:
        ways, curvatures = [*ways, np.full(ARCS, -step)], [*curvatures, bends]
        costs.append(REVERSE_COST * price)
    if pivot:
        ways.append(np.full(2, PIVOT * angle))
        curvatures.append(np.array([-1.0, 1.0]) / PIVOT)
        costs.append(np.full(2, half_gauge * angle))
    way, curvature, cost = (np.concatenate(of) for of in (ways, curvatures, costs))
    return Moves(way, curvature, cost, float(radius), float(half_gauge), reverse, pivot)


def find_route(
    start: ArrayLike, goal: ArrayLike, radius: float, field: Clearance, footprint: Footprint,
    reverse: bool = False, half_gauge: float | None = None, time_limit: float = 10.0,
) -> Route:  # fmt: skip
    """A free path of arcs and lines from one pose to another, x, y [m], yaw [rad].

    radius: least turning radius [m]. reverse: whether it may change the gear. half_gauge [m]: of a
    vehicle that may turn on the spot; None: it may not. The search stays within the field and ends
    after time_limit [s], and soon after it has found one.
    """
    begin, end = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    high, wide = ((n - 1) * field.spacing for n in field.distance.shape)
    cell = max(CELL, math.sqrt(high * wide * YAWS / MOST_STATES))
    rows, columns = max(int(high / cell), 1), max(int(wide / cell), 1)
    grid = Grid(field.x, field.y, columns, rows, cell)
    ahead = np.empty(columns * rows)
    # The middle disc cannot come nearer: a lower bound, whatever the yaw.
    narrow = footprint.radius - field.spacing - 0.5 * (cell - CELL)
    _distances(field, narrow, grid, end[0], end[1], ahead)
    count = columns * rows * YAWS
    moves = _moves(radius, half_gauge or 0.0, cell, reverse, half_gauge is not None)
    search = Search(
        np.empty((count, 3)), np.full(count, math.inf), np.empty(count, np.int64),
        np.empty(count, np.int64), np.zeros(count, np.bool_), np.empty(4 * count + 64, np.int64),
        np.empty(4 * count + 64), ahead, np.zeros((PARTS, 2)), np.array([0, 0, -1]),
        np.array([math.inf]),
    )  # fmt: skip
    first = _cell(grid, begin[0], begin[1], begin[2])
    search.cost[first], search.parent[first], search.move[first] = 0.0, -1, -1
    search.poses[first] = begin
    search.counts[0] = _push(search.heap, search.keys, 0, 0.0, first)
    until, ended = time.monotonic() + time_limit, False
    while not ended and time.monotonic() < until:
        ended = _expand(field, footprint, grid, end, moves, search, BATCH)
        if search.counts[2] >= 0:
            until = min(until, time.monotonic() + BETTER)
    expanded, last = int(search.counts[1]), int(search.counts[2])
    if last < 0:
        return Route(None, expanded, -math.inf, ended)
    steps = []
    while search.parent[last] >= 0:
        steps.append(search.move[last])
        last = search.parent[last]
    lengths = [*moves.way[steps[::-1]], *search.shot[:, 0]]
    path = _merged(begin, lengths, [*moves.curvature[steps[::-1]], *search.shot[:, 1]])
    at = places(path, np.linspace(0.0, path.whole_length, 1 + int(path.whole_length / CHECKED)))
    poses = np.stack([at.x, at.y, at.yaw], axis=1)
    return Route(path, expanded, float(clearances(field, footprint, poses).min()), False)


def _merged(start: Array, lengths: list[float], curvatures: list[float]) -> Path:
    """A path in which neighbours of one curvature and gear are one piece."""
    pieces: list[list[float]] = []
    for length, curvature in zip(lengths, curvatures, strict=True):
        if pieces and pieces[-1][1] == curvature and pieces[-1][0] * length > 0.0:
            pieces[-1][0] += length
        elif length != 0.0:
            pieces.append([length, curvature])
    return Path.of(start, [piece[0] for piece in pieces], [piece[1] for piece in pieces])
