"""A rigid body: attitude, momentum, the linear solve, payloads, inclines against their matrix."""

import math

import numpy as np
import pytest

from tracked_env.physics import rigid_body as rigid
from tracked_env.physics.rigid_body import LEVEL, Drag, Inertia, Quaternion, Twist, Wrench

VEHICLE = Inertia(62.0, 2.18, 2.81, 4.5)
ATTITUDES = [(0.2, 0.1), (-0.3, 0.25), (0.1, -0.6), (0.0, 0.3), (-0.4, 0.0)]  # pitch, roll [rad]


def axes(pitch, roll, yaw=0.0):
    """Rotation matrix; its columns are the body's axes."""
    return np.array(rigid.matrix_of(rigid.quaternion_of(yaw, pitch, roll))).reshape(3, 3)


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_gravity_in_body_axes_is_the_vertical_turned_into_them(pitch, roll):
    incline = rigid.incline_of(pitch, roll)
    down = axes(pitch, roll, yaw=0.8).T @ [0.0, 0.0, -1.0]
    gravity = (incline.down_x, incline.down_y, -incline.press)
    assert gravity == pytest.approx(tuple(down), abs=1e-15)
    assert (incline.down_x > 0.0) == (pitch > 0.0)  # nose down: it pulls forward
    assert (incline.down_y < 0.0) == (roll > 0.0)  # left side up: it pulls to the right


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_a_motion_in_the_vehicles_plane_seen_on_the_map_and_back(pitch, roll):
    incline, forward, left = rigid.incline_of(pitch, roll), 0.7, -0.3
    on_the_map = rigid.on_map(forward, left, incline)
    assert on_the_map == pytest.approx(
        tuple((axes(pitch, roll) @ [forward, left, 0.0])[:2]), abs=1e-15
    )
    assert rigid.in_plane_above(*on_the_map, incline) == pytest.approx((forward, left), abs=1e-15)


@pytest.mark.parametrize("pitch, roll", ATTITUDES)
def test_the_heading_turns_as_body_rates_say(pitch, roll):
    yaw_rate, pitch_rate, h = 0.5, -0.4, 1e-6
    a, b = rigid.heading_rate(rigid.incline_of(pitch, roll), pitch_rate)
    start = rigid.quaternion_of(0.3, pitch, roll)
    after = (rigid.turned(start, 0.0, pitch_rate * t, yaw_rate * t) for t in (-h, h))
    ends = [rigid.angles_of(q, 0.3) for q in after]
    assert a * yaw_rate + b == pytest.approx((ends[1][0] - ends[0][0]) / (2.0 * h), rel=1e-8)


def test_level_ground_and_a_missing_attitude_change_no_bit():
    for angles in ((0.0, 0.0), (math.nan, 0.1), (0.1, math.nan), (math.inf, 0.0)):
        assert tuple(rigid.incline_of(*angles)) == tuple(LEVEL)
    for values in np.random.default_rng(0).normal(size=(20, 2)):
        assert rigid.on_map(*values, LEVEL) == tuple(values) == rigid.in_plane_above(*values, LEVEL)
    assert rigid.heading_rate(LEVEL, 0.7) == (1.0, 0.0)
    assert rigid.heading_rate(rigid.incline_of(0.1, 0.2), math.nan)[1] == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_a_torque_free_body_keeps_its_angular_momentum_in_the_world(seed):
    rng = np.random.default_rng(seed)
    inertia, spin = VEHICLE, rng.uniform(-2.0, 2.0, 3)
    velocity = rng.uniform(-2.0, 2.0, 3)
    zero = Wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    turning = rigid.with_inertia(zero, Twist(*velocity, *spin), inertia)
    assert np.array(turning[:3]) == pytest.approx(-62.0 * np.cross(spin, velocity))
    momentum = np.array(inertia[1:]) * spin
    assert np.array(turning[3:]) == pytest.approx(-np.cross(spin, momentum))


