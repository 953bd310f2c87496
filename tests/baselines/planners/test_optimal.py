"""Plans of least time under slip: they reach the goal, keep the limits, and know the slip."""

import math
from itertools import product

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.planners.curves import dubins
from baselines.planners.least_time import optimal
from baselines.planners.slip_surface import surface_of
from baselines.planners.trajectory import Limits, Start
from tests.baselines.planners.planner_cases import (
    FOCCHI,
    GOAL,
    ORIGIN,
    SLIP,
    SurfaceSlip,
    belts_of,
    end_of_plan,
    halton_goals,
    limits_of,
    missed,
    motion_on,
    random_goals,
    refused,
    replayed,
    vehicle_on,
)
from tracked_env.physics.level_motion import hold_speeds
from tracked_env.physics.patches_on_level_ground import make_patches


def fastest(goal=GOAL, v_min=0.4, slip=SLIP, start=ORIGIN, bounds=None, **options):
    """The plan of FOCCHI with limits of F; bounds: other limits."""
    return optimal(start, goal, limits_of(FOCCHI, v_min, **bounds or {}), FOCCHI, slip, **options)


EVERY = [*product(("focchi", "focchi-short"), (0.4, 0.1), (0.4, 0.15, 0.0))]
# Random goals take long.
OFTEN = {("focchi", 0.1, 0.4), ("focchi-short", 0.4, 0.0)}
TASKS = [
    pytest.param(*of, goals, marks=[pytest.mark.slow] * (goals == "random" and of not in OFTEN))
    for of, goals in product(EVERY, ("1 m", "2 m", "random"))
]


@pytest.mark.parametrize(("name", "mu", "v_min", "goals"), TASKS)
def test_every_goal_has_a_plan_that_ends_there(name, mu, v_min, goals):
    vehicle, slip = vehicle_on(mu, name, 18.0 if mu > 0.2 else 10.0)
    wanted = random_goals() if goals == "random" else halton_goals(float(goals[0]))
    motion = optimal(ORIGIN, wanted, limits_of(vehicle, v_min), vehicle, slip)
    assert all(plan.converged for plan in motion)
    assert max(plan.end_error for plan in motion) < 1e-6
    assert max(plan.end_yaw_error for plan in motion) < 1e-6
    for goal, plan in zip(wanted, motion, strict=True):
        assert missed(end_of_plan(plan), goal) < 1e-7


def test_the_goals_are_those_of_the_published_code():
    first = [0.792974239075002, 1.76464342816245, 4.40310690628574]
    assert halton_goals(1.0)[0] == pytest.approx(first, abs=1e-12)
    assert len(halton_goals(1.0)) == len(halton_goals(2.0)) == 100


def test_durations_of_the_goal_of_figure_16_are_those_of_an_independent_solver():
    """IPOPT on surfaces of 7 x 7 terms: 8.55 s without slip, 8.70 s with it, at any speed."""
    for v_min in (0.4, 0.0):
        for slip, duration, off in ((None, 8.55, 0.01), (SLIP, 8.70, 0.02)):
            assert fastest(v_min=v_min, slip=slip).duration == pytest.approx(duration, abs=off)


def test_slippery_ground_takes_longer():
    durations = []
    for mu in (0.4, 0.2, 0.1):
        vehicle, slip = vehicle_on(mu, limit=10.0)
        durations.append(optimal(ORIGIN, GOAL, limits_of(vehicle, 0.0), vehicle, slip).duration)
    assert durations == sorted(durations)
    assert durations[2] - durations[0] > 0.2


