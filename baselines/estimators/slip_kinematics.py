"""Kinematics of a slipping tracked vehicle as an observer needs it: process and sensors.

State x = [X, Y, psi, i_L, i_R, alpha]; input: belt speeds V_t = omega r. With the gain of a track
g = V / V_t (terramechanics.track_speed_from_belt at V_t = 1), t = tan(alpha):
    V_L = g_L V_tL, V_R = g_R V_tR,  v_x = (V_L + V_R) / 2,  w = (V_R - V_L) / B,  v_y = t v_x
    X+   = X + dt v_x (cos(psi_m) - t sin(psi_m)),   psi_m = psi + w dt / 2
    Y+   = Y + dt v_x (sin(psi_m) + t cos(psi_m)),   psi+ = psi + w dt      S 7.2.2, ISO sign
    i_L, i_R, alpha: random walks
On a slope X, Y, psi are those of the map: (v_x, t v_x) -> `rigid_body.on_map`, w -> d psi/dt by the
measured roll, pitch and rate of pitch; all else stays in the vehicle's plane.
    z    = [X, Y, psi, v_x, v_y, w], taken `age` ago (see late poses)
Belt speeds act as the mean over the step, with noise s = r sigma_omega (see covariances).
Errors in variables: the same noise is in z - h and in dh/di = -V_t, whose product would not average
to zero (0.003 of slip with 0.1 rad/s). So the belt speed one step earlier multiplies what depends
on the sigma point, as an instrumental variable: V = g_mean V_t + (g - g_mean) V_t,earlier.

A track that stands tells nothing about its slip: noise of its sprocket would pass for full slip. So
deviations of the sigma points from the mean fade out with the belt speed, and alpha's with v_x.

Late poses: a sample that is `age` old saw the vehicle where it was, so the observer predicts that:
it takes the way driven since then off its present pose. The ring holds sums over time, not poses,
so that the way has the present estimate of the slips (constant over the delay):
    D_L = sum dt V_tL,   C_L = sum dt V_tL cos(psi),   S_L = sum dt V_tL sin(psi)     and R
    yaw  way = (g_R D_R - g_L D_L) / B,    g = V / V_t of each track
    X    way = (g_L C_L + g_R C_R) / 2 - tan(alpha) (g_L S_L + g_R S_R) / 2
    Y    way = (g_L S_L + g_R S_R) / 2 + tan(alpha) (g_L C_L + g_R C_R) / 2
with psi the estimated heading in the middle of each step. On a slope C and S hold ways on the map,
dt V_t cos(pitch), and D what turns the heading, dt V_t cos(roll) / cos(pitch). What the roll adds
to lateral ways (0.1 alpha) and the rate of pitch to psi (0.04 rad/s) is left out there. The ring,
one slot per step, reaches back for the longest delay. Stored poses would carry the slips of then:
a corrected slip would take effect only after the delay, and would be corrected again and again.

Covariances: noise of the belts s = r sigma_omega enters z and X, Y, psi beside the other sensors:
    R += s^2 J J^T,  J = d(v_x, v_y, w)/d(V_tL, V_tR);     Q += s^2 dt^2 G G^T likewise
Process noise fades out likewise. Information on s = (i_L, i_R, alpha): eigenvalues of
D P_s^-1 D - 1, D the prior's sigmas.

References: [S] Strawa et al., Electronics 10 (2021) 187, sections 3 and 7.2. [1] O. K. Smith, Comm.
ACM 4 (1961) 168: eigenvalues of a symmetric 3 x 3 matrix.
"""

import math
from typing import NamedTuple

import numpy as np

from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.rigid_body import heading_rate, on_map
from tracked_env.physics.terramechanics import track_speed_from_belt

