"""The part of the panel for the two drives: demand, actual value and slip."""

from typing import NamedTuple

import pygame

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.snapshot import Snapshot

_LEFT, _RIGHT = 14, 266  # [px] margins
_LARGE = 1e3  # [N m] torque limits from here on are written in kN m


class _Side(NamedTuple):
    """One drive and its track."""

    name: str
    torque: float  # [N m]
    speed: float  # [rad/s] of the sprocket
    slip: float  # [-]
    demand: float  # [-] of the limit


class _Scale(NamedTuple):
    """How torques or speeds of a sprocket are written."""

    unit: str
    factor: float  # shown value over SI value
    signed: str  # format


def _torque_scale(limit: float) -> _Scale:
    return _Scale("kN m", 1e-3, "+.2f") if limit >= _LARGE else _Scale("N m", 1.0, "+z.1f")


_SPEED = _Scale("rad/s", 1.0, "+z.2f")


def draw(target: pygame.Surface, text: Text, shot: Snapshot) -> None:
    """Bars of what the action commands, torques or sprocket speeds; then slip and the other."""
    state, p = shot.state, shot.parameters
    torque = _torque_scale(p.torque_limit)
    if shot.by_torque:
        label, limit, scale = "torque", p.torque_limit, torque
    else:
        label, limit, scale = "sprocket speed", p.sprocket_speed_limit, _SPEED
    heading = f"{label}, of ±{limit * scale.factor:g} {scale.unit}"
    text.put(target, heading, _LEFT, 163, 10, canvas.MUTED)
    text.put(target, "demand", _RIGHT, 163, 10, canvas.MUTED, align=1.0)
    pygame.draw.polygon(target, canvas.INK, [(210, 167), (218, 167), (214, 172)])
    sides = (
        _Side("left", state.torque_left, state.sprocket_speed_left, state.slip_left,
              shot.action[0]),
        _Side("right", state.torque_right, state.sprocket_speed_right, state.slip_right,
              shot.action[1]),
    )  # fmt: skip
    for row, side in enumerate(sides):
        y = 180 + 20 * row
        value = side.torque if shot.by_torque else side.speed
        text.put(target, side.name, _LEFT, y)
        number = f"{value * scale.factor:{scale.signed}}"
        text.put(target, number, _RIGHT, y, bold=True, align=1.0)
        _bar(target, pygame.Rect(50, y + 1, 170, 12), value / limit, side.demand)
        y = 236 + 16 * row
        text.put(target, side.name, _LEFT, y)
        pygame.draw.rect(target, canvas.slip_colour(side.slip), (50, y + 2, 18, 10))
        text.put(target, f"{100.0 * side.slip:.2f}", 150, y, bold=True, align=1.0)
        other = f"{side.speed:.2f}"
        if not shot.by_torque:
            other = f"{side.torque * torque.factor:{torque.signed}}"
        text.put(target, other, _RIGHT, y, bold=True, align=1.0)
    text.put(target, "slip [%]", 150, 222, 10, canvas.MUTED, align=1.0)
    other = "sprocket [rad/s]" if shot.by_torque else f"torque [{torque.unit}]"
    text.put(target, other, _RIGHT, 222, 10, canvas.MUTED, align=1.0)


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
