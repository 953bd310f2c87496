"""A training that was killed goes on as if nothing had happened; damaged files are noticed."""

from dataclasses import replace

import pytest
import torch

import train
from agents import checkpoint
from agents.algorithms import ALGORITHMS
from agents.learners import RolloutCallback
from tests.agents.agent_cases import (
    SETTINGS,
    assert_same_curves,
    killed_after,
    parameters,
    same_parameters,
    small,
    torn_in_two,
)


def models_at_the_end(monkeypatch):
    """Filled with the networks, values and optimisers of each training that ends."""
    found = []
    original = RolloutCallback._on_training_end

    def end(callback):
        found.append(callback.model.get_parameters())
        original(callback)

    monkeypatch.setattr(RolloutCallback, "_on_training_end", end)
    return found


def same_tensors(one, other):
    """Whether all tensors in two trees of dicts and lists are equal, bit for bit."""
    if isinstance(one, dict):
        return set(one) == set(other) and all(same_tensors(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same_tensors, one, other))
    return torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_resumed_training_is_the_uninterrupted_one(algorithm, tmp_path, monkeypatch, capsys):
    """In mid-episode, with running normalisation and a history, over a held-out evaluation."""
    changes = {
        "agent": algorithm, "augmentation": "history", "normalise": True, "checkpoint_every": 100
    }  # fmt: skip
    if algorithm == "sac":  # killed while its actions are drawn blindly
        changes["sac"] = replace(SETTINGS["sac"], learning_starts=360)
    whole = small(tmp_path / "whole", **changes)
    models = models_at_the_end(monkeypatch)
    assert train.main(whole) == 0
    torn = replace(whole, output=tmp_path / "torn")
    killed_after(330, torn, monkeypatch)
    assert (torn.folder / checkpoint.FILE).exists()
    assert train.main(replace(torn, resume=True)) == 0
    assert len(models) == 2 and same_tensors(*models)
    assert "going on after" in capsys.readouterr().out
    for name in ("last.zip", "agent.zip"):
        assert same_parameters(whole.folder / name, torn.folder / name)
    assert_same_curves(whole.folder, torn.folder, "mean_return")
    assert not (torn.folder / checkpoint.FILE).exists()


@pytest.mark.slow
def test_a_resumed_residual_goes_on_with_its_estimators(tmp_path, monkeypatch):
    whole = small(tmp_path / "whole", augmentation="residual")
    assert torn_in_two(270, whole, tmp_path / "torn", monkeypatch)


def test_the_same_seed_gives_the_same_agent_and_another_one_another(tmp_path):
    first, again = small(tmp_path / "a"), small(tmp_path / "b")
    other = small(tmp_path / "c", seed=4)
    for config in (first, again, other):
        assert train.main(config) == 0
    assert same_parameters(first.folder / "last.zip", again.folder / "last.zip")
    assert not same_parameters(first.folder / "last.zip", other.folder / "last.zip")


def test_evaluating_more_often_does_not_change_the_agent(tmp_path):
    often = small(tmp_path / "a", evaluate_every=128)
    never = small(tmp_path / "b", held_out=0)
    for config in (often, never):
        assert train.main(config) == 0
    assert same_parameters(often.folder / "last.zip", never.folder / "last.zip")
    assert parameters(never.folder / "agent.zip")


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
    whole, torn = small(tmp_path / "whole"), small(tmp_path / "torn")
    assert train.main(whole) == 0
    killed_after(400, torn, monkeypatch)
    latest = torn.folder / checkpoint.FILE
    if cut:
        latest.write_bytes(latest.read_bytes()[:2000])
    else:
        damage(latest)
    assert train.main(replace(torn, resume=True)) == 0
    shown = capsys.readouterr()
    assert "is damaged" in shown.err and "going on from the one before" in shown.err
    assert "going on after 256 steps" in shown.out
    assert same_parameters(whole.folder / "last.zip", torn.folder / "last.zip")


def test_nothing_but_damaged_checkpoints_is_a_clear_error(tmp_path, monkeypatch, capsys):
    config = small(tmp_path / "torn")
    killed_after(400, config, monkeypatch)
    for name in (checkpoint.FILE, checkpoint.PREVIOUS):
        damage(config.folder / name)
    assert train.main(replace(config, resume=True)) == 2
    assert "Nothing to resume" in capsys.readouterr().err


def test_a_kill_while_a_checkpoint_is_written_loses_neither(tmp_path, monkeypatch):
    config = small(tmp_path / "torn")
    killed_after(400, config, monkeypatch)
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


def test_an_unfinished_training_is_not_overwritten_nor_mixed(tmp_path, monkeypatch, capsys):
    config = small(tmp_path)
    killed_after(400, config, monkeypatch)
    assert train.main(config) == 2
    assert "add --resume" in capsys.readouterr().err
    assert train.main(replace(config, resume=True, seed=9)) == 2
    assert "seed (then 3, now 9)" in capsys.readouterr().err
    assert train.main(replace(config, resume=True)) == 0
