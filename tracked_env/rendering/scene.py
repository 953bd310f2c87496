"""The scene from above, paths, vehicle, reference, forces, and the vehicle as a mesh in space.

Vehicle and forces are drawn on a sprite of four times the resolution, which is then reduced:
that smooths the edges. It is transparent; its colours are premultiplied by their opacity.

The mesh consists of flat polygons in the body's frame: two tracks with pads and wheels, hull,
cabin. Lengths along and across are those of the parameters; heights, which the parameters do not
hold, are shares of the contact length. The belt runs around a stadium: a straight run of the
contact length, half circles at both ends. Origin: centre of mass; the tracks stand on
z = -centre_height.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray
from pygame import Surface

from tracked_env.physics.parameters import PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Bytes, Colour, Floats, Lines
from tracked_env.rendering.snapshot import Pose, Snapshot, placed
from tracked_env.rendering.soil_map import AMBIENT, LIGHT

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
BELT, CLEARANCE = 0.26, 0.10  # height of a track, of the hull above the ground
DECK_HEIGHT, CABIN_HEIGHT = 0.34, 0.52
MESH_GAP = 0.02  # between track and hull of the mesh

SUPERSAMPLING = 4  # [-] of sprites
POINT_DISTANCE = 12.0  # [px] between the points of a path that are drawn
ARC = 6  # [-] edges of a half circle
WHEELS, SPOKES = 5, 10  # [-] wheels of a track, corners of a wheel
FLOOR, BRIGHT = 0.5, 1.1  # [-] brightness of a face in shade and of one that faces the light
HULL: Colour = (82, 94, 103)
DECK: Colour = (112, 125, 135)
NOSE: Colour = (238, 240, 242)
WINDOW: Colour = (58, 78, 96)
RUBBER: Colour = (46, 50, 54)
_GHOST_OPACITY = 60  # of 255


class Camera(NamedTuple):
    """World to pixels: x right, y down there."""

    x: float  # [m] world, what is in the middle
    y: float  # [m]
    scale: float  # [px/m]
    middle_x: float  # [px]
    middle_y: float  # [px]

    def pixels(self, points: Floats) -> Floats:
        """World points (P, 2) [m] as pixels (P, 2)."""
        offset = (points - (self.x, self.y)) * (self.scale, -self.scale)
        return offset + np.array([self.middle_x, self.middle_y])


class Brush:
    """Draws shapes given in the frame of a pose, with lines as wide as suits the vehicle."""

    def __init__(self, target: Surface, camera: Camera, pose: Pose, length: float) -> None:
        """pose: of the frame in which points are given; length: contact length [m]."""
        self._target, self._camera, self._pose, self.length = target, camera, pose, length

    def place(self, points: Outline | Floats) -> Floats:
        """Pixels (P, 2) of points in the frame."""
        return self._camera.pixels(placed(points, self._pose))

    def area(self, points: Outline | Floats, colour: Colour) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self._target, colour, self.place(points).tolist())

    def stroke(self, points: Outline, colour: Colour, width: float, closed: bool = False) -> None:
        """A line of that width [contact lengths] with round joints."""
        thick = max(round(width * self.length * self._camera.scale), 1)
        pixels = self.place(points).tolist()
        pygame.draw.lines(self._target, colour, closed, pixels, thick)
        for pixel in pixels:
            pygame.draw.circle(self._target, colour, pixel, 0.5 * thick)

    def dot(self, radius: float, colour: Colour) -> None:
        """A disc around the origin of the frame; radius [contact lengths]."""
        middle = self.place([(0.0, 0.0)])[0].tolist()
        pygame.draw.circle(self._target, colour, middle, radius * self.length * self._camera.scale)

    def arrow(self, x: float, y: float, length: float, across: bool, colour: Colour) -> None:
        """From (x, y) along the frame's x axis, or its y axis when `across`; length [m] signed."""
        size, sign = abs(length), math.copysign(1.0, length)
        head = min(HEAD * self.length, 0.75 * size)
        for halo, fill in ((HALO * self.length, canvas.WHITE), (0.0, colour)):
            shaft, half = SHAFT * self.length + halo, 0.55 * head + 1.5 * halo
            neck, tip = size - head - halo, size + 2.0 * halo
            left = [(-halo, shaft), (neck, shaft), (neck, half)]
            outline = [*left, (tip, 0.0), *((u, -v) for u, v in reversed(left))]
            turned = [(v, sign * u) if across else (sign * u, v) for u, v in outline]
            self.area([(x + u, y + v) for u, v in turned], fill)


