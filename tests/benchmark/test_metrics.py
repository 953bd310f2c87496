"""Metrics of made-up traces whose values are known; abrupt changes, recovery from them; goals."""

import numpy as np
import pytest

from tests.benchmark.stub_policies import Constant, entry
from tracked_env import SPEED_ID
from tracked_env.benchmark import BenchmarkConfig, Store, metrics, run, summarise
from tracked_env.benchmark.policies import registered_policy
from tracked_env.benchmark.report import goal_table
from tracked_env.benchmark.runner import drive
from tracked_env.engine.env_config import DRIVES
from tracked_env.physics.parameters import VEHICLES

PERIOD = 0.02  # [s]
STEPS = 1000
LIMIT = 5.0  # [m]


def trace(steps=STEPS, max_steps=STEPS, **channels):
    """One episode with the given channels, numbers or (steps,), and 0 everywhere else."""
    values = np.zeros((steps, 1, len(metrics.CHANNELS)))
    for name, channel in channels.items():
        values[:, 0, metrics.CHANNELS.index(name)] = channel
    ended, limits = np.array([steps < max_steps]), (np.array([8000.0]), np.array([2.0]))
    return metrics.Trace(
        values, np.array([steps]), max_steps, ended, ~ended, *limits, LIMIT, PERIOD
    )


def value(of, name):
    return float(metrics.evaluate(of)[name][0])


def test_every_metric_is_computed_and_documented():
    assert set(metrics.evaluate(trace())) == set(metrics.METRICS)


def test_the_rmse_of_a_constant_error_is_that_error_and_settled_leaves_out_the_start():
    constant = trace(error=0.3)
    for name in ("tracking_rmse", "settled_rmse", "max_error", "final_error"):
        assert value(constant, name) == pytest.approx(0.3)
    error = np.where(np.arange(1, STEPS + 1) * PERIOD <= 5.0, 1.0, 0.1)
    assert value(trace(error=error), "settled_rmse") == pytest.approx(0.1)
    assert value(trace(error=error), "tracking_rmse") == pytest.approx(np.sqrt(0.25 + 0.75 * 0.01))
    short = trace(100, 100, error=np.repeat([1.0, 0.1], 50))  # its second half
    assert value(short, "settled_rmse") == pytest.approx(0.1)


def test_the_time_after_a_crash_counts_with_the_error_limit():
    crashed = trace(STEPS // 2, error=0.0)
    assert value(crashed, "tracking_rmse") == pytest.approx(LIMIT / np.sqrt(2.0))
    assert value(crashed, "max_error") == value(crashed, "final_error") == LIMIT
    assert value(crashed, "terminated") == 1.0
    assert value(crashed, "success") == 0.0
    assert value(crashed, "driven_time") == pytest.approx(10.0)


@pytest.mark.parametrize("steps", [1, 100, 500, 999])
def test_leaving_the_path_is_never_better_than_staying_at_the_limit(steps):
    stays = trace(error=np.r_[np.full(steps, 0.2), np.full(STEPS - steps, 0.999 * LIMIT)])
    leaves = trace(steps, error=0.2)
    for name in ("tracking_rmse", "settled_rmse", "max_error", "final_error"):
        assert value(leaves, name) >= value(stays, name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 80.0])
def test_a_state_that_is_not_finite_counts_as_the_limit_and_spoils_nothing(bad):
    moving = [name for name in metrics.CHANNELS if name not in metrics.CHANGING]
    channels = {name: np.r_[np.zeros(9), bad] for name in moving}
    diverged = metrics.evaluate(trace(10, **channels))
    # No change of the parameters, no goal, and the actions are torques.
    lacking = ("sprocket_speed_rate", *metrics.AFTER_CHANGE, *metrics.OF_GOALS)
    finite = {name: np.isfinite(column).all() for name, column in diverged.items()}
    assert [name for name in finite if not finite[name]] == list(lacking)
    assert diverged["max_error"][0] == LIMIT


def test_how_an_episode_ended_is_told_apart():
    assert metrics.ending(trace()) == ["time"]
    assert metrics.ending(trace(10, error=5.1)) == ["off-path"]
    assert metrics.ending(trace(10, x=np.nan)) == ["non-finite"]


