"""Sections 6.3 and 7.2: goals, and the plans to them, as the paper and its code have them.

Goals: scipy's Halton points as in the code, 4 (2 u - 1) in x and y, kept in an annulus from 1 m to
4 m and not from 2 m as printed (21 of the hundred are nearer). Start: (0, 0, 0).

    dubins     at v, turning radius at the limit of the sprockets, slip ignored
    clothoid   one G1 clothoid at v, whatever its length and curvature: none is bounded in F
    optimal    least time under slip (`planners.least_time`), v_min = v_max or v_min below;
               "rest to rest" begins and ends at rest, which no plan of F does
F has v = 0.4 m/s, sprockets up to 18 rad/s (10 at mu = 0.1, 7.1), and no other limit.
Conventions of the paper's code, one at a time:
    AddedSlip  the forward map with beta added, (29) as printed: slip turns the vehicle more. Data
               and controller have beta = r omega - v_track, which is subtracted
    unwrapped  the yaw of the goal in [0, 2 pi), to be reached as it stands: (52) does not wrap
    levels     7.2.2: c_1 and c_2 of (54) times numbers of the code, instead of other soils
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import product
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.planners import plan
from baselines.planners.curves import clothoid
from baselines.planners.interior_point import solve
from baselines.planners.least_time import optimal
from baselines.planners.planning_problem import Bounds, Task, make_work
from baselines.planners.slip_surface import surface_of
from baselines.planners.speed_along_path import TimedPath, constant, sampled
from baselines.planners.trajectory import Limits, Trajectory
from baselines.slip.slip_models import SlipModel
from baselines.slip.slip_regression import ExponentialSlipModel, fit_exponential
from baselines.slip.slip_sweep import identified_slip, sweep
from reproduce.focchi2025.control import LENGTHS, vehicle, within
from reproduce.policy_runs import Floats
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
INTERVALS = 40  # [-] N of Table 1
ITERATIONS = 200  # of the interior point method
FAST = 0.8  # [m/s] v_max of 7.2.2
IDENTIFIED = 10.0  # [rad/s] sprocket speeds up to which (54) is fitted, section 4
LEVELS = {"normal": (1.0, 1.0), "medium": (3.0, 0.5), "high": (4.0, 0.25)}  # [-] of c_1, of c_2
PRINTED_LEVELS = {"normal": 5.2, "medium": 4.9, "high": 4.12}  # [s] T of 7.2.2
SIGNS = {"subtracted": 1.0, "added": -1.0}  # of beta in the forward map
SUBSTEPS = 8  # of the model in a held interval


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
        limit = self.sprocket_speed
        return vehicle(self.length, friction)._replace(sprocket_speed_limit=limit)

    @property
    def sprocket_speed(self) -> float:
        """omega_max [rad/s]: 18 in 7.2, 10 in 7.1."""
        return FASTER if self.friction > SLIPPERY else SLOWER

    def limits(self, v_min: float = SPEED, v_max: float = SPEED) -> Limits:
        """Those of F: sprockets and speed."""
        return Limits(self.sprocket_speed, self.reserve, v_min=v_min, v_max=v_max)


class AddedSlip(NamedTuple):
    """A slip model whose beta has the other sign, so that a planner adds it."""

    slip_model: SlipModel

    def slip(self, sprocket_left: Any, sprocket_right: Any) -> tuple[Floats, Floats, Floats]:
        """(beta_left, beta_right [m/s], alpha [rad])."""
        left, right, alpha = self.slip_model.slip(sprocket_left, sprocket_right)
        return -left, -right, alpha


@lru_cache(maxsize=8)
def _in_annulus(nearest: float) -> Floats:
    unit = qmc.Halton(d=3, scramble=True, seed=0).random(DRAWS)
    goals: Floats = np.stack(
        [*(REACH * (2.0 * unit[:, k] - 1.0) for k in (0, 1)), 2.0 * math.pi * unit[:, 2]], axis=1
    )
    distance = np.hypot(goals[:, 0], goals[:, 1])
    return goals[(nearest < distance) & (distance < REACH)]


def halton_goals(count: int = 100, nearest: float = NEAREST) -> Floats:
    """The first goals (N, 3) in an annulus from `nearest` to REACH [m], as the code draws them."""
    return _in_annulus(nearest)[:count].copy()


def plans(
    ground: Ground, planner: str, goals: Floats, slip: SlipModel | None = None
) -> list[Trajectory]:
    """Plans of one of PLANNERS to goals (N, 3). slip: None is the table of the ground's sweep.

    Raises ValueError for another planner.
    """
    checked_choice("planner", planner, PLANNERS)
    vehicle, limits = ground.vehicle, ground.limits(V_MIN.get(planner, SPEED))
    if planner == "clothoid":
        return [_clothoid(goal, limits, vehicle) for goal in goals]
    if planner.startswith("dubins"):
        radius = RADII.get(planner, 0.0)
        limits = limits._replace(curvature=1.0 / radius if radius else math.inf)
        shortest: Any = plan(ORIGIN, goals, limits, None, "dubins", vehicle, period=PERIOD)
        return list(shortest)
    slip = identified_slip(vehicle) if slip is None else slip
    slip = AddedSlip(slip) if planner == "optimal, beta added" else slip
    stop = planner == "optimal, rest to rest"
    if stop:
        limits = limits._replace(sprocket_acceleration=GENTLE)
    fastest: Any = optimal(ORIGIN, goals, limits, vehicle, slip, period=PERIOD, stop=stop)
    return list(fastest)


def _clothoid(goal: Floats, limits: Limits, vehicle: PlantParameters) -> Trajectory:
    path = clothoid(ORIGIN, goal).path()
    profile = constant(path, SPEED)
    return sampled(TimedPath(path, profile, "clothoid"), goal, limits, vehicle, period=PERIOD)


class Seconds(NamedTuple):
    """CPU time of a plan [s]: median, and largest of all goals."""

    median: float
    worst: float


def seconds(call: Callable[[Floats], object], goals: Floats, repeats: int = 3) -> Seconds:
    """Of `call` for each goal, the least of some repeats; a first call is not counted."""
    call(goals[0])
    spent = np.empty((repeats, len(goals)))
    for round_ in range(repeats):
        for i, goal in enumerate(goals):
            began = process_time()
            call(goal)
            spent[round_, i] = process_time() - began
    least = spent.min(axis=0)
    return Seconds(float(np.median(least)), float(least.max()))


def durations(trajectories: Sequence[Trajectory]) -> Floats:
    """[s] (N,)."""
    return np.array([one.duration for one in trajectories])


# Conventions of the paper's code


def replayed(trajectories: Sequence[Trajectory], vehicle: PlantParameters, goals: Floats) -> Floats:
    """Distance (N,) [m] to the goals after the sprocket speeds of plans, on the model (27).

    Its slip is the table of the vehicle on its soil, with beta subtracted.
    """
    model, missed = PseudoKinematicModel(vehicle, identified_slip(vehicle)), []
    for t, goal in zip(trajectories, goals, strict=True):
        pose = np.array([[t.x[0], t.y[0], t.yaw[0]]])
        inputs = np.stack([t.sprocket_left, t.sprocket_right], axis=1)[:-1]
        first = np.flatnonzero(np.append(True, np.any(np.diff(inputs, axis=0) != 0.0, axis=1)))
        times = np.append(t.time[first], t.time[-1])
        for speeds, duration in zip(inputs[first], np.diff(times), strict=True):
            for _ in range(SUBSTEPS):
                pose = model.step(pose, speeds[None], float(duration) / SUBSTEPS)
        missed.append(math.hypot(pose[0, 0] - goal[0], pose[0, 1] - goal[1]))
    return np.array(missed)


class Unwrapped(NamedTuple):
    """Plans at constant speed to yaws as the code has them, (N,) each."""

    duration: Floats  # [s]
    converged: Any  # (N,) bool
    turns: Floats  # [-] whole turns from the yaw of the shortest Dubins path to that of the goal


def unwrapped(ground: Ground, goals: Floats) -> Unwrapped:
    """From the Dubins path, as in F, to the yaw in [0, 2 pi) as it stands."""
    vehicle, limits = ground.vehicle, ground.limits()
    half, belt = 0.5 * vehicle.track_gauge, vehicle.sprocket_radius * limits.sprocket_used
    surface = surface_of(identified_slip(vehicle), vehicle, limits.sprocket_used, SPEED)
    none = math.inf
    bounds = Bounds(float(belt), SPEED, SPEED, none, none, none, none, float(half), True, False)
    w = make_work(INTERVALS)
    rows = []
    for goal, guess in zip(goals, plans(ground, "dubins, 0.5 m", goals), strict=True):
        x, y, yaw = (float(value) for value in goal)
        task = Task(0.0, x, y, yaw, 0.0, 0.0, False, 0, 0, 1.0)
        knots = np.linspace(0.0, guess.duration, INTERVALS + 1)
        turned = np.diff(np.interp(knots, guess.time, guess.course)) / np.diff(knots)
        w.belts[:, 0], w.belts[:, 1] = SPEED, half * turned
        duration, _cost, converged, _used = solve(
            task, bounds, surface, guess.duration, w, ITERATIONS, math.inf
        )
        rows.append((duration, converged, (yaw - guess.course[-1]) / (2.0 * math.pi)))
    duration, converged, turns = np.array(rows, dtype=float).T
    return Unwrapped(duration, converged > 0.0, np.round(turns))


def exponential(ground: Ground) -> ExponentialSlipModel:
    """(54) fitted to the runs of the ground's sweep up to IDENTIFIED."""
    vehicle = ground.vehicle
    return fit_exponential(within(sweep(vehicle), IDENTIFIED), vehicle)[0]


def to_figure_16(ground: Ground, friction: float, slip: SlipModel) -> Any:
    """The plan to the goal of figure 16 with v in [0, FAST], on another mu."""
    return optimal(ORIGIN, FIGURE_16, ground.limits(0.0, FAST), ground.on(friction), slip)


def levels(ground: Ground) -> dict[tuple[str, str], Trajectory]:
    """{(sign of SIGNS, level of LEVELS): plan of 7.2.2 to the goal of figure 16}."""
    fitted, plans = exponential(ground), {}
    for (sign, factor), (level, times) in product(SIGNS.items(), LEVELS.items()):
        constants = fitted.constants * np.array(times)
        constants[:2, 0] *= factor
        slip = ExponentialSlipModel(constants, fitted.track_gauge)
        plans[sign, level] = to_figure_16(ground, ground.friction, slip)
    return plans


def soils(ground: Ground, frictions: Sequence[float] = (0.4, 0.2, 0.1)) -> dict[float, Trajectory]:
    """{mu: plan to the goal of figure 16 with the slip identified there}."""
    return {mu: to_figure_16(ground, mu, identified_slip(ground.on(mu))) for mu in frictions}