def path(picture: Surface, camera: Camera, points: Floats, colour: Colour) -> None:
    """The visible part of a path (P, 2) [m], as a smooth line of 3 px."""
    pixels = camera.pixels(points)
    inside = ((pixels > -50.0) & (pixels < np.array(picture.get_size()) + 50.0)).all(axis=1)
    visible = np.flatnonzero(inside)
    runs = np.split(visible, np.flatnonzero(np.diff(visible) > 1) + 1)
    for run in runs if visible.size else ():
        part = pixels[run]
        travelled = np.abs(np.diff(part, axis=0)).sum(axis=1).cumsum() // POINT_DISTANCE
        corners = np.flatnonzero(np.diff(travelled, prepend=-1.0, append=math.inf))
        for start, end in pairwise(part[corners].tolist()):
            pygame.draw.aaline(picture, colour, start, end, 3)


def chamfered(rear: float, front: float, side: float, cut: float, middle: float = 0.0) -> Outline:
    """A rectangle whose corners are cut off; `side` is half its width, `middle` its axis."""
    right, left = middle - side, middle + side
    rightmost = [(rear + cut, right), (front - cut, right), (front, right + cut)]
    leftmost = [(front, left - cut), (front - cut, left), (rear + cut, left)]
    return [*rightmost, *leftmost, (rear, left - cut), (rear, right + cut)]


@contextmanager
def _sprite(
    picture: Surface, camera: Camera, pose: Pose, reach: float, length: float
) -> Iterator[Brush]:
    """A brush in the frame of the pose, in high resolution, for what lies within `reach` [m]."""
    middle = camera.pixels(np.array([pose[:2]]))[0]
    half = math.ceil(min(reach * camera.scale, 0.71 * max(picture.get_size()))) + 1
    corner = np.round(middle).astype(int) - half
    side = 2 * half * SUPERSAMPLING
    fine = canvas.surface(side, side, transparent=True)
    x, y = ((middle - corner) * SUPERSAMPLING).tolist()
    yield Brush(fine, Camera(pose.x, pose.y, camera.scale * SUPERSAMPLING, x, y), pose, length)
    smooth = pygame.transform.smoothscale(fine, (2 * half, 2 * half))
    picture.blit(smooth, corner.tolist(), special_flags=pygame.BLEND_PREMULTIPLIED)


def vehicle(picture: Surface, camera: Camera, shot: Snapshot, travel: Sequence[float]) -> None:
    """Hull and tracks to scale, with the forces on them; travel [m] of both belts."""
    p, length = shot.parameters, shot.sizes.length
    side = 0.5 * (p.track_gauge + p.track_width)
    forces = (shot.state.effort_left, shot.state.effort_right, *shot.resistance, shot.lateral_force)
    longest = shot.sizes.force_scale * max(abs(force) for force in forces)
    size = math.hypot(0.5 * p.contact_length, side)
    reach = max(size, math.hypot(longest, side + BESIDE * length)) + MARGIN * length
    with _sprite(picture, camera, shot.pose, reach, length) as brush:
        _body(brush, shot, travel)
        _forces(brush, shot)


def _body(brush: Brush, shot: Snapshot, travel: Sequence[float]) -> None:
    p = shot.parameters
    middle, half = 0.5 * p.track_gauge, 0.5 * p.contact_length
    gap, axle = GAP * brush.length, AXLE * brush.length
    inner = max(middle - 0.5 * p.track_width - gap, gap)
    for x in (-0.6 * half, 0.6 * half):  # suspension
        brush.area(chamfered(x - axle, x + axle, middle, 0.0), canvas.INK)
    for side in (0, 1):
        _track(brush, shot, side, travel[side])
    hull = chamfered(-0.95 * half, 1.02 * half, inner, 0.35 * inner)
    brush.area(hull, HULL)
    brush.stroke(hull, canvas.INK, PEN, True)
    brush.area(chamfered(-0.8 * half, 0.35 * half, 0.7 * inner, 0.15 * inner), DECK)
    brush.area([(0.88 * half, 0.0), (0.5 * half, 0.45 * inner), (0.5 * half, -0.45 * inner)], NOSE)


