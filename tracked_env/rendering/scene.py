"""The world around the vehicle: paths, vehicle to scale, reference, forces.

Everything but ground and text is drawn on a layer of twice the resolution, which is then
halved: that smooths the edges. Colours on the layer are premultiplied by their opacity.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.physics.parameters import PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour
from tracked_env.rendering.snapshot import Pose, Snapshot

Points = NDArray[np.float64]

FORCE_SCALE = 0.15e-3  # [m/N] length of an arrow
FORCE_SHOWN = 100.0  # [N] smaller forces get no arrow
PAD_PITCH = 0.16  # [m] between two pads of a track
GHOST_REACH = 100.0  # [m] a reference farther away is not drawn
HULL: Colour = (73, 84, 92)
DECK: Colour = (104, 117, 126)
PAD_SHADE = 0.62  # [-] of the track's colour
_PREMULTIPLIED_GHOST = (0, 26, 41, 58)  # BLUE at 23 % opacity


class Camera(NamedTuple):
    """World to pixels of the layer: x right, y down there."""

    x: float  # [m] world, what is in the middle
    y: float  # [m]
    scale: float  # [px/m]
    middle_x: float  # [px]
    middle_y: float  # [px]

    def pixels(self, points: Points) -> Points:
        """World points (P, 2) [m] as pixels (P, 2)."""
        offset = (points - (self.x, self.y)) * (self.scale, -self.scale)
        return offset + (self.middle_x, self.middle_y)


class Brush:
    """Draws shapes given in the frame of a pose."""

    def __init__(self, layer: pygame.Surface, camera: Camera, pose: Pose) -> None:
        """pose: of the frame in which points are given."""
        self.layer, self.camera = layer, camera
        cosine, sine = math.cos(pose.yaw), math.sin(pose.yaw)
        self._rotation = np.array([[cosine, sine], [-sine, cosine]])
        self._origin = (pose.x, pose.y)

    def place(self, points: Sequence[tuple[float, float]]) -> list[list[float]]:
        """Pixels of points [m] in the frame."""
        return self.camera.pixels(np.array(points) @ self._rotation + self._origin).tolist()

    def area(self, points: Sequence[tuple[float, float]], colour: Sequence[int]) -> None:
        """A filled polygon."""
        pygame.draw.polygon(self.layer, colour, self.place(points))

    def stroke(
        self, points: Sequence[tuple[float, float]], colour: Colour, width: int, closed: bool
    ) -> None:
        """A line of `width` px of the layer, with round joints."""
        stroke(self.layer, self.place(points), colour, width, closed)

    def dot(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """A disc; radius in px of the layer."""
        pygame.draw.circle(self.layer, colour, self.place([(x, y)])[0], radius)

    def arrow(self, x: float, y: float, length: float, across: bool, colour: Colour) -> None:
        """From (x, y) along the frame's x axis, or its y axis when `across`; length [m] signed."""
        head = min(0.28, 0.75 * abs(length))
        sign = math.copysign(1.0, length)
        for halo, fill in ((0.035, canvas.WHITE), (0.0, colour)):
            shaft, half = 0.045 + halo, 0.5 * head + 1.3 * halo
            neck, tip = abs(length) - head - 0.5 * halo, abs(length) + 2.0 * halo
            outline = [
                (-halo, shaft), (neck, shaft), (neck, half), (tip, 0.0),
                (neck, -half), (neck, -shaft), (-halo, -shaft),
            ]  # fmt: skip
            self.area(
                [(x + v, y + sign * u) if across else (x + sign * u, y + v) for u, v in outline],
                fill,
            )


def stroke(
    layer: pygame.Surface, points: list[list[float]], colour: Colour, width: int, closed: bool
) -> None:
    """A line with round joints: pygame alone leaves gaps where thick lines bend."""
    pygame.draw.lines(layer, colour, closed, points, width)
    for point in points:
        pygame.draw.circle(layer, colour, point, 0.5 * width)


def path(
    layer: pygame.Surface, camera: Camera, points: Points, colour: Colour, width: int
) -> None:
    """The visible part of a path (P, 2) [m]."""
    pixels = camera.pixels(points)
    inside = ((pixels > -50) & (pixels < np.array(layer.get_size()) + 50)).all(axis=1)
    seen = np.flatnonzero(inside)
    for run in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1):
        if run.size > 1:
            part = pixels[run]
            apart = np.abs(np.diff(part, axis=0)).sum(axis=1).cumsum() // (1.5 * width)
            kept = np.flatnonzero(np.diff(apart, prepend=-1.0, append=math.inf))
            stroke(layer, part[kept].tolist(), colour, width, False)


