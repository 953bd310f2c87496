"""Slip on slopes: steady motions against closed forms, mirrors and level ground; the tables."""

import math
import time

import numpy as np
import pytest

from baselines.slip import identified_slip, identified_slope_slip, slope_slip_family, with_friction
from baselines.slip.slip_models import STEEPEST, grades
from baselines.slip.slip_sweep import slip_data, steady_motion
from baselines.slip.slope_motion import LOADS, attitudes, steady_on_slopes
from tracked_env.physics.parameters import VEHICLES
from tracked_env.physics.terrain_motion import NOMINAL_BODY
from tracked_env.physics.terramechanics import GRAVITY

FOCCHI = VEHICLES["focchi"]
# stiff ground: the vehicle tilts less on it
RIGID = NOMINAL_BODY._replace(
    stiffness=3.0 * NOMINAL_BODY.stiffness, damping=3.0 * NOMINAL_BODY.damping
)
TILT = 6.5e-3  # [rad] on the springs, along a slope of 20 degrees


def rolling_free(mu):
    """The light vehicle without motion resistance."""
    return with_friction(FOCCHI, mu)._replace(longitudinal_resistance=0.0)


def straight_slip(grade, load, mu=0.6, speed=5.0, body=NOMINAL_BODY, patches=(10, 4)):
    """Slip ratio at the foot, slip angle [rad] and yaw rate [rad/s] of straight belts.

    A body that is tilted by tau on its springs sees its own speed and that of its belts shortened
    by cos(tau) each, so that tau^2 adds to the slip ratio of v_x.
    """
    v_x, v_y, yaw_rate = steady_on_slopes(
        rolling_free(mu), [[speed, speed]], [grade], load, patches, body, tolerance=1e-6
    )[0]
    belt = FOCCHI.sprocket_radius * speed
    tau = TILT * abs(grade[0]) / math.tan(math.radians(20.0))
    return (belt - v_x) / belt - tau * tau, math.atan(v_y / v_x), yaw_rate


def tilted(slope, h=0.25):
    """Grade along the body of a vehicle that climbs a slope [rad] and tilts on its springs."""
    p = FOCCHI
    area = 2.0 * p.track_width * p.contact_length
    stiffness = NOMINAL_BODY.stiffness * area * (0.5 * p.contact_length) ** 2 / 3.0
    tilt = 0.0
    for _ in range(20):
        moment = p.mass * GRAVITY * math.cos(slope) * h * math.tan(slope + tilt)
        tilt = math.asin(moment / stiffness)
    return -math.tan(slope + tilt)


def test_straight_slip_on_a_slope_is_that_of_the_closed_form_with_uniform_load():
    """tan(s)/mu = 1 - (1 - exp(-u))/u with u = 2 l i / K; 3.261e-3 at 20 degrees and mu 0.6."""
    grade = (tilted(math.radians(20.0)), 0.0)
    slip, _alpha, _yaw_rate = straight_slip(grade, "uniform", patches=(80, 1))
    assert slip == pytest.approx(3.261e-3, rel=0.005)
    u = FOCCHI.contact_length * slip / FOCCHI.shear_deformation_modulus
    balance = 1.0 - (1.0 - math.exp(-u)) / u
    assert balance == pytest.approx(math.tan(math.radians(20.0)) / 0.6, rel=0.005)


def test_slip_is_less_climbing_and_more_descending_with_nonuniform_load():
    """2.31e-3 and 4.8e-3 at 20 degrees and mu 0.6: load sits where the soil is sheared most."""
    grade = tilted(math.radians(20.0))
    assert straight_slip((grade, 0.0), "nonuniform")[0] == pytest.approx(2.31e-3, rel=0.01)
    assert straight_slip((-grade, 0.0), "nonuniform")[0] == pytest.approx(-4.8e-3, rel=0.03)
    # Backwards down the same slope the front is behind: the same slip.
    assert straight_slip((grade, 0.0), "nonuniform", speed=-5.0)[0] == pytest.approx(
        straight_slip((-grade, 0.0), "nonuniform")[0], rel=1e-4
    )


def test_on_a_side_slope_the_vehicle_drifts_and_its_nose_turns_downhill():
    """20 degrees, mu 0.6, 0.5 m/s, nonuniform: 3.00 mrad and 1.17 mrad/s."""
    speed = 0.5 / FOCCHI.sprocket_radius
    down_to_the_right = (0.0, -math.tan(math.radians(20.0)))
    _slip, alpha, yaw_rate = straight_slip(down_to_the_right, "nonuniform", speed=speed, body=RIGID)
    assert alpha == pytest.approx(-3.0e-3, rel=0.05)
    assert yaw_rate == pytest.approx(-1.17e-3, rel=0.1)


@pytest.mark.parametrize("load", LOADS)
def test_mirrored_and_turned_about_the_motion_is_the_same(load):
    rng = np.random.default_rng(3)
    speeds, slopes = rng.uniform(-8.0, 8.0, (40, 2)), rng.uniform(-0.2, 0.2, (40, 2))
    motion = steady_on_slopes(FOCCHI, speeds, slopes, load)
    mirrored = steady_on_slopes(FOCCHI, speeds[:, ::-1], slopes * [1.0, -1.0], load)
    turned = steady_on_slopes(FOCCHI, -speeds[:, ::-1], -slopes, load)
    np.testing.assert_allclose(mirrored, motion * [1.0, -1.0, -1.0], atol=2e-5)
    np.testing.assert_allclose(turned, motion * [-1.0, -1.0, 1.0], atol=2e-5)


