"""Focchi et al. (2025), section 4, run again: slip over the sprocket speeds.

SLIPPERY and FIRM are sweeps that the authors published, github.com/mfocchi/robot_control,
base_controllers/tracked_robot/regressor: columns sprocket left, right [rad/s], beta_left,
beta_right [m/s], alpha [rad]. Their law multiplies the shear displacement by the belt speed, which
changes K and hardly the steady slip.
"""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.lyapunov.lyapunov_laws import LyapunovGains, PoseError
from baselines.slip.slip_regression import fit_exponential, train_trees, validate
from baselines.slip.slip_sweep import (
    identified_slip,
    read_measured,
    slip_data,
    steady_motion,
    sweep,
    upsample,
)
from reproduce.focchi2025 import claims, slopes
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025 import load_models as loads
from reproduce.focchi2025.control import vehicle, within
from tests.baselines.lyapunov.lyapunov_function import unicycle_law
from tracked_env.physics.rigid_body import in_body_plane
from tracked_env.physics.terramechanics import GRAVITY
from tracked_env.plants.standalone import TerrainRig

COARSE = 1.3  # [rad/s]


@pytest.fixture(scope="module")
def runs():
    return sweep(vehicle(), ident.STEP)


def real_file(runs, path, behind=0.0):
    """Runs as the file of a real vehicle whose markers sit `behind` [m] the turning centre."""
    across = runs.v_y - behind * runs.yaw_rate
    alpha = np.arctan2(across, runs.v_x)
    columns = (runs.sprocket_left * 34.45, runs.sprocket_right * 34.45, runs.beta_left,
               runs.beta_right, alpha)  # fmt: skip
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",")
    return path


def test_trees_predict_the_simulated_slip_with_the_accuracy_of_the_paper(runs):
    pytest.importorskip("sklearn", reason="decision trees need the extra `slip`")
    parameters = vehicle()
    _model, scores = train_trees(upsample(runs, parameters)[0], parameters)
    assert min(scores) > 0.999


def test_the_exponential_form_explains_three_quarters_of_the_variance_only(runs):
    _model, scores = fit_exponential(runs, vehicle())
    assert min(scores[:3]) > 0.7 and max(scores[:3]) < 0.85


def test_two_seconds_from_rest_are_enough_but_for_alpha_in_fast_turns(runs):
    left, right, alpha = ident.after_two_seconds(vehicle(), runs)
    brief = runs._replace(beta_left=left, beta_right=right, alpha=alpha)
    agreement = ident.agreement((runs.beta_left, runs.beta_right, runs.alpha), brief)
    assert agreement.determination[:2].min() > 0.98
    assert agreement.determination[2] < 0.95 and 0.6 < agreement.slope[2] < 0.9
    slow = within(runs, ident.MEASURED_LIMIT)
    agreement = ident.agreement(
        (slow.beta_left, slow.beta_right, slow.alpha), within(brief, ident.MEASURED_LIMIT)
    )
    assert agreement.determination.min() > 0.998


def test_alpha_grows_on_slippery_ground_and_hardly_differs_between_0_4_and_0_6():
    low, middle, high = (sweep(vehicle(friction=mu), COARSE) for mu in ident.FRICTIONS)
    assert ident.share_above(low, middle) > 2.0
    assert 1.0 < ident.share_above(middle, high) < 1.7


def test_the_agreement_of_runs_with_themselves_is_perfect(runs):
    slip = (runs.beta_left, runs.beta_right, runs.alpha)
    for values in ident.agreement(slip, runs):
        np.testing.assert_allclose(values, 1.0, atol=1e-12)
    half = ident.agreement((2.0 * runs.beta_left, *slip[1:]), runs)
    assert half.slope[0] == pytest.approx(0.5) and half.correlation[0] == pytest.approx(1.0)
    assert half.determination[0] < 0.5


