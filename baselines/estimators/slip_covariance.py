"""Covariances of the slip observer: process noise Q, measurement noise R, P within its bounds.

Noise of the belts s = r sigma_omega enters z and X, Y, psi, beside that of the other sensors:
    R += s^2 J J^T,  J = d(v_x, v_y, w)/d(V_tL, V_tR);     Q += s^2 dt^2 G G^T likewise
Process noise fades out with the belt speed, as the deviations of slip_kinematics do.
Information on s = (i_L, i_R, alpha): eigenvalues of D P_s^-1 D - 1, D the prior's sigmas.

References: [1] O. K. Smith, Comm. ACM 4 (1961) 168: eigenvalues of a symmetric 3 x 3 matrix.
"""

import math

from baselines.estimators.slip_kinematics import (
    PRIOR_SIDE_SLIP,
    PRIOR_SLIP,
    ROWS,
    SIDE_SLIP,
    SLIP_LEFT,
    SLIP_RIGHT,
    STATES,
    YAW,
    X,
    Y,
    body_velocity,
    gains,
)
from tracked_env.physics.elementary import rotation
from tracked_env.physics.jit import formula

# Times the sine of the tilt: a turn on a slope changes the force that the soil must carry, and so
# slips and alpha; a light vehicle on a slope of 0.2 then has a median NIS of 6, the expected one.
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


@formula
def fill_process_noise(noise, yaw, u, k):
    """Q of one step into noise (STATES, STATES)."""
    left, right, tangent = gains(u.slip_left, u.slip_right, u.side_slip, u)
    c, s = rotation(yaw)
    east, north = c - tangent * s, s + tangent * c
    sum_ = 0.25 * k.belt_variance * k.period * k.period * (left * left + right * right)
    turn = 0.5 * k.belt_variance * k.period * k.period * (right * right - left * left)
    turn *= k.inverse_gauge
    share = max(max(u.fade_left, u.fade_right), STANDING_SHARE)
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
        noise[SLIP_LEFT, SLIP_RIGHT] = min(u.fade_left, u.fade_right) * (
            u.common - 0.5 * slip_drift
        )
        noise[SLIP_RIGHT, SLIP_LEFT] = noise[SLIP_LEFT, SLIP_RIGHT]
        slip_drift = u.common + 0.5 * slip_drift
    noise[SLIP_LEFT, SLIP_LEFT] = u.fade_left * slip_drift
    noise[SLIP_RIGHT, SLIP_RIGHT] = u.fade_right * slip_drift
    noise[SIDE_SLIP, SIDE_SLIP] = u.fade_side * side_slip_drift


@formula
def fill_measurement_noise(noise, u, way, gyro, steps, k):
    """R of a sample that is `steps` steps old into noise (ROWS, ROWS)."""
    left, right, tangent = gains(u.slip_left, u.slip_right, u.side_slip, u)
    _v, _l, w = body_velocity(left, right, gyro.belt_left, gyro.belt_right, tangent, k)
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
    return PRIOR_SIDE_SLIP * PRIOR_SIDE_SLIP if state == SIDE_SLIP else PRIOR_SLIP * PRIOR_SLIP


@formula
def factorise(a, root, size, scale):
    """Lower Cholesky factor of scale A into root; A's upper triangle is read.

    Returns False when A is not positive definite to rounding: root is then that of a matrix near.
    """
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
def inflate(p, east, north, turn, pose_nis, nis, k):
    """Free the pose where the sample contradicts it, and the slips where the velocities do.

    Without velocities the slips are freed in any case.
    """
    if pose_nis > POSE_GATE:
        p[X, X] += east * east
        p[Y, Y] += north * north
        p[YAW, YAW] += turn * turn
    if k.rows < ROWS or nis - pose_nis > POSE_GATE:
        p[SLIP_LEFT, SLIP_LEFT] += PRIOR_SLIP * PRIOR_SLIP
        p[SLIP_RIGHT, SLIP_RIGHT] += PRIOR_SLIP * PRIOR_SLIP
        p[SIDE_SLIP, SIDE_SLIP] += PRIOR_SIDE_SLIP * PRIOR_SIDE_SLIP
    bound(p)


@formula
def information(p):
    """(smallest, largest) eigenvalue [-] of the information on slips and side slip."""
    s, t = 1.0 / (PRIOR_SLIP * PRIOR_SLIP), 1.0 / (PRIOR_SIDE_SLIP * PRIOR_SIDE_SLIP)
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
