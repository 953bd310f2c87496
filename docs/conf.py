"""Sphinx configuration: Markdown pages (MyST; tutorials run while they are built), one from the
docstring of the env, furo."""

from importlib.metadata import version as installed_version

project = "tracked-env"
author = "tracked-env contributors"
copyright = "2026, tracked-env contributors"
release = version = installed_version("tracked-env")

extensions = ["myst_nb", "sphinx.ext.mathjax"]  # myst_nb is myst_parser with cells that run
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build", "_generated"]
nitpicky = False

nb_execution_mode = "force"  # numbers and figures are those of the code as it is
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # [s] of one cell: the first ones compile kernels
nb_execution_show_tb = True
nb_output_stderr = "remove"  # progress bars

html_theme = "furo"
html_title = f"tracked-env {release}"


def write_environment_page(app: object) -> None:
    """The class docstring is Markdown: hand it to MyST as a page."""
    import inspect
    from pathlib import Path

    from tracked_env.env import TrackedVehicleEnv

    folder = Path(__file__).parent / "_generated"
    folder.mkdir(exist_ok=True)
    text = inspect.getdoc(TrackedVehicleEnv) or ""
    (folder / "environment.md").write_text(text)


def setup(app: object) -> None:
    """Sphinx's hook."""
    app.connect("builder-inited", write_environment_page)  # type: ignore[attr-defined]
