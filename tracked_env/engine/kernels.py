"""The loops that advance a batch by one control step.

One call advances vehicles start..stop-1: actions taken, parameters in force, motion (see
`moving_lumped`, `moving_patches`), reference, sensors, tracking error, reward, flags,
observation. Nothing in it depends on how many vehicles share the call, so a batch gives the bits
of one vehicle.
"""

import math

import numpy as np

from tracked_env.engine import columns as b
from tracked_env.engine import observing
from tracked_env.physics import lumped_forces, parameter_events, patch_forces, reference_profile
from tracked_env.physics import state as s
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PARAMETER_ROWS, row_parameters
from tracked_env.plants import distributed, lumped
from tracked_env.plants.lumped import LANES
from tracked_env.rewards import judge

DIVERGED = 1e15  # [SI] no motion of a vehicle has such numbers; their squares are still finite
CALM, SOME_ENDED = -1, -2  # results of a step: whether some vehicle's episode has ended


@formula
def derive(floats, i, substep, constrained):
    """Refresh what follows from the parameters of vehicle i; substep h [s]."""
    p = row_parameters(floats, i, b.PARAMETERS)
    k = lumped_forces.coefficients(p, constrained)
    drive = lumped_forces.drive_limits(p)
    for row in range(b.COEFFICIENT_COUNT):
        floats[i, b.COEFFICIENTS + row] = k[row]
    for row in range(b.DRIVE_COUNT):
        floats[i, b.DRIVE + row] = drive[row]
    floats[i, b.TORQUE_DECAY] = lumped_forces.torque_decay(0.5 * substep, p.drive_time_constant)


@formula
def _apply_events(floats, events, i, count, time):
    """Parameters in force at `time` [s]: the base values changed by each event in turn."""
    for row in range(PARAMETER_ROWS):
        floats[i, b.PARAMETERS + row] = floats[i, b.BASE + row]
    for e in range(count):
        row = b.PARAMETERS + int(events[i, e, 1])
        floats[i, row] = parameter_events.changed_value(
            floats[i, row], events, i, e, time, floats[i, b.STATE + s.X], floats[i, b.STATE + s.Y]
        )


@formula
def _advance_reference(floats, counters, profile, i, period):
    """Move the reference pose of vehicle i on by one control step."""
    x, y, cosine, sine, rotation = reference_profile.advance_pose(
        profile[:, i, :6],
        profile[:, i, 6:],
        counters[i, b.STEP] * period,
        period,
        floats[i, b.REFERENCE_X],
        floats[i, b.REFERENCE_Y],
        floats[i, b.REFERENCE_COSINE],
        floats[i, b.REFERENCE_COSINE + 1],
    )
    floats[i, b.REFERENCE_X], floats[i, b.REFERENCE_Y] = x, y
    floats[i, b.REFERENCE_COSINE], floats[i, b.REFERENCE_COSINE + 1] = cosine, sine
    floats[i, b.REFERENCE_YAW] += rotation


@formula
def _begin(floats, counters, events, actions, i, moving, period, h, constrained):
    """Take the action of vehicle i, and bring its parameters up to date."""
    if moving:
        for side in range(2):
            action = min(max(np.float64(actions[i, side]), -1.0), 1.0)
            floats[i, b.ACTION_BEFORE + side] = floats[i, b.PREVIOUS_ACTION + side]
            floats[i, b.PREVIOUS_ACTION + side] = action
    count = counters[i, b.EVENT_COUNT]
    if count > 0:
        _apply_events(floats, events, i, count, counters[i, b.STEP] * period)
    if count > 0 or not moving:
        derive(floats, i, h, constrained)


@formula
def _is_finite(floats, i):
    """Whether every entry of the state of vehicle i is finite, and far from overflow."""
    total = 0.0
    for row in range(s.STATE_ROWS):
        total += abs(floats[i, b.STATE + row])
    return total < DIVERGED


@formula
def _refused(actions, chosen, start, stop):
    """The first chosen row with a non-finite action, or CALM."""
    for j in range(start, stop):
        i = chosen[j]
        if not math.isfinite(actions[i, 0]) or not math.isfinite(actions[i, 1]):
            return i
    return CALM


@formula
def _finish(
    floats, counters, profile, noise, history, observations, i, moving, period, error_limit
):
    """All that follows the motion of vehicle i; returns CALM or SOME_ENDED."""
    if moving:
        _advance_reference(floats, counters, profile, i, period)
        counters[i, b.STEP] += 1
        counters[i, b.NOISE_CURSOR] += 1
    diverged = moving and not _is_finite(floats, i)
    observing.observe(
        floats, counters, profile, noise, history,
        i, counters[i, b.STEP], period, observations, diverged,
    )  # fmt: skip
    if moving:
        judge(floats, counters, i, error_limit, diverged)
        if counters[i, b.TERMINATED] + counters[i, b.TRUNCATED] > 0:
            return SOME_ENDED
    return CALM


def _lumped(constrained):
    """The step kernel of one lateral closure; each is compiled when it is first used."""

    def advance_batch(
        floats, counters, profile, events, noise, history,
        chosen, actions, observations, start, stop,
        moving, substeps, h, error_limit,
    ):  # fmt: skip
        """Advance vehicles chosen[start:stop] by one control step and write their observations.

        chosen: (M,) int64 indices of vehicles; actions: (N, 2) float32, clipped to [-1, 1];
        observations: (N, SIZE) float32; moving: False completes freshly loaded vehicles instead
        of moving them; h [s] is the sub-step, `substeps` of them make a control step;
        error_limit [m] ends an episode.
        Returns CALM or SOME_ENDED, or the first row with a non-finite action: then no vehicle
        has moved.
        """
        result = _refused(actions, chosen, start, stop)
        if result != CALM:
            return result
        period = substeps * h
        scratch = np.empty((lumped.SCRATCH_ROWS, LANES))
        for first in range(start, stop, LANES):
            lanes = min(LANES, stop - first)
            for lane in range(lanes):
                i = chosen[first + lane]
                _begin(floats, counters, events, actions, i, moving, period, h, constrained)
            steps = substeps if moving else 0
            lumped.move(floats, scratch, chosen, first, lanes, steps, h, constrained)
            for lane in range(lanes):
                ended = _finish(
                    floats, counters, profile, noise, history, observations,
                    chosen[first + lane], moving, period, error_limit,
                )  # fmt: skip
                result = min(result, ended)
        return result

    return loop(advance_batch)


advance_sliding = _lumped(False)
advance_constrained = _lumped(True)


@loop
def advance_distributed(
    floats, counters, profile, events, noise, history,
    chosen, actions, observations, start, stop,
    moving, substeps, h, error_limit, patches, by_torque,
):  # fmt: skip
    """The same for the distributed plant: patches under each track; by_torque: what the
    actions are, torques or else sprocket speeds."""
    result = _refused(actions, chosen, start, stop)
    if result != CALM:
        return result
    period = substeps * h
    scratch = np.empty((patch_forces.SCRATCH_ROWS, patch_forces.LANES))
    for j in range(start, stop):
        i = chosen[j]
        _begin(floats, counters, events, actions, i, moving, period, h, False)
        steps = substeps if moving else 0
        distributed.move(floats, scratch, i, steps, h, patches, by_torque)
        ended = _finish(
            floats, counters, profile, noise, history, observations, i, moving, period, error_limit
        )
        result = min(result, ended)
    return result
