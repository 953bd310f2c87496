"""The world around the vehicle: paths, vehicle to scale, reference, forces.

Vehicle and forces are drawn on a sprite of four times the resolution, which is then reduced:
that smooths the edges. It is transparent; its colours are premultiplied by their opacity.
"""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.physics.parameters import PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour
from tracked_env.rendering.snapshot import Pose, Snapshot

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
