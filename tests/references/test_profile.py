"""Profiles and their kernels against independent quadrature, differences and limits."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from tests.references.reference_cases import DURATION, KINDS, SMOOTH_KINDS, build
from tracked_env.physics import reference_profile as kernels
from tracked_env.physics.jit import loop
from tracked_env.references import sample


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
    pairs = ("speed", "acceleration"), ("acceleration", "jerk"), ("yaw", "yaw_rate")
    for function, derivative in (*pairs, ("yaw_rate", "yaw_acceleration")):
        difference = (getattr(after, function) - getattr(before, function)) / (2.0 * h)
        np.testing.assert_allclose(getattr(at, derivative), difference, atol=2e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_path_is_the_integral_of_speed_along_the_heading(kind, rng):
    profile = build(kind, rng)
    times = np.linspace(0.0, DURATION, 60001)
    path = sample(profile, times)
    for position, part in ((path.x, np.cos(path.yaw)), (path.y, np.sin(path.yaw))):
        rate = path.speed * part
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
    table = np.hstack([speed, yaw_rate])
    end = 0.5 * len(speed)
    last_v, last_w = (np.polynomial.polynomial.polyval(0.5, c[-1]) for c in (speed, yaw_rate))
    for time in (end, end + 0.3, end + 1e6, math.inf):
        rates = kernels.rates_at(table, time)
        np.testing.assert_allclose(rates, [last_v, 0.0, 0.0, last_w, 0.0], atol=1e-15)
        ahead = kernels.speeds_at(table, time)
        np.testing.assert_allclose(ahead, [last_v, last_w], atol=1e-15)
    for time in np.linspace(0.0, 4.0, 41):
        rates = kernels.rates_at(table, time)
        ahead = kernels.speeds_at(table, time)
        np.testing.assert_allclose(ahead, (rates.speed, rates.yaw_rate), rtol=1e-15)
    x, y, *_, yaw = walk(speed, yaw_rate, end, 0.2, 1)
    radius = last_v / last_w
    arc = [radius * math.sin(0.2 * last_w), radius * (1 - math.cos(0.2 * last_w)), 0.2 * last_w]
    np.testing.assert_allclose([x, y, yaw], arc, atol=1e-13)


def test_before_the_start_the_start_values_hold(rng):
    speed, yaw_rate = wild_profile(rng)
    table = np.hstack([speed, yaw_rate])
    at_start = kernels.rates_at(table, 0.0)
    assert at_start.speed == speed[0, 0] and at_start.yaw_rate == yaw_rate[0, 0]
    assert kernels.rates_at(table, -0.4) == at_start
    assert kernels.speeds_at(table, -0.4) == (speed[0, 0], yaw_rate[0, 0])


def test_the_start_pose_moves_and_turns_the_path_as_a_whole(rng):
    times = np.linspace(0.0, DURATION, 31)
    plain = sample(build("spiral", rng), times)
    moved = sample(build("spiral", rng, x=3.0, y=-2.0, yaw=0.7), times)
    turn = np.exp(0.7j) * (plain.x + 1j * plain.y) + 3.0 - 2.0j
    np.testing.assert_allclose(moved.x + 1j * moved.y, turn, atol=1e-12)
    np.testing.assert_allclose(moved.yaw, plain.yaw + 0.7, atol=1e-14)


@pytest.mark.parametrize("times", [[1.0, 0.0], [-0.1, 0.0], [0.0, math.nan], [[0.0]]])
def test_sampling_refuses_times_that_are_not_sorted_and_finite(times, rng):
    with pytest.raises(ValueError, match="times"):
        sample(build("circle", rng), times)
