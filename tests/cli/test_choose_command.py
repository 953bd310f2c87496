"""`tracked-env choose-sets`: a table of what the candidates separate, continued where it ended."""

import json
import re
from pathlib import Path

import pytest

from tracked_env import TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark.sets import SETS, TORQUE_SETS
from tracked_env.benchmark.splits import DEVELOPMENT
from tracked_env.cli.choose_command import candidates
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
    found = candidates(TORQUE_ID)
    assert found[: len(TORQUE_SETS.sets)] == TORQUE_SETS.sets
    assert set(found) == {n for n, s in SETS.items() if s.env == TORQUE_ID} - {"nominal"}
    assert "level" not in candidates(TERRAIN_ID)
