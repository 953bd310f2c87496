"""The arrays of a batch of N vehicles, and the names of their columns.

Everything the kernels touch lives in a few arrays, one vehicle per row:
    floats    (N, FLOAT_COLUMNS)   state, parameters, reference, sensors, bookkeeping
    counters  (N, COUNTER_COLUMNS) integers: clocks and flags
    profile   (S, N, 12)           reference: polynomials of speed (6) and of yaw rate (6)
    events    (N, E, EVENT_FIELDS) what changes inside the episode
    noise     (NOISE_BLOCK / NOISE_RUN, N, NOISE_RUN, NOISE_COUNT) float32 normal numbers
              drawn ahead; NOISE_RUN steps lie together because writing is scattered too
    history   (N, H, DELIVERED_COUNT) past samples, for delayed sensors
Profile and noise have the time first: vehicles that run in step then read one stream of memory.
A column is an offset, so that a kernel takes one array instead of a hundred.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.observation import LOOK_AHEAD
from tracked_env.physics.channels import CHANNEL_COUNT, GROUPS, NOISE_COUNT
from tracked_env.physics.lumped_forces import Coefficients, DriveLimits
from tracked_env.physics.parameters import PARAMETER_ROWS
from tracked_env.physics.state import STATE_ROWS

NOISE_BLOCK = 64  # [steps] noise drawn at once per vehicle
NOISE_RUN = 8  # [steps] of it that are neighbours in memory
EVENT_FIELDS = 8
AHEAD = len(LOOK_AHEAD)
GROUP_COUNT = len(GROUPS)
COEFFICIENT_COUNT = len(Coefficients._fields)
DRIVE_COUNT = len(DriveLimits._fields)
DELIVERED_COUNT = CHANNEL_COUNT + GROUP_COUNT  # samples, and the step at which each was taken
REWARD_TERMS = ("position", "heading", "speed", "effort", "smoothness")

# --- columns of `floats` -------------------------------------------------------------------
STATE = 0
PARAMETERS = STATE + STATE_ROWS  # in force now
COEFFICIENTS = PARAMETERS + PARAMETER_ROWS  # derived from PARAMETERS
DRIVE = COEFFICIENTS + COEFFICIENT_COUNT  # derived from PARAMETERS
TORQUE_DECAY = DRIVE + DRIVE_COUNT  # [-] exp(-h / 2T) of half a sub-step
REFERENCE_X = TORQUE_DECAY + 1  # [m]
REFERENCE_Y = REFERENCE_X + 1  # [m]
REFERENCE_YAW = REFERENCE_Y + 1  # [rad]
REFERENCE_COSINE = REFERENCE_YAW + 1  # [-] of the reference yaw, and the sine in the next column
REFERENCE_MOTION = REFERENCE_COSINE + 2  # v, dv/dt, d2v/dt2, w, dw/dt
AHEAD_SPEED = REFERENCE_MOTION + 5
AHEAD_YAW_RATE = AHEAD_SPEED + AHEAD
SIGMA = AHEAD_YAW_RATE + AHEAD  # standard deviation per channel
BIAS = SIGMA + CHANNEL_COUNT  # per channel
CROSS_COUPLING = BIAS + CHANNEL_COUNT  # [-]
VELOCITY = CROSS_COUPLING + 1  # [-] 1, or 0 where v_x and v_y are not measured
DROPOUT = VELOCITY + 1  # per group: a normal number below it loses the sample
SAMPLE = DROPOUT + GROUP_COUNT  # latest samples, and the step each group was sampled
DELIVERED = SAMPLE + DELIVERED_COUNT  # samples after their delay; unused while nobody has one
ERROR_X = DELIVERED + DELIVERED_COUNT  # [m] true error, reference minus vehicle, body frame
ERROR_Y = ERROR_X + 1  # [m]
# What a step reports lies together, so that one pass over the batch collects it.
ERROR_DISTANCE = ERROR_Y + 1  # [m]
ERROR_YAW = ERROR_DISTANCE + 1  # [rad]
REWARD = ERROR_YAW + 1
TERMS = REWARD + 1  # one per reward term
SQUARED_ERROR_SUM = TERMS + len(REWARD_TERMS)  # [m^2] over the episode, for its RMSE
PREVIOUS_ACTION = SQUARED_ERROR_SUM + 1  # left, right
ACTION_BEFORE = PREVIOUS_ACTION + 2  # left, right
BASE = ACTION_BEFORE + 2  # parameters at the start of the episode
FLOAT_COLUMNS = BASE + PARAMETER_ROWS

# --- columns of `counters` -----------------------------------------------------------------
STEP = 0  # control steps since reset
NOISE_CURSOR = 1  # next unused row of the noise block
TERMINATED = 2
TRUNCATED = 3
EVENT_COUNT = 4
MAX_STEP = 5  # [control steps] of the episode
PERIOD = 6  # per group, [control steps] between samples
DELAY = PERIOD + GROUP_COUNT  # per group, [control steps]
COUNTER_COLUMNS = DELAY + GROUP_COUNT


class Batch(NamedTuple):
    """The arrays of N vehicles."""

    floats: NDArray[np.float64]
    counters: NDArray[np.int64]
    profile: NDArray[np.float64]
    events: NDArray[np.float64]
    noise: NDArray[np.float32]
    history: NDArray[np.float64]


def allocate(count: int, segments: int, events: int = 1, history: int = 1) -> Batch:
    """Zeroed arrays for `count` vehicles."""
    return Batch(
        np.zeros((count, FLOAT_COLUMNS)),
        np.zeros((count, COUNTER_COLUMNS), dtype=np.int64),
        np.zeros((segments, count, 12)),
        np.zeros((count, events, EVENT_FIELDS)),
        np.zeros((NOISE_BLOCK // NOISE_RUN, count, NOISE_RUN, NOISE_COUNT), dtype=np.float32),
        np.zeros((count, history, DELIVERED_COUNT)),
    )


def bytes_per_vehicle(batch: Batch) -> int:
    """Memory of one vehicle [bytes]."""
    return sum(array.nbytes for array in batch) // batch.floats.shape[0]
