"""Focchi et al. (2025), section 4, run again: slip over the sprocket speeds.

SLIPPERY and FIRM are sweeps that the authors published, github.com/mfocchi/robot_control,
base_controllers/tracked_robot/regressor: columns sprocket left, right [rad/s], beta_left,
beta_right [m/s], alpha [rad]. Their law multiplies the shear displacement by the belt speed, which
changes K and hardly the steady slip.
"""

import sys

import numpy as np
import pytest

from baselines.slip.slip_regression import fit_exponential, train_trees, validate
from baselines.slip.slip_sweep import (
    identified_slip,
    read_measured,
    slip_data,
    steady_motion,
    sweep,
    upsample,
)
from reproduce.focchi2025 import identification as ident
from reproduce.focchi2025.control import vehicle, within

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


def test_without_the_file_of_the_real_vehicle_the_simulation_is_identified(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.tree", None)  # the trees are not the point
    results = ident.run_all(tmp_path / "none.csv", COARSE)
    assert results.measured is None and results.against_measured == {} and results.behind == {}
    assert len(results.simulated.runs.v_x) == 17 * 17
    assert results.simulated.trees is None and "tracked-env[slip]" in results.missing


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
