"""The loops behind the observation: sampling, delay, tracking error, packing.

For one vehicle of a batch, at the end of a control step (or at reset): advance the
reference's rates, sample the sensors, deliver what has arrived, compute the true tracking
error, and write the observation by the names of `tracked_env.observation`.
"""

import math

import numpy as np

from tracked_env import observation as obs
from tracked_env.engine import columns as b
from tracked_env.observation_fields import LOOK_AHEAD
from tracked_env.physics import channels, reference_knots, reference_profile
from tracked_env.physics import state as s
from tracked_env.physics.attitude import in_body_plane
from tracked_env.physics.channels import GROUP_START
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, prefetch
from tracked_env.physics.parameters import PARAMETER_INDEX

_RADIUS = b.PARAMETERS + PARAMETER_INDEX["sprocket_radius"]
_AHEAD_TIMES = np.array(LOOK_AHEAD)
_SEGMENTS_SHOWN = int(max(LOOK_AHEAD) * reference_profile.INVERSE_DURATION) + 1

# Channels that are shown as they are: (channel, column of the observation).
_SHOWN = np.array(
    [(c, obs.INDEX[name]) for c, name in enumerate(channels.CHANNELS) if name in obs.INDEX]
)
_X, _Y, _YAW = (channels.CHANNELS.index(name) for name in ("x", "y", "yaw"))
_ERROR_X, _ERROR_Y = obs.INDEX["position_error_x"], obs.INDEX["position_error_y"]
_HEADING_ERROR = obs.INDEX["heading_error"]
# Columns of v, dv/dt, d2v/dt2, w, dw/dt of the reference, in the order of `reference_profile`.
_REFERENCE = np.array(
    [
        obs.INDEX[f"reference_{name}"]
        for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration")
    ]
)
_AHEAD_SPEED, _AHEAD_YAW_RATE = (
    np.array([obs.INDEX[f"reference_{kind}_ahead_{time:g}"] for time in LOOK_AHEAD])
    for kind in ("speed", "yaw_rate")
)
_ACTION = np.array([obs.INDEX[f"previous_action_{side}"] for side in ("left", "right")])
_AGE = np.array([obs.INDEX[f"{group}_age"] for group in channels.GROUPS])


@formula
def expect(counters, profile, noise, i, period):
    """Fetch what `observe` reads of vehicle i after the coming step: its noise and its reference.

    Vehicles that are not in step read these from scattered places, and would wait for each.
    """
    cursor = counters[i, b.NOISE_CURSOR] + 1
    run, place = cursor // b.NOISE_RUN, cursor % b.NOISE_RUN
    prefetch(noise, (run, i, place, 0))
    prefetch(noise, (run, i, place, channels.NOISE_COUNT - 1))
    if profile.shape[2] != reference_knots.UNIFORM_COLUMNS:
        return
    last = profile.shape[0] - 1
    now, _ = reference_profile.locate(last, counters[i, b.STEP] * period)
    for ahead in range(_SEGMENTS_SHOWN):
        segment = min(now + ahead, last)
        prefetch(profile, (segment, i, 0))
        prefetch(profile, (segment, i, profile.shape[2] - 1))


@formula
def reference_rates(floats, profile, i, time):
    """Reference rates at `time` [s] and ahead, into their rows."""
    its = profile[:, i]
    rates = reference_knots.rates_at(its, time)
    for row in range(5):
        floats[i, b.REFERENCE_MOTION + row] = rates[row]
    for j in range(b.AHEAD):
        v, w = reference_knots.speeds_at(its, time + _AHEAD_TIMES[j])
        floats[i, b.AHEAD_SPEED + j] = v
        floats[i, b.AHEAD_YAW_RATE + j] = w


@formula
def sample_sensors(floats, counters, noise, i, step):
    """Take this step's samples of vehicle i; `step` counts control steps since reset."""
    cursor = counters[i, b.NOISE_CURSOR]
    run, place = cursor // b.NOISE_RUN, cursor % b.NOISE_RUN
    truth = channels.signals(
        floats, i, floats[i, _RADIUS], floats[i, b.CROSS_COUPLING], floats[i, b.VELOCITY]
    )
    for g in range(b.GROUP_COUNT):
        period = counters[i, b.PERIOD + g]
        due = period == 1 or step % period == 0
        lost = noise[run, i, place, channels.CHANNEL_COUNT + g] < floats[i, b.DROPOUT + g]
        if due and (not lost or step == 0):
            for c in range(GROUP_START[g], GROUP_START[g + 1]):
                error = floats[i, b.BIAS + c] + floats[i, b.SIGMA + c] * noise[run, i, place, c]
                floats[i, b.SAMPLE + c] = truth[c] + error
            floats[i, b.SAMPLE + channels.CHANNEL_COUNT + g] = step


@formula
def deliver(floats, counters, history, i, step):
    """Pass on the samples that have arrived after each group's delay: returns the column
    where they start."""
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
        row = channels.CHANNEL_COUNT + g
        floats[i, b.DELIVERED + row] = history[i, past, row]
    return b.DELIVERED


@formula
def tracking_error(floats, i):
    """True error of vehicle i: distance to the reference, and heading, reference minus vehicle.

    Where the vehicle is tilted, both in its own plane, see `physics.attitude.in_body_plane`.
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
def write_observation(floats, i, step, control_period, arrived, out):
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
        taken = floats[i, arrived + channels.CHANNEL_COUNT + g]
        obs.store(out, i, _AGE[g], (step - taken) * control_period)


@formula
def observe(
    floats, counters, profile, noise, history,
    i, step, period, observations, diverged,
):  # fmt: skip
    """All of the above for vehicle i at control step `step` of length `period` [s].

    diverged: its state is not finite; then the sensors keep their last samples.
    """
    reference_rates(floats, profile, i, step * period)
    tracking_error(floats, i)
    if not diverged:
        sample_sensors(floats, counters, noise, i, step)
    arrived = deliver(floats, counters, history, i, step)
    write_observation(floats, i, step, period, arrived, observations)
