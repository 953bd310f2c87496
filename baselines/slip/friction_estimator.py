"""Slip on unknown friction, estimated while driving: a bank of models over friction.

What slip depends on beside the sprocket speeds is the soil's strength over the weight, mu: with
it the steady slip is a member of a family (slip_model.SlipFamily). So mu is estimated, not the
slip itself: a measured slip belongs to the speeds of the moment, a friction to all. A gain
on the slip that turns was tried beside it and does harm: it also learns what is no steady slip, the
lag of a yawing vehicle, and the controller acts on that.

On slopes gravity pulls, and a vehicle that is taken to be on level ground seems to slip more than
its friction explains. There the plants are those of `slope_motion`, each on the slope that the
vehicle feels, with its load and the transfer of load that the slope makes. Without a measured
velocity nothing draws a plant back that slides down, at metres per second after a second, and
what its yaw rate does then says nothing of the vehicle: there no plant has less friction than
a vehicle needs to hold, |t| / STEEPEST (slope_models).

The plants of a bank (friction_bank) are driven by the measured sprocket speeds. Plants and not the
tables predict, because on slippery ground the vehicle takes seconds to become steady.

References: [F] Focchi et al. (2025), section 4, where slip is identified once, for one soil.

A bank of plants over friction: how well each explains what is measured.

Each of M plants, on frictions mu_k, is driven by the measured sprocket speeds and drawn to the
measured velocities z = (v_x, v_y, w) over PULL seconds (a Kalman filter with a fixed gain). With
the innovations r_k = z - z_k in units of their noise, the prediction of a friction between two of
the bank, at share s of the way in 1 / mu, has (1 - s) r_k + s r_{k+1}, as slip is nearly linear
in 1 / mu. Its sum of squares is kept for all s at once:
    J(k, s) = (1 - s)^2 A_k + 2 s (1 - s) C_k + s^2 A_{k+1} + ((k + s - p_0) / SPREAD)^2
    A_k <- f A_k + r_k . r_k,   C_k <- f C_k + r_k . r_{k+1}
and its least value gives mu, its curvature the variance. The last term is the prior. Plants and
not the tables predict, because on slippery ground the vehicle takes seconds to become steady.
    excitation   a sample counts in turns only, for friction does not show when driving straight;
                 f falls below 1 as far as the sample tells the neighbours of mu apart: nothing is
                 forgotten where nothing is learned
    outliers     a sample that no plant explains within GATE has less weight
    changes      Page's test of every mu_k against the present one,
                 D_k <- max(D_k + r . r - r_k . r_k, 0); beyond CHANGED the D_k replace the sums.
                 A friction that the data contradict is LARGEST behind the best at most:
                 however long the soil was the same, a change is seen soon
    bounds       mu stays within the bank, the curvature below SURE

References: [1] D. T. Magill (1965): banks of models. [2] E. S. Page (1954): cumulative sums.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.measurement import DataSheet
from baselines.slip.slip_models import STEEPEST, Array, SlipFamily, SlopeSlipFamily, grades
from baselines.slip.slip_sweep import (
    CONTACT,
    FRICTIONS,
    PATCHES,
    PLANAR,
    STATE_SIZE,
    hold_on_slope,
    middles,
    slip_family,
    slope_slip_family,
    strength_over_weight,
    with_friction,
)
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.physics.patches_on_level_ground import Patches, make_patches
from tracked_env.physics.terrain_motion import NOMINAL_BODY
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

JUMP = 0.5  # [m/s, rad/s] largest innovation that draws them: an outlier moves them little
FARTHEST = 100.0  # [-] largest innovation in units of its noise: a wild sample does not overflow
GATE = 9.0  # [-] squares of an innovation that the best plant may have
TOLD_APART = 0.02  # [-] squares by which a sample tells neighbours apart for f to be half way down
LARGEST = 200.0  # [-] that J may be above its least value
SURE = 100.0  # [-] curvature of J per share^2: 0.14 of the way between two frictions, 6 % of mu
SPREAD = 2.0  # [-] sigma of the prior, in frictions of the bank: a factor of 2.2
CHANNELS = 3  # v_x, v_y, w
CHANGED = 12.0  # [-] fall of the sum of squares that is a change: 3.5 sigma


# What is remembered of one vehicle: sprocket speeds, whether started, velocities of the plants,
# A, C, D; what else the plants have; then where mu is (k + s), and the curvature there.
STARTED, VELOCITIES, PLACE, CURVE = 2, 3, -2, -1


def columns_for(count: int, more: int = 0) -> int:
    """Columns of the memory for a bank of `count` plants, with `more` of each before PLACE."""
    return VELOCITIES + CHANNELS * count + 3 * count - 1 + more * count + 2


@formula
def least(memory, i, first, count, prior):
    """(J, k, s, curvature) where J is least; A in columns first.., C behind, prior p_0."""
    lowest, best, share, bend = math.inf, 0, 0.0, 1.0
    weight = 1.0 / (SPREAD * SPREAD)
    for k in range(count - 1):
        a, b = memory[i, first + k], memory[i, first + k + 1]
        c = memory[i, first + count + k]
        off = k - prior
        curve = a - 2.0 * c + b + weight
        slope = c - a + off * weight
        s = min(max(-slope / curve, 0.0), 1.0) if curve > 0.0 else (0.0 if a <= b else 1.0)
        value = (1.0 - s) * (1.0 - s) * a + 2.0 * s * (1.0 - s) * c + s * s * b
        value += (off + s) * (off + s) * weight
        if value < lowest:
            lowest, best, share, bend = value, k, s, curve
    return lowest, best, share, max(bend, weight)


@formula
def value_at(memory, i, first, count, best, share):
    """Sum of squares at share s between the frictions best and best + 1, without the prior."""
    a, b, c = memory[i, first + best], memory[i, first + best + 1], memory[i, first + count + best]
    rest = 1.0 - share
    return rest * rest * a + 2.0 * share * rest * c + share * share * b


@formula
def bounded(memory, i, first, count, best, share, curve):
    """Bring A and C down to what LARGEST and SURE allow, relative to their least value."""
    least_value = value_at(memory, i, first, count, best, share)
    shrink = min(1.0, SURE / curve)
    for k in range(2 * count - 1):
        memory[i, first + k] = min((memory[i, first + k] - least_value) * shrink, LARGEST)
    for k in range(count - 1):
        ends = min(memory[i, first + k], memory[i, first + k + 1])
        memory[i, first + count + k] = min(memory[i, first + count + k], ends)


@formula
def weigh(memory, i, first, count, residual, best, forgetting):
    """Take the innovations residual (count, CHANNELS), in units of their noise, into A and C."""
    smallest, apart = math.inf, 0.0
    for k in range(count):
        square = 0.0
        for c in range(CHANNELS):
            square += residual[k, c] * residual[k, c]
        smallest = min(smallest, square)
    for c in range(CHANNELS):
        apart += (residual[best + 1, c] - residual[best, c]) ** 2
    weight = min(1.0, GATE / max(smallest, GATE))
    keep = 1.0 - forgetting * weight * apart / (apart + TOLD_APART)
    for k in range(count):
        own, next_one = 0.0, 0.0
        for c in range(CHANNELS):
            own += residual[k, c] * residual[k, c]
            if k < count - 1:
                next_one += residual[k, c] * residual[k + 1, c]
        memory[i, first + k] = keep * memory[i, first + k] + weight * own
        if k < count - 1:
            column = first + count + k
            memory[i, column] = keep * memory[i, column] + weight * next_one


@formula
def changed(memory, i, first, count, residual, best, share):
    """Page's test; where it finds a change, what speaks for each friction replaces A and C."""
    page = first + 2 * count - 1
    own, largest = 0.0, 0.0
    for c in range(CHANNELS):
        own += ((1.0 - share) * residual[best, c] + share * residual[best + 1, c]) ** 2
    weight = min(1.0, GATE / max(own, GATE))
    for k in range(count):
        square = 0.0
        for c in range(CHANNELS):
            square += residual[k, c] * residual[k, c]
        gain = min(max(weight * (own - square), -GATE), GATE)
        memory[i, page + k] = max(memory[i, page + k] + gain, 0.0)
        largest = max(largest, memory[i, page + k])
    if largest > CHANGED:
        for k in range(count):
            memory[i, first + k] = largest - memory[i, page + k]
            memory[i, page + k] = 0.0
        for k in range(count - 1):
            memory[i, first + count + k] = min(memory[i, first + k], memory[i, first + k + 1])


