"""A route around obstacles: arcs, lines and turns on the spot, in the gears allowed.

It is searched by hybrid A* (`hybrid_a_star`), from the end that is nearer to obstacles first, with
coarse cells over long ways first, and with finer ones where all was tried. A larger area is
searched while the border has been met and time is left. The route is then shortened by paths
straight between poses of it. It is feasible for the turning radius and free all along
(`obstacles`), and near the shortest: cells are coarse.
"""

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners import hybrid_a_star as a_star
from baselines.planners.curves import PARTS, TURN
from baselines.planners.obstacles import Footprint, Scene, clearance_along, clearances
from baselines.planners.speed_along_path import Path, moved

Array = NDArray[np.float64]

FINENESS = 7.0  # [-] cells of a state over the vehicle's smaller side
COARSEST, FINEST, LONG = 8.0, 0.25, 150.0  # [-] of the usual cells; cells of the area at first
CHUNK = 100  # states between two looks at the clock
MOST_CELLS = 250_000  # of the way around the obstacles


class Route(NamedTuple):
    """Arcs, lines and turns on the spot around obstacles, or none."""

    start: Array  # (3,)
    pieces: Array  # (P, 2) way [m], negative in reverse, and turn [rad]; without way: on the spot
    report: str  # what was searched, where there is none

    @property
    def turns_on_the_spot(self) -> bool:
        """Whether a piece has no way."""
        return bool(np.any(self.pieces[:, 0] == 0.0))

    def path(self) -> Path:
        """The route as a path. It must not turn on the spot."""
        way, turn = self.pieces.T
        return Path.of(self.start, way, turn / way)


class Search(NamedTuple):
    """One search: the place where it happens, and what it may take."""

    capsules: Array  # (S, 5) of all obstacles
    footprint: Footprint
    margin: float  # [m]
    motions: a_star.Motions
    room: float | None  # [m] around start and goal; None: larger and larger
    time_limit: float  # [s]


def find_route(start: Array, goal: Array, search: Search) -> Route:
    """A free route from one pose (3,) to another, x, y [m], yaw [rad].

    The search begins at the end that is nearer to obstacles, and after half the time at the other.
    """
    ends = np.array([start, goal])
    box = ends[:, :2].min(axis=0), ends[:, :2].max(axis=0)
    clear = clearances(Scene.of(search.capsules, search.footprint, search.margin, *box), ends)
    backwards = bool(clear[1] < clear[0])
    half = search._replace(time_limit=0.5 * search.time_limit)
    route, over = _one_way(start, goal, half, backwards)
    if over or len(route.pieces):
        return route
    other, _ = _one_way(start, goal, half, not backwards)
    return other if len(other.pieces) else other._replace(report=f"{route.report}; {other.report}")


def _one_way(start: Array, goal: Array, search: Search, backwards: bool) -> tuple[Route, bool]:
    """A search from the start, or backwards from the goal; whether there is no more to search."""
    motions = search.motions
    begin, end = (goal, start) if backwards else (start, goal)
    reverse = motions.gears != 2 and (motions.gears == 1) == backwards
    costly = 1.0 if backwards else -1.0
    search = search._replace(motions=motions._replace(gears=abs(motions.gears), costly=costly))
    if reverse:
        turn = np.array([0.0, 0.0, math.pi])
        begin, end = begin + turn, end + turn
        search = search._replace(footprint=search.footprint.turned)
    pieces, report, over = _searched(begin, end, search, motions.words)
    if reverse:
        pieces = pieces * np.array([-1.0, 1.0])
    if backwards:
        pieces = -pieces[::-1]
    return Route(start, pieces, report), over


