"""Optimal plans on slopes: gravity drags a vehicle along, in another direction at every yaw.

The planner's slip is that of level ground. Its sprocket speeds are driven on the slope, with the
slip of the grade at the pose of every step, and it plans again to a goal that is moved by what was
missed, until they end at the goal (Broyden's method, with shorter steps where the plan changes to
another word and misses more). The whole turns stay those of the first plan. The ground is z =
h(x, y) with the slopes h_x, h_y at the centre; u is the direction of yaw, v to its left,
c^2 = 1 + h_u^2, g^2 = 1 + h_x^2 + h_y^2:
    grade       t_x = -h_u g / c     t_y = -h_v / c                    of slip.slip_models
    axes        e_x = (cos, sin) / c     e_y = (-sin - h_y h_u, cos + h_x h_u) / (g c)
    motion      (x', y') = v_x e_x + v_y e_y     yaw' = w c^2 / g
Left out: inertia; that uphill slip costs time, so that the plan is not exactly the fastest; contact
with ground that is curved over the length of the vehicle.

References: [F] Focchi et al. (2025), section 4.5.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.planners.trajectory import Start, Trajectory, checked_table, slope_of
from baselines.slip.slip_models import FrictionLayers, TableSlipModel, look_up_on_slopes
from tracked_env.physics.jit import formula, loop
from tracked_env.physics.parameters import PlantParameters, Range

Array = NDArray[np.float64]
# (x, y) (M,) [m] -> height [m] and its slopes in x and y [-], (M,) each
Heights = Callable[[Array, Array], tuple[Array, Array, Array]]
Ground = Heights | Sequence[float]  # or the slopes of a plane in x and y
LevelPlanner = Callable[[Start, Array, bool, float | None], Trajectory]  # with its change of yaw

STEP = 0.02  # [s] of the integration at most
REACHED = 2e-4  # [m], [rad] missed at which a plan is good enough
MISSED = 1e-3  # [m], [rad] with which it still is one
PASSES = 20  # at most
LOOKS = 2  # integrations of a pass: the second one takes the slopes where the first one was
SLOPE = Range(-1.0, 1.0, "-", "It is a slope, not an angle in degrees.")


def slopes_of(ground: Ground) -> Heights:
    """The ground as a function, as the `at` of a height field is. Raises ValueError."""
    if callable(ground):
        return ground
    ((a, b),) = checked_table("ground slope", ground, {"x": SLOPE, "y": SLOPE}).tolist()
    return lambda x, y: (a * x + b * y, np.full_like(x, a), np.full_like(y, b))


@formula
def grade_at(yaw, slope_x, slope_y):
    """Grade t_x, t_y [-] that a vehicle feels, and h_u, c, g of the header."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    up, aside = slope_x * cos + slope_y * sin, slope_y * cos - slope_x * sin
    c, g = math.sqrt(1.0 + up * up), math.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return -up * g / c, -aside / c, up, c, g


@loop
def _slip_at(yaw, slope, table, gauge, soil, w):
    """v_x, v_y [m/s], yaw rate [rad/s] of the belts in w at a yaw; w: work space."""
    speeds, grade, out = w
    grade[0, 0], grade[0, 1], _up, _c, _g = grade_at(yaw, slope[0], slope[1])
    look_up_on_slopes(table, speeds, grade, soil, out)
    left, right = table.radius * speeds[0, 0] - out[0, 0], table.radius * speeds[1, 0] - out[0, 1]
    v_x = 0.5 * (left + right)
    return v_x, v_x * math.tan(out[0, 2]), (right - left) / gauge


@loop
def _drive(pose, times, sprockets, slopes, table, gauge, soil, motion):
    """Poses and speeds (M, 6) at times (M,) of sprocket speeds (M, 2) held from each on.

    slopes (M, 2): of the ground there, linear between. soil: FrictionLayers of one vehicle.
    """
    w = np.empty((2, 1)), np.empty((1, 2)), np.empty((1, 3))
    x, y, yaw = pose[0], pose[1], pose[2]
    slope = np.empty(2)
    for k in range(len(times)):
        w[0][0, 0], w[0][1, 0] = sprockets[k, 0], sprockets[k, 1]
        v_x, v_y, turn = _slip_at(yaw, slopes[k], table, gauge, soil, w)
        out = motion[k]
        out[0], out[1], out[2], out[3], out[4], out[5] = x, y, yaw, v_x, v_y, turn
        if k == len(times) - 1:
            break
        parts = int((times[k + 1] - times[k]) / STEP) + 1
        step = (times[k + 1] - times[k]) / parts
        for part in range(parts):
            share = (part + 0.5) / parts
            slope[0] = slopes[k, 0] + share * (slopes[k + 1, 0] - slopes[k, 0])
            slope[1] = slopes[k, 1] + share * (slopes[k + 1, 1] - slopes[k, 1])
            middle = yaw + 0.5 * step * turn
            v_x, v_y, turn = _slip_at(middle, slope, table, gauge, soil, w)
            _t_x, _t_y, up, c, g = grade_at(middle, slope[0], slope[1])
            rate = turn * c * c / g
            middle = yaw + 0.5 * step * rate
            cos, sin = math.cos(middle), math.sin(middle)
            x += step * (v_x * cos / c - v_y * (sin + slope[1] * up) / (g * c))
            y += step * (v_x * sin / c + v_y * (cos + slope[0] * up) / (g * c))
            yaw += step * rate


