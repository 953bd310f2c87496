"""What an agent sees: the layout of the observation, defined once, by name.

The observation is a float32 vector of dimensionless numbers: each quantity in SI units
divided by its scale (so that a network sees values of order one) and clipped to its bound.
`unpack` gives the SI quantities back by name. Only sensors and the reference enter it; no
true state, no true parameter. Left/right and signs follow NOTATION.md.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula

LOOK_AHEAD = (0.25, 0.5, 1.0, 2.0)  # [s] times at which the coming reference is shown
FEATURE_BOUND = 10.0  # [-] features that are appended are clipped to this; they are of order one


class Field(NamedTuple):
    """One entry of the observation."""

    name: str
    unit: str
    scale: float  # SI value that is shown as 1
    bound: float  # SI value at which it is clipped, both signs
    meaning: str
    mirrored: bool  # changes sign when left and right are exchanged; True also for L/R pairs


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


FIELDS: tuple[Field, ...] = (
    Field("position_error_x", "m", 1.0, 20.0, "reference ahead of the measured position", False),
    Field("position_error_y", "m", 1.0, 20.0, "reference to the left of it", True),
    Field("heading_error", "rad", 0.5, 4.0, "reference heading minus measured yaw", True),
    Field("v_x", "m/s", 2.0, 40.0, "measured forward velocity", False),
    Field("v_y", "m/s", 0.5, 40.0, "measured lateral velocity", True),
    Field("yaw_rate", "rad/s", 0.5, 20.0, "gyro", True),
    Field("acceleration_x", "m/s^2", 2.0, 200.0, "forward accelerometer", False),
    Field("acceleration_y", "m/s^2", 2.0, 200.0, "lateral accelerometer", True),
    Field("yaw_acceleration", "rad/s^2", 2.0, 400.0, "from two accelerometers", True),
    Field("sprocket_speed_left", "rad/s", 6.0, 200.0, "left sprocket encoder", True),
    Field("sprocket_speed_right", "rad/s", 6.0, 200.0, "right sprocket encoder", True),
    Field("torque_left", "N m", 4000.0, 40000.0, "torque transmitted at the left sprocket", True),
    Field("torque_right", "N m", 4000.0, 40000.0, "torque transmitted at the right sprocket", True),
    Field("reference_speed", "m/s", 2.0, 40.0, "reference speed v, signed", False),
    Field("reference_acceleration", "m/s^2", 2.0, 100.0, "dv/dt of the reference", False),
    Field("reference_jerk", "m/s^3", 4.0, 400.0, "d2v/dt2 of the reference", False),
    Field("reference_yaw_rate", "rad/s", 0.5, 20.0, "reference yaw rate w", True),
    Field("reference_yaw_acceleration", "rad/s^2", 1.0, 100.0, "dw/dt of the reference", True),
    *_ahead("speed", "m/s", 2.0, 40.0, False),
    *_ahead("yaw_rate", "rad/s", 0.5, 20.0, True),
    Field("previous_action_left", "-", 1.0, 1.0, "left action of the step before", True),
    Field("previous_action_right", "-", 1.0, 1.0, "right action of the step before", True),
    Field("pose_age", "s", 1.0, 60.0, "age of position, heading and velocity", False),
    Field(
        "inertial_age", "s", 1.0, 60.0, "age of accelerations, yaw rate, yaw acceleration", False
    ),
    Field("drive_age", "s", 1.0, 60.0, "age of sprocket speeds and torques", False),
)
NAMES = tuple(field.name for field in FIELDS)
SIZE = len(FIELDS)
INDEX = {name: index for index, name in enumerate(NAMES)}
SCALE: NDArray[np.float64] = np.array([field.scale for field in FIELDS])
BOUND: NDArray[np.float32] = np.array([f.bound / f.scale for f in FIELDS], dtype=np.float32)
LOW: NDArray[np.float32] = np.where([f.endswith("_age") for f in NAMES], 0.0, -BOUND).astype(
    np.float32
)
HIGH = BOUND
INVERSE_SCALE: NDArray[np.float64] = 1.0 / SCALE
_BOUND64: NDArray[np.float64] = BOUND.astype(np.float64)

_LEFT_RIGHT = [
    (INDEX[name], INDEX[name.replace("_left", "_right")]) for name in NAMES if "_left" in name
]


@formula
def store(out, row, column, value):
    """Write an SI value into out[row, column] of a float32 observation: scale and clip."""
    scaled = value * INVERSE_SCALE[column]
    bound = _BOUND64[column]
    out[row, column] = min(max(scaled, -bound), bound)


def pack(values: dict[str, NDArray[np.float64] | float]) -> NDArray[np.float32]:
    """Build an observation from SI values by name; shape (SIZE,) or (N, SIZE).

    Raises ValueError when a name is missing or unknown.
    """
    wrong = set(values) ^ set(NAMES)
    if wrong:
        raise ValueError(
            f"observation fields missing or unknown: {sorted(wrong)}; needed are {NAMES}"
        )
    stacked = np.stack([np.asarray(values[name], dtype=float) for name in NAMES], axis=-1)
    scaled = np.clip(stacked * INVERSE_SCALE, -_BOUND64, _BOUND64)
    return scaled.astype(np.float32)


def joined(observation: NDArray[np.float32], features: NDArray[np.float32]) -> NDArray[np.float32]:
    """Observation (..., D) and features (..., F), those finite and clipped, as one."""
    bounded = np.clip(np.nan_to_num(features), -FEATURE_BOUND, FEATURE_BOUND)
    return np.concatenate([observation, bounded], axis=-1, dtype=np.float32)


def unpack(observation: NDArray[np.floating]) -> dict[str, NDArray[np.float64]]:
    """SI values by name from observations of shape (..., SIZE); each value has shape (...).

    Raises ValueError when the last axis is not SIZE long.
    """
    observation = np.asarray(observation, dtype=np.float64)
    if observation.shape[-1:] != (SIZE,):
        raise ValueError(
            f"observation has shape {observation.shape}; its last axis must be {SIZE} long. "
            "Did a wrapper stack or append to it?"
        )
    values = np.moveaxis(observation * SCALE, -1, 0)
    return dict(zip(NAMES, values, strict=True))


def mirror(observation: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same situation with left and right exchanged; shape (..., SIZE)."""
    mirrored = np.array(observation, copy=True)
    for index, field in enumerate(FIELDS):
        if field.mirrored and "_left" not in field.name and "_right" not in field.name:
            mirrored[..., index] *= -1.0
    for left, right in _LEFT_RIGHT:
        mirrored[..., left], mirrored[..., right] = (
            observation[..., right].copy(),
            observation[..., left].copy(),
        )
    return mirrored


def markdown_table() -> str:
    """The layout as a Markdown table, for the documentation."""
    lines = ["| index | name | unit | shown as 1 | clipped at | meaning |", "|--|--|--|--|--|--|"]
    for index, f in enumerate(FIELDS):
        lines.append(
            f"| {index} | `{f.name}` | {f.unit} | {f.scale:g} | {f.bound:g} | {f.meaning} |"
        )
    return "\n".join(lines)
