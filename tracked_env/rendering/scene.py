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

FORCE_SCALE = 0.15e-3  # [m/N] length of an arrow
FORCE_SHOWN = 100.0  # [N] smaller forces get no arrow
PAD_PITCH = 0.16  # [m] between two pads of a track
BESIDE = 0.18  # [m] from a track to the arrows of its forces
GHOST_REACH = 100.0  # [m] a reference farther away is not drawn
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
    """Draws shapes given in the frame of a pose."""

    def __init__(self, target: pygame.Surface, camera: Camera, pose: Pose) -> None:
        """pose: of the frame in which points are given."""
        self._target, self._camera = target, camera
        cosine, sine = math.cos(pose.yaw), math.sin(pose.yaw)
        self._rotation = np.array([[cosine, sine], [-sine, cosine]])
        self._origin = (pose.x, pose.y)

    def place(self, points: Outline) -> Points:
        """Pixels (P, 2) of points in the frame."""
        return self._camera.pixels(np.array(points) @ self._rotation + self._origin)

    def area(self, points: Outline, colour: Colour) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self._target, colour, self.place(points).tolist())

    def stroke(self, points: Outline, colour: Colour, width: float, closed: bool = False) -> None:
        """A line of that width [m] with round joints."""
        thick = max(round(width * self._camera.scale), 1)
        pixels = self.place(points).tolist()
        pygame.draw.lines(self._target, colour, closed, pixels, thick)
        for pixel in pixels:
            pygame.draw.circle(self._target, colour, pixel, 0.5 * thick)

    def dot(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """A disc [m]."""
        middle = self.place([(x, y)])[0].tolist()
        pygame.draw.circle(self._target, colour, middle, radius * self._camera.scale)

    def arrow(self, x: float, y: float, length: float, across: bool, colour: Colour) -> None:
        """From (x, y) along the frame's x axis, or its y axis when `across`; length [m] signed."""
        size, sign = abs(length), math.copysign(1.0, length)
        head = min(0.28, 0.75 * size)
        for halo, fill in ((0.035, canvas.WHITE), (0.0, colour)):
            shaft, half = 0.045 + halo, 0.55 * head + 1.5 * halo
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
    p = shot.parameters
    size = math.hypot(0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width))
    drawn = (
        shot.state.effort_left, shot.state.effort_right, *shot.resistance, shot.lateral_force
    )  # fmt: skip
    longest = FORCE_SCALE * max(abs(force) for force in drawn)
    side = 0.5 * (p.track_gauge + p.track_width) + BESIDE
    reach = max(size, math.hypot(longest, side)) + 0.3

    def paint(fine: pygame.Surface, close: Camera) -> None:
        brush = Brush(fine, close, shot.pose)
        _body(brush, shot, travel)
        _forces(brush, shot)

    _sprite(picture, camera, shot.pose, reach, paint)


def _body(brush: Brush, shot: Snapshot, travel: Sequence[float]) -> None:
    p, state = shot.parameters, shot.state
    middle, half = 0.5 * p.track_gauge, 0.5 * p.contact_length
    inner = max(middle - 0.5 * p.track_width - 0.05, 0.05)
    for x in (-0.6 * half, 0.6 * half):  # suspension
        brush.area(chamfered(x - 0.06, x + 0.06, middle, 0.0), canvas.INK)
    _track(brush, middle, p, state.slip_left, travel[0])
    _track(brush, -middle, p, state.slip_right, travel[1])
    hull = chamfered(-0.95 * half, 1.02 * half, inner, 0.35 * inner)
    brush.area(hull, HULL)
    brush.stroke(hull, canvas.INK, 0.03, True)
    brush.area(chamfered(-0.8 * half, 0.35 * half, 0.7 * inner, 0.15 * inner), DECK)
    brush.area([(0.88 * half, 0.0), (0.5 * half, 0.45 * inner), (0.5 * half, -0.45 * inner)], NOSE)


def _track(brush: Brush, middle: float, p: PlantParameters, slip: float, travel: float) -> None:
    """One track: coloured by its slip, with pads that run forward as the upper belt does."""
    half, side = 0.5 * p.contact_length, 0.5 * p.track_width
    colour = canvas.slip_colour(slip)
    pad_colour = canvas.shaded(colour)
    outline = chamfered(-half, half, side, min(0.07, 0.3 * side, 0.3 * half), middle)
    brush.area(outline, colour)
    count = int(p.contact_length / PAD_PITCH) + 1
    for pad in range(count):
        rear = -half + (travel + pad * PAD_PITCH) % (count * PAD_PITCH)
        front = min(rear + 0.4 * PAD_PITCH, half)
        if rear < front:
            brush.area(chamfered(rear, front, side, 0.0, middle), pad_colour)
    brush.stroke(outline, canvas.INK, 0.03, True)


def _forces(brush: Brush, shot: Snapshot) -> None:
    """Tractive efforts and motion resistances beside the tracks, lateral force at the middle."""
    p, state = shot.parameters, shot.state
    beside = 0.5 * (p.track_gauge + p.track_width) + BESIDE
    efforts = state.effort_left, state.effort_right
    for y, effort, resistance in zip((beside, -beside), efforts, shot.resistance, strict=True):
        for force, colour in ((effort, canvas.GREEN), (-resistance, canvas.VERMILLION)):
            if abs(force) > FORCE_SHOWN:
                brush.arrow(0.0, y, FORCE_SCALE * force, False, colour)
    if abs(shot.lateral_force) > FORCE_SHOWN:
        brush.arrow(0.0, 0.0, FORCE_SCALE * shot.lateral_force, True, canvas.PURPLE)
    brush.dot(0.0, 0.0, 0.08, canvas.INK)
    brush.dot(0.0, 0.0, 0.045, canvas.WHITE)


def _footprint(p: PlantParameters) -> Outline:
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)
    return chamfered(-half, half, side, min(0.1, 0.3 * half, 0.3 * side))


def ghost_shade(picture: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """The area that the vehicle should cover, to be drawn below the vehicle."""
    if shot.distance > GHOST_REACH:
        return
    corners = Brush(picture, camera, shot.reference).place(_footprint(shot.parameters))
    low = np.floor(corners.min(axis=0)).astype(int)
    size = np.ceil(corners.max(axis=0)).astype(int) - low + 1
    patch = canvas.surface(int(size[0]), int(size[1]), transparent=True)
    pygame.draw.polygon(patch, (*canvas.BLUE, _GHOST_OPACITY), (corners - low).tolist())
    picture.blit(patch, low.tolist())


def ghost(picture: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """The outline where the vehicle should be, and a line from there to where it is."""
    if shot.distance > GHOST_REACH:
        return
    p = shot.parameters
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)

    def paint(fine: pygame.Surface, close: Camera) -> None:
        brush = Brush(fine, close, shot.reference)
        brush.stroke(_footprint(p), canvas.BLUE, 0.045, True)
        chevron = [(0.6 * half, 0.22), (0.85 * half, 0.0), (0.6 * half, -0.22)]
        brush.stroke(chevron, canvas.BLUE, 0.05)

    _sprite(picture, camera, shot.reference, math.hypot(half, side) + 0.1, paint)
    start, end = camera.pixels(np.array([shot.pose[:2], shot.reference[:2]])).tolist()
    pygame.draw.aaline(picture, canvas.WHITE, start, end, 5)
    pygame.draw.aaline(picture, canvas.BLUE, start, end, 3)
    for radius, colour in ((5.0, canvas.WHITE), (4.0, canvas.BLUE)):
        pygame.draw.aacircle(picture, colour, end, radius)
