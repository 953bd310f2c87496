"""Lyapunov tracking laws for a vehicle driven by its two belts: unicycle and slippage-aware.

F writes the error e = (x - x_d, y - y_d, yaw - yaw_d) in the world and with polar angles psi.
Here e_x, e_y are body components and e_h = h - h_d with h = yaw, h_d = yaw_d. The motion points
along h + alpha (alpha: lateral slip angle). In axes along and across it
    a = e_x cos(alpha) + e_y sin(alpha),    n = e_y cos(alpha) - e_x sin(alpha)
and with eps = alpha + e_h, and e_xy the distance,
    e_xy sin(psi - (alpha + h + h_d) / 2) = n cos(eps / 2) + a sin(eps / 2) = q.
Heading and world axes have dropped out, and the laws become
    UC   v = v_d - k_p e_x,      w = w_d - k_y v_d q / cos(e_h / 2) - k_phi sin(e_h)  alpha = 0
    SLC  v = (v_d - k_p a) cos(alpha)                                               (44), (47)
         w = w_d - k_y v_d q / cos(eps / 2) - k_phi sin(e_h + alpha_d) - alpha_d'
         V = K L^2 (c - 1) + 1 - cos(e_h + alpha_d),   c = sqrt(1 + (e_x^2 + e_y^2) / L^2)   (45)
         V' = -k_y k_p a^2 - k_phi sin(e_h + alpha_d)^2
              + k_y v_d q (sin(eps) - sin(e_h + alpha_d)) / cos(eps / 2),     k_y = K / c
F has K = 1 / m^2 and no L, V = (e_x^2 + e_y^2) / 2 + ..; the proof holds for all K, L > 0. An error
of the slip angle leaves k_phi / (K v_d) times that error as an offset: 10 cm for 0.03 rad with the
gains of F at 0.3 m/s. Far from the path L keeps the demanded yaw rate within about K L v_d.
The last term, missing in (48), vanishes for alpha = alpha_d only; it is at most about
|k_y v_d q (alpha - alpha_d)|: an error of the slip model costs accuracy, a large one convergence.

The model behind the laws is pseudo-kinematic: a unicycle whose belts slip and which drifts,
    x'   = v_x / cos(alpha) cos(yaw + alpha) = v_x (cos(yaw) - tan(alpha) sin(yaw))   (27)
    y'   = v_x / cos(alpha) sin(yaw + alpha) = v_x (sin(yaw) + tan(alpha) cos(yaw))
    yaw' = w
    v_x  = (r omega_L - beta_L + r omega_R - beta_R) / 2                              (29)
    w    = (r omega_R - beta_R - r omega_L + beta_L) / B
Slip velocity beta = r omega - v_track [m/s] is positive when driving; (29) and (31) of F print
the opposite sign. alpha = atan(v_y / v_x) [rad], for both directions of v_x, so it is negative
in a left turn driving forward, and changes sign with both sprocket speeds.
A slip model gives beta_L, beta_R and alpha from the two sprocket speeds, (32) and (33).

Within a step the sprocket speeds are held. Then yaw is linear in time, and fourth-order
Runge-Kutta is Simpson's rule for the position.

Assumptions: the slip is in steady state, without inertia; belts follow their demand. Validity:
|alpha| < pi / 2; |eps| up to 2 arccos(HALF_COSINE_FLOOR), beyond which v_d q is no longer cancelled
(no bounded yaw rate can).

References: [F] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025), sections 3.2 and 5.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from baselines.batch_policy import check_columns, parameter_rows
from baselines.slip.slip_models import Array, NoSlip, SlipModel
from tracked_env.physics.elementary import rotation, wrap_angle
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import VEHICLES, PlantParameters, top_speed

HALF_COSINE_FLOOR = 0.25  # [-] cos(eps / 2) there: 151 deg; the gain 1 / cos stays below 4.4
MAXIMUM_SLIP_ANGLE = 1.0  # [rad] |alpha| is bounded here: cos(alpha) stays away from 0
SLOW = 0.05  # [m/s] below this speed alpha fades out: at standstill it has no sign and no use
TUNED_FOR = VEHICLES["focchi"]  # the vehicle of the registered gains
LAG, LAG_EXPONENT = 0.05, 0.4  # [s], [-] of drives, from which on gains are lower, and how much
DRIFT_TIME = 1.0  # [s] over which an error of dead reckoning keeps its sign


class LyapunovGains(NamedTuple):
    """Gains of (42) and (47); defaults of F 7.1."""

    k_p: float = 10.0  # [1/s] of the error along the motion
    k_phi: float = 1.0  # [rad/s] of the sine of the heading error
    k_y: float = 1.0  # [1/m^2] K, weight of distances in V against angles
    reach: float = math.inf  # [m] L, beyond it V grows with the distance, not with its square

    def for_vehicle(self, p: PlantParameters) -> "LyapunovGains":
        """Those of a vehicle of another size than TUNED_FOR, for which they are.

        Across the path s^2 + k_phi s + K v_d^2 = 0 keeps its poles where the speed is another, with
        lag both are slower; L keeps the largest yaw rate, K L v_d, in proportion to that of turns.
        """
        other = TUNED_FOR
        speed = top_speed(p) / top_speed(other)
        turn = min(speed * other.track_gauge / p.track_gauge, 1.0)
        time = max(p.drive_time_constant / LAG, 1.0) ** LAG_EXPONENT
        size = max(speed * turn * time, p.contact_length / other.contact_length)
        weight = self.k_y / (speed * time) ** 2
        return LyapunovGains(self.k_p / time, self.k_phi / time, weight, self.reach * size)


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
def slippage_aware_law(error, speed, yaw_rate, slip, gains):
    """BodyMotion demanded by (44), (47); speed v_d [m/s], yaw_rate w_d [rad/s], slip: Slip.

    No error: the reference itself. Odd in (e_y, e_h, w_d) to the left. Rests at no position error
    and e_h = -alpha_d.
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
def laws(error, reference, slip, gains, motion):
    """The law for N vehicles: error (N, 3), reference (N, 2) v_d and w_d, slip (N, 3);
    motion (N, 2) out: v_x and w. Rows as PoseError, Slip, BodyMotion."""
    for i in range(error.shape[0]):
        e = PoseError(error[i, 0], error[i, 1], error[i, 2])
        s = Slip(slip[i, 0], slip[i, 1], slip[i, 2])
        m = slippage_aware_law(e, reference[i, 0], reference[i, 1], s, gains)
        motion[i, 0], motion[i, 1] = m.speed, m.yaw_rate


