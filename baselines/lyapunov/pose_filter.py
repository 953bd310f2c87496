"""Pose error of the Lyapunov policies: dead reckoning, pulled towards the samples of the pose.

Dead reckoning is with velocity and gyro, the pull the steady Kalman gain K of a data sheet.
A pose sample that comes late is first carried forward by the mean motion over its age. (By the
motion now, k_p age >= 1 would make the vehicle rattle: the demand enters its own measurement.)
A missing sample (NaN) is made up from the belts.
"""

import numpy as np

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov import lyapunov_laws as law
from baselines.lyapunov import pseudo_kinematic as kinematics
from tracked_env import observation as layout
from tracked_env.physics.elementary import wrap_angle
from tracked_env.physics.jit import formula, loop

VELOCITY_NOISE_LIMIT = 1.0  # [m/s] a data sheet above it has no velocity: the belts give it
BELT_DRIFT = 0.05  # [m/s] slow error of the belts' velocity: slip that the model does not know

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


@formula
def _si(observation, i, column):
    return observation[i, column] * _SCALE[column]


@formula
def _blend(predicted, sample, gain):
    return sample if gain >= 1.0 else predicted + gain * (sample - predicted)


@loop
def locate(
    observation, motion, alpha, measured, gains, period, error, age, mean, located, reference
):  # fmt: skip
    """Bring error, mean (N, 3), age and located (N,) up to date; reference (N, 4) out.

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
        w = w if np.isfinite(w) else motion[i, 1]
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