@pytest.mark.parametrize("v_min", [0.4, 0.0])
def test_sprocket_speeds_replayed_on_the_model_end_at_the_goal(v_min):
    surface = SurfaceSlip(surface_of(SLIP, FOCCHI, 18.0, 0.4))
    model, table = PseudoKinematicModel(FOCCHI, surface), PseudoKinematicModel(FOCCHI, SLIP)
    goals = halton_goals(1.0)[:20]
    for goal, motion in zip(goals, fastest(goals, v_min), strict=True):
        assert missed(replayed(model, motion), goal) < 1e-3
        assert missed(replayed(table, motion), goal) < 0.06  # the surface is within 2 mm/s of it


def test_a_plan_that_knows_no_slip_misses_by_decimetres():
    model, goals = PseudoKinematicModel(FOCCHI, SLIP), halton_goals(1.0)[:20]
    ends = np.array([replayed(model, plan) for plan in fastest(goals, slip=None)])
    assert np.mean(np.hypot(*(ends - goals)[:, :2].T)) > 0.4


def test_the_distributed_plant_driven_by_a_plan_ends_near_the_goal():
    """From the plan's first speeds, for the plant has inertia and the model has none."""
    off, goals = [], halton_goals(1.0)[:10]
    for goal, motion in zip(goals, fastest(goals), strict=True):
        state, loads = np.zeros((1, 6)), np.empty((1, 6))
        state[0, 3:] = motion.speed[0] * math.cos(motion.course[0]), 0.0, motion.yaw_rate[0]
        state[0, 4] = motion.speed[0] * math.sin(motion.course[0] - motion.yaw[0])
        row = np.array([FOCCHI], dtype=np.float64)
        for k, duration in enumerate(np.diff(motion.time)):
            speeds = np.array([[motion.sprocket_left[k], motion.sprocket_right[k]]])
            steps = math.ceil(duration / 0.005)
            hold_speeds(state, speeds, row, make_patches(), steps, duration / steps, False, loads)
        off.append(np.hypot(*(state[0, :2] - goal[:2])))
    assert np.mean(off) < 0.12


@pytest.mark.parametrize("v_min", [0.4, 0.15, 0.0])
def test_limits_are_kept_on_every_interval(v_min):
    bounds = {"sprocket_speed": 14.0, "reserve": 0.2, "curvature": 2.0}
    bounds |= {"lateral_acceleration": 0.5, "sprocket_acceleration": 20.0}
    start = Start(speed=max(v_min, 0.2))
    options = {"start": start, "bounds": bounds, "stop": v_min < 0.4}
    for motion in fastest(halton_goals(1.0)[:30], v_min, **options):
        assert motion.converged
        p, q = belts_of(FOCCHI, motion)
        belt, rate = FOCCHI.sprocket_radius * 14.0 * 0.8, 20.0 * FOCCHI.sprocket_radius
        slack, step = 1e-6, motion.duration / 40
        assert (p + np.abs(q)).max() <= belt + slack
        assert p.max() <= 0.4 + slack
        v_x, v_y, turn = motion_on(surface_of(SLIP, FOCCHI, 11.2, 0.4), p, q).T
        assert np.abs(v_x * turn).max() <= 0.5 + slack
        assert (np.abs(turn) - 2.0 * v_x).max() <= slack
        belts = np.stack([p - q, p + q])
        if v_min < 0.4:
            assert np.hypot(v_x, v_y).max() <= 0.4 + slack
            first = FOCCHI.sprocket_radius * np.array(start.sprockets(FOCCHI))
            belts = np.hstack([first[:, None], belts, np.zeros((2, 1))])
        else:
            assert np.abs(p - 0.4).max() <= 1e-12
        assert np.abs(np.diff(belts)).max() <= rate * step + slack


