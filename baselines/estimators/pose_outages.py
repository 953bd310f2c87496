"""Motion without a pose: speed and heading by accelerometer and gyro, and the slips they make.

While poses come, two Kalman filters of two states run beside the slip filter and learn the biases
of accelerometer and gyro from the samples of speed and heading:
    v+ = v + dt (f_x + g_x + w v_y - b),    psi+ = psi + dt (w - b_w)
After `silence` steps without a pose (more than a late or rare one), or when a belt jumps between
poses, slips are no random walks: they take mean and covariance of that speed, see `take_speeds`.
    tracks    V_L, V_R = v -+ w B / 2 by that v and the gyro's w; i_L, i_R follow with the belts.
              A belt that stands or turns against its track says nothing of the way: in the place
              of the belts are then those that with slips of at most SLIP_SHOWN give V_L, V_R.
              What both share walks by the noise of f_x and the deviation sigma_b of the bias:
              var v per step = dt^2 sigma_a^2 + 3 sigma_b^2 t dt (of a constant error, at least its
              effect on the way: t^4 / 4 <= 1.5 t^4 / 6)
    effort    v by S (7) inverted: i = slip_from_effort(F; F_max, K), with the variance of the
              identified [ln F_max, ln K]; that error lasts, so that all samples of OUTAGE_TIME
              together count as one. It grows, as the soil may change; where the two contradict
              each other, the soil is another one: the squared difference adds to it
    friction  v_y from F_y(v_y, w) = m f_y with the identified mu_t, f_y the lateral accelerometer;
              -d w with the constrained lateral model
    turn      the gyro, less its bias
The first pose afterwards is an update like others; beyond the gate, after `inflate`. The inertial
speed takes the filter's then, once, and its bias what follows from it (`_adopt`). What is shown to
a controller follows: the difference fades with BLENDING.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 2 and 7.2.
"""

import math

from baselines.estimators.measurement import COLUMN, INERTIAL
from baselines.estimators.slip_kinematics import (
    SIDE_SLIP,
    SLIP_LEFT,
    SLIP_LIMIT,
    SLIP_RIGHT,
    STANDING_VEHICLE,
    YAW,
    X,
    Y,
    ramp,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula
from tracked_env.physics.rigid_body import heading_rate

SLIP_SHOWN = 0.8  # [-] slips count as at most that in an outage
WILD_TURN = 3.0  # [rad/s] a gyro that differs more from the belts is not used
LARGEST_ACCELERATION = 100.0  # [m/s^2] anything beyond is a fault of the sensor, as NaN is
LARGEST_SPEED = 100.0  # [m/s] likewise
UNMEASURED = 1e3  # [m/s] velocity noise on a data sheet where nothing is measured
HANDOVER = 0.02  # [m/s] sigma added where slips take the inertial speed, else effort is not heard
FILTERED = 1.0  # [s] over which the error of the filter's speed is one and the same
OUTAGE_TIME = 10.0  # [s] over which the error of the soil is one and the same
UNSEEN = 1e9  # [SI] variance of a row of z that says nothing, through a long outage
LARGEST_BRAKING = 0.5  # [-] slip by the effort beyond which a braked belt does not tell the speed
SPEED_FLOOR = 0.01  # [m/s] sigma of the speed by the effort, beside that of the soil
LASTING = 0.0045  # [m/s] sigma of what lasts of that error, on a soil that is not certain
SIDE_FLOOR = 0.01  # [m/s] sigma of v_y by the friction
SOIL_DRIFT = 0.1  # [1/sqrt(s)] of ln F_max and ln K, since the last pose
DISAGREEMENT = 4.0  # [-] squared innovation, in its variance, from which the soil is another one
PROBE_SPEED = 1e-3  # [m/s] at which the slope of the lateral friction is taken
LARGEST_SIDE = 0.5  # [-] |v_y| over the speed, as the controller bounds it

SUM, BIAS, P_SS, P_SB, P_BB = range(5)  # of a filter of a sum and the bias in it

_OTHERS = (X, Y, YAW, SIDE_SLIP)  # states beside the slips
_A_X, _A_Y = COLUMN["acceleration_x"], COLUMN["acceleration_y"]
_YAW_RATE = COLUMN["yaw_rate"]
_SPROCKET, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]


