"""Speed along a path: trapezoids in closed form, every limit held, and as fast as it can be."""

import math

import numpy as np
import pytest

from baselines.planners.speed_along_path import Path, constant, fastest, places
from baselines.planners.trajectory import Limits
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
FREE = Limits(sprocket_speed=10.0, v_min=0.0, v_max=0.4)
BENT = Path.of((0, 0, 0), [2.0, 1.5, -1.0], [0.0, 1.2, -0.5], [0.6, -1.6, 0.8])


@pytest.mark.parametrize(
    ("length", "top", "duration"),
    [(3.0, 0.4, 3.0 / 0.4 + 0.4 / 0.5), (0.1, math.sqrt(0.5 * 0.1), 2.0 * math.sqrt(0.1 / 0.5))],
)
def test_a_line_from_rest_to_rest_is_a_trapezoid_in_time_or_a_triangle(length, top, duration):
    """v/a up, v/a down, the rest at v."""
    limits = FREE._replace(acceleration=0.5)
    profile = fastest(Path.of((0, 0, 0), [length], [0.0]), limits, FOCCHI)
    assert profile.time[-1] == pytest.approx(duration, rel=1e-3)
    assert profile.speed[0] == profile.speed[-1] == 0.0
    assert profile.speed.max() == pytest.approx(top, rel=1e-6)
    assert np.abs(profile.acceleration).max() <= 0.5 * (1.0 + 1e-9)


def test_a_constant_sharpness_is_left_at_the_acceleration_of_the_outer_sprocket():
    # k = k' s at low speed: only u (1 + k B / 2) + x k' B / 2 <= r omega'_max binds
    limits = FREE._replace(sprocket_acceleration=2.0)
    path = Path.of((0, 0, 0), [0.5], [0.0], [1.0])
    profile = fastest(path, limits, FOCCHI)
    at = places(path, profile.distance)
    inner, outer = belts(profile, at)
    ahead = slice(1, 10)
    np.testing.assert_allclose(outer[ahead], 2.0 * FOCCHI.sprocket_radius, rtol=1e-9)
    assert np.all(np.abs(inner[ahead]) < 2.0 * FOCCHI.sprocket_radius)


def belts(profile, at):
    """Accelerations [m/s^2] of the inner and outer belt at the left of each interval."""
    half, x = 0.5 * FOCCHI.track_gauge, profile.speed[:-1] ** 2
    u, k = profile.acceleration, at.gear[:-1] * at.curvature[:-1]
    turn = x * at.sharpness[:-1] * half
    return u * (1.0 - k * half) - turn, u * (1.0 + k * half) + turn


def test_every_limit_is_held_along_a_path_with_a_change_of_gear():
    limits = Limits(10.0, 0.1, sprocket_acceleration=6.0, v_min=0.0, v_max=0.5)
    limits = limits._replace(acceleration=0.4, lateral_acceleration=0.2)
    profile = fastest(BENT, limits, FOCCHI, first=0.2)
    at = places(BENT, profile.distance)
    bent = np.abs(at.curvature)
    assert profile.reached
    assert profile.speed[0] == pytest.approx(0.2)
    assert np.all(profile.speed <= 0.5 + 1e-12)
    belt = profile.speed * (1.0 + 0.5 * FOCCHI.track_gauge * bent)
    assert np.all(belt <= 9.0 * FOCCHI.sprocket_radius * (1.0 + 1e-9))
    assert np.all(profile.speed**2 * bent <= 0.2 * (1.0 + 1e-9))
    assert np.abs(profile.acceleration).max() <= 0.4 * (1.0 + 1e-9)
    for side in belts(profile, at):
        assert np.abs(side).max() <= 6.0 * FOCCHI.sprocket_radius * 1.02  # k changes in an interval
    assert profile.speed[np.argmin(np.abs(profile.distance - 3.5))] == pytest.approx(0.0, abs=1e-9)
    gained = np.diff(profile.speed**2) / (2.0 * np.diff(profile.distance))
    np.testing.assert_allclose(gained, profile.acceleration, atol=1e-6)
    # something binds everywhere: no other profile within the limits is faster
    rates = [6.0 * FOCCHI.sprocket_radius - np.abs(side) for side in belts(profile, at)]
    rates += [0.5 - profile.speed[:-1], 9.0 * FOCCHI.sprocket_radius - belt[:-1]]
    rates += [0.2 - profile.speed[:-1] ** 2 * bent[:-1], 0.4 - np.abs(profile.acceleration)]
    assert np.quantile(np.minimum.reduce(rates), 0.95) < 2e-2


def test_a_start_that_is_too_fast_is_reported():
    limits = FREE._replace(acceleration=0.1)
    assert not fastest(Path.of((0, 0, 0), [0.2], [0.0]), limits, FOCCHI, first=0.4).reached
    assert fastest(Path.of((0, 0, 0), [0.8], [0.0]), limits, FOCCHI, first=0.39).reached


def test_without_limits_of_acceleration_the_speed_is_the_bound_and_no_length_takes_no_time():
    profile = fastest(Path.of((0, 0, 0), [2.0], [0.0]), FREE, FOCCHI)
    assert profile.time[-1] == pytest.approx(2.0 / 0.4, rel=2e-2)
    assert np.all(profile.speed[1:-1] == pytest.approx(0.4))
    standing = Path.of((1, 2, 3), [0.0], [0.0])
    assert fastest(standing, FREE, FOCCHI).time[-1] == 0.0
    assert constant(standing, 0.4).time[-1] == 0.0
