"""The pages `docs/own_*.md` can be followed: their files, entry points and uses run in a folder."""

import re
import shutil
import tomllib

import pytest

from tests.processes import python

# Page -> what its examples print, besides that they run. `own_algorithm`: agents/test_learner.py
PAGES = {
    "own_sensor": r"^-?\d+\.\d+",
    "own_plant": r"^(1\.0|0\.99999999\d*|1\.00000000\d*)$",
    "own_reference": r"^2\.0\n0\.28",
    "own_vehicle": r"^60\.0\n60\.0$",
    "own_set": r"(payload (nominal|adaptive) 0\.\d+\n){4}(falling-load .*\n?){4}$",
    "own_estimator": r"'belt_advance': .*'belt_advance_deviation': .*'belts_excitation': ",
    "own_controller": r"^\[0\.\d+, 0\.\d+\]",
}
LONGEST = ("own_plant", "own_set", "own_estimator", "own_controller")


def test_the_core_can_be_read_in_an_afternoon(repository):
    text = (repository / "CONTRIBUTING.md").read_text()
    files = re.findall(r"^\| `(tracked_env/[\w/]+\.py)` \|", text, flags=re.MULTILINE)
    lines = [len((repository / file).read_text().splitlines()) for file in files]
    assert len(files) == len(set(files)) == 10
    assert sum(lines) <= 3500, dict(zip(files, lines, strict=True))


def written(text, folder, examples):
    """Write the files of a page, `# name` in their first line; returns its other Python blocks.

    Files of the folder of examples to which it links are copied.
    The entry points of a pyproject.toml are those of a package that is installed in the folder.
    """
    uses = []
    for name in re.findall(r"\]\(examples/(\w+\.py)\)", text):
        shutil.copy(examples / name, folder)
    for kind, block in re.findall(r"^```(\w+)\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE):
        name = re.match(r"# (\w+\.(?:py|toml))\n", block)
        if name:
            (folder / name[1]).write_text(block)
        elif kind == "python":
            uses.append(block)
    if (folder / "pyproject.toml").exists():
        project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
        information = folder / "own-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
        groups = project["entry-points"].items()
        lines = [f"[{group}]\n{n} = {v}" for group, of in groups for n, v in of.items()]
        (information / "entry_points.txt").write_text("\n".join(lines))
    return uses


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] * (page in LONGEST)) for page in PAGES]
)
def test_what_a_page_says_works_in_a_folder_of_ones_own(page, repository, tmp_path):
    docs = repository / "docs"
    uses = written((docs / f"{page}.md").read_text(), tmp_path, docs / "examples")
    (tmp_path / "use.py").write_text("\n".join(uses))
    result = python("use.py", cwd=tmp_path, path=[tmp_path])
    assert re.search(PAGES[page], result.stdout), result.stdout
    assert "Warning" not in result.stderr


def test_each_page_is_run_and_stands_in_the_first_table(repository):
    """A page is read at a glance, its example apart; two have that in a file."""
    pages = {path.stem for path in (repository / "docs").glob("own_*.md")}
    assert pages == {*PAGES, "own_algorithm"}
    table = (repository / "CONTRIBUTING.md").read_text().partition("\n\n## ")[0]
    for page in pages:
        assert f"](docs/{page}.md)" in table
        text = (repository / f"docs/{page}.md").read_text()
        prose = re.sub(r"^```.*?^```\n", "", text, flags=re.DOTALL | re.MULTILINE)
        prose = text if page in ("own_plant", "own_algorithm") else prose
        assert len(prose.splitlines()) <= 45, page
