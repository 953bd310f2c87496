"""Two trainings in one folder: the second is refused, and a killed one blocks nobody."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import train
from tests.agents.agent_cases import small
from tracked_env.benchmark.files import locked

pytest.importorskip("fcntl", reason="folders are not locked here")

HOLD = """
import sys, time
from pathlib import Path
from tracked_env.benchmark.files import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path, repository):
    """A process that holds the lock of tmp_path / "out"."""
    folder = tmp_path / "out"
    folder.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None and process.stdout.readline() == b"locked\n"
        yield process, folder
        process.kill()


def test_a_second_training_in_a_folder_is_refused_in_a_line(holder, capsys):
    _, folder = holder
    for changes in ({}, {"resume": True}, {"overwrite": True}):
        assert train.main(small(folder, steps=128, **changes)) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{folder} is in use by a training that runs now" in line
    assert list(folder.iterdir()) == []


def test_the_lock_of_a_killed_training_is_free(holder):
    process, folder = holder
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert train.main(small(folder, steps=128)) == 0


def test_a_training_gives_the_lock_back_however_it_ends(tmp_path):
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    with locked(tmp_path), pytest.raises(ValueError, match="is in use"), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def test_a_lock_leaves_no_folder_where_nothing_was_written(tmp_path):
    with locked(tmp_path / "runs" / "mine"):
        assert (tmp_path / "runs" / "mine").is_dir()
    assert not (tmp_path / "runs").exists()
    with locked(tmp_path / "runs" / "mine"):
        (tmp_path / "runs" / "mine" / "config.json").write_text("{}")
    assert (tmp_path / "runs" / "mine" / "config.json").exists()


def test_what_is_no_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for output in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / ("x" * 300)):
        assert train.main(small(Path(output), steps=128)) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "must be a folder" in line or "cannot be written" in line
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
