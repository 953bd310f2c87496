"""Feedback linearization with dynamic extension for the torque-driven tracked vehicle.

Output: point D on the vehicle's axis, d ahead of the centre of mass, S (30). With h the heading,
e = (cos h, sin h), n its left normal, w the yaw rate, v_1 the forward speed, xi the compensator
and sigma = v_y + d w the lateral speed of D (body axes):
    z'   = v_1 e + sigma n                                               (32a, any v_y)
    z''  = (xi - w sigma) e + v_1 w n                                    (32b)
    z''' = (eta_1 - v_1 w^2 - sigma u_2) e + (v_1 u_2 + 2 xi w - w^2 sigma) n      (32c)
    r    = z_d''' + k_a (z_d'' - z'') + k_v (z_d' - z') + k_p e + k_i j    (35)
    e    = (z_d - z) / sqrt(1 + |z_d - z|^2 / b^2),   j' = e (body axes);  S: e = z_d - z, k_i = 0
    xi'  = eta_1 = r_e + v_1 w^2 + sigma u_2,   u_1 = xi                 (34)
    u_2  = (r_n - 2 xi w + w^2 sigma) / v_1                              (34)
The demand is the path point plus the arm along the heading that the vehicle must have there,
    z_d = p + d e(psi + delta),   sin(delta) = -v_y / v,
so that the centre of mass, not D, runs on the path. Torques from u_1, u_2: S (29), corrected.
On a slope all of this holds in the vehicle's plane, onto which z_d is lifted, and
    m u_1 = F - R + m g s_p + m w v_y,   F_y(v_y, w) = m (w v + g c_p s_r),   N = m g c_p c_r
with the pitch p (nose down) and the roll r that are measured; N is the load of R and F_y.
Derivations, choices and limits: docs/controller.md. S is written with sigma = 0.

Assumptions: parameters of the nominal model are right; v_y and sigma are those of a steady turn
along the reference (the measured v_y is noisier than it is informative); motor lag ignored; on a
slope that the ground is a plane as long as the tracks, and its normal the vehicle's up axis.
Validity: |v_1| > MINIMUM_SPEED; slower, the steering demand fades out.

References: [S] Strawa et al., Electronics 10 (2021) 187, section 6.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics import lumped as vehicle
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign, signed
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import PlantParameters
from tracked_env.physics.rigid_body import in_plane_above

MINIMUM_SPEED = 0.1  # [m/s] below it 1 / v_1 fades to 0; three sigma of a 0.03 m/s sensor
PROBE_SPEED = 1e-3  # [m/s] lateral speed at which the slope of the friction is taken
# Below both the soil is left to hold the heading: the demand is rounding (1 um off the path), and
# its sign means nothing.
RESTING_YAW_RATE = 1e-5  # [rad/s]
RESTING_YAW_ACCELERATION = 2e-5  # [rad/s^2]
TRACTION = 0.995  # [-] share of F_limit to be used: at all of it a belt slips by i = 1
TURN_BEHIND = 0.3  # [rad] heading error from which on steering may come before speed
LEAST_TURNING_SPEED = 0.8  # [m/s] slower, the sum of the efforts always comes first
RESERVE_SPEED = 1.0  # [m/s] that steering may take off the speed where traction is short of both
RESERVE_YAW_RATE = 1.0  # [rad/s] at least, of the turn that is to be carried: all of its friction
RESERVED_YAW_ACCELERATION = 2.0  # [rad/s^2] that the reserve gives
MAXIMUM_SIDE_SLIP = 0.5  # [-] |sin(delta)| is bounded here: 30 deg, the vehicle drifts


# The vehicle of the tuned gains: those of another one are in units of its length and of the time in
# which its drives answer.
TUNED_LENGTH = 2.0  # [m] contact length l
TUNED_LAG = 0.05  # [s] lag of the drives
LAG_EXPONENT = 0.4  # [-] times grow as this power of the lag: between 0.3 and 0.4 nothing changes


class Gains(NamedTuple):
    """Gains of (35); errors far below the bound obey s^3 + k_a s^2 + k_v s + k_p + k_i / s = 0."""

    k_p: float = 50.0  # [1/s^3]
    k_v: float = 70.0  # [1/s^2]
    k_a: float = 15.0  # [1/s]
    bound: float = math.inf  # [m] b, what the law sees of a position error at most
    k_i: float = 0.0  # [1/s^4] 0: no integral action

    def poles(self) -> NDArray[np.complex128]:
        """Poles [1/s] of the error dynamics, slowest first: (3,), or (4,) with integral action."""
        coefficients = [1.0, self.k_a, self.k_v, self.k_p]
        if self.k_i > 0.0:
            coefficients.append(self.k_i)
        roots = np.roots(coefficients).astype(np.complex128)
        return roots[np.argsort(-roots.real)]

    def for_vehicle(self, p: PlantParameters) -> "Gains":
        """Those of a vehicle of another size, whose drives answer later: poles slower by
        (lag / TUNED_LAG)^LAG_EXPONENT, the bound in proportion to the contact length."""
        time = max(p.drive_time_constant / TUNED_LAG, 1.0) ** LAG_EXPONENT
        size = p.contact_length / TUNED_LENGTH
        gains = self.k_p / time**3, self.k_v / time**2, self.k_a / time
        return Gains(*gains, self.bound * size, self.k_i / time**4)


# Of the controllers of the benchmark; those of S are the defaults of Gains. docs/tuning.md
TUNED_GAINS = Gains(130.0, 84.0, 13.0, 0.5)
TUNABLE = {  # lowest, highest, whether on a logarithmic scale
    "k_p": (40.0, 400.0, True),
    "k_v": (30.0, 200.0, True),
    "k_a": (6.0, 40.0, True),
    "bound": (0.1, 2.0, True),
}


def checked_gains(gains: Gains) -> Gains:
    """The gains as floats. Raises ValueError for those with which the tracking error grows."""
    gains = Gains(*(float(gain) for gain in gains))
    k_p, k_v, k_a, bound, k_i = gains
    if not (all(0.0 < gain < math.inf for gain in (k_p, k_v, k_a)) and bound > 0.0):
        raise ValueError(f"{gains}: all gains must be positive, and finite but for the bound")
    if k_a * k_v <= k_p:
        raise ValueError(
            f"{gains}: k_a k_v = {k_a * k_v:g} must exceed k_p = {k_p:g}, or the "
            "tracking error grows (not Hurwitz). Did you change the order of the gains?"
        )
    most = k_p * (k_a * k_v - k_p) / (k_a * k_a)
    if not 0.0 <= k_i < most:
        raise ValueError(
            f"{gains}: k_i = {k_i:g} 1/s^4; must be in [0, {most:g}), below k_p (k_a k_v - k_p) / "
            "k_a^2, or the tracking error grows (not Hurwitz). Is the integral action too strong?"
        )
    return gains


class Integral(NamedTuple):
    """Time integral of the bounded position error in body axes."""

    x: float  # [m s]
    y: float  # [m s]


class Reference(NamedTuple):
    """Motion of the path point: signed speed along the heading, and the heading's rates."""

    speed: float  # [m/s] v
    acceleration: float  # [m/s^2] dv/dt
    jerk: float  # [m/s^3] d2v/dt2
    yaw_rate: float  # [rad/s] w
    yaw_acceleration: float  # [rad/s^2] dw/dt


