"""The world around the vehicle: paths, vehicle to scale, reference, forces.

Vehicle and forces are drawn on a sprite of four times the resolution, which is then reduced:
that smooths the edges. It is transparent; its colours are premultiplied by their opacity.

What a picture shows of the time before it: the driven trail, the belts, the latest changes.

It is filled by the pictures themselves: what happened before the first of them is not known.

The vehicle as flat polygons in its own frame: two tracks with pads and wheels, hull, cabin.

Lengths along and across are those of the parameters; heights, which the parameters do not hold, are
in shares of the contact length. The belt runs around a stadium: a straight run of the contact
length, half circles at both ends. Origin: centre of mass; the tracks stand on z = -centre_height.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env import events
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour
from tracked_env.rendering.sizes import QUANTITIES
from tracked_env.rendering.snapshot import Pose, Snapshot
from tracked_env.rendering.soil_map import AMBIENT, LIGHT, value_at

Points = NDArray[np.float64]


Outline = Sequence[tuple[float, float]]  # [m]

# In contact lengths:
PAD_PITCH = 0.08  # between two pads of a track
PAD_SHARE, THIN_PAD_SHARE = 0.4, 0.2  # [-] of the pitch that is pad; where loads are shown
BESIDE = 0.09  # from a track to the arrows of its forces
GHOST_REACH = 50.0  # a reference farther away is not drawn
MARGIN = 0.15  # of a sprite, around what it holds
CHAMFER, ROUNDED = 0.035, 0.05  # at most, of a track's corners, and of the footprint's
PEN, WIDE_PEN, BROAD_PEN = 0.015, 0.0225, 0.025  # widths of lines
HEAD, SHAFT, HALO = 0.14, 0.0225, 0.0175  # of an arrow: head, half its width, white rim
GAP, AXLE, CHEVRON = 0.025, 0.03, 0.11  # track to hull; half widths of axle and chevron
DOT = (0.04, 0.0225)  # radii of the centre of mass, black and white

SUPERSAMPLING = 4  # [-] of sprites
POINT_DISTANCE = 12.0  # [px] between the points of a path that are drawn
HULL: Colour = (82, 94, 103)
DECK: Colour = (112, 125, 135)
NOSE: Colour = (238, 240, 242)
_GHOST_OPACITY = 60  # of 255


class Camera(NamedTuple):
    """World to pixels: x right, y down there."""

    x: float  # [m] world, what is in the middle
    y: float  # [m]
    scale: float  # [px/m]
    middle_x: float  # [px]
    middle_y: float  # [px]

    def pixels(self, points: Points) -> Points:
        """World points (P, 2) [m] as pixels (P, 2)."""
        offset = (points - (self.x, self.y)) * (self.scale, -self.scale)
        return offset + np.array([self.middle_x, self.middle_y])


class Brush:
    """Draws shapes given in the frame of a pose, with lines as wide as suits the vehicle."""

    def __init__(self, target: pygame.Surface, camera: Camera, pose: Pose, length: float) -> None:
        """pose: of the frame in which points are given; length: contact length [m]."""
        self._target, self._camera, self.length = target, camera, length
        cosine, sine = math.cos(pose.yaw), math.sin(pose.yaw)
        self._rotation = np.array([[cosine, sine], [-sine, cosine]])
        self._origin = (pose.x, pose.y)

    def place(self, points: Outline) -> Points:
        """Pixels (P, 2) of points in the frame."""
        return self._camera.pixels(np.array(points) @ self._rotation + self._origin)

    def area(self, points: Outline, colour: Colour) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self._target, colour, self.place(points).tolist())

    def areas(self, corners: Points, colours: canvas.Bytes) -> None:
        """Filled polygons, corners (K, C, 2) in the frame, colours (K, 3)."""
        pixels = self._camera.pixels(corners.reshape(-1, 2) @ self._rotation + self._origin)
        for outline, colour in zip(pixels.reshape(corners.shape), colours, strict=True):
            pygame.draw.polygon(self._target, colour.tolist(), outline.tolist())

    def stroke(self, points: Outline, colour: Colour, width: float, closed: bool = False) -> None:
        """A line of that width [contact lengths] with round joints."""
        thick = max(round(width * self.length * self._camera.scale), 1)
        pixels = self.place(points).tolist()
        pygame.draw.lines(self._target, colour, closed, pixels, thick)
        for pixel in pixels:
            pygame.draw.circle(self._target, colour, pixel, 0.5 * thick)

    def dot(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """A disc; radius [contact lengths]."""
        middle = self.place([(x, y)])[0].tolist()
        pygame.draw.circle(self._target, colour, middle, radius * self.length * self._camera.scale)

    def arrow(self, x: float, y: float, length: float, across: bool, colour: Colour) -> None:
        """From (x, y) along the frame's x axis, or its y axis when `across`; length [m] signed."""
        size, sign = abs(length), math.copysign(1.0, length)
        head = min(HEAD * self.length, 0.75 * size)
        for halo, fill in ((HALO * self.length, canvas.WHITE), (0.0, colour)):
            shaft, half = SHAFT * self.length + halo, 0.55 * head + 1.5 * halo
            neck, tip = size - head - halo, size + 2.0 * halo
            outline = [
                (-halo, shaft), (neck, shaft), (neck, half), (tip, 0.0),
                (neck, -half), (neck, -shaft), (-halo, -shaft),
            ]  # fmt: skip
            turned = [(v, sign * u) if across else (sign * u, v) for u, v in outline]
            self.area([(x + u, y + v) for u, v in turned], fill)


