"""A skid-steering tracked vehicle driven by its sprocket torques: coefficients, forces, RK4 steps.

Equations (S = Strawa et al. 2021 section 4, in ISO axes; symbols in NOTATION.md):
    V_L, V_R = v_x -+ w B / 2                 speeds of the tracks over the ground
    m (dv_x/dt - w v_y) = F_L + F_R - R_L - R_R
    m (dv_y/dt + w v_x) = F_y
    I dw/dt             = (B/2) [(F_R - R_R) - (F_L - R_L)] + f M
    F_k                 = clip(torque_k / r, traction limits),   k = L, R
    dtorque/dt          = (g_k demand - torque) / T
    a                   = dv/dt + w x v       inertial acceleration, in body axes
`sliding` lateral model: as above, F_y and M from the sliding contact; x_ICR = -v_y / w emerges.
`constrained` lateral model: S (28), v_y = -d w holds at all times and F_y follows from it:
    m (dv_x/dt + d w^2)          = F_L + F_R - R_L - R_R
    (I + m d^2) dw/dt - m d w v_x = (B/2) [(F_R - R_R) - (F_L - R_L)] - (F_y d + M_r)
The velocities are integrated by fixed steps of the fourth-order Runge-Kutta method, the pose in the
frame of the step's start, where the rotation is small. The lag of the torque has an exact solution,
which is used at each stage.

Assumptions: planar motion, weight shared equally by the tracks, no track inertia, ideal
transmission, parameters constant over one control step, traction limits constant over one sub-step.
References: [1] Strawa et al., Electronics 10 (2021) 187. [2] Hairer, Norsett, Wanner, Solving
Ordinary Differential Equations I, II.1.
"""

from typing import NamedTuple

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import exponential, saturated_sign, small_rotation
from tracked_env.physics.jit import formula


class Coefficients(NamedTuple):
    """What the equations of motion need of the parameters, for one control step."""

    inverse_mass: float  # [1/kg]
    inverse_inertia: float  # [1/(kg m^2)] of yaw; about the ICR when constrained
    half_gauge: float  # [m] B/2
    contact_length: float  # [m] l
    inverse_radius: float  # [1/m] 1/r
    resistance: float  # [N] mu_l m g / 2, per track
    friction_intensity: float  # [N/m] q = mu_t m g / l, both tracks
    turning_resistance_factor: float  # [-] f
    icr_forward: float  # [m] d


class DriveLimits(NamedTuple):
    """What bounds and shapes the tractive effort of one track."""

    effort_maximum: float  # [N] F_max
    effort_limit: float  # [N] F_limit = F(i = 1)
    shear_length: float  # [-] l / K, shear ratio u at i = 1
    inverse_belt_limit: float  # [s/m] 1 / (r omega_max)


class Motion(NamedTuple):
    """Body velocities, the part of the state that carries the dynamics."""

    v_x: float  # [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # [rad/s]


class Loads(NamedTuple):
    """Forces on the vehicle in its body frame."""

    effort_left: float  # [N] F_L
    effort_right: float  # [N] F_R
    resistance_left: float  # [N] R_L, subtracted
    resistance_right: float  # [N] R_R, subtracted
    lateral_force: float  # [N] F_y
    turning_moment: float  # [N m] soil's moment about the centre of mass, added


class TractionLimits(NamedTuple):
    """Bounds of the tractive effort of both tracks, for one sub-step."""

    left_low: float  # [N]
    left_high: float  # [N]
    right_low: float  # [N]
    right_high: float  # [N]


@formula
def coefficients(p, constrained):
    """Coefficients of a control step from its parameters; `constrained` is a bool."""
    weight, d = p.mass * soil.GRAVITY, p.icr_forward
    inertia = p.inertia + (p.mass * d * d if constrained else 0.0)
    return Coefficients(
        inverse_mass=1.0 / p.mass,
        inverse_inertia=1.0 / inertia,
        half_gauge=0.5 * p.track_gauge,
        contact_length=p.contact_length,
        inverse_radius=1.0 / p.sprocket_radius,
        resistance=0.5 * p.longitudinal_resistance * weight,
        friction_intensity=p.lateral_resistance * weight / p.contact_length,
        turning_resistance_factor=p.turning_resistance_factor,
        icr_forward=d,
    )


@formula
def drive_limits(p):
    """DriveLimits from the parameters: S (2), and S (7) at i = 1. Needs a tangent: hoist it."""
    maximum = soil.maximum_tractive_effort(
        p.cohesion, p.friction_angle, p.track_width, p.contact_length, p.mass
    )
    maximum = max(maximum, soil.LEAST_EFFORT)
    shear_length = p.contact_length / p.shear_deformation_modulus
    limit = maximum * soil.mobilised_shear(shear_length)
    belt_limit = p.sprocket_radius * p.sprocket_speed_limit
    return DriveLimits(maximum, limit, shear_length, 1.0 / belt_limit)


