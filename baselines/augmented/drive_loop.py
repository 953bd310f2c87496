"""L1 adaptive loop around each drive: weak and slow ones answer as the nominal drive does.

    h(n+1) = h(n) + (1 - a) (u(n) - h(n)) + s         h torque over its limit, u command,
    u      = u_d - d                                  a = exp(-dt / T) of the nominal drive
The channel of `matched_uncertainty` with the measured torque for x, in units of the command: s of a
drive with gain g and lag T_1 is (1 - a_1) (g u - h) - (1 - a) (u - h). Its input gain,
b = g (1 - a_1) / (1 - a), is in (0, 1] for weak and slow drives, so the small-gain condition holds
at any bandwidth w; the estimate settles at the rate b w, so a drive six times as slow asks for a
bandwidth near the rate of control, and amplifies the noise of the torque like the lead that it is.
A torque that was not measured in this period, or that no drive could have reached from the last
one (|h(n+1) - h(n)| > |u| + |h(n)|, a wrong reading), leaves the estimate as it was.
"""

import math

from baselines.augmented.matched_uncertainty import Estimate, sampled
from tracked_env.physics.jit import formula, loop

LARGEST_CORRECTION = 1.0  # [-] of the torque limit
ERROR_RATE = 1.0  # [1/s] a of the predictor: its share exp(-a dt) is 0.98 at 50 Hz
READING_ERROR = 0.05  # [-] of the torque limit, well above the noise of a torque sensor
# Columns of a row: torque given, whether it was measured, Estimate.
_TORQUE, _KNOWN, _ESTIMATE, DRIVE_COLUMNS = 0, 1, 2, 5


@formula
def mean_of(before, now, decay, lag, period):
    """Mean over one period [s] of h' = (u - h) / T from `before` to `now`, u constant;
    decay = exp(-period / T)."""
    command = (now - decay * before) / (1.0 - decay)
    return command + (before - command) * (1.0 - decay) * lag / period


@formula
def drive_period(memory, i, at, sent, torque, decay, lag, bandwidth, period):
    """Mean torque [-] that the drive gave since the last call, all torques over the limit.

    memory (N, ..): row i holds the drive in columns `at` and following, brought up to now. sent:
    command of the period. torque: measured now, NaN where it is not. decay, lag T [s]: nominal.
    """
    before = memory[i, at + _TORQUE]
    e = at + _ESTIMATE
    known = Estimate(memory[i, e], memory[i, e + 1], memory[i, e + 2])
    nominal = (1.0 - decay) * (sent - before)
    now = torque
    reach = abs(sent) + abs(before) + READING_ERROR
    measured = math.isfinite(torque) and abs(torque - before) <= reach
    if not measured:
        now = before + nominal + (1.0 - decay) * known.cancelled
    elif memory[i, at + _KNOWN] > 0.0:
        unit = (1.0 - decay) / period  # of a change per second, in commands
        later = sampled(
            known, (now - before) / unit, nominal / (1.0 - decay), ERROR_RATE, bandwidth,
            LARGEST_CORRECTION, period,
        )  # fmt: skip
        memory[i, e], memory[i, e + 1], memory[i, e + 2] = later
    memory[i, at + _TORQUE], memory[i, at + _KNOWN] = now, 1.0 if measured else 0.0
    return mean_of(before, now, decay, lag, period)


@loop
def correct_all(memory, at, action):
    """Actions (N, 2) in and out: less what the drives are known to add, within [-1, 1]."""
    for i in range(action.shape[0]):
        for side in range(2):
            known = memory[i, at + side * DRIVE_COLUMNS + _ESTIMATE + 2]
            action[i, side] = min(max(action[i, side] - known, -1.0), 1.0)
