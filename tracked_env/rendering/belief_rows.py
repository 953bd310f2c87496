"""The part of the panel for what a policy believes: estimates, 95 % bands, and the truth.

A row is one parameter: its true value now, a scale with the truth as a black line, the band
value +- 1.96 sigma as a bar and the estimate as a mark in it, and the estimate as a number. Scales
reach from 0 to twice the nominal value; what lies outside ends at their ends. Where the largest
effort of a track is believed, it stands for the cohesion and the friction angle that make it up.
Further parameters that are believed follow behind the others, as far as there is room.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import pygame

from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.quantities import QUANTITIES, value_of
from tracked_env.rendering.snapshot import Snapshot

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
