"""Focchi et al. (2025), figures 10 and 12 to 14, run again: what must come out."""

import numpy as np
import pytest

from reproduce.focchi2025 import control, predicted_slip
from reproduce.focchi2025.claims import prediction
from reproduce.focchi2025.control import LENGTHS, RESISTANCE, Case, Run, vehicle

RATE = 50  # [Hz] of control


def cases(*kinds, **fields):
    """Both lengths at RATE."""
    return [Case(kind, length, RATE, **fields) for length in LENGTHS for kind in kinds]


@pytest.fixture(scope="module")
def driven():
    """Errors after 3 s of the chicane, two vehicles each."""
    asked = cases("uc", "table", "exponential, slow")
    asked += cases("uc", "table", resistance=0.0, believed_resistance=0.0)
    for true, told in control.SOILS:
        asked += cases("table", "online", friction=true, believed=told)
        asked += cases("table", friction=true, believed=true)
    runs = control.drive(list(dict.fromkeys(asked)), seeds=2)
    return {case: run.numbers() for case, run in runs.items()}


@pytest.mark.parametrize("length", LENGTHS)
def test_the_slippage_aware_controller_stays_within_3_cm_and_the_unicycle_one_does_not(
    driven, length
):
    aware, blind = driven[Case("table", length, RATE)], driven[Case("uc", length, RATE)]
    assert aware.largest < 0.03
    assert blind.largest > 4.0 * aware.largest
    assert aware.heading < blind.heading


def test_the_unicycle_controller_is_a_tenth_of_a_metre_off_with_a_contact_length_of_half_a_metre(
    driven,
):
    assert driven[Case("uc", 0.5, RATE)].largest == pytest.approx(0.10, abs=0.03)
    assert driven[Case("uc", 0.7, RATE)].largest > 0.2


def test_slip_is_predicted_in_the_turns_and_not_after_the_jumps():
    case = Case("table", 0.7, RATE)
    run = control.drive([case], seeds=1)[case]
    told = predicted_slip(case, run)
    for size, error, jump in prediction({case: run}, {case: told}, case).values():
        assert error < 0.2 * size
        assert jump > 4.0 * error
    alpha = run.slip(vehicle())[2][:, 0]
    for start, end, sign in ((5.0, 12.0, -1.0), (14.0, 20.0, 1.0)):  # left turn, then right
        assert (sign * alpha[(run.time >= start) & (run.time < end)] > 0.01).all()


@pytest.mark.parametrize("length", LENGTHS)
def test_rolling_resistance_makes_both_controllers_worse(driven, length):
    for kind in control.KINDS:
        free = driven[Case(kind, length, RATE, resistance=0.0, believed_resistance=0.0)]
        assert free.largest < 0.95 * driven[Case(kind, length, RATE)].largest


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize(("true", "told"), control.SOILS)
def test_slip_identified_on_line_makes_up_for_the_wrong_friction(driven, length, true, told):
    known = driven[Case("table", length, RATE, true, true)]
    wrong = driven[Case("table", length, RATE, true, told)]
    online = driven[Case("online", length, RATE, true, told)]
    assert wrong.largest > 1.3 * known.largest
    assert online.largest < 1.2 * known.largest and online.rmse < 1.2 * known.rmse


@pytest.mark.parametrize("length", LENGTHS)
def test_the_exponential_form_of_slow_runs_is_between_the_table_and_no_slip_at_all(driven, length):
    middle = driven[Case("exponential, slow", length, RATE)].largest
    assert driven[Case("table", length, RATE)].largest < middle
    assert middle < driven[Case("uc", length, RATE)].largest


def test_vehicles_of_a_case_differ_by_their_noise_and_cases_share_it():
    quiet = Case("uc", rate=RATE, noise=0.0)
    asked = [quiet, quiet._replace(noise=0.02), quiet._replace(noise=0.04)]
    runs = control.drive(asked, seeds=2, duration=0.1)
    assert not np.ptp(runs[quiet].sprockets[1], axis=1).any()
    once, twice = (runs[case].sprockets[1] - runs[quiet].sprockets[1] for case in asked[1:])
    assert np.abs(once).min() > 0.0 and np.ptp(once, axis=1).min() > 0.0
    np.testing.assert_allclose(twice, 2.0 * once, atol=1e-5)  # actions are float32