@loop
def sprockets_for(motion, beta, half_gauge, radius, limit, sprockets):
    """Sprocket speeds (N, 2) [rad/s] out, left then right, within +-limit [rad/s].

    motion (N, 2), beta (N, 2) [m/s]; half_gauge, radius [m] and limit as in Geometry: of one
    vehicle, or of those whose rows come again and again.
    """
    for i in range(motion.shape[0]):
        at = i % radius.shape[0]
        demand, r = BodyMotion(motion[i, 0], motion[i, 1]), radius[at]
        left, right = belt_speeds(demand, beta[i, 0], beta[i, 1], half_gauge[at])
        sprockets[i, 0], sprockets[i, 1] = within_speed_limit(left / r, right / r, limit[at])


@formula
def lyapunov_value(error, reference_slip, gains):
    """V of (45), or of (38) for reference_slip = 0 [rad]; distances count by k_y and reach."""
    cosine, _sine = rotation(error.heading + reference_slip)
    square = error.x * error.x + error.y * error.y
    share = math.sqrt(1.0 + square / (gains.reach * gains.reach))
    return gains.k_y * square / (1.0 + share) + 1.0 - cosine


class Geometry(NamedTuple):
    """Lengths and limits of a vehicle for the kinematics, (N,) each, or (1,) for all alike."""

    half_gauge: Array  # [m] B / 2
    radius: Array  # [m] r
    limit: Array  # [rad/s] of a sprocket, both directions

    @classmethod
    def of(cls, parameters: PlantParameters) -> "Geometry":
        """From the parameters of a plant, each a number or (N,).

        Raises ValueError for a value outside its physical range, or lengths that disagree.
        """
        names = ("track_gauge", "sprocket_radius", "sprocket_speed_limit")
        gauge, radius, limit = parameter_rows({n: getattr(parameters, n) for n in names})
        return cls(0.5 * gauge, radius, limit)


@formula
def pose_rate(yaw, v_x, alpha):
    """World velocity (x', y') [m/s] of (27); v_x [m/s] signed, yaw and alpha [rad]."""
    cosine, sine = rotation(yaw)
    slip_cosine, slip_sine = rotation(alpha)
    v_y = v_x * slip_sine / slip_cosine
    return v_x * cosine - v_y * sine, v_x * sine + v_y * cosine


@formula
def pose_step(x, y, yaw, motion, alpha, duration):
    """Pose (x, y [m], yaw [rad]) after `duration` [s] of (27) at constant BodyMotion and alpha.

    One step of RK4; error v_x duration (w duration)^4 / 2880 [m].
    """
    turn = motion.yaw_rate * duration
    x_0, y_0 = pose_rate(yaw, motion.speed, alpha)
    x_1, y_1 = pose_rate(yaw + 0.5 * turn, motion.speed, alpha)
    x_2, y_2 = pose_rate(yaw + turn, motion.speed, alpha)
    sixth = duration / 6.0
    return x + sixth * (x_0 + 4.0 * x_1 + x_2), y + sixth * (y_0 + 4.0 * y_1 + y_2), yaw + turn


