"""Strawa et al. (2021), section 8, run again: what must come out."""

import math

import numpy as np
import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import COLUMN
from baselines.estimators.turning import TurningEstimator
from baselines.registry import nominal
from reproduce.strawa2021 import identification as ident
from reproduce.strawa2021 import soil as soils
from reproduce.strawa2021.control import CASES, SETTLED, run_all, surface
from reproduce.strawa2021.identification import Condition, PaperPolicy, as_in_paper, as_printed
from reproduce.strawa2021.soil import printed_gnr
from tests.baselines.episodes import context, interquartile_mean, run
from tests.baselines.estimators.motion_cases import (
    CLAY,
    EXACT,
    LATERAL_MODELS,
    RTK,
    TRUTH,
    follow,
    measurements,
    true_across,
    turning,
    with_lateral_model,
)
from tracked_env.physics import terramechanics

STEADY = {"v_x": 1e-6, "v_y": 1e-6, "yaw_rate": 1e-6, "slip_left": 1e-6, "slip_right": 1e-6,
          "sprocket_speed_left": 1e-5, "effort_left": 0.1, "effort_right": 0.1}  # fmt: skip


@pytest.fixture(scope="module")
def runs():
    """Sections 8.1 and 8.2."""
    return run_all(duration=40.0)


@pytest.mark.parametrize("case", [case for case in CASES if case[0] == "exact"])
def test_with_exact_parameters_the_error_vanishes_and_every_state_is_steady(runs, case):
    run = runs[case]
    assert run.distance[0] > 0.9 and run.settled_max < 1e-6
    for name, largest in STEADY.items():
        assert np.ptp(run.truth[name][run.time >= SETTLED]) < largest, name


def test_wrong_mass_and_inertia_leave_the_steady_offset_of_about_1_4_m(runs):
    run = runs["mass-inertia", "circle", 2.0]
    assert run.settled_rms == pytest.approx(1.4, abs=0.05)
    assert np.ptp(run.settled) < 1e-3


def test_resistance_maps_keep_the_error_moving_at_a_third_of_a_metre():
    case = "resistance-maps", "circle", 2.0
    run = run_all([case])[case]
    assert 0.3 < run.settled_rms < 0.45
    assert run.settled_max < 1.0


def test_the_paper_s_lost_vehicle_on_sandy_loam_follows_from_the_printed_factor_only(runs):
    printed, integral = (runs["sandy-loam", "circle", factor] for factor in (2.0, 1.0))
    assert printed.settled_rms > 2.0
    assert np.abs(printed.truth["slip_right"]).max() > 0.99
    assert integral.settled_max < 1e-6
    assert np.abs(integral.truth["slip_right"][100:]).max() < 0.05


PAPER = Condition("paper", 2.0, "strawa")


@pytest.fixture(scope="module")
def noisy():
    """The manoeuvre under the paper's noise on the maps, by kind of policy; 16 s, 3 vehicles."""
    return {
        kind: ident.identify(PAPER._replace(kind=kind), seeds=3, duration=16.0)
        for kind in ident.KINDS
    }


@pytest.mark.parametrize("kind", ["printed", "paper", "coupled"])
def test_on_the_straight_line_the_mass_is_right_to_one_percent(noisy, kind):
    assert ident.quality(noisy[kind]).mass_straight_worst < 0.01


def test_the_resistance_begins_to_change_when_the_spiral_begins(noisy):
    truth, time = noisy["paper"].truth, noisy["paper"].time
    for name in ("longitudinal_resistance", "lateral_resistance"):
        assert np.ptp(truth[name][time < ident.STRAIGHT]) < 0.01
        assert np.ptp(truth[name][time >= ident.STRAIGHT]) > 0.05


def test_in_the_spiral_a_single_forgetting_factor_takes_resistance_for_mass(noisy):
    printed, paper, coupled = (ident.quality(noisy[kind]) for kind in ident.KINDS[1:])
    assert ident.STRAIGHT + 3.0 < paper.exceeds < 16.0
    assert printed.exceeds == pytest.approx(paper.exceeds, abs=0.1)
    assert coupled.mass_spiral_worst < 0.05 and math.isnan(coupled.exceeds)
    assert abs(coupled.longitudinal_bias) < 0.02