def _track(brush: Brush, shot: Snapshot, track: int, travel: float) -> None:
    """One track: coloured by its slip, with pads that run forward as the upper belt does.

    Where loads are known it takes their colours, and narrow pads have the colour of the slip.
    """
    p, loads = shot.parameters, shot.loads
    middle = (0.5 - track) * p.track_gauge
    half, side = 0.5 * p.contact_length, 0.5 * p.track_width
    colour = canvas.slip_colour((shot.state.slip_left, shot.state.slip_right)[track])
    cut = min(CHAMFER * brush.length, 0.3 * side, 0.3 * half)
    outline = chamfered(-half, half, side, cut, middle)
    if loads is None:
        brush.area(outline, colour)
        pad_colour, share = canvas.shaded(colour), PAD_SHARE
    else:
        colours = canvas.load_colours(loads[track], shot.load_shown)
        x = np.linspace(-half, half, loads.shape[1] + 1)
        y = np.linspace(middle - side, middle + side, loads.shape[2] + 1)
        meshes = quads(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))
        shades: Any = colours.reshape(-1, 3).tolist()
        for mesh, shade in zip(meshes, shades, strict=True):
            brush.area(mesh, shade)
        pad_colour, share = colour, THIN_PAD_SHARE
    pitch = PAD_PITCH * brush.length
    count = int(p.contact_length / pitch) + 1
    for pad in range(count):
        rear = -half + (travel + pad * pitch) % (count * pitch)
        front = min(rear + share * pitch, half)
        if rear < front:
            brush.area(chamfered(rear, front, side, 0.0, middle), pad_colour)
    brush.stroke(outline, canvas.INK, PEN, True)


def quads(nodes: Floats) -> Floats:
    """Corners (K, 4, D) of the meshes between nodes (R, C, D)."""
    corners = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
    return np.stack(corners, axis=2).reshape(-1, 4, nodes.shape[-1])


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
    brush.dot(DOT[0], canvas.INK)
    brush.dot(DOT[1], canvas.WHITE)


def footprint(p: PlantParameters, length: float) -> Outline:
    """The area between and under the tracks, in the body's frame [m]; length: contact length."""
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)
    return chamfered(-half, half, side, min(ROUNDED * length, 0.3 * half, 0.3 * side))


def ghost_shade(picture: Surface, camera: Camera, shot: Snapshot) -> None:
    """The area that the vehicle should cover, to be drawn below the vehicle."""
    brush = Brush(picture, camera, shot.reference, shot.sizes.length)
    corners = brush.place(footprint(shot.parameters, shot.sizes.length))
    low = np.floor(corners.min(axis=0)).astype(int)
    width, height = (np.ceil(corners.max(axis=0)).astype(int) - low + 1).tolist()
    patch = canvas.surface(width, height, transparent=True)
    pygame.draw.polygon(patch, (*canvas.BLUE, _GHOST_OPACITY), (corners - low).tolist())
    picture.blit(patch, low.tolist())


def ghost(picture: Surface, camera: Camera, shot: Snapshot) -> None:
    """The outline where the vehicle should be, and a line from there to where it is."""
    p, length = shot.parameters, shot.sizes.length
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)

    reach, wing = math.hypot(half, side) + 0.05 * length, CHEVRON * length
    with _sprite(picture, camera, shot.reference, reach, length) as brush:
        brush.stroke(footprint(p, length), canvas.BLUE, WIDE_PEN, True)
        chevron = [(0.6 * half, wing), (0.85 * half, 0.0), (0.6 * half, -wing)]
        brush.stroke(chevron, canvas.BLUE, BROAD_PEN)
    start, end = camera.pixels(np.array([shot.pose[:2], shot.reference[:2]])).tolist()
    for colour, width in ((canvas.WHITE, 5), (canvas.BLUE, 3)):
        pygame.draw.aaline(picture, colour, start, end, width)
    for colour, radius in ((canvas.WHITE, 5.0), (canvas.BLUE, 4.0)):
        pygame.draw.aacircle(picture, colour, end, radius)