def test_the_energy_is_power_times_time_whatever_the_signs():
    driving = trace(
        torque_left=1000.0, sprocket_speed_left=-2.0, torque_right=-500.0, sprocket_speed_right=-4.0
    )
    assert value(driving, "energy") == pytest.approx(4000.0 * STEPS * PERIOD)


def test_saturation_counts_the_steps_and_sides_at_the_limit_of_the_demand():
    action = np.zeros(STEPS)
    action[:100] = 1.0
    assert value(trace(action_left=action), "saturation_share") == pytest.approx(0.05)
    assert value(trace(action_left=0.99), "saturation_share") == 0.0


@pytest.mark.parametrize(
    ("drive", "limit", "name", "other"),
    [
        ("torque", 8000.0, "torque_rate", "sprocket_speed_rate"),  # [N m]
        ("speed", 10.0, "sprocket_speed_rate", "torque_rate"),  # [rad/s]
    ],
)
def test_the_action_rate_is_the_mean_rate_of_the_demand_in_its_own_unit(drive, limit, name, other):
    given = {"drive": drive, "demand_limit": np.array([limit])}
    ramp = trace(action_left=np.linspace(0.0, 1.0, STEPS), action_right=0.5)._replace(**given)
    assert value(ramp, name) == pytest.approx(limit / (STEPS * PERIOD) / 2)
    alternating = trace(action_left=0.1 * (-1.0) ** np.arange(STEPS))._replace(**given)
    assert value(alternating, name) == pytest.approx(0.2 * limit / PERIOD / 2, rel=2e-3)
    assert np.isnan(value(alternating, other))


def test_every_drive_has_an_action_rate_and_every_unit_of_a_record_is_one_unit():
    assert set(metrics.ACTION_RATES) == set(DRIVES)
    units = [metrics.METRICS[name].unit for name in metrics.ACTION_RATES.values()]
    assert units == ["N m/s", "rad/s^2"]


def test_heading_and_speed_are_measured_over_the_time_driven():
    crashed = trace(100, heading_error=-0.2, speed_error=0.5)
    assert value(crashed, "heading_rmse") == pytest.approx(0.2)
    assert value(crashed, "speed_rmse") == pytest.approx(0.5)


def test_rows_past_the_end_of_an_episode_are_void():
    both = trace()
    values = np.zeros((STEPS, 2, len(metrics.CHANNELS)))
    values[100:, 1] = 1e9  # whatever lies there
    pair = both._replace(
        values=values,
        steps=np.array([STEPS, 100]),
        terminated=np.array([False, True]),
        success=np.array([True, False]),
        demand_limit=np.full(2, 8000.0),
        contact_length=np.full(2, 2.0),
    )
    alone = metrics.evaluate(trace(100))
    for name, column in metrics.evaluate(pair).items():
        assert column[1] == alone[name][0] or np.isnan([column[1], alone[name][0]]).all()


def history(**changes):
    """(T, 4) constant ones, but for the named parameters."""
    values = np.ones((STEPS, len(metrics.CHANGING)))
    for name, column in changes.items():
        values[:, metrics.CHANGING.index(name)] = column
    return values


def ramp(first, last, low=1.0, high=2.0):
    """(T,) constant, then linear so that the first new value is in step `first`, then constant."""
    return np.interp(np.arange(STEPS), [first - 1, last], [low, high])


HALTING = ramp(300, 310, 1.0, 1.5) + ramp(330, 340, 0.0, 0.5)