def test_where_the_markers_sit_is_estimated_and_explains_the_sign_in_reverse(runs, tmp_path):
    moved = read_measured(real_file(runs, tmp_path / "moved.csv", 0.05), vehicle())
    predicted = (runs.beta_left, runs.beta_right, runs.alpha)
    plain = ident.agreement(predicted, moved)
    behind, agreement = ident.offset(predicted, moved)
    assert behind == pytest.approx(0.05, abs=1e-6)
    assert agreement.determination.min() > 0.999 > plain.determination.min()
    assert plain.correlation[2] > plain.correlation[3]


def test_a_vehicle_measured_at_its_turning_centre_has_no_offset(runs, tmp_path):
    real = read_measured(real_file(runs, tmp_path / "real.csv"), vehicle())
    predicted = (runs.beta_left, runs.beta_right, runs.alpha)
    assert ident.offset(predicted, real)[0] == pytest.approx(0.0, abs=1e-6)
    for way in (real.v_x > ident.SLOW, real.v_x < -ident.SLOW):
        assert ident.distance(predicted, real, way) == pytest.approx(0.0, abs=1e-6)


def test_the_runs_of_the_real_vehicle_are_looked_for_beside_the_folder_of_the_project(repository):
    assert ident.MEASURED.parent == repository.parent / "shared" / "data"


def test_the_real_vehicle_agrees_with_the_paper():
    if not ident.MEASURED.exists():
        pytest.skip(f"needs the runs of the real vehicle, {ident.MEASURED.name}")
    pytest.importorskip("sklearn", reason="decision trees need the extra `slip`")
    real = read_measured(ident.MEASURED, vehicle())
    scores = validate(real, vehicle())
    np.testing.assert_allclose(scores[:3], (0.91, 0.84, 0.961), atol=0.05)
    model = identified_slip(vehicle(0.5))
    behind, moved = ident.offset(model.slip(real.sprocket_left, real.sprocket_right), real)
    assert 0.03 < behind < 0.06 and moved.determination[2:].min() > 0.9


def test_without_the_file_of_the_real_vehicle_the_simulation_is_identified(tmp_path):
    pytest.importorskip("sklearn", reason="decision trees need the extra `slip`")
    results = ident.run_all(tmp_path / "none.csv", COARSE)
    assert results.measured is None and results.against_measured == {} and results.behind == {}
    assert len(results.simulated.runs.v_x) == 17 * 17


# ident_wheels_sim_2d_0.1.csv: mu = 0.1, sprockets within 10 rad/s.
SLIPPERY = np.array(
    [
        (4.838710, 9.354839, -0.036189, 0.044795, -0.096468),
        (4.838710, 8.064516, -0.029354, 0.031327, -0.047363),
        (4.838710, 6.774194, -0.018323, 0.018541, -0.015733),
        (4.838710, 3.548387, 0.012191, -0.012164, 0.004821),
        (4.838710, 2.258065, 0.025039, -0.024663, 0.027503),
        (4.838710, 0.967742, 0.038212, -0.036720, 0.064622),
        (4.838710, -0.322581, 0.051869, -0.048375, 0.116829),
        (4.838710, -1.612903, 0.066024, -0.060016, 0.181415),
        (8.064516, 6.129032, 0.018480, -0.018208, 0.016253),
        (8.064516, 4.193548, 0.038003, -0.034353, 0.068148),
        (8.064516, 2.258065, 0.060988, -0.045714, 0.153648),
        (8.064516, 0.322581, 0.090093, -0.052492, 0.274089),
        (8.064516, -1.612903, 0.125652, -0.059490, 0.404373),
        (8.064516, -3.548387, 0.157838, -0.071930, 0.553341),
    ]
)
# data2d/csv/ident_wheels_sim_0.4_WLmax_18.csv: mu = 0.4, sprockets within 18 rad/s.
FIRM = np.array(
    [
        (10.174, 18.0, -0.038108, 0.043812, -0.068941),
        (10.174, 14.87, -0.024973, 0.025774, -0.025896),
        (10.174, 11.739, -0.009513, 0.009529, -0.002345),
        (10.174, 7.0435, 0.017018, -0.016901, 0.011127),
        (10.174, 3.913, 0.035020, -0.033750, 0.043341),
        (10.174, 0.78261, 0.053982, -0.049450, 0.095286),
        (10.174, -2.3478, 0.074282, -0.064653, 0.163320),
        (10.174, -5.4783, 0.094300, -0.080724, 0.249140),
        (10.174, -8.6087, 0.110000, -0.101080, 0.345690),
        (13.304, 16.435, -0.016664, 0.016882, -0.012390),
        (13.304, 8.6087, 0.025884, -0.025218, 0.025481),
        (13.304, 2.3478, 0.065013, -0.053539, 0.128780),
        (13.304, -3.913, 0.114940, -0.075251, 0.302330),
        (13.304, -10.174, 0.152760, -0.113240, 0.519770),
    ]
)
SWEEPS = {0.1: SLIPPERY, 0.4: FIRM}


