"""The page of tools is true: its examples run where the tool is installed, with these versions."""

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.tools import tools_page
from tests.tools.tools_page import PAGE, TESTED, TOOLS, run_section, sections

IMPOSSIBLE = {"PufferLib"}  # sections that say why not


def installed(module):
    """Whether a module, or one inside a package, is there."""
    try:
        return find_spec(module) is not None
    except ImportError:
        return False


def runnable(title):
    """Whether all that the examples of a section import is installed here."""
    files, _ = tools_page.examples(sections(PAGE.read_text())[title])
    imported = re.findall(r"^(?:import|from) (\w+)", "\n".join(files.values()), re.MULTILINE)
    return installed(TOOLS[title][1]) and all(installed(name) for name in imported)


@pytest.mark.slow
@pytest.mark.parametrize("title", TOOLS)
def test_the_examples_of_a_tool_run_as_they_stand(title, tmp_path):
    if not runnable(title):
        pytest.skip(f"{title} is not installed here; `make tools` builds an environment for it")
    run_section(Path(sys.executable), sections(PAGE.read_text())[title], tmp_path)


def test_the_table_of_versions_is_that_of_the_run():
    block = f"begin -->\n{tools_page.table(json.loads(TESTED.read_text()))}\n<!-- versions: end"
    assert block in PAGE.read_text(), "run `make tools`"


def test_every_tool_of_the_page_was_run_with_the_version_that_its_section_installs():
    tested, texts = json.loads(TESTED.read_text()), sections(PAGE.read_text())
    assert set(tested) == set(TOOLS) == set(texts) - IMPOSSIBLE
    for title, versions in tested.items():
        pins = [part.split("==") for part in tools_page.installation(texts[title]) if "==" in part]
        for name, version in pins:
            assert versions[re.sub(r"\[.*\]", "", name)] == version, title
        assert {"python", "gymnasium", "numpy"} <= set(versions), title


def test_a_section_that_fails_says_which_command_and_what_it_printed(tmp_path):
    section = "```bash\npip install x\n```\n```python\nprint('so far')\n1 / 0\n```\n"
    with pytest.raises(AssertionError, match=r"(?s)example_1.py\nso far.*ZeroDivisionError"):
        run_section(Path(sys.executable), section, tmp_path)


@pytest.fixture
def a_page_of_four(tmp_path, monkeypatch):
    """A page whose second example fails and whose third tool cannot be installed."""
    runs = "open('ran', 'a').write('.')"
    texts = {"One": runs, "Two": "1 / 0", "Three": "pass", "Four": runs}
    page, tested = tmp_path / "page.md", tmp_path / "tested.json"
    blocks = [
        f"\n## {title}\n```bash\npip install {title}\n```\n```python\n{text}\n```\n"
        for title, text in texts.items()
    ]
    page.write_text("".join(["<!-- versions: begin -->\n<!-- versions: end -->", *blocks]))
    tested.write_text(json.dumps({title: {"python": "3.1"} for title in texts}))

    def environment(arguments, folder, pip):
        if arguments == ["Three"]:
            raise subprocess.CalledProcessError(1, "pip")
        return Path(sys.executable)

    monkeypatch.setattr(tools_page, "PAGE", page)
    monkeypatch.setattr(tools_page, "TESTED", tested)
    monkeypatch.setattr(tools_page, "TOOLS", {title: (title, title) for title in texts})
    monkeypatch.setattr(tools_page, "environment_of", environment)
    return page, tested, tmp_path / "tools"


def test_a_tool_that_fails_does_not_stop_the_others_and_the_end_says_what_failed(
    a_page_of_four, capsys
):
    page, tested, folder = a_page_of_four
    assert tools_page.main(["--folder", str(folder)]) == 1
    output = capsys.readouterr().out
    assert "ZeroDivisionError" in output
    closing = [re.split(r"\s{2,}", line)[:2] for line in output.splitlines()[-4:]]
    outcomes = ("passed", "examples failed", "not installed", "passed")
    assert closing == [list(pair) for pair in zip(tools_page.TOOLS, outcomes, strict=True)]
    # An example that fails makes its row untrue; a network that fails does not.
    assert list(json.loads(tested.read_text())) == ["One", "Three", "Four"]
    assert re.findall(r"^\| \[(\w+)\]", page.read_text(), re.MULTILINE) == ["One", "Three", "Four"]


def test_every_environment_gets_the_pytorch_of_the_project(tmp_path, monkeypatch):
    words = []
    run = lambda command, **_: words.extend(map(str, command))  # noqa: E731
    monkeypatch.setattr(tools_page.venv, "create", lambda path, **_: path.mkdir(parents=True))
    monkeypatch.setattr(tools_page.subprocess, "run", run)
    tools_page.environment_of(["x", "/path/to/tracked-env[rl]"], tmp_path, ["--extra"])
    constraint = Path(words[words.index("-c") + 1]).read_text()
    assert constraint.strip() in (tools_page.ROOT / "constraints.txt").read_text().splitlines()
    assert constraint.startswith("torch==")
    assert words[-3:] == ["x", "-e", f"{tools_page.ROOT}[rl]"] and "--extra" in words
