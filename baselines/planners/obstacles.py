"""Obstacles in the plane: circles, polygons and the occupied cells of a map, checked.

All become one shape, the capsule: what is within `radius` of a segment. A circle is a capsule
without length; edges of polygons, and of areas of occupied cells, are capsules without radius.
Who touches no edge and does not begin inside stays outside, so that edges are enough for a motion
that begins in the open. They are exact, whatever is thin, and whatever the cells measure.

A route around obstacles: arcs, lines and turns on the spot, in the gears allowed.

It is searched by hybrid A* (`hybrid_a_star`), from the end that is nearer to obstacles first, with
coarse cells over long ways first, and with finer ones where all was tried. A larger area is
searched while the border has been met and time is left. The route is then shortened by paths
straight between poses of it. It is feasible for the turning radius and free all along
(`clearance`), and near the shortest: cells are coarse.
"""

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.planners.clearance import Footprint, Scene, clearance_along, clearances, moved
from baselines.planners.curves import PARTS, Path
from baselines.planners.hybrid_a_star import (
    MOST_STATES,
    TURN,
    YAWS,
    Area,
    Motions,
    Nodes,
    blocked_cells,
    coarse_cell,
    connect,
    distances,
    expand,
    kind_of,
    piece_cost,
    tightness,
)
from baselines.planners.trajectory import ANGLE, PLACE
from tracked_env.physics.jit import loop
from tracked_env.physics.parameters import Range
from tracked_env.validation import checked_number

Array = NDArray[np.float64]


MOST_CELLS = 100_000_000  # of a map: 100 MB as bool
MOST_EDGES = 2_000_000  # of all obstacles together: some 200 MB
_RADIUS = Range(1e-3, 1e5, "m", "Did you pass millimetres?")
_CELL = Range(1e-3, 10.0, "m", "It is the size of a cell of the grid.")
FLAT = 1e-12  # [-] area over the square of the extent below which a polygon has none


class Obstacles(NamedTuple):
    """What must not be touched. Make it with `Obstacles.of`."""

    circles: Array  # (C, 3) x, y, radius [m]
    polygons: tuple[Array, ...]  # each (K, 2) corners x, y [m] in order
    occupied: NDArray[np.bool_]  # (NY, NX) cells, row j along y of the map
    cell: float  # [m] size of a cell
    origin: tuple[float, float, float]  # x, y [m] of the middle of occupied[0, 0], yaw [rad]

    @classmethod
    def of(
        cls, circles: ArrayLike = (), polygons: Sequence[ArrayLike] = (),
        occupied: ArrayLike | None = None, cell: float = 0.1,
        origin: Sequence[float] = (0.0, 0.0),
    ) -> "Obstacles":  # fmt: skip
        """Circles (C, 3) x, y, radius [m]; polygons (K, 2) each; a map of occupied cells (NY, NX).

        Row j, column i of the map is centred at origin[:2] + (i cell, j cell), turned by
        origin[2] [rad] about the origin if it is there. Beyond the map nothing is occupied: close
        it with occupied cells where the vehicle must stay on it. Raises ValueError.
        """
        cells = np.zeros((0, 0), dtype=bool) if occupied is None else np.asarray(occupied)
        if cells.ndim != 2 or cells.dtype != bool:
            raise ValueError(
                f"occupied has shape {cells.shape} of {cells.dtype}; must be (NY, NX) of bool. "
                "Did you pass probabilities? Compare them with a threshold."
            )
        if cells.size > MOST_CELLS:
            raise ValueError(
                f"occupied has {cells.size} cells; must be at most {MOST_CELLS}. Cut the map to "
                "the area of the plan, or make its cells larger."
            )
        size = checked_number("cell", cell, _CELL)
        return cls(
            _checked_circles(circles), tuple(_checked_polygon(p) for p in polygons), cells, size,
            _checked_origin(origin),
        )  # fmt: skip

    def capsules(self) -> Array:
        """All obstacles as (S, 5) x, y of both ends and radius [m]. Raises ValueError."""
        rings = self.circles[:, [0, 1, 0, 1, 2]]
        edges = [np.hstack([p, np.roll(p, -1, axis=0)]) for p in self.polygons]
        edges.append(self._edges_of_cells())
        lines = np.vstack(edges)
        _check_edges(len(lines) + len(rings))
        return np.vstack([rings, np.hstack([lines, np.zeros((len(lines), 1))])])

    def contain(self, x: float, y: float) -> bool:
        """Whether a point [m] is inside an obstacle."""
        away = np.hypot(self.circles[:, 0] - x, self.circles[:, 1] - y)
        if np.any(away <= self.circles[:, 2]) or any(_inside(p, x, y) for p in self.polygons):
            return True
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        x, y = x - self.origin[0], y - self.origin[1]
        column = math.floor((cos * x + sin * y) / self.cell + 0.5)
        row = math.floor((cos * y - sin * x) / self.cell + 0.5)
        ny, nx = self.occupied.shape
        return 0 <= row < ny and 0 <= column < nx and bool(self.occupied[row, column])

    def _edges_of_cells(self) -> Array:
        """Outlines of the occupied areas (S, 4), runs of edges as one, in the world."""
        if not self.occupied.any():
            return np.zeros((0, 4))
        columns = np.ascontiguousarray(self.occupied.T)
        across, upwards = _runs(self.occupied), _runs(columns)[:, [1, 0, 3, 2]]
        x, y = (np.vstack([across, upwards]) - 0.5).reshape(-1, 2).T * self.cell
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        world = self.origin[0] + cos * x - sin * y, self.origin[1] + sin * x + cos * y
        return np.stack(world, axis=1).reshape(-1, 4)


