"""The yaw equation of a turning tracked vehicle as one least-squares sample.

    M = I dw/dt + C g f S(v_y, w),    C = m mu_t,   M = (B/2) [(F_R - R_R) - (F_L - R_L)]
S is the moment of the lateral friction per weight and mu_t, f the turning resistance factor. R_L,
R_R cancel unless the tracks move in opposite directions.
    sliding      S from the closed form of the friction (terramechanics); v_y from the lateral
                 accelerometer, a_y = -mu_t g v_y / (|w| l / 2) inside the contact. That v_y
                 depends on mu_t: the regressor is d(C S)/dC, and y is shifted to match
    constrained  S = sign(w) (l^2/4 - d^2) / l, and the terms of S (28): I + m d^2, m d w v_x, F_y d
The regressor of S 7.1.2 has the wrong sign and the factor 2; here it has f.
On a slope g is g cos(pitch) cos(roll), the normal load; the lateral accelerometer feels friction
alone, as on level ground.
Variance of the equation: torque sensors, yaw acceleration, gyro and lateral accelerometer times
the slopes of S. On the straight S is steep, and its friction not that of a turning vehicle:
samples below a least yaw rate are left out, or noise would be taken for turning.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2.

Turns on soil that resists by its cohesion, where the yaw equation tells nothing of the inertia.

Firm clay resists a turn by c A, whatever the weight, and its shear builds up with the way that the
tracks have turned: in a wide turn it is a third of what it is in a sharp one. To an equation with
one friction C this looks like a C that changes all the time; it is ten to a hundred times
the moment that the yaw acceleration takes, and the inertia that fits the rest is anything.
So, where the moment is more than the largest mu_t explains for LASTS, and for COHESIVE_TIME of
turning after that, samples determine C alone, with an inertia that is as uncertain as it was. At
the first of them the inertia is set back to what it was KEPT_TIME of turning or more before: the
shear has built up since. C is followed everywhere; it is the resistance of this moment.
"""

import math
from typing import NamedTuple

from baselines.estimators import least_squares
from baselines.estimators import least_squares as ls
from baselines.estimators import two_parameters as im
from baselines.estimators.measurement import COLUMN
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign
from tracked_env.physics.jit import formula

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
    low: float  # [-] least mu_t
    high: float  # [-] largest mu_t of friction; what resists more is cohesive
    averaged: float  # [-] share of a sample in the mean slip share of the yaw rate


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
def equation(z, i, known, mass, resistance, friction, inertia, press):
    """The Sample of vehicle i, and whether it moves and turns.

    mass m [kg], resistance mu_l [-], friction m mu_t [kg] and inertia [kg m^2] as known so far.
    press: [-] normal load over the weight.
    """
    v_x, w = z[i, _V_X], z[i, _W]
    left, right = v_x - w * known.half_gauge, v_x + w * known.half_gauge
    # Both tracks forward: the resistances cancel.
    opposite = 0.5 * (math.copysign(1.0, right) - math.copysign(1.0, left))
    rolling = opposite * resistance * mass * soil.GRAVITY * press
    y = known.half_gauge * ((z[i, _TORQUE + 1] - z[i, _TORQUE]) * known.inverse_radius - rolling)
    v_y, shift, side, across = 0.0, 0.0, 0.0, 0.0
    if known.constrained:
        d = known.icr_forward
        y += mass * d * (w * v_x - d * z[i, _BEND])
        sign = saturated_sign(w, 1.0 / soil.YAW_FRICTION_REGULARISATION)
        across = 2.0 * soil.GRAVITY / known.contact_length * d * d * sign
    else:
        weight_share = mass / (max(friction, LEAST_FRICTION * mass) * press)
        v_y, shift, side = sideways(z[i, _A_Y], w, weight_share, known)
    factor = known.turning_resistance_factor * press
    turn = math.sqrt(known.turn_variance)
    slope = 0.5 * (unit_moment(v_y, w + turn, known) - unit_moment(v_y, w - turn, known))
    spread = factor * friction
    variance = (
        known.moment_variance
        + inertia * inertia * known.bend_variance
        + spread * spread * (slope * slope + side * side)
    )
    usable = min(abs(left), abs(right)) > known.slowest and abs(w) > known.least_turn
    regressor = factor * (unit_moment(v_y, w, known) + shift) + across * press
    return ls.Sample(
        y + factor * shift * friction, z[i, _BEND], regressor, variance, known.bend_variance
    ), usable


