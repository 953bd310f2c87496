"""How large things are drawn: lengths in contact lengths, forces in usual resistances.

A light vehicle then fills the picture as a heavy one does. The vehicle and its soil are the nominal
ones of the environment: what an episode draws does not move the scales.
"""

import math
from typing import NamedTuple

from tracked_env.physics.parameters import VEHICLES, PlantParameters

ZOOM = (40.0, 200.0)  # [px] allowed for one contact length
DEFAULT_ZOOM = 80.0  # [px] for one contact length
DEFAULT = VEHICLES["strawa"]  # the forces below are of this one, of others in proportion
FORCE_SCALE = 0.15e-3  # [m/N] length of an arrow
FORCE_SHOWN = 100.0  # [N] smaller forces get no arrow
FORCE_SAMPLE = 5e3  # [N] about what the sample arrow shows


class Sizes(NamedTuple):
    """Scales of a vehicle's pictures."""

    length: float  # [m] contact length
    force_scale: float  # [m/N] length of an arrow
    force_shown: float  # [N] smaller forces get no arrow
    force_sample: float  # [N] of the sample arrow, a round number


class Grid(NamedTuple):
    """Lines on the ground."""

    side: int  # [m] between thick lines, which have labels
    parts: int  # [-] from one of them to the next


def sizes_of(vehicle: PlantParameters) -> Sizes:
    """Sizes in pictures of that vehicle."""
    longer = vehicle.contact_length / DEFAULT.contact_length
    stronger = _usual_resistance(vehicle) / _usual_resistance(DEFAULT)
    return Sizes(
        vehicle.contact_length,
        FORCE_SCALE * longer / stronger,
        FORCE_SHOWN * stronger,
        _rounded_down(FORCE_SAMPLE * stronger),
    )


def _usual_resistance(p: PlantParameters) -> float:
    """Resistance of the soil to sliding ahead and aside, over g [kg]."""
    return p.mass * (p.longitudinal_resistance + p.lateral_resistance)


def _rounded_down(value: float) -> float:
    """The largest of 1, 2, 5, 10, 20 ... that is not above the value."""
    decade = 10.0 ** math.floor(math.log10(value))
    return max(decade * step for step in (1.0, 2.0, 5.0) if step == 1.0 or decade * step <= value)


def default_zoom(length: float) -> int:
    """Pixels per metre for a vehicle with that contact length [m]."""
    return round(DEFAULT_ZOOM / length)


def checked_zoom(pixels_per_metre: int, *lengths: float) -> int:
    """The zoom, if it is a whole number that suits one of the contact lengths [m].

    Without lengths: one of any preset vehicle. Raises ValueError for anything else.
    """
    given = lengths or [vehicle.contact_length for vehicle in VEHICLES.values()]
    low, high = math.ceil(ZOOM[0] / max(given)), math.floor(ZOOM[1] / min(given))
    if pixels_per_metre not in range(low, high + 1):
        whose = f" for a vehicle with {lengths[0]:g} m of contact" if lengths else ""
        raise ValueError(
            f"pixels_per_metre = {pixels_per_metre}; must be an int in [{low}, {high}]{whose}"
        )
    return int(pixels_per_metre)


def grid_of(pixels_per_metre: int) -> Grid:
    """Lines that are neither crowded nor lost at that zoom."""
    if pixels_per_metre <= 100:
        return Grid(5, 5)
    return Grid(2, 4) if pixels_per_metre <= 200 else Grid(1, 5)


def scale_bar(pixels_per_metre: int) -> float:
    """Length [m] of the bar that shows the scale, 40 to 100 px."""
    steps = ((50, 2.0), (100, 1.0), (200, 0.5))
    return next((metres for zoom, metres in steps if pixels_per_metre <= zoom), 0.2)
