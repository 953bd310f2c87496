"""Files around the code: workflow, hooks, container, issue forms, and what may run code."""

import ast
import json
import re

import pytest
import yaml

PROGRAM = ("tracked_env", "baselines", "agents", "reproduce")
UNPICKLING = ("pickle", "cloudpickle", "dill", "joblib", "torch", "marshal", "shelve")
RUNNING = ("exec", "eval", "__import__")
IMPORTING = ("import_module", "spec_from_file_location", "run_path", "run_module")
CPU_INDEX = "https://download.pytorch.org/whl/cpu"


def text_of(repository, name):
    return (repository / name).read_text(encoding="utf-8")


def make_targets(repository):
    """Commands of the Makefile that `make help` lists."""
    return set(re.findall(r"^([a-z-]+):.*## ", text_of(repository, "Makefile"), re.MULTILINE))


def made_targets(text):
    """Targets that a script calls make for."""
    return set(re.findall(r"\bmake ([a-z][a-z-]*)(?=[\s\"'#]|$)", text, re.MULTILINE))


def test_every_place_that_says_the_version_says_the_same(repository):
    project = re.search(r'^version = "(.+)"$', text_of(repository, "pyproject.toml"), re.MULTILINE)
    said = {
        "tracked_env/__init__.py": r'__version__ = "(.+)"',
        "CITATION.cff": r"^version: (.+)$",
        "docs/scale.md": r"tracked_env-(.+?)-py3-none-any\.whl",
    }
    for name, pattern in said.items():
        result = re.findall(pattern, text_of(repository, name), re.MULTILINE)
        assert result == [project[1]], name


def workflow(repository):
    return yaml.safe_load(text_of(repository, ".github/workflows/tests.yml"))


def test_the_workflow_runs_tests_lint_documentation_and_package_by_existing_targets(repository):
    jobs = workflow(repository)["jobs"]
    steps = {
        name: "\n".join(step.get("run", "") for step in job["steps"]) for name, job in jobs.items()
    }
    called = {name: made_targets(text) for name, text in steps.items()}
    assert called == {
        "test": {"install", "test", "test-slow"},
        "oracle": {"oracle"},
        "lint": {"install", "lint"},
        "docs": {"docs"},
        "package": {"bare"},
    }
    assert set().union(*called.values()) <= make_targets(repository)
    assert re.search(r"sphinx -W ", text_of(repository, "Makefile"))  # warnings are errors


def test_the_workflow_runs_every_version_of_python_that_the_metadata_name(repository):
    named = re.findall(
        r'"Programming Language :: Python :: (3\.\d+)"', text_of(repository, "pyproject.toml")
    )
    jobs = workflow(repository)["jobs"]
    for name in ("test", "package"):
        assert jobs[name]["strategy"]["matrix"]["python-version"] == named


def test_the_workflow_may_only_read_the_repository(repository):
    tests = workflow(repository)
    assert tests["permissions"] == {"contents": "read"}
    assert all("permissions" not in job for job in tests["jobs"].values())
    assert "secrets." not in text_of(repository, ".github/workflows/tests.yml")


def test_the_hooks_before_a_commit_have_the_tested_version_of_ruff(repository):
    repos = yaml.safe_load(text_of(repository, ".pre-commit-config.yaml"))["repos"]
    (ruff,) = (repo for repo in repos if "ruff" in repo["repo"])
    pin = re.search(r"^ruff==(.+)$", text_of(repository, "constraints.txt"), re.MULTILINE)
    assert pin is not None and ruff["rev"] == f"v{pin[1]}"
    (local,) = (repo for repo in repos if repo["repo"] == "local")
    for hook in local["hooks"]:
        called = made_targets(hook["entry"])
        assert called and called <= make_targets(repository)


def test_the_container_runs_the_two_commands(repository):
    text = text_of(repository, ".devcontainer/Dockerfile")
    called = made_targets(text.replace('", "', " "))
    assert {"evaluate", "test", "install"} <= called <= make_targets(repository)
    for line in re.findall(r"^COPY (.*)$", text, re.MULTILINE):
        for source in line.split()[:-1]:
            assert (repository / source).exists(), source
    container = json.loads(text_of(repository, ".devcontainer/devcontainer.json"))
    folder = repository / ".devcontainer"
    assert (folder / container["build"]["dockerfile"]).is_file()
    assert (folder / container["build"]["context"]).resolve() == repository.resolve()
    assert made_targets(container["postCreateCommand"]) == {"install"}


def test_where_pip_installs_pytorch_its_small_build_is_named(repository):
    pages = [repository / "README.md", *sorted((repository / "docs").glob("*.md"))]
    telling = []
    for page in pages:
        text = page.read_text(encoding="utf-8")
        if re.search(r"pip install .*(\[[a-z,]*\brl\b|\btorch\b)", text):
            telling.append(page.name)
            assert CPU_INDEX in text, f"{page.name} installs PyTorch without its CPU index"
    assert {"README.md", "register.md", "train.md"} <= set(telling)
    assert CPU_INDEX in text_of(repository, "Makefile")


def running_calls(tree):
    """Calls that unpickle, execute text or import what is named at run time."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
        owner = getattr(getattr(function, "value", None), "id", "")
        keywords = {keyword.arg: keyword.value for keyword in node.keywords}
        pickled = keywords.get("allow_pickle")
        if (
            (name in ("load", "loads", "Unpickler") and owner in UNPICKLING)
            or (name == "load" and "device" in keywords)  # of Stable-Baselines3
            or (name == "load" and not node.args and not node.keywords)  # of an entry point
            or (isinstance(function, ast.Name) and name in RUNNING)
            or name in IMPORTING
            or (pickled is not None and getattr(pickled, "value", None) is not False)
        ):
            yield ast.unparse(node)


def test_the_security_page_lists_exactly_the_files_that_can_run_what_they_read(repository):
    paths = [path for name in PROGRAM for path in sorted((repository / name).rglob("*.py"))]
    paths += [repository / "train.py", repository / "evaluate.py"]
    calling = {
        path.relative_to(repository).as_posix()
        for path in paths
        if list(running_calls(ast.parse(path.read_text(encoding="utf-8"))))
    }
    part = text_of(repository, "SECURITY.md").split("## Files and arguments that run code")[1]
    entries = set(re.findall(r"`([\w/.]+\.py)`", part))
    assert "agents/archive.py" in calling
    assert entries - {"matplotlib.py"} == calling


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("pickle.loads(data)", 1),
        ("torch.load(path, weights_only=False)", 1),
        ("np.load(path, allow_pickle=True)", 1),
        ("np.load(path, allow_pickle=False)", 0),
        ("np.load(path)", 0),
        ("PPO.load(path, device='cpu')", 1),
        ("entry.load()", 1),
        ("json.loads(text)", 0),
        ("importlib.import_module(name)", 1),
        ("exec(text)", 1),
        ("pickle.dumps(x)", 0),
    ],
)
def test_a_call_that_can_run_what_it_reads_is_found(text, count):
    assert len(list(running_calls(ast.parse(text)))) == count