@formula
def turning_effort(p):
    """Effort [N] of a track that turns the vehicle on the spot, against friction and resistance."""
    weight = p.mass * soil.GRAVITY
    moment = 0.25 * p.turning_resistance_factor * p.lateral_resistance * weight * p.contact_length
    return moment / p.track_gauge + 0.5 * p.longitudinal_resistance * weight


@formula
def track_speeds(motion, half_gauge):
    """Forward speed [m/s] of the left and the right track over the ground."""
    turn = motion.yaw_rate * half_gauge
    return motion.v_x - turn, motion.v_x + turn


@formula
def inertial_acceleration(motion, body_rate_x, body_rate_y):
    """Acceleration [m/s^2] of the centre of mass in body axes: dv/dt + w x v."""
    w = motion.yaw_rate
    return body_rate_x - w * motion.v_y, body_rate_y + w * motion.v_x


@formula
def torque_decay(duration, time_constant):
    """exp(-duration / T) [-]: what is left of the torque error after `duration` [s]."""
    return exponential(-duration / time_constant) if time_constant > 0.0 else 0.0


@formula
def track_limits(track_speed, drive):
    """(low, high) [N] of one track: driving up to the belt's top speed, braking to lock."""
    driving = soil.driving_effort_limit(
        track_speed, drive.inverse_belt_limit, drive.effort_maximum, drive.shear_length
    )
    low = -drive.effort_limit if track_speed >= 0.0 else -driving
    high = driving if track_speed >= 0.0 else drive.effort_limit
    return low, high


@formula
def traction_limits(motion, half_gauge, drive):
    """Traction limits of a sub-step that starts at `motion`."""
    left, right = track_speeds(motion, half_gauge)
    left_low, left_high = track_limits(left, drive)
    right_low, right_high = track_limits(right, drive)
    return TractionLimits(left_low, left_high, right_low, right_high)


@formula
def safe_effort(motion, effort, half_gauge, drive):
    """True when an effort of that size [N] is below every traction limit at `motion`.

    Uses u / (2 + u) <= mobilised_shear(u); the limit of a driven track falls with its speed and
    never exceeds that of a braked one.
    """
    fastest = abs(motion.v_x) + abs(motion.yaw_rate) * half_gauge
    slip = 1.0 - max(fastest, soil.STANDSTILL_SPEED) * drive.inverse_belt_limit
    u = max(slip, 0.0) * drive.shear_length
    return effort * (2.0 + u) < drive.effort_maximum * u


@formula
def _longitudinal(motion, torque_left, torque_right, k, limits):
    """Tractive efforts and motion resistances [N] of both tracks."""
    left, right = track_speeds(motion, k.half_gauge)
    effort_left = min(max(torque_left * k.inverse_radius, limits.left_low), limits.left_high)
    effort_right = min(max(torque_right * k.inverse_radius, limits.right_low), limits.right_high)
    inverse_width = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION
    resistance_left = soil.resisting(left, effort_left, k.resistance, inverse_width)
    resistance_right = soil.resisting(right, effort_right, k.resistance, inverse_width)
    return effort_left, effort_right, resistance_left, resistance_right


@formula
def sliding_loads(motion, torque_left, torque_right, k, limits):
    """Loads of the `sliding` lateral model; torques [N m] are those of the drives."""
    fl, fr, rl, rr = _longitudinal(motion, torque_left, torque_right, k, limits)
    force, moment = soil.lateral_friction(
        motion.v_y, motion.yaw_rate, k.friction_intensity, k.contact_length
    )
    return Loads(fl, fr, rl, rr, force, k.turning_resistance_factor * moment)


@formula
def constrained_loads(motion, torque_left, torque_right, k, limits):
    """Loads of the `constrained` lateral model: S 4.1.2 and S (20), (21) with x_ICR = d."""
    fl, fr, rl, rr = _longitudinal(motion, torque_left, torque_right, k, limits)
    length, d = k.contact_length, k.icr_forward
    inverse_width = 1.0 / soil.YAW_FRICTION_REGULARISATION
    sign = saturated_sign(motion.yaw_rate, inverse_width)
    force = 2.0 * k.friction_intensity * d * sign
    arm = max(0.25 * length * length - d * d, 0.0)
    magnitude = k.turning_resistance_factor * k.friction_intensity * arm
    applied = k.half_gauge * ((fr - rr) - (fl - rl))
    moment = soil.resisting(motion.yaw_rate, applied, magnitude, inverse_width)
    return Loads(fl, fr, rl, rr, force, -moment)


