"""Shear of the soil under the patches: quadrature, closed forms, limits, mirrors, bounds."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from tests.physics import patch_cases as cases
from tests.physics.patch_cases import FOCCHI, PATCHES
from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics.lumped import Motion
from tracked_env.physics.patches_on_level_ground import HISTORY_TURN, Patches
from tracked_env.physics.terramechanics import tractive_effort

_, DRIVE, CONTACT = cases.parts(FOCCHI)
HALF = CONTACT.half_length
STRENGTH = DRIVE.effort_maximum  # [N] of one side
COULOMB = CONTACT._replace(inverse_modulus=1e12)  # K -> 0
COUNTS = [(1, 1), (2, 3), (9, 4), (10, 4), (7, 5), (64, 64)]


def _displacement(motion, belt, x, y):
    """|j| [m] of one patch, read back from the force that the formulas give it."""
    column = math.copysign(x, x * belt) / HALF  # from the entry on
    one = Patches(np.array([column]), np.zeros(1), np.full(1, 0.5))
    contact = CONTACT._replace(half_gauge=y, strength=1.0, inverse_modulus=1.0)
    k = cases.soil_resistance(motion, belt, belt, contact, one).left
    speed = math.hypot(motion.v_x - motion.yaw_rate * y - belt, motion.v_y + motion.yaw_rate * x)
    return -math.log1p(-k * speed)


def _displacement_by_quadrature(motion, belt, x, y):
    """|j| [m]: F (5) integrated in time, in axes that do not turn with the vehicle."""
    v_x, v_y, w = motion
    entry = math.copysign(HALF, belt)
    forward = v_x - w * y - belt

    def rate(time, axis):
        c, s, lateral = math.cos(w * time), math.sin(w * time), v_y + w * (entry - belt * time)
        return c * forward - s * lateral if axis == 0 else s * forward + c * lateral

    end = (entry - x) / belt
    parts_ = [quad(rate, 0.0, end, (axis,), epsabs=1e-15, epsrel=1e-13)[0] for axis in (0, 1)]
    return math.hypot(*parts_)


@pytest.mark.parametrize("sense", [1.0, -1.0], ids=["forward", "reverse"])
@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")  # at its own rounding
def test_the_shear_displacement_is_the_integral_of_the_shear_velocity(sense):
    draws = np.random.default_rng(1)
    turns = []
    for _ in range(300):
        belt = sense * float(10.0 ** draws.uniform(-1.0, 0.5))
        motion = Motion(
            float(belt + draws.uniform(-1.0, 1.0)), *(float(v) for v in draws.uniform(-1.0, 1.0, 2))
        )
        x, y = float(draws.uniform(-HALF, HALF)), float(draws.uniform(-0.4, 0.4))
        turns.append(abs(motion.yaw_rate * (math.copysign(HALF, belt) - x) / belt))
        expected = _displacement_by_quadrature(motion, belt, x, y)
        assert _displacement(motion, belt, x, y) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert max(turns) > 4.0


def test_the_shear_displacement_has_no_seam_where_the_yaw_rate_vanishes():
    x, y, belt, forward, lateral = -0.2, 0.3, 0.5, 0.4, 0.05
    straight = _displacement(Motion(forward, lateral, 0.0), belt, x, y)
    assert straight == pytest.approx(math.hypot(0.1, 0.05) * (HALF - x) / belt, rel=1e-14)
    for w in (*10.0 ** np.arange(-20.0, -1.0), 5e-324, 1e-160, 1e-150):
        for sense in (-1.0, 1.0):
            motion = Motion(forward, lateral, sense * float(w))
            expected = _displacement_by_quadrature(motion, belt, x, y)
            assert _displacement(motion, belt, x, y) == pytest.approx(expected, rel=1e-13)
            assert abs(_displacement(motion, belt, x, y) - straight) < w + 1e-15


def test_the_printed_displacement_depends_on_the_heading_and_the_corrected_one_does_not():
    # F (6) ends its second line in -b cos(phi); with + it is the integral.
    x, y, belt, v_x, v_y, w = -0.2, 0.3, 0.25, 0.2, -0.01, 0.03
    b, lateral = v_x - w * y, v_y + w * x
    result = {-1.0: [], 1.0: []}
    for heading in (0.0, 1.0, 2.5):
        a = w * (HALF - x) / belt + heading
        c, s = math.cos(heading), math.sin(heading)
        j_x = (lateral * math.cos(a) + b * math.sin(a) - (v_y + w * HALF) * c - b * s) / w
        for sign, values in result.items():
            j_y = lateral * math.sin(a) - b * math.cos(a) - (v_y + w * HALF) * s + sign * b * c
            values.append(math.hypot(j_x, j_y / w))
    exact = _displacement_by_quadrature(Motion(v_x, v_y, w), belt, x, y)
    assert result[1.0] == pytest.approx([exact] * 3, rel=1e-10)
    assert result[-1.0][0] > 90.0 * exact and np.ptp(result[-1.0]) > exact


@pytest.mark.parametrize("count", COUNTS)
def test_the_sums_are_those_of_the_patches_one_by_one(count):
    patches = level.make_patches(*count)
    contact = cases.parts(FOCCHI, patches)[2]
    scale = np.array([STRENGTH, STRENGTH, 2.0 * STRENGTH, STRENGTH, 2.0 * STRENGTH])
    compared = 0
    for motion, left, right in cases.random_motions(150, 3, slowest=-2.0):
        if abs(motion.yaw_rate) * 2.0 * HALF > HISTORY_TURN * min(abs(left), abs(right)):
            continue
        result = np.array(cases.forces(motion, left, right, contact, patches))
        expected = np.array(cases.forces_patch_by_patch(motion, left, right, contact, patches))
        assert np.abs((result - expected) / scale).max() < 1e-10
        compared += 1
    assert compared > 100


@pytest.mark.parametrize("slip", [0.002, 0.01, 0.1, 1.0])
def test_the_thrust_of_straight_driving_tends_to_the_integral_over_the_track(slip):
    # S (7), the same law integrated along the track: midpoint rule, order two in the patches.
    p = FOCCHI._replace(shear_deformation_modulus=0.02)
    exact = tractive_effort(slip, STRENGTH, p.contact_length / p.shear_deformation_modulus)
    errors = []
    for along in (8, 16, 32, 64):
        patches = level.make_patches(along, 3)
        result = cases.forces(
            Motion(1.0 - slip, 0.0, 0.0), 1.0, -1.0, cases.parts(p, patches)[2], patches
        )
        errors.append(abs(result.left - exact))
    assert np.all(np.diff(errors) < 0.0)
    assert errors[-2] / errors[-1] == pytest.approx(4.0, abs=0.3), errors


def test_without_deformation_every_motion_meets_coulomb_friction():
    x = PATCHES.columns[:, None] * HALF
    across = np.concatenate([-PATCHES.rows, PATCHES.rows]) * CONTACT.track_width
    for motion, left, right in cases.random_motions(300, 4):
        expected = np.zeros(3)
        for belt, arm in ((left, CONTACT.half_gauge), (right, -CONTACT.half_gauge)):
            y = arm + across
            s_x = motion.v_x - motion.yaw_rate * y - belt + 0.0 * x
            s_y = motion.v_y + motion.yaw_rate * x + 0.0 * y
            f_x, f_y = (-CONTACT.strength * s / np.hypot(s_x, s_y) for s in (s_x, s_y))
            expected += f_x.sum(), f_y.sum(), (x * f_y - y * f_x).sum()
        result = cases.forces(motion, left, right, COULOMB)
        together = (result.left + result.right, result.lateral, result.moment)
        assert together == pytest.approx(expected, abs=1e-7 * STRENGTH)


@pytest.mark.parametrize("modulus", [1e-4, 1e-3, 1e-2, 0.1])
def test_a_belt_that_stands_meets_full_sliding_friction(modulus):
    contact = CONTACT._replace(inverse_modulus=1.0 / modulus)
    for motion, _, _ in cases.random_motions(100, 5, slowest=-2.0):
        expected = cases.forces(motion, 0.0, 0.0, COULOMB)
        for belt in (0.0, 1e-12, -1e-12):
            result = cases.forces(motion, belt, -belt, contact)
            assert result == pytest.approx(expected, abs=1e-7 * STRENGTH)


@pytest.mark.parametrize("modulus", [1e-4, 1e-3, 1e-2, 0.1])
def test_the_force_has_no_jump_on_the_way_to_a_belt_that_stands(modulus):
    contact = CONTACT._replace(inverse_modulus=1.0 / modulus)

    def steps(motion, low, high, points):
        """(belt speeds, largest change of a force from each to the next)."""
        belts = np.geomspace(low, high, points)
        result = [cases.forces(motion, float(b), -0.7 * float(b), contact)[:4] for b in belts]
        return belts, np.abs(np.diff(result, axis=0)).max(axis=1)

    for motion, _, _ in cases.random_motions(30, 6, slowest=-2.0):
        low, high, points = 1e-9, 1e-2, 1000
        for _ in range(5):  # ever closer to the largest change: a jump would stay
            belts, changes = steps(motion, low, high, points)
            worst = int(changes.argmax())
            low, high, points = belts[worst], belts[worst + 1], 50
        assert changes.max() < 1e-5 * STRENGTH


@pytest.mark.parametrize("count", COUNTS)
def test_mirrored_motions_meet_mirrored_resistance_bit_for_bit(count):
    patches = level.make_patches(*count)
    contact = cases.parts(FOCCHI, patches)[2]
    motions = list(cases.random_motions(100, 8, slowest=-9.0))
    motions += [(m, 0.0, 0.0) for m, _, _ in motions] + [(m, b, 0.0) for m, b, _ in motions]
    for (v_x, v_y, w), left, right in motions:
        r = cases.soil_resistance(Motion(v_x, v_y, w), left, right, contact, patches)
        other = cases.soil_resistance(Motion(v_x, -v_y, -w), right, left, contact, patches)
        assert other == (r.right, r.left, -r.right_arm, -r.left_arm, r.forward, r.polar)
        back = cases.soil_resistance(Motion(-v_x, v_y, -w), -left, -right, contact, patches)
        assert back == (r.left, r.right, r.left_arm, r.right_arm, -r.forward, r.polar)


@settings(deadline=None, max_examples=300)
@given(
    st.tuples(*[st.floats(-1e3, 1e3) for _ in range(5)]),
    st.floats(1e-4, 0.1),
    st.tuples(st.integers(1, 12), st.integers(1, 6)),
)
def test_whatever_the_motion_the_soil_gives_no_more_than_its_strength_and_dissipates(
    motion, modulus, count
):
    patches = level.make_patches(*count)
    contact = cases.parts(FOCCHI, patches)[2]._replace(inverse_modulus=1.0 / modulus)
    v_x, v_y, w, left, right = motion
    r = cases.soil_resistance(Motion(v_x, v_y, w), left, right, contact, patches)
    assert np.all(np.isfinite(r))
    assert min(r.left, r.right, r.polar) >= 0.0
    result = cases.forces(Motion(v_x, v_y, w), left, right, contact, patches)
    # Sums k (belt - track) over patches whose track speeds differ lose digits at high speeds.
    rounding = 1e-13 * (r.left + r.right) * max(map(abs, motion)) + 1e-9
    assert max(abs(result.left), abs(result.right)) <= STRENGTH + rounding
    assert math.hypot(result.left + result.right, result.lateral) <= 2.0 * STRENGTH + rounding
    assert result.dissipation >= -rounding * max(map(abs, motion))


def test_the_patches_of_a_track_share_its_strength():
    for count in COUNTS:
        patches = level.make_patches(*count)
        assert level.patch_count(patches) == math.prod(count)
        # Full sliding of one track straight on: all patches pull one way.
        contact = cases.parts(FOCCHI, patches)[2]._replace(inverse_modulus=1e12)
        result = cases.forces(Motion(1.0, 0.0, 0.0), 0.0, 5.0, contact, patches)
        assert result.left == pytest.approx(-STRENGTH, rel=1e-12)
        assert result.right == pytest.approx(STRENGTH, rel=1e-12)
        # Middles of equal cells: second moments of a rectangle but for 1/n^2.
        x2 = (patches.columns**2).mean()
        assert x2 == pytest.approx((1.0 - 1.0 / count[0] ** 2) / 3.0, abs=1e-12)
        y2 = (patches.weights * patches.rows**2).sum() / patches.weights.sum()
        assert y2 == pytest.approx((1.0 - 1.0 / count[1] ** 2) / 12.0, abs=1e-12)
        assert np.array_equal(patches.columns, -patches.columns[::-1])
