"""Lyapunov tracking laws for a vehicle driven by its two belts: unicycle and slippage-aware.

F writes the error e = (x - x_d, y - y_d, yaw - yaw_d) in the world and with polar angles psi.
Here e_x, e_y are body components, so with e_xy the distance and h = yaw, h_d = yaw_d
    e_x = e_xy cos(psi - h),    e_y = e_xy sin(psi - h),    e_h = h - h_d.
The motion points along h + alpha (alpha: lateral slip angle). In axes along and across it
    a = e_x cos(alpha) + e_y sin(alpha)   = e_xy cos(psi - h - alpha)
    n = e_y cos(alpha) - e_x sin(alpha)   = e_xy sin(psi - h - alpha)
and since psi - (alpha + h + h_d) / 2 = (psi - h - alpha) + eps / 2 with eps = alpha + e_h,
    e_xy sin(psi - (alpha + h + h_d) / 2) = n cos(eps / 2) + a sin(eps / 2) = q.
Heading and world axes have dropped out, and the laws become
    UC   v = v_d - k_p e_x,      w = w_d - k_y v_d q / cos(e_h / 2) - k_phi sin(e_h)  alpha = 0
    SLC  v = (v_d - k_p a) cos(alpha)                                               (44), (47)
         w = w_d - k_y v_d q / cos(eps / 2) - k_phi sin(e_h + alpha_d) - alpha_d'
         V = K L^2 (c - 1) + 1 - cos(e_h + alpha_d),   c = sqrt(1 + (e_x^2 + e_y^2) / L^2)   (45)
         V' = -k_y k_p a^2 - k_phi sin(e_h + alpha_d)^2
              + k_y v_d q (sin(eps) - sin(e_h + alpha_d)) / cos(eps / 2),     k_y = K / c
F has K = 1 / m^2 (a metre weighs as much as a radian) and no L, V = (e_x^2 + e_y^2) / 2 + ..; the
proof holds for all K, L > 0. Across the path, near it, the law is s^2 + k_phi s + K v_d^2 = 0, and
an error of the slip angle leaves k_phi / (K v_d) times that error as an offset: 10 cm for 0.03 rad
at 0.3 m/s with the gains of F, 0.75 cm with GAINS_ON_SLOPES. Far from the path L keeps the
demanded yaw rate within about K L v_d.
The last term is missing in (48): it vanishes for alpha = alpha_d only. It is at most about
|k_y v_d q (alpha - alpha_d)|, so a small error of the slip model costs accuracy; a large one
that grows with the speed can cost convergence.

Assumptions: the slip is in steady state; belts follow their demand. Validity: |eps| up to
2 arccos(HALF_COSINE_FLOOR); beyond, v_d q is no longer cancelled (no bounded yaw rate can).

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), section 5.
"""

import math
from typing import NamedTuple

from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, loop

HALF_COSINE_FLOOR = 0.25  # [-] cos(eps / 2) there: 151 deg; the gain 1 / cos stays below 4.4


class LyapunovGains(NamedTuple):
    """Gains of (42) and (47); defaults of F 7.1."""

    k_p: float = 10.0  # [1/s] of the error along the motion
    k_phi: float = 1.0  # [rad/s] of the sine of the heading error
    k_y: float = 1.0  # [1/m^2] K, weight of distances in V against angles
    reach: float = math.inf  # [m] L, beyond it V grows with the distance, not with its square


# Of the registered policies, chosen on development episodes (docs/tuning.md); on slopes, where the
# attitude is shown, of every policy.
GAINS_ON_FLOORS = LyapunovGains(k_p=5.0, k_phi=3.0, k_y=40.0, reach=0.04)
GAINS_ON_SLOPES = LyapunovGains(k_p=5.0, k_phi=3.0, k_y=40.0, reach=0.1)


TUNABLE = {  # lowest, highest, whether on a logarithmic scale
    "k_p": (1.0, 40.0, True),
    "k_phi": (0.3, 12.0, True),
    "k_y": (1.0, 200.0, True),
    "reach": (0.02, 2.0, True),
}


class PoseError(NamedTuple):
    """Vehicle minus reference, position in body axes."""

    x: float  # [m] e_x, the vehicle is ahead
    y: float  # [m] e_y, the vehicle is to the left
    heading: float  # [rad] e_h, the vehicle points to the left


class Slip(NamedTuple):
    """Lateral slip angle: of the vehicle now, and along the reference."""

    alpha: float  # [rad] atan(v_y / v_x) at the actual belt speeds
    reference: float  # [rad] alpha_d, at the desired belt speeds
    reference_rate: float  # [rad/s] alpha_d'


class BodyMotion(NamedTuple):
    """Motion of the body, demanded or actual."""

    speed: float  # [m/s] v_x, forward
    yaw_rate: float  # [rad/s] w, positive to the left


@formula
def inverse_half_cosine(cosine):
    """1 / c [-] of c = cos(eps / 2): exact for |c| >= HALF_COSINE_FLOOR, below it
    x (2 - x^2) / HALF_COSINE_FLOOR with x = c / HALF_COSINE_FLOOR.

    Odd and continuously differentiable; 0 at c = 0, where left and right are equally far.
    """
    x = cosine / HALF_COSINE_FLOOR
    return 1.0 / cosine if abs(x) >= 1.0 else x * (2.0 - x * x) / HALF_COSINE_FLOOR


