"""Yaw inertia and lateral resistance from the turning motion.

    M = I dw/dt + C g f S(v_y, w),    C = m mu_t,   M = (B/2) [(F_R - R_R) - (F_L - R_L)]
S is the moment of the lateral friction per weight and mu_t, f the turning resistance factor. R_L,
R_R cancel unless the tracks move in opposite directions. The soil's resistance grows with m mu_t,
hence that product is estimated and handed out divided by the present estimate of the mass.
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

Shared friction: the equation has a friction that acts across the tracks whatever they pull. Where
friction acts along the slip velocity, the traction that speeds the yaw up takes away from what
resists the turn, and the inertia is found too small: by nothing where shear is elastic, and where
all of it slides (K -> 0, motion normal to the limit of the forces) by the slip share
    s = 1 - w B / (belt_R - belt_L),    belt = r omega
of the yaw rate of the belts. Which of the two a soil is, is not known: a bias anywhere in [0, s]
has the mean square s^2 / 3, and that much is added to the claimed variance of the inertia. The
recursion does not contain it. On firm soil s is 0.01 to 0.02.

Cohesive soil: firm clay resists a turn by c A, whatever the weight, and its shear builds up with
the way that the tracks have turned: in a wide turn it is a third of what it is in a sharp one. To
an equation with one friction C this looks like a C that changes all the time; it is ten to a
hundred times the moment that the yaw acceleration takes, and the inertia that fits the rest is
anything. So, where the moment is more than the largest mu_t explains for COHESIVE_ONSET, and for
COHESIVE_TIME of turning after that, samples determine C alone, with an inertia that is as uncertain
as it was. At the first of them the inertia is set back to what it was NOTE_TIME of turning or more
before: the shear has built up since. C is followed everywhere, and may exceed m mu_t of any
friction; then "lateral_resistance" is the resistance of this moment over the weight.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    HOLDING,
    INERTIAL,
    REJECTED,
    SLOWEST,
    TORQUE_MARGIN,
    Estimate,
    Measurement,
    Quantity,
    Rows,
    columns_of,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.parameters import RANGES
from tracked_env.physics.rigid_body import incline_of

# Models of interacting_models, with walks [1/sqrt(s)] of the inertia, relative, and of m mu_t, in
# units of its nominal value.
WALKS = {
    im.CALM: (0.005, 0.01),
    im.FAST: (0.005, 0.15),
    im.BORDER: (0.0, 1.5),
    im.JUMP: (3.0, 3.0),
    im.ALARMED: (0.04, 0.08),
    im.SLOW: (0.0, 0.005),
}
TREND_GATE = 9.0  # [-] three standard deviations of the mean
INERTIA_SIGMA = 0.4  # [-] of the nominal inertia: prior standard deviation
FRICTION_SIGMA = 0.4  # [-] of the nominal m mu_t
INERTIA_FACTOR = 6.0  # [-] inertia is sought between nominal / factor and nominal * factor
MODEL_NOISE = 20.0  # [N m] of the equation itself
SHARE_TIME = 15.0  # [s] of turning over which the slip share is averaged

ITERATIONS = 3  # [-] for v_y; the first is exact in fast turns
EPS2 = soil.LATERAL_FRICTION_REGULARISATION**2  # [m^2/s^2]
LEAST_FRICTION = 0.1  # [-] mu_t of which v_y is still found
INSIDE = 0.8  # [-] of the half contact: the ICR is sought inside it

COHESIVE_TIME = 10.0  # [s] of turning
COHESIVE_GATE = 3.0  # [-] standard deviations of the equation beyond the largest mu_t
COHESIVE_ONSET = 0.2  # [s] of turning: single samples may be beyond by a torque of another moment
NOTE_TIME = 1.0  # [s] of turning between two notes of the inertia

_V_X, _W, _SPROCKET = COLUMN["v_x"], COLUMN["yaw_rate"], COLUMN["sprocket_speed_left"]
_A_Y, _BEND, _TORQUE = COLUMN["acceleration_y"], COLUMN["yaw_acceleration"], COLUMN["torque_left"]
# What the longitudinal regression says of one vehicle.
VEHICLE = np.dtype([("mass", float), ("mass_variance", float), ("resistance", float)])


class Constants(NamedTuple):
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
def unit_moment(v_y, w, k):
    """S(v_y, w) g [m^2/s^2], positive for w > 0: friction moment per m mu_t, factor apart."""
    length = k.contact_length
    if k.constrained:
        d = k.icr_forward
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
def sideways(a_y, w, weight_share, k):
    """(v_y [m/s], C dS/dC, what the noise of a_y does to S) g of the sliding lateral model. a_y
    [m/s^2] as measured, weight_share m / C = 1 / mu_t [-]."""
    half = 0.5 * k.contact_length * w
    share = weight_share / soil.GRAVITY
    inside = INSIDE * math.sqrt(half * half + EPS2)
    v_y, free, per_acceleration = 0.0, 0.0, 0.0
    for _ in range(ITERATIONS):
        per_acceleration = share * lever(v_y, half)
        free = -a_y * per_acceleration
        v_y = min(max(free, -inside), inside)
    step = max(k.side_noise * per_acceleration, 1e-3 * inside)
    change = 0.5 * (unit_moment(v_y + step, w, k) - unit_moment(v_y - step, w, k))
    return v_y, -change * v_y / step if abs(free) < inside else 0.0, change


@formula
def equation(z, i, k, mass, resistance, friction, inertia, press):
    """The Sample of vehicle i, and whether it moves and turns. mass m [kg], resistance mu_l [-],
    friction m mu_t [kg] and inertia [kg m^2] as known so far. press: [-] normal load over the
    weight."""
    v_x, w = z[i, _V_X], z[i, _W]
    left, right = v_x - w * k.half_gauge, v_x + w * k.half_gauge
    # Both tracks forward: the resistances cancel.
    opposite = 0.5 * (math.copysign(1.0, right) - math.copysign(1.0, left))
    rolling = opposite * resistance * mass * soil.GRAVITY * press
    y = k.half_gauge * ((z[i, _TORQUE + 1] - z[i, _TORQUE]) * k.inverse_radius - rolling)
    v_y, shift, side, across = 0.0, 0.0, 0.0, 0.0
    if k.constrained:
        d = k.icr_forward
        y += mass * d * (w * v_x - d * z[i, _BEND])
        sign = saturated_sign(w, 1.0 / soil.YAW_FRICTION_REGULARISATION)
        across = 2.0 * soil.GRAVITY / k.contact_length * d * d * sign
    else:
        weight_share = mass / (max(friction, LEAST_FRICTION * mass) * press)
        v_y, shift, side = sideways(z[i, _A_Y], w, weight_share, k)
    factor = k.turning_resistance_factor * press
    turn = math.sqrt(k.turn_variance)
    slope = 0.5 * (unit_moment(v_y, w + turn, k) - unit_moment(v_y, w - turn, k))
    spread = factor * friction
    variance = (
        k.moment_variance
        + inertia * inertia * k.bend_variance
        + spread * spread * (slope * slope + side * side)
    )
    usable = min(abs(left), abs(right)) > k.slowest and abs(w) > k.least_turn
    regressor = factor * (unit_moment(v_y, w, k) + shift) + across * press
    return ls.Sample(
        y + factor * shift * friction, z[i, _BEND], regressor, variance, k.bend_variance
    ), usable


@formula
def _note(row, period):
    """Note the inertia once in NOTE_TIME, beside the note before."""
    row.since_note += period
    if row.since_note >= NOTE_TIME:
        row.since_note = 0.0
        row.earlier_mean, row.earlier_information = row.last_mean, row.last_information
        p_11, _p_12, _p_22 = ls.scaled_covariance(row.estimates[0])
        row.last_mean, row.last_information = row.estimates[0].x_1, 1.0 / p_11 - 1.0


@formula
def _set_back(row):
    """The inertia of all models becomes that of the earlier note; both notes are that one."""
    mean, information = row.earlier_mean, row.earlier_information
    row.last_mean, row.last_information, row.since_note = mean, information, 0.0
    for j in range(im.MODELS + 2):
        e = row.estimates[j]
        _p_11, _p_12, p_22 = ls.scaled_covariance(e)
        ls.set_gaussian(e, mean, e.x_2, 1.0 / (information + 1.0), 0.0, p_22)


@formula
def cohesion_resists(row, sample, inertia, most, period):
    """Whether a vehicle turns on cohesive soil, or has just done so. sample: of a turn. inertia
    [kg m^2] as estimated so far. most [kg]: the largest m mu_t that friction explains. period [s]:
    between two samples."""
    moment = (sample.y - sample.phi_1 * inertia) * math.copysign(1.0, sample.phi_2)
    excess = moment - most * abs(sample.phi_2)
    row.beyond = row.beyond + period if excess > COHESIVE_GATE * math.sqrt(sample.variance) else 0.0
    if row.beyond >= COHESIVE_ONSET - 1e-9:
        if row.cohesive <= 0.0:
            _set_back(row)
        row.cohesive = COHESIVE_TIME
    else:
        row.cohesive = max(row.cohesive - period, 0.0)
    if row.cohesive <= 0.0:
        _note(row, period)
    return row.cohesive > 0.0


@formula
def on_friction_alone(sample, inertia, variance):
    """The sample as an equation on C, with an inertia [kg m^2] of this variance."""
    doubt = sample.phi_1 * sample.phi_1 * variance
    rest = sample.y - sample.phi_1 * inertia
    return ls.Sample(rest, 0.0, sample.phi_2, sample.variance + doubt, 0.0)


@formula
def _compare_belts(z, i, row, k):
    """Add a sample of the yaw rate and that of the belts to their means."""
    turned = 2.0 * k.half_gauge * z[i, _W]
    belts = (z[i, _SPROCKET + 1] - z[i, _SPROCKET]) / k.inverse_radius
    if math.isfinite(turned + belts):
        row.turned += k.averaged * (turned * turned - row.turned)
        row.belts += k.averaged * (turned * belts - row.belts)


@formula
def slip_share(row):
    """Size of s [-], in [0, 1]; 0 before the first turn."""
    turned, belts = row.turned, row.belts
    return min(abs(belts - turned) / max(belts, turned), 1.0) if turned > 0.0 else 0.0


@formula
def shared_friction_variance(row, inertia, variance, prior):
    """`variance` of the inertia and what the equation may be wrong by, at most the prior's."""
    bias = slip_share(row) * inertia
    chance = 1.0 / (1.0 + row.agreement)
    most = max(variance, prior.sigma_1 * prior.sigma_1)
    return min(variance + chance * bias * bias / 3.0, most)


