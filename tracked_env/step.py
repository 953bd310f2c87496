"""The control step of a batch: what every plant's kernel does before and after its own motion.

One call advances vehicles start..stop-1: actions taken, parameters in force, motion (the plant's),
reference, sensors, tracking error, reward, flags, observation. Nothing in it depends on how many
vehicles share the call, so a batch gives the bits of one vehicle. A plant's file makes its kernels
by handing its own functions to the templates:

    @loop
    def advance(batch, rows, clock, options):
        scratch = np.empty((ROWS, LANES))
        return advance_blocks(derive, move, LANES, scratch, batch, rows, clock, options)

    @loop
    def hold(batch, vehicles, pace, options):
        scratch = np.empty((ROWS, LANES))
        hold_blocks(derive, move_held, LANES, scratch, batch, vehicles, pace, options)

They stand at module level, because the kernel cache finds those again in a new process, but not
closures. Parameters start an episode with their base; each event changes one of them in turn, by
time and place (`tracked_env.events`).

The reward is a weighted sum of named, bounded terms of the true tracking error and the action. Each
is between 0 and 1; WEIGHTS says what it is worth per control step.
    position    = 1 / (1 + (distance / (l/4))^2)             l: contact length; l/4 of 2 m is 0.5 m
    heading     = 1 / (1 + (heading error / 0.25 rad)^2)
    speed       = 1 / (1 + (speed error / (l/4 per s))^2)
    effort      = mean square of the action (left, right)
    smoothness  = mean square of the change of the action, over its largest value 4
The sum lies in [-0.1, 1]: always better to stay on the path than to end the episode. A vehicle
whose motion is no longer finite gets the worst of every term, in all -0.1, and its episode ends.
Other rewards, and costs, follow from the arrays after the step: `tracked_env.rewards`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env import sensors
from tracked_env.events import changed_value
from tracked_env.physics import parameters as s
from tracked_env.physics import reference_profile
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, prefetch, template
from tracked_env.physics.parameters import PARAMETER_INDEX, PARAMETER_ROWS
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.sensors import CHANNEL_COUNT, GROUP_START

DIVERGED = 1e15  # [SI] no motion of a vehicle has such numbers; their squares are still finite
CALM, SOME_ENDED = -1, -2  # results of a step: whether some vehicle's episode has ended
POSITION_SCALE = 0.25  # [-] distance over the contact length at which the term is 1/2
HEADING_SCALE = 0.25  # [rad]
SPEED_SCALE = 0.25  # [1/s] of the contact length
WEIGHTS = {"position": 0.7, "heading": 0.15, "speed": 0.15, "effort": -0.05, "smoothness": -0.05}
INFO_KEYS = tuple(f"reward_{name}" for name in WEIGHTS)  # of `info`, one number a term

_POSITION, _HEADING, _SPEED, _EFFORT, _SMOOTHNESS = (WEIGHTS[name] for name in b.REWARD_TERMS)
_WORST = tuple(min(WEIGHTS[name], 0.0) for name in b.REWARD_TERMS)
_LENGTH = b.PARAMETERS + PARAMETER_INDEX["contact_length"]
_RADIUS = b.PARAMETERS + PARAMETER_INDEX["sprocket_radius"]
_AHEAD_TIMES = np.array(obs.LOOK_AHEAD)
_SEGMENTS_SHOWN = int(max(obs.LOOK_AHEAD) * reference_profile.INVERSE_DURATION) + 1
_HALF_ROOT = math.sqrt(0.5)
_X, _Y, _YAW = (sensors.CHANNELS.index(name) for name in ("x", "y", "yaw"))

# Columns of the observation. Channels that are shown as they are: (channel, column).
_SHOWN = np.array([(c, obs.INDEX[n]) for c, n in enumerate(sensors.CHANNELS) if n in obs.INDEX])
_ERROR_X, _ERROR_Y = obs.INDEX["position_error_x"], obs.INDEX["position_error_y"]
_HEADING_ERROR = obs.INDEX["heading_error"]
# v, dv/dt, d2v/dt2, w, dw/dt of the reference, in the order of `reference_profile`
_RATES = ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration")
_REFERENCE = np.array([obs.INDEX[f"reference_{name}"] for name in _RATES])
_AHEAD_SPEED, _AHEAD_YAW_RATE = (
    np.array([obs.INDEX[f"reference_{kind}_ahead_{time:g}"] for time in obs.LOOK_AHEAD])
    for kind in ("speed", "yaw_rate")
)
_ACTION = np.array([obs.INDEX[f"previous_action_{side}"] for side in ("left", "right")])
_AGE = np.array([obs.INDEX[f"{group}_age"] for group in sensors.GROUPS])


class Rows(NamedTuple):
    """Which vehicles take a control step, and what goes in and out of it."""

    vehicles: NDArray[np.int64]  # (M,) rows of vehicles
    actions: NDArray[np.float32]  # (N, 2), clipped to [-1, 1]
    observations: NDArray[np.float32]  # (N, SIZE), written
    start: int  # first and last of `vehicles`
    stop: int
    moving: bool  # False completes freshly loaded vehicles instead of moving them


class Clock(NamedTuple):
    """Time of a control step, the same for every vehicle."""

    substeps: int  # of a control step
    substep: float  # [s]


class Block(NamedTuple):
    """Vehicles that a plant moves at once, vehicles[first] .. vehicles[first + lanes - 1]."""

    vehicles: NDArray[np.int64]
    first: int
    lanes: int


class Pace(NamedTuple):
    """How far a plant moves them: `substeps` steps of h [s]; 0 settles what follows from a state.

    period [s]: of a control step, also where substeps is 0.
    """

    substeps: int
    h: float
    period: float


# --- before the motion ------------------------------------------------------------------------
@formula
def _refused(actions, vehicles, start, stop):
    """The first chosen row with a non-finite action, or CALM."""
    for j in range(start, stop):
        i = vehicles[j]
        if not math.isfinite(actions[i, 0]) or not math.isfinite(actions[i, 1]):
            return i
    return CALM


@formula
def _refresh(batch, i, count, time):
    """Parameters in force at the centre of mass of vehicle i, at `time` [s], into their columns."""
    floats = batch.floats
    for row in range(PARAMETER_ROWS):
        floats[i, b.PARAMETERS + row] = floats[i, b.BASE + row]
    x, y = floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
    for e in range(count):
        row = b.PARAMETERS + int(batch.events[i, e, 1])
        floats[i, row] = changed_value(floats[i, row], batch.events, i, e, time, x, y)


@formula
def _begin(derive, batch, clock, actions, i, moving, period):
    floats = batch.floats
    if moving:
        for side in range(2):
            action = min(max(np.float64(actions[i, side]), -1.0), 1.0)
            floats[i, b.LAST_ACTION + side] = floats[i, b.ACTION + side]
            floats[i, b.ACTION + side] = action
    count = batch.counters[i, b.EVENT_COUNT]
    if count > 0:
        _refresh(batch, i, count, batch.counters[i, b.STEP] * period)
    if count > 0 or not moving:
        derive(floats, i, clock.substep)


@formula
def _expect(counters, profile, noise, i, period):
    """Fetch what is read of vehicle i after the coming step: its noise and its reference.

    Vehicles that are not in step read these from scattered places, and would wait for each.
    """
    cursor = counters[i, b.NOISE_CURSOR] + 1
    run, place = cursor // b.NOISE_RUN, cursor % b.NOISE_RUN
    prefetch(noise, (run, i, place, 0))
    prefetch(noise, (run, i, place, sensors.NOISE_COUNT - 1))
    if profile.shape[2] != reference_profile.UNIFORM_COLUMNS:
        return
    last = profile.shape[0] - 1
    now, _ = reference_profile.locate(last, counters[i, b.STEP] * period)
    for ahead in range(_SEGMENTS_SHOWN):
        segment = min(now + ahead, last)
        prefetch(profile, (segment, i, 0))
        prefetch(profile, (segment, i, profile.shape[2] - 1))


# --- after the motion: reference and sensors ----------------------------------------------------
@formula
def _advance_reference(floats, counters, profile, i, period):
    step = counters[i, b.STEP]
    x, y, yaw = floats[i, b.REFERENCE_X], floats[i, b.REFERENCE_Y], floats[i, b.REFERENCE_YAW]
    cosine, sine = floats[i, b.REFERENCE_COSINE], floats[i, b.REFERENCE_COSINE + 1]
    its, begin, end = profile[:, i], step * period, (step + 1) * period
    x, y, cosine, sine, yaw = reference_profile.advance(
        its, begin, end, period, (x, y, cosine, sine, yaw)
    )
    floats[i, b.REFERENCE_X], floats[i, b.REFERENCE_Y], floats[i, b.REFERENCE_YAW] = x, y, yaw
    floats[i, b.REFERENCE_COSINE], floats[i, b.REFERENCE_COSINE + 1] = cosine, sine


@formula
def _reference_rates(floats, profile, i, time):
    """Reference rates of vehicle i at `time` [s] and ahead, into their columns."""
    its = profile[:, i]
    rates = reference_profile.rates_at(its, time)
    for row in range(5):
        floats[i, b.REFERENCE_MOTION + row] = rates[row]
    for j in range(b.AHEAD):
        v, w = reference_profile.speeds_at(its, time + _AHEAD_TIMES[j])
        floats[i, b.AHEAD_SPEED + j] = v
        floats[i, b.AHEAD_YAW_RATE + j] = w


@formula
def _steps_between(low, high, normal):
    """U(low, high) as a whole number of control steps, at least one, by a normal number."""
    share = 0.5 * math.erfc(-normal * _HALF_ROOT)
    return max(int(low + (high - low) * share + 0.5), 1)


@formula
def outage(floats, counters, noise, i, step, run, place):
    """Whether vehicle i is without pose in this step, which is called once for each.

    When an outage begins, its length and the gap behind it are drawn by the numbers for the noise
    of x and for the dropout, of which an outage makes no use. At the start there is a gap only.
    """
    if step == counters[i, b.OUTAGE_FROM]:
        low, high = floats[i, b.OUTAGE + 2], floats[i, b.OUTAGE + 3]
        length = _steps_between(low, high, noise[run, i, place, _X])
        low, high = floats[i, b.OUTAGE], floats[i, b.OUTAGE + 1]
        gap = _steps_between(low, high, noise[run, i, place, CHANNEL_COUNT])
        counters[i, b.OUTAGE_UNTIL] = step + (length if step > 0 else 0)
        counters[i, b.OUTAGE_FROM] = counters[i, b.OUTAGE_UNTIL] + gap
    return step < counters[i, b.OUTAGE_UNTIL]


@formula
def _sample_sensors(floats, counters, noise, i, step):
    """Take this step's samples of vehicle i; `step` counts control steps since reset."""
    cursor = counters[i, b.NOISE_CURSOR]
    run, place = cursor // b.NOISE_RUN, cursor % b.NOISE_RUN
    radius, coupling = floats[i, _RADIUS], floats[i, b.CROSS_COUPLING]
    truth = sensors.signals(floats, i, radius, coupling, floats[i, b.VELOCITY])
    missing = outage(floats, counters, noise, i, step, run, place)
    for g in range(b.GROUP_COUNT):
        period = counters[i, b.PERIOD + g]
        due = period == 1 or step % period == 0
        lost = noise[run, i, place, CHANNEL_COUNT + g] < floats[i, b.DROPOUT + g]
        if due and (not (lost or (missing and g == 0)) or step == 0):
            for c in range(GROUP_START[g], GROUP_START[g + 1]):
                error = floats[i, b.BIAS + c] + floats[i, b.SIGMA + c] * noise[run, i, place, c]
                floats[i, b.SAMPLE + c] = truth[c] + error
            floats[i, b.SAMPLE + CHANNEL_COUNT + g] = step