@formula
def turn_towards(along, across, angle):
    """q / cos(angle / 2) [m]: the position error that steering is to remove.

    along, across [m]: error in axes of the motion; angle [rad]: motion minus reference heading.
    `across` for a small angle; periodic in the angle; bounded at pi.
    """
    cosine, sine = rotation(0.5 * wrap_angle(angle))
    return (across * cosine + along * sine) * inverse_half_cosine(cosine)


@formula
def distance_weight(x, y, gains):
    """k_y = K / c [1/m^2], twice the slope of V over the square of the distance; x, y [m]."""
    x, y = x / gains.reach, y / gains.reach
    return gains.k_y / math.sqrt(1.0 + x * x + y * y)


@formula
def unicycle_law(error, speed, yaw_rate, gains):
    """BodyMotion demanded by (40), (42), blind to slip; speed v_d [m/s], yaw_rate w_d [rad/s].

    error: PoseError. No error: the reference itself. Odd in (e_y, e_h, w_d) to the left.
    """
    _cosine, sine = rotation(error.heading)
    steering = speed * turn_towards(error.x, error.y, error.heading)
    steering *= distance_weight(error.x, error.y, gains)
    return BodyMotion(speed - gains.k_p * error.x, yaw_rate - steering - gains.k_phi * sine)


@formula
def slippage_aware_law(error, speed, yaw_rate, slip, gains):
    """BodyMotion demanded by (44), (47); speed v_d [m/s], yaw_rate w_d [rad/s], slip: Slip.

    No slip: the unicycle law, to the bit. Rests at no position error and e_h = -alpha_d.
    """
    cosine, sine = rotation(slip.alpha)
    along = error.x * cosine + error.y * sine
    across = error.y * cosine - error.x * sine
    steering = speed * turn_towards(along, across, error.heading + slip.alpha)
    steering *= distance_weight(error.x, error.y, gains)
    _cosine, heading = rotation(error.heading + slip.reference)
    return BodyMotion(
        (speed - gains.k_p * along) * cosine,
        yaw_rate - steering - gains.k_phi * heading - slip.reference_rate,
    )


@formula
def belt_speeds(motion, beta_left, beta_right, half_gauge):
    """Belt speeds (left, right) [m/s] for a BodyMotion: (29) inverted, r omega = v_track + beta.

    beta [m/s]: slip velocity of each track, positive when driving. half_gauge: B / 2 [m].
    """
    turn = half_gauge * motion.yaw_rate
    return motion.speed - turn + beta_left, motion.speed + turn + beta_right


@formula
def body_motion(left, right, beta_left, beta_right, half_gauge):
    """BodyMotion of belts at speeds (left, right) [m/s]: (29), (31), with the sign of beta that
    the text and the data of F have; what it prints is the opposite."""
    track_left, track_right = left - beta_left, right - beta_right
    return BodyMotion(
        0.5 * (track_left + track_right), (track_right - track_left) / (2.0 * half_gauge)
    )


@formula
def within_speed_limit(left, right, limit):
    """Belt speeds (left, right) within +-limit [same unit]: the turn is kept, speed gives way.

    While the limit leaves room for v_d, V' <= 0 still holds, since steering cancels a term of
    v_d and a shortened delta_v has the right sign. Scaling both would scale the steering too.
    """
    turn = min(max(0.5 * (right - left), -limit), limit)
    room = limit - abs(turn)
    mean = min(max(0.5 * (left + right), -room), room)
    return mean - turn, mean + turn


@loop
def laws(error, reference, slip, aware, gains, motion):
    """Either law for N vehicles: error (N, 3), reference (N, 2) v_d and w_d, slip (N, 3);
    motion (N, 2) out: v_x and w. Rows as PoseError, Slip, BodyMotion."""
    for i in range(error.shape[0]):
        e = PoseError(error[i, 0], error[i, 1], error[i, 2])
        if aware:
            s = Slip(slip[i, 0], slip[i, 1], slip[i, 2])
            m = slippage_aware_law(e, reference[i, 0], reference[i, 1], s, gains)
        else:
            m = unicycle_law(e, reference[i, 0], reference[i, 1], gains)
        motion[i, 0], motion[i, 1] = m.speed, m.yaw_rate


@loop
def sprockets_for(motion, beta, half_gauge, radius, limit, sprockets):
    """Sprocket speeds (N, 2) [rad/s] out, left then right, within +-limit [rad/s].

    motion (N, 2), beta (N, 2) [m/s]; half_gauge, radius [m] and limit: (N,) each.
    """
    for i in range(motion.shape[0]):
        left, right = belt_speeds(
            BodyMotion(motion[i, 0], motion[i, 1]), beta[i, 0], beta[i, 1], half_gauge[i]
        )
        sprockets[i, 0], sprockets[i, 1] = within_speed_limit(
            left / radius[i], right / radius[i], limit[i]
        )


@loop
def motions_of(sprockets, beta, half_gauge, radius, motion):
    """BodyMotion (N, 2) out of sprocket speeds (N, 2) [rad/s]; beta, B / 2, r as above."""
    for i in range(motion.shape[0]):
        r = radius[i]
        m = body_motion(
            sprockets[i, 0] * r, sprockets[i, 1] * r, beta[i, 0], beta[i, 1], half_gauge[i]
        )
        motion[i, 0], motion[i, 1] = m.speed, m.yaw_rate


@formula
def lyapunov_value(error, reference_slip, gains):
    """V of (45), or of (38) for reference_slip = 0 [rad]; distances count by k_y and reach."""
    cosine, _sine = rotation(error.heading + reference_slip)
    square = error.x * error.x + error.y * error.y
    share = math.sqrt(1.0 + square / (gains.reach * gains.reach))
    return gains.k_y * square / (1.0 + share) + 1.0 - cosine
