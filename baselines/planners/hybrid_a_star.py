"""Hybrid A*: the states of a search, their costs and bounds, and paths straight to the goal.

States are cells of (x, y, yaw) and gear; from each, arcs of one length to the left, to the right
and straight on are driven exactly, so that every state keeps the pose in which it was reached. The
order of expansion is the cost so far plus GREED times a lower bound: the largest of the way around
the obstacles for the centre (Dijkstra), the straight line, and the Dubins or Reeds-Shepp path. Now
and then paths straight to the goal are tried: the words of Dubins, that of Reeds and Shepp, and
turn, line, turn. Ways near obstacles, in reverse, and changes of gear cost more.

References: [1] Dolgov, Thrun, Montemerlo and Diebel, Path planning for autonomous vehicles in
unknown semi-structured environments, International Journal of Robotics Research 29 (2010).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners import curves
from baselines.planners.curves import PARTS, TURN, relative, wrapped
from baselines.planners.obstacles import Scene, clearance_along, place_clearance
from baselines.planners.speed_along_path import moved
from tracked_env.physics.jit import copy_entries, formula, loop

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

YAWS = 48  # cells of the yaw, usually
ARCS = 5  # curvatures of a step: -1, -1/2, 0, 1/2, 1 over the radius
EVERY, EVERY_NEAR = 16, 4  # states between two tries of paths straight to the goal
NEAR_GOAL = 4.0  # [-] of the radius and the vehicle's
LARGEST_TURN = 1.0  # [rad] of a step
TURNING_COST = 1.05  # [-] of way on an arc: straight on where it does not matter
REVERSE_COST = 1.3  # [-] of way in reverse
CHANGE_COST = 0.5  # [-] of the vehicle's radius: of a change of gear
TIGHT_COST, AIRY = 1.0, 0.3  # [-] of way without clearance; of the vehicle's radius: enough of it
GREED = 1.5  # [-] of the lower bound: a route may cost so much more than the least
MOST_STATES = 1_000_000  # 90 MB
FORWARD, REVERSE, SPOT = 1, 2, 0  # kinds of motion, and of the state that they lead to


class Motions(NamedTuple):
    """What the vehicle may do on a route."""

    radius: float  # [m] least turning radius of arcs
    gears: int  # 1: forwards, -1: in reverse, 2: both
    spot: bool  # whether it may turn on the spot
    half_gauge: float  # [m] way of the tracks per turn on the spot
    costly: float = -1.0  # sign of the way that costs more where both gears are allowed

    @property
    def words(self) -> str:
        """As a message says it."""
        gears = {1: "forwards only", -1: "in reverse only", 2: "forwards and in reverse"}
        spot = "with turns on the spot" if self.spot else "without turns on the spot"
        return f"{gears[self.gears]}, {spot}, arcs of {self.radius:.3g} m or wider"


class Field(NamedTuple):
    """Where a search happens: obstacles, and a rectangle in cells."""

    scene: Scene
    motions: Motions
    goal: Array  # (3,)
    away: Array  # (rows * columns,) [m] way to the goal around the obstacles
    step: float  # [m] of a state
    x: float  # [m] of the rectangle's corner
    y: float  # [m]
    width: float  # [m]
    height: float  # [m]
    cell: float  # [m] of a state
    coarse: float  # [m] of the way around the obstacles
    columns: int  # of coarse cells
    rows: int
    yaws: int  # cells of the yaw


class Nodes(NamedTuple):
    """States, the hash table of their cells, and the heap of those that are open."""

    pose: Array  # (N, 3)
    cost: Array  # (N,)
    piece: Array  # (N, 2) that leads there
    parent: Whole  # (N,)
    cell: Whole  # (N,)
    kind: Whole  # (N,) of motion
    closed: NDArray[np.bool_]  # (N,)
    table: NDArray[np.int32]  # (T,) state + 1, 0: empty
    heap: Whole
    keys: Array
    progress: Whole  # (4,) size of the heap, states, expanded, border met
    best: Array  # (2,) cost of the best route, its last state
    shot: Array  # (PARTS, 2) pieces from there to the goal
    trial: Array  # (PARTS, 2)
    words: Array  # (6, 3)
    sides: Array  # (3, PARTS)

    @classmethod
    def empty(cls, most: int) -> "Nodes":
        """Room for `most` states."""
        states = np.empty((most, 3)), np.empty(most), np.empty((most, 2)), *np.empty((3, most), int)
        open_states = np.empty(4 * most, np.int64), np.empty(4 * most), np.zeros(4, np.int64)
        slots = np.zeros(1 << (2 * most - 1).bit_length(), np.int32)
        work = np.zeros((PARTS, 2)), np.zeros((PARTS, 2)), np.empty((6, 3)), np.zeros((3, PARTS))
        best = np.array([np.inf, -1.0])
        closed = np.zeros(most, np.bool_)
        return cls._make((*states, closed, slots, *open_states, best, *work))

    def begin(self, start: Array) -> None:
        """Let the start be the only open state."""
        self.table[:], self.closed[:] = 0, False
        self.progress[:], self.best[:] = (1, 1, 0, 0), (np.inf, -1.0)
        self.pose[0], self.cost[0], self.parent[0], self.kind[0] = start, 0.0, -1, -1
        self.cell[0], self.heap[0], self.keys[0] = -1, 0, 0.0

    def best_pieces(self) -> Array:
        """Pieces (P, 2) of the best route."""
        at, pieces = int(self.best[1]), []
        while self.parent[at] >= 0:
            pieces.append(self.piece[at].copy())
            at = int(self.parent[at])
        return np.array([*pieces[::-1], *self.shot])


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


@formula
def coarse_cell(field, x, y):
    """Number of the coarse cell of a place."""
    column = min(max(int((x - field.x) / field.coarse), 0), field.columns - 1)
    row = min(max(int((y - field.y) / field.coarse), 0), field.rows - 1)
    return row * field.columns + column


@loop
def distances(field, inner):
    """Way [m] to the goal from every coarse cell, 8 neighbours; whether it meets the border.

    inner [m]: clearance that the centre has wherever it can be.
    """
    coarse, columns, away = field.coarse, field.columns, field.away
    count, border = columns * field.rows, False
    blocked, least = np.empty(count, np.bool_), inner - math.sqrt(0.5) * coarse
    for cell in range(count):
        row, column = cell // columns, cell % columns
        x, y = field.x + (column + 0.5) * coarse, field.y + (row + 0.5) * coarse
        blocked[cell] = place_clearance(field.scene, x, y) < least
    heap, keys = np.empty(8 * count + 8, np.int64), np.empty(8 * count + 8)
    away[:] = math.inf
    first = coarse_cell(field, field.goal[0], field.goal[1])
    away[first] = 0.0
    size = _push(heap, keys, 0, 0.0, first)
    while size > 0:
        key, here = keys[0], _pop(heap, keys, size)
        size -= 1
        if key > away[here]:
            continue
        row, column = here // columns, here % columns
        for down in range(-1, 2):
            for aside in range(-1, 2):
                r, c = row + down, column + aside
                if not (0 <= r < field.rows and 0 <= c < columns):
                    border = True
                    continue
                there = r * columns + c
                way = key + coarse * math.sqrt(down * down + aside * aside)
                if blocked[there] or way >= away[there] - 1e-12:
                    continue
                away[there] = way
                size = _push(heap, keys, size, way, there)
    return border


@formula
def kind_of(way):
    """Kind of the motion of a piece."""
    return FORWARD if way > 0.0 else (REVERSE if way < 0.0 else SPOT)


@formula
def piece_cost(motions, radius, way, turn, before):
    """Cost [m] of a piece after a motion of kind `before`, -1: at the start."""
    cost = motions.half_gauge * abs(turn) * TURNING_COST
    if way != 0.0:
        cost = abs(way) * (TURNING_COST if turn != 0.0 else 1.0)
        cost *= REVERSE_COST if way * motions.costly > 0.0 and motions.gears == 2 else 1.0
    return cost + (CHANGE_COST * radius if before >= 0 and kind_of(way) != before else 0.0)


@formula
def tightness(scene, clear):
    """Factor of the cost of a motion with its least clearance [m]."""
    return 1.0 + TIGHT_COST * max(0.0, 1.0 - clear / (AIRY * scene.radius))


@loop
def _accept(scene, motions, pose, pieces, before, best, out):
    """The cost of pieces (PARTS, 2) from a pose if they are free and cost less than `best`.

    Then they are copied to `out`; `best` otherwise.
    """
    cost = 0.0
    for looking in range(2):  # at first without obstacles, which is fast
        x, y, yaw, kind, cost = pose[0], pose[1], pose[2], before, 0.0
        for part in range(PARTS):
            way, turn = pieces[part]
            if way == 0.0 and turn == 0.0:
                continue
            piece, kind = piece_cost(motions, scene.radius, way, turn, kind), kind_of(way)
            if looking == 1:
                clear = clearance_along(scene, x, y, yaw, way, turn)
                if clear < 0.0:
                    return best
                piece *= tightness(scene, clear)
                x, y, yaw = moved(x, y, yaw, way, turn)
            cost += piece
            if cost >= best:
                return best
    for part in range(PARTS):
        out[part, 0], out[part, 1] = pieces[part, 0], pieces[part, 1]
    return cost


@formula
def _seen(pose, goal, radius):
    """A goal (3,) as seen from a pose: x, y [radii], yaw in [-pi, pi]."""
    x, y, turned = relative(pose, goal, radius)
    return x, y, wrapped(turned)


@loop
def connect(field, pose, goal, before, best, nodes, out):
    """The cheapest free path straight to a goal (3,) below the cost `best`: its cost, or `best`."""
    scene, motions, trial, sides = field.scene, field.motions, nodes.trial, nodes.sides
    radius = motions.radius
    x, y, turned = _seen(pose, goal, radius)
    curves.segments_of_words(x, y, turned, curves.SNAP, nodes.words)
    for word in range(6):
        trial[:] = 0.0
        for part in range(3):
            angle = nodes.words[word, part]
            trial[part, 0], trial[part, 1] = angle * radius, angle * curves.SIGNS[word, part]
        if not math.isnan(trial[0, 0] + trial[1, 0] + trial[2, 0]):
            best = _accept(scene, motions, pose, trial, before, best, out)
    if motions.gears == 2:
        curves.shortest(x, y, turned, sides[0], sides[1], sides[2])
        for part in range(PARTS):
            trial[part, 0], trial[part, 1] = (
                sides[1, part] * radius,
                sides[1, part] * sides[2, part],
            )
        best = _accept(scene, motions, pose, trial, before, best, out)
    if motions.spot:
        line, ahead = math.hypot(goal[0] - pose[0], goal[1] - pose[1]), math.atan2(y, x)
        for gear in range(1, 3 if motions.gears == 2 else 2):
            first = ahead if gear == FORWARD else ahead - math.copysign(math.pi, ahead)
            first = 0.0 if line < 1e-9 else first
            trial[:] = 0.0
            trial[0, 1], trial[2, 1] = first, wrapped(turned - first)
            trial[1, 0] = line if gear == FORWARD else -line
            best = _accept(scene, motions, pose, trial, before, best, out)
    return best


@loop
def _bound(motions, pose, goal, nodes):
    """Length [m] of the shortest path without obstacles, 0 where turns on the spot are allowed."""
    if motions.spot:
        return 0.0
    x, y, turned = _seen(pose, goal, motions.radius)
    if motions.gears == 2:
        sides = nodes.sides
        return curves.shortest(x, y, turned, sides[0], sides[1], sides[2]) * motions.radius
    curves.segments_of_words(x, y, turned, curves.SNAP, nodes.words)
    best = math.inf
    for word in range(6):
        total = nodes.words[word, 0] + nodes.words[word, 1] + nodes.words[word, 2]
        best = min(best, total if total >= 0.0 else math.inf)
    return best * motions.radius


@formula
def _cell(field, x, y, yaw, kind):
    """Number of the state's cell, -1 outside the area."""
    column, row = math.floor((x - field.x) / field.cell), math.floor((y - field.y) / field.cell)
    if not (0.0 <= x - field.x <= field.width and 0.0 <= y - field.y <= field.height):
        return -1
    part = int((yaw / TURN - math.floor(yaw / TURN)) * field.yaws) % field.yaws
    columns = int(field.width / field.cell) + 1
    return ((row * columns + column) * field.yaws + part) * 3 + kind


