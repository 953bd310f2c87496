"""The leaderboard: order, seeds, verdicts, lost sets, and the same in every form."""

import importlib.util
import json
import re

import numpy as np
import pytest

from tests.benchmark.test_report import EASY, records
from tracked_env.benchmark import leaderboard as lb
from tracked_env.benchmark import report
from tracked_env.benchmark import statistics as stats
from tracked_env.benchmark import table_model as tables
from tracked_env.benchmark.figures import profiles
from tracked_env.benchmark.report import comparison_table, main_table, policy_table
from tracked_env.benchmark.statistics import Estimate
from tracked_env.benchmark.store import BESIDE
from tracked_env.benchmark.summary import rows_of, summarise

SEEDS = {f"ppo@{i}": (0.7 + 0.1 * i) * EASY for i in range(5)}
FEW = {"few@3": 2.0 * EASY, "few@4": 2.0 * EASY}


def board_of(given, conditions="sets v1"):
    """The leaderboard of records, and its rows."""
    rows = rows_of(given)
    return lb.leaderboard(summarise(given, rows), rows, conditions), rows


def board(*sets, **rmse):
    return board_of([r for name in sets or ("a", "b") for r in records(name, **rmse)])


CONTROLLERS = {"nominal": 3.0 * EASY, "adaptive": 1.5 * EASY, "oracle": EASY}
ALL = {**CONTROLLERS, **SEEDS, **FEW}


SUMMARY = summarise(records("a", nominal=EASY, mine=EASY))


def test_agents_are_ordered_by_their_relative_error_and_seeds_are_one_agent():
    found, _ = board(**ALL)
    assert [p.agent for p in found.places] == ["ppo", "oracle", "adaptive", "few", "nominal"]
    assert [p.seeds for p in found.places] == [5, 0, 0, 2, 0]
    scores = [p.overall.score.value for p in found.places if p.overall.score]
    assert scores == pytest.approx([1.05, 1.0, 0.75, 0.5, 0.0], abs=0.03)
    assert found.sets == ["a", "b"]


def test_the_statistics_of_an_agent_are_those_of_all_seeds_and_episodes():
    found, _ = board("a", **ALL)
    pooled = np.concatenate(list(SEEDS.values()))
    assert found.places[0].overall.rmse_mean.value == pytest.approx(pooled.mean())
    assert found.places[0].overall.episodes == 16
    width = {p.agent: p.overall.rmse_mean.high - p.overall.rmse_mean.low for p in found.places}
    assert width["ppo"] > 2.0 * width["oracle"]  # seeds differ more than episodes


def test_without_scores_the_smaller_error_comes_first():
    found, _ = board(one=2.0 * EASY, two=EASY)
    assert [p.agent for p in found.places] == ["two", "one"]
    assert found.reference == "one"


def test_agents_are_compared_with_the_adaptive_baseline():
    found, _ = board(**ALL)
    said = {p.agent: lb.verdict(p) for p in found.places}
    verdicts = {"ppo": "better", "oracle": "better", "adaptive": "reference", "few": "too few"}
    assert said == {**verdicts, "nominal": "worse"}
    close, _ = board(
        nominal=3 * EASY, adaptive=EASY, x=np.where(np.arange(16) % 2, 0.8, 1.2) * EASY
    )
    assert {p.agent: lb.verdict(p) for p in close.places}["x"] == "not certain"


def test_lost_vehicles_that_the_iqm_does_not_see_are_in_columns_of_the_same_weight():
    gone = np.arange(16) < 3
    errors = np.where(gone, 40.0, 0.5) * EASY  # better but for three lost vehicles
    given = records("a", nominal=3 * EASY, adaptive=EASY, x=errors)
    for record in given:
        failed = record["policy"] == "x" and gone[record["episode"]]
        record["success"] = float(not failed)
    found, _ = board_of(given)
    (place,) = (p for p in found.places if p.agent == "x")
    assert place.relative.mean.value == pytest.approx(errors.mean() / EASY.mean())
    assert place.relative.quantile.value == pytest.approx(np.sort(errors)[14] / np.sort(EASY)[14])
    head, *rows = main_table(found).texts
    cells = dict(zip(head, next(row for row in rows if row[0] == "x"), strict=True))
    pattern = r"{} \[\d\.\d\d, \d+\.\d\d\]"
    for column, value in {
        "error / adaptive": "0.54",  # most of its ratios are 0.5
        "mean": f"{place.relative.mean.value:.2f}",
        "90 % quantile": f"{place.relative.quantile.value:.2f}",
    }.items():
        assert re.fullmatch(pattern.format(value), cells[column]), column
    assert cells["failures"] == "18.8%"