@formula
def _deliver(floats, counters, history, i, step):
    """Pass on the samples of vehicle i that have arrived after each group's delay.

    Returns the column where they start.
    """
    slots = history.shape[1]
    if slots == 1:  # no sensor of this batch is delayed
        return b.SAMPLE
    slot = step % slots
    for row in range(b.DELIVERED_COUNT):
        history[i, slot, row] = floats[i, b.SAMPLE + row]
    for g in range(b.GROUP_COUNT):
        past = max(step - counters[i, b.DELAY + g], 0) % slots
        for c in range(GROUP_START[g], GROUP_START[g + 1]):
            floats[i, b.DELIVERED + c] = history[i, past, c]
        row = CHANNEL_COUNT + g
        floats[i, b.DELIVERED + row] = history[i, past, row]
    return b.DELIVERED


@formula
def _tracking_error(floats, i):
    """True error of vehicle i: distance to the reference, and heading, reference minus vehicle.

    Where the vehicle is tilted, both in its own plane, see `physics.rigid_body.in_body_plane`.
    """
    yaw = floats[i, b.STATE + s.YAW]
    dx = floats[i, b.REFERENCE_X] - floats[i, b.STATE + s.X]
    dy = floats[i, b.REFERENCE_Y] - floats[i, b.STATE + s.Y]
    turn = wrap_angle(floats[i, b.REFERENCE_YAW] - yaw)
    pitch, roll = floats[i, b.STATE + s.PITCH], floats[i, b.STATE + s.ROLL]
    if pitch != 0.0 or roll != 0.0:
        cosine, sine = rotation(yaw)
        dx, dy = cosine * dx + sine * dy, cosine * dy - sine * dx
        dx, dy, turn = in_body_plane(dx, dy, turn, rotation(pitch), rotation(roll))
    floats[i, b.ERROR_YAW] = turn
    floats[i, b.ERROR_DISTANCE] = math.sqrt(dx * dx + dy * dy)


