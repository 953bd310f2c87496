"""Texts over the scene, and the strip below it on a terrain.

Over the scene: key of lines, scales, coordinates of the grid, notices. The strip:
    profile  height of the ground under the reference against the distance along it
    loads    normal load of each patch, seen from above, the front at the top, one linear scale
    tilt     the vehicle from behind (roll) and from its right side (pitch), with the tilt limit
"""

import math
from typing import Any

import numpy as np
import pygame
from pygame import Rect, Surface

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import MUTED, Colour, Floats, Sheet, grid_of, scale_bar
from tracked_env.rendering.scene import DECK, HULL
from tracked_env.rendering.snapshot import BodyPose, Snapshot, TerrainSource
from tracked_env.rendering.soil_map import SoilMap

WIDTH, HEIGHT = 640, 640  # [px] of the scene
TOP, BOTTOM = 26, 52  # [px] height of the strips over it
_VEIL = (252, 252, 251, 242)
_NOTICE = (33, 37, 41, 225)
_BAR, _SLIP_BAR = 120, 150  # [px] width of the colour bars
_KEY = (  # two lines, then arrows, which are not drawn in perspective
    (canvas.BLUE, "reference"),
    (canvas.INK, "driven"),
    (canvas.GREEN, "tractive effort"),
    (canvas.VERMILLION, "motion resistance"),
    (canvas.PURPLE, "lateral force"),
)

STRIP_WIDTH, STRIP_HEIGHT = 960, 160  # [px]
_PROFILE = Rect(60, 30, 388, 98)
_LOADS = (Rect(540, 30, 40, 98), Rect(616, 30, 40, 98))  # left, right track
_DIALS = ((766, 88), (890, 88))  # [px] middles: roll, pitch
_RADIUS = 46  # [px] of a dial
_MARGIN = 0.15  # [-] of the range of heights, above and below the profile
_FLATTEST = 0.25  # [contact lengths] range of heights that is shown at least
_POINTS = 400  # [-] of the profile
_LONGEST = 1.3  # [contact lengths] width of a silhouette at most
_NEAR_LIMIT = 0.8  # [-] of the tilt limit, from which tilt is written in vermillion
EARTH: Colour = (219, 199, 166)


