"""Soil estimator: [F_max, K] of the ground under the tracks, from slips and torques.

A damped Gauss-Newton fit of S (7) to a window of samples of both tracks (soil_regression): the
generalised Newton-Raphson method of S with weights and a weak prior. Identifiability: at
u = i l / K << 1 only the stiffness F_max l / (2 K), the slope dF/di at i = 0, is observable
(`ratio_only`); near i = 1 only F_max (`limit_determined`).

Both tracks run on the same soil; each control step gives one sample per track. Per vehicle
and step:
    samples    only fresh drive data, |F| above its noise, belt or ground faster than SLOWEST,
               effort and slip not contradicting each other beyond noise
    outliers   innovation^2 > OUTLIER_GATE S is refused; PATIENCE of them in short succession,
               or windows that no soil explains, are a new soil: the window is emptied.
               Old samples of high slip and new ones of little make K a tenth of any
               soil's, without a misfit: such a K is a sign of a mixture too (NO_SOIL)
    fit        from the last converged values, which stay where it does not converge
    anchor     the prior mean moves on to the fit in those directions (eigenvectors of the data's
               information in units of the prior's) that the data determine DETERMINED times
               better than the prior, and only if they contradict it: else noise would let it drift
               along the directions that are hardly observable
Slip without a filter: i = (r omega - V) / max(|r omega|, |V|), V = v_x -+ w B / 2, with the
variance of first order; the error of v_x is shared by both tracks and counted twice, so that
two equal samples weigh as much as the one that they are.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.3.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators import soil_regression as sr
from baselines.estimators.measurement import (
    COLUMN,
    CONVERGING,
    DRIVE,
    HOLDING,
    POSE,
    REJECTED,
    BatchEstimator,
    Estimate,
    Measurement,
    Quantity,
)
from tracked_env.physics import lumped
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters, Range
from tracked_env.validation import checked_number, checked_whole

EFFORT_RANGE = (100.0, 1e6)  # [N] bounds of F_max
EFFORT_FLOOR = 5.0  # [N] sigma of the model: F is not quite quasi-static
SLIP_FLOOR = 2e-4  # [-] sigma of the model, likewise
CLEAR_EFFORT = 5.0  # [-] standard deviations that an effort must be above zero
# The UKF's slip errors hang together over some samples: variance counts that much more.
SLIP_CORRELATION = 10.0  # [control steps]
# In the stack. A second after a change of the soil, and of the slips behind it, all is new.
WINDOW = 40  # [control steps]
MAX_ITERATIONS = 20  # of one fit, as in S
PRIOR_SIGMA = (1.0, 0.7)  # [-] of ln F_max (weak soil to clay: a factor e), ln K (1 to 6 cm)
_WINDOW = Range(2, 10000, "control steps", "Did you pass seconds?")
_CORRELATED = Range(1.0, 1e4, "control steps", "1 = white.")
SLOWEST = 0.1  # [m/s] belt or ground must be faster: below it slip is noise
CONTRADICTION = 4.0  # [-] standard deviations by which a slip may be outside [0, 1]
OUTLIER_GATE = 25.0  # [-] five standard deviations
PATIENCE = 4  # [steps] that many outliers, or misfits in a row, are a new soil
START_SHARE = 1.1  # [-] F_max over the largest effort seen, first guess on a new soil
RECOVERY = 0.1  # [steps] by which a sample that fits lowers the count of outliers
DETERMINED = 25.0  # [-] data over prior information: F_max to 0.2 of itself, see PRIOR
SIGNIFICANT = 9.0  # [-] squared distance to the fit, in its variances, that moves the anchor
NO_SOIL = 9.0  # [-] squared distance to the nominal ln K, in the prior's variances, of no soil
MISFIT = 4.0  # [-] cost per sample of a window that mixes two soils; 1 is expected
SURPRISE = 9.0  # [-] normalised innovation squared that makes a holding vehicle fit at once
HOLD_STRIDE = 5  # [steps] between the fits of a vehicle that holds, with a full window

_BELT, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]
_V_X, _YAW_RATE = COLUMN["v_x"], COLUMN["yaw_rate"]


class Sensing(NamedTuple):
    """How slips and efforts follow from the channels, and how exactly."""

    radius: float  # [m] r
    half_gauge: float  # [m] B/2
    belt_variance: float  # [m^2/s^2] of V_t
    track_variance: float  # [m^2/s^2] of V; what both tracks share counts twice
    slip_variance: float  # [-] added to the variance of every slip
    least_effort: float  # [N]
    provided_scale: float  # [-] on the variance of slips that are provided
    window: int  # [control steps]


class Sample(NamedTuple):
    """One track's sample, mirrored so that the effort is positive. effort 0 = none."""

    slip: float
    effort: float
    variance: float