NAMES = ("x", "y", "yaw", "slip_left", "slip_right", "side_slip")
STATES = len(NAMES)
X, Y, YAW, SLIP_LEFT, SLIP_RIGHT, SIDE_SLIP = range(STATES)
ROWS = 6  # of z: X, Y, psi, v_x, v_y, w
SLIP_LIMIT = 0.98  # [-] bound of the estimated slips, inside the physical +-1
SIDE_SLIP_LIMIT = 1.0  # [rad] bound of the estimated alpha
SIDE_SLIP_MODELLED = 1.2  # [rad] sigma points beyond it count as this: tan must stay moderate
PRIOR_SLIP = 0.3  # [-] sigma of a slip nothing is known about: most soils stay below it
PRIOR_SIDE_SLIP = 0.3  # [rad] the same for alpha
SLIP_VARIANCE, SIDE_SLIP_VARIANCE = PRIOR_SLIP * PRIOR_SLIP, PRIOR_SIDE_SLIP * PRIOR_SIDE_SLIP
STANDING_BELT = 0.03  # [m/s] a belt slower than this plus 3 sigma of its noise stands
STANDING_VEHICLE = 0.1  # [m/s] v_x below which alpha = atan(v_y / v_x) is not observed
BELT_SIGMAS = 5.0  # [-] of its noise: a belt that changes by more within a step really moves
# Times the sine of the tilt: a turn on a slope changes the force on the soil, so slips and alpha.
SLOPE_SLIP_DRIFT = 0.25  # [1/sqrt(s)]
SLOPE_SIDE_SLIP_DRIFT = 0.5  # [rad/sqrt(s)]
LARGEST_POSITION = 100.0  # [m] sigma of X and Y grows no further
LARGEST_YAW = 1.0  # [rad] sigma of psi grows no further: beyond it the circle is closed
STANDING_SHARE = 0.01  # [-] process noise variance of the pose at standstill, of that in motion
ICR_OFFSET = 0.2  # [m] x_icr of a turn on the spot, whose v_y = -x_icr w alpha cannot describe
IGNORED = 1e4  # [SI] variance of a row of z that is missing
LEAST_PIVOT = 1e-13  # [-] share of a variance that rounding leaves: below it P has lost digits
POSE_GATE = 30.7  # [-] chi^2 of three rows that white noise exceeds once in 1e6
JITTER = 1e-12  # [SI] added to every variance per step: keeps P positive definite

# The state of the slip observer for one vehicle. A filter of (sum, bias) holds both and their
# covariance: SUM, BIAS, P_SS, P_SB, P_BB.
ROW = np.dtype([
    ("state", float, STATES), ("covariance", float, (STATES, STATES)),
    ("belt", float, 2), ("stale", float, 2),  # [m/s] left, right; steps without a new sample
    ("started", float),  # 1 once a pose has come
    ("outliers", float), ("skipped", float),  # in a row; samples with NaN
    # of pose_outages
    ("silent", float),  # [steps] since the last pose
    ("speed", float, 5), ("heading", float, 5),  # filters of [m/s, m/s^2] and [rad, rad/s]
    # the ground, 0: unknown: F_max [N], l / K [-], covariance of their logarithms, mu_t
    ("effort_maximum", float), ("shear_length", float),
    ("p_ff", float), ("p_fk", float), ("p_kk", float), ("friction", float),
    ("gap", float, 4),  # shown minus filtered x, y, yaw, speed
    ("speed_error", float), ("turn_error", float),  # [m/s], [rad] innovations of the last pose
    ("acceleration", float), ("turning", float),  # [m/s^2], [rad/s] at the last step
    # of the ring
    ("head", float), ("filled", float),  # slot written last, slots written so far
])  # fmt: skip
# A slot of the ring: sums of the belts' ways [m] since the start, belt speeds [m/s].
SLOT = np.dtype([(name, float, 2) for name in ("d", "c", "s", "belt")])