def test_a_verdict_is_given_where_the_corrected_p_value_is_at_most_one_in_twenty():
    found, _ = board(**CONTROLLERS, x=0.9 * EASY)
    (place,) = (p for p in found.places if p.agent == "x")
    relative = place.relative._replace(
        whole=Estimate(0.8, 0.7, 0.9), settled=Estimate(1.3, 1.1, 1.4)
    )
    said = place._replace(relative=relative, corrected=(0.05, 0.051))
    assert (lb.verdict(said), lb.verdict(said, settled=True)) == ("better", "not certain")
    said = said._replace(corrected=(0.051, 0.05))
    assert (lb.verdict(said), lb.verdict(said, settled=True)) == ("not certain", "worse")
    assert lb.verdict(said._replace(seeds=1)) == "too few"


def test_holms_correction_counts_both_verdicts_of_all_policies_that_get_any():
    rng = np.random.default_rng(1)
    several = {f"x{i}": EASY * rng.uniform(0.9, 1.12, 16) for i in range(5)}
    given = records("a", **{**CONTROLLERS, **several, **FEW})
    for record in given:
        record["settled_rmse"] = record["tracking_rmse"] ** 2
    places = {p.agent: p for p in board_of(given)[0].places}
    assert places["adaptive"].corrected == places["few"].corrected == (1.0, 1.0)
    judged = [places[name] for name in places if name not in ("adaptive", "few")]
    assert [p for of in judged for p in of.corrected] == pytest.approx(
        stats.holm([p for of in judged for p in of.relative.p_values])
    )
    assert len(judged) == 7


@pytest.mark.parametrize(
    ("episodes", "seeds", "expected"),
    [(15, 0, "too few"), (16, 0, "better"), (16, 4, "too few"), (16, 5, "better")],
)
def test_no_verdict_is_given_below_sixteen_episodes_or_five_seeds(episodes, seeds, expected):
    easy = EASY[:episodes]
    names = [f"x@{i}" for i in range(seeds)] or ["x"]
    given = records("a", adaptive=4 * easy, **dict.fromkeys(names, easy))
    given += records("b", adaptive=4 * EASY, **dict.fromkeys(names, EASY))
    summary = summarise(given)
    found = {p.agent: p for p in board_of(given)[0].places}
    assert lb.verdict(found["x"]) == lb.verdict(found["x"], settled=True).replace(
        "not certain", expected
    )
    (line,) = (row for row in comparison_table(summary).rows if row[:2] == ["a", "x"])
    assert line[4] == {"better": "yes"}.get(expected, expected)
    (row,) = (row for row in report.set_table(board_of(given)[0]).body if row[0].text == "x")
    assert row[2].more == (expected,)
    assert row[2].text == f"{easy.mean():.3f} m: 0.25 [0.25, 0.25]"


def test_an_agent_that_loses_a_set_is_not_called_better_and_the_set_is_named():
    given = []
    for i in range(12):
        lost = i == 4
        parts = records(f"set{i}", adaptive=EASY, x=np.full(16, 5.0) if lost else 0.5 * EASY)
        for record in parts:
            record["success"] = float(not (lost and record["policy"] == "x"))
        given += parts
    found, _ = board_of(given)
    (place,) = (p for p in found.places if p.agent == "x")
    assert place.relative.whole.high < 1.0  # eleven good sets make up for it in the mean
    assert (lb.verdict(place), lb.verdict(place, settled=True)) == ("loses set4",) * 2
    (row,) = (row for row in main_table(found).rows if row[0] == "x")
    assert row[-1] == "100 set4"


def test_an_agent_with_one_seed_has_no_interval():
    found, _ = board(nominal=3 * EASY, adaptive=EASY, **{"one@0": 0.5 * EASY}, oracle=EASY)
    cells = {row[0]: row for row in main_table(found).texts[1:]}
    assert "[" in cells["adaptive"][3] and "[" in cells["adaptive"][4]
    assert "[" not in "".join(cells["one *"])


def test_the_reference_is_the_adaptive_policy_of_the_drive():
    found, _ = board(uc=3 * EASY, **{"slc-adaptive": EASY, "slc-oracle": EASY})
    assert found.reference == "slc-adaptive"


