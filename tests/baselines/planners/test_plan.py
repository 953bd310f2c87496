"""Plans by every method, one or many at once: what they promise, and what is refused."""

import math

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.planners.motion_planning import METHODS, plan
from baselines.planners.trajectory import Limits, Start
from baselines.slip.slip_sweep import identified_slip
from tests.baselines.planners.planner_cases import (
    FOCCHI,
    GOAL,
    ORIGIN,
    end_of_plan,
    limits_of,
    missed,
    random_pairs,
    refused,
    replayed,
)
from tracked_env.physics.parameters import VEHICLES

VEHICLE = VEHICLES["focchi"]
PATHS = ("dubins", "reeds-shepp", "clothoid")
FIXED = Limits(sprocket_speed=18.0, v_min=0.4, v_max=0.4)  # F 7.2.1


@pytest.mark.parametrize("method", PATHS)
@pytest.mark.parametrize(
    "limits",
    [FIXED, Limits.of(VEHICLE, v_min=0.0, sprocket_acceleration=20.0, reserve=0.1)],
    ids=["constant speed", "rest to rest"],
)
def test_its_samples_integrate_to_the_goal(method, limits):
    _, goals = random_pairs(40, seed=1)
    for goal, motion in zip(goals, plan((0, 0, 0), goals, limits, method=method), strict=True):
        assert motion.converged
        assert missed(end_of_plan(motion), goal) < 1e-8
        assert max(motion.end_error, motion.end_yaw_error) < 1e-6
        assert np.all(np.diff(motion.time) > 0.0)
        fine = np.linspace(0.0, motion.duration, 20_000)
        speed, course = (np.interp(fine, motion.time, v) for v in (motion.speed, motion.course))
        x = motion.x[0] + np.trapezoid(speed * np.cos(course), fine)
        y = motion.y[0] + np.trapezoid(speed * np.sin(course), fine)
        assert math.hypot(x - goal[0], y - goal[1]) < 2e-2  # corners between samples
        largest = max(np.abs(motion.sprocket_left).max(), np.abs(motion.sprocket_right).max())
        assert largest <= limits.sprocket_used * (1.0 + 1e-9)


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_a_path_starts_at_the_speed_of_the_vehicle_and_ends_at_rest(speed):
    motion = plan(Start(speed=speed), GOAL, Limits.of(VEHICLE, v_min=0.0), method="clothoid")
    assert motion.speed[0] == pytest.approx(speed, abs=1e-12) and motion.speed[-1] == 0.0
    assert motion.sprocket_left[-1] == motion.sprocket_right[-1] == 0.0


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_sprockets_of_an_optimal_plan_step_by_what_the_limit_allows_in_an_interval(speed):
    """Steps of held speeds, as the documentation of `Trajectory` says, whatever the samples are."""
    limits = Limits.of(VEHICLE, sprocket_acceleration=20.0, v_min=0.0)
    motion = plan(Start(speed=speed), GOAL, limits, period=0.02)
    most = 20.0 * motion.duration / 40 + 1e-6
    first = speed / VEHICLE.sprocket_radius
    for side in (motion.sprocket_left, motion.sprocket_right):
        steps = np.abs(np.diff(np.concatenate([[first], side[:-1], [0.0]])))
        assert np.count_nonzero(steps > 1e-9) <= 41
        assert steps.max() <= most
        assert steps.max() > 20.0 * 0.02  # more than the limit allows between two samples
    assert max(abs(motion.sprocket_left[-1]), abs(motion.sprocket_right[-1])) <= most


def test_sprockets_of_a_plan_that_knows_slip_drive_it_on_the_model_with_slip():
    slip = identified_slip(VEHICLE)
    limits = Limits.of(VEHICLE, v_min=0.3, v_max=0.3, curvature=1.5)
    model = PseudoKinematicModel(VEHICLE, slip)
    ends = {}
    for name, assumed in (("slip", slip), ("none", None)):
        motion = plan((0, 0, 0), GOAL, limits, assumed, method="dubins", period=0.005)
        ends[name] = math.dist(replayed(model, motion, 1)[:2], GOAL[:2])
    # The yaw jumps by alpha where arcs begin: the model, which starts each with the yaw it has,
    # drives off by about alpha times the rest of the way.
    assert ends["slip"] < 0.3 * ends["none"]
    assert motion.yaw == pytest.approx(motion.course)


def test_a_clothoid_that_breaks_a_limit_says_so_and_falls_back():
    motion = plan((0, 0, 0), (-0.5, 0.1, 0.2), FIXED, method="clothoid")
    assert motion.method == "dubins"
    assert "Dubins path instead" in motion.message
    assert motion.converged


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turns", [0, 1])
def test_one_pose_needs_no_motion(method, turns):
    motion = plan((1, 2, 3), (1, 2, 3 + 2.0 * math.pi * turns), FIXED, method=method)
    assert motion.converged
    assert motion.duration == motion.length == motion.cost == 0.0
    assert not np.any(motion.at([0.0, 1.0])[3:])
    assert method != "optimal" or motion.message == "start and goal are one pose"


