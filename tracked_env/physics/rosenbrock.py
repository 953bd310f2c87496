"""Linearly implicit steps of a vehicle on a soil that resists with k (belt - track).

The resistance k = tau A / |s| of a patch grows without bound where the shear velocity s vanishes:
explicit steps of any size chatter there. A step of length h from the state v = (motion, belts),
with F(v) its rates and A(v) their drag, the secant that the sums of k give for nothing:
    v_m = v + (h/2) (1 + (h/2) A)^-1 F(v)                 middle of the step, linearly implicit
    dz/dt = F(v_m) - A(v_m) z,  z(0) = v - v_m            over the step, z = departure from v_m
    v(h) = v_m + z(h)                                     by an L-stable method of order two
F(v_m) - A z passes through F at the middle, and v(t) - v_m is odd there but for O(h^2): whatever A
is, the error of a step is O(h^3). That makes it a W-method: a Rosenbrock method that does not need
the Jacobian. The secant is not the slope but steeper: with Coulomb friction a (K -> 0, or a belt
that stands) the middle is v^2 / (v + a h/2), which never crosses v = 0, and z is damped at its
rate. So a vehicle comes to rest and stays there; with the slope, which is zero while a
patch slides, the step would be explicit.

Assumptions: all that A leaves out (rolling resistance, turning of the axes) changes slowly.
References: [1] Hairer, Wanner, Solving Ordinary Differential Equations II, IV.7. [2] Verwer,
Spee, Blom, Hundsdorfer, "A second-order Rosenbrock method applied to photochemical dispersion
problems", SIAM J. Sci. Comput. 20 (1999).
"""

import math
from typing import NamedTuple

from tracked_env.physics.jit import formula
from tracked_env.physics.vehicle import Motion

GAMMA = 1.0 - math.sqrt(0.5)  # [-] of the method: L-stable with the exact Jacobian


class Belts(NamedTuple):
    """One number for each side: belt speeds r omega [m/s], their rates, or torques [N m]."""

    left: float
    right: float


class Rates(NamedTuple):
    """What changes during a step."""

    v_x: float  # [m/s^2] in body axes
    v_y: float  # [m/s^2]
    yaw_rate: float  # [rad/s^2]
    left: float  # [m/s^2] of the left belt
    right: float  # [m/s^2]


@formula
def damped(r, rates, k, inverse_belt_mass, duration):
    """(1 - duration A)^-1 rates, where A is the linear drag of the soil's resistance r.

    The belts are eliminated first: each is coupled to the body only.
    """
    give_left = 1.0 / (1.0 + duration * inverse_belt_mass * r.left)
    give_right = 1.0 / (1.0 + duration * inverse_belt_mass * r.right)
    s_left, s_right = r.left * give_left, r.right * give_right
    a_left, a_right = r.left_arm * give_left, r.right_arm * give_right
    mass = 1.0 / k.inverse_mass + duration * (s_left + s_right)
    side = 1.0 / k.inverse_mass + duration * (r.left + r.right)
    polar = r.polar - duration * inverse_belt_mass * (a_left * r.left_arm + a_right * r.right_arm)
    turn = 1.0 / k.inverse_inertia + duration * polar
    arm, shift = duration * (a_left + a_right), duration * r.forward
    push = rates.v_x / k.inverse_mass + duration * (s_left * rates.left + s_right * rates.right)
    slide = rates.v_y / k.inverse_mass
    twist = rates.yaw_rate / k.inverse_inertia
    twist -= duration * (a_left * rates.left + a_right * rates.right)
    yaw = (twist + arm * push / mass - shift * slide / side) / (
        turn - arm * arm / mass - shift * shift / side
    )
    forward = (push + arm * yaw) / mass
    pull = duration * inverse_belt_mass
    left = give_left * (rates.left + pull * (r.left * forward - r.left_arm * yaw))
    right = give_right * (rates.right + pull * (r.right * forward - r.right_arm * yaw))
    return Rates(forward, (slide - shift * yaw) / side, yaw, left, right)


@formula
def pushed(motion, rates, duration):
    """Motion after `duration` [s] at constant rates."""
    return Motion(
        motion.v_x + duration * rates.v_x,
        motion.v_y + duration * rates.v_y,
        motion.yaw_rate + duration * rates.yaw_rate,
    )


@formula
def combined(first, second, a, b):
    """a first + b second, of rates."""
    return Rates(
        a * first.v_x + b * second.v_x,
        a * first.v_y + b * second.v_y,
        a * first.yaw_rate + b * second.yaw_rate,
        a * first.left + b * second.left,
        a * first.right + b * second.right,
    )


@formula
def departure(r, first, rates, k, inverse_belt_mass, h):
    """What motion and belts are away from the middle of the step at its end.

    Solves dz/dt = rates - A z, z(0) = -(h/2) first, A of the middle, by an L-stable method of
    order two: z(h) = P [a z(0) + g h rates + P (b z(0) + (1 - g) h rates)], P = (1 + g h A)^-1.
    """
    back = -0.5 * h
    a, b = (2.0 * GAMMA - 1.0) / GAMMA, (1.0 - GAMMA) / GAMMA
    inner = combined(first, rates, b * back, (1.0 - GAMMA) * h)
    inner = damped(r, inner, k, inverse_belt_mass, GAMMA * h)
    outer = combined(first, rates, a * back, GAMMA * h)
    return damped(r, combined(outer, inner, 1.0, 1.0), k, inverse_belt_mass, GAMMA * h)
