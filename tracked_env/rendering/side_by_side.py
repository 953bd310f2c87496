"""Several pictures of one size in one, each under its name: two in a row, four in a square.

Names are in large letters, which can be read in a film that is shown in a column of a page.
"""

import math
from collections.abc import Sequence

import numpy as np
import pygame
from numpy.typing import NDArray

from tracked_env.rendering import canvas

TITLE = 34  # [px] height of the strip with a name
GAP = 4  # [px] between two pictures


def side_by_side(names: Sequence[str], pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures (height, width, 3) of one size as one; its sizes are even, as films need them."""
    count = len(pictures)
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    height, width = pictures[0].shape[:2]
    whole = canvas.surface(
        _even(columns * width + (columns - 1) * GAP), _even(rows * (TITLE + height) + rows * GAP)
    )
    whole.fill(canvas.PAPER)
    text = canvas.Text()
    for number, (name, picture) in enumerate(zip(names, pictures, strict=True)):
        row, column = divmod(number, columns)
        x, y = column * (width + GAP), row * (height + TITLE + GAP)
        pygame.draw.rect(whole, canvas.INK, (x, y, width, TITLE))
        text.put(whole, name, x + 12, y + 5, 20, canvas.WHITE, bold=True)
        canvas.paint(whole.subsurface((x, y + TITLE, width, height)), picture)
    return canvas.to_array(whole)


def _even(size: int) -> int:
    return size + size % 2