@formula
def silent(row, k):
    """Whether there has been no pose for longer than a late or rare one is away."""
    return row.silent > k.silence


@formula
def _speeds(x, left, right, k):
    """(v [m/s], w [rad/s]) by belts [m/s] and slips."""
    v_left = soil.track_speed_from_belt(left, x[SLIP_LEFT])
    v_right = soil.track_speed_from_belt(right, x[SLIP_RIGHT])
    return 0.5 * (v_left + v_right), (v_right - v_left) * k.inverse_gauge


@formula
def steepness(belt, slip, k):
    """-dV/di [m/s] of a track at this slip: |V_t| when driven, |V_t| / (1 - |i|)^2 when braked."""
    gain = soil.track_speed_from_belt(1.0, slip if belt >= 0.0 else -slip)
    return max(abs(belt), k.standing_belt) * max(gain * gain, 1.0)


@formula
def speed_variance(x, p, left, right, k):
    """Variance [m^2/s^2] of the speed by slips of covariance p and belts [m/s]."""
    left, right = steepness(left, x[SLIP_LEFT], k), steepness(right, x[SLIP_RIGHT], k)
    both = 2.0 * left * right * p[SLIP_LEFT, SLIP_RIGHT]
    return 0.25 * abs(
        left * left * p[SLIP_LEFT, SLIP_LEFT] + right * right * p[SLIP_RIGHT, SLIP_RIGHT] + both
    )


@formula
def _restart(row, speed, variance):
    """The inertial speed begins anew with `speed` [m/s] of this variance; the bias stays."""
    row.speed[SUM] = speed
    row.speed[P_SS], row.speed[P_SB] = variance, 0.0


@formula
def _adopt(filter_, number, variance):
    """Set the sum of a filter (sum, bias) to `number`, of at most this variance; the bias given
    each sum stays."""
    share = filter_[P_SB] / filter_[P_SS]
    variance = min(variance, filter_[P_SS])
    filter_[BIAS] += share * (number - filter_[SUM])
    filter_[SUM] = number
    filter_[P_BB] += share * share * (variance - filter_[P_SS])
    filter_[P_SS], filter_[P_SB] = variance, share * variance


@formula
def drift(filter_, variance, period):
    """Covariance of a filter (sum, bias) after a step; variance: of one sample."""
    filter_[P_SS] += period * period * (filter_[P_BB] + variance)
    filter_[P_SS] -= 2.0 * period * filter_[P_SB]
    filter_[P_SB] -= period * filter_[P_BB]


@formula
def compare(filter_, error, variance):
    """Update a filter (sum, bias) by an error of the sum and its variance."""
    ss, sb = filter_[P_SS], filter_[P_SB]
    share = 1.0 / (ss + variance)
    filter_[SUM] += ss * share * error
    filter_[BIAS] += sb * share * error
    filter_[P_BB] -= sb * sb * share
    filter_[P_SB] -= ss * sb * share
    filter_[P_SS] -= ss * ss * share


@formula
def _slip(belt, speed, last, k):
    """Slip of a track with `speed` [m/s] over the ground; `last` where its belt stands."""
    moves = ramp(belt, k.standing_belt) > 0.0
    slip = soil.slip_ratio(belt, speed) if moves else last
    return min(max(slip, -SLIP_SHOWN), SLIP_SHOWN)


@formula
def belt_of(speed, slip):
    """Belt speed [m/s] that with this slip gives the speed over the ground."""
    gain = soil.track_speed_from_belt(1.0, slip if speed >= 0.0 else -slip)
    return speed / gain


@formula
def _take_track(row, side, last, belt, speed, same, k):
    """The slip of a track, 0 left, 1 right, with the belt at `last` [m/s], becomes what makes this
    speed of this belt; the covariance is that of the `same` speeds, or slips. Returns the belt, or
    one that makes it."""
    x, p, state = row.state, row.covariance, SLIP_LEFT + side
    before = steepness(last, x[state], k)
    x[state] = _slip(belt, speed, x[state], k)
    belt = belt_of(speed, x[state])
    factor = before / steepness(belt, x[state], k) if same else 1.0
    p[state, :] *= factor
    p[:, state] *= factor
    return belt


