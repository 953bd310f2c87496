"""train.py from the command line: a folder with an agent, killed and resumed, in the benchmark."""

import dataclasses
import inspect
import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from agents.algorithms import (
    ALGORITHMS,
    LIMITS,
    OffPolicySettings,
    PPOSettings,
    RecurrentPPOSettings,
    SACSettings,
    TD3Settings,
    make_model,
)
from agents.environments import make_environment
from agents.options import Options
from agents.run import configuration, resolve
from baselines.learned.augmentation import LAGS
from tests.agents.agent_cases import Config, one_line, same_arrays, small
from tests.processes import python
from train import command, main

SHORT = [
    "--quiet", "--vehicles", "8", "--held-out", "2", "--duration", "2", "--uncertainty", "payload",
    "drift", "--evaluate-every", "1024",
]  # fmt: skip
BUDGET = [*SHORT, "--ppo.n-steps", "64", "--ppo.batch-size", "256"]


def train(*arguments):
    """Run train.py with a tiny budget."""
    return python("train.py", *BUDGET, *arguments)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder of a trained agent."""
    folder = tmp_path_factory.mktemp("blind")
    result = train("--steps", "4096", "--output", folder, "--seed", "3")
    assert "steps/s with the learner" in result.stdout
    return folder


@pytest.mark.slow
def test_the_agent_comes_with_its_configuration_and_learning_curve(trained):
    recipe = json.loads((trained / "config.json").read_text())
    assert recipe["environment"]["uncertainty"] == ["payload", "drift"]
    assert recipe["config"]["vehicles"] == 8 and recipe["config"]["ppo"]["n_steps"] == 64
    assert "torch" in recipe["versions"]
    curve = np.genfromtxt(trained / "curve.csv", delimiter=",", names=True)
    evaluated = ~np.isnan(curve["held_out_rmse"])
    assert curve["steps"][evaluated].tolist() == [1024, 2048, 3072, 4096]
    assert {path.name for path in trained.iterdir()} == {
        "agent.zip",
        "last.zip",
        "config.json",
        "curve.csv",
    }


@pytest.mark.slow
def test_a_killed_training_goes_on_to_the_same_agent(trained, repository, tmp_path):
    arguments = ("--steps", "4096", "--output", str(tmp_path), "--seed", "3")
    command = [sys.executable, "train.py", *BUDGET, *arguments]
    process = subprocess.Popen(command, cwd=repository, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while not (tmp_path / "checkpoint-before.zip").exists() and time.monotonic() < until:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "it ended before it could be killed"
    result = train(*arguments, "--resume")
    assert "going on after" in result.stdout
    assert same_arrays(trained / "last.zip", tmp_path / "last.zip")


@pytest.mark.slow
def test_evaluate_accepts_the_archive(trained, tmp_path):
    few = ("--no-figures", "--episodes", "2", "--duration", "2", "--sets", "payload")
    result = python(
        "evaluate.py", *few, "--output", tmp_path, "--policies", "nominal", trained / "agent.zip"
    )
    assert trained.name in result.stdout


def test_the_help_lists_what_there_is(capsys):
    with pytest.raises(SystemExit, match=r"^0$"):
        command(["--help"])
    text = capsys.readouterr().out
    for name in (
        "recurrent-ppo", "residual", "--uncertainty", "--sensors", "--resume", "--tensorboard",
        "--normalise", "--sac.gradient-steps", "--tqc.tau", "horizon of one second",
        "--overwrite", "--env-args", "1 000 000 for recurrent PPO", "a tenth of all",
    ):  # fmt: skip
        assert name in " ".join(text.split())
    assert "{None" not in text and "INTEGER" in text
    assert not re.search(r"\b(INT|FLOAT|STR)\b", text)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--uncertainty", "nope"), "soil-and-mass"),
        (("--sensors", "rtk", '{"preset": "rtk",'), "not a JSON object"),
        (("--sensors", "rtk", "nope"), "ideal"),
        (("--sensors", "mixture"), "2 vehicles or held-out episodes for 6 kinds of sensors"),
        (("--sensors", '{"pose_delay": -1}'), "pose_delay"),
        (("--augmentation", "residual", "--residual-scale", "0"), "must be in"),
        (("--augmentation", "residual", "--base", "nobody"), "base = 'nobody'; must be a regist"),
        (
            ("--augmentation", "residual", "--base", "adaptive", "--env", "tracked_env/Speed-v0"),
            "base = 'adaptive' on a vehicle driven by its sprocket speeds; must be left out",
        ),
        (("--env", "tracked_env/Nothing-v0"), "Nothing"),
        (("--env", "CartPole-v1"), "--env CartPole-v1 is not an environment of tracked vehicles"),
        (("--env", "nothing_at_all:Torque-v0"), "--env nothing_at_all:Torque-v0: "),
        (("--env-args", '{"plant": "lumpy"}'), "lumped"),
        (("--vehicles", "1", "--ppo.n-steps", "1"), "ppo: `n_steps * n_envs` must be greater than"),
        (
            ("--agent", "tqc", "--tqc.ent-coef", "auto_0"),
            "tqc: The initial value of ent_coef must be",
        ),
        *(
            (
                ("--agent", name, f"--{name}.buffer-size", "31"),
                "buffer_size = 31; must be at least 32: n_steps = 4 of 8 vehicles",
            )
            for name in ("sac", "td3", "tqc")
        ),
        (("--steps", "0"), "steps = 0; must be in [1, 1e12]"),
        (("--vehicles", "0"), "vehicles = 0; must be in [1, 65536]"),
        (("--held-out", "-3"), "held_out = -3; must be in [0, 65536]"),
        (("--ppo.batch-size", "0"), "batch_size = 0; must be in [2, 1e8]"),
        (("--ppo.learning-rate", "1e30"), "learning_rate = 1e+30; must be in (0, 1]"),
        (("--sac.gamma", "0.9"), "train.py: --sac options have no effect"),
        (("--output", ""), "--output: is empty"),
        (("--sac.n-steps", "0"), "n_steps = 0; must be in [1, 1000000]"),
    ],
)
def test_wrong_settings_are_clear_errors_and_leave_nothing(arguments, message, tmp_path, capsys):
    output = tmp_path / "none"
    assert command([*SHORT, "--output", str(output), *arguments]) == 2
    assert message in one_line(capsys) and not output.exists()


# Settings: defaults that suit the algorithm, and values that are refused at once

ALL = [*(one.settings for one in ALGORITHMS.values()), Config]


@pytest.mark.parametrize(
    ("changes", "steps", "checkpoint"),
    [
        ({}, 2_000_000, 0),
        ({"agent": "recurrent-ppo"}, 1_000_000, 0),
        ({"agent": "sac"}, 300_000, 20_000),
        ({"agent": "td3"}, 300_000, 20_000),
        ({"agent": "tqc"}, 300_000, 20_000),
    ],
)
def test_steps_and_evaluations_suit_the_algorithm_and_are_recorded(changes, steps, checkpoint):
    options = resolve(Config(**changes)).options
    assert (options.steps, options.checkpoint_every) == (steps, checkpoint)
    assert options.evaluate_every == steps // 10
    recorded = configuration(options)
    assert (recorded["steps"], recorded["evaluate_every"]) == (steps, steps // 10)
    chosen = {"steps": 5, "evaluate_every": 3, "checkpoint_every": 2}
    options = resolve(Config(**changes, **chosen)).options
    assert {name: getattr(options, name) for name in chosen} == chosen
    assert resolve(Config(**changes, steps=5)).options.evaluate_every == 1


@pytest.mark.parametrize("kind", ALL)
def test_defaults_are_within_the_limits_and_every_number_has_some(kind):
    kind()
    free = {"seed", "duration"}  # elsewhere
    numbers = {
        field.name
        for field in dataclasses.fields(kind)
        if isinstance(field.default, (int, float, tuple)) and not isinstance(field.default, bool)
    }
    assert numbers - free <= LIMITS.keys()


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        (PPOSettings, {"batch_size": 0}, r"batch_size = 0; must be in \[2, 1e8\]"),
        (PPOSettings, {"learning_rate": 1e30}, r"learning_rate = 1e\+30; must be in \(0, 1\]"),
        (PPOSettings, {"ent_coef": float("inf")}, "ent_coef = inf"),
        (SACSettings, {"ent_coef": "auto_nan"}, "ent_coef = 'auto_nan'"),
        (Config, {"precision": float("nan")}, "precision = nan"),
        (Config, {"smoothness": -1.0}, r"smoothness = -1\.0"),
        (Config, {"lags": (0,)}, r"lags = \(0,\)"),
        (PPOSettings, {"learning_rate": float("nan")}, "learning_rate = nan"),
        (PPOSettings, {"hidden": (64, 0)}, r"hidden = \(64, 0\); must be in \[1, 16384\]"),
        (SACSettings, {"gamma": 1.0}, r"gamma = 1\.0; must be in \[0, 1\)"),
        (SACSettings, {"ent_coef": "many"}, "ent_coef = 'many'.* auto_ and a number"),
        (TD3Settings, {"tau": 0.0}, r"tau = 0\.0; must be in \(0, 1\]"),
        (SACSettings, {"gradient_steps": 0}, "gradient_steps = 0"),
        (Config, {"checkpoint_every": -1}, "checkpoint_every = -1"),
    ],
)
def test_a_value_outside_its_limits_is_refused_with_name_value_and_range(kind, changes, message):
    with pytest.raises(ValueError, match=message):
        kind(**changes)


def test_what_stable_baselines_allows_is_allowed():
    for entropy in ("auto", "auto_0.1", "0.2", "0"):
        SACSettings(ent_coef=entropy)
    PPOSettings(ent_coef=0.0, gae_lambda=1.0, gamma=0.0, hidden=())
    OffPolicySettings(learning_starts=0, tau=1.0)


@pytest.mark.parametrize("algorithm", ["sac", "td3", "tqc"])
def test_a_buffer_of_what_a_target_sums_of_all_vehicles_is_enough(algorithm, tmp_path):
    settings = ALGORITHMS[algorithm].settings(buffer_size=16)
    env = make_environment(resolve(small(tmp_path, agent=algorithm)))
    make_model(algorithm, settings, env, 0)


def test_more_samples_than_memory_holds_are_a_clear_error(tmp_path, capsys, monkeypatch):
    def allocate(*_):
        raise MemoryError("Unable to allocate 454. GiB")

    monkeypatch.setattr("agents.learners.make_model", allocate)
    assert main(small(tmp_path / "none")) == 2
    assert "454. GiB. Lower vehicles, n_steps" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sac": SACSettings(gamma=0.9)}, "--sac options .*: what learns is ppo. Give --agent sac"),
        ({"agent": "td3", "ppo": PPOSettings(n_steps=7)}, "--ppo options .* learns is td3"),
        ({"recurrent_ppo": RecurrentPPOSettings(lstm_hidden=8)}, "--recurrent-ppo options"),
        ({"lags": (1, 2)}, "--lags .* augmentation blind: it is .* history. Give"),
        ({"lags": LAGS}, "--lags has no effect"),  # the default value
        ({"augmentation": "estimates", "lags": (1,)}, "--lags has no effect"),
        ({"residual_scale": 0.3}, "with augmentation blind: .* residual. Give"),
        ({"base": "adaptive"}, "--base has no effect with augmentation blind: .* residual. Give"),
    ],
)
def test_an_option_without_effect_is_refused_in_one_line(changes, message):
    with pytest.raises(ValueError, match=message) as refused:
        resolve(Config(**changes))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"agent": "sac", "sac": SACSettings(gamma=0.9)},
        {"augmentation": "history", "lags": (1, 2)},
        {"augmentation": "residual", "residual_scale": 0.2},
        {"sac": SACSettings(), "lags": None},
    ],
)
def test_an_option_that_is_read_is_taken_and_defaults_are_silent(changes):
    recorded = resolve(Config(**changes)).recipe["config"]
    assert recorded["lags"] == list(changes.get("lags") or LAGS)
    assert recorded["residual_scale"] == changes.get("residual_scale", 0.3)


def test_defaults_that_are_found_later_are_those_of_the_help():
    options, text = resolve(Config()).options, inspect.getsource(Options)
    assert (options.algorithm, options.precision) == ("ppo", 0.075)
    for default in ("by default ppo", "leaves it out. Default: 0.075"):
        assert default in text
