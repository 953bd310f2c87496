"""Soil estimator: [F_max, K] of the ground under the tracks, from slips and torques.

A window of samples of both tracks (soil_window) and a damped Gauss-Newton fit of S (7) to it
(soil_regression); the generalised Newton-Raphson method of S with weights and a weak prior.
Identifiability: at u = i l / K << 1 only the stiffness F_max l / (2 K), the slope dF/di at
i = 0, is observable; near i = 1 only F_max. `ratio_only` and `effort_limit` say so.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.3.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import (
    BatchEstimator,
    DataSheet,
    Estimate,
    Estimator,
    Measurement,
    Quantity,
    Setting,
    columns_of,
)
from baselines.estimators.slip_observer import Answer, SlipObserver, estimate_of
from baselines.estimators.soil_window import DETERMINED, SOJOURN, Sensing, update_all
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

EFFORT_RANGE = (100.0, 1e6)  # [N] bounds of F_max
EFFORT_FLOOR = 5.0  # [N] sigma of the model: F is not quite quasi-static
SLIP_FLOOR = 2e-4  # [-] sigma of the model, likewise
CLEAR_EFFORT = 5.0  # [-] standard deviations that an effort must be above zero
# The UKF's slip errors hang together over some samples: variance counts that much more.
SLIP_CORRELATION = 10.0  # [control steps]
# In the stack. A second after a change of the soil, and of the slips behind it, all is new.
WINDOW = 40  # [control steps]
PRIOR_SIGMA = (1.0, 0.7)  # [-] of ln F_max (weak soil to clay: a factor e), ln K (1 to 6 cm)
_WINDOW = Range(2, 10000, "control steps", "Did you pass seconds?")
_ITERATIONS = Range(1, 1000, "-", "S allows 20.")
_CORRELATED = Range(1.0, 1e4, "control steps", "1 = white.")
_CORRELATION = Range(0.0, 1.0, "-", "It is a coefficient.")


def nominal_effort_maximum(parameters: PlantParameters) -> float:
    """F_max of one track [N]."""
    return float(lumped.drive_limits(parameters).effort_maximum)


class SoilEstimator(BatchEstimator):
    """Estimates [F_max [N], K [m]] of vehicles on the move.

    parameters: nominal; its soil is the first guess. count: vehicles N.
    window: [control steps] 50 as in S. iterations: at most, per update, 20 as in S.
    residual: "total" (both errors) or "effort" (S (43)); see soil_regression.
    correlation_steps: [control steps] over which errors of given slips are correlated; 1 =
    white. A filter's slip needs more, else the covariance is too small.
    Raises ValueError for a parameter or option outside its range.
    """

    names = ("effort_maximum", "shear_deformation_modulus")
    provides = (
        Quantity("effort_maximum", "N", nominal_effort_maximum, True),
        Quantity("shear_deformation_modulus", "m", "shear_deformation_modulus", True),
    )
    needs = (
        "v_x", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right", "torque_left",
        "torque_right", "slip_left", "slip_right",
    )  # fmt: skip
    paired = False
    row = sr.ROW

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        window: int = 50,
        iterations: int = 20,
        residual: str = "total",
        correlation_steps: float = 1.0,
    ) -> None:
        for name in (
            "mass", "track_width", "track_gauge", "contact_length", "sprocket_radius", "cohesion",
            "friction_angle", "shear_deformation_modulus",
        ):  # fmt: skip
            checked_number(f"nominal {name}", getattr(parameters, name), RANGES[name])
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        window = checked_whole("window", window, _WINDOW)
        iterations = checked_whole("iterations", iterations, _ITERATIONS)
        checked_number("correlation_steps", correlation_steps, _CORRELATED)
        for name in ("torque_noise", "sprocket_speed_noise", "velocity_noise", "gyro_noise"):
            checked_number(name, getattr(data_sheet, name), SIGMA)
        if residual not in ("total", "effort"):
            raise ValueError(f"residual = {residual!r}; must be 'total' or 'effort'")
        p, sheet = parameters, data_sheet
        radius, half = float(p.sprocket_radius), 0.5 * float(p.track_gauge)
        effort = math.hypot(sheet.torque_noise / radius, EFFORT_FLOOR)
        maximum = soil.maximum_tractive_effort(
            p.cohesion, p.friction_angle, p.track_width, p.contact_length, p.mass
        )
        maximum = min(max(maximum, EFFORT_RANGE[0]), EFFORT_RANGE[1])
        self._nominal = math.log(maximum), math.log(p.shear_deformation_modulus)
        low_k, high_k = RANGES["shear_deformation_modulus"][:2]
        self._model = sr.Model(
            float(p.contact_length), effort * effort,
            1.0 / PRIOR_SIGMA[0] ** 2, 1.0 / PRIOR_SIGMA[1] ** 2,
            math.log(EFFORT_RANGE[0]), math.log(EFFORT_RANGE[1]),
            math.log(low_k), math.log(high_k), residual == "total", int(iterations),
            *self._nominal, control_period / SOJOURN,
        )  # fmt: skip
        turn = half * half * (sheet.gyro_noise**2 + sheet.gyro_bias**2)
        self._sensing = Sensing(
            radius, half, (radius * sheet.sprocket_speed_noise) ** 2,
            2.0 * sheet.velocity_noise**2 + turn, SLIP_FLOOR**2, CLEAR_EFFORT * effort,
            float(correlation_steps), int(window),
        )  # fmt: skip
        self._slips: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._nothing = np.zeros((count, 2))
        # (N,) whether the data determined the effort limit after the last sample
        self.limit_determined = np.zeros(count, dtype=bool)
        samples = 2 * int(window)
        self.memory = np.zeros((count, columns_of(sr.ROW)))
        self.ring = np.zeros((count, sr.BLOCKS * samples))
        self.fitted = np.empty((count, 2, 2))  # covariance on a soil that never changes
        self._scratch = np.zeros((2 * sr.ROWS + 1, samples))
        self.reset()

    @classmethod
    def for_stack(cls, setting: Setting) -> "SoilEstimator":
        """As a part of the identification stack."""
        return cls(
            setting.parameters, setting.control_period, setting.data_sheet, setting.count,
            window=WINDOW, correlation_steps=SLIP_CORRELATION,
        )  # fmt: skip

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """The slips of the filter."""
        source = parts["slip"]
        assert isinstance(source, SlipObserver)
        self._slips = source.slips_and_variances()

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all of the vehicles `rows` (indices or a mask), or of all."""
        super().reset(rows)
        where = slice(None) if rows is None else np.asarray(rows)
        states = self.rows
        log_f, log_k = self._nominal
        for name, value in {
            "log_f": log_f, "log_k": log_k, "anchor_f": log_f, "anchor_k": log_k, "converged": 1.0,
            "p_ff": PRIOR_SIGMA[0] ** 2, "p_kk": PRIOR_SIGMA[1] ** 2,
        }.items():  # fmt: skip
            states[name][where] = value

    def provide_slip(self, slip: ArrayLike, variance: ArrayLike, correlation: float = 0.0) -> None:
        """Slip ratios (N, 2) and their variances for the next update, such as a filter's.

        correlation: of the errors of the two tracks, in [0, 1]. Without this call the slip
        follows from sprocket speeds, v_x and yaw rate of the measurement. Raises ValueError
        for other shapes.
        """
        shape = (len(self.memory), 2)
        arrays = np.array(slip, dtype=float), np.array(variance, dtype=float)
        if arrays[0].shape != shape or arrays[1].shape != shape:
            raise ValueError(f"slip {arrays[0].shape}, variance {arrays[1].shape}; must be {shape}")
        self._slips = (
            arrays[0],
            arrays[1] * (1.0 + checked_number("correlation", correlation, _CORRELATION)),
        )

    def compute(self, measurement: Measurement) -> Answer:
        """Take one sample, with provided slips once; returns the bare answer: value, covariance,
        summary, status."""
        count = len(self.memory)
        answer = (
            np.empty((count, 2)), np.empty((count, 2, 2)), np.empty((count, 4)),
            np.empty(count, dtype=np.int64),
        )  # fmt: skip
        slips = (self._slips is not None, *(self._slips or (self._nothing, self._nothing)))
        self.limit_determined = np.empty(count, dtype=bool)
        windows = self.ring.reshape(count, sr.BLOCKS, -1)
        update_all(
            measurement[:2], slips, self.rows, windows, self._sensing, self._model, self._scratch,
            (*answer, self.limit_determined, self.fitted),
        )  # fmt: skip
        self._slips = None
        return answer

    def estimate(self, answer: Answer) -> Estimate:
        """The bare answer as an Estimate."""
        return estimate_of(self.names, answer)

    @property
    def iterations(self) -> NDArray[np.int64]:
        """Steps of the fit in the last update, (N,); 0 where there was none."""
        return self.rows["iterations"].astype(np.int64)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether the last fit converged, (N,); else the values before it are kept."""
        return self.rows["converged"] > 0.5

    @property
    def changes(self) -> NDArray[np.int64]:
        """New soils found so far, (N,)."""
        return self.rows["changes"].astype(np.int64)

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """F_max l / (2 K) [N], the slope dF/di at i = 0, (N,)."""
        difference = self.rows["log_f"] - self.rows["log_k"]
        return 0.5 * self._model.contact_length * np.exp(difference)

    @property
    def stiffness_deviation(self) -> NDArray[np.float64]:
        """Standard deviation [N] of the stiffness, from data and prior, (N,)."""
        return self.stiffness * np.sqrt(self._variance(-1.0, self._model))

    def _variance(
        self, twist: float | NDArray[np.float64], model: sr.Model | None
    ) -> NDArray[np.float64]:
        """Variance of ln F_max + twist ln K; without a model from the data alone (or inf)."""
        prior = (0.0, 0.0) if model is None else (model.information_f, model.information_k)
        a, b = self.rows["j_ff"] + prior[0], self.rows["j_fk"]
        c = self.rows["j_kk"] + prior[1]
        determinant = a * c - b * b
        safe = determinant > 1e-12 * a * c
        numerator = c - 2.0 * b * twist + a * np.square(twist)
        return np.divide(numerator, determinant, out=np.full(len(a), np.inf), where=safe)

    @property
    def ratio_only(self) -> NDArray[np.bool_]:
        """True where the data determine the stiffness, but not F_max, to 20 %, (N,)."""
        stiff = self._variance(-1.0, self._model) * DETERMINED <= 1.0
        return stiff & (self._variance(0.0, None) * DETERMINED > 1.0)

    def effort_limit(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """(F(i = 1) [N] of one track, whether the data of the window determine it to 10 %)."""
        count = len(self.memory)
        limit, trusted = np.empty(count), np.empty(count, dtype=bool)
        sr.limits(self.rows, self._model.contact_length, limit, trusted)
        return limit, trusted