@formula
def _complete(out, row, prior, table, vehicle, k):
    """Complete the answer of the regression: the share of the friction, and mu_t for m mu_t. mu_t
    is at most that of friction, if none is cohesive; the variance of the mass adds to its own."""
    p = out.covariance
    if table.shape[0] > 0:
        p[0, 0] = shared_friction_variance(row, out.value[0], p[0, 0], prior)
    square = vehicle.mass * vehicle.mass
    high = math.inf if row.cohesive > 0.0 else k.high
    friction = min(max(out.value[1] / vehicle.mass, k.low), high)
    out.value[1] = friction
    p[0, 1] /= vehicle.mass
    p[1, 0] = p[0, 1]
    relative = vehicle.mass_variance / square
    p[1, 1] = p[1, 1] / square + friction * friction * relative


@loop
def update_all(samples, rows, prior, table, k, vehicles, out):
    """One sample of every vehicle: samples z (N, 13), fresh and attitude (N, 3), vehicles (N,) of
    VEHICLE; the rows (N,) of the memory are changed, the answers (N,) written."""
    z, fresh, attitude = samples
    for i in range(z.shape[0]):
        row, vehicle, status, nis = rows[i], vehicles[i], HOLDING, np.nan
        if fresh[i, INERTIAL] and fresh[i, DRIVE]:
            inertia, friction = ls.values(row.estimates[0], prior)
            press = incline_of(attitude[i, 1], attitude[i, 0]).press
            sample, moving = equation(
                z, i, k, vehicle.mass, vehicle.resistance, friction, inertia, press
            )
            total = sample.y + sample.phi_1 + sample.phi_2 + sample.variance
            side = 0.0 if k.constrained else z[i, _A_Y]  # v_y is bounded, even of infinity
            if not math.isfinite(total + z[i, _V_X] + side):
                row.skipped += 1.0
                status = REJECTED
            elif max(abs(z[i, _TORQUE]), abs(z[i, _TORQUE + 1])) > k.largest_torque:
                status = REJECTED
            elif moving:
                if table.shape[0] > 0:
                    period, most = k.averaged * SHARE_TIME, k.high * vehicle.mass
                    if cohesion_resists(row, sample, inertia, most, period):
                        variance, _p_12, _p_22 = ls.covariance(row.estimates[0], prior)
                        sample = on_friction_alone(sample, inertia, variance)
                status, nis = im.take(row, sample, prior, table)
                if row.cohesive > 0.0:
                    status = max(status, HOLDING)
                _compare_belts(z, i, row, k)
            elif table.shape[0] > 0:
                im.wait(row, prior, table)
        im.write_answer(row, prior, status, nis, out[i])
        _complete(out[i], row, prior, table, vehicle, k)