class Demand(NamedTuple):
    """Demanded motion of D relative to the vehicle, in measured body axes."""

    error_x: float  # [m] z_d - z
    error_y: float  # [m]
    velocity_x: float  # [m/s] z_d'
    velocity_y: float  # [m/s]
    acceleration_x: float  # [m/s^2] z_d''
    acceleration_y: float  # [m/s^2]
    jerk_x: float  # [m/s^3] z_d'''
    jerk_y: float  # [m/s^3]


@formula
def inverse_speed(speed):
    """1 / v [s/m], exact for |v| >= MINIMUM_SPEED, below it x (2 - x^2) / MINIMUM_SPEED with
    x = v / MINIMUM_SPEED: odd, continuously differentiable, 0 at standstill."""
    x = speed / MINIMUM_SPEED
    slow = x * (2.0 - x * x) / MINIMUM_SPEED
    return 1.0 / speed if abs(x) >= 1.0 else slow


@formula
def pressed(k, press):
    """Coefficients whose resistances are those of a normal load of `press` times the weight."""
    inertial = k.inverse_mass, k.inverse_inertia
    lengths = k.half_gauge, k.contact_length, k.inverse_radius
    loads = k.resistance * press, k.friction_intensity * press
    rest = k.turning_resistance_factor, k.icr_forward
    return vehicle.Coefficients(*inertial, *lengths, *loads, *rest)


