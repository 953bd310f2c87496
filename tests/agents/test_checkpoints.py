"""A killed training goes on as if nothing had happened; its checkpoints are plain data."""

import io
import json
import pickle
import random
import shutil
import zipfile
from collections import deque
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
import torch
from numpy.lib import format as npy
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

import train
from agents import checkpoint
from agents.algorithms import ALGORITHMS, make_model
from agents.environments import make_environment
from agents.folder import CONFIG, begin
from agents.learners import RolloutCallback
from agents.run import resolve
from baselines.learned.augmentation import KINDS
from tests.agents import agent_cases as cases
from tracked_env import SPEED_ID, TERRAIN, TERRAIN_ID, TORQUE_ID
from tracked_env import arrays as columns
from tracked_env.physics.parameters import VEHICLES, VehicleState
from tracked_env.sb3 import TrackedVehicleVecEnv
from tracked_env.uncertainty.drawing_laws import RECORD
from tracked_env.vector_env import TrackedVehicleVectorEnv


def models_at_the_end(monkeypatch):
    """Filled with the networks, values and optimisers of each training that ends."""
    found = []
    original = RolloutCallback._on_training_end

    def end(callback):
        found.append(callback.model.get_parameters())
        original(callback)

    monkeypatch.setattr(RolloutCallback, "_on_training_end", end)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_resumed_training_is_the_uninterrupted_one(algorithm, tmp_path, monkeypatch, capsys):
    """In mid-episode, with running normalisation and a history, over a held-out evaluation."""
    changes = {
        "agent": algorithm,
        "augmentation": "history",
        "normalise": True,
        "checkpoint_every": 100,
    }
    if algorithm == "sac":  # killed while its actions are drawn blindly
        changes["sac"] = replace(cases.SETTINGS["sac"], learning_starts=360)
    whole = cases.small(tmp_path / "whole", **changes)
    models = models_at_the_end(monkeypatch)
    assert train.main(whole) == 0
    torn = replace(whole, output=tmp_path / "torn")
    cases.killed_after(330, torn, monkeypatch)
    assert (torn.folder / checkpoint.FILE).exists()
    assert train.main(replace(torn, resume=True)) == 0
    assert len(models) == 2 and same(*models)
    assert "going on after" in capsys.readouterr().out
    for name in ("last.zip", "agent.zip"):
        assert cases.same_arrays(whole.folder / name, torn.folder / name)
    cases.assert_same_curves(whole.folder, torn.folder, "mean_return")
    assert not (torn.folder / checkpoint.FILE).exists()


@pytest.mark.slow
def test_a_resumed_residual_goes_on_with_its_estimators(tmp_path, monkeypatch):
    whole = cases.small(tmp_path / "whole", augmentation="residual")
    assert cases.torn_in_two(270, whole, tmp_path / "torn", monkeypatch)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_agent_and_another_one_another(tmp_path):
    first, again = cases.small(tmp_path / "a"), cases.small(tmp_path / "b")
    other = cases.small(tmp_path / "c", seed=4)
    for config in (first, again, other):
        assert train.main(config) == 0
    assert cases.same_arrays(first.folder / "last.zip", again.folder / "last.zip")
    assert not cases.same_arrays(first.folder / "last.zip", other.folder / "last.zip")


def test_evaluating_more_often_does_not_change_the_agent(tmp_path):
    often = cases.small(tmp_path / "a", evaluate_every=128)
    never = cases.small(tmp_path / "b", held_out=0)
    for config in (often, never):
        assert train.main(config) == 0
    assert cases.same_arrays(often.folder / "last.zip", never.folder / "last.zip")
    assert cases.parameters(never.folder / "agent.zip")


def steps_in(folder):
    """Steps that the checkpoint of a folder goes on after."""
    return checkpoint.read(folder)["learner"]["attributes"]["num_timesteps"]


