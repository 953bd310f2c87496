"""What surrounds the filter in one step of the slip observer: memory, samples, gate, bounds.

Order of one step, for whatever does the filtering between:
    take_drive    belt speeds in, Inputs out; missing ones stay as they were and are counted; a
                  belt that jumps does not take the vehicle along, so it changes the slip
    (predict)
    reckon        the step's way into the ring of dead_reckoning
    take_pose     sample, its R and how old it is; rows that are missing get a huge variance
    start, or innovation_verdict and (update)
                  NIS above the gate is an outlier; PATIENCE of them in a row are a change: then
                  slip_covariance.inflate frees what the innovation contradicts, and the sample is
                  used
    finish        slips and alpha into their bounds, covariance symmetric and bounded

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2.
"""

import math

from baselines.estimators import pose_outages, slip_kinematics
from baselines.estimators import slip_kinematics as dead_reckoning
from baselines.estimators import slip_kinematics as slip_covariance
from baselines.estimators.measurement import COLUMN, DRIVE, INERTIAL, POSE
from baselines.estimators.slip_kinematics import (
    BELT_SIGMAS,
    PRIOR_SLIP,
    SIDE_SLIP,
    SIDE_SLIP_LIMIT,
    SLIP_LEFT,
    SLIP_LIMIT,
    SLIP_RIGHT,
    STANDING_VEHICLE,
    STATES,
    YAW,
    Way,
)
from tracked_env.physics.elementary import signed, wrap_angle
from tracked_env.physics.jit import formula
from tracked_env.physics.rigid_body import heading_rate, incline_of
from tracked_env.physics.terramechanics import slip_ratio, track_speed_from_belt

PATIENCE = 5  # [samples] that many outliers in a row are a change
EXCITED = 1.0  # [-] excitation from which on the data determine slips and side slip
TRACK_ACCELERATION = 8.0  # [m/s^2] of a track over the ground; what a belt does beyond is slip
LOST_DIGITS = 1e-6  # [SI] least variance after rounding has spoilt the covariance
FASTEST_BELT = 100.0  # [m/s] a belt beyond it is a fault of the sensor, as NaN is
OLDEST = 10.0  # [s] an older sample counts as that old
LARGEST_READING = 1e9  # [SI] anything beyond is a fault of the sensor, as NaN is

# What is remembered of one vehicle, the columns of `memory`.
STATE = 0
COVARIANCE = STATE + STATES
BELT_L, BELT_R, HELD_L, HELD_R, STARTED, OUTLIERS, SKIPPED = range(
    COVARIANCE + STATES * STATES, COVARIANCE + STATES * STATES + 7
)  # belt speeds and for how many steps they are held, a pose came (1 = yes), in a row, counted
OUTAGE = SKIPPED + 1  # what slip_outage remembers
RING = OUTAGE + pose_outages.COLUMNS

_SPEED_L, _SPEED_R = COLUMN["sprocket_speed_left"], COLUMN["sprocket_speed_right"]
_YAW_RATE = COLUMN["yaw_rate"]


@formula
def _usable(reading):
    """False for NaN, infinity and nonsense."""
    return abs(reading) < LARGEST_READING


@formula
def load(memory, i, x, p):
    """State and covariance of vehicle i into x (STATES,) and p (STATES, STATES)."""
    for a in range(STATES):
        x[a] = memory[i, STATE + a]
        for b in range(STATES):
            p[a, b] = memory[i, COVARIANCE + STATES * a + b]


@formula
def store(memory, i, x, p):
    """The reverse of `load`."""
    for a in range(STATES):
        memory[i, STATE + a] = x[a]
        for b in range(STATES):
            memory[i, COVARIANCE + STATES * a + b] = p[a, b]


@formula
def _jumps(last, belt, steps, k):
    """Whether a belt went from `last` to `belt` [m/s] faster than its track can in these steps."""
    follows = TRACK_ACCELERATION * k.period * steps
    return abs(belt - last) > follows + BELT_SIGMAS * math.sqrt(k.belt_variance)


@formula
def _slip_of_jump(x, p, state, last, belt, steps, k):
    """Slip `state` after the belt went from `last` to `belt` [m/s] within `steps` steps.

    The track over the ground follows by TRACK_ACCELERATION at most. Returns the belt that with the
    new slip makes the speed of before.
    """
    follows = TRACK_ACCELERATION * k.period * steps
    if _jumps(last, belt, steps, k):
        before = track_speed_from_belt(last, x[state])
        speed = before + signed(follows, belt - last)
        jumped = min(max(slip_ratio(belt, speed), -SLIP_LIMIT), SLIP_LIMIT)
        p[state, state] += min((jumped - x[state]) ** 2, PRIOR_SLIP * PRIOR_SLIP)
        x[state] = jumped
        last = pose_outages.belt_of(before, jumped)
    return last


@formula
def is_blind(memory, i, k):
    """Whether vehicle i is in an outage."""
    return pose_outages.silent(memory, i, OUTAGE, k)


