"""An algorithm of one's own: the page that says how is followed, to the benchmark and back."""

import importlib.util
import re
import shutil
import sys

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import set_random_seed
from torch import nn

import train
from agents import algorithms
from agents.archive import agent_entry, network_of
from agents.environments import make_environment
from agents.folder import Diverged, Progress
from agents.learners import Sb3Learner
from agents.options import options_of_train, parse
from agents.run import resolve
from baselines.learned.trained_agent import read_recipe
from tests.agents import agent_cases as cases
from tests.processes import python
from tests.test_documentation import python_blocks
from tracked_env import observation as obs

BUDGET = [
    "--agent", "cross-entropy", "--cross-entropy.horizon", "20", "--steps", "1600", "--vehicles",
    "8", "--held-out", "2", "--duration", "1", "--quiet", "--seed", "3", "--checkpoint-every",
    "160",
]  # fmt: skip


@pytest.fixture
def cross_entropy(repository):
    """The module of the page, registered while a test runs."""
    path = repository / "docs/examples/cross_entropy.py"
    spec = importlib.util.spec_from_file_location("cross_entropy", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cross_entropy"] = module
    spec.loader.exec_module(module)
    yield module
    del algorithms.ALGORITHMS["cross-entropy"], sys.modules["cross_entropy"]


@pytest.mark.slow
def test_the_page_can_be_followed_in_a_folder_of_ones_own(repository, tmp_path):
    (use,) = python_blocks((repository / "docs/own_algorithm.md").read_text())
    shutil.copy(repository / "docs/examples/cross_entropy.py", tmp_path)
    (tmp_path / "use.py").write_text(use)
    done = python("use.py", cwd=tmp_path, path=[tmp_path])
    assert re.search(r"done: 25,600 steps in .*\n(mine \d+\.\d+\n){2}$", done.stdout), done.stdout
    curve = np.genfromtxt(tmp_path / "mine" / "curve.csv", delimiter=",", names=True)
    assert curve["mean_return"][-1] > curve["mean_return"][0]  # it learns


def test_its_agent_acts_as_its_weights_say(cross_entropy, tmp_path):
    assert train.command([*BUDGET, "--output", str(tmp_path / "out")]) == 0
    path = tmp_path / "out" / "last.zip"
    recipe = read_recipe(path)
    assert recipe["config"]["agent"] == "cross-entropy" and recipe["steps"] == 1600
    assert recipe["config"]["cross_entropy"] == {"horizon": 20, "elite": 0.2, "spread": 0.1}
    assert not {"ppo", "sac"} & set(recipe["config"])
    weights = cases.parameters(path)
    batch = np.random.default_rng(0).normal(size=(3, obs.SIZE)).astype(np.float32)
    action, _ = agent_entry(path).make(cases.CONTEXT).predict(batch)
    expected = batch @ weights["action_net.weight"].T + weights["action_net.bias"]
    np.testing.assert_allclose(action, np.clip(expected, -1.0, 1.0), atol=1e-6)
    assert np.ptp(action) > 0.01


def test_its_training_goes_on_after_a_kill_as_if_nothing_had_been(cross_entropy, tmp_path, capsys):
    whole, _ = parse([*BUDGET, "--output", str(tmp_path / "whole")], options_of_train())
    cases.interrupted_and_resumed(800, whole, tmp_path / "torn")
    assert "going on after 800 steps" in capsys.readouterr().out


def test_the_last_agent_is_evaluated_once(cross_entropy, tmp_path):
    arguments = [*BUDGET, "--output", str(tmp_path / "out"), "--evaluate-every", "800"]
    assert train.command(arguments) == 0
    curve = np.genfromtxt(tmp_path / "out" / "curve.csv", delimiter=",", names=True)
    evaluated = ~np.isnan(curve["held_out_rmse"])
    assert curve["steps"][evaluated].tolist() == [800, 1600]


def test_a_learner_that_diverges_without_a_learning_rate_ends_in_one_line(
    cross_entropy, tmp_path, monkeypatch, capsys
):
    def diverge(learner, progress):
        raise Diverged("the training diverged at 160 steps")

    monkeypatch.setattr(cross_entropy.CrossEntropyLearner, "generation", diverge)
    assert train.command([*BUDGET, "--output", str(tmp_path / "out")]) == 2
    line = cases.one_line(capsys)
    assert "diverged at 160 steps. Train anew with --overwrite" in line


def test_its_settings_are_options_with_the_help_of_their_docstrings(cross_entropy, capsys):
    with pytest.raises(SystemExit):
        train.command(["--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "cross-entropy" in shown and "--cross-entropy.elite NUMBER" in shown
    assert "Share of the candidates around which the next ones are drawn." in shown


def test_a_name_that_is_taken_or_no_option_is_refused():
    record = algorithms.ALGORITHMS["ppo"]
    with pytest.raises(ValueError, match="'ppo' is registered already"):
        algorithms.register("ppo", record)
    for name in ("My Own", "a_b", "", "3a"):
        with pytest.raises(ValueError, match="must be lower-case letters"):
            algorithms.register(name, record)
    assert list(algorithms.ALGORITHMS) == ["ppo", "sac", "td3", "tqc", "recurrent-ppo"]


def test_an_algorithm_that_is_not_registered_is_refused_with_those_that_are():
    with pytest.raises(
        ValueError, match="agent = 'dqn'; must be one of ppo, sac, td3, tqc, recurrent-ppo"
    ):
        options_of_train()(agent="dqn")


def test_an_algorithm_that_is_called_like_an_option_is_refused(monkeypatch):
    monkeypatch.setitem(algorithms.ALGORITHMS, "residual-scale", algorithms.ALGORITHMS["ppo"])
    with pytest.raises(ValueError, match="--residual-scale is another option; rename it"):
        options_of_train()


# Every update of a training learns: its rate is above 0, in the last one and in the only one

ROLLOUT = 128  # [steps] of `small`, four vehicles


def trained(tmp_path, steps, **changes):
    """(parameters before, after) of a training, and its learner."""
    tmp_path.mkdir(exist_ok=True)
    run = resolve(cases.small(tmp_path, steps=steps, held_out=0, **changes))
    learner = Sb3Learner(run)
    before = torch.nn.utils.parameters_to_vector(learner.model.policy.parameters()).detach().clone()
    learner.learn(Progress(run, learner))
    after = torch.nn.utils.parameters_to_vector(learner.model.policy.parameters()).detach()
    return before, after, learner


@pytest.mark.parametrize("name", ["ppo", "sac", "recurrent-ppo"])
@pytest.mark.parametrize("steps", [2 * ROLLOUT, 2 * ROLLOUT + 8])
def test_the_rate_of_no_update_is_0_and_falls_in_proportion(name, steps, tmp_path, monkeypatch):
    rates = []
    call = algorithms.FallingRate.__call__

    def recorded(rate, remaining):
        rates.append(call(rate, remaining))
        return rates[-1]

    monkeypatch.setattr(algorithms.FallingRate, "__call__", recorded)
    trained(tmp_path, steps, agent=name)
    start = cases.SETTINGS[name.replace("-", "_")].learning_rate
    if name == "sac":
        expected = start * (1.0 - 4 * (-(-steps // 4) - 1) / steps)  # four vehicles a rollout
    else:
        expected = start * (1.0 - (-(-steps // ROLLOUT) - 1) * ROLLOUT / steps)
    assert min(rates) > 0.0 and rates[0] == pytest.approx(start)
    assert rates[-1] == pytest.approx(expected)


@pytest.mark.parametrize("steps", [1, ROLLOUT])
@pytest.mark.parametrize("name", ["ppo", "recurrent-ppo"])
def test_a_training_of_one_rollout_changes_the_network(name, steps, tmp_path):
    before, after, learner = trained(tmp_path, steps, agent=name)
    assert learner.steps == ROLLOUT
    assert (after - before).abs().max() > 1e-4


@pytest.mark.parametrize("name", ["sac", "td3", "tqc"])
def test_a_training_that_ends_before_its_first_gradient_is_refused(name, tmp_path, capsys, refused):
    assert hasattr(algorithms.ALGORITHMS[name].settings(), "learning_starts")
    most = cases.SETTINGS[name].learning_starts
    with pytest.raises(ValueError, match=f"steps = {most}; must be above learning_starts = {most}"):
        Sb3Learner(resolve(cases.small(tmp_path, steps=most, agent=name)))
    before, after, _ = trained(tmp_path, most + 1, agent=name)
    assert (after - before).abs().max() > 0.0
    output = tmp_path / "none"
    arguments = ["--agent", name, "--steps", "4096", "--vehicles", "4", "--quiet"]
    assert train.command([*arguments, "--output", str(output)]) == 2
    assert "learning_starts = 10000" in capsys.readouterr().err and not output.exists()


@pytest.mark.slow
def test_a_small_budget_raises_the_return(tmp_path):
    settings = algorithms.PPOSettings(n_steps=64, batch_size=256, hidden=(32, 32))
    _before, _after, learner = trained(
        tmp_path, 16_384, vehicles=16, uncertainty=("nominal",), ppo=settings
    )
    assert np.isfinite(learner.mean_return)
    curve = np.genfromtxt(tmp_path / "curve.csv", delimiter=",", names=True)
    returns = curve["mean_return"][~np.isnan(curve["mean_return"])]
    assert returns[-1] > returns[0]


# What one training loads

# Modules of the project, packages too, that lie in files: those that a tiny training of a blind
# agent adds to the ones that making and resetting its environment has loaded.
COUNT = """
import sys
import gymnasium, tracked_env
def modules():
    folders = ("tracked_env", "baselines", "agents", "train")
    return {name for name in sys.modules if name.partition(".")[0] in folders}
gymnasium.make(tracked_env.TORQUE_ID).reset(seed=0)
before = modules()
import train
assert train.command(sys.argv[1].split()) == 0
print(*sorted(modules() - before))
"""
TINY = (
    "--steps 64 --vehicles 4 --held-out 2 --duration 0.4 --quiet --uncertainty payload "
    "--ppo.n-steps 16 --ppo.batch-size 32 --output "
)


@pytest.mark.slow
def test_a_training_loads_at_most_35_files_besides_those_of_its_environment(tmp_path):
    done = python("-c", COUNT, f"{TINY}{tmp_path / 'out'}")
    names = done.stdout.splitlines()[-1].split()
    assert 20 < len(names) <= 35, names
    assert not any(
        name.startswith(("baselines.linearizing", "baselines.lyapunov")) for name in names
    )


# Policies that learn: that of PPO is as in Stable-Baselines3, and what passes by an LSTM

SEEN, ACTS = Box(-np.inf, np.inf, (31,), np.float32), Box(-1.0, 1.0, (2,), np.float32)


def both():
    """Their policy and ours with the same weights."""
    policies = []
    for kind, activation in (
        (ActorCriticPolicy, nn.Tanh),
        (algorithms.GaussianPolicy, algorithms.Tanh),
    ):
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
    assert (np.abs(algorithms.Tanh()(x).numpy() - exact) <= 2.0 * spacing).all()
    points = torch.linspace(-4.0, 4.0, 41, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(algorithms.Tanh(), points)


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
    run = resolve(cases.small(tmp_path))
    settings = cases.SETTINGS["ppo"]
    ours = algorithms.make_model("ppo", settings, make_environment(run), 0)
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


@pytest.mark.parametrize("name", algorithms.ALGORITHMS)
def test_the_optimiser_has_the_settings_that_stable_baselines_gives_it(name, tmp_path):
    run = resolve(cases.small(tmp_path, agent=name))
    model = algorithms.make_model(name, run.settings, make_environment(run), 0)
    on_policy = hasattr(run.settings, "gae_lambda")
    whole = model.policy if on_policy else model.policy.actor
    (group,) = whole.optimizer.param_groups
    assert group["eps"] == (1e-5 if on_policy else 1e-8) and group["fused"]
    assert network_of(model.policy)["activation"] == ("tanh" if on_policy else "relu")


# The policy with an LSTM: what reaches its action and its value, and what learns


@pytest.fixture
def policy(tmp_path):
    config = cases.small(tmp_path, agent="recurrent-ppo")
    env = make_environment(resolve(config))
    settings = algorithms.RecurrentPPOSettings(hidden=(16,), lstm_hidden=8)
    return algorithms.make_model("recurrent-ppo", settings, env, 0).policy


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
