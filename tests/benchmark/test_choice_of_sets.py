"""What a set separates, and how alike two sets are, on made-up numbers."""

import json
import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from benchmarks.studies import choice_of_sets as choosing
from tests.benchmark.test_report import EASY, records
from tracked_env import TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT, SETS, UNLIKE_SETS, VERSIONS
from tracked_env.benchmark.statistics import correlations
from tracked_env.benchmark.summary import rows_of

TORQUE_V3 = VERSIONS["torque-v3"]
FACTORS = {"nominal": 9.0, "integral": 4.0, "adaptive": 1.5, "oracle": 1.2, "mpc-oracle": 1.0}
FACTORS |= {"ppo-blind": 7.0, "sac-blind": 8.0, "recurrent-ppo-blind": 2.0}


def given(name, **factors):
    """Records of a set: every RMSE is a factor times that of an easy episode."""
    return records(name, **{policy: factor * EASY for policy, factor in factors.items()})


def chosen(*sets):
    made = [r for name, factors in sets for r in given(name, **factors)]
    return choosing.choice(rows_of(made), TORQUE_V3)


def test_the_roles_of_a_set_are_filled_by_the_best_of_each_kind():
    (found,) = chosen(("a", FACTORS)).sets
    assert found.roles == {
        **{"blind": "ppo-blind", "memory": "adaptive", "baseline": "integral"},
        **{"adaptive": "adaptive", "ceiling": "mpc-oracle"},  # the best policy with the truth
    }


def test_the_headroom_is_the_adaptive_error_over_the_least_with_the_truth_whole_and_later():
    made = given("a", **FACTORS)
    for record in made:  # after the start the other oracle is the best
        factor = {"oracle": 0.5, "mpc-oracle": 0.8, "adaptive": 2.0}.get(record["policy"], 1.0)
        record["settled_rmse"] = factor * record["tracking_rmse"] / FACTORS[record["policy"]]
    (found,) = choosing.choice(rows_of(made), TORQUE_V3).sets
    assert found.headroom == pytest.approx((1.5 / 1.0, 2.0 / 0.5))
    assert "1.50 / 4.00" in choosing.table(choosing.Choice([found], np.eye(1)))[1]
    (alone,) = chosen(("a", {"adaptive": 1.5})).sets
    assert np.isnan(alone.headroom).all()


CLOSE = {**FACTORS, "integral": 1.1, "adaptive": 1.05, "recurrent-ppo-blind": 1.06}
CLOSE |= {"ppo-blind": 1.15, "sac-blind": 1.15}
NEAR = {**FACTORS, "integral": 1.25, "adaptive": 1.1}


@pytest.mark.parametrize(
    ("factors", "memory", "identification", "needed"),
    [
        # Shares of the gap between baseline and ceiling.
        (FACTORS, (7.0 - 1.5) / (4.0 - 1.0), (4.0 - 1.5) / (4.0 - 1.0), (True, True)),
        (dict.fromkeys(FACTORS, 1.0), 0.0, 0.0, (False, False)),
        (CLOSE, 1.0, 0.0, (False, False)),  # 0.1 of a gap of 0.1, 10 % of the error
        (NEAR, None, 0.6, (None, False)),  # of a gap of 0.25, 14 % of the error
        ({**NEAR, "integral": 1.35}, None, None, (None, True)),
        ({"integral": 4.0, "oracle": 1.0}, np.nan, np.nan, (None, None)),  # nobody of that role
    ],
)
def test_what_a_set_separates_is_a_share_of_the_gap_and_needs_a_gap_that_is_large(
    factors, memory, identification, needed
):
    (found,) = chosen(("a", factors)).sets
    for kind, expected, strong in zip(
        ("memory", "identification"), (memory, identification), needed, strict=True
    ):
        value, is_strong = found.separates(kind)
        assert expected is None or value == pytest.approx(expected, nan_ok=True)
        assert strong is None or is_strong == strong
    shown = choosing.table(choosing.Choice([found], np.eye(1)))[1][-3:]
    assert (shown == ["-", "-", "-"]) == (memory is not None and np.isnan(memory))


