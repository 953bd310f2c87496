"""A skid-steering tracked vehicle driven by its sprocket torques.

Equations (S = Strawa et al. 2021 section 4, in ISO axes; symbols in NOTATION.md):
    m (dv_x/dt - w v_y) = F_L + F_R - R_L - R_R
    m (dv_y/dt + w v_x) = F_y
    I dw/dt             = (B/2) [(F_R - R_R) - (F_L - R_L)] + f M
    F_k                 = clip(torque_k / r, traction limits),   k = L, R
    dtorque/dt          = (g_k demand - torque) / T
`sliding` lateral model: as above, F_y and M from the sliding contact; x_ICR = -v_y / w emerges.
`constrained` lateral model: S (28), v_y = -d w holds at all times and F_y follows from it:
    m (dv_x/dt + d w^2)          = F_L + F_R - R_L - R_R
    (I + m d^2) dw/dt - m d w v_x = (B/2) [(F_R - R_R) - (F_L - R_L)] - (F_y d + M_r)
Assumptions: planar motion, no track inertia, ideal transmission, parameters constant over
one control step, traction limits constant over one sub-step.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

from typing import NamedTuple

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import saturated_sign
from tracked_env.physics.jit import formula
from tracked_env.physics.vehicle import Loads, track_speeds


class TractionLimits(NamedTuple):
    """Bounds of the tractive effort of both tracks, for one sub-step."""

    left_low: float  # [N]
    left_high: float  # [N]
    right_low: float  # [N]
    right_high: float  # [N]


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

    Uses u / (2 + u) <= mobilised_shear(u), so that no exponential is needed; the limit of a
    driven track falls with its speed and never exceeds that of a braked one.
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
    return Loads(
        fl, fr, rl, rr, force, -soil.resisting(motion.yaw_rate, applied, magnitude, inverse_width)
    )


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
    yaw_acceleration = (moment + coupling) * k.inverse_inertia
    return (
        (drive_left + drive_right) * k.inverse_mass - d * w * w,
        -d * yaw_acceleration,
        yaw_acceleration,
    )


@formula
def track_slip(effort, track_speed, drive):
    """(slip ratio i [-], belt speed r omega [m/s]) of a track that carries `effort` [N]."""
    carried = soil.slip_from_effort(effort, drive.effort_maximum, drive.shear_length)
    belt = soil.belt_speed(effort, track_speed, carried, 1.0 / drive.inverse_belt_limit)
    return soil.slip_ratio(belt, track_speed), belt