@formula
def take_drive(memory, i, values, fresh, attitude, x, p, k):
    """Inputs of this step; the belt speeds are remembered. attitude (N, 3): ATTITUDE."""
    begun_left, begun_right = last_left, last_right = memory[i, BELT_L], memory[i, BELT_R]
    left, right = k.radius * values[i, _SPEED_L], k.radius * values[i, _SPEED_R]
    memory[i, HELD_L] += 1.0
    memory[i, HELD_R] += 1.0
    seen_left, seen_right = abs(left) < FASTEST_BELT, abs(right) < FASTEST_BELT
    jumps = seen_left and _jumps(last_left, left, memory[i, HELD_L], k)
    jumps = jumps or (seen_right and _jumps(last_right, right, memory[i, HELD_R], k))
    learns = memory[i, STARTED] > 0.0 and k.rows >= slip_kinematics.ROWS
    if jumps and learns and not fresh[i, POSE]:
        pose_outages.begin(memory, i, OUTAGE, k)
    blind = memory[i, OUTAGE] >= k.silence
    if seen_left:
        if not blind:
            last_left = _slip_of_jump(x, p, SLIP_LEFT, last_left, left, memory[i, HELD_L], k)
        memory[i, BELT_L] = left
        memory[i, HELD_L] = 0.0 if fresh[i, DRIVE] else memory[i, HELD_L]
    if seen_right:
        if not blind:
            last_right = _slip_of_jump(x, p, SLIP_RIGHT, last_right, right, memory[i, HELD_R], k)
        memory[i, BELT_R] = right
        memory[i, HELD_R] = 0.0 if fresh[i, DRIVE] else memory[i, HELD_R]
    if not (seen_left and seen_right):
        memory[i, SKIPPED] += 1.0
    incline, common = incline_of(attitude[i, 1], attitude[i, 0]), -1.0
    if memory[i, STARTED] > 0.0:
        turn, carried = heading_rate(incline, attitude[i, 2])
        common, last_left, last_right, left, right = pose_outages.carry(
            memory, i, OUTAGE, x, p, last_left, last_right, memory[i, BELT_L], memory[i, BELT_R],
            values, incline, carried, turn, k,
        )  # fmt: skip
        if common >= 0.0:
            memory[i, BELT_L], memory[i, BELT_R] = left, right
            begun_left, begun_right = last_left, last_right
    return slip_kinematics.make_inputs(
        begun_left, begun_right, memory[i, BELT_L], memory[i, BELT_R],
        x[SLIP_LEFT], x[SLIP_RIGHT], x[SIDE_SLIP], incline, attitude[i, 2], common, k,
    )  # fmt: skip


@formula
def reckon(memory, i, slots, yaw, u, k):
    """Add the step's way, with heading `yaw` [rad] in its middle."""
    way = slip_kinematics.step_way(yaw, memory[i, BELT_L], memory[i, BELT_R], u, k)
    dead_reckoning.push(memory, i, RING, slots, way)


@formula
def _steps(age, k):
    """Whole control steps in `age` [s]; 0 for what is not a positive number."""
    return math.floor(min(age, OLDEST) / k.period + 0.5) if age > 0.0 else 0.0


@formula
def _moment(memory, i, slots, steps, k):
    """Belt speeds of `steps` steps ago, with what serves as their instruments."""
    way = dead_reckoning.since(memory, i, RING, slots, steps)
    return (
        way.belt_left,
        way.belt_right,
        slip_kinematics.instrument(way.instrument_left, way.belt_left, k),
        slip_kinematics.instrument(way.instrument_right, way.belt_right, k),
    )


@formula
def take_pose(memory, i, slots, values, fresh, age, x, u, k, z, noise):
    """Sample into z (ROWS,), its R into noise (ROWS, ROWS).

    Returns (the way since it was taken, belt speeds when the gyro's was taken). Velocities that
    are missing, and a gyro without a new sample, are replaced by the model's with a huge variance.
    The drive's own delay counts: its latest belt speed is one of `age` ago.
    """
    if pose_outages.silent(memory, i, OUTAGE, k):
        pose_outages.add_shown(memory, i, OUTAGE, x, memory[i, BELT_L], memory[i, BELT_R], 1.0, k)
    drive, pose = _steps(age[i, DRIVE], k), _steps(age[i, POSE], k)
    pose_outages.see(memory, i, OUTAGE, values[i, 3], values[i, 2], pose * k.period, values, k)
    sums = dead_reckoning.since(memory, i, RING, slots, pose)
    way = Way(
        sums.d_left, sums.d_right, sums.c_left, sums.s_left, sums.c_right, sums.s_right,
        *_moment(memory, i, slots, pose - drive, k),
    )  # fmt: skip
    gyro = Way(
        0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        *_moment(memory, i, slots, _steps(age[i, INERTIAL], k) - drive, k),
    )  # fmt: skip
    slip_covariance.fill_measurement_noise(noise, u, way, gyro, pose, k)
    expected = slip_kinematics.measured(x[0], x[1], x[2], x[3], x[4], x[5], u, way, gyro, k)
    z[0], z[1] = values[i, 0], values[i, 1]
    z[2] = expected[2] + wrap_angle(values[i, 2] - expected[2])
    z[3], z[4], z[5] = values[i, 3], values[i, 4], values[i, _YAW_RATE]
    missing = False
    for row in range(3, int(k.rows)):
        new = row < 5 or fresh[i, INERTIAL]
        missing = missing or (new and not _usable(z[row]))
        if not (new and _usable(z[row])):
            z[row] = expected[row]
            noise[row, :] = 0.0
            noise[:, row] = 0.0
            noise[row, row] = slip_covariance.IGNORED
    if missing:
        memory[i, SKIPPED] += 1.0
    return way, gyro