@formula
def _kinematic_slip(belt, track, sensing):
    """(slip ratio [-], its variance) from belt and track speed [m/s]."""
    larger = max(abs(belt), abs(track))
    inverse = 1.0 / max(larger, SLOWEST)
    belt_leads = abs(belt) >= abs(track)
    ratio = (track if belt_leads else belt) * inverse
    leading = sensing.belt_variance if belt_leads else sensing.track_variance
    trailing = sensing.track_variance if belt_leads else sensing.belt_variance
    variance = (trailing + ratio * ratio * leading) * inverse * inverse
    return soil.slip_ratio(belt, track), variance


@formula
def _sample(values, side, slips, sensing):
    """Sample of one track; side 0 left, 1 right. NaN effort: a channel is missing. values
    (CHANNELS,). slips: whether slips are provided, and these with their variances (2,)."""
    provided, ratios, variances = slips
    belt = values[_BELT + side] * sensing.radius
    torque = values[_TORQUE + side]
    track = values[_V_X] + (2.0 * side - 1.0) * sensing.half_gauge * values[_YAW_RATE]
    slip, variance = _kinematic_slip(belt, track, sensing)
    speed = max(abs(belt), abs(track))
    if provided:
        slip, variance = ratios[side], variances[side] * sensing.provided_scale
        # The ground moves at least as the slip says, also where v_x is missing.
        speed = max(abs(belt), abs(belt) * (1.0 - slip))
    variance += sensing.slip_variance
    effort = torque / sensing.radius
    forward = slip if effort >= 0.0 else -slip
    reach = CONTRADICTION * math.sqrt(variance)
    good = abs(effort) > sensing.least_effort and speed > SLOWEST
    good = good and forward > -reach and forward < 1.0 + reach and variance < math.inf
    missing = math.isnan(slip + variance + effort + belt)
    size = abs(effort) if good else 0.0
    return Sample(forward, math.nan if missing else size, variance)


@formula
def _covariance(row, model):
    """(P_FF, P_FK, P_KK) of (ln F_max, ln K)."""
    a = row.j_ff + model.information_f
    b = row.j_fk
    c = row.j_kk + model.information_k
    inverse = 1.0 / (a * c - b * b)
    return c * inverse, -b * inverse, a * inverse


@formula
def _innovation(row, sample, star, model):
    """Squared innovation of a sample with fitted slip `star` over its expected variance [-]."""
    log_f, log_k = row.log_f, row.log_k
    force, twist, error, weight, _star, _gain = sr.residual(
        sample.slip, sample.effort, sample.variance, star,
        math.exp(log_f), model.contact_length * math.exp(-log_k), model,
    )  # fmt: skip
    ff, fk, kk = _covariance(row, model)
    spread = force * force * ff - 2.0 * force * twist * fk + twist * twist * kk
    return error * error / (1.0 / weight + spread)


@formula
def _entry(window, slot):
    """A sample of the window."""
    return Sample(window[sr.SLIP, slot], window[sr.EFFORT, slot], window[sr.VARIANCE, slot])


@formula
def _insert(row, window, slot, sample, star):
    """Write a sample with fitted slip `star`, or an empty one, into the window."""
    used = sample.effort > 0.0
    window[sr.SLIP, slot] = sample.slip if used else 0.0
    window[sr.EFFORT, slot] = sample.effort if used else 0.0
    window[sr.VARIANCE, slot] = sample.variance if used else 0.0
    window[sr.STAR, slot] = star if used else 0.0
    window[sr.CLOCK, slot] = row.clock