class Constants(NamedTuple):
    """All numbers of the model, as the kernels take them."""

    period: float  # [s] dt
    radius: float  # [m] r
    inverse_gauge: float  # [1/m] 1 / B
    belt_variance: float  # [m^2/s^2] s^2
    standing_belt: float  # [m/s]
    position_variance: float  # [m^2]
    yaw_variance: float  # [rad^2]
    velocity_variance: float  # [m^2/s^2]
    yaw_rate_variance: float  # [rad^2/s^2]
    position_drift: float  # [m^2] variance per step
    yaw_drift: float  # [rad^2] per step
    slip_drift: float  # [-] per step
    side_slip_drift: float  # [rad^2] per step
    gate: float  # [-] NIS of an outlier
    rows: float  # [-] of z that are used: 3 or 6
    silence: float  # [steps] without pose that are more than a late or rare one
    acceleration_variance: float  # [m^2/s^4]
    bias_variance: float  # [m^2/s^4] of the accelerometer, before anything is known of it
    gyro_variance: float  # [rad^2/s^2] white
    turn_bias_variance: float  # [rad^2/s^2] of the gyro
    contact_length: float  # [m] l
    constrained: float  # [-] 1 with the constrained lateral model, else 0
    icr_forward: float  # [m] d, of that model
    fading: float  # [-] share of the gap behind an outage that is left after a step


Pair = tuple[float, float]  # of the left and the right track


class Inputs(NamedTuple):
    """What drives one step of one vehicle: belts [m/s], their directions, and the fading."""

    belt: Pair  # mean over the step
    direction: Pair  # [-] -1 or 1
    slip: Pair  # [-] mean of the state, from which sigma points deviate
    side_slip: float  # [rad] likewise
    fade: Pair  # [-] 0 = the track stands, 1 = it moves
    fade_side: float
    gain: Pair  # [-] g at the mean
    ahead: float  # [-] way on the map along the heading per way forward; 1 on level ground
    cross: float  # [-] the same per way to the left; 0
    aside: float  # [-] way on the map to the left per way to the left; 1
    turn: float  # [-] d psi/dt = turn w + carried; 1
    carried: float  # [rad/s] 0
    steep: float  # [-] squared sine of the tilt
    press: float  # [-] normal load over the weight
    common: float  # [-] variance per step of what both slips share; -1: they walk on their own


class Way(NamedTuple):
    """Sums of the belts' ways [m] since some earlier step, and their speeds [m/s] then."""

    d: Pair
    c: Pair
    s: Pair
    belt: Pair
    instrument: Pair  # speeds one step earlier: nearly the same, but with other noise


@formula
def push(row, ring, way):
    """Add one step: `way` holds the step's own sums and the belt speeds at its end."""
    old = ring[int(row.head)]
    head = (int(row.head) + 1) % ring.shape[0]
    new = ring[head]
    row.head = head
    row.filled = min(row.filled + 1.0, 1.0 * ring.shape[0])
    for side in range(2):
        new.d[side] = old.d[side] + way.d[side]
        new.c[side] = old.c[side] + way.c[side]
        new.s[side] = old.s[side] + way.s[side]
        new.belt[side] = way.belt[side]


@formula
def since(row, ring, steps):
    """Way since `steps` steps ago, at most as far back as the ring reaches; 0 gives zero sums and
    the present belt speeds."""
    head, slots = int(row.head), ring.shape[0]
    reach = max(row.filled - 1.0, 0.0)
    back = int(min(max(steps, 0.0), reach))
    more = int(min(max(steps, 0.0) + 1.0, reach))
    now, then = ring[head], ring[(head - back + slots) % slots]
    earlier = ring[(head - more + slots) % slots]
    return Way(
        (now.d[0] - then.d[0], now.d[1] - then.d[1]),
        (now.c[0] - then.c[0], now.c[1] - then.c[1]),
        (now.s[0] - then.s[0], now.s[1] - then.s[1]),
        (then.belt[0], then.belt[1]),
        (earlier.belt[0], earlier.belt[1]),
    )


@formula
def ramp(speed, standing):
    """0 [-] below the speed `standing`, 1 from twice that speed on, linear between."""
    return min(max(abs(speed) / standing - 1.0, 0.0), 1.0)


