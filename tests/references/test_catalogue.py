"""The catalogue of references against closed forms, symmetries and the limits they promise."""

import math

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import fresnel, j0, struve

from tests.references.reference_cases import DURATION, POINTS, SMOOTH_KINDS, build
from tracked_env.physics.reference_profile import SEGMENT_DURATION
from tracked_env.references import REFERENCES, catalogue, make_reference, number_of_segments, sample
from tracked_env.references.catalogue import random_smooth


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_smooth_references_have_no_jump_up_to_the_third_derivative_of_position(kind, rng):
    profile = build(kind, rng, **({"initial_speed": 0.5} if kind == "straight" else {}))
    knots = 0.5 * np.arange(1, len(profile.speed) - 1)  # the spiral ends at the last one
    before, after = sample(profile, knots - 1e-9), sample(profile, knots)
    for field in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        np.testing.assert_allclose(getattr(before, field), getattr(after, field), atol=1e-7)


def test_a_circle_closes_after_a_revolution_and_keeps_its_distance_to_the_centre(rng):
    profile = build("circle", rng, speed=2.0, radius=5.0)
    period = 2.0 * math.pi * 5.0 / 2.0
    path = sample(profile, np.linspace(0.0, period, 200))
    np.testing.assert_allclose([path.x[-1], path.y[-1]], [0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(np.hypot(path.x, path.y - 5.0), 5.0, atol=1e-9)
    assert path.yaw[-1] == pytest.approx(2.0 * math.pi, abs=1e-12)


def test_a_reversed_circle_keeps_its_centre_on_the_side_of_its_direction(rng):
    path = sample(build("circle", rng, speed=-2.0, radius=5.0), np.linspace(0.0, 10.0, 50))
    np.testing.assert_allclose(np.hypot(path.x, path.y - 5.0), 5.0, atol=1e-9)
    assert path.x[1] < 0.0 and path.yaw_rate[0] < 0.0


def test_the_figure_eight_closes_and_its_tips_are_its_size_apart(rng):
    speed, size = 2.0, 30.0
    assert j0(catalogue.EIGHT_AMPLITUDE) == pytest.approx(0.0, abs=1e-15)
    assert struve(0, catalogue.EIGHT_AMPLITUDE) == pytest.approx(catalogue.EIGHT_EXTENT, rel=1e-14)
    spec = {"kind": "figure_eight", "speed": speed, "size": size}
    profile = make_reference(spec, 45.0, rng)
    period = 2.0 * size / catalogue.EIGHT_EXTENT / speed
    path = sample(profile, period * np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
    np.testing.assert_allclose([path.x[[2, 4]], path.y[[2, 4]]], 0.0, atol=1e-9)
    assert path.yaw[-1] == pytest.approx(0.0, abs=1e-10)
    tips = math.hypot(path.x[3] - path.x[1], path.y[3] - path.y[1])
    assert tips == pytest.approx(size, abs=1e-8)
    assert path.yaw_rate[1] / speed == pytest.approx(5.664 / size, rel=1e-4)


def test_the_spiral_is_a_clothoid_with_the_radii_that_were_asked_for(rng):
    speed, radius_end = 2.0, 8.0
    profile = build("spiral", rng, speed=speed, radius_start=1e4, radius_end=radius_end)
    path = sample(profile, np.linspace(0.0, DURATION, 50))
    curvature = path.yaw_rate / path.speed
    line = 1e-4 + (1.0 / radius_end - 1e-4) * np.linspace(0.0, 1.0, 50)
    np.testing.assert_allclose(curvature, line, atol=1e-14)
    # Closed form: yaw = a t + b t^2, so the position is a difference of Fresnel integrals.
    a, b = speed * 1e-4, 0.5 * speed * (1.0 / radius_end - 1e-4) / DURATION
    shift, scale = a / (2.0 * b), math.sqrt(2.0 * b / math.pi)
    (s1, c1), (s0, c0) = fresnel(scale * (DURATION + shift)), fresnel(scale * shift)
    turn, factor = b * shift**2, speed / scale
    x = factor * (math.cos(turn) * (c1 - c0) + math.sin(turn) * (s1 - s0))
    y = factor * (math.cos(turn) * (s1 - s0) - math.sin(turn) * (c1 - c0))
    np.testing.assert_allclose([path.x[-1], path.y[-1]], [x, y], atol=1e-10)


@pytest.mark.parametrize("kind", ["circle", "figure_eight", "spiral", "identification"])
def test_the_other_direction_is_the_mirror_image(kind, rng):
    times = np.linspace(0.0, DURATION, 101)
    left = sample(build(kind, rng, direction=1), times)
    right = sample(build(kind, rng, direction=-1), times)
    for field in ("y", "yaw", "yaw_rate", "yaw_acceleration"):
        assert np.array_equal(getattr(left, field), -getattr(right, field))
    for field in ("x", "speed", "acceleration", "jerk"):
        assert np.array_equal(getattr(left, field), getattr(right, field))
    assert left.yaw_rate.max() > 0.0


def test_the_straight_ramp_keeps_its_acceleration_and_ends_at_its_speed(rng):
    profile = build("straight", rng, speed=3.0, initial_speed=-1.0, acceleration=0.8)
    path = sample(profile, np.linspace(0.0, DURATION, 3001))
    assert path.speed[0] == pytest.approx(-1.0, abs=1e-14) and path.speed[-1] == 3.0
    assert 0.7 < path.acceleration.max() <= 0.8 and path.acceleration.min() >= -1e-12
    assert not path.y.any() and not path.yaw.any()


def test_the_identification_manoeuvre_is_straight_for_7_s_then_its_curvature_grows(rng):
    path = sample(build("identification", rng, radius_end=6.0), np.linspace(0.0, 30.5, 306))
    curvature = path.yaw_rate / path.speed
    assert np.abs(path.yaw_rate[:70]).max() < 1e-12
    assert np.all(np.diff(curvature[72:]) > 0.0)
    assert curvature[-1] == pytest.approx(1.0 / 6.0, rel=1e-6)
    assert path.speed[0] == pytest.approx(0.5) and np.ptp(path.speed[50:]) > 0.35


def test_the_chicane_jumps_as_focchi_53_prints(rng):
    profile = build("chicane", rng, speed=0.2, yaw_rate=0.3)
    path = sample(profile, [0.0, 1.0, 2.0 - 1e-9, 2.0, 11.9, 12.0, 20.0])
    np.testing.assert_allclose(path.speed, [0.0, 0.2, 0.4, 0.2, 0.2, 0.2, 0.2], atol=1e-8)
    np.testing.assert_allclose(path.yaw_rate, [0.0, 0.0, 0.0, 0.3, 0.3, -0.3, -0.3])


def test_random_paths_stay_within_all_their_limits_and_use_them():
    limits = {"speed_range": [0.5, 4.0], "yaw_rate_limit": 0.8, "lateral_acceleration_limit": 1.2}
    extremes = []
    for seed in range(40):
        profile = build("random", np.random.default_rng(seed), **limits)
        path = sample(profile, np.linspace(0.0, DURATION + 3.0, 1001))
        lateral = np.abs(path.speed * path.yaw_rate)
        assert path.speed.min() >= 0.5 - 1e-12 and path.speed.max() <= 4.0 + 1e-12
        assert np.abs(path.yaw_rate).max() <= 0.8 + 1e-12
        assert lateral.max() <= 1.2 + 1e-12
        assert np.abs(path.acceleration).max() <= 3.5 / 2.0 + 1e-12
        assert path.acceleration[0] == pytest.approx(0.0, abs=1e-12)
        extremes.append((np.ptp(path.speed), np.abs(path.yaw_rate).max(), lateral.max()))
    assert np.all(np.mean(extremes, axis=0) > [2.5, 0.35, 0.9])


@pytest.mark.parametrize("knot_interval", [0.5, 1.0, 2.0, 6.0])
def test_random_paths_are_the_b_splines_of_their_coefficients(knot_interval):
    profile = random_smooth(30.0, np.random.default_rng(4), knot_interval=knot_interval)
    rng = np.random.default_rng(4)
    count = -(-len(profile.speed) // round(knot_interval / SEGMENT_DURATION)) + 3
    knots = knot_interval * np.arange(-3, count + 1)
    draws = [np.clip(1.5 * rng.uniform(-1.0, 1.0, count), -1.0, 1.0) for _ in range(2)]
    for values in draws:
        values[1:3] = values[0]
    v = 2.0 + draws[0]
    fastest = [np.abs(v[max(n - 3, 0) : n + 4]).max() for n in range(count)]
    w = np.clip(0.5 * draws[1], -1.5 / np.array(fastest), 1.5 / np.array(fastest))
    times = np.linspace(0.0, 30.0, 301)
    result = sample(profile, times)
    assert result.speed == pytest.approx(BSpline(knots, v, 3)(times), abs=1e-10)
    assert result.yaw_rate == pytest.approx(BSpline(knots, w, 3)(times), abs=1e-10)


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
