"""Whether a vehicle reaches the goal of its reference, when, and at what cost.

With d_k the distance of the pose to the goal after control step k, h the control period, P_k the
power of both sprockets, l the contact length and N the steps driven:
    reached    d_k <= GOAL_DISTANCE l and |yaw - goal's| <= GOAL_ANGLE in some step
    time       h k of the first such step; the length of the episode where there is none
    energy     sum of h P_k until then; of the whole drive where there is none
    miss       d_N, at the end of the drive, or where the pose was finite last
All are NaN in episodes whose reference has no goal.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.engine.episode import Episode

FloatArray = NDArray[np.float64]

GOAL_DISTANCE = 1.0 / 7.0  # [-] of the contact length: 0.1 m for 0.7 m
GOAL_ANGLE = 0.1  # [rad]


class GoalReaching(NamedTuple):
    """The four numbers of n episodes, (n,) each."""

    reached: FloatArray  # [-] 1 or 0
    time: FloatArray  # [s]
    energy: FloatArray  # [J]
    miss: FloatArray  # [m]


def goals_of(episodes: list[Episode]) -> FloatArray:
    """Goals (n, 3) x, y [m], yaw [rad]; NaN where a reference has none."""
    goals = np.full((len(episodes), 3), np.nan)
    for i, episode in enumerate(episodes):
        if episode.profile.knots.size:
            goals[i] = episode.profile.knots[-1, 1:4]
    return goals


def reaching(
    poses: FloatArray, power: FloatArray, steps: NDArray[np.int64], goals: FloatArray,
    contact_length: float, period: float, whole: float,
) -> GoalReaching:  # fmt: skip
    """Of n episodes with true poses (3, T, n) and power [W] (T, n) in `steps` (n,) driven steps.

    goals (n, 3); contact_length [m] of the nominal vehicle; period [s] of a step, whole [s] of an
    episode.
    """
    x, y, yaw = np.where(np.isfinite(poses), poses, np.nan) - goals.T[:, None]
    away = np.hypot(x, y)
    turned = np.abs(np.remainder(yaw + np.pi, 2.0 * np.pi) - np.pi)
    driven = np.arange(len(away))[:, None] < steps
    there = driven & (away <= GOAL_DISTANCE * contact_length) & (turned <= GOAL_ANGLE)
    reached, first = there.any(axis=0), there.argmax(axis=0)
    last = np.where(reached, first, steps - 1)
    spent = np.where(np.arange(len(away))[:, None] <= last, power, 0.0)
    spent = np.where(np.isfinite(spent), spent, 0.0)
    energy = np.ascontiguousarray(spent.T).sum(axis=-1) * period
    ends = np.where(driven & np.isfinite(away), np.arange(len(away))[:, None], 0).max(axis=0)
    miss = away[ends, np.arange(len(steps))]
    known = np.isfinite(goals).all(axis=1)
    found = (reached.astype(float), np.where(reached, (first + 1) * period, whole), energy, miss)
    return GoalReaching(*(np.where(known, values, np.nan) for values in found))
