"""The motion of a vehicle of which nothing is known: a Kalman filter without a model of it.

State z = (x, y, yaw, v_x, v_y, b_x, b_y, b_w, ln r, d, i, q, s): pose in the frame of the samples,
velocity in body axes, biases of accelerometers and gyro, effective radius of the sprockets, how far
behind the middle the vehicle turns, and how belts slip. Means of the last two samples drive it,
a = f - b and w = g - b_w, with c, s = cos, sin(yaw + h w / 2) and h the control period (inertial
navigation):
    x' = x + h (v_x c - v_y s),     y' = y + h (v_x s + v_y c),     yaw' = yaw + h w
    v_x' = v_x + h (a_x + w v_y),   v_y' = v_y + h (a_y - w v_x)
Fresh poses and velocities correct it, a late one by what was filtered at its time, and in every
step two rough rules, which hold the motion where there is no pose:
    v_x = r (w_L + w_R) / 2 + i D + q S (r (w_R - w_L) - B w) + s a_x         the belts
    v_y + d w = 0                                       the vehicle does not move sideways
    D = r (|w_R| - |w_L|) sign(w_R - w_L),     S = (|w_R| - |w_L|) / (|w_R| + |w_L|)
with the gauge B that belts and gyro showed of late. Where drives force speeds on the belts, a turn
takes forces: the outer belt slips ahead and the inner one back, on like ground by the same share of
their speeds. v_x loses half the difference: i is half that share of late, negative, and the gyro
shows how it changes, q = -1/2. What accelerates slips, too. By torque i, q and s are 0.
What misses by more than HUBER standard deviations moves the state no further than that [1]: a
filter that was sure of the wrong motion finds back. Belts that miss by more than WILD move it less
the more they miss: they spin. Covariances are those of the linearised equations (extended Kalman
filter), measurements are taken one by one. The ground is level.

References: [1] Huber, Annals of Mathematical Statistics 35 (1964) 73.
"""

import math
from typing import NamedTuple

import numpy as np

from baselines.batch_policy import Array
from baselines.estimators.measurement import COLUMN, DRIVE, INERTIAL, POSE, DataSheet
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, loop

X, Y, YAW, V_X, V_Y, BIAS_X, BIAS_Y, BIAS_W, LOG_RADIUS, SIDE = range(10)
TURNING, CHANGING, PULLING = range(10, 13)
SIZE, MOVED = 13, 5  # numbers of the state; the first of them are the motion, which is remembered
OLDEST = 1.0  # [s] an older pose is not used
WILD, HUBER = 5.0, 10.0  # [-] standard deviations
SIDE_SLIP = (0.02, 0.1)  # [m/s] at rest, and [-] of the speed
SPINNING = 0.3  # [s]
GAUGE_MEMORY = 5.0  # [s]
USUAL_RADIUS, RADIUS_SPREAD, SIDE_SPREAD = 0.25, 1.0, 0.3  # [m], [-], [m] before any sample
BIAS_DRIFT = 1e-3  # [1/sqrt(s)] of the magnitude on the data sheet, and so that no bias is certain
JERK = 2.0  # [m/s^3] and [rad/s^3] of what moves between two samples
LEAST_NOISE = (2e-3, 1e-3, 5e-3)  # [m, rad, m/s] of a pose that claims to be certain
STANDING = 1e-3  # [rad/s] belts that stand
UNSEEN = 1e3  # [m/s] a velocity of this noise is not measured

ROW = [
    ("mean", float, SIZE), ("covariance", float, (SIZE, SIZE)), ("felt", float, 3), ("step", float),
    ("turned", float, 2),  # sums of the regression of w_R - w_L on the yaw rate
]  # fmt: skip
_A_X, _A_Y, _GYRO = COLUMN["acceleration_x"], COLUMN["acceleration_y"], COLUMN["yaw_rate"]
_V_X, _V_Y, _LEFT = COLUMN["v_x"], COLUMN["v_y"], COLUMN["sprocket_speed_left"]


class Rules(NamedTuple):
    """How rough the rules are that hold the motion of a vehicle by its belts.

    Spreads are before any sample, drifts [1/sqrt(s)].
    """

    rest: float = 0.005  # [m/s] of the belts at rest
    share: float = 0.01  # [-] of their speed
    spinning: float = 0.0  # [m/s] of belts that spin at the start, for about SPINNING
    radius_drift: float = 0.001  # of ln r
    side_drift: float = 0.03  # [m] of d
    turning: float = 0.0  # spread [-] of i
    turning_drift: float = 0.0
    changing: float = 0.0  # q [-] before any sample
    changing_spread: float = 0.0
    pulling: float = 0.0  # spread [s] of s
    pulling_drift: float = 0.0


