"""Dubins, Reeds-Shepp and clothoids: closed forms, degenerate poses, second methods."""

import math

import numpy as np
import pytest

from baselines.planners.curves import WORDS, clothoid, dubins, reeds_shepp
from baselines.planners.speed_along_path import Path, end_errors, places
from tests.baselines.planners import planner_cases as cases

PI = math.pi


@pytest.mark.parametrize(
    ("curve", "goal", "radius", "length"),
    [
        *((curve, (0, 0, 0), 0.5, 0.0) for curve in (dubins, reeds_shepp)),  # one pose
        (dubins, (0, 0, 4 * PI), 0.5, 0.0),  # and whole turns of it
        *((curve, (0, 0, -1e-16), 0.5, 0.0) for curve in (dubins, reeds_shepp)),  # is no circle
        *((curve, (3, 0, 0), 0.5, 3.0) for curve in (dubins, reeds_shepp)),  # straight ahead
        (dubins, (3, 1e-12, 1e-12), 0.5, 3.0),
        (dubins, (3, -1e-12, -1e-12), 0.5, 3.0),
        *((curve, (0, 2, PI), 1.0, PI) for curve in (dubins, reeds_shepp)),  # half circle
        (dubins, (0, -2, -PI), 1.0, PI),
        *(
            (curve, (1, 1, cases.HALF), 1.0, cases.HALF) for curve in (dubins, reeds_shepp)
        ),  # quarter circle
        (dubins, (2, 2, 0), 1.0, PI),  # two quarters: the inner circles touch
        (dubins, (2, -2, 0), 1.0, PI),
        (dubins, (-2, 0, PI), 0.5, None),
        (dubins, (1000, 0, 0), 0.1, 1000.0),
        (dubins, (0, 0, PI), 1.0, 7 * PI / 3),  # turning round on the spot: three arcs
        (dubins, (-1e-12, 0, 0), 1.0, 0.0),
        (reeds_shepp, (-3, 0, 0), 0.5, 3.0),  # straight back
        (reeds_shepp, (-1, -1, cases.HALF), 1.0, cases.HALF),  # a quarter in reverse
        (reeds_shepp, (0, 0, PI), 1.0, PI),  # three arcs of 60 degrees, two changes of gear
    ],
)
def test_degenerate_poses_have_the_length_of_their_closed_form(curve, goal, radius, length):
    path = curve(cases.ORIGIN, goal, radius)
    end = cases.drive(cases.ORIGIN, path.segments[0], path.curvature[0])
    assert cases.missed(end, goal) < 1e-9 * (1.0 + path.length[0])
    if length is not None:
        assert path.length[0] == pytest.approx(length, abs=1e-9)
    gears = np.sign(path.segments[0][np.abs(path.segments[0]) > 1e-9 * radius])
    reversals = 2 if curve is reeds_shepp and goal == (0, 0, PI) else 0
    assert np.count_nonzero(np.diff(gears)) == reversals


@pytest.mark.parametrize(("curve", "tolerance"), [(dubins, 1e-12), (reeds_shepp, 1e-9)])
def test_every_path_drives_to_its_goal(curve, tolerance):
    start, goal = cases.random_pairs(4000)
    radius = np.random.default_rng(1).uniform(0.1, 2.0, 4000)
    path = curve(start, goal, radius)
    for i in range(4000):
        end = cases.drive(start[i], path.segments[i], path.curvature[i])
        assert cases.missed(end, goal[i]) < tolerance * (1.0 + path.length[i])
    if curve is dubins:
        assert len(np.unique(np.sign(path.curvature), axis=0)) == len(WORDS)


def test_rounding_adds_no_circle_to_a_straight_line():
    start = np.random.default_rng(6).uniform(-4, 4, (2000, 3))
    ahead = np.random.default_rng(7).uniform(0.1, 4, 2000)
    line = np.stack([np.cos(start[:, 2]), np.sin(start[:, 2]), np.zeros(2000)], axis=1)
    path = dubins(start, start + ahead[:, None] * line, 0.4)
    np.testing.assert_allclose(path.length, ahead, rtol=1e-9)


@pytest.mark.parametrize(
    ("column", "curve", "tolerance"),
    [
        ("dubins_length", lambda goals: dubins(cases.ORIGIN, goals, 0.106241234), 1e-8),
        ("clothoid_length", lambda goals: clothoid(cases.ORIGIN, goals), 1e-9),
    ],
)
def test_published_targets_have_their_length(reference_data, column, curve, tolerance):
    goals, length = cases.published_targets(reference_data, column)
    np.testing.assert_allclose(curve(goals).length, length, atol=tolerance)


