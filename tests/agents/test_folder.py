"""A folder holds one training: finished ones are not repeated, none is overwritten unasked."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import train
from agents import checkpoint, folder
from agents.algorithms import ALGORITHMS, LIMITS
from agents.folder import PRODUCTS, Progress
from agents.learners import RolloutCallback, Sb3Learner
from baselines.learned.agent_policy import LEARNED_SLIP
from baselines.registry import ANY, LEARNED
from tests.agents import agent_cases as cases
from tracked_env.benchmark.files import locked


def recorded(folder):
    return json.loads((folder / "config.json").read_text())


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The configuration of a training that has ended."""
    config = cases.small(tmp_path_factory.mktemp("finished"), steps=256)
    assert train.main(config) == 0
    return config


def test_a_finished_training_is_not_repeated(finished, capsys, refused):
    written = {path: path.stat().st_mtime_ns for path in finished.folder.iterdir()}
    assert recorded(finished.folder)["finished"] is True
    assert train.main(replace(finished, resume=True, quiet=False)) == 0
    assert capsys.readouterr().out == f"already finished: {finished.folder / 'agent.zip'}\n"
    assert train.main(finished) == 2
    message = capsys.readouterr().err
    assert f"{finished.folder} holds a finished training" in message
    assert "another --output" in message and "--overwrite" in message
    assert "steps (then 256, now 512)" in refused(replace(finished, resume=True, steps=512))
    assert written == {path: path.stat().st_mtime_ns for path in finished.folder.iterdir()}


def test_overwrite_trains_anew_where_a_training_is_finished(finished, tmp_path, monkeypatch):
    config = replace(finished, output=tmp_path)
    with monkeypatch.context() as patch:  # killed before the last checkpoints were deleted
        patch.setattr(checkpoint, "remove", lambda folder: None)
        assert train.main(config) == 0
    (tmp_path / checkpoint.FILE).replace(tmp_path / checkpoint.PREVIOUS)
    anew = replace(config, overwrite=True, seed=4, steps=512)
    cases.killed_after(200, anew, monkeypatch)
    assert "finished" not in recorded(tmp_path)
    assert not (tmp_path / checkpoint.PREVIOUS).exists()
    assert not (tmp_path / "agent.zip").exists()  # it would be the one of before
    assert train.main(replace(anew, overwrite=False, resume=True)) == 0
    assert recorded(tmp_path)["finished"] is True and recorded(tmp_path)["config"]["seed"] == 4


@pytest.mark.parametrize("damaged", [False, True])
def test_one_checkpoint_of_two_is_an_unfinished_training_too(
    damaged, finished, tmp_path, monkeypatch, capsys, refused
):
    """As a kill between two renamings leaves it; a damaged one gives way to --overwrite."""
    config = replace(finished, output=tmp_path)
    cases.killed_after(200, config, monkeypatch)
    left = (tmp_path / checkpoint.FILE).replace(tmp_path / checkpoint.PREVIOUS)
    if damaged:
        left.write_bytes(b"half of it")
    assert "holds an unfinished training: add --resume" in refused(config)
    assert train.main(replace(config, overwrite=True)) == 0
    assert "going on" not in capsys.readouterr().out
    assert cases.same_arrays(tmp_path / "last.zip", finished.folder / "last.zip")
    assert not list(tmp_path.glob("*checkpoint*"))


CONFIGS = [b'{"finished": true}', b"[]", b"torn {", b"\xff\x00\x93", b"[" * 9999,
           b'{"config": {"seed": 3}}', b'{"finished": true, "config": 5}', b""]  # fmt: skip
OF_STRANGERS = {
    "config.json": CONFIGS,
    "agent.zip": [b"mine"],
    "last.zip": [b""],
    "curve.csv": [b"time"],
    "checkpoint.zip": [b"mine"],
    "checkpoint-before.zip": [b"mine"],
}


