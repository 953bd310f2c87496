"""The arrays of a batch of N vehicles, the names of their columns, and what is read of them.

Everything the kernels touch lives in a few arrays, one vehicle per row, see `Batch`. A column is an
offset, so that a kernel takes one array instead of a hundred. Offsets are for kernels; outside them
a column has a name (`COLUMN`, `Batch.column`, `Batch.counter`). Profile and noise have the time
first: vehicles that run in step then read one stream of memory.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.observation import LOOK_AHEAD
from tracked_env.physics.lumped import Coefficients, DriveLimits
from tracked_env.physics.parameters import PARAMETER_NAMES, PARAMETER_ROWS, STATE_NAMES, STATE_ROWS
from tracked_env.physics.reference_profile import UNIFORM_COLUMNS
from tracked_env.sensors import CHANNEL_COUNT, GROUPS, NOISE_COUNT

NOISE_BLOCK = 64  # [steps] noise drawn at once per vehicle
NOISE_RUN = 8  # [steps] of it that are neighbours in memory: writing is scattered too
EVENT_FIELDS = 8
AHEAD = len(LOOK_AHEAD)
GROUP_COUNT = len(GROUPS)
COEFFICIENT_COUNT = len(Coefficients._fields)
DRIVE_COUNT = len(DriveLimits._fields)
DELIVERED_COUNT = CHANNEL_COUNT + GROUP_COUNT  # samples, and the step at which each was taken
STEEPEST = 5.0  # [-] dz/dx of any terrain, 79 degrees
# What an episode draws on top of a terrain, see `terrain.pool`: two slopes, and sinusoids.
DRAWN_WAVES = 8
RELIEF_SIZE = 2 + 4 * DRAWN_WAVES
RELIEF_COLUMNS = RELIEF_SIZE + 1  # and the member of the pool
SUCCESS_RMSE = 0.25  # [-] an episode that ends with less, over the contact length, is a success

REWARD_TERMS = ("position", "heading", "speed", "effort", "smoothness")

# --- columns of `floats` -------------------------------------------------------------------
STATE = 0
PARAMETERS = STATE + STATE_ROWS  # in force now
COEFFICIENTS = PARAMETERS + PARAMETER_ROWS  # derived from PARAMETERS, by plants that use them
DRIVE = COEFFICIENTS + COEFFICIENT_COUNT  # the same
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
OUTAGE = DROPOUT + GROUP_COUNT  # [control steps] gap low, high, length low, high
SAMPLE = OUTAGE + 4  # latest samples, and the step each group was sampled
DELIVERED = SAMPLE + DELIVERED_COUNT  # samples after their delay; unused while nobody has one
# What a step reports lies together, so that one pass over the batch collects it.
ERROR_DISTANCE = DELIVERED + DELIVERED_COUNT  # [m] true distance from vehicle to reference
ERROR_YAW = ERROR_DISTANCE + 1  # [rad] true, reference minus vehicle
REWARD = ERROR_YAW + 1
TERMS = REWARD + 1  # one per reward term
SQUARED_ERROR_SUM = TERMS + len(REWARD_TERMS)  # [m^2] over the episode, for its RMSE
ACTION = SQUARED_ERROR_SUM + 1  # [-] in force: left, right
LAST_ACTION = ACTION + 2  # [-] of the control step before: left, right
BASE = LAST_ACTION + 2  # parameters at the start of the episode
FAILURE = BASE + PARAMETER_ROWS  # [-] why the vehicle cannot go on, `Plant.failures`; 0: it can
ERROR_LIMIT = FAILURE + 1  # [m] distance to the reference that ends the episode
PLANT = ERROR_LIMIT + 1  # from here on: what a plant keeps for itself

# Name -> column of `floats`, for all that is read outside kernels.
COLUMN = {
    **{name: STATE + row for row, name in enumerate(STATE_NAMES)},
    **{name: PARAMETERS + row for row, name in enumerate(PARAMETER_NAMES)},
    **{name: DRIVE + row for row, name in enumerate(DriveLimits._fields)},
    **{"reference_x": REFERENCE_X, "reference_y": REFERENCE_Y, "reference_yaw": REFERENCE_YAW},
    **{"reference_speed": REFERENCE_MOTION, "reference_yaw_rate": REFERENCE_MOTION + 3},
    **{"distance": ERROR_DISTANCE, "heading_error": ERROR_YAW, "reward": REWARD},
    **{f"reward_{name}": TERMS + row for row, name in enumerate(REWARD_TERMS)},
    **{"squared_error_sum": SQUARED_ERROR_SUM, "error_limit": ERROR_LIMIT},
    **{"action_left": ACTION, "action_right": ACTION + 1},
}

# --- columns of `counters` -----------------------------------------------------------------
STEP, NOISE_CURSOR, TERMINATED, TRUNCATED, EVENT_COUNT, MAX_STEP = range(6)
COUNTER = {  # names, as above: control steps since reset, next row of the noise block, flags, ...
    **{"step": STEP, "noise_cursor": NOISE_CURSOR, "event_count": EVENT_COUNT},
    **{"terminated": TERMINATED, "truncated": TRUNCATED, "max_step": MAX_STEP},
}
PERIOD = len(COUNTER)  # per group, [control steps] between samples
DELAY = PERIOD + GROUP_COUNT  # per group, [control steps]
OUTAGE_FROM = DELAY + GROUP_COUNT  # step at which the next outage of the pose begins; -1: never
OUTAGE_UNTIL = OUTAGE_FROM + 1  # step at which the last one ends or has ended
COUNTER_COLUMNS = OUTAGE_UNTIL + 1


class Report(NamedTuple):
    """What a control step reports of N vehicles."""

    tracking_error: NDArray[np.float64]  # (N, 2) distance [m] and heading error [rad]
    reward: NDArray[np.float64]  # (N,)
    terms: NDArray[np.float64]  # (len(REWARD_TERMS), N)


class RowReport(NamedTuple):
    """The same of one vehicle, as views: they change with its next step."""

    tracking_error: NDArray[np.float64]  # (2,)
    rewards: NDArray[np.float64]  # (1 + terms,) the reward, then its terms
    flags: NDArray[np.int64]  # (2,) terminated, truncated


class Batch(NamedTuple):
    """The arrays of N vehicles."""

    floats: NDArray[np.float64]  # (N, PLANT + those of the plant) state, parameters, sensors, ..
    counters: NDArray[np.int64]  # (N, COUNTER_COLUMNS) clocks and flags
    # (S, N, 12 or more) reference: polynomials of speed (6) and of yaw rate (6), and its knots
    # where it has its own, see `physics.reference_profile`
    profile: NDArray[np.float64]
    events: NDArray[np.float64]  # (N, E, EVENT_FIELDS) what changes inside the episode
    noise: NDArray[np.float32]  # (NOISE_BLOCK / NOISE_RUN, N, NOISE_RUN, NOISE_COUNT) drawn ahead
    history: NDArray[np.float64]  # (N, H, DELIVERED_COUNT) past samples, for delayed sensors

    def column(self, name: str) -> NDArray[np.float64]:
        """A view (N,) of one column of the floats."""
        return self.floats[:, COLUMN[name]]

    def counter(self, name: str) -> NDArray[np.int64]:
        """A view (N,) of one counter."""
        return self.counters[:, COUNTER[name]]

    def state(self) -> NDArray[np.float64]:
        """A view (N, STATE_ROWS) of the states."""
        return self.floats[:, STATE : STATE + STATE_ROWS]

    def parameters(self) -> NDArray[np.float64]:
        """A view (N, PARAMETER_ROWS) of the parameters in force."""
        return self.floats[:, PARAMETERS : PARAMETERS + PARAMETER_ROWS]

    def base(self) -> NDArray[np.float64]:
        """A view (N, PARAMETER_ROWS) of the parameters at the start of the episode."""
        return self.floats[:, BASE : BASE + PARAMETER_ROWS]

    def row_report(self, i: int) -> RowReport:
        """Views of what the last step reports of vehicle i."""
        row, flags = self.floats[i], self.counters[i, TERMINATED : TRUNCATED + 1]
        return RowReport(row[ERROR_DISTANCE:REWARD], row[REWARD:SQUARED_ERROR_SUM], flags)


def columns(names: Iterable[str]) -> list[int]:
    """Columns of `floats` of these names."""
    return [COLUMN[name] for name in names]


def allocate(
    count: int, segments: int, plant_columns: int = 0, reference_columns: int = UNIFORM_COLUMNS
) -> Batch:
    """Zeroed arrays for `count` vehicles, of a plant with so many columns of its own."""
    return Batch(
        np.zeros((count, PLANT + plant_columns)),
        np.zeros((count, COUNTER_COLUMNS), dtype=np.int64),
        np.zeros((segments, count, reference_columns)),
        np.zeros((count, 1, EVENT_FIELDS)),
        np.zeros((NOISE_BLOCK // NOISE_RUN, count, NOISE_RUN, NOISE_COUNT), dtype=np.float32),
        np.zeros((count, 1, DELIVERED_COUNT)),
    )