@formula
def take_speeds(row, belts, v, w, variance, turn_variance, k):
    """Slips by v [m/s], w [rad/s] with these variances in place of those of the state; belts [m/s].
    What the other states are for each slip stays: with A = P_12 P_22^-1, m the slips, x_1 += A
    (m' - m), P_12 = A P_22', P_11 += A (P_22' - P_22) A^T. Returns belts, see _take_track."""
    x, p, (left, right) = row.state, row.covariance, belts
    half = 0.5 * w / k.inverse_gauge
    before_left = soil.track_speed_from_belt(left, x[SLIP_LEFT])
    before_right = soil.track_speed_from_belt(right, x[SLIP_RIGHT])
    left = _take_track(row, 0, left, left, v - half, True, k)
    right = _take_track(row, 1, right, right, v + half, True, k)
    g_left, g_right = steepness(left, x[SLIP_LEFT], k), steepness(right, x[SLIP_RIGHT], k)
    more_left, more_right = (before_left - v + half) / g_left, (before_right - v - half) / g_right
    a, b, c = p[SLIP_LEFT, SLIP_LEFT], p[SLIP_LEFT, SLIP_RIGHT], p[SLIP_RIGHT, SLIP_RIGHT]
    across = turn_variance * 0.25 / (k.inverse_gauge * k.inverse_gauge)
    aa = (variance + across) / (g_left * g_left)
    bb = (variance - across) / (g_left * g_right)
    cc = (variance + across) / (g_right * g_right)
    inverse = 1.0 / max(a * c - b * b, 1e-9 * a * c)
    for r in _OTHERS:
        d, e = p[r, SLIP_LEFT], p[r, SLIP_RIGHT]
        p[r, SLIP_LEFT], p[r, SLIP_RIGHT] = (c * d - b * e) * inverse, (a * e - b * d) * inverse
        x[r] += p[r, SLIP_LEFT] * more_left + p[r, SLIP_RIGHT] * more_right
    for r in _OTHERS:
        for s in _OTHERS:
            d, e = p[s, SLIP_LEFT], p[s, SLIP_RIGHT]
            p[r, s] += p[r, SLIP_LEFT] * ((aa - a) * d + (bb - b) * e)
            p[r, s] += p[r, SLIP_RIGHT] * ((bb - b) * d + (cc - c) * e)
    for r in _OTHERS:
        d, e = p[r, SLIP_LEFT], p[r, SLIP_RIGHT]
        p[r, SLIP_LEFT] = p[SLIP_LEFT, r] = d * aa + e * bb
        p[r, SLIP_RIGHT] = p[SLIP_RIGHT, r] = d * bb + e * cc
    p[SLIP_LEFT, SLIP_LEFT], p[SLIP_RIGHT, SLIP_RIGHT] = aa, cc
    p[SLIP_LEFT, SLIP_RIGHT] = p[SLIP_RIGHT, SLIP_LEFT] = bb
    return left, right


@formula
def start(row, sensors, speed, variance, k):
    """Inertial speed begins with `speed` [m/s] of this variance, heading with that of the state."""
    _restart(row, speed, variance)
    yaw_variance = row.covariance[YAW, YAW]
    row.heading[SUM], row.heading[P_SS], row.heading[P_SB] = row.state[YAW], yaw_variance, 0.0
    row.speed[P_BB], row.heading[P_BB] = k.bias_variance, k.turn_bias_variance
    a, w = sensors[_A_X], sensors[_YAW_RATE]
    row.turning = w if abs(w) < WILD_TURN else 0.0
    row.acceleration = a if abs(a) < LARGEST_ACCELERATION else 0.0


