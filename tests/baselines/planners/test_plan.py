"""`plan`: what every method promises, its messages, and what it refuses."""

import math

import numpy as np
import pytest

from baselines.lyapunov.lyapunov_laws import PseudoKinematicModel
from baselines.planners.plan import plan
from baselines.planners.trajectory import Limits, Start
from baselines.slip.slip_sweep import identified_slip
from tests.baselines.planners.pairs import missed, random_pairs
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
PATHS = ("dubins", "reeds-shepp", "clothoid")
FIXED = Limits(sprocket_speed=18.0, v_min=0.4, v_max=0.4)  # F 7.2.1
GOAL = (2.0, 2.5, -0.4)


@pytest.mark.parametrize("method", PATHS)
@pytest.mark.parametrize(
    "limits", [FIXED, Limits.of(FOCCHI, v_min=0.0, sprocket_acceleration=20.0, reserve=0.1)],
    ids=["constant speed", "rest to rest"],
)  # fmt: skip
def test_its_samples_integrate_to_the_goal(method, limits):
    _, goals = random_pairs(40, seed=1)
    for goal, made in zip(goals, plan((0, 0, 0), goals, limits, method=method), strict=True):
        assert made.converged
        assert missed(np.array([made.x[-1], made.y[-1], made.yaw[-1]]), goal) < 1e-8
        assert max(made.end_error, made.end_yaw_error) < 1e-6
        assert np.all(np.diff(made.time) > 0.0)
        fine = np.linspace(0.0, made.duration, 20_000)
        speed, course = (
            np.interp(fine, made.time, made.speed),
            np.interp(fine, made.time, made.course),
        )
        x = made.x[0] + np.trapezoid(speed * np.cos(course), fine)
        y = made.y[0] + np.trapezoid(speed * np.sin(course), fine)
        assert math.hypot(x - goal[0], y - goal[1]) < 2e-2  # corners between samples
        largest = max(np.abs(made.sprocket_left).max(), np.abs(made.sprocket_right).max())
        assert largest <= limits.sprocket_used * (1.0 + 1e-9)


def test_from_rest_to_rest_it_starts_and_ends_at_rest():
    made = plan((0, 0, 0), GOAL, Limits.of(FOCCHI, v_min=0.0), method="clothoid")
    assert made.speed[0] == made.speed[-1] == 0.0
    assert made.sprocket_left[-1] == made.sprocket_right[-1] == 0.0


def test_the_optimal_plan_can_brake_to_rest_within_one_interval_of_its_end():
    limits = Limits.of(FOCCHI, sprocket_acceleration=20.0)
    made = plan((0, 0, 0), GOAL, limits, period=10.0)
    moving = plan((0, 0, 0), GOAL, limits._replace(sprocket_acceleration=math.inf), period=10.0)
    within = 20.0 * made.duration / 40
    for side in ("sprocket_left", "sprocket_right"):
        assert abs(getattr(made, side)[-1]) <= within + 1e-6
    assert max(moving.sprocket_left[-1], moving.sprocket_right[-1]) > 1.0


@pytest.mark.parametrize("speed", [0.0, 0.2])
def test_sprockets_of_an_optimal_plan_step_by_what_the_limit_allows_in_an_interval(speed):
    """Steps of held speeds, as the documentation of `Trajectory` says, whatever the samples are."""
    limits = Limits.of(FOCCHI, sprocket_acceleration=20.0, v_min=0.0)
    made = plan(Start(speed=speed), GOAL, limits, period=0.02)
    most = 20.0 * made.duration / 40 + 1e-6
    first = speed / FOCCHI.sprocket_radius
    for side in (made.sprocket_left, made.sprocket_right):
        steps = np.abs(np.diff(np.concatenate([[first], side[:-1], [0.0]])))
        assert np.count_nonzero(steps > 1e-9) <= 41
        assert steps.max() <= most
        assert steps.max() > 20.0 * 0.02  # more than the limit allows between two samples
    assert max(abs(made.sprocket_left[-1]), abs(made.sprocket_right[-1])) <= most


