"""Inertia and lateral resistance from measurements that obey the plant's equations, and turns on
soil that resists by its cohesion: C is followed, the inertia is left as it was."""

import numpy as np
import pytest

from baselines.estimators import interacting_models as im
from baselines.estimators import turning as equations
from baselines.estimators.least_squares import Sample
from baselines.estimators.measurement import COLUMN, Status
from tests.baselines import observer_runs
from tests.baselines.estimators.motion_cases import (
    CLAY,
    EXACT,
    LATERAL_MODELS,
    RTK,
    TRUTH,
    assert_consistent,
    follow,
    measurements,
    true_across,
    turning,
    with_lateral_model,
)
from tracked_env.physics import terramechanics as soil
from tracked_env.physics.parameters import RANGES

FIRM = TRUTH._replace(lateral_resistance=2.0 * RANGES["lateral_resistance"].high)


def relative_error(estimate, p):
    """(N, 2) of I and mu_t."""
    return estimate.value / true_across(p) - 1.0


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("factor", [1.0, 2.0])
@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_without_noise_inertia_and_lateral_resistance_are_found(kind, factor, lateral_model):
    truth, nominal = with_lateral_model(TRUTH, factor), with_lateral_model(CLAY, factor)
    part = turning(nominal=nominal, lateral=lateral_model)
    last = follow(part, measurements(truth, kind, lateral_model))[-1]
    assert np.abs(relative_error(last, truth)).max() < 2e-4  # what is left of the prior
    assert last.status[0] == Status.CONVERGING


def test_the_lateral_velocity_is_found_from_the_lateral_acceleration():
    constants = turning()._constants
    for w in (-1.0, -0.2, -0.05, 0.03, 0.1, 0.6):
        for share in np.linspace(-0.5, 0.5, 11):
            v_y = share * np.hypot(0.5 * CLAY.contact_length * w, 0.03)
            intensity = 0.7 * soil.GRAVITY / CLAY.contact_length
            a_y, _moment = soil.lateral_friction(v_y, w, intensity, CLAY.contact_length)
            part, _shift, _noise = equations.sideways(a_y, w, 1.0 / 0.7, constants)
            assert part == pytest.approx(v_y, rel=0.01, abs=1e-9)


@pytest.mark.parametrize("lateral", [0.2, 0.4, 1.1])
def test_a_far_lateral_resistance_is_found_although_the_regressor_depends_on_it(lateral):
    truth = TRUTH._replace(lateral_resistance=lateral)
    last = follow(turning(), measurements(truth, "curves"))[-1]
    assert np.abs(relative_error(last, truth)).max() < 1e-3


def test_with_opposite_tracks_the_motion_resistance_enters():
    # Both resistances turn the same way: a wrong mu_l is taken for lateral friction.
    part = turning()
    part.vehicles["resistance"][:] = 0.5 * TRUTH.longitudinal_resistance
    last = follow(part, measurements(TRUTH, "pivot"))[-1]
    extra = 0.25 * TRUTH.longitudinal_resistance * CLAY.track_gauge  # over mu_t l / 4, at v_y = 0
    expected = extra / (0.25 * TRUTH.lateral_resistance * CLAY.contact_length)
    assert relative_error(last, TRUTH)[0, 1] == pytest.approx(expected, rel=0.2)
    same = turning()
    same.vehicles["resistance"][:] = 0.5 * TRUTH.longitudinal_resistance
    both_forward = follow(same, measurements(TRUTH, "curves"))[-1]
    assert np.abs(relative_error(both_forward, TRUTH)).max() < 2e-4


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("factor", [1.0, 2.0])
@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_with_the_noise_of_the_sensors_errors_are_small_and_as_large_as_said(
    kind, factor, lateral_model
):
    count = 100
    truth, nominal = with_lateral_model(TRUTH, factor), with_lateral_model(CLAY, factor)
    part = turning(RTK, count, nominal, lateral=lateral_model)
    results = follow(part, measurements(truth, kind, lateral_model, RTK, count))
    error = relative_error(results[-1], truth)
    assert np.sqrt((error**2).mean(0)).max() < 0.02
    assert_consistent(results[200::100], true_across(truth), 0.1, 2.4)
    assert 0.6 < np.nanmean([result.nis for result in results[50:]]) < 1.2