@formula
def _excitation(row, model):
    """Eigenvalues and direction (see sr.eigen) of the information in units of the prior's [-]."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    return sr.eigen(row.j_ff * s_f * s_f, row.j_fk * s_f * s_k, row.j_kk * s_k * s_k)


@formula
def _move_anchor(row, model):
    """Let the prior mean follow the fit in the directions that the data determine."""
    s_f, s_k = 1.0 / math.sqrt(model.information_f), 1.0 / math.sqrt(model.information_k)
    smallest, largest, cosine, sine = _excitation(row, model)
    gap_f = (row.log_f - row.anchor_f) / s_f
    gap_k = (row.log_k - row.anchor_k) / s_k
    strong, weak = cosine * gap_f + sine * gap_k, cosine * gap_k - sine * gap_f
    if largest < DETERMINED or strong * strong * largest < SIGNIFICANT:
        strong = 0.0
    if smallest < DETERMINED or weak * weak * smallest < SIGNIFICANT:
        weak = 0.0
    row.anchor_f += s_f * (cosine * strong - sine * weak)
    row.anchor_k += s_k * (sine * strong + cosine * weak)


@formula
def _empty(row, model):
    """A new soil: forget the window of vehicle i; the estimate stays as the first guess."""
    row.changes += 1.0
    row.outliers = row.misfits = row.filled = row.next = 0.0
    row.j_ff = row.j_fk = row.j_kk = 0.0
    sr.forget(row, model)
    row.converged = 0.0


@formula
def _start(row, window, n, model):
    """(ln F_max, ln K) to start the fit from: the last converged values. After a new soil or a fit
    that failed: an F_max that just carries the largest effort in the window, and the anchor's K;
    the fitted slips start anew too."""
    log_f, log_k = row.log_f, row.log_k
    if row.converged < 0.5:
        largest = math.exp(model.low_f)
        for k in range(n):
            largest = max(largest, window[sr.EFFORT, k])
        log_f = min(math.log(START_SHARE * largest), model.high_f)
        log_k = row.anchor_k
        for k in range(0, n, 2):  # both tracks of a step
            left, right = _entry(window, k), _entry(window, k + 1)
            star_left, star_right = sr.sample_slips(left, right, log_f, log_k, model)
            if left.effort > 0.0:
                window[sr.STAR, k] = star_left
            if right.effort > 0.0:
                window[sr.STAR, k + 1] = star_right
    return log_f, log_k


@formula
def _fit(row, window, scratch, model):
    """Fit the window of vehicle i and remember the result if it converged."""
    n = int(2.0 * row.filled)
    start, anchor = _start(row, window, n, model), (row.anchor_f, row.anchor_k)
    log_f, log_k, normal, iterations, converged = sr.fit(window, n, scratch, start, anchor, model)
    row.iterations = iterations
    row.converged = 1.0 if converged else 0.0
    row.waiting = 0.0
    gap = log_k - model.nominal_k
    misfit = normal.cost > MISFIT * max(normal.samples, 1.0)
    misfit = misfit or gap * gap * model.information_k > NO_SOIL
    row.misfits = row.misfits + 1.0 if misfit else 0.0
    if row.misfits >= PATIENCE and normal.samples > 2 * PATIENCE:
        _empty(row, model)
    elif converged:
        # A fit worse than the noise explains knows less (Birge ratio).
        share = 1.0 / max(normal.cost / max(normal.samples, 1.0), 1.0)
        row.log_f = log_f
        row.log_k = log_k
        row.j_ff = share * normal.ff
        row.j_fk = share * normal.fk
        row.j_kk = share * normal.kk
        sr.claim(row, window, scratch, n, share, model)
        _move_anchor(row, model)


@formula
def _step(row, window, left, right, scratch, sensing, model):
    """Take the samples of both tracks. Returns (refused, mean innovation squared or NaN)."""
    count, total, worst = 0.0, 0.0, 0.0
    star_left, star_right = sr.sample_slips(left, right, row.log_f, row.log_k, model)
    for side in range(2):
        sample = left if side == 0 else right
        if sample.effort > 0.0:
            star = star_left if side == 0 else star_right
            nis = _innovation(row, sample, star, model)
            count += 1.0
            total += nis
            worst = max(worst, nis)
    refused = worst > OUTLIER_GATE
    row.iterations = 0.0
    if count > 0.0:
        outliers = row.outliers
        row.outliers = outliers + 1.0 if refused else max(outliers - RECOVERY, 0.0)
        if row.outliers >= PATIENCE:
            _empty(row, model)
            refused = False
        if not refused:
            row.taken = row.clock
            slot = 2 * int(row.next)
            _insert(row, window, slot, left, star_left)
            _insert(row, window, slot + 1, right, star_right)
            row.next = (row.next + 1.0) % sensing.window
            full = row.filled >= sensing.window
            row.filled = min(row.filled + 1.0, float(sensing.window))
            smallest, _largest, _cosine, _sine = _excitation(row, model)
            row.waiting += 1.0
            waits = full and smallest < DETERMINED and worst < SURPRISE
            if not waits or row.waiting >= HOLD_STRIDE:
                _fit(row, window, scratch, model)
    return refused, total / count if count > 0.0 else math.nan


@loop
def update_all(samples, slips, rows, windows, k, scratch, more, answers):
    """One sample of every vehicle. samples: values (N, CHANNELS), fresh (N, 3); slips: whether they
    are provided, ratios and variances (N, 2); rows (N,) and windows (N, BLOCKS, samples) of the
    memory are changed; k: Sensing and Model. Written are the answers (N,) and more: determined (N,)
    whether the data determine the effort limit, and fitted (N, 2, 2), the covariance by the fit
    alone, as if the soil never changed."""
    values, fresh = samples
    provided, ratios, variances = slips
    determined, fitted = more
    sensing, model = k
    for i in range(rows.shape[0]):
        row, out, refused, nis = rows[i], answers[i], False, math.nan
        row.iterations = 0.0
        row.clock += 1.0
        if fresh[i, DRIVE] and (provided or fresh[i, POSE]):
            of_vehicle = provided, ratios[i], variances[i]
            left = _sample(values[i], 0, of_vehicle, sensing)
            right = _sample(values[i], 1, of_vehicle, sensing)
            if math.isnan(left.effort + right.effort):
                row.skipped += 1.0
                refused = True
            else:
                refused, nis = _step(row, windows[i], left, right, scratch, sensing, model)
        sr.write_answer(row, model, out.value, out.covariance)
        ff, fk, kk = _covariance(row, model)
        fitted[i, 0, 0] = ff * out.value[0] * out.value[0]
        fitted[i, 0, 1] = fitted[i, 1, 0] = fk * out.value[0] * out.value[1]
        fitted[i, 1, 1] = kk * out.value[1] * out.value[1]
        smallest, largest, _cosine, _sine = _excitation(row, model)
        out.excitation = smallest
        out.condition = largest / smallest if smallest > 0.0 else math.inf
        out.status = REJECTED if refused else (CONVERGING if smallest > DETERMINED else HOLDING)
        out.nis, out.skipped = nis, row.skipped
        determined[i] = sr.limit_determined(row, model.contact_length)


def nominal_effort_maximum(parameters: PlantParameters) -> float:
    """F_max of one track [N]."""
    return float(lumped.drive_limits(parameters).effort_maximum)


class SoilEstimator(BatchEstimator):
    """Estimates [F_max [N], K [m]] of vehicles on the move; the nominal soil is the first guess.

    window: [control steps], 50 in S. correlation_steps: [control steps] over which errors of the
    slips are correlated; 1 = white. A filter's slip needs more, else the covariance is too small.
    limit_determined (N,): whether the data determined the effort limit after the last sample.
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
    kernel = update_all

    def __init__(
        self,
        *setting: Any,
        window: int = WINDOW,
        correlation_steps: float = SLIP_CORRELATION,
        **named: Any,
    ) -> None:
        super().__init__(*setting, **named)
        window = checked_whole("window", window, _WINDOW)
        correlation_steps = checked_number("correlation_steps", correlation_steps, _CORRELATED)
        p, sheet, count = self.parameters, self.data_sheet, len(self.memory)
        radius, half = p.sprocket_radius, 0.5 * p.track_gauge
        effort = math.hypot(sheet.torque_noise / radius, EFFORT_FLOOR)
        maximum = soil.maximum_tractive_effort(
            p.cohesion, p.friction_angle, p.track_width, p.contact_length, p.mass
        )
        maximum = min(max(maximum, EFFORT_RANGE[0]), EFFORT_RANGE[1])
        low_k, high_k = RANGES["shear_deformation_modulus"][:2]
        self._model = sr.Model(
            p.contact_length, effort * effort,
            1.0 / PRIOR_SIGMA[0] ** 2, 1.0 / PRIOR_SIGMA[1] ** 2,
            math.log(EFFORT_RANGE[0]), math.log(EFFORT_RANGE[1]),
            math.log(low_k), math.log(high_k), MAX_ITERATIONS,
            math.log(maximum), math.log(p.shear_deformation_modulus),
            self.control_period / sr.SOJOURN,
        )  # fmt: skip
        turn = half * half * (sheet.gyro_noise**2 + sheet.gyro_bias**2)
        self._sensing = Sensing(
            radius, half, (radius * sheet.sprocket_speed_noise) ** 2,
            2.0 * sheet.velocity_noise**2 + turn, SLIP_FLOOR**2, CLEAR_EFFORT * effort,
            correlation_steps, window,
        )  # fmt: skip
        self._slips: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._nothing = np.zeros((count, 2))
        self.limit_determined = np.zeros(count, dtype=bool)
        self.ring = np.zeros((count, sr.BLOCKS * 2 * window))
        self.fitted = np.empty((count, 2, 2))  # covariance on a soil that never changes
        self._scratch = np.zeros((2 * sr.ROWS + 1, 2 * window))
        log_f, log_k = self._model.nominal_f, self._model.nominal_k
        self.initial = {
            "log_f": log_f, "log_k": log_k, "anchor_f": log_f, "anchor_k": log_k, "converged": 1.0,
            "p_ff": PRIOR_SIGMA[0] ** 2, "p_kk": PRIOR_SIGMA[1] ** 2,
        }  # fmt: skip
        self.reset()

    def take_over(self, parts: Mapping[str, Any], estimates: Mapping[str, Estimate]) -> None:
        """The slips of the filter."""
        self._slips = parts["slip"].slips_and_variances()

    def provide_slip(self, slip: ArrayLike, variance: ArrayLike) -> None:
        """Slip ratios (N, 2) and their variances for the next update, such as a filter's.

        Without this call the slip follows from sprocket speeds, v_x and yaw rate of the
        measurement. Raises ValueError for other shapes.
        """
        shape = (len(self.memory), 2)
        slips = np.array(slip, float, order="C"), np.array(variance, float, order="C")
        if slips[0].shape != shape or slips[1].shape != shape:
            raise ValueError(f"slip {slips[0].shape}, variance {slips[1].shape}; must be {shape}")
        self._slips = slips

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """Samples, provided slips once, state, constants, and what else is written."""
        slips = (self._slips is not None, *(self._slips or (self._nothing, self._nothing)))
        self._slips, count = None, len(self.memory)
        self.limit_determined = np.empty(count, dtype=bool)
        windows, k = self.ring.reshape(count, sr.BLOCKS, -1), (self._sensing, self._model)
        more = self.limit_determined, self.fitted
        return measurement[:2], slips, self.rows, windows, k, self._scratch, more

    @property
    def iterations(self) -> NDArray[np.int64]:
        """Steps of the fit in the last update, (N,); 0 where there was none."""
        return self.rows["iterations"].astype(np.int64)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Whether the last fit converged, (N,); else the values before it are kept."""
        return self.rows["converged"] > 0.5

    @property
    def stiffness(self) -> NDArray[np.float64]:
        """F_max l / (2 K) [N], the slope dF/di at i = 0, (N,)."""
        difference = self.rows["log_f"] - self.rows["log_k"]
        return 0.5 * self._model.contact_length * np.exp(difference)

    @property
    def ratio_only(self) -> NDArray[np.bool_]:
        """True where the data determine the stiffness, but not F_max, to 20 %, (N,)."""
        stiff = self._variance(-1.0, self._model) * DETERMINED <= 1.0
        return stiff & (self._variance(0.0, None) * DETERMINED > 1.0)

    def _variance(self, twist: float, model: sr.Model | None) -> NDArray[np.float64]:
        """Variance of ln F_max + twist ln K; without a model from the data alone (or inf)."""
        prior = (0.0, 0.0) if model is None else (model.information_f, model.information_k)
        a, b = self.rows["j_ff"] + prior[0], self.rows["j_fk"]
        c = self.rows["j_kk"] + prior[1]
        determinant = a * c - b * b
        safe = determinant > 1e-12 * a * c
        numerator = c - 2.0 * b * twist + a * np.square(twist)
        return np.divide(numerator, determinant, out=np.full(len(a), np.inf), where=safe)
