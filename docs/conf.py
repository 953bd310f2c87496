"""Sphinx configuration: Markdown pages (MyST; tutorials run while they are built), pages made of
the code, furo."""

import re
import sys
import tomllib
from html import escape
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))  # the repository, whatever else is installed

project = "tracked-env"
author = "tracked-env contributors"
copyright = "2026, tracked-env contributors"
release = version = installed_version("tracked-env")

# myst_nb is myst_parser with cells that run
extensions = ["myst_nb", "sphinx.ext.autodoc"]
myst_enable_extensions = [
    "amsmath",
    "attrs_block",
    "attrs_inline",
    "colon_fence",
    "deflist",
    "dollarmath",
]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_generated"]
nitpicky = False
smartquotes = False  # f' is a derivative
autodoc_default_options = {"members": True, "ignore-module-all": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 90
toc_object_entries = False  # the side bar names modules, not each of 2000 functions

nb_execution_mode = "force"  # numbers and figures are those of the code as it is
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # [s] of one cell: the first ones compile kernels
nb_execution_show_tb = True
nb_output_stderr = "remove"  # progress bars

html_math_renderer = "mathml"  # of the browser: no script, no network
html_theme = "furo"
html_title = f"tracked-env {release}"
html_static_path = ["_style"]
html_extra_path = ["_static/gallery/replay.html"]
html_css_files = ["site.css"]


def write_pages(app: object) -> None:
    """Pages made of the code, and those of files that stand outside this folder."""
    from docs import generated_pages
    from docs.gallery import page
    from docs.generated_pages import write_changed

    generated_pages.write_api_pages(HERE / "api")
    generated_pages.write_environment_pages(HERE / "_generated")
    generated_pages.write_catalogue(HERE / "_generated")
    write_changed(HERE / "_generated" / "gallery.md", page())
    for name in ("CONTRIBUTING", "NOTATION", "CHANGELOG"):
        text = (HERE.parent / f"{name}.md").read_text(encoding="utf-8")
        write_changed(HERE / "_generated" / f"{name.lower()}.md", inside(text))


def inside(text: str) -> str:
    """Markdown of the repository's root with links to pages here, or else to the repository."""
    project = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))

    def target(match: re.Match[str]) -> str:
        path, _, place = match[1].partition("#")
        if path in ("CONTRIBUTING.md", "NOTATION.md", "CHANGELOG.md"):
            path = path.lower()
        elif path.startswith("docs/"):
            path = path.removeprefix("docs/")
        elif path and "://" not in path:
            path = f"{project['project']['urls']['Repository']}/blob/HEAD/{path}"
        return f"]({path}#{place})" if place else f"]({path})"

    return re.sub(r"\]\(([^)\s]+)\)", target, text)


# What docutils' translation of LaTeX lacks, and how it knows the same.
_LATEX = {r"\dots": r"\ldots", "°": r"^\circ ", r"\Big(": r"\left(", r"\Big)": r"\right)"}
_FUNCTION = re.compile(r"<mi>(\w{2,})</mi>\s*<mo>&ApplyFunction;</mo>")  # as tan, sets no space


def write_formula(translator: Any, node: nodes.math | nodes.math_block) -> None:
    """Visitor of Sphinx: a formula as MathML."""
    text = node.astext().strip()
    for ours, known in _LATEX.items():
        text = text.replace(ours, known)
    try:
        formula = tex2mathml("{}" * text.startswith("^") + text, isinstance(node, nodes.math_block))
    except Exception as error:
        logging.getLogger(__name__).warning("%s: %s", text, error, location=node)
        formula = escape(text)
    formula = _FUNCTION.sub(r'<mo lspace="0.17em" rspace="0.17em">\1</mo>', formula)
    translator.body.append(formula.replace("ˉ", "¯"))  # the bar that the font has
    raise nodes.SkipNode


class ForeignTypes(SphinxPostTransform):
    """Types of other projects in signatures are no links: each is looked for among all names."""

    default_priority = 5  # before references are resolved

    def run(self, **_: Any) -> None:
        """Put the text of such a reference in its place."""
        ours = {name.rpartition(".")[2] for name in self.env.domaindata["py"]["objects"]}
        for reference in [*self.document.findall(addnodes.pending_xref)]:
            name = reference["reftarget"].rpartition(".")[2]
            if reference.get("refdomain") == "py" and name not in ours:
                reference.replace_self(reference.children)


def setup(app: Sphinx) -> None:
    """Sphinx's hook."""
    app.add_post_transform(ForeignTypes)
    app.add_html_math_renderer("mathml", (write_formula, None), (write_formula, None))
    from docs.generated_pages import convert_docstring, shorten_signature, skip_member

    app.connect("builder-inited", write_pages)
    app.connect("autodoc-process-docstring", convert_docstring)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("autodoc-skip-member", skip_member)
