"""A small closed loop for the tests of controllers: plant, ideal or noisy sensors, policy."""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson

from tracked_env import observation as layout
from tracked_env.physics import lumped
from tracked_env.physics.jit import loop
from tracked_env.physics.lumped import rk4_step

SUB_STEP = 0.0025  # [s]
RTK_NOISE = (0.02, math.radians(0.3), 0.03, 0.003)  # [m], [rad], [m/s], [rad/s]


def _plant_step(accelerations, constrained):
    @loop
    def step(state, p, action, count):
        """Advance state (8, N): X, Y, yaw, v_x, v_y, yaw rate, torques; in place."""
        k, drive = lumped.coefficients(p, constrained), lumped.drive_limits(p)
        decay = lumped.torque_decay(0.5 * SUB_STEP, p.drive_time_constant)
        for i in range(state.shape[1]):
            motion = lumped.Motion(state[3, i], state[4, i], state[5, i])
            left, right = state[6, i], state[7, i]
            to_left, to_right = action[i, 0] * p.torque_limit, action[i, 1] * p.torque_limit
            for _ in range(count):
                limits = lumped.traction_limits(motion, k.half_gauge, drive)
                start = (left, right)
                middle = (to_left + (left - to_left) * decay, to_right + (right - to_right) * decay)
                left = to_left + (middle[0] - to_left) * decay
                right = to_right + (middle[1] - to_right) * decay
                motion, x, y, turn = rk4_step(
                    accelerations, motion, start, middle, (left, right), k, limits, SUB_STEP
                )
                cosine, sine = math.cos(state[2, i]), math.sin(state[2, i])
                state[0, i] += cosine * x - sine * y
                state[1, i] += sine * x + cosine * y
                state[2, i] += turn
            state[3, i], state[4, i], state[5, i] = motion.v_x, motion.v_y, motion.yaw_rate
            state[6, i], state[7, i] = left, right

    return step


STEP = {
    "sliding": _plant_step(lumped.sliding_accelerations, False),
    "constrained": _plant_step(lumped.constrained_accelerations, True),
}


class Path:
    """Reference from analytic speed (v, v', v'') and yaw rate (w, w') as functions of time."""

    def __init__(self, speed, yaw_rate, duration=60.0, spacing=0.01):
        self.speed, self.yaw_rate, self.spacing = speed, yaw_rate, spacing
        t = np.linspace(0.0, duration, 8 * round(duration / spacing) + 1)
        v, w = speed(t)[0] + 0.0 * t, yaw_rate(t)[0] + 0.0 * t
        yaw = cumulative_simpson(w, x=t, initial=0.0)
        x = cumulative_simpson(v * np.cos(yaw), x=t, initial=0.0)
        y = cumulative_simpson(v * np.sin(yaw), x=t, initial=0.0)
        self.poses = np.array([x, y, yaw])[:, ::8]

    def at(self, time):
        """(x, y, yaw), (v, v', v''), (w, w') at a multiple of the spacing."""
        pose = self.poses[:, round(time / self.spacing)]
        return pose, self.speed(np.float64(time)), self.yaw_rate(np.float64(time))


def steady(speed, yaw_rate):
    """Circle or straight line at constant speed."""
    return Path(lambda t: (speed, 0.0, 0.0), lambda t: (yaw_rate, 0.0))


def starts(count=1, **values):
    """State (8, count) with the named rows set."""
    names = ("x", "y", "yaw", "v_x", "v_y", "yaw_rate", "torque_left", "torque_right")
    state = np.zeros((8, count))
    for name, value in values.items():
        state[names.index(name)] = value
    return state


def observe(state, path, time, rng, noise):
    """Observations (N, SIZE) with white noise on position, yaw, velocity and yaw rate."""
    (x, y, yaw), speed, yaw_rate = path.at(time)
    seen = state[:6].copy()
    if rng is not None:
        sigma = np.repeat(noise, [2, 1, 2, 1])[:, np.newaxis]
        seen += sigma * rng.standard_normal(seen.shape)
    cosine, sine = np.cos(seen[2]), np.sin(seen[2])
    values = {name: np.zeros(state.shape[1]) for name in layout.NAMES}
    values["position_error_x"] = cosine * (x - seen[0]) + sine * (y - seen[1])
    values["position_error_y"] = cosine * (y - seen[1]) - sine * (x - seen[0])
    values["heading_error"] = (yaw - seen[2] + math.pi) % (2.0 * math.pi) - math.pi
    values["v_x"], values["v_y"], values["yaw_rate"] = seen[3:6]
    for name, value in zip(("speed", "acceleration", "jerk"), speed, strict=True):
        values[f"reference_{name}"] += value
    for name, value in zip(("yaw_rate", "yaw_acceleration"), yaw_rate, strict=True):
        values[f"reference_{name}"] += value
    return layout.pack(values)


class Run(NamedTuple):
    """What a closed loop gave, one row per control step."""

    error: np.ndarray  # [m] (steps, N) distance of the centre of mass to the reference
    action: np.ndarray  # [-] (steps, N, 2)
    state: np.ndarray  # (8, N) at the end


def drive(controller, p, path, state, duration, lateral_model="sliding", noise=None):
    """Close the loop for `duration` [s] on the plant with true parameters p."""
    rate = round(1.0 / controller.control_period)
    count = round(controller.control_period / SUB_STEP)
    rng = None if noise is None else np.random.default_rng(7)
    state, memory = state.copy(), None
    errors, actions = [], []
    for step in range(round(duration * rate)):
        x, y, _ = path.at(step / rate)[0]
        errors.append(np.hypot(x - state[0], y - state[1]))
        observation = observe(state, path, step / rate, rng, noise)
        action, memory = controller.predict(observation, memory)
        actions.append(action)
        STEP[lateral_model](state, p, action.astype(np.float64), count)
    return Run(np.array(errors), np.array(actions), state)
