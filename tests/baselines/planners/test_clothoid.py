"""Clothoids: driven to their goal, closed forms, symmetries, pyclothoids as a second method."""

import math

import numpy as np
import pytest

from baselines.planners.curves import Path, clothoid, end_errors, places
from tests.baselines.planners.pairs import HALF, drive, missed, published_targets, random_pairs

ORIGIN = (0.0, 0.0, 0.0)


def apart(count, seed):
    """Pairs of poses at different places."""
    start, goal = random_pairs(count, seed)
    return start[count // 8 :], goal[count // 8 :]


def test_every_clothoid_drives_to_its_goal():
    start, goal = apart(3000, seed=0)
    made = clothoid(start, goal)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    way = 0.5 * made.length[:, None] * (nodes + 1.0)
    yaw = start[:, 2:] + (made.curvature[:, None] + 0.5 * made.sharpness[:, None] * way) * way
    half = 0.5 * made.length
    x = start[:, 0] + half * (np.cos(yaw) @ weights)
    y = start[:, 1] + half * (np.sin(yaw) @ weights)
    away = np.hypot(x - goal[:, 0], y - goal[:, 1])
    assert np.all(away < 1e-11 * (1.0 + made.length))
    turned = start[:, 2] + made.turning - goal[:, 2]
    assert np.max(np.abs(np.sin(turned))) < 1e-10
    assert np.all(made.length > 0.0)


@pytest.mark.parametrize(
    ("goal", "curvature", "length"),
    [
        ((3, 0, 0), 0.0, 3.0),  # a line
        ((1, 1, HALF), 1.0, HALF),  # arcs
        ((0, 2, -math.pi), 1.0, math.pi),
        ((1, -1, -HALF), -1.0, HALF),
    ],
)
def test_lines_and_arcs_are_clothoids(goal, curvature, length):
    made = clothoid(ORIGIN, goal)
    assert made.curvature[0] == pytest.approx(curvature, abs=1e-12)
    assert made.sharpness[0] == pytest.approx(0.0, abs=1e-12)
    assert made.length[0] == pytest.approx(length, abs=1e-12)


def test_a_clothoid_is_as_long_from_the_goal_and_mirrored():
    start, goal = apart(1000, seed=1)
    start, goal = start[500:], goal[500:]  # a goal straight behind has two clothoids
    made = clothoid(start, goal)
    turned = np.array([0.0, 0.0, math.pi])
    back = clothoid(goal + turned, start + turned)
    np.testing.assert_allclose(back.length, made.length, rtol=1e-9)
    np.testing.assert_allclose(back.curvature, -made.end_curvature, rtol=1e-7, atol=1e-9)
    mirror = clothoid(start * [1, -1, -1], goal * [1, -1, -1])
    np.testing.assert_allclose(mirror.curvature, -made.curvature, rtol=1e-7, atol=1e-9)


def test_published_targets_have_their_length(reference_data):
    goals, length = published_targets(reference_data, "clothoid_length")
    np.testing.assert_allclose(clothoid(ORIGIN, goals).length, length, atol=1e-9)


def test_the_clothoid_of_figure_16_takes_9_07_s():
    # F 7.2.1: 0.4 m/s, goal (2, 2.5, -0.4)
    assert clothoid(ORIGIN, (2.0, 2.5, -0.4)).length[0] / 0.4 == pytest.approx(9.068, abs=5e-4)


def test_clothoids_agree_with_pyclothoids():
    library = pytest.importorskip("pyclothoids", reason="pyclothoids is not installed (extra dev)")
    start, goal = apart(1200, seed=2)
    straight = np.array([[x, 0.0, yaw] for x in (-2.0, 1.0) for yaw in (0.0, HALF, math.pi)])
    start, goal = (
        np.concatenate([start[400:], 0.0 * straight]),
        np.concatenate([goal[400:], straight]),
    )
    made = clothoid(start, goal)
    for i, (first, last) in enumerate(zip(start, goal, strict=True)):
        theirs = library.Clothoid.G1Hermite(*first, *last)
        assert made.length[i] == pytest.approx(theirs.length, rel=1e-8)
        assert made.curvature[i] == pytest.approx(theirs.KappaStart, rel=1e-6, abs=1e-8)
        assert made.sharpness[i] == pytest.approx(theirs.dk, rel=1e-6, abs=1e-8)


def test_a_clothoid_to_the_same_place_is_refused():
    with pytest.raises(ValueError, match="0 m apart"):
        clothoid(ORIGIN, (0.0, 0.0, 1.0))


def test_places_of_a_path_are_those_of_its_arcs_and_its_integral():
    path = Path.of((0.3, -0.2, 0.7), [0.8, -1.1, 0.0, 0.5], [0.9, -0.4, 3.0, 1e-3])
    end = drive(path.start, path.length, path.curvature)
    last = places(path, [0.0, path.whole_length])
    assert missed(np.array([last.x[1], last.y[1], last.yaw[1]]), end) < 1e-12
    assert [last.x[0], last.y[0], last.yaw[0]] == [0.3, -0.2, 0.7]
    bent = Path.of((0.3, -0.2, 0.7), [3.0, -2.0], [0.4, -1.0], [1.5, 2.0])
    at = places(bent, [0.0, 3.0, bent.whole_length])
    assert at.curvature[1] == pytest.approx(0.4 + 1.5 * 3.0)
    assert at.gear.tolist() == [1.0, 1.0, -1.0]
    assert max(end_errors(bent, (at.x[2], at.y[2], at.yaw[2]))) < 1e-6
