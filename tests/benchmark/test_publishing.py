"""The tables of README.md, docs/results.md, docs/boards.md and docs/speed.md come from scripts."""

import json
import re
import sys

import pytest

from tests.benchmark.test_leaderboard import ALL, board, script
from tests.benchmark.test_report import records
from tracked_env.benchmark import report
from tracked_env.benchmark.files import replace_block

TRACKS = ("Torque-v0", "Speed-v0", "Terrain-v0")
# A ratio of errors in prose is written with its interval, as a table of the page has it:
# `0.94 [0.90, 0.98] of the error`. UNCERTAIN finds one without: `3.6 times the error`,
# `6 % better`, `a factor of 2`. It does not find words (half of the error) and lone numbers (1.02
# and 0.96); limits (more than 5 % better) and ratios of no error (times the action rate) it leaves.
NUMBER = r"(?<![\d.])\d+(?:\.\d+)?"
INTERVAL = rf"{NUMBER} \[{NUMBER}, {NUMBER}\]"
UNCERTAIN = (
    rf"(?<!more than ){NUMBER} % (?:of the error|less|more|better|worse|ahead|behind|closer)"
    rf"|{NUMBER} (?:of the error|times(?! (?:the|its) (?:action rate|traction)))"
    rf"|factor of {NUMBER}(?! \[)"
)


def block(path, name):
    """What stands between the markers `name` of a page."""
    (found,) = re.findall(
        f"<!-- {name}: begin -->\n(.*?)\n<!-- {name}: end -->", path.read_text(), flags=re.DOTALL
    )
    return str(found)


def pages(root):
    """Pages with empty blocks, and the folders of the agents and of the figure."""
    (root / "docs" / "_static").mkdir(parents=True)
    of_pages = {"docs/boards.md": "", "docs/results.md": "short ", "README.md": "short "}
    for name, prefix in of_pages.items():
        marks = [f"<!-- {prefix}leaderboard of {t}: {{}} -->" for t in TRACKS]
        (root / name).write_text("\n".join(f"{m.format('begin')}{m.format('end')}" for m in marks))
    (root / "agents" / "pretrained").mkdir(parents=True)


def test_the_readme_is_at_most_150_lines_long(repository):
    assert (repository / "README.md").read_text().count("\n") <= 150


@pytest.mark.parametrize("track", TRACKS)
def test_readme_and_results_have_five_columns_of_the_board(track, repository):
    board = block(repository / "docs" / "boards.md", f"leaderboard of {track}").split("\n\n")[0]
    results = block(repository / "docs" / "results.md", f"short leaderboard of {track}")
    readme = block(repository / "README.md", f"short leaderboard of {track}")
    own = [row for row in results.split("\n") if "-true-motion" not in row]
    assert readme.split("\n") == own[:10]  # two of head, eight policies
    head, _, *rows = results.split("\n")
    assert head == "| error | after 5 s | policy | success | call [us] |"
    of_board = [[cell.strip() for cell in row.split("|")[1:-1]] for row in board.split("\n")]
    names, _, *full = of_board
    for row, entry in zip(rows, full, strict=True):
        cells, told = (
            [c.strip() for c in row.split("|")[1:-1]],
            dict(zip(names, entry, strict=True)),
        )
        assert cells[:3] == [told["error"], told["after 5 s"], told["policy"]]
        failures, success = float(told["failures"][:-2]), float(cells[3][:-2])
        assert failures + success == pytest.approx(100.0, abs=0.11)
    assert (repository / "docs" / "_static" / f"results-{track.lower()}.png").exists()


def test_publishing_writes_one_board_into_three_pages_and_leaves_the_rest(
    repository, tmp_path, monkeypatch
):
    publishing = script(repository, "publish")
    monkeypatch.setattr(publishing, "ROOT", tmp_path)
    monkeypatch.setattr(publishing, "PRETRAINED", tmp_path / "agents" / "pretrained")
    pages(tmp_path)
    found, _ = board("payload", **ALL)
    (tmp_path / "leaderboard.json").write_text(json.dumps(report.document(found)))
    (tmp_path / "results.json").write_text(json.dumps({"episodes": records("payload", **ALL)}))
    monkeypatch.setattr(sys, "argv", ["publish.py", str(tmp_path)])
    assert publishing.main() == 0
    full = block(tmp_path / "docs" / "boards.md", "leaderboard of Torque-v0")
    assert re.search(r"^\| 1 \| ppo \| [^|]+ \| better \| .* \| 5 \| ", full, re.M)
    assert "| `payload` |" in full
    shown = block(tmp_path / "docs" / "results.md", "short leaderboard of Torque-v0")
    assert shown == block(tmp_path / "README.md", "short leaderboard of Torque-v0")
    assert re.search(r"^\| 0\.\d\d \[.*\| ppo \| \d+\.\d % \| - \|$", shown, re.M)
    assert (tmp_path / "docs" / "_static" / "results-torque-v0.png").stat().st_size > 5000
    text = (tmp_path / "README.md").read_text()
    assert "<!-- short leaderboard of Speed-v0: begin --><!-- short leaderboard of Spe" in text
    assert publishing.main() == 0
    assert (tmp_path / "README.md").read_text() == text


