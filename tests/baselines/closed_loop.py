"""A small closed loop for the tests of controllers: plant, ideal or noisy sensors, policy."""

import math
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_simpson

from tracked_env import observation as layout
from tracked_env.physics.parameters import VehicleState
from tracked_env.plants.standalone import Rig

RTK_NOISE = (0.02, math.radians(0.3), 0.03, 0.003)  # [m], [rad], [m/s], [rad/s]


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
    """States (count, STATE_ROWS) at rest at the origin but for the named columns."""
    return np.stack([np.broadcast_to(values.get(n, 0.0), count) for n in VehicleState._fields], 1)


def observe(state, path, time, rng, noise):
    """Observations (N, SIZE) of states (N, STATE_ROWS) with white noise on pose, velocity and yaw
    rate."""
    (x, y, yaw), speed, yaw_rate = path.at(time)
    seen = state.T[:6].copy()
    if rng is not None:
        sigma = np.repeat(noise, [2, 1, 2, 1])[:, np.newaxis]
        seen += sigma * rng.standard_normal(seen.shape)
    cosine, sine = np.cos(seen[2]), np.sin(seen[2])
    values = {name: np.zeros(len(state)) for name in layout.NAMES}
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
    state: np.ndarray  # (N, STATE_ROWS) at the end


def drive(controller, p, path, state, duration, lateral_model="sliding", noise=None):
    """Close the loop for `duration` [s] on the plant with true parameters p."""
    rate = round(1.0 / controller.control_period)
    rng = None if noise is None else np.random.default_rng(7)
    rig = Rig("lumped", p, len(state), options={"lateral": lateral_model})
    rig.states[:] = state
    errors, actions, memory = [], [], None
    for step in range(round(duration * rate)):
        x, y, _ = path.at(step / rate)[0]
        errors.append(np.hypot(x - rig.state.x, y - rig.state.y))
        observation = observe(rig.states, path, step / rate, rng, noise)
        action, memory = controller.predict(observation, memory)
        actions.append(action)
        rig.advance(p.torque_limit * action.astype(np.float64), controller.control_period)
    return Run(np.array(errors), np.array(actions), rig.states.copy())
