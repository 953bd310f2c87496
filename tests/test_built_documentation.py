"""The built pages: no warning, no dead link, tables on the pages of the ids, all that is public."""

import ast
import os
import re
import subprocess
import sys
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import gymnasium
import pytest

from docs.gallery import FOLDER, pictures
from docs.generated_pages import IDS, restructured
from tracked_env.env import TrackedVehicleEnv

PUBLIC = ("tracked_env", "baselines")
# Not for other projects: the core behind the environments, and the command line.
INTERNAL = ("tracked_env.engine", "tracked_env.cli", "tracked_env.entry_points")


class Page(NamedTuple):
    """What a page holds."""

    anchors: set[str]
    links: list[str]
    cells: set[str]  # texts of `code` in the cells of its tables
    loaded: list[str]  # what a browser fetches to show it: scripts, styles, pictures, frames


def page_of(text):
    """What a page of HTML holds."""
    parser = pytest.importorskip("bs4", reason="pages are read with the extra `docs`")
    soup = parser.BeautifulSoup(text, "html.parser")

    def values(*names):
        return [tag[name] for tag in soup.find_all(True) for name in names if tag.get(name)]

    cells = {code.get_text() for code in soup.select("td code")}
    styles = [tag["href"] for tag in soup.find_all("link", href=True)]
    return Page({*values("id", "name")}, values("href", "src"), cells, values("src") + styles)


def pages_of(folder):
    """Every HTML page that the documentation wrote; the replay is a program, not a page."""
    paths = (path for path in sorted(folder.rglob("*.html")) if path.name != "replay.html")
    return {path.resolve(): page_of(path.read_text(encoding="utf-8")) for path in paths}


def dead_links(folder, pages):
    """Links, pictures and scripts of the pages of a folder that lead to nothing inside it."""
    dead = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            page_there, place = pages.get(target), unquote(parts.fragment)
            lost = page_there and place and place not in page_there.anchors
            if lost or not target.is_file():
                dead.append(f"{path.relative_to(folder.resolve())}: {link}")
    return dead


def public_names(root):
    """Classes and functions with a docstring of every module that other projects may call."""
    names = set()
    for path in (one for package in PUBLIC for one in (root / package).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if module.startswith(INTERNAL):
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, (ast.ClassDef, ast.FunctionDef)) or node.name[0] == "_":
                continue
            if ast.get_docstring(node):
                names.add(f"{module}.{node.name}")
    return names


def info_keys(env_id):
    """Keys of `info` after a step."""
    env = gymnasium.make(env_id, expose_truth=True)
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[4]
    env.close()
    return set(info)


@pytest.fixture(scope="module")
def built(repository, tmp_path_factory):
    """The documentation, built once: folder, what its pages hold, and how the build ended."""
    pytest.importorskip("furo", reason="building the pages needs the extra `docs`")
    folder = tmp_path_factory.mktemp("documentation")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
    command += ["-D", "nb_execution_in_temp=1"]  # who downloads a notebook has no clone
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    environment.pop("MPLBACKEND", None)  # figures stand in the notebooks
    result = subprocess.run(
        [*command, "-d", str(folder / "trees"), "docs", str(folder / "html")],
        cwd=repository, capture_output=True, text=True, timeout=1800, env=environment,
    )  # fmt: skip
    return folder / "html", pages_of(folder / "html"), result


@pytest.mark.slow
def test_the_documentation_builds_without_warnings_links_and_shows_what_the_code_has(
    repository, built
):
    html, pages, result = built
    assert result.returncode == 0, result.stderr
    assert dead_links(html, pages) == []
    for page, env_id in IDS.items():
        cells = pages[(html / "environments" / f"{page}.html").resolve()].cells
        env = gymnasium.make(env_id)
        names = set(env.unwrapped.layout.names)  # type: ignore[attr-defined]
        assert names <= cells, f"{env_id}: {names - cells}"
        heads = ("reward_", "ended_", "is_", "truth", "reference_scale")
        keys = {cell for cell in cells if cell.startswith(heads)}
        assert keys | {"tracking_error"} == info_keys(env_id), env_id
        defaults = gymnasium.spec(env_id).kwargs
        assert {*defaults, "uncertainty", "duration"} <= cells
        assert all(f'"{v}"' in cells for v in defaults.values() if isinstance(v, str)), env_id
    api = (html / "api").resolve()
    anchors = {a for path, page in pages.items() if api in path.parents for a in page.anchors}
    assert public_names(repository) - anchors == set()
    landing = (html / "index.html").read_text(encoding="utf-8")
    assert "mpc-adaptive" in landing and "policy-adaptive" in landing


