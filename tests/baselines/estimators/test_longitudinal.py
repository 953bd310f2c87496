"""Mass and motion resistance from measurements that obey the plant's equations."""

import numpy as np
import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import COLUMN, Status
from tests.baselines.estimators.motion_cases import (
    CLAY,
    EXACT,
    RTK,
    follow,
    measurements,
)
from tests.baselines.estimators.state_columns import J_11, J_12, J_22

TRUTH = CLAY._replace(mass=1750.0, longitudinal_resistance=0.45, inertia=1500.0)


def true_values(p):
    return np.array([1.0 / p.mass, p.longitudinal_resistance])


def estimator(sheet=EXACT, count=1, **options):
    return LongitudinalEstimator(CLAY, 0.02, data_sheet=sheet, count=count, **options)


def relative_error(estimate, p):
    """(N, 2) of 1/m and mu_l."""
    return estimate.value / true_values(p) - 1.0


# --- exact where the model is ---------------------------------------------------------------


@pytest.mark.parametrize("lateral_model", ["sliding", "constrained"])
@pytest.mark.parametrize("kind", ["straight", "curves", "reverse"])
def test_without_noise_the_coupled_regression_finds_mass_and_resistance(kind, lateral_model):
    samples = measurements(TRUTH._replace(icr_forward=0.2), kind, lateral_model)
    last = follow(estimator(), samples)[-1]
    assert np.abs(relative_error(last, TRUTH)).max() < 1e-4  # what is left of the prior
    assert last.status[0] == Status.CONVERGING


@pytest.mark.parametrize("lateral_model", ["sliding", "constrained"])
def test_on_the_spot_the_resistances_cancel_and_the_mass_is_found_alone(lateral_model):
    last = follow(estimator(), measurements(TRUTH, "pivot", lateral_model))[-1]
    assert abs(relative_error(last, TRUTH)[0, 0]) < 1e-5
    assert last.of("longitudinal_resistance") == CLAY.longitudinal_resistance
    assert last.deviation("longitudinal_resistance") == pytest.approx(0.3, rel=1e-6)
    assert last.status[0] == Status.HOLDING
    assert last.excitation[0] == 0.0
    assert last.condition[0] > 1e9


# --- noise ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["straight", "curves", "reverse"])
def test_with_the_noise_of_the_sensors_errors_are_small_and_as_large_as_said(kind):
    count = 200
    results = follow(estimator(RTK, count), measurements(TRUTH, kind, sheet=RTK, count=count))
    error = relative_error(results[-1], TRUTH)
    assert np.sqrt((error**2).mean(0)).max() < 0.01
    for result in results[100::100]:
        error = result.value - true_values(TRUTH)
        sigma = np.stack([result.deviation(name) for name in result.names], axis=1)
        assert (np.abs(error) < 3.0 * sigma).mean() > 0.98
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance), error)
        assert 0.1 < squared.mean() < 2.2  # 2 when right; less: the resistance does not walk here
    innovations = np.array([result.nis for result in results[20:]])
    assert 0.7 < np.nanmean(innovations) < 1.1


def test_a_payload_is_found_and_put_down_to_the_mass():
    count = 50
    before = measurements(TRUTH, "curves", sheet=RTK, count=count, steps=600)
    loaded = TRUTH._replace(mass=1.35 * TRUTH.mass)
    after = measurements(loaded, "curves", sheet=RTK, count=count, steps=600, seed=1)
    found = estimator(RTK, count)
    last = follow(found, before + after)[-1]
    assert np.quantile(np.abs(relative_error(last, loaded)), 0.9) < 0.02


def test_other_soil_is_found_and_put_down_to_the_resistance():
    count = 50
    before = measurements(TRUTH, "curves", sheet=RTK, count=count, steps=600)
    soft = TRUTH._replace(longitudinal_resistance=0.8)
    after = measurements(soft, "curves", sheet=RTK, count=count, steps=600, seed=1)
    found = estimator(RTK, count)
    last = follow(found, before + after)[-1]
    assert np.quantile(np.abs(relative_error(last, soft)), 0.9) < 0.02


def test_a_long_straight_at_constant_speed_leaves_the_mass_as_it_was():
    count, steps = 20, 15_000
    found = estimator(RTK, count)
    first = follow(found, measurements(TRUTH, "curves", sheet=RTK, count=count))[-1]
    steady = measurements(TRUTH, "steady", sheet=RTK, count=count, steps=steps)
    last = follow(found, steady)[-1]
    drift = (last.of("inverse_mass") / first.of("inverse_mass")) - 1.0
    assert np.abs(drift).max() < 0.02
    assert np.abs(relative_error(last, TRUTH)).max() < 0.05
    assert (last.status == Status.HOLDING).all()