@formula
def carried(error, v_x, v_y, yaw_rate, speed, turn, duration):
    """PoseError after `duration` [s]: vehicle at (v_x, v_y [m/s], yaw_rate [rad/s]), reference
    at (speed, turn). Midpoint rule; position in the body axes of the end."""
    half = 0.5 * duration
    c, s = rotation(yaw_rate * half)
    c_h, s_h = rotation(error.heading + (yaw_rate - turn) * half)
    x = c * error.x + s * error.y + (v_x - speed * c_h) * duration
    y = c * error.y - s * error.x + (v_y + speed * s_h) * duration
    return PoseError(c * x + s * y, c * y - s * x, error.heading + (yaw_rate - turn) * duration)


def steady_gain(noise: float, rate_noise: float, drift: float, period: float) -> float:
    """Kalman gain K [-] for dead reckoning against samples of `noise`, in steady state.

    The rate has white noise `rate_noise` every `period` [s], and an error `drift` of both signs
    over DRIFT_TIME. 1 without noise: the sample is taken as it is.
    """
    if noise <= 0.0:
        return 1.0
    grown = (rate_noise * period) ** 2 + drift * drift * period * DRIFT_TIME
    ratio = grown / (noise * noise)
    return 0.5 * (math.sqrt(ratio * ratio + 4.0 * ratio) - ratio)


@formula
def faded(alpha, speed):
    """Slip angle [rad] to work with: bounded, smoothly 0 towards standstill, 0 for NaN."""
    x = min(abs(speed) / SLOW, 1.0)
    bounded = min(max(alpha, -MAXIMUM_SLIP_ANGLE), MAXIMUM_SLIP_ANGLE)
    return bounded * (x * x * (3.0 - 2.0 * x)) if alpha == alpha else 0.0


@loop
def step_all(pose, motion, alpha, duration):
    """`pose_step` of N vehicles: pose (N, 3) in and out, motion (N, 2), alpha (N,)."""
    for i in range(pose.shape[0]):
        m, (x, y, yaw) = BodyMotion(motion[i, 0], motion[i, 1]), pose[i, :3]
        pose[i, 0], pose[i, 1], pose[i, 2] = pose_step(x, y, yaw, m, alpha[i], duration)


@loop
def settle(sprockets, slip, half_gauge, radius, beta, alpha, motion):
    """What sprockets (N, 2) [rad/s] and a model's slip (N, 3) mean: (N, 2) beta, (N,) alpha faded,
    (N, 2) motion, all out; beta is 0 where the model knows none. Lengths as in `sprockets_for`."""
    for i in range(sprockets.shape[0]):
        at = i % radius.shape[0]
        for side in range(2):
            beta[i, side] = slip[i, side] if math.isfinite(slip[i, side]) else 0.0
        left, right = sprockets[i, 0] * radius[at], sprockets[i, 1] * radius[at]
        m = body_motion(left, right, beta[i, 0], beta[i, 1], half_gauge[at])
        motion[i, 0], motion[i, 1] = m.speed, m.yaw_rate
        alpha[i] = faded(slip[i, 2], m.speed)


@loop
def along_slip(reference, alpha, alpha_rate, motion):
    """BodyMotion (N, 2) of a vehicle on its path: v_d cos(alpha_d), w_d - alpha_d'."""
    for i in range(alpha.shape[0]):
        cosine, _sine = rotation(alpha[i])
        motion[i, 0] = reference[i, 0] * cosine
        motion[i, 1] = reference[i, 1] - alpha_rate[i]


class PseudoKinematicModel:
    """N vehicles that obey (27) and (29) with the slip of a model.

    parameters: track_gauge, sprocket_radius and sprocket_speed_limit are used. slip_model:
    None is a unicycle. Raises ValueError for parameters outside their physical range.
    """

    def __init__(self, parameters: PlantParameters, slip_model: SlipModel | None = None) -> None:
        self.geometry = Geometry.of(parameters)
        self.slip_model: SlipModel = NoSlip() if slip_model is None else slip_model

    def motion(self, sprockets: Array) -> tuple[Array, Array]:
        """Motion (N, 2) of v_x [m/s] and w [rad/s], and alpha (N,), at sprockets (N, 2)."""
        geometry = self.geometry
        check_columns(len(sprockets), len(geometry.radius))
        left, right, alpha = self.slip_model.slip(sprockets[:, 0], sprockets[:, 1])
        belts = sprockets * geometry.radius[:, None]
        motion = body_motion(*belts.T, left, right, geometry.half_gauge)
        return np.stack(motion, axis=1), alpha

    def step(self, pose: ArrayLike, sprockets: Array, duration: float) -> Array:
        """Pose (N, 3) after `duration` [s] at held sprocket speeds (N, 2) [rad/s].

        Raises ValueError for a duration that is not positive and finite.
        """
        if not 0.0 < duration < math.inf:
            raise ValueError(f"duration = {duration} s; must be positive. Is the step reversed?")
        after = np.array(pose, dtype=np.float64)
        motion, alpha = self.motion(sprockets)
        step_all(after, motion, alpha, duration)
        return after
