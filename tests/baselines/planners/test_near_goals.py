"""Plans to near goals: initial guesses, whole turns, and an alarm for missed minima."""

import math

import numpy as np
import pytest

from baselines.planners.interior_point import solve
from baselines.planners.least_time import _prepared, _task, optimal
from baselines.planners.planning_problem import make_work
from baselines.planners.slip_surface import surface_of
from baselines.planners.trajectory import Limits, Start
from baselines.slip.slip_sweep import identified_slip, with_friction
from tests.baselines.planners.planner_cases import (
    FOCCHI,
    ORIGIN,
    SLIP,
    belts_of,
    halton_goals,
    limits_of,
    vehicle_on,
)
from tracked_env.physics.parameters import VEHICLES


@pytest.mark.parametrize("v_min", [0.4, 0.15, 0.0])
def test_goals_a_few_millimetres_ahead_are_reached_straight(v_min):
    vehicle, slip = vehicle_on(0.4, limit=10.0)
    away = np.array([1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1])
    goals, limits = np.outer(away, [1.0, 0.0, 0.0]), limits_of(vehicle, v_min, reserve=0.1)
    motion = optimal(ORIGIN, goals, limits, vehicle, slip)
    assert all(plan.converged for plan in motion)
    assert all([plan.duration for plan in motion] < away / 0.4 + 2e-3)
    assert [plan.length for plan in motion] == pytest.approx(away, rel=1e-6)


def test_goals_a_millimetre_away_are_reached_by_small_turns():
    vehicle, slip = vehicle_on(0.4, limit=10.0)
    directions = np.array([0.0, 0.001, 0.01, 0.1, 0.5, 1.57, math.pi, -2.0])
    x, y = 1e-3 * np.cos(directions), 1e-3 * np.sin(directions)
    goals, limits = np.column_stack([x, y, 0.0 * x]), limits_of(vehicle, 0.0, reserve=0.1)
    motion = optimal(ORIGIN, goals, limits, vehicle, slip)
    assert all(plan.converged for plan in motion)
    assert np.mean([plan.cost for plan in motion]) < 2.0
    assert max(plan.length for plan in motion) < 0.6


def test_tight_turns_on_slippery_ground_are_found_by_few_iterations():
    """79 with starts that drive their arcs at full speed, and so in wide loops."""
    vehicle, slip = vehicle_on(0.1, "focchi-short", 10.0)
    motion = optimal(ORIGIN, halton_goals(1.0), limits_of(vehicle, 0.0), vehicle, slip)
    assert all(plan.converged for plan in motion)
    assert max(plan.iterations for plan in motion) <= 60
    assert np.mean([plan.cost for plan in motion]) < 8.723


@pytest.mark.parametrize(
    "row, v_min, reserve, cost",
    [
        (18, 0.15, 0.0, 11.1131),
        (34, 0.15, 0.0, 9.7459),
        (34, 0.0, 0.0, 9.7459),
        (8, 0.4, 0.25, 11.9477),
    ],
)
def test_the_cheaper_winding_is_found_on_slippery_ground(row, v_min, reserve, cost):
    """The plan from the shortest word needs over 30 iterations, or the cheapest word is longer."""
    vehicle, slip = vehicle_on(0.1, limit=10.0)
    limits = Limits(10.0, reserve, v_min=v_min, v_max=0.4)
    motion = optimal(ORIGIN, halton_goals(1.0)[row], limits, vehicle, slip)
    assert motion.converged
    assert motion.cost < 1.001 * cost


def test_a_plan_winds_as_it_is_told():
    goal = (1.0, 1.0, 0.5)
    for turning in (0.5, 0.5 + 2.0 * math.pi, 0.5 - 2.0 * math.pi):
        motion = optimal(ORIGIN, goal, limits_of(FOCCHI, 0.15), FOCCHI, SLIP, turning=turning)
        assert motion.converged
        assert motion.yaw[-1] == pytest.approx(turning, abs=1e-6)


