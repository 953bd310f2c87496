"""What a policy sees that is never told its vehicle: FEATURES, among them an action to begin with.

Everything is in units that the vehicle itself shows: torques as shares of what a command of 1 gave
of late, belts by the effective radius of `kinematic_filter`. With the shares f_L, f_R of the
drives, V the speed of a track and sat(x) = x / (|x| + 1) two regressions say how it answers,
    f_L + f_R = a_x / alpha + rho [sat(V_L / V_0) + sat(V_R / V_0)]
    f_R - f_L = dw/dt / gamma + tau sat(w / W_0) + rho [sat(V_R / V_0) - sat(V_L / V_0)]
by least squares that forget within MEMORY, around a wide prior. The action to begin with is what
they ask for accelerations of the reference and of its errors. A data sheet
of the vehicle may be shown too, right or wrong, or zeros in its place.

Commands of speeds (`Drive.by_speed`) give belt speeds, shares of what a command of 1 gave of late.
In place of the regressions is shown how the filter says that belts slip. The action to begin with
is then
    r w_L,R = v + K (e_x, h a) -+ (B / 2) [w + K (e_yaw, v e_y, h dw/dt)]
with h the lag of the drives and the gauge B, in which slip is, that belts and gyro show. Belts may
turn before the first command: what is left of their first speed after t is exp(-t / h) of it, and
what a command of 1 gives is found from the rest.

`VehicleFeatures.action` adds to the network what it leaves: an integral of the error ahead and, by
torque, feedback of the lateral error (LATERAL_GAINS).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.batch_policy import Array, Bools, Floats
from baselines.estimators.measurement import (
    COLUMN,
    DRIVE,
    INERTIAL,
    POSE,
    DataSheet,
    Rows,
    Stateful,
    columns_of,
)
from baselines.estimators.observation_reader import NEEDS, ObservationReader
from baselines.learned import kinematic_filter as kinematic
from baselines.learned.kinematic_filter import MOVED, Noise
from tracked_env import observation as layout
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import BoundOnce, formula, loop
from tracked_env.physics.parameters import PlantParameters

MEMORY = 1.5  # [s] of the regressions
TORQUE_MEMORY, SPEED_MEMORY = 0.5, 5.0  # [s] of what a command of 1 gives
LAGS = (0.02, 0.04, 0.07, 0.12, 0.2)  # [s] of drives, of which the one that fits best is taken
USUAL_LAG = 2  # its place, before any torque
SLOW_TRACK, SLOW_TURN = 0.1, 0.05  # [m/s, rad/s] V_0 and W_0
SLOW_COURSE = 0.5  # [m/s] below which the course says less
# Means and deviations before any sample: 1 / alpha [s^2/m] and rho, 1 / gamma [s^2/rad] and tau.
ALONG_PRIOR, TURNING_PRIOR = (0.2, 0.1, 0.15, 0.1), (0.3, 0.2, 0.4, 0.25)
NOISE = 0.03  # [-] of a share, with what the two equations leave out
GAINS = (6.0, 9.0, 8.0, 16.0, 8.0)  # [1/s, 1/s^2, 1/s, 1/s^2, 1/m s] on v, x, w, yaw and v y
SPEED_GAINS = (2.0, 2.0, 1.5)  # [1/s, 1/s, -] on x, yaw, and on v y over half the gauge
TOLD = ("contact_length", "track_gauge", "sprocket_radius", "mass", "inertia", "torque_limit")
SHOWN_AS_ZERO = (2.0, 1.6, 0.25, 2000.0, 2000.0, 5000.0)  # of TOLD
SHEET = ("position_noise", "yaw_noise", "velocity_noise", "gyro_bias")
SHEET_AS_ZERO = (0.02, 0.005, 0.03, 0.001)
BOUND = 8.0  # [-] features are clipped to
# Integral action: gain [1/s^3] on what is ahead, what is integrated at most [m] and for how long it
# is remembered [s].
STEADY, LARGEST_OFFSET, OFFSET_MEMORY = 15.0, 0.05, 6.0
# Feedback of the lateral error beside the network, by torque: gains [1/s, 1/s^2, 1/m s] on w, the
# course and v y, which fade beyond an error [m], and the last one beyond a speed [m/s].
LATERAL_GAINS, NEAR, FAST = (3.0, 6.0, 2.0), 0.3, 3.0
STIFFEST = 0.9  # [1/s] of v times the gain on v y, times the lag: beyond SPEED_GAINS[1] it swings
SPEED_REACH = 0.3  # [-] of half the gauge, [rad]: errors that gains of speeds see at most
LARGEST_UNIT = 0.2  # [-]
STEADY_SPEED = 1.0  # [1/s^2] that gain of speeds

ROW = np.dtype([
    *kinematic.ROW,
    # commands behind each of LAGS, and sums of the torques that they give: yu, uu and yy
    ("commanded", float, (2, len(LAGS))), ("given", float, (2, len(LAGS), 3)),
    ("rolling", float, (2, len(LAGS))),  # what is left of the first speeds
    ("along", float, 5), ("turning", float, 5), ("gauge", float, 2),  # sums of regressions
    ("offset", float),  # [m s] integral of what is ahead
    ("radius", float, 2),  # sums of the regression of v_x on turns, by speed
])  # fmt: skip


class Drive(NamedTuple):
    """What commands of a drive give."""

    column: int  # of the left one in samples
    usual: float  # [SI] what a command of 1 gives before any sample, as if ...
    certain: float  # [-] ... by commands of so much, squared and summed
    shown_as_zero: float  # [SI] of what a command of 1 gives
    keep: float  # [s] how long that is remembered
    unit: float  # what an output of 1 of the network adds: [-], by speed [1/s] of the gauge
    most: float  # outputs are clipped to
    by_speed: bool


DRIVES = {
    "torque": Drive(COLUMN["torque_left"], 0.0, 0.0, 3000.0, TORQUE_MEMORY, 1.0, np.inf, False),
    "speed": Drive(COLUMN["sprocket_speed_left"], 30.0, 1e-4, 10.0, SPEED_MEMORY, 0.05, 3.0, True),
}
_AHEAD = ("0.25", "0.5", "1", "2")
# How the vehicle answers, and by speed how its belts slip
_ANSWERS = (
    *("alpha", "rho", "gamma", "tau", "alpha_deviation", "rho_deviation"),
    *("gamma_deviation", "tau_deviation", "along_left", "turning_left"),
)
_SLIPS = (
    *("turning_slip", "changing_slip", "pulling_slip", "straight_radius", "turning_slip_deviation"),
    *("changing_slip_deviation", "pulling_slip_deviation", "straight_radius_deviation"),
    *("slip_ahead", "missing_yaw_rate"),
)
FEATURES = (
    *("error_x", "error_y", "error_yaw", "large_error_x", "large_error_y", "large_error_yaw"),
    *("speed_error", "yaw_rate_error", "v_x", "v_y", "yaw_rate", "side_slip"),
    *("reference_speed", "reference_acceleration", "reference_jerk", "reference_yaw_rate"),
    *("reference_yaw_acceleration", "centripetal"),
    *(f"speed_change_{t}" for t in _AHEAD), *(f"yaw_rate_change_{t}" for t in _AHEAD),
    *("acceleration_x", "acceleration_y", "yaw_acceleration"),
    *("share_left", "share_right", "command_left", "command_right"),
    *("log_torque", "torque_left_to_right", "lag"),
    *("log_radius", "log_gauge", "side", "slip_left", "slip_right"),
    *_ANSWERS,
    *("begin_left", "begin_right"),
    *("position_deviation", "yaw_deviation", "speed_deviation"),
    *("missed_x", "missed_y", "missed_yaw", "missed_v_x", "missed_v_y"),
    *("pose_is_new", "inertial_is_new", "drive_is_new", "pose_age", "drive_age", "time"),
    *(f"sheet_{name}" for name in SHEET), "is_told", *(f"told_{name}" for name in TOLD),
)  # fmt: skip
FEATURES_BY_SPEED = tuple(dict(zip(_ANSWERS, _SLIPS, strict=True)).get(n, n) for n in FEATURES)
_SLIP = FEATURES.index("alpha")
_I, _SCALE = layout.INDEX, layout.SCALE
_V, _A, _J = (_I[f"reference_{name}"] for name in ("speed", "acceleration", "jerk"))
_W, _BEND = _I["reference_yaw_rate"], _I["reference_yaw_acceleration"]
_V_AHEAD, _W_AHEAD = (_I[f"reference_{name}_ahead_0.25"] for name in ("speed", "yaw_rate"))
_COMMAND = _I["previous_action_left"]
_TIMES = np.array([float(t) for t in _AHEAD])
_ACROSS, _BENDING = COLUMN["acceleration_y"], COLUMN["yaw_acceleration"]
_SPROCKET = COLUMN["sprocket_speed_left"]
READS = (
    *NEEDS, "reference_jerk", "previous_action_left", "previous_action_right",
    *(f"reference_speed_ahead_{t}" for t in _AHEAD),
    *(f"reference_yaw_rate_ahead_{t}" for t in _AHEAD),
)  # fmt: skip


@formula
def _log(x):
    """A number of any size: x near 0, a logarithm far from it."""
    return math.copysign(math.log(1.0 + abs(x)), x)


@formula
def _sat(x):
    return x / (abs(x) + 1.0)


@formula
def _add(sums, keep, p, q, y):
    """A sample y = a p + b q into the sums of a regression."""
    weight = 1.0 / (NOISE * NOISE)
    sums[0] = keep * sums[0] + weight * p * p
    sums[1] = keep * sums[1] + weight * p * q
    sums[2] = keep * sums[2] + weight * q * q
    sums[3] = keep * sums[3] + weight * p * y
    sums[4] = keep * sums[4] + weight * q * y


@formula
def _solve(sums, prior, excess):
    """(a, b) and their deviations, around a prior; `excess` steps are worth one."""
    i_a, i_b = 1.0 / (prior[2] * prior[2]), 1.0 / (prior[3] * prior[3])
    m_aa, m_ab, m_bb = i_a + sums[0] / excess, sums[1] / excess, i_b + sums[2] / excess
    y_a, y_b = i_a * prior[0] + sums[3] / excess, i_b * prior[1] + sums[4] / excess
    inverse = 1.0 / (m_aa * m_bb - m_ab * m_ab)
    a, b = inverse * (m_bb * y_a - m_ab * y_b), inverse * (m_aa * y_b - m_ab * y_a)
    return a, b, math.sqrt(m_bb * inverse), math.sqrt(m_aa * inverse)


@loop
def look(observation, samples, reference, rows, misses, sheet, told, k, drive, features, actions):
    """Features (N, F) and actions (3, N, 2) out, after `navigate`: to begin with, of the integral,
    and what an output of 1 of the network adds.

    drive: one of DRIVES; by speed the integral is beside the action to begin with. observation
    (N, >= SIZE); samples: values, fresh and age of the latest ones; reference (N, 3) its pose;
    sheet (4,) of the sensors as shown; told (N, 1 + TOLD). Rows that begin are zeros but for what
    `navigate` has put there.
    """
    values, fresh, age = samples
    keep, given_keep = math.exp(-k.period / MEMORY), math.exp(-k.period / drive.keep)
    slow_keep = math.exp(-k.period / kinematic.GAUGE_MEMORY)
    lags = 1.0 - np.exp(-k.period / np.array(LAGS))
    excess = 0.1 / k.period
    begin, steady, unit = actions[0], actions[1], actions[2]
    for i in range(observation.shape[0]):
        row, sample, o, f, miss = rows[i], values[i], observation[i], features[i], misses[i]
        z, p = row.mean, row.covariance
        cosine, sine = rotation(z[2])
        e_x, e_y = reference[i, 0] - z[0], reference[i, 1] - z[1]
        e_x, e_y = cosine * e_x + sine * e_y, cosine * e_y - sine * e_x
        e_yaw = wrap_angle(reference[i, 2] - z[2])
        v_x, v_y, w = z[3], z[4], row.felt[2] - z[7]
        a_x = row.felt[0] - z[5]
        v, a, turn = o[_V] * _SCALE[_V], o[_A] * _SCALE[_A], o[_W] * _SCALE[_W]
        jerk, bend = o[_J] * _SCALE[_J], o[_BEND] * _SCALE[_BEND]
        felt_bend = sample[_BENDING] if math.isfinite(sample[_BENDING]) else 0.0

        # Shares of what a command of 1 gives, by the lag that fits them best.
        for side in range(2):
            command = o[_COMMAND + side] * _SCALE[_COMMAND + side]
            measured = sample[drive.column + side]
            for j in range(lags.size):
                u = row.commanded[side, j]
                u += lags[j] * (command - u)
                row.commanded[side, j] = u
                row.rolling[side, j] -= lags[j] * row.rolling[side, j]
                if fresh[i, DRIVE] and math.isfinite(measured):
                    if drive.by_speed and row.step < 1.5:
                        row.rolling[side, j] = measured
                    # The shortest lag stands for drives that answer within a step.
                    due = measured - (row.rolling[side, j] if j > 0 or row.step < 1.5 else 0.0)
                    given = row.given[side, j]
                    given[0] = given_keep * given[0] + due * u
                    given[1] = given_keep * given[1] + u * u
                    given[2] = given_keep * given[2] + due * due
        best, least = USUAL_LAG, 1e300
        for j in range(lags.size):
            left, right = row.given[0, j], row.given[1, j]
            missed = left[2] - left[0] * left[0] / max(left[1], 1e-9)
            missed += right[2] - right[0] * right[0] / max(right[1], 1e-9)
            answers = not drive.by_speed or min(left[0], right[0]) > 0.0
            if left[1] > 1e-3 and right[1] > 1e-3 and answers and missed < least:
                best, least = j, missed
        left, right = row.given[0, best], row.given[1, best]
        known = least < 1e300
        first = 2.0 * (abs(row.rolling[0, best]) + abs(row.rolling[1, best]))
        prior = drive.certain * max(drive.usual, first)
        weight = 0.0 if drive.by_speed and not known else 1.0
        left_per = (weight * left[0] + prior) / max(weight * left[1] + drive.certain, 1e-9)
        right_per = (weight * right[0] + prior) / max(weight * right[1] + drive.certain, 1e-9)
        left_per, right_per = max(left_per, 1e-6), max(right_per, 1e-6)
        given_by_one, even, log_given = 0.5 * (left_per + right_per), 0.0, 0.0
        if known:
            log_given = math.log(given_by_one / drive.shown_as_zero)
        s_l, s_r = row.commanded[0, best], row.commanded[1, best]
        if known and math.isfinite(sample[drive.column] + sample[drive.column + 1]):
            s_l = min(max(sample[drive.column] / given_by_one, -2.0), 2.0)
            s_r = min(max(sample[drive.column + 1] / given_by_one, -2.0), 2.0)
            even = math.log(left_per / right_per)

        # Belts, and the gauge that they seem to have.
        radius = math.exp(z[8])
        turns_l, turns_r = sample[_SPROCKET], sample[_SPROCKET + 1]
        if not math.isfinite(turns_l + turns_r):
            turns_l = turns_r = 0.0
        log_radius = z[8]
        if drive.by_speed:  # the filter's is as slow as its belts are thought to slip
            both = 0.5 * (turns_l + turns_r)
            row.radius[0] = slow_keep * row.radius[0] + both * v_x
            row.radius[1] = slow_keep * row.radius[1] + both * both
            prior = 0.05 * kinematic.USUAL_RADIUS
            radius = (row.radius[0] + prior) / (row.radius[1] + 0.05)
            radius = min(max(radius, 0.01), 2.7)
            log_radius = math.log(radius)
        belt_l, belt_r = radius * turns_l, radius * turns_r
        row.gauge[0] = slow_keep * row.gauge[0] + (belt_r - belt_l) * w
        row.gauge[1] = slow_keep * row.gauge[1] + w * w
        gauge = (row.gauge[0] + 0.05 * 6.0 * radius) / (row.gauge[1] + 0.05)
        half = 0.5 * min(max(gauge, 0.1), 12.0)
        v_l, v_r = v_x - half * w, v_x + half * w

        # How the vehicle answers.
        on_l, on_r = _sat(v_l / SLOW_TRACK), _sat(v_r / SLOW_TRACK)
        turned = _sat(w / SLOW_TURN)
        fresh_both = fresh[i, INERTIAL] and fresh[i, DRIVE] and row.step > 1.5  # not the first
        fresh_both = fresh_both and not drive.by_speed
        if fresh_both:
            _add(row.along, keep, a_x, on_l + on_r, s_l + s_r)
        per_a, rho, per_a_spread, rho_spread = _solve(row.along, ALONG_PRIOR, excess)
        per_a, rho = min(max(per_a, 0.02), 1.5), min(max(rho, 0.0), 0.6)
        if fresh_both:
            _add(row.turning, keep, felt_bend, turned, s_r - s_l - rho * (on_r - on_l))
        per_b, tau, per_b_spread, tau_spread = _solve(row.turning, TURNING_PRIOR, excess)
        per_b, tau = min(max(per_b, 0.01), 4.0), min(max(tau, 0.0), 1.5)

        # The action to begin with.
        ahead = v * math.cos(e_yaw)
        wanted = a + GAINS[0] * (ahead - v_x) + GAINS[1] * e_x + LAGS[best] * jerk
        bent = bend + GAINS[2] * (turn - w) + GAINS[3] * e_yaw + GAINS[4] * v * e_y
        goes_l, goes_r = _sat((v - half * turn) / SLOW_TRACK), _sat((v + half * turn) / SLOW_TRACK)
        both = per_a * wanted + rho * (goes_l + goes_r)
        apart = per_b * bent + tau * _sat(turn / SLOW_TURN) + rho * (goes_r - goes_l)
        weak_l, weak_r = math.exp(-0.5 * even), math.exp(0.5 * even)
        begin[i, 0] = min(max(0.5 * (both - apart) * weak_l, -1.0), 1.0)
        begin[i, 1] = min(max(0.5 * (both + apart) * weak_r, -1.0), 1.0)

        # Integral action against what the network leaves ahead.
        grow = min(max(e_x, -LARGEST_OFFSET), LARGEST_OFFSET) - row.offset / OFFSET_MEMORY
        row.offset += k.period * grow
        if drive.by_speed:
            reach = SPEED_REACH * half
            near_x, near_y = min(max(e_x, -reach), reach), min(max(e_y, -reach), reach)
            near_yaw = min(max(e_yaw, -SPEED_REACH), SPEED_REACH)
            toward = ahead + SPEED_GAINS[0] * near_x + LAGS[best] * a
            stiff = max(1.0, SPEED_GAINS[2] * v * v / half * LAGS[best] / STIFFEST)
            aside = SPEED_GAINS[1] * near_yaw + SPEED_GAINS[2] * v * near_y / (half * stiff)
            around = half * (turn + aside + LAGS[best] * bend)
            begin[i, 0] = min(max((toward - around) / (radius * left_per), -1.0), 1.0)
            begin[i, 1] = min(max((toward + around) / (radius * right_per), -1.0), 1.0)
            integral = STEADY_SPEED * row.offset / radius
            steady[i, 0] = begin[i, 0] + integral / left_per
            steady[i, 1] = begin[i, 1] + integral / right_per
            unit[i, 0] = min(drive.unit * 2.0 * half / (radius * left_per), LARGEST_UNIT)
            unit[i, 1] = min(drive.unit * 2.0 * half / (radius * right_per), LARGEST_UNIT)
        else:
            unit[i, 0] = unit[i, 1] = drive.unit
            slow, fast = SLOW_COURSE * SLOW_COURSE, v * v / (FAST * FAST)
            course = v * (v * math.sin(e_yaw) - v_y) / (v * v + slow)
            lateral = LATERAL_GAINS[0] * (turn - w) + LATERAL_GAINS[1] * course
            lateral += LATERAL_GAINS[2] * v * e_y / (1.0 + fast * fast)
            lateral *= per_b / (1.0 + (e_x * e_x + e_y * e_y) / (NEAR * NEAR))
            integral = per_a * STEADY * row.offset
            steady[i, 0] = 0.5 * (integral - lateral) * weak_l
            steady[i, 1] = 0.5 * (integral + lateral) * weak_r

        c = 0
        for value in (
            _log(50.0 * e_x), _log(50.0 * e_y), _log(100.0 * e_yaw),
            _log(3.0 * e_x), _log(3.0 * e_y), 2.0 * e_yaw,
            _log(20.0 * (ahead - v_x)), _log(40.0 * (turn - w)), _log(2.0 * v_x), _log(20.0 * v_y),
            _log(4.0 * w), _log(20.0 * (v_y + z[9] * w)),
            _log(2.0 * v), _log(2.0 * a), _log(jerk), _log(4.0 * turn), _log(4.0 * bend),
            _log(2.0 * v_x * w),
        ):  # fmt: skip
            f[c] = value
            c += 1
        for j in range(4):
            f[c + j] = _log(2.0 * (o[_V_AHEAD + j] * _SCALE[_V_AHEAD + j] - v) / _TIMES[j])
            change = (o[_W_AHEAD + j] * _SCALE[_W_AHEAD + j] - turn) / _TIMES[j]
            f[c + 4 + j] = _log(4.0 * change)
        c += 8
        for value in (
            _log(2.0 * a_x), _log(2.0 * row.felt[1]), _log(4.0 * felt_bend),
            2.0 * s_l, 2.0 * s_r, 2.0 * o[_COMMAND], 2.0 * o[_COMMAND + 1],
            log_given / 3.0, 3.0 * even, 0.5 * best - 1.0,
            log_radius + 1.4, math.log(half / 0.8), _log(5.0 * z[9]),
            _log(20.0 * (belt_l - v_l)), _log(20.0 * (belt_r - v_r)),
        ):  # fmt: skip
            f[c] = value
            c += 1
        for value in (
            math.log(5.0 * per_a), _log(8.0 * rho), math.log(4.0 * per_b), _log(4.0 * tau),
            math.log(10.0 * per_a_spread), math.log(20.0 * rho_spread),
            math.log(10.0 * per_b_spread), math.log(20.0 * tau_spread),
            _log(20.0 * (s_l + s_r - per_a * a_x - rho * (on_l + on_r))),
            _log(20.0 * (s_r - s_l - per_b * felt_bend - tau * turned - rho * (on_r - on_l))),
            2.0 * begin[i, 0], 2.0 * begin[i, 1],
        ):  # fmt: skip
            f[c] = value
            c += 1
        if drive.by_speed:
            straight = math.exp(z[8])
            slip = kinematic.TURNING  # the first of three
            f[_SLIP], f[_SLIP + 1], f[_SLIP + 2] = 10.0 * z[slip], z[slip + 1], 50.0 * z[slip + 2]
            f[_SLIP + 3] = 10.0 * (z[8] - log_radius)
            for j in range(3):
                f[_SLIP + 4 + j] = 0.5 * math.log(1e-9 + p[slip + j, slip + j]) + 2.0
            f[_SLIP + 7] = 0.5 * math.log(p[8, 8]) + 4.0
            f[_SLIP + 8] = _log(20.0 * (0.5 * straight * (turns_l + turns_r) - v_x))
            missing = straight * kinematic.missing_turn(row, turns_r - turns_l, w)
            f[_SLIP + 9] = _log(20.0 * missing)
        for value in (
            0.25 * math.log((p[0, 0] + p[1, 1]) / 2e-4), 0.25 * math.log(p[2, 2] / 1e-5),
            0.25 * math.log((p[3, 3] + p[4, 4]) / 2e-4),
            miss[0], miss[1], miss[2], miss[3], miss[4],
            1.0 if fresh[i, POSE] else 0.0, 1.0 if fresh[i, INERTIAL] else 0.0,
            1.0 if fresh[i, DRIVE] else 0.0, _log(2.0 * age[i, POSE]), _log(20.0 * age[i, DRIVE]),
            math.exp(-k.period * row.step),
        ):  # fmt: skip
            f[c] = value
            c += 1
        for j in range(sheet.shape[0]):
            f[c + j] = sheet[j]
        c += sheet.shape[0]
        for j in range(told.shape[1]):
            f[c + j] = told[i, j]
        for j in range(f.shape[0]):
            f[j] = min(max(f[j], -BOUND), BOUND) if math.isfinite(f[j]) else 0.0


def told_of(vehicles: Sequence[PlantParameters]) -> Array:
    """What data sheets say, (N, 1 + TOLD), as it is shown."""
    values = np.array([[getattr(p, name) for name in TOLD] for p in vehicles])
    logarithms = np.log(values / np.array(SHOWN_AS_ZERO))
    return np.concatenate([np.ones((len(values), 1)), logarithms / 2.0], axis=1)


class VehicleFeatures(Stateful):
    """Filter and features of `count` vehicles; its state is `memory`, `ring` and the reader's."""

    rows = Rows("memory", ROW)

    def __init__(
        self, control_period: float, sheet: DataSheet, count: int, drive: str = "torque"
    ) -> None:
        self.drive = DRIVES[drive]
        self.noise = Noise.of(sheet, control_period, self.drive.by_speed)
        self.reader = ObservationReader(control_period, count, sheet.pose_delay)
        slots = round(kinematic.OLDEST / control_period) + 2
        self.memory = np.zeros((count, columns_of(ROW)))
        self.ring = np.zeros((count, slots * MOVED))
        self.told = np.zeros((count, 1 + len(TOLD)))
        self.features = np.zeros((count, len(FEATURES)), dtype=np.float32)
        self._actions = np.zeros((3, count, 2))
        self._misses = np.zeros((count, MOVED))
        shown = np.array([getattr(sheet, name) for name in SHEET]) / np.array(SHEET_AS_ZERO)
        self._sheet = np.clip(np.log10(np.maximum(shown, 1e-3)), -3.0, 3.0)
        self._navigate, self._look = BoundOnce(kinematic.navigate), BoundOnce(look)

    def see(self, observation: Floats, start: Bools) -> Floats:
        """Features (N, F) of observations (N, >= SIZE); rows with `start` begin an episode."""
        self.reset(start)
        reading = self.reader.read(observation, start)
        samples = reading.latest.values, reading.latest.fresh, reading.latest.age
        rings = self.ring.reshape(len(self.ring), -1, MOVED)
        self._navigate(*samples, self.rows, rings, self.noise, self._misses)
        self._look(
            observation, samples, reading.reference, self.rows, self._misses, self._sheet,
            self.told, self.noise, self.drive, self.features, self._actions,
        )  # fmt: skip
        return self.features

    @property
    def begin(self) -> Array:
        """The actions to begin with, (N, 2)."""
        return self._actions[0]

    @property
    def steady(self) -> Array:
        """What is added to what the network says, (N, 2)."""
        return self._actions[1]

    @property
    def unit(self) -> Array:
        """What an output of 1 of the network adds, (N, 2)."""
        return self._actions[2]

    def action(self, outputs: Floats) -> Array:
        """Actions (N, 2), of any size, for what the network says of what was seen last."""
        most = self.drive.most
        return self.unit * np.clip(outputs, -most, most) + self.steady

    @property
    def parts(self) -> tuple[Any, ...]:
        """What holds a state: this object and its reader."""
        return self, self.reader
