"""Yaw inertia and lateral resistance from the turning motion.

    M = I dw/dt + C g f S(v_y, w),    C = m mu_t
The equation, its regressors and its variance are in turning_equation. The soil's resistance grows
with m mu_t, hence that product is estimated and handed out divided by the mass in use.

Shared friction: the equation has a friction that acts across the tracks whatever they pull. Where
friction acts along the slip velocity, the traction that speeds the yaw up takes away from what
resists the turn, and the inertia is found too small: by nothing where shear is elastic, and where
all of it slides (K -> 0, motion normal to the limit of the forces) by the slip share
    s = 1 - w B / (belt_R - belt_L),    belt = r omega
of the yaw rate of the belts. Which of the two a soil is, is not known: a bias anywhere in [0, s]
has the mean square s^2 / 3, and that much is added to the claimed variance of the inertia. The
recursion knows nothing of it. On firm soil s is 0.01 to 0.02.

Where the cohesion of the soil resists (cohesive_soil), C alone is learned, and may exceed m mu_t of
any friction; then "lateral_resistance" is the resistance of this moment over the weight.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.1.2.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import least_squares as ls
from baselines.estimators import turning_equation
from baselines.estimators import two_parameters as im
from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    INERTIAL,
    DataSheet,
    Estimate,
    Estimator,
    Quantity,
    Setting,
)
from baselines.estimators.turning_equation import Known, equation
from baselines.estimators.two_parameters import (
    HOLDING,
    P_11,
    P_12,
    P_22,
    REJECTED,
    SLOWEST,
    TORQUE_MARGIN,
    VALUE_1,
    VALUE_2,
    TwoParameterEstimator,
    answer,
    checked_forgetting,
    take,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.physics.rigid_body import incline_of
from tracked_env.validation import CONTROL_PERIOD, checked_number

FORGETTING = 0.9995  # [-] per sample: at 50 Hz 40 s
# Models of interacting_models, with walks [1/sqrt(s)] of the inertia, relative, and of m mu_t, in
# units of its nominal value.
WALKS = {
    im.CALM: (0.005, 0.01), im.FAST: (0.005, 0.15), im.BORDER: (0.0, 1.5), im.JUMP: (3.0, 3.0),
    im.ALARMED: (0.04, 0.08), im.SLOW: (0.0, 0.005),
}  # fmt: skip
TREND_GATE = 9.0  # [-] three standard deviations of the mean
INERTIA_SIGMA = 0.4  # [-] of the nominal inertia: prior standard deviation
FRICTION_SIGMA = 0.4  # [-] of the nominal m mu_t
INERTIA_FACTOR = 6.0  # [-] inertia is sought between nominal / factor and nominal * factor
MODEL_NOISE = 20.0  # [N m] of the equation itself
SHARE_TIME = 15.0  # [s] of turning over which the slip share is averaged

_V_X, _A_Y, _TORQUE = COLUMN["v_x"], COLUMN["acceleration_y"], COLUMN["torque_left"]
_W, _SPROCKET = COLUMN["yaw_rate"], COLUMN["sprocket_speed_left"]
# Columns of the memory behind those of the regression: means of (w B)^2 and w B (belt_R - belt_L).
# AGREEMENT: how well the side slip agrees with a friction that is not shared, 0: nothing known.
# COHESIVE: the first of those of cohesive_soil.
TURNED, BELTS, AGREEMENT, COHESIVE = range(im.MEMORY, im.MEMORY + 4)
MEMORY = COHESIVE + turning_equation.COLUMNS


@formula
def _compare_belts(z, i, memory, known):
    """Add a sample of the yaw rate and that of the belts to their means."""
    turned = 2.0 * known.half_gauge * z[i, _W]
    belts = (z[i, _SPROCKET + 1] - z[i, _SPROCKET]) / known.inverse_radius
    if math.isfinite(turned + belts):
        memory[i, TURNED] += known.averaged * (turned * turned - memory[i, TURNED])
        memory[i, BELTS] += known.averaged * (turned * belts - memory[i, BELTS])


@formula
def slip_share(memory, i):
    """Size of s [-] of vehicle i, in [0, 1]; 0 before the first turn."""
    turned, belts = memory[i, TURNED], memory[i, BELTS]
    return min(abs(belts - turned) / max(belts, turned), 1.0) if turned > 0.0 else 0.0


@formula
def admit_shared_friction(out, i, memory, prior):
    """Add what the equation may be wrong by to the variance of the inertia, up to the prior's."""
    bias = slip_share(memory, i) * out[i, VALUE_1]
    chance = 1.0 / (1.0 + memory[i, AGREEMENT])
    most = max(out[i, P_11], prior.sigma_1 * prior.sigma_1)
    out[i, P_11] = min(out[i, P_11] + chance * bias * bias / 3.0, most)


