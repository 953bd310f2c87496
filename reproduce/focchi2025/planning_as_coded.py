"""Section 6.3 and 7.2.2 with the conventions of the paper's code, one at a time.

added_slip  the forward map with beta added, (29) as printed: slip turns the vehicle more.
            Data and controller have beta = r omega - v_track, which is subtracted
unwrapped   the yaw of the goal in [0, 2 pi), to be reached as it stands: (52) does not wrap
levels      7.2.2: c_1 and c_2 of (54) times numbers of the code, instead of other soils
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from baselines.lyapunov.pseudo_kinematic import PseudoKinematicModel
from baselines.planners.interior_point import solve
from baselines.planners.interval_limits import Bounds
from baselines.planners.optimal import optimal
from baselines.planners.planning_problem import Task, make_work
from baselines.planners.riccati import make_stages
from baselines.planners.surface_fit import surface_of
from baselines.planners.trajectory import Trajectory
from baselines.slip.slip_models import ExponentialSlipModel
from baselines.slip.slip_regression import fit_exponential
from baselines.slip.slip_sweep import identified_slip, sweep
from reproduce.focchi2025.identification import within
from reproduce.focchi2025.planning import FIGURE_16, ORIGIN, SPEED, Ground, plans
from reproduce.focchi2025.runs import Floats
from tracked_env.physics.parameters import PlantParameters

INTERVALS = 40  # [-] N of Table 1
ITERATIONS = 200  # of the interior point method
FAST = 0.8  # [m/s] v_max of 7.2.2
IDENTIFIED = 10.0  # [rad/s] sprocket speeds up to which (54) is fitted, section 4
LEVELS = {"normal": (1.0, 1.0), "medium": (3.0, 0.5), "high": (4.0, 0.25)}  # [-] of c_1, of c_2
PRINTED_LEVELS = {"normal": 5.2, "medium": 4.9, "high": 4.12}  # [s] T of 7.2.2
SIGNS = {"subtracted": 1.0, "added": -1.0}  # of beta in the forward map
SUBSTEPS = 8  # of the model in a held interval


def replayed(found: Sequence[Trajectory], vehicle: PlantParameters, goals: Floats) -> Floats:
    """Distance (N,) [m] to the goals after the sprocket speeds of plans, on the model (27).

    Its slip is the table of the vehicle on its soil, with beta subtracted.
    """
    model, missed = PseudoKinematicModel(vehicle, identified_slip(vehicle)), []
    for made, goal in zip(found, goals, strict=True):
        pose = np.array([[made.x[0], made.y[0], made.yaw[0]]])
        inputs = np.stack([made.sprocket_left, made.sprocket_right], axis=1)[:-1]
        first = np.flatnonzero(np.append(True, np.any(np.diff(inputs, axis=0) != 0.0, axis=1)))
        times = np.append(made.time[first], made.time[-1])
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
    w, a = make_work(INTERVALS), make_stages(INTERVALS)
    rows = []
    for goal, guess in zip(goals, plans(ground, "dubins, 0.5 m", goals), strict=True):
        x, y, yaw = (float(value) for value in goal)
        task = Task(0.0, x, y, yaw, 0.0, 0.0, False, 0, 0, 1.0)
        knots = np.linspace(0.0, guess.duration, INTERVALS + 1)
        turned = np.diff(np.interp(knots, guess.time, guess.course)) / np.diff(knots)
        w.belts[:, 0], w.belts[:, 1] = SPEED, half * turned
        duration, _cost, converged, _used = solve(
            task, bounds, surface, guess.duration, w, a, ITERATIONS, math.inf
        )
        rows.append((duration, converged, (yaw - guess.course[-1]) / (2.0 * math.pi)))
    found = np.array(rows, dtype=float).T
    return Unwrapped(found[0], found[1] > 0.0, np.round(found[2]))


def exponential(ground: Ground) -> ExponentialSlipModel:
    """(54) fitted to the runs of the ground's sweep up to IDENTIFIED."""
    vehicle = ground.vehicle
    return fit_exponential(within(sweep(vehicle), IDENTIFIED), vehicle)[0]


def levels(ground: Ground) -> dict[tuple[str, str], Trajectory]:
    """{(sign of SIGNS, level of LEVELS): plan of 7.2.2 to the goal of figure 16}."""
    fitted, found = exponential(ground), {}
    for sign, factor in SIGNS.items():
        for level, times in LEVELS.items():
            constants = fitted.constants * np.array(times)
            constants[:2, 0] *= factor
            model = ExponentialSlipModel(constants, fitted.track_gauge)
            made = optimal(ORIGIN, FIGURE_16, ground.limits(0.0, FAST), ground.vehicle, model)
            assert isinstance(made, Trajectory)
            found[sign, level] = made
    return found


def soils(ground: Ground, frictions: Sequence[float] = (0.4, 0.2, 0.1)) -> dict[float, Trajectory]:
    """{mu: plan to the goal of figure 16 with v in [0, FAST] and the slip identified there}."""
    found = {}
    for friction in frictions:
        slippery = ground.on(friction)
        made = optimal(
            ORIGIN, FIGURE_16, ground.limits(0.0, FAST), slippery, identified_slip(slippery)
        )
        assert isinstance(made, Trajectory)
        found[friction] = made
    return found
