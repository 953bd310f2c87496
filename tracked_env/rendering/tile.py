"""Texts of a small picture, one of many in a film of a vector environment.

Tiles of a film are a few hundred pixels wide: only time, error, speed and slip are written, in
letters of 5 % of the picture's height, which can be read at a quarter of its size.
"""

import pygame

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Text
from tracked_env.rendering.snapshot import Snapshot

SIZE = 34  # [px] of the letters
STRIP = 50  # [px] height of the strips above and below
_MARGIN, _DROP = 12, 5  # [px] of a text in its strip
_VEIL = (252, 252, 251, 235)
_NOTICE = (33, 37, 41, 225)


def draw(picture: pygame.Surface, text: Text, shot: Snapshot, notices: list[str]) -> None:
    """Write on the scene; notices: changes of this moment, of which the last one is shown."""
    width, height = picture.get_size()
    slip = max(abs(shot.state.slip_left), abs(shot.state.slip_right))
    for y, left, right in (
        (0, f"{shot.time:.1f} s", f"error {shot.distance:.2f} m"),
        (height - STRIP, f"{shot.state.v_x:.1f} m/s", f"slip {100.0 * slip:.0f} %"),
    ):
        _veil(picture, pygame.Rect(0, y, width, STRIP), _VEIL)
        text.put(picture, left, _MARGIN, y + _DROP, SIZE, bold=True)
        text.put(picture, right, width - _MARGIN, y + _DROP, SIZE, bold=True, align=1.0)
    pygame.draw.rect(picture, canvas.INK, picture.get_rect(), 2)
    line = shot.ending.partition(":")[0] or (notices[-1].partition(":")[0] if notices else "")
    if line:
        _veil(picture, pygame.Rect(0, STRIP + 8, width, STRIP), _NOTICE)
        text.put(picture, line, width // 2, STRIP + 8 + _DROP, 28, canvas.WHITE, True, 0.5)


def _veil(picture: pygame.Surface, box: pygame.Rect, colour: tuple[int, int, int, int]) -> None:
    """Cover a part of the picture so that text on it can be read."""
    cover = canvas.surface(*box.size, transparent=True)
    cover.fill(colour)
    picture.blit(cover, box)
