"""What a slope changes for the Lyapunov laws: errors and reference in the vehicle's plane, F 5.3.

    e_b    = R_x(roll)^T R_y(pitch)^T (e_x, e_y, 0),  e_psi,b = cos(pitch) cos(roll) e_psi     (49)
    v_d,b  = v_d / cos(pitch),   w_d,b = cos(pitch) cos(roll) w_d
with the yaw counted once (`physics.attitude.in_body_plane`). The reference is horizontal, so that a
vehicle above or below it has to drive faster along its own plane to keep up. Roll and pitch come
from their samples and from two gyros, filtered as the heading is; level ground changes no bit.

On slopes the steady slip angle is no longer small: a slow vehicle that turns where a side slope
takes half of the friction drifts at 1 rad, and the angle jumps with the demanded yaw rate, while
the vehicle needs its time to drift. Fed back at once it makes the law chatter. So the angle follows
with SLIP_TIME, and it and its rate along the reference are bounded.

References: [F] Focchi et al. (2025), section 5.3.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov.lyapunov_laws import GAINS_ON_FLOORS, GAINS_ON_SLOPES, LyapunovGains
from baselines.lyapunov.pseudo_kinematic import Array, steady_gain
from tracked_env import observation as layout
from tracked_env.physics.attitude import in_body_plane

ATTITUDE = ("roll", "pitch", "roll_rate", "pitch_rate")
STEEPEST_ATTITUDE = 1.4  # [rad] beyond it a vehicle lies on its side
SLIP_TIME = 0.2  # [s] in which slip settles, about its velocity over mu g
LARGEST_SLIP_ANGLE = 0.4  # [rad] that the law is told on slopes
LARGEST_SLIP_RATE = 0.3  # [rad/s] of alpha_d', which has a jump where the reference begins to turn
_FIRST = layout.SIZE  # a View puts fields that are not of V0 behind those of V0
_POSE = [layout.INDEX[n] for n in ("position_error_x", "position_error_y", "heading_error")]
_ALONG = [layout.INDEX[n] for n in ("reference_speed", "reference_acceleration")]
_ABOUT = [layout.INDEX[n] for n in ("reference_yaw_rate", "reference_yaw_acceleration")]
_ATTITUDE_LAYOUT = layout.make_layout(["attitude"])
_SCALE = _ATTITUDE_LAYOUT.scale[_ATTITUDE_LAYOUT.columns(ATTITUDE)]
_POSE_SCALE = layout.SCALE[_POSE]


def shows_attitude(observation: Sequence[str]) -> bool:
    """Whether an observation of these fields tells roll and pitch."""
    return all(name in observation for name in ATTITUDE)


def tuned_gains(observation: Sequence[str]) -> LyapunovGains:
    """Gains of the registered policies: of slopes where these names show the attitude."""
    return GAINS_ON_SLOPES if shows_attitude(observation) else GAINS_ON_FLOORS


class AttitudeFilter:
    """Roll and pitch of N vehicles from observations with the fields ATTITUDE behind those of V0.

    sheet: noise of the sensors. control_period [s]: between two samples.
    """

    def __init__(self, sheet: DataSheet, control_period: float) -> None:
        self.control_period = control_period
        self.gain = steady_gain(sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias, control_period)

    def update(
        self, observation: NDArray[np.float32], last: Array, start: NDArray[np.bool_]
    ) -> Array:
        """(N, 2) roll, pitch [rad]; last: the same of the step before, where not `start`.

        A sample that is missing (NaN) is carried on by the gyros, a missing gyro stands still.
        """
        seen = observation[:, _FIRST : _FIRST + 4] * _SCALE
        turned = self.control_period * np.nan_to_num(seen[:, 2:])
        predicted = np.where(start[:, None], 0.0, last + turned)
        sample = np.where(np.isfinite(seen[:, :2]), seen[:, :2], predicted)
        share = np.where(start[:, None], 1.0, self.gain)
        attitude = np.where(share >= 1.0, sample, predicted + share * (sample - predicted))
        return np.clip(attitude, -STEEPEST_ATTITUDE, STEEPEST_ATTITUDE)


def in_vehicle_plane(observation: NDArray[np.float32], attitude: Array) -> NDArray[np.float32]:
    """The observation with pose error and reference in the plane of vehicles at roll, pitch [rad];
    rows of level vehicles are as they were, to the bit."""
    roll, pitch = attitude.T
    level = (roll == 0.0) & (pitch == 0.0)
    cosines = np.cos(pitch), np.cos(roll)
    ahead, left, turn = (observation[:, _POSE] * _POSE_SCALE).T
    sines = np.sin(pitch), np.sin(roll)
    error = in_body_plane.py_func(ahead, left, turn, (cosines[0], sines[0]), (cosines[1], sines[1]))
    tilted = observation.copy()
    tilted[:, _POSE] = np.stack(error, axis=1) / _POSE_SCALE
    tilted[:, _ALONG] /= cosines[0][:, None]
    tilted[:, _ABOUT] *= (cosines[0] * cosines[1])[:, None]
    return np.where(level[:, None], observation, tilted)


def settled_slip(alpha: Array, last: Array, start: NDArray[np.bool_], period: float) -> Array:
    """Slip angle (N,) [rad] that follows the one of the belts, alpha, from `last` for a period."""
    bounded = np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE)
    share = np.where(start, 1.0, min(period / SLIP_TIME, 1.0))
    return last + share * (bounded - last)


def bounded_slip(alpha: Array, rate: Array) -> tuple[Array, Array]:
    """alpha_d [rad] and alpha_d' [rad/s], (N,), within what the law is told."""
    inside = np.abs(alpha) <= LARGEST_SLIP_ANGLE
    return (
        np.clip(alpha, -LARGEST_SLIP_ANGLE, LARGEST_SLIP_ANGLE),
        np.where(inside, np.clip(rate, -LARGEST_SLIP_RATE, LARGEST_SLIP_RATE), 0.0),
    )
