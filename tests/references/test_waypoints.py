"""Way-point references: the points are passed, the curvature is a spline's, the end is straight."""

import math

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from tests.references.reference_cases import DURATION, POINTS, build
from tracked_env.references import REFERENCES, make_reference, number_of_segments, sample


@pytest.mark.parametrize("gap", [1.0, 2.0, 5.0])
def test_way_points_are_passed_within_a_millimetre_at_constant_speed(gap):
    for seed in range(5):
        headings = np.cumsum(np.random.default_rng(seed).uniform(-0.7, 0.7, 12))
        points = np.cumsum(gap * np.stack([np.cos(headings), np.sin(headings)], axis=1), axis=0)
        profile = REFERENCES["waypoints"](40.0, points, 2.0)
        path = sample(profile, np.linspace(0.0, 40.0, 20001))
        assert (path.x[0], path.y[0]) == tuple(points[0])
        distance = np.hypot(path.x[:, None] - points[:, 0], path.y[:, None] - points[:, 1])
        assert distance.min(axis=0).max() < math.hypot(1e-3, 0.5 * 2.0 * 0.002)
        assert np.all(path.speed == 2.0)


def test_the_way_point_profile_has_the_curvature_of_the_quintic_spline(rng):
    points, speed = np.array(POINTS), 1.5
    chords = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    straight = [(2, np.zeros(2)), (3, np.zeros(2))]
    spline = make_interp_spline(chords, points, k=5, bc_type=(straight, straight))
    x, y = spline(np.linspace(0.0, chords[-1], 40001)).T
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    curvature = np.gradient(np.unwrap(np.arctan2(np.gradient(y), np.gradient(x))), arc)
    knots = np.arange(0.5, arc[-1] / speed, 0.5)
    path = sample(build("waypoints", rng, speed=speed), knots)
    expected = np.interp(speed * knots, arc, curvature)
    np.testing.assert_allclose(path.yaw_rate / speed, expected, atol=1e-5)
    expected = np.interp(speed * knots, arc, np.gradient(curvature, arc))
    np.testing.assert_allclose(path.yaw_acceleration / speed**2, expected, atol=1e-4)


def test_beyond_the_last_way_point_the_reference_goes_straight_on(rng):
    profile = build("waypoints", rng, points=[[1.0, 2.0], [4.0, 6.0]], speed=1.0)
    path = sample(profile, [0.0, 5.0, 20.0])
    np.testing.assert_allclose(path.x, [1.0, 4.0, 13.0], atol=1e-9)
    np.testing.assert_allclose(path.y, [2.0, 6.0, 18.0], atol=1e-9)
    path = sample(build("waypoints", rng), np.linspace(25.0, DURATION, 11))
    np.testing.assert_allclose(path.yaw_rate, 0.0, atol=1e-9)


def test_a_way_point_path_longer_than_the_episode_is_truncated(rng):
    long = make_reference({"kind": "waypoints", "points": POINTS}, 4.0, rng)
    whole = build("waypoints", rng)
    assert len(long.speed) == number_of_segments(4.0)
    np.testing.assert_allclose(long.yaw_rate, whole.yaw_rate[: len(long.speed)], atol=1e-9)


def test_changing_a_way_point_reference_does_not_change_the_next_one(rng):
    build("waypoints", rng).yaw_rate[:] = 9.0
    assert build("waypoints", rng).yaw_rate.max() < 5.0
