"""The panel beside the scene: numbers, bars, parameters, and the whole path from above."""

import math
from itertools import pairwise

import numpy as np
import pygame

from tracked_env.rendering import belief_rows, canvas, drives
from tracked_env.rendering.afterglow import Memory
from tracked_env.rendering.belief_rows import Beliefs
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.quantities import QUANTITIES, Quantity, value_of
from tracked_env.rendering.scene import Points
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap

WIDTH, HEIGHT = 280, 640  # [px]
_LEFT, _RIGHT = 14, 266  # [px] margins
_OVERVIEW = pygame.Rect(14, 452, 252, 176)
_CHANGED = 1e-6  # [-] relative change that is marked


class Panel:
    """The panel of one episode."""

    def __init__(self, text: Text, reference: Points, soil: SoilMap, margin: float) -> None:
        """reference: the whole path (P, 2) [m]; margin [m] around it in the overview."""
        self.surface = canvas.surface(WIDTH, HEIGHT)
        self._text, self._soil = text, soil
        low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
        self._scale = float(min(np.array(_OVERVIEW.size) / (high - low)))  # [px/m]
        self._middle = 0.5 * (low + high)
        self._path = self._pixels(reference[:: max(len(reference) // 500, 1)])
        self._ground: pygame.Surface | None = None

    def draw(
        self,
        shot: Snapshot,
        memory: Memory,
        refresh: bool,
        view: tuple[float, float] | None,
        beliefs: Beliefs | None = None,
    ) -> pygame.Surface:
        """The panel now; refresh: the map has changed; view [m]: half the scene, if it is seen
        from above; beliefs: of the policy that drives, beside the true parameters.
        """
        self.surface.fill(canvas.PAPER)
        self._clock(shot)
        self._tracking(shot)
        self._heading("DRIVES", 150)
        drives.draw(self.surface, self._text, shot)
        self._heading("VEHICLE AND SOIL UNDER IT", 278)
        if beliefs is not None:
            belief_rows.draw(self.surface, self._text, shot, beliefs)
        else:
            self._parameters(shot)
        self._overview(shot, memory, refresh, view)
        pygame.draw.line(self.surface, canvas.RULE, (0, 0), (0, HEIGHT))
        return self.surface

    def _put(self, string: str, x: int, y: int, **style: object) -> int:
        return self._text.put(self.surface, string, x, y, **style)  # type: ignore[arg-type]

    def _heading(self, string: str, y: int) -> None:
        width = self._put(string, _LEFT, y, size=10, bold=True, colour=canvas.MUTED)
        start = _LEFT + width + 6
        pygame.draw.line(self.surface, canvas.RULE, (start, y + 6), (_RIGHT, y + 6))

    def _clock(self, shot: Snapshot) -> None:
        self._put(f"{shot.time:.2f} s", _LEFT, 9, size=19, bold=True)
        self._put(f"of {shot.duration:g} s", _LEFT + 116, 16, size=11, colour=canvas.MUTED)
        self._put("reward", _RIGHT, 7, size=10, colour=canvas.MUTED, align=1.0)
        self._put(f"{shot.reward:+.3f}", _RIGHT, 19, size=13, bold=True, align=1.0)
        done = min(shot.time / shot.duration, 1.0)
        pygame.draw.rect(self.surface, canvas.RULE, (_LEFT, 40, _RIGHT - _LEFT, 3))
        pygame.draw.rect(self.surface, canvas.BLUE, (_LEFT, 40, round(done * (_RIGHT - _LEFT)), 3))

    def _tracking(self, shot: Snapshot) -> None:
        self._heading("TRACKING", 52)
        self._put("vehicle", 190, 64, size=10, colour=canvas.MUTED, align=1.0)
        self._put("reference", _RIGHT, 64, size=10, colour=canvas.MUTED, align=1.0)
        rows = (
            ("speed [m/s]", f"{shot.state.v_x:.2f}", f"{shot.reference_speed:.2f}"),
            (
                "yaw rate [°/s]",
                f"{math.degrees(shot.state.yaw_rate):.1f}",
                f"{math.degrees(shot.reference_yaw_rate):.1f}",
            ),
            ("position error [m]", f"{shot.distance:.3f}", ""),
            ("heading error [°]", f"{math.degrees(shot.heading_error):.2f}", ""),
        )
        for row, (label, value, wanted) in enumerate(rows):
            y = 78 + 16 * row
            self._put(label, _LEFT, y)
            self._put(_tidy(value), 190, y, bold=True, align=1.0)
            self._put(_tidy(wanted), _RIGHT, y, colour=canvas.BLUE, align=1.0)

    def _parameters(self, shot: Snapshot) -> None:
        self._put("at start", 196, 291, size=10, colour=canvas.MUTED, align=1.0)
        self._put("now", _RIGHT, 291, size=10, colour=canvas.MUTED, align=1.0)
        for row, (quantity, usual, start, now) in enumerate(_rows(shot)):
            y = 305 + 16 * row
            changed = abs(now - start) > _CHANGED * abs(start)
            colour = canvas.VERMILLION if changed else canvas.INK
            unit = f" [{quantity.unit}]" if quantity.unit else ""
            self._put(quantity.label + unit, _LEFT, y)
            self._put(quantity.number(start, usual), 196, y, align=1.0)
            if changed:
                self._put("→", 210, y, colour=colour)
            self._put(
                quantity.number(now, usual), _RIGHT, y, colour=colour, bold=changed, align=1.0
            )

    def _pixels(self, points: Points) -> Points:
        return (points - self._middle) * (self._scale, -self._scale) + _OVERVIEW.center

    def _overview(
        self, shot: Snapshot, memory: Memory, refresh: bool, view: tuple[float, float] | None
    ) -> None:
        box = _OVERVIEW
        self._heading("OVERVIEW", 434)
        if refresh or self._ground is None:
            self._ground = self._new_ground(shot)
        self.surface.blit(self._ground, box)
        self.surface.set_clip(box)
        trail = self._pixels(memory.trail[:: max(len(memory.trail) // 500, 1)])
        here = self._pixels(np.array([shot.pose[:2]]))[0]
        pygame.draw.aalines(self.surface, canvas.INK, False, [*trail.tolist(), here.tolist()])
        if view is not None:
            half = np.round(np.array(view) * self._scale)
            pygame.draw.rect(self.surface, canvas.MUTED, (*(here - half), *(2.0 * half)), 1)
        pygame.draw.circle(self.surface, canvas.WHITE, here.tolist(), 5)
        pygame.draw.circle(self.surface, canvas.VERMILLION, here.tolist(), 4)
        self.surface.set_clip(None)
        pygame.draw.rect(self.surface, canvas.RULE, box, 1)

    def _new_ground(self, shot: Snapshot) -> pygame.Surface:
        """What does not move: the soil map, in cells of two pixels, and the path."""
        offset_x = np.arange(-_OVERVIEW.width / 2 + 1, _OVERVIEW.width / 2, 2) / self._scale
        offset_y = np.arange(-_OVERVIEW.height / 2 + 1, _OVERVIEW.height / 2, 2) / self._scale
        pixels = self._soil.image(shot, self._middle[0] + offset_x, self._middle[1] - offset_y)
        ground = canvas.surface(*_OVERVIEW.size)
        left = self._middle[0] - 0.5 * _OVERVIEW.width / self._scale
        top = self._middle[1] + 0.5 * _OVERVIEW.height / self._scale
        fine = pixels.repeat(2, 0).repeat(2, 1)
        canvas.paint(ground, self._soil.with_relief(fine, left, top, 1.0 / self._scale))
        for start, end in pairwise((self._path - np.array(_OVERVIEW.topleft)).tolist()):
            pygame.draw.aaline(ground, canvas.BLUE, start, end, 2)
        return ground


def _rows(shot: Snapshot) -> list[tuple[Quantity, float, float, float]]:
    """Parameters of the plant: each with its nominal value, the one at the start, and now."""
    values = shot.nominal, shot.parameters_at_start, shot.parameters
    rows = []
    for name in shot.plant.panel:
        usual, start, now = (value_of(p, name) for p in values)
        rows.append((QUANTITIES[name], usual, start, now))
    return rows


def _tidy(number: str) -> str:
    """No minus sign before a zero: the sign of -0.00 flickers."""
    return number.lstrip("-") if number and float(number) == 0.0 else number
