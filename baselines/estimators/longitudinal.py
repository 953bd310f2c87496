"""Mass and motion resistance from the longitudinal motion.

    a_x = (F_L + F_R) / m - g mu_l (s_L + s_R) / 2,    F = torque / r,  s = sign(v_track)
a_x is what the accelerometer feels, dv_x/dt - w v_y, so the coupling with lateral and yaw motion
is in it, and each track has its own resistance: `coupled`, exact in curves too. On a slope the
accelerometer feels dv_x/dt - w v_y - g sin(pitch), and m times that is what traction and resistance
add up to: gravity stays in a_x, where it excites the mass; the normal load alone changes,
g cos(pitch) cos(roll) for g. S 7.1.2 assumes longitudinal motion: its regression takes dv_x/dt for
a_x and s_L = s_R = sign(v_x).
Variance of the equation: accelerometer and torque sensors. Tracks slower than SLOWEST are left
out: there s is not yet +-1.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2, its suggestion in 8.3.1.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import COLUMN, DRIVE, HOLDING, INERTIAL, REJECTED, Quantity
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES
from tracked_env.physics.rigid_body import incline_of

# Models of interacting_models, with walks [1/sqrt(s)] of 1/m, relative, and of mu_l.
WALKS = {
    im.CALM: (0.0, 0.005),
    im.FAST: (0.005, 0.2),
    im.BORDER: (0.0, 0.8),
    im.JUMP: (3.0, 0.01),
    im.ALARMED: (0.04, 0.08),
    im.SLOW: (0.0, 0.003),
}
SOIL_ALARM = (0.0, 0.08)  # in an alarm, where no other equation tells load and soil apart
TREND_GATE = 2.0  # [-] square of the mean, which the large variance of the equation keeps small
INVERSE_MASS_SIGMA = 0.4  # [-] of the nominal 1/m: prior standard deviation
RESISTANCE_SIGMA = 0.3  # [-] prior standard deviation of mu_l
MASS_FACTOR = 5.0  # [-] mass is sought between nominal / factor and nominal * factor
SLIDING = 0.8  # [-] slip from which on belts tell neither the speed of a track nor its sign
TORQUE_MARGIN = 1.5  # [-] of the drives' limit: a larger torque is not one, and would weigh much
SLOWEST = 0.2  # [m/s] slower tracks may be held by the soil, and say nothing about it
MODEL_NOISE = 0.02  # [m/s^2] of the equation itself: what the model leaves out

_V_X, _V_Y, _W = COLUMN["v_x"], COLUMN["v_y"], COLUMN["yaw_rate"]
_A_X, _TORQUE = COLUMN["acceleration_x"], COLUMN["torque_left"]
_SPROCKET = COLUMN["sprocket_speed_left"]


class Constants(NamedTuple):
    """Constants of the longitudinal equation."""

    inverse_radius: float  # [1/m] 1/r
    half_gauge: float  # [m] B/2
    inverse_mass: float  # [1/kg] nominal, for the variance
    acceleration_variance: float  # [m^2/s^4] accelerometer and model
    effort_variance: float  # [N^2] of F_L + F_R
    largest_torque: float  # [N m] that can be
    slowest: float  # [m/s] slower tracks are left out
    coupled: bool


@formula
def _sliding(belt, track):
    """Whether a belt spins, is locked or runs against its track [m/s]: then neither the filtered
    speed nor its sign is reliable."""
    return abs(belt - track) > SLIDING * max(abs(belt), abs(track))


@formula
def equation(z, i, k, press):
    """The Sample of vehicle i from its measurement z (N, 13), and whether the tracks move. press:
    [-] normal load over the weight."""
    v_x, w = z[i, _V_X], z[i, _W]
    left, right = v_x - w * k.half_gauge, v_x + w * k.half_gauge
    force = (z[i, _TORQUE] + z[i, _TORQUE + 1]) * k.inverse_radius
    slowest = min(abs(left), abs(right)) if k.coupled else abs(v_x)
    belt_left = z[i, _SPROCKET] / k.inverse_radius
    belt_right = z[i, _SPROCKET + 1] / k.inverse_radius
    doubt = k.coupled and (_sliding(belt_left, left) or _sliding(belt_right, right))
    if k.coupled:
        y = z[i, _A_X]
        side = 0.5 * (math.copysign(1.0, left) + math.copysign(1.0, right))
    else:
        y = z[i, _A_X] + w * z[i, _V_Y]
        side = math.copysign(1.0, v_x)
    scale = k.inverse_mass * k.inverse_mass
    variance = k.acceleration_variance + scale * k.effort_variance
    return ls.Sample(
        y, force, -soil.GRAVITY * press * side, variance, k.effort_variance
    ), slowest > k.slowest and not doubt


@loop
def update_all(samples, rows, prior, table, k, out):
    """One sample of every vehicle: samples z (N, 13), fresh and attitude (N, 3); the rows (N,) of
    the memory are changed, the answers (N,) written."""
    z, fresh, attitude = samples
    for i in range(z.shape[0]):
        row, status, nis = rows[i], HOLDING, np.nan
        if fresh[i, INERTIAL] and fresh[i, DRIVE]:
            press = incline_of(attitude[i, 1], attitude[i, 0]).press
            sample, moving = equation(z, i, k, press)
            total = sample.y + sample.phi_1 + sample.phi_2 + z[i, _V_X] + z[i, _W]
            if not math.isfinite(total):
                row.skipped += 1.0
                status = REJECTED
            elif max(abs(z[i, _TORQUE]), abs(z[i, _TORQUE + 1])) > k.largest_torque:
                status = REJECTED
            elif moving:
                status, nis = im.take(row, sample, prior, table)
        im.write_answer(row, prior, status, nis, out[i])


class LongitudinalEstimator(im.TwoParameterEstimator):
    """Estimates [1/m, mu_l] of N vehicles; see the head of the file.

    With the sliding lateral model the equation of the side slip tells load and soil apart; without
    it a slow trend is taken for one of the soil.
    """

    names = ("inverse_mass", "longitudinal_resistance")
    provides = (
        Quantity("mass", "kg", "mass", inverse_of="inverse_mass"),
        Quantity("longitudinal_resistance", "-"),
    )
    needs = ("v_x", "v_y", "yaw_rate", "acceleration_x", "torque_left", "torque_right")
    kernel = update_all

    def __init__(self, *setting: Any, **named: Any) -> None:
        super().__init__(*setting, **named)
        p, sheet = self.parameters, self.data_sheet
        nominal, limits = 1.0 / p.mass, RANGES["longitudinal_resistance"]
        self.prior = ls.Prior(
            nominal, p.longitudinal_resistance, INVERSE_MASS_SIGMA * nominal, RESISTANCE_SIGMA,
            nominal / MASS_FACTOR, limits.low, nominal * MASS_FACTOR, limits.high, im.FORGETTING,
        )  # fmt: skip
        walks = WALKS if self.lateral == "sliding" else {**WALKS, im.ALARMED: SOIL_ALARM}
        self.table = im.table(walks, TREND_GATE, RESISTANCE_SIGMA, self.control_period)
        effort = sheet.torque_noise / p.sprocket_radius
        self._constants = Constants(
            inverse_radius=1.0 / p.sprocket_radius,
            half_gauge=0.5 * p.track_gauge,
            inverse_mass=nominal,
            acceleration_variance=sheet.acceleration_noise**2 + MODEL_NOISE**2,
            effort_variance=2.0 * effort * effort,
            largest_torque=TORQUE_MARGIN * p.torque_limit,
            slowest=SLOWEST,
            coupled=True,
        )

    def bounds(self) -> dict[str, tuple[float, float]]:
        """(low, high) between which each parameter is sought, by name."""
        p = self.prior
        return {
            "mass": (1.0 / p.high_1, 1.0 / p.low_1),
            "longitudinal_resistance": (p.low_2, p.high_2),
        }

    def residual(self, values: NDArray[np.float64], mass: float, resistance: float) -> float:
        """Residual of one vehicle's sample (1, 13) on level ground with these parameters, over its
        standard deviation; NaN where the sample says nothing."""
        sample, usable = equation(values, 0, self._constants, 1.0)
        error = sample.y - sample.phi_1 * (1.0 / mass) - sample.phi_2 * resistance
        return error / math.sqrt(sample.variance) if usable else math.nan
