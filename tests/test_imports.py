"""Who may import whom, read from the source with `ast`, and what `import tracked_env` costs."""

import ast
from pathlib import Path

import pytest

from tests.processes import python

OURS = (
    "tracked_env", "baselines", "agents", "reproduce", "train", "evaluate", "tests", "benchmarks",
)  # fmt: skip

# Importer -> what it may import of OURS, and foreign packages that it may not import.
# A module belongs to the longest prefix that fits.
ALLOWED = {
    "tracked_env.physics": ("tracked_env.physics",),
    "tracked_env": ("tracked_env",),
    "tracked_env.cli": ("tracked_env",),
    "baselines": (
        "tracked_env.physics",
        "tracked_env.observation",
        "tracked_env.sensors",
        "tracked_env.validation",
        "tracked_env.vehicles",
        "baselines",
    ),
    "baselines.identify": ("tracked_env", "baselines"),  # commands of the command line
    "agents": ("tracked_env", "baselines", "agents"),
    "reproduce": ("tracked_env", "baselines", "reproduce"),
    # train.py names itself, as the processes that train import it
    "train": ("tracked_env", "baselines", "agents", "train"),
    "evaluate": ("tracked_env", "baselines", "agents", "reproduce"),
}
# A baseline never sees an env, and trained agents drive without what trained them.
_LEARNING = ("torch", "stable_baselines3", "sb3_contrib")
FORBIDDEN = {"baselines": ("gymnasium", *_LEARNING), "tracked_env.cli": _LEARNING}

# Parts of tracked_env, each a file or a folder; one imports only those that stand before it.
ORDER = (
    *("physics", "validation", "entry_points", "vehicles", "observation", "sensors", "events"),
    *("arrays", "streams", "step", "rewards"),  # the ground floor ends here
    *("terrain", "references", "uncertainty", "plants", "engine", "rendering"),
    *("env", "vector_env", "environment_ids", "wrappers", "sb3", "benchmark", "datasets", "cli"),
)
LOADED = (45, 9000)  # modules of tracked_env, and their lines, that making Torque-v0 may load


def within(module, prefixes):
    """Whether `module` is one of `prefixes` or lies below one."""
    return any(module == prefix or module.startswith(f"{prefix}.") for prefix in prefixes)


def rule_of(module):
    """The key of ALLOWED that governs `module`."""
    fitting = [key for key in ALLOWED if within(module, (key,))]
    return max(fitting, key=len, default=None)


def module_name(path, root):
    """Dotted name of the module in `path`."""
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path, root):
    """(line, dotted name) of everything that a file imports, in functions too."""
    package = module_name(path, root).split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    imports = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imports += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            imports += [(node.lineno, f"{source}.{alias.name}") for alias in node.names]
        elif isinstance(node, ast.Call) and node.args:
            name = getattr(node.func, "attr", getattr(node.func, "id", None))
            target = node.args[0]
            if name in ("import_module", "__import__") and isinstance(target, ast.Constant):
                imports.append((node.lineno, str(target.value)))
    return imports


def upward(module, target):
    """Whether a module of tracked_env imports a part that comes after its own."""
    places = [
        ORDER.index(parts[1]) if len(parts) > 1 and parts[1] in ORDER else -1
        for parts in (module.split("."), target.split("."))
        if parts[0] == "tracked_env"
    ]
    return len(places) == 2 and 0 <= places[0] < places[1]


def violations(root):
    """Every import below `root` that breaks a rule, as 'file:line imports what'."""
    paths = [path for name in OURS for path in sorted((root / name).rglob("*.py"))]
    paths += [path for name in OURS if (path := root / f"{name}.py").exists()]
    broken = []
    for path in paths:
        name = module_name(path, root)
        rule = rule_of(name)
        if rule is None:
            continue
        for line, target in imported_modules(path, root):
            stranger = within(target, OURS) and not within(target, ALLOWED[rule])
            if stranger or upward(name, target) or within(target, FORBIDDEN.get(rule, ())):
                broken.append(f"{path.relative_to(root)}:{line} imports {target}")
    return broken


def test_imports_follow_the_rules_of_the_layout(repository):
    assert (repository / "tracked_env" / "physics").is_dir()
    assert violations(repository) == []


PARAMETERS, LQR = "tracked_env/physics/parameters.py", "baselines/linearizing/lqr.py"
RUNNER, MAIN = "tracked_env/benchmark/runner.py", "tracked_env/cli/main.py"
FORBIDDEN_LINES = [
    (PARAMETERS, "from tracked_env import observation"),
    (PARAMETERS, "from .. import observation"),
    (PARAMETERS, "import agents"),
    ("tracked_env/plants/__init__.py", "from tracked_env.engine.episode import Episode"),
    ("tracked_env/terrain/ground.py", "def f():\n    from .. import plants"),
    ("tracked_env/arrays.py", "from tracked_env import step"),
    ("tracked_env/engine/reset.py", "import tracked_env.benchmark.runner"),
    ("tracked_env/env.py", "from baselines.linearizing import lqr"),
    ("tracked_env/env.py", "import importlib; importlib.import_module('baselines')"),
    (RUNNER, "def f():\n    import agents.archive"),
    (LQR, "from tracked_env.env import TrackedVehicleEnv"),
    (LQR, "import tracked_env"),
    (LQR, "import gymnasium as gym"),
    ("baselines/learned/agent_policy.py", "def f():\n    import torch"),
    (MAIN, "def f():\n    from baselines import registry"),
    (MAIN, "import torch"),
    ("baselines/slip/slip_models.py", "from agents import networks"),
    ("agents/archive.py", "import evaluate"),
    ("train.py", "from evaluate import main"),
    ("evaluate.py", "from tests.conftest import ROOT"),
]
ALLOWED_LINES = [
    (PARAMETERS, "from . import parameters"),
    (RUNNER, "from ..physics import state"),
    (LQR, "from tracked_env import observation"),
    (LQR, "from tracked_env.physics.parameters import VehicleState"),
    (LQR, "from baselines.slip.slip_models import SlipModel"),
    ("evaluate.py", "import tracked_env, baselines, agents"),
]


@pytest.mark.parametrize(("file", "line"), FORBIDDEN_LINES + ALLOWED_LINES)
def test_a_forbidden_import_is_found_and_an_allowed_one_is_not(file, line, tmp_path):
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text(f"{line}\n")
    assert len(violations(tmp_path)) == ((file, line) in FORBIDDEN_LINES)


def test_importing_the_package_loads_no_heavy_optional_dependency():
    heavy = ("torch", "stable_baselines3", "matplotlib", "pygame", "moviepy")
    code = f"import sys, tracked_env; print(*[m for m in {heavy} if m in sys.modules])"
    assert python("-c", code).stdout.split() == []


def test_every_part_of_the_package_has_a_place_in_the_order(repository):
    files = (repository / "tracked_env").iterdir()
    parts = {path.stem for path in files if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert parts == {"__init__", *ORDER}


def test_making_an_environment_loads_a_package_that_one_person_can_read():
    code = (
        "import sys, gymnasium; gymnasium.make('tracked_env:tracked_env/Torque-v0')\n"
        "print(*(m.__file__ for n, m in sys.modules.items() if n.split('.')[0] == 'tracked_env'))"
    )
    files = python("-c", code).stdout.split()
    assert len(files) > 20
    lines = sum(len(Path(file).read_text(encoding="utf-8").splitlines()) for file in files)
    assert (len(files) <= LOADED[0], lines <= LOADED[1]) == (True, True), (len(files), lines)
