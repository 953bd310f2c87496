"""The bound of identification against closed forms, and the inertia's bias on patches of soil."""

import numpy as np
import pytest

from docs.identification_bound import bound, walks
from docs.inertia_bias import biases, eight


def test_a_constant_regressor_is_averaged():
    steps, variance, slope = 50, 0.3, 2.0
    h = np.full((steps, 1, 1), slope)
    found = bound(h, np.full((steps, 1), variance), np.zeros(1), np.array([[1e9]]))
    n = np.arange(1, steps + 1)
    assert found[:, 0, 0] == pytest.approx(variance / (slope * slope * n), rel=1e-6)


def test_without_equations_the_prior_grows_by_the_walk():
    walk, prior = np.array([0.1, 0.3]), np.array([[1.0, 0.2], [0.2, 2.0]])
    found = bound(np.ones((10, 1, 2)), np.full((10, 1), np.inf), walk, prior)
    assert found[-1] == pytest.approx(prior + 10.0 * np.diag(walk))


def test_a_walk_ends_at_the_solution_of_the_riccati_equation():
    variance, walk = 0.5, 0.02
    found = bound(
        np.ones((500, 1, 1)), np.full((500, 1), variance), np.array([walk]), np.array([[9.0]])
    )
    before = 0.5 * walk + np.sqrt(0.25 * walk * walk + walk * variance)  # P^2 - Q P - Q R = 0
    assert found[-1, 0, 0] == pytest.approx(before - walk, rel=1e-6)


def test_only_what_the_regressors_excite_is_found():
    h = np.tile([[1.0, -1.0]], (400, 1, 1))
    found = bound(h, np.full((400, 1), 1e-6), np.zeros(2), np.eye(2))[-1]
    assert found[0, 0] == pytest.approx(0.5, rel=1e-3)  # the sum stays as unknown as it was
    assert np.array([1.0, -1.0]) @ found @ [1.0, -1.0] < 1e-6


def test_the_walk_of_a_ramp_is_its_change_in_one_second():
    ramp = 0.03 * 0.02 * np.arange(500.0)[:, None]
    assert walks(ramp, 0.02) == pytest.approx([0.03**2 * 0.02])


def medians(modulus):
    """Bias of least squares, coupling and slip share in whole eights on soil of this K [m]."""
    soil = {"shear_deformation_modulus": modulus}
    return np.median(biases({"soil": soil, "reference": eight(2.0)}, count=6), axis=0)


def test_where_all_shear_slides_the_bias_is_that_of_shared_friction_and_its_limit_is_reached():
    fitted, coupling, share = medians(0.003)
    assert share > 0.2
    assert fitted == pytest.approx(coupling, abs=0.03)
    assert coupling == pytest.approx(-share, abs=0.03)


def test_where_shear_is_elastic_belts_slip_as_much_and_the_inertia_is_right():
    fitted, _coupling, share = medians(0.1)
    assert share > 0.2
    assert fitted == pytest.approx(0.0, abs=0.05)
