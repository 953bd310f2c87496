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
    measured  v, v_y and w, by what outage_measurement makes of effort, friction and gyro
The first pose afterwards is an update like others; beyond the gate, after `inflate`. The inertial
speed takes the filter's then, once, and its bias what follows from it (`_adopt`). What is shown to
a controller follows: the difference fades with BLENDING.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 2 and 7.2.

What is measured without a pose: speed by the effort, side slip by the friction, the gyro.

    effort    v by S (7) inverted: i = slip_from_effort(F; F_max, K), with the variance
              of the identified [ln F_max, ln K]; that error lasts, so that all samples of
              OUTAGE_TIME together count as one. It grows, as the soil may change; where the
              two contradict each other, it is another one: the squared difference adds to it
    friction  v_y from F_y(v_y, w) = m f_y with the identified mu_t, f_y the lateral
              accelerometer; -d w with the constrained lateral model
    turn      the gyro, less its bias
The ground and the biases stand in the columns of slip_outage, from `at` on.

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

SLIP_SHOWN = 0.8  # [-] slips count as at most that in an outage
WILD_TURN = 3.0  # [rad/s] a gyro that differs more from the belts is not used
LARGEST_ACCELERATION = 100.0  # [m/s^2] anything beyond is a fault of the sensor, as NaN is
LARGEST_SPEED = 100.0  # [m/s] likewise
UNMEASURED = 1e3  # [m/s] velocity noise on a data sheet where nothing is measured
HANDOVER = 0.02  # [m/s] sigma added where slips take the inertial speed, else effort is not heard
FILTERED = 1.0  # [s] over which the error of the filter's speed is one and the same

# What is remembered of one vehicle, from column `at` of its memory on.
(
    SILENT,  # [steps] since the last pose
    SPEED, BIAS, P_SS, P_SB, P_BB,  # [m/s], [m/s^2], their covariance
    TURNED, TURN_BIAS, P_TT, P_TG, P_GG,  # [rad], [rad/s], their covariance
    EFFORT_MAXIMUM, SHEAR_LENGTH, P_FF, P_FK, P_KK, FRICTION,  # of the ground; 0 = not known
    GAP_X, GAP_Y, GAP_YAW, GAP_SPEED,  # shown minus filtered
    SEEN_SPEED, SEEN_TURN,  # [m/s], [rad] innovations of the last pose
    FELT, TURNS,  # [m/s^2], [rad/s] at the last step
) = range(25)  # fmt: skip
COLUMNS = 25

_OTHERS = (X, Y, YAW, SIDE_SLIP)  # states beside the slips
_A_X, _YAW_RATE = COLUMN["acceleration_x"], COLUMN["yaw_rate"]


@formula
def silent(memory, i, at, k):
    """Whether there has been no pose for longer than a late or rare one is away."""
    return memory[i, at + SILENT] > k.silence


@formula
def _speeds(x, left, right, k):
    """(v [m/s], w [rad/s]) by belts [m/s] and slips."""
    v_left = soil.track_speed_from_belt(left, x[SLIP_LEFT])
    v_right = soil.track_speed_from_belt(right, x[SLIP_RIGHT])
    return 0.5 * (v_left + v_right), (v_right - v_left) * k.inverse_gauge


@formula
def begin(memory, i, at, k):
    """An outage begins with this step."""
    memory[i, at + SILENT] = max(memory[i, at + SILENT], k.silence)


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
def _restart(memory, i, at, speed, variance):
    """The inertial speed begins anew with `speed` [m/s] of this variance; the bias stays."""
    memory[i, at + SPEED] = speed
    memory[i, at + P_SS], memory[i, at + P_SB] = variance, 0.0


@formula
def _adopt(memory, i, value, number, variance):
    """(sum, bias) in columns `value` ff. when the sum is `number`, of at most this variance; what
    the bias is for each sum stays."""
    first = value + 2
    share = memory[i, first + 1] / memory[i, first]
    variance = min(variance, memory[i, first])
    memory[i, value + 1] += share * (number - memory[i, value])
    memory[i, value] = number
    memory[i, first + 2] += share * share * (variance - memory[i, first])
    memory[i, first], memory[i, first + 1] = variance, share * variance


@formula
def drift(memory, i, first, variance, period):
    """Covariance of (sum, bias) in columns `first` ff. after a step; variance: of one sample."""
    memory[i, first] += period * period * (memory[i, first + 2] + variance)
    memory[i, first] -= 2.0 * period * memory[i, first + 1]
    memory[i, first + 1] -= period * memory[i, first + 2]


