"""The slip observer under symmetry, bad samples, standstill, and as a batch."""

import numpy as np
import pytest

from baselines.estimators.measurement import COLUMN, DataSheet, Measurement, make_measurement
from baselines.estimators.slip_kinematics import NAMES
from baselines.estimators.slip_observer import SlipObserver
from tests.baselines.estimators.slip_cases import (
    PARAMETERS,
    PERIOD,
    RTK,
    STRAWA,
    follow,
    positive_definite,
    simulate,
    weaving,
)

SLIPS = np.array([0.05, 0.14])
SPEEDS = [COLUMN["sprocket_speed_left"], COLUMN["sprocket_speed_right"]]


def _observer(sheet=RTK, count=1, **options):
    return SlipObserver(PARAMETERS, PERIOD, sheet, count, **options)


def _changed(measurement, signs, swap):
    values = measurement.values.copy()
    for name, sign in signs.items():
        values[:, COLUMN[name]] *= sign
    if swap:
        values[:, SPEEDS] = values[:, SPEEDS[::-1]]
    return measurement._replace(values=values)


def test_the_mirror_image_of_a_drive_has_the_mirrored_slips():
    run = simulate(weaving(300, 5), SLIPS, -0.06)
    signs = {"y": -1.0, "yaw": -1.0, "v_y": -1.0, "yaw_rate": -1.0}
    value, *_ = follow(_observer(count=5), run.measurements)
    other, *_ = follow(_observer(count=5), [_changed(m, signs, True) for m in run.measurements])
    mirrored = other[..., [0, 1, 2, 4, 3, 5]] * np.array([1, -1, -1, 1, 1, -1])
    # Sigma points of left and right differ: equal to second order in the uncertainty.
    assert np.abs(value - mirrored)[100:].max() < 1e-3
    assert np.abs(value - other).max() > 0.05


def test_a_drive_mirrored_front_to_back_has_the_negative_slips_and_side_slip():
    run = simulate(weaving(300, 5), SLIPS, -0.06)
    signs = dict.fromkeys(("x", "v_x", "yaw", "yaw_rate", *_speed_names()), -1.0)
    value, *_ = follow(_observer(count=5), run.measurements)
    other, *_ = follow(_observer(count=5), [_changed(m, signs, False) for m in run.measurements])
    assert np.abs(value - other * np.array([-1, 1, -1, -1, -1, -1])).max() < 1e-9


def _speed_names():
    return "sprocket_speed_left", "sprocket_speed_right"


def test_the_branch_of_the_measured_yaw_does_not_matter():
    run = simulate(weaving(800, 1, swing=0.2) + np.array([0.0, 1.5]), SLIPS, 0.0)
    assert run.state[-1, 0, 2] > 2.0 * np.pi
    rng, wrapped = np.random.default_rng(0), []
    for m in run.measurements:
        values = m.values.copy()
        values[:, 2] += 2.0 * np.pi * rng.integers(-3, 4)
        wrapped.append(m._replace(values=values))
    wrapped[0] = run.measurements[0]
    value, *_ = follow(_observer(), run.measurements)
    other, *_ = follow(_observer(), wrapped)
    assert np.abs(value - other).max() < 1e-9


def test_a_single_outlier_is_refused_and_leaves_no_trace():
    run = simulate(weaving(300), SLIPS, -0.06)
    good, bad = _observer(), _observer()
    for m in run.measurements[:200]:
        good.update(m), bad.update(m)
    m = run.measurements[200]
    off = m._replace(values=m.values + np.where(np.arange(m.values.shape[1]) == 1, 5.0, 0.0))
    missing = m._replace(fresh=np.zeros_like(m.fresh) | [False, True, True])
    before = bad.update(off)
    same = good.update(missing)
    assert before.status[0] == 2 and before.nis[0] > 1e3 and before.skipped[0] == 0
    assert np.array_equal(before.value, same.value)
    assert np.array_equal(before.covariance, same.covariance)