def against_published(friction, length, resistance):
    """(R^2, published over ours) of beta_left, beta_right, alpha."""
    left, right, *published = SWEEPS[friction].T
    parameters = vehicle(length, friction, resistance)
    ours = slip_data(parameters, left, right, steady_motion(parameters, left, right))
    columns = list(zip((ours.beta_left, ours.beta_right, ours.alpha), published, strict=True))
    scores = [1.0 - np.sum((q - p) ** 2) / np.sum((q - q.mean()) ** 2) for p, q in columns]
    return np.array(scores), np.array([(p @ q) / (p @ p) for p, q in columns])


@pytest.mark.parametrize(("friction", "length"), [(0.1, 0.7), (0.4, 0.5)])
def test_a_published_sweep_is_that_of_one_length_without_rolling_resistance(friction, length):
    score, slope = against_published(friction, length, 0.0)
    assert score[:2].min() > 0.998 and score[2] > 0.98
    assert slope == pytest.approx(1.0, abs=0.06) and slope[:2] == pytest.approx(1.0, abs=0.03)
    other = 1.2 - length
    assert against_published(friction, other, 0.0)[0][:2].max() < 0.75
    assert against_published(friction, length, 0.025)[0][:2].max() < 0.98


def test_with_rolling_resistance_both_tracks_slip_forward_where_the_path_is_nearly_straight():
    for resistance, agree in ((0.025, True), (0.0, False)):
        parameters = vehicle(0.7, 0.1, resistance)
        left, right = np.array([9.95]), np.array([10.0])
        slip = slip_data(parameters, left, right, steady_motion(parameters, left, right))
        assert (slip.beta_left[0] * slip.beta_right[0] > 0.0) == agree


# Focchi et al. (2025), 8.1, 8.2, the grounds of section 8; printed equations of 2.2 and 5.3

MAP_SLOPES = (0.0277, 0.2788, 0.5300)  # [-] median, 90 %, 99 % of the authors' map


@pytest.fixture
def mapped(reference_data):
    """The authors' map, or a skip that names the file."""
    ground, missing = slopes.authors_map(reference_data / "terrain_mesh" / "height_5cm.npz")
    if ground is None:
        pytest.skip(missing)
    return ground


def test_the_seeded_field_has_the_slopes_of_the_authors_map():
    np.testing.assert_allclose(slopes.steepness(slopes.field()), MAP_SLOPES, rtol=0.02)


def test_the_authors_map_has_the_slopes_that_the_seeded_field_is_fitted_to(mapped):
    np.testing.assert_allclose(slopes.steepness(mapped), MAP_SLOPES, rtol=0.001)


def test_a_vehicle_starts_on_a_flank_of_both_grounds(mapped):
    for one in (mapped, slopes.field()):
        _, slope_x, slope_y = one.field.at(*one.start)
        assert 0.18 < slope_x < 0.25 and abs(slope_y) < 0.06


