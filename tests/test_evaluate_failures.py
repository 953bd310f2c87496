"""The command where something is wrong: arguments, folders, policies, stored results."""

import sys
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


WRONG = """
import sys
import numpy as np

class Exits:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        sys.exit(0)

class Exiting:
    def __init__(self):
        sys.exit(0)

class Raises(Exits):
    def predict(self, *args, **kwargs):
        raise RuntimeError("lost\\nit")
"""


@pytest.mark.parametrize(
    ("attribute", "status", "message"),
    [
        ("Exits", 1, "set 'payload', step 0: it called sys.exit(0)"),
        ("Exiting", 2, "when it was made: it called sys.exit(0)"),
        ("Raises", 1, "set 'payload', step 0: RuntimeError: lost it ("),
    ],
)
def test_a_policy_that_raises_or_exits_is_a_failure_in_one_line_that_names_it(
    tmp_path, monkeypatch, capsys,
    attribute, status, message,
):  # fmt: skip
    (tmp_path / "wrong_policies.py").write_text(WRONG)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "wrong_policies", raising=False)
    config = evaluate_module.Config(
        output=tmp_path / "results", policies=("nominal", f"wrong_policies:{attribute}"),
        sets=("payload",), episodes=1, duration=0.5, figures=False,
    )  # fmt: skip
    assert evaluate_module.main(config) == status
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("evaluate.py")]
    assert f"policy 'wrong_policies:{attribute}', {message}" in line


def test_damaged_results_are_one_line_and_damaged_traces_are_left_out_with_a_notice(
    tmp_path, capsys
):
    config = evaluate_module.Config(
        output=tmp_path,
        policies=("nominal", "oracle"),
        sets=("payload",),
        episodes=2,
        duration=0.5,
    )
    assert evaluate_module.main(config) == 0
    (file,) = tmp_path.glob("*/episodes.jsonl")
    whole = file.read_text()
    capsys.readouterr()
    negative = whole.replace('"tracking_rmse": ', '"tracking_rmse": -')
    for text in ("[]\n", whole + "null\n", negative):
        file.write_text(text)
        assert evaluate_module.main(config) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith(f"evaluate.py: {file}")
        assert captured.err.count("\n") == 1
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


def test_results_that_cannot_be_written_at_the_end_are_one_line(tmp_path, capsys):
    config = evaluate_module.Config(
        output=tmp_path, policies=("nominal",), sets=("payload",), episodes=1, duration=0.5,
        figures=False,
    )  # fmt: skip
    assert evaluate_module.main(config) == 0
    (file,) = tmp_path.glob("*/results.json")
    file.unlink()
    file.mkdir()
    capsys.readouterr()
    assert evaluate_module.main(config) == 1
    lines = capsys.readouterr().err.splitlines()
    (line,) = [line for line in lines if line.startswith("evaluate.py: ")]
    assert "results.json" in line
    assert "Traceback" not in "".join(lines)
    assert list(file.parent.glob(".*.tmp")) == []