def test_a_jump_of_the_pose_is_followed_after_five_samples_and_spares_the_slips():
    run = simulate(weaving(400), SLIPS, -0.06)
    for m in run.measurements[250:]:
        m.values[:, 0] += 30.0
    value, covariance, status, _ = follow(_observer(), run.measurements)
    assert status[250:254, 0].tolist() == [2] * 4 and np.all(status[254:] == 0)
    assert value[260, 0, 0] - run.state[260, 0, 0] == pytest.approx(30.0, abs=0.1)
    assert value[260, 0, 2] == pytest.approx(run.state[260, 0, 2], abs=0.02)
    assert np.abs(value[255:, 0, 3:5] - SLIPS).max() < 0.03
    assert positive_definite(covariance)


def test_a_belt_that_spins_up_does_not_take_the_vehicle_along():
    belts = np.full((300, 1, 2), 2.0)
    slips = np.zeros((300, 1, 2))
    belts[200:, 0, 0], slips[200:, 0, 0] = 6.0, 2.0 / 3.0
    run = simulate(belts, slips, 0.0)
    observer = _observer()
    for k, m in enumerate(run.measurements):
        answer = observer.update(m)
        assert abs(observer.motion().v_x[0] - run.velocity[k, 0, 0]) < 0.1 or k < 5
        assert answer.status[0] != 2
    assert answer.value[0, 3] == pytest.approx(2.0 / 3.0, abs=0.02)


def test_a_track_that_loses_its_grip_at_constant_belt_speed_is_found():
    belts, slips = np.full((300, 1, 2), 2.0), np.full((300, 1, 2), 0.02)
    slips[200:, 0, 1] = 0.7
    value, covariance, status, _ = follow(_observer(), simulate(belts, slips, 0.0).measurements)
    assert np.all(np.abs(value[207:, 0, 4] - 0.7) < 0.08)
    assert np.all(status[207:] == 0) and positive_definite(covariance)


def test_missing_sprocket_speeds_are_held_and_counted():
    run = simulate(np.full((200, 1, 2), 2.0), SLIPS, 0.0)
    for m in run.measurements[150:160]:
        m.values[:, SPEEDS] = np.nan
    observer = _observer()
    value, *_ = follow(observer, run.measurements)
    assert np.abs(value[150:, 0, 3:5] - SLIPS).max() < 0.03
    assert observer.update(run.measurements[-1]).skipped[0] == 10


@pytest.mark.parametrize("name", ["v_x", "v_y", "yaw_rate"])
def test_a_missing_velocity_is_left_out_and_the_rest_used(name):
    run = simulate(weaving(300), SLIPS, -0.06)
    for m in run.measurements:
        m.values[:, COLUMN[name]] = np.nan
    observer = _observer()
    value, _, status, _ = follow(observer, run.measurements)
    assert np.abs(value[-1, 0, 3:] - run.state[-1, 0, 3:]).max() < 0.05
    assert np.all(status[50:] == 0)
    assert observer.update(run.measurements[-1]).skipped[0] == 301


def test_with_nothing_but_belts_uncertainty_grows_up_to_the_prior_and_nothing_else_happens():
    run = simulate(np.full((6000, 1, 2), 2.0), SLIPS, 0.0)
    for m in run.measurements[200:]:
        m.fresh[:, :2] = False
        m.values[:, COLUMN["acceleration_x"] : COLUMN["sprocket_speed_left"]] = np.nan
    _, covariance, status, nis = follow(_observer(), run.measurements)
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))[:, 0]
    assert np.all(np.diff(sigma[201:, 3:], axis=0) >= 0.0) and np.all(sigma <= 100.0)
    assert np.all(sigma[:, 3:] <= 0.3 + 1e-12) and sigma[-1, 3] > 0.15
    assert np.all(status[200:] == 1) and np.all(np.isnan(nis[200:]))
    assert positive_definite(covariance)