@formula
def compare(memory, i, value, error, variance):
    """Update (sum, bias) in columns `value` ff. by an error of the sum and its variance."""
    first = value + 2
    ss, sb = memory[i, first], memory[i, first + 1]
    share = 1.0 / (ss + variance)
    memory[i, value] += ss * share * error
    memory[i, value + 1] += sb * share * error
    memory[i, first + 2] -= sb * sb * share
    memory[i, first + 1] -= ss * sb * share
    memory[i, first] -= ss * ss * share


@formula
def _slip(belt, speed, held, k):
    """Slip of a track with `speed` [m/s] over the ground; `held` where its belt stands."""
    moves = ramp(belt, k.standing_belt) > 0.0
    slip = soil.slip_ratio(belt, speed) if moves else held
    return min(max(slip, -SLIP_SHOWN), SLIP_SHOWN)


@formula
def belt_of(speed, slip):
    """Belt speed [m/s] that with this slip gives the speed over the ground."""
    gain = soil.track_speed_from_belt(1.0, slip if speed >= 0.0 else -slip)
    return speed / gain


@formula
def _take_track(x, p, state, last, belt, speed, same, k):
    """Slip `state`, with the belt at `last` [m/s], becomes what makes this speed of this belt; the
    covariance is that of the `same` speeds, or slips. Returns the belt, or one that makes it."""
    before = steepness(last, x[state], k)
    x[state] = _slip(belt, speed, x[state], k)
    belt = belt_of(speed, x[state])
    factor = before / steepness(belt, x[state], k) if same else 1.0
    p[state, :] *= factor
    p[:, state] *= factor
    return belt


@formula
def take_speeds(x, p, left, right, v, w, variance, turn_variance, k):
    """Slips by v [m/s], w [rad/s] with these variances in place of those of (x, p); belts [m/s].

    What the other states are for each slip stays: with A = P_12 P_22^-1, m the slips,
    x_1 += A (m' - m), P_12 = A P_22', P_11 += A (P_22' - P_22) A^T. Returns belts, see _take_track.
    """
    half = 0.5 * w / k.inverse_gauge
    before_left = soil.track_speed_from_belt(left, x[SLIP_LEFT])
    before_right = soil.track_speed_from_belt(right, x[SLIP_RIGHT])
    left = _take_track(x, p, SLIP_LEFT, left, left, v - half, True, k)
    right = _take_track(x, p, SLIP_RIGHT, right, right, v + half, True, k)
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
def start(memory, i, at, x, p, values, speed, variance, k):
    """Inertial speed begins with `speed` [m/s] of this variance, heading with that of (x, p)."""
    _restart(memory, i, at, speed, variance)
    memory[i, at + TURNED], memory[i, at + P_TT], memory[i, at + P_TG] = x[YAW], p[YAW, YAW], 0.0
    memory[i, at + P_BB], memory[i, at + P_GG] = k.bias_variance, k.turn_bias_variance
    a, w = values[i, _A_X], values[i, _YAW_RATE]
    memory[i, at + TURNS] = w if abs(w) < WILD_TURN else 0.0
    memory[i, at + FELT] = a if abs(a) < LARGEST_ACCELERATION else 0.0


