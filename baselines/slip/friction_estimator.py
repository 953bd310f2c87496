"""Slip on unknown friction, estimated while driving: a bank of plants over friction.

Beside the sprocket speeds slip depends on the soil's strength over the weight, mu: with it the
steady slip is a member of a family (SlipFamily). So mu is estimated, not the slip itself: a
measured slip belongs to the speeds of the moment, a friction to all.

Each of M plants, on frictions mu_k, moves under the measured sprocket speeds and is pulled to the
measured velocities z = (v_x, v_y, w) over PULL seconds (a Kalman filter with a fixed gain). With
the innovations r_k = z - z_k in units of their noise, the prediction of a friction between two of
the bank, at share s of the way in 1 / mu, has (1 - s) r_k + s r_{k+1}, as slip is nearly linear
in 1 / mu. Its sum of squares is updated for all s at once:
    J(k, s) = (1 - s)^2 A_k + 2 s (1 - s) C_k + s^2 A_{k+1} + ((k + s - p_0) / SPREAD)^2
    A_k <- f A_k + r_k . r_k,   C_k <- f C_k + r_k . r_{k+1}
and its least value gives mu, its curvature the variance. The last term is the prior. Plants and
not the tables predict, because on slippery ground the vehicle takes seconds to become steady.
    excitation   a sample counts in turns only, for friction does not show when driving straight;
                 f falls below 1 as far as the sample tells the neighbours of mu apart
    outliers     a sample that no plant explains within GATE has less weight
    changes      Page's test of every mu_k against the present one,
                 D_k <- max(D_k + r . r - r_k . r_k, 0); beyond CHANGE the D_k replace the sums.
                 J is at most LARGEST above its least value: a change is found soon, however
                 long the soil was the same
    bounds       mu stays within the bank, the curvature below SURE

On slopes the plants are those of `slope_motion`, each on the slope that the vehicle feels. Without
a measured velocity nothing pulls back a plant that slides down: there no plant has less friction
than a vehicle needs to hold, |t| / STEEPEST (slip_models).

References: [1] D. T. Magill (1965): banks of models. [2] E. S. Page (1954): cumulative sums.
[F] Focchi et al. (2025), section 4, where slip is identified once, for one soil.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.measurement import DataSheet
from baselines.slip import slope_motion
from baselines.slip.slip_models import STEEPEST, Array, Slip, grades
from baselines.slip.slip_sweep import FRICTIONS, slip_family, slope_slip_family, with_friction
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.parameters import PARAMETER_NAMES, PlantParameters
from tracked_env.physics.patches_on_level_ground import Patches, make_patches
from tracked_env.validation import CONTROL_PERIOD, SIGMA, VEHICLES, checked_number, checked_whole

JUMP = 0.5  # [m/s, rad/s] largest innovation that draws them: an outlier moves them little
FARTHEST = 100.0  # [-] largest innovation in units of its noise: a wild sample does not overflow
GATE = 9.0  # [-] squares of an innovation that the best plant may have
NEIGHBOURS_APART = 0.02  # [-] squares by which a sample tells neighbours apart: f is half way down
LARGEST = 200.0  # [-] that J may be above its least value
SURE = 100.0  # [-] curvature of J per share^2: 0.14 of the way between two frictions, 6 % of mu
SPREAD = 2.0  # [-] sigma of the prior, in frictions of the bank: a factor of 2.2
CHANNELS = 3  # v_x, v_y, w
CHANGE = 12.0  # [-] fall of the sum of squares that is a change of friction: 3.5 sigma
PULL = 1.0  # [s] over which the plants are drawn to the measured velocities
MEMORY_TIME = 5.0  # [s] of turns, over which evidence is forgotten
TURNING = 0.05  # [rad/s] yaw rate of the belts below which a vehicle drives straight
MODEL_SPEED = 0.01  # [m/s] what the plants leave unexplained in v_x and v_y
MODEL_YAW_RATE = 0.01  # [rad/s] the same in w
IMPOSSIBLE = 3.0  # [-] times what the sprockets can drive: such a sample counts as missing
LARGEST_STEP = 0.01  # [s] of the plants
_FRICTION_ANGLE = PARAMETER_NAMES.index("friction_angle")
BANK = len(FRICTIONS)

# What is remembered of one vehicle: sprocket speeds, whether started, velocities of the plants,
# A, C, D; what else the plants have; then where mu is (k + s), and the curvature there.
STARTED, VELOCITIES, PLACE, CURVE = 2, 3, -2, -1
SQUARES = VELOCITIES + CHANNELS * BANK
PRODUCTS = SQUARES + BANK
PAGE = PRODUCTS + BANK - 1
CONTACTS = PAGE + BANK


class Evidence(NamedTuple):
    """What speaks for each friction, of one vehicle."""

    squares: Array  # (M,) A
    products: Array  # (M - 1,) C
    page: Array  # (M,) D


@formula
def _sum_of_squares(e, k, s):
    """At share s between the frictions k and k + 1, without the prior."""
    rest = 1.0 - s
    a, b, c = e.squares[k], e.squares[k + 1], e.products[k]
    return rest * rest * a + 2.0 * s * rest * c + s * s * b


@formula
def least(e, prior):
    """(k, s, curvature) where J is least; prior p_0."""
    lowest, best, share, bend = math.inf, 0, 0.0, 1.0
    weight = 1.0 / (SPREAD * SPREAD)
    for k in range(BANK - 1):
        a, b, c = e.squares[k], e.squares[k + 1], e.products[k]
        off = k - prior
        curve = a - 2.0 * c + b + weight
        slope = c - a + off * weight
        s = min(max(-slope / curve, 0.0), 1.0) if curve > 0.0 else (0.0 if a <= b else 1.0)
        value = _sum_of_squares(e, k, s) + (off + s) * (off + s) * weight
        if value < lowest:
            lowest, best, share, bend = value, k, s, curve
    return best, share, max(bend, weight)


@formula
def bound(e, best, share, curve):
    """Bring A and C down to what LARGEST and SURE allow, relative to their least value."""
    lowest = _sum_of_squares(e, best, share)
    shrink = min(1.0, SURE / curve)
    for k in range(BANK):
        e.squares[k] = min((e.squares[k] - lowest) * shrink, LARGEST)
    for k in range(BANK - 1):
        product = min((e.products[k] - lowest) * shrink, LARGEST)
        e.products[k] = min(product, min(e.squares[k], e.squares[k + 1]))


@formula
def _product(residual, k, m):
    """r_k . r_m of the innovations residual (M, CHANNELS)."""
    total = 0.0
    for c in range(CHANNELS):
        total += residual[k, c] * residual[m, c]
    return total


@formula
def weigh(e, residual, best, forgetting):
    """Take the innovations residual (M, CHANNELS), in units of their noise, into A and C."""
    smallest, apart = math.inf, 0.0
    for k in range(BANK):
        smallest = min(smallest, _product(residual, k, k))
    for c in range(CHANNELS):
        apart += (residual[best + 1, c] - residual[best, c]) ** 2
    weight = min(1.0, GATE / max(smallest, GATE))
    remain = 1.0 - forgetting * weight * apart / (apart + NEIGHBOURS_APART)
    for k in range(BANK):
        e.squares[k] = remain * e.squares[k] + weight * _product(residual, k, k)
    for k in range(BANK - 1):
        e.products[k] = remain * e.products[k] + weight * _product(residual, k, k + 1)


@formula
def page_test(e, residual, best, share):
    """Page's test; where it finds a change, what speaks for each friction replaces A and C."""
    present, largest = 0.0, 0.0
    for c in range(CHANNELS):
        present += ((1.0 - share) * residual[best, c] + share * residual[best + 1, c]) ** 2
    weight = min(1.0, GATE / max(present, GATE))
    for k in range(BANK):
        gain = min(max(weight * (present - _product(residual, k, k)), -GATE), GATE)
        e.page[k] = max(e.page[k] + gain, 0.0)
        largest = max(largest, e.page[k])
    if largest > CHANGE:
        for k in range(BANK):
            e.squares[k] = largest - e.page[k]
            e.page[k] = 0.0
        for k in range(BANK - 1):
            e.products[k] = min(e.squares[k], e.squares[k + 1])