@pytest.mark.slow
def test_without_the_map_its_file_is_named_and_the_seeded_field_is_run(tmp_path, monkeypatch):
    for module in (loads, slopes):
        monkeypatch.setattr(module, "DURATION", 0.5)
    monkeypatch.setattr(slopes, "RATE", 50.0)
    monkeypatch.setattr(slopes, "SPEED_STEP", 6.0)
    monkeypatch.setattr(slopes, "PROBES", 40)
    lines = []
    results = slopes.run_all(lines.append, tmp_path / "gone.npz")
    assert "gone.npz" in lines[0] and "left out" in lines[0] and results.missing == lines[0]
    assert [one.name for one in results.grounds] == ["seeded field"]
    outcomes = claims.load_claims(results)
    assert not any(outcome.values.get("ground") == "authors' map" for outcome in outcomes)


@pytest.mark.parametrize(("name", "rate"), [("Table 2", 425.0), ("as 8.1 prints", 4250.0)])
def test_roll_decays_at_the_rate_of_the_closed_form(name, rate):
    damping = loads.DAMPING[name]
    assert loads.roll_decay(damping) == pytest.approx(rate, rel=1e-3)
    assert loads.measured_roll_decay(damping) == pytest.approx(rate, rel=0.005)


def test_the_damping_of_8_1_is_too_large_for_its_explicit_steps_and_that_of_table_2_is_not():
    amplified = {name: abs(1.0 - 1e-3 * loads.roll_decay(d)) for name, d in loads.DAMPING.items()}
    assert amplified["as 8.1 prints"] > 3.0 and amplified["Table 2"] < 1.0


def test_across_a_slope_the_lower_track_is_loaded_by_the_moment_of_the_shear_forces():
    plant, closed = loads.load_on_a_side_slope(0.25)
    assert plant == pytest.approx(closed, rel=0.002) and plant > 0.2


def test_the_printed_pair_gives_53_9_kn_per_m_and_5_5_with_half_a_metre_the_printed_23():
    printed, fits = (loads.foremost(*loads.PAIRS[name], 1.4) for name in ("printed", "fits"))
    assert printed == pytest.approx(5e3 * (1.0 + 10.5 * 1.4 * 0.665))
    assert fits == pytest.approx(5e3 * (1.0 + 5.5 * 1.4 * 0.475))
    assert fits == pytest.approx(loads.PRINTED_STIFFNESS, rel=0.02)
    assert printed > 2.3 * loads.PRINTED_STIFFNESS


@pytest.mark.parametrize("reading", loads.PER_AREA)
@pytest.mark.parametrize("pair", loads.PAIRS)
def test_a_vehicle_on_stiffening_ground_pitches_until_force_and_moment_balance(pair, reading):
    run = loads.stiffen(*loads.PAIRS[pair], loads.PER_AREA[reading])
    assert run.held == pytest.approx(run.equilibrium, rel=0.005)
    assert run.held < -0.01 and run.pitch[0] == pytest.approx(0.0, abs=1e-3)
    assert run.raised == ((pair, reading) == ("fits", "per track"))
    if not run.raised:
        closed = loads.foremost(*loads.PAIRS[pair], 1.4)
        assert run.stiffness.max() == pytest.approx(closed, rel=0.005)


def test_the_belts_of_the_open_loop_are_those_of_a_unicycle_beyond_any_limit():
    parameters = vehicle()
    left, right = loads.belts(parameters, np.array([1.6]), np.array([0.6]))[0]
    radius, gauge = parameters.sprocket_radius, parameters.track_gauge
    assert 0.5 * radius * (left + right) == pytest.approx(1.6)
    assert radius * (right - left) / gauge == pytest.approx(0.6)
    assert left > parameters.sprocket_speed_limit


