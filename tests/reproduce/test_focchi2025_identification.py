"""Focchi et al. (2025), section 4, run again: slip over the sprocket speeds."""

import sys

import numpy as np
import pytest

from baselines.slip.slip_regression import fit_exponential, train_trees, validate
from baselines.slip.slip_sweep import identified_slip, read_measured, sweep, upsample
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
    found = ident.agreement((runs.beta_left, runs.beta_right, runs.alpha), brief)
    assert found.determination[:2].min() > 0.98
    assert found.determination[2] < 0.95 and 0.6 < found.slope[2] < 0.9
    slow = within(runs, ident.MEASURED_LIMIT)
    found = ident.agreement(
        (slow.beta_left, slow.beta_right, slow.alpha), within(brief, ident.MEASURED_LIMIT)
    )
    assert found.determination.min() > 0.998


def test_alpha_grows_on_slippery_ground_and_hardly_differs_between_0_4_and_0_6():
    low, middle, high = (sweep(vehicle(friction=mu), COARSE) for mu in ident.FRICTIONS)
    assert ident.share_above(low, middle) > 2.0
    assert 1.0 < ident.share_above(middle, high) < 1.7


def test_the_agreement_of_runs_with_themselves_is_perfect(runs):
    own = (runs.beta_left, runs.beta_right, runs.alpha)
    for values in ident.agreement(own, runs):
        np.testing.assert_allclose(values, 1.0, atol=1e-12)
    half = ident.agreement((2.0 * runs.beta_left, *own[1:]), runs)
    assert half.slope[0] == pytest.approx(0.5) and half.correlation[0] == pytest.approx(1.0)
    assert half.determination[0] < 0.5


def test_where_the_markers_sit_is_found_and_explains_the_sign_in_reverse(runs, tmp_path):
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
    found = ident.run_all(tmp_path / "none.csv", COARSE)
    assert found.measured is None and found.against_measured == {} and found.behind == {}
    assert len(found.simulated.runs.v_x) == 17 * 17
    assert found.simulated.trees is None and "tracked-env[slip]" in found.missing