@pytest.mark.parametrize(
    ("v_min", "goal", "cost"),
    [
        (0.4, (0.628, -0.183, -0.865), 1.744),
        (0.4, (0.958, -0.682, 0.279), 3.728),
        (0.4, (0.056, 1.282, 1.246), 4.724),
        (0.15, (0.05, 0.0, 0.3), 0.2275),
        (0.15, (0.2, 0.1, 1.6), 1.180),
        (0.15, (0.315, -0.027, 1.434), 3.017),
    ],
)
def test_the_cheapest_plan_to_a_near_goal_is_found(v_min, goal, cost):
    """Least cost of 28 starts of four radii and of one arc, up to 200 iterations each."""
    vehicle = VEHICLES["focchi"]
    limits = Limits.of(vehicle, reserve=0.1, v_min=v_min, v_max=0.4)
    motion = optimal(ORIGIN, goal, limits, vehicle, identified_slip(vehicle))
    assert motion.converged
    assert motion.cost < 1.01 * cost


MISSED = 1  # [-] of the 167 pairs of one condition


def bent(motion, goal, limits, vehicle, slip, steps=10):
    """Cost of a plan that is moved in steps to another goal of the same yaw; infinite: it ends."""
    bounds, setting = _prepared(Start(), limits, vehicle, False, 1.0, math.nan)
    surface = surface_of(slip, vehicle, limits.sprocket_used, limits.v_max)
    w = make_work(40)
    w.belts[:], duration = belts_of(vehicle, motion).T, motion.duration
    first, turning = np.array([motion.x[-1], motion.y[-1], motion.yaw[-1]]), motion.yaw[-1]
    for step in range(1, steps + 1):
        target = first + (goal - first) * step / steps
        task = _task(np.zeros(3), target, turning, duration / 40, bounds, setting)
        duration, cost, converged, _ = solve(task, bounds, surface, duration, w, 200, math.inf)
        if not converged:
            return math.inf
    return cost


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.375, 0.0])
@pytest.mark.parametrize(
    ("name", "mu"), [("focchi", 0.4), ("focchi", 0.1), ("focchi", 0.05), ("focchi-short", 0.4)]
)
def test_no_plan_is_a_fifth_dearer_than_what_a_neighbours_plan_can_be_bent_into(name, mu, share):
    """2004 pairs in all, 0.1 to 4 m away, more of them near. Three of them are missed, each in
    another condition, by 1.28 to 1.39 times; before tighter words were tried it was one in a
    hundred goals, by up to 5.4 times."""
    rng, count, v_max = np.random.default_rng(3), 167, 0.4
    vehicle = with_friction(VEHICLES[name], mu)
    slip = identified_slip(vehicle)
    distance = rng.uniform(math.sqrt(0.1), 2.0, count) ** 2
    direction, yaw, way = rng.uniform(-math.pi, math.pi, (3, count))
    goals = np.column_stack([distance * np.cos(direction), distance * np.sin(direction), yaw])
    moved = rng.uniform(0.01, 0.03, count)
    others = goals + np.column_stack([moved * np.cos(way), moved * np.sin(way), 0.0 * way])
    limits = Limits.of(vehicle, reserve=0.1, v_min=share * v_max, v_max=v_max)
    missed = []
    plans = (optimal(ORIGIN, each, limits, vehicle, slip) for each in (goals, others))
    for pair in zip(*plans, goals, others, strict=True):
        cheap, dear = sorted(pair[:2], key=lambda motion: motion.cost)
        if cheap.converged and dear.cost > 1.2 * cheap.cost:
            goal = pair[3] if dear is pair[1] else pair[2]
            if bent(cheap, goal, limits, vehicle, slip) < dear.cost / 1.2:
                missed.append((goal, dear.cost, cheap.cost))
    assert len(missed) <= MISSED, missed
