"""What every part of a picture is drawn with: colours, texts, surfaces, labels and scales.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart [1]; scales vary
in lightness, so that they also survive a grey print. Lengths in pictures are proportional to the
contact length, forces to the usual resistance of the environment's nominal vehicle on its soil: a
light vehicle fills the picture as a heavy one does, and no episode moves the scales. Text has 10 px
where a picture is shown 650 px wide, as on a page.

References: [1] Okabe, Ito, Color Universal Design, 2008.
"""

import math
from collections.abc import Sequence
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pygame
from numpy.typing import NDArray
from pygame import Surface

from tracked_env.physics.lumped import drive_limits
from tracked_env.physics.parameters import PARAMETER_NAMES, RANGES, VEHICLES, PlantParameters

Colour = tuple[int, int, int]
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Lines = list[tuple[Floats, Colour]]  # paths (P, 2) [m] on the ground
TEXT = 15  # [px] of letters

INK: Colour = (33, 37, 41)
MUTED: Colour = (98, 106, 114)
RULE: Colour = (214, 218, 222)
PAPER: Colour = (252, 252, 251)
WHITE: Colour = (255, 255, 255)
FIELD: Colour = (238, 240, 242)  # behind bars and bands
BLUE: Colour = (0, 114, 178)  # reference
PALE_BLUE: Colour = (116, 166, 199)  # the part of it that is past
GREEN: Colour = (0, 140, 102)  # tractive effort
VERMILLION: Colour = (213, 94, 0)  # motion resistance; what has changed
PURPLE: Colour = (170, 64, 126)  # lateral force
QUANTITY_COLOURS = (INK, MUTED, BLUE, PALE_BLUE, GREEN, VERMILLION, PURPLE)


def colour_scale(*stops: Colour) -> Bytes:
    """256 colours (256, 3) through equally spaced stops."""
    grid, at = np.linspace(0.0, 1.0, 256), np.linspace(0.0, 1.0, len(stops))
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


def load_colours(loads: Floats, full: float) -> Bytes:
    """Colours (..., 3) of normal loads (...) [N]; full [N]: end of the scale."""
    share = np.clip(np.nan_to_num(loads) / full, 0.0, 1.0)
    return LOAD_SCALE[(255.0 * share).astype(np.uint8)]


def shaded(colour: Colour) -> Colour:
    """The colour made lighter when it is dark, else darker."""
    light = sum(colour) > 330
    r, g, b = (round(0.6 * c) if light else round(c + 0.32 * (255 - c)) for c in colour)
    return r, g, b


def surface(width: int, height: int, transparent: bool = False) -> Surface:
    """A 32-bit surface in memory; needs no window."""
    if transparent:
        return Surface((width, height), pygame.SRCALPHA, 32)
    return Surface((width, height), 0, 32, (0xFF0000, 0x00FF00, 0x0000FF, 0))


def paint(target: Surface, pixels: Bytes) -> None:
    """Copy an image (height, width, 3) onto a surface of that size."""
    pygame.surfarray.blit_array(target, pixels.swapaxes(0, 1))


def to_array(source: Surface) -> Bytes:
    """A copy of the picture, (height, width, 3)."""
    pixels = pygame.surfarray.pixels3d(source).swapaxes(0, 1)
    picture = np.empty(pixels.shape, dtype=np.uint8)
    for channel in range(3):  # five times faster than copying them together
        picture[..., channel] = pixels[..., channel]
    return picture


def colour_bar(scale: Bytes, width: int, height: int) -> Surface:
    """A colour scale from left to right."""
    bar = surface(width, height)
    row = scale[np.linspace(0, 255, width).astype(int)]
    paint(bar, np.broadcast_to(row, (height, width, 3)))
    return bar


@cache
def _font(size: int, bold: bool) -> pygame.font.Font:
    """DejaVu Sans, as matplotlib ships it."""
    spec = find_spec("matplotlib")  # importing it takes long
    assert spec is not None and spec.origin is not None
    folder = Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"
    return pygame.font.Font(folder / f"DejaVuSans{'-Bold' if bold else ''}.ttf", size)


