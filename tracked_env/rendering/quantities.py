"""How parameters are written in pictures: label, symbol, display unit, digits, colour range."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from tracked_env.physics import vehicle
from tracked_env.physics.parameters import PARAMETER_NAMES, RANGES, PlantParameters

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
    "effort_maximum": lambda p: float(vehicle.drive_limits(p).effort_maximum),
}
QUANTITIES["friction"] = Quantity("friction μ = tan φ", "", 1.0, 2)
QUANTITIES["effort_maximum"] = Quantity("largest effort of a track", "kN", 1e-3, 1)


def value_of(parameters: PlantParameters, name: str) -> float:
    """SI value of a parameter, or of what follows from parameters."""
    following = FOLLOWING.get(name)
    return float(getattr(parameters, name)) if following is None else following(parameters)
