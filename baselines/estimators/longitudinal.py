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

The mass from the steady side slip of a turning vehicle, one more equation of it (`SideslipRow`):

    a_y = -2 g C v_y / (m (e_rear + e_front)),    C = m mu_t
is the sum of the lateral friction under both tracks; what stands for |w| l is the lever of
turning_equation, regularised as the friction is. C is known of the turning regression, which needs
no mass for it, and v_y and a_y are measured. So
    v_y = k / (1/m),    k = -a_y lever / (C g)
is one more equation on 1/m, and the only one that tells mass from motion resistance when both
change slowly. Its variance: velocity, lateral accelerometer with its bias, C, and the equation
itself, whose error lasts for ERROR_TIME: a sample counts that much less.
It holds where friction is that of the lumped lateral model; elsewhere it would falsify the mass. So
it is used where the belts turn as the vehicle does: a slip share (see turning) below FIRM leaves
friction nothing to share. On other soils it is compared with the longitudinal regression while
nothing changes, and used where the ratio of measured to expected v_y speaks for it by AGREES: its
likelihood, normal about 1, over that of any ratio between 0 and 1. The turning regression uses this
agreement in its claim of the inertia.
Where the equation holds, C is a property of vehicle and soil, and an evident trend of C (see
interacting_models) says that the mass may change as well: it raises the alarm of the longitudinal
regression, which by itself cannot see a mass that grows while the resistance falls. Elsewhere C
changes with slip and turn alone.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 3 (lateral
friction), 7.1.2, its suggestion in 8.3.1.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.interacting_models import TwoParameterEstimator
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    HOLDING,
    INERTIAL,
    POSE,
    REJECTED,
    SLOWEST,
    TORQUE_MARGIN,
    Measurement,
    Quantity,
    Rows,
    Setting,
    Stateful,
    columns_of,
)
from baselines.estimators.turning import lever, slip_share
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import BoundOnce, formula, loop
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


# --- the side slip ----------------------------------------------------------------------------
LEAST_TURN = 0.1  # [rad/s] slower turns say nothing
LEAST_SPEED = 0.3  # [m/s] of the vehicle, forward
INSIDE = 0.6  # [-] of the half contact: the ICR must lie inside it
ERROR = 0.03  # [-] of the equation, relative
ERROR_TIME = 10.0  # [s] for which that error lasts
RATIO_TIME = 15.0  # [s] of calm time over which the equation is compared
CALM_ODDS = 0.5  # [-] of the calm model, from which on the time is calm
FIRM = 0.05  # [-] slip share up to which the equation needs no proof
AGREES = 2.0  # [-] agreement from which on it is used elsewhere

_A_Y = COLUMN["acceleration_y"]
SIDESLIP_ROW = np.dtype([("square", float), ("product", float)])  # weighted sums for the ratio


class SideslipConstants(NamedTuple):
    """SideslipConstants of the equation."""

    half_length: float  # [m] l / 2
    velocity_variance: float  # [m^2/s^2] of v_y
    acceleration_variance: float  # [m^2/s^4] of a_y, with its bias
    lasting: float  # [-] samples for which an error of the equation lasts
    keep: float  # [-] share of the sums for the ratio that is left after a sample


@formula
def expected(z, i, k, inverse_mass, friction, friction_variance, press):
    """(v_y [m/s] as the equation expects it, its variance) of vehicle i. inverse_mass [1/kg],
    friction C = m mu_t [kg] with its variance. press: [-] normal load over the weight."""
    factor = lever(z[i, _V_Y], k.half_length * z[i, _W])
    a_y, per_acceleration = z[i, _A_Y], factor / (friction * soil.GRAVITY * press * inverse_mass)
    v_y = -a_y * per_acceleration
    relative = friction_variance / (friction * friction) + ERROR * ERROR * k.lasting
    variance = (
        k.velocity_variance
        + per_acceleration * per_acceleration * k.acceleration_variance
        + v_y * v_y * relative
    )
    return v_y, variance


@formula
def _agreement(row):
    """Likelihood of the measured ratio where the equation holds, over that where it does not [-].
    There any ratio in [0, 1] is as likely as another. 0 before the first sample."""
    if row.square <= 0.0:
        return 0.0
    off = row.product / row.square - 1.0
    return math.sqrt(row.square / (2.0 * math.pi)) * math.exp(-0.5 * off * off * row.square)


