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
from email.parser import Parser
from pathlib import Path

import pytest

from tests.test_documentation import python_blocks

LIMIT = 7e6  # [bytes] of the wheel, most of which is agents
SOURCE_LIMIT = 7e6  # [bytes] of the source distribution, most of which is figures
POLICIES = ("nominal", "ppo-blind", "ppo-estimates")
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


def built(kind, folder, request):
    """A distribution of this clone; kind: "wheel" or "sdist"."""
    pytest.importorskip("build", reason="building needs the extra `dev`")
    isolated = () if importlib.util.find_spec("hatchling") is None else ("--no-isolation",)
    command = [sys.executable, "-m", "build", f"--{kind}", *isolated, "--outdir", str(folder)]
    result = subprocess.run(
        [*command, str(request.config.rootpath)], capture_output=True, text=True, timeout=300
    )
    if result.returncode != 0 and not isolated:
        pytest.skip("building needs the package hatchling, or a network to get it from")
    assert result.returncode == 0, result.stderr
    (file,) = folder.iterdir()
    return file


@pytest.fixture(scope="module")
def wheel(tmp_path_factory, request):
    """The wheel of this clone."""
    return built("wheel", tmp_path_factory.mktemp("wheel"), request)


@pytest.fixture(scope="module")
def sdist(tmp_path_factory, request):
    """The source distribution of this clone."""
    return built("sdist", tmp_path_factory.mktemp("sdist"), request)


@pytest.fixture(scope="module")
def alone(wheel, repository):
    """Command that runs the unpacked wheel, as an installation has it, with further arguments."""
    folder = wheel.parent / "unpacked"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return [sys.executable, "-c", ALONE, str(folder), str(repository)]


@pytest.fixture(scope="module")
def metadata(wheel):
    """What the wheel says of itself."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return Parser().parsestr(archive.read(name).decode())


def test_the_wheel_holds_the_two_packages_and_the_shipped_agents(wheel, repository):
    assert wheel.stat().st_size < LIMIT
    with zipfile.ZipFile(wheel) as archive:
        files = set(archive.namelist())
    packages = {name.partition("/")[0].partition("-")[0] for name in files}
    assert packages == {"tracked_env", "baselines"}
    archives = (repository / "baselines" / "learned" / "pretrained").glob("*/*/agent.zip")
    agents = {path.relative_to(repository).as_posix() for path in archives}
    assert len(agents) >= 31 and agents <= files
    assert not [name for name in files if Path(name).name in ("curve.csv", "config.json")]
    assert {"tracked_env/py.typed", "baselines/py.typed"} <= files


def test_the_source_distribution_holds_what_builds_and_tests_it_and_no_weights(sdist):
    assert sdist.stat().st_size < SOURCE_LIMIT
    with tarfile.open(sdist) as archive:
        files = {name.partition("/")[2] for name in archive.getnames()}
    assert not [name for name in files if name.endswith(("agent.zip", "curve.csv"))]
    scores = [name for name in files if name.endswith("scores.json")]
    assert len(scores) == 3  # by which the names of the agents are known
    needed = {"pyproject.toml", "hatch_build.py", "Makefile", "LICENSE", "README.md", "SECURITY.md"}
    assert needed | {"tracked_env/py.typed", "baselines/py.typed", "tests/conftest.py"} <= files
    assert not [name for name in files if name.startswith((".github", ".ci", ".devcontainer"))]


def test_the_metadata_say_licence_versions_addresses_and_types(metadata, repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    assert metadata["Version"] == project["version"] and metadata["License-Expression"] == "MIT"
    addresses = dict(entry.split(", ") for entry in metadata.get_all("Project-URL", []))
    assert {"Repository", "Documentation", "Changelog", "Issues"} <= set(addresses)
    assert all(one.startswith(addresses["Repository"]) for one in addresses.values())
    citation = (repository / "CITATION.cff").read_text()
    assert f'repository-code: "{addresses["Repository"]}"' in citation
    versions = {f"Programming Language :: Python :: 3.{minor}" for minor in (11, 12, 13)}
    assert {"Typing :: Typed", *versions} <= set(metadata.get_all("Classifier", []))
    assert len(metadata["Keywords"].split(",")) >= 10


def test_links_and_pictures_of_the_readme_are_absolute_in_the_metadata(metadata, repository):
    text = str(metadata.get_payload())
    source = (repository / "README.md").read_text()
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    home = project["urls"]["Repository"]
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


def test_both_distributions_pass_the_strict_check_of_the_package_index(wheel, sdist):
    pytest.importorskip("twine", reason="the check needs the extra `dev`")
    command = [sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.count("PASSED") == 2


def run(command, folder, text=""):
    folder.mkdir(exist_ok=True)
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=folder, env=environment, input=text, capture_output=True, text=True,
        timeout=500,
    )  # fmt: skip


def records(folder):
    (file,) = folder.glob("results/*/results.json")
    episodes = json.loads(file.read_text())["episodes"]
    times = ("predict_time", "fingerprint")
    return [{k: v for k, v in of.items() if not k.endswith(times)} for of in episodes]


@pytest.mark.slow
def test_the_wheel_alone_evaluates_as_the_clone_does(alone, repository, tmp_path):
    there = run([sys.executable, str(repository / "evaluate.py"), *ARGUMENTS], tmp_path / "clone")
    assert there.returncode == 0, there.stderr
    result = run([*alone, "evaluate", *ARGUMENTS], tmp_path / "wheel")
    assert result.returncode == 0, result.stderr
    episodes = records(tmp_path / "wheel")
    assert episodes == records(tmp_path / "clone")
    seeds = {f"{name}@{seed}" for name in POLICIES[1:] for seed in range(5)}
    assert {record["policy"] for record in episodes} == {"nominal", *seeds}


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["policies"], 0, "ppo-estimates"),
        (["train"], 2, "training is not part of the installed package"),
        pytest.param(
            *(["evaluate", "--paper", "focchi2025"], 2, "needs the package `reproduce`"),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            *(["render", "nominal", "--duration", "1"], 1, "pip install"), marks=pytest.mark.slow
        ),
    ],
)
def test_the_wheel_alone_says_what_it_has_and_what_it_lacks(
    arguments, status, message, alone, tmp_path
):
    result = run([*alone, *arguments], tmp_path)
    assert result.returncode == status, result.stderr
    assert message in result.stdout + result.stderr
    assert "Traceback" not in result.stderr


def test_the_wheel_alone_follows_the_quickstart(alone, repository, tmp_path):
    blocks = python_blocks((repository / "docs" / "quickstart.md").read_text())
    assert len(blocks) >= 3
    result = run([*alone, "run"], tmp_path, "\n".join(blocks))
    assert result.returncode == 0, result.stderr
    assert "Warning" not in result.stderr
