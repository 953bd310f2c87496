"""Focchi et al. (2025), figures 10 and 12 to 14, run again: what must come out."""

import numpy as np
import pytest

from reproduce.focchi2025 import control, predicted_slip
from reproduce.focchi2025.claims import prediction
from reproduce.focchi2025.control import LENGTHS, RESISTANCE, Case, slip_of, vehicle
from reproduce.policy_runs import GOAL, MOTION, SPROCKETS, Drive, follow, sampled

RATE = 50  # [Hz] of control


def cases(*kinds, **fields):
    """Both lengths at RATE."""
    return [Case(kind, length, RATE, **fields) for length in LENGTHS for kind in kinds]


@pytest.fixture(scope="module")
def errors():
    """Errors after 3 s of the chicane, two vehicles each."""
    every = cases("uc", "table", "exponential, slow")
    every += cases("uc", "table", resistance=0.0, assumed_resistance=0.0)
    for true, assumed in control.SOILS:
        every += cases("table", "online", friction=true, assumed=assumed)
        every += cases("table", friction=true, assumed=true)
    runs = control.drive(list(dict.fromkeys(every)), seeds=2)
    return {case: control.numbers(run) for case, run in runs.items()}


@pytest.mark.slow
@pytest.mark.parametrize("length", LENGTHS)
def test_the_slippage_aware_controller_stays_within_3_cm_and_the_unicycle_one_does_not(
    errors, length
):
    aware, blind = errors[Case("table", length, RATE)], errors[Case("uc", length, RATE)]
    assert aware.largest < 0.03
    assert blind.largest > 4.0 * aware.largest
    assert aware.heading < blind.heading


@pytest.mark.slow
def test_the_unicycle_controller_is_a_tenth_of_a_metre_off_with_a_contact_length_of_half_a_metre(
    errors,
):
    assert errors[Case("uc", 0.5, RATE)].largest == pytest.approx(0.10, abs=0.03)
    assert errors[Case("uc", 0.7, RATE)].largest > 0.2


def test_slip_is_predicted_in_the_turns_and_not_after_the_jumps():
    case = Case("table", 0.7, RATE)
    run = control.drive([case], seeds=1)[case]
    expected = predicted_slip(case, run)
    for size, error, jump in prediction({case: run}, {case: expected}, case).values():
        assert error < 0.2 * size
        assert jump > 4.0 * error
    alpha = slip_of(run, vehicle())[2][:, 0]
    for start, end, sign in ((5.0, 12.0, -1.0), (14.0, 20.0, 1.0)):  # left turn, then right
        assert (sign * alpha[(run.time >= start) & (run.time < end)] > 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("length", LENGTHS)
def test_rolling_resistance_makes_both_controllers_worse(errors, length):
    for kind in control.KINDS:
        free = errors[Case(kind, length, RATE, resistance=0.0, assumed_resistance=0.0)]
        assert free.largest < 0.95 * errors[Case(kind, length, RATE)].largest


@pytest.mark.slow
@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize(("true", "assumed"), control.SOILS)
def test_slip_identified_on_line_makes_up_for_the_wrong_friction(errors, length, true, assumed):
    right = errors[Case("table", length, RATE, true, true)]
    wrong = errors[Case("table", length, RATE, true, assumed)]
    online = errors[Case("online", length, RATE, true, assumed)]
    assert wrong.largest > 1.3 * right.largest
    assert online.largest < 1.2 * right.largest and online.rmse < 1.2 * right.rmse


@pytest.mark.slow
@pytest.mark.parametrize("length", LENGTHS)
def test_the_exponential_form_of_slow_runs_is_between_the_table_and_no_slip_at_all(errors, length):
    middle = errors[Case("exponential, slow", length, RATE)].largest
    assert errors[Case("table", length, RATE)].largest < middle
    assert middle < errors[Case("uc", length, RATE)].largest


def test_vehicles_of_a_case_differ_by_their_noise_and_cases_share_it():
    quiet = Case("uc", rate=RATE, noise=0.0)
    noises = [quiet, quiet._replace(noise=0.02), quiet._replace(noise=0.04)]
    runs = control.drive(noises, seeds=2, duration=0.1)
    speeds = {case: np.stack([run.truth[n][1] for n in SPROCKETS]) for case, run in runs.items()}
    assert not np.ptp(speeds[quiet], axis=1).any()
    once, twice = (speeds[case] - speeds[quiet] for case in noises[1:])
    assert np.abs(once).min() > 0.0 and np.ptp(once, axis=1).min() > 0.0
    np.testing.assert_allclose(twice, 2.0 * once, atol=1e-5)  # actions are float32


def test_the_closed_loop_on_patches_moves_as_the_environment_does():
    case = Case("uc", rate=200, noise=0.0)
    inside = control.drive([case], seeds=1, duration=4.0)[case]
    reference = sampled([control.reading("v_max t")], 200.0, 4.0)
    plant = control.patches(vehicle(), 1, False, 2.5e-3)
    outside = follow(control.policy(case), plant, reference, control.START, vehicle(), 200.0)
    for names, tolerance in ((GOAL, 1e-9), (MOTION, 1e-4)):
        for name in names:
            np.testing.assert_allclose(outside.truth[name], inside.truth[name], atol=tolerance)


def test_a_vehicle_at_rest_has_no_slip_angle_and_a_moving_one_that_of_its_velocity():
    truth = {name: np.zeros((2, 1)) for name in (*MOTION, *SPROCKETS)}
    truth["v_x"][1], truth["v_y"][1], truth["yaw_rate"][1] = 0.2, -0.05, 0.3
    run = Drive(np.arange(2.0), truth, {}, np.empty((0, 1, 0), dtype=np.float32))
    left, right, alpha = slip_of(run, vehicle())
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


@pytest.mark.slow
def test_explicit_euler_with_1_ms_drives_the_same_chicane(monkeypatch):
    monkeypatch.setattr(control, "DURATION", 8.0)
    errors = control.integrators()
    reference = errors["Rosenbrock, 1 ms", "table"].largest
    for (name, kind), one in errors.items():
        if kind == "table":
            assert one.largest == pytest.approx(reference, abs=1e-3), name


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
    table_2 = vehicle()
    assert (table_2.mass, table_2.inertia, table_2.track_gauge) == (62.0, 4.5, 0.606)
    assert (table_2.contact_length, table_2.sprocket_radius) == (0.7, 0.0856)
    assert np.tan(table_2.friction_angle) == pytest.approx(0.1)
    assert table_2.longitudinal_resistance == RESISTANCE == 0.025
    assert table_2.shear_deformation_modulus == 0.001 and table_2.cohesion == 0.0