@formula
def per_mass(out, i, mass, variance, known, high):
    """m mu_t of vehicle i becomes mu_t, at most high; the variance [kg^2] of the mass adds to its
    own."""
    square = mass[i] * mass[i]
    friction = min(max(out[i, VALUE_2] / mass[i], known.low), high)
    out[i, VALUE_2] = friction
    out[i, P_12] /= mass[i]
    relative = variance[i] / square
    out[i, P_22] = out[i, P_22] / square + friction * friction * relative


@formula
def complete(out, i, memory, prior, table, mass, variance, known):
    """The answer of the regression on vehicle i becomes that of this estimator."""
    if table.shape[0] > 0:
        admit_shared_friction(out, i, memory, prior)
    cohesive = memory[i, COHESIVE + turning_equation.LEFT] > 0.0
    per_mass(out, i, mass, variance, known, math.inf if cohesive else known.high)


@formula
def _inertia_apart(memory, i, sample, prior, mass, known):
    """The sample; on cohesive soil one on the friction alone."""
    inertia, _friction = ls.values(memory, i, prior)
    most, period = known.high * mass, known.averaged * SHARE_TIME
    if turning_equation.resists(memory, i, COHESIVE, sample, inertia, most, period):
        variance, _p_12, _p_22 = ls.covariance(memory, i, prior)
        sample = turning_equation.on_friction_alone(sample, inertia, variance)
    return sample


@loop
def update_all(z, fresh, attitude, memory, prior, table, known, mass, variance, resistance, out):
    """One sample of every vehicle: z (N, 13), fresh and attitude (N, 3), memory (N, MEMORY) in and
    out, mass, its variance and mu_l (N,) as known."""
    for i in range(z.shape[0]):
        status, nis = HOLDING, np.nan
        if fresh[i, INERTIAL] and fresh[i, DRIVE]:
            inertia, friction = ls.values(memory, i, prior)
            press = incline_of(attitude[i, 1], attitude[i, 0]).press
            sample, moving = equation(z, i, known, mass[i], resistance[i], friction, inertia, press)
            seen = sample.y + sample.phi_1 + sample.phi_2 + sample.variance
            felt = 0.0 if known.constrained else z[i, _A_Y]  # v_y is bounded, even of infinity
            if not math.isfinite(seen + z[i, _V_X] + felt):
                memory[i, ls.SKIPPED] += 1.0
                status = REJECTED
            elif max(abs(z[i, _TORQUE]), abs(z[i, _TORQUE + 1])) > known.largest_torque:
                status = REJECTED
            elif moving:
                if table.shape[0] > 0:
                    sample = _inertia_apart(memory, i, sample, prior, mass[i], known)
                status, nis = take(memory, i, sample, prior, table)
                if memory[i, COHESIVE + turning_equation.LEFT] > 0.0:
                    status = max(status, HOLDING)
                _compare_belts(z, i, memory, known)
            elif table.shape[0] > 0:
                im.wait(memory, i, prior, table)
        answer(memory, i, prior, status, nis, out)
        complete(out, i, memory, prior, table, mass, variance, known)


@loop
def complete_all(out, memory, prior, table, mass, variance, known):
    """`complete` of every vehicle."""
    for i in range(out.shape[0]):
        complete(out, i, memory, prior, table, mass, variance, known)


@loop
def hand_on(answer, longitudinal, memory, prior, table, mass, variance, resistance):
    """What the longitudinal estimator answers, for this one: mass, its variance and mu_l (N,).

    longitudinal: the memory of that estimator; an alarm in it is one in this memory, too.
    """
    for i in range(memory.shape[0]):
        im.share_alarm(memory, longitudinal, i)
        if table.shape[0] > 0 and memory[i, im.ODDS] > 0.0 and im.jumped(longitudinal, i):
            im.let_jump(memory, i, prior, table)
        mass[i] = 1.0 / answer[i, VALUE_1]
        variance[i] = answer[i, P_11] * mass[i] ** 4
        resistance[i] = answer[i, VALUE_2]


