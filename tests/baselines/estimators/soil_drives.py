"""Drives over soils with known parameters, for the tests of the soil estimator."""

import math
from collections import deque

import numpy as np
from scipy.special import ndtr

from baselines.estimators.measurement import DataSheet, Measurement, make_measurement
from baselines.estimators.soil_estimator import SoilEstimator
from tracked_env.physics.parameters import plant_parameters

CLAY = plant_parameters()
RTK = DataSheet()
IDEAL = DataSheet(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
LENGTH, RADIUS, HALF = CLAY.contact_length, CLAY.sprocket_radius, 0.5 * CLAY.track_gauge
PERIOD = 0.02
LOAM, SAND, WEAK, FIRM = (9e3, 0.025), (5e3, 0.01), (5e3, 0.02), (43e3, 0.02)


def effort(slip, maximum, modulus):
    """S (7) in its printed form."""
    u = np.abs(slip) * LENGTH / modulus
    return np.sign(slip) * maximum * (1.0 + np.expm1(-u) / np.maximum(u, 1e-300))


def sample(slip, ground, maximum, modulus, rng, sheet=RTK) -> Measurement:
    """Measurement of tracks with slip ratio (N, 2) [-] over the ground at v_x = `ground` [m/s]."""
    slip = np.asarray(slip, dtype=float)
    turn = 0.1
    track = ground + turn * HALF * np.array([-1.0, 1.0])
    driven = slip * track >= 0.0
    belt = np.where(driven, track / (1.0 - np.abs(slip)), track * (1.0 - np.abs(slip)))
    torque = RADIUS * effort(slip, maximum, modulus)
    noise = rng.standard_normal((6, len(slip)))
    return make_measurement(
        v_x=ground + sheet.velocity_noise * noise[0],
        yaw_rate=turn + sheet.gyro_noise * noise[1],
        sprocket_speed_left=belt[:, 0] / RADIUS + sheet.sprocket_speed_noise * noise[2],
        sprocket_speed_right=belt[:, 1] / RADIUS + sheet.sprocket_speed_noise * noise[3],
        torque_left=torque[:, 0] + sheet.torque_noise * noise[4],
        torque_right=torque[:, 1] + sheet.torque_noise * noise[5],
    )


def drive(estimator, soil, slips, steps, seed=0, ground=1.5, sheet=RTK):
    """Drive with slips that wander within `slips`; yields the estimate of every step."""
    rng = np.random.default_rng(seed)
    count = len(estimator.memory)
    walk = rng.standard_normal((count, 2))
    low, high = slips
    for _ in range(steps):
        slip = low * (high / low) ** ndtr(walk)
        walk = 0.95 * walk + math.sqrt(1.0 - 0.95**2) * rng.standard_normal((count, 2))
        yield estimator.update(sample(slip, ground, *soil, rng, sheet))


def last(estimates):
    """The last of an iterator."""
    return deque(estimates, maxlen=1)[0]


def make(count=1, sheet=RTK, window=50, correlation_steps=1.0):
    options = {"window": window, "correlation_steps": correlation_steps}
    return SoilEstimator(CLAY, PERIOD, sheet, count, **options)