def _check_edges(count: int) -> None:
    if count > MOST_EDGES:
        raise ValueError(
            f"the obstacles have {count} edges; must be at most {MOST_EDGES}. Is the map noise? "
            "Filter it, or make its cells larger."
        )


def checked_obstacles(value: Any) -> Obstacles | None:
    """`value` if it is None or Obstacles. Raises ValueError."""
    if value is None or isinstance(value, Obstacles):
        return value
    raise ValueError(
        f"obstacles = a {type(value).__name__}; must be Obstacles. Did you mean "
        "Obstacles.of(circles=..., polygons=...)?"
    )


def _checked_circles(circles: ArrayLike) -> Array:
    try:
        rings = np.asarray(circles, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"circles = {circles!r}; must be numbers x, y, radius [m]") from error
    rings = rings.reshape(1, 3) if rings.shape == (3,) else rings
    if rings.size == 0:
        return np.zeros((0, 3))
    if rings.ndim != 2 or rings.shape[1] != 3:
        raise ValueError(f"circles have shape {rings.shape}; must be (C, 3): x, y, radius [m]")
    for x, y, radius in rings:
        checked_number("circle x", float(x), PLACE)
        checked_number("circle y", float(y), PLACE)
        checked_number("circle radius", float(radius), _RADIUS)
    return rings


def _checked_polygon(corners: ArrayLike) -> Array:
    """Corners (K, 2) without those that repeat the one before. Raises ValueError."""
    try:
        polygon = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"polygon {corners!r}; must be corners x, y [m] (K, 2)") from error
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise ValueError(f"polygon of shape {polygon.shape}; must be (K, 2), K >= 3: x, y")
    if not np.isfinite(polygon).all():
        raise ValueError(f"polygon {polygon.tolist()}; all corners must be finite")
    checked_number("polygon corner", float(polygon.flat[np.abs(polygon).argmax()]), PLACE)
    ring = np.ascontiguousarray(polygon[np.any(polygon != np.roll(polygon, 1, axis=0), axis=1)])
    if len(ring) < 3 or _area(ring) <= FLAT * float(np.ptp(ring, axis=0).max()) ** 2:
        raise ValueError(
            f"polygon {polygon.tolist()[:4]} has no area; its corners must not be on one line. Is "
            "it a thin wall? Give it a thickness."
        )
    first, second = _crossing(ring)
    if first >= 0:
        raise ValueError(
            f"polygon crosses itself: the edges from corner {first} {ring[first].tolist()} and "
            f"from corner {second} {ring[second].tolist()}; must not. Are its corners in order?"
        )
    return ring


