"""The Lyapunov function of Focchi et al. and the error it is made of, as the paper has them."""

import math
from typing import NamedTuple

import numpy as np

from baselines.lyapunov.lyapunov_laws import BodyMotion, PoseError, distance_weight, turn_towards
from tracked_env.physics.elementary import rotation


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


class Spiral(NamedTuple):
    """The reference of F, figure 10: constant speed, yaw rate w_d = yaw_acceleration t.

    F prints w_d = 4 t in no unit. In rad/s it needs sprockets of 10 rad/s, the end of F's own
    data, after 0.5 s and a radius of 1 cm after 8 s. The default reaches 1 rad/s, a radius of
    0.3 m, in 20 s.
    """

    speed: float = 0.3  # [m/s] v_d
    yaw_acceleration: float = 0.05  # [rad/s^2] dw_d / dt

    def yaw_rate(self, time):
        """w_d [rad/s] at `time` [s]."""
        return self.yaw_acceleration * time

    def advance(self, pose, time, duration):
        """Reference pose (3,) at time + duration [s]; `pose` is that at `time`. RK4 of (35)."""
        middle, end = time + 0.5 * duration, time + duration
        start, bend = pose[2], 0.5 * self.yaw_acceleration
        halfway = start + bend * (middle * middle - time * time)
        final = start + bend * (end * end - time * time)
        yaws = np.array([start, halfway, final])
        weights = np.array([1.0, 4.0, 1.0]) * self.speed * duration / 6.0
        return np.array([pose[0] + weights @ np.cos(yaws), pose[1] + weights @ np.sin(yaws), final])


def unicycle_law(error, speed, yaw_rate, gains):
    """BodyMotion demanded by (40), (42) of F, blind to slip; speed v_d, yaw_rate w_d."""
    _cosine, sine = rotation(error.heading)
    steering = speed * turn_towards(error.x, error.y, error.heading)
    steering *= distance_weight(error.x, error.y, gains)
    return BodyMotion(speed - gains.k_p * error.x, yaw_rate - steering - gains.k_phi * sine)