@pytest.mark.parametrize(
    "sheet", [RTK, pytest.param(STRAWA, marks=pytest.mark.slow)], ids=["rtk", "strawa"]
)
def test_a_vehicle_that_stands_for_half_an_hour_keeps_its_slips(sheet):
    count, rng = 4, np.random.default_rng(0)
    belts = weaving(400, count)
    belts[-60:] *= np.linspace(1.0, 0.0, 60)[:, None, None]
    run = simulate(belts, SLIPS, -0.06, sheet)
    observer = _observer(sheet, count)
    follow(observer, run.measurements[:-1])
    slips, variances = observer.slips, observer.slip_variances
    sample = run.measurements[-1]
    sigma = np.array([sheet.position_noise] * 2 + [sheet.yaw_noise] + [sheet.velocity_noise] * 2)
    place = np.concatenate([run.state[-1, :, :3], np.zeros((count, 2))], axis=1)
    for _ in range(100_000):
        sample.values[:, :5] = place + sigma * rng.standard_normal((count, 5))
        sample.values[:, 7] = sheet.gyro_noise * rng.standard_normal(count)
        sample.values[:, SPEEDS] = sheet.sprocket_speed_noise * rng.standard_normal((count, 2))
        answer = observer.update(sample)
    assert np.all(answer.status == 1)
    assert np.abs(observer.slips - slips).max() < 0.05
    assert np.all(observer.slip_variances < 1.3 * variances + 1e-4)
    assert np.abs(answer.value[:, :2] - run.state[-1, :, :2]).max() < 0.25 * sheet.position_noise
    assert np.abs(answer.value[:, 2] - run.state[-1, :, 2]).max() < 0.25 * sheet.yaw_noise + 0.002
    assert positive_definite(answer.covariance)


@pytest.mark.parametrize("velocity", [True, False], ids=["velocity", "pose_only"])
@pytest.mark.parametrize("sheet", [RTK, DataSheet(*[0.0] * 7, 1.0, 0.0, 0.0)], ids=["rtk", "ideal"])
def test_nonsense_keeps_every_value_in_its_bounds_and_the_covariance_positive(sheet, velocity):
    rng, count = np.random.default_rng(5), 20
    observer = _observer(sheet, count, velocity=velocity)
    scale = 10.0 ** rng.integers(-3, 4, count)[:, None]
    for k in range(2000):
        values = scale * rng.standard_normal((count, 13)) * (10.0 if k % 7 else 1.0)
        values[rng.random(values.shape) < 0.05] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
        age = rng.choice([0.0, 0.1, 5.0, np.nan, -1.0, np.inf], (count, 3))
        answer = observer.update(Measurement(values, rng.random((count, 3)) < 0.8, age))
        assert np.all(np.isfinite(answer.value)) and np.all(np.isfinite(answer.covariance))
        assert np.abs(answer.value[:, 3:5]).max() <= 0.98
        assert np.abs(answer.value[:, 5]).max() <= 1.0
        assert np.all(answer.excitation >= 0.0) and np.all(answer.condition >= 1.0)
        assert positive_definite(answer.covariance)


def test_excitation_and_status_tell_what_the_data_determine():
    run = simulate(weaving(200), SLIPS, -0.06)
    observer = _observer()
    first = observer.update(run.measurements[0])
    assert first.status[0] == 1 and first.excitation[0] < 1e-9 and np.isinf(first.condition[0])
    _, _, status, _ = follow(observer, run.measurements[1:])
    answer = observer.update(run.measurements[-1])
    unit = answer.covariance[0, 3:, 3:] / 0.09
    eigenvalues = 1.0 / np.linalg.eigvalsh(unit) - 1.0
    assert answer.excitation[0] == pytest.approx(eigenvalues.min(), rel=1e-9)
    assert answer.condition[0] == pytest.approx(eigenvalues.max() / eigenvalues.min(), rel=1e-9)
    assert np.all(status[50:] == 0) and answer.excitation[0] > 100.0


def test_slips_motion_and_names_belong_to_the_estimate():
    observer = _observer(count=2)
    answer = observer.update(make_measurement(x=[1.0, 2.0], y=3.0, yaw=0.5))
    assert observer.names == NAMES == answer.names
    assert np.array_equal(observer.slips, answer.value[:, 3:5])
    assert np.array_equal(observer.slip_variances, answer.covariance[:, [3, 4], [3, 4]])
    assert np.array_equal(observer.motion().x, [1.0, 2.0])
    assert np.array_equal(observer.rows["started"], [1.0, 1.0])
