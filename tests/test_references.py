"""References: kernels against independent quadrature, closed forms, limits and messages."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline
from scipy.special import fresnel, j0, struve

from tracked_env.physics import reference_profile as kernels
from tracked_env.physics.jit import loop
from tracked_env.references import (
    REFERENCES,
    catalogue,
    make_reference,
    number_of_segments,
    sample,
)
from tracked_env.references.specification import MIXED

DURATION = 30.0
POINTS = [[0.0, 0.0], [8.0, 1.0], [14.0, 6.0], [15.0, 14.0], [8.0, 18.0], [1.0, 15.0]]
KINDS = sorted(REFERENCES)
SMOOTH_KINDS = [kind for kind in KINDS if kind != "chicane"]


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def build(kind, rng, **parameters):
    if kind == "waypoints":
        parameters = {"points": POINTS} | parameters
    return make_reference({"kind": kind} | parameters, DURATION, rng)


@loop
def walk(speed, yaw_rate, time, step, count):
    """Pose (x, y, cos, sin, yaw) after `count` steps from `time`, from the origin."""
    x, y, c, s, yaw = 0.0, 0.0, 1.0, 0.0, 0.0
    for n in range(count):
        x, y, c, s, rotation = kernels.advance_pose(
            speed, yaw_rate, time + n * step, step, x, y, c, s
        )
        yaw += rotation
    return x, y, c, s, yaw


def wild_profile(rng, segments=6):
    """Coefficients with jumps at every knot, 2 m/s and up to 3 rad/s."""
    decay = 2.0 ** np.arange(6)
    speed = rng.uniform(-1.0, 1.0, (segments, 6)) / decay + [2.0, 0, 0, 0, 0, 0]
    return speed, 2.0 * rng.uniform(-1.0, 1.0, (segments, 6)) / decay


def polynomial(coefficients, time):
    k = min(int(time / 0.5), len(coefficients) - 1)
    return np.polynomial.polynomial.polyval(time - 0.5 * k, coefficients[k])


def pose_by_quadrature(speed, yaw_rate, start, end):
    """Pose at `end` relative to `start` with scipy; knots are break points."""
    knots = [k * 0.5 for k in range(len(speed) + 1)]
    integrals = [np.polynomial.polynomial.polyint(row) for row in yaw_rate]
    whole = [np.polynomial.polynomial.polyval(0.5, row) for row in integrals]

    def heading(time):
        k = min(int(time / 0.5), len(speed) - 1)
        part = np.polynomial.polynomial.polyval(time - 0.5 * k, integrals[k])
        return sum(whole[:k]) + part

    def integral(function):
        cuts = [start, *(k for k in knots if start < k < end), end]
        parts = itertools.pairwise(cuts)
        return sum(quad(function, a, b, epsabs=1e-15, epsrel=1e-13)[0] for a, b in parts)

    zero = heading(start)
    x = integral(lambda t: polynomial(speed, t) * math.cos(heading(t) - zero))
    y = integral(lambda t: polynomial(speed, t) * math.sin(heading(t) - zero))
    return x, y, heading(end) - zero


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_printed_derivatives_are_those_of_speed_and_yaw_rate(kind, rng):
    profile = build(kind, rng)
    times, h = np.linspace(0.13, DURATION - 0.2, 211), 1e-4
    before, at, after = (sample(profile, times + d) for d in (-h, 0.0, h))
    for function, derivative in [
        ("speed", "acceleration"),
        ("acceleration", "jerk"),
        ("yaw_rate", "yaw_acceleration"),
        ("yaw", "yaw_rate"),
    ]:
        difference = (getattr(after, function) - getattr(before, function)) / (2.0 * h)
        np.testing.assert_allclose(getattr(at, derivative), difference, atol=2e-4)


@pytest.mark.parametrize("kind", SMOOTH_KINDS)
def test_smooth_references_have_no_jump_up_to_the_third_derivative_of_position(kind, rng):
    profile = build(kind, rng, **({"initial_speed": 0.5} if kind == "straight" else {}))
    knots = 0.5 * np.arange(1, len(profile.speed) - 1)  # the spiral ends at the last one
    before, after = sample(profile, knots - 1e-9), sample(profile, knots)
    for field in ("speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration"):
        np.testing.assert_allclose(getattr(before, field), getattr(after, field), atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_the_path_is_the_integral_of_speed_along_the_heading(kind, rng):
    profile = build(kind, rng)
    times = np.linspace(0.0, DURATION, 60001)
    path = sample(profile, times)
    for position, rate in [
        (path.x, path.speed * np.cos(path.yaw)),
        (path.y, path.speed * np.sin(path.yaw)),
    ]:
        trapezoids = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(times))
        np.testing.assert_allclose(position[1:] - position[0], trapezoids, atol=2e-3)


@pytest.mark.parametrize("step", [0.002, 0.02, 1.0 / 30.0, 0.1, 0.2])
def test_one_step_of_the_pose_agrees_with_adaptive_quadrature(step, rng):
    for _ in range(5):
        speed, yaw_rate = wild_profile(rng)
        for start in (0.0, 0.11, 0.5 - 0.4 * step, 1.5 - 0.9 * step, 2.0):
            x, y, c, s, rotation = walk(speed, yaw_rate, start, step, 1)
            expected = pose_by_quadrature(speed, yaw_rate, start, start + step)
            np.testing.assert_allclose([x, y, rotation], expected, rtol=0.0, atol=1e-13)
            np.testing.assert_allclose([c, s], [math.cos(rotation), math.sin(rotation)], atol=1e-15)


def test_steps_that_cross_knots_lead_where_steps_that_end_at_knots_lead(rng):
    speed, yaw_rate = wild_profile(rng)
    straddling = walk(speed, yaw_rate, 0.0, 0.2, 14)
    splitting = walk(speed, yaw_rate, 0.0, 0.02, 140)
    one = walk(speed, yaw_rate, 0.0, 2.8, 1)
    np.testing.assert_allclose(straddling, splitting, atol=1e-12)
    np.testing.assert_allclose(one, splitting, atol=1e-12)


def test_after_the_last_segment_speed_and_yaw_rate_stay_and_derivatives_vanish(rng):
    speed, yaw_rate = wild_profile(rng)
    end = 0.5 * len(speed)
    last_v, last_w = (np.polynomial.polynomial.polyval(0.5, c[-1]) for c in (speed, yaw_rate))
    for time in (end, end + 0.3, end + 1e6, math.inf):
        rates = kernels.evaluate(speed, yaw_rate, time)
        np.testing.assert_allclose(rates, [last_v, 0.0, 0.0, last_w, 0.0], atol=1e-15)
        ahead = kernels.speed_and_yaw_rate(speed, yaw_rate, time)
        np.testing.assert_allclose(ahead, [last_v, last_w], atol=1e-15)
    x, y, *_, yaw = walk(speed, yaw_rate, end, 0.2, 1)
    radius = last_v / last_w
    arc = [radius * math.sin(0.2 * last_w), radius * (1 - math.cos(0.2 * last_w)), 0.2 * last_w]
    np.testing.assert_allclose([x, y, yaw], arc, atol=1e-13)


def test_before_the_start_the_start_values_hold(rng):
    speed, yaw_rate = wild_profile(rng)
    at_start = kernels.evaluate(speed, yaw_rate, 0.0)
    assert at_start.speed == speed[0, 0] and at_start.yaw_rate == yaw_rate[0, 0]
    assert kernels.evaluate(speed, yaw_rate, -0.4) == at_start
    assert kernels.speed_and_yaw_rate(speed, yaw_rate, -0.4) == (speed[0, 0], yaw_rate[0, 0])


def test_look_ahead_and_evaluation_agree_at_all_times(rng):
    speed, yaw_rate = wild_profile(rng)
    for time in np.linspace(0.0, 4.0, 41):
        rates = kernels.evaluate(speed, yaw_rate, time)
        ahead = kernels.speed_and_yaw_rate(speed, yaw_rate, time)
        np.testing.assert_allclose(ahead, (rates.speed, rates.yaw_rate), rtol=1e-15)


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


def test_the_start_pose_moves_and_turns_the_path_as_a_whole(rng):
    times = np.linspace(0.0, DURATION, 31)
    plain = sample(build("spiral", rng), times)
    moved = sample(build("spiral", rng, x=3.0, y=-2.0, yaw=0.7), times)
    turn = np.exp(0.7j) * (plain.x + 1j * plain.y) + 3.0 - 2.0j
    np.testing.assert_allclose(moved.x + 1j * moved.y, turn, atol=1e-12)
    np.testing.assert_allclose(moved.yaw, plain.yaw + 0.7, atol=1e-14)


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


@pytest.mark.parametrize("duration", [0.5, 7.3, 20.0, 20.2])
def test_the_number_of_segments_depends_on_the_duration_alone(duration, rng):
    for kind in KINDS:
        spec = {"kind": kind, "points": POINTS} if kind == "waypoints" else kind
        profile = make_reference(spec, duration, rng)
        shape = (math.ceil(duration / 0.5) + 1, 6)
        assert profile.speed.shape == profile.yaw_rate.shape == shape
        for array in (profile.speed, profile.yaw_rate):
            assert array.dtype == np.float64 and array.flags.c_contiguous and array.flags.writeable


def test_the_same_generator_gives_the_same_reference_and_another_one_another():
    for kind in ("random", "mixed"):
        one, same, other = (
            make_reference(kind, DURATION, np.random.default_rng(seed)) for seed in (1, 1, 2)
        )
        assert np.array_equal(one.speed, same.speed)
        assert np.array_equal(one.yaw_rate, same.yaw_rate)
        assert not np.array_equal(one.yaw_rate, other.yaw_rate)


def test_a_pair_is_drawn_uniformly_whatever_the_order_of_the_keys():
    spec = {"kind": "circle", "radius": [5.0, 15.0], "speed": [1.0, 2.0], "direction": [-1, 1]}
    turned = dict(reversed(spec.items()))
    speeds, radii = [], []
    for seed in range(200):
        one = make_reference(spec, 5.0, np.random.default_rng(seed))
        two = make_reference(turned, 5.0, np.random.default_rng(seed))
        assert np.array_equal(one.yaw_rate, two.yaw_rate) and np.array_equal(one.speed, two.speed)
        speeds.append(one.speed[0, 0])
        radii.append(one.speed[0, 0] / one.yaw_rate[0, 0])
    assert 1.0 <= min(speeds) < 1.05 and 1.95 < max(speeds) <= 2.0
    assert 5.0 <= min(np.abs(radii)) < 5.5 and 14.5 < max(np.abs(radii)) <= 15.0
    assert 60 < np.sum(np.array(radii) > 0.0) < 140


def test_mixed_references_keep_the_lateral_acceleration_that_their_table_promises(rng):
    for spec in MIXED:
        choices = [value if isinstance(value, list) else [value] for value in spec.values()]
        for corner in itertools.product(*choices):
            extreme = dict(zip(spec, corner, strict=True))
            path = sample(make_reference(extreme, 20.0, rng), np.linspace(0.0, 20.0, 201))
            assert np.abs(path.speed * path.yaw_rate).max() <= 1.5 + 1e-9


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("circel", ["'circel'", "must be one of straight, circle"]),
        (3, ["reference = 3", "a name or a dictionary"]),
        (
            {"kind": "circle", "raduis": 3.0},
            ["'raduis'", "speed, radius, direction", "misspelling"],
        ),
        ({"kind": "waypoints", "points": POINTS, "x": 1.0}, ["'x'", "points, speed"]),
        ({"kind": "circle", "radius": -3.0}, ["radius = -3.0 m", "[1, 10000] m", "direction"]),
        ({"kind": "circle", "speed": 7.2}, ["speed = 7.2 m/s", "[-5, 5]", "km/h"]),
        ({"kind": "circle", "speed": math.nan}, ["speed = nan m/s"]),
        ({"kind": "circle", "speed": True}, ["speed = True"]),
        ({"kind": "circle", "speed": "fast"}, ["speed = 'fast'"]),
        ({"kind": "circle", "speed": None}, ["speed = None"]),
        ({"kind": "circle", "speed": [2.0, 1.0]}, ["low <= high", "Swap"]),
        ({"kind": "circle", "speed": [1.0, 2.0, 3.0]}, ["[low, high]"]),
        ({"kind": "circle", "yaw": 180.0}, ["yaw = 180.0 rad", "degrees"]),
        ({"kind": "circle", "direction": 0.5}, ["direction = 0.5", "+1 (left), -1 (right)"]),
        ({"kind": "figure_eight", "speed": -1.0}, ["speed = -1.0 m/s", "reverse"]),
        ({"kind": "figure_eight", "speed": 5.0, "size": 5.0}, ["<= 5.0 rad/s", "lower the speed"]),
        ({"kind": "chicane", "turn_time": 2.2}, ["turn_time = 2.2 s", "multiple of 0.5 s"]),
        ({"kind": "chicane", "switch_time": 1.0}, ["switch_time = 1.0 s", "turn_time = 2.0 s"]),
        ({"kind": "random", "speed_range": [3.0, 1.0]}, ["speed_range", "low <= high"]),
        ({"kind": "waypoints"}, ["points missing"]),
        ({"kind": "waypoints", "points": [[0.0, 0.0]]}, ["(1, 2)", "2 <= M"]),
        ({"kind": "waypoints", "points": [[0, 1, 2], [0, 1, 2]]}, ["(2, 3)", "(2, M)"]),
        ({"kind": "waypoints", "points": [[0, 0], [math.nan, 1]]}, ["NaN"]),
        ({"kind": "waypoints", "points": [[0, 0], [0, 0], [1, 1]]}, ["0 and 1", "repeated"]),
        (
            {"kind": "waypoints", "points": [[0, 0], [1, 0], [1, 1], [0, 1], [0, 2]], "speed": 3.0},
            ["misses way-point", "lower the speed"],
        ),
    ],
)
def test_a_bad_specification_is_refused_with_quantity_value_range_and_cause(spec, words, rng):
    with pytest.raises(ValueError) as error:
        make_reference(spec, DURATION, rng)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf, 1e5])
def test_a_bad_duration_is_refused(duration, rng):
    with pytest.raises(ValueError, match=r"duration = .* s; must be a number within"):
        make_reference("circle", duration, rng)


@pytest.mark.parametrize("times", [[1.0, 0.0], [-0.1, 0.0], [0.0, math.nan], [[0.0]]])
def test_sampling_refuses_times_that_are_not_sorted_and_finite(times, rng):
    with pytest.raises(ValueError, match="times"):
        sample(build("circle", rng), times)