@pytest.mark.parametrize(
    ("parameters", "changes"),
    [
        ({"mass": ramp(400, 400), "inertia": ramp(400, 400)}, [(400, 400)]),
        ({"longitudinal_resistance": ramp(300, 340)}, [(300, 340)]),  # a border
        ({"mass": ramp(100, 100 + round(metrics.ABRUPT_TIME / PERIOD))}, []),  # a drift
        ({"mass": ramp(100, 600)}, []),
        ({"mass": ramp(400, 400), "lateral_resistance": ramp(1, STEPS - 1)}, [(400, 400)]),
        ({"lateral_resistance": ramp(1, 40)}, []),  # no whole change
        ({"lateral_resistance": ramp(STEPS - 40, STEPS - 1)}, []),
        ({"lateral_resistance": ramp(STEPS - 40, STEPS + 40)}, []),
        ({"mass": ramp(STEPS - 5, STEPS - 5)}, [(STEPS - 5, STEPS - 5)]),
        ({"mass": ramp(400, 400, 1.0, 1.01)}, []),  # not felt
        ({"mass": ramp(300, 320) + ramp(600, 620, 0.0, -1.0)}, [(300, 320), (600, 620)]),
        ({"mass": HALTING}, [(300, 340)]),  # on the border
        ({"mass": ramp(300, 330), "inertia": ramp(320, 350)}, [(300, 350)]),
        ({"mass": ramp(300, 330), "lateral_resistance": ramp(100, 110)}, [(100, 110), (300, 330)]),
    ],
)
def test_steps_and_crossed_borders_are_changes_and_drifts_are_none(parameters, changes):
    assert metrics.abrupt_changes(history(**parameters), PERIOD) == changes


def test_an_error_that_decays_recovers_when_it_falls_below_the_threshold():
    time = PERIOD * (1 + np.arange(STEPS))  # entry k is taken after step k
    error = np.where(time > 6.0, np.exp(-(time - 6.0) / 2.0), 0.01)
    found, peak, _ = metrics.recovery(error, [metrics.Change(300, 300)], PERIOD, 0.1)
    assert found == pytest.approx(2.0 * np.log(1.0 / 0.1), abs=PERIOD)
    assert peak == pytest.approx(np.exp(-0.01))


def error_with(**parts):
    """(T,) zeros but for slices `first_last`."""
    error = np.zeros(STEPS)
    for name, level in parts.items():
        first, last = map(int, name.strip("k").split("_"))
        error[first:last] = level
    return error


RMSE = np.sqrt((10 * 0.81 + 50 * 0.04) / (STEPS - 300))


@pytest.mark.parametrize(
    ("error", "changes", "expected"),
    [
        # The time counts from the end of a change, the peak from its start.
        (error_with(k300_310=0.9, k340_390=0.2), [metrics.Change(300, 340)], (1.0, 0.9, RMSE)),
        # Who leaves the threshold again has not recovered before.
        (error_with(k500_501=1.0, k900_901=0.5), [metrics.Change(400, 400)], (501 * PERIOD,)),
        # Who never recovers takes the time that is left, or that to the next change.
        (np.full(STEPS, 0.5), [metrics.Change(400, 400)], (600 * PERIOD, 0.5, 0.5)),
        (
            np.full(STEPS, 0.5),
            [metrics.Change(400, 400), metrics.Change(500, 500)],
            (100 * PERIOD,),
        ),
        (np.full(STEPS, 0.05), [metrics.Change(400, 420)], (0.0, 0.05, 0.05)),
        (np.ones(STEPS), [], (np.nan, np.nan, np.nan)),
    ],
)
def test_recovery_is_the_time_after_the_first_change_until_the_error_stays_small(
    error, changes, expected
):
    found = metrics.recovery(error, changes, PERIOD, 0.1)[: len(expected)]
    assert found == pytest.approx(expected, nan_ok=True)


def test_the_payload_step_of_a_real_episode_is_found_where_its_schedule_has_it():
    config = BenchmarkConfig(sets=("payload",), duration=4.0)
    env = config.environment("payload", 4, truth=False)
    trace, _ = drive(Constant(0.2, 0.2), env, range(4), lambda: None)
    for i, changes in enumerate(trace.changes()):
        episode = env.simulation.episodes[i]
        step = int(np.ceil(episode.events[0, 3] / PERIOD))
        assert changes == [metrics.Change(step, step)]


@pytest.mark.parametrize("name", ["soil-and-mass", "drift", "resistance-map"])
def test_sets_without_steps_and_borders_have_no_abrupt_change(name):
    env = BenchmarkConfig(duration=20.0).environment(name, 4, truth=False)
    trace, _ = drive(Constant(0.25, 0.25), env, range(4), lambda: None)
    assert trace.changes() == [[]] * 4


