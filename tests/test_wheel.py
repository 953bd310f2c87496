"""What is distributed: metadata, content, and that the wheel alone evaluates as the clone does."""

import importlib.util
import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.message import Message
from email.parser import Parser
from pathlib import Path

import pytest

from tests.test_documentation import python_blocks

LIMIT = 6e6  # [bytes] of the wheel, most of which is agents
SOURCE_LIMIT = 7e6  # [bytes] of the source distribution, most of which is figures
POLICIES = ("nominal", "ppo-estimates", "ppo-student", "recurrent-ppo-blind")
ARGUMENTS = ("--policies", *POLICIES, "--sets", "payload", "--episodes", "2", "--duration", "3",
             "--no-figures")  # fmt: skip
# Runs a command with an import system that has the wheel and installed packages, and not
# what a user of the wheel need not have.
ALONE = """
import sys
WHEEL, CLONE = sys.argv[1:3]
BLOCKED = ("torch", "stable_baselines3", "sb3_contrib", "pygame", "agents",
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
if sys.argv[3] == "run":
    exec(compile(sys.stdin.read(), "page", "exec"), {"__name__": "__main__"})
    status = 0
else:
    status = main(sys.argv[3:])
assert not any(name.partition(".")[0] in BLOCKED for name in sys.modules)
sys.exit(status)
"""


def built(kind: str, folder: Path, request: pytest.FixtureRequest) -> Path:
    """A distribution of this clone; kind: "wheel" or "sdist"."""
    pytest.importorskip("build", reason="building needs the extra `dev`")
    isolated = () if importlib.util.find_spec("hatchling") is None else ("--no-isolation",)
    command = [sys.executable, "-m", "build", f"--{kind}", *isolated, "--outdir", str(folder)]
    done = subprocess.run(
        [*command, str(request.config.rootpath)], capture_output=True, text=True, timeout=300
    )
    if done.returncode != 0 and not isolated:
        pytest.skip("building needs the package hatchling, or a network to get it from")
    assert done.returncode == 0, done.stderr
    (file,) = folder.iterdir()
    return file


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """The wheel of this clone."""
    return built("wheel", tmp_path_factory.mktemp("wheel"), request)


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """The source distribution of this clone."""
    return built("sdist", tmp_path_factory.mktemp("sdist"), request)


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
    assert not [name for name in files if Path(name).name in ("curve.csv", "config.json")]
    assert {"tracked_env/py.typed", "baselines/py.typed"} <= files


def test_the_source_distribution_holds_what_builds_and_tests_it_and_no_weights(
    sdist: Path, repository: Path
) -> None:
    assert sdist.stat().st_size < SOURCE_LIMIT
    with tarfile.open(sdist) as archive:
        files = {name.partition("/")[2] for name in archive.getnames()}
    weights = [name for name in files if name.endswith(("agent.zip", "curve.csv"))]
    assert weights == []
    scores = [name for name in files if name.endswith("scores.json")]
    assert len(scores) == 3  # by which the names of the agents are known
    needed = {"pyproject.toml", "hatch_build.py", "Makefile", "LICENSE", "README.md", "SECURITY.md",
              "tracked_env/py.typed", "baselines/py.typed", "tests/conftest.py"}  # fmt: skip
    assert needed <= files
    assert not [name for name in files if name.startswith((".github", ".ci", ".devcontainer"))]


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return Parser().parsestr(archive.read(name).decode())


def test_the_metadata_say_licence_versions_addresses_and_types(
    wheel: Path, repository: Path
) -> None:
    found = metadata(wheel)
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    assert found["Version"] == project["version"] and found["License-Expression"] == "MIT"
    addresses = dict(entry.split(", ") for entry in found.get_all("Project-URL", []))
    assert {"Repository", "Documentation", "Changelog", "Issues"} <= set(addresses)
    assert all(one.startswith(addresses["Repository"]) for one in addresses.values())
    citation = (repository / "CITATION.cff").read_text()
    assert f'repository-code: "{addresses["Repository"]}"' in citation
    assert f"version: {project['version']}\n" in citation
    classifiers = found.get_all("Classifier", [])
    assert "Typing :: Typed" in classifiers
    assert {f"Programming Language :: Python :: 3.{minor}" for minor in (11, 12, 13)} <= set(
        classifiers
    )
    assert len(found["Keywords"].split(",")) >= 10


