"""Pose error and attitude of the Lyapunov policies, filtered; on slopes in the vehicle's plane.

Pose error: dead reckoning with velocity and gyro, pulled towards the samples of the pose by the
steady Kalman gain K of a data sheet. A pose sample that comes late is first carried forward by the
mean motion over its age. (By the motion now, k_p age >= 1 would make the vehicle rattle: the demand
enters its own measurement.) A missing sample (NaN) is made up from the belts.
While poses come, a Kalman filter of two states learns the bias of the gyro from the heading error,
    h+ = h + dt (w - b - w_ref)
(the filter of estimators.pose_outages). In an outage the bias is taken off the gyro: 0.001 rad/s
would be 25 mm to the side after 10 s at 0.5 m/s.

On slopes errors and reference are those in the vehicle's plane, F 5.3:
    e_b    = R_x(roll)^T R_y(pitch)^T (e_x, e_y, 0),  e_psi,b = cos(pitch) cos(roll) e_psi     (49)
    v_d,b  = v_d / cos(pitch),   w_d,b = cos(pitch) cos(roll) w_d
with the yaw counted once (`in_body_plane`). Roll and pitch come from their samples and from two
gyros, filtered as the heading is; level ground changes no bit.

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 5.3.
"""

from typing import NamedTuple

import numpy as np

from baselines.batch_policy import Bools, Floats
from baselines.estimators import pose_outages as inertial
from baselines.estimators.measurement import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov.lyapunov_laws import steady_gain
from baselines.slip.slip_models import Array
from tracked_env import observation as layout
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.rigid_body import in_body_plane

VELOCITY_NOISE_LIMIT = 1.0  # [m/s] a data sheet above it has no velocity: the belts give it
OUTAGE = 0.25  # [s] a pose that is older is missing, a younger one only late
BELT_DRIFT = 0.05  # [m/s] slow error of the belts' velocity: slip that the model does not know
STEEPEST_ATTITUDE = 1.4  # [rad] beyond it a vehicle lies on its side

# What is remembered of the gyro: heading error and bias, [rad] and [rad/s], and their covariance.
TURNED, TURN_BIAS, P_TT, _P_TG, P_GG, GYRO = range(6)  # GYRO: how many columns

# Fields of the observation that the filters read; ATTITUDE stands behind those of v0.
POSE = ("position_error_x", "position_error_y", "heading_error", "v_x", "v_y", "yaw_rate")
ALONG, ABOUT = (
    tuple(f"reference_{name}{rate}" for rate in rates)
    for name, rates in (("", ("speed", "acceleration")), ("yaw_", ("rate", "acceleration")))
)
PATH = (ALONG[0], ABOUT[0], ALONG[1], ABOUT[1])
ATTITUDE = ("roll", "pitch", "roll_rate", "pitch_rate")
_I, _SCALE = layout.INDEX, layout.SCALE
_X, _Y, _HEADING, _V_X, _V_Y, _YAW_RATE = (_I[name] for name in POSE)
_AGE = _I["pose_age"]
_REFERENCE = np.array([_I[name] for name in PATH])
_ERROR = [_I[name] for name in POSE[:3]]
_ALONG, _ABOUT = [_I[name] for name in ALONG], [_I[name] for name in ABOUT]
_ATTITUDE_LAYOUT = layout.make_layout(["attitude"])
_ATTITUDE_SCALE = _ATTITUDE_LAYOUT.scale[_ATTITUDE_LAYOUT.columns(ATTITUDE)]


class PoseFilter(NamedTuple):
    """Gains and variances of the filter."""

    velocity_measured: bool  # with the pose
    position_gain: float  # [-] K
    heading_gain: float  # [-] K
    heading_variance: float  # [rad^2] of a sample of the heading
    gyro_variance: float  # [rad^2/s^2] white
    bias_variance: float  # [rad^2/s^2]; 0: no bias of the gyro is learned
    period: float  # [s]
    since_last: bool = False  # whether the gains grow with the time since the last sample

    @classmethod
    def of(cls, sheet: DataSheet, control_period: float, learns_bias: bool) -> "PoseFilter":
        """From a data sheet; learns_bias: whether there is a bias of the gyro to be learned."""
        measured = sheet.velocity_noise <= VELOCITY_NOISE_LIMIT
        rate = (sheet.velocity_noise, 0.0) if measured else (0.0, BELT_DRIFT)
        gyro = (sheet.gyro_noise, sheet.gyro_bias)
        return cls(
            measured,
            steady_gain(sheet.position_noise, *rate, control_period),
            steady_gain(sheet.yaw_noise, *gyro, control_period),
            sheet.yaw_noise**2,
            sheet.gyro_noise**2,
            sheet.gyro_bias**2 if learns_bias and sheet.yaw_noise > 0.0 else 0.0,
            control_period,
        )


class PoseMemory(NamedTuple):
    """What the filter remembers of N vehicles."""

    error: Array  # (N, 3) vehicle minus reference, body axes [m, m, rad]
    age: Array  # (N,) [s] age of the pose sample last seen
    mean: Array  # (N, 3) v_x, v_y [m/s], yaw rate [rad/s], averaged over the age of the pose
    gyro: Array  # (N, GYRO) bias of the gyro
    located: Bools  # (N,) whether a pose has been seen

    @classmethod
    def blank(cls, count: int) -> "PoseMemory":
        """Before anything has been seen."""
        error, mean, gyro = (np.zeros((count, width)) for width in (3, 3, GYRO))
        return cls(error, np.zeros(count), mean, gyro, np.zeros(count, dtype=bool))


@formula
def _si(observation, i, column):
    return observation[i, column] * _SCALE[column]


@formula
def _blend(predicted, sample, gain):
    return sample if gain >= 1.0 else predicted + gain * (sample - predicted)


