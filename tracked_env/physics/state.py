"""The state of a tracked vehicle: names and order of its entries.

A batch of N vehicles keeps one vehicle per row and one entry of the state per column, shape
(N, STATE_ROWS). In the scratch block of the lumped plant it is the other way round, one entry per
row and one vehicle per column, so that its loops run over vehicles with unit stride. A plant
integrates the entries that are its own; the others follow from them algebraically and are refreshed
after every control step.
World frame x, y, z up; body frame ISO 8855 (x forward, y left); yaw positive to the left. The
attitude is yaw, then pitch, then roll (z-y'-x''). Planar plants leave the last seven
entries at zero.
"""

from typing import NamedTuple


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


STATE_NAMES = VehicleState._fields
STATE_ROWS = len(STATE_NAMES)
(
    X, Y, YAW, V_X, V_Y, YAW_RATE, TORQUE_LEFT, TORQUE_RIGHT,
    SLIP_LEFT, SLIP_RIGHT, SPROCKET_SPEED_LEFT, SPROCKET_SPEED_RIGHT,
    EFFORT_LEFT, EFFORT_RIGHT, ACCELERATION_X, ACCELERATION_Y, YAW_ACCELERATION,
    Z, ROLL, PITCH, V_Z, ROLL_RATE, PITCH_RATE, ACCELERATION_Z,
) = range(STATE_ROWS)  # fmt: skip
