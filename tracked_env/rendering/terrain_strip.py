"""The strip below the scene on a terrain: profile along the path, loads under the tracks, tilt.

profile  height of the ground under the reference against the distance along it
loads    normal load of each patch, seen from above, the front at the top, one linear scale
tilt     the vehicle from behind (roll) and from its right side (pitch), with the tilt limit
"""

import math

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour, Text
from tracked_env.rendering.scene import DECK, HULL
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.terrain_source import BodyPose, TerrainSource, pose_of

FloatArray = NDArray[np.float64]

WIDTH, HEIGHT = 960, 160  # [px]
_PROFILE = pygame.Rect(48, 30, 400, 98)
_LOADS = (pygame.Rect(528, 30, 40, 98), pygame.Rect(588, 30, 40, 98))  # left, right track
_DIALS = ((752, 84), (884, 84))  # [px] middles: roll, pitch
_RADIUS = 46  # [px] of a dial
_MARGIN = 0.15  # [-] of the range of heights, above and below the profile
_FLATTEST = 0.25  # [contact lengths] range of heights that is shown at least
_POINTS = 400  # [-] of the profile
_LONGEST = 1.3  # [contact lengths] width of a silhouette at most
_NEAR_LIMIT = 0.8  # [-] of the tilt limit, from which tilt is written in vermillion
EARTH: Colour = (219, 199, 166)


