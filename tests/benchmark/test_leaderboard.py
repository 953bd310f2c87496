"""The leaderboard: order, seeds, verdicts, and the same in every form."""

import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.benchmark.test_report import EASY, records
from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import leaderboard_page as page
from tracked_env.benchmark.report import comparison_table, policy_table, terminal
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.summary import rows_of, summarise

SEEDS = {f"ppo@{i}": (0.7 + 0.1 * i) * EASY for i in range(5)}
FEW = {"few@3": 2.0 * EASY, "few@4": 2.0 * EASY}


def board(
    *sets: str, conditions: str = "sets v1", **rmse: Any
) -> tuple[lb.Leaderboard, dict[str, Any]]:
    given = [r for name in sets or ("a", "b") for r in records(name, **rmse)]
    rows = rows_of(given)
    return lb.leaderboard(summarise(given, rows), rows, conditions), rows


ALL: dict[str, Any] = {
    "nominal": 3.0 * EASY, "adaptive": 1.5 * EASY, "oracle": EASY, **SEEDS, **FEW,
}  # fmt: skip


def test_agents_are_ordered_by_their_relative_error_and_seeds_are_one_agent() -> None:
    found, _ = board(**ALL)
    assert [p.agent for p in found.places] == ["ppo", "oracle", "adaptive", "few", "nominal"]
    assert [p.seeds for p in found.places] == [5, 0, 0, 2, 0]
    scores = [p.overall.score.value for p in found.places if p.overall.score]
    assert scores == pytest.approx([1.05, 1.0, 0.75, 0.5, 0.0], abs=0.03)
    assert found.sets == ["a", "b"]


def test_the_statistics_of_an_agent_are_those_of_all_seeds_and_episodes() -> None:
    found, _ = board("a", **ALL)
    pooled = np.concatenate(list(SEEDS.values()))
    assert found.places[0].overall.rmse_mean.value == pytest.approx(pooled.mean())
    assert found.places[0].overall.episodes == 16
    width = {p.agent: p.overall.rmse_mean.high - p.overall.rmse_mean.low for p in found.places}
    assert width["ppo"] > 2.0 * width["oracle"]  # seeds differ more than episodes


def test_in_the_mean_of_the_sets_a_set_that_fails_is_seen_and_in_the_score_it_is_not() -> None:
    given = [
        r
        for i in range(6)
        for r in records(
            f"set{i}", nominal=3.0 * EASY, mine=(40.0 if i == 0 else 1.0) * EASY, oracle=EASY
        )
    ]
    rows = rows_of(given)
    found = {p.agent: p for p in lb.leaderboard(summarise(given, rows), rows).places}
    mine = found["mine"]
    assert mine.overall.score
    assert mine.overall.score.value > 0.9
    assert mine.balanced
    assert mine.balanced.value == pytest.approx((5 * 1.0 + (3 - 40) / 2) / 6)
    assert tuple(mine.balanced) == pytest.approx((mine.balanced.value,) * 3)
    assert found["oracle"].balanced == pytest.approx((1.0, 1.0, 1.0))


def test_the_mean_of_the_sets_has_the_interval_of_seeds_that_are_the_same_in_all() -> None:
    found, _ = board("a", "b", "c", **ALL)
    one, _ = board("a", **ALL)
    many, single = found.places[0].balanced, one.places[0].balanced
    assert many
    assert single
    assert many.high - many.low > 0.9 * (single.high - single.low)  # not smaller by sqrt(3)


def test_without_scores_the_smaller_error_comes_first() -> None:
    found, _ = board(one=2.0 * EASY, two=EASY)
    assert [p.agent for p in found.places] == ["two", "one"]
    assert found.reference == "one"


def test_agents_are_compared_with_the_adaptive_baseline() -> None:
    found, _ = board(**ALL)
    said = {p.agent: lb.verdict(p) for p in found.places}
    assert said == {
        "ppo": "better", "oracle": "better", "adaptive": "reference", "few": "too few",
        "nominal": "worse",
    }  # fmt: skip
    close, _ = board(
        nominal=3 * EASY, adaptive=EASY, x=np.where(np.arange(16) % 2, 0.8, 1.2) * EASY
    )
    assert {p.agent: lb.verdict(p) for p in close.places}["x"] == "not certain"


