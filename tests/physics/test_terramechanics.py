"""Track-soil formulas against quadrature, closed forms, limits and published values."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.lumped import drive_limits, track_slip
from tracked_env.physics.parameters import RANGES, VEHICLES

STRAWA = VEHICLES["strawa"]
LENGTH = STRAWA.contact_length
WEIGHT = STRAWA.mass * soil.GRAVITY
CLAY = drive_limits(STRAWA)
RESISTANCE = 0.5 * STRAWA.longitudinal_resistance * WEIGHT  # [N] of one track
INVERSE_WIDTH = 1.0 / soil.MOTION_RESISTANCE_REGULARISATION


def _soils(count=60):
    """(F_max [N], l / K [-]) over the whole allowed range of soils and vehicles."""
    draws = np.random.default_rng(2)
    for _ in range(count):
        cohesion = 10.0 ** draws.uniform(1.0, 6.0)
        angle = draws.uniform(RANGES["friction_angle"].low, RANGES["friction_angle"].high)
        modulus = math.exp(draws.uniform(math.log(1e-4), math.log(1.0)))
        length = draws.uniform(0.1, 10.0)
        yield soil.maximum_tractive_effort(cohesion, angle, 0.3, length, 1450.0), length / modulus


def test_maximum_effort_on_heavy_clay_is_that_of_mohr_and_coulomb():
    expected = 0.3 * 2.0 * 70e3 + 0.5 * 1450.0 * 9.81 * math.tan(math.radians(38.4))
    assert CLAY.effort_maximum == pytest.approx(expected, rel=1e-15)
    assert CLAY.effort_maximum == pytest.approx(47.64e3, rel=1e-4)
    assert soil.maximum_tractive_effort(0.0, 0.0, 0.3, 2.0, 1450.0) == 0.0


@pytest.mark.parametrize("slip", [1e-6, 1e-3, 1.2e-3, 1.3e-3, 0.0019, 0.02, 0.3, 0.7, 1.0])
@pytest.mark.parametrize("modulus", [0.001, 0.02, 0.3])
def test_effort_is_the_integral_of_janosi_and_hanamoto_over_the_contact(slip, modulus):
    # S (5), (6): tau = tau_max (1 - exp(-i x / K)) at the distance x from the front.
    def shear(x):
        return -math.expm1(-slip * x / modulus)

    knee = min(30.0 * modulus / slip, LENGTH)
    parts = ((0.0, knee), (knee, LENGTH))
    mean = sum(quad(shear, *ends, epsabs=0.0, epsrel=1e-13)[0] for ends in parts) / LENGTH
    effort = soil.tractive_effort(slip, 1000.0, LENGTH / modulus)
    assert effort == pytest.approx(1000.0 * mean, rel=1e-12)


def test_nine_percent_of_the_maximum_effort_takes_0_19_percent_of_slip_on_heavy_clay():
    # Straight driving: rolling resistance 4.27 kN per track is 9 % of F_max = 47.6 kN.
    assert RESISTANCE / CLAY.effort_maximum == pytest.approx(0.09, abs=0.0005)
    slip = soil.slip_from_effort(0.09 * CLAY.effort_maximum, CLAY.effort_maximum, 100.0)
    assert slip == pytest.approx(0.0019, abs=0.00005)


def test_mobilised_shear_has_its_limits_and_is_monotone():
    ratios = np.concatenate([np.logspace(-12, 6, 500), np.linspace(0.12, 0.13, 200)])
    values = np.array([soil.mobilised_shear(u) for u in np.sort(ratios)])
    assert soil.mobilised_shear(0.0) == 0.0
    assert np.diff(values).min() >= 0.0
    assert soil.mobilised_shear(1e-6) == pytest.approx(0.5e-6, rel=1e-6)
    assert soil.mobilised_shear(1e4) == pytest.approx(1.0 - 1e-4, rel=1e-14)


def test_the_slope_of_the_mobilised_shear_is_that_of_finite_differences():
    assert soil.mobilised_shear_slope(0.0) == 0.5
    for u in (1e-3, 0.05, 0.1249, 0.125, 0.1251, 0.7, 3.0, 40.0):
        h = 1e-4 * max(u, 0.1)
        outer = soil.mobilised_shear(u + 2.0 * h) - soil.mobilised_shear(max(u - 2.0 * h, 0.0))
        inner = soil.mobilised_shear(u + h) - soil.mobilised_shear(u - h)
        expected = (8.0 * inner - outer) / (12.0 * h)
        assert soil.mobilised_shear_slope(u) == pytest.approx(expected, rel=1e-9)
    series, closed = soil.mobilised_shear_slope(0.125 - 1e-15), soil.mobilised_shear_slope(0.125)
    assert series == pytest.approx(closed, rel=1e-12)
    assert soil.mobilised_shear_slope(1e5) == pytest.approx(1e-10, rel=1e-4)


def test_slip_and_effort_are_inverse_of_each_other_on_every_soil():
    slips = np.concatenate([np.logspace(-9, 0, 40), [0.0, 0.00125, 0.5, 0.99]])
    for maximum, shear_length in _soils():
        for slip in slips:
            effort = soil.tractive_effort(slip, maximum, shear_length)
            assert soil.slip_from_effort(effort, maximum, shear_length) == pytest.approx(
                slip, rel=1e-10, abs=0.0
            )
        limit = soil.tractive_effort(1.0, maximum, shear_length)
        for share in (1e-9, 1e-4, 0.03, 0.5, 0.667, 0.97, 0.9999):
            slip = soil.slip_from_effort(share * limit, maximum, shear_length)
            assert soil.tractive_effort(slip, maximum, shear_length) == pytest.approx(
                share * limit, rel=1e-13
            )


def test_slip_and_effort_are_odd_bit_for_bit():
    for maximum, shear_length in _soils(10):
        for slip in (1e-5, 0.01, 0.4, 1.0):
            effort = soil.tractive_effort(slip, maximum, shear_length)
            assert soil.tractive_effort(-slip, maximum, shear_length) == -effort
            there = soil.slip_from_effort(effort, maximum, shear_length)
            assert soil.slip_from_effort(-effort, maximum, shear_length) == -there


def test_an_effort_beyond_the_limit_means_full_slip():
    for maximum, shear_length in _soils(20):
        limit = soil.tractive_effort(1.0, maximum, shear_length)
        for factor in (1.0 + 1e-9, 1.5, 1e6):
            assert soil.slip_from_effort(factor * limit, maximum, shear_length) == pytest.approx(
                1.0, rel=1e-9
            )
        assert soil.slip_from_effort(-2.0 * maximum, maximum, shear_length) == -1.0


def test_driving_effort_falls_from_the_limit_at_standstill_to_zero_at_top_speed():
    top = 1.0 / CLAY.inverse_belt_limit
    drive = CLAY.inverse_belt_limit, CLAY.effort_maximum, CLAY.shear_length
    efforts = [soil.driving_effort_limit(v, *drive) for v in np.linspace(0.0, 1.2 * top, 200)]
    assert efforts[0] == pytest.approx(CLAY.effort_limit, rel=1e-8)
    assert np.diff(efforts).max() <= 0.0
    assert efforts[-1] == 0.0
    # At 90 % of the top speed the belt slips by 10 %: u = 10 and F = F_max (0.9 + e^-10 / 10).
    tenth = soil.driving_effort_limit(0.9 * top, *drive)
    assert tenth == pytest.approx(CLAY.effort_maximum * (0.9 + 0.1 * math.exp(-10.0)), rel=1e-12)


@pytest.mark.parametrize("speed", [-3.0, -0.02, 0.02, 3.0])
@pytest.mark.parametrize("share", [-0.9, -0.3, -1e-4, 1e-4, 0.3, 0.9])
def test_the_belt_outruns_a_driven_track_and_lags_a_braked_one(speed, share):
    slip, belt = track_slip(share * CLAY.effort_limit, speed, CLAY)
    assert belt * speed > 0.0
    assert (abs(belt) > abs(speed)) == (share * speed > 0.0)
    # The slip ratio has the sign of the effort and carries exactly that effort, S (7).
    assert slip == pytest.approx((belt - speed) / max(abs(belt), abs(speed)), rel=1e-12)
    effort = soil.tractive_effort(slip, CLAY.effort_maximum, CLAY.shear_length)
    assert effort == pytest.approx(share * CLAY.effort_limit, rel=1e-9)


def test_a_track_that_stands_or_has_no_effort_has_no_slip_until_it_spins_or_is_locked():
    for speed in (-3.0, 0.0, 0.5):
        assert track_slip(0.0, speed, CLAY) == (0.0, speed)
    assert track_slip(-2.0 * CLAY.effort_limit, 1.5, CLAY) == (-1.0, 0.0)
    assert track_slip(0.5 * CLAY.effort_limit, 0.0, CLAY) == (0.0, 0.0)
    top = 1.0 / CLAY.inverse_belt_limit
    for sense in (-1.0, 1.0):
        slip, belt = track_slip(sense * 1.1 * CLAY.effort_limit, 0.0, CLAY)
        assert slip == sense
        assert belt == pytest.approx(sense * top, rel=1e-12)


def test_the_belt_never_exceeds_the_speed_of_its_drive():
    top = 1.0 / CLAY.inverse_belt_limit
    for speed in (0.01, 1.0, 5.9):
        for share in (0.5, 0.99, 1.0, 3.0):
            _, belt = track_slip(share * CLAY.effort_limit, speed, CLAY)
            assert speed < belt <= top * (1.0 + 1e-15)


def test_at_rest_a_load_is_balanced_up_to_the_resistance_and_not_beyond():
    for load in (-RESISTANCE, -0.3 * RESISTANCE, 0.0, 1e-9, 0.999 * RESISTANCE, RESISTANCE):
        assert load - soil.resisting(0.0, load, RESISTANCE, INVERSE_WIDTH) == 0.0
    for load in (1.1 * RESISTANCE, 5.0 * RESISTANCE):
        assert soil.resisting(0.0, load, RESISTANCE, INVERSE_WIDTH) == RESISTANCE
        assert soil.resisting(0.0, -load, RESISTANCE, INVERSE_WIDTH) == -RESISTANCE


@pytest.mark.parametrize("load", [-1e4, 0.0, 1e3, 1e4])
def test_above_its_width_the_resistance_is_the_printed_sign_function(load):
    for speed in (0.1, 0.11, 2.0):
        assert soil.resisting(speed, load, RESISTANCE, INVERSE_WIDTH) == RESISTANCE
        assert soil.resisting(-speed, load, RESISTANCE, INVERSE_WIDTH) == -RESISTANCE


def test_what_is_left_of_a_small_load_always_slows_the_track():
    for speed in (1e-6, 0.01, 0.05, 0.2):
        for load in np.linspace(-0.99, 0.99, 21) * RESISTANCE:
            net = load - soil.resisting(speed, load, RESISTANCE, INVERSE_WIDTH)
            assert net < 0.0
            mirrored = -load - soil.resisting(-speed, -load, RESISTANCE, INVERSE_WIDTH)
            assert mirrored == -net


def test_the_held_load_gives_back_at_most_a_trace_of_power_within_the_width():
    # Near standstill the resistance still balances a load against the motion; continuity in the
    # speed costs max over x of x (1 - 3 x + x^3) = 0.0841 of R times the width, no more.
    width = soil.MOTION_RESISTANCE_REGULARISATION
    powers = [
        v * soil.resisting(v, load, RESISTANCE, INVERSE_WIDTH)
        for v in np.linspace(0.0, 1.2 * width, 500)
        for load in (-3.0 * RESISTANCE, -RESISTANCE, 0.0, RESISTANCE)
    ]
    assert min(powers) >= -0.0842 * RESISTANCE * width
    assert max(powers) > 0.0


SPEEDS = (-20.0, -1.7, -0.3, 0.3, 1.7, 20.0)


@pytest.mark.parametrize("belt", SPEEDS)
@pytest.mark.parametrize("slip", [-0.97, -0.5, -0.02, 0.0, 0.02, 0.5, 0.97])
def test_track_speed_from_belt_is_the_inverse_of_the_slip_ratio(belt, slip):
    speed = soil.track_speed_from_belt(belt, slip)
    assert soil.slip_ratio(belt, speed) == pytest.approx(slip, abs=1e-14)
    assert soil.track_speed_from_belt(-belt, -slip) == -speed
    if slip * belt >= 0.0:  # driving
        assert speed == pytest.approx(belt * (1.0 - abs(slip)))


@pytest.mark.parametrize("belt", SPEEDS)
def test_a_braking_track_is_faster_than_its_belt_but_finite_when_locked(belt):
    braking = -math.copysign(0.6, belt)
    assert soil.track_speed_from_belt(belt, braking) == pytest.approx(belt / 0.4)
    locked = soil.track_speed_from_belt(belt, -math.copysign(1.0, belt))
    assert locked == pytest.approx(belt / soil.LOCKED_MARGIN)


def test_track_speed_from_belt_is_smooth_at_no_slip_and_zero_for_a_standing_belt():
    left, right = soil.track_speed_from_belt(2.0, -1e-6), soil.track_speed_from_belt(2.0, 1e-6)
    assert (left - 2.0) / 1e-6 == pytest.approx(2.0, rel=1e-5)
    assert (right - 2.0) / 1e-6 == pytest.approx(-2.0, rel=1e-5)
    assert all(soil.track_speed_from_belt(0.0, i) == 0.0 for i in (-1.0, -0.4, 0.0, 0.4, 1.0))