FORCED = Rules(0.005, 0.01, 1.5, 0.001, 0.007, 0.1, 0.01, -0.5, 0.5, 0.01, 0.01)  # belts by speed


class Noise(NamedTuple):
    """What the filter reads of the data sheet."""

    period: float  # [s]
    pose: Array  # (5,) of x, y, yaw, v_x, v_y
    felt: Array  # (2,) of accelerometers and gyro
    bias: Array  # (2,)
    rules: Rules = Rules()

    @classmethod
    def of(cls, sheet: DataSheet, period: float, by_speed: bool = False) -> "Noise":
        """Of a data sheet; by_speed: what drives force on the belts."""
        place, yaw, v = (max(sheet[i], least) for i, least in enumerate(LEAST_NOISE))
        felt = np.array([sheet.acceleration_noise, sheet.gyro_noise])
        bias = np.maximum([sheet.acceleration_bias, sheet.gyro_bias], 1e-4)
        rules = FORCED if by_speed else Rules()
        return cls(float(period), np.array([place, place, yaw, v, v]), felt, bias, rules)


@formula
def _begin(row, values, is_seen, k):
    """State and covariance before the first step."""
    z, p = row.mean, row.covariance
    for i in range(SIZE):
        z[i] = 0.0
        for j in range(SIZE):
            p[i, j] = 0.0
    for i in range(MOVED):
        column = i if i < 3 else _V_X + i - 3
        known = is_seen and math.isfinite(values[column])
        if i >= 3:
            known = known and k.pose[i] < UNSEEN
        z[i] = values[column] if known or (i < 3 and math.isfinite(values[column])) else 0.0
        p[i, i] = k.pose[i] * k.pose[i] if known else 1.0
    z[LOG_RADIUS] = math.log(USUAL_RADIUS)
    p[BIAS_X, BIAS_X] = p[BIAS_Y, BIAS_Y] = k.bias[0] * k.bias[0]
    p[BIAS_W, BIAS_W] = k.bias[1] * k.bias[1]
    p[LOG_RADIUS, LOG_RADIUS] = RADIUS_SPREAD * RADIUS_SPREAD
    p[SIDE, SIDE] = SIDE_SPREAD * SIDE_SPREAD
    z[CHANGING] = k.rules.changing
    p[TURNING, TURNING] = k.rules.turning * k.rules.turning
    p[CHANGING, CHANGING] = k.rules.changing_spread * k.rules.changing_spread
    p[PULLING, PULLING] = k.rules.pulling * k.rules.pulling
    row.felt[0], row.felt[1], row.felt[2] = 0.0, 0.0, 0.0


@loop
def move(z, p, f_x, f_y, gyro, age, k, room):
    """State z and covariance p one period on; age [s] of what is felt, room (MOVED, SIZE)."""
    h = k.period
    w = gyro - z[BIAS_W]
    v_x, v_y = z[V_X], z[V_Y]
    cosine, sine = rotation(z[YAW] + 0.5 * h * w)
    z[X] += h * (v_x * cosine - v_y * sine)
    z[Y] += h * (v_x * sine + v_y * cosine)
    z[YAW] = wrap_angle(z[YAW] + h * w)
    z[V_X] += h * (f_x - z[BIAS_X] + w * v_y)
    z[V_Y] += h * (f_y - z[BIAS_Y] - w * v_x)
    x_yaw, y_yaw = -h * (v_x * sine + v_y * cosine), h * (v_x * cosine - v_y * sine)
    c, s = h * cosine, h * sine
    for j in range(SIZE):
        room[0, j] = x_yaw * p[YAW, j] + c * p[V_X, j] - s * p[V_Y, j]
        room[1, j] = y_yaw * p[YAW, j] + s * p[V_X, j] + c * p[V_Y, j]
        room[2, j] = -h * p[BIAS_W, j]
        room[3, j] = h * (w * p[V_Y, j] - p[BIAS_X, j] - v_y * p[BIAS_W, j])
        room[4, j] = h * (v_x * p[BIAS_W, j] - w * p[V_X, j] - p[BIAS_Y, j])
    for i in range(MOVED):
        for j in range(SIZE):
            p[i, j] += room[i, j]
    for i in range(SIZE):
        by_x = x_yaw * p[i, YAW] + c * p[i, V_X] - s * p[i, V_Y]
        by_y = y_yaw * p[i, YAW] + s * p[i, V_X] + c * p[i, V_Y]
        by_yaw = -h * p[i, BIAS_W]
        by_ahead = h * (w * p[i, V_Y] - p[i, BIAS_X] - v_y * p[i, BIAS_W])
        by_left = h * (v_x * p[i, BIAS_W] - w * p[i, V_X] - p[i, BIAS_Y])
        p[i, X] += by_x
        p[i, Y] += by_y
        p[i, YAW] += by_yaw
        p[i, V_X] += by_ahead
        p[i, V_Y] += by_left
    between = JERK * (0.5 * h + age)
    felt = h * h * (k.felt[0] * k.felt[0] + between * between)
    p[V_X, V_X] += felt
    p[V_Y, V_Y] += felt
    p[YAW, YAW] += h * h * (k.felt[1] * k.felt[1] + between * between * 0.01)
    p[BIAS_X, BIAS_X] += h * (BIAS_DRIFT * k.bias[0]) ** 2
    p[BIAS_Y, BIAS_Y] += h * (BIAS_DRIFT * k.bias[0]) ** 2
    p[BIAS_W, BIAS_W] += h * (BIAS_DRIFT * k.bias[1]) ** 2
    p[LOG_RADIUS, LOG_RADIUS] += h * k.rules.radius_drift * k.rules.radius_drift
    p[SIDE, SIDE] += h * k.rules.side_drift * k.rules.side_drift
    p[TURNING, TURNING] += h * k.rules.turning_drift * k.rules.turning_drift
    p[PULLING, PULLING] += h * k.rules.pulling_drift * k.rules.pulling_drift