def test_rank_correlations_are_those_of_an_independent_implementation_ties_included():
    rng = np.random.default_rng(5)
    for _ in range(20):
        one, other = rng.integers(0, 6, 9) / 6.0, rng.normal(size=9)
        pair = [{f"p{i}": float(v) for i, v in enumerate(of)} for of in (one, other)]
        expected = spearmanr(one, other).statistic
        assert correlations(pair)[0, 1] == pytest.approx(expected, abs=1e-12)
    assert np.isnan(correlations([{"a": 1.0, "b": 1.0}, {"a": 1.0, "b": 2.0}])[0, 1])


def test_two_chosen_sets_that_rank_the_policies_alike_are_named():
    one, two = TORQUE_V3.sets[:2]
    other = {name: 10.0 - factor for name, factor in FACTORS.items()}
    same = chosen((one, FACTORS), (two, FACTORS), ("candidate", FACTORS))
    different = chosen((one, FACTORS), (two, other), ("candidate", FACTORS))
    assert same.verdict()[3].startswith("NOT met: no two")
    assert f"{two} and {one} (1.00)" in same.verdict()[3]
    assert different.verdict()[3].startswith("met: ")
    assert [each.name for each in same.chosen()] == [one, two]
    assert "NOT met: 10 to 12 sets: 2" in same.verdict()


def most_by_trying(correlation):
    """Of the most rows of which no two correlate above ALIKE, by trying all choices."""
    places = range(len(correlation))
    return max(
        size
        for size in range(len(correlation) + 1)
        for some in combinations(places, size)
        if all(correlation[pair] <= choosing.ALIKE for pair in combinations(some, 2))
    )


@pytest.mark.parametrize("seed", range(8))
def test_the_most_sets_that_are_unlike_are_as_many_as_by_trying_all_choices(seed):
    noise = np.random.default_rng(seed).normal(size=(9, 4))
    correlation = np.corrcoef(noise + np.array([2.0, 0.0, -2.0, 0.0]))
    found = choosing.unlike(correlation)
    assert all(correlation[pair] <= choosing.ALIKE for pair in combinations(found, 2))
    assert 1 < len(found) == most_by_trying(correlation) < 9


def test_of_two_sets_that_are_alike_the_chosen_one_stays():
    correlation = np.array([[1.0, 0.95, 0.1], [0.95, 1.0, 0.2], [0.1, 0.2, 1.0]])
    assert choosing.unlike(correlation, preferred=[0]) == [0, 2]
    assert choosing.unlike(correlation, preferred=[1]) == [1, 2]


def test_the_verdict_says_how_many_sets_could_go_together():
    other = dict(zip(FACTORS, reversed(FACTORS.values()), strict=True))
    found = chosen(("alternating", FACTORS), ("late-gains", FACTORS), ("mine", other))
    assert "of the 2 chosen sets at most 1 go together" in "\n".join(found.verdict())
    assert "of the 3 candidates at most 2 go together" in "\n".join(found.verdict())
    all_chosen = chosen(("alternating", FACTORS), ("late-gains", other))
    assert "of the 2 chosen sets at most 2" in "\n".join(all_chosen.verdict())
    assert "candidates" not in "\n".join(all_chosen.verdict())  # which would say the same again


def test_two_sets_that_one_policy_alone_makes_different_do_not_go_together_for_long():
    """Without it both rank the others alike."""
    first = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0, "e": 5.0}
    second = {**first, "a": 9.0}
    assert correlations([first, second])[0, 1] == pytest.approx(0.0)
    np.testing.assert_allclose(choosing.without_one([first, second]), 1.0)
    turned = dict(zip(first, reversed(first.values()), strict=True))
    np.testing.assert_allclose(choosing.without_one([first, turned])[0, 1], -1.0)
    moved = {**FACTORS, "nominal": 0.5 * min(FACTORS.values())}
    found = chosen(("alternating", FACTORS), ("mine", moved))
    assert [each.name for each in found.most_unlike(found.sets)] == ["alternating", "mine"]
    assert [each.name for each in found.most_unlike(found.sets, lasting=True)] == ["alternating"]
    said = "of the 2 candidates at most 1 go together without a pair above 0.9, whichever policy"
    assert said in "\n".join(found.verdict())


