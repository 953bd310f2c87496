"""The wheel alone, without PyTorch and without the clone, evaluates controllers and agents."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

LIMIT = 5e6  # [bytes]
POLICIES = ("nominal", "ppo-estimates", "ppo-student", "recurrent-ppo-blind")
ARGUMENTS = ("--policies", *POLICIES, "--sets", "payload", "--episodes", "2", "--duration", "3",
             "--no-figures")  # fmt: skip
# Runs a command with an import system that has the wheel and installed packages, and not
# what a user of the wheel need not have.
ALONE = """
import sys
WHEEL, CLONE = sys.argv[1:3]
BLOCKED = ("torch", "stable_baselines3", "sb3_contrib", "tyro", "matplotlib", "pygame", "agents",
           "reproduce", "evaluate", "train")

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.path[:] = [WHEEL, *(place for place in sys.path if place not in ("", CLONE))]
sys.meta_path[:] = [Blocker(), *(one for one in sys.meta_path if "editable" not in repr(one))]
import tracked_env
import baselines
assert tracked_env.__file__.startswith(WHEEL) and baselines.__file__.startswith(WHEEL)
from tracked_env.cli.main import main
status = main(sys.argv[3:])
assert not any(name.partition(".")[0] in BLOCKED for name in sys.modules)
sys.exit(status)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """The wheel of this clone."""
    pytest.importorskip("build", reason="building needs the extra `dev`")
    folder = tmp_path_factory.mktemp("wheel")
    isolated = () if importlib.util.find_spec("hatchling") is None else ("--no-isolation",)
    command = [sys.executable, "-m", "build", "--wheel", *isolated, "--outdir", str(folder)]
    done = subprocess.run(
        [*command, str(request.config.rootpath)], capture_output=True, text=True, timeout=300
    )
    if done.returncode != 0 and not isolated:
        pytest.skip("building needs the package hatchling, or a network to get it from")
    assert done.returncode == 0, done.stderr
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def unpacked(wheel: Path) -> Path:
    """Its content, as an installation has it."""
    folder = wheel.parent / "unpacked"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def test_the_wheel_holds_the_two_packages_and_the_shipped_agents(
    wheel: Path, repository: Path
) -> None:
    assert wheel.stat().st_size < LIMIT
    with zipfile.ZipFile(wheel) as archive:
        files = set(archive.namelist())
    assert {name.partition("/")[0].partition("-")[0] for name in files} == {
        "tracked_env",
        "baselines",
    }
    agents = {
        path.relative_to(repository).as_posix()
        for path in (repository / "baselines" / "learned" / "pretrained").glob("*/*/agent.zip")
    }
    assert len(agents) >= 60 and agents <= files


def run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    folder.mkdir(exist_ok=True)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500
    )


def records(folder: Path) -> list[dict[str, object]]:
    (file,) = folder.glob("results/*/results.json")
    episodes: list[dict[str, object]] = json.loads(file.read_text())["episodes"]
    times = ("predict_time", "fingerprint")
    return [{k: v for k, v in of.items() if not k.endswith(times)} for of in episodes]


def take_over_compiled_kernels(unpacked: Path, repository: Path) -> None:
    """Give each file of the wheel that equals the clone's the kernels compiled there."""
    for file in unpacked.rglob("*.py"):
        same = repository / file.relative_to(unpacked)
        kernels = list((same.parent / "__pycache__").glob(f"{same.stem}.*.nb?"))
        if kernels and same.read_bytes() == file.read_bytes():
            stamp = same.stat()  # numba compares it
            os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
            cache = file.parent / "__pycache__"
            cache.mkdir(exist_ok=True)
            for kernel in kernels:
                shutil.copy2(kernel, cache)


def test_the_wheel_alone_evaluates_as_the_clone_does(
    unpacked: Path, repository: Path, tmp_path: Path
) -> None:
    there = run([sys.executable, str(repository / "evaluate.py"), *ARGUMENTS], tmp_path / "clone")
    assert there.returncode == 0, there.stderr
    take_over_compiled_kernels(unpacked, repository)
    alone = [sys.executable, "-c", ALONE, str(unpacked), str(repository)]
    done = run([*alone, "evaluate", *ARGUMENTS], tmp_path / "wheel")
    assert done.returncode == 0, done.stderr
    found = records(tmp_path / "wheel")
    assert found == records(tmp_path / "clone")
    seeds = {f"{name}@{seed}" for name in POLICIES[1:] for seed in range(5)}
    assert {record["policy"] for record in found} == {"nominal", *seeds}


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["policies"], 0, "ppo-student"),
        (["train"], 2, "training is not part of the installed package"),
        (["evaluate", "--paper", "focchi2025"], 2, "needs the package `reproduce`"),
        (["render", "nominal", "--duration", "1"], 1, "pip install"),
    ],
)
def test_the_wheel_alone_says_what_it_has_and_what_it_lacks(
    arguments: list[str],
    status: int,
    message: str,
    unpacked: Path,
    repository: Path,
    tmp_path: Path,
) -> None:
    done = run([sys.executable, "-c", ALONE, str(unpacked), str(repository), *arguments], tmp_path)
    assert done.returncode == status, done.stderr
    assert message in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