class Legend(Sheet):
    """What lies over the scene."""

    def draw(self, soil: SoilMap, shot: Snapshot, notices: list[str], zoom: int | None) -> None:
        """All but the coordinates; zoom [px/m]: None in perspective, which has no arrows."""
        self._veil(Rect(0, 0, WIDTH, TOP), _VEIL)
        self._key(zoom is not None)
        y = HEIGHT - BOTTOM
        self._veil(Rect(0, y, WIDTH, BOTTOM), _VEIL)
        if zoom is not None:
            self._lengths(shot, y, zoom)
        self._soil_bar(soil, shot, y)
        self._slip_bar(shot, y)
        lines = [*notices, shot.ending] if shot.ending else notices
        if lines:
            style: Any = {"size": canvas.TEXT, "bold": True, "colour": canvas.WHITE}
            width = max(canvas.text_image(line, **style).get_width() for line in lines) + 28
            box = Rect((WIDTH - width) // 2, TOP + 20, width, 20 * len(lines) + 12)
            self._veil(box, _NOTICE)
            for row, line in enumerate(lines):
                self.put(line, WIDTH // 2, box.y + 6 + 20 * row, align=0.5, **style)

    def _veil(self, box: Rect, colour: tuple[int, int, int, int]) -> None:
        """Cover a part of the picture so that text on it can be read."""
        cover = canvas.surface(*box.size, transparent=True)
        pygame.draw.rect(cover, colour, cover.get_rect(), border_radius=0 if box.x == 0 else 6)
        self.surface.blit(cover, box)

    def coordinates(self, left: float, top: float, zoom: int) -> None:
        """Label the thick grid lines with x below the upper strip and with y at the left."""
        x0, y0 = round(left * zoom), round(-top * zoom)
        metres = grid_of(zoom).side
        side = metres * zoom
        for column in range(x0 // side + 1, (x0 + WIDTH - 1) // side + 1):
            x = column * side - x0
            if x < WIDTH - 60:
                self.note(f"x {metres * column}", x + 4, TOP + 3)
        for row in range(y0 // side + 1, (y0 + HEIGHT - 1) // side + 1):
            y = row * side - y0
            if TOP + 20 < y < HEIGHT - BOTTOM - 16:
                self.note(f"y {-metres * row}", 4, y + 3)

    def _key(self, arrows: bool) -> None:
        """Key of lines and, if there are any, arrows."""
        x, middle = 8, TOP // 2
        for number, (colour, label) in enumerate(_KEY if arrows else _KEY[:2]):
            pygame.draw.line(self.surface, colour, (x, middle), (x + 13, middle), 3)
            if number > 1:
                tip = [(x + 17, middle), (x + 9, middle - 5), (x + 9, middle + 5)]
                pygame.draw.polygon(self.surface, colour, tip)
            x += 33 + self.put(label, x + 21, middle - 9)

    def _lengths(self, shot: Snapshot, y: int, zoom: int) -> None:
        """Scale of lengths and of forces."""
        metres, force = scale_bar(zoom), shot.sizes.force_sample
        x, length = 10, round(metres * zoom)
        self.put(f"{metres:g} m", x, y + 4)
        pygame.draw.rect(self.surface, canvas.INK, (x, y + 31, length, 4))
        half = (x + length // 2, y + 32, length // 2 - 1, 2)
        pygame.draw.rect(self.surface, canvas.WHITE, half)
        x, length = 124, round(force * shot.sizes.force_scale * zoom)
        self.put(f"{force / 1e3:g} kN" if force >= 1e3 else f"{force:g} N", x, y + 4)
        pygame.draw.line(self.surface, canvas.INK, (x, y + 33), (x + length - 6, y + 33), 3)
        tip = [(x + length, y + 33), (x + length - 9, y + 28), (x + length - 9, y + 38)]
        pygame.draw.polygon(self.surface, canvas.INK, tip)

    def _soil_bar(self, soil: SoilMap, shot: Snapshot, y: int) -> None:
        """The colours of the ground, and the value below the vehicle."""
        label, x = soil.label, 204
        self.put(f"soil: {label.with_unit}{'' if label.unit else ' [-]'}", x, y + 4)
        start = x + self.put(f"{label.low:g}", x, y + 25) + 6
        self.scale(canvas.SOIL_SCALE, Rect(start, y + 28, _BAR, 12))
        self.put(f"{label.high:g}", start + _BAR + 6, y + 25)
        share = min(max(label.share(getattr(shot.parameters, soil.name)), 0.0), 1.0)
        tip = start + round(share * (_BAR - 1))
        mark = [(tip, y + 37), (tip - 5, y + 46), (tip + 5, y + 46)]
        pygame.draw.polygon(self.surface, canvas.INK, mark)

    def _slip_bar(self, shot: Snapshot, y: int) -> None:
        """The colours of the tracks, logarithmic; of their pads alone where loads are shown too."""
        x, whose = 450, "tracks" if shot.loads is None else "pads"
        self.put(f"slip of {whose} [%]", x, y + 4)
        decades = round(math.log10(1.0 / canvas.SLIP_LOW))
        bar = Rect(x + 12, y + 24, _SLIP_BAR, 9)
        self.scale(canvas.SLIP_SCALE, bar)
        for decade in range(decades + 1):
            at = bar.x + round(decade * (bar.width - 1) / decades)
            pygame.draw.line(self.surface, canvas.INK, (at, bar.y), (at, bar.bottom + 1))
            label = f"{100 * canvas.SLIP_LOW * 10**decade:g}"
            self.put(label, at, bar.bottom, align=0.5)


class TerrainStrip(Sheet):
    """The strip of one episode."""

    def __init__(self, terrain: TerrainSource, path: Floats, length: float) -> None:
        """path (P, 2) [m] of the reference, in time; length: contact length [m]."""
        super().__init__(canvas.surface(STRIP_WIDTH, STRIP_HEIGHT))
        self._terrain = terrain
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        self._distance = np.concatenate([[0.0], np.cumsum(steps)])  # [m] at points of the path
        self._total = max(float(self._distance[-1]), 1e-9)
        at = np.linspace(0.0, self._total, _POINTS)
        places = np.stack([np.interp(at, self._distance, path[:, k]) for k in (0, 1)])
        heights = terrain.checked_heights(*places)
        low, high = self._range = float(heights.min()), float(heights.max())
        spread = max(high - low, _FLATTEST * length)
        self._low = 0.5 * (low + high) - (0.5 + _MARGIN) * spread
        self._per_metre = _PROFILE.height / ((1.0 + 2.0 * _MARGIN) * spread)  # [px/m] upward
        columns = _PROFILE.x + at / self._total * (_PROFILE.width - 1)
        self._line = np.stack([columns, self._row(heights)], axis=1)

    def draw(self, shot: Snapshot, done: int, interval: float) -> Surface:
        """The strip now; done: points of the path that are past; interval [m] of contours."""
        self.surface.fill(canvas.PAPER)
        pygame.draw.line(self.surface, canvas.RULE, (0, 0), (STRIP_WIDTH, 0))
        pose = self._terrain.pose(shot.state)
        self._profile(pose, done, interval)
        self._loads(shot)
        self._tilt(pose, shot)
        return self.surface

    def _row(self, height: Floats | float) -> Floats:
        return np.asarray(_PROFILE.bottom - 1 - (height - self._low) * self._per_metre)

    def _profile(self, pose: BodyPose, done: int, interval: float) -> None:
        self.heading("Profile along the reference", 14, 6, _PROFILE.right)
        box, line = _PROFILE, self._line.tolist()
        earth = [*line, (box.right - 1, box.bottom - 1), (box.left, box.bottom - 1)]
        pygame.draw.polygon(self.surface, EARTH, earth)
        distance = float(self._distance[min(done, len(self._distance)) - 1])
        x = box.x + distance / self._total * (box.width - 1)
        past = int(np.searchsorted(self._line[:, 0], x))
        for part, colour in ((line[:past], canvas.PALE_BLUE), (line[past:], canvas.BLUE)):
            if len(part) > 1:
                pygame.draw.aalines(self.surface, colour, False, part)
                pygame.draw.aalines(self.surface, colour, False, [(a, b + 1) for a, b in part])
        ground = pose.z - self._terrain.centre_height
        y = min(max(float(self._row(ground)), box.top), box.bottom - 1)
        pygame.draw.line(self.surface, MUTED, (x, box.top), (x, box.bottom - 1))
        self.here((x, y))
        pygame.draw.rect(self.surface, canvas.RULE, box, 1)
        for height in dict.fromkeys(self._range):
            self.note(f"{height:.2f}", box.x - 5, round(float(self._row(height))) - 9, 1.0)
        below, steeper = box.bottom + 4, self._per_metre * self._total / box.width
        self.note("0 m", box.x, below)
        self.note(f"{self._total:.1f} m", box.right, below, 1.0)
        label = f"height [m] x{steeper:.1f}, contours {interval:g} m"
        self.note(label, box.centerx, below, 0.5)

    def _loads(self, shot: Snapshot) -> None:
        (left, right), loads = _LOADS, shot.loads
        self.heading("Normal loads", left.x - 74, 6, right.right + 40)
        if loads is None:
            self.put("not known", left.right + 18, 72, colour=MUTED, align=0.5)
            return
        full = shot.load_shown
        for box, patches in zip(_LOADS, loads, strict=True):
            self.surface.blit(load_picture(patches, full, box.size), box)
            pygame.draw.rect(self.surface, MUTED, box, 1)
            total = _force(float(patches.sum()))
            self.put(total, box.centerx, box.bottom + 4, bold=True, align=0.5)
        bar = pygame.transform.rotate(canvas.colour_bar(canvas.LOAD_SCALE, left.height, 8), 90)
        self.surface.blit(bar, (left.x - 14, left.y))
        self.note("front", right.right + 6, right.y)
        self.note(_force(full), left.x - 18, left.y - 2, 1.0)
        self.note("a patch" if loads[0].size > 1 else "a track", left.x - 18, left.y + 16, 1.0)
        self.note("0", left.x - 18, left.bottom - 14, 1.0)

    def _tilt(self, pose: BodyPose, shot: Snapshot) -> None:
        limit, p = self._terrain.tilt_limit, shot.parameters
        self.heading("Tilt", _DIALS[0][0] - 58, 6, STRIP_WIDTH - 14)
        across = min((p.track_gauge + p.track_width) / p.contact_length, _LONGEST)
        dials = (("roll", pose.roll, across, 0.0), ("pitch", pose.pitch, _LONGEST, 0.3))
        for middle, (name, angle, width, nose) in zip(_DIALS, dials, strict=True):
            self._dial(middle, angle, limit, 0.62 * _RADIUS * width, nose)
            label = f"{name} {math.degrees(angle):+z.1f}°"
            self.put(label, middle[0], 24, bold=True, align=0.5)
        near = pose.tilt > _NEAR_LIMIT * limit
        label = f"tilt {math.degrees(pose.tilt):.1f}° of {math.degrees(limit):.0f}°"
        colour = canvas.VERMILLION if near else canvas.INK
        between = (_DIALS[0][0] + _DIALS[1][0]) // 2
        self.put(label, between, 138, colour=colour, bold=near, align=0.5)

    def _dial(
        self, middle: tuple[int, int], angle: float, limit: float, half: float, nose: float
    ) -> None:
        """A silhouette turned clockwise by an angle [rad], and where it may not go.

        half [px]: of its width; nose [-]: share of it by which the front, at the right, slopes.
        """
        pygame.draw.aacircle(self.surface, canvas.RULE, middle, _RADIUS, 1)
        box = Rect(0, 0, 2 * _RADIUS, 2 * _RADIUS)
        box.center = middle
        for begin in (limit, math.pi + limit):  # no side of the vehicle between limit and upright
            end = begin + math.pi - 2.0 * limit
            if end > begin:
                pygame.draw.arc(self.surface, canvas.VERMILLION, box, begin, end, 3)
        cosine, sine = math.cos(angle), math.sin(angle)

        def turned(*points: tuple[float, float]) -> list[tuple[float, float]]:
            mx, my = middle
            return [(mx + cosine * x - sine * y, my + sine * x + cosine * y) for x, y in points]

        reach = _RADIUS - 2
        pygame.draw.aalines(self.surface, MUTED, False, turned((-reach, 0), (reach, 0)))
        deck, top = -0.5 * half, -0.85 * half
        front, rear = (0.5 - 0.8 * nose) * half, (-0.5 - 0.8 * nose) * half
        hull = turned((-half, 0.0), (half, 0.0), (half - nose * half, deck), (-half, deck))
        roof = (front - 0.15 * half, top), (rear + 0.15 * half, top)
        pygame.draw.polygon(self.surface, HULL, hull)
        pygame.draw.polygon(self.surface, DECK, turned((rear, deck), (front, deck), *roof))


def load_picture(patches: Floats, full: float, size: tuple[int, int]) -> Surface:
    """One track's loads (nx, ny) [N] from above, the front at the top; full [N]: scale's end."""
    rows_down = patches[::-1, ::-1]  # rear to front, right to left -> top to bottom, left to right
    columns = np.arange(size[0]) * rows_down.shape[1] // size[0]
    rows = np.arange(size[1]) * rows_down.shape[0] // size[1]
    picture = canvas.surface(*size)
    canvas.paint(picture, canvas.load_colours(rows_down, full)[rows][:, columns])
    return picture


def _force(force: float) -> str:
    return f"{force / 1e3:.1f} kN" if abs(force) >= 1e3 else f"{force:.0f} N"
