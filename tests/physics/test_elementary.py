"""Elementary functions against the C library, their limits and their symmetries."""

import math

import numpy as np
import pytest

from tracked_env.physics import elementary

SPEEDS = np.concatenate([np.logspace(-12, 6, 400), np.linspace(0.0, 0.2, 401)])
WIDTH = 0.03  # [m/s]


def test_exponential_agrees_with_the_library_over_its_whole_range():
    draws = np.random.default_rng(1)
    arguments = np.concatenate(
        [
            draws.uniform(-700.0, 700.0, 20_000),
            draws.uniform(-1.0, 1.0, 5_000),
            -np.logspace(-300, 0, 500),
            0.5 * math.log(2.0) * np.arange(-1000, 1001),  # where the range reduction rounds
        ]
    )
    worst = max(abs(elementary.exponential(x) / math.exp(x) - 1.0) for x in arguments)
    assert worst < 1e-14


def test_exponential_is_clipped_and_never_infinite_or_zero():
    assert elementary.exponential(0.0) == 1.0
    assert elementary.exponential(1e300) == elementary.exponential(700.0) < math.inf
    assert elementary.exponential(-math.inf) == elementary.exponential(-700.0) > 0.0
    assert math.isnan(elementary.exponential(math.nan))


def test_the_inverse_root_is_exact_to_two_units_in_the_last_place():
    draws = 10.0 ** np.random.default_rng(2).uniform(-300.0, 300.0, 20_000)
    for x in (*draws, *(1.0 + 2.0**-52 * k for k in range(-3, 4)), 1e-24):
        assert abs(elementary.inverse_root(x) * math.sqrt(x) - 1.0) < 6e-16
    assert math.isnan(elementary.inverse_root(math.nan))


@pytest.mark.parametrize(("largest", "error"), [(0.02, 3e-16), (0.05, 1.2e-15), (0.1, 3e-13)])
def test_small_rotation_is_exact_to_the_first_neglected_term(largest, error):
    for angle in np.linspace(-largest, largest, 2001):
        cosine, sine = elementary.small_rotation(angle)
        assert abs(cosine - math.cos(angle)) < error
        assert abs(sine - math.sin(angle)) < error
        assert elementary.small_rotation(-angle) == (cosine, -sine)


def test_an_angle_is_wrapped_by_whole_turns_and_not_touched_within_half_a_turn():
    for angle in (0.0, 1.0, -3.0, 3.14):
        assert elementary.wrap_angle(angle) == angle
    assert elementary.wrap_angle(4.0) == pytest.approx(4.0 - 2.0 * math.pi)
    angles = np.random.default_rng(0).uniform(-100.0, 100.0, 2000)
    expected = [math.remainder(angle, 2.0 * math.pi) for angle in angles]
    assert elementary.wrap_angle(angles) == pytest.approx(expected, abs=1e-12)
    angles = np.append(angles, math.pi * np.arange(1, 10))
    assert np.array_equal(elementary.wrap_angle(-angles), -elementary.wrap_angle(angles))


def _regularised(speed):
    return elementary.regularised_sign(speed, WIDTH)


def _saturated(speed):
    return elementary.saturated_sign(speed, 1.0 / WIDTH)


@pytest.mark.parametrize("sign", [_regularised, _saturated])
def test_smooth_signs_are_odd_bounded_and_monotone(sign):
    values = np.array([sign(u) for u in np.sort(SPEEDS)])
    assert np.array_equal(values, [-sign(-u) for u in np.sort(SPEEDS)])
    assert sign(0.0) == 0.0
    # Where the exact value is 1 to the last digit, rounding shows: a few ulp, no more.
    assert values.max() <= 1.0 + 5e-16
    assert np.diff(values).min() > -8e-16
    for u in (1e-9, -1e-7):
        assert sign(u) / u == pytest.approx(1.5 / WIDTH, rel=1e-8)


def test_regularised_sign_approaches_one_with_the_fourth_power():
    for ratio in (20.0, 50.0, 100.0):
        gap = 1.0 - _regularised(ratio * WIDTH)
        assert gap == pytest.approx(0.375 * ratio**-4, rel=4.0 / ratio**2)
    assert _regularised(1e9) == pytest.approx(1.0, abs=3e-16)


def test_saturated_sign_is_the_sign_beyond_its_width():
    # 1 / 32 and its inverse are exact, so "at the width" is no matter of rounding.
    for u in (0.03125, 0.04, 1.0, 1e9):
        assert elementary.saturated_sign(u, 32.0) == 1.0
        assert elementary.saturated_sign(-u, 32.0) == -1.0
    assert elementary.saturated_sign(0.031, 32.0) < 1.0


def test_signed_takes_the_sign_of_the_direction_and_zero_counts_as_positive():
    assert elementary.signed(2.0, 0.1) == 2.0
    assert elementary.signed(2.0, -0.1) == -2.0
    assert elementary.signed(2.0, 0.0) == 2.0


def test_rotation_is_cosine_and_sine_over_many_turns_and_exactly_odd():
    rng = np.random.default_rng(0)
    multiples = np.arange(-60, 61) * math.pi / 4.0  # where the quadrant changes
    draws = [rng.uniform(-7, 7, 500), rng.uniform(-1e4, 1e4, 500), rng.uniform(-1e6, 1e6, 5000)]
    angles = np.concatenate([*draws, multiples])
    for angle in angles:
        cosine, sine = elementary.rotation(angle)
        assert abs(cosine - math.cos(angle)) < 2e-15
        assert abs(sine - math.sin(angle)) < 2e-15
        assert elementary.rotation(-angle) == (cosine, -sine)
        assert elementary.rotation.py_func(angle) == (cosine, sine)
