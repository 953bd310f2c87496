"""Goals: reached or not, when, at what cost; and the sets that ask for it."""

import numpy as np
import pytest

from tests.benchmark.stub_policies import Constant, entry
from tracked_env import SPEED_ID
from tracked_env.benchmark import BenchmarkConfig, metrics
from tracked_env.benchmark.metrics import GOAL_ANGLE, GOAL_DISTANCE, goals_of
from tracked_env.benchmark.policies import registered_policy
from tracked_env.benchmark.report import goal_table
from tracked_env.benchmark.runner import run
from tracked_env.benchmark.store import Store
from tracked_env.benchmark.summary import summarise
from tracked_env.physics.parameters import VEHICLES

LENGTH, PERIOD, STEPS = 0.7, 0.1, 50
POWER = 3.0  # [W]


def measured(x, yaw, steps=STEPS, goal=(4.0, 0.0, 0.0)):
    """The numbers of one episode that moves along x(t) with yaw(t)."""
    values = np.zeros((STEPS, 1, len(metrics.CHANNELS)))
    for name, channel in (("x", x), ("yaw", yaw)):
        values[:, 0, metrics.CHANNELS.index(name)] = channel
    none, one = np.zeros(1, bool), np.ones(1)
    nominal = VEHICLES["strawa"]._replace(contact_length=LENGTH)
    trace = metrics.Trace(values, np.array([steps]), STEPS, none, none, one, one, 5.0, PERIOD)
    trace = trace._replace(nominal=nominal, goals=np.array([goal]))
    found = metrics.goal_reaching(trace, np.full((STEPS, 1), POWER))
    return [float(numbers[0]) for numbers in found.values()]


def test_a_goal_is_reached_in_the_first_step_within_both_tolerances():
    x = 0.1 * np.arange(1, STEPS + 1)
    reached, time, energy, miss = measured(x, np.zeros(STEPS))
    assert (reached, miss) == (1.0, pytest.approx(1.0))
    assert time == pytest.approx(3.9)  # 0.1 m before it
    assert energy == pytest.approx(3.9 * POWER)
    early = 4.0 - 0.999 * GOAL_DISTANCE * LENGTH - x
    assert measured(x + early[37], np.zeros(STEPS))[1] == pytest.approx(3.8)


def test_a_pose_with_another_yaw_is_not_the_goal_and_whole_turns_do_not_matter():
    x = np.minimum(0.1 * np.arange(1, STEPS + 1), 4.0)
    wrong = measured(x, np.full(STEPS, 1.01 * GOAL_ANGLE))
    assert wrong == [0.0, pytest.approx(5.0), pytest.approx(5.0 * POWER), 0.0]
    right = measured(x, np.full(STEPS, 0.99 * GOAL_ANGLE - 6.0 * np.pi))
    assert right[0] == 1.0 and right[1] == pytest.approx(3.9)


def test_an_episode_that_ends_early_has_the_time_of_a_whole_one_and_what_it_has_spent():
    x = 0.1 * np.arange(1, STEPS + 1)
    reached, time, energy, miss = measured(x, np.zeros(STEPS), steps=20)
    assert (reached, time) == (0.0, pytest.approx(5.0))
    assert energy == pytest.approx(2.0 * POWER) and miss == pytest.approx(2.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_of_a_pose_that_is_not_finite_the_last_finite_one_counts(bad):
    x = 0.1 * np.arange(1, STEPS + 1)
    x[19] = bad
    reached, time, _, miss = measured(x, np.zeros(STEPS), steps=20)
    assert (reached, time, miss) == (0.0, pytest.approx(5.0), pytest.approx(2.1))


def test_without_a_goal_there_is_no_number():
    goal = (np.nan, np.nan, np.nan)
    assert np.isnan(measured(np.zeros(STEPS), np.zeros(STEPS), goal=goal)).all()


def test_the_goals_of_a_set_are_those_of_its_plans_and_the_vehicle_sees_them():
    config = BenchmarkConfig(sets=("goals",))
    env = config.environment("goals", 3, truth=False)
    seen, _ = env.reset(seed=[0, 1, 2])
    known = env.simulation.layout.unpack(seen)
    goals = goals_of(list(env.simulation.episodes))
    distance = np.hypot(known["goal_x"], known["goal_y"])
    np.testing.assert_allclose(distance, np.hypot(goals[:, 0], goals[:, 1]), atol=0.3)
    assert "goal_x" in config.context("goals").observation
    plain = BenchmarkConfig(sets=("friction",)).environment("friction", 2, truth=False)
    plain.reset(seed=[0, 1])
    assert np.isnan(goals_of(list(plain.simulation.episodes))).all()


def test_a_policy_that_follows_the_plan_reaches_more_goals_than_one_that_stands(tmp_path):
    config = BenchmarkConfig(sets=("goals",), episodes=8)
    entries = [
        entry("stands", lambda context: Constant(0.0, 0.0)),
        registered_policy("slc", SPEED_ID),
    ]
    records = run(config, entries, Store(tmp_path, config.identity()))
    summary = summarise(records)
    still, slc = (summary.policies["goals"][name].means for name in ("stands", "slc"))
    assert still["goal_reached"] == 0.0 and slc["goal_reached"] >= 0.75
    assert still["goal_time"] == 20.0 and slc["goal_time"] < 15.0
    assert slc["goal_miss"] < 0.1 < still["goal_miss"]
    shares = [row[:3] for row in goal_table(summary).rows[1:]]
    assert shares == [["goals", "stands", "0%"], ["goals", "slc", "100%"]]
