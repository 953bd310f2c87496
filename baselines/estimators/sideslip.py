"""The mass from the steady side slip of a turning vehicle, for the longitudinal regression.

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

References: [S] Strawa et al., Electronics 10 (2021) 187, section 3 (lateral friction).
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.interacting_models import TwoParameterEstimator
from baselines.estimators.measurement import (
    COLUMN,
    INERTIAL,
    POSE,
    Measurement,
    Rows,
    Setting,
    Stateful,
    columns_of,
)
from baselines.estimators.turning import lever, slip_share
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.rigid_body import incline_of
from tracked_env.physics.terramechanics import GRAVITY

LEAST_TURN = 0.1  # [rad/s] slower turns say nothing
LEAST_SPEED = 0.3  # [m/s] of the vehicle, forward
INSIDE = 0.6  # [-] of the half contact: the ICR must lie inside it
ERROR = 0.03  # [-] of the equation, relative
ERROR_TIME = 10.0  # [s] for which that error lasts
RATIO_TIME = 15.0  # [s] of calm time over which the equation is compared
CALM_ODDS = 0.5  # [-] of the calm model, from which on the time is calm
FIRM = 0.05  # [-] slip share up to which the equation needs no proof
AGREES = 2.0  # [-] agreement from which on it is used elsewhere

_V_X, _V_Y, _W = COLUMN["v_x"], COLUMN["v_y"], COLUMN["yaw_rate"]
_A_Y = COLUMN["acceleration_y"]
ROW = np.dtype([("square", float), ("product", float)])  # weighted sums for the ratio


class Constants(NamedTuple):
    """Constants of the equation."""

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
    a_y, per_acceleration = z[i, _A_Y], factor / (friction * GRAVITY * press * inverse_mass)
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
def update_all(samples, rows, longitudinal, prior, turning, turning_prior, table, k):
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

    rows = Rows("memory", ROW)

    def __init__(self, setting: Setting) -> None:
        period, sheet = setting.control_period, setting.data_sheet
        self.memory = np.zeros((setting.count, columns_of(ROW)))
        self._compute = BoundOnce(update_all)
        self._constants = Constants(
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