def path(
    picture: pygame.Surface, camera: Camera, points: Points, colour: Colour, width: int
) -> None:
    """The visible part of a path (P, 2) [m], as a smooth line."""
    pixels = camera.pixels(points)
    inside = ((pixels > -50.0) & (pixels < np.array(picture.get_size()) + 50.0)).all(axis=1)
    seen = np.flatnonzero(inside)
    for run in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1):
        if run.size < 2:
            continue
        part = pixels[run]
        travelled = np.abs(np.diff(part, axis=0)).sum(axis=1).cumsum() // POINT_DISTANCE
        kept = np.flatnonzero(np.diff(travelled, prepend=-1.0, append=math.inf))
        corners = part[kept].tolist()
        for start, end in pairwise(corners):
            pygame.draw.aaline(picture, colour, start, end, width)


def chamfered(rear: float, front: float, side: float, cut: float, middle: float = 0.0) -> Outline:
    """A rectangle whose corners are cut off; `side` is half its width, `middle` its axis."""
    right, left = middle - side, middle + side
    return [
        (rear + cut, right), (front - cut, right), (front, right + cut), (front, left - cut),
        (front - cut, left), (rear + cut, left), (rear, left - cut), (rear, right + cut),
    ]  # fmt: skip


def _sprite(
    picture: pygame.Surface,
    camera: Camera,
    pose: Pose,
    reach: float,
    paint: Callable[[pygame.Surface, Camera], None],
) -> None:
    """Let `paint` draw what lies within `reach` [m] of the pose, in high resolution."""
    middle = camera.pixels(np.array([pose[:2]]))[0]
    half = math.ceil(min(reach * camera.scale, 0.71 * max(picture.get_size()))) + 1
    corner = np.round(middle).astype(int) - half
    side = 2 * half * SUPERSAMPLING
    fine = canvas.surface(side, side, transparent=True)
    within = ((middle - corner) * SUPERSAMPLING).tolist()
    paint(fine, Camera(pose.x, pose.y, camera.scale * SUPERSAMPLING, within[0], within[1]))
    smooth = pygame.transform.smoothscale(fine, (2 * half, 2 * half))
    picture.blit(smooth, corner.tolist(), special_flags=pygame.BLEND_PREMULTIPLIED)