@formula
def make_inputs(last, belts, x, incline, pitch_rate, common, k):
    """Inputs of a step in which the belts (left, right) went from `last` to `belts` [m/s], with the
    slips and side slip of the state x."""
    slip, side_slip = (x[SLIP_LEFT], x[SLIP_RIGHT]), x[SIDE_SLIP]
    ahead, _ = on_map(1.0, 0.0, incline)
    cross, aside = on_map(0.0, 1.0, incline)
    turn, carried = heading_rate(incline, pitch_rate)
    left, right = 0.5 * (last[0] + belts[0]), 0.5 * (last[1] + belts[1])
    forward = 0.5 * (left + right)
    direction = (1.0 if left >= 0.0 else -1.0, 1.0 if right >= 0.0 else -1.0)
    gain = (
        track_speed_from_belt(1.0, direction[0] * slip[0]),
        track_speed_from_belt(1.0, direction[1] * slip[1]),
    )
    fade = (ramp(left, k.standing_belt), ramp(right, k.standing_belt))
    fade_side = ramp(forward, max(STANDING_VEHICLE, k.standing_belt))
    steep = incline.down_x * incline.down_x + incline.down_y * incline.down_y
    return Inputs(
        (left, right), direction, slip, side_slip, fade, fade_side, gain, ahead, cross, aside,
        turn, carried, steep, incline.press, common,
    )  # fmt: skip


@formula
def gains(slip_left, slip_right, side_slip, u):
    """(g_L, g_R, tan alpha) [-] of a sigma point, its deviations faded."""
    left = u.slip[0] + u.fade[0] * (slip_left - u.slip[0])
    right = u.slip[1] + u.fade[1] * (slip_right - u.slip[1])
    angle = u.side_slip + u.fade_side * (side_slip - u.side_slip)
    c, s = rotation(min(max(angle, -SIDE_SLIP_MODELLED), SIDE_SLIP_MODELLED))
    return (
        track_speed_from_belt(1.0, u.direction[0] * left),
        track_speed_from_belt(1.0, u.direction[1] * right),
        s / c,
    )


@formula
def body_velocity(left, right, belt, tangent, k):
    """(v_x, v_y [m/s], w [rad/s]) from the gains and belt speeds of both tracks."""
    v_left, v_right = left * belt[0], right * belt[1]
    forward = 0.5 * (v_left + v_right)
    return forward, tangent * forward, (v_right - v_left) * k.inverse_gauge


@formula
def process(state, u, k):
    """(X, Y, psi) one step after a state (6 numbers), of which the others stay."""
    x, y, yaw, slip_left, slip_right, side_slip = state
    left, right, tangent = gains(slip_left, slip_right, side_slip, u)
    forward, side, w = body_velocity(left, right, u.belt, tangent, k)
    v_x, v_y, rate = u.ahead * forward + u.cross * side, u.aside * side, u.turn * w + u.carried
    c, s = rotation(yaw + 0.5 * rate * k.period)
    return (
        x + k.period * (v_x * c - v_y * s),
        y + k.period * (v_x * s + v_y * c),
        yaw + k.period * rate,
    )


@formula
def measured(state, u, way, gyro, k):
    """z = (X, Y, psi, v_x, v_y, w) of a state (6 numbers): the pose group when `way` began, w when
    `gyro` began."""
    x, y, yaw, slip_left, slip_right, side_slip = state
    left, right, tangent = gains(slip_left, slip_right, side_slip, u)
    east = 0.5 * (left * way.c[0] + right * way.c[1])
    north = 0.5 * (left * way.s[0] + right * way.s[1])
    more_left, more_right = left - u.gain[0], right - u.gain[1]
    v_left = u.gain[0] * way.belt[0] + more_left * way.instrument[0]
    v_right = u.gain[1] * way.belt[1] + more_right * way.instrument[1]
    w_left = u.gain[0] * gyro.belt[0] + more_left * gyro.instrument[0]
    w_right = u.gain[1] * gyro.belt[1] + more_right * gyro.instrument[1]
    forward = 0.5 * (v_left + v_right)
    return (
        x - east + tangent * north,
        y - north - tangent * east,
        yaw - (right * way.d[1] - left * way.d[0]) * k.inverse_gauge,
        forward,
        tangent * forward,
        (w_right - w_left) * k.inverse_gauge,
    )


