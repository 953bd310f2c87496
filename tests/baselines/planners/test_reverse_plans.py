"""Optimal plans that may drive in reverse: exact mirrors, cheaper where the goal is behind."""

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.planners.motion_planning import plan
from baselines.planners.slip_surface import surface_of
from baselines.planners.trajectory import Limits, Start
from tests.baselines.planners import planner_cases as cases

REST = Limits.of(cases.FOCCHI, reserve=0.1, sprocket_acceleration=20.0)
ANY_SPEED = (
    cases.limits_of(cases.FOCCHI, 0.4),
    cases.limits_of(cases.FOCCHI, 0.15),
    cases.limits_of(cases.FOCCHI, 0.0),
    REST,
)
NAMES = ("constant speed", "from 0.15 m/s", "from 0 m/s", "rest to rest")


def drive(goal, limits=REST, start=cases.ORIGIN, **options):
    return plan(start, goal, limits, cases.SLIP, vehicle=cases.FOCCHI, **options)


def reversals(motion):
    signs = np.sign(motion.speed[np.abs(motion.speed) > 1e-9])
    return int(np.count_nonzero(np.diff(signs)))


@pytest.mark.parametrize("limits", ANY_SPEED, ids=NAMES)
@pytest.mark.parametrize("goal", [(1.5, 0.4, 0.3), (1.0, -0.2, -0.2), (2.0, 0.0, 0.0)])
def test_a_plan_in_reverse_is_the_forward_plan_mirrored(goal, limits):
    """Driven backwards to the mirrored goal, each track does what the other did forwards."""
    forth = drive(goal, limits)
    back = drive((-goal[0], -goal[1], goal[2]), limits, reverse=True)
    same = "time", "yaw", "course", "course_rate", "yaw_rate", "yaw_acceleration"
    mirrored = {name: name for name in ("x", "y", "speed", "acceleration")}
    mirrored |= {"sprocket_left": "sprocket_right", "sprocket_right": "sprocket_left"}
    pairs = [*((name, name, 1) for name in same), *((*pair, -1) for pair in mirrored.items())]
    for name, other, sign in pairs:
        expected = sign * getattr(forth, other)
        np.testing.assert_allclose(getattr(back, name), expected, rtol=0.0, atol=1e-9)
    assert back.cost == pytest.approx(forth.cost, abs=1e-9)
    assert (back.speed <= 0.0).all()


@pytest.mark.parametrize("limits", ANY_SPEED, ids=NAMES)
def test_a_goal_behind_is_reached_backwards_and_sooner_one_ahead_as_without_reverse(limits):
    forth, back = (drive((-1.0, 0.1, 0.1), limits, reverse=way) for way in (False, True))
    assert forth.converged and back.converged
    assert back.cost < 0.6 * forth.cost
    assert back.speed.max() < 1e-9 < forth.speed.max()
    forth, free = (drive((2.0, 0.5, 0.4), limits, reverse=way) for way in (False, True))
    assert np.array_equal(forth.sprocket_left, free.sprocket_left)


def test_a_goal_beside_is_reached_with_a_change_of_gear():
    limits = REST
    forth, free = (drive((0.0, 0.5, 0.0), limits, reverse=way) for way in (False, True))
    assert free.converged and reversals(free) >= 1
    assert free.cost < forth.cost
    assert cases.missed(cases.end_of_plan(free), (0.0, 0.5, 0.0)) < 1e-6
    for side in (free.sprocket_left, free.sprocket_right):
        assert np.abs(side).max() <= limits.sprocket_used + 1e-6
        # held inputs: from one interval to the next a belt changes by 20 rad/s^2 times its length
        longest = free.duration / 40
        assert np.abs(np.diff(side)).max() <= 20.0 * longest + 1e-6
    fine = drive((0.0, 0.5, 0.0), limits, reverse=True, period=0.005)
    assert np.all(np.diff(fine.time) > 0.0)
    assert np.abs(np.diff(fine.yaw)).max() < 0.02


@pytest.mark.parametrize("goal", [(-1.0, 0.1, 0.1), (0.0, 0.5, 0.0), (-0.5, -0.7, 2.0)])
def test_sprocket_speeds_in_both_gears_replayed_on_the_model_end_at_the_goal(goal):
    motion = drive(goal, reverse=True, period=10.0)
    surface = cases.SurfaceSlip(surface_of(cases.SLIP, cases.FOCCHI, REST.sprocket_used, 0.4))
    model = PseudoKinematicModel(cases.FOCCHI, surface)
    assert motion.converged and motion.speed.min() < -0.05
    assert cases.missed(cases.replayed(model, motion), goal) < 1e-3
    assert motion.end_error < 1e-6 and motion.end_yaw_error < 1e-6


def test_many_goals_have_a_plan_and_none_costs_more_with_reverse():
    rng = np.random.default_rng(3)
    goals = np.column_stack([rng.uniform(-2.0, 2.0, (40, 2)), rng.uniform(-3.1, 3.1, 40)])
    forth, free = (drive(goals, reverse=way) for way in (False, True))
    assert all(motion.converged for motion in free)
    costs = np.array([[a.cost, b.cost] for a, b in zip(forth, free, strict=True)])
    assert (costs[:, 1] <= costs[:, 0] + 1e-12).all()
    assert costs[:, 1].mean() < 0.9 * costs[:, 0].mean()
    for goal, motion in zip(goals, free, strict=True):
        assert cases.missed(cases.end_of_plan(motion), goal) < 1e-6


def test_a_vehicle_that_moves_backwards_goes_on_backwards():
    start = Start(speed=-0.3)
    motion = drive((-1.5, 0.0, 0.0), start=start, reverse=True)
    step = motion.duration / 40
    assert motion.converged
    first = -0.3 / cases.FOCCHI.sprocket_radius
    assert abs(motion.sprocket_left[0] - first) <= 20.0 * step + 1e-6
    assert motion.duration < drive((-1.5, 0.0, 0.0), reverse=True).duration
