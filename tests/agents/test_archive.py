"""Archives: no code of a stranger runs unasked, and nothing in them is a traceback."""

import base64
import io
import json
import pickle
import tracemalloc
import zipfile
from functools import cache

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3

import evaluate
from agents.algorithms import ALGORITHMS, make_model
from agents.archive import agent_entry, load_network, to_npz
from agents.environments import make_environment
from agents.run import resolve
from baselines.learned import trained_agent
from baselines.learned.agent_policy import Actor
from baselines.learned.trained_agent import LONGEST_LAG, RECIPE, WEIGHTS, read_recipe
from baselines.registry import shipped_agents
from tests.agents import agent_cases as cases
from tracked_env import TORQUE_ID
from tracked_env import observation as obs
from tracked_env.benchmark.policies import open_archive
from train import main


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    return cases.archive_of(cases.small(folder, steps=128))


@pytest.fixture(scope="module")
def scaled(tmp_path_factory):
    """An agent with past samples and a running normalisation."""
    folder = tmp_path_factory.mktemp("scaled")
    options = {"augmentation": "history", "lags": (1, 2), "normalise": True}
    return cases.archive_of(cases.small(folder, steps=128, **options))


def pickled_data(mark):
    """The file `data` of Stable-Baselines3 with harm in it."""
    text = base64.b64encode(pickle.dumps(cases.Harm(mark))).decode()
    return json.dumps({"policy_class": {":type:": "<class 'type'>", ":serialized:": text}})


