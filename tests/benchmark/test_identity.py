"""The identity of results: all that changes numbers is part of it, and nothing else."""

import ast
import sys
import types
from pathlib import Path

import pytest

import tracked_env
from tracked_env.benchmark import BenchmarkConfig
from tracked_env.benchmark.benchmark_config import SOURCE, WITHOUT_INFLUENCE
from tracked_env.benchmark.files import source_fingerprint

SHORT = BenchmarkConfig(sets=("soil-and-mass",), episodes=4, duration=2.0)


@pytest.mark.parametrize(
    "change",
    [
        *({"seed": 1}, {"sensors": "ideal"}, {"duration": 1.0}, {"reference": {"kind": "circle"}}),
        *({"lateral": "constrained"}, {"error_limit": 3.0}, {"control_rate": 25.0}),
    ],
)
def test_whatever_changes_numbers_is_part_of_the_identity(change):
    changed = BenchmarkConfig(**{"sets": SHORT.sets, "duration": 2.0, **change})
    assert changed.identity() != SHORT.identity()


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A copy of the package's source, which identities are then taken from."""
    source = Path(tracked_env.__file__).parent
    copy = tmp_path / "tracked_env"
    for path in source.rglob("*.py"):
        target = copy / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    monkeypatch.setattr(tracked_env.__spec__, "submodule_search_locations", [str(copy)])
    return copy


def test_a_policy_of_a_script_is_known_by_its_file_and_one_of_a_notebook_by_its_process(
    tmp_path, monkeypatch
):
    main = types.ModuleType("__main__")
    monkeypatch.setitem(sys.modules, "__main__", main)
    typed = source_fingerprint("__main__")
    main.__file__ = str(tmp_path / "script.py")
    for text in ("a = 1", "a = 2"):
        (tmp_path / "script.py").write_text(text)
        (tmp_path / "module.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        assert source_fingerprint("__main__") == source_fingerprint("module") != typed


def test_every_source_file_is_part_of_the_identity_or_named_as_without_influence(copied):
    def fingerprint():
        return source_fingerprint("tracked_env", WITHOUT_INFLUENCE)

    first = fingerprint()
    assert SHORT.identity()["source"] == SOURCE == first
    unnoticed = set()
    for path in sorted(copied.rglob("*.py")):
        content = path.read_bytes()
        path.write_bytes(content + b"#")
        assert SHORT.identity()["source"] == SOURCE  # of what runs, not of what is on disk by now
        if fingerprint() == first:
            unnoticed.add(path.relative_to(copied).as_posix())
        path.write_bytes(content)
    named = {
        path.relative_to(copied).as_posix()
        for name in WITHOUT_INFLUENCE
        for path in ([copied / name] if name.endswith(".py") else (copied / name).rglob("*.py"))
    }
    assert unnoticed == named
    for name in ("__init__.py", "uncertainty/__init__.py", "references/__init__.py"):
        assert name not in unnoticed
    assert all((copied / name).exists() for name in WITHOUT_INFLUENCE)


def imports(path):
    """Modules that a file of the package names in an import, as paths relative to it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        found |= {name.partition(".")[2].replace(".", "/") for name in names}
    return found


def test_the_simulation_takes_nothing_but_pictures_from_what_is_without_influence():
    source = Path(tracked_env.__file__).parent
    left_out = {name.rstrip("/").removesuffix(".py") for name in WITHOUT_INFLUENCE}
    taken = {
        (name, used)
        for path in source.rglob("*.py")
        for name in [path.relative_to(source).as_posix()]
        if not any(name.removesuffix(".py").startswith(of) for of in left_out)
        for used in imports(path) & left_out
    }
    assert taken == {
        ("env.py", "rendering"),
        ("benchmark/benchmark_config.py", "benchmark/files"),
        *(("benchmark/runner.py", f"benchmark/{name}") for name in ("executors", "store")),
    }