def test_curvature_jumps_are_reported_where_sprockets_have_an_acceleration_limit():
    limits = Limits.of(VEHICLE, sprocket_acceleration=20.0)
    assert "jump" in plan((0, 0, 0), GOAL, limits, method="dubins").message
    assert "jump" not in plan((0, 0, 0), (2.0, 0.0, 0.0), limits, method="dubins").message


LIMITS = limits_of(FOCCHI, 0.15)
STARTS = np.array([[0.0, 0.0, 0.0], [1.0, -1.0, 2.0], [-2.0, 0.5, -1.0]])
GOALS = np.array([[2.0, 2.5, -0.4], [-1.0, 0.5, 0.0], [0.0, -2.0, 3.0]])
WAYS = [("optimal", 1), ("optimal", 2), ("dubins", 1), ("clothoid", 1)]


def planned(start, goal, method="optimal", threads=1, limits=LIMITS, **given):
    return plan(start, goal, limits, method=method, vehicle=FOCCHI, threads=threads, **given)


@pytest.mark.parametrize(("method", "threads"), WAYS)
@pytest.mark.parametrize("pairs", ["N to N", "N to 1", "1 to N"])
def test_each_plan_goes_from_its_own_start_to_its_own_goal(method, threads, pairs):
    starts = STARTS if pairs[0] == "N" else STARTS[1]
    goals = GOALS if pairs[-1] == "N" else GOALS[1]
    motion = planned(starts, goals, method, threads)
    assert len(motion) == 3
    for i, one in enumerate(motion):
        start, goal = np.broadcast_to(starts, (3, 3))[i], np.broadcast_to(goals, (3, 3))[i]
        assert one.converged
        assert missed(np.array([one.x[0], one.y[0], one.course[0]]), start) < 0.3  # and slip
        assert missed(end_of_plan(one), goal) < 1e-6
        assert one.cost == planned(start, goal, method).cost


def test_starts_in_motion_have_plans_of_their_own():
    limits = limits_of(FOCCHI, 0.0, sprocket_acceleration=3.0)
    starts = [Start(), Start(speed=0.3), Start(speed=0.1)]
    for threads in (1, 2):
        motion = planned(starts, GOAL, threads=threads, limits=limits)
        assert [one.cost for one in motion] == [
            planned(s, GOAL, limits=limits).cost for s in starts
        ]
    assert motion[0].cost > motion[2].cost > motion[1].cost


@pytest.mark.parametrize(("method", "threads"), WAYS)
@pytest.mark.parametrize(("bad", "why"), [(math.nan, "goal x = nan"), (1e9, "goal x = 1000000000")])
def test_a_bad_goal_does_not_lose_the_others(method, threads, bad, why):
    goals = GOALS.copy()
    goals[1, 0] = bad
    motion = planned(ORIGIN, goals, method, threads)
    assert [one.converged for one in motion] == [True, False, True]
    assert motion[1].message.startswith(why)
    assert motion[1].cost == math.inf and motion[1].duration == 0.0
    refused(lambda: planned(ORIGIN, goals[1], method, threads), why)


def test_a_plan_of_too_many_samples_does_not_lose_the_others():
    far = (1e6, 0.0, 0.0)
    motion = planned(ORIGIN, [far, GOAL], "dubins")
    assert [one.converged for one in motion] == [False, True]
    assert len(planned(ORIGIN, far, "dubins", period=10.0).time) < 260_000


@pytest.mark.parametrize("far", [1e3, 1e5, 1e6])
def test_an_optimal_plan_to_a_far_goal_has_few_samples_or_is_refused(far):
    motion = planned(ORIGIN, [(far, 0.0, 0.0), GOAL])
    assert motion[1].converged
    assert len(motion[0].time) <= (41 if not motion[0].converged else 1_000_000)


def test_limits_may_be_a_dict_of_their_fields():
    motion = planned(ORIGIN, GOAL, limits={"v_min": 0.15, "acceleration": math.inf})
    assert (
        motion.cost == planned(ORIGIN, GOAL, limits=Limits.of(FOCCHI, acceleration=math.inf)).cost
    )


@pytest.mark.parametrize("method", ["optimal", "dubins"])
@pytest.mark.parametrize("goals", [np.zeros((0, 3)), np.zeros((0, 3), dtype=int)])
def test_no_goals_have_no_plans(method, goals):
    assert planned(ORIGIN, goals, method) == []
    assert planned(np.zeros((0, 3)), ORIGIN, method) == []


def test_a_period_longer_than_the_plan_samples_its_ends():
    assert len(planned(ORIGIN, GOAL, "dubins", period=10.0).time) == 2


