"""Pictures of a running simulation, with pygame: import this package only to draw.

    canvas      colours, texts, labels, scales       snapshot     what a picture shows; terrain
    soil_map    the ground from above, its relief    scene        vehicle and paths from above, mesh
    legend      texts over the scene, terrain strip  panel        numbers, bars, beliefs, overview
    raster      depth buffer: ground and polygons    perspective  the scene from behind the vehicle
    renderer    puts them together                   viewer       an episode as a page for a browser
The viewer needs the extra `viewer`. World frame: x to the right, y up.
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
from tracked_env.rendering.snapshot import TerrainSource, source_of
from tracked_env.rendering.viewer import Recorder

__all__ = ["Recorder", "Renderer", "TerrainSource", "source_of"]
