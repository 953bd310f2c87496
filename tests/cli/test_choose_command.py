"""`tracked-env choose-sets`: a table of what the candidates separate, continued where it ended."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.studies.choose_sets import candidates
from tracked_env import TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.evaluation_sets import DEVELOPMENT, SETS, TORQUE_SETS, UNLIKE_SETS
from tracked_env.cli.main import main

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")

ARGUMENTS = ("choose-sets", "--sets", "alternating", "payload", "--episodes", "2")


def chunks() -> list[dict[str, object]]:
    (file,) = Path("results").glob("choice-torque-v0/*/episodes.jsonl")
    return [json.loads(line) for line in file.read_text().splitlines()[1:]]


def test_the_choice_is_made_on_development_episodes_and_policies_can_be_added_later(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*ARGUMENTS, "--policies", "integral", "adaptive"]) == 0
    first = chunks()
    assert {e["seed"] for chunk in first for e in chunk["episodes"]} == {  # type: ignore[attr-defined]
        DEVELOPMENT,
        DEVELOPMENT + 1,
    }
    page = Path("page.md")
    page.write_text("<!-- choice for Torque-v0: begin -->\n<!-- choice for Torque-v0: end -->\n")
    more = ["--policies", "integral", "adaptive", "oracle", "ppo-blind", "--page", str(page)]
    assert main([*ARGUMENTS, *more]) == 0
    assert chunks()[: len(first)] == first
    assert [(c["policy"], c["set"]) for c in chunks()[len(first) :]] == [
        (name, of) for of in ("alternating", "payload") for name in ("oracle", "ppo-blind@0")
    ]
    printed, written = capsys.readouterr().out, page.read_text()
    assert "NOT met: 10 to 12 sets: 1" in printed
    for text in ("alternating | identification", "payload | -", "| 1.00 |"):
        assert text in written
    assert re.search(r" adaptive \| [\d.]+ oracle \| ", written)  # the ceiling


def test_a_page_without_a_place_for_the_table_is_one_line_on_stderr(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("page.md").write_text("nothing\n")
    arguments = [*ARGUMENTS, "--policies", "integral", "--page", "page.md"]
    assert main(arguments) == 2
    assert "has no block" in capsys.readouterr().err.splitlines()[-1]


def test_a_page_that_does_not_exist_is_told_before_anything_is_driven(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([*ARGUMENTS, "--policies", "integral", "--page", "pag.md"]) == 2
    error = capsys.readouterr().err
    assert "--page pag.md: no such file" in error and error.count("\n") == 1
    assert not Path("results").exists()


def test_candidates_are_all_sets_in_which_something_is_unknown_the_chosen_ones_first() -> None:
    found = candidates(TORQUE_ID, TORQUE_SETS)
    assert found[: len(TORQUE_SETS.sets)] == TORQUE_SETS.sets
    assert set(found) == {n for n, s in SETS.items() if s.env == TORQUE_ID} - {"nominal"}
    assert "level" not in candidates(TERRAIN_ID, None)
    assert candidates(TORQUE_ID, UNLIKE_SETS)[: len(UNLIKE_SETS.sets)] == UNLIKE_SETS.sets


def test_the_choice_of_another_version_is_judged_where_it_is_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = Path("page.md")
    block = "choice for torque-unlike-v1"
    page.write_text(f"<!-- {block}: begin -->\n<!-- {block}: end -->\n")
    given = ["choose-sets", "--sets", "alternating", "distributed-fast", "--episodes", "2"]
    given += ["--policies", "integral", "adaptive", "--sets-version", "torque-unlike-v1"]
    assert main([*given, "--page", str(page)]) == 0
    text = page.read_text()
    assert "| distributed-fast | out-of-distribution |" in text and "| alternating | - |" in text
    assert main([*given[:-1], "v9"]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert "v9" in error and "torque-unlike-v1" in error
