"""What passes between the estimators of the stack, as kernels: times and bad input.

The time of the slip filter is that of the drive samples, which move it. Where the pose is late
too, what it knows is that old, and `advance` brings it to the present; where the pose is newer
than the drive, the filter has already been pulled there.
"""

import math

from baselines.estimators.sensor_samples import COLUMN, POSE
from tracked_env.observation import INDEX
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop

_AFTER_SENSORS = INDEX["reference_speed"]  # from here on: reference, action, ages
_A_X, _BEND = COLUMN["acceleration_x"], COLUMN["yaw_acceleration"]


@loop
def first_bad(observation):
    """(row, column) of the first reference, action or age of observation (N, SIZE) that is not
    finite, or (-1, -1). Sensors may be NaN: those samples are skipped."""
    for i in range(observation.shape[0]):
        for column in range(_AFTER_SENSORS, observation.shape[1]):
            if not math.isfinite(observation[i, column]):
                return i, column
    return -1, -1


@loop
def date(age, delay, behind):
    """Ages (N, 3) [s] of the pose become those at the time of the filter.

    delay (N,) [s] of the drive. behind (N,) [s] out: how old what the filter knows is.
    """
    for i in range(age.shape[0]):
        behind[i] = min(age[i, POSE], delay[i])
        age[i, POSE] -= behind[i]


@loop
def advance(x, y, yaw, v_x, v_y, yaw_rate, behind, felt):
    """Move a motion, (N,) arrays that are `behind` (N,) [s], to the present, in place.

    Acceleration and yaw acceleration, felt (N, CHANNELS) at that time, stay what they are.
    """
    for i in range(x.shape[0]):
        time = behind[i]
        if time > 0.0:
            forward, bend = felt[i, _A_X] + yaw_rate[i] * v_y[i], felt[i, _BEND]
            gain_x = forward * time if math.isfinite(forward) else 0.0
            gain_w = bend * time if math.isfinite(bend) else 0.0
            along, across = time * (v_x[i] + 0.5 * gain_x), time * v_y[i]
            c, s = rotation(yaw[i] + 0.5 * time * (yaw_rate[i] + 0.25 * gain_w))
            x[i] += c * along - s * across
            y[i] += s * along + c * across
            yaw[i] += time * (yaw_rate[i] + 0.5 * gain_w)
            v_x[i] += gain_x
            yaw_rate[i] += gain_w