@pytest.mark.parametrize("changes", [{}, {"resume": True}, {"overwrite": True}], ids=str)
@pytest.mark.parametrize("name", OF_STRANGERS)
def test_a_file_that_no_training_has_written_stays_as_it_is(
    changes, name, finished, tmp_path, refused, monkeypatch
):
    """In the folder that is named, and in the working directory; a broken link too."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    for content in OF_STRANGERS[name]:
        for output in (tmp_path, Path()):
            path.write_bytes(content)
            message = refused(replace(finished, output=output, **changes))
            assert name in message and "no config.json that a training has written" in message
            assert path.read_bytes() == content
    path.unlink()
    path.symlink_to(tmp_path / "nowhere")
    assert train.main(replace(finished, output=tmp_path, **changes)) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == [name] and path.is_symlink()


def test_what_comes_with_the_project_is_recognised_as_written_by_a_training():
    pretrained = Path(__file__).parents[2] / "baselines" / "learned" / "pretrained"
    others = (ANY, LEARNED, LEARNED_SLIP)  # regressed, not trained by train.py
    folders = [
        path.parent
        for path in sorted(pretrained.glob("*/*/config.json"))
        if path.parent.name.rpartition("-seed")[0] not in others
    ]
    assert len(folders) >= 20
    for path in folders[::6]:
        assert folder._recorded(path)["command"].startswith("python train.py")


def test_resume_without_a_checkpoint_begins_only_the_training_that_lies_there(
    finished, tmp_path, refused
):
    config = replace(finished, output=tmp_path, resume=True)
    recipe = recorded(finished.folder)
    del recipe["finished"]
    recipe["config"]["seed"] = 9
    (tmp_path / "config.json").write_text(json.dumps(recipe))
    assert "seed (then 9, now 3)" in refused(config)
    recipe["config"]["seed"] = 3
    (tmp_path / "config.json").write_text(json.dumps(recipe))
    assert train.main(config) == 0
    assert cases.same_arrays(tmp_path / "last.zip", finished.folder / "last.zip")


def test_a_checkpoint_left_by_a_kill_in_the_last_moment_is_cleared(
    finished, tmp_path, capsys, monkeypatch
):
    config = replace(finished, output=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "remove", lambda folder: None)
        assert train.main(config) == 0
    left = tmp_path / checkpoint.FILE
    assert left.exists()
    assert train.main(replace(config, resume=True)) == 0
    assert "already finished" in capsys.readouterr().out
    assert not left.exists()


def test_a_finished_training_without_its_agent_is_not_called_finished(finished, tmp_path, capsys):
    shutil.copytree(finished.folder, tmp_path / "copied")
    (tmp_path / "copied" / "agent.zip").unlink()
    assert train.main(replace(finished, output=tmp_path / "copied", resume=True)) == 2
    assert "agent.zip is missing" in capsys.readouterr().err


def test_nothing_is_deleted_before_the_new_configuration_is_on_the_disk(
    finished, tmp_path, capsys, monkeypatch
):
    shutil.copytree(finished.folder, tmp_path / "copied")
    config = replace(finished, output=tmp_path / "copied", overwrite=True)
    kept = {path: path.read_bytes() for path in config.folder.iterdir()}

    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        assert train.main(config) == 2
    assert "No space left on device" in cases.one_line(capsys)
    assert kept == {path: path.read_bytes() for path in config.folder.iterdir()}


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("/proc/none", "cannot be written"),
        ("/dev/null", "is a file; must be a folder"),
        ("/dev/null/none", "Not a directory"),
        ("x" * 300, "File name too long"),
    ],
)
def test_a_folder_that_cannot_be_written_is_one_clear_line(output, message, finished, refused):
    for asked in ({}, {"resume": True}, {"overwrite": True}):
        assert message in refused(replace(finished, output=Path(output), **asked))


def test_wrong_settings_delete_nothing(finished, capsys):
    for changes in ({"uncertainty": ("nope",)}, {"resume": True}):
        assert train.main(replace(finished, overwrite=True, **changes)) == 2
        assert "nope" in capsys.readouterr().err or "resume" in changes
    assert (finished.folder / "agent.zip").is_file()
    assert recorded(finished.folder)["finished"] is True


# One training at a time

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
    pytest.importorskip("fcntl", reason="folders are not locked here")
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
        assert train.main(cases.small(folder, steps=128, **changes)) == 2
        assert f"{folder} is in use by a training that runs now" in cases.one_line(capsys)
    assert list(folder.iterdir()) == []


def test_the_lock_of_a_killed_training_is_free(holder):
    process, folder = holder
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert train.main(cases.small(folder, steps=128)) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="folders are not locked here")
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


# Trainings that end before their time: in one line, with what was good still there


@pytest.fixture
def any_rate(monkeypatch):
    """Learning rates that spoil a network at once are refused; here they are let through."""
    monkeypatch.setitem(LIMITS, "learning_rate", "(0, inf)")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_training_that_diverges_says_so_and_keeps_nothing_of_it(
    algorithm, any_rate, tmp_path, refused
):
    config = cases.small(tmp_path, agent=algorithm)
    name = algorithm.replace("-", "_")
    quick = replace(getattr(config, name), learning_rate=1e30)
    message = refused(replace(config, **{name: quick}))
    assert "the training diverged at" in message and "is not finite" in message
    assert f"Lower --{algorithm}.learning-rate (now 1e+30)" in message
    for product in PRODUCTS[:2]:
        if (tmp_path / product).exists():
            assert all(
                np.isfinite(of).all() for of in cases.parameters(tmp_path / product).values()
            )


def test_a_late_divergence_leaves_the_agent_and_the_checkpoint_of_before(
    tmp_path, capsys, monkeypatch
):
    config = cases.small(tmp_path, evaluate_every=128)
    check = Sb3Learner.check

    def spoil(learner):
        if learner.steps >= 384:
            next(learner.model.policy.parameters()).data[0] = float("nan")
        check(learner)

    with monkeypatch.context() as patch:
        patch.setattr(Sb3Learner, "check", spoil)
        assert train.main(config) == 2
    assert "diverged at 384 steps: log_std is not finite" in cases.one_line(capsys)
    assert checkpoint.read(tmp_path)["progress"]["saved"] == 256
    for product in PRODUCTS[:2]:
        assert all(np.isfinite(of).all() for of in cases.parameters(tmp_path / product).values())
    assert "finished" not in json.loads((tmp_path / "config.json").read_text())


def test_an_error_of_the_program_is_not_taken_for_a_divergence(tmp_path, monkeypatch):
    def fail(callback):
        raise ValueError("of the program")

    monkeypatch.setattr(RolloutCallback, "_on_step", fail)
    with pytest.raises(ValueError, match="of the program"):
        train.main(cases.small(tmp_path))


def test_an_evaluation_without_a_number_does_not_replace_the_best_agent(tmp_path, monkeypatch):
    scores = iter([0.5, float("nan"), 0.7])
    monkeypatch.setattr("agents.folder.held_out_rmse", lambda *_: next(scores))
    path = cases.archive_of(cases.small(tmp_path, evaluate_every=128, steps=384))
    assert not cases.same_arrays(path, tmp_path / "last.zip")


def test_a_disk_that_is_full_is_one_line_and_the_training_goes_on_later(
    tmp_path, capsys, monkeypatch
):
    config = cases.small(tmp_path / "torn", held_out=0)
    assert train.main(replace(config, output=tmp_path / "whole")) == 0
    write, written = checkpoint.write, []

    def full(folder, state):
        if len(written) == 2:
            (folder / f".{checkpoint.FILE}.tmp").write_bytes(b"half of it")
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(write(folder, state))

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write", full)
        assert train.main(config) == 2
    message = cases.one_line(capsys)
    assert "cannot be written" in message and "No space left on device" in message
    assert train.main(replace(config, resume=True)) == 0
    assert "going on after 256 steps" in capsys.readouterr().out
    assert cases.same_arrays(tmp_path / "torn" / "last.zip", tmp_path / "whole" / "last.zip")
    assert not list((tmp_path / "torn").glob(".*"))


@pytest.mark.parametrize(
    "stage",
    ["agents.learners.make_environment", "agents.learners.make_model", "agents.folder.begin"],
)
def test_an_interruption_before_the_first_checkpoint_is_one_line(
    stage, tmp_path, capsys, monkeypatch
):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, interrupt)
    assert train.main(cases.small(tmp_path / "none")) == 130
    assert "interrupted; no checkpoint yet" in cases.one_line(capsys)
    assert not (tmp_path / "none").exists()


def test_an_interruption_later_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "evaluate", interrupt)
    assert train.main(cases.small(tmp_path)) == 130
    assert cases.one_line(capsys) == f"interrupted; go on with --resume --output {tmp_path}\n"


LATER = [pytest.param(delay, marks=pytest.mark.slow) for delay in (0.1, 1.8)]


@pytest.mark.parametrize("delay", [0.8, *LATER])
def test_ctrl_c_while_everything_is_imported_is_one_line(delay, repository, tmp_path):
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", "import contextlib"], cwd=repository, check=True)
    delay += 2.0 * (time.perf_counter() - began)  # the handler stands, however busy the machine is
    process = subprocess.Popen(
        [sys.executable, str(repository / "train.py"), "--output", str(tmp_path / "none")],
        cwd=repository,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # In the background of a shell SIGINT is ignored, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    output, message = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in message and message.count("\n") == 1 and not output
    assert not (tmp_path / "none").exists()
