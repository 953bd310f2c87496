"""Measurements that obey the plant's equations exactly, for the tests of the regressions.

TRUTH is a vehicle that is heavier than the nominal CLAY.
"""

import numpy as np

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import (
    COLUMN,
    DataSheet,
    arrays_of,
    make_measurement,
)
from baselines.estimators.turning import TurningEstimator
from tracked_env.physics import lumped
from tracked_env.physics.parameters import plant_parameters

CLAY = plant_parameters()
NO_LIMITS = lumped.TractionLimits(-1e9, 1e9, -1e9, 1e9)
EXACT = DataSheet(*[0.0] * 6, 0.0, 1.0, 0.0, 0.0)  # sensors without errors
RTK = DataSheet()
TRUTH = CLAY._replace(
    mass=1750.0, longitudinal_resistance=0.45, inertia=1500.0, lateral_resistance=0.65
)
LATERAL_MODELS = ("sliding", "constrained")
KINDS = ("curves", "straight", "reverse", "pivot", "steady")


def _waves(rng, t):
    """A smooth random function of time, of order 1."""
    return sum(
        rng.uniform(0.3, 1.0) * np.sin(rng.uniform(0.5, 4.0) * t + rng.uniform(0.0, 6.3))
        for _ in range(4)
    )


def motion(kind, seed=0, steps=1000, period=0.02):
    """(v_x, v_y, yaw rate, torque left, torque right), each (steps,), of one kind of drive.

    curves: both ways, changing speed. straight: no turning. reverse: curves, backwards.
    pivot: the tracks run in opposite directions. steady: straight, at constant torque. Torques
    vary freely: the acceleration that they cause is measured, but not integrated.
    """
    rng = np.random.default_rng(seed)
    t = period * np.arange(steps)
    along, across, phase = _waves(rng, t), _waves(rng, t), rng.uniform(0.0, 6.3)
    v_x, yaw_rate = 2.5 + 0.2 * along, 0.4 * across
    mean = 1500.0 + 300.0 * along
    side = 900.0 * np.sign(yaw_rate) + 500.0 * np.sin(2.1 * t) + 200.0 * along * across
    if kind in ("straight", "steady"):
        yaw_rate, side = np.zeros(steps), np.zeros(steps)
    if kind == "steady":
        mean = np.full(steps, 1500.0)
    if kind == "reverse":
        v_x, mean = -v_x, -mean
    if kind == "pivot":
        v_x, yaw_rate, mean = 0.1 * along, 1.2 + 0.2 * across, 300.0 * along
    half = 0.5 * CLAY.contact_length * np.abs(yaw_rate)
    return v_x, 0.4 * half * np.sin(1.3 * t + phase), yaw_rate, mean - side, mean + side


def mirrored(measurement):
    """The same with left and right exchanged."""
    values = measurement.values.copy()
    for name in ("y", "yaw", "v_y", "acceleration_y", "yaw_rate", "yaw_acceleration"):
        values[:, COLUMN[name]] *= -1.0
    for name in ("sprocket_speed", "torque"):
        left, right = COLUMN[f"{name}_left"], COLUMN[f"{name}_right"]
        values[:, [left, right]] = values[:, [right, left]]
    return measurement._replace(values=values)


def measurements(p, kind, lateral_model="sliding", sheet=EXACT, count=1, seed=0, steps=1000):
    """A list of measurements of `count` vehicles with parameters p: the plant's accelerations
    at every moment of a motion, with the sensors' noise (no bias). Belts roll without slip."""
    constrained = lateral_model == "constrained"
    k = lumped.coefficients(p, constrained)
    rates = lumped.constrained_accelerations if constrained else lumped.sliding_accelerations
    rng = np.random.default_rng(seed + 1000)
    result = []
    for v_x, v_y, w, left, right in zip(*motion(kind, seed, steps), strict=True):
        state = lumped.Motion(v_x, -p.icr_forward * w if constrained else v_y, w)
        rate_x, rate_y, bend = rates(state, left, right, k, NO_LIMITS)
        a_x, a_y = lumped.inertial_acceleration(state, rate_x, rate_y)
        noise = rng.standard_normal((8, count))
        result.append(
            make_measurement(
                v_x=state.v_x + sheet.velocity_noise * noise[0],
                v_y=state.v_y + sheet.velocity_noise * noise[1],
                acceleration_x=a_x + sheet.acceleration_noise * noise[2],
                acceleration_y=a_y + sheet.acceleration_noise * noise[3],
                yaw_rate=w + sheet.gyro_noise * noise[4],
                yaw_acceleration=bend + sheet.yaw_acceleration_noise * noise[5],
                torque_left=left + sheet.torque_noise * noise[6],
                torque_right=right + sheet.torque_noise * noise[7],
                sprocket_speed_left=(v_x - 0.5 * p.track_gauge * w) / p.sprocket_radius,
                sprocket_speed_right=(v_x + 0.5 * p.track_gauge * w) / p.sprocket_radius,
            )
        )
    return result


def follow(part, samples):
    """Estimates after each sample."""
    return [part.update(sample) for sample in samples]


def longitudinal(sheet=EXACT, count=1, **options):
    return LongitudinalEstimator(CLAY, 0.02, sheet, count, **options)


def turning(sheet=EXACT, count=1, nominal=CLAY, truth=TRUTH, **options):
    """With the mass and motion resistance of `truth`, as the longitudinal estimator finds them."""
    part = TurningEstimator(nominal, 0.02, sheet, count, **options)
    part.vehicles["mass"], part.vehicles["resistance"] = truth.mass, truth.longitudinal_resistance
    return part


def true_along(p):
    return np.array([1.0 / p.mass, p.longitudinal_resistance])


def true_across(p):
    return np.array([p.inertia, p.lateral_resistance])


def with_lateral_model(p, factor=1.0, icr=0.2):
    return p._replace(turning_resistance_factor=factor, icr_forward=icr)


def assert_consistent(results, truth, least, most):
    """That errors of vehicles are as large as claimed; least, most: mean NEES, 2 when right."""
    for result in results:
        error = result.value - truth
        sigma = np.stack([result.deviation(name) for name in result.names], axis=1)
        assert (np.abs(error) < 3.0 * sigma).mean() > 0.97
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance), error)
        assert least < squared.mean() < most


def state(part):
    """A copy of the whole state, (N, columns)."""
    return np.concatenate(arrays_of(part), axis=1)


def go_on(part, other):
    """Let `part` go on from the state of `other`."""
    for array, source in zip(arrays_of(part), arrays_of(other), strict=True):
        array[:] = source
