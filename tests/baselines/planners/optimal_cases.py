"""Vehicles, limits and goals for the tests of plans of least time, and what a plan leads to."""

import math

import numpy as np
from scipy.stats import qmc

from baselines.planners.trajectory import Limits
from baselines.slip.slip_sweep import identified_slip, with_friction
from tracked_env.physics.parameters import VEHICLES

GOAL = (2.0, 2.5, -0.4)  # F, figure 16
ORIGIN = (0.0, 0.0, 0.0)


def vehicle_on(mu, name="focchi", limit=18.0):
    """A vehicle of F on friction mu with fast sprockets, and its slip."""
    made = with_friction(VEHICLES[name], mu)._replace(sprocket_speed_limit=limit)
    return made, identified_slip(made)


FOCCHI, SLIP = vehicle_on(0.4)


def limits_of(vehicle, v_min, **given):
    """Limits of F 7.2: up to 0.4 m/s."""
    return Limits.of(vehicle, **{"v_min": v_min, "v_max": 0.4, "acceleration": math.inf, **given})


def halton_goals(nearest):
    """The first hundred goals that the code of F draws in an annulus from `nearest` to 4 m."""
    draws = qmc.Halton(d=3, scramble=True, seed=0).random(400)
    x, y, yaw = 4.0 * (2.0 * draws[:, 0] - 1.0), 4.0 * (2.0 * draws[:, 1] - 1.0), draws[:, 2]
    distance = np.hypot(x, y)
    inside = (nearest < distance) & (distance < 4.0)
    return np.stack([x, y, 2.0 * math.pi * yaw], axis=1)[inside][:100]


def random_goals(count=500):
    """Goals from 0.1 to 4 m away, in any direction and yaw."""
    rng = np.random.default_rng(1)
    distance, direction = rng.uniform(0.1, 4.0, count), rng.uniform(-math.pi, math.pi, count)
    yaw = rng.uniform(-math.pi, math.pi, count)
    return np.stack([distance * np.cos(direction), distance * np.sin(direction), yaw], axis=1)


def held(vehicle, made):
    """Belt speeds p, q [m/s] (N,) of a plan's intervals."""
    left, right = made.sprocket_left[:-1], made.sprocket_right[:-1]
    return 0.5 * vehicle.sprocket_radius * np.stack([left + right, right - left])


def replayed(model, made):
    """The pose at the end of a plan's sprocket speeds on a pseudo-kinematic model."""
    pose = np.array([[made.x[0], made.y[0], made.yaw[0]]])
    for k, duration in enumerate(np.diff(made.time)):
        speeds = np.array([[made.sprocket_left[k], made.sprocket_right[k]]])
        for _ in range(8):
            pose = model.step(pose, speeds, duration / 8)
    return pose[0]
