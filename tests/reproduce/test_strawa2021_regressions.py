"""The regressions of Strawa et al. (2021), as printed and kept bounded, on exact and noisy data."""

import numpy as np
import pytest

from baselines.estimators.longitudinal import LongitudinalEstimator
from baselines.estimators.measurement import COLUMN
from baselines.estimators.turning import TurningEstimator
from baselines.registry import nominal
from reproduce.strawa2021.identification import PaperPolicy, as_in_paper, as_printed
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
