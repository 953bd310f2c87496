"""Archives of agents become policies: those of SB3 if trusted; damaged ones are clear errors."""

import warnings
import zipfile

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3

from agents.algorithms import ALGORITHMS, make_model
from agents.archive import agent_entry, load_network, unpickled
from agents.environments import make_environment
from agents.run import resolve
from baselines.learned import trained_agent
from baselines.learned.agent_policy import Actor
from baselines.learned.trained_agent import read_recipe
from baselines.registry import shipped_agents
from tests.agents.agent_cases import CONTEXT, packed, parameters, small
from tracked_env import TORQUE_ID
from tracked_env import observation as obs
from train import main


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
    entry = agent_entry(tmp_path / "mine.zip", trust=True)
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
    agent_entry(tmp_path / "mine.zip", trust=True)
    (tmp_path / "VecNormalize_final.pkl").write_bytes(b"")
    with pytest.raises(ValueError, match=r"VecNormalize_final\.pkl.*--normalise.*module:attr"):
        agent_entry(tmp_path / "mine.zip", trust=True)


def test_loading_with_targets_of_several_rewards_is_quiet_of_that_alone(tmp_path, monkeypatch):
    algorithm = ALGORITHMS["tqc"].model
    algorithm("MlpPolicy", gymnasium.make(TORQUE_ID), n_steps=4, device="cpu").save(
        tmp_path / "a.zip"
    )
    load = algorithm.load

    def loud(*arguments, **options):
        warnings.warn("`n_steps=4` is ignored because of the weather", UserWarning, stacklevel=1)
        return load(*arguments, **options)

    monkeypatch.setattr(algorithm, "load", loud)
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        assert unpickled(tmp_path / "a.zip").n_steps == 4
    assert [str(warning.message) for warning in shown] == [
        "`n_steps=4` is ignored because of the weather"
    ]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_archive_has_the_network_of_the_action_and_nothing_else_of_learning(algorithm, tmp_path):
    """Its weights fit a model of Stable-Baselines3 with the same settings, to learn on from."""
    assert main(small(tmp_path, agent=algorithm, steps=128)) == 0
    path = tmp_path / "agent.zip"
    with zipfile.ZipFile(path) as archive:
        assert set(archive.namelist()) == {"recipe.json", "weights.npz"}
    stored = parameters(path)
    assert stored and not [name for name in stored if "critic" in name or "value" in name]
    config = small(tmp_path, agent=algorithm)
    run = resolve(config)
    model = make_model(algorithm, run.settings, make_environment(run), 0)
    state = {name: torch.from_numpy(value) for name, value in stored.items()}
    assert not model.policy.load_state_dict(state, strict=False).unexpected_keys
    network = load_network(path, read_recipe(path))
    batch = np.random.default_rng(0).normal(size=(3, obs.SIZE)).astype(np.float32)
    acted = [each.predict(batch, deterministic=True)[0] for each in (model, network)]
    assert np.ptp(acted[0]) > 0.0
    np.testing.assert_array_equal(*acted)


def test_an_agent_of_another_environment_is_refused(tmp_path):
    PPO("MlpPolicy", "Pendulum-v1", device="cpu").save(tmp_path / "pendulum.zip")
    with pytest.raises(ValueError, match=r"sees \(3,\).*must see \(31,\)"):
        agent_entry(tmp_path / "pendulum.zip", trust=True)


def test_an_agent_of_another_control_rate_is_refused(trained):
    with pytest.raises(ValueError, match=r"period of 0\.02 s; this environment has 0\.05 s"):
        agent_entry(trained).make(CONTEXT._replace(control_period=0.05))


def test_missing_damaged_and_foreign_files_are_clear_errors(trained, tmp_path):
    path, whole = tmp_path / "agent.zip", trained.read_bytes()
    with pytest.raises(ValueError, match="no such file"):
        agent_entry(path)
    bits = bytearray(whole)
    bits[len(bits) // 3] ^= 1
    for content, message in (
        (b"not an archive", "cannot be loaded"),
        (whole[: len(whole) // 2], "cannot be loaded"),
        (bytes(bits), "damaged"),
    ):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=message):
            agent_entry(path)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"holiday.txt": "a picture"}, "not an archive of an agent"),
        ({"data": "{}"}, "cannot be loaded as recurrent-ppo"),
        ({"recipe.json": '{"format": 1, "algorithm": "ppo"}'}, "another format"),
        ({"recipe.json": '{"format": 2, "algorithm": "ppo"}'}, "lacks .*augmentation"),
        ({"data": "{}", "recipe.json": "[]"}, "another format"),
    ],
)
def test_an_archive_that_is_not_understood_is_a_clear_error(files, message, tmp_path):
    path = packed(tmp_path / "agent.zip", files)
    with pytest.raises(ValueError, match=message):
        agent_entry(path, trust=True)


def test_agents_are_called_after_their_folder_and_told_apart(trained, tmp_path):
    entry = agent_entry(trained)
    assert entry.name == trained.parent.name
    copy = tmp_path / "champion.zip"
    copy.write_bytes(trained.read_bytes())
    assert agent_entry(copy).name == "champion"
    assert agent_entry(copy).fingerprint == entry.fingerprint
    assert main(small(tmp_path / "other", steps=128, seed=8)) == 0
    assert agent_entry(tmp_path / "other" / "agent.zip").fingerprint != entry.fingerprint


SOURCES = sorted(path.name for path in trained_agent.HERE.glob("*.py"))


@pytest.mark.parametrize("name", SOURCES)
def test_a_changed_byte_of_a_file_around_the_network_changes_the_fingerprint(
    name, trained, tmp_path, monkeypatch
):
    for source in SOURCES:
        (tmp_path / source).write_bytes((trained_agent.HERE / source).read_bytes())
    monkeypatch.setattr(trained_agent, "HERE", tmp_path)
    before = agent_entry(trained).fingerprint
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes() + b"#")
    assert agent_entry(trained).fingerprint != before


def test_an_agent_with_estimators_changes_with_any_baseline_and_a_blind_one_does_not(
    trained, tmp_path, monkeypatch
):
    estimates = shipped_agents("torque")["ppo-estimates"][0]
    here = tmp_path / "learned"
    here.mkdir()
    monkeypatch.setattr(trained_agent, "HERE", here)
    before = agent_entry(trained).fingerprint, agent_entry(estimates).fingerprint
    (tmp_path / "estimator.py").write_text("x")
    after = agent_entry(trained).fingerprint, agent_entry(estimates).fingerprint
    assert (after[0] == before[0], after[1] == before[1]) == (True, False)


def test_an_agent_that_is_plain_data_is_opened_without_pytorch_with_trust_too(trained):
    for opened in (agent_entry(trained), agent_entry(trained, trust=True)):
        assert isinstance(opened.make(CONTEXT).model, Actor)
