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
    return (
        state[i, rows.X],
        state[i, rows.Y],
        state[i, rows.YAW],
        velocity * state[i, rows.V_X],
        velocity * state[i, rows.V_Y],
        forward + cross_coupling * lateral,
        lateral + cross_coupling * forward,
        state[i, rows.YAW_RATE],
        state[i, rows.YAW_ACCELERATION],
        state[i, rows.SPROCKET_SPEED_LEFT],
        state[i, rows.SPROCKET_SPEED_RIGHT],
        state[i, rows.EFFORT_LEFT] * sprocket_radius,
        state[i, rows.EFFORT_RIGHT] * sprocket_radius,
    )
