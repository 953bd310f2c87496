"""Reward: a weighted sum of named, bounded terms of the true tracking error and the action.

Each term is between 0 and 1; the weights below say what it is worth per control step.
    position    = 1 / (1 + (distance / (l/4))^2)             l: contact length; l/4 of 2 m is 0.5 m
    heading     = 1 / (1 + (heading error / 0.25 rad)^2)
    speed       = 1 / (1 + (speed error / (l/4 per s))^2)
    effort      = mean square of the action (left, right)
    smoothness  = mean square of the change of the action, over its largest value 4
The sum lies in [-0.1, 1]: always better to stay on the path than to end the episode. A vehicle
whose motion is no longer finite gets the worst of every term, in all -0.1, and its episode ends.
"""

from tracked_env.engine import columns as b
from tracked_env.physics import state as s
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import PARAMETER_INDEX

POSITION_SCALE = 0.25  # [-] distance over the contact length at which the term is 1/2
HEADING_SCALE = 0.25  # [rad]
SPEED_SCALE = 0.25  # [1/s] of the contact length
WEIGHTS = {
    "position": 0.7,
    "heading": 0.15,
    "speed": 0.15,
    "effort": -0.05,
    "smoothness": -0.05,
}
INFO_KEYS = tuple(f"reward_{name}" for name in WEIGHTS)  # of `info`, one number a term
_LENGTH = b.PARAMETERS + PARAMETER_INDEX["contact_length"]
_POSITION, _HEADING, _SPEED, _EFFORT, _SMOOTHNESS = (WEIGHTS[name] for name in b.REWARD_TERMS)
_WORST = tuple(min(WEIGHTS[name], 0.0) for name in b.REWARD_TERMS)


@formula
def closeness(error, scale):
    """1 at error 0, 1/2 at error = scale, 0 far away [-]."""
    ratio = error / scale
    return 1.0 / (1.0 + ratio * ratio)


@formula
def reward_terms(distance, heading_error, speed_error, left, right, left_before, right_before):
    """Weighted terms (position, heading, speed, effort, smoothness) and so their sum.

    distance [-] and speed_error [1/s] over the contact length, heading_error [rad], actions [-] in
    [-1, 1].
    """
    change_left, change_right = left - left_before, right - right_before
    return (
        _POSITION * closeness(distance, POSITION_SCALE),
        _HEADING * closeness(heading_error, HEADING_SCALE),
        _SPEED * closeness(speed_error, SPEED_SCALE),
        _EFFORT * 0.5 * (left * left + right * right),
        _SMOOTHNESS * 0.125 * (change_left * change_left + change_right * change_right),
    )


@formula
def reward_and_ending(floats, counters, i, error_limit, diverged):
    """Reward, and whether the episode of vehicle i ends; diverged: its state is not finite."""
    distance = floats[i, b.ERROR_DISTANCE]
    left, right = floats[i, b.ACTION], floats[i, b.ACTION + 1]
    speed_error = floats[i, b.REFERENCE_MOTION] - floats[i, b.STATE + s.V_X]
    length = floats[i, _LENGTH]
    terms = reward_terms(
        distance / length,
        floats[i, b.ERROR_YAW],
        speed_error / length,
        left,
        right,
        floats[i, b.LAST_ACTION],
        floats[i, b.LAST_ACTION + 1],
    )
    if diverged:
        terms = _WORST
    total = 0.0
    for row in range(len(b.REWARD_TERMS)):
        floats[i, b.TERMS + row] = terms[row]
        total += terms[row]
    floats[i, b.REWARD] = total
    floats[i, b.SQUARED_ERROR_SUM] += distance * distance
    inside = distance <= error_limit and not diverged and floats[i, b.FAILURE] == 0.0
    counters[i, b.TERMINATED] = 0 if inside else 1
    ended = counters[i, b.STEP] >= counters[i, b.MAX_STEP]
    counters[i, b.TRUNCATED] = 1 if ended and inside else 0