def test_uniform_load_ends_metres_beside_nonuniform_load_on_the_authors_map(mapped):
    starts = [(*mapped.start, 0.0)]
    runs = [loads.drive(mapped.field, load, starts, "linear") for load in loads.LOADS]
    assert loads.length(runs[0])[0] == pytest.approx(claims.PRINTED_LENGTH, abs=0.1)
    assert loads.gap(*runs)[0] == pytest.approx(3.68, abs=0.1)


def test_on_the_ground_of_the_authors_script_the_load_models_end_less_than_a_metre_apart(mapped):
    start = [loads.SCRIPTED]
    gaps = {
        name: loads.gap(
            *(loads.drive(mapped.field, load, start, "linear", soil) for load in loads.LOADS)
        )[0]
        for name, soil in loads.SOILS.items()
    }
    assert gaps["authors"] == pytest.approx(0.41, abs=0.05)
    assert gaps["Table 2"] == pytest.approx(2.76, abs=0.1)


def test_on_level_ground_the_load_models_drive_the_same_path_to_a_few_centimetres():
    runs = [loads.drive("flat", load, [(0.0, 0.0, 0.0)], "(53)") for load in loads.LOADS]
    assert loads.gap(*runs)[0] < 0.1
    assert not runs[1].saturated.any()


ANGLE, SPEED = math.radians(20.0), 0.5  # [rad], [m/s]


def test_the_printed_damper_lifts_a_vehicle_that_drives_downhill():
    weight = vehicle().mass * GRAVITY
    vertical = -SPEED * math.sin(ANGLE)  # z . p' of (17) for motion along the ground
    lift = -2.0 * loads.DAMPING["Table 2"] * vertical  # (18), both tracks
    assert lift == pytest.approx(1.71e3, rel=0.01) and lift > 2.0 * weight
    parameters = vehicle(friction=loads.FRICTION)
    rig = TerrainRig(parameters, {"terrain": {"kind": "plane", "slope_x": -math.tan(ANGLE)}})
    rig.stand(0.0, 0.0, 0.0)
    rig.advance([[SPEED / parameters.sprocket_radius] * 2], 4.0)
    assert rig.load[0] == pytest.approx(weight * math.cos(ANGLE), rel=1e-4)


@pytest.mark.parametrize("yaw", [0.5, 1.5, -2.0])
def test_a_tilt_taken_from_the_rotation_vector_is_turned_by_half_the_yaw(yaw):
    tilt = np.array([0.0, 1e-4, 0.0])  # of the ground, which (15) gives no yaw
    ground, body = Rotation.from_rotvec(tilt), Rotation.from_euler("z", yaw)
    error = (ground * body.inv()).as_rotvec()[:2]
    turned = math.remainder(math.atan2(error[1], error[0]) - 0.5 * math.pi, 2.0 * math.pi)
    assert turned == pytest.approx(0.5 * yaw, abs=1e-3)
    assert np.hypot(*error) == pytest.approx(1e-4 * 0.5 * yaw / math.sin(0.5 * yaw), rel=1e-3)


def printed_speed(error, yaw, gains):
    """delta_v of (42) with the error of (49): rotated by the yaw, then with the yaw once more."""
    x, y = Rotation.from_euler("z", yaw).inv().apply([*error, 0.0])[:2]
    return -gains.k_p * math.hypot(x, y) * math.cos(math.atan2(y, x) - yaw)


@pytest.mark.parametrize("yaw", [0.0, 1.0, math.pi])
def test_the_printed_error_in_the_body_depends_on_where_north_is(yaw):
    gains = LyapunovGains()
    behind = (-0.1 * math.cos(yaw), -0.1 * math.sin(yaw))  # vehicle less reference
    level = ((1.0, 0.0), (1.0, 0.0))
    ahead, left, turn = in_body_plane.py_func(0.1, 0.0, 0.0, *level)
    right = unicycle_law(PoseError(-ahead, -left, -turn), 0.0, 0.0, gains)
    assert right.speed == pytest.approx(0.1 * gains.k_p)
    assert printed_speed(behind, yaw, gains) == pytest.approx(right.speed * math.cos(yaw))
