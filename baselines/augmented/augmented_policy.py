"""Adaptive augmentation of the linearizing law, and the one by L1 adaptive control.

    observation -> reader and slip observer -> filtered motion -> adaptation -> law -> efforts
The motion is that of the adaptive policy's filter; no parameter is identified. The adaptation sees
the filtered forward speed and yaw rate and the commands that were sent, and says what the law is to
cancel or which parameters it is to use. Its state is one row per vehicle. The last period in the
two channels of the vehicle, each over the nominal mass or inertia:
    v_x' = thrust - resistance + pull,    w' = twist - turning + carried
Loads of the ground, those of the lumped plant, are the mean of both ends of the period; v_y is that
of a steady turn with the measured speed and yaw rate.

L1 adaptive loop of one channel (`sampled`), with x measured, f the acceleration of the nominal
model under the input that was applied, s what it lacks (matched, with the unknown input gain):
    x'  = f + s                                     the vehicle
    p'  = f + s^ - a (p - x)                        state predictor, error e = p - x
    s^  = -exp(-a T) e / P,  P = (1 - exp(-a T)) / a        at every sample, held for T
    d'  = w (s^ - d)                                low-pass filter C(s) = w / (s + w)
The law demands u - d where it demanded u:
    net force m_0 (u_1 - d_1 - w v_y),   moment I_0 (u_2 - d_2) - f M_0
Over a period the error is integrated exactly for x that is linear in time and f that is its mean,
so that nothing winds up. d is kept within +-bound. With b the true over the assumed input gain, the
loop is stable for |b - 1| < 1 at any bandwidth (small gain); see docs/augmented.md

The same loop around each drive lets weak and slow ones answer as the nominal drive does:
    h(n+1) = h(n) + (1 - a) (u(n) - h(n)) + s         h torque over its limit, u command,
    u      = u_d - d                                  a = exp(-dt / T) of the nominal drive
A torque that was not measured in this period, or that no drive could have reached from the last
one (|h(n+1) - h(n)| > |u| + |h(n)|, a wrong reading), leaves the estimate as it was.

References: [1] Hovakimyan, Cao, L1 Adaptive Control Theory (SIAM 2010), sections 2.1 and 3.3.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Array, Bools, Floats
from baselines.estimators.actuators import COMMANDS
from baselines.estimators.measurement import COLUMN, DRIVE
from baselines.estimators.motion_filter import MotionFilter
from baselines.linearizing import linearizing_law as law
from baselines.linearizing import linearizing_policy
from baselines.linearizing.adaptive_policy import FilteredPolicy
from baselines.linearizing.linearizing_law import Gains
from tracked_env import observation as layout
from tracked_env.physics import lumped as plant
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range, plant_parameters
from tracked_env.validation import checked_number

LARGEST_CORRECTION = 1.0  # [-] of the torque limit, by the loop of a drive
ERROR_RATE = 1.0  # [1/s] a of its predictor: its share exp(-a dt) is 0.98 at 50 Hz
READING_ERROR = 0.05  # [-] of the torque limit, well above the noise of a torque sensor
# Columns of a drive: torque delivered, whether it was measured, Estimate.
_TORQUE, _MEASURED, _ESTIMATE, _CANCELLED, DRIVE_COLUMNS = 0, 1, 2, 4, 5
# Columns of a row of the adaptation: both drives, the measured motion, whether there is one; then
# those of the adaptation, from CHANNEL_COLUMN on.
SPEED = 2 * DRIVE_COLUMNS
YAW_RATE, MEASURED, CHANNEL_COLUMN = SPEED + 1, SPEED + 2, SPEED + 3
_V_X, _W, _COMMAND = (layout.INDEX[n] for n in ("v_x", "yaw_rate", "previous_action_left"))
_UNLIMITED = plant.TractionLimits(-1e30, 1e30, -1e30, 1e30)
_TORQUES = [COLUMN["torque_left"], COLUMN["torque_right"]]
_ALLOWED = Range(0.0, 1e6, "SI", "Gains, rates, bandwidths and bounds are not negative.")


class Estimate(NamedTuple):
    """What one L1 channel remembers, in the unit of its acceleration but for the first."""

    error: float  # e = p - x, prediction less measurement [of x]
    uncertainty: float  # s^, held since the last sample
    cancelled: float  # d, its low-pass


class Loop(NamedTuple):
    """Numbers of one L1 channel."""

    rate: float  # [1/s] a of the predictor's error
    bandwidth: float  # [1/s] w of the low-pass; inf passes s^ on as it is
    bound: float  # of d, >= 0


@formula
def predictor_gains(rate, period):
    """(exp(-a T) [-], P = (1 - exp(-a T)) / a [s]) for a [1/s] and T [s]; a = 0 gives (1, T)."""
    decay = math.exp(-rate * period)
    return decay, (1.0 - decay) / rate if rate > 0.0 else period


@formula
def sampled(before, change, modelled, loop, period):
    """Estimate after one period [s]; before: that at its start.

    change: of the measured x over it. modelled: mean of f over it. loop: Loop.
    """
    decay, hold = predictor_gains(loop.rate, period)
    error = decay * before.error + hold * (before.uncertainty + modelled - change / period)
    uncertainty = -decay * error / hold
    share = 1.0 - math.exp(-loop.bandwidth * period)
    cancelled = before.cancelled + share * (uncertainty - before.cancelled)
    return Estimate(error, uncertainty, min(max(cancelled, -loop.bound), loop.bound))


@formula
def advance(memory, i, at, change, modelled, loop, period):
    """`sampled` of the Estimate in columns `at` and following of row i, in and out."""
    before = Estimate(memory[i, at], memory[i, at + 1], memory[i, at + 2])
    estimate = sampled(before, change, modelled, loop, period)
    memory[i, at], memory[i, at + 1], memory[i, at + 2] = estimate


# --- the drives -----------------------------------------------------------------------------


class DriveLoop(NamedTuple):
    """The nominal drive, and the loop around it."""

    lag: float  # [s] T
    decay: float  # [-] exp(-period / T)
    bandwidth: float  # [1/s] w
    period: float  # [s]


@formula
def mean_of(before, now, drive):
    """Mean over one period of h' = (u - h) / T from `before` to `now`, u constant."""
    command = (now - drive.decay * before) / (1.0 - drive.decay)
    return command + (before - command) * (1.0 - drive.decay) * drive.lag / drive.period


