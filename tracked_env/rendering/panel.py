"""The panel beside the scene: numbers, bars, parameters, and the whole path from above.

The part of the panel for what a policy believes: estimates, 95 % bands, and the truth.

A row is one parameter: its true value now, a scale with the truth as a black line, the band
value +- 1.96 sigma as a bar and the estimate as a mark in it, and the estimate as a number. Scales
reach from 0 to twice the nominal value; what lies outside ends at their ends. Where the largest
effort of a track is believed, it stands for the cohesion and the friction angle that make it up.
Further parameters that are believed follow behind the others, as far as there is room.

The part of the panel for the two drives: demand, actual value and slip.
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pygame

from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.scene import Memory, Points
from tracked_env.rendering.sizes import QUANTITIES, Quantity, value_of
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap

Beliefs = Mapping[str, tuple[float, float]]  # (value, standard deviation) SI, by parameter
SIGMAS = 1.959964  # [-] half the width of a 95 % band of a normal distribution
TOP, PITCH, MOST = 305, 16, 8  # [px], [px], rows
_LEFT, _TRUTH, _RIGHT = 14, 170, 266  # [px]
_SCALE = (176, 50)  # [px] left end and width
_REACH = 2.0  # [-] nominal values at the right end of a scale
# What the panel shows of a parameter that is believed: name -> (parameter, function of it).
_FOLLOWING: dict[str, tuple[str, Callable[[float], float]]] = {
    "friction": ("friction_angle", math.tan)
}
_MADE_UP = ("cohesion", "friction_angle")  # what the largest effort follows from
_SHORT = {
    "shear_deformation_modulus": "shear def. K", "drive_time_constant": "lag of drives",
    "effort_maximum": "largest effort",
}  # fmt: skip


class Row(NamedTuple):
    """One parameter, SI."""

    name: str
    nominal: float
    truth: float
    value: float  # estimate
    low: float  # of its band
    high: float


def _band(name: str, beliefs: Beliefs) -> tuple[float, float, float]:
    """Estimate and ends of its band; NaN where nothing is believed."""
    source, follow = _FOLLOWING.get(name, (name, float))
    if name in beliefs:
        source, follow = name, float
    value, deviation = beliefs.get(source, (math.nan, math.nan))
    reach = SIGMAS * deviation
    return follow(value), follow(value - reach), follow(value + reach)


def rows(shot: Snapshot, beliefs: Beliefs) -> list[Row]:
    """The parameters of the panel, then others that are believed and that the plant reads."""
    shown = list(shot.plant.panel)
    if "effort_maximum" in beliefs and not {*_MADE_UP} & {*beliefs} and {*_MADE_UP} <= {*shown}:
        shown[shown.index(_MADE_UP[0])] = "effort_maximum"
        shown.remove(_MADE_UP[1])
    believed = {source for name, (source, _) in _FOLLOWING.items() if name in shown}
    further = [
        name
        for name in PARAMETER_NAMES
        if name in beliefs and name in shot.reads and name not in (*shown, *believed)
    ]
    found = []
    for name in (*shown, *further)[:MOST]:
        nominal, truth = value_of(shot.nominal, name), value_of(shot.parameters, name)
        found.append(Row(name, nominal, truth, *_band(name, beliefs)))
    return found


def draw(target: pygame.Surface, text: Text, shot: Snapshot, beliefs: Beliefs) -> None:
    """All rows, with the heads of their columns."""
    text.put(target, "true", _TRUTH, TOP - 14, 10, canvas.MUTED, align=1.0)
    text.put(target, "believed, 95 %", _RIGHT, TOP - 14, 10, canvas.MUTED, align=1.0)
    for number, row in enumerate(rows(shot, beliefs)):
        _draw_row(target, text, shot.parameters_at_start, row, TOP + PITCH * number)


def _draw_row(target: pygame.Surface, text: Text, start: PlantParameters, row: Row, y: int) -> None:
    quantity = QUANTITIES[row.name]
    changed = abs(row.truth - value_of(start, row.name)) > 1e-6 * abs(row.truth)
    colour = canvas.VERMILLION if changed else canvas.INK
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    text.put(target, _SHORT.get(row.name, quantity.label) + unit, _LEFT, y)
    number = quantity.number(row.truth, row.nominal)
    text.put(target, number, _TRUTH, y, colour=colour, bold=changed, align=1.0)
    if not math.isfinite(row.value + row.low + row.high):
        text.put(target, "-", _RIGHT, y, colour=canvas.MUTED, align=1.0)
        return
    box = pygame.Rect(_SCALE[0], y + 2, _SCALE[1], 10)
    pygame.draw.rect(target, (238, 240, 242), box)
    low, high, value, truth = (
        place(of, row.nominal, box) for of in (row.low, row.high, row.value, row.truth)
    )
    pygame.draw.rect(target, canvas.PALE_BLUE, (low, box.y + 2, max(high - low, 1), 6))
    pygame.draw.rect(target, canvas.BLUE, (value - 1, box.y + 1, 3, 8))
    pygame.draw.line(target, canvas.INK, (truth, box.y - 2), (truth, box.bottom + 1), 1)
    number = quantity.number(row.value, row.nominal)
    text.put(target, number, _RIGHT, y, colour=canvas.BLUE, bold=True, align=1.0)


def place(value: float, nominal: float, box: pygame.Rect) -> int:
    """Column [px] of a value on a scale from 0 to _REACH nominal values."""
    share = value / (_REACH * nominal) if nominal else 0.0
    return box.x + round(min(max(share, 0.0), 1.0) * (box.width - 1))


_LEFT, _RIGHT = 14, 266  # [px] margins
_LARGE = 1e3  # [N m] torque limits from here on are written in kN m


class _Quantity(NamedTuple):
    """How a torque or a speed of a sprocket is written."""

    label: str
    heading: str  # of its column where it is not commanded
    unit: str
    factor: float  # shown value over SI value
    signed: str  # format where it is commanded or a torque
    plain: str  # format where it is not commanded


def _quantities(torque_limit: float) -> dict[str, _Quantity]:
    """By the name of the state's rows."""
    if torque_limit >= _LARGE:
        torque = _Quantity("torque", "torque [kN m]", "kN m", 1e-3, "+.2f", "+.2f")
    else:
        torque = _Quantity("torque", "torque [N m]", "N m", 1.0, "+z.1f", "+z.1f")
    speed = _Quantity("sprocket speed", "sprocket [rad/s]", "rad/s", 1.0, "+z.2f", ".2f")
    return {"torque": torque, "sprocket_speed": speed}