@pytest.mark.parametrize(
    ("name", "v_min", "options", "bound"),
    [
        ("belt", 0.4, {"sprocket_speed": 10.0, "reserve": 0.2}, 0.8 * 0.856),
        ("lateral", 0.4, {"lateral_acceleration": 0.3}, 0.3),
        ("curvature", 0.4, {"curvature": 1.5}, 1.5),
        ("ground", 0.0, {}, 0.4),
        ("slowest", 0.15, {}, -0.15),
    ],
)
def test_a_limit_is_reached_and_kept(name, v_min, options, bound):
    """Goals behind need turns as tight, and as slow, as the limit allows."""
    goals, largest = [(-1.0, 0.6, 0.0), (-0.5, -1.0, 2.0), (0.3, 1.0, 3.0)], []
    for motion in fastest(goals, v_min, bounds=options):
        assert motion.converged
        p, q = belts_of(FOCCHI, motion)
        used = 8.0 if name == "belt" else 18.0
        v_x, v_y, turn = motion_on(surface_of(SLIP, FOCCHI, used, 0.4), p, q).T
        value = {
            "belt": p + np.abs(q),
            "lateral": np.abs(v_x * turn),
            "curvature": np.abs(turn) / v_x,
            "ground": np.hypot(v_x, v_y),
            "slowest": -p,
        }[name]
        largest.append(value.max())
    assert max(largest) <= bound + 1e-5
    assert max(largest) >= bound - 0.01 * abs(bound)


def test_v_min_holds_but_while_the_vehicle_gathers_speed_and_stops():
    motion = fastest(v_min=0.15, bounds={"sprocket_acceleration": 5.0}, stop=True)
    p, _ = belts_of(FOCCHI, motion)
    assert motion.converged
    assert p[0] <= 5.0 * FOCCHI.sprocket_radius * motion.duration / 40 + 1e-6
    assert p[-1] <= 5.0 * FOCCHI.sprocket_radius * motion.duration / 40 + 1e-6
    assert p[5:-5].min() >= 0.15 - 1e-6
    assert motion.duration > fastest(v_min=0.15).duration


def test_a_moving_vehicle_goes_on_from_its_sprocket_speeds():
    start = Start(sprocket_left=1.0, sprocket_right=4.0)
    motion = fastest(v_min=0.0, start=start, bounds={"sprocket_acceleration": 3.0})
    change = 3.0 * motion.duration / 40 + 1e-5
    assert abs(motion.sprocket_left[0] - 1.0) <= change
    assert abs(motion.sprocket_right[0] - 4.0) <= change


def test_the_cost_hardly_depends_on_the_number_of_intervals():
    costs = [fastest(v_min=0.0, intervals=n).cost for n in (40, 80, 160, 320)]
    assert max(costs) - min(costs) < 0.02 * costs[0]
    assert abs(costs[3] - costs[2]) < abs(costs[1] - costs[0])


def test_smoothing_smooths():
    rough, smooth = (fastest(smoothing=weight) for weight in (0.1, 10.0))
    assert rough.duration < smooth.duration
    assert np.abs(np.diff(rough.yaw_rate)).max() > 2.0 * np.abs(np.diff(smooth.yaw_rate)).max()


def test_plans_take_the_whole_turns_of_a_short_path():
    """With goals' yaws in [0, 2 pi) taken as they stand, half of the plans wind a turn more."""
    goals = halton_goals(1.0)
    motion = fastest(goals)
    shortest = dubins(ORIGIN, goals, 0.106241234).length / 0.4
    ratio = np.array([plan.duration for plan in motion]) / shortest
    assert np.mean(ratio) < 1.13
    assert max(abs(plan.yaw[-1]) for plan in motion) < 2.0 * math.pi + 1e-6


def test_a_mirrored_goal_has_the_mirrored_plan():
    goals = halton_goals(1.0)[:20]
    mirrored = fastest(goals * [1.0, -1.0, -1.0], 0.15)
    for a, b in zip(fastest(goals, 0.15), mirrored, strict=True):
        assert a.cost == pytest.approx(b.cost, abs=1e-3)
        assert a.duration == pytest.approx(b.duration, rel=1e-2)


