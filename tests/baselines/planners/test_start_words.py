"""Starts of optimal plans: near goals, tight turns on slippery ground, whole turns."""

import math

import numpy as np
import pytest

from baselines.planners.optimal import optimal
from baselines.planners.trajectory import Limits
from tests.baselines.planners.optimal_cases import (
    FOCCHI,
    ORIGIN,
    SLIP,
    halton_goals,
    limits_of,
    vehicle_on,
)


@pytest.mark.parametrize("v_min", [0.4, 0.15, 0.0])
@pytest.mark.parametrize("away", [1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1])
def test_a_goal_a_few_millimetres_ahead_is_reached_straight(v_min, away):
    vehicle, slip = vehicle_on(0.4, limit=10.0)
    limits = limits_of(vehicle, v_min, reserve=0.1)
    made = optimal(ORIGIN, (away, 0.0, 0.0), limits, vehicle, slip)
    assert made.converged
    assert made.duration < away / 0.4 + 2e-3
    assert made.length == pytest.approx(away, rel=1e-6)


def test_goals_a_millimetre_away_are_reached_by_small_turns():
    vehicle, slip = vehicle_on(0.4, limit=10.0)
    directions = np.array([0.0, 0.001, 0.01, 0.1, 0.5, 1.57, math.pi, -2.0])
    x, y = 1e-3 * np.cos(directions), 1e-3 * np.sin(directions)
    made = optimal(ORIGIN, np.column_stack([x, y, 0.0 * x]), limits_of(vehicle, 0.0, reserve=0.1),
                   vehicle, slip)  # fmt: skip
    assert all(plan.converged for plan in made)
    assert np.mean([plan.cost for plan in made]) < 2.0
    assert max(plan.length for plan in made) < 0.6


def test_tight_turns_on_slippery_ground_are_found_by_few_iterations():
    """79 with starts that drive their arcs at full speed, and so in wide loops."""
    vehicle, slip = vehicle_on(0.1, "focchi-short", 10.0)
    made = optimal(ORIGIN, halton_goals(1.0), limits_of(vehicle, 0.0), vehicle, slip)
    assert all(plan.converged for plan in made)
    assert max(plan.iterations for plan in made) <= 60
    assert np.mean([plan.cost for plan in made]) < 8.723


@pytest.mark.parametrize(
    "row, v_min, reserve, cost",
    [(18, 0.15, 0.0, 11.1131), (34, 0.15, 0.0, 9.7459), (34, 0.0, 0.0, 9.7459),
     (8, 0.4, 0.25, 11.9477)],
)  # fmt: skip
def test_the_cheaper_winding_is_found_on_slippery_ground(row, v_min, reserve, cost):
    """The plan from the shortest word needs over 30 iterations, or the cheapest word is longer."""
    vehicle, slip = vehicle_on(0.1, limit=10.0)
    limits = Limits(10.0, reserve, v_min=v_min, v_max=0.4)
    made = optimal(ORIGIN, halton_goals(1.0)[row], limits, vehicle, slip)
    assert made.converged
    assert made.cost < 1.001 * cost


def test_a_plan_winds_as_it_is_told():
    goal = (1.0, 1.0, 0.5)
    for turning in (0.5, 0.5 + 2.0 * math.pi, 0.5 - 2.0 * math.pi):
        made = optimal(ORIGIN, goal, limits_of(FOCCHI, 0.15), FOCCHI, SLIP, turning=turning)
        assert made.converged
        assert made.yaw[-1] == pytest.approx(turning, abs=1e-6)
