"""The Lyapunov laws: the decrease that F proves, symmetries, limits, and the belts' kinematics."""

import math

import numpy as np
import pytest

from baselines.lyapunov import lyapunov_laws as law
from tests.baselines.lyapunov.lyapunov_function import lyapunov_rate, pose_error, unicycle_law

GAINS = law.LyapunovGains()
NO_SLIP = law.Slip(0.0, 0.0, 0.0)
HALF_GAUGE = 0.303
SAFE_ANGLE = 2.0 * math.acos(law.HALF_COSINE_FLOOR)  # beyond it the guard is at work


def situations(count, seed=1, angle=SAFE_ANGLE):
    """Random (PoseError, v_d, w_d, Slip) with |e_h|, |e_h + alpha|, |e_h + alpha_d| < angle."""
    rng = np.random.default_rng(seed)
    while count > 0:
        error = law.PoseError(*rng.normal(0.0, 0.5, 2), rng.uniform(-math.pi, math.pi))
        slip = law.Slip(*rng.uniform(-0.5, 0.5, 2), rng.normal(0.0, 0.3))
        if max(abs(error.heading + shift) for shift in (0.0, *slip[:2])) < angle:
            count -= 1
            yield error, rng.uniform(-0.5, 0.5), rng.normal(0.0, 0.5), slip


def printed_law(pose, reference, speed, yaw_rate, slip):
    """(44), (47) as F prints them: world frame, polar angle psi."""
    x, y, yaw = pose
    x_d, y_d, yaw_d = reference
    distance, psi = math.hypot(x - x_d, y - y_d), math.atan2(y - y_d, x - x_d)
    e_h, beta = yaw - yaw_d, yaw + yaw_d
    delta_v = -GAINS.k_p * distance * math.cos(psi - (yaw + slip.alpha))
    delta_w = -speed * distance / math.cos((slip.alpha + e_h) / 2)
    delta_w *= math.sin(psi - (slip.alpha + beta) / 2)
    delta_w -= GAINS.k_phi * math.sin(e_h + slip.reference) + slip.reference_rate
    return (speed + delta_v) * math.cos(slip.alpha), yaw_rate + delta_w


def rate_along_the_model(error, speed, yaw_rate, slip, motion, gains=GAINS):
    """V' by a central difference along the model (27) and the reference (35)."""
    yaw_d, h = 0.7, 1e-5
    yaw = yaw_d + error.heading
    x = math.cos(yaw) * error.x - math.sin(yaw) * error.y
    y = math.sin(yaw) * error.x + math.cos(yaw) * error.y
    v_x, v_y = law.pose_rate(yaw, motion.speed, slip.alpha)
    values = []
    for t in (-h, h):
        pose = x + v_x * t, y + v_y * t, yaw + motion.yaw_rate * t
        goal = speed * math.cos(yaw_d) * t, speed * math.sin(yaw_d) * t, yaw_d + yaw_rate * t
        error_then = pose_error(*pose, *goal)
        values.append(
            law.lyapunov_value(error_then, slip.reference + slip.reference_rate * t, gains)
        )
    return (values[1] - values[0]) / (2.0 * h)


WEIGHTS = [law.LyapunovGains(5.0, 3.0, k_y, reach) for k_y in (0.2, 40.0) for reach in (0.1, 1.0)]
WEIGHTS += [law.LyapunovGains(5.0, 3.0, k_y) for k_y in (0.2, 40.0)]


@pytest.mark.parametrize("gains", [GAINS, *WEIGHTS])
def test_the_laws_decrease_v_as_in_43_and_48_with_every_weight_of_distances(gains):
    """48: when the slip is that of the reference."""
    papers = gains is GAINS
    count, tolerance = (3000, {"abs": 1e-6}) if papers else (500, {"rel": 1e-5, "abs": 1e-5})
    for error, speed, yaw_rate, slip in situations(count):
        distance = math.hypot(error.x, error.y) / gains.reach
        weight = gains.k_y / math.sqrt(1.0 + distance**2)
        for s in (slip._replace(reference=slip.alpha), NO_SLIP):
            motion = law.slippage_aware_law(error, speed, yaw_rate, s, gains)
            if s is NO_SLIP:
                assert motion == unicycle_law(error, speed, yaw_rate, gains)
            along = error.x * math.cos(s.alpha) + error.y * math.sin(s.alpha)
            heading = math.sin(error.heading + s.alpha)
            expected = -weight * gains.k_p * along**2 - gains.k_phi * heading**2
            rate = rate_along_the_model(error, speed, yaw_rate, s, motion, gains)
            assert rate == pytest.approx(expected, **tolerance)
            assert expected <= 0.0
            accuracy = 1e-12 if papers else 1e-9
            assert lyapunov_rate(error, speed, s, gains) == pytest.approx(expected, abs=accuracy)


