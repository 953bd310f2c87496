"""The command where something is wrong: arguments, folders, policies, stored results."""

from pathlib import Path

import pytest

import evaluate as evaluate_module
from tracked_env import SPEED_ID


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"policies": ("uc",)}, "the environment takes its torque"),
        ({"policies": ("oracle",), "env": SPEED_ID}, "the environment takes its speed"),
        ({"sets": ("friction", "payload")}, "must be of one environment"),
        ({"sensors": "gps"}, "unknown sensor preset 'gps'"),
        ({"sets": ("mud",)}, "unknown evaluation set 'mud'"),
        ({"policies": ("agent.zip",)}, "no such file"),
        ({"reference": '{"kind": '}, "not a JSON object"),
        ({"env": "CartPole-v1"}, "unknown environment 'CartPole-v1'"),
        ({"policies": ("json:dumps",)}, "policy 'json:dumps', when it was made: TypeError"),
        ({"policies": ("sys:exit",)}, "policy 'sys:exit', when it was made: it called sys.exit"),
        ({"policies": ("a\nb=nominal",)}, "that can be printed"),
    ],
)
def test_a_wrong_argument_is_one_line_and_starts_nothing(tmp_path, capsys, arguments, message):
    output = tmp_path / "results"
    assert evaluate_module.main(evaluate_module.Config(output=output, **arguments)) == 2
    text = capsys.readouterr().err
    assert message in text
    assert text.count("\n") == 1
    assert not output.exists()


@pytest.mark.parametrize("paper", ["none", "strawa2021"])
@pytest.mark.parametrize("kind", ["file", "proc", "too long"])
def test_an_output_that_cannot_be_written_is_one_line_before_anything_runs(
    tmp_path, capsys, kind, paper
):
    (tmp_path / "file").write_text("mine")
    places = {"proc": Path("/proc/nothing"), "too long": tmp_path / ("x" * 999)}
    output = places.get(kind, tmp_path / "file")
    config = evaluate_module.Config(output=output, policies=("nominal",), duration=1.0, paper=paper)
    assert evaluate_module.main(config) in (1, 2)
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("evaluate.py: ")
    assert captured.out == ""
    assert (tmp_path / "file").read_text() == "mine"


@pytest.fixture
def config(tmp_path):
    """A tiny comparison that has been run once."""
    config = evaluate_module.Config(
        output=tmp_path, policies=("nominal", "oracle"), sets=("payload",), episodes=2, duration=0.5
    )
    assert evaluate_module.main(config) == 0
    return config


def test_damaged_results_are_one_line_and_damaged_traces_are_left_out_with_a_notice(config, capsys):
    (file,) = config.output.glob("*/episodes.jsonl")
    whole = file.read_text()
    capsys.readouterr()
    file.write_text("[]\n")
    assert evaluate_module.main(config) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"evaluate.py: {file}") and captured.err.count("\n") == 1
    file.write_text(whole.replace('"digest": "', '"digest": "x', 1))
    assert evaluate_module.main(config) == 1
    assert "did not meet the same episodes" in capsys.readouterr().err
    file.write_text(whole)
    for trace in file.parent.glob("traces/*oracle.npz"):
        trace.write_bytes(b"mine")
    assert evaluate_module.main(config) == 0
    assert "oracle.npz is damaged and left out of the figures" in capsys.readouterr().out
    for trace in file.parent.glob("traces/*.npz"):
        trace.unlink()
    assert evaluate_module.main(config) == 0


def test_results_that_cannot_be_written_at_the_end_are_one_line(config, capsys):
    (file,) = config.output.glob("*/results.json")
    file.unlink()
    file.mkdir()
    capsys.readouterr()
    assert evaluate_module.main(config) == 1
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("evaluate.py: ")]
    assert "results.json" in line
    assert "Traceback" not in "".join(lines)
    assert list(file.parent.glob(".*.tmp")) == []
