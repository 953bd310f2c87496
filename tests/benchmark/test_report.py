"""From records to a summary: what is said, and what makes a set separate."""

import csv
import json
import re

import numpy as np
import pytest

from tracked_env.benchmark import report
from tracked_env.benchmark import table_model as tables
from tracked_env.benchmark.identification_metrics import ESTIMATION_METRICS
from tracked_env.benchmark.metrics import METRICS, OF_GOALS
from tracked_env.benchmark.store import READS_TRUTH
from tracked_env.benchmark.summary import ALL_SETS, SEPARATION_RATIO, summarise
from tracked_env.benchmark.table_model import escaped

EASY = np.linspace(0.04, 0.06, 16)
TRUTHFUL = ("oracle", "slc-oracle", "mpc-oracle")


def records(uncertainty_set, **rmse):
    """Records of one set with the given RMSE per policy; the others are 0.5, and no goals."""
    return [
        {
            **dict.fromkeys(METRICS, 0.5),
            **dict.fromkeys(OF_GOALS),
            **{"set": uncertainty_set, "policy": policy, "digest": f"{uncertainty_set}{i}"},
            **{"episode": i, "seed": i, "ended": "time", "predict_time": 2e-6},
            "tracking_rmse": float(value),
            **({READS_TRUTH: True} if policy in TRUTHFUL else {}),
        }
        for policy, values in rmse.items()
        for i, value in enumerate(values)
    ]


def markdown(summary):
    return tables.markdown(report.tables_of(summary))


def comparison(nominal, oracle):
    summary = summarise(records("set", nominal=nominal, oracle=oracle))
    return summary.comparisons["set"]["oracle"]


def test_a_set_separates_when_the_difference_is_certain_and_the_ratio_large_enough():
    certain = comparison(3.0 * EASY, EASY)
    assert certain.worse and certain.ratio.value == pytest.approx(3.0)
    assert certain.difference.value == pytest.approx(2.0 * EASY.mean())
    assert tuple(certain.improvement) == (1.0, 1.0, 1.0)
    small = comparison(1.1 * EASY, EASY)
    assert small.difference.low > 0.0 and not small.worse
    uncertain = comparison(np.where(np.arange(16) % 2, 3.0 * EASY, 0.02 * EASY), EASY)
    assert uncertain.ratio.value > SEPARATION_RATIO and not uncertain.worse
    assert uncertain.difference.low < 0.0 < uncertain.difference.value
    assert not comparison(EASY, 3.0 * EASY).worse


@pytest.mark.parametrize("names", [("nominal", "oracle"), ("ppo@0", "ppo@1")])
def test_policies_and_seeds_that_did_not_meet_the_same_episodes_are_not_compared(names):
    both = records("set", **dict.fromkeys(names, EASY))
    both[-1]["digest"] = "other"
    with pytest.raises(ValueError, match=f"{names[1]}' did not meet the same episodes"):
        summarise(both)


def test_all_sets_pools_the_episodes_of_several_sets_and_one_set_has_no_such_row():
    one = records("a", nominal=EASY, oracle=EASY)
    two = one + records("b", nominal=9.0 * EASY, oracle=EASY)
    assert ALL_SETS not in summarise(one).policies
    pooled = summarise(two).policies[ALL_SETS]
    assert pooled["nominal"].episodes == 32
    assert pooled["nominal"].rmse_mean.value == pytest.approx(5.0 * EASY.mean())


def test_a_single_policy_is_summarised_without_a_comparison():
    text = report.terminal(summarise(records("set", mine=EASY)))
    assert "mine" in text
    assert "clearly worse" not in text


def test_names_are_shown_as_they_are_in_markdown():
    strange = "a|b\n<script>&`x`[y](z)\\|"
    text = markdown(summarise(records("s|t", **{strange: EASY, "b": 2 * EASY})))
    shown = r"a\|b &lt;script>&amp;\`x\`[y\](z)\\\|"
    assert shown in text
    assert "<script>" not in text
    for part in text.split("\n\n"):
        rows = [line for line in part.splitlines() if line.startswith("|")]
        assert len({len(re.findall(r"(?<!\\)(?:\\\\)*\|", line)) for line in rows}) <= 1
        assert len(rows) in (0, len(part.splitlines()))
    assert escaped("RMSE [m]: IQM [95 %] *") == "RMSE [m]: IQM [95 %] *"


