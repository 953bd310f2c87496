"""Estimator of the drives: gain of each, and their lag, from commands and torques.

Recursive least squares of `actuator_step` for N vehicles, with its prior from the nominal vehicle
and the data sheet. Both drives have the same lag; their gains may differ, and step on the way.

What the drives make of their commands: gain of each, and lag, from commands and torques.

    torque_k(n) = a torque_k(n-1) + b_k limit u_k(n),   a = exp(-dt / T),   b_k = g_k (1 - a)
    sensor_k(n) = torque_k(n) - J domega_k(n)/dt
with u_k(n) the command (action) in force before step n, T the lag of both drives, g_k the gain of
each, k = L, R, and J what the soil does not get of the torque: the inertia of a drive and track, or
0 on a plant without. Recursive least squares on the output error [1], of [b_L, b_R, a, J]: the
model runs on commands alone, which are known without noise, so nothing biases these parameters.
Its sensitivities obey the same equation,
    db_k(n) = a db_k(n-1) + limit u_k(n),       da_k(n) = a da_k(n-1) + torque_k(n-1)
and the model is moved along them with every correction. It is b_k and a, not g_k and T, since the
first samples are linear in them. A sample waits for the next one, for domega/dt = the difference of
its neighbours over the time between them; while the lag is not known it does not. Old data fade by
random walks of g_k and a. JUMP_AFTER outliers of one drive in a row are a change of its gain, or of
the lag.
The sensor shows the torque that reaches the soil. It is that of the drive only where the soil
carries it: a track that may slip fast, or a sprocket near its top speed, says nothing of its drive.

References: [1] L. Ljung, System Identification, 2nd ed., section 11.4.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    AnsweringEstimator,
    DataSheet,
    Estimate,
    Estimator,
    Measurement,
    Quantity,
    Setting,
)
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES, PlantParameters
from tracked_env.validation import CONTROL_PERIOD, VEHICLES, checked_number, checked_whole

LARGEST_DECAY = 0.99  # [-] at 50 Hz a lag of 2 s
LEAST_DECAY = 1e-3  # [-] at 50 Hz a lag of 3 ms: as good as none
SLIPPING = 0.5  # [-] slip ratio beyond which the soil may limit the torque
UNSURE = 0.06  # [m/s] of the slip velocity: slower tracks say nothing
OUTLIER = 5.0  # [-] standard deviations of the innovation
UNKNOWN = 0.5  # [-] of the prior variance of a: above it samples do not wait
JUMP_AFTER = 3  # [-] outliers of one drive in a row are a change

# Columns of `memory`: clocks; the sample that waits (when it was taken, plus one; torques; speeds
# of the sprockets) and the one before (when, speeds); the model; parameters and their covariance;
# room for a regressor and P times it; then a ring of commands, two per step.
(
    STEPS, MODELLED, SKIPPED, WAITING, HELD, _HELD_RIGHT, SPEED, _SPEED_RIGHT, BEFORE, EARLIER,
    _EARLIER_RIGHT, TORQUE, _TORQUE_RIGHT, DA, _DA_RIGHT, DB, _DB_RIGHT, OUTLIERS, _OUTLIERS_RIGHT,
) = range(19)  # fmt: skip
B, A, INERTIA = 19, 21, 22
ORDER = 4  # b_L, b_R, a, J
P = B + ORDER
PHI = P + ORDER * ORDER
P_PHI = PHI + ORDER
RING = P_PHI + ORDER
# Columns of an answer.
VALUES, VARIANCES, ANSWER_STATUS, ANSWER_NIS, ANSWER_SKIPPED = 0, 3, 9, 10, 11
ANSWER = 12
CONVERGING, HOLDING, REJECTED = 0, 1, 2  # of estimate.Status, as plain numbers for kernels

_V_X, _W = COLUMN["v_x"], COLUMN["yaw_rate"]
_SPROCKET, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]


class Model(NamedTuple):
    """Constants of the estimator."""

    period: float  # [s]
    slots: int  # of the ring
    limit: float  # [N m] of one drive
    radius: float  # [m] r
    half_gauge: float  # [m] B/2
    fastest: float  # [rad/s] of a sprocket that is used
    variance: float  # [N^2 m^2] of one torque
    speed_variance: float  # [rad^2/s^2] of the difference of two speeds of a sprocket
    inertia: float  # [kg m^2] J, nominal
    longest: float  # [steps] between the neighbours of a sample
    decay: float  # [-] prior mean of a
    gain_variance: float  # [-] prior
    decay_variance: float  # [-] prior
    gain_walk: float  # [-] variance per step
    decay_walk: float  # [-] variance per step
    jump_variance: float  # [-] of a after a change
    gain_low: float  # [-]
    gain_high: float  # [-]


@formula
def _doubt(memory, i, left, right, decay, inertia, variance):
    """Add a variance to P along a direction of [b_L, b_R, a, J]."""
    way = (left, right, decay, inertia)
    for row in range(ORDER):
        for column in range(ORDER):
            memory[i, P + ORDER * row + column] += variance * way[row] * way[column]


@formula
def _doubt_gain(memory, i, side, variance):
    """Add a variance [-] of the gain of one drive, 0 left, 1 right."""
    open_ = 1.0 - memory[i, A]
    _doubt(memory, i, open_ * (1.0 - side), open_ * side, 0.0, 0.0, variance)


@formula
def _doubt_lag(memory, i, variance):
    """Add a variance [-] of a, with the gains as they are: b_k changes by -g_k times as much."""
    inverse = 1.0 / (1.0 - memory[i, A])
    left, right = memory[i, B] * inverse, memory[i, B + 1] * inverse
    _doubt(memory, i, -left, -right, 1.0, 0.0, variance)


@formula
def _begin(memory, i, model):
    """The prior, where nothing has been seen: J between 0 and that of the nominal vehicle."""
    memory[i, A] = model.decay
    memory[i, B] = memory[i, B + 1] = 1.0 - model.decay
    memory[i, INERTIA] = 0.5 * model.inertia
    _doubt_gain(memory, i, 0, model.gain_variance)
    _doubt_gain(memory, i, 1, model.gain_variance)
    _doubt_lag(memory, i, model.decay_variance)
    _doubt(memory, i, 0.0, 0.0, 0.0, 0.5 * model.inertia, 1.0)


@formula
def _advance(memory, i, model):
    """Move the model by one step, with the commands in force then."""
    step = int(memory[i, MODELLED]) + 1
    at = RING + 2 * (step % model.slots)
    a = memory[i, A]
    for side in range(2):
        torque, command = memory[i, TORQUE + side], memory[i, at + side]
        memory[i, DA + side] = a * memory[i, DA + side] + torque
        memory[i, DB + side] = a * memory[i, DB + side] + command
        memory[i, TORQUE + side] = a * torque + memory[i, B + side] * command
    memory[i, MODELLED] = step


@formula
def _carried(z, i, side, model):
    """Whether the soil carries what the drive gives, as far as speeds tell."""
    sign = 2.0 * side - 1.0
    track = z[i, _V_X] + sign * z[i, _W] * model.half_gauge
    sprocket = z[i, _SPROCKET + side]
    belt = sprocket * model.radius
    slip = abs(belt - track) + UNSURE
    return abs(sprocket) < model.fastest and slip < SLIPPING * max(abs(belt), abs(track))


@formula
def _correct(memory, i, side, rate, rate_variance, model):
    """Take the torque that waits of one drive, 0 left, 1 right, at domega/dt = rate [rad/s^2].

    Returns (innovation squared over its variance, whether it was used).
    """
    torque, inertia = memory[i, HELD + side], memory[i, INERTIA]
    memory[i, PHI + 1 - side] = 0.0
    memory[i, PHI + side] = memory[i, DB + side]
    memory[i, PHI + 2], memory[i, PHI + 3] = memory[i, DA + side], -rate
    spread = model.variance + inertia * inertia * rate_variance
    for row in range(ORDER):
        entry = 0.0
        for column in range(ORDER):
            entry += memory[i, P + ORDER * row + column] * memory[i, PHI + column]
        memory[i, P_PHI + row] = entry
        spread += memory[i, PHI + row] * entry
    innovation = torque - (memory[i, TORQUE + side] - inertia * rate)
    nis = innovation * innovation / spread
    if nis > OUTLIER * OUTLIER:
        memory[i, OUTLIERS + side] += 1.0
        if memory[i, OUTLIERS + side] >= JUMP_AFTER:
            _doubt_gain(memory, i, side, model.gain_variance)
            _doubt_lag(memory, i, model.jump_variance)
            # Whatever made it so, the torque is what it is.
            memory[i, TORQUE + side] = torque + inertia * rate
            memory[i, DA + side] = memory[i, DB + side] = memory[i, OUTLIERS + side] = 0.0
        return nis, False
    memory[i, OUTLIERS + side] = 0.0
    step = innovation / spread
    before = memory[i, A]
    memory[i, A] = min(max(before + memory[i, P_PHI + 2] * step, LEAST_DECAY), LARGEST_DECAY)
    memory[i, INERTIA] += memory[i, P_PHI + 3] * step
    for drive in range(2):  # the model as it would be with these parameters from the start
        change = memory[i, P_PHI + drive] * step
        memory[i, B + drive] += change
        memory[i, TORQUE + drive] += (
            memory[i, DA + drive] * (memory[i, A] - before) + memory[i, DB + drive] * change
        )
    for row in range(ORDER):
        for column in range(ORDER):
            product = memory[i, P_PHI + row] * memory[i, P_PHI + column]
            memory[i, P + ORDER * row + column] -= product / spread
    _doubt_gain(memory, i, side, model.gain_walk)
    _doubt_lag(memory, i, 0.5 * model.decay_walk)
    return nis, True


@formula
def _take(memory, z, i, taken, model):
    """Use the sample that waits, whose neighbours are known now; returns (sum of normalised
    innovations squared, drives used, whether a sample was refused).

    domega/dt is as uncertain as the sensor makes it, and as what it changes by meanwhile.
    """
    span = (taken + 1.0 - memory[i, BEFORE]) * model.period
    total, used, refused = 0.0, 0, False
    for side in range(2):
        newest, before = z[i, _SPROCKET + side], memory[i, EARLIER + side]
        rate = (newest - before) / span
        bend = (newest - memory[i, SPEED + side] - memory[i, SPEED + side] + before) / span
        if math.isfinite(memory[i, HELD + side]) and math.isfinite(rate + bend):
            variance = model.speed_variance / (span * span) + bend * bend
            nis, good = _correct(memory, i, side, rate, variance, model)
            total += nis
            used += 1
            refused = refused or not good
    return total, used, refused


@formula
def _take_at_once(memory, i, model):
    """Use the newest sample without its next neighbour, instead of letting it wait; as `_take`.

    domega/dt is that of the last step, and may be wrong by all of itself.
    """
    span = (memory[i, WAITING] - memory[i, BEFORE]) * model.period
    total, used, refused = 0.0, 0, False
    for side in range(2):
        rate = (memory[i, SPEED + side] - memory[i, EARLIER + side]) / span
        if math.isfinite(memory[i, HELD + side] + rate):
            variance = model.speed_variance / (span * span) + rate * rate
            nis, good = _correct(memory, i, side, rate, variance, model)
            total += nis
            used += 1
            refused = refused or not good
        memory[i, HELD + side] = np.nan
    return total, used, refused


@formula
def _answer(memory, i, model, out):
    """g_L, g_R, a and their covariance into out (N, ANSWER); gains within their range."""
    s = 1.0 / (1.0 - memory[i, A])
    left, right = s * memory[i, B], s * memory[i, B + 1]
    p_ll, p_lr, p_la = memory[i, P], memory[i, P + 1], memory[i, P + 2]
    p_rr, p_ra, p_aa = memory[i, P + 5], memory[i, P + 6], memory[i, P + 10]
    out[i, 0] = min(max(left, model.gain_low), model.gain_high)
    out[i, 1] = min(max(right, model.gain_low), model.gain_high)
    out[i, 2] = memory[i, A]
    out[i, 3] = s * s * (p_ll + 2.0 * left * p_la + left * left * p_aa)
    out[i, 4] = s * s * (p_lr + right * p_la + left * p_ra + left * right * p_aa)
    out[i, 5] = s * s * (p_rr + 2.0 * right * p_ra + right * right * p_aa)
    out[i, 6] = s * (p_la + left * p_aa)
    out[i, 7] = s * (p_ra + right * p_aa)
    out[i, 8] = p_aa


@loop
def update_all(z, fresh, age, command_left, command_right, memory, model, out):
    """One sample of every vehicle: z (N, 13), fresh, age (N, 3), commands (N,) [-] in force before
    now; memory (N, columns) in and out; out (N, ANSWER)."""
    for i in range(z.shape[0]):
        step = int(memory[i, STEPS])
        if step == 0:
            _begin(memory, i, model)
        at = RING + 2 * (step % model.slots)
        memory[i, at] = model.limit * command_left[i]
        memory[i, at + 1] = model.limit * command_right[i]
        status, nis, used = HOLDING, 0.0, 0
        taken = step - int(age[i, DRIVE] / model.period + 0.5)
        new = fresh[i, DRIVE] and taken >= memory[i, WAITING]
        waiting = int(memory[i, WAITING]) - 1
        until = max(waiting if new else 0, step - model.slots + 1)
        while memory[i, MODELLED] < until:
            _advance(memory, i, model)
        if new:
            close = taken + 1.0 - memory[i, BEFORE] <= model.longest
            if memory[i, BEFORE] > 0.0 and close and waiting == memory[i, MODELLED]:
                nis, used, refused = _take(memory, z, i, taken, model)
                status = REJECTED if refused else HOLDING
            memory[i, BEFORE], memory[i, WAITING] = memory[i, WAITING], taken + 1.0
            for side in range(2):
                memory[i, EARLIER + side] = memory[i, SPEED + side]
                memory[i, SPEED + side] = z[i, _SPROCKET + side]
                torque = z[i, _TORQUE + side]
                if not math.isfinite(torque + z[i, _V_X] + z[i, _W] + z[i, _SPROCKET + side]):
                    memory[i, SKIPPED] += 1.0
                    status, torque = REJECTED, np.nan
                elif not _carried(z, i, side, model):
                    torque = np.nan
                memory[i, HELD + side] = torque
            unsure = memory[i, P + 2 * ORDER + 2] > UNKNOWN * model.decay_variance
            if unsure and taken + 1.0 - memory[i, BEFORE] == 1.0 and memory[i, BEFORE] > 0.0:
                while memory[i, MODELLED] < taken:
                    _advance(memory, i, model)
                nis, used, refused = _take_at_once(memory, i, model)
                status = REJECTED if refused else status
        _answer(memory, i, model, out)
        if used > 0 and status == HOLDING:
            known = max(out[i, 3], out[i, 5]) < 0.5 * model.gain_variance
            if known and out[i, 8] < 0.5 * model.decay_variance:
                status = CONVERGING
        memory[i, STEPS] = step + 1.0
        out[i, ANSWER_STATUS] = status
        out[i, ANSWER_NIS] = nis if used == 2 else np.nan
        out[i, ANSWER_SKIPPED] = memory[i, SKIPPED]


COMMANDS = ("previous_action_left", "previous_action_right")  # fields of the observation
LONGEST_AGE = 1.0  # [s] of a drive sample that is used
LONGEST_SPAN = 0.2  # [s] between the neighbours of a sample that is used
GAIN_SIGMA = 0.3  # [-] prior standard deviation
DECAY_SIGMA = 0.2  # [-] the same of a, at 50 Hz; T = 0.05 s is a = 0.67, T = 0.3 s is a = 0.94
GAIN_WALK = 0.004  # [1/sqrt(s)] random walk of a gain
DECAY_WALK = 0.002  # [1/sqrt(s)] of a
DECAY_JUMP = 0.03  # [-] of a, where a gain seems to have changed
MODEL_NOISE = 0.0005  # [-] of the torque limit: what the model leaves out
FASTEST = 0.85  # [-] of the top speed: from here on a drive may give less


class ActuatorEstimator(AnsweringEstimator):
    """Estimates [drive_time_constant T [s], gains of the left and right drive [-]] of N vehicles.

    parameters: nominal ones. control_period [s]. data_sheet: noise of the sensors. count: vehicles.
    Raises ValueError for a period or count that makes no sense.
    """

    names = ("drive_time_constant", "actuator_gain_left", "actuator_gain_right")
    provides = (
        Quantity("drive_time_constant", "s"),
        Quantity("actuator_gain_left", "-"),
        Quantity("actuator_gain_right", "-"),
    )
    needs = (
        "v_x", "yaw_rate", "sprocket_speed_left", "sprocket_speed_right", "torque_left",
        "torque_right", *COMMANDS,
    )  # fmt: skip
    paired = True

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float = 0.02,
        data_sheet: DataSheet | None = None,
        count: int = 1,
    ) -> None:
        period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        sheet = DataSheet() if data_sheet is None else data_sheet
        p = parameters
        lag = float(p.drive_time_constant)
        decay = math.exp(-period / lag) if lag > 0.0 else LEAST_DECAY
        bounds = RANGES["actuator_gain_left"]
        self._model = Model(
            period, round(LONGEST_AGE / period) + 2, float(p.torque_limit),
            float(p.sprocket_radius), 0.5 * float(p.track_gauge),
            FASTEST * float(p.sprocket_speed_limit),
            sheet.torque_noise**2 + (MODEL_NOISE * float(p.torque_limit)) ** 2,
            2.0 * sheet.sprocket_speed_noise**2, float(p.sprocket_inertia),
            max(LONGEST_SPAN / period, 2.0) + 0.5,
            min(max(decay, LEAST_DECAY), LARGEST_DECAY), GAIN_SIGMA**2, DECAY_SIGMA**2,
            GAIN_WALK**2 * period, DECAY_WALK**2 * period, DECAY_JUMP**2, bounds.low, bounds.high,
        )  # fmt: skip
        self.memory = np.zeros((count, RING + 2 * self._model.slots))

    @classmethod
    def for_stack(cls, setting: Setting) -> "ActuatorEstimator":
        """As a part of the identification stack."""
        return cls(setting.parameters, setting.control_period, setting.data_sheet, setting.count)

    def take_over(self, parts: Mapping[str, Estimator], estimates: Mapping[str, Estimate]) -> None:
        """Nothing is needed of other estimators."""

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        self.memory[slice(None) if rows is None else np.asarray(rows)] = 0.0

    def compute(self, measurement: Measurement) -> NDArray[np.float64]:
        """Take one sample; the bare answer (N, ANSWER): g_L, g_R, a, their covariance (LL, LR, RR,
        La, Ra, aa), status, NIS, samples skipped."""
        out = np.empty((len(self.memory), ANSWER))
        left, right = (measurement.channel(name) for name in COMMANDS)
        update_all(
            measurement.values, measurement.fresh, measurement.age, left, right, self.memory,
            self._model, out,
        )  # fmt: skip
        return out

    def belt_inertia(self) -> NDArray[np.float64]:
        """J [kg m^2] of a drive and track that the torques show, (N,); 0 on a plant without."""
        return self.memory[:, INERTIA].copy()

    def update(self, measurement: Measurement) -> Estimate:
        """Take one sample of every vehicle."""
        return self.estimate(self.compute(measurement))

    def estimate(self, answer: NDArray[np.float64]) -> Estimate:
        """The answer of the kernel as an Estimate; the lag to first order."""
        model, value = self._model, np.empty((len(answer), 3))
        decay = answer[:, 2]
        value[:, 0] = lag(decay, model.period)
        value[:, 1:] = answer[:, :2]
        slope = value[:, 0] ** 2 / (model.period * decay)  # dT/da
        index = np.array([[5, 3, 4], [3, 0, 1], [4, 1, 2]])
        raw = answer[:, VARIANCES:ANSWER_STATUS][:, index]
        jacobian = np.ones_like(value)
        jacobian[:, 0] = slope
        prior = np.sqrt([model.decay_variance, model.gain_variance, model.gain_variance])
        information = np.linalg.eigvalsh(np.linalg.inv(raw / np.outer(prior, prior))) - 1.0
        smallest, largest = np.maximum(information[:, 0], 0.0), information[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            condition = np.where(smallest > 0.0, largest / smallest, np.inf)
        return Estimate(
            self.names,
            value,
            raw * jacobian[:, :, None] * jacobian[:, None, :],
            smallest,
            condition,
            answer[:, ANSWER_STATUS].astype(np.int64),
            answer[:, ANSWER_NIS],
            answer[:, ANSWER_SKIPPED].astype(np.int64),
        )


def lag(decay: NDArray[np.float64], period: float) -> NDArray[np.float64]:
    """T [s] from a = exp(-dt / T), dt = period [s]."""
    return np.asarray(-period / np.log(decay))