@loop
def take_longitudinal(answers, longitudinal, rows, prior, table, vehicles):
    """The answers and rows of the longitudinal regression into vehicles (N,); its alarms and jumps
    are those of this regression, too."""
    for i in range(rows.shape[0]):
        row, vehicle, answer = rows[i], vehicles[i], answers[i]
        row.alarm = max(row.alarm, longitudinal[i].alarm)
        jumps = longitudinal[i].odds[im.JUMP] > im.JUMPED
        if table.shape[0] > 0 and row.odds[0] > 0.0 and jumps:
            im.walk_all(row, prior, table[im.JUMP, im.WALK_1], table[im.JUMP, im.WALK_2])
        vehicle.mass = 1.0 / answer.value[0]
        vehicle.mass_variance = answer.covariance[0, 0] * vehicle.mass**4
        vehicle.resistance = answer.value[1]


class TurningEstimator(im.TwoParameterEstimator):
    """Estimates [I, mu_t] of N vehicles; see the head of the file.

    vehicles: (N,) of VEHICLE, which the owner keeps up to date: mass and its variance, which start
    at the nominal value and 0, and mu_l.
    """

    names = ("inertia", "lateral_resistance")
    provides = (Quantity("inertia", "kg m^2", "inertia"), Quantity("lateral_resistance", "-"))
    needs = (
        "v_x", "yaw_rate", "acceleration_y", "yaw_acceleration", "torque_left", "torque_right",
        "mass", "longitudinal_resistance", "sprocket_speed_left", "sprocket_speed_right",
    )  # fmt: skip
    kernel = update_all
    vehicles = Rows("_vehicle_memory", VEHICLE)  # (N,)

    def __init__(self, *setting: Any, **named: Any) -> None:
        super().__init__(*setting, **named)
        p, sheet, constrained = self.parameters, self.data_sheet, self.lateral == "constrained"
        inertia, friction = p.inertia, p.mass * p.lateral_resistance
        limit = RANGES["lateral_resistance"].high
        self.prior = ls.Prior(
            inertia, friction, INERTIA_SIGMA * inertia, FRICTION_SIGMA * friction,
            inertia / INERTIA_FACTOR, 0.02 * friction,
            inertia * INERTIA_FACTOR, limit * INERTIA_FACTOR * p.mass, im.FORGETTING,
        )  # fmt: skip
        self.table = im.table(WALKS, TREND_GATE, FRICTION_SIGMA, self.control_period)
        effort = sheet.torque_noise / p.sprocket_radius
        least_turn = 2.0 * soil.LATERAL_FRICTION_REGULARISATION / p.contact_length
        self._constants = Constants(
            inverse_radius=1.0 / p.sprocket_radius,
            half_gauge=0.5 * p.track_gauge,
            contact_length=p.contact_length,
            turning_resistance_factor=p.turning_resistance_factor,
            icr_forward=p.icr_forward,
            moment_variance=2.0 * (0.5 * p.track_gauge * effort) ** 2 + MODEL_NOISE**2,
            bend_variance=sheet.yaw_acceleration_noise**2,
            turn_variance=sheet.gyro_noise**2 + sheet.gyro_bias**2 + 1e-8,
            side_noise=sheet.acceleration_noise,
            least_turn=soil.YAW_FRICTION_REGULARISATION if constrained else least_turn,
            slowest=SLOWEST,
            largest_torque=TORQUE_MARGIN * p.torque_limit,
            constrained=constrained,
            low=0.0,
            high=limit,
            averaged=min(self.control_period / SHARE_TIME, 1.0),
        )
        self._take_longitudinal = BoundOnce(take_longitudinal)
        self._vehicle_memory = np.zeros((len(self.memory), columns_of(VEHICLE)))
        self.vehicles["mass"], self.vehicles["resistance"] = p.mass, p.longitudinal_resistance

    def take_over(self, parts: Mapping[str, Any], estimates: Mapping[str, Estimate]) -> None:
        """Mass and mu_l, and the alarm of slow trends."""
        source = parts["longitudinal"]
        self._take_longitudinal(
            source.answer, source.rows, self.rows, self.prior, self.table, self.vehicles
        )

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """Samples, state, constants, and the vehicles as the longitudinal estimator sees them."""
        samples = measurement.values, measurement.fresh, measurement.attitude
        return samples, self.rows, self.prior, self.table, self._constants, self.vehicles

    def bounds(self, mass: float) -> dict[str, tuple[float, float]]:
        """(low, high) between which each parameter is sought, by name, for a vehicle of a mass."""
        p = self.prior
        limit = RANGES["lateral_resistance"].high
        return {"inertia": (p.low_1, p.high_1), "lateral_resistance": (p.low_2 / mass, limit)}

    def residual(
        self,
        values: NDArray[np.float64],
        mass: float,
        resistance: float,
        inertia: float,
        friction: float,
    ) -> float:
        """Residual of one vehicle's sample (1, 13) on level ground with these parameters, over its
        standard deviation; NaN where the sample says nothing."""
        k, product = self._constants, mass * friction
        sample, usable = equation(values, 0, k, mass, resistance, product, inertia, 1.0)
        error = sample.y - sample.phi_1 * inertia - sample.phi_2 * product
        return error / math.sqrt(sample.variance) if usable else math.nan

    def with_shared_friction(self, inertia: float, deviation: float) -> float:
        """The deviation of an inertia of the first vehicle, where slip may share friction."""
        variance = shared_friction_variance(self.rows[0], inertia, deviation**2, self.prior)
        return math.sqrt(float(variance))