@formula
def _take(z, p, gain, expected, missed, least):
    """Correct by a measurement h z that misses by `missed`: gain (SIZE,) is p h, `expected` the
    variance of what is missed, taken as at least `least`. Returns standard deviations."""
    share = 1.0 / max(expected, least)
    for i in range(SIZE):
        z[i] += share * missed * gain[i]
        for j in range(i + 1):
            p[i, j] -= share * gain[i] * gain[j]
            p[j, i] = p[i, j]
    return missed / math.sqrt(expected)


@loop
def correct(z, p, a, h_a, b, h_b, missed, variance, room):
    """Take a measurement of h_a z[a] + h_b z[b] that misses by `missed`.

    room (1, SIZE). Returns how much that is in standard deviations.
    """
    gain = room[0]
    for i in range(SIZE):
        gain[i] = h_a * p[i, a] + h_b * p[i, b]
    expected = h_a * gain[a] + h_b * gain[b] + variance
    return _take(z, p, gain, expected, missed, abs(missed) * math.sqrt(expected) / HUBER)


@formula
def use_belts(z, p, left, right, pull, missing, rules, fading, room):
    """The rule of the belts, from the speeds of both sprockets, the acceleration ahead and
    `missing`, by how much the gyro falls short of the belts [m/s]."""
    radius, gain = math.exp(z[LOG_RADIUS]), room[0]
    more = abs(right) - abs(left)
    apart = radius * more * math.copysign(1.0, right - left)
    change = more / (abs(right) + abs(left) + STANDING) * missing
    belts = 0.5 * radius * (left + right) + z[TURNING] * apart
    rough = rules.rest + rules.share * abs(z[V_X]) + rules.spinning * fading
    bent = belts * p[LOG_RADIUS, LOG_RADIUS]  # what is not linear in ln r
    for i in range(SIZE):
        gain[i] = belts * p[i, LOG_RADIUS] - p[i, V_X]
        gain[i] += apart * p[i, TURNING] + change * p[i, CHANGING] + pull * p[i, PULLING]
    expected = belts * gain[LOG_RADIUS] - gain[V_X] + rough * rough + 0.5 * bent * bent
    expected += apart * gain[TURNING] + change * gain[CHANGING] + pull * gain[PULLING]
    missed = z[V_X] - belts - z[CHANGING] * change - z[PULLING] * pull
    _take(z, p, gain, expected, missed, missed * missed / (WILD * WILD))


@formula
def missing_turn(row, apart, w):
    """By how much the yaw rate w falls short of belts that are `apart` [rad/s], of late; 0 as long
    as nothing has turned."""
    known = row.turned[1] / (row.turned[1] + 0.05)
    return known * (apart - row.turned[0] / (row.turned[1] + 1e-3) * w)


