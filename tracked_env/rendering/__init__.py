"""Pictures of a running simulation, with pygame: import this package only to draw.

    canvas       colours, text, surfaces          snapshot   what one picture shows, from the arrays
    sizes        scales, by the vehicle           drives     numbers and bars of the drives
    quantities   labels, units, displayed ranges  afterglow  what a picture needs of those before it
    soil_map     the ground, coloured             scene      the vehicle and paths, from above
    panel        numbers, bars and the overview   renderer   puts them together
    belief_rows  estimates beside the truth       tile       few large numbers instead of a panel
    side_by_side several pictures in one
On terrain and from behind the vehicle:
    terrain_source  heights, loads, pose          hill_shading   brightness of slopes, contour lines
    terrain_strip   profile, loads, tilt          raster         depth buffer: ground and polygons
    landscape       ground of an episode          vehicle_mesh   the vehicle as polygons
    chase_camera    where the eye stands          perspective    puts these together
In a browser, with the extra `viewer`: recording (an episode as arrays), viewer (page and server).
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
from tracked_env.rendering.snapshot import TerrainSource, source_of
from tracked_env.rendering.viewer import Recorder

__all__ = ["Recorder", "Renderer", "TerrainSource", "source_of"]
