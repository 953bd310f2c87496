"""Inertia and lateral resistance from measurements that obey the plant's equations."""

import numpy as np
import pytest

from baselines.estimators import interacting_models as im
from baselines.estimators import turning as turning_equation
from baselines.estimators.measurement import COLUMN, Status
from baselines.estimators.turning import TurningEstimator
from tests.baselines.estimators.motion_cases import CLAY, EXACT, RTK, follow, measurements
from tests.baselines.estimators.state_columns import AGREEMENT, ALARM, BELTS, TURNED
from tests.baselines.estimators.turning_cases import (
    LATERAL_MODELS,
    TRUTH,
    estimator,
    relative_error,
    true_values,
    with_lateral_model,
)
from tracked_env.physics import terramechanics as soil

# --- exact where the model is ---------------------------------------------------------------


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("factor", [1.0, 2.0])
@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_without_noise_inertia_and_lateral_resistance_are_found(kind, factor, lateral_model):
    truth, nominal = with_lateral_model(TRUTH, factor), with_lateral_model(CLAY, factor)
    found = estimator(nominal=nominal, lateral=lateral_model)
    last = follow(found, measurements(truth, kind, lateral_model))[-1]
    assert np.abs(relative_error(last, truth)).max() < 2e-4  # what is left of the prior
    assert last.status[0] == Status.CONVERGING


def test_the_lateral_velocity_is_found_from_the_lateral_acceleration():
    known = estimator()._constants
    for w in (-1.0, -0.2, -0.05, 0.03, 0.1, 0.6):
        for share in np.linspace(-0.5, 0.5, 11):
            v_y = share * np.hypot(0.5 * CLAY.contact_length * w, 0.03)
            intensity = 0.7 * soil.GRAVITY / CLAY.contact_length
            a_y, _moment = soil.lateral_friction(v_y, w, intensity, CLAY.contact_length)
            found, _shift, _noise = turning_equation.sideways(a_y, w, 1.0 / 0.7, known)
            assert found == pytest.approx(v_y, rel=0.01, abs=1e-9)


@pytest.mark.parametrize("lateral", [0.2, 0.4, 1.1])
def test_a_far_lateral_resistance_is_found_although_the_regressor_depends_on_it(lateral):
    truth = TRUTH._replace(lateral_resistance=lateral)
    last = follow(estimator(), measurements(truth, "curves"))[-1]
    assert np.abs(relative_error(last, truth)).max() < 1e-3


def test_with_opposite_tracks_the_motion_resistance_enters():
    # Both resistances turn the same way: a wrong mu_l is taken for lateral friction.
    found = estimator()
    found.vehicles["resistance"][:] = 0.5 * TRUTH.longitudinal_resistance
    last = follow(found, measurements(TRUTH, "pivot"))[-1]
    extra = 0.25 * TRUTH.longitudinal_resistance * CLAY.track_gauge  # over mu_t l / 4, at v_y = 0
    expected = extra / (0.25 * TRUTH.lateral_resistance * CLAY.contact_length)
    assert relative_error(last, TRUTH)[0, 1] == pytest.approx(expected, rel=0.2)
    same = estimator()
    same.vehicles["resistance"][:] = 0.5 * TRUTH.longitudinal_resistance
    both_forward = follow(same, measurements(TRUTH, "curves"))[-1]
    assert np.abs(relative_error(both_forward, TRUTH)).max() < 2e-4