@formula
def carry(row, last, sensors, incline, pitch_rate, k):
    """Inertial speed and heading of one step; without a pose, the slips that they make. last: belts
    [m/s] before, left and right; those of now are in the row, and replaced without a pose. Returns
    (the variance per step [-] of what both slips share, or -1 where they are random walks; the
    belts before and now that with the present slips make the speeds of before and now)."""
    x, p, (last_left, last_right) = row.state, row.covariance, last
    left, right = row.belt[0], row.belt[1]
    turn, carried = heading_rate(incline, pitch_rate)
    v, w = _speeds(x, last_left, last_right, k)
    v, w = min(max(v, -LARGEST_SPEED), LARGEST_SPEED), min(max(w, -WILD_TURN), WILD_TURN)
    better = row.speed[P_SS] < speed_variance(x, p, last_left, last_right, k)
    if better and not silent(row, k):
        v = min(max(row.speed[SUM], -LARGEST_SPEED), LARGEST_SPEED)
    row.silent += 1.0
    gyro = sensors[_YAW_RATE]
    turns = abs(gyro - w) < WILD_TURN
    w = gyro - row.heading[BIAS] if turns else w
    drift(row.heading, k.gyro_variance if turns else 1.0 / k.period, k.period)
    turning = turn * w + carried
    heading = row.heading[SUM]
    row.heading[SUM] += 0.5 * k.period * (row.turning + turning)
    row.turning = turning
    c, s = rotation(x[SIDE_SLIP])
    a = sensors[_A_X] + soil.GRAVITY * incline.down_x + w * v * s / c - row.speed[BIAS]
    measured = abs(a) < LARGEST_ACCELERATION
    before, variance = v, row.speed[P_SS]
    if measured:
        gain = 0.5 * k.period * (row.acceleration + a)
        v += gain
        row.acceleration = a
        drift(row.speed, k.acceleration_variance, k.period)
        row.speed[SUM] += gain
    else:
        _restart(row, v, 1.0)
    if not silent(row, k):
        return -1.0, last, (left, right)
    if row.silent < k.silence + 1.5:  # since the last pose the gyro has turned
        if better and measured:
            variance += HANDOVER * HANDOVER
            last_left, last_right = take_speeds(row, last, before, w, variance, k.gyro_variance, k)
        x[YAW] = heading  # this step's turn is still to be predicted
    half = 0.5 * w / k.inverse_gauge
    before_left = soil.track_speed_from_belt(last_left, x[SLIP_LEFT])
    before_right = soil.track_speed_from_belt(last_right, x[SLIP_RIGHT])
    left = _take_track(row, 0, last_left, left, v - half, measured, k)
    right = _take_track(row, 1, last_right, right, v + half, measured, k)
    last = (belt_of(before_left, x[SLIP_LEFT]), belt_of(before_right, x[SLIP_RIGHT]))
    if not measured:
        return 0.5 * k.slip_drift, last, (left, right)
    mean = max(0.5 * (abs(left) + abs(right)), STANDING_VEHICLE)
    time = row.silent * k.period
    noise = k.period * k.acceleration_variance + 3.0 * row.speed[P_BB] * time
    return k.period * noise / (mean * mean), last, (left, right)


@formula
def add_shown(row, sign, k):
    """Add the filtered pose and speed to the gap (sign 1) before the first pose after an outage is
    used, and take them off (-1) afterwards: what is shown stays where it was."""
    x = row.state
    row.gap[0] += sign * x[X]
    row.gap[1] += sign * x[Y]
    row.gap[2] += sign * x[YAW]
    row.gap[3] += sign * _speeds(x, row.belt[0], row.belt[1], k)[0]


@formula
def compare_inertial(row, v, yaw, age, sensors, k):
    """By how much v [m/s] and yaw [rad] of a sample differ from the inertial ones of that time."""
    a, w = sensors[_A_X] - row.speed[BIAS], sensors[_YAW_RATE] - row.heading[BIAS]
    a = a if abs(a) < LARGEST_ACCELERATION else 0.0
    w = w if abs(w) < WILD_TURN else 0.0
    row.speed_error = v - (row.speed[SUM] - age * a)
    row.turn_error = wrap_angle(yaw - (row.heading[SUM] - age * w))


@formula
def settle(row, used, k):
    """At the end of a step; used: a pose was, and inertial speed and heading are compared with it.
    Where no velocity is measured, the filter's stands for it."""
    x, p, left, right = row.state, row.covariance, row.belt[0], row.belt[1]
    v, _w = _speeds(x, left, right, k)
    for column in range(4):
        row.gap[column] *= k.fading
    if not used:
        return
    variance = speed_variance(x, p, left, right, k)
    if silent(row, k):
        add_shown(row, -k.fading, k)
        _adopt(row.speed, v, variance)
        _adopt(row.heading, x[YAW], p[YAW, YAW])
    else:
        if k.velocity_variance >= UNMEASURED * UNMEASURED:
            variance *= FILTERED / k.period
            compare(row.speed, v - row.speed[SUM], variance)
        elif abs(row.speed_error) < LARGEST_SPEED:
            compare(row.speed, row.speed_error, k.velocity_variance)
        compare(row.heading, row.turn_error, k.yaw_variance)
    row.silent = 0.0


