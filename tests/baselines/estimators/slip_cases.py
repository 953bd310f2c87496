"""Vehicles with known slips for the tests of the slip observer: kinematics, noise, delay."""

import math
from typing import NamedTuple

import numpy as np

from baselines.estimators.measurement import DataSheet, Measurement, make_measurement
from tracked_env.physics.parameters import plant_parameters

PARAMETERS = plant_parameters()
GAUGE, RADIUS = PARAMETERS.track_gauge, PARAMETERS.sprocket_radius
PERIOD = 0.02
RTK = DataSheet(gyro_bias=0.0)
STRAWA = DataSheet(
    position_noise=1.0, yaw_noise=math.radians(1.0), velocity_noise=0.1, gyro_noise=0.002,
    gyro_bias=0.0, sprocket_speed_noise=0.1,
)  # fmt: skip
SHEETS = {"rtk": RTK, "strawa": STRAWA}


class Run(NamedTuple):
    """T steps of N vehicles."""

    measurements: list[Measurement]
    state: np.ndarray  # (T, N, 6) x, y, yaw, i_L, i_R, alpha
    velocity: np.ndarray  # (T, N, 3) v_x, v_y, yaw rate


def gain(belt, slip):
    """V / V_t of a track, written independently of the formula under test."""
    driving = slip * np.sign(belt) >= 0.0
    return np.where(driving, 1.0 - np.abs(slip), 1.0 / np.maximum(1.0 - np.abs(slip), 0.02))


def weaving(steps, count=1, speed=2.0, swing=0.4):
    """Belt speeds (T, N, 2) [m/s] of vehicles that weave, each at its own phase."""
    time = PERIOD * np.arange(steps)[:, None] + np.linspace(0.0, 5.0, count)
    turn = swing * np.sin(0.9 * time)
    return np.stack([speed + 0.3 * np.sin(0.5 * time) - turn, speed + turn], axis=-1)


def simulate(belts, slips, side_slip, sheet=RTK, seed=0, drifts=(0.0, 0.0), delay=0):
    """Drive with belts (T, N, 2) [m/s], slips broadcast to them, side_slip to (T, N) [rad].

    drifts: of position and yaw, per sqrt(second); delay [steps] of the pose group.
    """
    steps, count = belts.shape[:2]
    rng = np.random.default_rng(seed)
    slips = np.broadcast_to(slips, belts.shape)
    tangent = np.tan(np.broadcast_to(side_slip, (steps, count)))
    velocity, state = np.empty((steps, count, 3)), np.empty((steps, count, 6))
    pose = np.zeros((3, count))
    spread = np.array([drifts[0], drifts[0], drifts[1]]) * math.sqrt(PERIOD)
    last = gain(belts[0], slips[0]) * belts[0]
    for k in range(steps):
        tracks = gain(belts[k], slips[k]) * belts[k]
        left, right = (0.5 * (last + tracks)).T
        v, w, t = 0.5 * (left + right), (right - left) / GAUGE, tangent[max(k - 1, 0)]
        c, s = np.cos(pose[2] + 0.5 * PERIOD * w), np.sin(pose[2] + 0.5 * PERIOD * w)
        pose = pose + PERIOD * np.array([v * (c - t * s), v * (s + t * c), w])
        pose = pose + spread[:, None] * rng.standard_normal((3, count))
        left, right = tracks.T
        v, w, t, last = 0.5 * (left + right), (right - left) / GAUGE, tangent[k], tracks
        velocity[k] = np.stack([v, t * v, w], axis=-1)
        state[k] = np.column_stack([*pose, slips[k], np.arctan(t)])
    measurements = []
    for k in range(steps):
        then = max(k - delay, 0)
        draw = rng.standard_normal((8, count))
        measurements.append(
            make_measurement(
                age=np.array([delay * PERIOD, 0.0, 0.0]),
                x=state[then, :, 0] + sheet.position_noise * draw[0],
                y=state[then, :, 1] + sheet.position_noise * draw[1],
                yaw=state[then, :, 2] + sheet.yaw_noise * draw[2],
                v_x=velocity[then, :, 0] + sheet.velocity_noise * draw[3],
                v_y=velocity[then, :, 1] + sheet.velocity_noise * draw[4],
                yaw_rate=velocity[k, :, 2] + sheet.gyro_noise * draw[5],
                sprocket_speed_left=belts[k, :, 0] / RADIUS + sheet.sprocket_speed_noise * draw[6],
                sprocket_speed_right=belts[k, :, 1] / RADIUS + sheet.sprocket_speed_noise * draw[7],
            )
        )
    return Run(measurements, state, velocity)


def follow(observer, measurements):
    """(value (T, N, 6), covariance (T, N, 6, 6), status (T, N), nis (T, N)) of the observer."""
    answers = [observer.update(m) for m in measurements]
    return tuple(
        np.array([getattr(a, name) for a in answers])
        for name in ("value", "covariance", "status", "nis")
    )


def part(measurement, rows):
    """The same sample for some of the vehicles."""
    return Measurement(*(array[rows] for array in measurement))


def positive_definite(covariance):
    """Whether all of (..., 6, 6) are symmetric and positive definite."""
    scale = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    unit = covariance / (scale[..., :, None] * scale[..., None, :])
    symmetric = np.array_equal(covariance, np.swapaxes(covariance, -1, -2))
    return symmetric and bool(np.linalg.eigvalsh(unit).min() > 0.0)