@pytest.mark.parametrize(
    ("curve", "arguments", "message"),
    [
        (dubins, ((0, 0, math.nan), cases.ORIGIN, 1.0), "start yaw = nan"),
        (dubins, (cases.ORIGIN, (math.inf, 0, 0), 1.0), "goal x = inf"),
        (dubins, (cases.ORIGIN, cases.ORIGIN, 0.0), "radius = 0.0"),
        (dubins, (cases.ORIGIN, (1.0, 2.0), 1.0), "goal has shape"),
        (dubins, (np.zeros((2, 3)), np.zeros((3, 3)), 1.0), r"\[2, 3\] poses"),
        (clothoid, (cases.ORIGIN, (0.0, 0.0, 1.0)), "0 m apart"),
    ],
)
def test_bad_poses_are_refused_in_one_line(curve, arguments, message):
    cases.refused(lambda: curve(*arguments), message)


@pytest.mark.parametrize("curve", [dubins, reeds_shepp])
def test_lengths_agree_with_ompl(curve):
    base = pytest.importorskip("ompl", reason="OMPL is not installed (extra dev)").base
    start, goal = cases.random_pairs(800, seed=3)
    path = curve(start, goal, 0.7)
    spaces = {dubins: base.DubinsStateSpace, reeds_shepp: base.ReedsSheppStateSpace}
    space = spaces[curve](0.7)
    first, last = space.allocState(), space.allocState()
    for i in range(800):
        for state, pose in ((first, start[i]), (last, goal[i])):
            state.setX(pose[0])
            state.setY(pose[1])
            state.setYaw(pose[2])
        # Ours may be shorter: its candidates are accepted by driving them.
        assert path.length[i] < space.distance(first, last) * (1.0 + 1e-6) + 1e-6
        assert (
            cases.missed(cases.drive(start[i], path.segments[i], path.curvature[i]), goal[i]) < 1e-8
        )


def apart(count, seed):
    """Pairs of poses at different places."""
    return (poses[count // 8 :] for poses in cases.random_pairs(count, seed))


def test_every_clothoid_drives_to_its_goal():
    start, goal = apart(3000, seed=0)
    spiral = clothoid(start, goal)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    way = 0.5 * spiral.length[:, None] * (nodes + 1.0)
    yaw = start[:, 2:] + (spiral.curvature + 0.5 * spiral.sharpness * way) * way
    half = 0.5 * spiral.length
    x = start[:, 0] + half * (np.cos(yaw) @ weights)
    y = start[:, 1] + half * (np.sin(yaw) @ weights)
    away = np.hypot(x - goal[:, 0], y - goal[:, 1])
    assert np.all(away < 1e-11 * (1.0 + spiral.length))
    bend = spiral.curvature + 0.5 * spiral.sharpness * spiral.segments
    turned = start[:, 2] + np.sum(bend * spiral.segments, axis=1) - goal[:, 2]
    assert np.max(np.abs(np.sin(turned))) < 1e-10
    assert np.all(spiral.length > 0.0)


def test_clothoids_agree_with_pyclothoids():
    library = pytest.importorskip("pyclothoids", reason="pyclothoids is not installed (extra dev)")
    start, goal = apart(1200, seed=2)
    straight = np.array([[x, 0.0, yaw] for x in (-2.0, 1.0) for yaw in (0.0, cases.HALF, math.pi)])
    start = np.concatenate([start[400:], 0.0 * straight])
    goal = np.concatenate([goal[400:], straight])
    spiral = clothoid(start, goal)
    for i, (first, last) in enumerate(zip(start, goal, strict=True)):
        theirs = library.Clothoid.G1Hermite(*first, *last)
        assert spiral.length[i] == pytest.approx(theirs.length, rel=1e-8)
        assert spiral.curvature[i, 0] == pytest.approx(theirs.KappaStart, rel=1e-6, abs=1e-8)
        assert spiral.sharpness[i, 0] == pytest.approx(theirs.dk, rel=1e-6, abs=1e-8)


def test_places_of_a_path_are_those_of_its_arcs_and_its_integral():
    path = Path.of((0.3, -0.2, 0.7), [0.8, -1.1, 0.0, 0.5], [0.9, -0.4, 3.0, 1e-3])
    end = cases.drive(path.start, path.length, path.curvature)
    last = places(path, [0.0, path.whole_length])
    assert cases.missed(np.array([last.x[1], last.y[1], last.yaw[1]]), end) < 1e-12
    assert [last.x[0], last.y[0], last.yaw[0]] == [0.3, -0.2, 0.7]
    bent = Path.of((0.3, -0.2, 0.7), [3.0, -2.0], [0.4, -1.0], [1.5, 2.0])
    at = places(bent, [0.0, 3.0, bent.whole_length])
    assert at.curvature[1] == pytest.approx(0.4 + 1.5 * 3.0)
    assert at.gear.tolist() == [1.0, 1.0, -1.0]
    assert max(end_errors(bent, (at.x[2], at.y[2], at.yaw[2]))) < 1e-6