@pytest.mark.parametrize("lateral_model", LATERAL_MODELS)
@pytest.mark.parametrize("sheet", [EXACT, RTK], ids=["exact", "rtk"])
def test_on_the_straight_it_holds_however_long(sheet, lateral_model):
    count = 10
    part = turning(sheet, count, lateral=lateral_model)
    fresh = follow(part, measurements(TRUTH, "straight", lateral_model, sheet, count))[-1]
    assert not part.memory.any()
    assert (fresh.excitation == 0.0).all()
    assert (fresh.status == Status.HOLDING).all()
    follow(part, measurements(TRUTH, "curves", lateral_model, sheet, count))
    memory = part.memory.copy()
    after = follow(part, measurements(TRUTH, "straight", lateral_model, sheet, count))[-1]
    assert np.array_equal(part.memory, memory)
    assert np.abs(relative_error(after, TRUTH)).max() < 0.1


def test_the_uncertainty_of_the_mass_adds_to_that_of_the_lateral_resistance():
    samples = measurements(TRUTH, "curves", sheet=RTK)
    sure, unsure = turning(RTK), turning(RTK)
    unsure.vehicles["mass_variance"][:] = (0.1 * TRUTH.mass) ** 2
    one, other = follow(sure, samples)[-1], follow(unsure, samples)[-1]
    assert np.array_equal(one.value, other.value)
    added = (0.1 * one.of("lateral_resistance")) ** 2
    assert other.covariance - one.covariance == pytest.approx(
        np.array([[[0.0, 0.0], [0.0, added[0]]]]), rel=1e-9
    )
    assert np.array_equal(unsure.read().covariance, other.covariance)


def test_another_mass_rescales_the_lateral_resistance_so_that_the_friction_stays():
    part = turning(RTK)
    before = follow(part, measurements(TRUTH, "curves", sheet=RTK))[-1]
    part.vehicles["mass"][:] *= 1.25
    after = part.read()
    assert after.value[0] == pytest.approx(before.value[0] / [1.0, 1.25], rel=1e-12)
    assert after.deviation("lateral_resistance") == pytest.approx(
        before.deviation("lateral_resistance") / 1.25, rel=1e-12
    )
    assert after.of("inertia") == before.of("inertia")


def test_a_jump_elsewhere_keeps_the_values_and_forgets_how_sure_they_were():
    part = turning(RTK, 2)
    before = follow(part, measurements(TRUTH, "curves", sheet=RTK, count=2))[-1]
    walks = part.table[im.JUMP, [im.WALK_1, im.WALK_2]]
    im.walk_all(part.rows[0], part.prior, *walks)
    after = part.read()
    assert after.value == pytest.approx(before.value, rel=1e-12)
    assert after.deviation("inertia")[0] > 0.2 * CLAY.inertia
    assert np.array_equal(after.covariance[1], before.covariance[1])


def test_on_a_straight_during_an_alarm_the_friction_is_less_and_less_sure_and_else_kept():
    part = turning(RTK, 2)
    before = follow(part, measurements(TRUTH, "curves", sheet=RTK, count=2))[-1]
    part.rows["alarm"] = [2.0, 0.0]
    straight = measurements(TRUTH, "straight", sheet=RTK, count=2, steps=100)
    after = follow(part, straight)[-1]
    assert after.value == pytest.approx(before.value, rel=1e-12)
    wider = after.deviation("lateral_resistance") / before.deviation("lateral_resistance")
    expected = 0.15 * np.sqrt(2.0) * CLAY.lateral_resistance * CLAY.mass / TRUTH.mass
    assert after.deviation("lateral_resistance")[0] == pytest.approx(expected, rel=0.15)
    assert wider[1] == 1.0
    assert part.rows["alarm"][0] == pytest.approx(0.0, abs=0.03)


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
    rolling, slipping = turning(RTK), turning(RTK)
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
    slipping.rows["agreement"] = 3.0
    assert slipping.read().deviation("inertia")[0] ** 2 == pytest.approx(
        first.deviation("inertia")[0] ** 2 + (size * inertia) ** 2 / 12.0, rel=1e-2
    )


def test_the_claim_of_the_inertia_is_never_wider_than_the_prior_and_counts_no_missing_belt():
    part = turning(RTK)
    samples = measurements(TRUTH, "curves", sheet=RTK, steps=50)
    follow(part, samples)
    part.rows["turned"], part.rows["belts"] = 0.1, 10.0
    assert part.read().deviation("inertia")[0] == pytest.approx(part.prior.sigma_1)
    before = part.rows[["turned", "belts"]].copy()
    samples[-1].values[:, COLUMN["sprocket_speed_left"]] = np.nan
    part.update(samples[-1])
    assert part.rows[["turned", "belts"]] == before


# --- cohesive soil


def inertia_of(estimate):
    return estimate.value[:, 0], np.sqrt(estimate.covariance[:, 0, 0])


