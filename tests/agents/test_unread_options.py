"""Options that a training would not read are refused in one line, where they are given."""

from pathlib import Path

import pytest

import train
from agents.algorithms import PPOSettings, SACSettings, StudentSettings
from agents.run import resolve
from tests.agents.agent_cases import Config

REFUSED = [
    (
        ("--sac.gamma", "0.9"),
        "--sac.gamma has no effect: it is a setting of sac, and what learns is ppo. Give "
        "--agent sac, or leave it out",
    ),
    (("--sac.learning-rate", "1e-3"), "--sac.learning-rate has no effect"),  # the default value
    (("--sac.learning_rate=1e-3",), "--sac.learning-rate has no effect"),
    (("--agent", "tqc", "--ppo.gamma", "0.9"), "what learns is tqc. Give --agent ppo"),
    (("--agent", "ppo", "--recurrent-ppo.lstm-hidden", "8"), "setting of recurrent-ppo"),
    (("--student.n-steps", "64"), "setting of student, .*Give --augmentation student"),
    (
        ("--augmentation", "student", "--teacher", "a.zip", "--ppo.gamma", "0.985"),
        "what learns is a student, which has the network of its teacher",
    ),
    (
        ("--lags", "1", "2"),
        "--lags has no effect with augmentation blind: it is an option of augmentation history "
        "and student. Give --augmentation history",
    ),
    (("--lags", "1", "2", "4", "8", "16", "32"), "--lags has no effect"),  # the default value
    (("--augmentation", "estimates", "--lags", "1"), "--lags has no effect"),
    (("--residual-scale", "0.3"), "has no effect with augmentation blind: .* residual. Give"),
    (("--trust",), "--trust has no effect with augmentation blind"),
    (("--base", "adaptive"), "--base has no effect with augmentation blind: .* residual. Give"),
    (
        ("--augmentation", "teacher", "--data-sheet"),
        "--data-sheet has no effect with augmentation teacher: it is an option of augmentation",
    ),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=lambda given: str(given[0]))
def test_an_option_without_effect_is_refused_in_one_line(arguments, message, tmp_path, capsys):
    output = tmp_path / "none"
    assert train.command([*arguments, "--steps", "64", "--output", str(output)]) == 2
    shown = capsys.readouterr()
    (line,) = shown.err.splitlines()
    assert line.startswith("train.py: --")
    with pytest.raises(ValueError, match=message):
        raise ValueError(line)
    assert not output.exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sac": SACSettings(gamma=0.9)}, r"--sac\.gamma has no effect"),
        ({"agent": "td3", "ppo": PPOSettings(n_steps=7)}, r"--ppo\.n-steps has no effect"),
        ({"student": StudentSettings(hidden=(7,))}, r"--student\.hidden has no effect"),
        ({"residual_scale": 0.2}, "--residual-scale has no effect"),
        ({"lags": (1, 2)}, "--lags has no effect"),
    ],
)
def test_an_option_without_effect_is_refused_in_python_too(changes, message):
    with pytest.raises(ValueError, match=message):
        resolve(Config(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"agent": "sac", "sac": SACSettings(gamma=0.9)},
        {"augmentation": "history", "lags": (1, 2)},
        {"augmentation": "residual", "residual_scale": 0.2},
        {"augmentation": "student", "teacher": Path("a.zip"), "lags": (1, 2), "trust": True},
        {"augmentation": "student", "student": StudentSettings(n_steps=7)},
        {"sac": SACSettings(), "lags": None},
    ],
)
def test_an_option_that_is_read_is_taken_and_defaults_are_silent(changes):
    recorded = resolve(Config(**changes)).recipe["config"]
    assert recorded["lags"] == list(changes.get("lags") or (1, 2, 4, 8, 16, 32))
    assert recorded["residual_scale"] == changes.get("residual_scale", 0.3)


@pytest.mark.parametrize("word", ["--memory=history", "--memory"])
def test_the_former_name_of_an_option_gets_a_hint_of_one_line(word, tmp_path, capsys):
    values = [] if "=" in word else ["history"]
    assert train.command([word, *values, "--output", str(tmp_path / "none")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "train.py: --memory is called --augmentation now, with the same values"
    assert not (tmp_path / "none").exists()
