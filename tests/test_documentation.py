"""The documentation is true: code blocks run, tables match the code, names exist."""

import re

import pytest

from tracked_env import observation as obs
from tracked_env.references import REFERENCES
from tracked_env.sensors import PRESETS, Sensors
from tracked_env.uncertainty import SOILS, UNCERTAINTY_SETS

PAGES = ["README.md", "docs/quickstart.md", "docs/index.md", "docs/register.md"]


def python_blocks(text):
    """Complete examples: Python blocks that import what they use."""
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    return [block for block in blocks if "import" in block]


@pytest.mark.parametrize("page", PAGES)
def test_every_complete_example_runs(page, repository, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = python_blocks((repository / page).read_text())
    assert blocks, f"{page} shows no example"
    for block in blocks:
        # Training budgets are for readers; here a hundredth of them shows that it runs.
        shortened = re.sub(r"learn\([\d_]+\)", "learn(64)", block)
        exec(compile(shortened, page, "exec"), {})


def test_the_observation_page_shows_the_layout_in_the_code(repository):
    assert obs.markdown_table() in (repository / "docs/observation.md").read_text()


@pytest.mark.parametrize(
    "page, names",
    [
        ("uncertainty", [*UNCERTAINTY_SETS, *SOILS]),
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
    index = (docs / "index.md").read_text()
    for block in re.findall(r"```\{toctree\}(.*?)```", index, flags=re.DOTALL):
        for line in block.split("\n"):
            if line.strip() and not line.startswith(":") and "*" not in line:
                assert (docs / f"{line.strip()}.md").exists(), line
    for page in [repository / "README.md", *docs.glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", page.read_text()):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} links to {target}"