@loop
def compare(memory, states, measured, sigma, fastest, gain, turning, forgetting, prior, used):
    """Compare the bank with one sample of N vehicles and draw it to the measured velocities.

    memory (N, columns_for(M)). states (N M, 6): the plants after the step.
    measured (N, 5): sprocket speeds and v_x, v_y, w, NaN where missing. sigma (3,): of the
    innovations. fastest (3,): a wilder sample counts as missing. gain [-]: share of the way to z.
    turning [rad/s]: difference of sprocket speeds above which a sample counts. forgetting [-]:
    share of a period in the memory. prior: p_0. used (N,) bool out: whether a sample counted.
    """
    count = states.shape[0] // memory.shape[0]
    first = VELOCITIES + CHANNELS * count
    residual = np.empty((count, CHANNELS))
    for i in range(memory.shape[0]):
        started = memory[i, STARTED] > 0.0
        seen = 0
        for c in range(CHANNELS):
            z = measured[i, 2 + c]
            known = abs(z) < fastest[c]  # NaN is not
            seen += 1 if known else 0
            for k in range(count):
                model = states[i * count + k, 3 + c] if started else (z if known else 0.0)
                off = z - model if known else 0.0
                residual[k, c] = min(max(off / sigma[c], -FARTHEST), FARTHEST)
                drawn = model + gain * min(max(off, -JUMP), JUMP)
                memory[i, VELOCITIES + CHANNELS * k + c] = drawn
        if seen == CHANNELS:
            memory[i, STARTED] = 1.0
        turns = abs(memory[i, 1] - memory[i, 0]) > turning
        _value, best, share, curve = least(memory, i, first, count, prior)
        if started and seen > 0 and turns:
            weigh(memory, i, first, count, residual, best, forgetting)
            changed(memory, i, first, count, residual, best, share)
            _value, best, share, curve = least(memory, i, first, count, prior)
            bounded(memory, i, first, count, best, share, curve)
            _value, best, share, curve = least(memory, i, first, count, prior)
        used[i] = started and seen > 0 and turns
        memory[i, PLACE], memory[i, CURVE] = best + share, curve


