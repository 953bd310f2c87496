"""References of the kind "plan": what planners made, in both frames, and what is refused."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from baselines.planners import plan
from baselines.planners.least_time import optimal
from baselines.planners.legs import timed_path
from baselines.planners.trajectory import Limits, Start
from baselines.slip.slip_sweep import identified_slip
from tracked_env.physics import reference_profile as knots
from tracked_env.physics.parameters import VEHICLES
from tracked_env.references import make_reference, plans, sample
from tracked_env.references.profile import of_table, with_knots

FOCCHI = VEHICLES["focchi"]
GOAL = (2.0, 2.5, -0.4)
FIXED = {"v_min": 0.4, "v_max": 0.4}
LIMITS = {**plans.DEFAULT_LIMITS}
TARGETS = Path(__file__).parents[3] / "shared" / "data" / "planners" / "targets.csv"
PATHS = ("dubins", "reeds-shepp", "clothoid")


def build(duration=30.0, vehicle=FOCCHI, seed=0, **options):
    goal = {} if "goals" in options else {"goal": GOAL}
    spec = {"kind": "plan", **goal, **options}
    return make_reference(spec, duration, np.random.default_rng(seed), vehicle)


def optimal_trajectory(limits, slip=True, goal=GOAL, vehicle=FOCCHI):
    allowed = Limits.of(vehicle, **limits)
    model = identified_slip(vehicle) if slip else None
    return optimal(Start(), goal, allowed, vehicle, model, stop=not allowed.fixed)


def close(result, expected, atol=1e-9):
    np.testing.assert_allclose(result, expected, rtol=0.0, atol=atol)


def same(result, expected, names, atol=1e-9):
    """The fields of both agree."""
    for name in names:
        close(getattr(result, name), getattr(expected, name), atol)


def belts_of(trajectory):
    """Speed [m/s] of the middle of both belts."""
    return 0.5 * FOCCHI.sprocket_radius * (trajectory.sprocket_left + trajectory.sprocket_right)


@pytest.mark.parametrize("limits", [LIMITS, {**LIMITS, **FIXED}], ids=["variable", "fixed"])
@pytest.mark.parametrize("frame", plans.FRAMES)
def test_the_reference_of_an_optimal_plan_is_the_trajectory_of_the_planner(frame, limits):
    trajectory, profile = optimal_trajectory(limits), build(frame=frame, limits=limits)
    at = sample(profile, trajectory.time)
    same(at, trajectory, ("x", "y"))
    expected = trajectory.at(trajectory.time, frame, FOCCHI)
    same(at, expected, ("speed", "yaw_rate"))
    close(at.yaw[:-1], expected.yaw[:-1])
    if frame == "body":
        close(at.yaw[:-1], trajectory.yaw[:-1])
        close(at.speed[:-1], belts_of(trajectory)[:-1])
    # Between the knots the inputs are held, and the pose moves with them.
    t = np.linspace(0.0, trajectory.duration - 1e-6, 777)
    at, expected = sample(profile, t), trajectory.at(t, frame, FOCCHI)
    same(at, expected, ("speed", "yaw_rate", "yaw"))
    # The course turns steadily while the plan's vehicle slips: that path is another one by 0.2 mm.
    same(at, expected, ("x", "y"), 1e-9 if frame == "body" else 2e-4)
    assert np.ptp(at.acceleration) == 0.0


@pytest.mark.parametrize("limits", [{}, {**FIXED, "curvature": 2.0}], ids=["variable", "fixed"])
@pytest.mark.parametrize("method", PATHS)
def test_along_a_path_the_reference_is_the_trajectory_of_the_planner(method, limits):
    both = {**LIMITS, **limits}
    allowed = Limits.of(FOCCHI, **both)
    trajectory = plan(Start(), GOAL, allowed, None, method, FOCCHI)
    at = sample(build(planner=method, limits=both), trajectory.time)
    before = slice(None, -1)  # at the last sample it stands
    for name, field in [("x", "x"), ("y", "y"), ("yaw", "course"), ("speed", "speed")]:
        close(getattr(at, name)[before], getattr(trajectory, field)[before])
    # Where the curvature jumps the side of the jump is a matter of rounding:
    wrong = np.abs(at.yaw_rate - trajectory.course_rate)[before] > 1e-8
    assert np.count_nonzero(wrong) <= 1


def test_in_reverse_the_speed_of_the_reference_is_negative_and_it_arrives():
    profile = build(planner="reeds-shepp", goal=[-1.0, 0.2, 0.0])
    times = np.linspace(0.0, 20.0, 4001)
    at = sample(profile, times)
    assert at.speed.min() < -0.3
    assert math.hypot(at.x[-1] + 1.0, at.y[-1] - 0.2) == 0.0
    assert np.abs(np.diff(at.x)).max() < 0.4 * 0.005 * 1.01  # it does not jump anywhere


def test_in_the_body_frame_a_path_is_driven_by_the_belts_that_slip_needs():
    limits = {**LIMITS, "v_max": 0.3, "curvature": 3.0}
    profile = build(planner="clothoid", frame="body", slip=True, limits=limits)
    allowed = Limits.of(FOCCHI, **limits)
    model = identified_slip(FOCCHI)
    trajectory = plan(Start(), GOAL, allowed, model, "clothoid", FOCCHI, period=0.05)
    assert trajectory.method == "clothoid"
    at, inner = sample(profile, trajectory.time), slice(1, -1)
    close(at.speed[inner], belts_of(trajectory)[inner], 2e-3)
    for name, atol in (("yaw", 5e-3), ("x", 1e-3), ("y", 1e-3)):
        close(getattr(at, name)[inner], getattr(trajectory, name)[inner], atol)
    assert np.abs(trajectory.yaw - trajectory.course).max() > 0.02  # there is slip
    path = timed_path(Start(), np.array(GOAL), allowed, FOCCHI, "clothoid")
    assert profile.knots[-1, 0] == pytest.approx(path.speed.time[-1])


SLIPPING = {"planner": "clothoid", "slip": True, "limits": {"v_min": 0.3, "v_max": 0.3}}


@pytest.mark.parametrize("frame", plans.FRAMES)
@pytest.mark.parametrize("options", [*({"planner": p} for p in ("optimal", *PATHS)), SLIPPING])
def test_after_the_plan_the_reference_stands_at_the_goal_with_its_yaw(options, frame):
    profile = build(**options, frame=frame)
    end = profile.knots[-1, 0]
    at = sample(profile, [end, end + 1.0, 3000.0])
    np.testing.assert_array_equal(at.x, GOAL[0])
    np.testing.assert_array_equal(at.y, GOAL[1])
    np.testing.assert_allclose(np.remainder(at.yaw - GOAL[2] + 1.0, 2 * np.pi), 1.0, atol=1e-12)
    for name in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        np.testing.assert_array_equal(getattr(at, name), 0.0)


def test_from_rest_the_vehicle_starts_at_rest_and_at_constant_speed_with_it():
    assert build().speed[0, 0] == 0.0
    assert build(planner="dubins").speed[0, 0] == 0.0
    assert build(limits=FIXED, slip=False).speed[0, 0] == pytest.approx(0.4)


def test_a_plan_from_another_start_is_the_plan_from_the_origin_moved_there():
    x, y, yaw = 3.0, -2.0, 1.2
    t = np.linspace(0.0, 12.0, 61)
    plain, moved = sample(build(), t), sample(build(x=x, y=y, yaw=yaw), t)
    place = (plain.x + 1j * plain.y) * np.exp(1j * yaw) + x + 1j * y
    np.testing.assert_allclose(moved.x + 1j * moved.y, place, atol=1e-12)
    np.testing.assert_allclose(moved.yaw, plain.yaw + yaw, atol=1e-12)
    np.testing.assert_array_equal(moved.speed, plain.speed)


@pytest.mark.parametrize("width", [knots.COURSE_COLUMNS, knots.BODY_COLUMNS])
def test_a_reference_on_the_uniform_grid_is_the_same_with_knots_of_its_own(width, rng):
    profile = make_reference("random", 10.0, rng)
    table = with_knots(profile, width)
    t = np.linspace(0.0, 14.0, 203)
    close(sample(of_table(table, *table[0, 13:16]), t), sample(profile, t), 1e-12)


@pytest.mark.parametrize("nearest", [1.0, 2.0])
def test_the_goals_of_halton_are_those_of_the_published_code(nearest):
    if not TARGETS.exists():
        pytest.skip("the table of targets is not part of the repository")
    with TARGETS.open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["annulus_min"]) == nearest]
    expected = [[float(row[name]) for name in ("x", "y", "yaw")] for row in rows]
    close(plans.halton_goals(nearest, 4.0), expected, 1e-12)


def test_drawn_goals_are_halton_points_of_the_vehicle_and_follow_the_generator():
    ends = {tuple(build(goals="halton", seed=s).knots[-1, 1:3].tolist()) for s in range(12)}
    goals = {tuple(goal[:2].tolist()) for goal in plans.halton_goals(1.0, 4.0)}
    assert ends <= goals and len(ends) > 6
    assert build(goals="halton", seed=5).knots[-1, 1] == build(goals="halton", seed=5).knots[-1, 1]
    large = build(goals="halton", vehicle=VEHICLES["strawa"], seed=1).knots[-1, 1:3]
    scale = 1.7 / 0.606
    assert scale <= np.hypot(*large) <= 4.0 * scale
    options = {tuple(build(goals=[GOAL, (1.0, 1.0, 0.0)], seed=s).knots[-1, 1:3]) for s in range(8)}
    assert options == {(2.0, 2.5), (1.0, 1.0)}


def refusing(converged):
    """A planner that finds plans to those goals alone whose x is in `converged`."""

    def planner(vehicle, limits, slip, frame, goal):
        rows = np.zeros((1, knots.COURSE_COLUMNS))
        rows[0, knots.POSE : knots.POSE + 3] = goal
        return knots.PlannedRows(rows, goal[0] in converged, "it is out of reach")

    return planner


def test_a_drawn_goal_without_a_plan_gives_way_to_the_next_one(monkeypatch):
    monkeypatch.setattr(plans, "_planner", lambda name: refusing([3.0]))
    goals = [(float(n), 0.0, 0.0) for n in range(5)]
    for seed in range(6):
        assert build(goals=goals, seed=seed).knots[-1, 1] == 3.0
    monkeypatch.setattr(plans, "_planner", lambda name: refusing([]))
    with pytest.raises(ValueError, match=r"none of 5 goals drawn, .*out of reach"):
        build(goals=goals)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goal": None}, "goal = None; must be"),
        ({"goal": [1.0, 2.0]}, "goal = .* must be \\[x, y, yaw\\]"),
        ({"goal": [1.0, math.nan, 0.0]}, "goal y = nan m"),
        ({"goal": GOAL, "goals": "halton"}, "one of 'goal'"),
        ({"goals": "sobol"}, "goals = 'sobol'|goals 'sobol'"),
        ({"goals": []}, 'must be "halton" or a list'),
        ({"goals": "halton", "annulus": [4.0, 1.0]}, "low must be <= high"),
        ({"goals": "halton", "annulus": [3.99, 4.0]}, "Widen it"),
        ({"annulus": [1.0, 4.0]}, "annulus is of"),
        ({"planner": "rrt"}, "planner .*rrt.*dubins"),
        ({"frame": "world"}, "frame .*world"),
        ({"slip": 1}, "slip = 1"),
        ({"limits": {"v": 1.0}}, "limits.*'v'"),
        ({"limits": {"v_max": 99.0}}, "limits v_max = 99"),
        ({"limits": {"v_min": 0.5, "v_max": 0.4}}, "v_min = 0.5, v_max = 0.4"),
        ({"limits": {"reserve": math.nan}}, "limits reserve = nan"),
        ({"goal": [30.0, 0.0, 0.0]}, r"it takes 7\d.\d s of an episode of 30 s"),
        ({"goal": [900.0, 0.0, 0.0], "planner": "clothoid"}, "raise duration or v_max"),
        ({"planner": "dubins", "slip": True}, "with slip the sprockets reach"),
        ({"radius": 3.0}, "radius"),
        ({"yaw": 1e9}, "start yaw"),
    ],
)
def test_a_wrong_plan_is_refused_in_one_line(options, message):
    with pytest.raises(ValueError, match=message) as error:
        build(
            **({"goal": GOAL} if "goal" not in options and "goals" not in options else {}) | options
        )
    assert "\n" not in str(error.value)


def test_a_plan_without_a_vehicle_is_refused():
    with pytest.raises(ValueError, match="needs the vehicle"):
        make_reference({"kind": "plan", "goal": GOAL}, 30.0, np.random.default_rng(0))


def test_no_installed_package_with_planners_is_a_clear_error(monkeypatch):
    plans._planner.cache_clear()
    monkeypatch.setattr(plans, "declared", lambda group: [])
    with pytest.raises(ValueError, match="no installed package registers"):
        build()
    plans._planner.cache_clear()