def gliding(before, after, seconds, period=0.02):
    """Vehicles as friction goes from one value to the other: what shear does as it builds up."""
    shares = np.arange(period, seconds, period) / seconds
    low, high = before.lateral_resistance, after.lateral_resistance
    return [before._replace(lateral_resistance=low + (high - low) * share) for share in shares]


def over_time(vehicles, seed=0):
    """One measurement of each of these vehicles, one control step after the other."""
    options = {"sheet": RTK, "seed": seed, "steps": len(vehicles)}
    runs = {p: measurements(p, "curves", **options) for p in dict.fromkeys(vehicles)}
    return [runs[p][k] for k, p in enumerate(vehicles)]


def test_on_soil_beyond_all_friction_the_resistance_is_found_and_the_inertia_stays_unknown():
    part = turning(sheet=RTK, nominal=CLAY._replace(inertia=TRUTH.inertia))
    prior, deviation = inertia_of(part.read())
    every = follow(part, measurements(FIRM, "curves", sheet=RTK, steps=500))
    value, claimed = inertia_of(every[-1])
    assert value == pytest.approx(prior) and claimed == pytest.approx(deviation, rel=1e-3)
    assert every[-1].value[0, 1] == pytest.approx(FIRM.lateral_resistance, rel=0.01)
    assert all(
        one.status[0] == Status.HOLDING for one in every[round(equations.COHESIVE_ONSET / 0.02) :]
    )


@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_friction_in_its_range_is_never_taken_for_cohesion(kind):
    part = turning(sheet=RTK)
    edge = TRUTH._replace(lateral_resistance=0.95 * RANGES["lateral_resistance"].high)
    for vehicle in (TRUTH, edge):
        part.reset()
        for sample in measurements(vehicle, kind, sheet=RTK, steps=500):
            part.update(sample)
            assert part.rows["cohesive"][0] == 0.0


def test_the_inertia_found_before_is_kept_on_clay_that_builds_its_shear_up_within_a_second():
    part = turning(sheet=RTK)
    vehicles = [TRUTH] * 300 + gliding(TRUTH, FIRM, 0.6) + [FIRM] * 150
    every = follow(part, over_time(vehicles))
    constants, deviation = inertia_of(every[299])
    assert constants == pytest.approx(TRUTH.inertia, rel=0.05)
    value, claimed = inertia_of(every[-1])
    assert value == pytest.approx(TRUTH.inertia, rel=0.05)
    assert abs(value - TRUTH.inertia) < 3.0 * claimed
    assert claimed >= 0.99 * deviation


def test_after_the_clay_the_inertia_is_learned_again():
    part = turning(sheet=RTK)
    follow(part, measurements(FIRM, "curves", sheet=RTK, steps=100))
    turns = int(1.5 * equations.COHESIVE_TIME / 0.02)
    last = follow(part, measurements(TRUTH, "curves", sheet=RTK, steps=turns))[-1]
    assert last.value[0, 0] == pytest.approx(TRUTH.inertia, rel=0.05)
    assert last.status[0] == Status.CONVERGING


def test_a_sample_on_friction_alone_says_of_it_what_the_joint_estimate_would():
    """Marginal of the joint Gaussian update, by matrices, with no covariance beforehand."""
    sample = Sample(y=9000.0, phi_1=0.8, phi_2=6.0, variance=150.0**2, noise_1=0.0)
    mean, covariance = np.array([1200.0, 1100.0]), np.diag([300.0, 200.0]) ** 2
    phi = np.array([sample.phi_1, sample.phi_2])
    gain = covariance @ phi / (phi @ covariance @ phi + sample.variance)
    joint = mean + gain * (sample.y - phi @ mean)
    left = covariance - np.outer(gain, phi @ covariance)
    alone = equations.on_friction_alone(sample, mean[0], covariance[0, 0])
    share = covariance[1, 1] * alone.phi_2
    share /= alone.phi_2 * share + alone.variance
    assert alone.phi_1 == 0.0
    assert mean[1] + share * (alone.y - alone.phi_2 * mean[1]) == pytest.approx(joint[1])
    assert (1.0 - share * alone.phi_2) * covariance[1, 1] == pytest.approx(left[1, 1])


@pytest.mark.parametrize("name", ["distributed", "distributed-alternating"])
def test_on_patches_the_claim_of_the_inertia_holds_also_where_they_are_of_clay(name):
    run = observer_runs.observe(name, 12, ["inertia"])
    normalised = ((run.value - run.truth) / run.deviation)[100:, :, 0]
    assert np.mean(normalised**2) < 1.5
    assert np.mean(np.abs(normalised) < 3.0) > 0.98
