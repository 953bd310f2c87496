"""Turns on soil that resists by its cohesion: C is followed, the inertia is left as it was."""

import numpy as np
import pytest

from baselines.estimators import turning
from baselines.estimators.least_squares import Sample
from baselines.estimators.measurement import Status
from docs import observer_runs
from tests.baselines.estimators.motion_cases import CLAY, RTK, follow, measurements
from tests.baselines.estimators.state_columns import column
from tests.baselines.estimators.turning_cases import TRUTH, estimator
from tracked_env.physics.parameters import RANGES

FIRM = TRUTH._replace(lateral_resistance=2.0 * RANGES["lateral_resistance"].high)
LEFT = column("cohesive")


def inertia_of(estimate):
    return estimate.value[:, 0], np.sqrt(estimate.covariance[:, 0, 0])


def gliding(before, after, seconds, period=0.02):
    """Vehicles as friction goes from one value to the other: what shear does as it builds up."""
    shares = np.arange(period, seconds, period) / seconds
    low, high = before.lateral_resistance, after.lateral_resistance
    return [before._replace(lateral_resistance=low + (high - low) * share) for share in shares]


def over_time(vehicles, seed=0):
    """One measurement of each of these vehicles, one control step after the other."""
    steps = len(vehicles)
    return [
        measurements(p, "curves", sheet=RTK, seed=seed, steps=steps)[k]
        for k, p in enumerate(vehicles)
    ]


def test_on_soil_beyond_all_friction_the_resistance_is_found_and_the_inertia_stays_unknown():
    found = estimator(sheet=RTK, nominal=CLAY._replace(inertia=TRUTH.inertia))
    prior, deviation = inertia_of(found.read())
    every = follow(found, measurements(FIRM, "curves", sheet=RTK, steps=500))
    value, claimed = inertia_of(every[-1])
    assert value == pytest.approx(prior) and claimed == pytest.approx(deviation, rel=1e-3)
    assert every[-1].value[0, 1] == pytest.approx(FIRM.lateral_resistance, rel=0.01)
    assert all(one.status[0] == Status.HOLDING for one in every[round(turning.LASTS / 0.02) :])


@pytest.mark.parametrize("kind", ["curves", "reverse", "pivot"])
def test_friction_in_its_range_is_never_taken_for_cohesion(kind):
    found = estimator(sheet=RTK)
    edge = TRUTH._replace(lateral_resistance=0.95 * RANGES["lateral_resistance"].high)
    for vehicle in (TRUTH, edge):
        found.reset()
        for sample in measurements(vehicle, kind, sheet=RTK, steps=500):
            found.update(sample)
            assert found.memory[0, LEFT] == 0.0


def test_the_inertia_found_before_is_kept_on_clay_that_builds_its_shear_up_within_a_second():
    found = estimator(sheet=RTK)
    vehicles = [TRUTH] * 300 + gliding(TRUTH, FIRM, 0.6) + [FIRM] * 150
    every = follow(found, over_time(vehicles))
    known, deviation = inertia_of(every[299])
    assert known == pytest.approx(TRUTH.inertia, rel=0.05)
    value, claimed = inertia_of(every[-1])
    assert value == pytest.approx(TRUTH.inertia, rel=0.05)
    assert abs(value - TRUTH.inertia) < 3.0 * claimed
    assert claimed >= 0.99 * deviation


def test_after_the_clay_the_inertia_is_learned_again():
    found = estimator(sheet=RTK)
    follow(found, measurements(FIRM, "curves", sheet=RTK, steps=100))
    turns = int(1.5 * turning.COHESIVE_TIME / 0.02)
    last = follow(found, measurements(TRUTH, "curves", sheet=RTK, steps=turns))[-1]
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
    alone = turning.on_friction_alone(sample, mean[0], covariance[0, 0])
    share = covariance[1, 1] * alone.phi_2
    share /= alone.phi_2 * share + alone.variance
    assert alone.phi_1 == 0.0
    assert mean[1] + share * (alone.y - alone.phi_2 * mean[1]) == pytest.approx(joint[1])
    assert (1.0 - share * alone.phi_2) * covariance[1, 1] == pytest.approx(left[1, 1])


@pytest.mark.parametrize("name", ["distributed", "distributed-alternating"])
def test_on_patches_the_claim_of_the_inertia_holds_also_where_they_are_of_clay(name):
    run = observer_runs.driven(name, 12)
    normalised = (run.error("inertia") / run.claimed("inertia"))[100:]
    assert np.mean(normalised**2) < 1.5
    assert np.mean(np.abs(normalised) < 3.0) > 0.98
