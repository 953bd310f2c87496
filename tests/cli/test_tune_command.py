"""`tracked-env tune`: what it drives, keeps, goes on from and refuses."""

import csv
import math

import numpy as np
import pytest

from baselines.registry import POLICIES, policies
from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, PolicyEntry, Store, run
from tracked_env.benchmark.evaluation_sets import AUDIT, DEVELOPMENT
from tracked_env.benchmark.statistics import interquartile_mean
from tracked_env.benchmark.tuning import Search
from tracked_env.cli.main import main
from tracked_env.cli.policy_commands import registered

TINY = ("--sets", "soil-and-mass", "payload", "--episodes", "4", "--budget", "4", "--duration", "1")


def rows_of(folder):
    (file,) = folder.glob("*.csv")
    with file.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines))


def test_tune_writes_what_it_drove_and_a_page_and_goes_on_where_it_was_interrupted(
    tmp_path, capsys
):
    command = ["tune", "adaptive", *TINY, "--audit", "--output", str(tmp_path)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    rows = rows_of(tmp_path)
    assert {row["seed"] for row in rows} == {str(DEVELOPMENT), str(AUDIT)}
    (page,) = tmp_path.glob("*.md")
    text = page.read_text(encoding="utf-8")
    assert "## `adaptive` on tracked_env/Torque-v0" in text and "audit split" in text
    assert "k_p" in printed and "x 0.5" in printed

    (file,) = tmp_path.glob("*.csv")
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    file.write_text("".join(lines[:3]) + lines[3][:40], encoding="utf-8")  # cut in the third row
    assert main(command) == 0
    again = capsys.readouterr().out
    assert again.startswith("going on with 2 settings")
    assert page.read_text(encoding="utf-8") == text
    assert printed in again


def test_the_numbers_of_a_search_are_those_of_the_benchmark(tmp_path):
    sets = ("soil-and-mass",)
    search = Search(registered("adaptive", TORQUE_ID), sets, 4, tmp_path, 1.0)
    candidate = search.evaluate("default", search.default)
    config = BenchmarkConfig(sets, 4, DEVELOPMENT, duration=1.0)
    entry = PolicyEntry("adaptive", POLICIES["adaptive"], "here")
    records = run(config, [entry], Store(tmp_path / "store", config.identity()))
    for field, key in (("rmse", "tracking_rmse"), ("settled", "settled_rmse")):
        expected = interquartile_mean(np.array([record[key] for record in records]))
        assert getattr(candidate.outcomes["soil-and-mass"], field) == expected


def test_settings_that_the_controller_refuses_are_kept_as_refused(tmp_path):
    search = Search(registered("adaptive", TORQUE_ID), ("payload",), 4, tmp_path, 1.0)
    wild = {**search.default, "k_p": 400.0, "k_v": 30.0, "k_a": 6.0}
    assert search.evaluate("search", wild) is None
    assert rows_of(tmp_path)[0]["cost"] == "refused"
    again = Search(registered("adaptive", TORQUE_ID), ("payload",), 4, tmp_path, 1.0)
    assert (DEVELOPMENT, *wild.values()) in again.candidates
    assert again.evaluate("search", wild) is None


@pytest.mark.parametrize(
    "env", [TORQUE_ID, SPEED_ID, pytest.param(TERRAIN_ID, marks=pytest.mark.slow)]
)
def test_every_controller_of_an_environment_can_be_tuned_and_its_defaults_lie_in_range(
    env, tmp_path
):
    key = {TORQUE_ID: "torque", SPEED_ID: "speed"}.get(env, env)
    sets = {TORQUE_ID: "payload", SPEED_ID: "friction", TERRAIN_ID: "slope"}
    names = [name for name in policies()[key] if name in POLICIES]
    assert names
    for name in names:
        search = Search(registered(name, env), (sets[env],), 4, tmp_path)
        for setting, (low, high, _) in search.policy.ranges.items():
            value = search.default[setting]
            assert low <= value <= high or math.isinf(value), (name, setting)
