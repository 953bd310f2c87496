"""The page of tools is true: its examples run where the tool is installed, with these versions."""

import json
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.tools.tools_page import (
    PAGE,
    TESTED,
    TOOLS,
    examples,
    installation,
    run_section,
    sections,
    with_table,
)

IMPOSSIBLE = {"PufferLib"}  # sections that say why not


def installed(module):
    """Whether a module, or one inside a package, is there."""
    try:
        return find_spec(module) is not None
    except ImportError:
        return False


def runnable(title):
    """Whether all that the examples of a section import is installed here."""
    files, _ = examples(sections(PAGE.read_text())[title])
    imported = re.findall(r"^(?:import|from) (\w+)", "\n".join(files.values()), re.MULTILINE)
    return installed(TOOLS[title][1]) and all(installed(name) for name in imported)


@pytest.mark.parametrize("title", TOOLS)
def test_the_examples_of_a_tool_run_as_they_stand(title, tmp_path):
    if not runnable(title):
        pytest.skip(f"{title} is not installed here; `make tools` builds an environment for it")
    run_section(Path(sys.executable), sections(PAGE.read_text())[title], tmp_path)


def test_the_table_of_versions_is_that_of_the_run():
    text = PAGE.read_text()
    assert with_table(text, json.loads(TESTED.read_text())) == text, "run `make tools`"


def test_every_tool_of_the_page_was_run_with_the_version_that_its_section_installs():
    tested, found = json.loads(TESTED.read_text()), sections(PAGE.read_text())
    assert set(tested) == set(TOOLS) == set(found) - IMPOSSIBLE
    for title, versions in tested.items():
        pins = [part.split("==") for part in installation(found[title]) if "==" in part]
        for name, version in pins:
            assert versions[re.sub(r"\[.*\]", "", name)] == version, title
        assert {"python", "gymnasium", "numpy"} <= set(versions), title


def test_a_section_that_fails_says_which_command_and_what_it_printed(tmp_path):
    section = "```bash\npip install x\n```\n```python\nprint('so far')\n1 / 0\n```\n"
    with pytest.raises(AssertionError, match=r"(?s)example_1.py\nso far.*ZeroDivisionError"):
        run_section(Path(sys.executable), section, tmp_path)