def test_nothing_finished_is_an_error():
    with pytest.raises(ValueError, match="no finished episode"):
        summarise([])


@pytest.mark.parametrize("first", ["nominal", "mine"])  # the baseline
def test_the_score_is_zero_for_nominal_one_for_the_oracle_and_in_between_by_the_gap_closed(first):
    errors = {"nominal": 3.0 * EASY, "mine": 1.5 * EASY, "worse": 4.0 * EASY, "oracle": EASY}
    found = summarise(records("set", **{first: errors[first], **errors})).policies["set"]
    scores = {"nominal": 0.0, "mine": 0.75, "worse": -0.5, "oracle": 1.0}
    for policy, expected in scores.items():
        score = found[policy].score
        assert tuple(score) == pytest.approx((expected,) * 3)  # the same redraws: all cancels


def test_the_score_starts_at_integral_and_ends_at_the_best_policy_that_reads_the_truth():
    given = records(
        "set", nominal=9 * EASY, integral=3 * EASY, adaptive=2 * EASY, oracle=2.5 * EASY, other=EASY
    )
    for record in given:
        if record["policy"] in ("oracle", "other"):
            record[READS_TRUTH] = True
    found = summarise(given).policies["set"]
    scores = {name: of.score.value for name, of in found.items() if of.score}
    assert scores == pytest.approx(
        {"nominal": -3.0, "integral": 0.0, "adaptive": 0.5, "oracle": 0.25, "other": 1.0}
    )


def test_there_is_no_score_without_both_anchors_or_without_a_certain_gap():
    only = summarise(records("set", nominal=3.0 * EASY, mine=EASY)).policies["set"]
    assert only["mine"].score is None
    uncertain = np.where(np.arange(16) % 2, 1.2, 0.8) * EASY
    for nominal in (uncertain, EASY):
        summary = summarise(records("set", nominal=nominal, oracle=EASY))
        assert summary.policies["set"]["oracle"].score is None


def test_only_failures_that_the_baseline_does_not_share_are_counted():
    given = records("set", nominal=EASY[:4], mine=EASY[:4])
    for row, change in {
        0: {"terminated": 1.0, "success": 0.0},
        4: {"success": 0.0},
        5: {"terminated": 1.0, "success": 0.0},
        6: {"success": 0.0},
    }.items():
        given[row].update(change)
    assert summarise(given).comparisons["set"]["mine"].fails_alone == 2


def test_recovery_is_averaged_over_the_episodes_with_a_change_and_shown_for_such_sets(tmp_path):
    given = records("a", nominal=EASY[:4], oracle=EASY[:4]) + records(
        "b", nominal=EASY[:4], oracle=EASY[:4]
    )
    for record in given:
        changed = record["set"] == "a" and record["episode"] < 2
        record["recovery_time"] = float(record["episode"] + 1) if changed else None
        record["peak_after_change"] = 0.4 if changed else None
    summary = summarise(given)
    assert summary.policies["a"]["nominal"].changed == 2
    assert summary.policies["a"]["nominal"].means["recovery_time"] == 1.5
    head, *rows = report.policy_table(summary).rows
    place = head.index("recovery [s]")
    assert [row[place] for row in rows] == ["1.5", "1.5", "-", "-", "1.5", "1.5"]
    report.write(tmp_path, {}, given, summary)
    text = (tmp_path / "results.json").read_text()
    assert "NaN" not in text
    assert json.loads(text)["summary"]["policies"]["b"]["oracle"]["means"]["recovery_time"] is None


