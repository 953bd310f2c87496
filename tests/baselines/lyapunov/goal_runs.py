"""Vehicles that drive to goals on the distributed plant, with sensors that show the goal."""

from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from baselines.estimators.measurement import DataSheet
from baselines.lyapunov.replanning import ReplanningPolicy
from baselines.slip.slip_sweep import with_friction
from tracked_env import observation as layout
from tracked_env.physics.parameters import VEHICLES
from tracked_env.plants.standalone import Rig

FOCCHI = VEHICLES["focchi"]
SHOWN = layout.make_layout(["motion", "drive", "age", "goal"])
PERIOD = 0.02  # [s]
IDEAL = DataSheet(*(0.0 for _ in DataSheet._fields))


def draw_goals(count):
    """Goals (count, 3) 1 to 4 m from the origin; constants were chosen on others, those of F."""
    unit = 2.0 * qmc.Halton(3, scramble=True, rng=0).random(400) - 1.0
    goals = unit * [4.0, 4.0, np.pi]
    distance = np.hypot(*goals.T[:2])
    return goals[(distance > 1.0) & (distance < 4.0)][:count]


def make(**changes):
    """`slc-replan` with ideal sensors."""
    options = {"data_sheet": IDEAL, "observation": SHOWN.names, **changes}
    return ReplanningPolicy(FOCCHI, PERIOD, **options)


def show(states, sprockets, goals, age=0.0, seen_at=None):
    """Observations (N, D): pose and velocity of `seen_at`, `age` [s] old; the rest of now."""
    old = states if seen_at is None else seen_at
    cosine, sine = np.cos(old[:, 2]), np.sin(old[:, 2])
    x, y, turn = (goals - old[:, :3]).T
    values = dict.fromkeys(SHOWN.names, np.zeros(len(states))) | {
        "v_x": old[:, 3],
        "v_y": old[:, 4],
        "yaw_rate": states[:, 5],
        "sprocket_speed_left": sprockets[:, 0],
        "sprocket_speed_right": sprockets[:, 1],
        "goal_x": cosine * x + sine * y,
        "goal_y": cosine * y - sine * x,
        "goal_cosine": np.cos(turn),
        "goal_sine": np.sin(turn),
        "pose_age": np.full(len(states), age),
    }
    return SHOWN.pack(values)


class Drive(NamedTuple):
    """What happened, over T steps."""

    states: np.ndarray  # (T, N, 6) pose and velocities
    observations: np.ndarray  # (T, N, D)
    actions: np.ndarray  # (T, N, 2)
    memory: Any  # the policy's state at the end
    off: np.ndarray  # (N,) [m] from the goal at the end
    turned: np.ndarray  # (N,) [rad] from its yaw there


def drive(
    policy, goals, frictions=(0.4, 0.1), change=2.0, duration=25.0, speed=0.0, late=0, starts=None
):
    """Drive to goals (N, 3) from the origin, at `speed` [m/s] there.

    frictions: until `change` [s], and then. late: steps by which pose and velocity are. starts
    (T, N): where episodes start; the vehicle goes on from where it is.
    """
    count, limit = len(goals), FOCCHI.sprocket_speed_limit
    rigs = [Rig("distributed", with_friction(FOCCHI, mu), count, "speed") for mu in frictions]
    sprockets = np.full((count, 2), speed / FOCCHI.sprocket_radius)
    rigs[0].states[:, 3] = speed
    rig, memory, states, observations, actions = rigs[0], None, [], [], []
    for k in range(round(duration / PERIOD)):
        if rig is not rigs[1] and k * PERIOD >= change:
            rigs[1].states[:] = rig.states
            rig = rigs[1]
        states.append(rig.states[:, :6].copy())
        back = min(late, k)
        seen = show(states[-1], sprockets, goals, PERIOD * back, states[-1 - back])
        action, memory = policy.predict(seen, memory, None if starts is None else starts[k])
        sprockets = limit * action.astype(np.float64)
        rig.advance(sprockets, PERIOD)
        observations.append(seen)
        actions.append(action)
    missed = (rig.states[:, :3] - goals).T
    off, turned = np.hypot(*missed[:2]), np.abs(np.arctan2(np.sin(missed[2]), np.cos(missed[2])))
    history = (np.array(rows) for rows in (states, observations, actions))
    return Drive(*history, memory, off, turned)