@formula
def _write_observation(floats, i, step, control_period, arrived, out):
    """Pack what vehicle i sees into out[i] by the layout `V0` of `tracked_env.observation`.

    arrived: column of `floats` where the delivered samples start.
    """
    yaw = floats[i, arrived + _YAW]
    cosine, sine = rotation(yaw)
    dx = floats[i, b.REFERENCE_X] - floats[i, arrived + _X]
    dy = floats[i, b.REFERENCE_Y] - floats[i, arrived + _Y]
    obs.store(out, i, _ERROR_X, cosine * dx + sine * dy)
    obs.store(out, i, _ERROR_Y, cosine * dy - sine * dx)
    obs.store(out, i, _HEADING_ERROR, wrap_angle(floats[i, b.REFERENCE_YAW] - yaw))
    for k in range(_SHOWN.shape[0]):
        obs.store(out, i, _SHOWN[k, 1], floats[i, arrived + _SHOWN[k, 0]])
    for row in range(5):
        obs.store(out, i, _REFERENCE[row], floats[i, b.REFERENCE_MOTION + row])
    for j in range(b.AHEAD):
        obs.store(out, i, _AHEAD_SPEED[j], floats[i, b.AHEAD_SPEED + j])
        obs.store(out, i, _AHEAD_YAW_RATE[j], floats[i, b.AHEAD_YAW_RATE + j])
    for side in range(2):
        obs.store(out, i, _ACTION[side], floats[i, b.ACTION + side])
    for g in range(b.GROUP_COUNT):
        taken = floats[i, arrived + CHANNEL_COUNT + g]
        obs.store(out, i, _AGE[g], (step - taken) * control_period)