class Comparison(NamedTuple):
    """How a bank is compared with samples."""

    sigma: Array  # (3,) of the innovations
    fastest: Array  # (3,) [m/s, m/s, rad/s] a wilder sample counts as missing
    gain: float  # [-] share of the way to z that plants are drawn
    turning: float  # [rad/s] difference of sprocket speeds above which a sample counts
    forgetting: float  # [-] share of a period in the memory
    prior: float  # p_0


@loop
def compare(memory, velocities, measured, how, used):
    """Compare the bank with one sample of N vehicles and draw it to the measured velocities.

    memory (N, columns). velocities (N M, 3): of the plants after the step. measured (N, 3): v_x,
    v_y, w, NaN where missing. used (N,) bool out: whether a sample counted.
    """
    residual = np.empty((BANK, CHANNELS))
    for i in range(memory.shape[0]):
        row = memory[i]
        e = Evidence(row[SQUARES:PRODUCTS], row[PRODUCTS:PAGE], row[PAGE:CONTACTS])
        started = row[STARTED] > 0.0
        count = 0
        for c in range(CHANNELS):
            z = measured[i, c]
            valid = abs(z) < how.fastest[c]  # NaN is not
            count += 1 if valid else 0
            for k in range(BANK):
                model = velocities[i * BANK + k, c] if started else (z if valid else 0.0)
                off = z - model if valid else 0.0
                residual[k, c] = min(max(off / how.sigma[c], -FARTHEST), FARTHEST)
                row[VELOCITIES + CHANNELS * k + c] = model + how.gain * min(max(off, -JUMP), JUMP)
        if count == CHANNELS:
            row[STARTED] = 1.0
        used[i] = started and count > 0 and abs(row[1] - row[0]) > how.turning
        best, share, curve = least(e, how.prior)
        if used[i]:
            weigh(e, residual, best, how.forgetting)
            page_test(e, residual, best, share)
            best, share, curve = least(e, how.prior)
            bound(e, best, share, curve)
            best, share, curve = least(e, how.prior)
        row[PLACE], row[CURVE] = best + share, curve