class Terrain(NamedTuple):
    """The ground, and the vehicle on it."""

    heights: Heights
    slip_model: TableSlipModel
    vehicle: PlantParameters

    @classmethod
    def of(cls, ground: Ground, model: Any, vehicle: PlantParameters) -> "Terrain":
        """Raises ValueError for a slip model that knows no slopes."""
        if not (isinstance(model, TableSlipModel) and model.family.sloped):
            raise ValueError(
                f"slip_model = {type(model).__name__} with a ground; must know slopes: "
                "`identified_slope_slip(vehicle)` of baselines.slip"
            )
        return cls(slopes_of(ground), model, vehicle)

    def slopes(self, x: Array, y: Array) -> Array:
        """(M, 2) slopes at places (M,)."""
        _, slope_x, slope_y = self.heights(np.ascontiguousarray(x), np.ascontiguousarray(y))
        return np.stack([slope_x, slope_y], axis=1)

    def replay(self, plan: Trajectory, along: Array | None = None) -> Array:
        """Poses and speeds (M, 6) of a trajectory's sprocket speeds.

        along (M, 2): where the slopes are taken; None: along the trajectory.
        """
        family, gauge = self.slip_model.family, self.vehicle.track_gauge
        soil = FrictionLayers.of(family.frictions, self.slip_model.friction, 1)
        slopes = self.slopes(*((plan.x, plan.y) if along is None else along.T))
        pose = np.array([plan.x[0], plan.y[0], plan.yaw[0]])
        sprockets = np.stack([plan.sprocket_left, plan.sprocket_right], axis=1)
        table = family.table._replace(radius=self.vehicle.sprocket_radius)
        out = np.empty((len(plan.time), 6))
        _drive(pose, plan.time, sprockets, slopes, table, gauge, soil, out)
        return out


class _Trial(NamedTuple):
    """A plan and what it does on the ground."""

    plan: Trajectory
    motion: Array  # (M, 6) poses and speeds
    missed: Array  # (3,) end less goal: x, y [m], yaw [rad]

    @property
    def off(self) -> float:
        """The larger of distance [m] and yaw [rad] missed."""
        return max(math.hypot(self.missed[0], self.missed[1]), abs(self.missed[2]))


def _trial(goal: Array, terrain: Terrain, plan: Trajectory, before: _Trial | None) -> _Trial:
    """What a plan does on the ground, with the slopes that it meets there."""
    along = None
    if before is not None:
        share, then = (np.linspace(0.0, 1.0, len(rows)) for rows in (plan.time, before.motion))
        along = np.stack([np.interp(share, then, c) for c in before.motion[:, :2].T], axis=1)
    for _ in range(LOOKS):
        motion = terrain.replay(plan, along)
        along = motion[:, :2]
    missed: Array = motion[-1, :3] - goal
    missed[2] = math.remainder(missed[2], 2.0 * math.pi)
    return _Trial(plan, motion, missed)


def plan_on_terrain(
    level: LevelPlanner, start: Start, goal: Array, last: bool, terrain: Terrain
) -> Trajectory:
    """The plan that ends at a goal (3,) on the ground; level: plans on level ground."""
    plan = level(start, goal, last, None)
    if not plan.converged:
        return plan
    best, aim, shorter, jacobian = _trial(goal, terrain, plan, None), goal, 1.0, np.eye(3)
    iterations, turning = plan.iterations, float(plan.yaw[-1] - plan.yaw[0])
    for _ in range(PASSES - 1):
        if best.off < REACHED:
            break
        away = -shorter * np.linalg.solve(jacobian, best.missed)
        plan = level(start, aim + away, last, turning)
        iterations, shorter = iterations + plan.iterations, 0.5 * shorter
        if not plan.converged:
            continue
        trial, turning = _trial(goal, terrain, plan, best), float(plan.yaw[-1] - plan.yaw[0])
        off = trial.missed - best.missed - jacobian @ away
        if not np.abs(off).max() > np.abs(away).max():
            jacobian += np.outer(off, away) / (away @ away)
        if trial.off < best.off:
            best, aim, shorter = trial, aim + away, 1.0
    return _trajectory(best, terrain)._replace(iterations=iterations)


def _trajectory(best: _Trial, terrain: Terrain) -> Trajectory:
    """The trajectory of what the vehicle does on the ground."""
    plan, (x, y, yaw, v_x, v_y, turn) = best.plan, best.motion.T
    alpha = np.arctan2(v_y, np.abs(v_x)) * np.where(v_x < 0.0, -1.0, 1.0)
    speed, course = np.copysign(np.hypot(v_x, v_y), v_x), yaw + alpha
    places = zip(yaw, terrain.slopes(x, y), strict=True)
    grade = np.array([grade_at(angle, *slope)[:2] for angle, slope in places])
    model, belts = terrain.slip_model, (plan.sprocket_left, plan.sprocket_right)
    holds = model.family.holds(*belts, grade, float(np.ravel(model.friction)[0]))

    missed, turned = math.hypot(best.missed[0], best.missed[1]), abs(float(best.missed[2]))
    notes = [plan.message] if plan.message else []
    reached = missed <= MISSED and turned <= MISSED
    if not reached:
        notes.append(f"on the slope the plan ends {missed:.3g} m and {turned:.3g} rad off")
    slides = float(np.mean(~holds[:-1])) if len(holds) > 1 else 0.0
    if slides > 0.0:
        notes.append(f"the vehicle slides or turns downhill for {100.0 * slides:.0f} % of it")
    poses = plan.time, x, y, yaw, course
    gain, bend, spin = (slope_of(values, plan.time) for values in (speed, course, turn))
    rates = speed, gain, bend, slope_of(bend, plan.time), turn, spin
    outcome = plan.cost, plan.converged and reached, plan.iterations, missed, turned, plan.method
    return Trajectory._make((*poses, *rates, *belts, *outcome, "; ".join(notes)))
