"""Turns on soil that resists by its cohesion, where the yaw equation tells nothing of the inertia.

Firm clay resists a turn by c A, whatever the weight, and its shear builds up with the way that the
tracks have turned: in a wide turn it is a third of what it is in a sharp one. To an equation with
one friction C this looks like a C that changes all the time; it is ten to a hundred times
the moment that the yaw acceleration takes, and the inertia that fits the rest is anything.
So, where the moment is more than the largest mu_t explains for LASTS, and for COHESIVE_TIME of
turning after that, samples determine C alone, with an inertia that is as uncertain as it was. At
the first of them the inertia is set back to what it was KEPT_TIME of turning or more before: the
shear has built up since. C is followed everywhere; it is the resistance of this moment.
"""

import math

from baselines.estimators import gaussian_blocks as gaussian
from baselines.estimators import interacting_models as im
from baselines.estimators import least_squares as ls
from tracked_env.physics.jit import formula

COHESIVE_TIME = 10.0  # [s] of turning
GATE = 3.0  # [-] standard deviations of the equation beyond the largest mu_t
LASTS = 0.2  # [s] of turning: a sample whose torque is not of its moment may be beyond as well
KEPT_TIME = 1.0  # [s] of turning between two notes of the inertia
# Columns of the memory, behind the first: seconds of turning left, seconds beyond friction, seconds
# since the last note, and two notes of mean and information of the inertia, in units of the prior.
LEFT, BEYOND, SINCE, LAST_MEAN, LAST_VALUE, EARLIER_MEAN, EARLIER_VALUE = range(7)
COLUMNS = 7


@formula
def _note(memory, i, first, period):
    """Note the inertia of vehicle i once in KEPT_TIME; the note before is kept."""
    memory[i, first + SINCE] += period
    if memory[i, first + SINCE] >= KEPT_TIME:
        memory[i, first + SINCE] = 0.0
        memory[i, first + EARLIER_MEAN] = memory[i, first + LAST_MEAN]
        memory[i, first + EARLIER_VALUE] = memory[i, first + LAST_VALUE]
        p_11, _p_12, _p_22 = gaussian.covariance(memory, i, 0)
        memory[i, first + LAST_MEAN] = memory[i, ls.X_1]
        memory[i, first + LAST_VALUE] = 1.0 / p_11 - 1.0


@formula
def _set_back(memory, i, first):
    """The inertia of all models becomes that of the earlier note; both notes are that one."""
    mean, value = memory[i, first + EARLIER_MEAN], memory[i, first + EARLIER_VALUE]
    memory[i, first + LAST_MEAN], memory[i, first + LAST_VALUE] = mean, value
    memory[i, first + SINCE] = 0.0
    for k in range(im.MODELS + 2):
        h = k * ls.SIZE
        _p_11, _p_12, p_22 = gaussian.covariance(memory, i, h)
        gaussian.put(memory, i, h, mean, memory[i, h + ls.X_2], 1.0 / (value + 1.0), 0.0, p_22)


@formula
def resists(memory, i, first, sample, inertia, most, period):
    """Whether vehicle i turns on cohesive soil, or has just done so.

    sample: of a turn. inertia [kg m^2] as known so far. most [kg]: the largest m mu_t that friction
    explains. period [s]: between two samples.
    """
    moment = (sample.y - sample.phi_1 * inertia) * math.copysign(1.0, sample.phi_2)
    beyond = moment - most * abs(sample.phi_2)
    found = beyond > GATE * math.sqrt(sample.variance)
    memory[i, first + BEYOND] = memory[i, first + BEYOND] + period if found else 0.0
    if memory[i, first + BEYOND] >= LASTS - 1e-9:
        if memory[i, first + LEFT] <= 0.0:
            _set_back(memory, i, first)
        memory[i, first + LEFT] = COHESIVE_TIME
    else:
        memory[i, first + LEFT] = max(memory[i, first + LEFT] - period, 0.0)
    lasting = memory[i, first + LEFT] > 0.0
    if not lasting:
        _note(memory, i, first, period)
    return lasting


@formula
def on_friction_alone(sample, inertia, variance):
    """The sample as an equation on C, with an inertia [kg m^2] of this variance."""
    doubt = sample.phi_1 * sample.phi_1 * variance
    rest = sample.y - sample.phi_1 * inertia
    return ls.Sample(rest, 0.0, sample.phi_2, sample.variance + doubt, 0.0)