@formula
def drive_period(memory, i, at, sent, torque, drive):
    """Mean torque [-] that the drive gave since the last call, all torques over the limit.

    memory (N, ..): row i holds the drive from column `at` on, brought up to now. sent: command of
    the period. torque: measured now or NaN. drive: DriveLoop.
    """
    before, decay = memory[i, at + _TORQUE], drive.decay
    nominal, now = (1.0 - decay) * (sent - before), torque
    reach = abs(sent) + abs(before) + READING_ERROR
    measured = math.isfinite(torque) and abs(torque - before) <= reach
    if not measured:
        now = before + nominal + (1.0 - decay) * memory[i, at + _CANCELLED]
    elif memory[i, at + _MEASURED] > 0.0:
        unit = (1.0 - decay) / drive.period  # of a change per second, in commands
        change, modelled = (now - before) / unit, nominal / (1.0 - decay)
        numbers = Loop(ERROR_RATE, drive.bandwidth, LARGEST_CORRECTION)
        advance(memory, i, at + _ESTIMATE, change, modelled, numbers, drive.period)
    memory[i, at + _TORQUE], memory[i, at + _MEASURED] = now, 1.0 if measured else 0.0
    return mean_of(before, now, drive)


@loop
def correct_all(memory, action):
    """Actions (N, 2) in and out: less what the loops of the drives cancel, within [-1, 1]."""
    for i in range(action.shape[0]):
        for side in range(2):
            cancelled = memory[i, side * DRIVE_COLUMNS + _CANCELLED]
            action[i, side] = min(max(action[i, side] - cancelled, -1.0), 1.0)