@lru_cache(maxsize=2048)
def text_image(string: str, size: int, bold: bool, colour: Colour) -> Surface:
    """The string as a surface with a transparent ground."""
    pygame.font.init()
    try:
        return _font(size, bold).render(string, True, colour)
    except pygame.error:  # pygame.quit() was called since: its fonts are dead
        _font.cache_clear()
        return _font(size, bold).render(string, True, colour)


class Sheet:
    """A surface of a picture that is written on."""

    def __init__(self, target: Surface) -> None:
        self.surface = target

    def put(
        self,
        string: str,
        x: int,
        y: int,
        size: int = TEXT,
        colour: Colour = INK,
        bold: bool = False,
        align: float = 0.0,
    ) -> int:
        """Write with the top at y; align 0, 0.5, 1: x is left, middle, right. Returns the width."""
        image = text_image(string, size, bold, colour)
        self.surface.blit(image, (x - round(align * image.get_width()), y))
        return image.get_width()

    def note(self, string: str, x: int, y: int, align: float = 0.0) -> None:
        """Write pale."""
        self.put(string, x, y, colour=MUTED, align=align)

    def heading(self, string: str, x: int, y: int, end: int) -> None:
        """Write a heading, with a rule behind it up to the column `end`."""
        start = x + 6 + self.put(string, x, y, bold=True, colour=MUTED)
        pygame.draw.line(self.surface, RULE, (start, y + 9), (end, y + 9))

    def scale(self, colours: Bytes, box: pygame.Rect) -> None:
        """A colour scale from left to right, framed."""
        self.surface.blit(colour_bar(colours, *box.size), box)
        pygame.draw.rect(self.surface, MUTED, box, 1)

    def here(self, place: Sequence[float]) -> None:
        """Mark where the vehicle is [px]."""
        pygame.draw.circle(self.surface, WHITE, place, 5)
        pygame.draw.circle(self.surface, VERMILLION, place, 4)


class Label(NamedTuple):
    """How a parameter is written; the displayed value is the SI value times `factor`."""

    label: str
    unit: str
    factor: float
    decimals: int
    low: float = 0.0  # display unit, lower end of the colour scale
    high: float = 1.0  # display unit, upper end of the colour scale

    @property
    def with_unit(self) -> str:
        """The label, and behind it the unit in brackets where there is one."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    def number(self, value: float, usual: float = 0.0) -> str:
        """The value in its display unit, without the unit.

        usual: a value that the decimals have to show to within ROUNDING; 0: as many as usual.
        """
        usual_shown, decimals = usual * self.factor, self.decimals
        while abs(round(usual_shown, decimals) - usual_shown) > ROUNDING * abs(usual_shown):
            decimals += 1
        return f"{value * self.factor:.{decimals}f}"

    def share(self, value: Any) -> Any:
        """Position of a number or an array on the colour scale; beyond its ends outside [0, 1]."""
        return (value * self.factor - self.low) / (self.high - self.low)


ROUNDING = 0.05  # [-] of the usual value of a parameter
_DEG = math.degrees(1.0)  # [deg/rad]
LABELS = {
    "mass": Label("mass m", "kg", 1.0, 0),
    "inertia": Label("yaw inertia I", "kg m²", 1.0, 0),
    "track_gauge": Label("track gauge B", "m", 1.0, 2),
    "track_width": Label("track width w", "m", 1.0, 2),
    "contact_length": Label("contact length l", "m", 1.0, 2),
    "sprocket_radius": Label("sprocket radius r", "m", 1.0, 3),
    "torque_limit": Label("torque limit", "kN m", 1e-3, 2),
    "sprocket_speed_limit": Label("sprocket speed limit", "rad/s", 1.0, 1),
    "drive_time_constant": Label("drive time constant", "ms", 1e3, 0),
    "sprocket_inertia": Label("sprocket inertia J", "kg m²", 1.0, 2),
    "cohesion": Label("cohesion c", "kPa", 1e-3, 1, 0.0, 80.0),
    "friction_angle": Label("friction angle φ", "°", _DEG, 1, 0.0, 45.0),
    "shear_deformation_modulus": Label("shear deformation K", "mm", 1e3, 1, 0.0, 40.0),
    "longitudinal_resistance": Label("motion resistance", "", 1.0, 2, 0.0, 1.2),
    "lateral_resistance": Label("lateral resistance", "", 1.0, 2, 0.0, 1.2),
    "turning_resistance_factor": Label("turning factor", "", 1.0, 2),
    "icr_forward": Label("ICR forward d", "m", 1.0, 2),
    "ground_stiffness_factor": Label("ground stiffness factor", "", 1.0, 2, 0.0, 1.5),
    # What follows from parameters and may be shown in their place.
    "friction": Label("friction μ = tan φ", "", 1.0, 2),
    "effort_maximum": Label("largest effort of a track", "kN", 1e-3, 1),
}
for _name in PARAMETER_NAMES:  # those without an entry of their own
    _unit = RANGES[_name].unit.replace("^2", "²")
    LABELS.setdefault(_name, Label(_name.replace("_", " "), "" if _unit == "-" else _unit, 1.0, 2))


def value_of(parameters: PlantParameters, name: str) -> float:
    """SI value of a parameter, or of what follows from parameters."""
    if name == "friction":
        return math.tan(parameters.friction_angle)
    if name == "effort_maximum":
        return float(drive_limits(parameters).effort_maximum)
    return float(getattr(parameters, name))


ZOOM = (40.0, 200.0)  # [px] allowed for one contact length
DEFAULT_ZOOM = 80.0  # [px] for one contact length
STANDARD = VEHICLES["strawa"]  # the forces below are of this vehicle, of others in proportion
FORCE_SCALE = 0.15e-3  # [m/N] length of an arrow
FORCE_SHOWN = 100.0  # [N] smaller forces get no arrow
FORCE_SAMPLE = 5e3  # [N] about what the sample arrow shows


class Sizes(NamedTuple):
    """Scales of a vehicle's pictures."""

    length: float  # [m] contact length
    force_scale: float  # [m/N] length of an arrow
    force_shown: float  # [N] smaller forces get no arrow
    force_sample: float  # [N] of the sample arrow, a round number


