"""CONTRIBUTING.md can be followed: each section's file and its use run in an own folder."""

import os
import re
import subprocess
import sys

import pytest

from tests.test_documentation import python_blocks
from tests.tools.tools_page import sections

# Section -> what its last block prints, besides that it runs.
SECTIONS = {
    "a sensor channel": r"^-?\d+\.\d+",
    "an observation group": r"^\d{4,5}\.\d+",
    "a plant": r"^0\.\d+",
    "an uncertainty set": r"(payload (nominal|adaptive) 0\.\d+\n){4}(falling-load .*\n?){4}$",
    "an estimator": r"'belt_advance': .*'belt_advance_deviation': .*'belts_excitation': ",
    "a controller": r"^\[0\.\d+, 0\.\d+\]",
}


def test_the_core_can_be_read_in_an_afternoon(repository):
    text = (repository / "CONTRIBUTING.md").read_text().partition("## How to add")[0]
    files = re.findall(r"^\| `(tracked_env/[\w/]+\.py)` \|", text, flags=re.MULTILINE)
    lines = [len((repository / file).read_text().splitlines()) for file in files]
    assert len(files) == len(set(files)) == 10
    assert sum(lines) <= 3500, dict(zip(files, lines, strict=True))


LONGEST = ("a plant", "an uncertainty set", "an estimator", "a controller")


@pytest.mark.parametrize(
    "what", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONGEST)) for name in SECTIONS]
)
def test_what_a_section_says_works_in_a_folder_of_ones_own(what, repository, tmp_path):
    texts = sections((repository / "CONTRIBUTING.md").read_text())
    blocks = python_blocks(texts[f"How to add {what}"])
    files = [block for block in blocks if block.startswith("# ")]
    assert len(files) == 1 and len(blocks) == 2  # one file with its registration, and its use
    (tmp_path / files[0].split()[1]).write_text(files[0])
    (tmp_path / "use.py").write_text(blocks[1])
    path = os.pathsep.join([str(tmp_path), str(repository)])
    result = subprocess.run(
        [sys.executable, "use.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert result.returncode == 0, result.stderr
    assert re.search(SECTIONS[what], result.stdout), result.stdout
    assert "Warning" not in result.stderr
