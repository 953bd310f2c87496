"""Prediction of the pseudo-kinematic model for model predictive control of sprocket speeds.

Stages k of h seconds at constant sprocket speeds u_k, in units of their limit, with beta(u) and
alpha(u) of a slip model:
    v = (r omega_L - beta_L + r omega_R - beta_R) / 2
    w = (r omega_R - beta_R - r omega_L + beta_L) / B
    yaw' = yaw + h w,   (x', y') by (v, v tan(alpha)) along the mean heading
The states are those of `tracked_prediction`: pose, v and w of the stage before, and its sprocket
speeds. v, w and tan(alpha) are linear in the sprocket speeds about a plan: `felt` (3, N, V, 3) is
what they are on the plan of each of V vehicles, then their slopes by the left and right input.

References: [F] Focchi et al. (2025), section 3.2.
"""

import numpy as np

from baselines.lyapunov import lyapunov_laws as law
from baselines.predictive.path_ahead import HEADING, PATH_SPEED, PATH_YAW_RATE
from baselines.predictive.tracked_prediction import (
    GIVEN_LEFT,
    GIVEN_RIGHT,
    SPEED,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula


@formula
def motion_at(felt, k, i, left, right):
    """v [m/s], w [rad/s] and tan(alpha) [-] of stage k, a change of (left, right) off the plan."""
    v, w, t = felt[0, k, i, 0], felt[0, k, i, 1], felt[0, k, i, 2]
    return (
        v + left * felt[1, k, i, 0] + right * felt[2, k, i, 0],
        w + left * felt[1, k, i, 1] + right * felt[2, k, i, 1],
        t + left * felt[1, k, i, 2] + right * felt[2, k, i, 2],
    )


@formula
def move(s, motion, left, right, h, after):
    """State after one stage; returns cosine and sine of its mean heading."""
    v, w, t = motion
    cosine, sine = rotation(s[YAW] + 0.5 * h * w)
    after[X] = s[X] + h * v * (cosine - t * sine)
    after[Y] = s[Y] + h * v * (sine + t * cosine)
    after[YAW] = s[YAW] + h * w
    after[SPEED], after[YAW_RATE] = v, w
    after[GIVEN_LEFT], after[GIVEN_RIGHT] = left, right
    return cosine, sine


@formula
def differentiate(s, after, motion, felt, k, i, turn, h, forward):
    """forward of stage k, see tracked_prediction; v and w of the stage before have no effect."""
    v, _w, t = motion
    cosine, sine = turn
    forward[:, :] = 0.0
    way_x, way_y = after[X] - s[X], after[Y] - s[Y]
    forward[0, X], forward[0, Y], forward[0, YAW] = -way_y, way_x, 1.0
    for side in range(2):
        d_v, d_w, d_t = felt[1 + side, k, i, 0], felt[1 + side, k, i, 1], felt[1 + side, k, i, 2]
        column = forward[5 + side]
        column[X] = h * (d_v * (cosine - t * sine) - v * d_t * sine) - 0.5 * h * d_w * way_y
        column[Y] = h * (d_v * (sine + t * cosine) + v * d_t * cosine) + 0.5 * h * d_w * way_x
        column[YAW], column[SPEED], column[YAW_RATE] = h * d_w, d_v, d_w


@formula
def on_the_path(ahead, felt, beta, i, half_gauge, unit):
    """Bring heading, v_x and yaw rate of `ahead` to a vehicle on the path, and fill its inputs.

    beta (stages, V, 2) [m/s]; unit [m/s]: belt speed at the limit.
    """
    path, v, w = ahead.path, ahead.speed, ahead.turn
    count = ahead.efforts.shape[0]
    for k in range(count):
        tangent = felt[0, k, i, 2]
        speed = 0.5 * (v[k] + v[k + 1]) / np.sqrt(1.0 + tangent * tangent)
        turn = 0.5 * (w[k] + w[k + 1])
        path[k + 1, HEADING] -= np.arctan(tangent)
        path[k + 1, PATH_SPEED], path[k + 1, PATH_YAW_RATE] = speed, turn
        left, right = law.belt_speeds(
            law.BodyMotion(speed, turn), beta[k, i, 0], beta[k, i, 1], half_gauge
        )
        ahead.efforts[k, 0] = min(max(left / unit, -1.0), 1.0)
        ahead.efforts[k, 1] = min(max(right / unit, -1.0), 1.0)