@formula
def _slot(nodes, cell):
    """Place of a cell in the hash table, or the empty one where it belongs."""
    mask = len(nodes.table) - 1
    at = (cell * 0x9E3779B1 >> 7) & mask
    while nodes.table[at] != 0 and nodes.cell[nodes.table[at] - 1] != cell:
        at = (at + 1) & mask
    return at


@loop
def _reach(field, here, way, turn, nodes):
    """The state after a piece from the state `here`, if it is new or cheaper than before."""
    scene, motions, goal = field.scene, field.motions, field.goal
    to = np.empty(3)
    x, y, yaw = nodes.pose[here]
    to[0], to[1], to[2] = moved(x, y, yaw, way, turn)
    kind = kind_of(way)
    cell = _cell(field, to[0], to[1], to[2], kind)
    if cell < 0:
        nodes.progress[3] = 1
        return
    ahead = field.away[coarse_cell(field, to[0], to[1])]
    if not ahead < math.inf:
        return
    piece = piece_cost(motions, scene.radius, way, turn, nodes.kind[here])
    at = _slot(nodes, cell)
    node = nodes.table[at] - 1
    if node >= 0 and (nodes.closed[node] or nodes.cost[here] + piece >= nodes.cost[node] - 1e-9):
        return
    clear = clearance_along(scene, x, y, yaw, way, turn)
    if clear < 0.0:
        return
    cost = nodes.cost[here] + tightness(scene, clear) * piece
    if node >= 0 and cost >= nodes.cost[node] - 1e-9:
        return
    if nodes.progress[0] >= len(nodes.heap) or (node < 0 and nodes.progress[1] >= len(nodes.cost)):
        return
    if node < 0:
        node = nodes.progress[1]
        nodes.progress[1] += 1
        nodes.table[at] = node + 1
    copy_entries(to, nodes.pose[node])
    nodes.cost[node], nodes.parent[node], nodes.cell[node] = cost, here, cell
    nodes.kind[node] = kind
    nodes.piece[node, 0], nodes.piece[node, 1] = way, turn
    line = math.hypot(goal[0] - to[0], goal[1] - to[1])
    around = 0.92 * ahead - 2.0 * field.coarse
    bound = max(line, around, _bound(motions, to, goal, nodes))
    nodes.progress[0] = _push(nodes.heap, nodes.keys, nodes.progress[0], cost + GREED * bound, node)


