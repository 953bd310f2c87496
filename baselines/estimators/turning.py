"""Yaw inertia and lateral resistance from the turning motion.

    M = I dw/dt + C g f S(v_y, w),    C = m mu_t,   M = (B/2) [(F_R - R_R) - (F_L - R_L)]
S is the moment of the lateral friction per weight and mu_t, f the turning resistance factor. The
soil's resistance grows with m mu_t, hence that product is estimated and handed out divided by
the mass in use. R_L, R_R cancel unless the tracks move in opposite directions.
    sliding      S from the closed form of the friction (terramechanics); v_y from the lateral
                 accelerometer, a_y = -mu_t g v_y / (|w| l / 2) inside the contact
    constrained  S = sign(w) (l^2/4 - d^2) / l, and the terms of S (28): I + m d^2, m d w v_x, F_y d
The regressor of S 7.1.2 has the wrong sign and the factor 2; here it has f.
Variance of the equation: torque sensors, yaw acceleration, and the gyro times the slope of S,
which is steep on the straight: there a sample weighs next to nothing.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import least_squares as ls
from baselines.estimators.estimate import Estimate
from baselines.estimators.longitudinal import PAPER_FORGETTING
from baselines.estimators.measurement import COLUMN, DRIVE, INERTIAL, DataSheet, Measurement
from baselines.estimators.two_parameters import (
    ANSWER,
    HOLDING,
    P_12,
    P_22,
    REJECTED,
    SLOWEST,
    VALUE_2,
    TwoParameterEstimator,
    answer,
    checked_forgetting,
    read_all,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters

# At 50 Hz: inertia remembers 80 s, lateral resistance 1 s.
INERTIA_FORGETTING = 0.9995
FRICTION_FORGETTING = 0.9
INERTIA_SIGMA = 0.4  # [-] of the nominal inertia: prior standard deviation
FRICTION_SIGMA = 0.4  # [-] of the nominal m mu_t
INERTIA_FACTOR = 6.0  # [-] inertia is sought between nominal / factor and nominal * factor
MODEL_NOISE = 20.0  # [N m] of the equation itself

_V_X, _W = COLUMN["v_x"], COLUMN["yaw_rate"]
_A_Y, _BEND, _TORQUE = COLUMN["acceleration_y"], COLUMN["yaw_acceleration"], COLUMN["torque_left"]


class Known(NamedTuple):
    """Constants of the yaw equation."""

    inverse_radius: float  # [1/m] 1/r
    half_gauge: float  # [m] B/2
    contact_length: float  # [m] l
    turning_resistance_factor: float  # [-] f
    icr_forward: float  # [m] d, of the constrained closure
    moment_variance: float  # [N^2 m^2] torque sensors and model
    bend_variance: float  # [rad^2/s^4] of dw/dt
    turn_variance: float  # [rad^2/s^2] of w
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
def equation(z, i, known, mass, resistance, friction, inertia):
    """The Sample of vehicle i, and whether the tracks move.

    mass m [kg], resistance mu_l [-], friction m mu_t [kg] and inertia [kg m^2] as known so far.
    """
    v_x, w = z[i, _V_X], z[i, _W]
    left, right = v_x - w * known.half_gauge, v_x + w * known.half_gauge
    # Both tracks forward: the sides cancel.
    side = 0.5 * (math.copysign(1.0, right) - math.copysign(1.0, left))
    rolling = side * resistance * mass * soil.GRAVITY
    drive = (z[i, _TORQUE + 1] - z[i, _TORQUE]) * known.inverse_radius
    y = known.half_gauge * (drive - rolling)
    d = known.icr_forward
    if known.constrained:
        v_y = 0.0
        y += mass * d * (w * v_x - d * z[i, _BEND])
        sign = saturated_sign(w, 1.0 / soil.YAW_FRICTION_REGULARISATION)
        extra = 2.0 * soil.GRAVITY / known.contact_length * d * d * sign
    else:
        half = 0.5 * known.contact_length * abs(w)
        v_y = -z[i, _A_Y] * half * mass / (max(friction, 0.1 * mass) * soil.GRAVITY)
        v_y = min(max(v_y, -0.8 * half), 0.8 * half)
        extra = 0.0
    factor = known.turning_resistance_factor
    shape = factor * unit_moment(v_y, w, known) + extra
    probe = math.sqrt(known.turn_variance)
    slope = factor * (
        unit_moment(v_y, abs(w) + probe, known) - unit_moment(v_y, abs(w) - probe, known)
    )
    variance = (
        known.moment_variance
        + inertia * inertia * known.bend_variance
        + 0.25 * friction * friction * slope * slope
    )
    return ls.Sample(y, z[i, _BEND], shape, variance, known.bend_variance), min(
        abs(left), abs(right)
    ) > SLOWEST


@loop
def update_all(z, fresh, memory, prior, known, mass, resistance, out):
    """One sample of every vehicle: z (N, 13), fresh (N, 3), memory (N, MEMORY) in and out,
    mass and mu_l (N,) as known."""
    for i in range(z.shape[0]):
        status, nis = HOLDING, np.nan
        if fresh[i, INERTIAL] and fresh[i, DRIVE]:
            inertia, friction = ls.values(memory, i, prior)
            sample, moving = equation(z, i, known, mass[i], resistance[i], friction, inertia)
            if not math.isfinite(sample.y + sample.phi_1 + sample.phi_2 + sample.variance):
                memory[i, ls.SKIPPED] += 1.0
                status = REJECTED
            elif moving:
                status, nis = ls.step(memory, i, sample, prior)
        answer(memory, i, prior, status, nis, out)


class TurningEstimator(TwoParameterEstimator):
    """Estimates [I, mu_t] of N vehicles; see the head of the file.

    mass, mass_variance, resistance: arrays (N,) that the owner keeps up to date; they start
    at the nominal values with variance 0. lateral: closure, "sliding" or "constrained".
    forgetting: (inertia, friction) factors per sample; regression "paper" takes 0.998 for
    both and searches no changes, "coupled" (default) takes those of this file.
    """

    names = ("inertia", "lateral_resistance")
    _kernel = update_all

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        regression: str = "coupled",
        forgetting: tuple[float, float] | None = None,
        follows_changes: bool | None = None,
    ) -> None:
        if lateral not in ("sliding", "constrained"):
            raise ValueError(f"lateral = {lateral!r}; must be 'sliding' or 'constrained'")
        if regression not in ("coupled", "paper"):
            raise ValueError(f"regression = {regression!r}; must be 'coupled' or 'paper'")
        coupled = regression == "coupled"
        if forgetting is None:
            forgetting = (PAPER_FORGETTING,) * 2
            if coupled:
                forgetting = (INERTIA_FORGETTING, FRICTION_FORGETTING)
        for factor in forgetting:
            checked_forgetting("forgetting", factor)
        inertia = parameters.inertia
        friction = parameters.mass * parameters.lateral_resistance
        limit = RANGES["lateral_resistance"].high
        prior = ls.Prior(
            inertia, friction, INERTIA_SIGMA * inertia, FRICTION_SIGMA * friction,
            inertia / INERTIA_FACTOR, 0.02 * friction,
            inertia * INERTIA_FACTOR, limit * INERTIA_FACTOR * parameters.mass,
            *forgetting, False, coupled if follows_changes is None else follows_changes,
        )  # fmt: skip
        super().__init__(parameters, control_period, data_sheet, count, prior)
        sheet, p = self.data_sheet, self.parameters
        effort = sheet.torque_noise / p.sprocket_radius
        self._known = Known(
            1.0 / p.sprocket_radius,
            0.5 * p.track_gauge,
            p.contact_length,
            p.turning_resistance_factor,
            p.icr_forward,
            2.0 * (0.5 * p.track_gauge * effort) ** 2 + MODEL_NOISE**2,
            sheet.yaw_acceleration_noise**2,
            sheet.gyro_noise**2 + sheet.gyro_bias**2 + 1e-8,
            lateral == "constrained",
        )
        self.mass = np.full(count, p.mass)
        self.mass_variance = np.zeros(count)
        self.resistance = np.full(count, p.longitudinal_resistance)

    def known(self) -> tuple[Any, ...]:
        """Constants of the equation, and what the longitudinal estimator knows."""
        return self._known, self.mass, self.resistance

    def estimate(self, out: NDArray[np.float64]) -> Estimate:
        """Divide m mu_t by the mass in use; the mass' uncertainty adds to that of mu_t."""
        out[:, VALUE_2] = np.clip(
            out[:, VALUE_2] / self.mass, 0.0, RANGES["lateral_resistance"].high
        )
        out[:, P_12] /= self.mass
        relative = self.mass_variance / self.mass**2
        out[:, P_22] = out[:, P_22] / self.mass**2 + out[:, VALUE_2] ** 2 * relative
        return super().estimate(out)