@pytest.mark.slow
def test_on_uniform_ground_the_spiral_costs_less_than_5_percent_and_inertia_is_better_than_mass():
    result = ident.identify(PAPER._replace(ground="uniform"), seeds=3)
    quality = ident.quality(result)
    assert quality.mass_spiral_worst < 0.05
    assert quality.inertia < 0.01 and quality.inertia < quality.mass_spiral
    printed = ident.identify(PAPER._replace(kind="printed", ground="uniform"), seeds=3)
    assert ident.quality(printed).mass_spiral_worst == pytest.approx(0.02, abs=0.005)


def test_on_the_maps_the_printed_recursion_has_no_bound_and_the_bounded_one_ends_on_its_own():
    results = {
        kind: ident.identify(PAPER._replace(kind=kind, sensors="ideal"))
        for kind in ("printed", "paper")
    }
    worst = {kind: ident.quality(one).mass_spiral_worst for kind, one in results.items()}
    assert worst["printed"] > 30.0
    assert worst["paper"] == pytest.approx(5.0 * 0.55 - 1.0)  # five times the mass believed


@pytest.mark.parametrize("sigma", [1e-4, 1e-3])
def test_the_window_of_the_paper_is_more_robust_to_noise_than_shorter_ones(ground, sigma):
    windows = {n: soils.noisy(ground["ideal"], 0, sigma, n) for n in soils.WINDOWS}
    error = {window: soils.quality(one, 0).effort for window, one in windows.items()}
    assert error[50] < 0.5 * min(error[5], error[15])


@pytest.mark.parametrize("kind", ["printed", "paper", "coupled"])
def test_identified_parameters_keep_the_vehicle_closer_to_the_path_than_wrong_ones(noisy, kind):
    assert noisy[kind].rmse().max() < 0.2 * noisy["fixed"].rmse().min()


@pytest.mark.parametrize("way", ["circle", "manoeuvre"])
def test_a_wrong_mass_costs_more_than_a_wrong_inertia(way):
    results = surface(way, 2.0, np.array([0.5, 0.75, 1.0, 1.25, 1.5]), duration=15.0)
    assert results.rmse[2, 2] == 0.0
    mass, inertia = results.along()
    assert mass > 1.0 and mass > 50.0 * inertia
    assert results.rmse[0, 2] > results.rmse[1, 2] > 0.1


@pytest.fixture(scope="module")
def filtered():
    cases = [soils.SlipCase(speed, "sandy loam", 100.0) for speed in soils.SPEEDS]
    return soils.slip_runs(cases, seeds=6, duration=25.0)


@pytest.mark.parametrize("measured", soils.MEASURED)
@pytest.mark.parametrize("side", soils.SIDES)
def test_the_slip_is_unbiased_in_gentle_motion_and_not_on_rapid_changes_of_speed(
    filtered, measured, side
):
    gentle = soils.slip_quality(filtered, 0, measured, side, rapid=False)
    assert abs(gentle.bias) < 4.0 * gentle.uncertainty and abs(gentle.bias) < 0.006
    assert gentle.rms < 0.02
    rapid = soils.slip_quality(filtered, 1, measured, side, rapid=True)
    assert rapid.rms > (1.5 if side == "right" else 1.0) * gentle.rms
    assert math.isnan(soils.slip_quality(filtered, 0, measured, side, rapid=True).rms)


@pytest.fixture(scope="module")
def ground():
    cases = [soils.Case("circle", "changing"), soils.Case("circle", "heavy clay")]
    return soils.run_all(cases, duration=24.0)


def test_the_printed_method_finds_the_soil_from_true_slips_within_its_window(ground):
    quality = soils.quality(ground["printed"], 0)
    assert quality.effort < 1e-6 and quality.modulus < 1e-6
    assert quality.adapted <= 0.5 + 1e-9
    assert quality.most_iterations == 20 and quality.error_failed > 3.0 * quality.error_converged


