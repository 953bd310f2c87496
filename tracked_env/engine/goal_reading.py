"""Where the goal of a planned reference is, as the vehicle's measured pose has it.

With the delivered samples x, y, yaw and the goal (x_g, y_g, yaw_g) of the reference's last row:
    goal_x, goal_y       = R_z(-yaw) (x_g - x, y_g - y)
    goal_cosine, _sine   = cos, sin of yaw_g - yaw
    goal_time            = max(t_g - t, 0), until the plan arrives
The pose keeps its last sample where the state is not finite, so these are finite too.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.physics.channels import CHANNELS
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import loop
from tracked_env.physics.reference_knots import goal_of

_X, _Y, _YAW = (CHANNELS.index(name) for name in ("x", "y", "yaw"))


@loop
def _read(floats, counters, profile, rows, pose, period, shown):
    """Fill shown (n, 5); pose: column of the delivered samples, period [s] of a control step."""
    for k in range(rows.size):
        i = rows[k]
        x, y, yaw, time = goal_of(profile[:, i])
        dx, dy = x - floats[i, pose + _X], y - floats[i, pose + _Y]
        cosine, sine = rotation(floats[i, pose + _YAW])
        shown[k, 0], shown[k, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
        shown[k, 2], shown[k, 3] = rotation(yaw - floats[i, pose + _YAW])
        shown[k, 4] = max(time - counters[i, b.STEP] * period, 0.0)


def read_goal(
    batch: b.Batch, rows: NDArray[np.int64], period: float, shown: NDArray[Any]
) -> None:  # fmt: skip
    """The goals of the vehicles `rows` into shown (n, 5); period [s]: of a control step."""
    delivered = b.SAMPLE if batch.history.shape[1] == 1 else b.DELIVERED
    _read(batch.floats, batch.counters, batch.profile, rows, delivered, period, shown)