def vehicle(
    picture: pygame.Surface, camera: Camera, shot: Snapshot, travel: Sequence[float]
) -> None:
    """Hull and tracks to scale, with the forces on them; travel [m] of both belts."""
    p, length = shot.parameters, shot.sizes.length
    size = math.hypot(0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width))
    drawn = (shot.state.effort_left, shot.state.effort_right, *shot.resistance, shot.lateral_force)
    longest = shot.sizes.force_scale * max(abs(force) for force in drawn)
    side = 0.5 * (p.track_gauge + p.track_width) + BESIDE * length
    reach = max(size, math.hypot(longest, side)) + MARGIN * length

    def paint(fine: pygame.Surface, close: Camera) -> None:
        brush = Brush(fine, close, shot.pose, length)
        _body(brush, shot, travel)
        _forces(brush, shot)

    _sprite(picture, camera, shot.pose, reach, paint)


def _body(brush: Brush, shot: Snapshot, travel: Sequence[float]) -> None:
    p, state = shot.parameters, shot.state
    middle, half = 0.5 * p.track_gauge, 0.5 * p.contact_length
    gap, axle = GAP * brush.length, AXLE * brush.length
    inner = max(middle - 0.5 * p.track_width - gap, gap)
    for x in (-0.6 * half, 0.6 * half):  # suspension
        brush.area(chamfered(x - axle, x + axle, middle, 0.0), canvas.INK)
    slips = state.slip_left, state.slip_right
    for side, y in enumerate((middle, -middle)):
        loads = None
        if shot.loads is not None:
            loads = canvas.load_colours(shot.loads[side], shot.load_shown)
        _track(brush, y, p, slips[side], travel[side], loads)
    hull = chamfered(-0.95 * half, 1.02 * half, inner, 0.35 * inner)
    brush.area(hull, HULL)
    brush.stroke(hull, canvas.INK, PEN, True)
    brush.area(chamfered(-0.8 * half, 0.35 * half, 0.7 * inner, 0.15 * inner), DECK)
    brush.area([(0.88 * half, 0.0), (0.5 * half, 0.45 * inner), (0.5 * half, -0.45 * inner)], NOSE)


def _track(
    brush: Brush,
    middle: float,
    p: PlantParameters,
    slip: float,
    travel: float,
    loads: canvas.Bytes | None,
) -> None:
    """One track: coloured by its slip, with pads that run forward as the upper belt does.

    loads (nx, ny, 3): colours of the patches below it, which it takes; then narrow pads have the
    colour of the slip.
    """
    half, side = 0.5 * p.contact_length, 0.5 * p.track_width
    colour = canvas.slip_colour(slip)
    pad_colour = canvas.shaded(colour) if loads is None else colour
    share = PAD_SHARE if loads is None else THIN_PAD_SHARE
    cut = min(CHAMFER * brush.length, 0.3 * side, 0.3 * half)
    outline = chamfered(-half, half, side, cut, middle)
    if loads is None:
        brush.area(outline, colour)
    else:
        brush.areas(_cells(half, side, middle, loads.shape[:2]), loads.reshape(-1, 3))
    pitch = PAD_PITCH * brush.length
    count = int(p.contact_length / pitch) + 1
    for pad in range(count):
        rear = -half + (travel + pad * pitch) % (count * pitch)
        front = min(rear + share * pitch, half)
        if rear < front:
            brush.area(chamfered(rear, front, side, 0.0, middle), pad_colour)
    brush.stroke(outline, canvas.INK, PEN, True)


def _cells(half: float, side: float, middle: float, count: tuple[int, ...]) -> Points:
    """Corners (nx ny, 4, 2) of the patches of a track, from the rear right one to the left."""
    x = np.linspace(-half, half, count[0] + 1)
    y = np.linspace(middle - side, middle + side, count[1] + 1)
    nodes = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2)
    return quads.reshape(-1, 4, 2)


def _forces(brush: Brush, shot: Snapshot) -> None:
    """Tractive efforts and motion resistances beside the tracks, lateral force at the middle."""
    p, state, sizes = shot.parameters, shot.state, shot.sizes
    beside = 0.5 * (p.track_gauge + p.track_width) + BESIDE * sizes.length
    efforts = state.effort_left, state.effort_right
    for y, effort, resistance in zip((beside, -beside), efforts, shot.resistance, strict=True):
        for force, colour in ((effort, canvas.GREEN), (-resistance, canvas.VERMILLION)):
            if abs(force) > sizes.force_shown:
                brush.arrow(0.0, y, sizes.force_scale * force, False, colour)
    if abs(shot.lateral_force) > sizes.force_shown:
        brush.arrow(0.0, 0.0, sizes.force_scale * shot.lateral_force, True, canvas.PURPLE)
    brush.dot(0.0, 0.0, DOT[0], canvas.INK)
    brush.dot(0.0, 0.0, DOT[1], canvas.WHITE)


