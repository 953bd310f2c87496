"""Archives of agents: plain ones of SB3 load, damaged and foreign ones are clear errors."""

import json
import warnings
import zipfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3

from agents import memory
from agents.algorithms import ALGORITHMS
from agents.loading import agent_entry, load_model
from tests.agents.agent_cases import small
from tracked_env import TORQUE_ID
from tracked_env import observation as obs
from tracked_env.benchmark import PolicyContext
from train import main

CONTEXT = PolicyContext(0.02, "sliding")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    assert main(small(folder, steps=128)) == 0
    return folder / "agent.zip"


@pytest.mark.parametrize("algorithm", [PPO, SAC, TD3, TQC, RecurrentPPO])
def test_an_archive_of_sb3_alone_is_loaded_as_a_blind_agent(algorithm, tmp_path, capsys):
    policy = "MlpLstmPolicy" if algorithm is RecurrentPPO else "MlpPolicy"
    model = algorithm(policy, gymnasium.make(TORQUE_ID), device="cpu", seed=0)
    model.save(tmp_path / "mine.zip")
    entry = agent_entry(tmp_path / "mine.zip")
    assert entry.name == "mine"
    (notice,) = capsys.readouterr().err.splitlines()
    assert "mine.zip has no recipe" in notice
    assert "blind agent, observations not normalised" in notice
    batch = np.random.default_rng(0).normal(size=(3, obs.SIZE)).astype(np.float32)
    action, _ = entry.make(CONTEXT).predict(batch)
    expected, _ = model.predict(batch, episode_start=np.ones(3, bool), deterministic=True)
    np.testing.assert_array_equal(action, expected)


def test_an_archive_of_train_py_is_loaded_without_a_notice(trained, capsys):
    (trained.parent / "vec_normalize.pkl").write_bytes(b"of something else")
    agent_entry(trained)
    assert capsys.readouterr().err == ""


def test_an_archive_of_sb3_beside_a_normalisation_is_refused(tmp_path):
    PPO("MlpPolicy", gymnasium.make(TORQUE_ID), device="cpu").save(tmp_path / "mine.zip")
    (tmp_path / "policy.pkl").write_bytes(b"")
    agent_entry(tmp_path / "mine.zip")
    (tmp_path / "VecNormalize_final.pkl").write_bytes(b"")
    with pytest.raises(ValueError, match=r"VecNormalize_final\.pkl.*--normalise.*module:attribute"):
        agent_entry(tmp_path / "mine.zip")


def test_loading_with_targets_of_several_rewards_is_quiet_of_that_alone(tmp_path, monkeypatch):
    made = ALGORITHMS["sac"][0]
    made("MlpPolicy", gymnasium.make(TORQUE_ID), n_steps=4, device="cpu").save(tmp_path / "a.zip")
    load = made.load

    def loud(*arguments, **options):
        warnings.warn("`n_steps=4` is ignored because of the weather", UserWarning, stacklevel=1)
        return load(*arguments, **options)

    monkeypatch.setattr(made, "load", loud)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        assert load_model(tmp_path / "a.zip", ("sac",)).n_steps == 4
    assert [str(warning.message) for warning in shown] == [
        "`n_steps=4` is ignored because of the weather"
    ]


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_an_archive_has_no_moments_of_gradients_and_goes_on_learning(algorithm, tmp_path):
    assert main(small(tmp_path, agent=algorithm, steps=256)) == 0
    path = tmp_path / "agent.zip"
    made = ALGORITHMS[algorithm][0]
    with zipfile.ZipFile(path) as archive:
        optimisers = [name for name in archive.namelist() if name.endswith("optimizer.pth")]
        assert len(optimisers) >= 1
        for name in optimisers:
            state = torch.load(archive.open(name), weights_only=True)
            assert state["state"] == {} and state["param_groups"]
    model = made.load(path, env=gymnasium.make(TORQUE_ID), device="cpu")
    bias = "actor.mu.bias" if algorithm == "sac" else "action_net.bias"
    before = model.policy.state_dict()[bias].clone()
    model.learn(64 if algorithm == "ppo" else 400)
    assert not torch.equal(before, model.policy.state_dict()[bias])


def test_an_agent_of_another_environment_is_refused(tmp_path):
    PPO("MlpPolicy", "Pendulum-v1", device="cpu").save(tmp_path / "pendulum.zip")
    with pytest.raises(ValueError, match=r"sees \(3,\).*must see \(31,\)"):
        agent_entry(tmp_path / "pendulum.zip")


def test_an_agent_of_another_control_rate_is_refused(trained):
    with pytest.raises(ValueError, match=r"period of 0\.02 s; this environment has 0\.05 s"):
        agent_entry(trained).make(PolicyContext(0.05, "sliding"))


def test_missing_damaged_and_foreign_files_are_clear_errors(trained, tmp_path):
    path = tmp_path / "agent.zip"
    with pytest.raises(ValueError, match="no such file"):
        agent_entry(path)
    path.write_bytes(b"not an archive")
    with pytest.raises(ValueError, match="cannot be loaded"):
        agent_entry(path)
    whole = trained.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="cannot be loaded"):
        agent_entry(path)
    bits = bytearray(whole)
    bits[len(bits) // 3] ^= 1
    path.write_bytes(bytes(bits))
    with pytest.raises(ValueError, match="damaged"):
        agent_entry(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("holiday.txt", "a picture")
    with pytest.raises(ValueError, match="not an archive of an agent"):
        agent_entry(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "{}")
    with pytest.raises(ValueError, match="cannot be loaded as recurrent-ppo"):
        agent_entry(path)


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        ({"format": 99}, "another format"),
        ({"format": 1, "algorithm": "ppo"}, "lacks .*memory"),
        ([], "another format"),
    ],
)
def test_a_recipe_that_is_not_understood_is_a_clear_error(recipe, message, tmp_path):
    path = tmp_path / "agent.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", "{}")
        archive.writestr("recipe.json", json.dumps(recipe))
    with pytest.raises(ValueError, match=message):
        agent_entry(path)


def test_agents_are_called_after_their_folder_and_told_apart(trained, tmp_path):
    entry = agent_entry(trained)
    assert entry.name == trained.parent.name
    copy = tmp_path / "champion.zip"
    copy.write_bytes(trained.read_bytes())
    assert agent_entry(copy).name == "champion"
    assert agent_entry(copy).fingerprint == entry.fingerprint
    assert main(small(tmp_path / "other", steps=128, seed=8)) == 0
    assert agent_entry(tmp_path / "other" / "agent.zip").fingerprint != entry.fingerprint


def test_results_are_stored_apart_when_the_code_around_the_network_changes(
    trained, tmp_path, monkeypatch
):
    source = Path(memory.__file__).parent
    for path in source.glob("*.py"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(memory, "__file__", str(tmp_path / "memory.py"))
    found = {agent_entry(trained).fingerprint}
    changed = ("memory", "policy", "slip_memory", "held", "recurrent", "loading")
    for name in changed:
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("# changed")
        found.add(agent_entry(trained).fingerprint)
    assert len(found) == 1 + len(changed)
    (tmp_path / "training.py").write_text("# of no influence on a trained agent")
    assert agent_entry(trained).fingerprint in found
