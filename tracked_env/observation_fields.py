"""The fields that an observation can be made of, in named groups: names, units, scales and bounds.

The groups of `VERSIONS` are written by the compiled loops; `tracked_env.observation.register` adds
one. Left/right and signs follow NOTATION.md.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.attitude import in_body_plane
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop

LOOK_AHEAD = (0.25, 0.5, 1.0, 2.0)  # [s] times at which the coming reference is shown

Known = Mapping[str, NDArray[np.float64]]


class Field(NamedTuple):
    """One entry of the observation."""

    name: str
    unit: str
    scale: float  # SI value that is shown as 1
    bound: float  # SI value at which it is clipped, both signs
    meaning: str
    mirrored: bool = False  # changes sign when left and right are exchanged; True for L/R pairs
    signed: bool = True  # False: it is never negative


class Group(NamedTuple):
    """Fields that are shown together.

    What its fields are is computed from what an agent may know, the fields of `V0` and the samples
    of `channels` in SI units, in one of two forms:
        values     by name, {field: (n,)} from {name: (n,)}, in Python
        compiled   a function of numba (known (n, K), shown (n, F)) that writes the fields from
                   those named in `reads`; a tenth of the time. It has to be compiled with `nogil`,
                   as by `physics.jit.loop`, for threads to run side by side
    With neither, each field is the channel of its name. A group with `scan` shows heights of the
    ground there, one with `goal` that of the reference, which has to be planned.
    """

    name: str
    fields: tuple[Field, ...]
    channels: tuple[str, ...] = ()  # registered sensor channels that it reads
    values: Callable[[Known], Known] | None = None
    scan: tuple[tuple[float, float], ...] = ()  # [contact lengths] (ahead, left) of each field
    compiled: Callable[[NDArray[np.float64], NDArray[np.float64]], None] | None = None
    reads: tuple[str, ...] = ()  # by `compiled`, in the order of the columns of `known`
    goal: bool = False  # its fields are those of `engine.goal_reading`


def _ahead(kind: str, unit: str, scale: float, bound: float, mirrored: bool) -> tuple[Field, ...]:
    return tuple(
        Field(
            f"reference_{kind}_ahead_{time:g}",
            unit,
            scale,
            bound,
            f"reference {kind.replace('_', ' ')} {time:g} s ahead",
            mirrored,
        )
        for time in LOOK_AHEAD
    )


_POSE_ERROR = (
    Field("position_error_x", "m", 1.0, 20.0, "reference ahead of the measured position", False),
    Field("position_error_y", "m", 1.0, 20.0, "reference to the left of it", True),
    Field("heading_error", "rad", 0.5, 4.0, "reference heading minus measured yaw", True),
)
_MOTION = (
    Field("v_x", "m/s", 2.0, 40.0, "measured forward velocity", False),
    Field("v_y", "m/s", 0.5, 40.0, "measured lateral velocity", True),
    Field("yaw_rate", "rad/s", 0.5, 20.0, "gyro", True),
    Field("acceleration_x", "m/s^2", 2.0, 200.0, "forward accelerometer", False),
    Field("acceleration_y", "m/s^2", 2.0, 200.0, "lateral accelerometer", True),
    Field("yaw_acceleration", "rad/s^2", 2.0, 400.0, "from two accelerometers", True),
)
_DRIVE = (
    Field("sprocket_speed_left", "rad/s", 6.0, 200.0, "left sprocket encoder", True),
    Field("sprocket_speed_right", "rad/s", 6.0, 200.0, "right sprocket encoder", True),
    Field("torque_left", "N m", 4000.0, 40000.0, "torque transmitted at the left sprocket", True),
    Field("torque_right", "N m", 4000.0, 40000.0, "torque transmitted at the right sprocket", True),
)
_REFERENCE = (
    Field("reference_speed", "m/s", 2.0, 40.0, "reference speed v, signed", False),
    Field("reference_acceleration", "m/s^2", 2.0, 100.0, "dv/dt of the reference", False),
    Field("reference_jerk", "m/s^3", 4.0, 400.0, "d2v/dt2 of the reference", False),
    Field("reference_yaw_rate", "rad/s", 0.5, 20.0, "reference yaw rate w", True),
    Field("reference_yaw_acceleration", "rad/s^2", 1.0, 100.0, "dw/dt of the reference", True),
)
_LOOK_AHEAD = (
    *_ahead("speed", "m/s", 2.0, 40.0, False),
    *_ahead("yaw_rate", "rad/s", 0.5, 20.0, True),
)
_ACTION = (
    Field("previous_action_left", "-", 1.0, 1.0, "left action of the step before", True),
    Field("previous_action_right", "-", 1.0, 1.0, "right action of the step before", True),
)
_AGES = {
    "pose_age": "age of position, heading and velocity",
    "inertial_age": "age of accelerations, yaw rate, yaw acceleration",
    "drive_age": "age of sprocket speeds and torques",
}
_AGE = tuple(Field(name, "s", 1.0, 60.0, of, signed=False) for name, of in _AGES.items())

# On slopes; the third gyro and two axes of the specific force are in the group `motion`.
_ATTITUDE = (
    Field("roll", "rad", 0.5, 4.0, "roll of the IMU, left side up", True),
    Field("pitch", "rad", 0.5, 4.0, "pitch of the IMU, nose down", False),
    Field("roll_rate", "rad/s", 0.5, 20.0, "gyro about the body's x axis", True),
    Field("pitch_rate", "rad/s", 0.5, 20.0, "gyro about the body's y axis", False),
    Field("specific_force_z", "m/s^2", 10.0, 200.0, "vertical accelerometer, g at rest", False),
)
_TANGENT_ERROR = (
    Field("tangent_error_x", "m", 1.0, 20.0, "reference ahead, in the vehicle's plane", False),
    Field("tangent_error_y", "m", 1.0, 20.0, "reference to the left, in that plane", True),
    Field("tangent_heading_error", "rad", 0.5, 4.0, "heading error about its normal", True),
)


# Of references of the kind "plan"; see `engine.goal_reading`.
_GOAL = (
    Field("goal_x", "m", 2.0, 200.0, "goal ahead of the measured position", False),
    Field("goal_y", "m", 2.0, 200.0, "goal to the left of it", True),
    Field("goal_cosine", "-", 1.0, 1.0, "cosine of the goal's heading less the yaw", False),
    Field("goal_sine", "-", 1.0, 1.0, "sine of the same", True),
    Field("goal_time", "s", 10.0, 3600.0, "until the plan arrives", signed=False),
)


def _scanned(ahead: float, left: float) -> str:
    """Name of the field of a point of the scan."""
    name = f"height_{'behind' if ahead < 0.0 else 'ahead'}_{abs(ahead):g}"
    return name + (f"_{'left' if left > 0.0 else 'right'}_{abs(left):g}" if left else "")


_SCAN = tuple(
    (ahead, left)
    for ahead in (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0)
    for left in (-1.0, -0.5, 0.0, 0.5, 1.0)
)
_HEIGHTS = tuple(
    Field(
        _scanned(*point), "m", 0.25, 5.0,
        f"ground {point[0]:g} l ahead, {point[1]:g} l to the left, less the vehicle's height",
        bool(point[1]),
    )
    for point in _SCAN
)  # fmt: skip


@loop
def _in_plane(known, shown):
    """The measured pose error in the plane of the vehicle, by the measured roll and pitch."""
    for k in range(known.shape[0]):
        ahead, left, turn = known[k, 0], known[k, 1], known[k, 2]
        roll, pitch = rotation(known[k, 3]), rotation(known[k, 4])
        shown[k, 0], shown[k, 1], shown[k, 2] = in_body_plane(ahead, left, turn, pitch, roll)


_COMPILED: dict[str, Group] = {
    name: Group(name, fields)
    for name, fields in {
        "pose_error": _POSE_ERROR, "motion": _MOTION, "drive": _DRIVE, "reference": _REFERENCE,
        "look_ahead": _LOOK_AHEAD, "action": _ACTION, "age": _AGE,
    }.items()
}  # fmt: skip
GROUPS: dict[str, Group] = {
    **_COMPILED,
    "attitude": Group("attitude", _ATTITUDE, tuple(field.name for field in _ATTITUDE)),
    "tangent_error": Group(
        "tangent_error", _TANGENT_ERROR, ("roll", "pitch"), compiled=_in_plane,
        reads=(*(field.name for field in _POSE_ERROR), "roll", "pitch"),
    ),
    "height_scan": Group("height_scan", _HEIGHTS, scan=_SCAN),
    "goal": Group("goal", _GOAL, goal=True),
}  # fmt: skip
VERSIONS = {"v0": tuple(_COMPILED)}  # layouts by name; what a name stands for never changes
