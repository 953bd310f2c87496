"""From observations to measurements: absolute pose, new samples, samples that belong together.

An observation holds the pose as an error against the reference. The reader integrates the
reference from the observed speed and yaw rate (cubic between two observations), so that
    p = p_ref - R(yaw) e_p,    yaw = yaw_ref - e_yaw
are coordinates in a frame fixed at the start of the episode. What the integration loses is common
to p and p_ref, hence nothing that a controller acts on. A group has a new sample when its age has
not grown by one control period. Inertial and drive samples of different age are paired by the
time at which they were taken, so that regressions see one moment; each pair comes once.
Assumption: one call per control step and vehicle.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    INERTIAL,
    LONGEST_AGE,
    POSE,
    POSE_DELAY,
    Floats,
    Measurement,
    Rows,
    Stateful,
    columns_of,
)
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.sensors import CHANNEL_COUNT, CHANNELS, GROUPS
from tracked_env.validation import CONTROL_PERIOD, VEHICLES, checked_number, checked_whole

DELAY_RISE = 0.2  # [-] slope at which the delay of a group follows ages that stay up
GROUP_SIZE = 4  # channels of the inertial and of the drive group

# The state of the reader for one vehicle, and a slot of the rings of inertial and drive samples.
READER_ROW = np.dtype([
    ("x", float), ("y", float), ("yaw", float),  # of the reference
    ("speed", float), ("acceleration", float), ("yaw_rate", float), ("yaw_acceleration", float),
    ("age", float, 3),  # [s] of the groups
    ("step", float), ("delay", float),  # [s] of the drive group, dropouts apart
    ("last_pair", float),  # step at which it was taken plus one, 0 = none yet
])  # fmt: skip
SAMPLE = np.dtype([("taken", float), ("values", float, GROUP_SIZE)])  # step plus one, 0 = empty

_I, _SCALE = layout.INDEX, layout.SCALE
_ERRORS = ("position_error_x", "position_error_y", "heading_error")
_PATH = (
    "reference_speed",
    "reference_acceleration",
    "reference_yaw_rate",
    "reference_yaw_acceleration",
)
_CHANNELS = CHANNELS[COLUMN["v_x"] :]  # taken as they are
NEEDS = (*_ERRORS, *_CHANNELS, *_PATH, *(f"{group}_age" for group in GROUPS))
_ERROR_X, _ERROR_Y, _ERROR_YAW = (_I[name] for name in _ERRORS)
_SPEED, _ACCELERATION, _REF_YAW_RATE, _BEND = (_I[name] for name in _PATH)
_AGES = _I["pose_age"]
_OLDEST = float(layout.FIELDS[_AGES].bound)  # [s] at which ages are clipped
_COPIED = np.array([(_I[name], COLUMN[name]) for name in _CHANNELS])  # observation column, channel
FIRST = np.array([0, COLUMN["acceleration_x"], COLUMN["sprocket_speed_left"]])  # of each group


class Reading(NamedTuple):
    """What an observation says."""

    latest: Measurement  # each group's last sample
    paired: Measurement  # inertial and drive of one moment; not fresh where there is no pair
    reference: Floats  # (N, 3) pose of the reference now [m, m, rad]
    drive_delay: Floats  # (N,) [s] the delay of the drive group; dropouts apart


@formula
def advance_reference(row, speed, acceleration, yaw_rate, yaw_acceleration, period):
    """Move the reference pose by one period [s] to the motion now observed. Cubic Hermite
    interpolation of speed and yaw rate, Simpson's rule for the position."""
    v, a, w, bend = row.speed, row.acceleration, row.yaw_rate, row.yaw_acceleration
    half = period * ((13.0 * w + 3.0 * yaw_rate) / 32.0) + period * period * (
        (11.0 * bend - 5.0 * yaw_acceleration) / 192.0
    )
    whole = 0.5 * period * (w + yaw_rate) + period * period * (bend - yaw_acceleration) / 12.0
    v_middle = 0.5 * (v + speed) + period * (a - acceleration) / 8.0
    yaw = row.yaw
    c_0, s_0 = rotation(yaw)
    c_1, s_1 = rotation(yaw + half)
    c_2, s_2 = rotation(yaw + whole)
    row.x += period / 6.0 * (v * c_0 + 4.0 * v_middle * c_1 + speed * c_2)
    row.y += period / 6.0 * (v * s_0 + 4.0 * v_middle * s_1 + speed * s_2)
    row.yaw = yaw + whole


@formula
def _pair(row, rings, when, paired):
    """Fill the inertial and drive channels of `paired` (CHANNELS,) with samples of step `when`, the
    last for which both can have come; True when both are there and were not paired before."""
    slot = when % rings.shape[1]
    together = row.last_pair <= when
    for group in (INERTIAL, DRIVE):
        sample = rings[group - 1, slot]
        together = together and sample.taken == when + 1.0
        for c in range(GROUP_SIZE):
            paired[FIRST[group] + c] = sample.values[c]
    if together:
        row.last_pair = when + 1.0
    return together


