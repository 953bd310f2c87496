"""Core of the L1 augmentation against the exact matrix exponential, and its known properties."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from baselines.augmented.augmented_policy import Estimate, Loop, predictor_gains, sampled
from tracked_env.physics.jit import loop

NONE = Estimate(0.0, 0.0, 0.0)
FREE = 1e9  # bound that is never reached


@loop
def run(changes, modelled, numbers, period, out):
    """Feed one channel; out (T, 3)."""
    estimate = Estimate(0.0, 0.0, 0.0)
    for k in range(changes.size):
        estimate = sampled(estimate, changes[k], modelled[k], numbers, period)
        out[k, 0], out[k, 1], out[k, 2] = estimate


def fed(changes, modelled, rate=2.0, bandwidth=10.0, bound=FREE, period=0.02):
    """Estimates (T, 3) after every period."""
    out = np.empty((len(changes), 3))
    modelled = np.broadcast_to(np.asarray(modelled, dtype=float), len(changes)).copy()
    run(np.asarray(changes, dtype=float), modelled, Loop(rate, bandwidth, bound), period, out)
    return out


def closed_loop(demand, gain, lack, pole, rate, bandwidth, period, steps):
    """x of the plant x' = -pole x + gain (u - d) + lack with u held, and its estimates."""
    x, estimate, xs, numbers = 0.0, NONE, [], Loop(rate, bandwidth, FREE)
    for _ in range(steps):
        u = demand - estimate.cancelled
        phi = math.exp(-pole * period) if pole else 1.0
        hold = (1.0 - phi) / pole if pole else period
        later = phi * x + hold * (gain * u + lack)
        modelled = u - pole * 0.5 * (x + later)  # the nominal model, gain 1, nothing lacking
        estimate = Estimate(*sampled(estimate, later - x, modelled, numbers, period))
        x = later
        xs.append((x, *estimate))
    return np.array(xs)


@pytest.mark.parametrize("rate", [0.0, 0.5, 20.0])
@pytest.mark.parametrize("period", [0.1, 0.02, 1e-3])
def test_predictor_and_filter_are_the_exact_solution_for_held_signals(rate, period):
    rng, bandwidth = np.random.default_rng(3), 7.0
    changes, modelled = rng.normal(size=60) * period, rng.normal(size=60)
    got = fed(changes, modelled, rate, bandwidth, FREE, period)
    # (p, x) with p' = f + s^ - a (p - x), x' = change / T; then d' = w (s^ - d): inputs as states.
    a, w = rate, bandwidth
    predictor = expm(period * np.array([[-a, a, 1, 0], [0, 0, 0, 1], [0] * 4, [0] * 4]))
    low_pass = expm(period * np.array([[-w, w], [0, 0]]))
    hold = np.diff(expm(period * np.array([[-a, 1], [0, 0]])))[0, 0] + math.exp(-a * period)
    prediction, x, estimate, filtered = 0.0, 0.0, 0.0, 0.0
    for k in range(60):
        inputs = (modelled[k] + estimate, changes[k] / period)
        prediction, x = (predictor @ [prediction, x, *inputs])[:2]
        estimate = -math.exp(-a * period) * (prediction - x) / hold
        filtered = (low_pass @ [filtered, estimate])[0]
        np.testing.assert_allclose(got[k], (prediction - x, estimate, filtered), rtol=0, atol=1e-9)


def test_the_prediction_error_of_a_constant_uncertainty_shrinks_with_the_sample_time():
    errors, lack = [], 3.0
    for period in (0.08, 0.04, 0.02, 0.01):
        out = fed(np.full(200, lack * period), 0.0, period=period)
        _, hold = predictor_gains(2.0, period)
        np.testing.assert_allclose(out[-1, 0], -hold * lack, rtol=1e-9)
        np.testing.assert_allclose(out[-1, 1], math.exp(-2.0 * period) * lack, rtol=1e-9)
        errors.append(abs(out[-1, 0]))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 0.9).all() and (order < 1.05).all()


def test_without_limit_of_bandwidth_the_reference_model_is_recovered_as_sampling_gets_fine():
    """x' = -2 x + 0.6 (u - d) + 4 is driven as x' = -2 x + u, whose answer is known."""
    errors = []
    for period in (0.004, 0.002, 0.001):
        steps = round(2.0 / period)
        out = closed_loop(1.5, 0.6, 4.0, 2.0, 0.0, math.inf, period, steps)
        time = period * np.arange(1, steps + 1)
        wanted = 0.75 * (1.0 - np.exp(-2.0 * time))
        errors.append(np.abs(out[:, 0] - wanted).max())
    assert errors[-1] < 0.01
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 0.9).all()


@pytest.mark.parametrize("bandwidth", [1.0, 5.0])
def test_with_a_low_pass_filter_the_loop_follows_the_linear_system_that_theory_gives(bandwidth):
    """x' = b (u - d) + s, d' = w (s^ - d), s^ = (b - 1)(u - d) + s: pole -w b, d settles at
    u + (s - u) / b with u constant."""
    gain, lack, demand, period = 1.6, -2.0, 1.0, 1e-4
    steps = round(1.0 / period)
    out = closed_loop(demand, gain, lack, 0.0, 0.0, bandwidth, period, steps)
    time = period * np.arange(1, steps + 1)
    final = demand + (lack - demand) / gain
    wanted = final * (1.0 - np.exp(-gain * bandwidth * time))
    assert np.abs(out[:, 3] - wanted).max() < 2e-3


def test_small_gain_a_loop_of_input_gain_below_two_settles_at_any_bandwidth():
    for gain in (0.2, 1.0, 1.9):
        out = closed_loop(1.0, gain, 5.0, 0.0, 0.5, math.inf, 0.02, 600)
        assert np.ptp(out[-50:, 3]) < 1e-6
    beyond = closed_loop(1.0, 2.2, 5.0, 0.0, 0.0, math.inf, 0.02, 600)
    assert np.abs(beyond[-1, 3]) > 1e6
    slow = closed_loop(1.0, 2.2, 5.0, 0.0, 0.5, 10.0, 0.02, 600)
    assert np.ptp(slow[-50:, 3]) < 1e-6


def test_what_is_cancelled_stays_within_its_bound_and_leaves_it_at_once():
    out = fed(np.r_[np.full(50, 9.0 * 0.02), np.zeros(50)], 0.0, bound=2.0)
    assert np.abs(out[:, 2]).max() == 2.0
    assert out[49, 2] == 2.0
    assert out[52, 2] < 2.0 * math.exp(-10.0 * 0.02)
    assert not fed(np.full(9, 1.0), 0.0, bound=0.0)[:, 2].any()


def test_the_channel_is_odd():
    rng = np.random.default_rng(0)
    changes, modelled = rng.normal(size=40), rng.normal(size=40)
    for bound in (FREE, 0.3):
        one, other = (fed(sign * changes, sign * modelled, bound=bound) for sign in (1.0, -1.0))
        np.testing.assert_array_equal(one, -other)
        assert (np.abs(one[:, 2]).max() == bound) == (bound == 0.3)