def _checked_origin(origin: Sequence[float]) -> tuple[float, float, float]:
    if np.ndim(origin) != 1 or len(origin) not in (2, 3):
        raise ValueError(f"origin = {origin!r}; must be x, y [m], or x, y, yaw [rad]")
    x, y, yaw = (*origin, 0.0)[:3]
    return (
        checked_number("origin x", x, PLACE), checked_number("origin y", y, PLACE),
        checked_number("origin yaw", yaw, ANGLE),
    )  # fmt: skip


def _area(ring: Array) -> float:
    """Sum of the areas [m^2] that successive triangles around the first corner sweep, unsigned."""
    x, y = (ring - ring[0]).T
    return float(0.5 * np.abs(x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


@loop
def _side(a, b, c):
    """Twice the signed area of a, b, c (2,): above 0 where they turn left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@loop
def _crossing(ring):
    """Two edges of a ring (K, 2) that cross, by their first corners; (-1, -1): none."""
    count = len(ring)
    for i in range(count):
        a, b = ring[i], ring[(i + 1) % count]
        for j in range(i + 2, count):
            c, d = ring[j], ring[(j + 1) % count]
            if _side(a, b, c) * _side(a, b, d) < 0.0 and _side(c, d, a) * _side(c, d, b) < 0.0:
                return i, j
    return -1, -1


def _inside(polygon: Array, x: float, y: float) -> bool:
    """Whether a point is inside a polygon (K, 2): edges that a ray to the right crosses."""
    (a_x, a_y), (b_x, b_y) = polygon.T, np.roll(polygon, -1, axis=0).T
    cut = (a_y > y) != (b_y > y)
    at = a_x[cut] + (y - a_y[cut]) / (b_y[cut] - a_y[cut]) * (b_x[cut] - a_x[cut])
    return bool(np.count_nonzero(at > x) % 2)


def _runs(occupied: NDArray[np.bool_]) -> Array:
    """Edges along rows, between cells of which one is occupied: (S, 4) in cells, from corners."""
    edge = np.zeros((len(occupied) + 1, occupied.shape[1]), dtype=bool)
    edge[0], edge[-1] = occupied[0], occupied[-1]
    np.not_equal(occupied[1:], occupied[:-1], out=edge[1:-1])
    begins = np.count_nonzero(edge[:, 1:] > edge[:, :-1])
    _check_edges(int(np.count_nonzero(edge[:, 0]) + begins))
    row, column = np.nonzero(edge)
    breaks = np.flatnonzero((np.diff(row) != 0) | (np.diff(column) != 1))
    first, last = np.append(0, breaks + 1), np.append(breaks, len(row) - 1)
    ends = [column[first], row[first], column[last] + 1, row[last]]
    return np.stack(ends, axis=1).astype(np.float64)


FINENESS = 7.0  # [-] cells of a state over the vehicle's smaller side
COARSEST, FINEST, LONG = 8.0, 0.25, 150.0  # [-] of the usual cells; cells of the area at first
CHUNK = 100  # states between two looks at the clock
MOST_CELLS_ROUTE = 250_000  # of the way around the obstacles


class Route(NamedTuple):
    """Arcs, lines and turns on the spot around obstacles, or none."""

    start: Array  # (3,)
    pieces: Array  # (P, 2) way [m], negative in reverse, and turn [rad]; without way: on the spot
    expanded: int  # states
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
    motions: Motions
    room: float | None  # [m] around start and goal; None: larger and larger
    time_limit: float  # [s]


def find_route(start: Array, goal: Array, search: Search) -> Route:
    """A free route from one pose (3,) to another, x, y [m], yaw [rad].

    The search begins at the end that is nearer to obstacles, and after half the time at the other.
    """
    ends = np.array([start, goal])
    scene = Scene.of(
        search.capsules, search.footprint, search.margin, ends[:, :2].min(axis=0),
        ends[:, :2].max(axis=0),
    )  # fmt: skip
    clear = clearances(scene, ends)
    backwards = bool(clear[1] < clear[0])
    half = search._replace(time_limit=0.5 * search.time_limit)
    route, over = _one_way(start, goal, half, backwards)
    if not len(route.pieces) and not over:
        again, _ = _one_way(start, goal, half, not backwards)
        route = (
            again if len(again.pieces) else again._replace(report=f"{route.report}; {again.report}")
        )
    return route


def _one_way(start: Array, goal: Array, search: Search, backwards: bool) -> tuple[Route, bool]:
    """A search from the start, or backwards from the goal; whether there is no more to search."""
    gears = search.motions.gears
    begin, end = (goal, start) if backwards else (start, goal)
    reverse = gears != 2 and (gears == 1) == backwards
    dear = 1.0 if backwards else -1.0
    search = search._replace(motions=search.motions._replace(gears=abs(gears), dear=dear))
    if reverse:
        turn = np.array([0.0, 0.0, math.pi])
        begin, end = begin + turn, end + turn
        search = search._replace(footprint=search.footprint.turned)
    pieces, expanded, report, over = _searched(
        begin, end, search, search.motions._replace(gears=gears)
    )
    if reverse:
        pieces = pieces * np.array([-1.0, 1.0])
    if backwards:
        pieces = -pieces[::-1]
    return Route(start, pieces, expanded, report), over


def _searched(
    start: Array, goal: Array, search: Search, motions_asked: Motions
) -> tuple[Array, int, str, bool]:
    """Pieces (P, 2) from start to goal, number of states, report, and whether that was all."""
    low, high = np.minimum(start[:2], goal[:2]), np.maximum(start[:2], goal[:2])
    radius, motions = search.footprint.radius, search.motions
    ends = search.capsules[:, :4].reshape(-1, 2, 2)
    reach = search.capsules[:, 4:] + 2.0 * (radius + motions.radius) + search.margin
    # beyond it no obstacle is in the way
    outer = np.minimum(low, np.min(ends.min(axis=1) - reach, axis=0, initial=np.inf))
    outer = outer, np.maximum(high, np.max(ends.max(axis=1) + reach, axis=0, initial=-np.inf))
    room = search.room
    if room is None:
        room = max(3.0, 4.0 * radius, 4.0 * motions.radius)
    nodes, expanded, scale = Nodes.empty(MOST_STATES), 0, math.nan
    begun: float | None = None
    while True:
        box = low - room, high + room
        whole = search.room is not None
        whole |= bool(np.all(box[0] <= outer[0]) and np.all(box[1] >= outer[1]))
        finest = min(sum(search.footprint[:2]), sum(search.footprint[2:])) / FINENESS
        if math.isnan(scale):
            scale = float(np.max(box[1] - box[0])) / (LONG * finest)
            scale = min(max(scale, 1.0), COARSEST)
        yaws = round(YAWS / min(scale, 1.0))
        scene, area, away, closed = _prepared(search, goal, box, scale * finest, yaws)
        step = max(1.5 * area.cell, 1.5 * motions.radius * TURN / yaws)
        _begin(nodes, start)
        arguments = scene, area, motions, goal, away, step, nodes
        expand(*arguments, 0)
        connect(scene, motions, start, goal, -1, -1.0, nodes, nodes.shot)
        begun = time.perf_counter() if begun is None else begun  # all is compiled
        left = max(search.time_limit - (time.perf_counter() - begun), 0.0)
        until = time.perf_counter() + (left if whole and scale <= 1.0 else 0.5 * left)
        apart = over = not away[coarse_cell(area, start[0], start[1])] < math.inf
        while not over and time.perf_counter() < until:
            over = bool(expand(*arguments, CHUNK))
        full = bool(nodes.progress[1] >= MOST_STATES)
        expanded += int(nodes.progress[2])
        spent = time.perf_counter() - begun
        if nodes.best[0] < math.inf:
            pieces = _shortened(scene, motions, start, _pieces(nodes), nodes)
            return pieces, expanded, "", True
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
    elif over and not full:
        why = "all states that can be reached were tried"
    elif full:
        why = f"the memory for {MOST_STATES} states was used"
    report = (
        f"searched x {box[0][0]:.4g} to {box[1][0]:.4g} m, y {box[0][1]:.4g} to {box[1][1]:.4g} m "
        f"in cells of {area.cell:.2g} m and {360.0 / area.yaws:.3g} deg, {motions_asked.words}, "
        f"margin {search.margin:g} m, {expanded} states in {spent:.2g} s: {why}"
    )
    return np.zeros((0, 2)), expanded, report, never


def _prepared(
    search: Search, goal: Array, box: tuple[Array, Array], cell: float, yaws: int
) -> tuple[Scene, Area, Array, bool]:
    """Obstacles, cells, way to the goal around them, and whether the goal is closed in."""
    scene = Scene.of(search.capsules, search.footprint, search.margin, *box)
    width, height = (float(side) for side in box[1] - box[0])
    coarse = max(min(search.footprint) / FINENESS, math.sqrt(width * height / MOST_CELLS_ROUTE))
    area = Area(
        float(box[0][0]), float(box[0][1]), width, height, cell, coarse,
        math.ceil(width / coarse), math.ceil(height / coarse), yaws,
    )  # fmt: skip
    blocked = np.empty(area.columns * area.rows, dtype=np.bool_)
    blocked_cells(scene, area, min(search.footprint) + search.margin, blocked)
    away = np.empty(len(blocked))
    return scene, area, away, not distances(area, blocked, goal[0], goal[1], away)


def _begin(nodes: Nodes, start: Array) -> None:
    """The start as the only open state."""
    nodes.table[:], nodes.closed[:] = 0, False
    nodes.progress[:], nodes.best[:] = (1, 1, 0, 0), (np.inf, -1.0)
    nodes.pose[0], nodes.cost[0], nodes.parent[0], nodes.kind[0] = start, 0.0, -1, -1
    nodes.cell[0] = -1
    nodes.heap[0], nodes.keys[0] = 0, 0.0


def _pieces(nodes: Nodes) -> Array:
    """Pieces (P, 2) of the best route."""
    at, pieces = int(nodes.best[1]), []
    while nodes.parent[at] >= 0:
        pieces.append(nodes.piece[at].copy())
        at = int(nodes.parent[at])
    return _merged(np.array([*pieces[::-1], *nodes.shot]))


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


def _shortened(scene: Scene, motions: Motions, start: Array, pieces: Array, nodes: Nodes) -> Array:
    """The route with paths straight on in place of its pieces, as far along as they are cheaper."""
    parts: list[Array] = []
    begin, at = start, 0
    out, before = np.zeros((PARTS, 2)), -1
    while at < len(pieces):
        to, poses = len(pieces), [begin]
        for way, turn in pieces[at:]:
            poses.append(np.array(moved(*poses[-1], way, turn)))
        while to > at + 1:
            cost, kind = 0.0, before
            for pose, (way, turn) in zip(poses, pieces[at:to], strict=False):
                clear = clearance_along(scene, *pose, way, turn)
                cost += piece_cost(motions, scene.radius, way, turn, kind) * tightness(scene, clear)
                kind = kind_of(way)
            if connect(scene, motions, begin, poses[to - at], before, cost, nodes, out) < cost:
                parts.extend(piece.copy() for piece in out)
                break
            to = at + (to - at) // 2
        else:
            to = at + 1
            parts.append(pieces[at])
        begin, at = poses[to - at], to
        before = kind_of([p for p in parts if p.any()][-1][0])
    return _merged(np.array(parts))
