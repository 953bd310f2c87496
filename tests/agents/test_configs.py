"""Settings: defaults that suit the algorithm, and values that are refused at once."""

import dataclasses
import inspect
from pathlib import Path

import pytest

from agents.algorithms import (
    ALGORITHMS,
    LIMITS,
    OffPolicySettings,
    PPOSettings,
    RecurrentPPOSettings,
    SACSettings,
    StudentSettings,
    TD3Settings,
    TQCSettings,
    make_model,
)
from agents.environments import make_environment
from agents.learners import StudentLearner
from agents.options import Options
from agents.run import configuration, resolve
from tests.agents.agent_cases import ON_POLICY, Config, small
from train import main

ALL = [*(made.settings for made in ALGORITHMS.values()), StudentSettings, Config]


@pytest.mark.parametrize(
    ("changes", "steps", "checkpoint"),
    [
        ({}, 2_000_000, 0),
        ({"augmentation": "teacher"}, 2_000_000, 0),
        ({"agent": "recurrent-ppo"}, 1_000_000, 0),
        ({"agent": "sac"}, 300_000, 20_000),
        ({"agent": "td3"}, 300_000, 20_000),
        ({"agent": "tqc"}, 300_000, 20_000),
        ({"augmentation": "student"}, 500_000, 20_000),
    ],
)
def test_steps_and_evaluations_suit_the_algorithm_and_are_recorded(changes, steps, checkpoint):
    config = Config(**changes)
    assert resolve(config).schedule == (steps, steps // 10, checkpoint)
    kept = configuration(config)
    assert (kept["steps"], kept["evaluate_every"]) == (steps, steps // 10)
    given = Config(**changes, steps=5, evaluate_every=3, checkpoint_every=2)
    assert resolve(given).schedule == (5, 3, 2)
    assert resolve(Config(**changes, steps=5)).schedule.evaluate_every == 1


@pytest.mark.parametrize("made", ALL)
def test_defaults_are_within_the_limits_and_every_number_has_some(made):
    made()
    free = {"seed", "duration"}  # elsewhere
    numbers = {
        field.name
        for field in dataclasses.fields(made)
        if isinstance(field.default, (int, float, tuple)) and not isinstance(field.default, bool)
    }
    assert numbers - free <= LIMITS.keys()


@pytest.mark.parametrize(
    ("made", "changes", "message"),
    [
        (PPOSettings, {"batch_size": 0}, r"batch_size = 0; must be in \[2, 1e8\]"),
        (PPOSettings, {"learning_rate": 0.0}, r"learning_rate = 0\.0; must be in \(0, 1\]"),
        (PPOSettings, {"learning_rate": 1e30}, r"learning_rate = 1e\+30; must be in \(0, 1\]"),
        (PPOSettings, {"log_std_init": 1e30}, r"log_std_init = 1e\+30; must be in \[-20, 5\]"),
        (PPOSettings, {"ent_coef": float("inf")}, "ent_coef = inf"),
        (PPOSettings, {"clip_range": 1e9}, r"clip_range = 1000000000\.0; must be in"),
        (SACSettings, {"ent_coef": "auto_nan"}, "ent_coef = 'auto_nan'"),
        (TD3Settings, {"action_noise": 1e9}, "action_noise"),
        (Config, {"precision": float("nan")}, "precision = nan"),
        (Config, {"smoothness": -1.0}, r"smoothness = -1\.0"),
        (Config, {"residual_scale": float("nan")}, "residual_scale = nan"),
        (Config, {"lags": (0,)}, r"lags = \(0,\)"),
        (Config, {"teacher": Path("a.zip")}, "only a student has a teacher"),
        (PPOSettings, {"learning_rate": float("nan")}, "learning_rate = nan"),
        (PPOSettings, {"hidden": (64, 0)}, r"hidden = \(64, 0\); must be in \[1, 16384\]"),
        (RecurrentPPOSettings, {"lstm_hidden": 0}, "lstm_hidden = 0"),
        (SACSettings, {"n_steps": 0}, r"n_steps = 0; must be in \[1, 1000000\]"),
        (SACSettings, {"gamma": 1.0}, r"gamma = 1\.0; must be in \[0, 1\)"),
        (SACSettings, {"gamma": -0.1}, r"gamma = -0\.1"),
        (SACSettings, {"ent_coef": "many"}, "ent_coef = 'many'.* auto_ and a number"),
        (TD3Settings, {"tau": 0.0}, r"tau = 0\.0; must be in \(0, 1\]"),
        (StudentSettings, {"gradient_steps": 0}, "gradient_steps = 0"),
        (Config, {"vehicles": 0}, r"vehicles = 0; must be in \[1, 65536\]"),
        (Config, {"held_out": -3}, r"held_out = -3; must be in \[0, 65536\]"),
        (Config, {"steps": 0}, r"steps = 0; must be in \[1, 1e12\]"),
        (Config, {"evaluate_every": 0}, "evaluate_every = 0"),
        (Config, {"checkpoint_every": -1}, "checkpoint_every = -1"),
        (Config, {"threads": 0}, "threads = 0"),
    ],
)
def test_a_value_outside_its_limits_is_refused_with_name_value_and_range(made, changes, message):
    with pytest.raises(ValueError, match=message):
        made(**changes)


def test_what_stable_baselines_allows_is_allowed():
    for entropy in ("auto", "auto_0.1", "0.2", "0"):
        SACSettings(ent_coef=entropy)
    PPOSettings(ent_coef=0.0, gae_lambda=1.0, gamma=0.0, hidden=())
    OffPolicySettings(learning_starts=0, tau=1.0)


@pytest.mark.parametrize("algorithm", ["sac", "td3", "tqc"])
def test_a_buffer_holds_what_a_target_sums_of_all_vehicles(algorithm, tmp_path, capsys):
    settings = ALGORITHMS[algorithm].settings
    config = small(tmp_path / "none", agent=algorithm, **{algorithm: settings(buffer_size=15)})
    assert main(config) == 2
    message = "buffer_size = 15; must be at least 16: n_steps = 4 of 4 vehicles"
    assert message in capsys.readouterr().err
    assert not config.folder.exists()
    env = make_environment(resolve(config))
    make_model(algorithm, settings(buffer_size=16), env, 0)


def test_the_buffer_of_a_student_holds_what_it_drives_at_once(tmp_path):
    assert main(small(tmp_path, augmentation="teacher", steps=128)) == 0
    settings = StudentSettings(buffer_size=255)
    config = small(tmp_path / "student", augmentation="student", teacher=tmp_path / "agent.zip")
    config = dataclasses.replace(config, student=settings)
    with pytest.raises(ValueError, match="buffer_size = 255; must be at least 256"):
        StudentLearner(resolve(config))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"vehicles": 1, "ppo": PPOSettings(**{**ON_POLICY, "n_steps": 1})},
            "ppo: `n_steps * n_envs` must be greater than 1",
        ),
        (
            {"agent": "tqc", "tqc": TQCSettings(ent_coef="auto_0")},
            "tqc: The initial value of ent_coef must be greater than 0",
        ),
    ],
)
def test_what_stable_baselines_refuses_is_a_clear_error(changes, message, tmp_path, capsys):
    config = small(tmp_path / "none", **changes)
    assert main(config) == 2
    assert message in capsys.readouterr().err
    assert not config.folder.exists()