def test_the_verdict_is_of_the_ratio_and_says_where_the_mean_is_the_opposite() -> None:
    lost = np.where(np.arange(16) < 3, 40.0, 0.5) * EASY  # better but for three lost vehicles
    found, _ = board("a", nominal=3 * EASY, adaptive=EASY, x=lost)
    (place,) = (p for p in found.places if p.agent == "x")
    assert place.against
    assert place.against.gain.value > 0.0 > place.against.difference.value
    said = place._replace(
        against=place.against._replace(difference=Estimate(-1.0, -1.5, -0.5)),
        relative=place.relative._replace(
            whole=Estimate(0.8, 0.7, 0.9), settled=Estimate(1.1, 0.9, 1.2)
        ),
    )
    assert lb.verdict(said) == "better, mean worse"
    assert lb.verdict(said, settled=True) == "not certain"
    assert lb.verdict(said._replace(seeds=1)) == "too few"
    worse = said.relative._replace(settled=Estimate(1.3, 1.1, 1.4))
    assert lb.verdict(said._replace(relative=worse), settled=True) == "worse"


@pytest.mark.parametrize(
    ("episodes", "seeds", "expected"),
    [(15, 0, "too few"), (16, 0, "better"), (16, 4, "too few"), (16, 5, "better")],
)
def test_no_verdict_is_given_below_sixteen_episodes_or_five_seeds(
    episodes: int, seeds: int, expected: str
) -> None:
    easy = EASY[:episodes]
    names = [f"x@{i}" for i in range(seeds)] or ["x"]
    given = records("a", adaptive=4 * easy, **dict.fromkeys(names, easy))
    given += records("b", adaptive=4 * EASY, **dict.fromkeys(names, EASY))
    rows = rows_of(given)
    summary = summarise(given, rows)
    found = {p.agent: p for p in lb.leaderboard(summary, rows).places}
    assert lb.verdict(found["x"]) == lb.verdict(found["x"], settled=True).replace(
        "not certain", expected
    )
    (line,) = (row for row in comparison_table(summary) if row[:2] == ["a", "x"])
    assert line[4] == {"better": "yes"}.get(expected, expected)


def test_an_agent_that_loses_a_set_is_not_called_better_and_the_set_is_named() -> None:
    given = []
    for i in range(12):
        lost = i == 4
        parts = records(f"set{i}", adaptive=EASY, x=np.full(16, 5.0) if lost else 0.5 * EASY)
        for record in parts:
            record["success"] = float(not (lost and record["policy"] == "x"))
        given += parts
    rows = rows_of(given)
    found = lb.leaderboard(summarise(given, rows), rows)
    (place,) = (p for p in found.places if p.agent == "x")
    assert place.relative.whole.high < 1.0  # eleven good sets make up for it in the mean
    assert (lb.verdict(place), lb.verdict(place, settled=True)) == ("loses set4",) * 2
    (row,) = (row for row in lb.table(found) if row[1] == "x")
    assert row[5] == "100 set4"


def test_an_agent_with_one_seed_has_no_interval() -> None:
    found, _ = board(nominal=3 * EASY, adaptive=EASY, **{"one@0": 0.5 * EASY}, oracle=EASY)
    cells = {row[1]: row for row in lb.table(found)[1:]}
    assert "[" in cells["adaptive"][3] and "[" in cells["adaptive"][4]
    assert "[" not in "".join(cells["one *"])


def test_the_reference_is_the_adaptive_policy_of_the_drive() -> None:
    found, _ = board(uc=3 * EASY, **{"slc-adaptive": EASY, "slc-oracle": EASY})
    assert found.reference == "slc-adaptive"


def test_fewer_than_five_seeds_are_marked_and_five_are_not() -> None:
    found, _ = board(**ALL)
    names = [row[1] for row in lb.table(found)[1:]]
    assert names == ["ppo", "oracle", "adaptive", "few *", "nominal"]
    assert "* fewer than 5 training seeds" in lb.terminal(found)
    given = records("a", **ALL)
    assert "few *" in [row[1] for row in policy_table(summarise(given))]
    assert "* fewer than 5" in terminal(summarise(given))
    assert "fewer" not in lb.terminal(board(nominal=EASY, mine=EASY)[0])


