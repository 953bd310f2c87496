"""Policies that learn: that of PPO is as in Stable-Baselines3, and what passes by an LSTM."""

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import set_random_seed
from torch import nn

from agents.algorithms import (
    ALGORITHMS,
    GaussianPolicy,
    RecurrentPPOSettings,
    Tanh,
    make_model,
)
from agents.archive import network_of
from agents.environments import make_environment
from agents.run import resolve
from tests.agents.agent_cases import SETTINGS, small

SEEN, ACTS = Box(-np.inf, np.inf, (31,), np.float32), Box(-1.0, 1.0, (2,), np.float32)


def both():
    """Their policy and ours with the same weights."""
    policies = []
    for kind, activation in ((ActorCriticPolicy, nn.Tanh), (GaussianPolicy, Tanh)):
        torch.manual_seed(0)
        layers = {"net_arch": [64, 64], "activation_fn": activation, "log_std_init": -0.7}
        policies.append(kind(SEEN, ACTS, lambda _: 1e-3, **layers))
    policies[1].load_state_dict(policies[0].state_dict())
    return policies


def batch(rows=300):
    return torch.from_numpy(np.random.default_rng(0).normal(size=(rows, 31)).astype(np.float32))


def test_tanh_is_that_of_pytorch_to_rounding_and_so_is_its_gradient():
    x = torch.linspace(-12.0, 12.0, 100_001)
    exact = np.tanh(x.numpy().astype(np.float64))
    spacing = np.spacing(np.abs(exact).astype(np.float32))
    assert (np.abs(Tanh()(x).numpy() - exact) <= 2.0 * spacing).all()
    points = torch.linspace(-4.0, 4.0, 41, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(Tanh(), points)


def test_a_rollout_draws_the_actions_that_stable_baselines_draws():
    results = []
    for policy in both():
        torch.manual_seed(5)
        with torch.no_grad():
            results.append([*policy(batch()), *policy(batch(), deterministic=True)])
    for theirs, ours in zip(*results, strict=True):
        assert theirs.shape == ours.shape and theirs.dtype == ours.dtype
        np.testing.assert_allclose(ours.numpy(), theirs.numpy(), rtol=1e-5, atol=2e-6)
    assert results[1][0].std() > 0.4  # explores
    assert (results[1][0] != results[1][3]).all()


def test_densities_entropies_values_and_their_gradients_are_those_of_stable_baselines():
    results, gradients = [], []
    actions = 0.5 * batch()[:, :2]
    for policy in both():
        value, density, entropy = policy.evaluate_actions(batch(), actions)
        results.append([part.detach().numpy() for part in (value, density, entropy)])
        weights = torch.linspace(-1.0, 2.0, len(density))
        loss = (weights * density).mean() + 0.3 * entropy.mean() + (value**2).mean()
        loss.backward()
        gradients.append({name: part.grad.numpy() for name, part in policy.named_parameters()})
    for theirs, ours in zip(*results, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=2e-6)
    assert gradients[0].keys() == gradients[1].keys()
    for name, theirs in gradients[0].items():
        scale = np.abs(theirs).max()
        assert scale > 0.0, name
        np.testing.assert_allclose(gradients[1][name], theirs, atol=2e-5 * scale, err_msg=name)


def test_a_rollout_and_its_update_are_those_of_stable_baselines(tmp_path):
    """The same seed makes the same samples and, but for rounding, the same weights of them."""
    run = resolve(small(tmp_path))
    settings = SETTINGS["ppo"]
    ours = make_model("ppo", settings, make_environment(run), 0)
    theirs = PPO(
        "MlpPolicy", make_environment(run), seed=0, device="cpu",
        learning_rate=settings.learning_rate,  # no learner says how much of a training is left
        n_steps=settings.n_steps, batch_size=settings.batch_size, n_epochs=settings.n_epochs,
        gamma=settings.gamma, gae_lambda=settings.gae_lambda, clip_range=settings.clip_range,
        policy_kwargs={
            "net_arch": list(settings.hidden), "log_std_init": settings.log_std_init,
            "activation_fn": nn.Tanh,
        },
    )  # fmt: skip
    before = {name: value.clone() for name, value in ours.policy.state_dict().items()}
    for model in (ours, theirs):
        set_random_seed(7)  # making them has drawn from the streams that they share
        model.learn(
            2 * settings.n_steps * run.options.vehicles
        )  # an update, then a rollout that follows it
    for name in ("observations", "actions", "values", "log_probs", "advantages"):
        one, other = (getattr(model.rollout_buffer, name) for model in (ours, theirs))
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-3, err_msg=name)
    after = ours.policy.state_dict()
    for name, value in theirs.policy.state_dict().items():
        moved = (value - before[name]).abs().max()
        assert moved > 0.0 and (after[name] - value).abs().max() < 0.1 * moved, name


@pytest.mark.parametrize("name", ALGORITHMS)
def test_the_optimiser_has_the_settings_that_stable_baselines_gives_it(name, tmp_path):
    run = resolve(small(tmp_path, agent=name))
    model = make_model(name, run.settings, make_environment(run), 0)
    on_policy = hasattr(run.settings, "gae_lambda")
    whole = model.policy if on_policy else model.policy.actor
    (group,) = whole.optimizer.param_groups
    assert group["eps"] == (1e-5 if on_policy else 1e-8) and group["fused"]
    assert network_of(model.policy)["activation"] == ("tanh" if on_policy else "relu")


# The policy with an LSTM: what reaches its action and its value, and what learns


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
