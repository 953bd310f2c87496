"""The script that tries to break the headline: what it varies, and what it says."""

import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from baselines.registry import POLICIES
from tests.benchmark.stub_policies import Constant
from tests.benchmark.test_leaderboard import script
from tests.benchmark.test_report import EASY, records
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.evaluation_sets import AUDIT


class Settings(NamedTuple):
    gain: float = 3.0
    off: float = 0.0
    bound: float = math.inf


def tuned(context: Any, **settings: float) -> Constant:
    return Constant(Settings(**settings).gain, 0.0)


tuned.TUNABLE = {"gain": (1.0, 9.0, True), "off": (0.0, 1.0, False), "bound": (0.1, 9.0, True)}  # type: ignore[attr-defined]
tuned.SETTINGS = lambda context: Settings()  # type: ignore[attr-defined]


@pytest.fixture
def breaking(repository: Path) -> Any:
    return script(repository, "break_headline")


def found(breaking: Any) -> list[Any]:
    registry = {"adaptive": tuned, "other": tuned, "plain": lambda context: Constant()}
    return breaking.variants(registry, ["adaptive", "other", "plain"], BenchmarkConfig())


def test_every_setting_that_can_be_scaled_is_scaled_alone_by_every_factor(breaking: Any) -> None:
    of = found(breaking)
    assert [(v.controller, v.setting, v.factor) for v in of] == [
        (name, "gain", factor) for name in ("adaptive", "other") for factor in breaking.FACTORS
    ]
    context = BenchmarkConfig().context("payload")
    assert [v.entry.make(context).action[0] for v in of[:4]] == pytest.approx(
        [3.0 * factor for factor in breaking.FACTORS]
    )
    assert len({v.entry.fingerprint for v in of[:4]}) == 4


def test_the_registered_controllers_can_be_scaled_and_settings_reach_them(breaking: Any) -> None:
    config = BenchmarkConfig()
    of = {(v.setting, v.factor): v for v in breaking.variants(POLICIES, ["adaptive"], config)}
    context = config.context("payload")
    usual = POLICIES["adaptive"](context).controller.gains
    doubled = of["k_p", 2.0].entry.make(context).controller.gains
    assert doubled == usual._replace(k_p=2.0 * usual.k_p)


def driven(breaking: Any, factor: float, settled: float = 1.0) -> tuple[Any, ...]:
    """Records of two sets in which `adaptive gain x2` has these errors over adaptive's."""
    errors: dict[str, Any] = dict.fromkeys([v.entry.name for v in found(breaking)], EASY)
    errors |= {"adaptive gain x2": factor * EASY, "adaptive": EASY, "other": 1.02 * EASY}
    errors |= {"ppo@0": 0.9 * EASY, "ppo@1": 1.1 * EASY, "other gain x0.5": 0.5 * EASY}
    given = [record for name in ("a", "b") for record in records(name, **errors)]
    for record in given:
        record["settled_rmse"] = 0.5 * record["tracking_rmse"] / factor * settled
        if record["policy"] != "adaptive gain x2":
            record["settled_rmse"] = 0.5 * record["tracking_rmse"]
    sets = breaking.of_sets(given)
    usual = breaking.ranking(sets, ["adaptive", "other", "ppo"], "adaptive")
    return (given, usual, *breaking.gain_table(sets, found(breaking), usual, "adaptive"))


def test_the_headline_breaks_where_one_gain_makes_the_reference_over_five_percent_better(
    breaking: Any,
) -> None:
    for factor, settled, count in (
        (0.96, 0.96, 0), (0.94, 1.0, 1), (1.0, 0.94, 1), (0.9, 0.9, 2), (1.5, 1.5, 0),
        (0.9, 1.1, 0), (1.1, 0.9, 0),
    ):  # fmt: skip
        *_, errors = driven(breaking, factor, settled)
        said = breaking.broken(errors, "adaptive")
        assert len(said) == count, (factor, settled)
        assert all(line.startswith("gain of adaptive times 2: ") for line in said)
    # Another controller may get better; that is no fault of the reference.
    assert "other" not in " ".join(breaking.broken(errors, "adaptive"))


def test_the_table_says_what_each_gain_does_to_error_rank_and_order(breaking: Any) -> None:
    _, usual, cells, _ = driven(breaking, 0.97)
    assert list(usual) == ["ppo", "adaptive", "other"] or usual["ppo"] == pytest.approx(1.0, 0.1)
    rows = {(row[0], row[1], row[2]): row for row in cells[1:]}
    assert rows["adaptive", "gain", "2"][3].startswith("0.970 [0.970, 0.970]")
    better = rows["other", "gain", "0.5"]
    assert better[3].startswith("0.490") and better[6:8] == ["0.500", "1"]
    assert float(better[8]) < 1.0


def test_other_trainings_and_fewer_episodes_are_orders_of_their_own(breaking: Any) -> None:
    given, usual, *_ = driven(breaking, 1.0)
    plain = [record for record in given if " x" not in record["policy"]]
    rows = {row[0]: row for row in breaking.other_choices(plain, usual, "adaptive")[1:]}
    assert list(rows) == [
        "as it is", "training 0 alone", "training 1 alone", "first 8 episodes",
        "first 4 episodes", "first 2 episodes",
    ]  # fmt: skip
    assert rows["as it is"][1] == "1.00"
    assert rows["training 0 alone"][2] == "ppo"
    assert rows["training 1 alone"][2:4] == ["adaptive", "1"]


def test_it_runs_on_the_audit_split_continues_and_says_whether_the_headline_stands(
    breaking: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(breaking, "FACTORS", (1.0,))
    given = ["break_headline", "--policies", "adaptive", "nominal", "--sets", "payload"]
    monkeypatch.setattr(sys, "argv", [*given, "--episodes", "2", "--output", str(tmp_path)])
    assert breaking.main() == 0
    (folder,) = tmp_path.iterdir()
    assert folder.name.startswith(f"headline-{AUDIT}-")
    text = capsys.readouterr().out
    assert "The headline stands" in text and f"from seed {AUDIT}" in text
    assert "1.000 [1.000, 1.000]" in text
    before = (folder / "episodes.jsonl").read_bytes()
    assert f'"seed": {AUDIT + 1}'.encode() in before
    assert breaking.main() == 0
    assert (folder / "episodes.jsonl").read_bytes() == before
    monkeypatch.setattr(sys, "argv", ["break_headline", "--policies", "nominal"])
    assert breaking.main() == 2
    monkeypatch.setattr(breaking, "FACTORS", ())
    monkeypatch.setattr(sys, "argv", [*given, "--output", str(tmp_path)])
    assert breaking.main() == 2
    assert "nothing would be tried" in capsys.readouterr().err