def test_on_firm_clay_a_little_noise_of_the_slip_leaves_only_the_ratio(ground):
    exact = soils.quality(ground["printed"], 1)
    noisy = soils.quality(soils.noisy(ground["ideal"], 1, 1e-4), 0)
    assert exact.effort < 1e-6
    assert noisy.effort > 0.3 and noisy.stiffness < 0.5 * noisy.effort
    weighted = soils.quality(ground["ideal"], 1)
    assert weighted.ratio_only > 0.9
    assert weighted.stiffness < 0.05 < 0.1 < weighted.effort


def test_with_the_noise_of_the_paper_the_soil_is_not_known_very_accurately(ground):
    assert soils.quality(ground["strawa"], 0).effort > 0.05


def printed_resistance(force, friction, speed):
    """G of S (19): the force on a track."""
    if speed != 0.0:
        return -friction * np.sign(speed)
    return 0.0 if abs(force) <= friction else -friction * np.sign(force)


def test_the_printed_resistance_lets_a_standing_vehicle_start_under_any_load():
    mass, friction, effort = 1450.0, 4000.0, 1000.0
    assert (effort + printed_resistance(effort, friction, 0.0)) / mass > 0.6
    assert effort - terramechanics.resisting(0.0, effort, friction, 10.0) == 0.0
    # Heun's method in steps of 10 ms: it starts, is braked, and never rests for two steps.
    speeds, speed = [0.0], 0.0
    for _ in range(100):
        first = (effort + printed_resistance(effort, friction, speed)) / mass
        second = (effort + printed_resistance(effort, friction, speed + 0.01 * first)) / mass
        speed += 0.005 * (first + second)
        speeds.append(speed)
    assert np.ptp(speeds[50:]) > 1e-3 and not np.any(np.diff(speeds) == 0.0)


def test_the_printed_difference_of_two_accelerometers_is_minus_the_yaw_acceleration():
    near, far, step = 0.2, 0.9, 1e-3  # [m] ahead of the centre of rotation, [s]
    time = np.arange(-2, 3) * step

    def lateral_acceleration(ahead):
        """Of a point ahead, from its positions, along the left normal of the hull now."""
        yaw = 0.4 * time + 0.5 * 0.7 * time**2  # 0.7 rad/s^2
        y = 0.3 * time**2 + ahead * np.sin(yaw)
        return (y[3] - 2.0 * y[2] + y[1]) / step**2

    printed = (lateral_acceleration(near) - lateral_acceleration(far)) / (far - near)
    assert printed == pytest.approx(-0.7, abs=1e-3)


def test_the_printed_method_inverts_the_effort_of_a_track():
    slip = np.column_stack([np.linspace(0.01, 0.05, 60), np.linspace(0.02, 0.2, 60)])
    maximum, modulus, length = 12e3, 0.015, 2.0
    effort = maximum * np.array(
        [[terramechanics.mobilised_shear(i * length / modulus) for i in row] for row in slip]
    )
    fit = printed_gnr(slip, effort, length, (20e3, 0.02))
    assert fit.converged[1:].all()
    assert fit.effort_maximum[-1] == pytest.approx(maximum, rel=1e-9)
    assert fit.modulus[-1] == pytest.approx(modulus, rel=1e-9)
    lost = printed_gnr(slip, effort, length, (1e3, 0.9))
    assert lost.effort_maximum[0] == 1e3  # not converged: the last converged value


# The regressions of Strawa et al. (2021), as printed and kept bounded, on exact and noisy data


def longitudinal(settings=None, sheet=EXACT):
    part = LongitudinalEstimator(CLAY, 0.02, data_sheet=sheet)
    if settings is not None:
        settings(part)
    return part


def turning_of(settings, lateral, truth=TRUTH):
    part = turning(EXACT, 1, with_lateral_model(CLAY), truth, lateral=lateral)
    settings(part)
    return part


def errors(estimate, p):
    """(N, 2) of 1/m and mu_l."""
    return np.abs(estimate.value / np.array([1.0 / p.mass, p.longitudinal_resistance]) - 1.0)


def test_the_paper_s_regression_is_exact_on_the_straight_and_biased_in_curves():
    # S 8.3: mass error below 1 % on the straight, below 5 % afterwards.
    p = TRUTH._replace(icr_forward=0.2)

    def largest(settings, path):
        last = follow(longitudinal(settings), measurements(p, path, "constrained"))[-1]
        return errors(last, p).max()

    assert largest(as_in_paper, "straight") < 1e-5
    assert largest(None, "curves") < 1e-4
    assert 0.002 < largest(as_in_paper, "curves") < 0.05


