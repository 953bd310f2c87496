"""Environments whose reference is a plan, and the observation of its goal."""

import math

import gymnasium
import numpy as np
import pytest

from tests.driving import ON_PATH
from tracked_env import SPEED, SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env import arrays as b
from tracked_env import observation as obs
from tracked_env.references import sample
from tracked_env.vector_env import TrackedVehicleVectorEnv

GOAL = [2.0, 2.5, -0.4]
PLAN = {"kind": "plan", "goal": GOAL}
DRAWN = {"kind": "plan", "goals": "halton"}
SHOWN = [*obs.V0.groups, "goal"]
CALM = {"uncertainty": "nominal", "error_limit": 1e3}
FRAMES = ("course", "body")
REFERENCE = slice(b.REFERENCE_X, b.REFERENCE_X + 3)


def make(env_id=SPEED_ID, **arguments):
    settings = {
        "reference": PLAN,
        "observation": SHOWN,
        "sensors": "ideal",
        "uncertainty": "nominal",
    }
    return gymnasium.make(env_id, **{**settings, **CALM, **arguments}).unwrapped


def indoors(count, **arguments):
    settings = {**SPEED, "reference": DRAWN, "observation": SHOWN, "duration": 20.0}
    return TrackedVehicleVectorEnv(count, **{**settings, **arguments})


