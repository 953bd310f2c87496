"""Fixed-step fourth-order Runge-Kutta integration of the vehicle's motion.

The body velocities obey the equations of motion; the pose follows from them. Within one
sub-step the pose is integrated in the frame of the sub-step's start, where the rotation is
small, so that the integrator itself needs no sine or cosine of the heading. The motor
torque follows its demand by a first-order lag whose exact solution is used at each stage.

References: [1] Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.1.
"""

from tracked_env.physics.elementary import small_rotation
from tracked_env.physics.jit import formula
from tracked_env.physics.vehicle import Motion


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
    """One RK4 step of length h [s].

    accelerations: jitted (motion, torque_left, torque_right, k, limits) -> 3 rates.
    torque_*: (left, right) [N m] at the start, the middle and the end of the step.
    Returns the motion at the end, and the travel (x, y) [m] and rotation [rad] in the frame
    of the start.
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