def draw(
    picture: Surface, shot: Snapshot, zoom: int, lines: Lines, travel: Sequence[float]
) -> None:
    """Objects on the ground, the lowest first; the vehicle is in the middle of the picture.

    zoom [px/m]; lines: paths (P, 2) [m] and their colours; travel [m] of both belts.
    """
    width, height = picture.get_size()
    camera = Camera(shot.state.x, shot.state.y, zoom, 0.5 * width, 0.5 * height)
    for points, colour in lines:
        path(picture, camera, points, colour)
    near = shot.distance <= GHOST_REACH * shot.sizes.length
    if near:
        ghost_shade(picture, camera, shot)
    vehicle(picture, camera, shot, travel)
    if near:
        ghost(picture, camera, shot)


class Faces(NamedTuple):
    """Convex flat polygons; polygon k has the corners from starts[k] to starts[k + 1]."""

    corners: Floats  # (V, 3) [m]
    starts: NDArray[np.int64]  # (K + 1,)
    colours: Bytes  # (K, 3)
    inside: Floats  # (K, 3) [m] a point behind each polygon, inside the body

    def lit(self, light: Sequence[float] = LIGHT) -> Bytes:
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


def concatenated(parts: Sequence[Faces]) -> Faces:
    """All polygons of several sets."""
    begin = np.cumsum([0, *(part.starts[-1] for part in parts)])
    starts = [part.starts[:-1] + at for part, at in zip(parts, begin, strict=False)]
    corners, _, colours, inside = map(np.concatenate, zip(*parts, strict=True))
    return Faces(corners, np.concatenate([*starts, begin[-1:]]), colours, inside)


def _faces(polygons: Sequence[tuple[Floats, Colour]], inside: Sequence[float]) -> Faces:
    """A set from corners (k, 3) [m] and a colour each."""
    corners, colours = zip(*polygons, strict=True)
    starts, behind = np.cumsum([0, *map(len, corners)]), np.array([inside] * len(polygons))
    return Faces(np.concatenate(corners), starts, np.array(colours, dtype=np.uint8), behind)


def _prism(profile: Outline, half: float) -> list[Floats]:
    """Both ends, then the sides of an outline (x, z) [m] drawn from y = -half to y = half."""
    right, left = (np.insert(np.array(profile), 1, y, axis=1) for y in (-half, half))
    sides = [np.stack([right[k - 1], right[k], left[k], left[k - 1]]) for k in range(len(profile))]
    return [right, left, *sides]


def _belt_length(p: PlantParameters) -> float:
    """All around [m]."""
    return 2.0 * p.contact_length + math.pi * BELT * p.contact_length


def _on_belt(p: PlantParameters, place: Floats) -> Floats:
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
    p: PlantParameters, middle: float, slip: float, travel: float, loads: Bytes | None
) -> Faces:
    """The belt of one track, coloured by its slip, with pads; travel [m] of the upper belt.

    loads (nx, 3): colours of the loads from the rear to the front, which the belt above them
    takes; then only its pads have the colour of the slip.
    """
    around, length, half = _belt_length(p), p.contact_length, 0.5 * p.track_width
    pads = max(round(around / (PAD_PITCH * length)), 8)
    pitch, arc = around / pads, 0.5 * math.pi * BELT * length
    pad = pitch * (np.arange(pads)[:, None] + np.array([0.0, PAD_SHARE])).ravel() + travel
    bends = np.linspace(0.0, arc, ARC + 1)
    edges = np.concatenate([pad % around, length + bends, 2.0 * length + arc + bends])
    edges = np.unique(np.round(edges % around, 9))
    ends = np.append(edges[1:], edges[0] + around)
    on_pad = ((0.5 * (edges + ends) - travel) % pitch < PAD_SHARE * pitch)[:, None]
    start, end = _on_belt(p, edges), _on_belt(p, ends)
    corners = np.empty((edges.size, 4, 3))
    corners[:, (0, 3), ::2], corners[:, (1, 2), ::2] = start[:, None], end[:, None]
    corners[:, :2, 1], corners[:, 2:, 1] = middle - half, middle + half
    colour = canvas.slip_colour(slip)
    if loads is None:
        colours = np.where(on_pad, canvas.shaded(colour), colour).astype(np.uint8)
    else:
        share = 0.5 * (start + end)[:, 0] / length + 0.5  # 0 at the rear, 1 at the front
        place = np.clip((share * len(loads)).astype(np.int64), 0, len(loads) - 1)
        colours = np.where(on_pad, colour, loads[place]).astype(np.uint8)
    inside = np.tile([0.0, middle, 0.5 * BELT * length], (edges.size, 1))
    return Faces(corners.reshape(-1, 3), 4 * np.arange(edges.size + 1), colours, inside)


