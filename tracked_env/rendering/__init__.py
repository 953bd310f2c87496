"""Pictures of a running simulation, with pygame: import this package only to draw.

    canvas      colours, text, surfaces          snapshot  what one picture shows, from the arrays
    sizes       scales, by the vehicle           drives    numbers and bars of the drives
    quantities  labels, units, displayed ranges  memory    what a picture needs of those before it
    soil_map    the ground, coloured             scene     the world around the vehicle
    panel       numbers, bars and the overview   renderer  puts them together
World frame: x to the right, y up.
"""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
try:
    import pygame
except ImportError as error:
    raise ImportError(
        'rendering needs pygame-ce, which is not installed: pip install "tracked-env[render]"'
    ) from error
if not getattr(pygame, "IS_CE", False):
    raise ImportError(
        "rendering needs pygame-ce, but the older pygame is installed in its place: "
        'pip uninstall pygame && pip install --force-reinstall pygame-ce "tracked-env[render]"'
    )

from tracked_env.rendering.renderer import Renderer

__all__ = ["Renderer"]
