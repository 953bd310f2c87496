"""The bias of the inertia on patches of soil: what friction along the slip velocity leaves over."""

import numpy as np
import pytest

from docs.inertia_bias import biases, eight


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