@formula
def instrument(earlier, belt, k):
    """`earlier`, unless the belt [m/s] has really changed since: then its noise matters less."""
    return earlier if abs(belt - earlier) < BELT_SIGMAS * math.sqrt(k.belt_variance) else belt


@formula
def step_way(yaw, belts, u, k):
    """Way of one step with heading `yaw` in its middle and these belts at its end."""
    c, s = rotation(yaw)
    c, s = u.ahead * c, u.ahead * s
    left, right = k.period * u.belt[0], k.period * u.belt[1]
    return Way(
        (u.turn * left, u.turn * right), (c * left, c * right), (s * left, s * right), belts, belts
    )


@formula
def fill_process_noise(noise, yaw, u, k):
    """Q of one step into noise (STATES, STATES)."""
    left, right, tangent = gains(u.slip[0], u.slip[1], u.side_slip, u)
    c, s = rotation(yaw)
    east, north = c - tangent * s, s + tangent * c
    sum_ = 0.25 * k.belt_variance * k.period * k.period * (left * left + right * right)
    turn = 0.5 * k.belt_variance * k.period * k.period * (right * right - left * left)
    turn *= k.inverse_gauge
    share = max(max(u.fade[0], u.fade[1]), STANDING_SHARE)
    noise[:, :] = 0.0
    noise[X, X] = sum_ * east * east + share * k.position_drift
    noise[Y, Y] = sum_ * north * north + share * k.position_drift
    noise[X, Y] = noise[Y, X] = sum_ * east * north
    noise[X, YAW] = noise[YAW, X] = turn * east
    noise[Y, YAW] = noise[YAW, Y] = turn * north
    noise[YAW, YAW] = 4.0 * sum_ * k.inverse_gauge * k.inverse_gauge + share * k.yaw_drift
    slip_drift = k.slip_drift + u.steep * k.period * SLOPE_SLIP_DRIFT**2
    side_slip_drift = k.side_slip_drift + u.steep * k.period * SLOPE_SIDE_SLIP_DRIFT**2
    if u.common >= 0.0:  # half of it is that of the difference, which walks as ever
        cross = min(u.fade[0], u.fade[1]) * (u.common - 0.5 * slip_drift)
        noise[SLIP_LEFT, SLIP_RIGHT] = noise[SLIP_RIGHT, SLIP_LEFT] = cross
        slip_drift = u.common + 0.5 * slip_drift
    noise[SLIP_LEFT, SLIP_LEFT] = u.fade[0] * slip_drift
    noise[SLIP_RIGHT, SLIP_RIGHT] = u.fade[1] * slip_drift
    noise[SIDE_SLIP, SIDE_SLIP] = u.fade_side * side_slip_drift


@formula
def fill_measurement_noise(noise, u, way, gyro, steps, k):
    """R of a sample that is `steps` steps old into noise (ROWS, ROWS)."""
    left, right, tangent = gains(u.slip[0], u.slip[1], u.side_slip, u)
    _v, _l, w = body_velocity(left, right, gyro.belt, tangent, k)
    forward = 0.25 * k.belt_variance * (left * left + right * right)
    turn = 0.5 * k.belt_variance * k.inverse_gauge * (right * right - left * left)
    spin = ICR_OFFSET * w * (1.0 - u.fade_side)
    noise[:, :] = 0.0
    noise[0, 0] = noise[1, 1] = k.position_variance + steps * k.position_drift
    noise[2, 2] = k.yaw_variance + steps * k.yaw_drift
    noise[3, 3] = k.velocity_variance + forward
    noise[4, 4] = k.velocity_variance + forward * tangent * tangent + spin * spin
    noise[3, 4] = noise[4, 3] = forward * tangent
    noise[5, 5] = k.yaw_rate_variance + 4.0 * forward * k.inverse_gauge * k.inverse_gauge
    noise[3, 5] = noise[5, 3] = turn
    noise[4, 5] = noise[5, 4] = turn * tangent