COHESIVE_TIME = 10.0  # [s] of turning
GATE = 3.0  # [-] standard deviations of the equation beyond the largest mu_t
LASTS = 0.2  # [s] of turning: a sample whose torque is not of its moment may be beyond as well
KEPT_TIME = 1.0  # [s] of turning between two notes of the inertia
# Columns of the memory, behind the first: seconds of turning left, seconds beyond friction, seconds
# since the last note, and two notes of mean and information of the inertia, in units of the prior.
LEFT, BEYOND, SINCE, LAST_MEAN, LAST_VALUE, EARLIER_MEAN, EARLIER_VALUE = range(7)
COLUMNS = 7


@formula
def _note(memory, i, first, period):
    """Note the inertia of vehicle i once in KEPT_TIME; the note before is kept."""
    memory[i, first + SINCE] += period
    if memory[i, first + SINCE] >= KEPT_TIME:
        memory[i, first + SINCE] = 0.0
        memory[i, first + EARLIER_MEAN] = memory[i, first + LAST_MEAN]
        memory[i, first + EARLIER_VALUE] = memory[i, first + LAST_VALUE]
        p_11, _p_12, _p_22 = least_squares.covariance_gaussian_blocks(memory, i, 0)
        memory[i, first + LAST_MEAN] = memory[i, least_squares.X_1]
        memory[i, first + LAST_VALUE] = 1.0 / p_11 - 1.0


@formula
def _set_back(memory, i, first):
    """The inertia of all models becomes that of the earlier note; both notes are that one."""
    mean, value = memory[i, first + EARLIER_MEAN], memory[i, first + EARLIER_VALUE]
    memory[i, first + LAST_MEAN], memory[i, first + LAST_VALUE] = mean, value
    memory[i, first + SINCE] = 0.0
    for k in range(im.MODELS + 2):
        h = k * least_squares.SIZE
        _p_11, _p_12, p_22 = least_squares.covariance_gaussian_blocks(memory, i, h)
        least_squares.put(
            memory, i, h, mean, memory[i, h + least_squares.X_2], 1.0 / (value + 1.0), 0.0, p_22
        )


@formula
def resists(memory, i, first, sample, inertia, most, period):
    """Whether vehicle i turns on cohesive soil, or has just done so.

    sample: of a turn. inertia [kg m^2] as known so far. most [kg]: the largest m mu_t that friction
    explains. period [s]: between two samples.
    """
    moment = (sample.y - sample.phi_1 * inertia) * math.copysign(1.0, sample.phi_2)
    beyond = moment - most * abs(sample.phi_2)
    found = beyond > GATE * math.sqrt(sample.variance)
    memory[i, first + BEYOND] = memory[i, first + BEYOND] + period if found else 0.0
    if memory[i, first + BEYOND] >= LASTS - 1e-9:
        if memory[i, first + LEFT] <= 0.0:
            _set_back(memory, i, first)
        memory[i, first + LEFT] = COHESIVE_TIME
    else:
        memory[i, first + LEFT] = max(memory[i, first + LEFT] - period, 0.0)
    lasting = memory[i, first + LEFT] > 0.0
    if not lasting:
        _note(memory, i, first, period)
    return lasting


@formula
def on_friction_alone(sample, inertia, variance):
    """The sample as an equation on C, with an inertia [kg m^2] of this variance."""
    doubt = sample.phi_1 * sample.phi_1 * variance
    rest = sample.y - sample.phi_1 * inertia
    return least_squares.Sample(rest, 0.0, sample.phi_2, sample.variance + doubt, 0.0)