def draw_drives(target: pygame.Surface, text: Text, shot: Snapshot) -> None:
    """Bars of what the action commands, torques or sprocket speeds; then slip and the other."""
    state, p = shot.state, shot.parameters
    quantities = _quantities(p.torque_limit)
    commanded = shot.drive.quantity
    (free,) = set(quantities) - {commanded}
    asked, other = quantities[commanded], quantities[free]
    limit = getattr(p, shot.drive.limit)
    heading = f"{asked.label}, of ±{limit * asked.factor:g} {asked.unit}"
    text.put(target, heading, _LEFT, 163, 10, canvas.MUTED)
    text.put(target, "demand", _RIGHT, 163, 10, canvas.MUTED, align=1.0)
    pygame.draw.polygon(target, canvas.INK, [(210, 167), (218, 167), (214, 172)])
    for row, side in enumerate(("left", "right")):
        y = 180 + 20 * row
        value, slip = getattr(state, f"{commanded}_{side}"), getattr(state, f"slip_{side}")
        text.put(target, side, _LEFT, y)
        number = f"{value * asked.factor:{asked.signed}}"
        text.put(target, number, _RIGHT, y, bold=True, align=1.0)
        _bar(target, pygame.Rect(50, y + 1, 170, 12), value / limit, shot.action[row])
        y = 236 + 16 * row
        text.put(target, side, _LEFT, y)
        pygame.draw.rect(target, canvas.slip_colour(slip), (50, y + 2, 18, 10))
        text.put(target, f"{100.0 * slip:.2f}", 150, y, bold=True, align=1.0)
        number = f"{getattr(state, f'{free}_{side}') * other.factor:{other.plain}}"
        text.put(target, number, _RIGHT, y, bold=True, align=1.0)
    text.put(target, "slip [%]", 150, 222, 10, canvas.MUTED, align=1.0)
    text.put(target, other.heading, _RIGHT, 222, 10, canvas.MUTED, align=1.0)


def _bar(target: pygame.Surface, box: pygame.Rect, share: float, demand: float) -> None:
    """A bar to the right of the middle for positive shares, to its left for negative ones."""
    pygame.draw.rect(target, (238, 240, 242), box)
    half = box.width // 2
    end = box.centerx + round(max(min(share, 1.0), -1.0) * half)
    colour = canvas.GREEN if share >= 0.0 else canvas.VERMILLION
    pygame.draw.rect(
        target, colour, (min(box.centerx, end), box.y, abs(end - box.centerx), box.height)
    )
    for tick in range(-4, 5):
        x = box.centerx + tick * half // 4
        inner = canvas.MUTED if tick == 0 else canvas.RULE
        pygame.draw.line(target, inner, (x, box.y), (x, box.bottom - 1))
    x = box.centerx + round(demand * half)
    pygame.draw.polygon(
        target, canvas.INK, [(x - 4, box.y - 3), (x + 4, box.y - 3), (x, box.y + 2)]
    )


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
        draw_drives(self.surface, self._text, shot)
        self._heading("VEHICLE AND SOIL UNDER IT", 278)
        if beliefs is not None:
            draw(self.surface, self._text, shot, beliefs)
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
