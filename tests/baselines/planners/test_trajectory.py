"""What a controller follows of a plan: the course with the ground speed, or the body and belts."""

import math

import numpy as np
import pytest

from baselines.planners.motion_planning import METHODS, plan
from baselines.planners.trajectory import FRAMES, Limits, held_intervals
from tests.baselines.planners.planner_cases import FOCCHI, GOAL, SLIP, refused

RATES = {
    "constant speed": Limits.of(FOCCHI, reserve=0.1, v_min=0.4),
    "from rest to rest": Limits.of(FOCCHI, reserve=0.1, sprocket_acceleration=20.0),
}


def planned(method="optimal", speed="constant speed", slip=SLIP, goal=GOAL, **options):
    """A plan to the goal of figure 16 of F, or to another one."""
    motion = plan((0, 0, 0), goal, RATES[speed], slip, method, FOCCHI, **options)
    assert motion.converged or method != "optimal"
    return motion


@pytest.fixture(scope="module", params=RATES)
def motion(request):
    return planned(speed=request.param)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("method", METHODS)
def test_at_the_samples_of_a_plan_it_is_where_the_plan_is(method, frame):
    plan_ = planned(method, slip=None if method != "optimal" else SLIP)
    answer = plan_.at(plan_.time, frame, FOCCHI)
    np.testing.assert_allclose(answer.x, plan_.x, atol=1e-12)
    np.testing.assert_allclose(answer.y, plan_.y, atol=1e-12)
    if frame == "body" or method != "optimal":
        np.testing.assert_allclose(answer.yaw, plan_.yaw, atol=1e-9)


def test_between_the_samples_of_held_inputs_it_is_on_their_arcs():
    coarse, fine = (planned(period=period) for period in (10.0, 0.01))
    for frame in FRAMES:
        a, b = (p.at(fine.time, frame, FOCCHI) for p in (coarse, fine))
        for name in ("x", "y", "yaw", "speed", "yaw_rate", "acceleration", "yaw_acceleration"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-6)


def test_the_course_is_continuous_though_that_of_held_inputs_jumps(motion):
    times = np.linspace(0.0, motion.duration * (1.0 - 1e-9), 100_001)
    answer = motion.at(times)
    ends = held_intervals(motion).first[1:]
    jumps = np.abs(np.diff(motion.course - motion.yaw)[ends - 1])
    assert jumps.max() > 0.01
    assert np.abs(np.diff(answer.yaw)).max() < 1e-3
    held = held_intervals(motion)
    alpha = (motion.course - motion.yaw)[held.first]
    yaw = motion.at(held.middle, "body", FOCCHI).yaw
    np.testing.assert_allclose(motion.at(held.middle).yaw, yaw + alpha, atol=1e-9)


def test_the_course_frame_is_a_unicycle_on_the_planned_path(motion):
    times = np.linspace(0.0, motion.duration * (1.0 - 1e-9), 200_001)
    answer, step = motion.at(times), times[1]
    velocity = answer.speed * np.exp(1j * answer.yaw)
    place = np.append(0.0, np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step))
    assert np.abs(place - (answer.x + 1j * answer.y)).max() < 1e-3
    turned = np.append(0.0, np.cumsum(0.5 * (answer.yaw_rate[1:] + answer.yaw_rate[:-1]) * step))
    np.testing.assert_allclose(turned, answer.yaw - answer.yaw[0], atol=1e-3)


def test_the_body_frame_repeats_the_sprocket_speeds(motion):
    answer = motion.at(motion.time[:-1], "body", FOCCHI)
    turn = 0.5 * FOCCHI.track_gauge * answer.yaw_rate
    for belt, omega in (
        (answer.speed - turn, motion.sprocket_left),
        (answer.speed + turn, motion.sprocket_right),
    ):
        np.testing.assert_allclose(belt, FOCCHI.sprocket_radius * omega[:-1], atol=1e-12)


@pytest.mark.parametrize("method", ["dubins", "clothoid"])
def test_the_frames_of_a_path_with_slip_differ_by_alpha(method):
    motion = planned(method, slip=SLIP)
    course, body = (motion.at(motion.time[:-1], frame, FOCCHI) for frame in FRAMES)
    np.testing.assert_allclose(course.yaw - body.yaw, (motion.course - motion.yaw)[:-1], atol=1e-9)
    np.testing.assert_allclose(course.speed, 0.4, atol=1e-9)
    belts = 0.5 * FOCCHI.sprocket_radius * (motion.sprocket_left + motion.sprocket_right)[:-1]
    np.testing.assert_allclose(body.speed, belts, atol=1e-12)


def test_a_path_in_reverse_has_negative_speeds_and_moves_against_its_course():
    motion = planned("reeds-shepp", "from rest to rest", None, goal=(-1.0, 0.0, 0.0))
    times = np.linspace(0.0, motion.duration, 2001)
    answer = motion.at(times)
    assert answer.speed.min() < -0.2 and answer.speed.max() <= 0.0
    moved = np.gradient(answer.x, times)[2:-2]
    np.testing.assert_allclose(moved, (answer.speed * np.cos(answer.yaw))[2:-2], atol=0.05)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("method", METHODS)
def test_after_its_end_a_plan_stands_at_the_goal_with_the_yaw_of_the_vehicle(method, frame):
    motion = planned(method, slip=SLIP)
    times = motion.duration + np.array([0.0, 1e-3, 5.0])
    answer = motion.at(times, frame, FOCCHI)
    for name, value in zip(("x", "y"), GOAL, strict=False):
        np.testing.assert_allclose(getattr(answer, name), value, atol=1e-6)
    np.testing.assert_allclose(answer.yaw, motion.yaw[-1], atol=1e-12)
    assert not np.any(answer[3:])


@pytest.mark.parametrize(
    ("times", "frame", "message"),
    [
        ([-1.0], "course", "must be .* finite and >= 0"),
        ([math.nan], "body", "finite"),
        ([[0.0]], "course", "must be"),
        ([0.0], "chassis", "unknown frame 'chassis'"),
    ],
)
def test_bad_input_gets_one_line(times, frame, message):
    refused(lambda: planned().at(times, frame, FOCCHI), message)