def test_the_closed_loop_on_patches_moves_as_the_environment_does():
    case = Case("uc", rate=200, noise=0.0)
    inside = control.drive([case], seeds=1, duration=4.0)[case]
    policy = control.policy(case)
    outside = control.follow(
        policy, control.patches(vehicle(), 1, False, 2.5e-3),
        control.sampled([control.reading("v_max t")], 200.0, 4.0), control.START, vehicle(), 200.0,
    )  # fmt: skip
    np.testing.assert_allclose(outside.reference, inside.reference, atol=1e-9)
    np.testing.assert_allclose(outside.state, inside.state, atol=1e-4)


def test_a_vehicle_at_rest_has_no_slip_angle_and_a_moving_one_that_of_its_velocity():
    state = np.zeros((2, 6, 1))
    state[1, 3:, 0] = 0.2, -0.05, 0.3
    rest = np.zeros((2, 2, 1))
    run = Run(np.arange(2.0), state, rest, np.zeros((2, 3, 1)), {})
    left, right, alpha = run.slip(vehicle())
    half = 0.5 * vehicle().track_gauge
    np.testing.assert_allclose(left[:, 0], [0.0, -(0.2 - half * 0.3)])
    np.testing.assert_allclose(right[:, 0], [0.0, -(0.2 + half * 0.3)])
    np.testing.assert_allclose(alpha[:, 0], [np.nan, np.arctan(-0.25)])


@pytest.mark.parametrize(
    ("name", "start", "end"),
    [("v_max t", 0.0, 0.4), ("v_max t / t_1", 0.0, 0.2), ("v_max (t - t_1)", -0.4, 0.0)],
)
def test_the_ramp_of_the_chicane_has_three_readings(name, start, end):
    profile = control.reading(name)
    assert profile.speed[0, 0] == pytest.approx(start)
    assert profile.speed[3, 0] + 0.5 * profile.speed[3, 1] == pytest.approx(end)
    assert (profile.speed[4:, 0] == 0.2).all() and not profile.speed[4:, 1].any()


def test_explicit_euler_with_1_ms_drives_the_same_chicane(monkeypatch):
    monkeypatch.setattr(control, "DURATION", 8.0)
    runs = control.integrators()
    reference = runs["Rosenbrock, 1 ms", "table"].numbers().largest
    for (name, kind), run in runs.items():
        if kind == "table":
            assert run.numbers().largest == pytest.approx(reference, abs=1e-3), name


@pytest.fixture(scope="module")
def spirals():
    return control.spirals(duration=16.0)


def test_on_the_spiral_the_lyapunov_function_falls_for_the_slippage_aware_controller_only(spirals):
    uc, slc = spirals["uc"], spirals["slc"]
    assert slc.value[0] == pytest.approx(0.11, abs=0.005)
    assert slc.value[-1] < 0.02 * slc.value[0] and slc.rises < 1e-3
    assert uc.rises > 0.05
    assert slc.run.distance[-1, 0] < 0.2 * uc.run.distance[-1, 0]


def test_the_spiral_as_printed_is_too_fast_for_the_sprockets():
    assert control.beyond_after(vehicle()) == pytest.approx(0.459, abs=0.001)
    assert control.beyond_after(vehicle(), control.YAW_ACCELERATION) > control.SPIRAL_TIME


def test_the_vehicle_is_that_of_table_2():
    made = vehicle()
    assert (made.mass, made.inertia, made.track_gauge) == (62.0, 4.5, 0.606)
    assert (made.contact_length, made.sprocket_radius) == (0.7, 0.0856)
    assert np.tan(made.friction_angle) == pytest.approx(0.1)
    assert made.longitudinal_resistance == RESISTANCE == 0.025
    assert made.shear_deformation_modulus == 0.001 and made.cohesion == 0.0