def _searched(start: Array, goal: Array, search: Search, words: str) -> tuple[Array, str, bool]:
    """Pieces (P, 2) from start to goal, report, and whether that was all."""
    low, high = np.minimum(start[:2], goal[:2]), np.maximum(start[:2], goal[:2])
    radius, motions = search.footprint.radius, search.motions
    ends = search.capsules[:, :4].reshape(-1, 2, 2)
    reach = search.capsules[:, 4:] + 2.0 * (radius + motions.radius) + search.margin
    # beyond it no obstacle is in the way
    first = np.minimum(low, np.min(ends.min(axis=1) - reach, axis=0, initial=np.inf))
    last = np.maximum(high, np.max(ends.max(axis=1) + reach, axis=0, initial=-np.inf))
    room = max(3.0, 4.0 * radius, 4.0 * motions.radius) if search.room is None else search.room
    nodes, expanded = a_star.Nodes.empty(a_star.MOST_STATES), 0
    finest = min(sum(search.footprint[:2]), sum(search.footprint[2:])) / FINENESS
    scale = float(np.max((high + room) - (low - room))) / (LONG * finest)
    scale = min(max(scale, 1.0), COARSEST)
    begun: float | None = None
    while True:
        box = low - room, high + room
        whole = search.room is not None or bool(np.all(box[0] <= first) and np.all(box[1] >= last))
        yaws = round(a_star.YAWS / min(scale, 1.0))
        field, closed = _prepared(search, goal, box, scale * finest, yaws)
        nodes.begin(start)
        a_star.expand(field, nodes, 0)
        a_star.connect(field, start, goal, -1, -1.0, nodes, nodes.shot)
        begun = time.perf_counter() if begun is None else begun  # all is compiled
        left = max(search.time_limit - (time.perf_counter() - begun), 0.0)
        until = time.perf_counter() + (left if whole and scale <= 1.0 else 0.5 * left)
        here = a_star.coarse_cell(field, start[0], start[1])
        apart = over = not field.away[here] < math.inf
        while not over and time.perf_counter() < until:
            over = bool(a_star.expand(field, nodes, CHUNK))
        full = bool(nodes.progress[1] >= a_star.MOST_STATES)
        expanded += int(nodes.progress[2])
        spent = time.perf_counter() - begun
        if nodes.best[0] < math.inf:
            return _shortened(field, start, _merged(nodes.best_pieces()), nodes), "", True
        met = bool(nodes.progress[3])  # the border
        never = apart and (closed or whole)
        if never or full or spent >= search.time_limit or (scale <= FINEST and (whole or not met)):
            break
        if not apart and (scale > 1.0 or whole or not met):
            scale = max(0.5 * scale, FINEST) if scale <= 1.0 else max(0.5 * scale, 1.0)
        else:
            room *= 2.0
    why = f"the time limit of {search.time_limit:.3g} s for this direction was reached"
    if apart:
        why = "start and goal are in areas that the vehicle cannot go between"
    elif over or full:
        why = f"{'as many as fit' if full else 'all'} states that can be reached were tried"
    (x, y), (last_x, last_y) = box
    report = (
        f"searched x {x:.4g} to {last_x:.4g} m, y {y:.4g} to {last_y:.4g} m in cells of "
        f"{field.cell:.2g} m, {words}, margin {search.margin:g} m, {expanded} states in "
        f"{spent:.2g} s: {why}"
    )
    return np.zeros((0, 2)), report, never


def _prepared(
    search: Search, goal: Array, box: tuple[Array, Array], cell: float, yaws: int
) -> tuple[a_star.Field, bool]:
    """Obstacles, cells and the way to the goal around them, and whether the goal is closed in."""
    scene = Scene.of(search.capsules, search.footprint, search.margin, *box)
    width, height = (float(side) for side in box[1] - box[0])
    coarse = max(min(search.footprint) / FINENESS, math.sqrt(width * height / MOST_CELLS))
    columns, rows = math.ceil(width / coarse), math.ceil(height / coarse)
    corner = float(box[0][0]), float(box[0][1])
    step = max(1.5 * cell, 1.5 * search.motions.radius * TURN / yaws)
    cells, away = (width, height, cell, coarse), np.empty(columns * rows)
    place = *corner, *cells, columns, rows, yaws
    field = a_star.Field(scene, search.motions, goal, away, step, *place)
    return field, not a_star.distances(field, min(search.footprint) + search.margin)


def _merged(pieces: Array) -> Array:
    """Pieces (P, 2) of which neighbours of one kind and curvature are one."""
    out: list[Array] = []
    for way, turn in pieces:
        if way == 0.0 and turn == 0.0:
            continue
        before = out[-1] if out else np.full(2, np.nan)
        alike = (before[0] == 0.0) == (way == 0.0) and before[0] * way >= 0.0
        if alike and abs(before[1] * way - turn * before[0]) < 1e-12 * (1.0 + way * way):
            out[-1] = before + np.array([way, turn])
        else:
            out.append(np.array([way, turn]))
    return np.array(out).reshape(-1, 2)


def _shortened(field: a_star.Field, start: Array, pieces: Array, nodes: a_star.Nodes) -> Array:
    """The route with paths straight on in place of its pieces, as far along as they are cheaper."""
    parts: list[Array] = []
    begin, at, scene = start, 0, field.scene
    out, before = np.zeros((PARTS, 2)), -1
    while at < len(pieces):
        to, poses = len(pieces), [begin]
        for way, turn in pieces[at:]:
            poses.append(np.array(moved(*poses[-1], way, turn)))
        while to > at + 1:
            cost, kind = 0.0, before
            for pose, (way, turn) in zip(poses, pieces[at:to], strict=False):
                clear = clearance_along(scene, *pose, way, turn)
                piece = a_star.piece_cost(field.motions, scene.radius, way, turn, kind)
                cost += piece * a_star.tightness(scene, clear)
                kind = a_star.kind_of(way)
            if a_star.connect(field, begin, poses[to - at], before, cost, nodes, out) < cost:
                parts.extend(piece.copy() for piece in out)
                break
            to = at + (to - at) // 2
        else:
            to = at + 1
            parts.append(pieces[at])
        begin, at = poses[to - at], to
        before = a_star.kind_of([p for p in parts if p.any()][-1][0])
    return _merged(np.array(parts))