@formula
def lifted(demand, incline):
    """A demand given on the map, in the vehicle's plane above it."""
    return Demand(
        *in_plane_above(demand.error_x, demand.error_y, incline),
        *in_plane_above(demand.velocity_x, demand.velocity_y, incline),
        *in_plane_above(demand.acceleration_x, demand.acceleration_y, incline),
        *in_plane_above(demand.jerk_x, demand.jerk_y, incline),
    )


@formula
def steady_lateral_velocity(speed, yaw_rate, k, pull=0.0, ahead=0.0):
    """v_y [m/s] at which the soil carries a steady turn: F_y(v_y, w) = m (w v - pull), `sliding`.

    pull [m/s^2]: gravity along the body's y axis; its share, m pull |w| / (2 q), is that of
    friction without regularisation, with which a straight path across it would drift. ahead [m]: of
    the centre of mass before the middle of the contact, v_y = v_y(middle) + ahead w. By the slope
    F_y / v_y at PROBE_SPEED (relative error 1e-3 up to 0.9 mu_t g, for mu_t >= 0.4). Without pull
    odd in w and in v; bounded by MAXIMUM_SIDE_SLIP |v| where friction cannot carry it.
    """
    force, _moment = soil.lateral_friction(
        PROBE_SPEED, yaw_rate, k.friction_intensity, k.contact_length
    )
    bound = MAXIMUM_SIDE_SLIP * abs(speed)
    v_y = speed * yaw_rate / k.inverse_mass * PROBE_SPEED / min(force, -1e-9)
    v_y += pull * abs(yaw_rate) / (2.0 * k.inverse_mass * max(k.friction_intensity, 1e-9))
    v_y += ahead * yaw_rate
    return min(max(v_y, -bound), bound)


@formula
def demanded_motion(error_x, error_y, heading_error, ref, v_y, d, constrained):
    """Demand on D from the path point, its derivatives and the steady v_y [m/s].

    error_* [m] and heading_error [rad] as observed; d [m]. The heading to come is
    psi + delta; its rates are w + delta', w' and 0 (what is dropped: docs/controller.md).
    """
    v, a, w = ref.speed, ref.acceleration, ref.yaw_rate
    inverse = inverse_speed(v)
    sine = min(max(-v_y * inverse, -MAXIMUM_SIDE_SLIP), MAXIMUM_SIDE_SLIP)
    cosine = math.sqrt(1.0 - sine * sine)
    slip_rate = (d * ref.yaw_acceleration - sine * a) * inverse / cosine
    rate = w + (slip_rate if constrained else 0.0)
    c, s = math.cos(heading_error), math.sin(heading_error)
    arm_c, arm_s = d * (c * cosine - s * sine), d * (s * cosine + c * sine)
    along = ref.jerk - v * w * w
    across = 2.0 * a * w + v * ref.yaw_acceleration
    square, bend = rate * rate, ref.yaw_acceleration
    twist = 3.0 * rate * bend
    return Demand(
        error_x + arm_c - d,
        error_y + arm_s,
        v * c - rate * arm_s,
        v * s + rate * arm_c,
        a * c - v * w * s - bend * arm_s - square * arm_c,
        a * s + v * w * c + bend * arm_c - square * arm_s,
        along * c - across * s + rate * square * arm_s - twist * arm_c,
        along * s + across * c - rate * square * arm_c - twist * arm_s,
    )


