"""How large things are drawn: lengths in contact lengths, forces in usual resistances.

A light vehicle then fills the picture as a heavy one does. The vehicle and its soil are the nominal
ones of the environment: what an episode draws does not move the scales.

How parameters are written in pictures: label, symbol, display unit, digits, colour range.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from tracked_env.physics import lumped
from tracked_env.physics.parameters import PARAMETER_NAMES, RANGES, VEHICLES, PlantParameters

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


ROUNDING = 0.05  # [-] of the usual value of a parameter


class Quantity(NamedTuple):
    """One parameter in a picture; the displayed value is the SI value times `factor`."""

    label: str
    unit: str
    factor: float
    decimals: int
    low: float = 0.0  # display unit, lower end of the colour scale
    high: float = 1.0  # display unit, upper end of the colour scale

    def number(self, value: float, usual: float = 0.0) -> str:
        """The value in its display unit, without the unit.

        usual: a value that the decimals have to show to within ROUNDING; 0: as many as usual.
        """
        shown, decimals = usual * self.factor, self.decimals
        while abs(round(shown, decimals) - shown) > ROUNDING * abs(shown):
            decimals += 1
        return f"{value * self.factor:.{decimals}f}"

    def share(self, value: Any) -> Any:
        """Position of a number or an array on the colour scale; beyond its ends outside [0, 1]."""
        return (value * self.factor - self.low) / (self.high - self.low)


_DEG = 57.29577951308232  # [deg/rad]
QUANTITIES = {
    "mass": Quantity("mass m", "kg", 1.0, 0),
    "inertia": Quantity("yaw inertia I", "kg m²", 1.0, 0),
    "track_gauge": Quantity("track gauge B", "m", 1.0, 2),
    "track_width": Quantity("track width w", "m", 1.0, 2),
    "contact_length": Quantity("contact length l", "m", 1.0, 2),
    "sprocket_radius": Quantity("sprocket radius r", "m", 1.0, 3),
    "torque_limit": Quantity("torque limit", "kN m", 1e-3, 2),
    "sprocket_speed_limit": Quantity("sprocket speed limit", "rad/s", 1.0, 1),
    "drive_time_constant": Quantity("drive time constant", "ms", 1e3, 0),
    "sprocket_inertia": Quantity("sprocket inertia J", "kg m²", 1.0, 2),
    "cohesion": Quantity("cohesion c", "kPa", 1e-3, 1, 0.0, 80.0),
    "friction_angle": Quantity("friction angle φ", "°", _DEG, 1, 0.0, 45.0),
    "shear_deformation_modulus": Quantity("shear deformation K", "mm", 1e3, 1, 0.0, 40.0),
    "longitudinal_resistance": Quantity("motion resistance", "", 1.0, 2, 0.0, 1.2),
    "lateral_resistance": Quantity("lateral resistance", "", 1.0, 2, 0.0, 1.2),
    "turning_resistance_factor": Quantity("turning factor", "", 1.0, 2),
    "icr_forward": Quantity("ICR forward d", "m", 1.0, 2),
    "ground_stiffness_factor": Quantity("ground stiffness factor", "", 1.0, 2, 0.0, 1.5),
}
for _name in PARAMETER_NAMES:  # those without an entry of their own
    _unit = RANGES[_name].unit.replace("^2", "²")
    _label = _name.replace("_", " ")
    QUANTITIES.setdefault(_name, Quantity(_label, "" if _unit == "-" else _unit, 1.0, 2))
# What follows from parameters and may be shown in their place.
FOLLOWING: dict[str, Callable[[PlantParameters], float]] = {
    "friction": lambda p: math.tan(p.friction_angle),
    "effort_maximum": lambda p: float(lumped.drive_limits(p).effort_maximum),
}
QUANTITIES["friction"] = Quantity("friction μ = tan φ", "", 1.0, 2)
QUANTITIES["effort_maximum"] = Quantity("largest effort of a track", "kN", 1e-3, 1)


def value_of(parameters: PlantParameters, name: str) -> float:
    """SI value of a parameter, or of what follows from parameters."""
    following = FOLLOWING.get(name)
    return float(getattr(parameters, name)) if following is None else following(parameters)
