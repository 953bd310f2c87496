"""Dubins paths: closed forms, degenerate poses, symmetries, and a search as a second method."""

import math

import numpy as np
import pytest

from baselines.planners.curves import WORDS, dubins
from tests.baselines.planners.pairs import HALF, drive, missed, published_targets, random_pairs

PI = math.pi
ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("goal", "radius", "length"),
    [
        ((0, 0, 0), 0.5, 0.0),  # one pose
        ((0, 0, 4 * PI), 0.5, 0.0),  # and whole turns of it
        ((0, 0, -1e-16), 0.5, 0.0),  # rounding is not a circle
        ((3, 0, 0), 0.5, 3.0),  # straight ahead
        ((3, 1e-12, 1e-12), 0.5, 3.0),
        ((3, -1e-12, -1e-12), 0.5, 3.0),
        ((0, 2, PI), 1.0, PI),  # half circle
        ((0, -2, -PI), 1.0, PI),
        ((1, 1, HALF), 1.0, HALF),  # quarter circle
        ((2, 2, 0), 1.0, PI),  # two quarters: the inner circles touch
        ((2, -2, 0), 1.0, PI),
        ((-2, 0, PI), 0.5, None),
        ((1000, 0, 0), 0.1, 1000.0),
        ((0, 0, PI), 1.0, 7 * PI / 3),  # turning round on the spot: three arcs
        ((-1e-12, 0, 0), 1.0, 0.0),
    ],
)
def test_degenerate_poses_have_the_length_of_their_closed_form(goal, radius, length):
    path = dubins(ORIGIN, goal, radius)
    end = drive(ORIGIN, path.segments[0], path.curvature[0])
    assert missed(end, goal) < 1e-9 * (1.0 + path.length[0])
    if length is not None:
        assert path.length[0] == pytest.approx(length, abs=1e-9)


def test_every_path_drives_to_its_goal():
    start, goal = random_pairs(4000)
    radius = np.random.default_rng(1).uniform(0.1, 2.0, 4000)
    path = dubins(start, goal, radius)
    for i in range(4000):
        end = drive(start[i], path.segments[i], path.curvature[i])
        assert missed(end, goal[i]) < 1e-12 * (1.0 + path.length[i])
        assert end[2] - start[i, 2] == pytest.approx(path.turning[i], abs=1e-12)
    assert set(path.word) == set(range(len(WORDS)))


def test_rounding_adds_no_circle_to_a_straight_line():
    start = np.random.default_rng(6).uniform(-4, 4, (2000, 3))
    ahead = np.random.default_rng(7).uniform(0.1, 4, 2000)
    line = np.stack([np.cos(start[:, 2]), np.sin(start[:, 2]), np.zeros(2000)], axis=1)
    path = dubins(start, start + ahead[:, None] * line, 0.4)
    np.testing.assert_allclose(path.length, ahead, rtol=1e-9)


def scanned(goal, radius):
    """Length of the shortest path from the origin by a scan of the first arc and bisection."""
    best = math.inf
    for first in (1, -1):
        for last in (1, -1):
            centre = np.array(goal[:2]) + last * radius * np.array(
                [-math.sin(goal[2]), math.cos(goal[2])]
            )

            def ended(t, first=first):
                return drive(ORIGIN, [t * radius], [first / radius])

            def off_line(t, last=last, centre=centre, ended=ended):
                x, y, yaw = ended(t)
                aside = (centre[1] - y) * math.cos(yaw) - (centre[0] - x) * math.sin(yaw)
                return aside - last * radius

            def off_circle(t, first=first, centre=centre, ended=ended):
                x, y, yaw = ended(t)
                middle = np.array(
                    [x + first * radius * math.sin(yaw), y - first * radius * math.cos(yaw)]
                )
                return math.hypot(*(centre - middle)) - 2.0 * radius

            for function, straight in ((off_line, True), (off_circle, False)):
                if not straight and first != last:
                    continue
                for t in roots(function):
                    x, y, yaw = ended(t)
                    if straight:
                        ahead = (centre[0] - x) * math.cos(yaw) + (centre[1] - y) * math.sin(yaw)
                        if ahead < -1e-9:
                            continue
                        turn = last * (goal[2] - yaw) % (2 * PI)
                        middle, rest = ahead, 0.0 if turn > 2 * PI - 1e-6 else turn
                    else:
                        own = np.array(
                            [x + first * radius * math.sin(yaw), y - first * radius * math.cos(yaw)]
                        )
                        touch = math.atan2(*(centre - own)[::-1])
                        begin = math.atan2(y - own[1], x - own[0])
                        arc = -first * (touch - begin) % (2 * PI)
                        middle = arc * radius
                        rest = first * (goal[2] - (yaw - first * arc)) % (2 * PI)
                    best = min(best, radius * (t + rest) + middle)
    return best


