"""`tracked-env export`: which agent is written, under which name, and what is refused."""

import sys
from pathlib import Path

import pytest

from baselines.registry import PRETRAINED
from tracked_env.cli.main import main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


@pytest.mark.parametrize(
    ("arguments", "file"),
    [
        (["ppo-blind"], "ppo-blind-seed0.onnx"),
        (["any-vehicle"], "any-vehicle-seed0.onnx"),
        (["mpc-learned-observer@2"], "mpc-learned-observer-seed2.onnx"),
        (["ppo-reckoned@3", "--env", "Speed-v0", "--format", "onnx"], "ppo-reckoned-seed3.onnx"),
        ([str(PRETRAINED / "Torque-v0/ppo-blind-seed1"), "--file", "mine.onnx"], "mine.onnx"),
        ([str(PRETRAINED / "Torque-v0/ppo-blind-seed1/agent.zip")], "ppo-blind-seed1.onnx"),
    ],
)
def test_a_name_an_archive_or_the_folder_of_a_training_is_written(arguments, file, capsys):
    onnx = pytest.importorskip("onnx", reason="ONNX needs the extra `export`")
    assert main(["export", *arguments]) == 0
    assert [path.name for path in Path().iterdir()] == [file]
    metadata = {entry.key: entry.value for entry in onnx.load(file).metadata_props}
    assert metadata["drive"] == ("speed" if "Speed-v0" in arguments else "torque")
    shown = capsys.readouterr().out
    assert shown.startswith(f"{file}: 31 fields") and metadata["action"] in shown


@pytest.mark.parametrize(
    ("agent", "says"),
    [
        (
            "adaptive",
            "'adaptive' is no trained agent; must be one of any-vehicle, mpc-learned-observer, ",
        ),
        ("ppo-blind@9", "unknown seed of 'ppo-blind'"),
        ("runs/agent.zip", "agent runs/agent.zip: no such file"),
    ],
)
def test_what_is_no_trained_agent_is_one_line(agent, says, capsys):
    assert main(["export", agent]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"tracked-env export: {says}") and error.count("\n") == 1
    assert not list(Path().iterdir())


def test_without_the_library_the_message_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert main(["export", "ppo-blind"]) == 1
    assert "pip install 'tracked-env[export]'" in capsys.readouterr().err