def test_another_version_of_the_sets_is_published_beside_the_default_one(
    repository, tmp_path, monkeypatch, capsys
):
    publishing = script(repository, "publish")
    monkeypatch.setattr(publishing, "ROOT", tmp_path)
    pages(tmp_path)
    found, _ = board("payload", **ALL)
    (tmp_path / "leaderboard.json").write_text(json.dumps(report.document(found)))
    monkeypatch.setattr(sys, "argv", ["publish.py", str(tmp_path)])
    results = tmp_path / "docs" / "boards.md"
    mark = "<!-- leaderboard of torque-unlike-v1: {} -->"
    results.write_text(results.read_text() + mark.format("begin") + mark.format("end"))
    readme = (tmp_path / "README.md").read_text()
    for version, status in (("torque-unlike-v1", 0), ("v2", 2)):
        document = {"benchmark": {"version": version}, "episodes": records("payload", **ALL)}
        (tmp_path / "results.json").write_text(json.dumps(document))
        assert publishing.main() == status
    assert "leaderboard of v2" in capsys.readouterr().err  # no such block: nothing is overwritten
    assert "| 1 | ppo |" in block(results, "leaderboard of torque-unlike-v1")
    assert (
        "leaderboard of Torque-v0: begin --><!-- leaderboard of Torque-v0: end"
        in results.read_text()
    )
    assert (tmp_path / "README.md").read_text() == readme
    assert not list((tmp_path / "agents" / "pretrained").iterdir())


def prose_and_tables(text):
    """The sentences of a page, without code and what scripts write, in one line; and its tables."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    tables = "\n".join(re.findall(r"^\|.*", text, re.MULTILINE))
    text = re.sub(r"<!-- (.*?): begin -->.*?<!-- \1: end -->", "", text, flags=re.DOTALL)
    prose = re.sub(r"^\|.*|`[^`]*`|\]\([^)]*\)", "", text, flags=re.MULTILINE)
    return re.sub(r"\s+", " ", prose), tables


def uncertain(text):
    """Ratios in the prose of a page without an interval, or with one that no table of it has."""
    prose, tables = prose_and_tables(text)
    quoted, printed = re.findall(INTERVAL, prose), re.findall(INTERVAL, tables)
    brackets = re.findall(rf".{{8}}\[{NUMBER}, {NUMBER}\]", prose)
    other = [one for one in brackets if not re.search(INTERVAL, one)]
    return re.findall(UNCERTAIN, prose) + [one for one in quoted if one not in printed] + other


@pytest.mark.parametrize("page", ["results", "what_it_shows"])
def test_a_ratio_in_prose_stands_with_an_interval_of_a_table_of_its_page(page, repository):
    text = (repository / "docs" / f"{page}.md").read_text()
    assert uncertain(text) == []
    assert len(re.findall(INTERVAL, prose_and_tables(text)[0])) >= 3


@pytest.mark.parametrize(
    ("sentence", "count"),
    [
        ("has 0.94 [0.90, 0.98]\nof the error, more than 5 % better, 2.6 times the action rate", 0),
        ("`x` has 3.6 times\nthe error, `y` 34 % more error, both a factor of 2", 3),
        ("has 0.94 of the error, 6 % better or 7 % worse", 3),
        ("has 0.95 [0.90, 0.98] and 0.94 [0.90, 0.99]", 2),
        ("has 6 % [2, 10] less error", 1),
        ("```\n5 % better\n```\n<!-- x: begin -->\n5 % better\n<!-- x: end -->\n| 5 % better |", 0),
    ],
)
def test_ratios_without_an_interval_are_found(sentence, count):
    assert len(uncertain(f"| x | 0.94 [0.90, 0.98] |\n\n{sentence}\n")) == count


@pytest.mark.parametrize(
    "text",
    [
        "nothing",
        "<!-- x: begin -->",
        "<!-- x: end --> <!-- x: begin -->",
        2 * "<!-- x: begin --><!-- x: end -->",
    ],
)
def test_a_page_without_its_block_is_refused_and_stays(text, tmp_path):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(ValueError, match=r"page.md has no block between <!-- x: begin"):
        replace_block(page, "x", "new")
    assert page.read_text() == text


def test_measured_speeds_are_published_between_the_markers(repository, tmp_path, monkeypatch):
    speed = script(repository, "speed")
    block(repository / "docs" / "speed.md", "speed table")  # the page has one
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "speed.md"
    page.write_text("before\n<!-- speed table: begin -->\nold\n<!-- speed table: end -->\nafter\n")
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    monkeypatch.setattr(speed, "start_up", lambda: "")
    monkeypatch.setattr(speed, "rows", lambda registered: [speed.Row("a", 1, "a", None)])
    monkeypatch.setattr(speed, "measure", lambda row, seconds: (2.0, 1))
    monkeypatch.setattr(speed, "training", lambda: (2.0, 1))
    monkeypatch.setattr(sys, "argv", ["speed.py"])
    speed.main()
    assert "\nold\n" in page.read_text()
    monkeypatch.setattr(sys, "argv", ["speed.py", "--publish"])
    speed.main()
    assert "| a | 1 | 2.000 | 500,000 | 1.00 | a |" in block(page, "speed table")
    assert page.read_text().startswith("before\n") and page.read_text().endswith("\nafter\n")