@formula
def bounded_error(demand, bound):
    """Position error (x, y) [m] that the law sees: shorter than `bound` [m], direction kept.

    e / sqrt(1 + |e|^2 / b^2): smooth, odd, e itself for small errors and for an infinite bound.
    """
    x, y = demand.error_x / bound, demand.error_y / bound
    share = 1.0 / math.sqrt(1.0 + x * x + y * y)
    return demand.error_x * share, demand.error_y * share


@formula
def integrated(integral, error_x, error_y, short_x, short_y, period):
    """Integral after `period` [s], held where the drives cannot give what it asks for.

    error_* [m]: bounded. short_*: what the limits took off the demands along the two axes, in
    any unit; an error that would deepen the shortage is not integrated.
    """
    x = 0.0 if short_x * error_x > 0.0 else error_x
    y = 0.0 if short_y * error_y > 0.0 else error_y
    return Integral(integral.x + period * x, integral.y + period * y)


@formula
def linearizing_inputs(demand, v_x, yaw_rate, sigma, xi, gains, integral):
    """(eta_1 [m/s^3], u_2 [rad/s^2]) from (34) and (35), sigma [m/s], xi [m/s^2]."""
    error_x, error_y = bounded_error(demand, gains.bound)
    r_x = (
        demand.jerk_x
        + gains.k_a * (demand.acceleration_x - (xi - yaw_rate * sigma))
        + gains.k_v * (demand.velocity_x - v_x)
        + gains.k_p * error_x
        + gains.k_i * integral.x
    )
    r_y = (
        demand.jerk_y
        + gains.k_a * (demand.acceleration_y - v_x * yaw_rate)
        + gains.k_v * (demand.velocity_y - sigma)
        + gains.k_p * error_y
        + gains.k_i * integral.y
    )
    turn = yaw_rate * (yaw_rate * sigma - 2.0 * xi)
    u_2 = (r_y + turn) * inverse_speed(v_x)
    return r_x + v_x * yaw_rate * yaw_rate + sigma * u_2, u_2


@formula
def against_resistance(net, speed, magnitude, inverse_width):
    """Load F with F - terramechanics.resisting(speed, F, ...) = net: its exact inverse.

    net, magnitude [N or N m], speed [m/s or rad/s]. Odd in (net, speed). At standstill the
    load jumps by 2 magnitude at net = 0, where it is 0: held friction is overcome at once.
    """
    s = saturated_sign(speed, inverse_width)
    side = s if s != 0.0 else net
    share = abs(s)
    n = signed(net, side)
    slow = max(n / max(share, 1e-300), n - 2.0 * magnitude * (1.0 - share))
    load = magnitude + (n if n >= 0.0 else slow)
    return signed(load, side) if side != 0.0 else 0.0


