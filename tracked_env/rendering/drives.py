"""The part of the panel for the two drives: demand, actual value and slip."""

from typing import NamedTuple

import pygame

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.snapshot import Snapshot

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


def draw(target: pygame.Surface, text: Text, shot: Snapshot) -> None:
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
