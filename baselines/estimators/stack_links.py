"""What passes between the estimators of the stack, as kernels: times and bad input.

The time of the slip filter is that of the drive samples, which move it. Where the pose is late
too, what it knows is that old, and `advance` brings it to the present; where the pose is newer
than the drive, the filter has already been pulled there.
"""

import math

from baselines.estimators.sensor_samples import COLUMN, POSE
from tracked_env.observation import INDEX, SIZE
from tracked_env.physics.attitude import heading_rate, incline_of, on_map
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.terramechanics import GRAVITY

_AFTER_SENSORS = INDEX["reference_speed"]  # from here on: reference, action, ages
_V_X, _A_X, _BEND = COLUMN["v_x"], COLUMN["acceleration_x"], COLUMN["yaw_acceleration"]


@loop
def inspect(observation, start):
    """(row, column, starts): the first reference, action or age of observation (N, >= SIZE) that
    is not finite, or (-1, -1), and whether any row of start (N,) is marked. Sensors may be NaN:
    those samples are skipped."""
    starts = False
    for i in range(observation.shape[0]):
        starts = starts or start[i]
        for column in range(_AFTER_SENSORS, SIZE):
            if not math.isfinite(observation[i, column]):
                return i, column, starts
    return -1, -1, starts


@loop
def date(age, delay, behind):
    """Ages (N, 3) [s] of the pose become those at the time of the filter.

    delay (N,) [s] of the drive. behind (N,) [s] out: how old what the filter knows is.
    """
    for i in range(age.shape[0]):
        behind[i] = min(age[i, POSE], delay[i])
        age[i, POSE] -= behind[i]


@loop
def put_velocity(motion, values):
    """The filtered v_x and v_y of motion (N, 6) in place of those of values (N, CHANNELS)."""
    for i in range(motion.shape[0]):
        values[i, _V_X], values[i, _V_X + 1] = motion[i, 3], motion[i, 4]


@loop
def advance(motion, behind, felt, attitude):
    """Move a motion, (N, 6), that is `behind` (N,) [s], to the present, in place.

    Acceleration and yaw acceleration, felt (N, CHANNELS) at that time, stay what they are; what the
    accelerometer feels of gravity, by the attitude (N, 3), moves nothing.
    """
    for i in range(motion.shape[0]):
        time = behind[i]
        if time > 0.0:
            yaw, v_x, v_y, yaw_rate = motion[i, 2], motion[i, 3], motion[i, 4], motion[i, 5]
            incline = incline_of(attitude[i, 1], attitude[i, 0])
            turn, carried = heading_rate(incline, attitude[i, 2])
            forward = felt[i, _A_X] + GRAVITY * incline.down_x + yaw_rate * v_y
            bend = felt[i, _BEND]
            gain_x = forward * time if math.isfinite(forward) else 0.0
            gain_w = bend * time if math.isfinite(bend) else 0.0
            along, across = on_map(time * (v_x + 0.5 * gain_x), time * v_y, incline)
            c, s = rotation(yaw + 0.5 * time * (turn * (yaw_rate + 0.25 * gain_w) + carried))
            motion[i, 0] += c * along - s * across
            motion[i, 1] += s * along + c * across
            motion[i, 2] += time * (turn * (yaw_rate + 0.5 * gain_w) + carried)
            motion[i, 3] += gain_x
            motion[i, 5] += gain_w
