"""Neighbouring goals have plans of similar cost: an alarm for missed minima that needs no oracle.

Where the costs of two neighbours differ by more than a fifth, the cheaper plan is bent step by step
into one to the other goal. If that succeeds and is cheaper, the planner has missed a minimum. If
not, the jump is one of the least cost itself: at a positive v_min a short plan ceases to exist
where its turn becomes too tight for the belts, and a loop remains.
"""

import math

import numpy as np
import pytest

from baselines.planners.interior_point import make_stages, solve
from baselines.planners.optimal import _prepared, _task, optimal
from baselines.planners.planning_problem import make_work
from baselines.planners.slip_surface import surface_of
from baselines.planners.trajectory import Limits, Start
from baselines.slip.slip_sweep import identified_slip, with_friction
from tests.baselines.planners.optimal_cases import ORIGIN, held
from tracked_env.physics.parameters import VEHICLES


@pytest.mark.parametrize(
    ("v_min", "goal", "cost"),
    [
        (0.4, (0.628, -0.183, -0.865), 1.744), (0.4, (0.958, -0.682, 0.279), 3.728),
        (0.4, (0.056, 1.282, 1.246), 4.724), (0.15, (0.05, 0.0, 0.3), 0.2275),
        (0.15, (0.2, 0.1, 1.6), 1.180), (0.15, (0.315, -0.027, 1.434), 3.017),
    ],
)  # fmt: skip
def test_the_cheapest_plan_to_a_near_goal_is_found(v_min, goal, cost):
    """Least cost of 28 starts of four radii and of one arc, up to 200 iterations each."""
    vehicle = VEHICLES["focchi"]
    limits = Limits.of(vehicle, reserve=0.1, v_min=v_min, v_max=0.4)
    made = optimal(ORIGIN, goal, limits, vehicle, identified_slip(vehicle))
    assert made.converged
    assert made.cost < 1.01 * cost


MISSED = 1  # [-] of the 167 pairs of one condition


def bent(made, goal, limits, vehicle, slip, steps=10):
    """Cost of a plan that is moved in steps to another goal of the same yaw; infinite: it ends."""
    bounds, setting = _prepared(Start(), limits, vehicle, False, 1.0, math.nan)
    surface = surface_of(slip, vehicle, limits.sprocket_used, limits.v_max)
    w, a = make_work(40), make_stages(40)
    w.belts[:], duration = held(vehicle, made).T, made.duration
    first, turning = np.array([made.x[-1], made.y[-1], made.yaw[-1]]), made.yaw[-1]
    for step in range(1, steps + 1):
        target = first + (goal - first) * step / steps
        task = _task(np.zeros(3), target, turning, duration / 40, bounds, setting)
        duration, cost, converged, _ = solve(
            task, bounds, surface, duration, w, a, 200, math.inf
        )  # fmt: skip
        if not converged:
            return math.inf
    return cost


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.375, 0.0])
@pytest.mark.parametrize(("name", "mu"), [("focchi", 0.4), ("focchi", 0.1), ("focchi", 0.05),
                                          ("focchi-short", 0.4)])  # fmt: skip
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
    for pair in zip(
        optimal(ORIGIN, goals, limits, vehicle, slip),
        optimal(ORIGIN, others, limits, vehicle, slip), goals, others, strict=True,
    ):  # fmt: skip
        cheap, dear = sorted(pair[:2], key=lambda made: made.cost)
        if cheap.converged and dear.cost > 1.2 * cheap.cost:
            goal = pair[3] if dear is pair[1] else pair[2]
            if bent(cheap, goal, limits, vehicle, slip) < dear.cost / 1.2:
                missed.append((goal, dear.cost, cheap.cost))
    assert len(missed) <= MISSED, missed