@loop
def expand(field, nodes, most):
    """Expand `most` states; whether it is over: the best route is known, or there is none."""
    p, scene, motions, step = nodes.progress, field.scene, field.motions, field.step
    for _ in range(most):
        if p[0] == 0 or nodes.keys[0] >= nodes.best[0]:
            return True
        here = _pop(nodes.heap, nodes.keys, p[0])
        p[0] -= 1
        if nodes.closed[here]:
            continue
        nodes.closed[here] = True
        ahead = field.away[coarse_cell(field, nodes.pose[here, 0], nodes.pose[here, 1])]
        near = ahead < NEAR_GOAL * max(motions.radius, scene.radius)
        if p[2] % (EVERY_NEAR if near else EVERY) == 0:
            before = nodes.kind[here] if nodes.parent[here] >= 0 else -1
            most_cost, pose = nodes.best[0] - nodes.cost[here], nodes.pose[here]
            cost = connect(field, pose, field.goal, before, most_cost, nodes, nodes.shot)
            if cost < most_cost:
                nodes.best[0], nodes.best[1] = nodes.cost[here] + cost, here
        p[2] += 1
        for arc in range(ARCS):
            turn = min(step / motions.radius, LARGEST_TURN) * (2.0 * arc / (ARCS - 1) - 1.0)
            _reach(field, here, step, turn, nodes)
            if motions.gears == 2:
                _reach(field, here, -step, turn, nodes)
        if motions.spot:
            for side in range(2):
                turn = (2.0 * side - 1.0) * 2.0 * TURN / field.yaws
                _reach(field, here, 0.0, turn, nodes)
    return False