@pytest.mark.parametrize("load", LOADS)
def test_on_level_ground_with_a_low_centre_of_mass_it_is_the_planar_plant(load):
    """Without motion resistance, which opposes each patch here and each track there."""
    low = NOMINAL_BODY._replace(height=1e-3, height_ratio=0.0)
    rng = np.random.default_rng(4)
    speeds = rng.uniform(-8.0, 8.0, (40, 2))
    p, level = rolling_free(0.4), np.zeros((40, 2))
    motion = steady_on_slopes(p, speeds, level, load, body=low, tolerance=1e-5)
    np.testing.assert_allclose(motion, steady_motion(p, *speeds.T), atol=3e-5)


def test_a_vehicle_on_ground_steeper_than_its_friction_has_no_steady_motion():
    slopes = [(0.5, 0.0), (0.0, 0.5), (-0.4, 0.4), (0.2, 0.1)]
    motion = steady_on_slopes(FOCCHI, [[5.0, 6.0]] * 4, slopes)
    np.testing.assert_array_equal(np.isnan(motion).any(axis=1), [True, True, True, False])


def test_grade_and_attitude_are_inverse_and_have_the_sign_of_gravity_in_the_body():
    rng = np.random.default_rng(5)
    roll, pitch = rng.uniform(-1.0, 1.0, (2, 100))
    np.testing.assert_allclose(attitudes(grades(roll, pitch)), np.stack([roll, pitch], axis=1))
    nose_down, left_up = grades(0.0, 0.1)[0], grades(0.1, 0.0)[0]
    assert nose_down[0] > 0.0  # gravity pulls forward
    assert left_up[1] < 0.0  # and to the right


@pytest.mark.slow
def test_the_table_agrees_with_runs_between_its_nodes():
    rng = np.random.default_rng(6)
    mean, turn = rng.uniform(1.5, 7.0, 200), rng.uniform(-1.5, 1.5, 200)
    slopes = 0.3 * rng.uniform(-1.0, 1.0, (200, 2)) / math.sqrt(2.0)
    left, right = mean - turn, mean + turn
    motion = steady_on_slopes(FOCCHI, np.stack([left, right], axis=1), slopes)
    beta_left, beta_right, alpha = identified_slope_slip(FOCCHI).on(slopes).slip(left, right)
    true = slip_data(FOCCHI, left, right, motion)
    assert np.median(np.abs(beta_left - true.beta_left)) < 5e-4
    for error in (beta_left - true.beta_left, beta_right - true.beta_right):
        assert np.percentile(np.abs(error), 95) < 3e-3
    assert np.median(np.abs(alpha - true.alpha)) < 2e-3
    assert np.percentile(np.abs(alpha - true.alpha), 95) < 8e-3
    assert np.std(true.alpha) > 0.03


@pytest.mark.slow
def test_slip_that_gravity_adds_in_a_turn_starts_at_the_smallest_turn():
    """Patches that slide sideways let gravity drag the vehicle: in proportion to |w|."""
    model = identified_slope_slip(FOCCHI).on(np.array([[0.0, -0.2]]))
    turn = np.array([-0.6, -0.3, 0.0, 0.3, 0.6])
    alpha = model.slip(5.0 - turn, 5.0 + turn)[2]
    assert (np.abs(alpha[[1, 3]] - alpha[2]) > 0.004).all()
    assert abs(alpha[2]) < 0.004
    left, right = np.full(3, 5.0), 5.0 + np.array([-1e-4, 0.0, 1e-4])
    np.testing.assert_allclose(model.slip(left, right)[2], alpha[2], atol=1e-5)


def test_beyond_what_friction_holds_slip_is_that_of_the_nearest_slope_and_says_so():
    model = identified_slope_slip(FOCCHI)
    steep, nearest = np.array([[0.6, 0.8]]), 0.4 * STEEPEST * np.array([[0.6, 0.8]])
    left, right = np.array([4.0]), np.array([6.0])
    np.testing.assert_allclose(
        model.on(steep).slip(left, right), model.on(nearest).slip(left, right), rtol=1e-9
    )
    assert not model.family.holds(left, right, steep, 0.4)
    assert model.family.holds(left, right, [[0.1, 0.1]], 0.4)
    assert np.isnan(model.on(np.array([[np.nan, 0.0]])).slip(left, right)[2])


def test_a_family_between_two_frictions_agrees_with_the_sweep_of_one_between():
    family = slope_slip_family(FOCCHI, (0.3, 0.5))
    single = identified_slope_slip(with_friction(FOCCHI, 0.4), "nonuniform", 2.5, 0.21875)
    rng = np.random.default_rng(7)
    left, right = rng.uniform(1.0, 7.0, (2, 300))
    slopes = rng.uniform(-0.15, 0.15, (300, 2))
    between = family.at(0.4).on(slopes).slip(left, right)
    for estimate, true in zip(between, single.on(slopes).slip(left, right), strict=True):
        assert np.median(np.abs(estimate - true)) < min(0.003, 0.1 * np.std(true))


@pytest.mark.parametrize(("sloped", "bar"), [(False, 0.5e-6), (True, 1e-7)])
def test_a_look_up_takes_less_than_a_microsecond_and_on_slopes_a_tenth_of_it(sloped, bar):
    rng = np.random.default_rng(8)
    count = 20000
    left, right = rng.uniform(-10.0, 10.0, (2, count))
    model = identified_slope_slip(FOCCHI) if sloped else identified_slip(FOCCHI)
    model = model.on(rng.uniform(-0.25, 0.25, (count, 2)))
    model.slip(left, right)
    best = math.inf
    for _ in range(20):
        begin = time.process_time()
        model.slip(left, right)
        best = min(best, time.process_time() - begin)
    assert best / count < 2.0 * bar  # twice the bar, for a machine that is busy