@formula
def sliding_accelerations(motion, torque_left, torque_right, k, limits):
    """(dv_x/dt, dv_y/dt, dw/dt) in body axes [m/s^2, m/s^2, rad/s^2], `sliding`."""
    f = sliding_loads(motion, torque_left, torque_right, k, limits)
    drive_left = f.effort_left - f.resistance_left
    drive_right = f.effort_right - f.resistance_right
    moment = k.half_gauge * (drive_right - drive_left) + f.turning_moment
    return (
        (drive_left + drive_right) * k.inverse_mass + motion.yaw_rate * motion.v_y,
        f.lateral_force * k.inverse_mass - motion.yaw_rate * motion.v_x,
        moment * k.inverse_inertia,
    )


@formula
def constrained_accelerations(motion, torque_left, torque_right, k, limits):
    """(dv_x/dt, dv_y/dt, dw/dt) in body axes, `constrained`: S (28) with v_y = -d w."""
    f = constrained_loads(motion, torque_left, torque_right, k, limits)
    drive_left = f.effort_left - f.resistance_left
    drive_right = f.effort_right - f.resistance_right
    d, w = k.icr_forward, motion.yaw_rate
    moment = k.half_gauge * (drive_right - drive_left) + f.turning_moment - d * f.lateral_force
    coupling = d * w * motion.v_x / k.inverse_mass
    turning = (moment + coupling) * k.inverse_inertia
    return (drive_left + drive_right) * k.inverse_mass - d * w * w, -d * turning, turning


@formula
def track_slip(effort, track_speed, drive):
    """(slip ratio i [-], belt speed r omega [m/s]) of a track that carries `effort` [N]."""
    slip = soil.slip_from_effort(effort, drive.effort_maximum, drive.shear_length)
    belt = soil.belt_speed(effort, track_speed, slip, 1.0 / drive.inverse_belt_limit)
    return soil.slip_ratio(belt, track_speed), belt


@formula
def _stage(motion, rate, duration):
    """Motion after `duration` [s] at constant `rate`."""
    return Motion(
        motion.v_x + duration * rate[0],
        motion.v_y + duration * rate[1],
        motion.yaw_rate + duration * rate[2],
    )


@formula
def _velocity(motion, angle):
    """Velocity in the frame of the sub-step's start, after a rotation by `angle`."""
    cosine, sine = small_rotation(angle)
    return cosine * motion.v_x - sine * motion.v_y, sine * motion.v_x + cosine * motion.v_y


@formula
def rk4_step(accelerations, motion, torque_start, torque_middle, torque_end, k, limits, h):
    """One RK4 step of length h [s]: motion at its end, travel (x, y) [m] and rotation [rad] in the
    frame of its start.

    accelerations: jitted (motion, torque_left, torque_right, k, limits) -> 3 rates.
    torque_*: (left, right) [N m] at the start, the middle and the end of the step.
    """
    half = 0.5 * h
    r1 = accelerations(motion, torque_start[0], torque_start[1], k, limits)
    m2 = _stage(motion, r1, half)
    r2 = accelerations(m2, torque_middle[0], torque_middle[1], k, limits)
    m3 = _stage(motion, r2, half)
    r3 = accelerations(m3, torque_middle[0], torque_middle[1], k, limits)
    m4 = _stage(motion, r3, h)
    r4 = accelerations(m4, torque_end[0], torque_end[1], k, limits)
    # Both midpoint stages share one rotation: they differ by O(h^2), the order stays four.
    middle = Motion(
        0.5 * (m2.v_x + m3.v_x), 0.5 * (m2.v_y + m3.v_y), 0.5 * (m2.yaw_rate + m3.yaw_rate)
    )
    v23 = _velocity(middle, 0.5 * half * (motion.yaw_rate + m2.yaw_rate))
    v4 = _velocity(m4, h * m3.yaw_rate)
    sixth = h / 6.0
    end = Motion(
        motion.v_x + sixth * (r1[0] + 2.0 * (r2[0] + r3[0]) + r4[0]),
        motion.v_y + sixth * (r1[1] + 2.0 * (r2[1] + r3[1]) + r4[1]),
        motion.yaw_rate + sixth * (r1[2] + 2.0 * (r2[2] + r3[2]) + r4[2]),
    )
    travel_x = sixth * (motion.v_x + 4.0 * v23[0] + v4[0])
    travel_y = sixth * (motion.v_y + 4.0 * v23[1] + v4[1])
    rotation = sixth * (motion.yaw_rate + 4.0 * middle.yaw_rate + m4.yaw_rate)
    return end, travel_x, travel_y, rotation