@loop
def read_all(observation, rows, rings, period, reading):
    """Read every row of observation (N, >= SIZE) into a Reading."""
    for i in range(observation.shape[0]):
        row, ring, fields = rows[i], rings[i], observation[i]
        latest, fresh = reading.latest.values[i], reading.latest.fresh[i]
        age = reading.latest.age[i]
        speed = fields[_SPEED] * _SCALE[_SPEED]
        acceleration = fields[_ACCELERATION] * _SCALE[_ACCELERATION]
        yaw_rate = fields[_REF_YAW_RATE] * _SCALE[_REF_YAW_RATE]
        bend = fields[_BEND] * _SCALE[_BEND]
        step = int(row.step)
        if step > 0:
            advance_reference(row, speed, acceleration, yaw_rate, bend, period)
        row.speed, row.acceleration = speed, acceleration
        row.yaw_rate, row.yaw_acceleration = yaw_rate, bend
        for g in range(3):
            age[g] = fields[_AGES + g] * _SCALE[_AGES + g]
            newest = min(row.age[g] + period, _OLDEST) - 0.5 * period
            fresh[g] = step == 0 or age[g] < newest
            row.age[g] = age[g]
        row.delay = reading.drive_delay[i] = min(age[DRIVE], row.delay + DELAY_RISE * period)
        for k in range(_COPIED.shape[0]):
            latest[_COPIED[k, 1]] = fields[_COPIED[k, 0]] * _SCALE[_COPIED[k, 0]]
        yaw = row.yaw - fields[_ERROR_YAW] * _SCALE[_ERROR_YAW]
        c, s = rotation(yaw)
        e_x, e_y = fields[_ERROR_X] * _SCALE[_ERROR_X], fields[_ERROR_Y] * _SCALE[_ERROR_Y]
        latest[0] = row.x - (c * e_x - s * e_y)
        latest[1] = row.y - (s * e_x + c * e_y)
        latest[2] = yaw
        reference = reading.reference[i]
        reference[0], reference[1], reference[2] = row.x, row.y, row.yaw
        when = step
        for g in (INERTIAL, DRIVE):
            taken = max(step - int(age[g] / period + 0.5), 0)
            when = min(when, taken)
            if fresh[g]:
                sample = ring[g - 1, taken % ring.shape[1]]
                sample.taken = taken + 1.0
                for k in range(GROUP_SIZE):
                    sample.values[k] = latest[FIRST[g] + k]
        paired = reading.paired.values[i]
        for k in range(CHANNEL_COUNT):
            paired[k] = latest[k]
        together = _pair(row, ring, when, paired)
        oldest = max(age[INERTIAL], age[DRIVE])
        for g in range(3):
            reading.paired.fresh[i, g] = fresh[POSE] if g == POSE else together
            reading.paired.age[i, g] = age[POSE] if g == POSE else oldest
        row.step = step + 1.0


class ObservationReader(Stateful):
    """Reads the observations of N vehicles, one call per control step.

    control_period [s]; count: vehicles; pose_delay [s], see late_pose. Its state is `memory` and
    `ring`. Raises ValueError for a number that makes no sense.
    """

    rows = Rows("memory", READER_ROW)
    rings = Rows("ring", SAMPLE, (2, -1))  # inertial, then drive

    def __init__(self, control_period: float, count: int = 1, pose_delay: float = 0.0) -> None:
        count = checked_whole("count", count, VEHICLES)
        self.control_period = checked_number("control_period", control_period, CONTROL_PERIOD)
        delay = checked_number("pose_delay", pose_delay, POSE_DELAY)
        self.lag = round(delay / self.control_period)  # [steps]
        slots = round(LONGEST_AGE / control_period) + 2
        self.memory = np.zeros((count, columns_of(READER_ROW)))
        self.ring = np.zeros((count, 2 * slots * columns_of(SAMPLE)))
        self._read = BoundOnce(read_all)

    def read(self, observation: NDArray[np.float32], start: ArrayLike | None = None) -> Reading:
        """Read observations (N, >= SIZE); rows with `start` begin a new episode."""
        if start is not None:
            self.reset(start)
        count = len(self.memory)
        values, groups = (count, CHANNEL_COUNT), (count, 3)
        latest = Measurement(np.empty(values), np.empty(groups, bool), np.empty(groups))
        paired = Measurement(np.empty(values), np.empty(groups, bool), np.empty(groups))
        reading = Reading(latest, paired, np.empty(groups), np.empty(count))
        usual = observation.dtype == np.float32 and observation.flags.c_contiguous
        read = self._read if usual else read_all
        read(observation, self.rows, self.rings, self.control_period, reading)
        return reading