# --- reward and ending ------------------------------------------------------------------------
@formula
def _closeness(error, scale):
    """1 at error 0, 1/2 at error = scale, 0 far away [-]."""
    ratio = error / scale
    return 1.0 / (1.0 + ratio * ratio)


@formula
def is_finite(floats, i):
    """Whether every entry of the state of vehicle i is finite, and far from overflow."""
    total = 0.0
    for row in range(s.STATE_ROWS):
        total += abs(floats[i, b.STATE + row])
    return total < DIVERGED


@formula
def _reward_and_ending(floats, counters, i, diverged):
    """Reward, and whether the episode of vehicle i ends; diverged: its state is not finite."""
    distance, length = floats[i, b.ERROR_DISTANCE], floats[i, _LENGTH]
    speed_error = floats[i, b.REFERENCE_MOTION] - floats[i, b.STATE + s.V_X]
    left, right = floats[i, b.ACTION], floats[i, b.ACTION + 1]
    change_left = left - floats[i, b.LAST_ACTION]
    change_right = right - floats[i, b.LAST_ACTION + 1]
    terms: Any = (
        _POSITION * _closeness(distance / length, POSITION_SCALE),
        _HEADING * _closeness(floats[i, b.ERROR_YAW], HEADING_SCALE),
        _SPEED * _closeness(speed_error / length, SPEED_SCALE),
        _EFFORT * 0.5 * (left * left + right * right),
        _SMOOTHNESS * 0.125 * (change_left * change_left + change_right * change_right),
    )
    if diverged:
        terms = _WORST
    total = 0.0
    for row in range(len(b.REWARD_TERMS)):
        floats[i, b.TERMS + row] = terms[row]
        total += terms[row]
    floats[i, b.REWARD] = total
    floats[i, b.SQUARED_ERROR_SUM] += distance * distance
    inside = distance <= floats[i, b.ERROR_LIMIT] and not diverged and floats[i, b.FAILURE] == 0.0
    counters[i, b.TERMINATED] = 0 if inside else 1
    ended = counters[i, b.STEP] >= counters[i, b.MAX_STEP]
    counters[i, b.TRUNCATED] = 1 if ended and inside else 0


