"""The first look of `evaluate`: what it compares, and how its kernels are compiled."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from baselines.estimators import soil_estimator, turning
from baselines.linearizing.adaptive_policy import AdaptivePolicy
from baselines.predictive import predictive_control
from baselines.predictive.predictive_control import PredictivePolicy
from tests.benchmark.stub_policies import Constant, entry
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env import observation as layout
from tracked_env.benchmark import SETS, BenchmarkConfig, default_sets
from tracked_env.benchmark.evaluation_sets import group_of, version_of
from tracked_env.benchmark.policies import default_names, registered_policies
from tracked_env.cli import compile_command
from tracked_env.cli.command_line import Parser
from tracked_env.cli.evaluate_options import (
    FIRST_LOOKS,
    Config,
    add_episode_options,
    benchmark_config,
    episode_config,
    first_policies,
    parsed,
)
from tracked_env.cli.main import main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

IDS = (TORQUE_ID, SPEED_ID, TERRAIN_ID)


@pytest.mark.parametrize("env", IDS)
def test_where_nothing_is_named_a_set_of_each_group_has_few_episodes(env):
    benchmark = benchmark_config(parsed(["--env", env], "test"))
    version = version_of(env)
    assert [group_of(name, version) for name in benchmark.sets] == list(version.groups)
    assert benchmark.episodes == 16
    known = default_names(registered_policies(), env)
    chosen = first_policies(env, known)
    assert chosen == FIRST_LOOKS[env].policies
    trained = [name for name in chosen if "@" in name]
    assert len(trained) == 2 and len(chosen) - len(trained) == 4


@pytest.mark.parametrize("env", IDS)
@pytest.mark.parametrize("named", ["--all", "--policies=adaptive", "--sets-version=v4"])
def test_all_sets_have_all_their_episodes_as_soon_as_something_is_named(env, named):
    config = parsed(["--env", env, *named.split("=")], "test")
    benchmark = benchmark_config(config)
    assert benchmark.sets == default_sets(env)
    assert benchmark.episodes == 32
    assert not config.is_first_look


@pytest.mark.parametrize("env", IDS)
def test_one_episode_is_of_a_plain_set_where_none_is_named(env):
    parser = Parser("render", "")
    add_episode_options(parser)
    (name,) = episode_config(parser.parse_args(["--env", env])).sets
    assert name == {TORQUE_ID: "payload", SPEED_ID: "friction", TERRAIN_ID: "slope"}[env]
    assert SETS[name].env == env and SETS[name].sensors in ("rtk", "mocap")


def test_a_number_of_episodes_that_is_given_holds_for_the_first_look_too():
    assert Config(episodes=3).is_first_look
    assert benchmark_config(Config(episodes=3)).episodes == 3
    assert benchmark_config(Config(sets=("payload",), episodes=3)).episodes == 3


def test_policies_that_are_not_registered_are_left_out_of_the_first_look():
    assert first_policies(TORQUE_ID, ("mine", "adaptive", "oracle")) == ("adaptive", "oracle")
    assert first_policies(TORQUE_ID, ("mine", "oracle")) == ("mine", "oracle")


def test_the_command_alone_compares_its_policies_and_ends_with_the_page(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "240")  # else tables are folded
    assert main(["evaluate", "--episodes", "1", "--duration", "0.5", "--no-figures"]) == 0
    (page,) = Path("results").glob("*/leaderboard.html")
    records = json.loads((page.parent / "results.json").read_text())["episodes"]
    look = FIRST_LOOKS[TORQUE_ID]
    assert {record["policy"] for record in records} == set(look.policies)
    assert {record["set"] for record in records} == set(look.sets)
    shown = capsys.readouterr().out.rstrip().splitlines()
    assert "a first look" in shown[1] and "--all" in shown[1]
    assert shown[-1].endswith(f"the page: {page}")
    assert "Leaderboard" in shown and len(shown) < 60  # all other tables are in the files


@pytest.mark.parametrize(("seconds", "said"), [(0.4, True), (0.0, False)])
def test_a_line_says_that_kernels_are_compiled_where_they_are(seconds, said, monkeypatch, capsys):
    asked = []

    class Pool:
        def __init__(self, workers):
            assert workers == 1

        def results(self, function, shared, jobs):
            yield asked.append((function, shared))

    monkeypatch.setattr(compile_command, "WorkerPool", Pool)
    monkeypatch.setattr(compile_command, "PATIENCE", 0.2)
    monkeypatch.setattr(compile_command, "run_task", lambda *task: time.sleep(seconds))
    monkeypatch.setattr(compile_command, "policies_for", lambda env, names: [constant])
    constant = entry("constant", lambda context: Constant())
    compile_command.compile_kernels([(BenchmarkConfig(sets=("payload",)), ("constant",))])
    assert ("compiling kernels, once" in capsys.readouterr().err) == said
    assert bool(asked) == said  # a second process, where there is something to compile
    time.sleep(0.3)
    assert bool(asked) == said


def test_the_bar_of_compiling_names_the_environment_of_what_is_compiled_now(monkeypatch):
    said, ahead = list[tuple[int, str]](), AdaptivePolicy
    piece = compile_command.Piece(
        BenchmarkConfig(sets=("payload", "ood")), entry("a", lambda context: ahead())
    )
    monkeypatch.setattr(compile_command, "run_task", lambda *task: task[-1](8, "payload: a"))
    piece.compile(lambda *call: said.append(call))
    monkeypatch.setattr(ahead, "compile_kernels", lambda policy: said.append((-1, "compiles")))
    piece._replace(ahead=True).compile(lambda *call: said.append(call))
    label = "Torque-v0: a"
    assert said == [(0, label), (8, label), (8, label), (0, label), (-1, "compiles")]


def test_this_process_begins_with_the_first_piece_and_others_with_the_last(monkeypatch):
    driven, helped = list[str](), list[int | None]()
    entries = [entry(name, lambda context: Constant()) for name in "ab"]

    class Pool:
        def __init__(self, workers):
            assert workers == 2

        def results(self, function, shared, jobs):
            helped.extend(jobs[number] for number in range(len(jobs)))
            yield 0, None

    monkeypatch.setattr(compile_command, "policies_for", lambda env, names: entries)
    monkeypatch.setattr(compile_command, "WorkerPool", Pool)
    monkeypatch.setattr(compile_command, "PATIENCE", 0.2)

    def drive(policy, task, *more):
        driven.append(f"{policy.name} on {task.uncertainty_set}")
        time.sleep(0.3)  # until others have taken the rest

    monkeypatch.setattr(compile_command, "run_task", drive)
    compile_command.compile_kernels([(BenchmarkConfig(sets=("payload", "ood")), ("a", "b"))], 3)
    assert driven == ["a on payload", "a on ood"]
    assert helped == [3, 2, 1]  # two that are compiled ahead, then the episodes


def test_compile_says_how_many_kernels_it_compiled_and_the_second_time_none(capsys):
    for _ in range(2):  # the first finds what other tests have compiled
        assert main(["compile", "nominal", "--workers", "1"]) == 0
    count, *words = capsys.readouterr().out.splitlines()[-1].split()
    assert (count, words[:2]) == ("0", ["kernels", "compiled"])


@pytest.mark.parametrize("kind", [AdaptivePolicy, PredictivePolicy])
def test_what_is_compiled_ahead_is_what_driving_calls(kind):
    kernels = [soil_estimator.update_all, turning.update_all]
    if kind is PredictivePolicy:
        kernels.append(predictive_control.plan_all)
    ahead, fresh = kind(), kind()
    ahead.compile_kernels()
    compiled = [set(kernel.signatures) for kernel in kernels]
    assert all(compiled)
    seen = np.random.default_rng(0).normal(0.0, 0.1, (3, layout.SIZE)).astype(np.float32)
    action, expected = ahead.predict(seen)[0], fresh.predict(seen)[0]
    assert [set(kernel.signatures) for kernel in kernels] == compiled
    np.testing.assert_array_equal(action, expected)  # and nothing of it is remembered
