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
likelihood, normal about 1, over that of any ratio between 0 and 1. The turning regression is told
this agreement, for its claim of the inertia.
Where the equation holds, C is a property of vehicle and soil, and an evident trend of it says that
the mass may change as well: it is an alarm of the longitudinal regression, which itself cannot see
a mass that grows as the resistance falls. Elsewhere C changes with slip and turn alone.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 3 (lateral friction).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from baselines.estimators import least_squares as ls
from baselines.estimators import two_parameters as im
from baselines.estimators.measurement import (
    COLUMN,
    INERTIAL,
    POSE,
    Measurement,
    Setting,
    attitude_of,
)
from baselines.estimators.turning import AGREEMENT, TURNED, slip_share
from baselines.estimators.turning_equation import lever
from baselines.estimators.two_parameters import TwoParameterEstimator
from tracked_env.physics.jit import formula, loop
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
SQUARE, PRODUCT = range(2)  # columns of memory: weighted sums for the ratio


class Known(NamedTuple):
    """Constants of the equation."""

    half_length: float  # [m] l / 2
    velocity_variance: float  # [m^2/s^2] of v_y
    acceleration_variance: float  # [m^2/s^4] of a_y, with its bias
    lasting: float  # [-] samples for which an error of the equation lasts
    keep: float  # [-] share of the sums for the ratio that is left after a sample


@formula
def expected(z, i, known, inverse_mass, friction, friction_variance, press):
    """(v_y [m/s] as the equation expects it, its variance) of vehicle i.

    inverse_mass [1/kg], friction C = m mu_t [kg] with its variance. press: [-] normal load over the
    weight.
    """
    a_y, w = z[i, _A_Y], z[i, _W]
    per_acceleration = lever(z[i, _V_Y], known.half_length * w) / (
        friction * GRAVITY * press * inverse_mass
    )
    v_y = -a_y * per_acceleration
    relative = friction_variance / (friction * friction) + ERROR * ERROR * known.lasting
    variance = (
        known.velocity_variance
        + per_acceleration * per_acceleration * known.acceleration_variance
        + v_y * v_y * relative
    )
    return v_y, variance


@formula
def _compare(memory, i, known, found, v_y, variance, relative):
    """Add a sample to the sums for the ratio of measured v_y to `found`, the expected one.

    relative [-]: variance of the mass it was found with, over its square; that error lasts.
    """
    weight = 1.0 / (variance + found * found * relative * known.lasting)
    memory[i, SQUARE] = known.keep * memory[i, SQUARE] + found * found * weight
    memory[i, PRODUCT] = known.keep * memory[i, PRODUCT] + found * v_y * weight


@formula
def _agreement(memory, i):
    """Likelihood of the measured ratio where the equation holds, over that where it does not [-].

    There any ratio in [0, 1] is as likely as another. 0 while nothing is known.
    """
    square = memory[i, SQUARE]
    if square <= 0.0:
        return 0.0
    off = memory[i, PRODUCT] / square - 1.0
    return math.sqrt(square / (2.0 * math.pi)) * math.exp(-0.5 * off * off * square)


@formula
def _usable(z, i, fresh, age, known):
    """Whether velocity and acceleration are of one moment, of a vehicle that turns forward."""
    together = fresh[i, POSE] and fresh[i, INERTIAL] and age[i, POSE] == age[i, INERTIAL]
    v_x, v_y, w = z[i, _V_X], z[i, _V_Y], z[i, _W]
    inside = abs(v_y) < INSIDE * known.half_length * abs(w)
    finite = math.isfinite(v_x + v_y + w + z[i, _A_Y])
    return together and finite and inside and v_x > LEAST_SPEED and abs(w) > LEAST_TURN


@formula
def _take(i, longitudinal, prior, known, v_y, found, variance, inverse_mass, holds):
    """Use the measured v_y for 1/m, where the equation has been found to hold."""
    slope = -found / inverse_mass
    sample = ls.Sample(v_y - found + slope * inverse_mass, slope, 0.0, variance, 0.0)
    error, gain = ls.innovation(longitudinal, i, 0, sample, prior)
    usual = error * error < im.OUTLIER_GATE * (gain + variance)
    if usual and holds:
        im.learn_apart(longitudinal, i, sample, prior)


@loop
def update_all(
    z, fresh, age, attitude, memory, longitudinal, prior, turning, other_prior, table, known
):  # fmt: skip
    """One sample of every vehicle: z (N, CHANNELS), fresh, age and attitude (N, 3), memory (N, 2)
    and those of the longitudinal and the turning regression in and out; table: of the latter."""
    for i in range(z.shape[0]):
        started = longitudinal[i, im.ODDS] > 0.0 and turning[i, im.ODDS] > 0.0
        if not (started and _usable(z, i, fresh, age, known)):
            continue
        press = incline_of(attitude[i, 1], attitude[i, 0]).press
        inverse_mass, _resistance = ls.values(longitudinal, i, prior)
        _inertia, friction = ls.values(turning, i, other_prior)
        _i_i, _i_c, c_c = ls.covariance(turning, i, other_prior)
        found, variance = expected(z, i, known, inverse_mass, friction, c_c, press)
        calm = longitudinal[i, im.ALARM] <= 0.0 and turning[i, im.ALARM] <= 0.0
        if calm and longitudinal[i, im.ODDS + im.CALM] > CALM_ODDS:
            # The monitor's mass owes nothing to this equation: it is no witness in its own cause.
            apart, p_11 = im.watched(longitudinal, i, prior)
            there = found * inverse_mass / apart
            _compare(memory, i, known, there, z[i, _V_Y], variance, p_11 / (apart * apart))
        turning[i, AGREEMENT] = _agreement(memory, i)
        firm = turning[i, TURNED] > 0.0 and slip_share(turning, i) < FIRM
        holds = firm or turning[i, AGREEMENT] >= AGREES
        if holds and im.evident(turning, i, table):
            im.share_alarm(longitudinal, turning, i)
        _take(i, longitudinal, prior, known, z[i, _V_Y], found, variance, inverse_mass, holds)


class SideslipRow:
    """The equation for N vehicles; see the head of the file. It changes the longitudinal memory."""

    def __init__(self, setting: Setting) -> None:
        period, sheet = setting.control_period, setting.data_sheet
        self.memory = np.zeros((setting.count, 2))
        self._known = Known(
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
        update_all(
            latest.values, latest.fresh, latest.age, attitude_of(latest), self.memory,
            longitudinal.memory, longitudinal.prior, turning.memory, turning.prior, turning.table,
            self._known,
        )  # fmt: skip

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0