def test_links_and_pictures_of_the_readme_are_absolute_in_the_metadata(
    wheel: Path, repository: Path
) -> None:
    text = metadata(wheel).get_payload()
    assert isinstance(text, str)
    source = (repository / "README.md").read_text()
    home = tomllib.loads((repository / "pyproject.toml").read_text())["project"]["urls"][
        "Repository"
    ]
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) == len(re.findall(r"\]\(([^)]+)\)", source)) > 20
    assert [link for link in links if not link.startswith("https://")] == []
    ours = [link.removeprefix(home) for link in links if link.startswith(home)]
    pictures = [path for path in ours if path.startswith("/raw/HEAD/")]
    assert pictures == ["/raw/HEAD/docs/_static/render.png"]
    for path in ours:
        assert (repository / path.split("/HEAD/")[1].partition("#")[0]).exists(), path
    blocks = re.compile(r"```.*?```", re.DOTALL)
    assert blocks.findall(text) == blocks.findall(source)


def test_both_distributions_pass_the_strict_check_of_the_package_index(
    wheel: Path, sdist: Path
) -> None:
    pytest.importorskip("twine", reason="the check needs the extra `dev`")
    command = [sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("PASSED") == 2


def run(command: list[str], folder: Path, given: str = "") -> subprocess.CompletedProcess[str]:
    folder.mkdir(exist_ok=True)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=folder, env=environment, input=given, capture_output=True, text=True,
        timeout=500,
    )  # fmt: skip


def records(folder: Path) -> list[dict[str, object]]:
    (file,) = folder.glob("results/*/results.json")
    episodes: list[dict[str, object]] = json.loads(file.read_text())["episodes"]
    times = ("predict_time", "fingerprint")
    return [{k: v for k, v in of.items() if not k.endswith(times)} for of in episodes]


def test_the_wheel_alone_evaluates_as_the_clone_does(
    unpacked: Path, repository: Path, tmp_path: Path
) -> None:
    there = run([sys.executable, str(repository / "evaluate.py"), *ARGUMENTS], tmp_path / "clone")
    assert there.returncode == 0, there.stderr
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


def test_the_wheel_alone_follows_the_quickstart(
    unpacked: Path, repository: Path, tmp_path: Path
) -> None:
    blocks = python_blocks((repository / "docs" / "quickstart.md").read_text())
    assert len(blocks) >= 3
    for block in blocks:
        command = [sys.executable, "-c", ALONE, str(unpacked), str(repository), "run"]
        done = run(command, tmp_path, block)
        assert done.returncode == 0, done.stderr
        assert "Warning" not in done.stderr


EPISODE = """
import sys; sys.path[:] = [sys.argv[1], *(place for place in sys.path if place)]
sys.meta_path[:] = [one for one in sys.meta_path if "editable" not in repr(one)]
import gymnasium, numpy as np, tracked_env
assert tracked_env.__file__.startswith(sys.argv[1])
env = gymnasium.make("tracked_env/Torque-v0")
env.reset(seed=0)
for _ in range(25):
    env.step(np.array([0.1, 0.5], np.float32))
print(env.unwrapped.simulation.batch.floats.tobytes().hex())
"""


@pytest.mark.slow
def test_an_update_of_the_wheel_drives_the_new_physics_over_the_old_kernel_cache(
    wheel: Path, tmp_path: Path
) -> None:
    """A formula that kernels inline differs in the new wheel: a tenth of the lateral force."""
    newer = tmp_path / wheel.name
    formula = "tracked_env/physics/lumped.py"
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(newer, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == formula:
                text = content.decode()
                content = text.replace("fr, rl, rr, force, k.t", "fr, rl, rr, 0.1 * force, k.t")
                assert content != text
            new.writestr(name, content)

    def episode(package: Path, cache: str) -> str:
        options = ["--quiet", "--no-deps", "--no-index", "--upgrade", "--target"]
        there = str(tmp_path / "installed")
        install = [sys.executable, "-m", "pip", "install", *options, there, str(package)]
        subprocess.run(install, check=True, capture_output=True)
        command = [sys.executable, "-c", EPISODE, there]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / cache)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    before = episode(wheel, "cache")
    assert episode(newer, "cache") == episode(newer, "empty") != before
    assert episode(wheel, "cache") == before