class TerrainStrip:
    """The strip of one episode."""

    def __init__(self, text: Text, terrain: TerrainSource, path: FloatArray, length: float) -> None:
        """path (P, 2) [m] of the reference, in time; length: contact length [m]."""
        self.surface = canvas.surface(WIDTH, HEIGHT)
        self._text, self._terrain = text, terrain
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        self._distance = np.concatenate([[0.0], np.cumsum(steps)])  # [m] at points of the path
        self._total = max(float(self._distance[-1]), 1e-9)
        at = np.linspace(0.0, self._total, _POINTS)
        places = np.stack([np.interp(at, self._distance, path[:, k]) for k in (0, 1)])
        heights = terrain.checked_heights(*places)
        low, high = float(heights.min()), float(heights.max())
        spread = max(high - low, _FLATTEST * length)
        self._low = 0.5 * (low + high) - (0.5 + _MARGIN) * spread
        self._per_metre = _PROFILE.height / ((1.0 + 2.0 * _MARGIN) * spread)  # [px/m] upward
        columns = _PROFILE.x + at / self._total * (_PROFILE.width - 1)
        self._line = np.stack([columns, self._row(heights)], axis=1)
        self._range = low, high
        self._length = length

    def draw(self, shot: Snapshot, done: int, interval: float) -> pygame.Surface:
        """The strip now.

        done: points of the path that are past; interval [m] of contours.
        """
        self.surface.fill(canvas.PAPER)
        pygame.draw.line(self.surface, canvas.RULE, (0, 0), (WIDTH, 0))
        pose = pose_of(shot.state, self._terrain)
        self._profile(pose, done, interval)
        self._loads(shot)
        self._tilt(pose, shot)
        return self.surface

    def _row(self, height: FloatArray | float) -> FloatArray:
        return np.asarray(_PROFILE.bottom - 1 - (height - self._low) * self._per_metre)

    def _heading(self, string: str, x: int, end: int) -> None:
        width = self._text.put(self.surface, string, x, 8, 10, canvas.MUTED, bold=True)
        pygame.draw.line(self.surface, canvas.RULE, (x + width + 6, 14), (end, 14))

    def _profile(self, pose: BodyPose, done: int, interval: float) -> None:
        self._heading("PROFILE ALONG THE REFERENCE", 14, _PROFILE.right)
        box, line = _PROFILE, self._line.tolist()
        earth = [*line, (box.right - 1, box.bottom - 1), (box.left, box.bottom - 1)]
        pygame.draw.polygon(self.surface, EARTH, earth)
        x = box.x + float(self._distance[min(done, len(self._distance)) - 1]) / self._total * (
            box.width - 1
        )
        past = int(np.searchsorted(self._line[:, 0], x))
        for part, colour in ((line[:past], canvas.PALE_BLUE), (line[past:], canvas.BLUE)):
            if len(part) > 1:
                pygame.draw.aalines(self.surface, colour, False, part)
                pygame.draw.aalines(self.surface, colour, False, [(a, b + 1) for a, b in part])
        ground = pose.z - self._terrain.centre_height
        y = min(max(float(self._row(ground)), box.top), box.bottom - 1)
        pygame.draw.line(self.surface, canvas.MUTED, (x, box.top), (x, box.bottom - 1))
        pygame.draw.circle(self.surface, canvas.WHITE, (x, y), 5)
        pygame.draw.circle(self.surface, canvas.VERMILLION, (x, y), 4)
        pygame.draw.rect(self.surface, canvas.RULE, box, 1)
        put, (low, high) = self._text.put, self._range
        for height in (low, high) if high > low else (low,):
            row = round(float(self._row(height)))
            put(self.surface, f"{height:.2f}", box.x - 5, row - 7, 10, canvas.MUTED, align=1.0)
        below = box.bottom + 4
        put(self.surface, "0 m", box.x, below, 10, canvas.MUTED)
        put(self.surface, f"{self._total:.1f} m", box.right, below, 10, canvas.MUTED, align=1.0)
        steeper = self._per_metre * self._total / box.width
        label = f"heights [m] x{steeper:.1f}; contour lines every {interval:g} m"
        put(self.surface, label, box.centerx, below, 10, canvas.MUTED, align=0.5)

    def _loads(self, shot: Snapshot) -> None:
        loads = shot.loads
        left, right = _LOADS
        self._heading("NORMAL LOADS", left.x - 52, right.right + 34)
        put = self._text.put
        if loads is None:
            put(self.surface, "not known", left.right + 10, 72, 11, canvas.MUTED, align=0.5)
            return
        full = shot.load_shown
        for box, patches in zip(_LOADS, loads, strict=True):
            self.surface.blit(load_picture(patches, full, box.size), box)
            pygame.draw.rect(self.surface, canvas.MUTED, box, 1)
            total = float(patches.sum())
            put(self.surface, _force(total), box.centerx, box.bottom + 4, 11, bold=True, align=0.5)
        bar = pygame.transform.rotate(canvas.colour_bar(canvas.LOAD_SCALE, left.height, 8), 90)
        self.surface.blit(bar, (left.x - 14, left.y))
        put(self.surface, "front", right.right + 6, right.y, 10, canvas.MUTED)
        put(self.surface, _force(full), left.x - 18, left.y - 4, 10, canvas.MUTED, align=1.0)
        share = "a patch" if loads[0].size > 1 else "a track"
        put(self.surface, share, left.x - 18, left.y + 8, 10, canvas.MUTED, align=1.0)
        put(self.surface, "0", left.x - 18, left.bottom - 10, 10, canvas.MUTED, align=1.0)

    def _tilt(self, pose: BodyPose, shot: Snapshot) -> None:
        limit, p = self._terrain.tilt_limit, shot.parameters
        self._heading("TILT", _DIALS[0][0] - 64, WIDTH - 14)
        dials = (
            ("roll", pose.roll, (p.track_gauge + p.track_width) / p.contact_length, 0.0),
            ("pitch", pose.pitch, _LONGEST, 0.3),
        )
        for middle, (name, angle, width, nose) in zip(_DIALS, dials, strict=True):
            self._dial(middle, angle, limit, 0.62 * _RADIUS * min(width, _LONGEST), nose)
            label = f"{name} {math.degrees(angle):+z.1f}°"
            self._text.put(self.surface, label, middle[0], 24, 11, bold=True, align=0.5)
        near = pose.tilt > _NEAR_LIMIT * limit
        label = f"tilt {math.degrees(pose.tilt):.1f}° of {math.degrees(limit):.0f}°"
        colour = canvas.VERMILLION if near else canvas.INK
        between = (_DIALS[0][0] + _DIALS[1][0]) // 2
        self._text.put(self.surface, label, between, 138, 11, colour, bold=near, align=0.5)

    def _dial(
        self, middle: tuple[int, int], angle: float, limit: float, half: float, nose: float
    ) -> None:
        """A silhouette turned clockwise by an angle [rad], and where it may not go.

        half [px]: of its width; nose [-]: share of it by which the front, at the right, slopes.
        """
        pygame.draw.aacircle(self.surface, canvas.RULE, middle, _RADIUS, 1)
        box = pygame.Rect(0, 0, 2 * _RADIUS, 2 * _RADIUS)
        box.center = middle
        for begin in (limit, math.pi + limit):  # no side of the vehicle between limit and upright
            end = begin + math.pi - 2.0 * limit
            if end > begin:
                pygame.draw.arc(self.surface, canvas.VERMILLION, box, begin, end, 3)
        cosine, sine = math.cos(angle), math.sin(angle)

        def turned(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
            return [
                (middle[0] + cosine * x - sine * y, middle[1] + sine * x + cosine * y)
                for x, y in points
            ]

        reach = _RADIUS - 2
        pygame.draw.aalines(self.surface, canvas.MUTED, False, turned([(-reach, 0), (reach, 0)]))
        low, deck, top = 0.0, -0.5 * half, -0.85 * half
        front, rear = (0.5 - 0.8 * nose) * half, (-0.5 - 0.8 * nose) * half
        hull = [(-half, low), (half, low), (half - nose * half, deck), (-half, deck)]
        cabin = [(rear, deck), (front, deck), (front - 0.15 * half, top), (rear + 0.15 * half, top)]
        for points, colour in ((hull, HULL), (cabin, DECK)):
            pygame.draw.polygon(self.surface, colour, turned(points))


def load_picture(patches: FloatArray, full: float, size: tuple[int, int]) -> pygame.Surface:
    """One track's loads (nx, ny) [N] from above, the front at the top; full [N]: scale's end."""
    seen = patches[::-1, ::-1]  # rear to front, right to left -> top to bottom, left to right
    columns = np.arange(size[0]) * seen.shape[1] // size[0]
    rows = np.arange(size[1]) * seen.shape[0] // size[1]
    picture = canvas.surface(*size)
    canvas.paint(picture, canvas.load_colours(seen, full)[rows][:, columns])
    return picture


def _force(force: float) -> str:
    return f"{force / 1e3:.1f} kN" if abs(force) >= 1e3 else f"{force:.0f} N"