def test_a_turned_and_moved_start_moves_the_plan():
    motion = fastest()
    turn, x, y = 1.2, 5.0, -3.0
    rotation = complex(math.cos(turn), math.sin(turn))
    moved = complex(GOAL[0], GOAL[1]) * rotation + complex(x, y)
    goal = (moved.real, moved.imag, GOAL[2] + turn)
    again = fastest(goal, start=(x, y, turn))
    np.testing.assert_allclose(again.sprocket_left, motion.sprocket_left, atol=1e-6)
    np.testing.assert_allclose(again.yaw, motion.yaw + turn, atol=1e-6)


def test_a_batch_gives_the_bits_of_single_plans_on_any_number_of_threads():
    goals = halton_goals(1.0)[:9]
    one, two = (fastest(goals, 0.15, threads=n) for n in (1, 2))
    for goal, a, b in zip(goals, one, two, strict=True):
        single = fastest(goal, 0.15)
        for name in ("time", "yaw", "sprocket_left", "cost", "iterations"):
            assert np.array_equal(getattr(a, name), getattr(b, name))
            assert np.array_equal(getattr(a, name), getattr(single, name))


def test_samples_between_the_intervals_lie_on_the_arcs():
    knots, fine = (fastest(v_min=0.15, period=period) for period in (None, 0.02))
    assert np.diff(fine.time).max() <= 0.02 + 1e-12
    at = np.searchsorted(fine.time, knots.time - 1e-9)
    np.testing.assert_allclose(fine.time[at], knots.time, atol=1e-9)
    for name in ("x", "y", "yaw", "sprocket_left", "speed"):
        np.testing.assert_allclose(getattr(fine, name)[at], getattr(knots, name), atol=1e-9)
    model = PseudoKinematicModel(FOCCHI, SurfaceSlip(surface_of(SLIP, FOCCHI, 18.0, 0.4)))
    assert missed(replayed(model, fine), GOAL) < 1e-6


def test_rates_are_the_slopes_of_what_they_are_rates_of():
    motion = fastest(v_min=0.0, intervals=320)
    for value, rate, allowed in (
        (motion.yaw, motion.yaw_rate, 0.02),
        (motion.speed, motion.acceleration, 0.02),
        (motion.course, motion.course_rate, 0.05),
        (motion.yaw_rate, motion.yaw_acceleration, 0.1),
        (motion.course_rate, motion.course_acceleration, 0.3),
    ):
        slope = np.gradient(value, motion.time)
        assert np.abs(slope - rate)[3:-3].max() < allowed


def test_a_goal_out_of_reach_of_the_limits_is_said_to_be():
    """Two intervals at constant speed have three unknowns: not enough for a pose behind."""
    motion = fastest((-1.0, 1e-3, 0.0), intervals=2, period=1e-4)
    assert not motion.converged and len(motion.time) <= 3
    assert motion.message.startswith("no plan in ")
    assert math.isinf(motion.cost)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (math.nan, 0.0, 0.0)}, "goal x = nan"),
        ({"start": Start(yaw=math.inf)}, "start yaw = inf"),
        ({"limits": Limits(sprocket_speed=18.0, v_min=0.5)}, "v_min = 0.5, v_max = 0.4"),
        ({"intervals": 1}, "intervals = 1"),
        ({"intervals": 40.5}, "must be a whole number"),
        ({"smoothing": 0.0}, "smoothing = 0.0"),
        ({"period": -0.02}, "period = -0.02"),
        ({"turning": math.inf}, "turning = inf"),
        ({"threads": 0}, "threads = 0"),
        ({"stop": True}, "stop = True; must be False"),
        ({"limits": Limits(sprocket_speed=20.0)}, "the slip model ends at 18 rad/s"),
    ],
)
def test_bad_input_gets_one_line(change, message):
    options = {"start": ORIGIN, "goal": GOAL, "limits": limits_of(FOCCHI, 0.4), **change}
    refused(lambda: optimal(vehicle=FOCCHI, slip_model=SLIP, **options), message)
