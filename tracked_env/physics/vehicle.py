"""What every plant of a tracked vehicle shares: its quantities, and what follows from parameters.

Equations (S = Strawa et al. 2021 section 4, in ISO axes; symbols in NOTATION.md):
    V_L, V_R = v_x -+ w B / 2                 speeds of the tracks over the ground
    a        = dv/dt + w x v                  inertial acceleration, in body axes
    E        = m (v_x^2 + v_y^2) / 2 + I w^2 / 2
Assumptions: planar motion, weight shared equally by the tracks.

References: [1] Strawa et al., Electronics 10 (2021) 187.
"""

import math
from typing import NamedTuple

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import exponential
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


@formula
def coefficients(p, constrained):
    """Coefficients of a control step from its parameters; `constrained` is a bool."""
    weight = p.mass * soil.GRAVITY
    d = p.icr_forward
    inertia = p.inertia + (p.mass * d * d if constrained else 0.0)
    return Coefficients(
        1.0 / p.mass,
        1.0 / inertia,
        0.5 * p.track_gauge,
        p.contact_length,
        1.0 / p.sprocket_radius,
        0.5 * p.longitudinal_resistance * weight,
        p.lateral_resistance * weight / p.contact_length,
        p.turning_resistance_factor,
        d,
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
    return DriveLimits(
        maximum, limit, shear_length, 1.0 / (p.sprocket_radius * p.sprocket_speed_limit)
    )


@formula
def track_speeds(motion, half_gauge):
    """Forward speed [m/s] of the left and the right track over the ground."""
    turn = motion.yaw_rate * half_gauge
    return motion.v_x - turn, motion.v_x + turn


@formula
def inertial_acceleration(motion, body_rate_x, body_rate_y):
    """Acceleration [m/s^2] of the centre of mass in body axes: dv/dt + w x v."""
    return (
        body_rate_x - motion.yaw_rate * motion.v_y,
        body_rate_y + motion.yaw_rate * motion.v_x,
    )


@formula
def torque_decay(duration, time_constant):
    """exp(-duration / T) [-]: what is left of the torque error after `duration` [s]."""
    return exponential(-duration / time_constant) if time_constant > 0.0 else 0.0


@formula
def kinetic_energy(motion, p):
    """Kinetic energy [J] of the vehicle; sprockets and tracks carry none, S (24)."""
    speed2 = motion.v_x * motion.v_x + motion.v_y * motion.v_y
    return 0.5 * p.mass * speed2 + 0.5 * p.inertia * math.pow(motion.yaw_rate, 2)