# --- the last control period ----------------------------------------------------------------


class Channels(NamedTuple):
    """Terms of both channels, at one moment or as a mean."""

    thrust: float  # [m/s^2] of both tracks
    resistance: float  # [m/s^2] of both tracks, subtracted
    pull: float  # [m/s^2] w v_y, and gravity on a slope
    twist: float  # [rad/s^2] of the difference of the efforts
    turning: float  # [rad/s^2] moment that resists the turn, subtracted
    carried: float  # [rad/s^2] coupling with the speed, `constrained` only


@formula
def channels_of(v_x, yaw_rate, torques, k, constrained, incline):
    """Channels at a measured motion under torques (left, right) [N m], nominal Coefficients."""
    across = soil.GRAVITY * incline.down_y
    v_y = law.steady_lateral_velocity(v_x, yaw_rate, k, across)
    v_y = -k.icr_forward * yaw_rate if constrained else v_y
    motion = plant.Motion(v_x, v_y, yaw_rate)
    if constrained:
        f = plant.constrained_loads(motion, torques[0], torques[1], k, _UNLIMITED)
    else:
        f = plant.sliding_loads(motion, torques[0], torques[1], k, _UNLIMITED)
    arm = k.icr_forward if constrained else 0.0
    uneven = k.half_gauge * (f.resistance_right - f.resistance_left)
    return Channels(
        (f.effort_left + f.effort_right) * k.inverse_mass,
        (f.resistance_left + f.resistance_right) * k.inverse_mass,
        yaw_rate * v_y + soil.GRAVITY * incline.down_x,
        k.half_gauge * (f.effort_right - f.effort_left) * k.inverse_inertia,
        (uneven - f.turning_moment + arm * f.lateral_force) * k.inverse_inertia,
        arm * yaw_rate * v_x * k.inverse_inertia / k.inverse_mass,
    )


class Setting(NamedTuple):
    """What the kernels know of the policy."""

    nominal: PlantParameters
    drive_bandwidth: float  # [1/s]
    period: float  # [s]
    constrained: bool  # the lateral model
    sloped: bool  # whether the observation shows the attitude


@formula
def last_period(observation, i, torques, memory, setting):
    """The last period of vehicle i: mean Channels, changes of v_x [m/s] and yaw rate [rad/s], and
    whether there was one. Its row of memory is brought up to now.

    observation (N, >= SIZE) filtered; torques (N, 2) [N m] measured or NaN; memory
    (N, >= CHANNEL_COLUMN).
    """
    p, bandwidth, period, constrained, sloped = setting
    incline = linearizing_policy.measured_incline(observation, i, sloped)
    k = law.pressed(plant.coefficients(p, constrained), incline.press)
    lag, limit, at = p.drive_time_constant, p.torque_limit, DRIVE_COLUMNS
    drive = DriveLoop(lag, plant.torque_decay(period, lag), bandwidth, period)
    sent_left, sent_right = observation[i, _COMMAND], observation[i, _COMMAND + 1]
    left = limit * drive_period(memory, i, 0, sent_left, torques[i, 0] / limit, drive)
    right = limit * drive_period(memory, i, at, sent_right, torques[i, 1] / limit, drive)
    v_x, yaw_rate = observation[i, _V_X] * layout.SCALE[_V_X], observation[i, _W] * layout.SCALE[_W]
    before_v, before_w, begun = memory[i, SPEED], memory[i, YAW_RATE], memory[i, MEASURED] > 0.0
    first = channels_of(before_v, before_w, (left, right), k, constrained, incline)
    second = channels_of(v_x, yaw_rate, (left, right), k, constrained, incline)
    mean = Channels(
        0.5 * (first.thrust + second.thrust),
        0.5 * (first.resistance + second.resistance),
        0.5 * (first.pull + second.pull),
        0.5 * (first.twist + second.twist),
        0.5 * (first.turning + second.turning),
        0.5 * (first.carried + second.carried),
    )
    memory[i, SPEED], memory[i, YAW_RATE], memory[i, MEASURED] = v_x, yaw_rate, 1.0
    return mean, v_x - before_v, yaw_rate - before_w, begun