REST = Limits.of(VEHICLE, reserve=0.1, sprocket_acceleration=20.0)
PLANE = {"method": "optimal", "limits": REST, "ground": (0.15, 0.1)}
WRONG = [
    ({"goal": (math.nan, 0, 0)}, "goal x = nan"),
    ({"goal": (1.0, 2.0)}, "goal has shape"),
    ({"goal": []}, "goal has shape"),
    ({"goal": "home"}, "goal = 'home'"),
    ({"goal": np.array([1.0, 2.0j, 0.0])}, "must be numbers x, y"),
    ({"goal": ["1", "2", "3"]}, "must be numbers x, y"),
    ({"goal": [(1.0, 2.0, 3.0), (1.0, 2.0)]}, "must be numbers x, y"),
    ({"goal": [True, False, True]}, "must be numbers x, y"),
    ({"start": (0, 0, math.inf)}, "start yaw = inf"),
    ({"start": None}, "start = None"),
    ({"start": np.full((2, 3), math.nan)}, "start x = nan"),
    ({"start": [Start(speed=math.nan)]}, "start speed = nan"),
    ({"start": STARTS, "goal": GOALS[:2]}, "3 starts and 2 goals; must be as many, or one"),
    ({"start": [Start()] * 2, "goal": GOALS}, "2 starts and 3 goals; must be as many, or one"),
    ({"method": "dubin"}, "Did you mean 'dubins'"),
    ({"vehicle": "foci"}, "Did you mean 'focchi'"),
    ({"limits": FIXED._replace(v_min=0.5)}, "Did you swap them"),
    ({"limits": FIXED._replace(reserve=0.9)}, "Is the reserve too large"),
    ({"limits": FIXED._replace(v_max=math.nan)}, "v_max = nan"),
    ({"limits": FIXED._replace(sprocket_speed=-1.0)}, "sprocket_speed = -1.0"),
    ({"limits": Limits(sprocket_speed=4.0, v_min=0.1, v_max=0.4)}, "for any turn"),
    ({"limits": {"v_mx": 1.0}}, "Did you mean 'v_max'"),
    ({"limits": {"v_max": "0.4"}}, "limits v_max = '0.4'; must be a number"),
    ({"limits": {"curvature": math.nan}}, "limits curvature = nan"),
    ({"limits": {"reserve": 0.1j}}, "limits reserve = 0.1j"),
    ({"limits": {"v_max": math.inf}}, "limits v_max = inf; must be finite"),
    ({"limits": {"v_min": True}}, "limits v_min = True"),
    ({"period": 0.0}, "period = 0.0 s"),
    ({"period": math.nan}, "period = nan"),
    ({"period": -1}, "period"),
    ({"period": 100.0}, "period = 100.0"),
    ({"goal": (1e6, 0, 0)}, r"period = 0.02 s; must be at least 2.5 s for 2.5e\+06 s"),
    (
        {"goal": (0, 1, 1), "limits": LIMITS._replace(curvature=1e-5)},
        "the speed or the curvature far too small",
    ),
    ({"threads": -1}, "threads = -1"),
    ({"threads": 1.5}, "threads = 1.5"),
    ({"intervals": 0}, "intervals = 0"),
    ({"reverse": True}, "reverse = True; must be False with method = 'dubins'"),
    ({"reverse": "yes"}, "reverse = 'yes'; must be True or False"),
    ({"limits": REST._replace(v_min=-0.4)}, "v_min = -0.4; .*in reverse"),
    ({"obstacles": [(1.0, 2.0, 0.3)]}, "obstacles = a list; must be Obstacles"),
    ({"margin": -0.1}, "margin = -0.1 m"),
    ({"margin": math.nan}, "margin = nan m"),
    ({"room": -1.0}, "room = -1.0 m"),
    ({"time_limit": math.inf}, "time_limit = inf s"),
    ({"footprint": (1.0, 2.0)}, "front, back, left, right"),
    ({"footprint": (0.0, 0.0, 1.0, 1.0)}, "must have a length and a width"),
    ({"footprint": (1.0, math.nan, 1.0, 1.0)}, "footprint back = nan m"),
    ({"ground": (0.1, 0.1)}, "ground with method = 'dubins'; must be 'optimal'"),
    (PLANE, "must know slopes"),
    ({**PLANE, "slip_model": identified_slip(VEHICLE)}, "must know slopes"),
]


@pytest.mark.parametrize(("change", "message"), WRONG)
def test_what_it_cannot_plan_gets_one_line(change, message):
    options = {"start": ORIGIN, "goal": GOAL, "limits": FIXED, "method": "dubins", **change}
    refused(lambda: plan(**options), message)


def test_limits_of_another_type_are_refused_and_starts_may_be_mixed():
    refused(lambda: planned(ORIGIN, GOAL, limits=[1.0]), "must be Limits, or a dict", TypeError)
    assert [one.converged for one in planned([Start(), ORIGIN], GOAL)] == [True, True]