# --- noise ----------------------------------------------------------------------------------


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("factor", [1.0, 2.0])
@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_with_the_noise_of_the_sensors_errors_are_small_and_as_large_as_said(
    kind, factor, lateral_model
):
    count = 100
    truth, nominal = with_lateral_model(TRUTH, factor), with_lateral_model(CLAY, factor)
    found = estimator(RTK, count, nominal, lateral=lateral_model)
    results = follow(found, measurements(truth, kind, lateral_model, RTK, count))
    error = relative_error(results[-1], truth)
    assert np.sqrt((error**2).mean(0)).max() < 0.02
    for result in results[200::100]:
        error = result.value - true_values(truth)
        sigma = np.stack([result.deviation(name) for name in result.names], axis=1)
        assert (np.abs(error) < 3.0 * sigma).mean() > 0.97
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance), error)
        assert 0.1 < squared.mean() < 2.4
    assert 0.6 < np.nanmean([result.nis for result in results[50:]]) < 1.2


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("sheet", [EXACT, RTK], ids=["exact", "rtk"])
def test_on_the_straight_it_holds_however_long(sheet, lateral_model):
    count = 10
    found = estimator(sheet, count, lateral=lateral_model)
    fresh = follow(found, measurements(TRUTH, "straight", lateral_model, sheet, count))[-1]
    assert not found.memory.any()
    assert (fresh.excitation == 0.0).all()
    assert (fresh.status == Status.HOLDING).all()
    follow(found, measurements(TRUTH, "curves", lateral_model, sheet, count))
    memory = found.memory.copy()
    after = follow(found, measurements(TRUTH, "straight", lateral_model, sheet, count))[-1]
    assert np.array_equal(found.memory, memory)
    assert np.abs(relative_error(after, TRUTH)).max() < 0.1


def test_other_soil_is_found_and_the_inertia_kept():
    count = 50
    before = measurements(TRUTH, "curves", sheet=RTK, count=count, steps=600)
    slippery = TRUTH._replace(lateral_resistance=0.4)
    after = measurements(slippery, "curves", sheet=RTK, count=count, steps=600, seed=1)
    found = estimator(RTK, count)
    last = follow(found, before + after)[-1]
    error = np.abs(relative_error(last, slippery))
    assert np.quantile(error, 0.9, axis=0).max() < 0.05


# --- the mass -------------------------------------------------------------------------------


def test_the_uncertainty_of_the_mass_adds_to_that_of_the_lateral_resistance():
    samples = measurements(TRUTH, "curves", sheet=RTK)
    sure, unsure = estimator(RTK), estimator(RTK)
    unsure.vehicles["mass_variance"][:] = (0.1 * TRUTH.mass) ** 2
    one, other = follow(sure, samples)[-1], follow(unsure, samples)[-1]
    assert np.array_equal(one.value, other.value)
    added = (0.1 * one.of("lateral_resistance")) ** 2
    assert other.covariance - one.covariance == pytest.approx(
        np.array([[[0.0, 0.0], [0.0, added[0]]]]), rel=1e-9
    )
    assert np.array_equal(unsure.read().covariance, other.covariance)


def test_another_mass_rescales_the_lateral_resistance_so_that_the_friction_stays():
    found = estimator(RTK)
    before = follow(found, measurements(TRUTH, "curves", sheet=RTK))[-1]
    found.vehicles["mass"][:] *= 1.25
    after = found.read()
    assert after.value[0] == pytest.approx(before.value[0] / [1.0, 1.25], rel=1e-12)
    assert after.deviation("lateral_resistance") == pytest.approx(
        before.deviation("lateral_resistance") / 1.25, rel=1e-12
    )
    assert after.of("inertia") == before.of("inertia")


def test_a_jump_elsewhere_keeps_the_values_and_forgets_how_sure_they_were():
    found = estimator(RTK, 2)
    before = follow(found, measurements(TRUTH, "curves", sheet=RTK, count=2))[-1]
    im.let_jump(found.rows[0], found.prior, found.table)
    after = found.read()
    assert after.value == pytest.approx(before.value, rel=1e-12)
    assert after.deviation("inertia")[0] > 0.2 * CLAY.inertia
    assert np.array_equal(after.covariance[1], before.covariance[1])


def test_on_a_straight_during_an_alarm_the_friction_is_less_and_less_sure_and_else_kept():
    found = estimator(RTK, 2)
    before = follow(found, measurements(TRUTH, "curves", sheet=RTK, count=2))[-1]
    found.memory[:, ALARM] = [2.0, 0.0]
    straight = measurements(TRUTH, "straight", sheet=RTK, count=2, steps=100)
    after = follow(found, straight)[-1]
    assert after.value == pytest.approx(before.value, rel=1e-12)
    wider = after.deviation("lateral_resistance") / before.deviation("lateral_resistance")
    expected = 0.15 * np.sqrt(2.0) * CLAY.lateral_resistance * CLAY.mass / TRUTH.mass
    assert after.deviation("lateral_resistance")[0] == pytest.approx(expected, rel=0.15)
    assert wider[1] == 1.0
    assert found.memory[0, ALARM] == pytest.approx(0.0, abs=0.03)


