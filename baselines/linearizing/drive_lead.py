"""Commands that make slow drives answer as fast as the nominal ones.

A drive of lag T follows its command by h(n+1) = a h(n) + (1 - a) u, a = exp(-dt / T); a nominal one
would reach a_0 h(n) + (1 - a_0) u_d. Both are the same for
    u = h + (u_d - h) b,    b = (1 - a_0) / (1 - a), at most LARGEST_LEAD, and 1 where T <= T_0
with h what the drive gives now, in units of the command and of its gain: a model that follows the
commands that were sent. Noise of the demand is amplified by b as well; the action stays in [-1, 1].
"""

from tracked_env.observation import INDEX
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PARAMETER_INDEX
from tracked_env.physics.vehicle import torque_decay

LARGEST_LEAD = 6.0  # [-] a lag of 0.3 s as fast as one of 0.05 s takes 5.1 at 50 Hz
_LAG = PARAMETER_INDEX["drive_time_constant"]
_COMMAND = INDEX["previous_action_left"]


@formula
def _reached(observation, i, side, start, decay, given):
    """What a drive gives now [-], of what it gave one period ago and the command sent since."""
    sent = observation[i, _COMMAND + side]
    reached = decay * given[i, side] + (1.0 - decay) * sent
    return 0.0 if start[i] else reached


@loop
def reached_all(observation, start, parameters, period, given):
    """Bring given (N, 2) to the present; arguments as `lead_all`."""
    shared = parameters.shape[1] == 1
    for i in range(given.shape[0]):
        decay = torque_decay(period, parameters[_LAG, 0 if shared else i])
        for side in range(2):
            given[i, side] = _reached(observation, i, side, start, decay, given)


@loop
def lead_all(observation, start, parameters, nominal_lag, period, given, action):
    """Actions (N, 2) in and out; given (N, 2) [-] what the drives give, in and out.

    observation (N, >= SIZE); start (N,): rows that begin, at rest; parameters (PARAMETER_ROWS, N or
    1) with the lag; nominal_lag T_0 and period dt [s].
    """
    nominal = torque_decay(period, nominal_lag)
    shared = parameters.shape[1] == 1
    for i in range(action.shape[0]):
        decay = torque_decay(period, parameters[_LAG, 0 if shared else i])
        factor = 1.0
        if decay > nominal:
            factor = min((1.0 - nominal) / (1.0 - decay), LARGEST_LEAD)
        for side in range(2):
            given[i, side] = _reached(observation, i, side, start, decay, given)
            if factor > 1.0:
                led = given[i, side] + (action[i, side] - given[i, side]) * factor
                action[i, side] = min(max(led, -1.0), 1.0)