def test_estimates_are_summarised_shown_and_written(tmp_path):
    given = records("set", nominal=EASY[:3], mine=EASY[:3])
    believed = dict.fromkeys(ESTIMATION_METRICS, 0.5)
    believed |= {"nees_apart": 0.25, "in_three_sigma_apart": 0.875, "claimed_deviation": 0.0625}
    for record, time in zip(given[3:], (1.0, 2.0, None), strict=True):
        settled = 0.0 if time is None else 1.0
        mass = {**believed, "settling_time": time, "settled": settled, "excited": None}
        record["identification"] = {"mass": mass}
        record["nis"] = {"filter": 1.25}
    assert "NEES" not in report.terminal(summarise(given[:3]))
    summary = summarise(given)
    mass = summary.identification["set"]["mine"]["mass"]
    assert (mass["settling_time"], mass["settled"]) == (
        2.0,
        pytest.approx(2 / 3),
    )  # median of 1, 2, never
    assert np.isnan(mass["excited"])
    assert "nominal" not in summary.identification["set"]
    text = report.terminal(summary)
    head, row = report.identification_table(summary).rows
    told = dict(zip(head, row, strict=True))
    assert (told["NEES"], told["in 3 sigma"]) == ("0.5", "50.0%")
    apart = told["NEES apart"], told["in 3 sigma apart"], told["claimed sigma"]
    assert apart == ("0.25", "87.5%", "6.2%")
    assert "NEES apart" in text
    assert "1.25" in text
    report.write(tmp_path, {}, given, summary)
    document = json.loads((tmp_path / "results.json").read_text())
    assert document["summary"]["identification"]["set"]["mine"]["mass"]["nees"] == 0.5
    assert document["summary"]["nis"]["set"]["mine"]["filter"] == 1.25
    assert document["units"]["settling_time"] == "s"
    with (tmp_path / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["mass.settling_time"] for row in rows] == ["", "", "", "1.0", "2.0", ""]
    assert rows[5]["nis.filter"] == "1.25"
    assert "| set | mine | mass |" in (tmp_path / "summary.md").read_text()


def test_most_episodes_that_never_settle_are_called_never():
    given = records("set", mine=EASY[:3])
    for record, settled in zip(given, (1.0, 0.0, 0.0), strict=True):
        times = {"settling_time": 1.0 if settled else None, "settled": settled}
        record["identification"] = {"mass": {**dict.fromkeys(ESTIMATION_METRICS, 0.5), **times}}
    assert "never" in report.terminal(summarise(given))


def test_the_terminal_table_is_aligned_fits_and_names_its_units():
    long = records("terrain-transition", nominal=100.0 * EASY, oracle=EASY)
    long += records("ood", nominal=EASY, oracle=EASY)
    lines = report.terminal(summarise(long)).splitlines()
    table = lines[: lines.index("")]
    assert max(len(line) for line in lines) <= 80
    assert {len(line) for line in table} == {len(table[0])}
    assert "[m]" in table[0]
    second = lines[lines.index("") + 1 :]
    assert second[0].split()[:2] == ["set", "policy"] and "[kJ]" in second[0]
    whole = report.terminal(summarise(long), width=132).splitlines()[0]
    assert "[m]" in whole and "[kJ]" in whole
    assert [line.split()[0] for line in table[2:6]] == [
        "terrain-transition",
        "oracle",
        "ood",
        "oracle",
    ]


def test_json_and_csv_hold_every_record_and_the_configuration(tmp_path):
    given = records("set", nominal=EASY, oracle=0.5 * EASY)
    header = {"hash": "abc", "identity": {"seed": 0}, "versions": {}, "machine": {}}
    report.write(tmp_path, header, given, summarise(given))
    document = json.loads((tmp_path / "results.json").read_text())
    assert document["episodes"] == given
    assert document["identity"] == {"seed": 0}
    assert document["units"]["energy"] == "J"
    found = document["summary"]["comparisons"]["set"]["oracle"]
    assert found["ratio"]["value"] == pytest.approx(2.0)
    assert found["worse"] is True
    with (tmp_path / "episodes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["tracking_rmse"]) for row in rows] == [r["tracking_rmse"] for r in given]
    assert (tmp_path / "summary.md").read_text().startswith("| set | policy |")
