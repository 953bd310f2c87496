"""Trainings that end before their time: in one line, with what was good still there."""

import errno
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import train
from agents import checkpoint
from agents.algorithms import ALGORITHMS, LIMITS
from agents.folder import PRODUCTS, Progress
from agents.learners import RolloutCallback, Sb3Learner
from tests.agents.agent_cases import (
    STUDENT,
    one_line,
    parameters,
    same_parameters,
    small,
    student_config,
)


@pytest.fixture
def any_rate(monkeypatch):
    """Learning rates that spoil a network at once are refused; here they are let through."""
    monkeypatch.setitem(LIMITS, "learning_rate", "(0, inf)")


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_training_that_diverges_says_so_and_keeps_nothing_of_it(
    algorithm, any_rate, tmp_path, capsys
):
    config = small(tmp_path, agent=algorithm)
    name = algorithm.replace("-", "_")
    quick = replace(getattr(config, name), learning_rate=1e30)
    assert train.main(replace(config, **{name: quick})) == 2
    message = one_line(capsys)
    assert "the training diverged at" in message and "is not finite" in message
    assert f"Lower --{algorithm}.learning-rate (now 1e+30)" in message
    for product in PRODUCTS[:2]:
        if (tmp_path / product).exists():
            assert all(np.isfinite(of).all() for of in parameters(tmp_path / product).values())


def test_a_late_divergence_leaves_the_agent_and_the_checkpoint_of_before(
    tmp_path, capsys, monkeypatch
):
    config = small(tmp_path, evaluate_every=128)
    check = Sb3Learner.check

    def spoil(learner):
        if learner.steps >= 384:
            next(learner.model.policy.parameters()).data[0] = float("nan")
        check(learner)

    with monkeypatch.context() as patch:
        patch.setattr(Sb3Learner, "check", spoil)
        assert train.main(config) == 2
    assert "diverged at 384 steps: log_std is not finite" in one_line(capsys)
    assert checkpoint.read(tmp_path)["progress"]["saved"] == 256
    for product in PRODUCTS[:2]:
        assert all(np.isfinite(of).all() for of in parameters(tmp_path / product).values())
    assert "finished" not in json.loads((tmp_path / "config.json").read_text())


def test_a_student_that_diverges_says_so(any_rate, teacher, tmp_path, capsys):
    config = student_config(tmp_path, teacher, student=replace(STUDENT, learning_rate=1e30))
    assert train.main(config) == 2
    message = one_line(capsys)
    assert "diverged" in message and "Lower --student.learning-rate" in message
    assert not (config.folder / "agent.zip").exists()


def test_an_error_of_the_program_is_not_taken_for_a_divergence(tmp_path, monkeypatch):
    def fail(callback):
        raise ValueError("of the program")

    monkeypatch.setattr(RolloutCallback, "_on_step", fail)
    with pytest.raises(ValueError, match="of the program"):
        train.main(small(tmp_path))


def test_an_evaluation_without_a_number_does_not_replace_the_best_agent(tmp_path, monkeypatch):
    scores = iter([0.5, float("nan"), 0.7])
    monkeypatch.setattr("agents.folder.held_out_rmse", lambda *_: next(scores))
    assert train.main(small(tmp_path, evaluate_every=128, steps=384)) == 0
    assert not same_parameters(tmp_path / "agent.zip", tmp_path / "last.zip")


def test_a_disk_that_is_full_is_one_line_and_the_training_goes_on_later(
    tmp_path, capsys, monkeypatch
):
    config = small(tmp_path / "torn", held_out=0)
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
    message = one_line(capsys)
    assert "cannot be written" in message and "No space left on device" in message
    assert train.main(replace(config, resume=True)) == 0
    assert "going on after 256 steps" in capsys.readouterr().out
    assert same_parameters(tmp_path / "torn" / "last.zip", tmp_path / "whole" / "last.zip")
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
    assert train.main(small(tmp_path / "none")) == 130
    assert "interrupted; no checkpoint yet" in one_line(capsys)
    assert not (tmp_path / "none").exists()


def test_an_interruption_later_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "evaluate", interrupt)
    assert train.main(small(tmp_path)) == 130
    assert one_line(capsys) == f"interrupted; go on with --resume --output {tmp_path}\n"


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
