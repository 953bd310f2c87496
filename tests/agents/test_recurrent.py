"""The policy with an LSTM: what reaches its action and its value, and what learns."""

import pytest
import torch

from agents.algorithms import RecurrentPPOSettings, make_model
from agents.environments import make_environment
from agents.run import resolve
from tests.agents.agent_cases import small


@pytest.fixture
def policy(tmp_path):
    config = small(tmp_path, agent="recurrent-ppo")
    env = make_environment(resolve(config))
    settings = RecurrentPPOSettings(hidden=(16,), lstm_hidden=8)
    return make_model("recurrent-ppo", settings, env, 0).policy


def outcome(policy, observation, state):
    """Mean action and value of observation (N, D) after LSTM state (1, N, H)."""
    start = torch.zeros(len(observation))
    action, _ = policy.get_distribution(observation, state, start)
    return action.mode(), policy.predict_values(observation, state, start)


def test_an_observation_reaches_the_action_where_the_memory_is_dead(policy):
    with torch.no_grad():
        for weights in policy.lstm_actor.parameters():
            weights.zero_()
        policy.action_net.weight.mul_(100.0)  # it begins next to 0
        state = (torch.zeros(1, 2, 8), torch.zeros(1, 2, 8))
        action, _ = outcome(policy, torch.randn(2, policy.features_dim), state)
    assert (action[0] - action[1]).abs().max() > 0.01


def test_the_memory_reaches_the_action_and_not_the_value(policy):
    """One call for each state: rows of one matrix product may be rounded differently."""
    with torch.no_grad():
        policy.action_net.weight.mul_(100.0)
        observation = torch.randn(1, policy.features_dim)
        states = [(torch.randn(1, 1, 8), torch.randn(1, 1, 8)) for _ in range(2)]
        (action, value), (other, same) = (outcome(policy, observation, state) for state in states)
    assert (action - other).abs().max() > 0.01
    assert torch.equal(value, same)


def test_every_parameter_is_in_the_optimiser_and_the_value_trains_its_own_layers(policy):
    held = {id(weights) for group in policy.optimizer.param_groups for weights in group["params"]}
    assert held == {id(weights) for weights in policy.parameters()}
    state = (torch.zeros(1, 3, 8), torch.zeros(1, 3, 8))
    _, value = outcome(policy, torch.randn(3, policy.features_dim), state)
    value.sum().backward()
    assert policy.critic.weight.grad.abs().max() > 0.0
    assert all(weights.grad is None for weights in policy.lstm_actor.parameters())