def roots(function, count=720):
    """Roots in [0, 2 pi] by sign changes and bisection."""
    grid = np.linspace(0.0, 2.0 * PI, count + 1)
    values = [function(t) for t in grid]
    for low, high, a, b in zip(grid, grid[1:], values, values[1:], strict=False):
        if a * b > 0.0:
            continue
        for _ in range(60):
            middle = 0.5 * (low + high)
            if function(low) * function(middle) <= 0.0:
                high = middle
            else:
                low = middle
        yield 0.5 * (low + high)


def test_no_path_of_a_scan_is_shorter():
    rng = np.random.default_rng(2)
    for _ in range(25):
        goal, radius = (*rng.uniform(-3, 3, 2), rng.uniform(-PI, PI)), rng.uniform(0.3, 1.5)
        assert dubins(ORIGIN, goal, radius).length[0] == pytest.approx(
            scanned(goal, radius), abs=1e-7
        )


def test_a_mirrored_pair_has_the_mirrored_path():
    start, goal = random_pairs(500, seed=3)
    path, other = dubins(start, goal, 0.4), dubins(start * [1, -1, -1], goal * [1, -1, -1], 0.4)
    np.testing.assert_allclose(other.length, path.length, atol=1e-12)
    general = slice(200, None)  # degenerate pairs have two shortest words
    np.testing.assert_allclose(other.turning[general], -path.turning[general], atol=1e-9)


def test_reversed_in_time_the_path_is_as_long():
    start, goal = random_pairs(500, seed=4)
    turned = np.array([0.0, 0.0, PI])
    np.testing.assert_allclose(
        dubins(goal + turned, start + turned, 0.4).length, dubins(start, goal, 0.4).length,
        atol=1e-9,
    )  # fmt: skip


def test_published_targets_have_their_length(reference_data):
    goals, length = published_targets(reference_data, "dubins_length")
    np.testing.assert_allclose(dubins(ORIGIN, goals, 0.106241234).length, length, atol=1e-8)


def test_the_path_of_figure_16_takes_8_13_s():
    # F 7.2.1: 0.4 m/s, 18 rad/s, goal (2, 2.5, -0.4): 8.12 s
    assert dubins(ORIGIN, (2.0, 2.5, -0.4), 0.106241234).length[0] / 0.4 == pytest.approx(
        8.129, abs=5e-4
    )


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (((0, 0, math.nan), ORIGIN, 1.0), "start yaw = nan"),
        ((ORIGIN, (math.inf, 0, 0), 1.0), "goal x = inf"),
        ((ORIGIN, ORIGIN, 0.0), "radius = 0.0"),
        ((ORIGIN, (1.0, 2.0), 1.0), "goal has shape"),
        ((np.zeros((2, 3)), np.zeros((3, 3)), 1.0), r"\[2, 3\] poses"),
    ],
)
def test_bad_poses_are_refused_in_one_line(given, message):
    with pytest.raises(ValueError, match=message) as error:
        dubins(*given)
    assert "\n" not in str(error.value)