PULL = 1.0  # [s] over which the plants are drawn to the measured velocities
MEMORY_TIME = 5.0  # [s] of turns, over which evidence is forgotten
TURNING = 0.05  # [rad/s] yaw rate of the belts below which a vehicle drives straight
MODEL_SPEED = 0.01  # [m/s] what the plants leave unexplained in v_x and v_y
MODEL_YAW_RATE = 0.01  # [rad/s] the same in w
IMPOSSIBLE = 3.0  # [-] times what the sprockets can drive: such a sample counts as missing
LARGEST_STEP = 0.01  # [s] of the plants
_FRICTION_ANGLE = PARAMETER_NAMES.index("friction_angle")


class RecursiveSlipEstimator:
    """Slip of N vehicles on friction that is not known and may change; a SlipModel.

    parameters: nominal; the vehicle is taken from them, and the friction to begin with.
    control_period [s]: between two updates. data_sheet: noise of velocity, gyro and sprocket
    speeds is used. count: N. memory_time [s]: of turns, after which evidence has faded. slopes:
    whether the attitude is known; the estimator of planar ground takes every place for level.
    All that is remembered is in `memory`: a copy of it resumes. Raises ValueError for arguments
    outside their range.
    """

    names = ("friction",)

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        memory_time: float = MEMORY_TIME,
        patches: Patches | None = None,
        slopes: bool = False,
    ) -> None:
        control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        count = checked_whole("count", count, VEHICLES)
        if not control_period <= memory_time < math.inf:
            raise ValueError(
                f"memory_time = {memory_time} s; must be one control period or more, finite. "
                "Did you pass steps?"
            )
        for name, sigma in data_sheet._asdict().items():
            checked_number(name, sigma, SIGMA)
        self.control_period = float(control_period)
        self.slopes = slopes
        self.family: SlipFamily | SlopeSlipFamily = (
            slope_slip_family(parameters) if slopes else slip_family(parameters)
        )
        self._patches = make_patches() if patches is None else patches
        bank = [with_friction(parameters, mu) for mu in FRICTIONS]
        self._plants = np.tile(np.array(bank, dtype=np.float64), (int(count), 1))
        velocity = math.hypot(data_sheet.velocity_noise, MODEL_SPEED)
        yaw_rate = math.hypot(data_sheet.gyro_noise, data_sheet.gyro_bias, MODEL_YAW_RATE)
        self._sigma = np.array([velocity, velocity, yaw_rate])
        limit = IMPOSSIBLE * parameters.sprocket_speed_limit
        belt = limit * parameters.sprocket_radius
        self._fastest = np.array([limit, belt, belt, 2.0 * belt / parameters.track_gauge])
        self._gain = min(self.control_period / PULL, 1.0)
        belts = parameters.sprocket_radius / parameters.track_gauge
        self._turning = TURNING / belts + 5.0 * math.sqrt(2.0) * data_sheet.sprocket_speed_noise
        self._forgetting = self.control_period / float(memory_time)
        nominal = np.clip(strength_over_weight(parameters), FRICTIONS[0], FRICTIONS[-1])
        places = np.arange(len(FRICTIONS), dtype=np.float64)
        self._prior = float(np.interp(math.log(nominal), np.log(FRICTIONS), places))
        self._inverse = 1.0 / np.array(FRICTIONS)
        self._steps = math.ceil(self.control_period / LARGEST_STEP - 1e-9)
        more = len(CONTACT) if slopes else 0
        self.memory = np.zeros((int(count), columns_for(len(FRICTIONS), more)))
        self.reset()

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        chosen = slice(None) if rows is None else np.asarray(rows)
        self.memory[chosen] = 0.0
        self.memory[chosen, PLACE] = self._prior
        self.memory[chosen, CURVE] = SPREAD**-2

    def update(
        self,
        sprocket_left: ArrayLike,
        sprocket_right: ArrayLike,
        v_x: ArrayLike,
        v_y: ArrayLike,
        yaw_rate: ArrayLike,
        attitude: Array | None = None,
    ) -> NDArray[np.bool_]:
        """Take one sample of every vehicle: sprocket speeds [rad/s] held since the last one,
        body velocities [m/s] and yaw rate [rad/s] now, each a number or (N,); NaN is missing.

        attitude (N, 2): roll, pitch [rad] since the last one, used with `slopes`; None is level.
        Returns (N,): whether the sample counted. Raises ValueError for another shape.
        """
        n, bank = len(self.memory), len(FRICTIONS)
        measured = np.empty((n, 5))
        for column, value in enumerate((sprocket_left, sprocket_right, v_x, v_y, yaw_rate)):
            array = np.asarray(value, dtype=np.float64)
            if array.shape not in ((), (n,)):
                raise ValueError(
                    f"a measurement has shape {array.shape}; must be ({n},). "
                    f"Is the estimator made for count = {n} vehicles?"
                )
            measured[:, column] = array
        possible = np.abs(measured[:, :2]) < self._fastest[0]  # NaN is not
        held = np.where(possible, measured[:, :2], self.memory[:, :2])
        self.memory[:, :2] = held
        planar = self.memory[:, VELOCITIES : VELOCITIES + CHANNELS * bank]
        seen = np.isfinite(measured[:, 2] + measured[:, 3])
        moved = self._moved(planar.reshape(n * bank, CHANNELS), held, attitude, seen)
        states = np.zeros((n * bank, 6))
        states[:, 3:] = moved
        used = np.empty(n, dtype=np.bool_)
        compare(
            self.memory, states, measured, self._sigma, self._fastest[1:], self._gain,
            self._turning, self._forgetting, self._prior, used,
        )  # fmt: skip
        return used

    def _moved(
        self, velocities: Array, held: Array, attitude: Array | None, seen: NDArray[np.bool_]
    ) -> Array:
        """v_x, v_y, w (N M, 3) of the plants after one control period at sprocket speeds (N, 2).

        seen (N,): whether the velocity is measured; without it no plant slides down a slope.
        """
        count, bank = len(velocities), len(FRICTIONS)
        speeds, period = np.repeat(held, bank, axis=0), self.control_period / self._steps
        if not self.slopes:
            states, loads = np.zeros((count, 6)), np.empty((count, 6))
            states[:, 3:] = velocities
            hold_speeds(
                states, speeds, self._plants, self._patches, self._steps, period, False, loads
            )
            return states[:, 3:]
        level = np.zeros((len(held), 2)) if attitude is None else attitude
        states = np.empty((count, STATE_SIZE))
        contact = self.memory[:, -2 - len(CONTACT) * bank : -2]
        states[:, PLANAR], states[:, CONTACT] = velocities, contact.reshape(count, -1)
        plants = self._holding(level, seen)
        hold_on_slope(
            states, np.repeat(level, bank, axis=0), speeds, plants, *middles(PATCHES), NOMINAL_BODY,
            False, self._steps, period, 0.0, 1, np.empty(count),
        )  # fmt: skip
        contact[:] = states[:, CONTACT].reshape(contact.shape)
        return states[:, PLANAR]

    def _holding(self, attitude: Array, seen: NDArray[np.bool_]) -> Array:
        """Parameters (N M, ...) of the plants; where no velocity is seen, of those that hold."""
        steep = np.linalg.norm(grades(*attitude.T), axis=1)
        needed = np.where(seen, 0.0, steep / STEEPEST)
        plants = self._plants.copy()
        angle = plants[:, _FRICTION_ANGLE]
        np.maximum(angle, np.arctan(np.repeat(needed, len(FRICTIONS))), out=angle)
        return plants

    def estimates(self) -> dict[str, tuple[Array, Array]]:
        """By name (value, standard deviation), (N,) each: friction mu [-]."""
        place, curve = self.memory[:, PLACE], self.memory[:, CURVE]
        k = np.minimum(place.astype(np.int64), len(FRICTIONS) - 2)
        apart = self._inverse[k] - self._inverse[k + 1]
        mu = 1.0 / (self._inverse[k] - (place - k) * apart)
        return {"friction": (mu, mu * mu * apart / np.sqrt(curve))}

    def velocities(self) -> Array:
        """v_x, v_y [m/s] (N, 2) of the plant on the friction estimated, as driven so far."""
        place = self.memory[:, PLACE]
        k = np.minimum(place.astype(np.int64), len(FRICTIONS) - 2)
        share = (place - k)[:, None]
        rows, first = np.arange(len(k))[:, None], VELOCITIES + CHANNELS * k[:, None]
        below = self.memory[rows, first + np.arange(2)]
        above = self.memory[rows, first + CHANNELS + np.arange(2)]
        return (1.0 - share) * below + share * above

    @property
    def friction(self) -> Array:
        """(N,) mu [-]."""
        return self.estimates()["friction"][0]

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> tuple[Array, Array, Array]:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], each vehicle on
        its own friction. (N,), or a multiple of N where each vehicle is asked several times."""
        return self.family.at(self.friction).slip(sprocket_left, sprocket_right)