def _wheels(p: PlantParameters, middle: float) -> Faces:
    """Side plates and road wheels of one track."""
    length, height = p.contact_length, BELT * p.contact_length
    outline = _on_belt(p, np.linspace(0.0, _belt_length(p), 40, endpoint=False)) * (1.0, 0.96)
    turn = np.linspace(0.0, 2.0 * math.pi, SPOKES, endpoint=False)
    polygons = []
    for half in (-0.5 * p.track_width, 0.5 * p.track_width):
        polygons.append((np.insert(outline, 1, middle + 0.97 * half, axis=1), RUBBER))
        for wheel in range(WHEELS):
            centre, size = (0.5, 0.38) if wheel in (0, WHEELS - 1) else (0.36, 0.26)
            x, z, radius = length * (wheel / (WHEELS - 1) - 0.5), centre * height, size * height
            y = np.full(SPOKES, middle + half)
            disc = np.stack([x + radius * np.cos(turn), y, z + radius * np.sin(turn)], axis=1)
            polygons.append((disc, DECK))
    return _faces(polygons, (0.0, middle, 0.5 * height))


def _hull(p: PlantParameters) -> Faces:
    """Hull between the tracks with a sloped front, arrow on the deck, cabin with windows."""
    length, reach = p.contact_length, 0.5 * p.contact_length
    inner = max(0.5 * (p.track_gauge - p.track_width) - MESH_GAP * length, 0.05 * length)
    low, deck, top = CLEARANCE * length, DECK_HEIGHT * length, CABIN_HEIGHT * length
    front = [(0.85 * reach, low), (1.15 * reach, 0.6 * deck), (0.85 * reach, deck)]
    belly = [(-1.05 * reach, low), *front, (-1.15 * reach, deck)]
    polygons = [(corners, HULL) for corners in _prism(belly, inner)]
    arrow = [(0.80 * reach, 0.0), (0.45 * reach, 0.6 * inner), (0.45 * reach, -0.6 * inner)]
    polygons.append((np.insert(np.array(arrow), 2, deck + 0.006 * length, axis=1), NOSE))
    roof = [(-0.85 * reach, top), (0.05 * reach, top)]
    cabin = [(-0.95 * reach, deck), *roof, (0.30 * reach, deck)]
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
    return concatenated([_wheels(p, middle), _wheels(p, -middle), _hull(p)])


def vehicle_faces(
    p: PlantParameters,
    centre_height: float,
    slips: Sequence[float] = (0.0, 0.0),
    travel: Sequence[float] = (0.0, 0.0),
    loads: Bytes | None = None,
) -> Faces:
    """All polygons in the body's frame; (left, right): slips [-] colour, travel [m] moves pads.

    loads (2, nx, 3): colours of the loads along both tracks; None: belts show the slip alone.
    """
    under = (None, None) if loads is None else loads
    sides = zip((0.5 * p.track_gauge, -0.5 * p.track_gauge), slips, travel, under, strict=True)
    faces = concatenated([_rigid(p), *(_belt(p, *side) for side in sides)])
    down = np.array([0.0, 0.0, centre_height])
    return faces._replace(corners=faces.corners - down, inside=faces.inside - down)