class RecursiveSlipEstimator:
    """Slip of N vehicles on friction that is not known and may change; a SlipModel.

    parameters: nominal; the vehicle is taken from them, and the friction to begin with.
    control_period [s]: between two updates. data_sheet: noise of velocity, gyro and sprocket
    speeds is used. count: N. slopes: whether the attitude is known; the estimator of planar ground
    takes every place for level. All that is remembered is in `memory`: a copy of it resumes.
    Raises ValueError for arguments outside their range.
    """

    names = ("friction",)

    def __init__(
        self,
        parameters: PlantParameters,
        control_period: float,
        data_sheet: DataSheet,
        count: int = 1,
        patches: Patches | None = None,
        slopes: bool = False,
    ) -> None:
        period = checked_number("control_period", control_period, CONTROL_PERIOD)
        self.control_period = period
        count = checked_whole("count", count, VEHICLES)
        for name, sigma in data_sheet._asdict().items():
            checked_number(name, sigma, SIGMA)
        self.slopes = slopes
        self.family = slope_slip_family(parameters) if slopes else slip_family(parameters)
        self._patches = make_patches() if patches is None else patches
        bank = [with_friction(parameters, mu) for mu in FRICTIONS]
        self._plants = np.tile(np.array(bank, dtype=np.float64), (count, 1))
        velocity = math.hypot(data_sheet.velocity_noise, MODEL_SPEED)
        yaw_rate = math.hypot(data_sheet.gyro_noise, data_sheet.gyro_bias, MODEL_YAW_RATE)
        self._limit = IMPOSSIBLE * parameters.sprocket_speed_limit
        belt = self._limit * parameters.sprocket_radius
        belts = parameters.sprocket_radius / parameters.track_gauge
        mu = slope_motion.strength_over_weight(parameters)
        nominal = np.clip(mu, FRICTIONS[0], FRICTIONS[-1])
        self._how = Comparison(
            np.array([velocity, velocity, yaw_rate]),
            np.array([belt, belt, 2.0 * belt / parameters.track_gauge]),
            min(period / PULL, 1.0),
            TURNING / belts + 5.0 * math.sqrt(2.0) * data_sheet.sprocket_speed_noise,
            period / MEMORY_TIME,
            float(np.interp(math.log(nominal), np.log(FRICTIONS), np.arange(float(BANK)))),
        )
        self._inverse = 1.0 / np.array(FRICTIONS)
        steps = math.ceil(period / LARGEST_STEP - 1e-9)
        self._schedule = slope_motion.Schedule(steps, period / steps, 1, 0.0)
        self._tracks = slope_motion.tracks_of()
        more = BANK * len(slope_motion.CONTACT) if slopes else 0
        self.memory = np.zeros((count, CONTACTS + more + 2))
        self.reset()

    def reset(self, rows: ArrayLike | None = None) -> None:
        """Forget all, of the vehicles named (indices or a mask), or of all."""
        which = slice(None) if rows is None else np.asarray(rows)
        self.memory[which] = 0.0
        self.memory[which, PLACE] = self._how.prior
        self.memory[which, CURVE] = SPREAD**-2

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
        n = len(self.memory)
        sample = np.empty((n, 5))
        for column, value in enumerate((sprocket_left, sprocket_right, v_x, v_y, yaw_rate)):
            if np.shape(value) not in ((), (n,)):
                raise ValueError(
                    f"a measurement has shape {np.shape(value)}; must be ({n},). "
                    f"Is the estimator made for count = {n} vehicles?"
                )
            sample[:, column] = value
        possible = np.abs(sample[:, :2]) < self._limit  # NaN is not
        sprockets = self.memory[:, :2] = np.where(possible, sample[:, :2], self.memory[:, :2])
        measured = np.isfinite(sample[:, 2] + sample[:, 3])
        velocities = self._moved(sprockets, attitude, measured)
        used = np.empty(n, dtype=np.bool_)
        compare(self.memory, velocities, sample[:, 2:], self._how, used)
        return used

    def _moved(
        self, sprockets: Array, attitude: Array | None, measured: NDArray[np.bool_]
    ) -> Array:
        """v_x, v_y, w (N M, 3) of the plants after one control period at sprocket speeds (N, 2).

        measured (N,): whether the velocity is; without it no plant slides down a slope.
        """
        velocities = self.memory[:, VELOCITIES:SQUARES].reshape(-1, CHANNELS)
        count, speeds = len(velocities), np.repeat(sprockets, BANK, axis=0)
        plants, schedule = self._plants, self._schedule
        if not self.slopes:
            states, loads = np.zeros((count, 6)), np.empty((count, 6))
            states[:, 3:] = velocities
            duration = schedule.steps, schedule.step
            hold_speeds(states, speeds, plants, self._patches, *duration, False, loads)
            return states[:, 3:]
        level = np.zeros((len(sprockets), 2)) if attitude is None else attitude
        states = np.empty((count, slope_motion.STATE_SIZE))
        contact = self.memory[:, CONTACTS:-2]
        states[:, slope_motion.PLANAR] = velocities
        states[:, slope_motion.CONTACT] = contact.reshape(count, -1)
        # Where no velocity is measured, the plants have a friction with which they hold.
        steep = np.linalg.norm(grades(*level.T), axis=1)
        angle = np.arctan(np.repeat(np.where(measured, 0.0, steep / STEEPEST), BANK))
        plants = plants.copy()
        np.maximum(plants[:, _FRICTION_ANGLE], angle, out=plants[:, _FRICTION_ANGLE])
        attitudes, durations = np.repeat(level, BANK, axis=0), np.empty(count)
        tracks = self._tracks
        slope_motion.hold_on_slope(states, attitudes, speeds, plants, tracks, schedule, durations)
        contact[:] = states[:, slope_motion.CONTACT].reshape(contact.shape)
        return states[:, slope_motion.PLANAR]

    def _between(self) -> tuple[NDArray[np.int64], Array]:
        """(k, share) of the present friction, (N,) each."""
        place = self.memory[:, PLACE]
        k = np.minimum(place.astype(np.int64), BANK - 2)
        return k, place - k

    def estimates(self) -> dict[str, tuple[Array, Array]]:
        """By name (value, standard deviation), (N,) each: friction mu [-]."""
        k, share = self._between()
        apart = self._inverse[k] - self._inverse[k + 1]
        mu = 1.0 / (self._inverse[k] - share * apart)
        return {"friction": (mu, mu * mu * apart / np.sqrt(self.memory[:, CURVE]))}

    def velocities(self) -> Array:
        """v_x, v_y [m/s] (N, 2) of the plant on the friction estimated, as it moves so far."""
        k, share = self._between()
        bank = self.memory[:, VELOCITIES:SQUARES].reshape(-1, BANK, CHANNELS)[:, :, :2]
        rows, share = np.arange(len(k)), share[:, None]
        return (1.0 - share) * bank[rows, k] + share * bank[rows, k + 1]

    @property
    def friction(self) -> Array:
        """(N,) mu [-]."""
        return self.estimates()["friction"][0]

    def slip(self, sprocket_left: Array, sprocket_right: Array) -> Slip:
        """(beta_left, beta_right [m/s], alpha [rad]) at sprocket speeds [rad/s], each vehicle on
        its own friction. (N,), or a multiple of N: several speeds of each vehicle."""
        return self.family.at(self.friction).slip(sprocket_left, sprocket_right)
