"""Sensors of the vehicle: what they measure and how they err.

Channels, in the order of `CHANNELS`, in three groups that share a sampling clock:
    pose      INS/GNSS: position (world), yaw, body velocity          white noise
    inertial  IMU: accelerations, yaw rate, yaw acceleration          bias, noise, cross-coupling
    drive     sprocket speeds and transmitted torques                 additive noise
The yaw acceleration is the difference of two lateral accelerometers a distance D apart:
    dw/dt = (a_1 - a_2) / D, so its noise is sqrt(2) sigma_a / D      S section 5.2.1
Accelerometers feel the specific force, f = a - g_vec in body axes: on a slope a part of gravity,
and two lateral ones a distance apart also W_x W_y; on level ground f_x, f_y are the accelerations.
Model of one channel: measured = true + coupling (other axis) + bias + sigma n, n ~ N(0, 1).
`TABLE` and `ATTITUDE` say all of a channel but its true value, which `signals` and
`attitude_signals` compute. Channels that are registered (`tracked_env.sensors.register`) carry
their true value as a function.

References: [1] Strawa et al., Electronics 10 (2021) 187, section 5.2.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from tracked_env.physics import state as rows
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.terramechanics import GRAVITY


class Channel(NamedTuple):
    """One sensor channel: what it measures, when, and how it errs."""

    name: str
    group: str  # one of GROUPS: sampling clock, delay and dropouts
    unit: str
    noise: str = ""  # field of the sensor presets: sigma [unit] of its white noise; "" = none
    bias: str = ""  # likewise, the magnitude [unit] of its bias
    differential: bool = False  # the difference of two sensors over their distance
    switch: str = ""  # field of the presets that is 0 where the channel is not measured
    # Of a registered channel: true value [unit], (N,), from true state and parameters by name,
    # and {preset: {field: value}}; what a preset does not name is 0.
    truth: Callable[[Mapping[str, Any]], Any] | None = None
    presets: Mapping[str, Mapping[str, float]] = MappingProxyType({})


GROUPS = ("pose", "inertial", "drive")
TABLE = (
    Channel("x", "pose", "m", "position_noise"),
    Channel("y", "pose", "m", "position_noise"),
    Channel("yaw", "pose", "rad", "yaw_noise"),
    Channel("v_x", "pose", "m/s", "velocity_noise", switch="velocity_measured"),
    Channel("v_y", "pose", "m/s", "velocity_noise", switch="velocity_measured"),
    Channel("acceleration_x", "inertial", "m/s^2", "acceleration_noise", "acceleration_bias"),
    Channel("acceleration_y", "inertial", "m/s^2", "acceleration_noise", "acceleration_bias"),
    Channel("yaw_rate", "inertial", "rad/s", "gyro_noise", "gyro_bias"),
    Channel(
        "yaw_acceleration",
        "inertial",
        "rad/s^2",
        "acceleration_noise",
        "acceleration_bias",
        differential=True,
    ),
    Channel("sprocket_speed_left", "drive", "rad/s", "sprocket_speed_noise"),
    Channel("sprocket_speed_right", "drive", "rad/s", "sprocket_speed_noise"),
    Channel("torque_left", "drive", "N m", "torque_noise"),
    Channel("torque_right", "drive", "N m", "torque_noise"),
)
# Of the attitude, sampled where an observation shows them: roll and pitch err as the yaw of the
# same INS does, the gyros and accelerometers as those of TABLE.
ATTITUDE = (
    Channel("roll", "inertial", "rad", "yaw_noise"),
    Channel("pitch", "inertial", "rad", "yaw_noise"),
    Channel("roll_rate", "inertial", "rad/s", "gyro_noise", "gyro_bias"),
    Channel("pitch_rate", "inertial", "rad/s", "gyro_noise", "gyro_bias"),
    Channel("specific_force_z", "inertial", "m/s^2", "acceleration_noise", "acceleration_bias"),
)
CHANNELS = tuple(channel.name for channel in TABLE)
CHANNEL_COUNT = len(CHANNELS)
# Channels of group g: GROUP_START[g] .. GROUP_START[g + 1]; the table is sorted by group.
GROUP_START = (
    *([channel.group for channel in TABLE].index(group) for group in GROUPS),
    CHANNEL_COUNT,
)
NOISE_COUNT = CHANNEL_COUNT + len(GROUPS)  # normal numbers per step: channels, then dropouts


@formula
def signals(state, i, sprocket_radius, cross_coupling, velocity):
    """Noise-free value of every channel of vehicle i, in the order of CHANNELS.

    state: (N, >= STATE_ROWS), its first columns the state; sprocket_radius r [m];
    cross_coupling [-] between the two accelerometer axes; velocity [-] 1, or 0 where the body
    velocity is not measured and reads 0.
    The torque that is measured is the one that reaches the soil, F r. In the lumped plant sprocket
    and track have no inertia, and it is all that the drive can give. In the distributed plant
    driven by torque they have `sprocket_inertia`: what speeds them up is not in the reading.
    """
    forward, lateral = state[i, rows.ACCELERATION_X], state[i, rows.ACCELERATION_Y]
    turning = state[i, rows.YAW_ACCELERATION]
    pitch, roll = state[i, rows.PITCH], state[i, rows.ROLL]
    if pitch != 0.0 or roll != 0.0:
        c_pitch, s_pitch = rotation(pitch)
        forward -= GRAVITY * s_pitch
        lateral += GRAVITY * c_pitch * rotation(roll)[1]
        turning += state[i, rows.ROLL_RATE] * state[i, rows.PITCH_RATE]
    return (
        state[i, rows.X],
        state[i, rows.Y],
        state[i, rows.YAW],
        velocity * state[i, rows.V_X],
        velocity * state[i, rows.V_Y],
        forward + cross_coupling * lateral,
        lateral + cross_coupling * forward,
        state[i, rows.YAW_RATE],
        turning,
        state[i, rows.SPROCKET_SPEED_LEFT],
        state[i, rows.SPROCKET_SPEED_RIGHT],
        state[i, rows.EFFORT_LEFT] * sprocket_radius,
        state[i, rows.EFFORT_RIGHT] * sprocket_radius,
    )


@formula
def attitude_signals(state, i):
    """Noise-free value of every channel of ATTITUDE of vehicle i, in its order.

    state: as of `signals`. The vertical accelerometer feels f_z = a_z + g cos(pitch) cos(roll).
    """
    pitch, roll = state[i, rows.PITCH], state[i, rows.ROLL]
    upright = rotation(pitch)[0] * rotation(roll)[0]
    return (
        roll,
        pitch,
        state[i, rows.ROLL_RATE],
        state[i, rows.PITCH_RATE],
        state[i, rows.ACCELERATION_Z] + GRAVITY * upright,
    )
