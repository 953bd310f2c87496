"""Core of the model-reference adaptation: against an ODE solver, and the theorems of the law."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from baselines.augmented.mrac import Adaptation, Load, Sample, adapted, beyond, demanded
from tracked_env.physics.jit import loop

LOW, HIGH, NOMINAL = Load(0.2, 0.0, -5.0), Load(4.0, 4.0, 5.0), Load(1.0, 1.0, 0.0)
TRUE = (1.7, 0.6, 0.8)


GAIN = Load(20.0, 5.0, 5.0)


def law(gain=GAIN, rate=5.0, leak=0.0, dead_zone=0.0, low=LOW, high=HIGH):
    return Adaptation(gain, low, high, NOMINAL, rate, leak, dead_zone)


@loop
def run(changes, thrust, resisting, numbers, period, out):
    """Parameters and error (T, 4) of one channel that starts at the nominal parameters."""
    p, error = numbers.nominal, 0.0
    for k in range(changes.size):
        p, error = adapted(p, error, Sample(changes[k], thrust[k], resisting[k]), numbers, period)
        out[k, 0], out[k, 1], out[k, 2] = p
        out[k, 3] = error


def adapt(changes, thrust, resisting, numbers, period):
    out = np.empty((len(changes), 4))
    run(changes, thrust, resisting, numbers, period, out)
    return out


def signals(time, exciting=True):
    """(thrust, resisting) at these times."""
    if not exciting:
        return np.full_like(time, 2.0), np.full_like(time, 1.0)
    thrust = 2.0 + 1.5 * np.sin(1.3 * time) + np.sin(3.1 * time)
    return thrust, 1.0 + 0.8 * np.cos(2.1 * time)


def plant(duration, period, exciting=True, true=TRUE):
    """Changes of x, and means of thrust and resisting over each period, of the linear plant
    true[0] x' = thrust - true[1] resisting - true[2]; means by Simpson's rule on a fine grid."""
    steps, fine = round(duration / period), 8
    time = period / fine * np.arange(steps * fine + 1)
    weights = np.array([1.0, *([4.0, 2.0] * (fine // 2 - 1)), 4.0, 1.0]) / (3.0 * fine)
    windows = np.arange(steps)[:, None] * fine + np.arange(fine + 1)
    thrust, resisting = (signal[windows] @ weights for signal in signals(time, exciting))
    changes = period * (thrust - true[1] * resisting - true[2]) / true[0]
    return changes, thrust, resisting


def by_ode(numbers, duration, count, true=TRUE):
    """(parameters, error) (count, 4) at equal times, by scipy, written from the equations."""
    gain, nominal = np.array(numbers.gain), np.array(numbers.nominal)

    def rates(time, state):
        p, error = state[:3], state[3]
        thrust, resisting = signals(np.float64(time))
        a = (thrust - p[1] * resisting - p[2]) / p[0]
        y = np.array([a, resisting, 1.0])
        effect = error - np.clip(error, -numbers.dead_zone, numbers.dead_zone)
        change = -gain * y * effect / (1.0 + y @ (gain * y) / numbers.rate**2)
        x_rate = (thrust - true[1] * resisting - true[2]) / true[0]
        leak = numbers.leak * (p - nominal)
        return [*(change - leak), -numbers.rate * error + x_rate - a]

    times = duration / count * np.arange(1, count + 1)
    options = {"rtol": 1e-11, "atol": 1e-12, "max_step": 0.01}
    return solve_ivp(rates, (0.0, duration), [*nominal, 0.0], "DOP853", times, **options).y.T


@pytest.mark.parametrize(("leak", "dead_zone"), [(0.0, 0.0), (0.3, 0.0), (0.1, 0.01)])
def test_the_law_on_a_linear_plant_is_the_ode_to_1e_6(leak, dead_zone):
    numbers, duration, period = law(leak=leak, dead_zone=dead_zone), 3.0, 2.5e-4
    exact = by_ode(numbers, duration, 60)
    got = adapt(*plant(duration, period), numbers, period)
    every = round(duration / 60 / period)
    assert np.abs(got[every - 1 :: every] - exact).max() < 1e-6
    assert np.abs(exact[-1, :3] - NOMINAL).max() > 0.2


def test_the_error_of_the_sampled_law_is_of_second_order_in_the_period():
    numbers, errors = law(), []
    exact = by_ode(numbers, 2.0, 10)
    for period in (0.01, 0.005, 0.0025):
        every = round(0.2 / period)
        got = adapt(*plant(2.0, period), numbers, period)
        errors.append(np.abs(got[every - 1 :: every] - exact).max())
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (order > 1.8).all() and (order < 2.2).all()


def test_parameters_converge_where_the_input_excites_them_and_the_prediction_does_anyway():
    exciting = adapt(*plant(480.0, 0.02), law(), 0.02)
    errors = np.abs(exciting[:, :3] - TRUE).max(axis=1)[5999::6000]
    assert (errors[1:] < 0.5 * errors[:-1]).all()  # exponentially
    assert errors[-1] < 1e-3
    assert np.abs(exciting[-500:, 3]).max() < 1e-4
    steady = adapt(*plant(120.0, 0.02, exciting=False), law(), 0.02)
    assert np.abs(steady[-500:, 3]).max() < 1e-4
    assert np.abs(steady[-1, :3] - TRUE).max() > 0.3  # no claim without excitation
    truth = (2.0 - TRUE[1] - TRUE[2]) / TRUE[0]
    assert demanded(Load(*steady[-1, :3]), 2.0, 1.0) == pytest.approx(truth, abs=1e-3)


def test_parameters_never_leave_the_projection_set():
    rng = np.random.default_rng(1)
    low, high = Load(0.7, 0.5, -0.2), Load(1.3, 1.2, 0.3)
    changes, thrust, resisting = plant(20.0, 0.02)
    changes += rng.normal(size=changes.size)  # nonsense of metres per second
    numbers = law(gain=Load(1e4, 1e4, 1e4), low=low, high=high)
    out = adapt(changes, thrust, resisting, numbers, 0.02)
    assert (out[:, :3] >= np.array(low)).all() and (out[:, :3] <= np.array(high)).all()
    for k in range(3):
        assert set(out[:, k]) >= {low[k], high[k]}  # both ends were reached


def test_sigma_modification_leaves_the_bias_of_its_closed_form():
    """At rest with constant signals l e = x' - a and p - p_0 = -g y e / k, where
    g = G / (1 + y' G y / l^2): one equation for a, solved by a method of scipy."""
    leak, gain, rate = 0.5, Load(2.0, 1.0, 0.5), 5.0
    out = adapt(*plant(400.0, 0.02, exciting=False), law(gain, rate, leak), 0.02)
    truth = (2.0 - TRUE[1] - TRUE[2]) / TRUE[0]

    def parameters(a):
        y = np.array([a, 1.0, 1.0])
        share = np.array(gain) * y / (1.0 + y @ (np.array(gain) * y) / rate**2)
        return np.array(NOMINAL) - share * (truth - a) / rate / leak

    a = brentq(lambda a: demanded(Load(*parameters(a)), 2.0, 1.0) - a, -3.0, 3.0, xtol=1e-13)
    assert out[-1] == pytest.approx([*parameters(a), (truth - a) / rate], abs=1e-6)
    assert abs(out[-1, 3]) > 1e-3  # a bias it is


def test_errors_within_the_dead_zone_change_nothing():
    assert beyond(0.3, 0.1) == pytest.approx(0.2)
    assert beyond(-0.3, 0.1) == pytest.approx(-0.2)
    out = adapt(*plant(5.0, 0.02), law(dead_zone=10.0), 0.02)
    assert (out[:, :3] == np.array(NOMINAL)).all()
