"""The tree: file names that stand once, and definitions that something other than a test uses."""

import ast
import re
from collections import Counter, defaultdict

import pytest

PROGRAM = ("tracked_env", "baselines", "agents", "reproduce", "benchmarks", "docs")
SCRIPTS = ("train.py", "evaluate.py")
ANYWHERE = ("__init__.py", "__main__.py", "conftest.py")
PARALLEL = ("strawa2021", "focchi2025")  # folders of reproduce/ whose files may have equal names
# What other projects call, and hooks that a tool calls by name.
PUBLIC = {
    "create_dataset", "env_creator", "unpack", "IdentifiedObservation", "load_network", "setup",
    "open_onnx", "__all__", "__getattr__",
    "author", "copyright", "extensions", "myst_enable_extensions", "myst_heading_anchors",
    "exclude_patterns", "nitpicky", "html_theme", "html_title", "release", "smartquotes",
    "autodoc_default_options", "autodoc_member_order", "autodoc_typehints_format",
    "python_maximum_signature_line_length", "toc_object_entries", "html_static_path",
    "html_css_files", "html_extra_path", "html_math_renderer", "nb_execution_mode",
    "nb_execution_raise_on_error",
    "nb_execution_timeout", "nb_execution_show_tb", "nb_output_stderr",
}  # fmt: skip
# Equations of the model that the plants use in another form; tests compare the two.
MODEL = {"tractive_effort", "regularised_sign"}


def program_files(root):
    """Python files of the program, without the tests."""
    result = [path for name in PROGRAM for path in sorted((root / name).rglob("*.py"))]
    return result + [root / name for name in SCRIPTS if (root / name).exists()]


def repeated_names(root):
    """File name -> the files that have it, where these are several."""
    by_name = defaultdict(list)
    for path in program_files(root) + sorted((root / "tests").rglob("*.py")):
        where = path.relative_to(root)
        if path.name not in ANYWHERE and not set(where.parts) & {*PARALLEL, "_build"}:
            by_name[path.name].append(str(where))
    for name in PARALLEL:
        for path in sorted((root / "reproduce" / name).glob("*.py")):
            if path.name in by_name:
                by_name[path.name].append(str(path.relative_to(root)))
    return {name: files for name, files in by_name.items() if len(files) > 1}


def top_level(tree):
    """(name, line) of the functions, classes and constants of a module."""
    result = []
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            if any(isinstance(each, ast.Call) for each in node.decorator_list):
                continue  # `@law("hills")` registers what it decorates
            result.append((node.name, node.lineno))
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        for target in targets:
            if isinstance(target, ast.Name):  # an unpacked tuple may leave some names unused
                result.append((target.id, node.lineno))
    return result


def used(tree):
    """Names that a module reads, as variable, attribute or in a short string (a look-up)."""
    names = Counter()
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            names[node.id] += 1
        elif isinstance(node, ast.Attribute):
            names[node.attr] += 1
        elif isinstance(node, ast.Constant) and len(str(node.value)) < 80:
            names.update(re.findall(r"\w+", str(node.value)))
    return names


def unused_definitions(root):
    """Module-level definitions that nothing in the program reads, as 'file:line name'."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in program_files(root)}
    names = Counter()
    for tree in trees.values():
        names.update(used(tree))
    project = root / "pyproject.toml"
    if project.exists():  # its entry points
        names.update(re.findall(r'"[\w.]+:(\w+)"', project.read_text(encoding="utf-8")))
    return [
        f"{path.relative_to(root)}:{line} {name}"
        for path, tree in trees.items()
        for name, line in top_level(tree)
        if not names[name] and name not in PUBLIC | MODEL
    ]


def test_a_file_name_stands_once_in_the_tree(repository):
    assert repeated_names(repository) == {}


def test_every_definition_is_used_by_something_other_than_a_test(repository):
    assert unused_definitions(repository) == []


@pytest.mark.parametrize(
    ("first", "second", "found"),
    [
        ("tracked_env/a.py", "baselines/a.py", True),
        ("tracked_env/a.py", "tests/agents/a.py", True),
        ("reproduce/strawa2021/a.py", "reproduce/focchi2025/a.py", False),
        ("reproduce/strawa2021/a.py", "tracked_env/a.py", True),
        ("tracked_env/__init__.py", "baselines/__init__.py", False),
    ],
)
def test_a_name_that_stands_twice_is_found(first, second, found, tmp_path):
    for name in (first, second):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    assert bool(repeated_names(tmp_path)) == found


@pytest.mark.parametrize(
    ("text", "unused"),
    [
        ("A = 1\n", ["A"]),
        ("A: int = 1\nB = A\nprint(B)\n", []),
        ("def f():\n    return 1\n", ["f"]),
        ("def f():\n    return 1\n\nx = globals()['f']()\nprint(x)\n", []),
        ("class C:\n    pass\n\nimport other\nother.C()\n", []),
    ],
)
def test_a_definition_that_nothing_reads_is_found(text, unused, tmp_path):
    (tmp_path / "tracked_env").mkdir()
    (tmp_path / "tracked_env" / "a.py").write_text(text)
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_a.py").write_text("from tracked_env.a import *\nprint(A, f, C)\n")
    assert [line.split()[1] for line in unused_definitions(tmp_path)] == unused