def pickled_array(mark):
    """An npz file of an array of objects with harm in it."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=True, log_std=np.array([cases.Harm(mark)], dtype=object))
    return buffer.getvalue()


def strangers(tmp_path, mark, trained):
    """Archives that harm whoever unpickles them."""
    recipe = cases.entries(trained)[RECIPE]
    archives = {
        "plain": {"data": pickled_data(mark)},
        "new": {RECIPE: recipe, "data": pickled_data(mark)},
        "array": {RECIPE: recipe, WEIGHTS: pickled_array(mark)},
        "bare": {RECIPE: recipe, WEIGHTS: pickle.dumps(cases.Harm(mark))},
    }
    return {name: cases.packed(tmp_path / f"{name}.zip", files) for name, files in archives.items()}


def test_no_code_of_an_archive_runs_unasked(trained, tmp_path, capsys):
    """Read, opened as a policy and by evaluate.py."""
    mark = tmp_path / "harm"
    for name, path in strangers(tmp_path, mark, trained).items():
        read_recipe(path)
        for opened in (agent_entry, open_archive):
            with pytest.raises(ValueError, match=str(path)) as refused:
                opened(path)
            assert "\n" not in str(refused.value)
            if name == "plain":
                assert "any code that its author put there" in str(refused.value)
                assert "--trust" in str(refused.value)
        assert evaluate.main(evaluate.Config(policies=(str(path),), output=tmp_path / "out")) == 2
        shown = capsys.readouterr().err
        assert len(shown.splitlines()) == 1 and str(path) in shown
        assert not mark.exists(), name


def test_an_archive_that_is_trusted_is_unpickled(trained, tmp_path):
    """The harm of these archives is real: they would be no test without."""
    mark = tmp_path / "harm"
    path = strangers(tmp_path, mark, trained)["plain"]
    with pytest.raises(ValueError, match="cannot be loaded as"):
        agent_entry(path, trust=True)
    assert mark.exists()
    mark.rmdir()
    config = evaluate.Config(policies=(str(path),), output=tmp_path / "out", trust=True)
    assert evaluate.main(config) == 2 and mark.exists()


def test_no_module_that_a_recipe_names_is_imported(trained, tmp_path, monkeypatch):
    (tmp_path / "harmful_module.py").write_text(
        f"from pathlib import Path\nPath({str(tmp_path / 'harm')!r}).mkdir()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    files = cases.entries(trained)
    recipe = json.loads(files[RECIPE])
    for name in ("harmful_module:tracked_env/Torque-v0", f"harmful_module:{TORQUE_ID}"):
        recipe["environment"] = {"id": name}
        path = cases.packed(tmp_path / "agent.zip", {**files, RECIPE: json.dumps(recipe)})
        with pytest.raises(ValueError, match=r"is none of this project, and there is no .*drive"):
            agent_entry(path)
        recipe["environment"] |= {"drive": "torque", "vehicle": "strawa"}
        path = cases.packed(tmp_path / "agent.zip", {**files, RECIPE: json.dumps(recipe)})
        agent_entry(path).make(cases.CONTEXT)  # says enough of itself
    assert not (tmp_path / "harm").exists()


def test_weights_that_are_not_those_of_the_recipe_are_one_line(trained, tmp_path):
    files, whole = cases.entries(trained), cases.parameters(trained)
    path = tmp_path / "agent.zip"
    for key, value in whole.items():
        changed = {
            "are not finite": [np.where(np.arange(value.size).reshape(value.shape) == 0, bad, value)
                               for bad in (np.float32("nan"), np.float32("inf"))],
            "must be": [value.astype(np.float64), value[..., None], value[:-1],
                        value.astype(np.int32)],
        }  # fmt: skip
        for message, others in changed.items():
            for other in others:
                content = to_npz({**whole, key: other})
                cases.packed(path, {**files, WEIGHTS: content})
                with pytest.raises(ValueError, match=f"weights {key} are.*{message}|{message}"):
                    agent_entry(path)
        cases.packed(path, {**files, WEIGHTS: to_npz({k: v for k, v in whole.items() if k != key})})
        with pytest.raises(ValueError, match=f"lack or have too much: {key}"):
            agent_entry(path)
    for content in (
        b"",
        b"no npz",
        to_npz({}),
        files[WEIGHTS][:-50],
        to_npz({**whole, "x": value}),
    ):
        cases.packed(path, {**files, WEIGHTS: content})
        with pytest.raises(ValueError, match="cannot be loaded") as refused:
            agent_entry(path)
        assert "\n" not in str(refused.value)


READ = (
    "format", "algorithm", "augmentation", "augmentation_options", "normalisation", "network",
    "environment", "control_period", "observation",
)  # fmt: skip


@pytest.mark.parametrize("field", READ)
def test_no_value_in_a_recipe_is_a_traceback(field, scaled, tmp_path):
    """Every value that is read, of every wrong type: opened all the same, or refused in a line."""
    files = cases.entries(scaled)
    recipe = json.loads(files[RECIPE])
    refused = 0
    for where in cases.branches(recipe[field], (field,)):
        for value in cases.WRONG:
            text = json.dumps(cases.put(recipe, where, value))
            cases.packed(tmp_path / "agent.zip", {**files, RECIPE: text})
            try:
                agent_entry(tmp_path / "agent.zip")
            except ValueError as error:
                assert str(tmp_path) in str(error) and "\n" not in str(error), (where, value)
                refused += 1
    assert refused >= len(cases.WRONG) // 2


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (("algorithm",), ["ppo"], r"algorithm = \['ppo'\]; must be one of ppo, sac"),
        (("augmentation",), {}, r"augmentation = {}; must be one of blind"),
        (("augmentation",), "student", "augmentation = 'student' is no longer known. Train"),
        (("augmentation",), "teacher", "augmentation = 'teacher' is no longer known. Train"),
        (("normalisation",), {}, "normalisation = {}; must be null, or have finite numbers"),
        (("normalisation", "mean"), [0.0], "61 of each"),
        (("environment",), "Torque", "must be an id and arguments"),
        (("environment",), {"id": "tracked_env/Nothing-v0"}, "Nothing-v0' is none of this project"),
        (("environment", "drive"), "wheels", "drive = 'wheels'; must be one of torque, speed"),
        (("environment", "vehicle"), [], "vehicle = \\[\\]; must be one of strawa"),
        (("observation",), {"motion": []}, "observation = .*must be groups with lists of"),
        (("observation",), {"motion": ["v_x", "v_x"]}, "name a field twice"),
        (("observation",), ["motion"], r"observation = \['motion'\]; must be groups with lists"),
        (("control_period",), "20 ms", "control_period = '20 ms'; must be in s"),
        (("network", "hidden"), [10**9], "within"),
        (("network", "inputs"), 31, "normalisation = .*31 of each"),
        (("augmentation_options",), {"scale": 0.3}, "of augmentation 'history' must have lags"),
    ],
)
def test_a_wrong_recipe_says_what_is_wrong(where, value, message, scaled, tmp_path):
    files = cases.entries(scaled)
    recipe = cases.put(json.loads(files[RECIPE]), where, value)
    path = cases.packed(tmp_path / "agent.zip", {**files, RECIPE: json.dumps(recipe)})
    with pytest.raises(ValueError, match=message):
        agent_entry(path)


def test_what_would_fill_the_memory_is_refused(scaled, tmp_path):
    files = cases.entries(scaled)
    recipe = cases.put(
        json.loads(files[RECIPE]), ("augmentation_options", "lags"), [1, LONGEST_LAG + 1]
    )
    path = cases.packed(tmp_path / "lags.zip", {**files, RECIPE: json.dumps(recipe)})
    with pytest.raises(ValueError, match=f"at most {LONGEST_LAG} control steps"):
        agent_entry(path)
    deep = cases.packed(tmp_path / "deep.zip", {**files, RECIPE: "[" * 100_000})
    with pytest.raises(ValueError, match="not an archive of an agent, or damaged"):
        agent_entry(deep)
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(RECIPE, files[RECIPE])
        archive.writestr(WEIGHTS, bytes(2**28 + 1))
    with pytest.raises(ValueError, match="at most 268435456 bytes"):
        agent_entry(tmp_path / "bomb.zip")


@cache
def zeros():
    """300 MB of zeros, 300 kB as npz."""
    inner = io.BytesIO()
    np.savez_compressed(inner, big=np.zeros(300 * 2**20, np.uint8))
    return inner.getvalue()


def test_an_archive_in_the_archive_is_not_unpacked_beyond_the_limit(trained, tmp_path):
    path = cases.packed(tmp_path / "nested.zip", {**cases.entries(trained), WEIGHTS: zeros()})
    tracemalloc.start()
    with pytest.raises(ValueError, match=f"{WEIGHTS} is .*at most 268435456 bytes"):
        agent_entry(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6


def test_loading_draws_nothing_from_the_random_stream(trained):
    torch.manual_seed(0)
    expected = torch.get_rng_state()
    agent_entry(trained)
    assert torch.equal(torch.get_rng_state(), expected)


# Archives as policies: those of Stable-Baselines3 if trusted


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
    action, _ = entry.make(cases.CONTEXT).predict(batch)
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


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_archive_has_the_network_of_the_action_and_nothing_else_of_learning(algorithm, tmp_path):
    """Its weights fit a model of Stable-Baselines3 with the same settings, to learn on from."""
    path = cases.archive_of(cases.small(tmp_path, agent=algorithm, steps=128))
    with zipfile.ZipFile(path) as archive:
        assert set(archive.namelist()) == {"recipe.json", "weights.npz"}
    stored = cases.parameters(path)
    assert stored and not [name for name in stored if "critic" in name or "value" in name]
    config = cases.small(tmp_path, agent=algorithm)
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


def test_missing_damaged_and_foreign_files_are_clear_errors(trained, tmp_path):
    path, whole = tmp_path / "agent.zip", trained.read_bytes()
    with pytest.raises(ValueError, match="no such file"):
        agent_entry(path)
    with zipfile.ZipFile(trained) as archive:
        largest = max(archive.infolist(), key=lambda one: one.compress_size)
    bits = bytearray(whole)  # a bit of its content: one of a header would be another error
    bits[largest.header_offset + largest.compress_size // 2] ^= 1
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
    path = cases.packed(tmp_path / "agent.zip", files)
    with pytest.raises(ValueError, match=message):
        agent_entry(path, trust=True)


def test_agents_are_called_after_their_folder_and_told_apart(trained, tmp_path):
    entry = agent_entry(trained)
    assert entry.name == trained.parent.name
    copy = tmp_path / "champion.zip"
    copy.write_bytes(trained.read_bytes())
    assert agent_entry(copy).name == "champion"
    assert agent_entry(copy).fingerprint == entry.fingerprint
    assert main(cases.small(tmp_path / "other", steps=128, seed=8)) == 0
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
        assert isinstance(opened.make(cases.CONTEXT).model, Actor)
