"""The turning resistance of a log where the smoothing of friction near rest is not known.

    M = I dw/dt + C g S(v_y, w; e) + opposite resistances,    C = m mu_t
    S = (1 / l) integral over the contact of s g(v_y + s w) ds,   g: the sign of the sliding speed,
smoothed over a width e [m/s] in one of two shapes, E = sqrt(u^2 + e^2):
    soft   g = u / E                      sharp  g = u / E + e^2 u / (2 E^3), that of the plants
The equations of the identification know one shape and width. Here all widths of a grid are fitted,
each with its I and C; its weight is its likelihood, of residuals as large and as correlated as they
are. What the mean law of the log differs by is taken off the torques, and the scatter of I and C
over the widths belongs into their intervals.
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.identify.csv_log import Floats
from baselines.identify.vehicle_log import Log
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.terramechanics import GRAVITY, LATERAL_FRICTION_REGULARISATION

WIDTHS = np.geomspace(1e-3, 0.2, 25)  # [m/s] e
SHAPES = (0.0, 0.5)  # factor of e^2 u / E^3: soft, sharp
OWN = (LATERAL_FRICTION_REGULARISATION, 0.5)
SLOWEST = 0.2  # [m/s] of a track
LEAST = 200  # samples
INSIDE = 0.8  # [-] of the half contact, where the centre of rotation is sought
MODEL_NOISE = 20.0  # [N m]
TEMPERED = 5.0  # [-] on the misfit, since widths lie apart and no shape is quite that of a soil
TRUSTED = 0.25  # [-] of the change by the smoothing: its standard deviation, for other shapes


class Turning(NamedTuple):
    """What the smoothing does to the turning resistance."""

    excess: Floats  # (T,) [N m] moment beyond that of the law the estimators have
    inertia_spread: float  # [-] standard deviation over the mean
    resistance_spread: float  # [-]
    width: float  # [m/s] the likeliest e


def unit_moment(v_y: Floats, rate: Floats, length: float, width: float, shape: float) -> Floats:
    """S [m] of v_y [m/s] and w [rad/s], odd in w."""
    w = np.where(np.abs(rate) < 1e-4, np.copysign(1e-4, rate), rate)
    half = 0.5 * length * w
    first, second = (_moments(v_y + k * half, width, shape) for k in (-1.0, 1.0))
    return np.asarray((second[1] - first[1] - v_y * (second[0] - first[0])) / (length * w * w))


def _moments(u: Floats, width: float, shape: float) -> tuple[Floats, Floats]:
    """Integrals of g(u) and of u g(u)."""
    e2 = width * width
    root, bend = np.hypot(u, width), np.arcsinh(u / width)
    zeroth = root - shape * e2 / root
    return zeroth, 0.5 * (u * root - e2 * bend) + shape * e2 * (bend - u / root)


def side_speed(
    a_y: Floats, rate: Floats, friction: float, length: float, width: float, shape: float
) -> Floats:
    """v_y [m/s] at which friction mu_t gives the lateral acceleration a_y [m/s^2]."""
    half = 0.5 * length * rate
    reach = INSIDE * np.hypot(half, width)
    v_y = np.zeros(len(a_y))
    for _ in range(4):
        one, two = (np.hypot(v_y + k * half, width) for k in (-1.0, 1.0))
        lever = 0.5 * (one + two) / (1.0 + shape * width * width / (one * two))
        v_y = np.clip(-a_y / (max(friction, 0.05) * GRAVITY) * lever, -reach, reach)
    return v_y


def turning_of(log: Log, vehicle: PlantParameters) -> Turning | None:
    """The turning resistance of a log, or None where it turns too little to say anything."""
    values, gauge, length = log.values, vehicle.track_gauge, vehicle.contact_length
    rate, bend, a_y = (values[n] for n in ("yaw_rate", "yaw_acceleration", "acceleration_y"))
    left, right = (
        vehicle.sprocket_radius * values[f"sprocket_speed_{s}"] for s in ("left", "right")
    )
    moment = (
        0.5 * gauge / vehicle.sprocket_radius * (values["torque_right"] - values["torque_left"])
    )
    usable = log.fresh[:, 1] & log.fresh[:, 2] & np.isfinite(moment + bend + a_y + rate)
    usable &= (np.minimum(np.abs(left), np.abs(right)) > SLOWEST) & (
        np.abs(rate) > 2.0 * LATERAL_FRICTION_REGULARISATION / length
    )
    if usable.sum() < LEAST:
        return None
    opposite = 0.5 * (np.sign(right) - np.sign(left))[usable]
    weight = vehicle.mass * GRAVITY
    sheet = log.sensors
    torque = 0.5 * gauge / vehicle.sprocket_radius * sheet.torque_noise
    noise = math.sqrt(2.0) * sheet.acceleration_noise / sheet.accelerometer_distance
    variance = 2.0 * torque**2 + MODEL_NOISE**2 + (vehicle.inertia * noise) ** 2
    friction = vehicle.lateral_resistance
    results: list[tuple[float, float, float]] = []
    laws: list[Floats] = []
    candidates = [OWN, *((float(w), s) for s in SHAPES for w in WIDTHS)]
    for width, shape in candidates:
        for _ in range(2):  # v_y needs mu_t
            v_y = side_speed(a_y, rate, friction, length, width, shape)
            law = weight * unit_moment(v_y, rate, length, width, shape)
            columns = [bend[usable], law[usable]]
            if np.abs(opposite).mean() > 0.01:
                columns.append(0.5 * gauge * weight * opposite)
            matrix = np.column_stack(columns)
            turn = np.hypot(sheet.gyro_noise, 1e-4)
            slope = friction * weight * (
                unit_moment(v_y, rate + turn, length, width, shape)
                - unit_moment(v_y, rate - turn, length, width, shape)
            )[usable] / 2.0  # fmt: skip
            if not results:  # the same weights for all: likelihoods are compared
                root = 1.0 / np.sqrt(variance + slope**2)
            solution = np.linalg.lstsq(root[:, None] * matrix, root * moment[usable], rcond=None)[0]
            friction = min(max(float(solution[1]), 0.05), 2.0)
        residuals = root * (moment[usable] - matrix @ solution)
        results.append((float(solution[0]), float(solution[1]), float(residuals @ residuals)))
        laws.append(law)
        if len(results) == 1 or results[-1][2] <= min(r[2] for r in results[:-1]):
            best = residuals
    inertia, resistance, misfit = np.array(results).T
    following = float(np.clip(best[1:] @ best[:-1] / (best @ best), 0.0, 0.95))
    scale = max(misfit.min() / len(best), 1.0) * (1.0 + following) / (1.0 - following)
    scale *= TEMPERED
    chance = np.exp(-0.5 * (misfit - misfit.min()) / scale)
    chance /= chance.sum()
    mean = float(chance @ resistance)
    law = sum(p * c * of for p, c, of in zip(chance, resistance, laws, strict=True))

    def spread(of: Floats) -> float:
        middle = float(chance @ of)
        variance = float(chance @ (of - middle) ** 2) + (TRUSTED * (middle - of[0])) ** 2
        return math.sqrt(variance) / max(abs(middle), 1e-9)

    excess = np.nan_to_num(np.asarray(law) - mean * laws[0])
    width = float(candidates[int(np.argmax(chance))][0])
    return Turning(excess, spread(inertia), spread(resistance), width)
