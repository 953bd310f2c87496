"""The loop around each drive: weak and slow drives answer as the nominal one."""

import math

import numpy as np
import pytest

from baselines.augmented.augmented_policy import (
    CHANNEL_COLUMN,
    DRIVE_COLUMNS,
    LARGEST_CORRECTION,
    DriveLoop,
    correct_all,
    drive_period,
    mean_of,
)
from tracked_env.physics.jit import loop

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
