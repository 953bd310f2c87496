"""Poses that come late: the estimators run at the time of the pose, inertial samples go on to now.

A pose that is L steps old tells of step n - L. Where slips change within the delay, no constant
slip explains both the belts now and that pose, and a filter that tries to loses the heading, on
weak soil within a second. So all samples of one moment are taken together,
    filter, regressions   at n - L, with belts, torques, gyro and accelerometer of then
    to the present        v_x' = f_x + w v_y - b,   psi' = w - b_w,   x', y' from them (trapezoids)
with f_x, w what was felt since, b, b_w the biases that slip_outage has learned, and v_y as it was.
Slips of the present are those of that motion and of the belts of now; what the accelerometer and
the gyro add to the variance of the speed, L steps long, adds to theirs.
L is of the data sheet. In the first L steps of an episode nothing new is known of the moment of
the first pose: the filter waits, and what is shown is that pose and the inertial way since.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.estimators import pose_outages
from baselines.estimators import slip_step as step
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    FIRST,
    GROUP_SIZE,
    INERTIAL,
    POSE,
    RINGS,
    SLOT,
    STEP,
    Estimate,
    Measurement,
    ObservationReader,
    Reading,
)
from baselines.estimators.slip_kinematics import (
    PRIOR_SLIP,
    SIDE_SLIP,
    SLIP_LEFT,
    SLIP_LIMIT,
    SLIP_RIGHT,
    STANDING_VEHICLE,
    STATES,
)
from baselines.estimators.slip_observer import Answer, SlipObserver
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.rigid_body import heading_rate, incline_of, on_map
from tracked_env.physics.terramechanics import GRAVITY, slip_ratio

_FELT = COLUMN["acceleration_x"] - int(FIRST[INERTIAL])
_GYRO = COLUMN["yaw_rate"] - int(FIRST[INERTIAL])
_BEND = COLUMN["yaw_acceleration"] - int(FIRST[INERTIAL])
_SPROCKET = COLUMN["sprocket_speed_left"]


class Moment(NamedTuple):
    """What N vehicles measured when the last pose saw them."""

    samples: Measurement  # ages as they were then
    paired: Measurement  # inertial and drive of one moment, then; not fresh where there is no pair
    drive_delay: NDArray[np.float64]  # (N,) [s] beyond that of the pose
    steps: NDArray[np.int64]  # (N,) since then
    held: NDArray[np.bool_]  # (N,) nothing is new: the filter waits


@formula
def _newest(memory, i, group, slots, moment):
    """(column of the last sample of a group up to step `moment`, steps it is older); -1: none."""
    for older in range(min(slots, moment + 1)):
        at = RINGS + ((group - 1) * slots + (moment - older) % slots) * SLOT
        if memory[i, at] == moment - older + 1.0:
            return at, older
    return -1, 0


@loop
def look_back(
    memory, period, slots, lag, values, fresh, age, pairs, pair, pair_age, delay, steps, held
):  # fmt: skip
    """Samples of `lag` steps ago out of the reader's memory, into values (N, CHANNELS), fresh and
    age (N, 3), those of one moment into pairs, pair, pair_age, and delay (N,), which all hold
    those of now; steps and held (N,) are written."""
    for i in range(memory.shape[0]):
        now = int(memory[i, STEP]) - 1
        steps[i] = min(lag, now)
        held[i] = 0 < now <= lag
        since = steps[i] * period
        for group in (INERTIAL, DRIVE):
            at, older = _newest(memory, i, group, slots, now - steps[i])
            fresh[i, group] = at >= 0 and older == 0 and not held[i]
            age[i, group] = older * period
            for c in range(GROUP_SIZE):
                values[i, FIRST[group] + c] = memory[i, at + 1 + c] if at >= 0 else np.nan
        if pair_age[i, DRIVE] < since + 0.5 * period:  # else even later than the pose
            for group in (INERTIAL, DRIVE):
                pair[i, group] = fresh[i, INERTIAL] and fresh[i, DRIVE]
                pair_age[i, group] = since
                for c in range(GROUP_SIZE):
                    pairs[i, FIRST[group] + c] = values[i, FIRST[group] + c]
        fresh[i, POSE] = fresh[i, POSE] and not held[i]
        age[i, POSE] = max(age[i, POSE] - since, 0.0)
        delay[i] = max(delay[i] - since, 0.0)


@loop
def carry(motion, memory, period, slots, steps, biases, attitude):
    """Motion (N, 6) of `steps` (N,) ago to the present, in place, by what was felt since.

    biases (N, 2) of accelerometer [m/s^2] and gyro [rad/s]; attitude (N, 3). Where a sample is
    missing, the accelerations of the one before last on.
    """
    for i in range(motion.shape[0]):
        now = int(memory[i, STEP]) - 1
        incline = incline_of(attitude[i, 1], attitude[i, 0])
        turn, carried = heading_rate(incline, attitude[i, 2])
        v_y, felt, turning = motion[i, 4], 0.0, motion[i, 5]
        for k in range(steps[i] + 1):
            at, older = _newest(memory, i, INERTIAL, slots, now - steps[i] + k)
            a, w = felt, turning
            if at >= 0:
                new_a = memory[i, at + 1 + _FELT] - biases[i, 0] + GRAVITY * incline.down_x
                new_w = memory[i, at + 1 + _GYRO] - biases[i, 1]
                if older > 0 and math.isfinite(memory[i, at + 1 + _BEND]):
                    new_w += older * period * memory[i, at + 1 + _BEND]
                a = new_a if abs(new_a) < pose_outages.LARGEST_ACCELERATION else felt
                w = new_w if abs(new_w - motion[i, 5]) < pose_outages.WILD_TURN else turning
            if k > 0:
                mean_w = 0.5 * (turning + w)
                gain = period * (0.5 * (felt + a) + mean_w * v_y)
                bend = period * (turn * mean_w + carried)
                c, s = rotation(motion[i, 2] + 0.5 * bend)
                along, across = on_map(
                    period * (motion[i, 3] + 0.5 * gain), period * v_y, incline
                )  # fmt: skip
                motion[i, 0] += c * along - s * across
                motion[i, 1] += s * along + c * across
                motion[i, 2] += bend
                motion[i, 3] += gain
            felt, turning = a, w
        if steps[i] > 0:
            motion[i, 5] = turning


@loop
def slips_now(motion, values, memory, value, covariance, steps, k):
    """Pose, slips and side slip of now into value (N, STATES) and covariance, which hold those of
    `steps` (N,) ago; motion (N, 6) and values (N, CHANNELS) are of now.

    With g = -dV/di, the variance of a speed V of a track is g^2 times that of its slip. The speed
    of then is as sure as its slips; a bias b and white noise s of the accelerometer add
    T^2 b^2 + T dt s^2 within T, and the turn of now is the gyro's.
    """
    at = step.OUTAGE
    for i in range(motion.shape[0]):
        x, p = value[i], covariance[i]
        left, right = memory[i, step.BELT_L], memory[i, step.BELT_R]
        time = steps[i] * k.period
        shared = pose_outages.speed_variance(x, p, left, right, k)
        shared += time * time * memory[i, at + pose_outages.P_BB]
        shared += time * k.period * k.acceleration_variance
        if steps[i] > 0:
            shared += pose_outages.HANDOVER * pose_outages.HANDOVER
        turn = 0.25 * (k.gyro_variance + memory[i, at + pose_outages.P_GG])
        turn /= k.inverse_gauge * k.inverse_gauge
        rises = (1.0, 1.0)
        for side in range(2):
            belt = k.radius * values[i, _SPROCKET + side]
            speed = motion[i, 3] + (side - 0.5) * motion[i, 5] / k.inverse_gauge
            state = SLIP_LEFT + side
            if abs(belt) < step.FASTEST_BELT and abs(belt) > k.standing_belt:
                x[state] = min(max(slip_ratio(belt, speed), -SLIP_LIMIT), SLIP_LIMIT)
                rise = pose_outages.steepness(belt, x[state], k)
                noise = k.belt_variance * (speed / belt) ** 2
                p[state, :] = 0.0
                p[:, state] = 0.0
                p[state, state] = min(
                    (shared + turn + noise) / (rise * rise), PRIOR_SLIP * PRIOR_SLIP
                )
            else:
                rise = math.inf
            rises = (rise, rises[1]) if side == 0 else (rises[0], rise)
        cross = (shared - turn) / (rises[0] * rises[1])
        p[SLIP_LEFT, SLIP_RIGHT] = p[SLIP_RIGHT, SLIP_LEFT] = cross
        for a in range(3):
            x[a] = motion[i, a]
        if abs(motion[i, 3]) > STANDING_VEHICLE:
            x[SIDE_SLIP] = math.atan(motion[i, 4] / motion[i, 3])


def moment_of(reader: ObservationReader, reading: Reading) -> Moment:
    """The moment of the last pose; that of the observation where poses are not late."""
    latest, count = reading.latest, len(reader.memory)
    steps, held = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)
    if reader.lag == 0:
        return Moment(latest, reading.paired, reading.drive_delay, steps, held)
    then, paired = (
        Measurement(one.values.copy(), one.fresh.copy(), one.age.copy())
        for one in (latest, reading.paired)
    )
    delay = reading.drive_delay.copy()
    look_back(
        reader.memory, reader.control_period, reader.slots, reader.lag,
        *then, *paired, delay, steps, held,
    )  # fmt: skip
    return Moment(then, paired, delay, steps, held)


def filtered(slip: SlipObserver, samples: Measurement, held: NDArray[np.bool_]) -> Answer:
    """The slip observer's answer; rows that are held stay where they were."""
    if not held.any():
        return slip.compute(samples)
    waiting = slip.memory[held]
    value, covariance, summary, status = slip.compute(samples)
    slip.memory[held] = waiting
    value[held] = waiting[:, step.STATE : step.STATE + STATES]
    covariance[held] = waiting[:, step.COVARIANCE :][:, : STATES**2].reshape(-1, STATES, STATES)
    return value, covariance, summary, status


def to_present(
    motion: NDArray[np.float64],
    reader: ObservationReader,
    slip: SlipObserver,
    moment: Moment,
    attitude: NDArray[np.float64],
) -> None:
    """Move a motion (N, 6) of that moment to now, in place; attitude (N, 3) [rad, rad, rad/s]."""
    if reader.lag == 0:
        return
    columns = [step.OUTAGE + pose_outages.BIAS, step.OUTAGE + pose_outages.TURN_BIAS]
    carry(
        motion, reader.memory, reader.control_period, reader.slots, moment.steps,
        slip.memory[:, columns], attitude,
    )  # fmt: skip


def estimate_now(
    slip: SlipObserver, answer: Answer, motion: NDArray[np.float64], values: NDArray[np.float64],
    steps: NDArray[np.int64],
) -> Estimate:  # fmt: skip
    """The Estimate of now of an answer that is `steps` (N,) old; see `slips_now`."""
    value, covariance = answer[0].copy(), answer[1].copy()
    slips_now(motion, values, slip.memory, value, covariance, steps, slip.constants)
    return slip.estimate((value, covariance, answer[2], answer[3]))