# --- the policy -----------------------------------------------------------------------------


class AugmentedState(NamedTuple):
    """State of the policy between two calls."""

    controller: Array  # (N, STATE) of the law
    memories: tuple[Array, ...]  # of the filter
    adaptation: Array  # (N, columns)


def checked_settings(settings: Any, lowest: dict[str, float]) -> Any:
    """A NamedTuple of settings as floats. Raises ValueError for one that is not a number, negative
    or below what `lowest` says of names with that ending."""
    for name, value in settings._asdict().items():
        least = max((low for end, low in lowest.items() if name.endswith(end)), default=0.0)
        checked_number(name, value, _ALLOWED._replace(low=least))
    return type(settings)(*(float(value) for value in settings))


class AugmentedPolicy(FilteredPolicy[AugmentedState]):
    """Nominal law on the filtered motion, with an adaptation that a subclass brings.

    Arguments as FilteredPolicy; gains: those of the settings by default. The commands that were
    sent must be observed.
    """

    first = np.zeros(CHANNEL_COLUMN)  # row of the adaptation with which an episode begins
    needs = (*linearizing_policy.NEEDS, *COMMANDS)
    settings: Any
    filter: MotionFilter

    def _make_controller(
        self, control_period: float, settings: Any, lateral: str, sloped: bool
    ) -> linearizing_policy.FeedbackLinearizingController:
        s = self.settings
        own = Gains(s.k_p, s.k_v, s.k_a, s.bound).for_vehicle(self.parameters)
        gains = own if settings is None else settings
        return super()._make_controller(control_period, gains, lateral, sloped)

    def _make_filter(self, count: int, period: float, lateral: str) -> MotionFilter:
        return MotionFilter(self.parameters, period, self.data_sheet, count, lateral, self.sloped)

    def _build(self, count: int) -> None:
        super()._build(count)
        law, s = self.controller, self.settings
        options = law.control_period, law.lateral == "constrained", self.sloped
        self._setting = Setting(self.parameters, s.drive_bandwidth, *options)
        self.controller.lacking = np.zeros((count, 2))
        self._rows = np.tile(self.first, (count, 1))

    def _learned(self) -> tuple[Array, ...]:
        """Rows of the adaptation, `lacking` and the parameters."""
        return self._rows, self.controller.lacking, self.controller.parameters.T

    def adapt(self, observation: Floats, torques: Array, adaptation: Array) -> None:
        """Take one filtered observation, and the torques (N, 2) [N m] at the sprockets or NaN:
        adaptation (N, columns) in and out, then the law's `lacking` or `parameters`."""
        raise NotImplementedError

    def act(
        self, observation: Floats, state: AugmentedState | None, start: Bools
    ) -> tuple[Floats, AugmentedState]:
        """Sprocket torques over their limit, and the new state; a NaN of a sensor is skipped."""
        count, memory = len(observation), None
        if state is not None:
            self.same_count(len(state.controller), count)
            memory = state.controller
        self._resume(count, state)
        step = self.filter.update(observation, start)
        self._show(observation, *step)
        fresh = np.tile(self.first, (count, 1))
        self._rows = fresh if state is None else state.adaptation.copy()
        self._rows[start] = self.first
        latest = step.latest
        now = latest.age[:, DRIVE] < 0.5 * self.controller.control_period  # new, and not late
        torques = np.where(now[:, None], latest.values[:, _TORQUES], np.nan)
        self.adapt(observation, torques, self._rows)
        self._hold_frozen(start)
        action, memory = self.controller.act(observation, memory, start)
        correct_all(self._rows, action)
        self._last = AugmentedState(memory, tuple(self.filter.memories()), self._rows)
        return action, self._last