def test_the_solve_is_that_of_the_dense_matrix():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6))
    matrix = root @ root.T
    inertia, d = VEHICLE, 0.37
    drag = Drag(*matrix[np.tril_indices(6)])
    b = rng.normal(size=6)
    whole = np.diag([62.0, 62.0, 62.0, 2.18, 2.81, 4.5]) + d * matrix
    result = rigid.solved(rigid.factors(drag, inertia, d), Wrench(*b))
    assert np.array(result) == pytest.approx(np.linalg.solve(whole, b), rel=1e-12)


@pytest.mark.parametrize("pitch", [0.3, -1.2, 0.5 * math.pi, -0.5 * math.pi])
def test_angles_and_quaternion_are_one_attitude_upright_and_on_its_nose(pitch):
    q = rigid.quaternion_of(4.0, pitch, -2.5)
    again = rigid.quaternion_of(*rigid.angles_of(q, 3.9))
    assert abs(np.dot(q, again)) == pytest.approx(1.0, abs=1e-14)
    if abs(pitch) < 1.5:
        assert rigid.angles_of(q, 3.9) == pytest.approx((4.0, pitch, -2.5), abs=1e-14)
    assert abs(rigid.angles_of(q, 3.9 + 8 * math.pi)[0] - (4.0 + 8 * math.pi)) < 4.0


def test_a_body_turns_about_its_own_axes_by_the_angle_of_the_vector():
    q = rigid.quaternion_of(0.4, 0.2, -0.3)
    after = rigid.turned(q, 0.0, 0.0, 1e-5)
    for _ in range(9):
        after = rigid.turned(after, 0.0, 0.0, 1e-5)
    once = rigid.turned(q, 0.0, 0.0, 1e-4)
    assert np.array(after) == pytest.approx(np.array(once), abs=1e-15)
    about = np.array(rigid.matrix_of(q)).reshape(3, 3)[:, 2]
    half = 0.5 * 0.9
    expected = Quaternion(math.cos(half), *(math.sin(half) * about))
    assert abs(np.dot(times(expected, q), rigid.turned(q, 0.0, 0.0, 0.9))) == pytest.approx(1.0)


def times(a, b):
    """Product of quaternions."""
    w = a[0] * b[0] - np.dot(a[1:], b[1:])
    v = a[0] * np.array(b[1:]) + b[0] * np.array(a[1:]) + np.cross(a[1:], b[1:])
    return np.array([w, *v])


@pytest.mark.parametrize("seed", range(5))
def test_a_payload_adds_mass_and_inertia_as_a_sum_over_its_grains_does(seed):
    rng = np.random.default_rng(seed)
    place, size, mass = rng.uniform(-0.4, 0.4, 3), rng.uniform(0.1, 0.5, 3), rng.uniform(5.0, 40.0)
    loaded, shift = rigid.with_payload(VEHICLE, mass, tuple(place), tuple(size))
    count = 40
    edges = [(np.arange(count) + 0.5) / count - 0.5] * 3
    grains = np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3) * size + place
    middle = mass * place / (62.0 + mass)
    assert np.array(shift) == pytest.approx(middle)
    assert loaded.mass == pytest.approx(62.0 + mass)
    for k, inertia in enumerate(VEHICLE[1:]):
        others = [axis for axis in range(3) if axis != k]
        of_box = mass * ((grains - middle)[:, others] ** 2).sum(axis=1).mean()
        of_vehicle = inertia + 62.0 * (middle[others] ** 2).sum()
        assert loaded[1 + k] == pytest.approx(of_box + of_vehicle, rel=1e-3)
    point, _ = rigid.with_payload(VEHICLE, mass, (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
    assert point.yaw == VEHICLE.yaw and point.roll > VEHICLE.roll
    assert rigid.with_payload(VEHICLE, 0.0, tuple(place), tuple(size)) == (VEHICLE, (0.0, 0.0, 0.0))


def test_a_point_of_a_turning_body_moves_about_the_others():
    v, w, arm = np.array([0.3, -0.2, 0.1]), np.array([0.5, -0.7, 1.1]), np.array([0.2, 0.3, -0.1])
    there = rigid.at_point(Twist(*v, *w), *arm)
    assert np.array(there[:3]) == pytest.approx(v + np.cross(w, arm))
    assert there[3:] == tuple(w)
    back = rigid.at_point(there, *-arm)
    assert np.array(back[:3]) == pytest.approx(v)