def footprint(p: PlantParameters, length: float) -> Outline:
    """The area between and under the tracks, in the body's frame [m]; length: contact length."""
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)
    return chamfered(-half, half, side, min(ROUNDED * length, 0.3 * half, 0.3 * side))


def ghost_shade(picture: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """The area that the vehicle should cover, to be drawn below the vehicle."""
    if shot.distance > GHOST_REACH * shot.sizes.length:
        return
    length = shot.sizes.length
    brush = Brush(picture, camera, shot.reference, length)
    corners = brush.place(footprint(shot.parameters, length))
    low = np.floor(corners.min(axis=0)).astype(int)
    size = np.ceil(corners.max(axis=0)).astype(int) - low + 1
    patch = canvas.surface(int(size[0]), int(size[1]), transparent=True)
    pygame.draw.polygon(patch, (*canvas.BLUE, _GHOST_OPACITY), (corners - low).tolist())
    picture.blit(patch, low.tolist())


def ghost(picture: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """The outline where the vehicle should be, and a line from there to where it is."""
    if shot.distance > GHOST_REACH * shot.sizes.length:
        return
    p, length = shot.parameters, shot.sizes.length
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)

    def paint(fine: pygame.Surface, close: Camera) -> None:
        brush = Brush(fine, close, shot.reference, length)
        brush.stroke(footprint(p, length), canvas.BLUE, WIDE_PEN, True)
        wing = CHEVRON * length
        chevron = [(0.6 * half, wing), (0.85 * half, 0.0), (0.6 * half, -wing)]
        brush.stroke(chevron, canvas.BLUE, BROAD_PEN)

    _sprite(picture, camera, shot.reference, math.hypot(half, side) + 0.05 * length, paint)
    start, end = camera.pixels(np.array([shot.pose[:2], shot.reference[:2]])).tolist()
    pygame.draw.aaline(picture, canvas.WHITE, start, end, 5)
    pygame.draw.aaline(picture, canvas.BLUE, start, end, 3)
    for radius, colour in ((5.0, canvas.WHITE), (4.0, canvas.BLUE)):
        pygame.draw.aacircle(picture, colour, end, radius)


TRAIL_STEP = 0.015  # [contact lengths] between points of the trail
TRAIL_LIMIT = 8192  # [-] points kept; beyond it every second one goes
NOTICE_DURATION = 3.0  # [s] a change stays on the screen after it has ended
NOTICE_WEIGHT = 0.01  # [-] smaller changes of an event's weight are not noticed


class Memory:
    """What has been seen of one episode."""

    def __init__(self, shot: Snapshot) -> None:
        """Start with the first picture of an episode."""
        self._time = shot.time
        self._points = np.empty((TRAIL_LIMIT, 2))
        self._points[0] = shot.state.x, shot.state.y
        self._count = 1
        self.travel = [0.0, 0.0]  # [m] of the left and the right belt
        self._weights = [self._change(shot, e)[2] for e in range(shot.events.shape[1])]
        self._notices: dict[int, tuple[float, str]] = {}

    @property
    def trail(self) -> NDArray[np.float64]:
        """Where the vehicle was, (P, 2) [m], world frame, oldest first."""
        return self._points[: self._count]

    def update(self, shot: Snapshot) -> None:
        """Take in the next picture of the episode."""
        elapsed, self._time = shot.time - self._time, shot.time
        speeds = shot.state.sprocket_speed_left, shot.state.sprocket_speed_right
        for side, speed in enumerate(speeds):
            self.travel[side] += elapsed * speed * shot.parameters.sprocket_radius
        here = np.array([shot.state.x, shot.state.y])
        if np.abs(here - self._points[self._count - 1]).sum() >= TRAIL_STEP * shot.sizes.length:
            if self._count == TRAIL_LIMIT:
                self._count //= 2
                self._points[: self._count] = self._points[::2]
            self._points[self._count] = here
            self._count += 1
        for e in range(shot.events.shape[1]):
            self._watch(shot, e)

    def notices(self) -> list[str]:
        """What has changed lately, a line for each event."""
        return [
            line for since, line in self._notices.values() if self._time - since < NOTICE_DURATION
        ]

    @staticmethod
    def _change(shot: Snapshot, e: int) -> tuple[str, float, float]:
        """Parameter of event e, its value without the event, and the event's weight in [0, 1]."""
        _, parameter, target = shot.events[0, e, :3]
        name = PARAMETER_NAMES[int(parameter)]
        before, after = (
            value_at(shot, count, name, shot.time, shot.state.x, shot.state.y)
            for count in (e, e + 1)
        )
        return name, before, (after - before) / (target - before) if target != before else 0.0

    def _watch(self, shot: Snapshot, e: int) -> None:
        """Note when event e acts. A wave acts everywhere, always: it is not news."""
        if shot.events[0, e, 0] == events.WAVE:
            return
        name, before, weight = self._change(shot, e)
        if name not in shot.reads:
            return
        change = weight - self._weights[e]
        if abs(change) < NOTICE_WEIGHT:
            return
        self._weights[e] = weight
        quantity = QUANTITIES[name]
        usual = getattr(shot.nominal, name)
        numbers = [quantity.number(x, usual) for x in (before, float(shot.events[0, e, 2]))]
        first, last = numbers if change > 0.0 else numbers[::-1]
        self._notices[e] = shot.time, f"{quantity.label}: {first} → {last} {quantity.unit}".rstrip()


# In contact lengths:
BELT = 0.26  # height of a track
CLEARANCE = 0.10  # of the hull above the ground
DECK_HEIGHT = 0.34  # of the hull's top
CABIN_HEIGHT = 0.52
GAP_VEHICLE_MESH = 0.02  # between track and hull
ARC = 6  # [-] edges of a half circle
WHEELS, SPOKES = 5, 10  # [-] wheels of a track, corners of a wheel
WINDOW: Colour = (58, 78, 96)
RUBBER: Colour = (46, 50, 54)
FLOOR, BRIGHT = 0.5, 1.1  # [-] brightness of a face in shade and of one that faces the light
PAD_SHARE = 0.4  # [-] of the belt that is pads


class Faces(NamedTuple):
    """Convex flat polygons; polygon k has the corners from starts[k] to starts[k + 1]."""

    corners: Points  # (V, 3) [m]
    starts: NDArray[np.int64]  # (K + 1,)
    colours: NDArray[np.uint8]  # (K, 3)
    inside: Points  # (K, 3) [m] a point behind each polygon, inside the body

    def lit(self, light: Sequence[float] = LIGHT) -> NDArray[np.uint8]:
        """Colours (K, 3) in the light; light: unit vector to it in the frame of the corners."""
        first = self.corners[self.starts[:-1]]
        second, third = (self.corners[self.starts[:-1] + k] for k in (1, 2))
        normals = np.cross(second - first, third - first)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        outward = np.sign(np.sum(normals * (first - self.inside), axis=1))
        share = np.clip(outward * (normals @ np.asarray(light)), 0.0, None) / LIGHT[2]
        share = np.minimum(AMBIENT + (1.0 - AMBIENT) * share, 1.0)
        factor = FLOOR + (BRIGHT - FLOOR) * share
        return np.clip(np.round(factor[:, None] * self.colours), 0, 255).astype(np.uint8)


def joined(parts: Sequence[Faces]) -> Faces:
    """All polygons of several sets."""
    begin = np.cumsum([0, *(part.starts[-1] for part in parts)])
    starts = [part.starts[:-1] + at for part, at in zip(parts, begin, strict=False)]
    return Faces(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([*starts, begin[-1:]]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.inside for part in parts]),
    )


