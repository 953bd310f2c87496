"""The filtered motion in an observation, in place of what the sensors measured.

A controller reads the observation as it would read the sensors. Pose errors are those of the
filtered pose to the same reference; the yaw rate is the gyro while its sample is new and the filter
has not refused it. What the controller does not use is 0 where it is missing.
"""

import numpy as np

from baselines.estimators.estimate import Status
from baselines.estimators.sensor_samples import COLUMN, INERTIAL
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, loop

_I, _SIZE = layout.INDEX, layout.SIZE
_X, _Y, _YAW = _I["position_error_x"], _I["position_error_y"], _I["heading_error"]
_V_X, _V_Y, _W = _I["v_x"], _I["v_y"], _I["yaw_rate"]
_GYRO, _REJECTED = COLUMN["yaw_rate"], int(Status.REJECTED)
WILD_GYRO = 1.0  # [rad/s] from the yaw rate of the belts: a refused gyro beyond that is not used
# Sensor fields that the controller does not use, but whose NaN would stop it.
_UNUSED = np.array(
    [_I[name] for name in layout.NAMES if name.startswith(("acc", "yaw_acc", "sprocket", "torque"))]
)


@formula
def _show(observation, i, column, value, always):
    """Write an SI value in place of what was measured: always, or where that is missing."""
    if always or not np.isfinite(observation[i, column]):
        layout.store(observation, i, column, value)


@formula
def _yaw_rate(i, yaw_rate, values, age, summary, status, stale):
    """The gyro [rad/s] where its sample is new and the filter has not refused it, else yaw_rate."""
    gyro = values[i, _GYRO]
    wild = abs(gyro - yaw_rate) > WILD_GYRO
    outlier = status[i] == _REJECTED and np.isfinite(summary[i, 2]) and wild
    usable = np.isfinite(gyro) and not (age[i, INERTIAL] > stale or outlier)
    return gyro if usable else yaw_rate


@loop
def show(observation, reference, motion, values, age, summary, status, stale, filtered):
    """Put the filtered motion (N, 6) into observation (N, >= SIZE), in one frame with reference
    (N, 3); not filtered: only where NaN. A missing attitude counts as level.

    values, age: of the latest samples; stale [s]: an older gyro is not used. summary, status: of
    the slip observer's answer.
    """
    for i in range(observation.shape[0]):
        c, s = rotation(motion[i, 2])
        e_x, e_y = reference[i, 0] - motion[i, 0], reference[i, 1] - motion[i, 1]
        turn = wrap_angle(reference[i, 2] - motion[i, 2])
        yaw_rate = _yaw_rate(i, motion[i, 5], values, age, summary, status, stale)
        _show(observation, i, _X, c * e_x + s * e_y, filtered)
        _show(observation, i, _Y, c * e_y - s * e_x, filtered)
        _show(observation, i, _YAW, turn, filtered)
        _show(observation, i, _V_X, motion[i, 3], filtered)
        _show(observation, i, _V_Y, motion[i, 4], filtered)
        _show(observation, i, _W, yaw_rate, filtered)
        for k in range(_UNUSED.shape[0]):
            _show(observation, i, _UNUSED[k], 0.0, False)
        for column in range(_SIZE, observation.shape[1]):
            if not np.isfinite(observation[i, column]):
                observation[i, column] = 0.0