@formula
def use_side(z, p, w, room):
    """The rule of the lateral velocity, at yaw rate w."""
    rough = SIDE_SLIP[0] + SIDE_SLIP[1] * abs(z[V_X] * w)
    correct(z, p, V_Y, 1.0, SIDE, w, -z[V_Y] - z[SIDE] * w, rough * rough, room)


@loop
def navigate(values, fresh, age, rows, rings, k, misses):
    """One step of all vehicles: rows (N,) of ROW and rings (N, slots, MOVED) in and out; misses (N,
    MOVED) out, of the pose in body axes over its standard deviation, 0 where none is new."""
    room, then = np.empty((MOVED, SIZE)), np.empty(MOVED)
    slots, keep = rings.shape[1], math.exp(-k.period / GAUGE_MEMORY)
    for i in range(values.shape[0]):
        row, sample, missed = rows[i], values[i], misses[i]
        z, p, felt, step = row.mean, row.covariance, row.felt, int(row.step)
        for j in range(MOVED):
            missed[j] = 0.0
        is_finite = math.isfinite(sample[0] + sample[1] + sample[2])
        if step == 0:
            _begin(row, sample, fresh[i, POSE] and is_finite and age[i, POSE] < k.period, k)
        f_x, f_y, gyro = felt[0], felt[1], felt[2]
        if math.isfinite(sample[_A_X] + sample[_A_Y] + sample[_GYRO]):
            felt[0], felt[1], felt[2] = sample[_A_X], sample[_A_Y], sample[_GYRO]
        if step > 0:
            f_x, f_y = 0.5 * (f_x + felt[0]), 0.5 * (f_y + felt[1])
            gyro = 0.5 * (gyro + felt[2])
            move(z, p, f_x, f_y, gyro, min(age[i, INERTIAL], 0.2), k, room)
        older = int(age[i, POSE] / k.period + 0.5)
        if step > 0 and fresh[i, POSE] and is_finite and older <= min(step, slots - 1):
            for j in range(MOVED):
                then[j] = z[j] if older == 0 else rings[i, (step - older) % slots, j]
            e_x, e_y = sample[0] - then[X], sample[1] - then[Y]
            e_yaw = wrap_angle(sample[2] - then[YAW])
            e_ahead, e_left = sample[_V_X] - then[V_X], sample[_V_Y] - then[V_Y]
            cosine, sine = rotation(then[YAW])
            # What one of them corrects, the next ones no longer miss.
            before_y, before_yaw = z[Y], z[YAW]
            before_ahead, before_left = z[V_X], z[V_Y]
            m_x = correct(z, p, X, 1.0, X, 0.0, e_x, k.pose[X] ** 2, room)
            m_y = correct(z, p, Y, 1.0, Y, 0.0, e_y - (z[Y] - before_y), k.pose[Y] ** 2, room)
            e_yaw -= z[YAW] - before_yaw
            missed[2] = correct(z, p, YAW, 1.0, YAW, 0.0, e_yaw, k.pose[YAW] ** 2, room)
            missed[0], missed[1] = cosine * m_x + sine * m_y, cosine * m_y - sine * m_x
            if k.pose[V_X] < UNSEEN and math.isfinite(e_ahead + e_left):
                e_ahead -= z[V_X] - before_ahead
                missed[3] = correct(z, p, V_X, 1.0, V_X, 0.0, e_ahead, k.pose[V_X] ** 2, room)
                e_left -= z[V_Y] - before_left
                missed[4] = correct(z, p, V_Y, 1.0, V_Y, 0.0, e_left, k.pose[V_Y] ** 2, room)
        left, right = sample[_LEFT], sample[_LEFT + 1]
        seen = math.isfinite(left + right)
        if fresh[i, DRIVE] and seen:
            missing = math.exp(z[LOG_RADIUS]) * missing_turn(row, right - left, felt[2] - z[BIAS_W])
            fading = math.exp(-k.period * step / SPINNING)
            use_belts(z, p, left, right, felt[0] - z[BIAS_X], missing, k.rules, fading, room)
        use_side(z, p, felt[2] - z[BIAS_W], room)
        z[YAW] = wrap_angle(z[YAW])
        z[LOG_RADIUS] = min(max(z[LOG_RADIUS], -4.6), 1.0)
        w = felt[2] - z[BIAS_W]
        row.turned[0] = keep * row.turned[0] + ((right - left) * w if seen else 0.0)
        row.turned[1] = keep * row.turned[1] + w * w
        for j in range(MOVED):
            rings[i, step % slots, j] = z[j]
        row.step = step + 1.0