# --- bounds, excitation, memory -------------------------------------------------------------


@pytest.mark.parametrize(
    ("belts", "v_x"),
    [((0.0, 1.2), 1.0), ((6.0, 1.2), 1.0), ((6.0, 0.0), 1.0), ((-1.4, 1.2), 1.0)],
    ids=["locked", "spinning", "both", "against"],
)
def test_a_belt_that_spins_or_is_locked_says_nothing_on_the_mass(belts, v_x):
    """There the filter can take a track for one that moves the other way."""
    samples = measurements(TRUTH, "straight")
    driving = estimator()
    follow(driving, samples[:200])
    before = driving.memory.copy()
    for m in samples[200:250]:
        m.values[:, COLUMN["v_x"]], m.values[:, COLUMN["yaw_rate"]] = v_x, 0.0
        for side, belt in zip(("left", "right"), belts, strict=True):
            m.values[:, COLUMN[f"sprocket_speed_{side}"]] = belt / CLAY.sprocket_radius
            m.values[:, COLUMN[f"torque_{side}"]] = 0.0
        m.values[:, COLUMN["acceleration_x"]] = -1.4
    last = follow(driving, samples[200:250])[-1]
    assert np.array_equal(driving.memory, before)
    assert last.status[0] == Status.HOLDING
    for m in samples[200:250]:
        for side in ("left", "right"):
            m.values[:, COLUMN[f"sprocket_speed_{side}"]] = v_x / CLAY.sprocket_radius
    follow(driving, samples[200:250])
    assert not np.array_equal(driving.memory, before)


def test_bounds_hold_under_dropouts_outliers_and_reversals():
    rng = np.random.default_rng(6)
    found = estimator(RTK, 20)
    samples = []
    for seed, kind in enumerate(("curves", "reverse", "pivot", "straight")):
        samples += measurements(TRUTH, kind, sheet=RTK, count=20, seed=seed, steps=300)
    for sample in samples:
        wild = rng.random(sample.values.shape) < 0.01
        sample.values[wild] *= rng.choice([-50.0, 0.0, 50.0, np.nan], wild.sum())
        estimate = found.update(sample)
        assert (estimate.value >= [1.0 / CLAY.mass / 5.0 * (1 - 1e-12), 0.0]).all()
        assert (estimate.value <= [5.0 / CLAY.mass * (1 + 1e-12), 1.5]).all()
        assert (np.linalg.eigvalsh(estimate.covariance * [[1e6, 1e3], [1e3, 1.0]]) > 0.0).all()
    assert np.quantile(np.abs(relative_error(estimate, TRUTH)[:, 0]), 0.9) < 0.1


def test_excitation_and_condition_are_those_of_the_information():
    found = estimator(RTK, 3)
    last = follow(found, measurements(TRUTH, "curves", sheet=RTK, count=3, steps=50))[-1]
    for i in range(3):
        a, b, c = found.memory[i, [J_11, J_12, J_22]]
        information = np.array([[a, b], [b, c]])
        assert last.excitation[i] == pytest.approx(np.linalg.eigvalsh(information)[0], rel=1e-7)
        assert last.condition[i] == pytest.approx(np.linalg.cond(information), rel=1e-7)


@pytest.mark.parametrize("rows", [[1], np.array([False, True, False])])
def test_reset_forgets_the_rows_named(rows):
    found = estimator(RTK, 3)
    follow(found, measurements(TRUTH, "curves", sheet=RTK, count=3, steps=50))
    before = found.memory.copy()
    found.reset(rows)
    assert not found.memory[1].any()
    assert np.array_equal(found.memory[[0, 2]], before[[0, 2]])
    assert found.read().value[1] == pytest.approx(true_values(CLAY))
    found.reset()
    assert not found.memory.any()


# --- errors ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control_period": 50.0}, "rate"),
        ({"control_period": float("nan")}, "control_period"),
        ({"count": 0}, "count"),
        ({"forgetting": 0.002}, "lambda"),
        ({"forgetting": 1.01}, "forgetting"),
    ],
)
def test_nonsense_is_refused_with_a_reason(options, message):
    with pytest.raises(ValueError, match=message):
        LongitudinalEstimator(CLAY, **options)


def test_a_measurement_of_another_number_of_vehicles_is_refused():
    with pytest.raises(ValueError, match="made for count = 1 vehicles"):
        estimator().update(measurements(TRUTH, "curves", count=2, steps=1)[0])