def _faces(polygons: Sequence[tuple[Points, Colour]], inside: Sequence[float]) -> Faces:
    """A set from corners (k, 3) [m] and a colour each."""
    sizes = [len(corners) for corners, _ in polygons]
    return Faces(
        np.concatenate([corners for corners, _ in polygons]),
        np.cumsum([0, *sizes]),
        np.array([colour for _, colour in polygons], dtype=np.uint8),
        np.tile(np.asarray(inside, dtype=np.float64), (len(polygons), 1)),
    )


def _prism(profile: Sequence[tuple[float, float]], half: float) -> list[Points]:
    """Both ends, then the sides of an outline (x, z) [m] drawn from y = -half to y = half."""
    right, left = (np.array([(x, y, z) for x, z in profile]) for y in (-half, half))
    sides = [np.stack([right[k - 1], right[k], left[k], left[k - 1]]) for k in range(len(profile))]
    return [right, left, *sides]


def _around(p: PlantParameters) -> tuple[float, int]:
    """Length of the belt [m] and number of its pads."""
    length = p.contact_length
    around = 2.0 * length + math.pi * BELT * length
    return around, max(round(around / (PAD_PITCH * length)), 8)


def _on_belt(p: PlantParameters, place: Points) -> Points:
    """(x, z) [m] (P, 2) at places [m] (P,): below from front to rear, then above to the front."""
    length, radius = p.contact_length, 0.5 * BELT * p.contact_length
    arc = math.pi * radius
    place = place % (2.0 * length + 2.0 * arc)
    rear = np.clip((place - length) / radius, 0.0, math.pi)
    front = np.clip((place - 2.0 * length - arc) / radius, 0.0, math.pi)
    below = np.minimum(place, length)
    above = np.clip(place - length - arc, 0.0, length)
    x = 0.5 * length - below + above + radius * (np.sin(front) - np.sin(rear))
    z = radius * (1.0 - np.cos(rear)) - radius * (1.0 - np.cos(front))
    return np.stack([x, z], axis=1)