@formula
def turning_moment(motion, u_2, p, k, constrained):
    """Moment [N m] the tracks must give for the yaw acceleration u_2 [rad/s^2]."""
    if not constrained:
        _force, moment = soil.lateral_friction(
            motion.v_y, motion.yaw_rate, k.friction_intensity, k.contact_length
        )
        return p.inertia * u_2 - k.turning_resistance_factor * moment
    d = k.icr_forward
    none = vehicle.TractionLimits(0.0, 0.0, 0.0, 0.0)
    loads = vehicle.constrained_loads(motion, 0.0, 0.0, k, none)
    turning = vehicle.Motion(0.0, 0.0, 2.0 * soil.YAW_FRICTION_REGULARISATION)
    magnitude = -vehicle.constrained_loads(turning, 0.0, 0.0, k, none).turning_moment
    inertial = u_2 / k.inverse_inertia - d * motion.yaw_rate * motion.v_x / k.inverse_mass
    if abs(motion.yaw_rate) < RESTING_YAW_RATE and abs(u_2) < RESTING_YAW_ACCELERATION:
        return 0.0
    net, inverse_width = inertial + d * loads.lateral_force, 1.0 / soil.YAW_FRICTION_REGULARISATION
    return against_resistance(net, motion.yaw_rate, magnitude, inverse_width)


@formula
def track_efforts(motion, u_1, u_2, p, k, constrained, pull=0.0):
    """Tractive efforts (left, right) [N] for u_1 [m/s^2] and u_2: S (29), corrected.

    pull [m/s^2]: gravity along the body's x axis, 0 on level ground.
    """
    force = (u_1 - motion.yaw_rate * motion.v_y - pull) / k.inverse_mass
    turn = 0.5 * turning_moment(motion, u_2, p, k, constrained) / k.half_gauge
    left, right = vehicle.track_speeds(motion, k.half_gauge)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    return (
        against_resistance(0.5 * force - turn, left, k.resistance, inverse_width),
        against_resistance(0.5 * force + turn, right, k.resistance, inverse_width),
    )


@formula
def turns_first(turning, speed, heading_error, demand, gains):
    """1.0 while steering comes before the sum of the efforts, else 0.0; `turning`: what it was.

    It does from the speed on that the law demands, until RESERVE_SPEED of it is lost: a turn that
    the soil does not carry at constant speed is driven by turns, accelerate and brake in the turn.
    """
    if abs(heading_error) < TURN_BEHIND:
        return 0.0
    error_x, _error_y = bounded_error(demand, gains.bound)
    demanded = demand.velocity_x + gains.k_p / gains.k_v * error_x
    excess = abs(speed) - max(signed(demanded, demanded * speed), LEAST_TURNING_SPEED)
    if excess >= 0.0:
        return 1.0
    return turning if excess > -RESERVE_SPEED else 0.0


@formula
def turning_reserve(motion, u_2, p, k, constrained, limit):
    """Half the difference of the efforts [N] that turns the vehicle towards the demand u_2 by
    RESERVED_YAW_ACCELERATION, against the friction of a turn.

    0 where a track carries a steady turn at constant speed within its `limit` [N].
    """
    rate = signed(max(abs(motion.yaw_rate), RESERVE_YAW_RATE), u_2)
    turning = vehicle.Motion(motion.v_x, motion.v_y, rate)
    steady = abs(turning_moment(turning, 0.0, p, k, constrained))
    if 0.5 * steady / k.half_gauge + k.resistance <= limit:
        return 0.0
    return 0.5 * (steady + p.inertia * RESERVED_YAW_ACCELERATION) / k.half_gauge


@formula
def within_limits(left, right, limit_left, limit_right, reserve=0.0):
    """Efforts (left, right) within +-limits [N]: the sum is kept first, then the difference.

    In this order a large steering demand cannot take the speed away on which steering rests. Of
    the difference, half of which is demanded, as much as `reserve` [N] comes before the sum.
    """
    both = 0.5 * (limit_left + limit_right)
    mean = min(max(0.5 * (left + right), -both), both)
    turn = 0.5 * (right - left)
    reserved = min(abs(turn), reserve, both)
    if reserved > 0.0:
        slower, faster = (limit_left, limit_right) if turn > 0.0 else (limit_right, limit_left)
        mean = min(max(mean, reserved - slower), faster - reserved)
    low = max(mean - limit_left, -limit_right - mean)
    high = min(mean + limit_left, limit_right - mean)
    turn = min(max(turn, low), high)
    return mean - turn, mean + turn