def walked(env, steps, action=(0.0, 0.0)):
    """References (steps + 1, 3) and observations in SI units of a constant action."""
    floats = env.simulation.batch.floats
    references, readings = [floats[0, REFERENCE].copy()], []
    for _ in range(steps):
        readings.append(env.step(np.float32(action))[0])
        references.append(floats[0, REFERENCE].copy())
    return np.array(references), env.layout.unpack(np.array(readings))


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("env_id", [SPEED_ID, TORQUE_ID])
def test_the_reference_of_an_environment_follows_the_plan_and_stands_at_its_end(env_id, frame):
    env = make(env_id, reference={**DRAWN, "frame": frame})
    env.reset(seed=4)
    profile = env.simulation.episodes[0].profile
    references, readings = walked(env, 1499)
    expected = sample(profile, 0.02 * np.arange(1500))
    np.testing.assert_allclose(references[:, 0], expected.x, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(references[:, 1], expected.y, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(references[:, 2], expected.yaw, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(readings["reference_speed"], expected.speed[1:], atol=1e-6)
    np.testing.assert_allclose(
        readings["reference_yaw_rate_ahead_0.5"][:-25], expected.yaw_rate[26:], atol=1e-6
    )
    assert tuple(references[-1]) == tuple(profile.knots[-1, 1:4])
    end = int(profile.knots[-1, 0] / 0.02) + 2
    assert np.ptp(references[end:], axis=0).max() == 0.0
    assert end < 1400


@pytest.mark.parametrize("env_id", [SPEED_ID, TORQUE_ID, TERRAIN_ID])
def test_the_goal_is_shown_in_the_axes_of_the_vehicle(env_id):
    groups = [*TERRAIN["observation"], "goal"] if env_id == TERRAIN_ID else SHOWN
    env = make(env_id, observation=groups, expose_truth=True)
    env.reset(seed=1)
    for _ in range(60):
        readings, *_, info = env.step(np.float32([0.05, 0.2]))
    truth, fields = info["truth"], env.layout.unpack(readings)
    away = (GOAL[0] - truth["x"] + 1j * (GOAL[1] - truth["y"])) * np.exp(-1j * truth["yaw"])
    assert fields["goal_x"] == pytest.approx(away.real, abs=1e-5)
    assert fields["goal_y"] == pytest.approx(away.imag, abs=1e-5)
    assert fields["goal_cosine"] == pytest.approx(math.cos(GOAL[2] - truth["yaw"]), abs=1e-6)
    assert fields["goal_sine"] == pytest.approx(math.sin(GOAL[2] - truth["yaw"]), abs=1e-6)
    duration = env.simulation.episodes[0].profile.knots[-1, 0]
    assert fields["goal_time"] == pytest.approx(duration - 0.02 * 60, abs=1e-4)
    assert abs(truth["yaw"]) > 0.05


def test_after_the_plan_no_time_is_left():
    env = make(reference={"kind": "plan", "goal": [0.5, 0.0, 0.0]})
    env.reset(seed=1)
    _, readings = walked(env, 250)
    left = readings["goal_time"]
    assert left[0] > 1.0 and left[-1] == 0.0
    np.testing.assert_allclose(np.diff(left[left > 0.0]), -0.02, atol=1e-5)


def test_the_goal_that_is_shown_is_as_late_as_the_measured_pose():
    env = make(sensors={"preset": "ideal", "pose_delay": 0.2}, expose_truth=True)
    env.reset(seed=1)
    places = []
    for _ in range(60):
        readings, *_, info = env.step(np.float32([0.3, 0.4]))
        places.append((info["truth"]["x"], info["truth"]["y"], info["truth"]["yaw"]))
    fields, (x, y, yaw) = env.layout.unpack(readings), places[-11]
    away = (GOAL[0] - x + 1j * (GOAL[1] - y)) * np.exp(-1j * yaw)
    assert fields["goal_x"] == pytest.approx(away.real, abs=1e-5)
    assert fields["goal_y"] == pytest.approx(away.imag, abs=1e-5)


def test_a_mirrored_goal_is_the_observation_of_the_mirrored_vehicle():
    readings = []
    for sign in (1.0, -1.0):
        goal = [GOAL[0], sign * GOAL[1], sign * GOAL[2]]
        env = make(reference={"kind": "plan", "goal": goal, "planner": "dubins"})
        start = {**ON_PATH, "offset_y": 0.2 * sign, "offset_yaw": 0.3 * sign}
        env.reset(seed=0, options={"start": start})
        action = np.float32([0.2, 0.3] if sign > 0.0 else [0.3, 0.2])
        for _ in range(50):
            last = env.step(action)[0]
        readings.append(last)
    np.testing.assert_allclose(env.layout.mirror(readings[0]), readings[1], atol=1e-6)
    names = env.layout.index
    assert abs(readings[0][names["goal_y"]]) > 0.1 and abs(readings[0][names["goal_sine"]]) > 0.1


def test_goals_follow_the_seed_and_differ_between_episodes():
    env = indoors(4)
    env.reset(seed=9)
    first = [episode.profile.knots[-1, 1:].copy() for episode in env.simulation.episodes]
    env.reset()
    second = [episode.profile.knots[-1, 1:].copy() for episode in env.simulation.episodes]
    env.reset(seed=9)
    again = [episode.profile.knots[-1, 1:] for episode in env.simulation.episodes]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, second)


def test_options_may_give_another_goal_with_more_knots_and_another_kind_of_reference():
    env = make(observation="v0", duration=40.0, reference={**PLAN, "planner": "dubins"})
    env.reset(seed=0)
    rows = len(env.simulation.batch.profile)
    env.reset(options={"reference": {"kind": "plan", "goal": [1.0, -1.0, 0.3]}})
    assert len(env.simulation.batch.profile) > rows
    references, _ = walked(env, 700)
    np.testing.assert_allclose(references[-1, :2], [1.0, -1.0], rtol=0.0, atol=1e-12)
    env.reset()  # to the plan with fewer knots, where those of the longer one have been
    references, _ = walked(env, 700)
    assert tuple(references[-1]) == (*GOAL[:2], pytest.approx(GOAL[2]))
    circle = {"kind": "circle", "radius": 2.0, "speed": 0.4}
    env.reset(options={"reference": circle, "start": ON_PATH})
    references, _ = walked(env, 1999)
    turned = 0.2 * 0.02 * np.arange(2000)
    np.testing.assert_allclose(references[:, 0], 2.0 * np.sin(turned), atol=1e-9)
    np.testing.assert_allclose(references[:, 2], turned, atol=1e-9)


def test_there_is_room_for_a_drawn_plan_with_more_knots_than_those_before():
    goals = [[1.0, 0.0, 0.0], [2.0, 2.5, -0.4], [1.5, -1.0, 2.0]]
    plan = {"kind": "plan", "goals": goals, "planner": "clothoid", "limits": {"curvature": 3.0}}
    env = indoors(6, reference=plan, error_limit=1e3)
    at_first = len(env.simulation.batch.profile)
    env.reset(seed=0)
    assert len(env.simulation.batch.profile) > at_first
    for _ in range(700):
        env.step(np.zeros((6, 2), np.float32))
    for row, episode in enumerate(env.simulation.episodes):
        expected = sample(episode.profile, [14.0])
        x, y, _ = env.simulation.batch.floats[row, REFERENCE]
        np.testing.assert_allclose([x, y], [expected.x[0], expected.y[0]], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "options", "said"),
    [
        ({"reference": "random"}, None, "group 'goal': the reference has no goal"),
        ({"observation": "v0", "reference": "random"}, PLAN, "keeps no knots"),
        ({"observation": "v0"}, {**PLAN, "frame": "body"}, '"frame": "body"'),
        ({}, "circle", "group 'goal': the reference has no goal"),
        ({"duration": 5.0}, None, "it takes .* s of an episode of 5 s"),
    ],
)
def test_a_goal_that_cannot_be_shown_or_kept_is_refused_in_one_line(arguments, options, said):
    with pytest.raises(ValueError, match=said) as error:
        env = make(**arguments)
        env.reset(seed=0)
        env.reset(options={"reference": options})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("uncertainty", ["terrain-transition", "mixed"])
def test_changes_on_the_path_lie_on_the_plan(uncertainty):
    settings = {"reference": DRAWN, "uncertainty": uncertainty, "observation": "v0"}
    many = TrackedVehicleVectorEnv(6, duration=30.0, **settings)
    many.reset(seed=5)
    lines = 0
    for episode in many.simulation.episodes:
        path = sample(episode.profile, np.linspace(0.0, 30.0, 3001))
        for event in episode.events[episode.events[:, 0] == 2]:
            lines += 1
            assert np.hypot(path.x - event[3], path.y - event[4]).min() < 0.05
    assert lines > 0