def test_far_from_the_path_the_demanded_yaw_rate_stays_within_the_reach():
    gains = law.LyapunovGains(5.0, 3.0, 40.0, 0.1)
    near = unicycle_law(law.PoseError(0.0, 0.01, 0.0), 0.3, 0.0, gains).yaw_rate
    assert near == pytest.approx(-40.0 * 0.3 * 0.01, rel=0.01)
    far = unicycle_law(law.PoseError(0.0, 5.0, 0.0), 0.3, 0.0, gains).yaw_rate
    assert far == pytest.approx(-40.0 * 0.1 * 0.3, rel=0.01)


def test_another_slip_than_the_reference_has_leaves_a_term_that_48_lacks():
    printed_misses = []
    for error, speed, yaw_rate, slip in situations(3000):
        motion = law.slippage_aware_law(error, speed, yaw_rate, slip, GAINS)
        rate = rate_along_the_model(error, speed, yaw_rate, slip, motion)
        assert rate == pytest.approx(lyapunov_rate(error, speed, slip, GAINS), abs=1e-6)
        along = error.x * math.cos(slip.alpha) + error.y * math.sin(slip.alpha)
        across = error.y * math.cos(slip.alpha) - error.x * math.sin(slip.alpha)
        half = 0.5 * (error.heading + slip.alpha)
        aim = error.heading + slip.reference
        printed = -GAINS.k_p * along**2 - GAINS.k_phi * math.sin(aim) ** 2
        missing = speed * (across * math.cos(half) + along * math.sin(half)) / math.cos(half)
        missing *= math.sin(2.0 * half) - math.sin(aim)
        assert rate == pytest.approx(printed + missing, abs=1e-6)
        printed_misses.append(rate - printed)
    assert max(printed_misses) > 0.05  # V can even grow where (48) has it fall


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lateral_offset_alone_is_steered_with_the_sign_that_5_1_ends_with(sign):
    # e_phi = 0, phi = psi +- pi/2. The sine on the way there, sin(e_phi/2 +- pi/2), should have -+.
    for speed, distance, psi in ((0.3, 0.4, 0.9), (-0.2, 1.3, -2.0), (0.5, 0.1, 3.0)):
        yaw = psi + sign * 0.5 * math.pi
        pose = (distance * math.cos(psi), distance * math.sin(psi), yaw)
        forward, turn = printed_law(pose, (0.0, 0.0, yaw), speed, 0.0, NO_SLIP)
        assert forward == pytest.approx(speed, abs=1e-12)
        assert turn == pytest.approx(sign * speed * distance, abs=1e-12)
        between = -speed * distance * math.sin(0.0 + sign * 0.5 * math.pi)
        assert turn == pytest.approx(-between, abs=1e-12)
        ours = unicycle_law(pose_error(*pose, 0.0, 0.0, yaw), speed, 0.0, GAINS)
        assert ours.yaw_rate == pytest.approx(turn, abs=1e-12)


def test_for_a_reference_that_stands_every_lateral_offset_is_an_equilibrium():
    motion = unicycle_law(law.PoseError(0.0, 0.7, 0.0), 0.0, 0.0, GAINS)
    assert motion.speed == 0.0 and motion.yaw_rate == 0.0
    turning = unicycle_law(law.PoseError(0.0, 0.7, 0.0), 0.3, 0.0, GAINS)
    assert abs(turning.yaw_rate) > 0.1


def test_in_body_axes_the_law_is_the_printed_one():
    for error, speed, yaw_rate, slip in situations(500, seed=2):
        yaw_d = 2.5
        yaw = yaw_d + error.heading
        x = 3.0 + math.cos(yaw) * error.x - math.sin(yaw) * error.y
        y = -1.0 + math.sin(yaw) * error.x + math.cos(yaw) * error.y
        for s in (slip, NO_SLIP):
            expected = printed_law((x, y, yaw), (3.0, -1.0, yaw_d), speed, yaw_rate, s)
            motion = law.slippage_aware_law(error, speed, yaw_rate, s, GAINS)
            assert tuple(motion) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_without_error_the_reference_itself_is_demanded():
    none = law.PoseError(0.0, 0.0, 0.0)
    assert unicycle_law(none, 0.3, -0.4, GAINS) == (0.3, -0.4)
    slip = law.Slip(-0.2, -0.2, 0.1)
    rest = law.PoseError(0.0, 0.0, 0.2)
    motion = law.slippage_aware_law(rest, 0.3, 0.5, slip, GAINS)
    assert tuple(motion) == pytest.approx((0.3 * math.cos(0.2), 0.5 - 0.1), abs=1e-15)
    v_x, v_y = law.pose_rate(rest.heading, motion.speed, slip.alpha)
    assert (v_x, v_y) == pytest.approx((0.3, 0.0), abs=1e-15)  # it moves as the reference does


