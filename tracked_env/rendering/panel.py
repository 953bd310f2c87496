"""The panel beside the scene: numbers, bars, parameters or beliefs, and the path from above.

Where a policy identifies, its beliefs stand beside the true parameters. A row is one parameter: its
true value now, a scale with the truth as a black line, the band value +- 1.96 sigma as a bar and
the estimate as a mark in it, and the estimate as a number. Scales reach from 0 to twice the nominal
value; what lies outside ends at their ends. Where the largest effort of a track is believed, it
stands for the cohesion and the friction angle that make it up. Further parameters that are believed
follow behind the others, as far as there is room.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pygame
from pygame import Rect, Surface

from tracked_env.physics.parameters import PARAMETER_NAMES
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import FIELD, LABELS, MUTED, Floats, Sheet, value_of
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap

Beliefs = Mapping[str, tuple[float, float]]  # (value, standard deviation) SI, by parameter
WIDTH, HEIGHT = 320, 640  # [px]
_LEFT, _RIGHT = 14, 306  # [px] margins
_OVERVIEW = Rect(14, 478, 292, 150)
_CHANGED = 1e-6  # [-] relative change that is marked
_LARGE = 1e3  # [N m] torque limits from here on are written in kN m

SIGMAS = 1.959964  # [-] half the width of a 95 % band of a normal distribution
TOP, PITCH, MAX_ROWS = 310, 20, 8  # of the parameters [px], [px]
_SCALE = (206, 50)  # [px] left end and width
_REACH = 2.0  # [-] nominal values at the right end of a scale
_STRENGTHS = ("cohesion", "friction_angle")  # what the largest effort follows from
_SHORT = {
    "shear_deformation_modulus": "shear def. K [mm]",
    "drive_time_constant": "lag of drives [ms]",
    "effort_maximum": "largest effort [kN]",
    "inertia": "inertia I [kg m²]",
}


class Belief(NamedTuple):
    """One parameter that the panel shows with what is believed of it, SI."""

    name: str
    nominal: float
    truth: float
    value: float  # estimate; NaN where nothing is believed, as the ends of its band
    low: float
    high: float


def belief_rows(shot: Snapshot, beliefs: Beliefs) -> list[Belief]:
    """The parameters of the panel, then others that are believed and that the plant reads."""
    names = list(shot.plant.panel)
    strengths = {*_STRENGTHS}
    if "effort_maximum" in beliefs and not strengths & {*beliefs} and strengths <= {*names}:
        names[names.index(_STRENGTHS[0])] = "effort_maximum"
        names.remove(_STRENGTHS[1])
    shown = {*names, *(["friction_angle"] if "friction" in names else [])}
    names += [name for name in PARAMETER_NAMES if name in {*beliefs} & shot.reads - shown]
    rows = []
    for name in names[:MAX_ROWS]:
        follows = name == "friction" and name not in beliefs
        value, deviation = beliefs.get("friction_angle" if follows else name, (math.nan, math.nan))
        band = [value + sign * SIGMAS * deviation for sign in (0.0, -1.0, 1.0)]
        if follows:
            band = [math.tan(angle) for angle in band]
        nominal, truth = value_of(shot.nominal, name), value_of(shot.parameters, name)
        rows.append(Belief(name, nominal, truth, *band))
    return rows


def place(value: float, nominal: float, box: Rect) -> int:
    """Column [px] of a value on a scale from 0 to _REACH nominal values."""
    share = value / (_REACH * nominal) if nominal else 0.0
    return box.x + round(min(max(share, 0.0), 1.0) * (box.width - 1))


View = tuple[float, float] | None  # [m] half the scene, if it is seen from above


class _Drive(NamedTuple):
    """How a torque or a speed of a sprocket is written."""

    label: str
    heading: str  # of its column where it is not commanded
    unit: str
    factor: float  # shown value over SI value
    signed: str  # format where it is commanded
    plain: str  # format where it is not commanded


_SPEED = _Drive("Sprocket speed", "sprocket [rad/s]", "rad/s", 1.0, "+z.2f", ".2f")
_TORQUE = _Drive("Torque", "torque [N m]", "N m", 1.0, "+z.1f", "+z.1f")
_LARGE_TORQUE = _Drive("Torque", "torque [kN m]", "kN m", 1e-3, "+.2f", "+.2f")


class Panel(Sheet):
    """The panel of one episode."""

    def __init__(self, reference: Floats, soil: SoilMap, margin: float) -> None:
        """reference: the whole path (P, 2) [m]; margin [m] around it in the overview."""
        super().__init__(canvas.surface(WIDTH, HEIGHT))
        self._soil = soil
        low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
        self._scale = float(min(np.array(_OVERVIEW.size) / (high - low)))  # [px/m]
        self._middle = 0.5 * (low + high)
        self._path = self._pixels(reference[:: max(len(reference) // 500, 1)])
        self._ground: Surface | None = None

    def draw(
        self,
        shot: Snapshot,
        trail: Floats,
        refresh: bool,
        view: View,
        beliefs: Beliefs | None = None,
    ) -> Surface:
        """The panel now; trail (P, 2) [m]: where the vehicle was; refresh: the map has changed;
        view [m]: half the scene, if it is seen from above; beliefs: of the policy that drives.
        """
        self.surface.fill(canvas.PAPER)
        self._clock(shot)
        self._tracking(shot)
        self._draw_drives(shot)
        self._parameters(shot, beliefs)
        self._overview(shot, trail, refresh, view)
        pygame.draw.line(self.surface, canvas.RULE, (0, 0), (0, HEIGHT))
        return self.surface

    def _right(self, string: str, y: int, x: int = _RIGHT, **style: Any) -> None:
        """Write with the right end at x."""
        self.put(string, x, y, align=1.0, **style)

    def _clock(self, shot: Snapshot) -> None:
        end = _LEFT + self.put(f"{shot.time:.2f} s", _LEFT, 7, size=20, bold=True)
        self.note(f"of {shot.duration:g} s", end + 8, 11)
        self.note("reward", _RIGHT - 62, 11, 1.0)
        self._right(f"{shot.reward:+.3f}", 11, bold=True)
        width, share = _RIGHT - _LEFT, min(shot.time / shot.duration, 1.0)
        pygame.draw.rect(self.surface, canvas.RULE, (_LEFT, 36, width, 3))
        pygame.draw.rect(self.surface, canvas.BLUE, (_LEFT, 36, round(share * width), 3))

    def _tracking(self, shot: Snapshot) -> None:
        self.heading("Tracking", _LEFT, 46, 150)
        self.note("vehicle", 214, 46, 1.0)
        self.note("reference", _RIGHT, 46, 1.0)
        yaw_rates = [math.degrees(w) for w in (shot.state.yaw_rate, shot.reference_yaw_rate)]
        rows = (
            ("speed [m/s]", f"{shot.state.v_x:z.2f}", f"{shot.reference_speed:z.2f}"),
            ("yaw rate [°/s]", *(f"{yaw_rate:z.1f}" for yaw_rate in yaw_rates)),
            ("position error [m]", f"{shot.distance:z.3f}", ""),
            ("heading error [°]", f"{math.degrees(shot.heading_error):z.2f}", ""),
        )
        for row, (label, value, reference) in enumerate(rows):
            y = 68 + PITCH * row
            self.put(label, _LEFT, y)
            self._right(value, y, x=214, bold=True)
            self._right(reference, y, colour=canvas.BLUE)

    def _draw_drives(self, shot: Snapshot) -> None:
        """Bars of what the action commands, torques or sprocket speeds; then slip and the other."""
        state, commanded = shot.state, shot.drive.quantity
        torque = _LARGE_TORQUE if shot.parameters.torque_limit >= _LARGE else _TORQUE
        drives = {"torque": torque, "sprocket_speed": _SPEED}
        (other_name,) = set(drives) - {commanded}
        command, other = drives[commanded], drives[other_name]
        limit = getattr(shot.parameters, shot.drive.limit)
        heading = f"{command.label}, of ±{limit * command.factor:.4g} {command.unit}"
        self.heading(heading, _LEFT, 154, _RIGHT)
        pygame.draw.polygon(self.surface, canvas.INK, [(14, 229), (22, 229), (18, 234)])
        self.note("demand", 28, 222)
        for row, side in enumerate(("left", "right")):
            y = 178 + 22 * row
            value, slip = getattr(state, f"{commanded}_{side}"), getattr(state, f"slip_{side}")
            self.put(side, _LEFT, y)
            self._right(f"{value * command.factor:{command.signed}}", y, bold=True)
            self._bar(Rect(56, y + 3, 176, 14), value / limit, shot.action[row])
            y = 242 + PITCH * row
            self.put(side, _LEFT, y)
            pygame.draw.rect(self.surface, canvas.slip_colour(slip), (56, y + 4, 18, 12))
            self._right(f"{100.0 * slip:.2f}", y, x=172, bold=True)
            value = getattr(state, f"{other_name}_{side}")
            self._right(f"{value * other.factor:{other.plain}}", y, bold=True)
        self.note("slip [%]", 172, 222, 1.0)
        self.note(other.heading, _RIGHT, 222, 1.0)

    def _bar(self, box: Rect, share: float, demand: float) -> None:
        """A bar to the right of the middle for positive shares, to its left for negative ones."""
        pygame.draw.rect(self.surface, FIELD, box)
        half = box.width // 2
        end = box.centerx + round(max(min(share, 1.0), -1.0) * half)
        colour = canvas.GREEN if share >= 0.0 else canvas.VERMILLION
        bar = (min(box.centerx, end), box.y, abs(end - box.centerx), box.height)
        pygame.draw.rect(self.surface, colour, bar)
        for tick in range(-4, 5):
            x = box.centerx + tick * half // 4
            inner = MUTED if tick == 0 else canvas.RULE
            pygame.draw.line(self.surface, inner, (x, box.y), (x, box.bottom - 1))
        x, y = box.centerx + round(demand * half), box.y
        pygame.draw.polygon(self.surface, canvas.INK, [(x - 4, y - 3), (x + 4, y - 3), (x, y + 2)])

    def _parameters(self, shot: Snapshot, beliefs: Beliefs | None) -> None:
        """A row for each parameter: its value at the start and now, or the true one and what is
        believed of it."""
        first, end, last = ("at start", 236, "now")
        if beliefs is not None:
            first, end, last = ("true", 186, "believed, 95 %")
        self.heading("Parameters", _LEFT, TOP - 22, 150)
        self.note(first, end, TOP - 22, 1.0)
        self.note(last, _RIGHT, TOP - 22, 1.0)
        for number, row in enumerate(belief_rows(shot, beliefs or {})):
            y, label = TOP + PITCH * number, LABELS[row.name]
            start = value_of(shot.parameters_at_start, row.name)
            changed = abs(row.truth - start) > _CHANGED * abs(start)
            style: Any = {"colour": canvas.VERMILLION if changed else canvas.INK, "bold": changed}
            truth = label.number(row.truth, row.nominal)
            self.put(_SHORT.get(row.name, label.with_unit), _LEFT, y)
            if beliefs is not None:
                self._right(truth, y, x=_SCALE[0] - 6, **style)
                self._belief(row, y)
                continue
            self._right(label.number(start, row.nominal), y, x=end)
            if changed:
                self.put("→", 240, y, colour=canvas.VERMILLION)
            self._right(truth, y, **style)

    def _belief(self, row: Belief, y: int) -> None:
        """Scale and number of what is believed of a parameter."""
        if not math.isfinite(row.value + row.low + row.high):
            self._right("-", y, colour=MUTED)
            return
        box = Rect(_SCALE[0], y + 3, _SCALE[1], 12)
        pygame.draw.rect(self.surface, FIELD, box)
        true, value, low, high = (place(value, row.nominal, box) for value in row[2:])
        band = (low, box.y + 3, max(high - low, 1), 6)
        pygame.draw.rect(self.surface, canvas.PALE_BLUE, band)
        pygame.draw.rect(self.surface, canvas.BLUE, (value - 1, box.y + 1, 3, 10))
        pygame.draw.line(self.surface, canvas.INK, (true, box.y - 2), (true, box.bottom + 1))
        estimate = LABELS[row.name].number(row.value, row.nominal)
        self._right(estimate, y, colour=canvas.BLUE, bold=True)

    def _pixels(self, points: Floats) -> Floats:
        return (points - self._middle) * (self._scale, -self._scale) + _OVERVIEW.center

    def _overview(self, shot: Snapshot, trail: Floats, refresh: bool, view: View) -> None:
        box = _OVERVIEW
        if refresh or self._ground is None:
            self._ground = self._new_ground(shot)
        self.surface.blit(self._ground, box)
        self.surface.set_clip(box)
        line = self._pixels(trail[:: max(len(trail) // 500, 1)]).tolist()
        here = self._pixels(np.array([shot.pose[:2]]))[0]
        pygame.draw.aalines(self.surface, canvas.INK, False, [*line, here.tolist()])
        if view is not None:
            half = np.round(np.array(view) * self._scale)
            pygame.draw.rect(self.surface, MUTED, (*(here - half), *(2.0 * half)), 1)
        self.here(here.tolist())
        self.surface.set_clip(None)
        pygame.draw.rect(self.surface, canvas.RULE, box, 1)

    def _new_ground(self, shot: Snapshot) -> Surface:
        """What does not move: the soil map, in cells of two pixels, and the path."""
        width, height = _OVERVIEW.size
        offset_x = np.arange(-width / 2 + 1, width / 2, 2) / self._scale
        offset_y = np.arange(-height / 2 + 1, height / 2, 2) / self._scale
        pixels = self._soil.image(shot, self._middle[0] + offset_x, self._middle[1] - offset_y)
        ground = canvas.surface(width, height)
        left = self._middle[0] - 0.5 * width / self._scale
        top = self._middle[1] + 0.5 * height / self._scale
        fine = pixels.repeat(2, 0).repeat(2, 1)
        canvas.paint(ground, self._soil.with_relief(fine, left, top, 1.0 / self._scale))
        for start, end in pairwise((self._path - np.array(_OVERVIEW.topleft)).tolist()):
            pygame.draw.aaline(ground, canvas.BLUE, start, end, 2)
        return ground
