"""The command `tracked-env timing`: time and memory of the calls of a policy for one vehicle."""

import gc
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest

from tests.benchmark.stub_policies import Truthful
from tracked_env.benchmark import leaderboard, policy_interface
from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.executors import sent
from tracked_env.benchmark.policies import policies_for
from tracked_env.cli import policy_commands as timing
from tracked_env.cli.main import main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

CONFIG = BenchmarkConfig(sets=("soil-and-mass",), duration=0.1)  # five steps
PAGE = "before\n<!-- timing table: begin -->\nold\n<!-- timing table: end -->\nafter\n"


class Plain:
    """Neither keeps anything nor needs much."""

    def __init__(self, context):
        self.arrays = []

    def predict(self, observation, *arguments, **named):
        return np.zeros((1, 2), dtype=np.float32), None


class Sleeping(Plain):
    """Its observer sleeps 5 ms, and it 7 ms beside that."""

    @property
    def observer(self):
        return self

    def update(self, observation):
        time.sleep(0.005)

    def predict(self, observation, *arguments, **named):
        self.update(observation)
        time.sleep(0.007)
        return super().predict(observation)


class Keeping(Plain):
    """Keeps an array of 1000 bytes per call."""

    def predict(self, observation, *arguments, **named):
        self.arrays.append(np.zeros(125))
        return super().predict(observation)


class Working(Plain):
    """Holds 100 000 bytes during a call."""

    def predict(self, observation, *arguments, **named):
        np.zeros(12_500).sum()
        return super().predict(observation)


@pytest.fixture
def few(monkeypatch):
    """Few calls beside those that are timed; the garbage collector as it was."""
    monkeypatch.setattr(timing, "RECORDED", 20)
    yield
    gc.collect()


def measured(policy):
    entry = policy_interface.PolicyEntry(policy.__name__, policy, "1")
    return timing.measure((sent(CONFIG, [entry]), 20, False), entry.name)


def test_percentiles_are_durations_that_occurred_and_misses_are_beyond_the_period():
    timed = timing.Timed(int)
    durations = np.arange(1, 1001) * 20_000  # [ns] 20 us to 20 ms
    durations[-2:] = 20_000_001, 60_000_000
    timed.durations = [7_000_000, 10**9, *np.random.default_rng(0).permutation(durations).tolist()]
    expected = 0.007, 500 * 2e-5, 990 * 2e-5, 0.020000001, 0.06, 2, 500
    assert timed.times(1000) == pytest.approx(expected, rel=1e-12)


@pytest.mark.usefixtures("few")
def test_the_times_are_those_of_the_policy_and_of_its_observer(monkeypatch):
    monkeypatch.setattr(timing, "WARM", 2)
    one = measured(Sleeping)
    assert one.observer is not None and not one.compiled
    assert 0.012 < one.predict.median < 0.05 and one.predict.first > 0.012
    assert one.predict.median <= one.predict.p99 <= one.predict.p99_9 <= one.predict.worst
    assert one.predict.misses_100_hz == 20
    assert 0.005 < one.observer.median < one.predict.median - 0.006


@pytest.mark.usefixtures("few")
def test_memory_that_a_policy_keeps_and_that_it_needs_during_a_call_is_seen():
    plain, keeping, working = (measured(kind) for kind in (Plain, Keeping, Working))
    assert plain.observer is None
    assert 1000 < keeping.growth < 1400 and abs(plain.growth) < 10 and abs(working.growth) < 10
    assert 1e5 < working.peak < 1.1e5 and plain.peak < 5e3


def test_the_adaptive_policy_keeps_no_memory_and_its_observer_is_timed():
    (entry,) = policies_for("torque", ["adaptive"])
    config = BenchmarkConfig(sets=("payload",), duration=5.0)
    one = timing.measure((sent(config, [entry]), 200, False), "adaptive")
    assert abs(one.growth) < 20.0  # an array has at least 100
    assert one.observer is not None and 0.2 < one.observer.median / one.predict.median < 1.0


def test_an_episode_that_ends_is_followed_by_the_next_one_and_the_truth_is_told():
    policy = Truthful()
    env = CONFIG.environment("soil-and-mass", 1, truth=True)
    loop = timing.Loop(policy, env, seed=3)
    for _ in range(12):
        loop.step()
    env.close()
    assert [int(start[0]) for _, start in policy.calls] == [1, 0, 0, 0, 0] * 2 + [1, 0]
    assert [state for state, _ in policy.calls] == [None, *range(1, 12)]  # its own
    masses = [truth["mass"][0] for truth in policy.told]
    assert len(masses) == 12 and masses[0] == masses[4] != masses[5]


@pytest.mark.slow
def test_the_command_prints_a_table_and_writes_it_as_json_and_into_a_page(monkeypatch, capsys):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmark")
    Path("page.md").write_text(PAGE)
    spec = "stub=stub_policies:Constant"
    options = ["--set", "payload", "--calls", "30", "--json", "timing.json", "--page", "page.md"]
    assert main(["timing", spec, "nominal", *options]) == 0
    shown = capsys.readouterr().out
    assert "P99.9 [us]" in shown and "30 calls after the first 101" in shown
    document = json.loads(Path("timing.json").read_text())
    assert document["set"] == "payload" and document["calls"] == 30 and document["freeze"]
    stub, nominal = document["timings"]
    assert stub["policy"] == "stub" and stub["growth"] > 100  # it notes its calls
    assert abs(nominal["growth"]) < 20 and nominal["observer"] is None
    before, line, after = re.split(r"(?m)^(\| nominal \|.*)$", Path("page.md").read_text())
    assert "old" not in before and after.endswith("<!-- timing table: end -->\nafter\n")
    assert line.startswith("| nominal | predict |")

    times = leaderboard.read_call_times(Path())
    assert times["nominal"] == (nominal["predict"]["median"], nominal["predict"]["p99"])
    Path("timing.json").write_text('{"timings": [{"policy": "x"}]}')
    with pytest.raises(ValueError, match="not what `tracked-env timing --json` writes"):
        leaderboard.read_call_times(Path())
    Path("timing.json").unlink()
    assert leaderboard.read_call_times(Path()) == {}
