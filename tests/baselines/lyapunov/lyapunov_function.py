"""The Lyapunov function of Focchi et al. and the error it is made of, as the paper has them."""

import math

from baselines.lyapunov.lyapunov_laws import PoseError, distance_weight


def pose_error(x, y, yaw, x_d, y_d, yaw_d):
    """PoseError of a pose against its reference, all in the world [m, rad]."""
    d_x, d_y = x - x_d, y - y_d
    return PoseError(
        math.cos(yaw) * d_x + math.sin(yaw) * d_y,
        math.cos(yaw) * d_y - math.sin(yaw) * d_x,
        math.remainder(yaw - yaw_d, 2.0 * math.pi),
    )


def lyapunov_rate(error, speed, slip, gains):
    """V' [1/s] under `slippage_aware_law`: (48) and the term in alpha - alpha_d missing there.

    Without slip it is (43), for the unicycle law.
    """
    along = error.x * math.cos(slip.alpha) + error.y * math.sin(slip.alpha)
    across = error.y * math.cos(slip.alpha) - error.x * math.sin(slip.alpha)
    half = 0.5 * (error.heading + slip.alpha)
    heading = math.sin(error.heading + slip.reference)
    offset = across * math.cos(half) + along * math.sin(half)
    left = 2.0 * math.sin(half) - heading / math.cos(half)
    distances = speed * offset * left - gains.k_p * along * along
    weight = distance_weight(error.x, error.y, gains)
    return weight * distances - gains.k_phi * heading * heading
