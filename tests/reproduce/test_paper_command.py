"""The command that runs a paper: progress, claims and page, with a made-up paper of one claim."""

import sys
import types
from typing import get_args, get_type_hints

import pytest
from matplotlib.figure import Figure

import evaluate
import reproduce
from reproduce import Outcome, PaperPage

WORDS = {
    "head": "# Made up\n",
    "claims": {"one": {"place": "1", "claim": "two and one", "ours": "{count}", "why": "counted"}},
    "tables": {"numbers": {"title": "Numbers", "text": "All.", "head": ["number"]}},
    "figures": {"line": "A line."},
}


@pytest.fixture
def paper(monkeypatch):
    """A paper whose result is the number 3."""
    module = types.ModuleType("reproduce.made_up")

    def run_everything(say):
        say("section 1: counting")
        return 3

    module.run_everything = run_everything
    module.PAGE = PaperPage(
        "made-up",
        WORDS,
        lambda results: [Outcome("one", "yes", {"count": results})],
        {"numbers": lambda results: [[f"{results}"]]},
        (lambda results: {"line": Figure()},),
    )
    monkeypatch.setitem(sys.modules, "reproduce.made_up", module)
    return module


def test_a_paper_is_run_its_claims_printed_and_its_page_written(paper, tmp_path, capsys):
    assert reproduce.main("made_up", tmp_path) == 0
    output = capsys.readouterr().out
    assert (
        output.index("section 1: counting")
        < output.index("two and one")
        < output.index("1 figures")
    )
    text = (tmp_path / "made_up" / "page.md").read_text(encoding="utf-8")
    assert "| 1 | two and one | 3 | yes | counted |" in text
    assert text.startswith("# Made up\n")
    assert text.index("![line](made-up-line.png)") < text.index("### Numbers")
    assert (tmp_path / "made_up" / "made-up-line.png").stat().st_size > 0


def test_without_figures_nothing_is_drawn(paper, tmp_path, capsys):
    assert reproduce.main("made_up", tmp_path, figures=False) == 0
    assert "0 figures" in capsys.readouterr().out
    assert not list(tmp_path.rglob("*.png"))
    assert "## Figures" not in (tmp_path / "made_up" / "page.md").read_text(encoding="utf-8")


def test_evaluate_and_the_folders_offer_the_same_papers(repository):
    offered = get_args(get_type_hints(evaluate.Config)["paper"])
    folders = {path.parent.name for path in (repository / "reproduce").glob("*/page.toml")}
    assert set(offered) - {"none"} == folders


def test_evaluate_hands_a_paper_to_the_command(monkeypatch, tmp_path):
    calls = []
    monkeypatch.setattr(reproduce, "main", lambda *arguments: calls.append(arguments) or 0)
    assert evaluate.main(evaluate.Config(paper="focchi2025", output=tmp_path, figures=False)) == 0
    assert calls == [("focchi2025", tmp_path, False)]