ARGUMENTS = ("--sets", "often-drives", "payload", "--episodes", "2")


def chunks():
    (file,) = Path("results").glob("choice-torque-v0/*/episodes.jsonl")
    return [json.loads(line) for line in file.read_text().splitlines()[1:]]


@pytest.mark.slow
@pytest.mark.usefixtures("in_an_empty_folder")
def test_the_choice_is_made_on_development_episodes_and_policies_can_be_added_later(capsys):
    assert choosing.main([*ARGUMENTS, "--policies", "integral", "adaptive"], "program") == 0
    first = chunks()
    assert {e["seed"] for chunk in first for e in chunk["episodes"]} == {  # type: ignore[attr-defined]
        DEVELOPMENT + SETS[name].seed + i for name in ("often-drives", "payload") for i in range(2)
    }
    page = Path("page.md")
    page.write_text("<!-- choice for Torque-v0: begin -->\n<!-- choice for Torque-v0: end -->\n")
    more = ["--policies", "integral", "adaptive", "oracle", "ppo-blind", "--page", str(page)]
    assert choosing.main([*ARGUMENTS, *more], "program") == 0
    assert chunks()[: len(first)] == first
    assert [(c["policy"], c["set"]) for c in chunks()[len(first) :]] == [
        (name, of) for of in ("often-drives", "payload") for name in ("oracle", "ppo-blind@0")
    ]
    printed, written = capsys.readouterr().out, page.read_text()
    assert "NOT met: 10 to 12 sets: 1" in printed
    for text in ("often-drives | identification", "payload | -", "| 1.00 |"):
        assert text in written
    assert re.search(r" adaptive \| [\d.]+ oracle \| ", written)  # the ceiling


@pytest.mark.usefixtures("in_an_empty_folder")
@pytest.mark.parametrize(
    ("page", "said"), [("page.md", "has no block"), ("pag.md", "no such file")]
)
def test_a_page_without_a_place_for_the_table_is_one_line_and_a_missing_one_before_any_drive(
    page, said, capsys
):
    Path("page.md").write_text("nothing\n")
    assert choosing.main([*ARGUMENTS, "--policies", "integral", "--page", page], "program") == 2
    assert said in capsys.readouterr().err.splitlines()[-1]
    assert Path("results").exists() == (page == "page.md")


@pytest.mark.usefixtures("in_an_empty_folder")
def test_candidates_are_all_sets_in_which_something_is_unknown_the_chosen_ones_first():
    found = choosing.candidates_of(TORQUE_ID, TORQUE_V3)
    assert found[: len(TORQUE_V3.sets)] == TORQUE_V3.sets
    assert set(found) == {n for n, s in SETS.items() if s.env == TORQUE_ID} - {"nominal"}
    assert "level" not in choosing.candidates_of(TERRAIN_ID, None)
    assert (
        choosing.candidates_of(TORQUE_ID, UNLIKE_SETS)[: len(UNLIKE_SETS.sets)] == UNLIKE_SETS.sets
    )


@pytest.mark.slow
@pytest.mark.usefixtures("in_an_empty_folder")
def test_the_choice_of_another_version_is_judged_where_it_is_named(capsys):
    page = Path("page.md")
    block = "choice for torque-unlike-v1"
    page.write_text(f"<!-- {block}: begin -->\n<!-- {block}: end -->\n")
    given = ["--sets", "alternating", "distributed-fast", "--episodes", "2"]
    given += ["--policies", "integral", "adaptive", "--sets-version", "torque-unlike-v1"]
    assert choosing.main([*given, "--page", str(page)], "program") == 0
    text = page.read_text()
    assert "| distributed-fast | out-of-distribution |" in text and "| alternating | - |" in text
    assert choosing.main([*given[:-1], "v9"], "program") == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "v9" in error and "torque-unlike-v1" in error
