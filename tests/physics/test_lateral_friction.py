"""Lateral friction against quadrature, its antiderivatives, closed forms and Wong's moment."""

import decimal
import itertools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from tracked_env.physics import terramechanics as soil
from tracked_env.physics.elementary import regularised_sign
from tracked_env.physics.parameters import VEHICLES

EPS = soil.LATERAL_FRICTION_REGULARISATION
STRAWA = VEHICLES["strawa"]
LENGTH = STRAWA.contact_length
WEIGHT = STRAWA.mass * soil.GRAVITY
INTENSITY = STRAWA.lateral_resistance * WEIGHT / LENGTH  # [N/m] q


def _friction_by_quadrature(v, w):
    """F_y [N] and M [N m] by adaptive quadrature, split around the zero of v + s w."""
    half = 0.5 * LENGTH
    cuts = [-half, half]
    if w != 0.0:
        cuts += [(n * EPS - v) / w for n in (-30.0, -3.0, -1.0, 0.0, 1.0, 3.0, 30.0)]
    cuts = sorted(c for c in cuts if -half <= c <= half)

    def integral(f):
        parts = [quad(f, a, b, epsabs=1e-15, epsrel=1e-11)[0] for a, b in itertools.pairwise(cuts)]
        return math.fsum(parts)

    force = -INTENSITY * integral(lambda s: regularised_sign(v + s * w, EPS))
    moment = -INTENSITY * integral(lambda s: s * regularised_sign(v + s * w, EPS))
    return force, moment


def _friction_in_150_digits(v, w):
    """The same integrals from the antiderivatives G and G2 in 150 decimal digits; w != 0."""
    with decimal.localcontext() as context:
        context.prec = 150
        v, w, length, eps = (decimal.Decimal(float(x)) for x in (v, w, LENGTH, EPS))

        def root(u):
            return (u * u + eps * eps).sqrt()

        def first(u):
            return (2 * u * u + eps * eps) / (2 * root(u))

        def second(u):
            return u * root(u) / 2

        half = length / 2
        a, b = v - half * w, v + half * w
        force = (first(b) - first(a)) / w
        moment = half * (first(b) + first(a)) / w - (second(b) - second(a)) / (w * w)
        return -INTENSITY * float(force), -INTENSITY * float(moment)


@pytest.mark.filterwarnings("ignore::scipy.integrate.IntegrationWarning")  # at its own rounding
def test_lateral_friction_is_the_integral_of_the_regularised_sign():
    speeds = np.concatenate([-np.logspace(-3, 2, 13), [0.0], np.logspace(-3, 2, 13)])
    worst = 0.0
    for v, w in itertools.product(speeds, speeds):
        force, moment = soil.lateral_friction(v, w, INTENSITY, LENGTH)
        expected_force, expected_moment = _friction_by_quadrature(v, w)
        # Quadrature itself cannot resolve a moment below rounding of the whole q l^2 / 4.
        floor_force, floor_moment = 1e-14 * INTENSITY * LENGTH, 1e-14 * INTENSITY * LENGTH**2
        gap_force = max(abs(force - expected_force) - floor_force, 0.0)
        gap_moment = max(abs(moment - expected_moment) - floor_moment, 0.0)
        worst = max(worst, gap_force / max(abs(expected_force), 1e-300))
        worst = max(worst, gap_moment / max(abs(expected_moment), 1e-300))
    assert worst < 1e-9


def test_lateral_friction_loses_no_digits_at_tiny_and_huge_speeds():
    draws = np.random.default_rng(3)
    pairs = 10.0 ** draws.uniform(-12, 6, (3000, 2)) * draws.choice([-1.0, 1.0], (3000, 2))
    on_the_edge = [(x * w, w) for w in (1e-9, 0.2, 50.0) for x in (0.9999999, 1.0, 1.0000001)]
    worst = 0.0
    for v, w in itertools.chain(pairs, on_the_edge):
        force, moment = soil.lateral_friction(v, w, INTENSITY, LENGTH)
        expected_force, expected_moment = _friction_in_150_digits(v, w)
        worst = max(worst, abs(force / expected_force - 1.0), abs(moment / expected_moment - 1.0))
    assert worst < 1e-13


def test_lateral_friction_of_pure_sliding_and_of_pure_turning_is_exact():
    assert soil.lateral_friction(0.0, 0.0, INTENSITY, LENGTH) == (0.0, 0.0)
    for v in (-40.0, 1e-7, 0.03, 2.0):
        force, moment = soil.lateral_friction(v, 0.0, INTENSITY, LENGTH)
        expected = -INTENSITY * LENGTH * regularised_sign(v, EPS)
        assert force == pytest.approx(expected, rel=1e-14)
        assert moment == 0.0
        assert soil.lateral_friction(0.0, v, INTENSITY, LENGTH)[0] == 0.0


def test_without_regularisation_the_moment_is_the_printed_one_without_its_factor_of_two():
    # The regularised sign depends on u / eps only: huge speeds are the limit eps -> 0.
    w = 1e6
    for x_icr in (-0.99, -0.3, 0.0, 0.05, 0.5, 0.9):
        for sense in (-1.0, 1.0):
            force, moment = soil.lateral_friction(-x_icr * w * sense, w * sense, INTENSITY, LENGTH)
            assert moment == pytest.approx(
                -sense * INTENSITY * (LENGTH**2 / 4.0 - x_icr**2), rel=1e-9
            )
            # F_y = 2 q x_icr sign(w), whatever the sign of x_icr.
            assert force == pytest.approx(sense * 2.0 * INTENSITY * x_icr, rel=1e-9)


def test_a_pivot_turn_meets_the_moment_of_wong():
    # Wong, Theory of Ground Vehicles: M_r = mu_t W l / 4.
    expected = STRAWA.lateral_resistance * WEIGHT * LENGTH / 4.0
    assert soil.lateral_friction(0.0, 1e6, INTENSITY, LENGTH)[1] == pytest.approx(-expected)
    assert expected == pytest.approx(5690.0, rel=1e-3)


def test_beyond_the_track_ends_the_whole_track_slides_one_way():
    for v in (1.0001e6, 5e6):
        force, moment = soil.lateral_friction(v, 1e6, INTENSITY, LENGTH)
        assert force == pytest.approx(-INTENSITY * LENGTH, rel=1e-6)
        assert abs(moment) < 1e-6 * INTENSITY * LENGTH**2


def test_lateral_friction_is_bounded_dissipative_and_odd_bit_for_bit():
    draws = np.random.default_rng(4)
    for v, w in 10.0 ** draws.uniform(-9, 4, (2000, 2)):
        force, moment = soil.lateral_friction(v, w, INTENSITY, LENGTH)
        assert -INTENSITY * LENGTH * (1.0 + 1e-15) <= force < 0.0
        assert -INTENSITY * LENGTH**2 / 4.0 * (1.0 + 1e-15) <= moment < 0.0
        assert soil.lateral_friction(-v, w, INTENSITY, LENGTH) == (-force, moment)
        assert soil.lateral_friction(v, -w, INTENSITY, LENGTH) == (force, -moment)
        assert soil.lateral_friction(-v, -w, INTENSITY, LENGTH) == (-force, -moment)
        assert force * v + moment * w < 0.0