@formula
def carry(
    memory, i, at, x, p, last_left, last_right, left, right, values, incline, carried, turn, k
):  # fmt: skip
    """Inertial speed and heading of one step; without a pose, the slips that they make.

    Belts [m/s] before and now; incline, with turn, carried of `attitude.heading_rate`. Returns (the
    variance per step [-] of what both slips share, or -1 where they are random walks; the belts
    before and now that with the present slips make the speeds of before and now).
    """
    v, w = _speeds(x, last_left, last_right, k)
    v, w = min(max(v, -LARGEST_SPEED), LARGEST_SPEED), min(max(w, -WILD_TURN), WILD_TURN)
    better = memory[i, at + P_SS] < speed_variance(x, p, last_left, last_right, k)
    if better and not silent(memory, i, at, k):
        v = min(max(memory[i, at + SPEED], -LARGEST_SPEED), LARGEST_SPEED)
    memory[i, at + SILENT] += 1.0
    gyro = values[i, _YAW_RATE]
    turns = abs(gyro - w) < WILD_TURN
    w = gyro - memory[i, at + TURN_BIAS] if turns else w
    drift(memory, i, at + P_TT, k.gyro_variance if turns else 1.0 / k.period, k.period)
    turning = turn * w + carried
    begun = memory[i, at + TURNED]
    memory[i, at + TURNED] += 0.5 * k.period * (memory[i, at + TURNS] + turning)
    memory[i, at + TURNS] = turning
    c, s = rotation(x[SIDE_SLIP])
    a = values[i, _A_X] + soil.GRAVITY * incline.down_x + w * v * s / c - memory[i, at + BIAS]
    felt = abs(a) < LARGEST_ACCELERATION
    before, variance = v, memory[i, at + P_SS]
    if felt:
        gain = 0.5 * k.period * (memory[i, at + FELT] + a)
        v += gain
        memory[i, at + FELT] = a
        drift(memory, i, at + P_SS, k.acceleration_variance, k.period)
        memory[i, at + SPEED] += gain
    else:
        _restart(memory, i, at, v, 1.0)
    if not silent(memory, i, at, k):
        return -1.0, last_left, last_right, left, right
    if memory[i, at + SILENT] < k.silence + 1.5:  # since the last pose the gyro has turned
        if better and felt:
            last_left, last_right = take_speeds(
                x, p, last_left, last_right, before, w, variance + HANDOVER**2, k.gyro_variance, k
            )  # fmt: skip
        x[YAW] = begun  # this step's turn is still to be predicted
    half = 0.5 * w / k.inverse_gauge
    before_left = soil.track_speed_from_belt(last_left, x[SLIP_LEFT])
    before_right = soil.track_speed_from_belt(last_right, x[SLIP_RIGHT])
    left = _take_track(x, p, SLIP_LEFT, last_left, left, v - half, felt, k)
    right = _take_track(x, p, SLIP_RIGHT, last_right, right, v + half, felt, k)
    last_left = belt_of(before_left, x[SLIP_LEFT])
    last_right = belt_of(before_right, x[SLIP_RIGHT])
    if not felt:
        return 0.5 * k.slip_drift, last_left, last_right, left, right
    mean = max(0.5 * (abs(left) + abs(right)), STANDING_VEHICLE)
    time = memory[i, at + SILENT] * k.period
    noise = k.period * k.acceleration_variance + 3.0 * memory[i, at + P_BB] * time
    return k.period * noise / (mean * mean), last_left, last_right, left, right


@formula
def add_shown(memory, i, at, x, left, right, sign, k):
    """Add the filtered pose and speed to the gap (sign 1) before the first pose after an outage
    is used, and take them off (-1) afterwards: what is shown stays where it was."""
    memory[i, at + GAP_X] += sign * x[X]
    memory[i, at + GAP_Y] += sign * x[Y]
    memory[i, at + GAP_YAW] += sign * x[YAW]
    memory[i, at + GAP_SPEED] += sign * _speeds(x, left, right, k)[0]


@formula
def see(memory, i, at, v, yaw, age, values, k):
    """Take down by how much v [m/s] and yaw [rad] of a sample differ from inertial ones, then."""
    a, w = values[i, _A_X] - memory[i, at + BIAS], values[i, _YAW_RATE] - memory[i, at + TURN_BIAS]
    a = a if abs(a) < LARGEST_ACCELERATION else 0.0
    w = w if abs(w) < WILD_TURN else 0.0
    memory[i, at + SEEN_SPEED] = v - (memory[i, at + SPEED] - age * a)
    memory[i, at + SEEN_TURN] = wrap_angle(yaw - (memory[i, at + TURNED] - age * w))


@formula
def settle(memory, i, at, x, p, left, right, used, k):
    """At the end of a step, with belts [m/s]; used: a pose was, and inertial speed and
    heading are compared with it. Where no velocity is measured, the filter's stands for it."""
    v, _w = _speeds(x, left, right, k)
    for column in range(GAP_X, GAP_SPEED + 1):
        memory[i, at + column] *= k.fading
    if not used:
        return
    variance = speed_variance(x, p, left, right, k)
    if silent(memory, i, at, k):
        add_shown(memory, i, at, x, left, right, -k.fading, k)
        _adopt(memory, i, at + SPEED, v, variance)
        _adopt(memory, i, at + TURNED, x[YAW], p[YAW, YAW])
    else:
        if k.velocity_variance >= UNMEASURED * UNMEASURED:
            variance *= FILTERED / k.period
            compare(memory, i, at + SPEED, v - memory[i, at + SPEED], variance)
        elif abs(memory[i, at + SEEN_SPEED]) < LARGEST_SPEED:
            compare(memory, i, at + SPEED, memory[i, at + SEEN_SPEED], k.velocity_variance)
        compare(memory, i, at + TURNED, memory[i, at + SEEN_TURN], k.yaw_variance)
    memory[i, at + SILENT] = 0.0