def test_seeds_that_did_not_meet_the_same_episodes_are_not_pooled() -> None:
    given = records("a", **SEEDS)
    given[-1]["digest"] = "other"
    with pytest.raises(ValueError, match="'ppo@4' did not meet the same episodes"):
        summarise(given)


def test_the_terminal_table_fits_and_markdown_and_json_say_the_same(tmp_path: Path) -> None:
    found, _ = board(**ALL)
    text = lb.terminal(found)
    assert max(map(len, text.splitlines())) <= 80
    assert text.endswith("sets v1")
    assert "Kendall's tau of this order and that by another statistic:\nmean 1.00" in text
    files = lb.write(tmp_path, found)
    assert [f.name for f in files] == ["leaderboard.json", "leaderboard.md"]
    document = json.loads(files[0].read_text())
    assert [a["agent"] for a in document["agents"]] == [p.agent for p in found.places]
    assert document["agents"][2]["against"] is None
    score = document["agents"][0]["scores"]["a"]
    assert f"{score['value']:.2f} (" in files[1].read_text()
    for part in files[1].read_text().split("\n\n"):
        if part.startswith("|"):
            assert len({line.count("|") for line in part.splitlines()}) == 1


def test_markdown_and_figures_show_a_strange_name_as_it_is(
    tmp_path: Path, repository: Path
) -> None:
    name = "<script>|x\n$\\foo$"
    found, rows = board("payload", "drift", **{**ALL, name: EASY})
    text = lb.markdown(found)
    assert "<script>" not in text
    assert r"&lt;script>\|x $\\foo$" in text
    publishing = script(repository, "publish")
    published = publishing.table(lb.document(found))
    (shown,) = (line for line in publishing.short_table(published).split("\n") if "foo" in line)
    assert re.fullmatch(
        r"\| \d \| &lt;script>.* \| \d\S+ \[.*\] \| [a-z ]+ \| .* \| .* % \| - \| .* \| .* \|",
        shown,
    )
    assert "<script>" not in published
    assert r"| &lt;script>\|x $\\foo$ |" in published
    pytest.importorskip("matplotlib")
    page.write(tmp_path, found, rows, {name: [[(1e5, 1.0), (1e6, 0.1)]]})


def script(repository: Path, name: str) -> Any:
    """A script of benchmarks/ as a module."""
    spec = importlib.util.spec_from_file_location(name, repository / "benchmarks" / f"{name}.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def by_speed(given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The same records with sprocket speeds as actions, whose rate is 2.5 rad/s^2."""
    return [{**r, "torque_rate": None, "sprocket_speed_rate": 2.5} for r in given]


@pytest.mark.parametrize(
    ("rate", "change", "short", "cost", "shown"),
    [
        (25e3, list, "kN m/s", "kN m/s", ("25.0", "25")),
        (25.0, list, "N m/s", "N m/s", ("25.0", "25")),
        (25.0, by_speed, "rad/s^2", "rad/s^2", ("2.5", "2.5")),
    ],
)
def test_every_table_names_the_unit_of_the_action_rate(
    repository: Path, rate: float, change: Any, short: str, cost: str, shown: tuple[str, str]
) -> None:
    given = [{**r, "torque_rate": rate} for r in records("payload", nominal=3 * EASY, oracle=EASY)]
    given = change(given)
    rows = rows_of(given)
    summary = summarise(given, rows)
    head, line, _ = policy_table(summary)
    assert (head[-1], line[-1]) == (f"action rate [{short}]", shown[0])
    found = lb.leaderboard(summary, rows)
    head, line, _ = lb.cost_table(found)
    assert (head[-3], line[-3]) == (f"action rate [{cost}]", shown[1])
    head_line, _, first, *_ = (
        script(repository, "publish").table(json.loads(json.dumps(lb.document(found)))).split("\n")
    )
    column = [cell.strip() for cell in head_line.split("|")].index(f"action rate [{short}]")
    assert first.split("|")[column].strip() == shown[0]
