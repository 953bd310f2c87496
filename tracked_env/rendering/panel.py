"""The panel beside the scene: numbers, bars, parameters, and the whole path from above."""

import math
from itertools import pairwise

import numpy as np
import pygame

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.memory import Memory
from tracked_env.rendering.quantities import QUANTITIES
from tracked_env.rendering.scene import Points
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap

WIDTH, HEIGHT = 280, 640  # [px]
_LEFT, _RIGHT = 14, 266  # [px] margins
_OVERVIEW = pygame.Rect(14, 452, 252, 176)
_SHOWN = (
    "mass", "inertia", "lateral_resistance", "longitudinal_resistance", "cohesion",
    "friction_angle", "shear_deformation_modulus",
)  # fmt: skip
_CHANGED = 1e-6  # [-] relative change that is marked


class Panel:
    """The panel of one episode."""

    def __init__(self, text: Text, reference: Points, soil: SoilMap) -> None:
        """reference: the whole path (P, 2) [m]."""
        self.surface = canvas.surface(WIDTH, HEIGHT)
        self._text, self._soil = text, soil
        low, high = reference.min(axis=0) - 3.0, reference.max(axis=0) + 3.0
        self._scale = float(min(np.array(_OVERVIEW.size) / (high - low)))  # [px/m]
        self._middle = 0.5 * (low + high)
        self._path = self._pixels(reference[:: max(len(reference) // 500, 1)])
        self._ground: pygame.Surface | None = None

    def draw(
        self, shot: Snapshot, memory: Memory, refresh: bool, view: tuple[float, float]
    ) -> pygame.Surface:
        """The panel now; refresh: the map has changed; view [m]: half the scene."""
        self.surface.fill(canvas.PAPER)
        self._clock(shot)
        self._tracking(shot)
        self._drives(shot)
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

    def _drives(self, shot: Snapshot) -> None:
        state, limit = shot.state, shot.parameters.torque_limit
        self._heading("DRIVES", 150)
        unit = f"torque, of ±{limit / 1e3:g} kN m"
        self._put(unit, _LEFT, 163, size=10, colour=canvas.MUTED)
        self._put("demand", _RIGHT, 163, size=10, colour=canvas.MUTED, align=1.0)
        pygame.draw.polygon(self.surface, canvas.INK, [(210, 167), (218, 167), (214, 172)])
        sides = (
            ("left", state.torque_left, shot.action[0], state.slip_left, state.sprocket_speed_left),
            ("right", state.torque_right, shot.action[1], state.slip_right,
             state.sprocket_speed_right),
        )  # fmt: skip
        for row, (side, torque, action, slip, speed) in enumerate(sides):
            y = 180 + 20 * row
            self._put(side, _LEFT, y)
            self._put(f"{torque / 1e3:+.2f}", _RIGHT, y, bold=True, align=1.0)
            self._bar(pygame.Rect(50, y + 1, 170, 12), torque / limit, action)
            y = 236 + 16 * row
            self._put(side, _LEFT, y)
            pygame.draw.rect(self.surface, canvas.slip_colour(slip), (50, y + 2, 18, 10))
            self._put(f"{100.0 * slip:.2f}", 150, y, bold=True, align=1.0)
            self._put(f"{speed:.2f}", _RIGHT, y, bold=True, align=1.0)
        self._put("slip [%]", 150, 222, size=10, colour=canvas.MUTED, align=1.0)
        self._put("sprocket [rad/s]", _RIGHT, 222, size=10, colour=canvas.MUTED, align=1.0)

    def _bar(self, box: pygame.Rect, share: float, demand: float) -> None:
        """A bar to the right of the middle for positive shares, to its left for negative ones."""
        pygame.draw.rect(self.surface, (238, 240, 242), box)
        half = box.width // 2
        end = box.centerx + round(max(min(share, 1.0), -1.0) * half)
        colour = canvas.GREEN if share >= 0.0 else canvas.VERMILLION
        pygame.draw.rect(
            self.surface, colour, (min(box.centerx, end), box.y, abs(end - box.centerx), box.height)
        )
        for tick in range(-4, 5):
            x = box.centerx + tick * half // 4
            inner = canvas.MUTED if tick == 0 else canvas.RULE
            pygame.draw.line(self.surface, inner, (x, box.y), (x, box.bottom - 1))
        x = box.centerx + round(demand * half)
        pygame.draw.polygon(
            self.surface, canvas.INK, [(x - 4, box.y - 3), (x + 4, box.y - 3), (x, box.y + 2)]
        )

    def _parameters(self, shot: Snapshot) -> None:
        self._heading("VEHICLE AND SOIL UNDER IT", 278)
        self._put("at start", 196, 291, size=10, colour=canvas.MUTED, align=1.0)
        self._put("now", _RIGHT, 291, size=10, colour=canvas.MUTED, align=1.0)
        for row, name in enumerate(_SHOWN):
            quantity, y = QUANTITIES[name], 305 + 16 * row
            start, now = getattr(shot.parameters_at_start, name), getattr(shot.parameters, name)
            changed = abs(now - start) > _CHANGED * abs(start)
            colour = canvas.VERMILLION if changed else canvas.INK
            unit = f" [{quantity.unit}]" if quantity.unit else ""
            self._put(quantity.label + unit, _LEFT, y)
            self._put(quantity.number(start), 196, y, align=1.0)
            if changed:
                self._put("→", 210, y, colour=colour)
            self._put(quantity.number(now), _RIGHT, y, colour=colour, bold=changed, align=1.0)

    def _pixels(self, points: Points) -> Points:
        return (points - self._middle) * (self._scale, -self._scale) + _OVERVIEW.center

    def _overview(
        self, shot: Snapshot, memory: Memory, refresh: bool, view: tuple[float, float]
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
        canvas.paint(ground, pixels.repeat(2, 0).repeat(2, 1))
        for start, end in pairwise((self._path - np.array(_OVERVIEW.topleft)).tolist()):
            pygame.draw.aaline(ground, canvas.BLUE, start, end, 2)
        return ground


def _tidy(number: str) -> str:
    """No minus sign before a zero: the sign of -0.00 flickers."""
    return number.lstrip("-") if number and float(number) == 0.0 else number
