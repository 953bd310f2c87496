"""The two lateral models: the ICR that emerges, and the ICR that is imposed."""

import math

import numpy as np
import pytest
from scipy.optimize import fsolve

from tests.physics.plant_cases import CLAY, SANDY_LOAM, model, random_cases
from tracked_env.physics.lumped import Motion, drive_limits, track_slip, track_speeds
from tracked_env.physics.parameters import plant_parameters


def _steady_circle(p, radius=10.0, speed=2.0):
    """(v_y, torque left, torque right) that keep the vehicle on a circle, `sliding`."""
    rates = model("sliding", p)[1]

    def residual(unknown):
        v_y, mean, difference = unknown[0], 1e3 * unknown[1], 1e3 * unknown[2]
        motion = Motion(speed, float(v_y), speed / radius)
        return np.array(rates(motion, float(mean - difference), float(mean + difference)))

    solution, _, status, message = fsolve(residual, [-0.01, 1.3, 1.0], full_output=True)
    assert status == 1, message
    v_y, mean, difference = solution
    return float(v_y), 1e3 * (mean - difference), 1e3 * (mean + difference)


def test_on_a_steady_circle_the_icr_moves_forward_until_friction_carries_the_lateral_force():
    # m w v_x = 2 q x_icr: x_icr = w v_x l / (2 mu_t g) = 0.051 m at R = 10 m and 2 m/s.
    v_y, _, _ = _steady_circle(CLAY)
    x_icr = -v_y / 0.2
    assert x_icr == pytest.approx(0.2 * 2.0 * 2.0 / (2.0 * 0.8 * 9.81), rel=0.02)
    assert x_icr == pytest.approx(0.05, rel=0.04)


def test_a_wide_turn_at_speed_moves_the_icr_further_forward():
    shifts = [-_steady_circle(CLAY, speed=v)[0] / (v / 10.0) for v in (1.0, 2.0, 3.0, 4.0)]
    assert np.all(np.diff(shifts) > 0.0)


def test_only_the_misprinted_factor_makes_sandy_loam_too_weak_for_the_paper_circle():
    # S 8.2.3: R = 10 m at 2 m/s on sandy loam. The outer track needs its rolling resistance
    # plus M_r / B: 7.6 kN with the integral, 11.0 kN with the factor 2; the soil gives 10.7 kN.
    needed = {}
    for factor in (1.0, 2.0):
        p = CLAY._replace(turning_resistance_factor=factor)
        needed[factor] = _steady_circle(p)[2] / p.sprocket_radius
    limit = drive_limits(plant_parameters(soil=SANDY_LOAM)).effort_limit
    assert limit == pytest.approx(10.66e3, rel=1e-3)
    assert needed[1.0] < 0.75 * limit
    assert needed[2.0] > limit


def _with_multiplier(p, motion, loads, yaw=0.7):
    """Body accelerations from S (26) with the constraint S (17) and its multiplier.

    M q'' + A^T lambda = Q and A q'' + A' q' = 0 in world axes, with
    A = [-sin yaw, cos yaw, d]; Q from the loads. Returns dv/dt in body axes.
    """
    c, s, w = math.cos(yaw), math.sin(yaw), motion.yaw_rate
    drive_left = loads.effort_left - loads.resistance_left
    drive_right = loads.effort_right - loads.resistance_right
    forward, lateral = drive_left + drive_right, loads.lateral_force
    moment = 0.5 * p.track_gauge * (drive_right - drive_left) + loads.turning_moment
    constraint = np.array([-s, c, p.icr_forward])
    constraint_rate = w * np.array([-c, -s, 0.0])
    velocity = np.array([c * motion.v_x - s * motion.v_y, s * motion.v_x + c * motion.v_y, w])
    system = np.zeros((4, 4))
    system[:3, :3] = np.diag([p.mass, p.mass, p.inertia])
    system[:3, 3] = system[3, :3] = constraint
    forces = [c * forward - s * lateral, s * forward + c * lateral, moment]
    x, y, yaw_acceleration, _ = np.linalg.solve(system, [*forces, -constraint_rate @ velocity])
    # dv/dt in body axes = R^T (world acceleration) - w x v.
    return (c * x + s * y + w * motion.v_y, -s * x + c * y - w * motion.v_x, yaw_acceleration)


def test_the_constrained_lateral_model_agrees_with_the_lagrange_multiplier():
    for p, motion, left, right in random_cases("constrained"):
        loads, rates = model("constrained", p)
        expected = _with_multiplier(p, motion, loads(motion, left, right))
        scale = max(abs(value) for value in expected)
        assert rates(motion, left, right) == pytest.approx(expected, rel=1e-9, abs=1e-11 * scale)


def test_the_constrained_lateral_model_keeps_the_icr_where_it_is():
    for p, motion, left, right in random_cases("constrained"):
        _, a_y, a_w = model("constrained", p)[1](motion, left, right)
        assert a_y == -p.icr_forward * a_w


def test_constrained_friction_is_sliding_friction_at_the_same_icr():
    # Far above both regularisations the two lateral models see the same contact.
    for d in (-0.3, -0.05, 0.05, 0.4):
        p = CLAY._replace(icr_forward=d)
        for w in (-300.0, 300.0):
            motion = Motion(1.0, -d * w, w)
            fixed = model("constrained", p)[0](motion, 0.0, 0.0)
            free = model("sliding", p)[0](motion, 0.0, 0.0)
            assert fixed.lateral_force == pytest.approx(free.lateral_force, rel=1e-6)
            assert fixed.turning_moment == pytest.approx(free.turning_moment, rel=1e-6)


def test_the_two_terms_missing_from_the_printed_control_law_are_needed_for_steady_motion():
    # S (29) corrected, in ISO axes: sum of drives = m d w^2, moment = F_y d + M_r - m d w v_x.
    d, speed, w = 0.05, 2.0, 0.2
    f_y = 2.0 * 0.8 * 1450.0 * 9.81 / 2.0 * d
    m_r = 0.8 * 1450.0 * 9.81 / 2.0 * (1.0 - d * d)
    resistance = 0.3 * 1450.0 * 9.81
    rates = model("constrained", CLAY)[1]

    def yaw_acceleration_and_thrust(centrifugal, lateral):
        mean = 0.3 * (resistance + 0.5 * centrifugal)
        difference = 0.3 / 1.7 * (lateral + m_r - 1450.0 * d * w * speed)
        return rates(Motion(speed, -d * w, w), mean - difference, mean + difference)

    corrected = yaw_acceleration_and_thrust(1450.0 * d * w * w, f_y * d)
    assert corrected == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    printed = yaw_acceleration_and_thrust(1450.0 * w * w, f_y)
    assert printed[0] == pytest.approx((1.0 - d) * w * w, rel=1e-9)
    assert printed[2] == pytest.approx((1.0 - d) * f_y / (1180.0 + 1450.0 * d * d), rel=1e-9)


def test_the_paper_circle_needs_about_one_radian_per_second_between_the_sprockets():
    # S 8.1, Figure 12: left and right sprocket differ by approximately 1 rad/s.
    _, left, right = _steady_circle(CLAY)
    drive = drive_limits(CLAY)
    speeds = track_speeds(Motion(2.0, 0.0, 0.2), 0.85)
    belts = [track_slip(t / 0.3, v, drive)[1] for t, v in zip((left, right), speeds, strict=True)]
    assert (belts[1] - belts[0]) / 0.3 == pytest.approx(1.0, abs=0.25)