# --- bounds and errors ----------------------------------------------------------------------


def belts_slip(samples, share):
    """The samples with belts that turn faster than the vehicle by a slip share [-] of theirs."""
    left, right = COLUMN["sprocket_speed_left"], COLUMN["sprocket_speed_right"]
    for sample in samples:
        middle = 0.5 * (sample.values[:, left] + sample.values[:, right])
        half = 0.5 * (sample.values[:, right] - sample.values[:, left]) / (1.0 - share)
        sample.values[:, left], sample.values[:, right] = middle - half, middle + half
    return samples


@pytest.mark.parametrize("share", [0.25, -0.5])
def test_where_belts_slip_in_turns_the_inertia_may_be_wrong_by_that_share_of_the_yaw_rate(share):
    rolling, slipping = estimator(RTK), estimator(RTK)
    follow(rolling, measurements(TRUTH, "curves", sheet=RTK))
    follow(slipping, belts_slip(measurements(TRUTH, "curves", sheet=RTK), share))
    first, last = rolling.read(), slipping.read()
    assert np.array_equal(first.value, last.value)  # a claim, no part of the recursion
    size = share if share > 0.0 else -share / (1.0 - share)
    inertia = first.of("inertia")[0]
    assert last.deviation("inertia")[0] ** 2 == pytest.approx(
        first.deviation("inertia")[0] ** 2 + (size * inertia) ** 2 / 3.0, rel=1e-2
    )
    assert np.array_equal(
        first.deviation("lateral_resistance"), last.deviation("lateral_resistance")
    )
    # A side slip that speaks for friction that is not shared makes it less.
    slipping.memory[:, AGREEMENT] = 3.0
    assert slipping.read().deviation("inertia")[0] ** 2 == pytest.approx(
        first.deviation("inertia")[0] ** 2 + (size * inertia) ** 2 / 12.0, rel=1e-2
    )


def test_the_claim_of_the_inertia_is_never_wider_than_the_prior_and_counts_no_missing_belt():
    found = estimator(RTK)
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=50)
    follow(found, samples)
    found.memory[:, TURNED], found.memory[:, BELTS] = 0.1, 10.0
    assert found.read().deviation("inertia")[0] == pytest.approx(found.prior.sigma_1)
    before = found.memory[:, [TURNED, BELTS]].copy()
    samples[-1].values[:, COLUMN["sprocket_speed_left"]] = np.nan
    found.update(samples[-1])
    assert np.array_equal(found.memory[:, [TURNED, BELTS]], before)


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
def test_bounds_hold_under_dropouts_outliers_and_reversals(lateral_model):
    rng = np.random.default_rng(6)
    found = estimator(RTK, 20, lateral=lateral_model)
    samples = []
    for seed, kind in enumerate(("curves", "reverse", "pivot", "straight", "curves")):
        samples += measurements(TRUTH, kind, lateral_model, RTK, count=20, seed=seed, steps=300)
    for sample in samples:
        wild = rng.random(sample.values.shape) < 0.01
        sample.values[wild] *= rng.choice([-50.0, 0.0, 50.0, np.nan], wild.sum())
        estimate = found.update(sample)
        assert (estimate.value >= [CLAY.inertia / 6.0, 0.0]).all()
        assert (estimate.value <= [6.0 * CLAY.inertia, 2.0]).all()
        assert (np.linalg.eigvalsh(estimate.covariance * [[1e-6, 1e-3], [1e-3, 1.0]]) > 0.0).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lateral": "slide"}, "lateral"),
        ({"control_period": -0.02}, "control_period"),
        ({"count": 0}, "count"),
        ({"forgetting": 0.002}, "lambda"),
    ],
)
def test_nonsense_is_refused_with_a_reason(options, message):
    with pytest.raises(ValueError, match=message):
        TurningEstimator(CLAY, **options)