def test_as_printed_exact_data_give_the_exact_parameters_however_far_they_are():
    far = TRUTH._replace(mass=30.0 * CLAY.mass, longitudinal_resistance=0.01)  # beyond all bounds
    last = follow(longitudinal(as_printed), measurements(far, "straight"))[-1]
    assert errors(last, far).max() < 1e-5
    bounded = follow(longitudinal(as_in_paper), measurements(far, "straight"))[-1]
    assert 1.0 / bounded.value[0, 0] == pytest.approx(5.0 * CLAY.mass)


def test_as_printed_the_estimate_is_the_forgetting_batch_least_squares_and_the_recursion_of_7_1_1():
    factor, radius = 0.998, CLAY.sprocket_radius
    samples = measurements(TRUTH, "curves", sheet=RTK)
    estimates = follow(longitudinal(as_printed, RTK), samples)
    rows = np.array([sample.values[0] for sample in samples])
    w, v_y = rows[:, COLUMN["yaw_rate"]], rows[:, COLUMN["v_y"]]
    y = rows[:, COLUMN["acceleration_x"]] + w * v_y
    torque = rows[:, COLUMN["torque_left"]] + rows[:, COLUMN["torque_right"]]
    phi = np.stack([torque / radius, np.full(len(y), -9.81)], axis=1)
    theta = np.array([1.0 / CLAY.mass, CLAY.longitudinal_resistance])
    p = np.diag([(400.0 / CLAY.mass) ** 2, 300.0**2])  # the paper names no P(0)
    for k in range(len(y)):
        gain = p @ phi[k] / (factor + phi[k] @ p @ phi[k])
        theta = theta + gain * (y[k] - phi[k] @ theta)
        p = (p - np.outer(gain, phi[k] @ p)) / factor
        if k in (100, 400, 999):
            weight = np.sqrt(factor ** np.arange(k, -1.0, -1.0))[:, None]
            batch = np.linalg.lstsq(weight * phi[: k + 1], weight[:, 0] * y[: k + 1], rcond=None)[0]
            assert estimates[k].value[0] == pytest.approx(batch, rel=1e-4)
            assert estimates[k].value[0] == pytest.approx(theta, rel=1e-4)


def test_as_printed_no_sample_is_left_out():
    part = longitudinal(as_printed)
    follow(part, measurements(TRUTH, "straight", steps=50))
    sample = measurements(TRUTH, "straight", steps=51)[-1]
    values = sample.values.copy()
    values[:, COLUMN["v_x"]] = 0.01  # as slow as no track that is used otherwise
    values[:, COLUMN["torque_left"]] = 1e5  # more than any drive has
    before = part.read().value
    after = part.update(sample._replace(values=values)).value
    assert np.abs(after / before - 1.0).max() > 1e-3


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_the_paper_s_settings_find_inertia_and_lateral_resistance(lateral_model):
    truth = with_lateral_model(TRUTH)
    part = turning_of(as_in_paper, lateral_model)
    last = follow(part, measurements(truth, "curves", lateral_model))[-1]
    assert np.abs(last.value / true_across(truth) - 1.0).max() < 2e-4


def test_as_printed_they_are_found_however_far_they_are():
    truth = with_lateral_model(TRUTH)
    far = truth._replace(inertia=20.0 * CLAY.inertia, lateral_resistance=0.05)
    part = turning_of(as_printed, "constrained", far)
    last = follow(part, measurements(far, "curves", "constrained"))[-1]
    assert np.abs(last.value / true_across(far) - 1.0).max() < 1e-4


def test_as_printed_sliding_tracks_are_refused():
    with pytest.raises(ValueError, match="must be 'constrained'"):
        as_printed(TurningEstimator(CLAY, lateral="sliding"))


def test_the_regressions_of_the_paper_are_worse_but_drive():
    mine = run(PaperPolicy(), "soil-and-mass", 32)
    blind = run(nominal(context()), "soil-and-mass", 32)
    assert interquartile_mean(mine.rmse) < 0.5 * interquartile_mean(blind.rmse)
    assert np.isfinite(mine.action).all()