def test_fewer_than_five_seeds_are_marked_and_five_are_not():
    found, _ = board(**ALL)
    names = [row[0] for row in main_table(found).rows[1:]]
    assert names == ["ppo", "oracle", "adaptive", "few *", "nominal"]
    given = summarise(records("a", **ALL))
    assert "few *" in [row[1] for row in policy_table(given).rows]
    alone = main_table(board(nominal=EASY, mine=EASY)[0])
    for table, said in ((main_table(found), 1), (policy_table(given), 1), (alone, 0)):
        assert ("* fewer than 5 training seeds" in " ".join(table.notes)) == said


def test_the_time_in_predict_of_parallel_runs_is_marked_as_not_comparable():
    given = records("a", nominal=EASY, oracle=EASY)
    for record in given:
        record |= {BESIDE: 2} if record["policy"] == "oracle" else {}
    head, *rows = report.cost_table(board_of(given)[0]).texts
    shown = {row[0]: row[head.index("predict [us]")] for row in rows}
    assert shown == {"nominal": "2.0", "oracle": "~2.0"}


def test_the_terminal_table_fits_and_markdown_and_json_say_the_same(tmp_path):
    found, _ = board(**ALL)
    text = tables.terminal(report.leaderboard_tables(found))
    assert max(map(len, text.splitlines())) <= 80
    assert text.endswith("sets v1")
    assert "Kendall's tau of this order and that by another statistic:\nmean 1.00" in text
    report.write_leaderboard(tmp_path, found, SUMMARY)
    document = json.loads((tmp_path / "leaderboard.json").read_text())
    assert [a["agent"] for a in document["agents"]] == [p.agent for p in found.places]
    assert document["agents"][2]["against"] is None
    markdown = (tmp_path / "leaderboard.md").read_text()
    best = document["agents"][0]
    ratio = Estimate(**best["relative"]["by_set"]["a"])
    assert f"| {best['rmse']['a']['value']:.3f} m: {tables.between(ratio, 2)} |" in markdown
    for part in markdown.split("\n\n"):
        if part.startswith("|"):
            assert len({line.count("|") for line in part.splitlines()}) == 1


def test_markdown_and_figures_show_a_strange_name_as_it_is(repository):
    name = "<script>|x\n$\\foo$"
    found, rows = board("payload", "drift", **{**ALL, name: EASY})
    text = tables.markdown(report.leaderboard_tables(found))
    assert "<script>" not in text
    assert r"&lt;script>\|x $\\foo$" in text
    publishing = script(repository, "publish")
    published = publishing.table(report.document(found))
    short = publishing.short_table(report.document(found))
    (shown,) = (line for line in short.split("\n") if "foo" in line)
    error = r"\d\S+ \[.*\]"
    row = rf"\|( {error} \|){{2}} &lt;script>.* \| \d+\.\d % \| - \|"
    assert re.fullmatch(row, shown)
    assert "<script>" not in published
    assert r"| &lt;script>\|x $\\foo$ |" in published
    assert "$\\foo$" in profiles(found, rows["all sets"]).svg