@formula
def _usable(z, i, fresh, age, k):
    """Whether velocity and acceleration are of one moment, of a vehicle that turns forward."""
    together = fresh[i, POSE] and fresh[i, INERTIAL] and age[i, POSE] == age[i, INERTIAL]
    v_x, v_y, w = z[i, _V_X], z[i, _V_Y], z[i, _W]
    inside = abs(v_y) < INSIDE * k.half_length * abs(w)
    finite = math.isfinite(v_x + v_y + w + z[i, _A_Y])
    return together and finite and inside and v_x > LEAST_SPEED and abs(w) > LEAST_TURN


@loop
def compare_all(samples, rows, longitudinal, prior, turning, turning_prior, table, k):
    """One sample of every vehicle: samples z (N, CHANNELS), fresh, age and attitude (N, 3); rows
    (N,) and those of the two regressions are changed; table: of the turning regression."""
    z, fresh, age, attitude = samples
    for i in range(z.shape[0]):
        straight, turn = longitudinal[i], turning[i]
        if not (straight.odds[0] > 0.0 and turn.odds[0] > 0.0 and _usable(z, i, fresh, age, k)):
            continue
        press = incline_of(attitude[i, 1], attitude[i, 0]).press
        inverse_mass, _resistance = ls.values(straight.estimates[0], prior)
        _inertia, friction = ls.values(turn.estimates[0], turning_prior)
        _i_i, _i_c, c_c = ls.covariance(turn.estimates[0], turning_prior)
        model, variance = expected(z, i, k, inverse_mass, friction, c_c, press)
        if straight.alarm <= 0.0 and turn.alarm <= 0.0 and straight.odds[im.CALM] > CALM_ODDS:
            # The monitor's mass does not use this equation: an independent check. Its error lasts.
            independent, p_11 = im.watched(straight, prior)
            relative = p_11 / (independent * independent)
            by_monitor = model * inverse_mass / independent
            weight = 1.0 / (variance + by_monitor * by_monitor * relative * k.lasting)
            rows[i].square = k.keep * rows[i].square + by_monitor * by_monitor * weight
            rows[i].product = k.keep * rows[i].product + by_monitor * z[i, _V_Y] * weight
        turn.agreement = _agreement(rows[i])
        firm = turn.turned > 0.0 and slip_share(turn) < FIRM
        holds = firm or turn.agreement >= AGREES
        if holds and im.evident(turn, table):
            straight.alarm = max(straight.alarm, turn.alarm)
        slope = -model / inverse_mass
        sample = ls.Sample(z[i, _V_Y] - model + slope * inverse_mass, slope, 0.0, variance, 0.0)
        error, gain = ls.innovation(straight.estimates[0], sample, prior)
        if error * error < im.OUTLIER_GATE * (gain + variance) and holds:
            im.learn_apart(straight, sample, prior)


class SideslipRow(Stateful):
    """The equation for N vehicles; see the head of the file. It changes the longitudinal memory."""

    rows = Rows("memory", SIDESLIP_ROW)

    def __init__(self, setting: Setting) -> None:
        period, sheet = setting.control_period, setting.data_sheet
        self.memory = np.zeros((setting.count, columns_of(SIDESLIP_ROW)))
        self._compute = BoundOnce(compare_all)
        self._constants = SideslipConstants(
            0.5 * float(setting.parameters.contact_length),
            sheet.velocity_noise**2,
            sheet.acceleration_noise**2 + sheet.acceleration_bias**2,
            ERROR_TIME / period,
            1.0 - min(period / RATIO_TIME, 1.0),
        )

    def compute(
        self,
        latest: Measurement,
        longitudinal: TwoParameterEstimator,
        turning: TwoParameterEstimator,
    ) -> None:
        """Take one sample of every vehicle."""
        samples = latest.values, latest.fresh, latest.age, latest.attitude
        self._compute(
            samples, self.rows, longitudinal.rows, longitudinal.prior,
            turning.rows, turning.prior, turning.table, self._constants,
        )  # fmt: skip
