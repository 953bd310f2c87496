"""The control step of a batch, as a template that every plant compiles for itself.

One call advances vehicles start..stop-1: actions taken, parameters in force, motion (the plant's),
reference, sensors, tracking error, reward, flags, observation. Nothing in it depends on how many
vehicles share the call, so a batch gives the bits of one vehicle.

A plant's file makes its kernels by handing its own functions to the templates:

    @loop
    def advance(
        floats, counters, profile, events, noise, history, chosen, actions, observations,
        start, stop, moving, substeps, substep, error_limit,
    ):
        batch = Batch(floats, counters, profile, events, noise, history)
        given = (chosen, actions, observations)
        rest = (start, stop, moving, substeps, substep, error_limit)
        return advance_blocks(derive, move, LANES, np.empty((ROWS, LANES)), batch, given, rest)

    @loop
    def hold(*call):
        return hold_blocks(derive, move_held, LANES, np.empty((ROWS, LANES)), call)

They stand at module level, because the kernel cache finds those again in a new process, but not
closures. A plant's options are further arguments of `advance`, and follow in `rest`. Kernels are
called with plain arrays and numbers: a tuple with names costs microseconds at the boundary from
Python, and nothing inside, and `*rest` instead of the numbers' names a twentieth of one.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine import columns as b
from tracked_env.engine import observing
from tracked_env.engine.columns import Batch
from tracked_env.physics import reference_knots
from tracked_env.physics import state as s
from tracked_env.physics.jit import formula, template
from tracked_env.rewards import reward_and_ending
from tracked_env.terrain import ground

DIVERGED = 1e15  # [SI] no motion of a vehicle has such numbers; their squares are still finite
CALM, SOME_ENDED = -1, -2  # results of a step: whether some vehicle's episode has ended


class Clock(NamedTuple):
    """Time of a control step and where an episode ends, the same for every vehicle."""

    substeps: int  # of a control step
    substep: float  # [s]
    error_limit: float  # [m] distance to the reference that ends an episode


class Block(NamedTuple):
    """Vehicles that a plant moves at once, chosen[first] .. chosen[first + lanes - 1]."""

    chosen: NDArray[np.int64]
    first: int
    lanes: int


class Pace(NamedTuple):
    """How far a plant moves them: `substeps` steps of h [s]; 0 settles what follows from a state.

    period [s]: of a control step, also where substeps is 0.
    """

    substeps: int
    h: float
    period: float


@formula
def _advance_reference(floats, counters, profile, i, period):
    """Move the reference pose of vehicle i on by one control step."""
    step = counters[i, b.STEP]
    x, y, cosine, sine, yaw = reference_knots.advance(
        profile[:, i],
        step * period,
        (step + 1) * period,
        period,
        floats[i, b.REFERENCE_X],
        floats[i, b.REFERENCE_Y],
        floats[i, b.REFERENCE_COSINE],
        floats[i, b.REFERENCE_COSINE + 1],
        floats[i, b.REFERENCE_YAW],
    )
    floats[i, b.REFERENCE_X], floats[i, b.REFERENCE_Y] = x, y
    floats[i, b.REFERENCE_COSINE], floats[i, b.REFERENCE_COSINE + 1] = cosine, sine
    floats[i, b.REFERENCE_YAW] = yaw


@formula
def _begin(derive, batch, clock, actions, i, moving, period):
    """Take the action of vehicle i, and bring its parameters up to date."""
    floats = batch.floats
    if moving:
        for side in range(2):
            action = min(max(np.float64(actions[i, side]), -1.0), 1.0)
            floats[i, b.LAST_ACTION + side] = floats[i, b.ACTION + side]
            floats[i, b.ACTION + side] = action
    count = batch.counters[i, b.EVENT_COUNT]
    if count > 0:
        ground.refresh(floats, batch.events, i, count, batch.counters[i, b.STEP] * period)
    if count > 0 or not moving:
        derive(floats, i, clock.substep)


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
def _finish(batch, observations, i, moving, period, error_limit):
    """All that follows the motion of vehicle i; returns CALM or SOME_ENDED."""
    floats, counters = batch.floats, batch.counters
    if moving:
        _advance_reference(floats, counters, batch.profile, i, period)
        counters[i, b.STEP] += 1
        counters[i, b.NOISE_CURSOR] += 1
    diverged = moving and not _is_finite(floats, i)
    observing.observe(
        floats, counters, batch.profile, batch.noise, batch.history, i, counters[i, b.STEP],
        period, observations, diverged,
    )  # fmt: skip
    if moving:
        reward_and_ending(floats, counters, i, error_limit, diverged)
        if counters[i, b.TERMINATED] + counters[i, b.TRUNCATED] > 0:
            return SOME_ENDED
    return CALM


@template
def advance_blocks(derive, move, lane_limit, scratch, batch, given, rest):
    """Advance vehicles chosen[start:stop] by one control step and write their observations.

    derive: compiled (floats, i, substep), refreshes what follows from the parameters of vehicle i.
    move: compiled (batch, scratch, block, pace, options), moves a block of at most lane_limit
    vehicles and settles their states. given: chosen (M,) int64 rows of vehicles, actions (N, 2)
    float32, clipped to [-1, 1], observations (N, SIZE) float32. rest: start, stop, moving, the
    numbers of Clock, then the plant's options; moving: False completes freshly loaded vehicles
    instead of moving them.
    Returns CALM or SOME_ENDED, or the first row with a non-finite action: then no vehicle has
    moved.
    """
    chosen, actions, observations = given
    start, stop, moving = rest[0], rest[1], rest[2]
    clock, options = Clock(rest[3], rest[4], rest[5]), rest[6:]
    result = _refused(actions, chosen, start, stop)
    if result != CALM:
        return result
    period = clock.substeps * clock.substep
    steps = clock.substeps if moving else 0
    for first in range(start, stop, lane_limit):
        lanes = min(lane_limit, stop - first)
        for lane in range(lanes):
            _begin(derive, batch, clock, actions, chosen[first + lane], moving, period)
        for lane in range(lanes):
            i = chosen[first + lane]
            observing.expect(batch.counters, batch.profile, batch.noise, i, period)
        pace = Pace(steps, clock.substep, period)
        move(batch, scratch, Block(chosen, first, lanes), pace, options)
        for lane in range(lanes):
            ended = _finish(
                batch, observations, chosen[first + lane], moving, period, clock.error_limit
            )
            result = min(result, ended)
    return result


@template
def hold_blocks(derive, move, lane_limit, scratch, call):
    """Move vehicles chosen[start:stop] with what their drives are asked held, and nothing else.

    No reference, sensors, reward or episode: the plant alone, for `plants.standalone`. call: the
    six arrays of the batch, chosen, start, stop, substeps, h [s], then what `move` takes as
    options. Parameters are those in force.
    """
    batch = Batch(call[0], call[1], call[2], call[3], call[4], call[5])
    chosen, start, stop, substeps, h = call[6], call[7], call[8], call[9], call[10]
    for first in range(start, stop, lane_limit):
        lanes = min(lane_limit, stop - first)
        for lane in range(lanes):
            derive(batch.floats, chosen[first + lane], h)
        pace = Pace(substeps, h, substeps * h)
        move(batch, scratch, Block(chosen, first, lanes), pace, call[11:])
    return CALM
