"""Sensors of the vehicle: what they measure and how they err.

Channels, in the order of `CHANNELS`, in three groups that share a sampling clock:
    pose      INS/GNSS: position (world), yaw, body velocity          white noise
    inertial  IMU: accelerations, yaw rate, yaw acceleration          bias, noise, cross-coupling
    drive     sprocket speeds and transmitted torques                 additive noise
The yaw acceleration is the difference of two lateral accelerometers a distance D apart:
    dw/dt = (a_1 - a_2) / D, so its noise is sqrt(2) sigma_a / D      S section 5.2.1
Model of one channel: measured = true + coupling (other axis) + bias + sigma n, n ~ N(0, 1).

References: [1] Strawa et al., Electronics 10 (2021) 187, section 5.2.
"""

from tracked_env.physics import state as rows
from tracked_env.physics.jit import formula

CHANNELS = (
    "x", "y", "yaw", "v_x", "v_y",
    "acceleration_x", "acceleration_y", "yaw_rate", "yaw_acceleration",
    "sprocket_speed_left", "sprocket_speed_right", "torque_left", "torque_right",
)  # fmt: skip
CHANNEL_COUNT = len(CHANNELS)
GROUPS = ("pose", "inertial", "drive")
GROUP_START = (0, 5, 9, CHANNEL_COUNT)  # channels of group g: GROUP_START[g] .. GROUP_START[g+1]
NOISE_COUNT = CHANNEL_COUNT + len(GROUPS)  # normal numbers per step: channels, then dropouts


@formula
def true_signal(state, sprocket_radius, i, channel):
    """Noise-free value of a channel for vehicle i; state of shape (N, >= STATE_ROWS).

    The torque that a shaft sensor sees is the transmitted one, F r: sprocket and track have
    no inertia in this model, so what the soil does not take the drive cannot give.
    """
    if channel == 0:
        return state[i, rows.X]
    if channel == 1:
        return state[i, rows.Y]
    if channel == 2:
        return state[i, rows.YAW]
    if channel == 3:
        return state[i, rows.V_X]
    if channel == 4:
        return state[i, rows.V_Y]
    if channel == 5:
        return state[i, rows.ACCELERATION_X]
    if channel == 6:
        return state[i, rows.ACCELERATION_Y]
    if channel == 7:
        return state[i, rows.YAW_RATE]
    if channel == 8:
        return state[i, rows.YAW_ACCELERATION]
    if channel == 9:
        return state[i, rows.SPROCKET_SPEED_LEFT]
    if channel == 10:
        return state[i, rows.SPROCKET_SPEED_RIGHT]
    if channel == 11:
        return state[i, rows.EFFORT_LEFT] * sprocket_radius
    return state[i, rows.EFFORT_RIGHT] * sprocket_radius


@formula
def coupled_signal(state, sprocket_radius, cross_coupling, i, channel):
    """Signal with the axis cross-coupling [-] of the two accelerometer axes."""
    value = true_signal(state, sprocket_radius, i, channel)
    if channel == 5:
        value += cross_coupling * state[i, rows.ACCELERATION_Y]
    elif channel == 6:
        value += cross_coupling * state[i, rows.ACCELERATION_X]
    return value
