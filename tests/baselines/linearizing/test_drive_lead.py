"""Commands that lead a slow drive: it answers as the nominal one, within the limits."""

import numpy as np
import pytest

from baselines.linearizing.linearizing_policy import LARGEST_LEAD, lead_all
from tracked_env import observation as layout
from tracked_env.physics.parameters import PARAMETER_INDEX, VEHICLES

PERIOD, NOMINAL_LAG = 0.02, 0.05
NOMINAL = np.array(VEHICLES["strawa"], dtype=np.float64)


def respond(demands, lag, model_lag=None):
    """(actions sent, what the drive gives) (T, 2) for demands (T, 2); model_lag [s] of the lead."""
    parameters = NOMINAL[:, None].copy()
    parameters[PARAMETER_INDEX["drive_time_constant"]] = lag if model_lag is None else model_lag
    decay = np.exp(-PERIOD / lag)
    delivered, sent, torque = np.zeros((1, 2)), [np.zeros(2, np.float32)], [np.zeros(2)]
    for k, demand in enumerate(demands):
        observation = np.zeros((1, layout.SIZE), dtype=np.float32)
        column = layout.INDEX["previous_action_left"]
        observation[0, column : column + 2] = sent[-1]
        action = np.array([demand], dtype=np.float32)
        start = np.array([k == 0])
        lead_all(observation, start, parameters, NOMINAL_LAG, PERIOD, delivered, action)
        sent.append(action[0])
        torque.append(decay * torque[-1] + (1.0 - decay) * action[0])
    return np.array(sent[1:]), np.array(torque[1:])


def demands(size):
    """(200, 2) that vary slowly and jitter, of magnitude `size` [-]."""
    rng, time = np.random.default_rng(0), PERIOD * np.arange(200)[:, None]
    return size * (np.sin(2.0 * time + [0.0, 1.0]) + 0.05 * rng.standard_normal((200, 2)))


@pytest.mark.parametrize("lag", [0.06, 0.15, 0.3])
def test_a_slow_drive_answers_as_the_nominal_one(lag):
    wanted = demands(0.2)
    _, nominal = respond(wanted, NOMINAL_LAG)
    sent, torque = respond(wanted, lag)
    assert np.abs(sent).max() < 1.0
    np.testing.assert_allclose(torque, nominal, atol=1e-6)
    _, without = respond(wanted, lag, model_lag=NOMINAL_LAG)
    assert np.abs(without - nominal).max() > 0.01


@pytest.mark.parametrize("lag", [0.0, 0.02, NOMINAL_LAG])
def test_a_drive_as_fast_as_the_nominal_one_gets_the_demand_to_the_bit(lag):
    wanted = demands(0.5).astype(np.float32)
    sent, _ = respond(wanted, max(lag, 1e-3), model_lag=lag)
    np.testing.assert_array_equal(sent, wanted)


def test_commands_stay_within_the_limits_and_the_lead_within_its_own():
    sent, _ = respond(demands(1.0), 0.3)
    assert np.abs(sent).max() == 1.0
    step = np.full((1, 2), 0.01)
    sent, _ = respond(step, 5.0)
    np.testing.assert_allclose(sent, LARGEST_LEAD * step, rtol=1e-6)
