"""Parameters and state of a tracked vehicle: names, units, physical ranges, presets.

A batch of N vehicles keeps one vehicle per row and one parameter per column, in the order of
`PARAMETER_NAMES`, shape (N, PARAMETER_ROWS); its state likewise, shape (N, STATE_ROWS). Schedules
and frozen sets know a parameter by its row, so a new one comes at the end. A plant integrates the
entries of the state that are its own; the others follow from them and are refreshed after every
control step.
World frame x, y, z up; body frame ISO 8855 (x forward, y left); yaw positive to the left. The
attitude is yaw, then pitch, then roll (z-y'-x''). Planar plants leave the last seven entries at 0.

References: [1] Strawa et al., Electronics 10 (2021) 187, Tables 1 and 2. [2] Focchi et al.,
"Pseudo-Kinematic Trajectory Control and Planning of Tracked Vehicles" (2025), Table 2.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tracked_env.physics.jit import template


class SoilParameters(NamedTuple):
    """The soil: default is heavy clay, Table 2 of [1]."""

    cohesion: float = 70e3  # [Pa] c
    friction_angle: float = math.radians(38.4)  # [rad] phi, angle of internal shearing resistance
    shear_deformation_modulus: float = 0.02  # [m] K
    longitudinal_resistance: float = 0.6  # [-] mu_l, motion resistance over weight
    lateral_resistance: float = 0.8  # [-] mu_t, lateral friction over weight
    ground_stiffness_factor: float = 1.0  # [-] on the springs and dampers of the ground


HEAVY_CLAY = SoilParameters()


class PlantParameters(NamedTuple):
    """All parameters of one vehicle on its soil, as the kernels take them.

    Default is Table 1 of [1] on heavy clay; the drive is this project's choice.
    """

    mass: float = 1450.0  # [kg] m
    inertia: float = 1180.0  # [kg m^2] I, yaw, about the centre of mass
    track_gauge: float = 1.7  # [m] B, between the track centre lines
    track_width: float = 0.3  # [m] w
    contact_length: float = 2.0  # [m] l
    sprocket_radius: float = 0.3  # [m] r
    torque_limit: float = 8000.0  # [N m] of one drive, at the sprocket
    sprocket_speed_limit: float = 20.0  # [rad/s] of one drive, at the sprocket
    drive_time_constant: float = 0.05  # [s] lag of the torque (or speed) behind its demand
    sprocket_inertia: float = 10.0  # [kg m^2] J, of one drive and track, seen at the sprocket
    cohesion: float = HEAVY_CLAY.cohesion  # [Pa] the soil's, as the next four
    friction_angle: float = HEAVY_CLAY.friction_angle  # [rad]
    shear_deformation_modulus: float = HEAVY_CLAY.shear_deformation_modulus  # [m]
    longitudinal_resistance: float = HEAVY_CLAY.longitudinal_resistance  # [-]
    lateral_resistance: float = HEAVY_CLAY.lateral_resistance  # [-]
    turning_resistance_factor: float = 1.0  # [-] 1 = integral; 2 = as printed in S (20)
    icr_forward: float = 0.05  # [m] d, x_ICR in the `constrained` lateral model
    centre_of_mass_x: float = 0.0  # [m] of the centre of mass ahead of the nominal one, body axes
    centre_of_mass_y: float = 0.0  # [m] the same, to the left
    centre_of_mass_z: float = 0.0  # [m] the same, upward
    roll_inertia_ratio: float = 2.18 / 4.5  # [-] roll over yaw inertia, of [2] for every vehicle
    pitch_inertia_ratio: float = 2.81 / 4.5  # [-] pitch over yaw inertia, of [2] likewise
    ground_stiffness_factor: float = HEAVY_CLAY.ground_stiffness_factor  # [-] the soil's
    actuator_gain_left: float = 1.0  # [-] torque that the left drive gives over its command
    actuator_gain_right: float = 1.0  # [-] the same of the right drive


class ParametersRead(NamedTuple):
    """The parameters on which motion and sensors of a plant depend, with its drive and options.

    What a plant does not read may be drawn, but setting or scheduling it is an error.
    """

    plant: str  # the plant in words, for messages
    names: frozenset[str]
    limit: str  # the parameter in which its actions are measured


class Range(NamedTuple):
    """Range of a quantity, both ends allowed, and what a value outside suggests."""

    low: float
    high: float
    unit: str
    hint: str


class VehicleState(NamedTuple):
    """State of one vehicle (floats) or of a batch (arrays of shape (N,))."""

    x: float = 0.0  # [m] X, centre of mass, world
    y: float = 0.0  # [m] Y, centre of mass, world
    yaw: float = 0.0  # [rad] heading, not wrapped
    v_x: float = 0.0  # [m/s] forward velocity, body
    v_y: float = 0.0  # [m/s] lateral velocity, body, to the left
    yaw_rate: float = 0.0  # [rad/s] positive to the left
    torque_left: float = 0.0  # [N m] torque of the drive at the left sprocket
    torque_right: float = 0.0  # [N m] torque of the drive at the right sprocket
    slip_left: float = 0.0  # [-] i, slip ratio of the left track
    slip_right: float = 0.0  # [-] i, slip ratio of the right track
    sprocket_speed_left: float = 0.0  # [rad/s] omega, left
    sprocket_speed_right: float = 0.0  # [rad/s] omega, right
    effort_left: float = 0.0  # [N] F, tractive effort of the left track
    effort_right: float = 0.0  # [N] F, tractive effort of the right track
    acceleration_x: float = 0.0  # [m/s^2] inertial acceleration, body x
    acceleration_y: float = 0.0  # [m/s^2] inertial acceleration, body y
    yaw_acceleration: float = 0.0  # [rad/s^2]
    z: float = 0.0  # [m] Z, centre of mass above its height on level ground at rest, world
    roll: float = 0.0  # [rad] positive: left side up
    pitch: float = 0.0  # [rad] positive: nose down
    v_z: float = 0.0  # [m/s] vertical velocity, body, upward
    roll_rate: float = 0.0  # [rad/s] about the body's x axis
    pitch_rate: float = 0.0  # [rad/s] about the body's y axis
    acceleration_z: float = 0.0  # [m/s^2] inertial acceleration, body z


PARAMETER_NAMES, STATE_NAMES = PlantParameters._fields, VehicleState._fields
PARAMETER_ROWS, STATE_ROWS = len(PARAMETER_NAMES), len(STATE_NAMES)
PARAMETER_INDEX = {name: row for row, name in enumerate(PARAMETER_NAMES)}
(X, Y, YAW, V_X, V_Y, YAW_RATE, TORQUE_LEFT, TORQUE_RIGHT, SLIP_LEFT, SLIP_RIGHT) = range(10)
(SPROCKET_SPEED_LEFT, SPROCKET_SPEED_RIGHT, EFFORT_LEFT, EFFORT_RIGHT) = range(10, 14)
(ACCELERATION_X, ACCELERATION_Y, YAW_ACCELERATION) = range(14, 17)
(Z, ROLL, PITCH, V_Z, ROLL_RATE, PITCH_RATE, ACCELERATION_Z) = range(17, STATE_ROWS)
GROUPS = {  # choices of the lateral model that are numbers are a group of their own
    "vehicle": PARAMETER_NAMES[:10] + PARAMETER_NAMES[17:22] + PARAMETER_NAMES[23:],
    "soil": SoilParameters._fields,
    "lateral_model": PARAMETER_NAMES[15:17],
}

# What only a plant with a height, a roll and a pitch reads: centre of mass to ground stiffness.
IN_SPACE = frozenset(PARAMETER_NAMES[17:23])
# What only a plant reads that is driven by torques.
OF_TORQUE_DRIVES = frozenset(
    {"torque_limit", "sprocket_inertia", "actuator_gain_left", "actuator_gain_right"}
)

STRAWA_VEHICLE = PlantParameters()
FOCCHI_VEHICLE = PlantParameters(  # Table 2 of [2]; the drive is this project's choice
    mass=62.0,
    inertia=4.5,
    track_gauge=0.606,
    track_width=0.1,
    contact_length=0.7,
    sprocket_radius=0.0856,
    torque_limit=40.0,
    sprocket_speed_limit=10.0,
    drive_time_constant=0.0,
    sprocket_inertia=0.05,
)
FIRM_FLOOR = SoilParameters(  # rubber on a firm floor, [2]: no cohesion, mu = tan(phi) = 0.4
    cohesion=0.0,
    friction_angle=math.atan(0.4),
    shear_deformation_modulus=0.001,
    longitudinal_resistance=0.025,
    lateral_resistance=0.4,
)

RANGES = {
    "mass": Range(10.0, 1e5, "kg", "Did you pass tonnes?"),
    "inertia": Range(0.5, 1e6, "kg m^2", "It is the yaw inertia about the centre of mass."),
    "track_gauge": Range(0.1, 10.0, "m", "Did you pass millimetres?"),
    "track_width": Range(0.01, 2.0, "m", "Did you pass millimetres?"),
    "contact_length": Range(0.1, 10.0, "m", "Did you pass millimetres?"),
    "sprocket_radius": Range(0.01, 2.0, "m", "Did you pass the diameter or millimetres?"),
    "torque_limit": Range(0.1, 1e6, "N m", "It is the torque at the sprocket, after the gear."),
    "sprocket_speed_limit": Range(0.1, 1e3, "rad/s", "Did you pass rpm or the motor's speed?"),
    "drive_time_constant": Range(0.0, 10.0, "s", "Did you pass milliseconds?"),
    "sprocket_inertia": Range(1e-4, 1e4, "kg m^2", "Did you forget the gear ratio squared?"),
    "cohesion": Range(0.0, 1e6, "Pa", "Did you pass kPa, or change the sign?"),
    "friction_angle": Range(0.0, math.radians(60.0), "rad", "Did you pass degrees?"),
    "shear_deformation_modulus": Range(1e-4, 1.0, "m", "Did you pass centimetres, or G in Pa?"),
    "longitudinal_resistance": Range(0.0, 1.5, "-", "Did you pass a percentage?"),
    "lateral_resistance": Range(0.0, 2.0, "-", "Did you pass a percentage?"),
    "turning_resistance_factor": Range(0.0, 4.0, "-", "1 is the integral, 2 the printed S (20)."),
    "icr_forward": Range(-2.0, 2.0, "m", "Beyond the track ends the motion is unstable."),
    "centre_of_mass_x": Range(-1.0, 1.0, "m", "It is an offset from the nominal centre of mass."),
    "centre_of_mass_y": Range(-1.0, 1.0, "m", "It is an offset from the nominal centre of mass."),
    "centre_of_mass_z": Range(-1.0, 1.0, "m", "It is an offset from the nominal centre of mass."),
    "roll_inertia_ratio": Range(0.05, 5.0, "-", "It is over the yaw inertia, not in kg m^2."),
    "pitch_inertia_ratio": Range(0.05, 5.0, "-", "It is over the yaw inertia, not in kg m^2."),
    "ground_stiffness_factor": Range(0.05, 10.0, "-", "It is a factor; 1 is the plant's option."),
    "actuator_gain_left": Range(0.2, 1.2, "-", "1 is a sound drive. Did you pass a percentage?"),
    "actuator_gain_right": Range(0.2, 1.2, "-", "1 is a sound drive. Did you pass a percentage?"),
}


def plant_parameters(
    vehicle: PlantParameters = STRAWA_VEHICLE, soil: SoilParameters = HEAVY_CLAY
) -> PlantParameters:
    """The vehicle on a soil; all numbers as floats, as the kernels are compiled for."""
    values = vehicle._asdict() | soil._asdict()
    return PlantParameters(**{name: float(value) for name, value in values.items()})


def gathering(kind: Any, arguments: str, entries: Mapping[str, str], **uses: Any) -> Any:
    """Compiled function of `arguments` that makes a named tuple of an expression for each field.

    uses: compiled functions in the expressions. Kernels make no named tuples of sequences.
    """
    listed = ", ".join(f"{name}={entries[name]}" for name in kind._fields)
    scope: dict[str, Any] = {"kind": kind, "__name__": __name__, **uses}
    exec(f"def gather({arguments}):\n    return kind({listed})", scope)
    return template(scope["gather"])


# (table, i, first): those of row i of a table that holds them from column `first` on.
row_parameters = gathering(
    PlantParameters,
    "table, i, first",
    {name: f"table[i, first + {row}]" for name, row in PARAMETER_INDEX.items()},
)


VEHICLES: dict[str, PlantParameters] = {  # a vehicle on the soil that its controllers expect
    "strawa": STRAWA_VEHICLE,
    "focchi": plant_parameters(FOCCHI_VEHICLE, FIRM_FLOOR),
    # Table 2 says 0.7 m; with 0.5 m the unicycle controller of [2] 7.1 comes nearest to figure 13.
    "focchi-short": plant_parameters(FOCCHI_VEHICLE._replace(contact_length=0.5), FIRM_FLOOR),
}


def top_speed(p: PlantParameters) -> float:
    """v_top = r omega_max [m/s]: straight ahead, without slip, at the speed limit of both drives.

    A drive by speed runs at omega_max. One by torque gives no torque there, so that the vehicle
    stays below v_top by the slip that carries the motion resistance.
    """
    return p.sprocket_radius * p.sprocket_speed_limit