def sizes_of(vehicle: PlantParameters) -> Sizes:
    """Sizes in pictures of that vehicle."""

    def usual_resistance(p: PlantParameters) -> float:
        """Of the soil to sliding ahead and aside, over g [kg]."""
        return p.mass * (p.longitudinal_resistance + p.lateral_resistance)

    longer = vehicle.contact_length / STANDARD.contact_length
    stronger = usual_resistance(vehicle) / usual_resistance(STANDARD)
    decade = 10.0 ** math.floor(math.log10(FORCE_SAMPLE * stronger))
    rounded = (decade * x for x in (2.0, 5.0) if decade * x <= FORCE_SAMPLE * stronger)
    return Sizes(
        vehicle.contact_length,
        FORCE_SCALE * longer / stronger,
        FORCE_SHOWN * stronger,
        max(rounded, default=decade),
    )


def default_zoom(length: float) -> int:
    """Pixels per metre for a vehicle with that contact length [m]."""
    return round(DEFAULT_ZOOM / length)


def checked_zoom(pixels_per_metre: int | None, length: float) -> int:
    """The zoom, if it is a whole number that suits a vehicle with that contact length [m].

    None: the default one. Raises ValueError for anything else.
    """
    if pixels_per_metre is None:
        return default_zoom(length)
    low, high = math.ceil(ZOOM[0] / length), math.floor(ZOOM[1] / length)
    if pixels_per_metre not in range(low, high + 1):
        raise ValueError(
            f"pixels_per_metre = {pixels_per_metre}; must be an int in [{low}, {high}] for a "
            f"vehicle with {length:g} m of contact"
        )
    return int(pixels_per_metre)


class Grid(NamedTuple):
    """Lines on the ground."""

    side: int  # [m] between thick lines, which have labels
    parts: int  # [-] from one of them to the next


def grid_of(pixels_per_metre: int) -> Grid:
    """Lines that are neither crowded nor lost at that zoom."""
    if pixels_per_metre <= 100:
        return Grid(5, 5)
    return Grid(2, 4) if pixels_per_metre <= 200 else Grid(1, 5)


def scale_bar(pixels_per_metre: int) -> float:
    """Length [m] of the bar that shows the scale, 40 to 100 px."""
    steps = ((50, 2.0), (100, 1.0), (200, 0.5))
    return next((metres for zoom, metres in steps if pixels_per_metre <= zoom), 0.2)
