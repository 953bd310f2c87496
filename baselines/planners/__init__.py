"""Planners of motion for tracked vehicles: from a pose to a goal, with or without slip.

    from baselines.planners import Limits, plan
    trajectory = plan((0, 0, 0), (2.0, 2.5, -0.4), Limits.of(vehicle, reserve=0.1))
Public:
* `plan`: by any method, through way points and around `Obstacles`
* `optimal`: plans of least time with slip alone; `dubins`, `reeds_shepp`, `clothoid`: paths alone
* `Start`, `Limits`: what a plan begins with and may ask of the vehicle
* `Trajectory`: what it returns; `Trajectory.at` gives its `Motion` at any time
"""

from baselines.planners.curves import clothoid, dubins, reeds_shepp
from baselines.planners.least_time import optimal
from baselines.planners.motion_planning import plan
from baselines.planners.obstacles import Obstacles
from baselines.planners.trajectory import Limits, Motion, Start, Trajectory

__all__ = [
    "Limits",
    "Motion",
    "Obstacles",
    "Start",
    "Trajectory",
    "clothoid",
    "dubins",
    "optimal",
    "plan",
    "reeds_shepp",
]
