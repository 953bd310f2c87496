"""What a vehicle can do on a soil, in closed form, and which of its parameters do not fit.

With W = m g on two tracks, F the effort that one track can give (the drive, T / r, and the soil,
S (7) at i = 1, whichever is less), R = mu_l W / 2 its motion resistance, B the gauge:
    turning on the spot   needs f mu_t W l / (4 B) + R of a track: the moment of lateral friction
                          under uniform pressure, S (20) with its factor f, over the gauge
    a grade               sin(a) + mu_l cos(a) <= 2 F / W, with the soil's part of F falling as
                          cos(a)
    acceleration          (2 F - mu_l W) / m on level ground
Speeds are without slip. A turn with lateral acceleration needs the same moment: friction that
slides does not depend on the speed.

References: [S] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from typing import NamedTuple

from tracked_env.physics.lumped import drive_limits, turning_effort
from tracked_env.physics.parameters import PlantParameters, top_speed
from tracked_env.physics.terramechanics import GRAVITY

# Beyond these a number is likely a slip of the pen; all are [-] but for the pressure.
INERTIA_RATIO = (0.4, 3.0)  # yaw inertia over that of a box around the tracks
LENGTH_OVER_GAUGE = (0.7, 1.9)  # of vehicles that are built: Wong's rule is 1 to 1.8
PRESSURE = (1e3, 2e5)  # [Pa]
LARGEST_SHARE = 0.9  # of the effort, that a turn on the spot may need


class Abilities(NamedTuple):
    """What one vehicle can do; efforts are of one track."""

    ground_pressure: float  # [Pa] mean, W over both contacts
    top_speed: float  # [m/s]
    fastest_turn: float  # [rad/s] on the spot
    drive_effort: float  # [N] T / r
    traction: float  # [N] S (7) on the soil, at i = 1
    turning_effort: float  # [N] that a turn on the spot needs
    turning_torque: float  # [N m] the same at the sprocket
    turning_share: float  # [-] of the effort that drive and soil give
    steepest_grade: float  # [rad] that it climbs; 0: cannot move on level ground, pi/2: any
    acceleration: float  # [m/s^2] on level ground, largest


def _steepest(p: PlantParameters, drive: float) -> float:
    """Grade [rad] at which the drives, or the soil, are used up; pi/2 where nothing stops it."""
    weight, resistance, limits = p.mass * GRAVITY, p.longitudinal_resistance, drive_limits(p)
    mobilised = limits.effort_limit / limits.effort_maximum  # [-] share of the strength, i = 1
    cohesive = mobilised * p.cohesion * p.track_width * p.contact_length

    def grade(share: float, slope: float) -> float:
        """Root of sin(a) + slope cos(a) = share [-]."""
        largest = math.hypot(1.0, slope)
        return math.asin(share / largest) - math.atan(slope) if share < largest else 0.5 * math.pi

    by_drive = grade(2.0 * drive / weight, resistance)
    by_soil = grade(2.0 * cohesive / weight, resistance - mobilised * math.tan(p.friction_angle))
    return max(min(by_drive, by_soil, 0.5 * math.pi), 0.0)


def abilities(p: PlantParameters) -> Abilities:
    """What a vehicle can do on the soil of its parameters."""
    weight, area = p.mass * GRAVITY, p.track_width * p.contact_length
    weaker = min(p.actuator_gain_left, p.actuator_gain_right)
    drive, traction = weaker * p.torque_limit / p.sprocket_radius, drive_limits(p).effort_limit
    effort, turning = min(drive, traction), turning_effort(p)
    return Abilities(
        ground_pressure=0.5 * weight / area,
        top_speed=top_speed(p),
        fastest_turn=2.0 * top_speed(p) / p.track_gauge,
        drive_effort=drive,
        traction=traction,
        turning_effort=turning,
        turning_torque=turning * p.sprocket_radius,
        turning_share=turning / effort,
        steepest_grade=_steepest(p, drive),
        acceleration=2.0 * effort / p.mass - p.longitudinal_resistance * GRAVITY,
    )


def contradictions(p: PlantParameters) -> list[str]:
    """What does not fit together, each a sentence with the numbers; empty for a sound vehicle."""
    able, found = abilities(p), list[str]()
    if able.acceleration <= 0.0:
        resistance = 0.5 * p.longitudinal_resistance * p.mass * GRAVITY
        found.append(
            f"it cannot move on its soil: a track gives {able.drive_effort:.4g} N by its drive, "
            f"{able.traction:.4g} N by the soil, and resists with {resistance:.4g} N"
        )
    elif able.turning_share > LARGEST_SHARE:
        found.append(
            f"it can hardly turn on its soil: a turn on the spot needs {able.turning_effort:.4g} N "
            f"of a track, {able.turning_share:.0%} of the {able.drive_effort:.4g} N that the drive "
            f"gives and the {able.traction:.4g} N that the soil carries. Is torque_limit that of "
            "the motor, before the gear?"
        )
    length, width = p.contact_length, p.track_gauge + p.track_width
    box = p.mass * (length * length + width * width) / 12.0
    checks = (
        ("inertia over that of a box around the tracks", p.inertia / box, INERTIA_RATIO, "-",
         f"inertia = {p.inertia:g} kg m^2, the box of this mass has {box:.3g} kg m^2"),
        ("contact_length over track_gauge", length / p.track_gauge, LENGTH_OVER_GAUGE, "-",
         "longer vehicles hardly turn, shorter ones hardly drive straight"),
        ("track_width over track_gauge", p.track_width / p.track_gauge, (0.0, 1.0), "-",
         "the tracks overlap"),
        ("ground pressure", able.ground_pressure, PRESSURE, "Pa",
         "is it the mass, or the size of the contact?"),
        ("inertia of a drive at its track, J / r^2, over the mass",
         p.sprocket_inertia / p.sprocket_radius**2 / p.mass, (0.0, 1.0), "-",
         "is the gear ratio squared in sprocket_inertia twice?"),
    )  # fmt: skip
    found += [
        f"{what} = {value:.3g} {unit}; usual is {low:g} to {high:g} {unit}: {hint}"
        for what, value, (low, high), unit, hint in checks
        if not low <= value <= high
    ]
    return found
