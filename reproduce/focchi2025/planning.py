"""Section 7.2: goals, and the plans to them, as the paper and its code have them.

Goals: scipy's Halton points as in the code, 4 (2 u - 1) in x and y, kept in an annulus from 1 m to
4 m and not from 2 m as printed (21 of the hundred are nearer). Start: (0, 0, 0).

    dubins     at v, turning radius at the limit of the sprockets, slip ignored
    clothoid   one G1 clothoid at v, whatever its length and curvature: none is bounded in F
    optimal    least time under slip (`baselines.planners.optimal`), v_min = v_max or v_min below;
               "rest to rest" begins and ends at rest, which no plan of F does
F has v = 0.4 m/s, sprockets up to 18 rad/s (10 at mu = 0.1, 7.1), and no other limit.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from baselines.planners import speed_profile
from baselines.planners.clothoid import clothoid
from baselines.planners.optimal import optimal
from baselines.planners.path import Path
from baselines.planners.plan import plan
from baselines.planners.timed_path import driven
from baselines.planners.trajectory import Limits, Trajectory
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025.runs import LENGTHS, Floats, vehicle
from tracked_env.physics.parameters import PlantParameters
from tracked_env.validation import checked_choice

ORIGIN = (0.0, 0.0, 0.0)
FIGURE_16 = (2.0, 2.5, -0.4)  # [m, m, rad] the goal of figures 16 and 17
SPEED = 0.4  # [m/s] v_max, and v_min at constant speed
SLOWEST = 0.15  # [m/s] v_min of "optimal, variable"
PERIOD = 0.02  # [s] between samples of a plan
FRICTION = 0.4  # [-] mu of 7.2
SLIPPERY = 0.1  # [-] mu of 7.1
FASTER, SLOWER = 18.0, 10.0  # [rad/s] omega_max of 7.2, and of 7.1 at SLIPPERY
REACH = 4.0  # [m] outer radius of the annulus, and half the edge of the square
NEAREST = 1.0  # [m] inner radius in the code; 2 m is printed
DRAWS = 400  # of which the first hundred inside count
PLANNERS = (
    "dubins", "clothoid", "optimal", "optimal, variable", "optimal, from 0",
    "optimal, beta added", "optimal, rest to rest", "dubins, 0.16 m", "dubins, 0.5 m",
)  # fmt: skip
RADII = {"dubins, 0.16 m": 0.16, "dubins, 0.5 m": 0.5}  # [m]; 0.106 m at the limit
V_MIN = {"optimal, variable": SLOWEST, "optimal, rest to rest": SLOWEST, "optimal, from 0": 0.0}
GENTLE = 5.0  # [rad/s^2] sprocket acceleration of "optimal, rest to rest"; F has no such limit


class Ground(NamedTuple):
    """A vehicle and its soil, and what plans leave to the controller."""

    length: float = LENGTHS[-1]  # [m] contact length
    friction: float = FRICTION  # [-] mu
    reserve: float = 0.0  # [-] share of the sprocket speed

    @property
    def vehicle(self) -> PlantParameters:
        """Table 2 on this soil."""
        return self.on(self.friction)

    def on(self, friction: float) -> PlantParameters:
        """The same vehicle, with the same sprockets, on another mu."""
        made = vehicle(self.length, friction)
        return made._replace(sprocket_speed_limit=self.sprocket_speed)

    @property
    def sprocket_speed(self) -> float:
        """omega_max [rad/s]: 18 in 7.2, 10 in 7.1."""
        return FASTER if self.friction > SLIPPERY else SLOWER

    def limits(self, v_min: float = SPEED, v_max: float = SPEED) -> Limits:
        """Those of F: sprockets and speed."""
        return Limits(self.sprocket_speed, self.reserve, v_min=v_min, v_max=v_max)


class AddedSlip(NamedTuple):
    """A slip model whose beta has the other sign, so that a planner adds it.

    (29) as printed does so in the forward map, and so does the code's planner: slip turns the
    vehicle more. Data and controller have beta = r omega - v_track, which is subtracted.
    """

    slip_model: SlipModel

    def slip(self, sprocket_left: Any, sprocket_right: Any) -> tuple[Floats, Floats, Floats]:
        """(beta_left, beta_right [m/s], alpha [rad])."""
        left, right, alpha = self.slip_model.slip(sprocket_left, sprocket_right)
        return -left, -right, alpha


@lru_cache(maxsize=8)
def _drawn(nearest: float) -> Floats:
    unit = qmc.Halton(d=3, scramble=True, seed=0).random(DRAWS)
    goals: Floats = np.stack(
        [*(REACH * (2.0 * unit[:, k] - 1.0) for k in (0, 1)), 2.0 * math.pi * unit[:, 2]], axis=1
    )
    distance = np.hypot(goals[:, 0], goals[:, 1])
    return goals[(nearest < distance) & (distance < REACH)]


def halton_goals(count: int = 100, nearest: float = NEAREST) -> Floats:
    """The first goals (N, 3) in an annulus from `nearest` to REACH [m], as the code draws them."""
    return _drawn(nearest)[:count].copy()


def plans(
    ground: Ground, planner: str, goals: Floats, slip: SlipModel | None = None
) -> list[Trajectory]:
    """Plans of one of PLANNERS to goals (N, 3). slip: None is the table of the ground's sweep.

    Raises ValueError for another planner.
    """
    checked_choice("planner", planner, PLANNERS)
    made = ground.vehicle
    limits = ground.limits(V_MIN.get(planner, SPEED))
    if planner == "clothoid":
        return [_clothoid(goal, limits, made) for goal in goals]
    if planner.startswith("dubins"):
        radius = RADII.get(planner, 0.0)
        bend = 1.0 / radius if radius else math.inf
        found = plan(ORIGIN, goals, limits._replace(curvature=bend), None, "dubins", made,
                     period=PERIOD)  # fmt: skip
    else:
        slip = identified_slip(made) if slip is None else slip
        slip = AddedSlip(slip) if planner == "optimal, beta added" else slip
        stop = planner == "optimal, rest to rest"
        if stop:
            limits = limits._replace(sprocket_acceleration=GENTLE)
        found = optimal(ORIGIN, goals, limits, made, slip, period=PERIOD, stop=stop)
    assert isinstance(found, list)
    return found


def _clothoid(goal: Floats, limits: Limits, made: PlantParameters) -> Trajectory:
    fitted = clothoid(ORIGIN, goal)
    path = Path.of(ORIGIN, fitted.length, fitted.curvature, fitted.sharpness)
    profile = speed_profile.constant(path, SPEED, limits, made)
    return driven(path, profile, goal, limits, made, "clothoid", period=PERIOD)


class Seconds(NamedTuple):
    """CPU time of a plan [s]: median, and largest of all goals."""

    median: float
    worst: float


def seconds(call: Callable[[Floats], object], goals: Floats, repeats: int = 3) -> Seconds:
    """Of `call` for each goal, the least of some repeats; a first call is not counted."""
    call(goals[0])
    taken = np.empty((repeats, len(goals)))
    for round_ in range(repeats):
        for i, goal in enumerate(goals):
            began = process_time()
            call(goal)
            taken[round_, i] = process_time() - began
    least = taken.min(axis=0)
    return Seconds(float(np.median(least)), float(least.max()))


def durations(found: Sequence[Trajectory]) -> Floats:
    """[s] (N,)."""
    return np.array([one.duration for one in found])
