"""Colours, text and surfaces: what every part of a picture is drawn with.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart [1]; scales vary
in lightness, so that they also survive a grey print.

References: [1] Okabe, Ito, Color Universal Design, 2008.

Several pictures of one size in one, each under its name: two in a row, four in a square.

Names are in large letters, which can be read in a film that is shown in a column of a page.
"""

import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pygame
from numpy.typing import NDArray

Colour = tuple[int, int, int]
Bytes = NDArray[np.uint8]

INK: Colour = (33, 37, 41)
MUTED: Colour = (98, 106, 114)
RULE: Colour = (214, 218, 222)
PAPER: Colour = (252, 252, 251)
WHITE: Colour = (255, 255, 255)
BLUE: Colour = (0, 114, 178)  # reference
PALE_BLUE: Colour = (116, 166, 199)  # the part of it that is past
GREEN: Colour = (0, 140, 102)  # tractive effort
VERMILLION: Colour = (213, 94, 0)  # motion resistance; what has changed
PURPLE: Colour = (170, 64, 126)  # lateral force
QUANTITY_COLOURS = (INK, MUTED, BLUE, PALE_BLUE, GREEN, VERMILLION, PURPLE)

_MASKS = (0xFF0000, 0x00FF00, 0x0000FF)
_TEXT_CACHE = 2048  # [-] rendered strings kept
_SUBSTITUTES = str.maketrans({"→": ">"})  # where the font lacks them


def colour_scale(*stops: Colour) -> Bytes:
    """256 colours (256, 3) through equally spaced stops."""
    grid = np.linspace(0.0, 1.0, 256)
    at = np.linspace(0.0, 1.0, len(stops))
    channels = [np.interp(grid, at, [stop[c] for stop in stops]) for c in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


SOIL_SCALE = colour_scale((253, 251, 246), (240, 231, 212), (219, 199, 166), (189, 161, 120))
SLIP_SCALE = colour_scale(  # cividis
    (0, 34, 78), (53, 69, 108), (102, 105, 112), (148, 142, 119), (200, 184, 102), (254, 232, 56)
)
LOAD_SCALE = colour_scale((247, 247, 244), (190, 203, 217), (94, 129, 172), (32, 55, 104))
SLIP_LOW, SLIP_DECADES = 1e-3, 3.0  # [-] the slip scale is logarithmic, 0.1 % to 100 %


def slip_colour(slip: float) -> Colour:
    """Colour of a track whose slip ratio [-] has that size."""
    share = np.log10(max(abs(slip), SLIP_LOW) / SLIP_LOW) / SLIP_DECADES
    r, g, b = SLIP_SCALE[min(int(256 * share), 255)].tolist()
    return r, g, b


def load_colours(loads: NDArray[np.float64], full: float) -> Bytes:
    """Colours (..., 3) of normal loads (...) [N]; full [N]: end of the scale."""
    share = np.clip(np.nan_to_num(loads) / full, 0.0, 1.0)
    return LOAD_SCALE[(255.0 * share).astype(np.uint8)]


def shaded(colour: Colour) -> Colour:
    """The colour made lighter when it is dark, else darker."""
    light = sum(colour) > 330
    r, g, b = (round(0.6 * c) if light else round(c + 0.32 * (255 - c)) for c in colour)
    return r, g, b


def surface(width: int, height: int, transparent: bool = False) -> pygame.Surface:
    """A 32-bit surface in memory; needs no window."""
    if transparent:
        return pygame.Surface((width, height), pygame.SRCALPHA, 32)
    return pygame.Surface((width, height), 0, 32, (*_MASKS, 0))


def paint(target: pygame.Surface, pixels: Bytes) -> None:
    """Copy an image (height, width, 3) onto a surface of that size."""
    pygame.surfarray.blit_array(target, pixels.swapaxes(0, 1))


def to_array(source: pygame.Surface) -> Bytes:
    """A copy of the picture, (height, width, 3)."""
    pixels = pygame.surfarray.pixels3d(source).swapaxes(0, 1)
    picture = np.empty(pixels.shape, dtype=np.uint8)
    for channel in range(3):  # five times faster than copying them together
        picture[..., channel] = pixels[..., channel]
    return picture


def colour_bar(scale: Bytes, width: int, height: int) -> pygame.Surface:
    """A colour scale from left to right."""
    bar = surface(width, height)
    row = scale[np.linspace(0, 255, width).astype(int)]
    paint(bar, np.broadcast_to(row, (height, width, 3)))
    return bar


def _font_files() -> tuple[str | None, str | None]:
    """DejaVu Sans, regular and bold, as matplotlib ships it; else the font of pygame."""
    found = importlib.util.find_spec("matplotlib")
    if found is not None and found.origin is not None:
        folder = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf"
        files = folder / "DejaVuSans.ttf", folder / "DejaVuSans-Bold.ttf"
        if all(file.exists() for file in files):
            return str(files[0]), str(files[1])
    return None, None


class Text:
    """Writes strings, and keeps the latest ones rendered."""

    def __init__(self) -> None:
        """Find the fonts; none is loaded yet."""
        self._files = _font_files()
        self._fonts: dict[tuple[int, bool], pygame.font.Font] = {}
        self._cache: dict[tuple[str, int, bool, Colour], pygame.Surface] = {}

    def _render(self, string: str, size: int, bold: bool, colour: Colour) -> pygame.Surface:
        if not pygame.font.get_init():
            pygame.font.init()
        if (size, bold) not in self._fonts:
            self._fonts[size, bold] = pygame.font.Font(self._files[bold], size)
        written = string if self._files[bold] else string.translate(_SUBSTITUTES)
        return self._fonts[size, bold].render(written, True, colour)

    def image(self, string: str, size: int, bold: bool, colour: Colour) -> pygame.Surface:
        """The string as a surface with a transparent ground."""
        key = (string, size, bold, colour)
        if key not in self._cache:
            if len(self._cache) >= _TEXT_CACHE:
                self._cache.clear()
            try:
                self._cache[key] = self._render(*key)
            except pygame.error:  # someone called pygame.quit(): the fonts are gone
                self._fonts.clear()
                self._cache[key] = self._render(*key)
        return self._cache[key]

    def put(
        self,
        target: pygame.Surface,
        string: str,
        x: int,
        y: int,
        size: int = 11,
        colour: Colour = INK,
        bold: bool = False,
        align: float = 0.0,
    ) -> int:
        """Write with the top at y; align 0, 0.5, 1: x is left, middle, right. Returns the width."""
        image = self.image(string, size, bold, colour)
        target.blit(image, (x - round(align * image.get_width()), y))
        return image.get_width()


TITLE = 34  # [px] height of the strip with a name
GAP = 4  # [px] between two pictures


def side_by_side(names: Sequence[str], pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures (height, width, 3) of one size as one; its sizes are even, as films need them."""
    count = len(pictures)
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    height, width = pictures[0].shape[:2]
    whole = surface(
        _even(columns * width + (columns - 1) * GAP), _even(rows * (TITLE + height) + rows * GAP)
    )
    whole.fill(PAPER)
    text = Text()
    for number, (name, picture) in enumerate(zip(names, pictures, strict=True)):
        row, column = divmod(number, columns)
        x, y = column * (width + GAP), row * (height + TITLE + GAP)
        pygame.draw.rect(whole, INK, (x, y, width, TITLE))
        text.put(whole, name, x + 12, y + 5, 20, WHITE, bold=True)
        paint(whole.subsurface((x, y + TITLE, width, height)), picture)
    return to_array(whole)


def _even(size: int) -> int:
    return size + size % 2
