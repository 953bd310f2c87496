"""What surrounds the filter in one step of the slip observer: samples, gate, bounds.

Order of one step:
    take_drive    belt speeds in, Inputs out; missing ones stay as they were and are counted; a
                  belt that jumps does not take the vehicle along, so it changes the slip
    (predict, and the step's way into the ring)
    take_pose     sample, its R and how old it is; rows that are missing get a huge variance
    take_motion   the same in an outage
    start, or innovation_verdict and (update)
                  NIS above the gate is an outlier; PATIENCE of them in a row are a change: then
                  inflate frees what the innovation contradicts, and the sample is used
    finish        slips and alpha into their bounds, covariance symmetric and bounded

References: [S] Strawa et al., Electronics 10 (2021) 187, section 7.2.
"""

import math
from typing import Any, NamedTuple

from baselines.estimators import pose_outages as outage
from baselines.estimators import slip_kinematics as kinematics
from baselines.estimators.measurement import COLUMN, CONVERGING, DRIVE, HOLDING, INERTIAL, POSE
from baselines.estimators.slip_kinematics import SIDE_SLIP, SLIP_LEFT, SLIP_LIMIT, SLIP_RIGHT, Way
from tracked_env.physics.elementary import signed, wrap_angle
from tracked_env.physics.jit import formula
from tracked_env.physics.rigid_body import incline_of
from tracked_env.physics.terramechanics import slip_ratio, track_speed_from_belt

PATIENCE = 5  # [samples] that many outliers in a row are a change
EXCITED = 1.0  # [-] excitation from which on the data determine slips and side slip
TRACK_ACCELERATION = 8.0  # [m/s^2] of a track over the ground; what a belt does beyond is slip
LOST_DIGITS = 1e-6  # [SI] least variance after rounding has spoilt the covariance
FASTEST_BELT = 100.0  # [m/s] a belt beyond it is a fault of the sensor, as NaN is
OLDEST = 10.0  # [s] an older sample counts as that old
LARGEST_READING = 1e9  # [SI] anything beyond is a fault of the sensor, as NaN is
NONE = (0.0, 0.0)  # no way
GOOD, OUTLIER, CHANGE = range(3)  # verdicts on an innovation

_SPEED_L, _SPEED_R = COLUMN["sprocket_speed_left"], COLUMN["sprocket_speed_right"]
_YAW_RATE = COLUMN["yaw_rate"]


class Sensed(NamedTuple):
    """The sample of one vehicle."""

    values: Any  # (CHANNELS,)
    fresh: Any  # (3,)
    age: Any  # (3,) [s]
    attitude: Any  # (3,) roll, pitch, rate of pitch


@formula
def _usable(reading):
    """False for NaN, infinity and nonsense."""
    return abs(reading) < LARGEST_READING


@formula
def _jumps(last, belt, steps, k):
    """Whether a belt went from `last` to `belt` [m/s] faster than its track can in these steps."""
    follows = TRACK_ACCELERATION * k.period * steps
    return abs(belt - last) > follows + kinematics.BELT_SIGMAS * math.sqrt(k.belt_variance)


@formula
def _slip_of_jump(row, side, belt, k):
    """Slip of a track, 0 left, 1 right, whose belt goes to `belt` [m/s]. The track over the ground
    follows by TRACK_ACCELERATION at most. Returns the belt that with the new slip makes the speed
    of before."""
    last, steps, state = row.belt[side], row.stale[side], SLIP_LEFT + side
    follows = TRACK_ACCELERATION * k.period * steps
    if _jumps(last, belt, steps, k):
        slip = row.state[state]
        before = track_speed_from_belt(last, slip)
        speed = before + signed(follows, belt - last)
        jumped = min(max(slip_ratio(belt, speed), -SLIP_LIMIT), SLIP_LIMIT)
        row.covariance[state, state] += min((jumped - slip) ** 2, kinematics.SLIP_VARIANCE)
        row.state[state] = jumped
        last = outage.belt_of(before, jumped)
    return last


