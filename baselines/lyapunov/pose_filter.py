"""Pose error of the Lyapunov policies: dead reckoning, pulled towards the samples of the pose.

Dead reckoning is with velocity and gyro, the pull the steady Kalman gain K of a data sheet.
A pose sample that comes late is first carried forward by the mean motion over its age. (By the
motion now, k_p age >= 1 would make the vehicle rattle: the demand enters its own measurement.)
A missing sample (NaN) is made up from the belts.
While poses come, a Kalman filter of two states learns the bias of the gyro from the heading error,
    h+ = h + dt (w - b - w_ref)
(the filter of slip_outage). In an outage the bias is taken off the gyro: 0.001 rad/s would be 25 mm
to the side after 10 s at 0.5 m/s.
"""

from typing import NamedTuple

import numpy as np

from baselines.estimators import slip_outage as inertial
from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov import pseudo_kinematic as kinematics
from tracked_env import observation as layout
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.jit import formula, loop

VELOCITY_NOISE_LIMIT = 1.0  # [m/s] a data sheet above it has no velocity: the belts give it
OUTAGE = 0.25  # [s] a pose that is older is missing, a younger one only late
BELT_DRIFT = 0.05  # [m/s] slow error of the belts' velocity: slip that the model does not know

# What is remembered of the gyro: heading error and bias, [rad] and [rad/s], and their covariance.
TURNED, TURN_BIAS, P_TT, _P_TG, P_GG = range(5)
GYRO = 5

# Fields of the observation that the filter reads.
POSE = ("position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate")
PATH = ("reference_speed", "reference_yaw_rate", "reference_acceleration",
        "reference_yaw_acceleration")  # fmt: skip
_I, _SCALE = layout.INDEX, layout.SCALE
_X, _Y, _HEADING, _V_X, _V_Y, _YAW_RATE = (_I[name] for name in POSE)
_AGE = _I["pose_age"]
_REFERENCE = np.array([_I[name] for name in PATH])


def filter_of(sheet: DataSheet, control_period: float) -> tuple[bool, tuple[float, float]]:
    """Whether the velocity is measured, and the gains of position and heading [-]."""
    measured = sheet.velocity_noise <= VELOCITY_NOISE_LIMIT
    rate = (sheet.velocity_noise, 0.0) if measured else (0.0, BELT_DRIFT)
    return measured, (
        kinematics.steady_gain(sheet.position_noise, *rate, control_period),
        kinematics.steady_gain(sheet.yaw_noise, sheet.gyro_noise, sheet.gyro_bias, control_period),
    )


class GyroNoise(NamedTuple):
    """Variances of which the bias of the gyro is learned."""

    heading: float  # [rad^2] of a sample of the heading
    gyro: float  # [rad^2/s^2] white
    bias: float  # [rad^2/s^2]; 0: none is learned


def gyro_noise_of(sheet: DataSheet, learned: bool) -> GyroNoise:
    """From a data sheet; learned: whether there is a bias to be learned."""
    bias = sheet.gyro_bias**2 if learned and sheet.yaw_noise > 0.0 else 0.0
    return GyroNoise(sheet.yaw_noise**2, sheet.gyro_noise**2, bias)


@formula
def _si(observation, i, column):
    return observation[i, column] * _SCALE[column]


@formula
def _blend(predicted, sample, gain):
    return sample if gain >= 1.0 else predicted + gain * (sample - predicted)


@formula
def _turned(gyro, i, w, turn, noise, period):
    """Heading error in gyro (N, GYRO) after a step with the gyro at w and the reference at turn."""
    gyro[i, TURNED] += period * (w - gyro[i, TURN_BIAS] - turn)
    inertial.drift(gyro, i, P_TT, noise.gyro, period)


@formula
def _seen(gyro, i, heading, begins, noise):
    """A sample of the heading error [rad]; begins: it is the first."""
    if begins or gyro[i, P_TT] == 0.0:
        gyro[i, TURNED], gyro[i, P_TT], gyro[i, _P_TG] = heading, noise.heading, 0.0
        gyro[i, P_GG] = noise.bias if begins else gyro[i, P_GG]
        return
    error = wrap_angle(heading - gyro[i, TURNED])
    inertial.compare(gyro, i, TURNED, error, noise.heading)


@loop
def locate(
    observation, motion, alpha, measured, gains, noise, period, error, age, mean, gyro, located,
    reference,
):  # fmt: skip
    """Bring error, mean (N, 3), gyro (N, GYRO), age, located (N,) up to date; reference (N, 4) out.

    motion (N, 2), alpha (N,): what the belts say. measured: whether velocity is, with the pose.
    gains (2,): of position and heading. reference: v_d, w_d, v_d', w_d', all NaN where one is.
    """
    for i in range(observation.shape[0]):
        check = 0.0
        for k in range(4):
            reference[i, k] = _si(observation, i, _REFERENCE[k])
            check += reference[i, k] * 0.0
        for k in range(4):
            reference[i, k] += check
        old = _si(observation, i, _AGE)
        fresh = not located[i] or old < age[i] + 0.5 * period
        v_x, v_y = _si(observation, i, _V_X), _si(observation, i, _V_Y)
        if not (measured and fresh and old < 1.5 * period and np.isfinite(v_x + v_y)):
            v_x, v_y = kinematics.pose_rate(0.0, motion[i, 0], alpha[i])
        w = _si(observation, i, _YAW_RATE)
        learns = noise.bias > 0.0 and located[i]
        if learns and check == 0.0:
            felt = w if np.isfinite(w) else motion[i, 1] + gyro[i, TURN_BIAS]
            _turned(gyro, i, felt, reference[i, 1], noise, period)
        w = w if np.isfinite(w) else motion[i, 1]
        if learns and old > OUTAGE:
            w -= gyro[i, TURN_BIAS]
        e = law.PoseError(error[i, 0], error[i, 1], error[i, 2])
        if check == 0.0:
            e = kinematics.carried(e, v_x, v_y, w, reference[i, 0], reference[i, 1], period)
        seen = law.PoseError(
            -_si(observation, i, _X), -_si(observation, i, _Y), -_si(observation, i, _HEADING)
        )
        if fresh and np.isfinite(seen.x + seen.y + seen.heading + old):
            share = period / (0.5 * old + period)  # exponential, of the same mean delay
            mean[i, 0] += share * (v_x - mean[i, 0])
            mean[i, 1] += share * (v_y - mean[i, 1])
            mean[i, 2] += share * (w - mean[i, 2])
            if noise.bias > 0.0 and old < 1.5 * period:
                _seen(gyro, i, seen.heading, not located[i], noise)
            if old > 0.0:
                seen = kinematics.carried(
                    seen, mean[i, 0], mean[i, 1], mean[i, 2], 0.0, 0.0, old
                )  # fmt: skip
            share, share_yaw = (gains[0], gains[1]) if located[i] else (1.0, 1.0)
            turned = e.heading + wrap_angle(seen.heading - e.heading)
            e = law.PoseError(
                _blend(e.x, seen.x, share),
                _blend(e.y, seen.y, share),
                seen.heading if share_yaw >= 1.0 else _blend(e.heading, turned, share_yaw),
            )
            located[i] = True
        age[i] = old if np.isfinite(old) else age[i] + period
        error[i, 0], error[i, 1], error[i, 2] = e.x, e.y, wrap_angle(e.heading)
