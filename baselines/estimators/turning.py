"""Yaw inertia and lateral resistance from the turning motion.

    M = I dw/dt + C g f S(v_y, w),    C = m mu_t,   M = (B/2) [(F_R - R_R) - (F_L - R_L)]
S is the moment of the lateral friction per weight and mu_t, f the turning resistance factor. The
soil's resistance grows with m mu_t, hence that product is estimated and handed out divided by
the mass in use. R_L, R_R cancel unless the tracks move in opposite directions.
    sliding      S from the closed form of the friction (terramechanics); v_y from the lateral
                 accelerometer, a_y = -mu_t g v_y / (|w| l / 2) inside the contact. That v_y
                 depends on mu_t: the regressor is d(C S)/dC, and y is shifted to match
    constrained  S = sign(w) (l^2/4 - d^2) / l, and the terms of S (28): I + m d^2, m d w v_x, F_y d
The regressor of S 7.1.2 has the wrong sign and the factor 2; here it has f.
Variance of the equation: torque sensors, yaw acceleration, gyro and lateral accelerometer times
the slopes of S. On the straight S is steep, and its friction not that of a turning vehicle:
samples below a least yaw rate are left out, or noise would be taken for turning.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import least_squares as ls
from baselines.estimators.estimate import Estimate, Estimator, Quantity, Setting
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.sensor_samples import COLUMN, DRIVE, INERTIAL, DataSheet
from baselines.estimators.two_parameters import (
    HOLDING,
    P_12,
    P_22,
    REJECTED,
    SLOWEST,
    TORQUE_MARGIN,
    VALUE_2,
    TwoParameterEstimator,
    answer,
    as_printed,
    tuning,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.validation import CONTROL_PERIOD, checked_number

FORGETTING = 0.9995  # [-] per sample: at 50 Hz 40 s
FRICTION_DRIFT = 0.02  # [1/sqrt(s)] random walk of m mu_t, of its nominal value
INERTIA_SIGMA = 0.4  # [-] of the nominal inertia: prior standard deviation
FRICTION_SIGMA = 0.4  # [-] of the nominal m mu_t
INERTIA_FACTOR = 6.0  # [-] inertia is sought between nominal / factor and nominal * factor
MODEL_NOISE = 20.0  # [N m] of the equation itself
SAME_WEIGHT = 1e6  # [N^2 m^2] variance of every sample, regression "printed": any number will do
ITERATIONS = 3  # [-] for v_y; the first is exact in fast turns
EPS2 = soil.LATERAL_FRICTION_REGULARISATION**2  # [m^2/s^2]
LEAST_FRICTION = 0.1  # [-] mu_t of which v_y is still found
INSIDE = 0.8  # [-] of the half contact: the ICR is sought inside it

_V_X, _W = COLUMN["v_x"], COLUMN["yaw_rate"]
_A_Y, _BEND, _TORQUE = COLUMN["acceleration_y"], COLUMN["yaw_acceleration"], COLUMN["torque_left"]


class Known(NamedTuple):
    """Constants of the yaw equation."""

    inverse_radius: float  # [1/m] 1/r
    half_gauge: float  # [m] B/2
    contact_length: float  # [m] l
    turning_resistance_factor: float  # [-] f
    icr_forward: float  # [m] d, of the constrained lateral model
    moment_variance: float  # [N^2 m^2] torque sensors and model
    bend_variance: float  # [rad^2/s^4] of dw/dt
    turn_variance: float  # [rad^2/s^2] of w
    side_noise: float  # [m/s^2] sigma of the lateral accelerometer
    least_turn: float  # [rad/s] slower turns are left out
    slowest: float  # [m/s] slower tracks are left out
    largest_torque: float  # [N m] that can be
    constrained: bool


@formula
def unit_moment(v_y, w, known):
    """S(v_y, w) g [m^2/s^2], positive for w > 0: friction moment per m mu_t, factor apart."""
    length = known.contact_length
    if known.constrained:
        d = known.icr_forward
        arm = max(0.25 * length * length - d * d, 0.0)
        sign = saturated_sign(w, 1.0 / soil.YAW_FRICTION_REGULARISATION)
        return soil.GRAVITY / length * arm * sign
    _force, moment = soil.lateral_friction(v_y, w, soil.GRAVITY / length, length)
    return -moment


@formula
def lever(v_y, half):
    """-v_y mu_t g / a_y [m/s] of the regularised friction; half = w l / 2 [m/s]."""
    rear, front = v_y - half, v_y + half
    e_rear, e_front = math.sqrt(rear * rear + EPS2), math.sqrt(front * front + EPS2)
    return (e_rear + e_front) / (2.0 + EPS2 / (e_rear * e_front))


@formula
def sideways(a_y, w, weight_share, known):
    """(v_y [m/s], C dS/dC, what the noise of a_y does to S) g of the sliding lateral model.

    a_y [m/s^2] as measured, weight_share m / C = 1 / mu_t [-].
    """
    half = 0.5 * known.contact_length * w
    share = weight_share / soil.GRAVITY
    inside = INSIDE * math.sqrt(half * half + EPS2)
    v_y, free, per_acceleration = 0.0, 0.0, 0.0
    for _ in range(ITERATIONS):
        per_acceleration = share * lever(v_y, half)
        free = -a_y * per_acceleration
        v_y = min(max(free, -inside), inside)
    step = max(known.side_noise * per_acceleration, 1e-3 * inside)
    change = 0.5 * (unit_moment(v_y + step, w, known) - unit_moment(v_y - step, w, known))
    return v_y, -change * v_y / step if abs(free) < inside else 0.0, change


@formula
def equation(z, i, known, mass, resistance, friction, inertia):
    """The Sample of vehicle i, and whether it moves and turns.

    mass m [kg], resistance mu_l [-], friction m mu_t [kg] and inertia [kg m^2] as known so far.
    """
    v_x, w = z[i, _V_X], z[i, _W]
    left, right = v_x - w * known.half_gauge, v_x + w * known.half_gauge
    # Both tracks forward: the resistances cancel.
    opposite = 0.5 * (math.copysign(1.0, right) - math.copysign(1.0, left))
    rolling = opposite * resistance * mass * soil.GRAVITY
    y = known.half_gauge * ((z[i, _TORQUE + 1] - z[i, _TORQUE]) * known.inverse_radius - rolling)
    v_y, shift, side, across = 0.0, 0.0, 0.0, 0.0
    if known.constrained:
        d = known.icr_forward
        y += mass * d * (w * v_x - d * z[i, _BEND])
        sign = saturated_sign(w, 1.0 / soil.YAW_FRICTION_REGULARISATION)
        across = 2.0 * soil.GRAVITY / known.contact_length * d * d * sign
    else:
        weight_share = mass / max(friction, LEAST_FRICTION * mass)
        v_y, shift, side = sideways(z[i, _A_Y], w, weight_share, known)
    factor = known.turning_resistance_factor
    turn = math.sqrt(known.turn_variance)
    slope = 0.5 * (unit_moment(v_y, w + turn, known) - unit_moment(v_y, w - turn, known))
    spread = factor * friction
    variance = (
        known.moment_variance
        + inertia * inertia * known.bend_variance
        + spread * spread * (slope * slope + side * side)
    )
    usable = min(abs(left), abs(right)) > known.slowest and abs(w) > known.least_turn
    regressor = factor * (unit_moment(v_y, w, known) + shift) + across
    return ls.Sample(
        y + factor * shift * friction, z[i, _BEND], regressor, variance, known.bend_variance
    ), usable


@loop
def update_all(z, fresh, memory, prior, known, mass, resistance, out):
    """One sample of every vehicle: z (N, 13), fresh (N, 3), memory (N, MEMORY) in and out,
    mass and mu_l (N,) as known."""
    for i in range(z.shape[0]):
        status, nis = HOLDING, np.nan
        if fresh[i, INERTIAL] and fresh[i, DRIVE]:
            inertia, friction = ls.values(memory, i, prior)
            sample, moving = equation(z, i, known, mass[i], resistance[i], friction, inertia)
            seen = sample.y + sample.phi_1 + sample.phi_2 + sample.variance
            if not math.isfinite(seen + z[i, _V_X]):
                memory[i, ls.SKIPPED] += 1.0
                status = REJECTED
            elif max(abs(z[i, _TORQUE]), abs(z[i, _TORQUE + 1])) > known.largest_torque:
                status = REJECTED
            elif moving:
                status, nis = ls.step(memory, i, sample, prior)
        answer(memory, i, prior, status, nis, out)


@loop
def hand_on(memory, jumps, value, covariance, mass, variance, resistance, jumped):
    """What the longitudinal estimator knows, for this one: (N,) arrays, the last four out.

    jumps (N,): how often the mass had jumped before this sample. Returns whether any has now.
    """
    some = False
    for i in range(memory.shape[0]):
        mass[i] = 1.0 / value[i, 0]
        variance[i] = covariance[i, 0, 0] * mass[i] ** 4
        resistance[i] = value[i, 1]
        jumped[i] = memory[i, ls.JUMPS] > jumps[i]
        some = some or jumped[i]
    return some


class TurningEstimator(TwoParameterEstimator):
    """Estimates [I, mu_t] of N vehicles; see the head of the file.

    mass, mass_variance, resistance: arrays (N,) that the owner keeps up to date; they start
    at the nominal values with variance 0. lateral: lateral model, "sliding" or "constrained".
    forgetting: factor per sample. drift [1/sqrt(s)]: random walk of m mu_t. None takes the
    defaults of the regression; "paper" and "printed" have lambda = 0.998, no walk, and search no
    changes; "printed" has the constrained lateral model alone.
    """

    names = ("inertia", "lateral_resistance")
    provides = (
        Quantity("inertia", "kg m^2", "inertia"),
        Quantity("lateral_resistance", "-"),
    )
    needs = (
        "v_x", "yaw_rate", "acceleration_y", "yaw_acceleration", "torque_left", "torque_right",
        "mass", "longitudinal_resistance",
    )  # fmt: skip
    _kernel = update_all

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        regression: str = "coupled",
        forgetting: float | None = None,
        drift: float | None = None,
        follows_changes: bool | None = None,
    ) -> None:
        if lateral not in ("sliding", "constrained"):
            raise ValueError(f"lateral = {lateral!r}; must be 'sliding' or 'constrained'")
        printed = regression == "printed"
        if printed and lateral != "constrained":
            raise ValueError(
                f"regression = 'printed' with lateral = {lateral!r}; must be 'constrained': "
                "S 7.1.2 knows no lateral motion but that of a fixed ICR"
            )
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        forgetting, drift, follows_changes = tuning(
            regression, forgetting, drift, follows_changes, (FORGETTING, FRICTION_DRIFT)
        )
        walk = drift * drift * control_period / FRICTION_SIGMA**2
        inertia = parameters.inertia
        friction = parameters.mass * parameters.lateral_resistance
        limit = RANGES["lateral_resistance"].high
        prior = ls.Prior(
            inertia, friction, INERTIA_SIGMA * inertia, FRICTION_SIGMA * friction,
            inertia / INERTIA_FACTOR, 0.02 * friction,
            inertia * INERTIA_FACTOR, limit * INERTIA_FACTOR * parameters.mass,
            forgetting, walk, False, follows_changes,
        )  # fmt: skip
        super().__init__(
            parameters, control_period, data_sheet, count, as_printed(prior) if printed else prior
        )
        sheet, p = self.data_sheet, self.parameters
        effort = sheet.torque_noise / p.sprocket_radius
        self._known = Known(
            1.0 / p.sprocket_radius,
            0.5 * p.track_gauge,
            p.contact_length,
            p.turning_resistance_factor,
            p.icr_forward,
            SAME_WEIGHT if printed else 2.0 * (0.5 * p.track_gauge * effort) ** 2 + MODEL_NOISE**2,
            0.0 if printed else sheet.yaw_acceleration_noise**2,
            0.0 if printed else sheet.gyro_noise**2 + sheet.gyro_bias**2 + 1e-8,
            sheet.acceleration_noise,
            soil.YAW_FRICTION_REGULARISATION
            if lateral == "constrained"
            else 2.0 * soil.LATERAL_FRICTION_REGULARISATION / p.contact_length,
            -1.0 if printed else SLOWEST,
            math.inf if printed else TORQUE_MARGIN * p.torque_limit,
            lateral == "constrained",
        )
        self._bounds = (-math.inf, math.inf) if printed else (0.0, limit)
        self.mass = np.full(count, p.mass)
        self.mass_variance = np.zeros(count)
        self.resistance = np.full(count, p.longitudinal_resistance)

    @classmethod
    def for_stack(cls, setting: Setting) -> "TurningEstimator":
        """As a part of the identification stack."""
        s = setting
        return cls(
            s.parameters, s.control_period, s.data_sheet, s.count, s.lateral, s.regression
        )  # fmt: skip

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Mass and mu_l; when the mass has jumped, the inertia is let go: payload changes both."""
        source, known = parts["longitudinal"], estimates["longitudinal"]
        assert isinstance(source, LongitudinalEstimator)
        jumped = np.empty(len(self.memory), dtype=bool)
        if hand_on(
            source.memory, source.jumps_before, known.value, known.covariance,
            self.mass, self.mass_variance, self.resistance, jumped,
        ):  # fmt: skip
            self.release_inertia(jumped)

    def release_inertia(self, rows: NDArray[np.bool_]) -> None:
        """Forget what the data said of the inertia and friction of the vehicles marked (N,)."""
        for column in (ls.J_11, ls.J_12, ls.J_22):
            self.memory[rows, column] = 0.0

    def known(self) -> tuple[Any, ...]:
        """Constants of the equation, and what the longitudinal estimator knows."""
        return self._known, self.mass, self.resistance

    def estimate(self, out: NDArray[np.float64]) -> Estimate:
        """Divide m mu_t by the mass in use; the mass' uncertainty adds to that of mu_t."""
        out[:, VALUE_2] = np.clip(out[:, VALUE_2] / self.mass, *self._bounds)
        out[:, P_12] /= self.mass
        relative = self.mass_variance / self.mass**2
        out[:, P_22] = out[:, P_22] / self.mass**2 + out[:, VALUE_2] ** 2 * relative
        return super().estimate(out)