@formula
def _finish(batch, observations, i, moving, period):
    """All that follows the motion of vehicle i; returns CALM or SOME_ENDED."""
    floats, counters = batch.floats, batch.counters
    if moving:
        _advance_reference(floats, counters, batch.profile, i, period)
        counters[i, b.STEP] += 1
        counters[i, b.NOISE_CURSOR] += 1
    diverged = moving and not is_finite(floats, i)
    step = counters[i, b.STEP]
    _reference_rates(floats, batch.profile, i, step * period)
    _tracking_error(floats, i)
    if not diverged:  # else the sensors keep their last samples
        _sample_sensors(floats, counters, batch.noise, i, step)
    arrived = _deliver(floats, counters, batch.history, i, step)
    _write_observation(floats, i, step, period, arrived, observations)
    if moving:
        _reward_and_ending(floats, counters, i, diverged)
        if counters[i, b.TERMINATED] + counters[i, b.TRUNCATED] > 0:
            return SOME_ENDED
    return CALM


# --- templates of kernels ---------------------------------------------------------------------
@template
def advance_blocks(derive, move, lane_limit, scratch, batch, rows, clock, options):
    """Advance the vehicles of `rows` by one control step and write their observations.

    derive: compiled (floats, i, substep), refreshes what follows from the parameters of vehicle i.
    move: compiled (batch, scratch, block, pace, options), moves a block of at most lane_limit
    vehicles and settles their states. options: of the plant, a tuple.
    Returns CALM or SOME_ENDED, or the first row with a non-finite action: then no vehicle has
    moved.
    """
    vehicles, actions, observations = rows.vehicles, rows.actions, rows.observations
    start, stop, moving = rows.start, rows.stop, rows.moving
    result = _refused(actions, vehicles, start, stop) if moving else CALM
    if result != CALM:
        return result
    period = clock.substeps * clock.substep
    pace = Pace(clock.substeps if moving else 0, clock.substep, period)
    for first in range(start, stop, lane_limit):
        lanes = min(lane_limit, stop - first)
        for lane in range(lanes):
            _begin(derive, batch, clock, actions, vehicles[first + lane], moving, period)
        for lane in range(lanes):
            i = vehicles[first + lane]
            _expect(batch.counters, batch.profile, batch.noise, i, period)
        move(batch, scratch, Block(vehicles, first, lanes), pace, options)
        for lane in range(lanes):
            i = vehicles[first + lane]
            result = min(result, _finish(batch, observations, i, moving, period))
    return result


@template
def hold_blocks(derive, move, lane_limit, scratch, batch, vehicles, pace, options):
    """Move `vehicles` with what their drives are to give held, and nothing else.

    No reference, sensors, reward or episode: the plant alone, for `plants.standalone`. options:
    (commands (N, 2), options of the plant), for `move`. Parameters are those in force.
    """
    for first in range(0, vehicles.size, lane_limit):
        lanes = min(lane_limit, vehicles.size - first)
        for lane in range(lanes):
            derive(batch.floats, vehicles[first + lane], pace.h)
        move(batch, scratch, Block(vehicles, first, lanes), pace, options)