@formula
def largest_variance(state):
    """Bound of the variance of one state."""
    if state < YAW:
        return LARGEST_POSITION * LARGEST_POSITION
    if state == YAW:
        return LARGEST_YAW * LARGEST_YAW
    return SIDE_SLIP_VARIANCE if state == SIDE_SLIP else SLIP_VARIANCE


@formula
def factorise(a, root, size, scale):
    """Lower Cholesky factor of scale A into root; A's upper triangle is read. Returns False when A
    is not positive definite to rounding: root is then that of a matrix near."""
    definite = True
    for r in range(size):
        for c in range(r + 1):
            rest = scale * a[c, r]
            for m in range(c):
                rest -= root[r, m] * root[c, m]
            if r == c:
                least = LEAST_PIVOT * scale * abs(a[r, r])
                definite = definite and rest > least
                root[r, r] = math.sqrt(max(rest, least + 1e-300))
            else:
                root[r, c] = rest / root[c, c]
    return definite


@formula
def bound(p):
    """Covariance symmetric, its variances within their bounds: P <- D P D."""
    for a in range(STATES):
        p[a, a] += JITTER
        largest = largest_variance(a)
        if p[a, a] > largest:
            shrink = math.sqrt(largest / p[a, a])
            for b in range(a):
                p[b, a] *= shrink
            for b in range(a + 1, STATES):
                p[a, b] *= shrink
            p[a, a] = largest
    for a in range(STATES):
        for b in range(a):
            p[a, b] = p[b, a]


@formula
def inflate(p, error, pose_nis, nis, k):
    """Free the pose where the sample contradicts it, and the slips where the velocities do. error:
    of X, Y, psi. Without velocities the slips are freed in any case."""
    east, north, turn = error
    if pose_nis > POSE_GATE:
        p[X, X] += east * east
        p[Y, Y] += north * north
        p[YAW, YAW] += turn * turn
    if k.rows < ROWS or nis - pose_nis > POSE_GATE:
        p[SLIP_LEFT, SLIP_LEFT] += SLIP_VARIANCE
        p[SLIP_RIGHT, SLIP_RIGHT] += SLIP_VARIANCE
        p[SIDE_SLIP, SIDE_SLIP] += SIDE_SLIP_VARIANCE
    bound(p)


@formula
def information(p):
    """(smallest, largest) eigenvalue [-] of the information on slips and side slip."""
    s, t = 1.0 / (SLIP_VARIANCE), 1.0 / (SIDE_SLIP_VARIANCE)
    a, b, c = s * p[3, 3], s * p[4, 4], t * p[5, 5]
    cross = math.sqrt(s * t)
    d, e, f = s * p[3, 4], cross * p[4, 5], cross * p[3, 5]
    mean = (a + b + c) / 3.0
    off = d * d + e * e + f * f
    a, b, c = a - mean, b - mean, c - mean
    radius = math.sqrt((a * a + b * b + c * c + 2.0 * off) / 6.0)
    determinant = a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f)
    shape = 0.5 * determinant / max(radius * radius * radius, 1e-300)
    angle = math.acos(min(max(shape, -1.0), 1.0)) / 3.0
    most = mean + 2.0 * radius * math.cos(angle)
    least = mean + 2.0 * radius * math.cos(angle + 2.0 * math.pi / 3.0)
    largest = 1.0 / max(least, 1e-15) - 1.0
    return max(1.0 / max(most, 1e-15) - 1.0, 0.0), max(largest, 0.0)
