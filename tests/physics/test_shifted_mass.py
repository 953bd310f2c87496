"""A centre of mass that is not where it nominally is: moments about another point, payloads."""

import numpy as np
import pytest

from tests.physics.test_ground_contact import (
    COLUMNS,
    FIELD,
    FOOTING,
    HALF_GAUGE,
    HEIGHT,
    ROWS,
    SHIFTS,
    WIDTH,
    contact,
    full,
    normals,
    shifted,
)
from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics.rigid_body import (
    Drag,
    Inertia,
    Twist,
    Wrench,
    at_point,
    matrix_of,
    quaternion_of,
    with_payload,
)
from tracked_env.terrain.ground import fill

VEHICLE = Inertia(62.0, 2.18, 2.81, 4.5)


def about(wrench, arm):
    """Force and moment (6,) about a point at `arm` from the one they are about."""
    force, moment = np.array(wrench[:3]), np.array(wrench[3:])
    return np.concatenate([force, moment - np.cross(arm, force)])


def carried(arm):
    """Matrix (6, 6) from the twist of a point to that of the one at `arm` from it."""
    matrix = np.eye(6)
    matrix[:3, 3:] = np.cross(np.eye(3), arm).T
    return matrix


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("seed", range(5))
def test_the_same_tracks_have_the_same_forces_and_their_moments_are_about_the_shifted_point(
    seed, shift
):
    w, *_ = contact(seed, stiffening=0.0)
    other, *_ = contact(seed, shift=shift, stiffening=0.0)
    for row in (g.SINKAGE, g.TIME, g.LOAD, g.SHEARED, g.FORWARD, g.THRUST, g.LATERAL, g.ROLLED):
        assert other[row] == pytest.approx(w[row], rel=1e-9, abs=1e-11 * np.abs(w[row]).max())
    wrench = g.total_wrench(w, 80, HEIGHT, 1.0)
    result = g.total_wrench(other, 80, HEIGHT + shift[2], 1.0)
    assert np.array(result) == pytest.approx(about(wrench, shift), rel=1e-10, abs=1e-9)
    damping = FOOTING.patch_area * FOOTING.damping
    here = full(g.total_drag(w, 80, HEIGHT, damping))
    there = full(g.total_drag(other, 80, HEIGHT + shift[2], damping))
    back = carried(-np.array(shift))
    assert there == pytest.approx(back.T @ here @ back, rel=1e-9, abs=1e-10 * here.max())


@pytest.mark.parametrize("seed", range(5))
def test_stiffer_ground_has_the_same_load_at_less_sinkage_and_damps_in_proportion(seed):
    w, _, twist, _ = contact(seed, stiffening=0.0)
    load = w[g.LOAD].copy()
    w[g.FIRMNESS, ::2] = 0.25
    g.press(w, 80, twist, FOOTING._replace(stiffening=0.0))
    assert w[g.LOAD, ::2] == pytest.approx(0.25 * load[::2], rel=1e-12)
    np.testing.assert_array_equal(w[g.LOAD, 1::2], load[1::2])
    w[[g.K_TT, g.K_TQ, g.K_QQ, g.K_ROLL]] = 0.0
    drag = full(g.total_drag(w, 80, HEIGHT, 1.0))
    n, loaded = normals(w), w[g.LOAD] > 0.0
    weights = np.where(loaded, w[g.FIRMNESS], 0.0)
    assert drag[:3, :3] == pytest.approx(np.einsum("k,ki,kj->ij", weights, n, n), abs=1e-11)


def uniform_contact(shift):
    """(wrench, drag, tilt) of load and tilt alone, about a centre of mass `shift` away."""
    footing = shifted(shift)
    w = np.zeros((g.SCRATCH_ROWS, g.LANES))
    lanes = g.place_patches(w, COLUMNS, ROWS, HALF_GAUGE, WIDTH, footing)
    r = matrix_of(quaternion_of(0.4, -0.15, 0.1))
    axes = np.array(r).reshape(3, 3)
    height = float(FIELD.at(0.3, 0.2)[0])
    place = np.array([0.3, 0.2, height]) + axes @ (np.array([0.0, 0.0, HEIGHT - 0.003]) + shift)
    g.locate_foot(w, g.WIDE, place, r, footing)
    fill(FIELD.relief, w, g.WIDE)
    g.orient(w, g.WIDE, r)
    g.share_plane(w, lanes)
    rocking = g.rocking_of(footing, HALF_GAUGE, WIDTH, 80)
    twist = at_point(Twist(0.3, -0.1, -0.02, 0.05, -0.08, 0.4), *shift)
    tilt = g.tilt_of(w, twist, footing, rocking)
    nothing = Wrench(*[0.0] * 6), Drag(*[0.0] * 21)
    return (*g.with_tilt(w, tilt, footing, rocking, *nothing), tilt)


@pytest.mark.parametrize("shift", SHIFTS)
def test_the_foot_of_the_uniform_load_stays_in_the_middle_of_the_tracks(shift):
    wrench, drag, tilt = uniform_contact((0.0, 0.0, 0.0))
    result, its_drag, same = uniform_contact(shift)
    assert tilt.load > 0.0
    assert np.array(same) == pytest.approx(np.array(tilt), rel=1e-9)
    assert np.array(result) == pytest.approx(about(wrench, shift), rel=1e-9, abs=1e-9)
    back = carried(-np.array(shift))
    expected = back.T @ full(drag) @ back
    assert full(its_drag) == pytest.approx(expected, rel=1e-9, abs=1e-10 * expected.max())


@pytest.mark.parametrize("seed", range(5))
def test_a_payload_adds_mass_and_inertia_as_a_sum_over_its_grains_does(seed):
    rng = np.random.default_rng(seed)
    place, size, mass = rng.uniform(-0.4, 0.4, 3), rng.uniform(0.1, 0.5, 3), rng.uniform(5.0, 40.0)
    loaded, shift = with_payload(VEHICLE, mass, tuple(place), tuple(size))
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
    point, _ = with_payload(VEHICLE, mass, (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
    assert point.yaw == VEHICLE.yaw and point.roll > VEHICLE.roll
    assert with_payload(VEHICLE, 0.0, tuple(place), tuple(size)) == (VEHICLE, (0.0, 0.0, 0.0))


def test_a_point_of_a_turning_body_moves_about_the_others():
    v, w, arm = np.array([0.3, -0.2, 0.1]), np.array([0.5, -0.7, 1.1]), np.array([0.2, 0.3, -0.1])
    there = at_point(Twist(*v, *w), *arm)
    assert np.array(there[:3]) == pytest.approx(v + np.cross(w, arm))
    assert there[3:] == tuple(w)
    back = at_point(there, *-arm)
    assert np.array(back[:3]) == pytest.approx(v)
