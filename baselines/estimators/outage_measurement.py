"""What is measured without a pose: speed by the effort, side slip by the friction, the gyro.

    effort    v by S (7) inverted: i = slip_from_effort(F; F_max, K), with the variance
              of the identified [ln F_max, ln K]; that error lasts, so that all samples of
              OUTAGE_TIME together count as one. It grows, as the soil may change; where the
              two contradict each other, it is another one: the squared difference adds to it
    friction  v_y from F_y(v_y, w) = m f_y with the identified mu_t, f_y the lateral
              accelerometer; -d w with the constrained lateral model
    turn      the gyro, less its bias
The ground and the biases stand in the columns of slip_outage, from `at` on.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 2 and 7.2.
"""

import math

from baselines.estimators.sensor_samples import COLUMN, INERTIAL
from baselines.estimators.slip_kinematics import (
    SLIP_LIMIT,
    STANDING_VEHICLE,
)
from baselines.estimators.slip_outage import (
    EFFORT_MAXIMUM,
    FRICTION,
    LARGEST_ACCELERATION,
    LARGEST_SPEED,
    P_FF,
    P_FK,
    P_KK,
    SHEAR_LENGTH,
    SILENT,
    TURN_BIAS,
    WILD_TURN,
    speed_variance,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula

OUTAGE_TIME = 10.0  # [s] over which the error of the soil is one and the same
UNSEEN = 1e9  # [SI] variance of a row of z that says nothing, through a long outage
LARGEST_BRAKING = 0.5  # [-] slip by the effort beyond which a braked belt does not tell the speed
SPEED_FLOOR = 0.01  # [m/s] sigma of the speed by the effort, beside that of the soil
LASTING = 0.0045  # [m/s] sigma of what lasts of that error, on a soil that is not certain
SIDE_FLOOR = 0.01  # [m/s] sigma of v_y by the friction
SOIL_DRIFT = 0.1  # [1/sqrt(s)] of ln F_max and ln K, since the last pose
DISAGREEMENT = 4.0  # [-] squared innovation, in its variance, from which the soil is another one
PROBE_SPEED = 1e-3  # [m/s] at which the slope of the lateral friction is taken
LARGEST_SIDE = 0.5  # [-] |v_y| over the speed, as the controller bounds it

_A_Y, _YAW_RATE = COLUMN["acceleration_y"], COLUMN["yaw_rate"]
_SPROCKET, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]


@formula
def _of_effort(memory, i, at, values, side, k):
    """(speed [m/s] of a track by belt and torque, its change [m/s] per ln F_max, per ln K).

    NaN where a braked belt does not tell it.
    """
    belt = k.radius * values[i, _SPROCKET + side]
    effort, maximum = values[i, _TORQUE + side] / k.radius, memory[i, at + EFFORT_MAXIMUM]
    length = memory[i, at + SHEAR_LENGTH]
    slip = soil.slip_from_effort(effort, maximum, length)
    u = abs(slip) * length
    share, rise = soil.mobilised_shear(u), soil.mobilised_shear_slope(u)
    bend = -share / (max(rise, 1e-9) * length)
    bend = bend if effort >= 0.0 else -bend
    if slip * belt < -LARGEST_BRAKING * abs(belt) or abs(belt) < k.standing_belt:
        return math.nan, 0.0, 0.0
    slip = min(max(slip, -SLIP_LIMIT), SLIP_LIMIT)
    return soil.track_speed_from_belt(belt, slip), -belt * bend, -belt * slip


@formula
def _speed_row(memory, i, at, values, v, x, p, left, right, k):
    """(v [m/s] by the effort of both tracks, its variance for one sample)."""
    if memory[i, at + EFFORT_MAXIMUM] <= 0.0:
        return v, UNSEEN
    one, f_left, k_left = _of_effort(memory, i, at, values, 0, k)
    two, f_right, k_right = _of_effort(memory, i, at, values, 1, k)
    by_effort, f, twist = 0.5 * (one + two), 0.5 * (f_left + f_right), 0.5 * (k_left + k_right)
    changed = SOIL_DRIFT * SOIL_DRIFT * memory[i, at + SILENT] * k.period
    changed = changed if memory[i, at + P_FF] > 0.0 else 0.0  # a soil that is certain
    spread = f * f * (memory[i, at + P_FF] + changed)
    spread += twist * twist * (memory[i, at + P_KK] + changed)
    spread = max(spread + 2.0 * f * twist * memory[i, at + P_FK], 0.0)
    known = speed_variance(x, p, left, right, k)
    floor = SPEED_FLOOR * SPEED_FLOOR
    error = by_effort - v
    certain = memory[i, at + P_FF] == 0.0
    spread += 0.0 if certain else LASTING * LASTING
    if not certain and error * error > DISAGREEMENT * (known + spread + floor):
        spread += error * error
    variance = floor + spread * OUTAGE_TIME / k.period
    usable = abs(by_effort) < LARGEST_SPEED and variance < math.inf
    return (by_effort, variance) if usable else (v, UNSEEN)


@formula
def _side_row(memory, i, at, values, v, w, press, k):
    """(v_y [m/s] by the lateral friction, its variance)."""
    bound = LARGEST_SIDE * abs(v)
    if k.constrained > 0.0:
        return min(max(-k.icr_forward * w, -bound), bound), SIDE_FLOOR * SIDE_FLOOR
    felt, friction = values[i, _A_Y], memory[i, at + FRICTION]
    if not (friction > 0.0 and abs(felt) < LARGEST_ACCELERATION):
        return 0.0, UNSEEN
    intensity = friction * soil.GRAVITY * press / k.contact_length
    force, _moment = soil.lateral_friction(PROBE_SPEED, w, intensity, k.contact_length)
    v_y = felt * PROBE_SPEED / min(force, -1e-9)
    return min(max(v_y, -bound), bound), SIDE_FLOOR * SIDE_FLOOR


@formula
def measure(memory, i, at, values, fresh, expected, x, p, left, right, press, k, z, noise):
    """z (ROWS,) and its R (ROWS, ROWS) of a step without a pose; expected: z by the model."""
    noise[:, :] = 0.0
    for row in range(6):
        z[row] = expected[row]
        noise[row, row] = UNSEEN
    gyro = values[i, _YAW_RATE]
    if fresh[i, INERTIAL] and abs(gyro - expected[5]) < WILD_TURN:
        z[5], noise[5, 5] = gyro - memory[i, at + TURN_BIAS], k.gyro_variance
    z[3], noise[3, 3] = _speed_row(memory, i, at, values, expected[3], x, p, left, right, k)
    side, variance = _side_row(memory, i, at, values, expected[3], z[5], press, k)
    if variance < UNSEEN and abs(expected[3]) > STANDING_VEHICLE:
        z[4], noise[4, 4] = side, variance