@formula
def take_drive(row, sample, k):
    """Inputs of this step; the row holds the belt speeds from then on."""
    belts, pitch_rate = row.belt, sample.attitude[2]
    before = last = (belts[0], belts[1])
    left, right = k.radius * sample.values[_SPEED_L], k.radius * sample.values[_SPEED_R]
    row.stale[0] += 1.0
    row.stale[1] += 1.0
    valid_left, valid_right = abs(left) < FASTEST_BELT, abs(right) < FASTEST_BELT
    jumps = valid_left and _jumps(last[0], left, row.stale[0], k)
    jumps = jumps or (valid_right and _jumps(last[1], right, row.stale[1], k))
    learns = row.started > 0.0 and k.rows >= kinematics.ROWS
    if jumps and learns and not sample.fresh[POSE]:
        row.silent = max(row.silent, k.silence)  # an outage begins with this step
    if row.silent < k.silence:
        last_left = _slip_of_jump(row, 0, left, k) if valid_left else last[0]
        last = (last_left, _slip_of_jump(row, 1, right, k) if valid_right else last[1])
    for side in range(2):
        belt = left if side == 0 else right
        if abs(belt) < FASTEST_BELT:
            belts[side] = belt
            row.stale[side] = 0.0 if sample.fresh[DRIVE] else row.stale[side]
    if not (valid_left and valid_right):
        row.skipped += 1.0
    incline, common = incline_of(sample.attitude[1], sample.attitude[0]), -1.0
    if row.started > 0.0:
        common, last, now = outage.carry(row, last, sample.values, incline, pitch_rate, k)
        if common >= 0.0:
            belts[0], belts[1] = now
            before = last
    now = (belts[0], belts[1])
    return kinematics.make_inputs(before, now, row.state, incline, pitch_rate, common, k)


@formula
def _steps(age, k):
    """Whole control steps in `age` [s]; 0 for what is not a positive number."""
    return math.floor(min(age, OLDEST) / k.period + 0.5) if age > 0.0 else 0.0


@formula
def _moment(way, sums, k):
    """A Way with these sums, belt speeds of the start of `way`, and what serves as their
    instruments."""
    d, c, s = sums
    instruments = (
        kinematics.instrument(way.instrument[0], way.belt[0], k),
        kinematics.instrument(way.instrument[1], way.belt[1], k),
    )
    return Way(d, c, s, way.belt, instruments)


@formula
def _expected(row, u, way, gyro, k):
    """z by the model."""
    x = row.state
    return kinematics.measured((x[0], x[1], x[2], x[3], x[4], x[5]), u, way, gyro, k)


@formula
def take_pose(row, ring, sample, u, k, out):
    """Sample into z (ROWS,), its R into noise (ROWS, ROWS), the two of `out`. Returns (the way
    since it was taken, belt speeds when the gyro's was taken). Velocities that are missing, and a
    gyro without a new sample, are replaced by the model's with a huge variance. The drive's own
    delay counts: its latest belt speed is one of `age` ago."""
    values, (z, noise) = sample.values, out
    if outage.silent(row, k):
        outage.add_shown(row, 1.0, k)
    drive, pose = _steps(sample.age[DRIVE], k), _steps(sample.age[POSE], k)
    outage.compare_inertial(row, values[3], values[2], pose * k.period, values, k)
    sums = kinematics.since(row, ring, pose)
    way = _moment(kinematics.since(row, ring, pose - drive), (sums.d, sums.c, sums.s), k)
    inertial = _steps(sample.age[INERTIAL], k)
    gyro = _moment(kinematics.since(row, ring, inertial - drive), (NONE, NONE, NONE), k)
    kinematics.fill_measurement_noise(noise, u, way, gyro, pose, k)
    expected = _expected(row, u, way, gyro, k)
    z[0], z[1] = values[0], values[1]
    z[2] = expected[2] + wrap_angle(values[2] - expected[2])
    z[3], z[4], z[5] = values[3], values[4], values[_YAW_RATE]
    missing = False
    for r in range(3, int(k.rows)):
        new = r < 5 or sample.fresh[INERTIAL]
        missing = missing or (new and not _usable(z[r]))
        if not (new and _usable(z[r])):
            z[r] = expected[r]
            noise[r, :] = 0.0
            noise[:, r] = 0.0
            noise[r, r] = kinematics.IGNORED
    if missing:
        row.skipped += 1.0
    return way, gyro