class TurningEstimator(TwoParameterEstimator):
    """Estimates [I, mu_t] of N vehicles; see the head of the file.

    mass, mass_variance, resistance: arrays (N,) that the owner keeps up to date; they start
    at the nominal values with variance 0. lateral: lateral model, "sliding" or "constrained".
    forgetting: factor per sample.
    """

    names = ("inertia", "lateral_resistance")
    provides = (
        Quantity("inertia", "kg m^2", "inertia"),
        Quantity("lateral_resistance", "-"),
    )
    needs = (
        "v_x", "yaw_rate", "acceleration_y", "yaw_acceleration", "torque_left", "torque_right",
        "mass", "longitudinal_resistance", "sprocket_speed_left", "sprocket_speed_right",
    )  # fmt: skip
    columns = MEMORY
    _kernel = update_all

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
        lateral: str = "sliding",
        forgetting: float = FORGETTING,
    ) -> None:
        if lateral not in ("sliding", "constrained"):
            raise ValueError(f"lateral = {lateral!r}; must be 'sliding' or 'constrained'")
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        forgetting = checked_forgetting("forgetting", forgetting)
        inertia = parameters.inertia
        friction = parameters.mass * parameters.lateral_resistance
        limit = RANGES["lateral_resistance"].high
        prior = ls.Prior(
            inertia, friction, INERTIA_SIGMA * inertia, FRICTION_SIGMA * friction,
            inertia / INERTIA_FACTOR, 0.02 * friction,
            inertia * INERTIA_FACTOR, limit * INERTIA_FACTOR * parameters.mass,
            forgetting,
        )  # fmt: skip
        super().__init__(
            parameters, control_period, data_sheet, count, prior,
            im.table(WALKS, TREND_GATE, FRICTION_SIGMA, control_period),
        )  # fmt: skip
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
            sheet.acceleration_noise,
            soil.YAW_FRICTION_REGULARISATION
            if lateral == "constrained"
            else 2.0 * soil.LATERAL_FRICTION_REGULARISATION / p.contact_length,
            SLOWEST,
            TORQUE_MARGIN * p.torque_limit,
            lateral == "constrained",
            0.0,
            limit,
            min(control_period / SHARE_TIME, 1.0),
        )
        self.mass = np.full(count, p.mass)
        self.mass_variance = np.zeros(count)
        self.resistance = np.full(count, p.longitudinal_resistance)

    @classmethod
    def for_stack(cls, setting: Setting) -> "TurningEstimator":
        """As a part of the identification stack."""
        s = setting
        part = cls(s.parameters, s.control_period, s.data_sheet, s.count, s.lateral)
        return part.on_slopes() if s.attitude else part

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Mass and mu_l, and the alarm of slow trends."""
        source = parts["longitudinal"]
        assert isinstance(source, LongitudinalEstimator)
        hand_on(
            source.answer, source.memory, self.memory, self.prior, self.table,
            self.mass, self.mass_variance, self.resistance,
        )  # fmt: skip

    def known(self) -> tuple[Any, ...]:
        """Constants of the equation, and what the longitudinal estimator knows."""
        return self._known, self.mass, self.mass_variance, self.resistance

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
        product = mass * friction
        sample, usable = equation(values, 0, self._known, mass, resistance, product, inertia, 1.0)
        error = sample.y - sample.phi_1 * inertia - sample.phi_2 * product
        return error / math.sqrt(sample.variance) if usable else math.nan

    def with_shared_friction(self, inertia: float, deviation: float) -> float:
        """The deviation of an inertia of the first vehicle, where slip may share friction."""
        out = np.zeros((1, self.answer.shape[1]))
        out[0, VALUE_1], out[0, P_11] = inertia, deviation**2
        admit_shared_friction(out, 0, self.memory, self.prior)
        return math.sqrt(float(out[0, P_11]))

    def read(self) -> Estimate:
        """What is known now, without a sample; mu_t by the mass in use."""
        out = self.answer_now()
        complete_all(
            out, self.memory, self.prior, self.table, self.mass, self.mass_variance, self._known
        )
        return self.estimate(out)
