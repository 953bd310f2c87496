"""Texts over the scene: key, scales, coordinates of the grid, notices."""

import math

import pygame

from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour, Text
from tracked_env.rendering.sizes import Sizes, grid_of, scale_bar
from tracked_env.rendering.snapshot import Snapshot
from tracked_env.rendering.soil_map import SoilMap

WIDTH, HEIGHT = 680, 640  # [px] of the scene
TOP, BOTTOM = 26, 44  # [px] height of the strips
_VEIL = (252, 252, 251, 242)
_NOTICE = (33, 37, 41, 225)
_BAR = 120  # [px] width of a colour bar


def _veil(picture: pygame.Surface, box: pygame.Rect, colour: tuple[int, int, int, int]) -> None:
    """Cover a part of the picture so that text on it can be read."""
    cover = canvas.surface(*box.size, transparent=True)
    pygame.draw.rect(cover, colour, cover.get_rect(), border_radius=0 if box.x == 0 else 6)
    picture.blit(cover, box)


def coordinates(ground: pygame.Surface, text: Text, left: float, top: float, zoom: int) -> None:
    """Label the thick grid lines with x below the upper strip and with y at the left."""
    x0, y0 = round(left * zoom), round(-top * zoom)
    metres = grid_of(zoom).side
    side = metres * zoom
    for column in range(x0 // side + 1, (x0 + WIDTH - 1) // side + 1):
        x = column * side - x0
        if x < WIDTH - 40:
            text.put(ground, f"x {metres * column}", x + 4, TOP + 3, 10, canvas.MUTED)
    for row in range(y0 // side + 1, (y0 + HEIGHT - 1) // side + 1):
        y = row * side - y0
        if TOP + 20 < y < HEIGHT - BOTTOM - 16:
            text.put(ground, f"y {-metres * row}", 4, y + 3, 10, canvas.MUTED)


def draw(
    picture: pygame.Surface,
    text: Text,
    soil: SoilMap,
    shot: Snapshot,
    notices: list[str],
    zoom: int | None,
) -> None:
    """Everything that lies over the scene; zoom [px/m]: None in perspective, without arrows."""
    _veil(picture, pygame.Rect(0, 0, WIDTH, TOP), _VEIL)
    _key(picture, text, zoom is not None)
    _veil(picture, pygame.Rect(0, HEIGHT - BOTTOM, WIDTH, BOTTOM), _VEIL)
    y = HEIGHT - BOTTOM
    if zoom is not None:
        _lengths(picture, text, y, zoom, shot.sizes)
    _soil_bar(picture, text, soil, shot, y)
    _slip_bar(picture, text, y, shot.loads is not None)
    lines = [*notices, shot.ending] if shot.ending else notices
    _notices(picture, text, lines)


def _key(picture: pygame.Surface, text: Text, arrows: bool) -> None:
    """Key of lines, outlines and, if there are any, arrows."""
    entries: tuple[tuple[str, Colour, str], ...] = (
        ("line", canvas.BLUE, "reference"),
        ("line", canvas.PALE_BLUE, "past"),
        ("box", canvas.BLUE, "reference pose"),
        ("line", canvas.INK, "driven"),
        ("arrow", canvas.GREEN, "tractive effort"),
        ("arrow", canvas.VERMILLION, "motion resistance"),
        ("arrow", canvas.PURPLE, "lateral force"),
    )
    x, middle = 8, TOP // 2
    for kind, colour, label in entries:
        if kind == "arrow" and not arrows:
            continue
        if kind == "box":
            pygame.draw.rect(picture, colour, (x, middle - 4, 14, 9), 2)
        else:
            pygame.draw.line(picture, colour, (x, middle), (x + 13, middle), 3)
        if kind == "arrow":
            tip = [(x + 16, middle), (x + 9, middle - 4), (x + 9, middle + 4)]
            pygame.draw.polygon(picture, colour, tip)
        x += 20
        x += text.put(picture, label, x, middle - 7, 11) + 11


def _lengths(picture: pygame.Surface, text: Text, y: int, zoom: int, sizes: Sizes) -> None:
    """Scale of lengths and of forces."""
    metres, force = scale_bar(zoom), sizes.force_sample
    x, length = 14, round(metres * zoom)
    text.put(picture, f"{metres:g} m", x, y + 6, 11)
    pygame.draw.rect(picture, canvas.INK, (x, y + 28, length, 4))
    pygame.draw.rect(picture, canvas.WHITE, (x + length // 2, y + 29, length // 2 - 1, 2))
    x, length = 134, round(force * sizes.force_scale * zoom)
    label = f"{force / 1e3:g} kN" if force >= 1e3 else f"{force:g} N"
    text.put(picture, label, x, y + 6, 11)
    pygame.draw.line(picture, canvas.INK, (x, y + 30), (x + length - 6, y + 30), 3)
    tip = [(x + length, y + 30), (x + length - 9, y + 25), (x + length - 9, y + 35)]
    pygame.draw.polygon(picture, canvas.INK, tip)


def _soil_bar(picture: pygame.Surface, text: Text, soil: SoilMap, shot: Snapshot, y: int) -> None:
    """The colours of the ground, and the value below the vehicle."""
    quantity, x = soil.quantity, 236
    unit = f" [{quantity.unit}]" if quantity.unit else " [-]"
    text.put(picture, f"soil: {quantity.label}{unit}", x, y + 6, 11)
    low, high = f"{quantity.low:g}", f"{quantity.high:g}"
    start = x + text.put(picture, low, x, y + 23, 11) + 6
    picture.blit(canvas.colour_bar(canvas.SOIL_SCALE, _BAR, 10), (start, y + 25))
    pygame.draw.rect(picture, canvas.MUTED, (start, y + 25, _BAR, 10), 1)
    text.put(picture, high, start + _BAR + 6, y + 23, 11)
    share = min(max(quantity.share(getattr(shot.parameters, soil.name)), 0.0), 1.0)
    tip = start + round(share * (_BAR - 1))
    pygame.draw.polygon(picture, canvas.INK, [(tip, y + 32), (tip - 4, y + 39), (tip + 4, y + 39)])


def _slip_bar(picture: pygame.Surface, text: Text, y: int, on_pads: bool) -> None:
    """The colours of the tracks, logarithmic; on_pads: of their pads alone, loads are shown too."""
    x = 478
    text.put(picture, f"{'pads' if on_pads else 'track'}: slip ratio, absolute [%]", x, y + 6, 11)
    decades = round(math.log10(1.0 / canvas.SLIP_LOW))
    width = 160
    bar = pygame.Rect(x + 4, y + 21, width, 9)
    picture.blit(canvas.colour_bar(canvas.SLIP_SCALE, width, bar.height), bar)
    pygame.draw.rect(picture, canvas.MUTED, bar, 1)
    for decade in range(decades + 1):
        at = bar.x + round(decade * (width - 1) / decades)
        pygame.draw.line(picture, canvas.INK, (at, bar.y), (at, bar.bottom + 1))
        label = f"{100 * canvas.SLIP_LOW * 10**decade:g}"
        text.put(picture, label, at, bar.bottom, 10, align=0.5)


def _notices(picture: pygame.Surface, text: Text, lines: list[str]) -> None:
    """Notices of the latest changes, in the upper middle."""
    if not lines:
        return
    width = max(text.image(line, 13, True, canvas.WHITE).get_width() for line in lines) + 28
    box = pygame.Rect((WIDTH - width) // 2, TOP + 20, width, 18 * len(lines) + 12)
    _veil(picture, box, _NOTICE)
    for row, line in enumerate(lines):
        y = box.y + 6 + 18 * row
        text.put(picture, line, WIDTH // 2, y, 13, canvas.WHITE, bold=True, align=0.5)