def test_a_moving_vehicle_goes_on_at_its_speed():
    made = plan(Start(speed=0.3), GOAL, Limits.of(FOCCHI, v_min=0.0), method="clothoid")
    assert made.speed[0] == pytest.approx(0.3)


def test_sprockets_of_a_plan_that_knows_slip_drive_it_on_the_model_with_slip():
    slip = identified_slip(FOCCHI)
    limits = Limits.of(FOCCHI, v_min=0.3, v_max=0.3, curvature=1.5)
    model = PseudoKinematicModel(FOCCHI, slip)
    ends = {}
    for name, known in (("slip", slip), ("none", None)):
        made = plan((0, 0, 0), GOAL, limits, known, method="dubins", period=0.005)
        pose = np.array([[made.x[0], made.y[0], made.yaw[0]]])
        for i, step in enumerate(np.diff(made.time)):
            pose = model.step(
                pose, np.array([[made.sprocket_left[i], made.sprocket_right[i]]]), step
            )
        ends[name] = math.hypot(pose[0, 0] - GOAL[0], pose[0, 1] - GOAL[1])
    # The yaw jumps by alpha where arcs begin: the model, which starts each with the yaw it has,
    # drives off by about alpha times the rest of the way.
    assert ends["slip"] < 0.3 * ends["none"]
    assert made.yaw == pytest.approx(made.course)


def test_a_clothoid_that_breaks_a_limit_says_so_and_falls_back():
    made = plan((0, 0, 0), (-0.5, 0.1, 0.2), FIXED, method="clothoid")
    assert made.method == "dubins"
    assert "Dubins path instead" in made.message
    assert made.converged
    far = plan((0, 0, 0), (2.7, -0.4, 3.0), FIXED._replace(sprocket_speed=1e3), method="clothoid")
    assert far.method in ("clothoid", "dubins")


def test_one_pose_needs_no_motion():
    for method in PATHS:
        made = plan((1, 2, 3), (1, 2, 3), FIXED, method=method)
        assert made.duration == made.length == 0.0
        assert made.converged


def test_curvature_jumps_are_reported_where_sprockets_have_an_acceleration_limit():
    limits = Limits.of(FOCCHI, sprocket_acceleration=20.0)
    assert "jump" in plan((0, 0, 0), GOAL, limits, method="dubins").message
    assert "jump" not in plan((0, 0, 0), (2.0, 0.0, 0.0), limits, method="dubins").message


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (math.nan, 0, 0)}, "goal x = nan"),
        ({"goal": (1.0, 2.0)}, "goal has shape"),
        ({"goal": "home"}, "goal = 'home'"),
        ({"start": (0, 0, math.inf)}, "start yaw = inf"),
        ({"method": "dubin"}, "Did you mean 'dubins'"),
        ({"vehicle": "foci"}, "Did you mean 'focchi'"),
        ({"limits": FIXED._replace(v_min=0.5)}, "Did you swap them"),
        ({"limits": FIXED._replace(reserve=0.9)}, "Is the reserve too large"),
        ({"limits": FIXED._replace(v_max=math.nan)}, "v_max = nan"),
        ({"limits": FIXED._replace(sprocket_speed=-1.0)}, "sprocket_speed = -1.0"),
        ({"limits": Limits(sprocket_speed=4.0, v_min=0.1, v_max=0.4)}, "for any turn"),
        ({"period": 0.0}, "period = 0.0 s"),
    ],
)
def test_what_it_cannot_plan_gets_one_line(change, message):
    given = {"start": (0, 0, 0), "goal": GOAL, "limits": FIXED, "method": "dubins", **change}
    with pytest.raises(ValueError, match=message) as error:
        plan(**given)
    assert "\n" not in str(error.value)