@formula
def _over(gain, steps):
    """Gain of a sample that comes `steps` control periods after the last one."""
    return gain if steps < 1.5 else 1.0 - (1.0 - gain) ** steps


@formula
def _compare_heading(gyro, i, heading, begins, f):
    """A sample of the heading error [rad]; begins: it is the first."""
    if begins or gyro[i, P_TT] == 0.0:
        gyro[i, TURNED], gyro[i, P_TT], gyro[i, _P_TG] = heading, f.heading_variance, 0.0
        gyro[i, P_GG] = f.bias_variance if begins else gyro[i, P_GG]
        return
    error = wrap_angle(heading - gyro[i, TURNED])
    inertial.compare(gyro[i], error, f.heading_variance)


@loop
def locate(observation, motion, alpha, pose_filter, memory, reference):
    """Bring the PoseMemory up to date; reference (N, 4) out: v_d, w_d, v_d', w_d', all NaN where
    one is. motion (N, 2), alpha (N,): what the belts say."""
    f, period = pose_filter, pose_filter.period
    error, age, mean, gyro, located = memory
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
        if not (f.velocity_measured and fresh and old < 1.5 * period and np.isfinite(v_x + v_y)):
            v_x, v_y = law.pose_rate(0.0, motion[i, 0], alpha[i])
        w = _si(observation, i, _YAW_RATE)
        learns = f.bias_variance > 0.0 and located[i]
        if learns and check == 0.0:
            measured = w if np.isfinite(w) else motion[i, 1] + gyro[i, TURN_BIAS]
            gyro[i, TURNED] += period * (measured - gyro[i, TURN_BIAS] - reference[i, 1])
            inertial.drift(gyro[i], f.gyro_variance, period)
        w = w if np.isfinite(w) else motion[i, 1]
        if learns and old > OUTAGE:
            w -= gyro[i, TURN_BIAS]
        e = law.PoseError(error[i, 0], error[i, 1], error[i, 2])
        if check == 0.0:
            e = law.carried(e, v_x, v_y, w, reference[i, 0], reference[i, 1], period)
        ahead, left = -_si(observation, i, _X), -_si(observation, i, _Y)
        sample = law.PoseError(ahead, left, -_si(observation, i, _HEADING))
        if fresh and np.isfinite(sample.x + sample.y + sample.heading + old):
            share = period / (0.5 * old + period)  # exponential, of the same mean delay
            mean[i, 0] += share * (v_x - mean[i, 0])
            mean[i, 1] += share * (v_y - mean[i, 1])
            mean[i, 2] += share * (w - mean[i, 2])
            if f.bias_variance > 0.0 and old < 1.5 * period:
                _compare_heading(gyro, i, sample.heading, not located[i], f)
            if old > 0.0:
                ahead, left, turn = mean[i, 0], mean[i, 1], mean[i, 2]
                sample = law.carried(sample, ahead, left, turn, 0.0, 0.0, old)
            steps = (age[i] + period - old) / period if f.since_last else 1.0
            share = _over(f.position_gain, steps) if located[i] else 1.0
            share_yaw = _over(f.heading_gain, steps) if located[i] else 1.0
            turned = e.heading + wrap_angle(sample.heading - e.heading)
            e = law.PoseError(
                _blend(e.x, sample.x, share),
                _blend(e.y, sample.y, share),
                sample.heading if share_yaw >= 1.0 else _blend(e.heading, turned, share_yaw),
            )
            located[i] = True
        age[i] = old if np.isfinite(old) else age[i] + period
        error[i, 0], error[i, 1], error[i, 2] = e.x, e.y, wrap_angle(e.heading)


def filtered_attitude(
    observation: Floats, last: Array, start: Bools, gain: float, period: float
) -> Array:
    """(N, 2) roll, pitch [rad] from the fields ATTITUDE behind those of v0; last: the same of the
    step before, where not `start`. gain: steady one of a sample.

    A sample that is missing (NaN) is carried on by the gyros, a missing gyro stands still.
    """
    samples = observation[:, layout.SIZE : layout.SIZE + len(ATTITUDE)] * _ATTITUDE_SCALE
    predicted = np.where(start[:, None], 0.0, last + period * np.nan_to_num(samples[:, 2:]))
    sample = np.where(np.isfinite(samples[:, :2]), samples[:, :2], predicted)
    share = np.where(start[:, None], 1.0, gain)
    attitude = np.where(share >= 1.0, sample, predicted + share * (sample - predicted))
    return np.clip(attitude, -STEEPEST_ATTITUDE, STEEPEST_ATTITUDE)


@loop
def _into_plane(error, cosine, sine):
    """Pose errors (N, 3) in and out; cosines and sines (N, 2) of roll, pitch."""
    for i in range(error.shape[0]):
        pitch, roll = (cosine[i, 1], sine[i, 1]), (cosine[i, 0], sine[i, 0])
        error[i, 0], error[i, 1], error[i, 2] = in_body_plane(
            error[i, 0], error[i, 1], error[i, 2], pitch, roll
        )


def in_vehicle_plane(observation: Floats, attitude: Array) -> Floats:
    """The observation with pose error and reference in the plane of vehicles at roll, pitch [rad];
    rows of level vehicles are as they were, to the bit."""
    cosine, tilted = np.cos(attitude), observation.copy()
    error = observation[:, _ERROR] * _SCALE[_ERROR]
    _into_plane(error, cosine, np.sin(attitude))
    tilted[:, _ERROR] = error / _SCALE[_ERROR]
    tilted[:, _ALONG] /= cosine[:, 1:]
    tilted[:, _ABOUT] *= cosine[:, 1:] * cosine[:, :1]
    return np.where((attitude == 0.0).all(axis=1, keepdims=True), observation, tilted)