def damage(path):
    """Turn a bit in the middle of a file."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize("cut", [True, False], ids=["torn", "one bit turned"])
def test_a_damaged_checkpoint_gives_way_to_the_one_before(cut, tmp_path, monkeypatch, capsys):
    whole, torn = cases.small(tmp_path / "whole"), cases.small(tmp_path / "torn")
    assert train.main(whole) == 0
    cases.killed_after(400, torn, monkeypatch)
    latest = torn.folder / checkpoint.FILE
    if cut:
        latest.write_bytes(latest.read_bytes()[:2000])
    else:
        damage(latest)
    assert train.main(replace(torn, resume=True)) == 0
    shown = capsys.readouterr()
    assert "is damaged" in shown.err and "going on from the one before" in shown.err
    assert "going on after 256 steps" in shown.out
    assert cases.same_arrays(whole.folder / "last.zip", torn.folder / "last.zip")


def test_nothing_but_damaged_checkpoints_is_a_clear_error(tmp_path, monkeypatch, refused):
    config = cases.small(tmp_path / "torn")
    cases.killed_after(400, config, monkeypatch)
    for name in (checkpoint.FILE, checkpoint.PREVIOUS):
        damage(config.folder / name)
    assert "Nothing to resume" in refused(replace(config, resume=True))


def test_a_kill_while_a_checkpoint_is_written_loses_neither(tmp_path, monkeypatch):
    config = cases.small(tmp_path / "torn")
    cases.killed_after(400, config, monkeypatch)
    before = steps_in(config.folder)
    half = (config.folder / checkpoint.FILE).read_bytes()[:5000]
    temporary = config.folder / f".{checkpoint.FILE}.1.tmp"
    temporary.write_bytes(half)
    assert steps_in(config.folder) == before
    (config.folder / checkpoint.FILE).unlink()  # killed between the two renamings
    assert steps_in(config.folder) == before - 128
    assert train.main(replace(config, resume=True)) == 0
    assert not temporary.exists()


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    checkpoint.write(tmp_path, {"number": 1})
    with pytest.raises(TypeError, match="cannot be written"):
        checkpoint.write(tmp_path, {"number": object()})
    assert [path.name for path in tmp_path.iterdir()] == [checkpoint.FILE]
    assert checkpoint.read(tmp_path)["number"] == 1


def test_an_unfinished_training_is_not_overwritten_nor_mixed(tmp_path, monkeypatch, refused):
    config = cases.small(tmp_path)
    cases.killed_after(400, config, monkeypatch)
    assert "add --resume" in refused(config)
    assert "seed (then 3, now 9)" in refused(replace(config, resume=True, seed=9))
    assert train.main(replace(config, resume=True)) == 0


# Plain data: what is written comes back, and a stranger's runs no code


def same(one, other):
    """Whether two states are equal, types and bits."""
    if isinstance(one, dict):  # an ordered one comes back as a dict, which has an order too
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    assert type(one) is type(other)
    if isinstance(one, (list, tuple, deque)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.random.Generator):
        return same(one.bit_generator.state, other.bit_generator.state)
    if isinstance(one, torch.Tensor):
        one, other = one.numpy(), other.numpy()
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and one.shape == other.shape
        assert one.flags.f_contiguous == other.flags.f_contiguous and other.flags.writeable
        return one.tobytes() == other.tobytes()
    return one == other or (one != one and other != other)


def there_and_back(state, tmp_path):
    checkpoint.write_state(tmp_path / "state.zip", state)
    return checkpoint.read_state(tmp_path / "state.zip")


def test_every_kind_of_value_comes_back_to_the_bit(tmp_path):
    shared = np.arange(3.0)
    deviation = np.random.default_rng(3)
    deviation.standard_normal(5, dtype=np.float32)
    state = {
        "numbers": [0, -7, 2**130, True, False, None, 0.1, -0.0, 1e-320, float("inf")],
        "nan": float("nan"), "text": 'a "b" \n \u00e4', 5: {(1, "a"): []},
        "numpy": (np.float64(0.1), np.float32(0.1), np.int64(-3), np.bool_(True)),
        "arrays": [np.zeros((0, 8)), np.array(0.5), np.eye(3, dtype=np.float32),
                   np.arange(24).reshape(2, 3, 4), np.arange(6.0).reshape(2, 3).T,
                   np.array([True, False]), np.arange(9, dtype=np.uint8)],
        "records": np.full(2, np.array(tuple(VEHICLES["strawa"]), dtype=RECORD)),
        "shared": [shared, shared], "deque": deque([{"r": 1.5}], maxlen=100),
        "tensors": (torch.arange(4), torch.tensor(0.25), torch.eye(2)),
        "named": VehicleState(1.0, yaw=np.float64(0.3)),
        "generators": [deviation, np.random.Generator(np.random.SFC64(4))],
        "python": random.getstate(), "legacy": np.random.RandomState(0).get_state(),
    }  # fmt: skip
    found = there_and_back(state, tmp_path)
    assert same(state, found)
    assert found["shared"][0] is found["shared"][1]
    drawn = [each.standard_normal() for each in (state["generators"][0], found["generators"][0])]
    assert drawn[0] == drawn[1]


SCAN = json.dumps({"observation": [*TERRAIN["observation"], "height_scan"]})
MEMORIES = [(augmentation, env, None) for env in (TORQUE_ID, SPEED_ID) for augmentation in KINDS]


@pytest.mark.parametrize(
    ("augmentation", "env", "shown"),
    [
        *MEMORIES,
        pytest.param("blind", TERRAIN_ID, SCAN, marks=pytest.mark.slow),
        pytest.param("residual", TERRAIN_ID, None, marks=pytest.mark.slow),  # slip tables of slopes
    ],
)
def test_the_state_of_every_memory_comes_back_to_the_bit(augmentation, env, shown, tmp_path):
    """After some steps: a named tuple that is not in TYPES would be a TypeError."""
    config = cases.small(
        tmp_path, augmentation=augmentation, env=env, normalise=True, env_args=shown
    )
    model = make_model("ppo", config.ppo, make_environment(resolve(config)), 0)
    model.learn(128)
    state = checkpoint.capture_model(model)
    assert same(state, there_and_back(state, tmp_path))


def test_what_cannot_be_written_is_a_clear_error(tmp_path):
    for value, message in (
        (object(), "a object cannot be written.*agents.checkpoint.TYPES"),
        (np.array([None]), "an array of object cannot be written"),
        (np.random.Generator(np.random.MT19937(0)), "a Generator cannot be written"),
        (type("VehicleState", (tuple,), {})(), "a VehicleState cannot be written"),
    ):
        with pytest.raises(TypeError, match=message):
            checkpoint.write_state(tmp_path / "state.zip", {"value": value})


def objects(mark):
    """An npy file of an array of objects with harm in it."""
    buffer = io.BytesIO()
    npy.write_array(buffer, np.array([cases.Harm(mark)], dtype=object), allow_pickle=True)
    return buffer.getvalue()


@pytest.fixture
def begun(tmp_path):
    """The configuration of a training that has begun."""
    run = resolve(cases.small(tmp_path / "out", resume=True))
    begin(run.options.folder, run.recipe, 0)
    return cases.small(tmp_path / "out", resume=True)


def test_no_code_of_a_checkpoint_runs(begun, tmp_path, refused):
    """Arrays of objects, and types that nobody listed."""
    mark = tmp_path / "harm"
    array, named = {"array": 0}, {"named": ["Popen", [["mkdir", str(mark)]]]}
    for files in (
        {checkpoint.STATE: json.dumps(array), checkpoint.ARRAYS: objects(mark)},
        {checkpoint.STATE: json.dumps(named), checkpoint.ARRAYS: b""},
        {checkpoint.STATE: pickle.dumps(cases.Harm(mark)), checkpoint.ARRAYS: b""},
    ):
        cases.packed(begun.folder / checkpoint.FILE, files)
        line = refused(begun)
        assert str(begun.folder) in line and "is damaged" in line
        assert not mark.exists()


def test_only_what_is_listed_is_ever_built():
    kinds = [getattr(import_module(module), name) for name, module in checkpoint.TYPES.items()]
    assert all(issubclass(kind, tuple) and kind._fields for kind in kinds)
    assert set(checkpoint.GENERATORS) == {"PCG64", "SFC64"}


@pytest.mark.parametrize(
    "content",
    ["", "[]", "5", "null", "{}", '{"format": 1}', '{"dict": []}', '{"dict": [["format", 2]]}',
     "[" * 100_000, '{"array": 0}', '{"array": -3}', '{"nothing": 0, "more": 1}',
     '{"generator": {"dict": [["bit_generator", "MT19937"]]}}'],
)  # fmt: skip
def test_a_checkpoint_that_is_none_is_one_line(content, begun, refused):
    cases.packed(
        begun.folder / checkpoint.FILE, {checkpoint.STATE: content, checkpoint.ARRAYS: b""}
    )
    line = refused(begun)
    assert "Nothing to resume" in line and str(begun.folder) in line


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """The configuration of a training that was killed, and its checkpoint as JSON and files."""
    config = cases.small(
        tmp_path_factory.mktemp("torn"), augmentation="history", normalise=True, held_out=0
    )
    with pytest.MonkeyPatch.context() as patch:
        cases.killed_after(400, config, patch)
    (config.folder / checkpoint.PREVIOUS).unlink()
    files = cases.entries(config.folder / checkpoint.FILE)
    return config, json.loads(files[checkpoint.STATE]), files


def resumed(config, folder, content):
    """Go on from a checkpoint with this content in a folder; returns the exit status."""
    folder.mkdir(exist_ok=True)
    shutil.copy(config.folder / CONFIG, folder)
    if "learner" in content:
        checkpoint.write_state(folder / checkpoint.FILE, content)
    else:
        cases.packed(folder / checkpoint.FILE, content)
    return train.main(replace(config, output=folder, resume=True))


def simulation_of(state):
    """The part of a state that the simulation goes on from."""
    layers = state["learner"]["environment"]
    return next(layer for layer in layers if isinstance(layer, dict) and "batch" in layer)


@pytest.mark.slow
def test_no_value_in_a_checkpoint_is_a_traceback(interrupted, tmp_path, capsys):
    """Wrong values in random places of the state: it goes on, or says in a line why not."""
    config, content, files = interrupted
    places = [where for where in cases.branches(content, width=10**6) if len(where) > 1]
    chosen = random.Random(0).sample(places, 120)
    refused = 0
    for i, where in enumerate(chosen):
        text = json.dumps(cases.put(content, where, cases.WRONG[i % len(cases.WRONG)]))
        status = resumed(config, tmp_path / str(i), {**files, checkpoint.STATE: text})
        lines = capsys.readouterr().err.splitlines()
        assert (status, len(lines)) in ((0, 0), (2, 1)), where
        refused += status == 2
    assert 20 < refused < 110  # some numbers may be others: they are as good as before


@pytest.mark.parametrize("column", ["STEP", "NOISE_CURSOR", "EVENT_COUNT", "DELAY"])
def test_places_outside_the_arrays_of_the_kernels_are_refused(
    column, interrupted, tmp_path, capsys
):
    config, _, _ = interrupted
    state = checkpoint.read_state(config.folder / checkpoint.FILE)
    counters = simulation_of(state)["batch"].counters
    counters[0, getattr(columns, column)] = -(10**6)
    assert resumed(config, tmp_path, state) == 2
    assert "Batch.counters" in capsys.readouterr().err


def test_arrays_of_another_shape_are_refused_before_anything_is_put_back(
    interrupted, tmp_path, capsys
):
    config, _, _ = interrupted
    for name in ("floats", "counters", "events", "noise", "history", "profile"):
        state = checkpoint.read_state(config.folder / checkpoint.FILE)
        simulation = simulation_of(state)
        smaller = getattr(simulation["batch"], name)[..., :-1]
        simulation["batch"] = simulation["batch"]._replace(**{name: smaller})
        assert resumed(config, tmp_path, state) == 2
        assert f"Batch.{name} = " in capsys.readouterr().err


def test_a_checkpoint_that_unpacks_to_more_than_its_file_is_refused(tmp_path):
    """A training writes nothing compressed, and nothing twice."""
    checkpoint.write_state(tmp_path / "state.zip", {"array": np.zeros(1000)})
    files = cases.entries(tmp_path / "state.zip")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
        archive.writestr("big.npy", bytes(10**7))
    assert (tmp_path / "bomb.zip").stat().st_size < 20_000
    with pytest.raises(ValueError, match="it unpacks to"):
        checkpoint.read_state(tmp_path / "bomb.zip")


def vehicles():
    return TrackedVehicleVecEnv(TrackedVehicleVectorEnv(2, autoreset_mode="SameStep"))


@pytest.mark.parametrize("name", ["_last_obs", "_n_updates", "ep_success_buffer"])
def test_an_attribute_that_another_version_of_the_library_lacks_ends_the_checkpoint(name):
    """It was left out, and the training went on from the checkpoint as another one."""
    model = PPO("MlpPolicy", vehicles(), n_steps=8, batch_size=8)
    model.learn(8)
    assert name in checkpoint.capture_model(model)["attributes"]
    delattr(model, name)
    with pytest.raises(AttributeError, match=f"has no attribute '{name}'"):
        checkpoint.capture_model(model)


def test_an_environment_whose_wrappers_lead_nowhere_ends_the_checkpoint(monkeypatch):
    env = VecMonitor(vehicles())
    assert len(checkpoint.capture_environment(env)) == len(checkpoint.layers(env)) > 1
    monkeypatch.setattr(env, "venv", None)
    with pytest.raises(AttributeError):
        checkpoint.capture_environment(env)