def script(repository, name):
    """A script of benchmarks/ as a module."""
    spec = importlib.util.spec_from_file_location(name, repository / "benchmarks" / f"{name}.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def by_speed(given):
    """The same records with sprocket speeds as actions, whose rate is 2.5 rad/s^2."""
    return [{**r, "torque_rate": None, "sprocket_speed_rate": 2.5} for r in given]


@pytest.mark.parametrize(
    ("rate", "change", "unit", "shown"),
    [
        (25e3, list, "kN m/s", ("25.0", "25")),
        (25.0, list, "N m/s", ("25.0", "25")),
        (25.0, by_speed, "rad/s^2", ("2.5", "2.5")),
    ],
)
def test_every_table_names_the_unit_of_the_action_rate(repository, rate, change, unit, shown):
    given = [{**r, "torque_rate": rate} for r in records("payload", nominal=3 * EASY, oracle=EASY)]
    given = change(given)
    head, line, _ = policy_table(summarise(given)).rows
    assert (head[-1], line[-1]) == (f"action rate [{unit}]", shown[0])
    found, _ = board_of(given)
    head, line, _ = report.cost_table(found).rows
    assert (head[-3], line[-3]) == (f"action rate [{unit}]", shown[1])
    document = json.loads(json.dumps(report.document(found)))
    head_line, _, first, *_ = script(repository, "publish").table(document).split("\n")
    column = [cell.strip() for cell in head_line.split("|")].index(f"action rate [{unit}]")
    assert first.split("|")[column].strip() == shown[0]


LIMIT = 5.0  # [m] error of a lost episode


def rows_with_losses(count=12, lost=0, share=1.0, **factors):
    """Rows of `count` sets; of the first `lost`, a share of the episodes is lost by `x`."""
    given = []
    for number in range(count):
        errors = {name: factor * EASY for name, factor in factors.items()}
        gone = np.arange(len(EASY)) < (share * len(EASY) if number < lost else 0)
        errors["x"] = np.where(gone, LIMIT, errors["x"])
        for record in records(f"set{number}", **errors):
            failed = record["policy"] == "x" and gone[record["episode"]]
            settled = record["tracking_rmse"] / 2.0
            given.append({**record, "success": float(not failed), "settled_rmse": settled})
    return {name: row for name, row in rows_of(given).items() if name.startswith("set")}


def test_the_same_factor_in_a_set_of_small_and_of_large_errors_counts_the_same():
    given = records("small", adaptive=EASY, x=2.0 * EASY, y=EASY)
    given += records("large", adaptive=9.0 * EASY, x=9.0 * EASY, y=18.0 * EASY)
    sets = {name: row for name, row in rows_of(given).items() if name in ("small", "large")}
    found = [lb.relative(sets, name, "adaptive") for name in ("x", "y")]
    assert tuple(found[0].whole) == pytest.approx((2.0**0.5,) * 3)
    assert tuple(found[1].whole) == pytest.approx((2.0**0.5,) * 3)
    assert [of.worst_set for of in found] == ["small", "large"]
    assert [of.worst for of in found] == pytest.approx([2.0, 2.0])


def test_one_lost_set_of_twelve_makes_the_mean_half_as_large_again_and_is_named():
    good, bad = (
        lb.relative(rows_with_losses(lost=n, adaptive=1.0, x=1.0), "x", "adaptive") for n in (0, 1)
    )
    assert good.whole.value == pytest.approx(1.0)
    assert bad.whole.value == pytest.approx((LIMIT / 0.05) ** (1.0 / 12.0)) and bad.whole.low > 1.4
    assert (bad.worst_set, bad.lost, good.lost) == ("set0", ("set0",), ())
    assert bad.worst == pytest.approx(LIMIT / 0.05)


def test_a_set_is_lost_from_more_than_half_of_the_episodes_and_where_the_reference_is_not():
    for share, lost in ((0.5, ()), (0.5625, ("set0", "set1"))):
        of = rows_with_losses(count=3, lost=2, share=share, adaptive=1.0, x=1.0)
        assert lb.relative(of, "x", "adaptive").lost == lost
        assert lb.relative(of, "adaptive", "x").lost == ()
    both = records("a", adaptive=EASY, x=EASY)
    for record in both:
        record["success"] = 0.0
    assert lb.relative(rows_of(both), "x", "adaptive").lost == ()


def test_the_order_by_another_statistic_shows_what_the_iqm_does_not():
    of = rows_with_losses(count=2, lost=2, share=0.2, adaptive=1.0, x=0.9, z=3.0)
    ranked = {
        name: lb.relative(of, name, "adaptive").whole.value for name in ("x", "adaptive", "z")
    }
    assert sorted(ranked, key=lambda name: ranked[name]) == ["x", "adaptive", "z"]
    found = lb.agreement(of, ranked)
    assert set(found) == {*lb.OTHER, "1 unlike sets"}
    assert found["median"] == found["IQM times power"] == 1.0
    assert found["mean"] == found["90 % quantile"] == pytest.approx(-1.0 / 3.0)  # x is last
    assert found["success"] < 0.0


def test_energy_is_weighed_per_time_driven_so_that_an_early_end_saves_nothing():
    given = records("a", adaptive=EASY, x=EASY)
    for record in given:
        early = record["policy"] == "x"
        record |= {"energy": 100.0 if early else 300.0, "driven_time": 10.0 if early else 30.0}
    of = rows_of(given)
    by = lb.OTHER["IQM times power"]
    assert by([of["a"]], "x") == pytest.approx(by([of["a"]], "adaptive"))


def test_the_cost_of_training_is_that_of_the_last_row_a_mean_over_seeds(tmp_path):
    folders = [tmp_path / name for name in ("a", "b", "none", "other")]
    for folder in folders:
        folder.mkdir()
    (folders[0] / "curve.csv").write_text("steps,cpu_seconds\n10,1\n1000000,100\n")
    (folders[1] / "curve.csv").write_text("steps,cpu_seconds\n3000000,200\n")
    (folders[3] / "curve.csv").write_text("steps,held_out_rmse\n20,0.5\n")
    assert lb.read_costs({"x": folders, "y": folders[2:]}) == {"x": lb.TrainingCost(2e6, 150.0)}
    assert str(lb.TrainingCost(2e6, 150.0)) == "2 M steps, 150 s"
