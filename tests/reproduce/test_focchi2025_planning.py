"""Focchi et al. (2025), section 7.2, run again: goals, durations, tracking, conventions."""

import numpy as np
import pytest

from baselines.slip.slip_models import NoSlip
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import planning as coded
from reproduce.focchi2025 import planning_loop as loop
from reproduce.focchi2025.claims import SLC_SLP, UC_DP, UC_SLP
from reproduce.focchi2025.planning import (
    FIGURE_16,
    AddedSlip,
    Ground,
    durations,
    halton_goals,
    plans,
    seconds,
)
from reproduce.focchi2025.planning_loop import Job, Pair
from tests.baselines.planners.planner_cases import published_targets

GROUND = Ground()
RIGHT, FLIPPED = coded.SIGNS


@pytest.fixture(scope="module")
def goals():
    return halton_goals(100)


@pytest.mark.parametrize("nearest", [1.0, 2.0])
def test_the_goals_are_the_halton_points_of_the_published_list(reference_data, nearest):
    listed, annulus = published_targets(reference_data, "annulus_min")
    rows = annulus == nearest
    assert rows.sum() == 100
    np.testing.assert_allclose(halton_goals(100, nearest), listed[rows], atol=1e-9)


@pytest.mark.parametrize(
    ("planner", "duration"), [("dubins", 8.12), ("clothoid", 9.07), ("optimal", 8.69)]
)
def test_plans_to_the_goal_of_figure_16_last_as_long_as_printed(planner, duration):
    (plan,) = plans(GROUND, planner, np.array([FIGURE_16]))
    assert plan.duration == pytest.approx(duration, abs=0.01)


def test_an_unknown_planner_is_refused_with_the_names_of_those_that_are_there():
    with pytest.raises(ValueError, match=r"unknown planner 'optimum'.*optimal, rest to rest"):
        plans(GROUND, "optimum", halton_goals(1))


def test_clothoids_take_83_percent_longer_than_dubins_paths_and_optimal_plans_12(goals):
    shortest = durations(plans(GROUND, "dubins", goals)).mean()
    ratio = {
        n: durations(plans(GROUND, n, goals)).mean() / shortest for n in ("clothoid", "optimal")
    }
    assert ratio["clothoid"] == pytest.approx(1.83, abs=0.01)
    assert ratio["optimal"] == pytest.approx(1.117, abs=0.005)


def test_a_yaw_that_is_not_wrapped_winds_half_of_the_plans_a_whole_turn_more(goals):
    result = coded.unwrapped(GROUND, goals)
    shortest = durations(plans(GROUND, "dubins", goals))
    converged = result.converged
    assert 45 <= np.sum(result.turns == 1.0) <= 60 and not np.any(result.turns < 0.0)
    assert result.duration[converged].mean() / shortest[converged].mean() == pytest.approx(
        1.24, abs=0.01
    )
    assert converged.mean() > 0.9
    straight = converged & (result.turns == 0.0)
    usual = durations(plans(GROUND, "optimal", goals))
    np.testing.assert_allclose(
        np.median(result.duration[straight] / usual[straight]), 1.0, atol=0.01
    )


@pytest.mark.slow
def test_plans_that_add_beta_end_farther_from_the_goal_than_plans_without_slip(goals):
    table = identified_slip(GROUND.vehicle)
    missed = {
        name: coded.replayed(plans(GROUND, "optimal", goals, model), GROUND.vehicle, goals).mean()
        for name, model in (
            ("right", table),
            ("none", NoSlip()),
            ("added", AddedSlip(table)),
        )
    }
    assert missed["right"] < 0.01
    assert missed["none"] == pytest.approx(1.11, abs=0.05)
    assert missed["added"] == pytest.approx(1.72, abs=0.05)