@pytest.mark.slow
def test_the_pages_are_read_without_a_network(built):
    """A browser fetches nothing from elsewhere, and shows formulas itself."""
    html, pages, _ = built
    outside = re.compile(r"(https?:)?//")
    assert not {link for page in pages.values() for link in page.loaded if outside.match(link)}
    styles = [path.read_text(encoding="utf-8") for path in html.rglob("*.css")]
    assert styles and not [text for text in styles if re.search(r"url\(.?(https?:)?//", text)]
    text = (html / "physics.html").read_text(encoding="utf-8")
    assert text.count("<math ") > 20 and "\\frac" not in text


@pytest.mark.slow
@pytest.mark.parametrize("page", ["adaptive_control", "train_and_compare"])
def test_the_notebook_of_a_tutorial_has_the_cells_of_its_page_and_runs(page, repository, built):
    """What the page offers to download is made from the page, and runs from its first cell on."""
    nbformat = pytest.importorskip("nbformat", reason="notebooks are made by the extra `docs`")
    html, _, _ = built
    (file,) = html.glob(f"_downloads/*/{page}.ipynb")
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    text = (repository / f"docs/tutorials/{page}.md").read_text()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.source for cell in cells] == [
        cell.strip()
        for cell in re.findall(r"^```\{code-cell\} ipython3\n(.*?)^```", text, re.S | re.M)
    ]
    assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
    outputs = [output for cell in cells for output in cell.outputs]
    assert sum("image/png" in output.get("data", ()) for output in outputs) >= 4
    assert not [output for output in outputs if output.output_type == "error"]
    values = [output for output in outputs if output.output_type == "execute_result"]
    assert not values, "a cell ends with an expression, whose value a reader would see"


@pytest.mark.parametrize(
    ("text", "dead"),
    [
        ('<a href="b.html">b</a>', []),
        ('<a href="b.html#here">b</a>', []),
        ('<a href="b.html#there">b</a>', ["a.html: b.html#there"]),
        ('<a href="c.html">c</a>', ["a.html: c.html"]),
        ('<a href="#there">b</a>', ["a.html: #there"]),
        ('<img src="p.png">', ["a.html: p.png"]),
        ('<a href="https://example.org/c.html">c</a>', []),
    ],
)
def test_a_link_that_leads_to_nothing_is_found(text, dead, tmp_path):
    (tmp_path / "a.html").write_text(text)
    (tmp_path / "b.html").write_text('<p id="here">b</p>')
    assert dead_links(tmp_path, pages_of(tmp_path)) == dead


def test_what_a_browser_fetches_is_told_from_what_a_reader_may_open():
    text = '<a href="https://a.b"></a><script src="//c.d/e.js"></script><link href="f.css">'
    assert page_of(text).loaded == ["//c.d/e.js", "f.css"]


def test_only_code_in_the_cells_of_a_table_counts_as_an_entry():
    page = page_of("<pre>| <code>a</code> |</pre><table><tr><td><code>b</code> c</td></tr></table>")
    assert page.cells == {"b"}


@pytest.mark.parametrize(
    ("docstring", "expected"),
    [
        ("The `mass` [kg].", "The \\ ``mass``\\  [kg]."),
        ("Of v_ and |x|.", "Of v\\_ and \\|x\\|."),
        ("With\n    a = b\nit ends.", "With\n\n.. code-block:: text\n\n       a = b\n\nit ends."),
        ("* one\n  more\n* two", "* one\n  more\n\n* two"),
    ],
)
def test_a_docstring_keeps_its_formulas_lists_and_code(docstring, expected):
    assert restructured(docstring) == expected


def test_the_class_docstring_of_the_environment_is_markdown_without_indentation():
    doc = TrackedVehicleEnv.__doc__ or ""
    lines = doc.split("\n")
    assert "## Action Space" in lines and "## Info" in lines
    assert not [line for line in lines if line.startswith(" ")]
    rows = [line for line in lines if line.startswith("|")]
    assert len(rows) > 40 and all(row.endswith("|") for row in rows)


def test_the_gallery_has_a_picture_of_every_plant_terrain_set_and_policy_and_no_other():
    files = {path.name for path in FOLDER.iterdir()}
    expected = {file for file, _ in pictures().values()}
    assert files == expected, "python -m docs.gallery files what is missing"
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 6e6
