"""Gravity in body axes and motions of an inclined plane on the map, against the rotation matrix."""

import math

import numpy as np
import pytest

from tracked_env.physics.rigid_body import (
    LEVEL,
    angles_of,
    heading_rate,
    in_plane_above,
    incline_of,
    matrix_of,
    on_map,
    quaternion_of,
    turned,
)

ATTITUDES = [(0.2, 0.1), (-0.3, 0.25), (0.1, -0.6), (0.0, 0.3), (-0.4, 0.0)]  # pitch, roll [rad]


def axes(pitch, roll, yaw=0.0):
    """Rotation matrix; its columns are the body's axes."""
    return np.array(matrix_of(quaternion_of(yaw, pitch, roll))).reshape(3, 3)


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_gravity_in_body_axes_is_the_vertical_turned_into_them(pitch, roll):
    incline = incline_of(pitch, roll)
    down = axes(pitch, roll, yaw=0.8).T @ [0.0, 0.0, -1.0]
    gravity = (incline.down_x, incline.down_y, -incline.press)
    assert gravity == pytest.approx(tuple(down), abs=1e-15)
    assert (incline.down_x > 0.0) == (pitch > 0.0)  # nose down: it pulls forward
    assert (incline.down_y < 0.0) == (roll > 0.0)  # left side up: it pulls to the right


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_a_motion_in_the_vehicles_plane_seen_on_the_map_and_back(pitch, roll):
    incline, forward, left = incline_of(pitch, roll), 0.7, -0.3
    on_the_map = on_map(forward, left, incline)
    assert on_the_map == pytest.approx(
        tuple((axes(pitch, roll) @ [forward, left, 0.0])[:2]), abs=1e-15
    )
    assert in_plane_above(*on_the_map, incline) == pytest.approx((forward, left), abs=1e-15)


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_the_heading_turns_as_body_rates_say(pitch, roll):
    yaw_rate, pitch_rate, h = 0.5, -0.4, 1e-6
    a, b = heading_rate(incline_of(pitch, roll), pitch_rate)
    ends = [
        angles_of(turned(quaternion_of(0.3, pitch, roll), 0.0, pitch_rate * t, yaw_rate * t), 0.3)
        for t in (-h, h)
    ]
    assert a * yaw_rate + b == pytest.approx((ends[1][0] - ends[0][0]) / (2.0 * h), rel=1e-8)


def test_level_ground_and_a_missing_attitude_change_no_bit():
    for angles in ((0.0, 0.0), (math.nan, 0.1), (0.1, math.nan), (math.inf, 0.0)):
        assert tuple(incline_of(*angles)) == tuple(LEVEL)
    for values in np.random.default_rng(0).normal(size=(20, 2)):
        assert on_map(*values, LEVEL) == tuple(values) == in_plane_above(*values, LEVEL)
    assert heading_rate(LEVEL, 0.7) == (1.0, 0.0)
    assert heading_rate(incline_of(0.1, 0.2), math.nan)[1] == 0.0