def test_slip_makes_a_plan_faster_only_where_beta_is_added():
    result = {key: plan.duration for key, plan in coded.levels(GROUND).items()}
    added = [result[FLIPPED, level] for level in coded.LEVELS]
    assert added == sorted(added, reverse=True) and added[0] - added[-1] > 0.1
    assert result[RIGHT, "high"] > result[RIGHT, "normal"] + 0.1
    soils = [plan.duration for plan in coded.soils(GROUND).values()]
    assert soils == sorted(soils) and soils[-1] - soils[0] > 0.2


@pytest.mark.slow
def test_from_a_matched_start_the_slippage_aware_pair_stays_within_15_mm(goals):
    ground = Ground(reserve=0.1)
    result = loop.track(ground, "moving", (UC_SLP, SLC_SLP, loop.VARIABLE), goals[:40])
    assert result[SLC_SLP].distance.mean() <= 0.015
    assert result[SLC_SLP].distance.mean() < 0.005  # with a continuous course
    assert result[SLC_SLP].heading.mean() < 0.02
    assert result[SLC_SLP].missed.mean() < 0.015
    assert result[UC_SLP].distance.mean() < 0.015
    assert result[loop.VARIABLE].distance.mean() < 0.015


@pytest.mark.slow
def test_from_rest_the_start_is_most_of_the_error_and_the_exchanged_frame_misses_the_goal(goals):
    pairs = (SLC_SLP, loop.VARIABLE, Pair("slc", "optimal", True))
    usual, variable, exchanged = loop.track(GROUND, "rest", pairs, goals[:20]).values()
    assert 0.03 < usual.distance.mean() < 0.07
    assert variable.distance.mean() < 0.8 * usual.distance.mean()
    assert exchanged.missed.mean() > 2.0 * usual.missed.mean()
    assert exchanged.turned.mean() > 5.0 * usual.turned.mean()


def test_plans_from_rest_to_rest_are_followed_from_rest_and_end_at_the_goal(goals):
    result = loop.track(Ground(reserve=0.1), "rest", loop.REST, goals[:10])
    for one in result.values():
        assert one.distance.mean() < 0.01 and one.missed.mean() < 0.015
        assert one.turned.mean() < 0.015


def test_a_moving_start_is_the_motion_and_the_sprockets_of_the_plan():
    (plan,) = plans(GROUND, "optimal", np.array([FIGURE_16]))
    state, sprockets = loop.begin(plan, "moving")
    assert np.hypot(*state[3:5]) == pytest.approx(plan.speed[0])
    assert state[5] == plan.yaw_rate[0]
    assert tuple(sprockets) == (plan.sprocket_left[0], plan.sprocket_right[0])
    assert not np.any(loop.begin(plan, "rest")[0][3:])


def test_blocks_keep_every_job_once_and_put_long_plans_apart(goals):
    jobs = [Job(UC_DP, i, plan) for i, plan in enumerate(plans(GROUND, "clothoid", goals))]
    blocks = loop.blocks(jobs)
    assert sorted(job.number for block in blocks for job in block) == list(range(100))
    assert [len(block) for block in blocks] == [loop.BLOCK] * 2
    ends = [max(job.trajectory.duration for job in block) for block in blocks]
    assert ends == sorted(ends) and ends[-1] > 100.0


def test_a_vehicle_s_errors_do_not_depend_on_the_others_of_its_block(goals):
    result = loop.track(GROUND, "rest", (UC_SLP,), goals[:5])[UC_SLP]
    alone = loop.track(GROUND, "rest", (UC_SLP,), goals[3:4])[UC_SLP]
    assert alone.distance[0] == pytest.approx(result.distance[3], rel=1e-6)


def test_times_are_of_every_goal_and_their_median_is_not_their_worst():
    def call(goal):
        return sum(range(200_000 if goal[0] > 4.0 else 2_000))

    result = seconds(call, np.arange(6.0)[:, None], repeats=2)
    assert 0.0 < result.median < 0.2 * result.worst
