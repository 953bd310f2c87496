"""Estimator of the drives: gain of each, and their lag, from commands and torques.

    torque_k(n) = a torque_k(n-1) + b_k limit u_k(n),   a = exp(-dt / T),   b_k = g_k (1 - a)
    sensor_k(n) = torque_k(n) - J domega_k(n)/dt
with u_k(n) the command (action) in force before step n, T the lag of both drives, g_k the gain of
each, k = L, R, and J what the soil does not get of the torque: the inertia of a drive and track, or
0 on a plant without. Recursive least squares on the output error [1], of [b_L, b_R, a, J]: the
model runs on commands alone, which have no noise, so nothing biases these parameters.
Its sensitivities obey the same equation,
    db_k(n) = a db_k(n-1) + limit u_k(n),       da_k(n) = a da_k(n-1) + torque_k(n-1)
and the model is moved along them with every correction. It is b_k and a, not g_k and T, since the
first samples are linear in them. A sample waits for the next one, for domega/dt = the difference of
its neighbours over the time between them; while the lag is uncertain it does not. Old data fade by
random walks of g_k and a. JUMP_AFTER outliers of one drive in a row are a change of its gain, or of
the lag.
The sensor shows the torque that reaches the soil. It is that of the drive only where the soil
carries it: a track that may slip fast, or a sprocket near its top speed, says nothing of its drive.
The prior is from the nominal vehicle and the data sheet. Both drives have the same lag; their gains
may differ, and step on the way.

References: [1] L. Ljung, System Identification, 2nd ed., section 11.4.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators.measurement import (
    COLUMN,
    CONVERGING,
    DRIVE,
    HOLDING,
    LONGEST_AGE,
    REJECTED,
    BatchEstimator,
    Estimate,
    Measurement,
    Quantity,
)
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import RANGES

COMMANDS = ("previous_action_left", "previous_action_right")  # fields of the observation
LONGEST_SPAN = 0.2  # [s] between the neighbours of a sample that is used
GAIN_SIGMA = 0.3  # [-] prior standard deviation
DECAY_SIGMA = 0.2  # [-] the same of a, at 50 Hz; T = 0.05 s is a = 0.67, T = 0.3 s is a = 0.94
GAIN_WALK = 0.004  # [1/sqrt(s)] random walk of a gain
DECAY_WALK = 0.002  # [1/sqrt(s)] of a
DECAY_JUMP = 0.03  # [-] of a, where a gain seems to have changed
MODEL_NOISE = 0.0005  # [-] of the torque limit: what the model leaves out
TOP_SPEED_SHARE = 0.85  # [-] of the top speed: from here on a drive may give less
LARGEST_DECAY = 0.99  # [-] at 50 Hz a lag of 2 s
LEAST_DECAY = 1e-3  # [-] at 50 Hz a lag of 3 ms: as good as none
LARGEST_SLIP = 0.5  # [-] slip ratio beyond which the soil may limit the torque
SLIP_SPEED_FLOOR = 0.06  # [m/s] added to the slip velocity: slower tracks say nothing
OUTLIER = 5.0  # [-] standard deviations of the innovation
UNDETERMINED = 0.5  # [-] of the prior variance of a: above it samples do not wait
JUMP_AFTER = 3  # [-] outliers of one drive in a row are a change

ORDER = 4  # b_L, b_R, a, J
# The state of the estimator for one vehicle; pairs are left and right.
ROW = np.dtype([
    ("steps", float), ("modelled", float),  # control steps so far, and of the model
    ("skipped", float),
    # The sample that waits: when it was taken, plus one; torques; speeds of the sprockets.
    ("waiting", float), ("measured", float, 2), ("speed", float, 2),
    ("before", float), ("earlier", float, 2),  # the one before: when, speeds
    ("torque", float, 2), ("da", float, 2), ("db", float, 2),  # the model and its sensitivities
    ("outliers", float, 2),  # in a row
    ("b", float, 2), ("a", float), ("inertia", float),
    ("p", float, (ORDER, ORDER)),  # covariance of [b_L, b_R, a, J]
    ("phi", float, ORDER), ("p_phi", float, ORDER),  # room for a regressor and P times it
])  # fmt: skip
_V_X, _W = COLUMN["v_x"], COLUMN["yaw_rate"]
_SPROCKET, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]


class Model(NamedTuple):
    """Constants of the estimator."""

    period: float  # [s]
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
def _doubt(row, left, right, decay, inertia, variance):
    """Add a variance to P along a direction of [b_L, b_R, a, J]."""
    direction = (left, right, decay, inertia)
    for r in range(ORDER):
        for c in range(ORDER):
            row.p[r, c] += variance * direction[r] * direction[c]


@formula
def _doubt_gain(row, side, variance):
    """Add a variance [-] of the gain of one drive, 0 left, 1 right."""
    open_ = 1.0 - row.a
    _doubt(row, open_ * (1.0 - side), open_ * side, 0.0, 0.0, variance)


@formula
def _doubt_lag(row, variance):
    """Add a variance [-] of a, with the gains as they are: b_k changes by -g_k times as much."""
    inverse = 1.0 / (1.0 - row.a)
    left, right = row.b[0] * inverse, row.b[1] * inverse
    _doubt(row, -left, -right, 1.0, 0.0, variance)


@formula
def _begin(row, model):
    """The prior, where nothing has been seen: J between 0 and that of the nominal vehicle."""
    row.a = model.decay
    row.b[0] = row.b[1] = 1.0 - model.decay
    row.inertia = 0.5 * model.inertia
    _doubt_gain(row, 0, model.gain_variance)
    _doubt_gain(row, 1, model.gain_variance)
    _doubt_lag(row, model.decay_variance)
    _doubt(row, 0.0, 0.0, 0.0, 0.5 * model.inertia, 1.0)


@formula
def _advance(row, ring):
    """Move the model by one step, with the commands in force then, of the ring (2 * slots,)."""
    step = int(row.modelled) + 1
    at = 2 * (step % (ring.shape[0] // 2))
    a = row.a
    for side in range(2):
        torque, command = row.torque[side], ring[at + side]
        row.da[side] = a * row.da[side] + torque
        row.db[side] = a * row.db[side] + command
        row.torque[side] = a * torque + row.b[side] * command
    row.modelled = step


@formula
def _shows_drive(z, i, side, model):
    """Whether the soil carries what the drive gives, as far as speeds tell."""
    sign = 2.0 * side - 1.0
    track = z[i, _V_X] + sign * z[i, _W] * model.half_gauge
    sprocket = z[i, _SPROCKET + side]
    belt = sprocket * model.radius
    slip = abs(belt - track) + SLIP_SPEED_FLOOR
    return abs(sprocket) < model.fastest and slip < LARGEST_SLIP * max(abs(belt), abs(track))


@formula
def _correct(row, side, rate, rate_variance, model):
    """Take the torque that waits of one drive, 0 left, 1 right, at domega/dt = rate [rad/s^2].
    Returns (innovation squared over its variance, whether it was used)."""
    torque, inertia = row.measured[side], row.inertia
    row.phi[1 - side], row.phi[side] = 0.0, row.db[side]
    row.phi[2], row.phi[3] = row.da[side], -rate
    spread = model.variance + inertia * inertia * rate_variance
    for r in range(ORDER):
        entry = 0.0
        for c in range(ORDER):
            entry += row.p[r, c] * row.phi[c]
        row.p_phi[r] = entry
        spread += row.phi[r] * entry
    innovation = torque - (row.torque[side] - inertia * rate)
    nis = innovation * innovation / spread
    if nis > OUTLIER * OUTLIER:
        row.outliers[side] += 1.0
        if row.outliers[side] >= JUMP_AFTER:
            _doubt_gain(row, side, model.gain_variance)
            _doubt_lag(row, model.jump_variance)
            row.torque[side] = torque + inertia * rate
            row.da[side] = row.db[side] = row.outliers[side] = 0.0
        return nis, False
    row.outliers[side] = 0.0
    step = innovation / spread
    before = row.a
    row.a = min(max(before + row.p_phi[2] * step, LEAST_DECAY), LARGEST_DECAY)
    row.inertia += row.p_phi[3] * step
    for drive in range(2):  # the model as it would be with these parameters from the start
        change = row.p_phi[drive] * step
        row.b[drive] += change
        row.torque[drive] += row.da[drive] * (row.a - before) + row.db[drive] * change
    for r in range(ORDER):
        for c in range(ORDER):
            row.p[r, c] -= row.p_phi[r] * row.p_phi[c] / spread
    _doubt_gain(row, side, model.gain_walk)
    _doubt_lag(row, 0.5 * model.decay_walk)
    return nis, True


@formula
def _use(row, z, i, span, at_once, model):
    """Use the sample that waits; returns (sum of normalised innovations squared, drives used,
    whether a sample was refused). domega/dt over `span` [s] is as uncertain as the sensor makes it,
    and as what it changes by meanwhile. at_once: without its next neighbour; domega/dt is then that
    of the last step, and may be wrong by all of itself."""
    total, used, refused = 0.0, 0, False
    for side in range(2):
        before = row.earlier[side]
        newest = row.speed[side] if at_once else z[i, _SPROCKET + side]
        rate = (newest - before) / span
        bend = rate if at_once else (newest - row.speed[side] - row.speed[side] + before) / span
        if math.isfinite(row.measured[side]) and math.isfinite(rate + bend):
            variance = model.speed_variance / (span * span) + bend * bend
            nis, good = _correct(row, side, rate, variance, model)
            total += nis
            used += 1
            refused = refused or not good
        if at_once:
            row.measured[side] = np.nan
    return total, used, refused


@formula
def _write_answer(row, model, out):
    """a, the gains within their range, and their covariance into `out`, an answer_row."""
    s, p, c = 1.0 / (1.0 - row.a), row.p, out.covariance
    left, right = s * row.b[0], s * row.b[1]
    p_ll, p_lr, p_la, p_rr, p_ra, p_aa = p[0, 0], p[0, 1], p[0, 2], p[1, 1], p[1, 2], p[2, 2]
    out.value[0] = row.a
    out.value[1] = min(max(left, model.gain_low), model.gain_high)
    out.value[2] = min(max(right, model.gain_low), model.gain_high)
    c[0, 0] = p_aa
    c[0, 1] = c[1, 0] = s * (p_la + left * p_aa)
    c[0, 2] = c[2, 0] = s * (p_ra + right * p_aa)
    c[1, 1] = s * s * (p_ll + 2.0 * left * p_la + left * left * p_aa)
    c[1, 2] = c[2, 1] = s * s * (p_lr + right * p_la + left * p_ra + left * right * p_aa)
    c[2, 2] = s * s * (p_rr + 2.0 * right * p_ra + right * right * p_aa)


@loop
def update_all(samples, commands, rows, rings, model, out):
    """One sample of every vehicle: samples z (N, 13), fresh, age (N, 3); commands (2, N) [-] in
    force before now; rows (N,) and rings (N, 2 * slots) of commands are changed, out is written."""
    z, fresh, age = samples
    slots = rings.shape[1] // 2
    for i in range(z.shape[0]):
        row, ring, answer = rows[i], rings[i], out[i]
        step = int(row.steps)
        if step == 0:
            _begin(row, model)
        at = 2 * (step % slots)
        ring[at], ring[at + 1] = model.limit * commands[0, i], model.limit * commands[1, i]
        status, nis, used = HOLDING, 0.0, 0
        taken = step - int(age[i, DRIVE] / model.period + 0.5)
        new = fresh[i, DRIVE] and taken >= row.waiting
        waiting = int(row.waiting) - 1
        until = max(waiting if new else 0, step - slots + 1)
        while row.modelled < until:
            _advance(row, ring)
        if new:
            close = taken + 1.0 - row.before <= model.longest
            if row.before > 0.0 and close and waiting == row.modelled:
                span = (taken + 1.0 - row.before) * model.period
                nis, used, refused = _use(row, z, i, span, False, model)
                status = REJECTED if refused else HOLDING
            row.before, row.waiting = row.waiting, taken + 1.0
            for side in range(2):
                row.earlier[side], row.speed[side] = row.speed[side], z[i, _SPROCKET + side]
                torque = z[i, _TORQUE + side]
                if not math.isfinite(torque + z[i, _V_X] + z[i, _W] + z[i, _SPROCKET + side]):
                    row.skipped += 1.0
                    status, torque = REJECTED, np.nan
                elif not _shows_drive(z, i, side, model):
                    torque = np.nan
                row.measured[side] = torque
            unsure = row.p[2, 2] > UNDETERMINED * model.decay_variance
            if unsure and taken + 1.0 - row.before == 1.0 and row.before > 0.0:
                while row.modelled < taken:
                    _advance(row, ring)
                span = (row.waiting - row.before) * model.period
                nis, used, refused = _use(row, z, i, span, True, model)
                status = REJECTED if refused else status
        _write_answer(row, model, answer)
        if used > 0 and status == HOLDING:
            p = answer.covariance
            sure = max(p[1, 1], p[2, 2]) < 0.5 * model.gain_variance
            if sure and p[0, 0] < 0.5 * model.decay_variance:
                status = CONVERGING
        row.steps = step + 1.0
        answer.status, answer.skipped = status, row.skipped
        answer.nis = nis if used == 2 else np.nan


class ActuatorEstimator(BatchEstimator):
    """Estimates [drive_time_constant T [s], gains of the left and right drive [-]], N vehicles."""

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
    row = ROW
    kernel = update_all

    def __init__(self, *setting: Any, **named: Any) -> None:
        super().__init__(*setting, **named)
        p, sheet, period = self.parameters, self.data_sheet, self.control_period
        time = p.drive_time_constant
        decay = math.exp(-period / time) if time > 0.0 else LEAST_DECAY
        bounds = RANGES["actuator_gain_left"]
        self._model = Model(
            period, p.torque_limit, p.sprocket_radius, 0.5 * p.track_gauge,
            TOP_SPEED_SHARE * p.sprocket_speed_limit,
            sheet.torque_noise**2 + (MODEL_NOISE * p.torque_limit) ** 2,
            2.0 * sheet.sprocket_speed_noise**2, p.sprocket_inertia,
            max(LONGEST_SPAN / period, 2.0) + 0.5,
            min(max(decay, LEAST_DECAY), LARGEST_DECAY), GAIN_SIGMA**2, DECAY_SIGMA**2,
            GAIN_WALK**2 * period, DECAY_WALK**2 * period, DECAY_JUMP**2, bounds.low, bounds.high,
        )  # fmt: skip
        slots = round(LONGEST_AGE / period) + 2
        self.ring = np.zeros((len(self.memory), 2 * slots))

    def inputs(self, measurement: Measurement) -> tuple[Any, ...]:
        """Samples, commands in force, state and model. The answers are of a and the gains, without
        excitation."""
        commands = np.empty((len(COMMANDS), len(self.memory)))
        for side, name in enumerate(COMMANDS):
            commands[side] = measurement.channel(name)
        return tuple(measurement), commands, self.rows, self.ring, self._model

    def estimate(self, answer: NDArray[Any]) -> Estimate:
        """The answers of the kernel as an Estimate; the lag to first order."""
        model, value, raw = self._model, answer["value"].copy(), answer["covariance"]
        decay = answer["value"][:, 0]
        value[:, 0] = -model.period / np.log(decay)
        jacobian = np.ones_like(value)
        jacobian[:, 0] = value[:, 0] ** 2 / (model.period * decay)  # dT/da
        prior = np.sqrt([model.decay_variance, model.gain_variance, model.gain_variance])
        information = np.linalg.eigvalsh(np.linalg.inv(raw / np.outer(prior, prior))) - 1.0
        smallest, largest = np.maximum(information[:, 0], 0.0), information[:, -1]
        with np.errstate(divide="ignore", invalid="ignore"):
            condition = np.where(smallest > 0.0, largest / smallest, np.inf)
        covariance = raw * jacobian[:, :, None] * jacobian[:, None, :]
        bare = super().estimate(answer)
        return bare._replace(
            value=value, covariance=covariance, excitation=smallest, condition=condition
        )
