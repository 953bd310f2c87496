"""A folder holds one training: finished ones are not repeated, none is overwritten unasked."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import train
from agents import checkpoints
from agents.student import Student
from tests.agents.agent_cases import same_parameters, small
from tests.agents.test_checkpoints import killed_after
from tests.agents.test_student import SETTINGS
from tracked_env import SPEED_ID


def recorded(folder):
    return json.loads((folder / "config.json").read_text())


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The configuration of a training that has ended."""
    config = small(tmp_path_factory.mktemp("finished"), steps=256)
    assert train.main(config) == 0
    return config


def test_a_finished_training_is_not_repeated(finished, capsys):
    written = {path: path.stat().st_mtime_ns for path in finished.folder.iterdir()}
    assert recorded(finished.folder)["finished"] is True
    assert train.main(replace(finished, resume=True, quiet=False)) == 0
    assert capsys.readouterr().out == f"already finished: {finished.folder / 'agent.zip'}\n"
    assert train.main(finished) == 2
    message = capsys.readouterr().err
    assert f"{finished.folder} holds a finished training" in message
    assert "another --output" in message and "--overwrite" in message
    assert train.main(replace(finished, resume=True, steps=512)) == 2
    assert "steps (then 256, now 512)" in capsys.readouterr().err
    assert written == {path: path.stat().st_mtime_ns for path in finished.folder.iterdir()}


def test_overwrite_trains_anew_where_a_training_is_finished(finished, tmp_path, monkeypatch):
    config = replace(finished, output=tmp_path)
    assert train.main(config) == 0
    (tmp_path / checkpoints.PREVIOUS).write_bytes(b"of before")
    anew = replace(config, overwrite=True, seed=4, steps=512)
    killed_after(200, anew, monkeypatch)
    assert "finished" not in recorded(tmp_path)
    assert not (tmp_path / checkpoints.PREVIOUS).exists()
    assert not (tmp_path / "agent.zip").exists()  # it would be the one of before
    assert train.main(replace(anew, overwrite=False, resume=True)) == 0
    assert recorded(tmp_path)["finished"] is True and recorded(tmp_path)["config"]["seed"] == 4


def test_overwrite_trains_anew_where_a_training_is_unfinished(
    finished, tmp_path, monkeypatch, capsys
):
    torn = replace(finished, output=tmp_path)
    killed_after(200, torn, monkeypatch)
    assert train.main(replace(torn, overwrite=True)) == 0
    assert "going on" not in capsys.readouterr().out
    assert same_parameters(tmp_path / "last.zip", finished.folder / "last.zip")
    assert not list(tmp_path.glob("*checkpoint*"))


def test_one_checkpoint_of_two_is_an_unfinished_training_too(finished, tmp_path, capsys):
    (tmp_path / checkpoints.PREVIOUS).write_bytes(b"killed between the two renamings")
    assert train.main(replace(finished, output=tmp_path)) == 2
    assert "holds an unfinished training: add --resume" in capsys.readouterr().err


@pytest.mark.parametrize("resume", [False, True])
def test_an_agent_of_unknown_origin_is_not_overwritten(resume, finished, tmp_path, capsys):
    (tmp_path / "agent.zip").write_bytes(b"mine")
    assert train.main(replace(finished, output=tmp_path, resume=resume)) == 2
    assert "holds an agent" in capsys.readouterr().err
    assert (tmp_path / "agent.zip").read_bytes() == b"mine"


def test_resume_without_a_checkpoint_begins_only_the_training_that_lies_there(
    finished, tmp_path, capsys
):
    config = replace(finished, output=tmp_path, resume=True)
    (tmp_path / "config.json").write_text(json.dumps({"config": {"seed": 9}}))
    assert train.main(config) == 2
    assert "seed (then 9, now 3)" in capsys.readouterr().err
    (tmp_path / "config.json").write_text("torn {")
    assert train.main(config) == 0
    assert same_parameters(tmp_path / "last.zip", finished.folder / "last.zip")


def test_a_checkpoint_left_by_a_kill_in_the_last_moment_is_cleared(finished, capsys):
    left = finished.folder / checkpoints.FILE
    left.write_bytes(b"not yet deleted")
    assert train.main(replace(finished, resume=True)) == 0
    assert "already finished" in capsys.readouterr().out
    assert not left.exists()


def test_wrong_settings_delete_nothing(finished, capsys):
    for changes in ({"uncertainty": ("nope",)}, {"resume": True}):
        assert train.main(replace(finished, overwrite=True, **changes)) == 2
        assert "nope" in capsys.readouterr().err or "resume" in changes
    assert (finished.folder / "agent.zip").is_file()
    assert recorded(finished.folder)["finished"] is True


def test_a_student_is_not_repeated_or_overwritten_either(tmp_path, monkeypatch, capsys):
    assert train.main(small(tmp_path / "teacher", memory="teacher", steps=128)) == 0
    teacher = tmp_path / "teacher" / "agent.zip"
    given = {"memory": "student", "teacher": teacher, "student": SETTINGS, "steps": 256}
    config = small(tmp_path / "student", **given, checkpoint_every=100)
    collect = Student.collect

    def interrupted(self):
        if self.steps >= 128:
            raise KeyboardInterrupt
        return collect(self)

    with monkeypatch.context() as patch:
        patch.setattr(Student, "collect", interrupted)
        assert train.main(config) == 130
    assert "finished" not in recorded(config.folder)
    assert train.main(config) == 2
    assert train.main(replace(config, overwrite=True)) == 0
    assert "going on" not in capsys.readouterr().out
    assert recorded(config.folder)["finished"] is True
    assert train.main(replace(config, resume=True)) == 0
    assert "already finished" in capsys.readouterr().out
    assert train.main(config) == 2


def test_each_environment_has_a_folder_of_its_own():
    assert train.Config().folder == Path("runs/ppo-blind-seed0")
    speed = train.Config(env=SPEED_ID, agent="sac", memory="history", seed=2)
    assert speed.folder == Path("runs/Speed-v0/sac-history-seed2")
    assert replace(speed, output=Path("mine")).folder == Path("mine")