def _track(
    brush: Brush, middle: float, p: PlantParameters, slip: float, travel: float
) -> None:
    """One track: coloured by its slip, with pads that run forward as the upper belt does."""
    half, width = 0.5 * p.contact_length, 0.5 * p.track_width
    colour = canvas.slip_colour(slip)
    red, green, blue = (round(PAD_SHADE * channel) for channel in colour)
    cut = min(0.06, 0.3 * width)
    outline = _chamfered(-half, half, middle - width, middle + width, cut)
    brush.area(outline, colour)
    count = int(p.contact_length / PAD_PITCH)
    for pad in range(count + 1):
        start = -half + (travel + pad * PAD_PITCH) % (count * PAD_PITCH + PAD_PITCH)
        low, high = start, min(start + 0.35 * PAD_PITCH, half)
        if low < half:
            sides = (middle - width, middle + width)
            brush.area(
                [(low, sides[0]), (high, sides[0]), (high, sides[1]), (low, sides[1])],
                (red, green, blue),
            )
    brush.stroke(outline, canvas.INK, 2, True)


def _chamfered(
    rear: float, front: float, right: float, left: float, cut: float
) -> list[tuple[float, float]]:
    """A rectangle [m] whose corners are cut off."""
    return [
        (rear + cut, right), (front - cut, right), (front, right + cut), (front, left - cut),
        (front - cut, left), (rear + cut, left), (rear, left - cut), (rear, right + cut),
    ]  # fmt: skip


def vehicle(layer: pygame.Surface, camera: Camera, shot: Snapshot, travel: Sequence[float]) -> None:
    """Hull and tracks, to scale."""
    brush, p, state = Brush(layer, camera, shot.pose), shot.parameters, shot.state
    middle = 0.5 * p.track_gauge
    half, inner = 0.5 * p.contact_length, max(middle - 0.5 * p.track_width - 0.05, 0.05)
    for position in (-0.6 * half, 0.6 * half):  # suspension arms
        brush.area(
            [(position - 0.06, -middle), (position + 0.06, -middle),
             (position + 0.06, middle), (position - 0.06, middle)],
            canvas.INK,
        )  # fmt: skip
    _track(brush, middle, p, state.slip_left, travel[0])
    _track(brush, -middle, p, state.slip_right, travel[1])
    hull = _chamfered(-0.95 * half, 1.02 * half, -inner, inner, 0.35 * inner)
    brush.area(hull, HULL)
    brush.stroke(hull, canvas.INK, 2, True)
    brush.area(_chamfered(-0.8 * half, 0.35 * half, -0.7 * inner, 0.7 * inner, 0.1), DECK)
    tip = [(0.88 * half, 0.0), (0.5 * half, 0.45 * inner), (0.5 * half, -0.45 * inner)]
    brush.area(tip, (236, 238, 240))
    brush.dot(0.0, 0.0, 7, canvas.INK)
    brush.dot(0.0, 0.0, 4, canvas.WHITE)


def ghost(layer: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """Where the vehicle should be, and a line to where it is."""
    if shot.distance > GHOST_REACH:
        return
    brush, p = Brush(layer, camera, shot.reference), shot.parameters
    half, side = 0.5 * p.contact_length, 0.5 * (p.track_gauge + p.track_width)
    outline = _chamfered(-half, half, -side, side, 0.1)
    _blend_area(layer, brush.place(outline))
    brush.stroke(outline, canvas.BLUE, 4, True)
    brush.stroke([(0.55 * half, 0.25), (0.9 * half, 0.0), (0.55 * half, -0.25)],
                 canvas.BLUE, 4, False)  # fmt: skip
    ends = camera.pixels(np.array([shot.pose[:2], shot.reference[:2]])).tolist()
    stroke(layer, ends, canvas.WHITE, 8, False)
    stroke(layer, ends, canvas.BLUE, 4, False)
    pygame.draw.circle(layer, canvas.BLUE, ends[1], 8)
    pygame.draw.circle(layer, canvas.WHITE, ends[1], 4)


def _blend_area(layer: pygame.Surface, points: list[list[float]]) -> None:
    """A polygon that what lies below shines through."""
    corners = np.array(points)
    low = np.floor(corners.min(axis=0)).astype(int)
    size = np.ceil(corners.max(axis=0)).astype(int) - low + 1
    patch = canvas.surface(int(size[0]), int(size[1]), transparent=True)
    pygame.draw.polygon(patch, _PREMULTIPLIED_GHOST, (corners - low).tolist())
    layer.blit(patch, low.tolist(), special_flags=pygame.BLEND_PREMULTIPLIED)


def forces(layer: pygame.Surface, camera: Camera, shot: Snapshot) -> None:
    """Tractive efforts and motion resistances beside the tracks, lateral force at the middle."""
    brush, p, state = Brush(layer, camera, shot.pose), shot.parameters, shot.state
    beside = 0.5 * (p.track_gauge + p.track_width) + 0.18
    efforts = state.effort_left, state.effort_right
    for side, effort, resistance in zip((1.0, -1.0), efforts, shot.resistance, strict=True):
        arrows = ((effort, canvas.GREEN), (-resistance, canvas.VERMILLION))
        for force, colour in arrows:
            if abs(force) > FORCE_SHOWN:
                brush.arrow(0.0, side * beside, FORCE_SCALE * force, False, colour)
    if abs(shot.lateral_force) > FORCE_SHOWN:
        brush.arrow(0.0, 0.0, FORCE_SCALE * shot.lateral_force, True, canvas.PURPLE)