LENGTH, STEP, COUNT = 0.7, 0.1, 50  # [m], [s], control steps of an episode to a goal
POWER = 3.0  # [W]
X = 0.1 * np.arange(1, COUNT + 1)


def measured(x, yaw, steps=COUNT, goal=(4.0, 0.0, 0.0)):
    """The numbers of one episode that moves along x(t) with yaw(t)."""
    values = np.zeros((COUNT, 1, len(metrics.CHANNELS)))
    for name, channel in (("x", x), ("yaw", yaw)):
        values[:, 0, metrics.CHANNELS.index(name)] = channel
    none, one = np.zeros(1, bool), np.ones(1)
    nominal = VEHICLES["strawa"]._replace(contact_length=LENGTH)
    motion = metrics.Trace(values, np.array([steps]), COUNT, none, none, one, one, 5.0, STEP)
    motion = motion._replace(nominal=nominal, goals=np.array([goal]))
    found = metrics.goal_reaching(motion, np.full((COUNT, 1), POWER))
    return [float(numbers[0]) for numbers in found.values()]


def test_a_goal_is_reached_in_the_first_step_within_both_tolerances():
    reached, time, energy, miss = measured(X, np.zeros(COUNT))
    assert (reached, miss) == (1.0, pytest.approx(1.0))
    assert time == pytest.approx(3.9)  # 0.1 m before it
    assert energy == pytest.approx(3.9 * POWER)
    early = 4.0 - 0.999 * metrics.GOAL_DISTANCE * LENGTH - X
    assert measured(X + early[37], np.zeros(COUNT))[1] == pytest.approx(3.8)


def test_a_pose_with_another_yaw_is_not_the_goal_and_whole_turns_do_not_matter():
    x = np.minimum(X, 4.0)
    wrong = measured(x, np.full(COUNT, 1.01 * metrics.GOAL_ANGLE))
    assert wrong == [0.0, pytest.approx(5.0), pytest.approx(5.0 * POWER), 0.0]
    right = measured(x, np.full(COUNT, 0.99 * metrics.GOAL_ANGLE - 6.0 * np.pi))
    assert right[0] == 1.0 and right[1] == pytest.approx(3.9)


def test_an_episode_that_ends_early_has_the_time_of_a_whole_one_and_what_it_has_spent():
    reached, time, energy, miss = measured(X, np.zeros(COUNT), steps=20)
    assert (reached, time) == (0.0, pytest.approx(5.0))
    assert energy == pytest.approx(2.0 * POWER) and miss == pytest.approx(2.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_of_a_pose_that_is_not_finite_the_last_finite_one_counts(bad):
    x = X.copy()
    x[19] = bad
    reached, time, _, miss = measured(x, np.zeros(COUNT), steps=20)
    assert (reached, time, miss) == (0.0, pytest.approx(5.0), pytest.approx(2.1))


def test_without_a_goal_there_is_no_number():
    goal = (np.nan, np.nan, np.nan)
    assert np.isnan(measured(np.zeros(COUNT), np.zeros(COUNT), goal=goal)).all()


def test_the_goals_of_a_set_are_those_of_its_plans_and_the_vehicle_sees_them():
    config = BenchmarkConfig(sets=("goals",))
    env = config.environment("goals", 3, truth=False)
    seen, _ = env.reset(seed=[0, 1, 2])
    known = env.simulation.layout.unpack(seen)
    goals = metrics.goals_of(list(env.simulation.episodes))
    distance = np.hypot(known["goal_x"], known["goal_y"])
    np.testing.assert_allclose(distance, np.hypot(goals[:, 0], goals[:, 1]), atol=0.3)
    assert "goal_x" in config.context("goals").observation
    plain = BenchmarkConfig(sets=("friction",)).environment("friction", 2, truth=False)
    plain.reset(seed=[0, 1])
    assert np.isnan(metrics.goals_of(list(plain.simulation.episodes))).all()


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