def _belt(
    p: PlantParameters,
    middle: float,
    slip: float,
    travel: float,
    loads: NDArray[np.uint8] | None = None,
) -> Faces:
    """The belt of one track, coloured by its slip, with pads; travel [m] of the upper belt.

    loads (nx, 3): colours of the loads from the rear to the front, which the belt above them
    takes; then only its pads have the colour of the slip.
    """
    around, pads = _around(p)
    length, half = p.contact_length, 0.5 * p.track_width
    pitch, arc = around / pads, 0.5 * math.pi * BELT * length
    pad = pitch * (np.arange(pads)[:, None] + np.array([0.0, PAD_SHARE])).ravel() + travel
    bends = np.linspace(0.0, arc, ARC + 1)
    edges = np.concatenate([pad % around, length + bends, 2.0 * length + arc + bends])
    edges = np.unique(np.round(edges % around, 9))
    ends = np.append(edges[1:], edges[0] + around)
    on_pad = (0.5 * (edges + ends) - travel) % pitch < PAD_SHARE * pitch
    start, end = _on_belt(p, edges), _on_belt(p, ends)
    corners = np.empty((edges.size, 4, 3))
    corners[:, (0, 3), 0], corners[:, (0, 3), 2] = start[:, :1], start[:, 1:]
    corners[:, (1, 2), 0], corners[:, (1, 2), 2] = end[:, :1], end[:, 1:]
    corners[:, :2, 1], corners[:, 2:, 1] = middle - half, middle + half
    colour = canvas.slip_colour(slip)
    if loads is None:
        colours = np.where(on_pad[:, None], canvas.shaded(colour), colour).astype(np.uint8)
    else:
        share = 0.5 * (start + end)[:, 0] / length + 0.5  # 0 at the rear, 1 at the front
        place = np.clip((share * len(loads)).astype(np.int64), 0, len(loads) - 1)
        colours = np.where(on_pad[:, None], np.array(colour, dtype=np.uint8), loads[place])
    inside = np.tile([0.0, middle, 0.5 * BELT * length], (edges.size, 1))
    return Faces(corners.reshape(-1, 3), 4 * np.arange(edges.size + 1), colours, inside)


