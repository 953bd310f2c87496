"""What all tests share: no window, no sound, no display, and where reference data lies."""

import gc
import os
import sys
from pathlib import Path

import pytest

# Before anything imports pygame or matplotlib.
os.environ["SDL_VIDEODRIVER"] = "dummy"
os.environ["SDL_AUDIODRIVER"] = "dummy"
os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
os.environ["MPLBACKEND"] = "Agg"

ROOT = Path(__file__).resolve().parent.parent
# What takes long goes first, the compilation of different kernels before what starts processes that
# need them: no worker waits for another one at the end, and few kernels are compiled twice.
FIRST = (
    "agents/test_checkpoints.py", "baselines/lyapunov/test_replanning.py",
    "agents/test_agents.py", "baselines/lyapunov/test_slopes.py",
    "baselines/predictive/test_predictive_control.py", "agents/test_environment.py",
    "agents/test_archive.py", "reproduce/test_paper_pages.py",
    "reproduce/test_focchi2025.py", "plants/test_terrain_runs.py",
    "baselines/estimators/test_late_and_lost_poses.py", "test_tutorials.py",
    "physics/test_kernel_cache.py", "test_built_documentation.py", "test_evaluate.py",
    "benchmark/test_executors.py", "benchmark/test_ray_cluster.py",
    "agents/test_several_trainings.py", "test_train.py", "test_wheel.py",
    "benchmark/test_frozen.py", "benchmark/test_speed.py", "test_contributing.py",
    "baselines/identify/test_user_logs.py", "tools/test_tools.py",
)  # fmt: skip


def pytest_ignore_collect(collection_path, config):
    """Where the slow tests alone are run, files without any are not imported."""
    if config.option.markexpr == "slow" and collection_path.suffix == ".py":
        return "mark.slow" not in collection_path.read_text(encoding="utf-8") or None
    return None


def pytest_collection_modifyitems(items):
    """Order the files of the tests: FIRST, then the others as they were found."""
    place = {ROOT / "tests" / file: number for number, file in enumerate(FIRST)}
    items.sort(key=lambda item: place.get(item.path, len(FIRST)))


def pytest_collection_finish():
    """What was collected stays: looking for garbage in it takes an eighth where tests compile."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture(scope="session")
def repository():
    """Root folder of the source tree."""
    return ROOT


@pytest.fixture(scope="session")
def reference_data():
    """Folder with reference data that is not part of the project; skips where it is absent.

    `TRACKED_ENV_REFERENCE_DATA` names it; default is `shared/data` beside the source tree.
    """
    default = ROOT.parent / "shared" / "data"
    folder = Path(os.environ.get("TRACKED_ENV_REFERENCE_DATA", default))
    if not folder.is_dir():
        pytest.skip(
            f"reference data not found at {folder}; set TRACKED_ENV_REFERENCE_DATA to its folder"
        )
    return folder


@pytest.fixture
def in_an_empty_folder(tmp_path, monkeypatch):
    """The working folder is empty; what commands change in their process is put back.

    That is the path of imports and what Ctrl-C does. No command says that it compiles kernels: a
    cold cache is no business of the tests.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("tracked_env.cli.main.end_at_interrupt", lambda program: None)
    monkeypatch.setattr("tracked_env.cli.command_line.PATIENCE", 3600.0)


@pytest.fixture
def registries():
    """What a test registers is gone after it."""
    from baselines import registry
    from baselines.estimators import stack
    from tracked_env import observation, sensors, uncertainty
    from tracked_env.benchmark import evaluation_sets as sets

    tables = (
        sensors.ADDED, observation.GROUPS, uncertainty.known_laws(), uncertainty.DESCRIPTIONS,
        sets.SETS, stack.REGISTERED, registry.POLICIES,
    )  # fmt: skip
    before = [dict(table) for table in tables]
    yield
    for table, old in zip(tables, before, strict=True):
        table.clear()
        table.update(old)
    observation._layout.cache_clear()


@pytest.fixture
def own_parts(monkeypatch):
    """`own_parts` can be imported and is not yet; what it registers is gone afterwards."""
    from tracked_env import rewards, vehicles
    from tracked_env.references import specification

    monkeypatch.syspath_prepend(Path(__file__).parent / "benchmark")
    monkeypatch.delitem(sys.modules, "own_parts", raising=False)
    monkeypatch.setattr(vehicles, "_registered", {})
    monkeypatch.setattr(rewards, "_REGISTERED", {})
    monkeypatch.setattr(specification, "_REGISTERED", {})
    monkeypatch.setattr(specification, "_ARGUMENTS", {**specification._ARGUMENTS})
    yield
    sys.modules.pop("own_parts", None)