def test_more_samples_than_memory_holds_are_a_clear_error(tmp_path, capsys, monkeypatch):
    def allocate(*_):
        raise MemoryError("Unable to allocate 454. GiB")

    monkeypatch.setattr("agents.learners.make_model", allocate)
    assert main(small(tmp_path / "none")) == 2
    assert "454. GiB. Lower vehicles, n_steps" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("agent", "ppo"),
        ("agent", "sac"),
        ("normalise", True),
        ("precision", 0.1),
        ("precision", 0.075),
        ("smoothness", 0.0),
        ("staggered", False),
        ("tensorboard", True),
    ],
)
def test_an_option_that_a_student_does_not_read_is_refused_where_it_is_given(name, value):
    Config(augmentation="student", teacher=Path("a.zip"))
    Config(**{name: value})
    option = name.replace("_", "-")
    message = f"{option} = {value} with augmentation student; must be left"
    with pytest.raises(ValueError, match=message):
        Config(augmentation="student", teacher=Path("a.zip"), **{name: value})


def test_defaults_that_are_found_later_are_those_of_the_help():
    resolved = resolve(Config())
    text = inspect.getsource(Options)
    assert (resolved.name, resolved.reward.precision) == ("ppo", 0.075)
    for default in ("by default ppo", "leaves it out. Default: 0.075"):
        assert default in text
