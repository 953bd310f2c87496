"""Every update of a training learns: its rate is above 0, in the last one and in the only one."""

import numpy as np
import pytest
import torch

import train
from agents.algorithms import ALGORITHMS, FallingRate, PPOSettings
from agents.folder import Progress
from agents.learners import Sb3Learner
from agents.run import resolve
from tests.agents.agent_cases import SETTINGS, small

ROLLOUT = 128  # [steps] of `small`, four vehicles


def trained(tmp_path, steps, **changes):
    """(parameters before, after) of a training, and its learner."""
    tmp_path.mkdir(exist_ok=True)
    run = resolve(small(tmp_path, steps=steps, held_out=0, **changes))
    learner = Sb3Learner(run)
    before = torch.nn.utils.parameters_to_vector(learner.model.policy.parameters()).detach().clone()
    learner.learn(Progress(run, learner))
    after = torch.nn.utils.parameters_to_vector(learner.model.policy.parameters()).detach()
    return before, after, learner


@pytest.mark.parametrize("name", ["ppo", "sac", "recurrent-ppo"])
@pytest.mark.parametrize("steps", [2 * ROLLOUT, 2 * ROLLOUT + 8])
def test_the_rate_of_no_update_is_0_and_falls_in_proportion(name, steps, tmp_path, monkeypatch):
    rates = []
    call = FallingRate.__call__

    def recorded(rate, remaining):
        rates.append(call(rate, remaining))
        return rates[-1]

    monkeypatch.setattr(FallingRate, "__call__", recorded)
    trained(tmp_path, steps, agent=name)
    start = SETTINGS[name.replace("-", "_")].learning_rate
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
def test_a_training_that_ends_before_its_first_gradient_is_refused(name, tmp_path, capsys):
    assert hasattr(ALGORITHMS[name].settings(), "learning_starts")
    most = SETTINGS[name].learning_starts
    with pytest.raises(ValueError, match=f"steps = {most}; must be above learning_starts = {most}"):
        Sb3Learner(resolve(small(tmp_path, steps=most, agent=name)))
    before, after, _ = trained(tmp_path, most + 1, agent=name)
    assert (after - before).abs().max() > 0.0
    output = tmp_path / "none"
    arguments = ["--agent", name, "--steps", "4096", "--vehicles", "4", "--quiet"]
    assert train.command([*arguments, "--output", str(output)]) == 2
    assert "learning_starts = 10000" in capsys.readouterr().err and not output.exists()


@pytest.mark.slow
def test_a_small_budget_raises_the_return(tmp_path):
    settings = PPOSettings(n_steps=64, batch_size=256, hidden=(32, 32))
    _before, _after, learner = trained(
        tmp_path, 16_384, vehicles=16, uncertainty=("nominal",), ppo=settings
    )
    assert np.isfinite(learner.mean_return)
    curve = np.genfromtxt(tmp_path / "curve.csv", delimiter=",", names=True)
    returns = curve["mean_return"][~np.isnan(curve["mean_return"])]
    assert returns[-1] > returns[0]
