"""The documentation is true: code blocks run, tables match the code, names exist."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from docs.generated_pages import SECTIONS
from tests import check_pages
from tracked_env import observation as obs
from tracked_env.benchmark import BenchmarkConfig, Store, load_policy, run
from tracked_env.references import REFERENCES
from tracked_env.sensors import PRESETS, Sensors
from tracked_env.uncertainty import SOILS, known_laws

ROOT = Path(__file__).resolve().parent.parent
# Examples that need what the commands between them have written
# (tests/baselines/identify/test_user_logs.py). What the pages `own_*` register ends with a process
# (test_contributing).
BESIDE = ("your_data.md",)
# Behind it are examples that need what is not installed beside this package (tests/tools).
TOOLS = "<!-- versions: begin -->"
PAGES = [
    str(path.relative_to(ROOT))
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    if "```python" in path.read_text()
    and path.name not in BESIDE
    and not path.name.startswith("own_")
    and "_generated" not in path.parts
]
# Budgets are for readers; here a small part of them shows that it runs.
BUDGETS = {
    r"learn\([\d_]+\)": "learn(64)",
    r"\bepisodes=\d+": "episodes=2",
    r"\bn_steps=\d+": "n_steps=16",
    r"\bsteps=[\d_]+": "steps=512",
}


def python_blocks(text):
    """The Python examples of a page, in order."""
    return re.findall(r"^```python\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


def test_no_example_uses_a_name_that_it_does_not_define(repository, tmp_path):
    """Each block of each page by itself, also of pages whose libraries are not installed."""
    for path in (*repository.glob("*.md"), *(repository / "docs").rglob("*.md")):
        for number, block in enumerate(python_blocks(path.read_text()), 1):
            (tmp_path / f"{path.stem}-{number}.py").write_text(block)
    assert len(list(tmp_path.glob("*.py"))) > 50
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", "--select", "F821"]
    result = subprocess.run([*ruff, "."], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout


def test_configuration_files_on_the_pages_can_be_read(repository):
    read = {"toml": tomllib.loads, "yaml": yaml.safe_load}
    for path in (*repository.glob("*.md"), *(repository / "docs").rglob("*.md")):
        blocks = re.findall(
            r"^```(toml|yaml)\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE
        )
        for kind, block in blocks:
            assert read[kind](block), path.name


LONGEST = ("docs/compare.md", "docs/planners.md", "docs/register.md")


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[pytest.mark.slow] * (page in LONGEST)) for page in PAGES]
)
def test_every_example_runs(page, repository, tmp_path, monkeypatch):
    """Blocks run in order; one that begins with `# name.py` is also a module for the others."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    if page == "docs/deploy.md":
        pytest.importorskip("onnxruntime", reason="its example needs the extra `export`")
    blocks = python_blocks((repository / page).read_text().partition(TOOLS)[0])
    assert blocks, f"{page} shows no example"
    try:
        for block in blocks:
            for budget, small in BUDGETS.items():
                block = re.sub(budget, small, block)
            if name := re.match(r"# (\w+\.py)\n", block):
                (tmp_path / name[1]).write_text(block)
            exec(compile(block, page, "exec"), {})
    finally:
        for path in tmp_path.glob("*.py"):
            sys.modules.pop(path.stem, None)


def test_an_agent_trained_as_on_its_page_is_compared_as_on_the_other(
    repository, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    train = python_blocks((repository / "docs/train.md").read_text())[1]
    assert "VecNormalize" in train
    for budget, small in BUDGETS.items():
        train = re.sub(budget, small, train)
    exec(compile(train, "train.md", "exec"), {})
    wrap = python_blocks((repository / "docs/compare.md").read_text())[0]
    assert wrap.startswith("# my_agent.py")
    (tmp_path / "my_agent.py").write_text(wrap)
    config = BenchmarkConfig(sets=("payload",), episodes=2, duration=1.0)
    try:
        entry = load_policy("my_agent:agent", {})
        records = run(config, [entry], Store(tmp_path / "results", config.identity()))
    finally:
        sys.modules.pop("my_agent", None)
    assert [record["policy"] for record in records] == ["my_agent:agent"] * 2
    assert all(record["tracking_rmse"] > 0.0 for record in records)


def test_the_observation_page_shows_the_layout_in_the_code(repository):
    assert obs.markdown_table() in (repository / "docs/observation.md").read_text()


@pytest.mark.parametrize(
    "page, names",
    [
        ("uncertainty", [*known_laws(), *SOILS]),
        ("references", REFERENCES),
        ("sensors", [*PRESETS, *(n for n in Sensors._fields if n.endswith(("_noise", "_bias")))]),
    ],
)
def test_every_name_of_a_catalogue_is_on_its_page(page, names, repository):
    text = (repository / f"docs/{page}.md").read_text()
    missing = [name for name in names if f"`{name}`" not in text]
    assert not missing


def test_every_page_of_the_table_of_contents_exists_and_links_resolve(repository):
    docs = repository / "docs"
    # Made when the pages are built; `test_built_documentation` follows these links.
    made = {docs / "api" / f"{name}.md" for name in ("index", *(one.file for one in SECTIONS))}
    index = (docs / "index.md").read_text()
    for block in re.findall(r"```\{toctree\}(.*?)```", index, flags=re.DOTALL):
        for line in block.split("\n"):
            if line.strip() and not line.startswith(":") and "*" not in line:
                entries = docs / f"{line.strip()}.md"
                assert entries.exists() or entries in made, line
    named = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md")
    pages = [page for page in docs.rglob("*.md") if "_generated" not in page.parts]
    for page in [*(repository / name for name in named), *pages]:
        text = without_code(page)
        for target, place in re.findall(r"\]\(([^)#]*?)(?:#([^)]*))?\)", text):
            if "://" in target:
                continue
            other = page.parent / target if target else page
            assert other.exists() or other in made, f"{page.name} links to {target}"
            if place:
                assert place in anchors(other, repository), f"{page.name}: {target}#{place}"


def without_code(page):
    """Text of a page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)


def anchors(page, repository):
    """Headings of a page as links name them; Sphinx knows those down to a level of conf.py."""
    conf = (repository / "docs" / "conf.py").read_text()
    level = int(re.search(r"^myst_heading_anchors = (\d)$", conf, re.MULTILINE)[1])
    headings = re.findall(rf"^#{{1,{level}}} (.*)$", without_code(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", one.lower()).replace(" ", "-") for one in headings}


def test_a_page_is_read_in_one_go():
    assert check_pages.page_faults(check_pages.pages(), check_pages.user_pages()) == []


def test_all_pages_together_are_a_short_book():
    assert check_pages.whole_faults(check_pages.pages(), check_pages.user_pages()) == []


def test_words_are_those_by_hand_and_a_sentence_ends_with_its_item():
    text = """# A title

One [link](to/a/page.md) and `code` and $x$. It ends:

- a first item
- a second

| a | table |
<!-- t: begin -->
| made | by | code |
<!-- t: end -->

```python
not = counted
```
"""
    page = check_pages.measured(text)
    assert (page.words, page.sentences, page.long) == (2 + 6 + 2 + 3 + 2 + 2, 5, 0)
    long = check_pages.measured(" ".join(["word"] * 36) + ". Short.")
    assert (long.sentences, long.long) == (2, 1)


def test_short_words_in_short_sentences_are_easier_to_read():
    easy, hard = (
        check_pages.measured(text).ease for text in ("We go.", "Identifiability matters.")
    )
    assert easy > 100.0 > hard
    assert [*map(check_pages.syllables, ("table", "made", "soil", "42"))] == [2, 1, 1, 1]