@formula
def take_ground(memory, i, at, maximum, modulus, ff, fk, kk, friction, k):
    """F_max [N] of a track, K [m], variances of their logarithms and mu_t, as identified."""
    memory[i, at + EFFORT_MAXIMUM] = maximum
    memory[i, at + SHEAR_LENGTH] = k.contact_length / modulus
    memory[i, at + P_FF], memory[i, at + P_FK], memory[i, at + P_KK] = ff, fk, kk
    memory[i, at + FRICTION] = friction


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

_A_Y, _YAW_RATE = COLUMN["acceleration_y"], COLUMN["yaw_rate"]
_SPROCKET, _TORQUE = COLUMN["sprocket_speed_left"], COLUMN["torque_left"]


@formula
def _of_effort(memory, i, at, values, side, k):
    """(speed [m/s] of a track by belt and torque, its change [m/s] per ln F_max, per ln K).

    NaN where a braked belt does not tell it.
    """
    belt = k.radius * values[i, _SPROCKET + side]
    effort, maximum = values[i, _TORQUE + side] / k.radius, memory[i, at + EFFORT_MAXIMUM]
    length = memory[i, at + SHEAR_LENGTH]
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
def _speed_row(memory, i, at, values, v, x, p, left, right, k):
    """(v [m/s] by the effort of both tracks, its variance for one sample)."""
    if memory[i, at + EFFORT_MAXIMUM] <= 0.0:
        return v, UNSEEN
    one, f_left, k_left = _of_effort(memory, i, at, values, 0, k)
    two, f_right, k_right = _of_effort(memory, i, at, values, 1, k)
    by_effort, f, twist = 0.5 * (one + two), 0.5 * (f_left + f_right), 0.5 * (k_left + k_right)
    changed = SOIL_DRIFT * SOIL_DRIFT * memory[i, at + SILENT] * k.period
    changed = changed if memory[i, at + P_FF] > 0.0 else 0.0  # a soil that is certain
    spread = f * f * (memory[i, at + P_FF] + changed)
    spread += twist * twist * (memory[i, at + P_KK] + changed)
    spread = max(spread + 2.0 * f * twist * memory[i, at + P_FK], 0.0)
    known = speed_variance(x, p, left, right, k)
    floor = SPEED_FLOOR * SPEED_FLOOR
    error = by_effort - v
    certain = memory[i, at + P_FF] == 0.0
    spread += 0.0 if certain else LASTING * LASTING
    if not certain and error * error > DISAGREEMENT * (known + spread + floor):
        spread += error * error
    variance = floor + spread * OUTAGE_TIME / k.period
    usable = abs(by_effort) < LARGEST_SPEED and variance < math.inf
    return (by_effort, variance) if usable else (v, UNSEEN)


@formula
def _side_row(memory, i, at, values, v, w, press, k):
    """(v_y [m/s] by the lateral friction, its variance)."""
    bound = LARGEST_SIDE * abs(v)
    if k.constrained > 0.0:
        return min(max(-k.icr_forward * w, -bound), bound), SIDE_FLOOR * SIDE_FLOOR
    felt, friction = values[i, _A_Y], memory[i, at + FRICTION]
    if not (friction > 0.0 and abs(felt) < LARGEST_ACCELERATION):
        return 0.0, UNSEEN
    intensity = friction * soil.GRAVITY * press / k.contact_length
    force, _moment = soil.lateral_friction(PROBE_SPEED, w, intensity, k.contact_length)
    v_y = felt * PROBE_SPEED / min(force, -1e-9)
    return min(max(v_y, -bound), bound), SIDE_FLOOR * SIDE_FLOOR


@formula
def measure(memory, i, at, values, fresh, expected, x, p, left, right, press, k, z, noise):
    """z (ROWS,) and its R (ROWS, ROWS) of a step without a pose; expected: z by the model."""
    noise[:, :] = 0.0
    for row in range(6):
        z[row] = expected[row]
        noise[row, row] = UNSEEN
    gyro = values[i, _YAW_RATE]
    if fresh[i, INERTIAL] and abs(gyro - expected[5]) < WILD_TURN:
        z[5], noise[5, 5] = gyro - memory[i, at + TURN_BIAS], k.gyro_variance
    z[3], noise[3, 3] = _speed_row(memory, i, at, values, expected[3], x, p, left, right, k)
    side, variance = _side_row(memory, i, at, values, expected[3], z[5], press, k)
    if variance < UNSEEN and abs(expected[3]) > STANDING_VEHICLE:
        z[4], noise[4, 4] = side, variance