@formula
def take_motion(row, sample, u, k, out):
    """In an outage: what gyro, effort and friction say into z (ROWS,), its R into noise, as
    `take_pose`. Returns (no way, present belt speeds)."""
    belts = (row.belt[0], row.belt[1])
    row.outliers = 0.0
    now = Way(NONE, NONE, NONE, belts, belts)
    outage.measure(row, sample, _expected(row, u, now, now, k), u.press, k, out)
    return now, now


@formula
def has_pose(sample):
    """Whether the pose of a sample can be used."""
    return _usable(sample.values[0]) and _usable(sample.values[1]) and _usable(sample.values[2])


@formula
def start(row, sensors, out, way, k):
    """Pose and inertial speed from the first sample, as uncertain as the sensor is and as far as it
    is old; out: z and R. The slips stay open: drives change them at once, but not the speed."""
    x, p, (z, noise) = row.state, row.covariance, out
    distance = max(abs(way.d[0]), abs(way.d[1]))
    for a in range(3):
        x[a] = z[a]
        p[a, :] = 0.0
        p[:, a] = 0.0
        p[a, a] = noise[a, a] + (distance * distance if a < kinematics.YAW else 0.0)
    row.started = 1.0
    v, variance = (
        0.5 * (way.belt[0] + way.belt[1]),
        kinematics.STANDING_VEHICLE * kinematics.STANDING_VEHICLE,
    )
    variance = max(kinematics.SLIP_VARIANCE * v * v, variance)
    if k.rows >= kinematics.ROWS and noise[3, 3] < variance:
        v, variance = z[3], noise[3, 3]
    outage.start(row, sensors, v, variance, k)


@formula
def innovation_verdict(row, nis, k):
    """GOOD, OUTLIER, or CHANGE: one outlier too many, which is followed, as the first pose after an
    outage is."""
    if outage.silent(row, k):
        return CHANGE if nis > k.gate else GOOD
    if nis <= k.gate:
        row.outliers = 0.0
        return GOOD
    row.outliers += 1.0
    if row.outliers < PATIENCE:
        return OUTLIER
    row.outliers = 0.0
    return CHANGE


@formula
def finish(row, root, u, used, k):
    """Bounds; root (STATES, STATES) is scratch; used: a pose was. Returns (excitation, condition,
    status where nothing is refused)."""
    x, p = row.state, row.covariance
    x[SLIP_LEFT] = min(max(x[SLIP_LEFT], -SLIP_LIMIT), SLIP_LIMIT)
    x[SLIP_RIGHT] = min(max(x[SLIP_RIGHT], -SLIP_LIMIT), SLIP_LIMIT)
    x[SIDE_SLIP] = min(max(x[SIDE_SLIP], -kinematics.SIDE_SLIP_LIMIT), kinematics.SIDE_SLIP_LIMIT)
    kinematics.bound(p)
    if not kinematics.factorise(p, root, kinematics.STATES, 1.0):
        # Rounding has used up the digits, after nonsense: keep the variances, drop the rest.
        for a in range(kinematics.STATES):
            variance = min(max(p[a, a], LOST_DIGITS), kinematics.largest_variance(a))
            p[a, :] = 0.0
            p[:, a] = 0.0
            p[a, a] = variance
    if row.started > 0.0:
        outage.settle(row, used, k)
    smallest, largest = kinematics.information(p)
    moves = min(min(u.fade[0], u.fade[1]), u.fade_side) > 0.0
    learns = used and moves and smallest >= EXCITED
    condition = largest / smallest if smallest > 1e-9 else math.inf
    return smallest, condition, CONVERGING if learns else HOLDING