@formula
def take_motion(memory, i, values, fresh, x, p, u, k, z, noise):
    """In an outage: what gyro, effort and friction say into z (ROWS,), its R into noise.

    Returns (no way, present belt speeds), as `take_pose`.
    """
    left, right = memory[i, BELT_L], memory[i, BELT_R]
    memory[i, OUTLIERS] = 0.0
    now = Way(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, left, right, left, right)
    expected = slip_kinematics.measured(x[0], x[1], x[2], x[3], x[4], x[5], u, now, now, k)
    pose_outages.measure(
        memory, i, OUTAGE, values, fresh, expected, x, p, left, right, u.press, k, z, noise
    )
    return now, now


@formula
def has_pose(values, fresh, i):
    """(a new pose sample came, it can be used)."""
    x, y, yaw = values[i, 0], values[i, 1], values[i, 2]
    return fresh[i, POSE], _usable(x) and _usable(y) and _usable(yaw)


@formula
def start(memory, i, values, x, p, z, noise, way, k):
    """Pose and inertial speed from the first sample, as uncertain as the sensor is and as far as it
    is old. The slips stay open: the drives change them at once, the speed they do not."""
    driven = max(abs(way.d_left), abs(way.d_right))
    for a in range(3):
        x[a] = z[a]
        p[a, :] = 0.0
        p[:, a] = 0.0
        p[a, a] = noise[a, a] + (driven * driven if a < YAW else 0.0)
    memory[i, STARTED] = 1.0
    v, variance = 0.5 * (way.belt_left + way.belt_right), STANDING_VEHICLE * STANDING_VEHICLE
    variance = max(PRIOR_SLIP * PRIOR_SLIP * v * v, variance)
    if k.rows >= slip_kinematics.ROWS and noise[3, 3] < variance:
        v, variance = z[3], noise[3, 3]
    pose_outages.start(memory, i, OUTAGE, x, p, values, v, variance, k)


@formula
def innovation_verdict(memory, i, nis, k):
    """0 = use the sample, 1 = outlier, 2 = one too many outliers: follow it.

    The first pose after an outage is followed.
    """
    if pose_outages.silent(memory, i, OUTAGE, k):
        return 2 if nis > k.gate else 0
    if nis <= k.gate:
        memory[i, OUTLIERS] = 0.0
        return 0
    memory[i, OUTLIERS] += 1.0
    if memory[i, OUTLIERS] < PATIENCE:
        return 1
    memory[i, OUTLIERS] = 0.0
    return 2


@formula
def finish(memory, i, x, p, root, u, used, outcome, k):
    """Bounds, memory; root (STATES, STATES) is scratch; used: a pose was.

    Returns (excitation, condition, status as estimate.Status).
    """
    x[SLIP_LEFT] = min(max(x[SLIP_LEFT], -SLIP_LIMIT), SLIP_LIMIT)
    x[SLIP_RIGHT] = min(max(x[SLIP_RIGHT], -SLIP_LIMIT), SLIP_LIMIT)
    x[SIDE_SLIP] = min(max(x[SIDE_SLIP], -SIDE_SLIP_LIMIT), SIDE_SLIP_LIMIT)
    slip_covariance.bound(p)
    if not slip_covariance.factorise(p, root, STATES, 1.0):
        # Rounding has used up the digits, after nonsense: keep the variances, drop the rest.
        for a in range(STATES):
            variance = min(max(p[a, a], LOST_DIGITS), slip_covariance.largest_variance(a))
            p[a, :] = 0.0
            p[:, a] = 0.0
            p[a, a] = variance
    if memory[i, STARTED] > 0.0:
        pose_outages.settle(memory, i, OUTAGE, x, p, memory[i, BELT_L], memory[i, BELT_R], used, k)
    store(memory, i, x, p)
    smallest, largest = slip_covariance.information(p)
    moves = min(min(u.fade_left, u.fade_right), u.fade_side) > 0.0
    learns = used and moves and smallest >= EXCITED
    status = outcome if outcome == 2 else (0 if learns else 1)
    return smallest, largest / smallest if smallest > 1e-9 else math.inf, status