# --- the two channels, by L1 adaptive control -------------------------------------------------


class L1Settings(NamedTuple):
    """Settings of the law and of both channels; forward first, then turning."""

    k_p: float = 120.0  # [1/s^3] gains of the law
    k_v: float = 65.0  # [1/s^2]
    k_a: float = 10.2  # [1/s]
    bound: float = 0.27  # [m] what the law sees of a position error at most
    mass_factor: float = 1.42  # [-] mass that the law and the predictor assume over the nominal one
    inertia_factor: float = 1.5  # [-] the same of the inertia; both set the input gain
    forward_bandwidth: float = 28.0  # [1/s] of the low-pass filter
    turning_bandwidth: float = 70.0  # [1/s]
    forward_rate: float = 1.0  # [1/s] a of the predictor's error
    turning_rate: float = 1.0  # [1/s]
    drive_bandwidth: float = 100.0  # [1/s] of the low-pass filter of each drive's loop
    forward_bound: float = 8.0  # [m/s^2] of what is cancelled
    turning_bound: float = 15.0  # [rad/s^2]


# Setting -> (low, high, whether on a logarithmic scale) of a search.
L1_TUNABLE = {
    **law.TUNABLE,
    "mass_factor": (0.8, 1.8, True),
    "inertia_factor": (0.8, 1.6, True),
    "forward_bandwidth": (5.0, 100.0, True),
    "turning_bandwidth": (5.0, 100.0, True),
    "drive_bandwidth": (30.0, 300.0, True),
}
_FORWARD, _TURNING = CHANNEL_COLUMN, CHANNEL_COLUMN + 3  # columns of the Estimates


@loop
def l1_adapt_all(observation, torques, setting, loops, memory, lacking):
    """One step of all vehicles: observation (N, >= SIZE) filtered, torques (N, 2) [N m] measured or
    NaN, loops: Loop of both channels, memory (N, CHANNEL_COLUMN + 6) in and out, lacking (N, 2)
    [m/s^2, rad/s^2] out."""
    period, a, b = setting.period, _FORWARD, _TURNING
    for i in range(observation.shape[0]):
        mean, faster, turned, begun = last_period(observation, i, torques, memory, setting)
        if begun:
            net = mean.thrust - mean.resistance + mean.pull
            moment = mean.twist - mean.turning + mean.carried
            advance(memory, i, a, faster, net, loops[0], period)
            advance(memory, i, b, turned, moment, loops[1], period)
        lacking[i, 0], lacking[i, 1] = memory[i, a + 2], memory[i, b + 2]


class L1Policy(AugmentedPolicy):
    """The nominal law with L1 adaptive augmentation; arguments as AugmentedPolicy, and settings.

    Raises ValueError for a setting that is negative or not a number.
    """

    first = np.zeros(CHANNEL_COLUMN + 6)

    def __init__(
        self,
        parameters: PlantParameters | None = None,
        *arguments: Any,
        settings: L1Settings | None = None,
        **options: Any,
    ) -> None:
        self.settings = s = checked_settings(settings or L1Settings(), {"_factor": 0.1})
        p = plant_parameters() if parameters is None else parameters
        assumed = p._replace(  # with the resistances of the nominal vehicle
            mass=p.mass * s.mass_factor,
            inertia=p.inertia * s.inertia_factor,
            longitudinal_resistance=p.longitudinal_resistance / s.mass_factor,
            lateral_resistance=p.lateral_resistance / s.mass_factor,
        )
        super().__init__(assumed, *arguments, **options)
        self._loops = (
            Loop(s.forward_rate, s.forward_bandwidth, s.forward_bound),
            Loop(s.turning_rate, s.turning_bandwidth, s.turning_bound),
        )

    def adapt(self, observation: Any, torques: Any, adaptation: Any) -> None:
        """As AugmentedPolicy.adapt."""
        lacking = self.controller.lacking
        l1_adapt_all(observation, torques, self._setting, self._loops, adaptation, lacking)