def test_the_inverse_cosine_is_exact_above_its_floor_and_fades_smoothly_to_zero():
    floor = law.HALF_COSINE_FLOOR
    for cosine in (floor, 0.5, 1.0, -0.7):
        assert law.inverse_half_cosine(cosine) == 1.0 / cosine
    assert law.inverse_half_cosine(0.0) == 0.0
    grid = np.linspace(-1.0, 1.0, 20001)
    values = np.array([law.inverse_half_cosine(c) for c in grid])
    assert np.abs(values).max() < 1.1 / floor
    assert np.array_equal(values, -np.array([law.inverse_half_cosine(-c) for c in grid]))
    slope = np.gradient(values, grid)
    assert np.abs(np.diff(slope)).max() < 20.0 / floor**3 * (grid[1] - grid[0])  # no kink


def test_facing_backwards_the_steering_is_bounded_and_without_a_jump():
    angles = np.linspace(math.pi - 0.6, math.pi + 0.6, 4001)
    values = np.array([law.turn_towards(0.3, 0.2, angle) for angle in angles])
    assert np.abs(values).max() < 1.1 / law.HALF_COSINE_FLOOR * math.hypot(0.3, 0.2)
    assert np.abs(np.diff(values)).max() < 0.02
    assert law.turn_towards(0.3, 0.2, math.pi) == pytest.approx(0.0, abs=1e-12)
    for angle in (0.3, -2.0, 3.1):
        turned = law.turn_towards(0.3, 0.2, angle + 2.0 * math.pi)
        assert turned == pytest.approx(law.turn_towards(0.3, 0.2, angle), abs=1e-9)


def test_a_faster_right_belt_turns_left_and_slip_is_fed_forward_with_its_sign():
    motion = law.body_motion(0.2, 0.4, 0.0, 0.0, HALF_GAUGE)
    assert tuple(motion) == pytest.approx((0.3, 0.2 / 0.606))
    # A track that slips when driving is slower than its belt.
    assert law.body_motion(0.3, 0.3, 0.0, 0.1, HALF_GAUGE).yaw_rate < 0.0
    for left, right, beta_left, beta_right in np.random.default_rng(0).normal(size=(200, 4)):
        motion = law.body_motion(left, right, beta_left, beta_right, HALF_GAUGE)
        back = law.belt_speeds(motion, beta_left, beta_right, HALF_GAUGE)
        assert back == pytest.approx((left, right), abs=1e-14)


def test_the_limit_keeps_the_turn_and_the_speed_gives_way():
    assert law.within_speed_limit(1.0, -2.0, 5.0) == (1.0, -2.0)
    left, right = law.within_speed_limit(9.0, 11.0, 5.0)
    assert (left, right) == pytest.approx((3.0, 5.0))
    assert law.within_speed_limit(-20.0, 20.0, 5.0) == (-5.0, 5.0)
    assert law.within_speed_limit(-4.0, 20.0, 5.0) == (-5.0, 5.0)
    for left, right in np.random.default_rng(1).normal(0.0, 9.0, (500, 2)):
        assert max(map(abs, law.within_speed_limit(left, right, 5.0))) <= 5.0


def test_v_still_falls_under_the_limit_while_it_leaves_room_for_the_reference_speed():
    limit, checked = 0.8, 0
    for error, speed, yaw_rate, slip in situations(3000, seed=5):
        steady = slip._replace(reference=slip.alpha)
        motion = law.slippage_aware_law(error, speed, yaw_rate, steady, GAINS)
        belts = law.belt_speeds(motion, 0.0, 0.0, HALF_GAUGE)
        limited = law.within_speed_limit(*belts, limit)
        slower = law.body_motion(*limited, 0.0, 0.0, HALF_GAUGE)
        room = limit - HALF_GAUGE * abs(motion.yaw_rate)
        if max(map(abs, belts)) > limit and abs(speed) < room:
            checked += 1
            assert rate_along_the_model(error, speed, yaw_rate, steady, slower) <= 1e-7
    assert checked > 500
