"""The loops of the L1 augmentation: one channel against the exact solution, and that of a drive."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from baselines.augmented.augmented_policy import (
    CHANNEL_COLUMN,
    DRIVE_COLUMNS,
    LARGEST_CORRECTION,
    DriveLoop,
    Estimate,
    Loop,
    correct_all,
    drive_period,
    mean_of,
    predictor_gains,
    sampled,
)
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


def test_without_a_filter_the_loop_is_the_reference_model_but_for_an_error_of_first_order():
    """x' = -2 x + 0.6 (u - d) + 4 is driven as x' = -2 x + u, whose answer is known."""
    errors = []
    for period in (0.004, 0.002, 0.001):
        out = closed_loop(1.5, 0.6, 4.0, 2.0, 0.0, math.inf, period, round(2.0 / period))
        time = period * np.arange(1, len(out) + 1)
        errors.append(np.abs(out[:, 0] - 0.75 * (1.0 - np.exp(-2.0 * time))).max())
    assert errors[-1] < 0.01
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 0.9).all() and (order < 1.1).all()


@pytest.mark.parametrize("bandwidth", [1.0, 5.0])
def test_the_loop_with_its_low_pass_filter_has_the_pole_of_theory_and_settles(bandwidth):
    """x' = b (u - d) + s, d' = w (s^ - d), s^ = (b - 1)(u - d) + s: pole -w b, d settles at
    u + (s - u) / b with u constant."""
    gain, lack, demand, period = 1.6, -2.0, 1.0, 1e-4
    out = closed_loop(demand, gain, lack, 0.0, 0.0, bandwidth, period, 10000)
    time = period * np.arange(1, len(out) + 1)
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


PERIOD, LAG = 0.02, 0.05
DECAY = math.exp(-PERIOD / LAG)


@loop
def take(memory, sent, torque, drive):
    """One period of the left drive of the first vehicle; its mean torque."""
    return drive_period(memory, 0, 0, sent, torque, drive)


def driven(demands, gain=1.0, lag=LAG, bandwidth=150.0, noise=0.0, missing=(), wrong=()):
    """What the drive gives after every period, and the commands, for demands (T,)."""
    rng, memory = np.random.default_rng(0), np.zeros((1, CHANNEL_COLUMN))
    torque, sent, given, commands = 0.0, 0.0, [], []
    decay = math.exp(-PERIOD / lag)
    for k, demand in enumerate(demands):
        seen = math.nan if k in missing else torque + noise * rng.standard_normal()
        seen = -0.8 if k in wrong else seen
        take(memory, sent, seen, DriveLoop(LAG, DECAY, bandwidth, PERIOD))
        action = np.array([[demand, 0.0]], dtype=np.float32)
        correct_all(memory, action)
        sent = float(action[0, 0])
        torque = gain * sent + (torque - gain * sent) * decay
        given.append(torque)
        commands.append(sent)
    return np.array(given), np.array(commands)


def demands(size=0.3):
    time = PERIOD * np.arange(300)
    return size * (np.sin(2.0 * time) + 0.3 * np.sin(9.0 * time))


def test_the_nominal_drive_is_left_alone():
    given, commands = driven(demands())
    np.testing.assert_allclose(commands, demands(), atol=1e-6)
    assert np.abs(given).max() > 0.1


@pytest.mark.parametrize(("gain", "lag"), [(0.4, LAG), (0.7, LAG), (1.0, 0.3), (0.6, 0.15)])
def test_a_weak_or_slow_drive_answers_as_the_nominal_one(gain, lag):
    wanted, _ = driven(demands())
    plain, _ = driven(demands(), gain, lag, bandwidth=0.0)
    led, _ = driven(demands(), gain, lag)
    after, before = (np.sqrt(np.mean((given - wanted)[50:] ** 2)) for given in (led, plain))
    assert after < 0.35 * before


def test_a_constant_demand_is_given_exactly_by_a_weak_drive():
    given, _ = driven(np.full(300, 0.3), gain=0.4)
    assert given[-1] == pytest.approx(0.3, abs=0.01)  # exp(-a dt) of the correction is missing
    without, _ = driven(np.full(300, 0.3), gain=0.4, bandwidth=0.0)
    assert without[-1] == pytest.approx(0.12, abs=1e-6)


def test_the_correction_does_not_wind_up_at_the_limit_of_the_drive():
    """A demand that a weak drive cannot give, then one of the other sign: no later than at once."""
    steps = np.r_[np.full(200, 1.0), np.full(50, -0.1)]
    given, commands = driven(steps, gain=0.4)
    assert commands[150] == 1.0 and given[150] == pytest.approx(0.4, abs=1e-3)
    short, _ = driven(np.r_[np.full(200, 0.39), np.full(50, -0.1)], gain=0.4)
    assert np.abs(given[212:] - short[212:]).max() < 0.03
    assert LARGEST_CORRECTION == 1.0


def test_missing_torques_hold_what_is_known_and_do_not_spoil_it():
    wanted = np.full(300, 0.3)
    some = tuple(range(100, 140)) + tuple(range(141, 200, 3))
    given, _ = driven(wanted, gain=0.5, missing=some)
    assert np.abs(given[60:] - 0.3).max() < 0.02


def test_readings_that_no_drive_could_have_reached_are_not_believed():
    wanted = np.full(300, 0.3)
    some = tuple(range(80, 300, 13))
    given, _ = driven(wanted, gain=0.7, wrong=some)
    assert np.abs(given[60:] - 0.3).max() < 0.02


def test_commands_stay_within_the_limits():
    _, commands = driven(demands(1.0), gain=0.5, lag=0.3, noise=0.05)
    assert np.abs(commands).max() == 1.0


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.4])
def test_the_mean_torque_of_a_period_is_that_of_the_exponential(lag):
    decay = math.exp(-PERIOD / lag) if lag else 0.0
    before, command = 0.2, 0.9
    now = command + (before - command) * decay
    time = np.linspace(0.0, PERIOD, 20001)[1:]
    curve = command + (before - command) * (np.exp(-time / lag) if lag else 0.0 * time)
    got = mean_of(before, now, DriveLoop(lag, decay, 0.0, PERIOD))
    assert got == pytest.approx(curve.mean(), abs=2e-5)


def test_both_drives_of_a_vehicle_have_columns_of_their_own():
    assert CHANNEL_COLUMN >= 2 * DRIVE_COLUMNS
    memory, action = np.zeros((1, CHANNEL_COLUMN)), np.zeros((1, 2), dtype=np.float32)
    memory[0, 4], memory[0, DRIVE_COLUMNS + 4] = 0.25, -0.5
    correct_all(memory, action)
    np.testing.assert_array_equal(action, [[-0.25, 0.5]])
