"""Slip surfaces: near their models, mirrored, with the sign of slip, and over friction."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.planners.slip_surface import surface_of
from baselines.slip.slip_regression import ExponentialSlipModel
from baselines.slip.slip_sweep import identified_slip, slip_family
from tests.baselines.planners.planner_cases import motion_on, refused, vehicle_on
from tracked_env.physics.parameters import VEHICLES

FOCCHI = VEHICLES["focchi"]
STEEP = ExponentialSlipModel([[0.1, 2.0], [-0.1, 2.0], [1.6, 1.0]], 0.606)
EXPONENTIAL = ExponentialSlipModel([[0.1, 2.0], [-0.12, 2.5], [0.4, 1.5]], FOCCHI.track_gauge)


def surface_on(vehicle="focchi", mu=0.4, limit=18.0, fastest=0.4):
    """(surface, table, parameters) of a vehicle on friction mu, identified up to a limit."""
    parameters, table = vehicle_on(mu, vehicle, limit)
    return surface_of(table, parameters, limit, fastest), table, parameters


def belts(limit, count=40):
    """Belt speeds p, q of a moving vehicle whose sprockets are within the limit."""
    radius = FOCCHI.sprocket_radius
    axes = np.linspace(0.1, 0.4, count), np.linspace(-0.5, 0.5, count)
    p, q = (speeds.ravel() for speeds in np.meshgrid(*axes))
    inside = p + np.abs(q) <= radius * limit
    return p[inside], q[inside]


def motion_of(model, p, q, radius, half_gauge):
    """v_x, v_y, w of a slip model by F (27) and (29) with beta = r omega - v."""
    left, right = (p - q) / radius, (p + q) / radius
    beta_left, beta_right, alpha = model.slip(left, right)
    v_left, v_right = radius * left - beta_left, radius * right - beta_right
    v_x = 0.5 * (v_left + v_right)
    return np.stack([v_x, v_x * np.tan(alpha), 0.5 * (v_right - v_left) / half_gauge], axis=1)


@pytest.mark.parametrize(
    ("vehicle", "mu", "limit", "allowed"),
    [
        ("focchi", 0.4, 10.0, 0.7e-3),
        ("focchi", 0.4, 18.0, 2.0e-3),
        ("focchi", 0.1, 10.0, 2.0e-3),
        ("focchi-short", 0.4, 18.0, 1.5e-3),
        ("focchi-short", 0.1, 10.0, 2.0e-3),
    ],
)
def test_a_surface_is_within_millimetres_a_second_of_the_table_it_is_fitted_to(
    vehicle, mu, limit, allowed
):
    surface, table, parameters = surface_on(vehicle, mu, limit)
    p, q = belts(limit)
    half = 0.5 * parameters.track_gauge
    off = motion_on(surface, p, q) - motion_of(table, p, q, parameters.sprocket_radius, half)
    off[:, 2] *= half
    assert np.sqrt(np.mean(off**2, axis=0)).max() < allowed


def test_slip_turns_a_vehicle_less_than_its_belts_would():
    for mu in (0.1, 0.4):
        surface, _, parameters = surface_on(mu=mu, limit=10.0)
        p, q = belts(10.0)
        turning = np.abs(q) > 0.05
        unslipped = q[turning] / (0.5 * parameters.track_gauge)
        ratio = motion_on(surface, p, q)[turning, 2] / unslipped
        assert ((ratio > 0.0) & (ratio < 0.95)).all()


def test_turns_and_gears_are_mirrored_and_a_turn_on_the_spot_goes_nowhere():
    surface, _, _ = surface_on()
    p, q = belts(18.0)
    left, right, reverse = (
        motion_on(surface, p, q),
        motion_on(surface, p, -q),
        motion_on(surface, -p, q),
    )
    np.testing.assert_allclose(right, left * [1.0, -1.0, -1.0], atol=1e-15)
    np.testing.assert_allclose(reverse, left * [-1.0, -1.0, 1.0], atol=1e-15)
    v_x, v_y, turn = motion_on(surface, np.zeros(9), np.linspace(0.1, 1.5, 9)).T  # on the spot
    assert (v_x == 0.0).all() and (v_y == 0.0).all() and (turn > 0.0).all()


def test_the_exponential_form_is_taken_as_it_is():
    surface = surface_of(EXPONENTIAL, FOCCHI, 18.0, 0.4)
    p, q = belts(18.0)
    exact = motion_of(EXPONENTIAL, p, q, FOCCHI.sprocket_radius, 0.5 * FOCCHI.track_gauge)
    np.testing.assert_allclose(motion_on(surface, p, q), exact, atol=1e-12)


def test_no_slip_moves_as_the_belts():
    surface = surface_of(None, FOCCHI, 18.0, 0.4)
    expected = [0.3, 0.0, 0.2 / (0.5 * FOCCHI.track_gauge)]
    np.testing.assert_allclose(motion_on(surface, 0.3, 0.2), [expected], atol=1e-15)


def test_surfaces_of_a_family_are_near_those_of_its_soils_and_continuous_in_friction():
    family = slip_family(FOCCHI)
    p, q = belts(10.0)

    def motion(mu):
        return motion_on(surface_of(family.at(mu), FOCCHI, 10.0, 0.4), p, q)

    for mu in (0.1, 0.2, 0.4):
        own = motion_on(surface_on(mu=mu, limit=10.0)[0], p, q)
        assert np.sqrt(np.mean((motion(mu) - own)[:, :2] ** 2)) < 4e-3
    for mu in family.frictions[1:-1]:
        np.testing.assert_allclose(motion(mu * (1.0 - 1e-9)), motion(mu * (1.0 + 1e-9)), atol=1e-7)


def test_an_estimator_is_its_family_at_the_friction_it_estimates():
    family = slip_family(FOCCHI)
    estimator = SimpleNamespace(family=family, friction=np.array([0.1]))  # what a plan reads
    expected = surface_of(family.at(0.1), FOCCHI, 10.0, 0.4)
    assert (surface_of(estimator, FOCCHI, 10.0, 0.4).terms == expected.terms).all()
    estimator.friction[:] = 0.4  # it has learnt: not the surface of before
    assert (surface_of(estimator, FOCCHI, 10.0, 0.4).terms != expected.terms).any()


@pytest.mark.parametrize(
    ("model", "limit", "message"),
    [
        (identified_slip(FOCCHI), 18.0, "sprocket speed = 18 rad/s; the slip model ends at 10"),
        (slip_family(FOCCHI).at([0.1, 0.4]), 10.0, "must be one number for a plan"),
        (slip_family(FOCCHI).at(math.nan), 10.0, "must be one number for a plan"),
        (STEEP, 10.0, "c_1 of alpha = 1.6 rad"),
    ],
)
def test_a_model_that_makes_no_surface_is_refused_in_one_line(model, limit, message):
    refused(lambda: surface_of(model, FOCCHI, limit, 0.4), message)