@formula
def _of_effort(row, sensors, side, k):
    """(speed [m/s] of a track by belt and torque, its change [m/s] per ln F_max, per ln K). NaN
    where a braked belt does not tell it."""
    belt = k.radius * sensors[_SPROCKET + side]
    effort, maximum = sensors[_TORQUE + side] / k.radius, row.effort_maximum
    length = row.shear_length
    slip = soil.slip_from_effort(effort, maximum, length)
    u = abs(slip) * length
    share, rise = soil.mobilised_shear(u), soil.mobilised_shear_slope(u)
    bend = -share / (max(rise, 1e-9) * length)
    bend = bend if effort >= 0.0 else -bend
    if slip * belt < -LARGEST_BRAKING * abs(belt) or abs(belt) < k.standing_belt:
        return math.nan, 0.0, 0.0
    slip = min(max(slip, -SLIP_LIMIT), SLIP_LIMIT)
    return soil.track_speed_from_belt(belt, slip), -belt * bend, -belt * slip


@formula
def _speed_row(row, sensors, v, k):
    """(v [m/s] by the effort of both tracks, its variance for one sample)."""
    if row.effort_maximum <= 0.0:
        return v, UNSEEN
    one, f_left, k_left = _of_effort(row, sensors, 0, k)
    two, f_right, k_right = _of_effort(row, sensors, 1, k)
    by_effort, f, twist = 0.5 * (one + two), 0.5 * (f_left + f_right), 0.5 * (k_left + k_right)
    certain = row.p_ff == 0.0
    changed = SOIL_DRIFT * SOIL_DRIFT * row.silent * k.period if row.p_ff > 0.0 else 0.0
    spread = f * f * (row.p_ff + changed)
    spread += twist * twist * (row.p_kk + changed)
    spread = max(spread + 2.0 * f * twist * row.p_fk, 0.0)
    present = speed_variance(row.state, row.covariance, row.belt[0], row.belt[1], k)
    floor, error = SPEED_FLOOR * SPEED_FLOOR, by_effort - v
    spread += 0.0 if certain else LASTING * LASTING
    if not certain and error * error > DISAGREEMENT * (present + spread + floor):
        spread += error * error
    variance = floor + spread * OUTAGE_TIME / k.period
    usable = abs(by_effort) < LARGEST_SPEED and variance < math.inf
    return (by_effort, variance) if usable else (v, UNSEEN)


@formula
def _side_row(row, sensors, v, w, press, k):
    """(v_y [m/s] by the lateral friction, its variance)."""
    bound = LARGEST_SIDE * abs(v)
    if k.constrained > 0.0:
        return min(max(-k.icr_forward * w, -bound), bound), SIDE_FLOOR * SIDE_FLOOR
    a_y, friction = sensors[_A_Y], row.friction
    if not (friction > 0.0 and abs(a_y) < LARGEST_ACCELERATION):
        return 0.0, UNSEEN
    intensity = friction * soil.GRAVITY * press / k.contact_length
    force, _moment = soil.lateral_friction(PROBE_SPEED, w, intensity, k.contact_length)
    v_y = a_y * PROBE_SPEED / min(force, -1e-9)
    return min(max(v_y, -bound), bound), SIDE_FLOOR * SIDE_FLOOR


@formula
def measure(row, sample, expected, press, k, out):
    """z (ROWS,) and its R (ROWS, ROWS), both of `out`, of a step without a pose. sample: of one
    vehicle, see slip_step.Sensed; expected: z by the model."""
    sensors, fresh = sample.values, sample.fresh
    z, noise = out
    noise[:, :] = 0.0
    for r in range(6):
        z[r] = expected[r]
        noise[r, r] = UNSEEN
    gyro = sensors[_YAW_RATE]
    if fresh[INERTIAL] and abs(gyro - expected[5]) < WILD_TURN:
        z[5], noise[5, 5] = gyro - row.heading[BIAS], k.gyro_variance
    z[3], noise[3, 3] = _speed_row(row, sensors, expected[3], k)
    side, variance = _side_row(row, sensors, expected[3], z[5], press, k)
    if variance < UNSEEN and abs(expected[3]) > STANDING_VEHICLE:
        z[4], noise[4, 4] = side, variance