def _wheels(p: PlantParameters, middle: float) -> Faces:
    """Side plates and road wheels of one track."""
    around, _ = _around(p)
    length, height = p.contact_length, BELT * p.contact_length
    outline = _on_belt(p, np.linspace(0.0, around, 40, endpoint=False)) * (1.0, 0.96)
    turn = np.linspace(0.0, 2.0 * math.pi, SPOKES, endpoint=False)
    polygons = []
    for half in (-0.5 * p.track_width, 0.5 * p.track_width):
        plate = np.insert(outline, 1, middle + 0.97 * half, axis=1)
        polygons.append((plate, RUBBER))
        for wheel in range(WHEELS):
            outer = wheel in (0, WHEELS - 1)
            x, z = length * (wheel / (WHEELS - 1) - 0.5), (0.5 if outer else 0.36) * height
            radius = (0.38 if outer else 0.26) * height
            y = np.full(SPOKES, middle + half)
            disc = np.stack([x + radius * np.cos(turn), y, z + radius * np.sin(turn)], axis=1)
            polygons.append((disc, DECK))
    return _faces(polygons, (0.0, middle, 0.5 * height))


def _hull(p: PlantParameters) -> Faces:
    """Hull between the tracks with a sloped front, arrow on the deck, cabin with windows."""
    length, reach = p.contact_length, 0.5 * p.contact_length
    inner = max(0.5 * (p.track_gauge - p.track_width) - GAP_VEHICLE_MESH * length, 0.05 * length)
    low, deck, top = CLEARANCE * length, DECK_HEIGHT * length, CABIN_HEIGHT * length
    belly = [
        (-1.05 * reach, low), (0.85 * reach, low), (1.15 * reach, 0.6 * deck),
        (0.85 * reach, deck), (-1.15 * reach, deck),
    ]  # fmt: skip
    polygons = [(corners, HULL) for corners in _prism(belly, inner)]
    arrow = [(0.80 * reach, 0.0), (0.45 * reach, 0.6 * inner), (0.45 * reach, -0.6 * inner)]
    lift = deck + 0.006 * length
    polygons.append((np.array([(x, y, lift) for x, y in arrow]), NOSE))
    cabin = [
        (-0.95 * reach, deck), (-0.85 * reach, top), (0.05 * reach, top), (0.30 * reach, deck)
    ]  # fmt: skip
    for k, corners in enumerate(_prism(cabin, 0.82 * inner)):
        polygons.append((corners, DECK))
        if k in (0, 1, 3, 5):  # right, left, rear, front
            middle = corners.mean(axis=0)
            outward = middle - (-0.35 * reach, 0.0, middle[2])
            outward *= 0.008 * length / np.linalg.norm(outward)
            polygons.append((middle + 0.7 * (corners - middle) + outward, WINDOW))
    return _faces(polygons, (-0.2 * reach, 0.0, 0.7 * deck))


@lru_cache(maxsize=8)
def _rigid(p: PlantParameters) -> Faces:
    """What does not move against the body."""
    middle = 0.5 * p.track_gauge
    return joined([_wheels(p, middle), _wheels(p, -middle), _hull(p)])


def vehicle_faces(
    p: PlantParameters,
    centre_height: float,
    slips: Sequence[float],
    travel: Sequence[float],
    loads: NDArray[np.uint8] | None = None,
) -> Faces:
    """All polygons in the body's frame; (left, right): slips [-] colour, travel [m] moves pads.

    loads (2, nx, 3): colours of the loads along both tracks; None: belts show the slip alone.
    """
    sides = 0.5 * p.track_gauge, -0.5 * p.track_gauge
    under = (None, None) if loads is None else (loads[0], loads[1])
    belts = [_belt(p, *side) for side in zip(sides, slips, travel, under, strict=True)]
    faces = joined([_rigid(p), *belts])
    down = np.array([0.0, 0.0, centre_height])
    return faces._replace(corners=faces.corners - down, inside=faces.inside - down)
